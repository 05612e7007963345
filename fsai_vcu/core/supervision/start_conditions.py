"""Table of the conditions from power-up to AS_DRIVING: it says why the car does not drive, as far as the bus shows it.

Bridge, monitor, pit wall and explain all ask it, each with what it knows of a moment; so they answer in the same words.
What the bus does not show (the bridge's mode, whose confirmation it waits for) is `readiness.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from operator import attrgetter, not_
from typing import Any, Final, cast

from msgspec import field

from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.interface.enums import (
    OFF_LIKE,
    AsState,
    BrakeStatus,
    CarEnum,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    ShutdownCause,
    TsState,
)
from fsai_vcu.interface.fields import fields_of
from fsai_vcu.interface.messages import COMMAND_FIELDS, VEHICLE_FIELD_OF, AiCommand, VcuStatus, VehicleState
from fsai_vcu.interface.specification import READY_STEER_DEG, READY_WAIT_NS
from fsai_vcu.interface.units import S, ms
from fsai_vcu.interface.values import Value

OFF: Final = OFF_LIKE
READY: Final = frozenset((AsState.AS_READY,))
DRIVING: Final = frozenset((AsState.AS_DRIVING,))


class Moment(Value, frozen=True):
    """Picture that the bus shows at one moment; what it does not show counts as met.

    `command`: what the AI computer says, None where nothing of it was heard. `silent_ns`: the age of 0x520, where that
    counts as lost. `waited_ns`: for how long AS_READY has lasted, None where its begin was not seen. `history`: by slug
    the evidence for conditions that only frames before this moment show.
    """

    vehicle: VehicleState
    command: AiCommand | None = None
    silent_ns: int | None = None
    waited_ns: int | None = None
    history: Mapping[str, str] = field(default_factory=dict)


class Obstacle(Value, frozen=True):
    """One thing that stands between now and driving. `follows`: it goes by itself once the ones above it are gone.

    `remedy`: what to do, where somebody looks it up.
    """

    slug: str
    words: str
    evidence: str = ""
    follows: bool = False
    remedy: str = ""

    @property
    def sentence(self) -> str:
        """The words, and the evidence where they do not name it already."""
        signal = self.evidence.partition(" ")[0]
        named = (self.evidence, self.evidence.replace(" is ", " "), f"({signal}", f"{signal}:")
        return self.words if any(part in self.words for part in named) else f"{self.words} ({self.evidence})"


class Condition(Value, frozen=True):
    """One condition. It is of interest in `states`, and met where it is not known or as wanted.

    `sources`: fields of a Moment, of which the first that is known decides; none: only `Moment.history` shows it.
    `after`: what has to be met before it. `hint`: no condition of the interface's table, but it goes with a car that
    does not start.
    """

    slug: str
    words: str
    states: frozenset[AsState]
    sources: tuple[str, ...] = ()
    wanted: Callable[[Any], bool] = bool
    after: tuple[str, ...] = ()
    hint: bool = False

    def evidence(self, moment: Moment) -> tuple[str, str] | None:
        """Evidence while the condition is not met: the field that shows it (none of history), its value in words."""
        if not self.sources:
            return ("", moment.history[self.slug]) if self.slug in moment.history else None
        known = self._known(moment)
        if known is None or self.wanted(known[1]):
            return None
        source, value = known
        return source, f"{SIGNAL_OF[source]} is {_label(value)}{_more(moment, source)}"

    def met(self, moment: Moment) -> tuple[str, str] | None:
        """The field that shows the condition as met, and its value in words; None where that is not seen."""
        known = self._known(moment)
        if known is None or not self.wanted(known[1]):
            return None
        return known[0], f"{SIGNAL_OF[known[0]]} is {_label(known[1])}"

    def _known(self, moment: Moment) -> tuple[str, Any] | None:
        """The first field that is known, and its value."""
        values = ((source, _value(moment, source)) for source in self.sources)
        return next((known for known in values if known[1] is not None), None)


def _value(moment: Moment, source: str) -> Any:
    """A field of the vehicle or the command; None where its message was not heard."""
    root, read = _reader(source)
    image = moment.command if root == "command" else getattr(moment.vehicle, root)
    return None if image is None else read(image)


@cache
def _reader(source: str) -> tuple[str, attrgetter[Any]]:
    root, _, rest = source.partition(".")
    return root, attrgetter(rest)


def _label(value: Any) -> str:
    return value.label if isinstance(value, CarEnum) else f"{value:g}"


SIGNAL_OF: Final[Mapping[str, str]] = {
    **{f"{name}.{one.name}": one.signal for kind, name in VEHICLE_FIELD_OF.items() for one in fields_of(kind)},
    **{f"command.{names[one.name]}": one.signal for kind, names in COMMAND_FIELDS.items() for one in fields_of(kind)},
}
"""Signal of each field of a Moment that a condition may look at, as the databases call it."""


def fault_names(status: VcuStatus) -> tuple[str, ...]:
    """The faults that 0x520 names, as the databases call them, and the cause of a shutdown."""
    names = status.faults.names
    if status.shutdown_cause is not None and status.shutdown_cause is not ShutdownCause.NO_SHUTDOWN:
        names += (f"SHUTDOWN_CAUSE {status.shutdown_cause.label}",)
    return names


def _more(moment: Moment, source: str) -> str:
    """Name the faults of 0x520 besides FAULT_STATUS."""
    names = fault_names(cast(VcuStatus, moment.vehicle.status)) if source == "status.fault" else ()
    return f": {', '.join(names)}" if names else ""


_LINK: Final = ("no_ai_data", "ai_data_incomplete", "link_lost")
_BEFORE_POWER: Final = ("tsms", "pushbar", "charging", "power_cycle", "fault", "shutting_down")
_ANY: Final = OFF | READY | DRIVING

CONDITIONS: Final[tuple[Condition, ...]] = (
    Condition(
        "status_frozen",
        "the VCU hung or its 0x520 froze: 0x520 repeated itself, so the real state of the car is not known",
        OFF | READY,
    ),
    Condition("no_ai_data", "no message of the AI computer comes: tractive system and EBS wait for it", OFF | READY),
    Condition("ai_data_incomplete", "not all five messages of the AI computer come", OFF),
    Condition("power_cycle", "the car has not been switched off since its last run", OFF),
    *(
        Condition("torque_requested", "axle torque is requested in AS_READY", READY, (source,), not_)
        for source in ("command.front_torque_nm", "command.rear_torque_nm")
    ),
    Condition("steering_requested", "steering is requested in AS_READY", READY, ("command.steer_deg",), not_),
    Condition(
        "steering_turned",
        "the steering is measured at 5 deg or more",
        READY,
        ("steer.angle_deg",),
        lambda angle_deg: abs(angle_deg) < READY_STEER_DEG,
    ),
    Condition(
        "direction_not_neutral",
        "DIRECTION_REQUEST is not NEUTRAL in AS_READY",
        READY,
        ("command.direction",),
        lambda said: said is Direction.NEUTRAL,
    ),
    Condition(
        "ready_not_selected",
        "MISSION_STATUS is not SELECTED in AS_READY: the official simulator does not start then",
        READY,
    ),
    Condition("asms", "ASMS is off (AS_SWITCH_STATUS 0)", _ANY, ("status.as_switch",)),
    Condition("tsms", "TSMS is off (TS_SWITCH_STATUS 0)", _ANY, ("status.ts_switch",)),
    Condition(
        "pushbar",
        "the car is moved by the pushbar (OP_STATE OP_PUSHBAR), and cannot start in this state",
        OFF | READY,
        ("status.op_state",),
        lambda state: state is not OpState.OP_PUSHBAR,
    ),
    Condition(
        "charging",
        "the car is charged (OP_STATE OP_CHARGE), and cannot start in this state",
        OFF | READY,
        ("status.op_state",),
        lambda state: state is not OpState.OP_CHARGE,
    ),
    Condition(
        "shutting_down",
        "the car asks for shutdown (SHUTDOWN_REQUEST)",
        _ANY,
        ("status.shutdown_request",),
        not_,
        after=("tsms",),
    ),
    Condition(
        "link_lost",
        "AI_COMMS_LOST: the AI computer's messages or echo are missing",
        _ANY,
        ("status.faults.ai_comms_lost",),
        not_,
        after=("no_ai_data", "ai_data_incomplete"),
    ),
    Condition("fault", "the car reports a fault", _ANY, ("status.fault",), not_, after=_LINK),
    Condition(
        "op_fault",
        "OP_STATE is OP_FAULT",
        _ANY,
        ("status.op_state",),
        lambda state: state is not OpState.OP_FAULT,
        after=("fault",),
    ),
    Condition(
        "estop_latched",
        "the AI computer requests an emergency stop (ESTOP_REQUEST 1)",
        OFF,
        ("command.estop_request",),
        not_,
        after=("no_ai_data",),
    ),
    Condition("no_mission", "no mission is chosen on the AMI", _ANY, ("status.ami",)),
    Condition(
        "status_not_selected",
        "the AI computer says MISSION_STATUS NOT_SELECTED: it is in manual mode, or planner and controller have not"
        " confirmed their reset",
        OFF,
        ("command.mission_status",),
        lambda said: said is not MissionStatus.NOT_SELECTED,
        after=("no_ai_data", "no_mission", "estop_latched"),
    ),
    Condition(
        "status_running",
        "the AI computer says RUNNING too early: the VCU waits for SELECTED",
        OFF,
        ("command.mission_status",),
        lambda said: said is not MissionStatus.RUNNING,
        after=("no_ai_data",),
    ),
    Condition(
        "status_finished",
        "the AI computer still says FINISHED from the run before: the VCU waits for SELECTED",
        OFF,
        ("command.mission_status",),
        lambda said: said is not MissionStatus.FINISHED,
        after=("no_ai_data",),
    ),
    Condition(
        "ts_not_running",
        "the tractive system does not run",
        _ANY,
        ("status.ts_state",),
        lambda state: state is TsState.TS_RUNNING,
        after=(*_LINK, *_BEFORE_POWER),
    ),
    Condition(
        "ebs_not_armed",
        "EBS is not armed",
        _ANY,
        ("status.ebs_state", "brake.ebs_status"),
        lambda state: state in (EbsState.EBS_ARMED, EbsStatus.ARMED),
        after=(*_LINK, "asms", *_BEFORE_POWER, "ts_not_running"),
    ),
    Condition(
        "steering_inactive",
        "the steering is not active (STEERING_STATUS 0)",
        READY | DRIVING,
        ("status.steering_status",),
        hint=True,
    ),
    Condition(
        "brakes_not_ready",
        "the brakes are not ready",
        READY | DRIVING,
        ("brake.brake_status",),
        lambda status: status is BrakeStatus.READY,
        hint=True,
    ),
    Condition("go_off", "the remote's Go went off (GO_SIGNAL 0) in AS_DRIVING", DRIVING, ("status.go_signal",)),
)
"""Conditions of a drive; the one to put right first stands in front."""

WORDS: Final[Mapping[str, str]] = {
    **{condition.slug: condition.words for condition in CONDITIONS},
    "vcu_unheard": "no 0x520 from the car yet",
    "go_held": "Go was on already: only a rising edge counts",
    "finished": "the mission is finished (AS_FINISHED): ASMS off ends the run",
    "braked": "EMERGENCY_BRAKE: wait 15 s, ASMS off, then switch the car off and on",
    "no_go": "waiting for Go",
}
"""Words of every condition, and of what an AS state itself waits for, by slug."""


def unmet(moment: Moment, state: AsState) -> tuple[tuple[Condition, str, str, bool], ...]:
    """The conditions that are not met in a state, what must be put right first in front.

    Each with the field that shows it, the evidence, and whether it follows from another one (or is a hint).
    """
    found: dict[str, tuple[Condition, str, str]] = {}
    for condition in CONDITIONS:
        shown = condition.evidence(moment) if state in condition.states else None
        if shown is not None:
            found.setdefault(condition.slug, (condition, *shown))
    rows = ((*row, row[0].hint or not found.keys().isdisjoint(row[0].after)) for row in found.values())
    return tuple(sorted(rows, key=lambda row: row[3]))


def seen_met(moment: Moment, state: AsState) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the fields that show a condition of that state as met, each with its value in words.

    It returns also the signals of conditions of which nothing is seen. Hints, and what only earlier frames show, are
    neither.
    """
    shown: dict[str, str] = {}
    unseen: dict[str, None] = {}
    for condition in CONDITIONS:
        if state in condition.states and not condition.hint:
            met = condition.met(moment)
            if met is not None:
                shown[met[0]] = met[1]
            elif condition.evidence(moment) is None:
                unseen |= dict.fromkeys(SIGNAL_OF[source] for source in condition.sources)
    return shown, tuple(unseen)


def why_not_driving(moment: Moment) -> Iterator[Obstacle]:
    """Yield the obstacles between now and driving that the bus shows, the one to put right first in front."""
    status = moment.vehicle.status
    if not moment.vehicle.status_known:
        yield Obstacle("as_state_unknown", Reason.AS_STATE_UNKNOWN.words)
    elif status is None:
        yield _waiting("vcu_unheard")
    elif moment.silent_ns is not None:
        words = f"0x520 is missing for {ms(moment.silent_ns)}: the car is silent"
        yield Obstacle("vcu_silent", words, f"its last AS state was {status.as_state.label}")
    elif status.as_state is AsState.EMERGENCY_BRAKE:
        yield _waiting("braked", ", ".join(fault_names(status)))
    elif status.as_state is AsState.AS_FINISHED:
        yield _waiting("finished")
    else:
        rows = unmet(moment, status.as_state)
        yield from (Obstacle(one.slug, one.words, evidence, follows) for one, _, evidence, follows in rows)
        if status.as_state is AsState.AS_READY:
            yield from _for_go(moment, status)
        elif status.as_state in OFF and not rows:
            words = (
                f"waiting for AS_READY: the car is in {status.as_state.label}, and every condition that the bus shows "
                "is met"
            )
            yield Obstacle("start_unknown", words)


def _for_go(moment: Moment, status: VcuStatus) -> Iterator[Obstacle]:
    waited_ns = READY_WAIT_NS if moment.waited_ns is None else moment.waited_ns
    waits = waited_ns < READY_WAIT_NS
    if waits:
        left_s = (READY_WAIT_NS - waited_ns) / S
        yield Obstacle("ready_wait", f"waiting in AS_READY: {left_s:.1f} s of {READY_WAIT_NS // S} s left")
    yield _waiting("go_held" if status.go_signal else "no_go", follows=waits)


def _waiting(slug: str, evidence: str = "", *, follows: bool = False) -> Obstacle:
    return Obstacle(slug, WORDS[slug], evidence, follows)
