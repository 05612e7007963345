"""The endings of a run, and which of them a fault may lead to.

What happens on the way, and by when, is judged by the checker of `rules/`: it knows the time of every graded reaction
to what the bridge is given.
Times here are milliseconds from the fault.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any, Final

from fsai_hil.rules.numbers import CAR_PATIENCE_NS, FEEDBACK_LOST_NS, MS
from fsai_vcu.interface.values import Value

Params = Mapping[str, Any]  # what was drawn for a fault, by name

# A reaction is decided in a 10 ms cycle, the fault may begin just after one, and at most 15 ms pass without 0x520.
SLACK_MS: Final = 25


class End(Enum):
    """The end of a run, seen from outside, in the words of the tables."""

    ON = "drives on"
    HELD = "stays in AS_DRIVING, torque 0"
    STOP = "service-brake stop, FINISHED"
    ESTOP = "EMERGENCY_BRAKE by ESTOP_REQUEST"
    SELF = "the car stops itself"
    OFF = "falls back to AS_OFF"
    NOT_STARTED = "does not start to drive"
    UNSAFE = "does not end: moves where it must stand, or never sends FINISHED"


class Must(Value, frozen=True):
    """The ends that are allowed after a fault.

    `pauses`: torque is 0 meanwhile, so the car may leave the course. `brake_ms`: the service brake of a stop is on,
    where the fault lies before the bridge: the checker knows the time of what the bridge is given only. `safe_ms`: the
    car stands, or its EBS acts; None where the checker's times are all. `asks`: ESTOP_REQUEST goes out by then, even
    where the car stops itself. `own_word`: that the controller reports that the mission is over is no fault, and ends
    the run as it should. `shows_late`: the reaction is timed from when steering or a wheel was certainly implausible.
    `note`: why, or what the rules on the wire hold besides.
    """

    ends: frozenset[End]
    pauses: bool = False
    brake_ms: float | None = None
    safe_ms: float | None = None
    asks: bool = False
    own_word: bool = True
    shows_late: bool = False
    note: str = ""

    def of_drawn(self, p: Params) -> Must:
        """The same whatever was drawn."""
        return self

    @property
    def words(self) -> str:
        """Name the ends that are allowed."""
        if self.ends == SAFE_ENDS:
            return "drives on, or stands in the end"
        return " or ".join(end.value.partition(",")[0] for end in End if end in self.ends)

    @property
    def allowed(self) -> str:
        """Name the ends that are allowed, and the times."""
        limits = ", torque 0 meanwhile" if self.pauses else ""
        limits += f" (service brake within {self.brake_ms:g} ms)" if self.brake_ms is not None else ""
        limits += f" (safe within {self.safe_ms:g} ms)" if self.safe_ms is not None else ""
        return self.words + limits

    @property
    def demanded(self) -> str:
        """All of it in words."""
        return (f"{self.note}: " if self.note else "") + self.allowed


class Graded(Value, frozen=True):
    """The ends by what was drawn for the parameter `of`: others from each number of `steps` on, or for each word.

    Below the first step nothing may change.
    """

    steps: tuple[tuple[float | str, Must], ...] = ()
    of: str = "duration"

    def of_drawn(self, p: Params) -> Must:
        drawn = p[self.of]
        return next(
            (
                must
                for step, must in reversed(self.steps)
                if (drawn == step if isinstance(step, str) else drawn >= step)
            ),
            NOTHING,
        )

    @property
    def demanded(self) -> str:
        first, *later = self.steps if self.steps and not self.steps[0][0] else ((0, NOTHING), *self.steps)
        named = (f"{self.of} {one}" if isinstance(one, str) else f"from {one:g} ms on" for one, _ in later)
        return "; ".join(
            (first[1].demanded, *(f"{name}: {must.demanded}" for name, (_, must) in zip(named, later, strict=True)))
        )


def ends(*allowed: End, **limits: Any) -> Must:
    return Must(frozenset(allowed), **limits)


def estop(after_ms: float) -> Must:
    """Our ESTOP_REQUEST after so long; the EBS acts at once."""
    return ends(End.ESTOP, safe_ms=after_ms + SLACK_MS + 10)


SAFE_ENDS: Final = frozenset(End) - {End.UNSAFE}
NOTHING: Final = ends(End.ON)
ANY: Final = Must(SAFE_ENDS, note="it cannot be told from the truth")
PAUSE: Final = ends(End.ON, pauses=True)
STOP: Final = ends(End.STOP)
IN_TIME_MS: Final = CAR_PATIENCE_NS // MS + SLACK_MS  # the car misses its echo
CAR_STOPS: Final = ends(End.SELF, End.ESTOP, safe_ms=IN_TIME_MS)
MAY_STOP_ITSELF: Final = ends(End.ON, End.SELF)
ODD: Final = ends(End.ON, End.HELD, End.STOP, End.ESTOP, note="stops once it is certainly implausible", shows_late=True)
UNBELIEVED: Final = ends(End.ON, End.HELD, End.STOP, End.ESTOP, note="the speeds are not believed")
ROUGH: Final = ends(End.ON, End.HELD, End.STOP, End.ESTOP, note="every limit and interlock holds")
WITHIN_LIMIT: Final = ends(End.ON, End.HELD, note="never above the live limit")
SILENT: Final = ends(End.SELF, safe_ms=IN_TIME_MS)
LOST_FEEDBACK: Final = Graded(((100, STOP), (300, estop(FEEDBACK_LOST_NS // MS))))
