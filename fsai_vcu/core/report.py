"""What the bridge knows, as one immutable snapshot: for the nodes, the status line, the log and the judge."""

from __future__ import annotations

from collections.abc import Mapping

from fsai_vcu.core.driving import Motion, Run
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.supervision.reasons import words_of
from fsai_vcu.interface.messages import AiCommand, GpsImu, VehicleState
from fsai_vcu.interface.values import Value


class BridgeReport(Value, frozen=True):
    """A snapshot at `t_ns` (monotonic). Ages are None for what was never received."""

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
    limits: OperationalLimits
    cycles: int  # made
    incomplete_cycles: int  # not sent whole
    vcu_gaps: int  # times that 0x520 was missing for 50 ms or more
    loop_faults: int  # exceptions and missed deadlines, in any AS state
    response_ns: int | None  # from the newest 0x520 to the cycle that answered it
    response_max_ns: int | None
    rx_counts: Mapping[int, int]  # by id
    problem_counts: Mapping[str, int]  # of received frames, by their words
    ages_ns: Mapping[str, int | None]  # by message
    unknown: str  # what the signal database lacks, and what follows

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
