"""The demands of the safety rules when something breaks, as an observer outside can check them.

Times are milliseconds from the fault (or from the moment at which it shows), as the table of graded reactions gives
them; what an observer may measure on top of them is `SLACK_MS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, Final

from fsai_hil.rules import numbers as n
from fsai_hil.rules.numbers import MS
from fsai_vcu.interface.values import Value

Params = Mapping[str, Any]  # what was drawn for a fault, by name

# Safety rules, graded reactions.
COMMAND_STALE_MS: Final = n.COMMAND_FRESH_NS // MS
COMMAND_LOST_MS: Final = n.COMMAND_LOST_NS // MS
SENSOR_STALE_MS: Final = n.DATA_FRESH_NS // MS
BOTH_PEDALS_MS: Final = n.PEDALS_NS // MS
VCU_STALE_MS: Final = n.STATUS_FRESH_NS // MS
FEEDBACK_STALE_MS: Final = n.FEEDBACK_STALE_NS // MS
FEEDBACK_LOST_MS: Final = n.FEEDBACK_LOST_NS // MS
IMPLAUSIBLE_MS: Final = n.ODD_NS // MS
IMPLAUSIBLE_LOST_MS: Final = n.ODD_LOST_NS // MS
DECELERATION_MS: Final = 500  # of a service-brake stop: so long without a deceleration, and it is an emergency
STOP_MS: Final = n.STOP_TIMEOUT_NS // MS  # a service-brake stop that lasts longer becomes an emergency
CAR_PATIENCE_MS: Final = n.CAR_PATIENCE_NS // MS

# A reaction is decided in a 10 ms cycle, the fault may begin just after one, and at most 15 ms pass without 0x520.
SLACK_MS: Final = 25
CONTROL_MS: Final = 20  # a command comes every 20 ms: what is wrong with it shows that much later
PLAN_MS: Final = 90  # cones come every 50 ms, and are planned with after 40 ms


class End(Enum):
    """The end of a run, seen from outside, in the words of the tables."""

    ON = "drives on"
    HELD = "stays in AS_DRIVING, torque 0"
    STOP = "service-brake stop, FINISHED"
    ESTOP = "EMERGENCY_BRAKE by our ESTOP_REQUEST"
    SELF = "the car stops itself"
    OFF = "falls back to AS_OFF"
    NOT_STARTED = "does not start to drive"
    UNSAFE = "does not end: moves where it must stand, or never sends FINISHED"


class Onset(Enum):
    """From when the allowed times count."""

    FAULT = "the fault"
    STEERING = "the steering certainly being off its request"
    WHEEL = "one wheel certainly being off the other three"
    COUNTS = "a wheel speed and its pulse count certainly contradicting each other"


class Demand(Value, frozen=True):
    """The reaction that must follow a fault. A time of None is not limited by the rules.

    `no_torque_ms`: from then on no torque is requested, for as long as the fault lasts (to the end where the run must
    end). `brake_ms`, `estop_ms`: when the service brake and ESTOP_REQUEST are on the wire, where the run ends so;
    ESTOP_REQUEST also where the car stops itself meanwhile. `safe_ms`: the car stands, or its EBS acts.
    `own_word`: that the controller reports that the mission is over is no fault, and ends the run as it should.
    `note`: why, or what the rules on the wire hold besides.
    """

    ends: frozenset[End]
    no_torque_ms: float | None = None
    brake_ms: float | None = None
    estop_ms: float | None = None
    safe_ms: float | None = None
    onset: Onset = Onset.FAULT
    own_word: bool = True
    note: str = ""

    def demand(self, p: Params) -> Demand:
        """The same whatever was drawn."""
        return self

    @property
    def words(self) -> str:
        """Name the ends that are allowed."""
        if self.ends == SAFE_ENDS:
            return "drives on, or stands in the end"
        return " or ".join(end.value.partition(",")[0] for end in End if end in self.ends)

    @property
    def demanded(self) -> str:
        """All of it in words; times are from the fault or the onset, what an observer may measure on top included."""
        named = ("torque 0", self.no_torque_ms), ("service brake", self.brake_ms), ("ESTOP_REQUEST", self.estop_ms)
        times = [f"{what} within {ms:g} ms" for what, ms in (*named, ("safe", self.safe_ms)) if ms is not None]
        since = "" if self.onset is Onset.FAULT else f" of {self.onset.value}"
        limits = f" ({', '.join(times)}{since})" if times else ""
        return (f"{self.note}: " if self.note else "") + self.words + limits


def ends(*allowed: End, **limits: Any) -> Demand:
    """A demand of which only the ends, and the limits named, count."""
    return Demand(frozenset(allowed), **limits)


SAFE_ENDS: Final = frozenset(End) - {End.UNSAFE}

NOTHING: Final = ends(End.ON)
ANY: Final = Demand(SAFE_ENDS, note="it cannot be told from the truth")
CAR_STOPS: Final = ends(End.SELF, End.ESTOP, safe_ms=CAR_PATIENCE_MS + SLACK_MS)
MAY_STOP_ITSELF: Final = ends(End.ON, End.SELF)


def held(after_ms: float) -> Demand:
    """Torque 0 after so long, and on again when the fault is over."""
    return ends(End.ON, no_torque_ms=after_ms + SLACK_MS)


def stop(after_ms: float, torque_ms: float | None = None) -> Demand:
    """A service-brake stop after so long, or the emergency brake where that does not do."""
    return ends(
        End.STOP,
        no_torque_ms=(after_ms if torque_ms is None else torque_ms) + SLACK_MS,
        brake_ms=after_ms + SLACK_MS,
        safe_ms=after_ms + STOP_MS + SLACK_MS,
    )


def estop(after_ms: float, torque_ms: float | None = None) -> Demand:
    """ESTOP_REQUEST after so long."""
    return ends(
        End.ESTOP,
        no_torque_ms=(after_ms if torque_ms is None else torque_ms) + SLACK_MS,
        estop_ms=after_ms + SLACK_MS,
        safe_ms=after_ms + SLACK_MS + 10,
    )


def implausible(
    onset: Onset, brake_ms: float = IMPLAUSIBLE_MS, estop_ms: float = IMPLAUSIBLE_LOST_MS, note: str = ""
) -> Demand:
    """A stop, then ESTOP_REQUEST, so long after `onset`; before it nothing is demanded."""
    allowed = frozenset((End.ON, End.HELD, End.STOP, End.ESTOP))
    return Demand(allowed, brake_ms=brake_ms + SLACK_MS, estop_ms=estop_ms + SLACK_MS, onset=onset, note=note)


class Graded(Value, frozen=True):
    """The demand by a message's age, which the parameter `of` gives: another from each of `steps` (age in ms) on.

    Below the first step nothing is demanded.
    """

    steps: tuple[tuple[float, Demand], ...] = ()
    of: str = "duration"

    def demand(self, p: Params) -> Demand:
        return next((demand for after_ms, demand in reversed(self.steps) if p[self.of] >= after_ms), NOTHING)

    @property
    def demanded(self) -> str:
        first, *later = self.steps if self.steps and not self.steps[0][0] else ((0, NOTHING), *self.steps)
        return "; ".join((first[1].demanded, *(f"from {ms:g} ms on: {demand.demanded}" for ms, demand in later)))


class Computed(Value, frozen=True):
    """The demand of a kind of fault as a function of what was drawn, and that in words."""

    demanded: str
    demand: Callable[[Params], Demand]


Must = Demand | Graded | Computed
