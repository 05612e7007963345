"""Plays many cases, keeps those that reach something new, and cuts down those that break a rule.

How deep the fuzzer goes is measured by what it reached: AS states, phases and their changes, reasons, causes of stops
and emergencies, and which of them came together. A case that reached anything for the first time becomes a parent.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from random import Random
from typing import Final

from fsai_hil.evidence.fuzz_cases import TOURS, changed, lineage_depth, make, shortened
from fsai_hil.evidence.fuzz_events import FuzzCase, FuzzEvent
from fsai_hil.evidence.fuzz_run import Played, play
from fsai_hil.rules.violation import Violation
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.supervisor import Asked, Latch, Phase
from fsai_vcu.interface.enums import AsState

Reached = tuple[str, ...]

KINDS: Final = ("AS state", "phase", "change", "reason", "stop", "emergency", "together")
_DEEPEST: Final = 12  # changes from one fresh case on
_REPLAYS: Final = 600  # while one case is being cut down


def _cause(latch: Latch | None) -> str:
    if latch is None:
        return "none"
    return latch.cause.slug if isinstance(latch.cause, Reason) else latch.cause.name


def look(played: Played) -> None:
    """Note what a cycle has reached."""
    bridge, active = played.bridge.state, played.bridge.tally.active
    state, decision = bridge.supervisor, bridge.decision
    seen = (state.as_state, decision.phase, state.stop, state.emergency, active)
    before = played.seen
    if seen == before:
        return
    played.seen = seen
    reached = played.reached
    as_state = "none yet" if state.as_state is None else state.as_state.name
    stop, emergency = _cause(state.stop), _cause(state.emergency)
    phase = decision.phase.name
    reached.add(("AS state", as_state))
    reached.add(("phase", phase))
    if isinstance(before, tuple):
        reached.add(("change", before[1].name, phase))
    reached.add(("stop", stop))
    reached.add(("emergency", emergency))
    for reason in active:
        reached.add(("reason", reason.slug))
        reached.add(("together", phase, reason.slug, stop))


def expected() -> dict[str, frozenset[str]]:
    """Everything there is to reach, by kind, as far as it is a plain list."""
    reasons = frozenset(reason.slug for reason in Reason)
    asked = frozenset(cause.name for cause in Asked)
    return {
        "AS state": frozenset(state.name for state in AsState),
        "phase": frozenset(phase.name for phase in Phase),
        "reason": reasons,
        "stop": asked | reasons,
        "emergency": asked | reasons,
    }


@dataclass(slots=True)
class Failure:
    """A case that breaks a rule."""

    case: FuzzCase
    problem: Violation


@dataclass(slots=True)
class Tally:
    """What a run of the fuzzer did."""

    cases: int = 0
    cycles: int = 0
    frames: int = 0
    simulated_s: float = 0.0
    seconds: float = 0.0
    corpus: int = 0
    reached: set[Reached] = field(default_factory=set)
    failures: list[Failure] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        self.cases += other.cases
        self.cycles += other.cycles
        self.frames += other.frames
        self.simulated_s += other.simulated_s
        self.corpus += other.corpus
        self.reached |= other.reached
        self.failures += other.failures

    def count(self, kind: str) -> int:
        return sum(one[0] == kind for one in self.reached)


def play_watched(case: FuzzCase) -> tuple[Played, list[Violation]]:
    """Play a case and note what it reaches."""
    played, problems = play(case, look)
    report = played.bridge.report(played.now_ns)
    played.reached.update(("reason", slug) for slug in report.reason_counts)
    return played, problems


class Fuzzer:
    """Cases of one seed, one after another; those that reached something new become parents of others."""

    def __init__(self, seed: str) -> None:
        self._seed = seed
        self._parents: list[FuzzCase] = []
        self._chance = Random(f"corpus {seed}")
        self._reached: set[Reached] = set()
        self._number = 0

    def _next(self) -> FuzzCase:
        number, self._number = self._number, self._number + 1
        if number < TOURS:
            return make(f"tour-{number}-{self._seed}")
        if self._parents and self._chance.random() < 0.6:
            before = self._chance.choice(self._parents)
            origin = f"{before.origin}.{number}"
            return replace(changed(before, Random(origin)), origin=origin)
        return make(f"{self._seed}-{number}")

    def run(
        self,
        *,
        cases: int | None = None,
        until_s: float | None = None,
        cpu_s: float = math.inf,
        stop_at_failures: int = 3,
    ) -> Tally:
        """Play until so many cases are done, or `time.monotonic()` is `until_s`, or so much processor time is spent."""
        tally = Tally()
        began_s, began_cpu_s = time.monotonic(), time.process_time()
        while (
            (cases is None or tally.cases < cases)
            and (until_s is None or time.monotonic() < until_s)
            and time.process_time() - began_cpu_s < cpu_s
            and len(tally.failures) < stop_at_failures
        ):
            case = self._next()
            played, problems = play_watched(case)
            tally.cases += 1
            tally.cycles += played.cycles
            tally.frames += played.frames
            tally.simulated_s += played.played_ns / 1e9
            tally.reached |= played.reached
            if problems:
                tally.failures.append(Failure(case, problems[0]))
            elif not played.reached <= self._reached and lineage_depth(case.origin) < _DEEPEST:
                self._parents.append(case)
                tally.corpus += 1
            self._reached |= played.reached
        tally.seconds = time.monotonic() - began_s
        return tally


def fuzz(seed: str, *, cases: int | None = None, cpu_s: float = math.inf, stop_at_failures: int = 3) -> Tally:
    """The first so many cases of `seed`. The same seed, the same cases."""
    return Fuzzer(seed).run(cases=cases, cpu_s=cpu_s, stop_at_failures=stop_at_failures)


_DIGITS: Final = re.compile(r"[-\d.]+")


def _same(one: Violation, other: Violation) -> bool:
    """The same rule, in the same words but for the numbers."""
    return one.rule == other.rule and _DIGITS.sub("", one.words) == _DIGITS.sub("", other.words)


def minimised(failure: Failure) -> Failure:
    """The failure with the fewest events that still show it."""
    case, left = failure.case, _REPLAYS

    def fails(events: tuple[FuzzEvent, ...]) -> bool:
        nonlocal left
        left -= 1
        if left < 0:
            return False
        _, problems = play(FuzzCase(case.setup, case.station, events))
        return bool(problems) and _same(problems[0], failure.problem)

    events = shortened(case.events, fails)
    small = FuzzCase(case.setup, case.station, events, case.origin)
    _, problems = play(small)
    return Failure(small, problems[0]) if problems else failure


def story(case: FuzzCase) -> tuple[list[str], list[Violation]]:
    """What happens in a case, line by line, and what it breaks."""
    from fsai_hil.evidence.fuzz_run import at_station

    lines: list[str] = []
    played = at_station(case.setup, case.station)
    played.say = lines.append
    return lines, played.play(case.events)


def described(failure: Failure) -> list[str]:
    """A failure in words."""
    lines, problems = story(failure.case)
    told = [f"rule {one.rule}: {one.words}" for one in problems[:5]]
    return [
        f"breaks rule {failure.problem.rule}: {failure.problem.words}",
        f"found as case {failure.case.origin}; what happens, from the station {failure.case.station!r} on:",
        *lines,
        *told,
    ]


def unreached(reached: Iterable[Reached], kind: str) -> frozenset[str]:
    """What of `expected` was not reached."""
    return expected()[kind] - {one[1] for one in reached if one[0] == kind}
