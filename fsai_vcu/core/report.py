"""What the bridge counts, and what it knows as one immutable snapshot: for nodes, status line, log and judge."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from fsai_vcu.core.driving import Motion, Run
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.supervision.readiness import READY_WAIT_NS
from fsai_vcu.core.supervision.reasons import Reason, words_of
from fsai_vcu.core.supervision.supervisor import Decision
from fsai_vcu.interface.images import AiCommand, GpsImu, VehicleState
from fsai_vcu.interface.immutable import Immutable

NOTHING: Mapping[str, int] = MappingProxyType({})

_OTHER_REVISION_FROM = 10  # frames in a row: interface specification v4.0 counts a loss in tens as well
_PROBLEMS_KEPT = 100  # distinct texts: a fuzzed bus must not fill the memory
_OTHER_PROBLEMS = "other problems"


@dataclass(slots=True)
class Tally:
    """What the bridge counts for its report: nothing that is sent depends on it, so it is no part of the state."""

    active: frozenset[Reason] = frozenset()  # in the last cycle
    counts: Counter[str] = field(default_factory=Counter)
    details: dict[str, str] = field(default_factory=dict)
    problems: Counter[str] = field(default_factory=Counter)
    rx: Counter[int] = field(default_factory=Counter)
    intruders: dict[int, tuple[int, str]] = field(default_factory=dict)  # by id: when last received, and with what
    other_revision: str = ""
    other_revision_frames: int = 0  # in a row
    cycles: int = 0
    incomplete_cycles: int = 0
    vcu_gaps: int = 0
    loop_faults: int = 0
    unanswered_ns: int | None = None  # the oldest 0x520 that no cycle has answered
    response_ns: int | None = None
    response_max_ns: int | None = None

    def note(self, reason: Reason, detail: str = "") -> None:
        """Something that happened once."""
        self.counts[reason.slug] += 1
        self.details[reason.slug] = detail

    def activate(self, decision: Decision, reasons: frozenset[Reason]) -> None:
        """The reasons active in this cycle; each is counted when it comes up, not for as long as it lasts."""
        for reason, detail in decision.details:
            self.details[reason.slug] = detail
        if reasons != self.active:
            for reason in reasons - self.active:
                self.counts[reason.slug] += 1
            self.active = reasons

    def problem(self, problem: str) -> None:
        """A received frame, or a call, that is not in order."""
        if problem not in self.problems and len(self.problems) >= _PROBLEMS_KEPT:
            problem = _OTHER_PROBLEMS
        self.problems[problem] += 1

    def on_revision(self, heard: str, means: str, ours: str) -> None:
        """A frame that only revision `heard` sends: another than ours is believed when it comes again and again."""
        if heard == ours:
            self.other_revision_frames = 0
            return
        self.other_revision_frames += 1
        if self.other_revision_frames == _OTHER_REVISION_FROM:
            self.other_revision = f"the car speaks interface revision {heard} ({means}), this bridge {ours}"
            self.problem(self.other_revision)

    def answered(self, now_ns: int) -> None:
        """A cycle was made, which answers every 0x520 before it."""
        self.cycles += 1
        if self.unanswered_ns is not None:
            self.response_ns = max(0, now_ns - self.unanswered_ns)
            self.response_max_ns = max(self.response_ns, self.response_max_ns or 0)
            self.unanswered_ns = None

    def received_wrongly(self, now_ns: int) -> tuple[str, ...]:
        """What should not be on the bus, in words."""
        # Named for as long as the car has to stand in AS_READY: who sends now and then is seen before Go.
        heard = [
            f"an intruder sends on our ids: {words}"
            for t_ns, words in self.intruders.values()
            if now_ns - t_ns < READY_WAIT_NS
        ]
        if self.other_revision_frames >= _OTHER_REVISION_FROM:
            heard.append(self.other_revision)
        return tuple(heard)


@dataclass(frozen=True, slots=True)
class BridgeReport(Immutable):
    """A snapshot at `t_ns` (monotonic). Ages are None for what was never heard."""

    t_ns: int
    mode: str
    run: Run
    vehicle: VehicleState
    gps: GpsImu
    command: AiCommand  # the last one made; the safe default before the first
    motion: Motion
    phase: str  # the row of the output table that is being sent, in words
    emergency: str | None  # why ESTOP_REQUEST is latched
    stopping: str | None  # why the car is being stopped, or was
    reasons: tuple[str, ...]  # short names of the reasons active in the last cycle
    reason_counts: Mapping[str, int]  # how often each has come up since the start
    reason_details: Mapping[str, str]  # the newest detail of each, where there is one
    why_not_driving: tuple[str, ...]  # empty while driving
    standing: bool  # all wheels fresh and under 10 rpm for 0.5 s
    confirmed: tuple[str, ...]  # who has confirmed the reset for this run
    vcu_lost: bool  # no believable 0x520 for 100 ms, or never
    bus_lost: str | None
    shutdown_requested: bool  # SHUTDOWN_REQUEST seen at rest: flush the logs
    listen_only: bool
    limits: OperationalLimits = UNLIMITED
    cycles: int = 0  # made
    incomplete_cycles: int = 0  # not sent whole
    vcu_gaps: int = 0  # times that 0x520 was missing for 50 ms or more
    loop_faults: int = 0  # exceptions and missed deadlines, in any AS state
    response_ns: int | None = None  # from the newest 0x520 to the cycle that answered it
    response_max_ns: int | None = None
    rx_counts: Mapping[int, int] = field(default_factory=lambda: MappingProxyType({}))  # by id
    problem_counts: Mapping[str, int] = field(default_factory=lambda: NOTHING)  # of received frames, by their words
    ages_ns: Mapping[str, int | None] = field(default_factory=lambda: MappingProxyType({}))  # by message
    unknown: str = ""  # what the signal database lacks, and what follows

    @property
    def autonomous(self) -> bool:
        return self.mode == "autonomous"

    @property
    def sentences(self) -> tuple[str, ...]:
        """The active reasons in words, with their details."""
        return tuple(
            words_of(slug) + (f" ({detail})" if (detail := self.reason_details.get(slug)) else "")
            for slug in self.reasons
        )
