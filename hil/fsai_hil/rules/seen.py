"""The checker's memory of the bus and of what people asked, as a value."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Annotated, Any, Final, NamedTuple

from msgspec import NODEFAULT, Struct
from msgspec.structs import fields

from fsai_hil.rules.declared import all_edges_ns, declared
from fsai_hil.rules.numbers import (
    AS_STATE_KNOWN_NS,
    COMMAND_FRESH_NS,
    COMMAND_LOST_NS,
    FEEDBACK_LOST_NS,
    FEEDBACK_STALE_NS,
    LAUNCH_NS,
    LISTEN_FIRST_NS,
    ODD_LOST_NS,
    ODD_NS,
    PEDALS_NS,
    POWER_CYCLE_NS,
    READY_SEEN_NS,
    SEND_LOST_NS,
    STATUS_FRESH_NS,
    STATUS_LOST_NS,
    STOP_CYCLES,
    STOP_TIMEOUT_NS,
)
from fsai_hil.rules.shown import SHOWN
from fsai_hil.rules.wheels import WheelAges
from fsai_vcu.core.ages import Ages, NotSearched
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.values import Value

NOBODY: Final[frozenset[str]] = frozenset()


class Violation(NamedTuple):
    """A rule that does not hold, and what is wrong."""

    rule: str
    words: str


class Order(NamedTuple):
    """The wishes of a valid command."""

    steer_deg: float
    throttle: float
    brake: float
    speed_limit_mps: float
    finished: bool
    estop: bool


class Process(Value, frozen=True):
    """The process behind the frames, whose inputs are known: what the rules name of its configuration.

    `nothing_hidden`: what a plausibility check finds is known as well, so that every stop has its reason.
    `follows`: steering and wheels of the car at the other end move as a car's do, so what is certainly implausible of
    them must be reacted to.
    """

    listen_only: bool = False
    autonomous_at_power_up: bool = False
    service_brake_pct: float = 80.0  # what a stop is made with
    stop_cycles: int = STOP_CYCLES
    stop_timeout_ns: int = STOP_TIMEOUT_NS
    nothing_hidden: bool = False
    follows: bool = False


class Seen(Struct):
    """The memory of the bus and of what people asked, as a value: no part of it is ever changed in place.

    Times are ns; None: never; each says at which ages it matters to a rule. What the wheels report is in `Wheels`.
    """

    # what the car sent
    as_state: AsState | None = None
    go: bool = False
    status_ns: Annotated[int | None, Ages(STATUS_FRESH_NS, STATUS_LOST_NS)] = None
    any_status_ns: Annotated[int | None, Ages(gap=(POWER_CYCLE_NS,))] = None  # any 0x520, believed or not
    # since when each 0x520 has been one that is known; None: the last is not
    known_ns: Annotated[int | None, Ages(AS_STATE_KNOWN_NS)] = None
    silent: bool = False  # the car was silent for as long as a power cycle takes, and was not believed since
    marks: frozenset[str] | None = None  # what 0x520 shows that must not turn up in AS_DRIVING
    handshake: bool | None = None
    mission: Ami = Ami.NOT_SELECTED
    ready_ns: Annotated[int | None, Ages(READY_SEEN_NS)] = None  # since when it has been AS_READY
    waited: bool = False  # for 5 s before Go
    path: int = 0
    # None: not driving, or since before the log began
    driving_ns: Annotated[int | None, Ages(LAUNCH_NS, LAUNCH_NS + COMMAND_FRESH_NS, LAUNCH_NS + COMMAND_LOST_NS)] = None
    angle_max_deg: float | None = None
    front_max_nm: float | None = None
    front_ns: Annotated[int | None, Ages(FEEDBACK_STALE_NS)] = None
    rear_max_nm: float | None = None
    rear_ns: Annotated[int | None, Ages(FEEDBACK_STALE_NS)] = None
    # what people and the planner asked for
    autonomous: bool = False
    power_up: bool = True  # autonomous has not been entered by itself, nor chosen, since the car was switched on
    confirmed: frozenset[str] = NOBODY  # who has reset himself for this mission
    acknowledged: bool = False  # SELECTED went out whole for it
    latched: bool = False  # an emergency: granted, or seen on the wire
    order: Order | None = None  # the newest valid command
    # of it; data of 500 ms ages like a command of 100 ms
    command_ns: Annotated[int | None, Ages(COMMAND_FRESH_NS, COMMAND_LOST_NS)] = None
    # the first cycle without a fresh command; None: the last one had one
    stale_ns: Annotated[int | None, Ages(COMMAND_LOST_NS)] = None
    pedals_ns: Annotated[int | None, Ages(PEDALS_NS)] = None  # since when every command has asked for both
    # what went wrong
    alarm: str | None = None  # why an emergency is due in this run
    stopped: str | None = None  # why torque is over in this run
    stopped_ns: Annotated[int, NotSearched("it is of a log, or where stops may be hidden")] = 0
    steer_odd_ns: Annotated[int | None, Ages(ODD_NS, ODD_LOST_NS)] = None
    wheel_odd_ns: Annotated[int | None, Ages(ODD_NS, ODD_LOST_NS)] = None
    restarted: bool = True  # the process is new and has not seen AS_OFF yet
    bus_gone: bool = False
    reopening: bool = False  # the bus is back, and the car has not been received on it
    # what could not be received before then is not missing
    back_ns: Annotated[int | None, Ages(STATUS_LOST_NS, FEEDBACK_LOST_NS)] = None
    ended: int | None = None  # cycles sent since the software was asked to stop
    # what went out
    began_ns: Annotated[int | None, Ages(LISTEN_FIRST_NS)] = None  # the first cycle, sent or not
    # the last cycle that went out whole, or the first that was tried
    complete_ns: Annotated[int | None, Ages(SEND_LOST_NS)] = None
    torque_nm: tuple[float, float] = (0.0, 0.0)  # front and rear, as the VCU has last seen them
    brake_pct: tuple[float, float] = (0.0, 0.0)
    braked_pct: float = 0.0  # what this process asked for last
    torque_may_be_there: bool = True
    torque_runs: bool = False
    zeros: int = 0  # complete cycles with both at zero; 2 means more
    echoed: bool = False  # and the newest 0x524, after them, says so
    steer_deg: float = 0.0
    steered_ns: Annotated[int | None, Ages()] = None
    whole: bool = True  # the last cycle that was made went out whole


class FieldParts:
    """The fields of a value apart: its times, by their declarations, and the others."""

    def __init__(self, made: type[Any]) -> None:
        """Raises ValueError, which names the file to change, if a time has no declaration."""
        notes = declared(made)
        times = [name for name, note in notes.items() if isinstance(note, Ages)]
        others = [name for name, note in notes.items() if not isinstance(note, (Ages, NotSearched))]
        self.others_of, self.times_of = attrgetter(*others), attrgetter(*times)
        self._names = (*others, *times)
        defaults = {spec.name: None if spec.default is NODEFAULT else spec.default for spec in fields(made)}
        self._never = [defaults[name] for name in times]

    def values(self, others: Sequence[object], times: Iterable[int | None]) -> dict[str, Any]:
        """Everything by its name, the next of the `times` by theirs; one that never was is as before it ever is."""
        been = [never if time is None else time for never, time in zip(self._never, times, strict=False)]
        return dict(zip(self._names, (*others, *been), strict=True))


PARTS: Final = FieldParts(Seen)
EDGES: Final = (
    *all_edges_ns(Seen),
    *(row.edges_ns for row in SHOWN),
    *all_edges_ns(WheelAges),
)
"""The ages at which each clock of `WireChecker.saved` matters."""
