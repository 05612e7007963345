"""Counts that the bridge keeps for its report.

Nothing that is sent depends on them, so they are no part of the bridge's state.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from fsai_vcu.core.report import IDS_KEPT, PROBLEMS_KEPT
from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.core.supervision.supervisor import Decision
from fsai_vcu.interface.specification import READY_WAIT_NS
from fsai_vcu.interface.units import S
from fsai_vcu.interface.values import DETAIL_LENGTH, shortened

_OTHER_REVISION_FROM = 10  # frames: interface specification v4.0 counts a loss in tens as well
_OTHER_REVISION_PAUSE_NS = 1 * S  # after which they count again from 0
_OTHER_PROBLEMS = "other problems"


@dataclass(slots=True)
class Tally:
    """Counted since the start. Times are of the monotonic clock, None: never."""

    active: frozenset[Reason] = frozenset()  # in the last cycle
    counts: Counter[str] = field(default_factory=Counter)
    details: dict[str, str] = field(default_factory=dict)
    problems: Counter[str] = field(default_factory=Counter)
    rx: Counter[int] = field(default_factory=Counter)
    intruders: dict[int, tuple[int, str]] = field(default_factory=dict)  # by id: when last received, and with what
    other_revision: str = ""
    other_revision_frames: int = 0  # without a pause
    other_revision_ns: int = 0  # the last of them
    cycles: int = 0
    incomplete_cycles: int = 0
    vcu_gaps: int = 0
    loop_faults: int = 0
    unanswered_ns: int | None = None  # the oldest 0x520 that no cycle has answered
    response_ns: int | None = None
    response_max_ns: int | None = None

    def received(self, can_id: int) -> None:
        """A data frame of a short identifier."""
        if can_id in self.rx or len(self.rx) < IDS_KEPT:
            self.rx[can_id] += 1

    def note(self, reason: Reason, detail: str = "") -> None:
        """Something that happened once."""
        self.counts[reason.slug] += 1
        self.details[reason.slug] = shortened(detail, DETAIL_LENGTH)

    def activate(self, decision: Decision, reasons: frozenset[Reason]) -> None:
        """The reasons active in this cycle; each is counted when it comes up, not for as long as it lasts."""
        for reason, detail in decision.details:
            self.details[reason.slug] = shortened(detail, DETAIL_LENGTH)
        if reasons != self.active:
            for reason in reasons - self.active:
                self.counts[reason.slug] += 1
            self.active = reasons

    def problem(self, problem: str) -> None:
        """A received frame, or a call, that is not in order."""
        problem = shortened(problem, DETAIL_LENGTH)
        if problem not in self.problems and len(self.problems) >= PROBLEMS_KEPT - 1:
            problem = _OTHER_PROBLEMS
        self.problems[problem] += 1

    def on_revision(self, received: str, means: str, ours: str, t_ns: int) -> None:
        """Take in a frame that only revision `received` sends.

        A revision other than the bridge's (`ours`) is named when it comes again and again, also between frames of
        `ours`.
        """
        if received == ours:
            return
        if t_ns - self.other_revision_ns >= _OTHER_REVISION_PAUSE_NS:
            self.other_revision_frames = 0
        self.other_revision_frames += 1
        self.other_revision_ns = t_ns
        if self.other_revision_frames == _OTHER_REVISION_FROM:
            self.other_revision = f"the car uses interface revision {received} ({means}), this bridge {ours}"
            self.problem(self.other_revision)
            self.note(Reason.OTHER_REVISION, self.other_revision)

    def answered(self, now_ns: int) -> None:
        """A cycle was made, which answers every 0x520 before it."""
        self.cycles += 1
        if self.unanswered_ns is not None:
            self.response_ns = max(0, now_ns - self.unanswered_ns)
            self.response_max_ns = max(self.response_ns, self.response_max_ns or 0)
            self.unanswered_ns = None

    def received_wrongly(self, now_ns: int) -> tuple[str, ...]:
        """Name what should not be on the bus, in words."""
        # Named for as long as the car has to stand in AS_READY: the sender of a rare frame is seen before Go.
        found = [
            (t_ns, f"a second sender uses the AI computer's ids: {words}") for t_ns, words in self.intruders.values()
        ]
        if self.other_revision_frames >= _OTHER_REVISION_FROM:
            found.append((self.other_revision_ns, self.other_revision))
        return tuple(words for t_ns, words in found if now_ns - t_ns < READY_WAIT_NS)
