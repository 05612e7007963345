"""Report of what the bridge knows, one immutable snapshot: for the nodes, the status line, the log and the judge."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from msgspec import Meta

from fsai_vcu.core.driving import Motion, Run
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.supervision.config import Reason, words_of
from fsai_vcu.interface.messages import AiCommand, GpsImu, VehicleState
from fsai_vcu.interface.values import Count, Detail, Sentence, Value, Whole, Word

REASONS_KEPT: Final = 48  # there are fewer
PROBLEMS_KEPT: Final = 101  # distinct texts, the last of them for all others: a fuzzed bus must not fill the memory
IDS_KEPT: Final = 128  # those that the bridge receives are fewer
WHYS_KEPT: Final = 12
UNKNOWN_LENGTH: Final = 4000  # names of signals


class BridgeReport(Value, frozen=True):
    """A snapshot at `t_ns` (monotonic). Ages are None for what was never received. Texts have been shortened."""

    t_ns: Whole
    mode: Word
    run: Run
    vehicle: VehicleState
    gps: GpsImu
    command: AiCommand  # the last one made; the safe default before the first
    motion: Motion
    phase: Sentence  # the row of the output table that is being sent, in words
    emergency: Sentence | None  # why ESTOP_REQUEST is latched
    stopping: Sentence | None  # why the car is being stopped, or was
    # short names of the reasons active in the last cycle
    reasons: Annotated[tuple[Word, ...], Meta(max_length=REASONS_KEPT)]
    # how often each has come up since the start
    reason_counts: Annotated[Mapping[Word, Count], Meta(max_length=REASONS_KEPT)]
    # the newest detail of each, where there is one
    reason_details: Annotated[Mapping[Word, Detail], Meta(max_length=REASONS_KEPT)]
    why_not_driving: Annotated[tuple[Sentence, ...], Meta(max_length=WHYS_KEPT)]  # empty while driving
    standing: bool  # all wheels fresh and under 10 rpm for 0.5 s
    confirmed: Annotated[tuple[Word, ...], Meta(max_length=4)]  # who has confirmed the reset for this run
    vcu_lost: bool  # no believable 0x520 for 100 ms, or never
    bus_lost: Sentence | None
    shutdown_requested: bool  # SHUTDOWN_REQUEST seen at rest: flush the logs
    listen_only: bool
    limits: OperationalLimits
    cycles: Count  # made
    incomplete_cycles: Count  # not sent whole
    vcu_gaps: Count  # times that 0x520 was missing for 50 ms or more
    loop_faults: Count  # exceptions and missed deadlines, in any AS state
    response_ns: Count | None  # from the newest 0x520 to the cycle that answered it
    response_max_ns: Count | None
    rx_counts: Annotated[Mapping[int, Count], Meta(max_length=IDS_KEPT)]  # by id
    # of received frames, by their words
    problem_counts: Annotated[Mapping[Detail, Count], Meta(max_length=PROBLEMS_KEPT)]
    ages_ns: Annotated[Mapping[Word, Whole | None], Meta(max_length=16)]  # by message
    unknown: Annotated[str, Meta(max_length=UNKNOWN_LENGTH)]  # what the signal database lacks, and what follows

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


def loop_fault_words(count: int) -> str:
    """The clause on a CAN loop that came too late so many times since it began; '' for none."""
    times = f"{count} time{'s' * (count > 1)}"
    return f"{words_of(Reason.LOOP_FAULT.slug)}, {times} so far: is this computer too busy?" if count else ""
