"""Breadth-first search over everything that can happen, with the shortest way to what must not.

Generic: it knows states, moves and problems, and nothing of cars. States are visited in the order of their distance
from the beginning, so the first problem found has a shortest trace.

A model has `initial()`, the first state; `moves(state)`, every move, where of several with one label the last is the
one on which time passes most; `safe(state)`; and `endings`: the ways in which the environment can behave from any
moment on, each with the label it keeps choosing and the time in ns within which a safe end must come.
"""

from __future__ import annotations

import gc
import itertools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

from fsai_hil.rules.seen import Violation
from fsai_vcu.interface.values import Value


class Move(Value, frozen=True):
    """One thing that can happen in a state. `label` numbers the environment's choice; `seen` describes the outcome."""

    label: int
    duration_ns: int
    target: Hashable
    problems: tuple[Violation, ...] = ()
    seen: object = None


@dataclass(slots=True)
class Search:
    """The result of a search."""

    states: int = 0
    transitions: int = 0
    depth: int = 0
    problems: tuple[Violation, ...] = ()
    trace: list[Move] = field(default_factory=list)
    bounds_ns: dict[str, int] = field(default_factory=dict)  # by ending: the longest way to a safe end

    @property
    def holds(self) -> bool:
        return not self.problems


def explore(model: Any) -> Search:
    """Visit every reachable state; stop at the first problem."""
    visit = _Visit(model)
    gc.disable()  # states hold no cycles, and the collector would go over all of them again and again
    try:
        if not visit.finds_problem():
            for name, (label, bound_ns) in model.endings.items():
                if visit.misses_the_end(name, label, bound_ns):
                    break
    finally:
        gc.enable()
    return visit.found


class _Visit:
    """One search under way. States are known by their number."""

    def __init__(self, model: Any) -> None:
        self.found = Search()
        self._model = model
        self._states: list[Hashable] = [model.initial()]
        self._parents = [-1]
        # By label of an ending: where each state's move leads, and how long that takes.
        self._onward: dict[int, list[tuple[int, int]]] = {label: [] for label, _ in model.endings.values()}

    def finds_problem(self) -> bool:
        """Visit all states, as far as the first problem."""
        found, states = self.found, self._states
        number = {states[0]: 0}
        depths = [0]
        for at, state in enumerate(states):  # which grows meanwhile
            next_of: dict[int, tuple[int, int]] = {}
            for move in self._model.moves(state):
                found.transitions += 1
                if move.problems:
                    found.states, found.depth, found.problems = len(states), depths[at] + 1, move.problems
                    found.trace = [*self._trace(at), move]
                    return True
                target = number.setdefault(move.target, len(states))
                if target == len(states):
                    states.append(move.target)
                    self._parents.append(at)
                    depths.append(depths[at] + 1)
                if move.label in self._onward:
                    next_of[move.label] = (target, move.duration_ns)
            for label, ways in self._onward.items():
                ways.append(next_of.get(label, (at, 0)))
        found.states, found.depth = len(states), depths[-1]
        return False

    def misses_the_end(self, name: str, label: int, bound_ns: int) -> bool:
        """Return whether the safe end comes never or too late after some state, under one ending.

        It is noted as a problem, with the way to it; otherwise the longest time until the safe end is noted.
        """
        found, ways = self.found, self._onward[label]
        safe = [self._model.safe(state) for state in self._states]
        left: list[int | None] = [0 if is_safe else None for is_safe in safe]  # time to the safe end
        worst = 0
        for start in range(len(self._states)):
            path: dict[int, None] = {}  # in order
            at = start
            while left[at] is None and at not in path:
                path[at] = None
                at = ways[at][0]
            time_ns = left[at]
            words = ""
            if time_ns is None:
                words = f"with {name} no safe end is ever reached"
            else:
                for index in reversed(path):
                    time_ns += ways[index][1]
                    left[index] = time_ns
                worst = max(worst, time_ns)
                if time_ns > bound_ns:
                    words = f"with {name} the safe end comes after {time_ns / 1e9:.3f} s, not {bound_ns / 1e9:g} s"
            if words:
                found.problems = (Violation("safe end", words),)
                end = [start]
                while not safe[end[-1]] and end[-1] not in end[:-1]:  # until it is safe, or repeats
                    end.append(ways[end[-1]][0])
                found.trace = [*self._trace(start), *self._moves(end, label)]
                found.depth = len(found.trace)
                return True
        found.bounds_ns[name] = worst
        return False

    def _trace(self, at: int) -> list[Move]:
        """The moves from the beginning to state `at`."""
        way = [at]
        while self._parents[way[-1]] >= 0:
            way.append(self._parents[way[-1]])
        return self._moves(way[::-1])

    def _moves(self, way: Sequence[int], label: int | None = None) -> list[Move]:
        """The moves from each of these states to the next, with that label."""
        return [
            next(
                move
                for move in self._model.moves(self._states[before])
                if move.target == self._states[after] and label in (None, move.label)
            )
            for before, after in itertools.pairwise(way)
        ]
