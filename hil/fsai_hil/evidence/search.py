"""Breadth-first search over everything that can happen, with the shortest way to what must not.

Generic: it knows states, moves and problems, and nothing of cars. States are visited in the order of their distance
from the beginning, so the first problem found has a shortest trace.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from fsai_hil.rules.violation import Violation

S = TypeVar("S", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Move(Generic[S]):
    """One thing that can happen in a state. `label` numbers the environment's choice; `seen` describes the outcome."""

    label: int
    duration_ns: int
    target: S
    problems: tuple[Violation, ...] = ()
    seen: object = None


class Model(Protocol[S]):
    """What is searched."""

    @property
    def endings(self) -> Mapping[str, int]:
        """Ways in which the environment can behave from any moment on, each by the label it keeps choosing.

        Under every one of them a safe end must come.
        """
        ...

    def initial(self) -> S: ...

    def moves(self, state: S) -> Iterable[Move[S]]:
        """Every move; where one label has several, the last is the one on which time passes most."""
        ...

    def safe(self, state: S) -> bool: ...


@dataclass(slots=True)
class Search(Generic[S]):
    """What a search found."""

    states: int = 0
    transitions: int = 0
    depth: int = 0
    complete: bool = True
    problems: tuple[Violation, ...] = ()
    trace: list[Move[S]] = field(default_factory=list)
    ending: str | None = None  # the environment's way under which no safe end comes
    bounds_ns: dict[str, int] = field(default_factory=dict)  # by ending: the longest way to a safe end
    safe_states: int = 0

    @property
    def holds(self) -> bool:
        return not self.problems and self.complete


def explore(model: Model[S], *, most_states: int = 2_000_000, bounds_ns: Mapping[str, int] | None = None) -> Search[S]:
    """Visit every reachable state; stop at the first problem.

    `bounds_ns` gives, for each ending, the time within which the safe end must come from every state.
    """
    first = model.initial()
    states: list[S] = [first]
    number: dict[S, int] = {first: 0}
    parents: list[int] = [-1]
    depths: list[int] = [0]
    endings = {label: name for name, label in model.endings.items()}
    onward: dict[int, list[tuple[int, int]]] = {label: [] for label in endings}
    found: Search[S] = Search()
    at = 0
    while at < len(states):
        state = states[at]
        next_of: dict[int, tuple[int, int]] = {}
        for move in model.moves(state):
            found.transitions += 1
            if move.problems:
                found.states, found.depth = len(states), depths[at] + 1
                found.problems = move.problems
                found.trace = [*_trace(model, states, parents, at), move]
                return found
            target = number.get(move.target)
            if target is None:
                target = number[move.target] = len(states)
                states.append(move.target)
                parents.append(at)
                depths.append(depths[at] + 1)
            if move.label in onward:
                next_of[move.label] = (target, move.duration_ns)
        for label, ways in onward.items():
            ways.append(next_of.get(label, (at, 0)))
        at += 1
        if len(states) > most_states:
            found.complete = False
            break
    found.states, found.depth = len(states), depths[-1]
    if found.complete:
        _endings(model, states, parents, onward, endings, bounds_ns or {}, found)
    return found


def _trace(model: Model[S], states: Sequence[S], parents: Sequence[int], at: int) -> list[Move[S]]:
    """The moves from the beginning to state `at`."""
    way = [at]
    while parents[way[-1]] >= 0:
        way.append(parents[way[-1]])
    way.reverse()
    trace: list[Move[S]] = []
    for before, after in itertools.pairwise(way):
        trace.append(next(move for move in model.moves(states[before]) if move.target == states[after]))
    return trace


def _endings(
    model: Model[S],
    states: Sequence[S],
    parents: Sequence[int],
    onward: Mapping[int, Sequence[tuple[int, int]]],
    names: Mapping[int, str],
    bounds_ns: Mapping[str, int],
    found: Search[S],
) -> None:
    """From every state, under every ending: how long until a safe state? Never, or too late, is a problem."""
    safe = [model.safe(state) for state in states]
    found.safe_states = sum(safe)
    for label, ways in onward.items():
        name = names[label]
        bound_ns = bounds_ns.get(name)
        left: list[int | None] = [0 if is_safe else None for is_safe in safe]  # time to the safe end
        worst = 0
        for start in range(len(states)):
            path: list[int] = []
            on_path: set[int] = set()
            at = start
            while left[at] is None and at not in on_path:
                path.append(at)
                on_path.add(at)
                at = ways[at][0]
            time_ns = left[at]
            if time_ns is None:
                found.problems = (Violation("safe end", f"with {name} no safe end is ever reached"),)
            else:
                for index in reversed(path):
                    time_ns += ways[index][1]
                    left[index] = time_ns
                worst = max(worst, time_ns)
                if bound_ns is not None and time_ns > bound_ns:
                    found.problems = (
                        Violation(
                            "safe end",
                            f"with {name} the safe end comes after {time_ns / 1e9:.3f} s, not {bound_ns / 1e9:g} s",
                        ),
                    )
            if found.problems:
                found.ending = name
                found.trace = _trace(model, states, parents, start)
                found.trace += _along(model, states, ways, label, start, safe)
                found.depth = len(found.trace)
                return
        found.bounds_ns[name] = worst


def _along(
    model: Model[S],
    states: Sequence[S],
    ways: Sequence[tuple[int, int]],
    label: int,
    start: int,
    safe: Sequence[bool],
) -> list[Move[S]]:
    """The moves that the environment's constant choice leads through, until they repeat."""
    moves: list[Move[S]] = []
    been: set[int] = set()
    at = start
    while at not in been and not safe[at]:
        been.add(at)
        there = ways[at][0]
        moves.append(next(m for m in model.moves(states[at]) if m.label == label and m.target == states[there]))
        at = there
    return moves
