"""The environment of the searched bridge: what may happen in a cycle, and the closed parts into which that is split.

Everything at once would be too much for a minute. Each scope gives some parties their whole freedom and lets the rest
behave; a rule is searched wherever what it speaks of is free. All begin with both sides just switched on, so every
state visited is one that the car can be brought into.

What is new to happen is a field of `Choice`, which `frames_of` puts into the car's frames, a row of `COMMANDS`, `MARKS`
or `EVENTS`, and free in a scope.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from functools import cache
from itertools import combinations, product
from typing import Annotated, Any, Final

from msgspec import field
from msgspec.structs import replace

from fsai_hil.evidence.abstraction import NOW
from fsai_hil.evidence.searched import SearchSetting
from fsai_hil.evidence.small_car import WELL
from fsai_hil.rules.numbers import BACKLOG_NS, CAR_PATIENCE_NS, MS, S
from fsai_hil.rules.seen import NOBODY
from fsai_hil.simulator.profiles import OFFICIAL_SIMULATOR
from fsai_hil.simulator.watched_bridge import WatchedBridge
from fsai_vcu.core.ages import Ages
from fsai_vcu.core.bridge import official_simulator
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.core.supervision.supervisor import CHANGES
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Decoded
from fsai_vcu.interface.enums import Ami, AsState, Direction, EbsState, MissionStatus, OpState, ShutdownCause, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import Faults, Image, VcuBrake, VcuDriveFront, VcuDriveRear, VcuSteer, WheelSpeeds
from fsai_vcu.interface.specification import EMERGENCY_TIMER_NS, READY_WAIT_NS
from fsai_vcu.interface.values import Value

STATUS, SPEEDS, STEER, AXLES, BRAKE = "0x520", "0x525", "0x523", "0x521/2", "0x524"
CAR_MESSAGES: Final = (STATUS, SPEEDS, STEER, AXLES, BRAKE)
BOTH: Final = frozenset(("planner", "controller"))

# ---------------------------------------------------------------- what may be chosen


def _command(*, data_age_ns: int = 0, run: int = 0, **fields: Any) -> VehicleCommand:
    """A command as the searched controller sends it; its stamp and its run are counted from now and the run in hand."""
    return VehicleCommand(-data_age_ns, run, **{"speed_limit_mps": 50.0} | fields)


_LEFT = math.radians(20.0)
_PEDAL: Final = {"steering_rad": _LEFT, "throttle": 0.123}  # no share of it is whole tenths of Nm
COMMANDS: Final[Mapping[str, VehicleCommand]] = {
    "drive": _command(**_PEDAL),
    "drive right": _command(steering_rad=-_LEFT, throttle=1.0),
    "coast": _command(),
    "brake": _command(steering_rad=_LEFT, brake=0.4),
    "both": _command(**_PEDAL, brake=0.4),
    "finished": _command(**_PEDAL, mission_finished=True),
    "estop": _command(**_PEDAL, estop_request=True),
    "old": _command(**_PEDAL, data_age_ns=500 * MS - 1),
    "too old": _command(**_PEDAL, data_age_ns=500 * MS),
    "far too old": _command(**_PEDAL, data_age_ns=700 * MS),
    "future": _command(**_PEDAL, data_age_ns=-21 * MS),
    "other run": _command(**_PEDAL, run=-1),
    "nan": _command(**_PEDAL | {"steering_rad": math.nan}),
    "infinite": _command(**_PEDAL | {"throttle": math.inf}),
    "beyond": _command(**_PEDAL | {"throttle": 1.5}),
    "negative": _command(**_PEDAL, brake=-0.1),
    "beyond steering": _command(**_PEDAL | {"steering_rad": math.radians(31.0)}),
}
NO_COMMAND: Final = "none"


class Choice(Value, frozen=True):
    """The environment's part of one cycle. The defaults: a car that is well and at rest, a planner that drives."""

    command: str = "drive"
    lost: frozenset[str] = frozenset()  # messages of the car that do not come
    unreadable: bool = False  # 0x520 comes, but its AS_STATE is none
    marks: frozenset[str] = frozenset()  # of MARKS: what 0x520 shows besides, FAULT_STATUS stays 0
    counting: bool = False  # a wheel turns by the pulse counts
    rpm: tuple[int, int, int, int] = (0, 0, 0, 0)
    go: bool = False
    asms: bool = True
    tsms: bool = True
    sdc_open: bool = False
    ami: Ami = Ami.TRACKDRIVE
    car_off: bool = False
    says: AsState | None = None  # whatever the VCU's state machine thinks
    fault: bool = False
    angle_max_deg: float = 30.0
    torque_max_nm: float = 195.0
    confirm: frozenset[str] = BOTH  # who says that he has reset himself
    confirm_other: frozenset[str] = frozenset()  # who says so of another run
    frames: int = 5  # how many of the cycle's five frames go out
    event: str | None = None  # what is asked of the process, or happens to it
    steer_odd: bool = False
    wheel_odd: bool = False


def unusual(value: Value) -> str:
    """Name the fields that do not have their defaults, and their values; "" where all have."""
    given = zip(value.__struct_fields__, value.__struct_defaults__, strict=True)
    chosen = {name: one for name, default in given if (one := getattr(value, name)) != default}
    return "; ".join(f"{name} {_plain(one)}" for name, one in chosen.items())


def _plain(value: object) -> str:
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, frozenset):
        return ", ".join(sorted(value)) or "nobody"
    return "/".join(map(str, value)) if isinstance(value, tuple) else str(value)


# ---------------------------------------------------------------- what happens to the process

EVENTS: Final[Mapping[str, Callable[[WatchedBridge, int], object]]] = {
    "an intruder sends 0x511": lambda b, now: (b.on_frame(Frame(0x511, bytes(4), now)), b.checker.on_intruder("0x511")),
    "the loop misses its deadline": lambda b, now: b.loop_fault("a deadline was missed by 50 ms", now),
    "the bus is lost": lambda b, now: b.bus_lost("the interface is gone", now),
    "the bus is back": lambda b, now: b.bus_back(now),
    "the software is stopped": lambda b, now: b.begin_stop(now),
    "frames waited for 20 ms": lambda b, now: b.backlog(BACKLOG_NS, now),
    "manual asked for": lambda b, now: b.set_mode("manual", now),
    "autonomous asked for": lambda b, now: b.set_mode("autonomous", now),
    "sideways asked for": lambda b, now: b.set_mode("sideways", now),  # which is no mode
    "emergency brake asked for": lambda b, now: b.emergency_brake("somebody asked for it", now),
    "reset asked for": lambda b, now: b.reset(now),
}
"""The events of a cycle that the process sees, by the name in `Choice.event`."""
HAPPENINGS: Final = tuple(event for event in EVENTS if not event.endswith("asked for"))
RESTART: Final = "restart"  # an event too: another process takes the bridge's place


# ---------------------------------------------------------------- the car


class Vcu(Value, frozen=True):
    """The memory of the other end: the AS state, what it received last, and the handshake."""

    state: AsState
    since_ns: Annotated[int, Ages(READY_WAIT_NS, EMERGENCY_TIMER_NS)] = NOW
    received: bool = False
    go_before: bool = True
    needs_power_cycle: bool = False
    estop: bool = False
    status: MissionStatus = MissionStatus.NOT_SELECTED
    direction: Direction = Direction.NEUTRAL
    front: bool = False
    rear: bool = False
    steer: bool = False
    brake: bool = False
    ai_ns: Annotated[int | None, Ages(CAR_PATIENCE_NS)] = None  # the last complete cycle
    echo_ns: Annotated[int | None, Ages(CAR_PATIENCE_NS)] = None  # since when the echo is awaited
    bit: bool = False


_WELL_STATUS: Final = replace(WELL, shutdown_cause=ShutdownCause.NO_SHUTDOWN)
MARKS: Final[Mapping[str, Mapping[str, Any]]] = {
    "AS_SWITCH_STATUS falls": {"as_switch": False},
    "TS_SWITCH_STATUS falls": {"ts_switch": False},
    "SHUTDOWN_REQUEST rises": {"shutdown_request": True},
    **{f"fault bit {name} rises": {name: True} for name in ("bms", "ebs")},
    "SHUTDOWN_CAUSE rises": {"shutdown_cause": ShutdownCause.BMS_FAULT},
    "EBS_STATE becomes FAULT": {"ebs_state": EbsState.EBS_FAULT},
    "TS_STATE becomes FAULT": {"ts_state": TsState.TS_FAULT},
    "OP_STATE becomes FAULT": {"op_state": OpState.OP_FAULT},
}
"""Marks that 0x520 may show besides, FAULT_STATUS being 0: fields of it and of its fault bits."""
_BITS: Final = Faults.__struct_fields__


class CarFrame(Frame, frozen=True):
    """A frame that carries its image along."""

    decoded: Decoded = Decoded(None)


class PlainCodec:
    """The codec that hands on what a frame carries."""

    unknown = ""

    def decode(self, frame: CarFrame) -> Decoded:
        return frame.decoded


def frames_of(choice: Choice, vcu: Vcu, now: int) -> Iterator[CarFrame]:
    """Yield the car's frames of one cycle that come, in their order."""
    if STATUS not in choice.lost and choice.unreadable:
        yield CarFrame(0x520, b"", now, decoded=Decoded(None, (), vcu.bit))
    elif STATUS not in choice.lost:
        yield _status_frame(vcu.bit, choice.go, vcu.state, choice.ami, choice.fault, choice.marks, now)
    if AXLES not in choice.lost:
        yield _frame(0x521, VcuDriveFront, now, 0.0, 0.0, choice.torque_max_nm)
        yield _frame(0x522, VcuDriveRear, now, 0.0, 0.0, choice.torque_max_nm)
    if STEER not in choice.lost:
        yield _frame(0x523, VcuSteer, now, 0.0, choice.angle_max_deg)
    if BRAKE not in choice.lost:
        yield _frame(0x524, VcuBrake, now, *[30.0 if vcu.brake else 0.0] * 4)
    if SPEEDS not in choice.lost:
        yield _frame(0x525, WheelSpeeds, now, *choice.rpm)


@cache  # the same few come again and again
def _frame(can_id: int, kind: type[Any], now: int, *values: float) -> CarFrame:
    image: Image = kind(*values, t_rx_ns=now)
    return CarFrame(can_id, b"", now, decoded=Decoded(image, (), None))


@cache
def _status_frame(
    bit: bool, go: bool, state: AsState, ami: Ami, fault: bool, marks: frozenset[str], now: int
) -> CarFrame:
    """Return 0x520 as the VCU sends it now; `marks` name the fault bits and values that differ from a sound car's."""
    shown = {name: value for mark in marks for name, value in MARKS[mark].items()}
    faults = Faults(**{name: shown.pop(name) for name in _BITS if name in shown})
    image = replace(
        _WELL_STATUS,
        handshake=bit,
        go_signal=go,
        as_state=state,
        ami=ami,
        fault=fault,
        faults=faults,
        t_rx_ns=now,
        **shown,
    )
    return CarFrame(0x520, b"", now, decoded=Decoded(image, (), bit))


# ---------------------------------------------------------------- choices that scopes share


def _each(base: Choice, *changes: dict[str, Any]) -> tuple[Choice, ...]:
    return tuple(replace(base, **change) for change in changes)


def _over(base: Choice, **values: Iterable[Any]) -> tuple[Choice, ...]:
    """`base` with every combination of these values of its fields."""
    return tuple(replace(base, **dict(zip(values, some, strict=True))) for some in product(*values.values()))


def _says(state: AsState, **changes: object) -> Choice:
    """A VCU that says this AS state whatever came before; Go is on in AS_DRIVING, off before it."""
    choice = replace(_WELL, says=state, go=state not in (AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY))
    return replace(choice, **changes)


STANDING: Final = (0, 0, 0, 0)
ROLLING: Final = (100, 100, 100, 100)
MOVING: Final = (200, 200, 200, 200)
TOO_FAST: Final = (1200, 1200, 1200, 1200)  # no tyre follows in one cycle
IMPOSSIBLE: Final = (65535, 65535, 65535, 65535)

_AUTONOMOUS, _MANUAL, _SIDEWAYS, _EMERGENCY, _RESET = (
    {"event": f"{what} asked for"} for what in ("autonomous", "manual", "sideways", "emergency brake", "reset")
)
_WELL = Choice()
GO = replace(_WELL, go=True)
PATH: Final = (_WELL, replace(_WELL, **_AUTONOMOUS), GO)
"""The choices that bring a car into AS_DRIVING: autonomous asked for, Go after 5 s."""

_OFF, _READY, _DRIVING = AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
_DRIVES: Final = replace(GO, rpm=MOVING)
_RIGHT: Final = replace(GO, command="drive right")
_SAYS_DRIVING: Final = replace(_DRIVES, says=_DRIVING)
_CUT_OFF: Final = replace(_DRIVES, lost=frozenset(CAR_MESSAGES))
_PEOPLE: Final[tuple[dict[str, Any], ...]] = (
    *(_MANUAL, _AUTONOMOUS, _EMERGENCY, _RESET),
    *({"asms": False}, {"tsms": False}, {"fault": True}, {"sdc_open": True}),
    *({"ami": Ami.ACCELERATION}, {"ami": Ami.NOT_SELECTED}, {"confirm": NOBODY}, {"go": False}),
    *({"command": "finished"}, {"command": "none"}),
)
_PLANNER: Final = frozenset(("planner",))
_CONFIRMED: Final = {"ami": (Ami.TRACKDRIVE, Ami.ACCELERATION), "confirm": (BOTH, _PLANNER, BOTH - _PLANNER, NOBODY)}
_LOST: Final = [frozenset(some) for count in (0, 1, 2) for some in combinations(CAR_MESSAGES, count)]
_EVERY_MARK: Final = frozenset(MARKS)
_EACH_MARK: Final = [frozenset((mark,)) for mark in MARKS]

# ---------------------------------------------------------------- the scopes


class Ending(Value, frozen=True):
    """A way in which the environment may behave from any moment on; then a safe end must come within that time."""

    words: str
    choice: Choice
    within_ns: int


STANDS: Final = Ending(
    "a silent planner and a car that comes to rest",
    replace(GO, command="none"),
    # 3 s of standing still, 300 ms for a lost command, 0.5 s of proven rest, the cycles between, and what the rounding
    # of ages counts twice
    5 * S,
)
# The same, and a deceleration that does not show within 0.5 s
MOVES: Final = Ending("a silent planner and a car that never brakes", replace(_DRIVES, command="none"), 5 * S)
# 0x520 stale for 100 ms, the cycles between, and a process that still listens its 200 ms
DEAF: Final = Ending("a car that is not received any more", _CUT_OFF, 500 * MS)
# A VCU that says whatever the environment wants cannot be brought out of AS_DRIVING. There the end is that it has been
# told to stop: ESTOP_REQUEST, or FINISHED at rest, and no torque.
_INSISTING: Final[dict[str, Any]] = {
    "path": (),
    "endings": tuple(
        Ending(f"{ending.words} and says AS_DRIVING for ever", replace(ending.choice, says=_DRIVING), ending.within_ns)
        for ending in (STANDS, MOVES)
    ),
}


class Scope(Value, frozen=True):
    """A closed part of everything that can happen: what the environment may do in it, and in which setting.

    Its choices are the path and the endings, `everywhere`, and, in AS_DRIVING from the last ns of the 3 s of standing
    still on, `driving`. While the first 200 ms are listened to, path and endings only; all where there is no path.

    It brings about `reactions`: that one of them is only reported is a mistake of `seeded.py`, to be found here.
    """

    name: str
    covers: str
    everywhere: tuple[Choice, ...]
    driving: tuple[Choice, ...] = ()
    path: tuple[Choice, ...] = PATH
    endings: tuple[Ending, ...] = (STANDS, MOVES)
    setting: SearchSetting = field(default_factory=SearchSetting)
    reactions: tuple[Reason, ...] = ()


_CONFIG: Final = SearchSetting().config
_AT_POWER_UP: Final = SearchSetting(config=replace(_CONFIG, autonomous_at_power_up=True))
_RUN: Final = Scope(
    "run",
    "people: mode requests, emergency brake, reset, Go, ASMS, TSMS, E-stop, faults, AMI, resets not confirmed; wheels "
    "standing, moving; planner driving, finished, silent",
    _each(GO, *_PEOPLE),
    (_DRIVES, *_each(_DRIVES, *_PEOPLE)),
)
SCOPES: Final = (
    _RUN,
    Scope(
        "confirmations",
        "the AMI changed before Go; resets confirmed by planner and controller, by one, by none, of another run",
        (
            *_over(_WELL, **_CONFIRMED),
            *_over(GO, **_CONFIRMED),
            *_over(_WELL, ami=[Ami.TRACKDRIVE, Ami.ACCELERATION], confirm=[NOBODY, _PLANNER], confirm_other=[BOTH]),
            replace(GO, asms=False),
        ),
        (_DRIVES, replace(_DRIVES, ami=Ami.ACCELERATION, confirm=NOBODY)),
    ),
    Scope(
        "commands",
        "every kind of command: valid, absurd, stale, of another run, both pedals; wheels standing, slowing, moving",
        _over(GO, command=["estop", "finished", "both"]),
        (
            *_over(_DRIVES, command=["none", *(kind for kind in COMMANDS if kind != "drive right")]),
            *_over(GO, command=["none", "drive", "coast", "brake", "both", "finished", "estop"]),
            *_over(GO, command=["none", "drive", "brake"], rpm=[ROLLING]),
        ),
        reactions=(Reason.BOTH_PEDALS,),
    ),
    Scope(
        "messages",
        "each of the car's messages and each pair of them fresh, late and lost; 0x520 that cannot be read",
        (replace(GO, lost=frozenset((STATUS,))), replace(GO, unreadable=True), _CUT_OFF),
        (
            *_over(_DRIVES, lost=_LOST),
            *_over(GO, lost=[lost for lost in _LOST if len(lost) < 2]),
            *_over(_DRIVES, lost=[NOBODY, frozenset((BRAKE,))], command=["brake"]),
            *_each(replace(GO, unreadable=True), {"rpm": MOVING}, {"lost": frozenset((SPEEDS,))}),
        ),
        endings=(STANDS, MOVES, DEAF),
    ),
    Scope(
        "sends",
        "cycles that go out whole, in part, not at all, for any time; pedals changing under it",
        _over(GO, frames=[0, 3]),
        (
            *_over(_DRIVES, frames=[0, 1, 3, 4, 5], command=["drive", "brake"]),
            *_over(GO, frames=[0, 3, 5], command=["drive", "none"]),
        ),
        endings=(STANDS, MOVES, DEAF),
    ),
    Scope(
        "trouble",
        "intruder, fault of the loop, bus lost and back, orderly end, frames that waited, in any order and at any time",
        _over(GO, event=HAPPENINGS),
        _over(_DRIVES, event=[None, *HAPPENINGS]),
        setting=SearchSetting(config=replace(_CONFIG, stop_cycles=2)),
        reactions=(Reason.INTRUDER,),
    ),
    Scope(
        "restarts",
        "the process dies and comes back in every state of the car, moving and standing; so does the car",
        _each(GO, {"event": RESTART}, {"asms": False}, {"car_off": True}),
        _each(_DRIVES, {}, {"event": RESTART}, {"command": "brake"}),
    ),
    Scope(
        "power cycle",
        "the car switched off for any time and on again in every state, with and without an emergency; its reset",
        _each(GO, {"car_off": True}, _EMERGENCY, _RESET),
        _each(_DRIVES, {}, {"car_off": True}),
    ),
    Scope(
        "any car",
        "a VCU that says any AS state at any time, whatever came before: reboots, jumps, faults; people's requests",
        (
            *(_says(state) for state in AsState),
            *(_says(state, rpm=MOVING) for state in AsState if state not in (AsState.AS_INIT, AsState.AS_FINISHED)),
            _says(_DRIVING, go=False, rpm=MOVING),
            *_each(_SAYS_DRIVING, {"fault": True}, _MANUAL, {"lost": frozenset((STATUS,))}),
            *_each(replace(_SAYS_DRIVING, says=_OFF), _EMERGENCY, _RESET),
            _says(_READY, **_AUTONOMOUS),
        ),
        **_INSISTING,
        reactions=(Reason.GO_OFF, Reason.FAULT_STATUS),
    ),
    Scope(
        "beginnings",
        "a VCU that comes to AS_DRIVING after any time, with Go on or off before it, with no mission on the AMI, and "
        "with SELECTED that never went out whole",
        (
            *_each(_says(_OFF), _AUTONOMOUS, {"frames": 3}, {"ami": Ami.NOT_SELECTED}),
            *_each(_says(_READY), {}, {"go": True}, {"frames": 3}, {"ami": Ami.NOT_SELECTED}),
            *_each(_says(_DRIVING), {}, {"rpm": MOVING}),
        ),
        **_INSISTING,
    ),
    Scope(
        "marks",
        "switches, SHUTDOWN_REQUEST, fault bits, SHUTDOWN_CAUSE and states of FAULT in 0x520 while FAULT_STATUS stays "
        "0: there since before the run, and turning in AS_DRIVING, each and all of them; the AMI turned",
        (replace(_WELL, marks=_EVERY_MARK), replace(GO, marks=_EVERY_MARK), replace(_WELL, marks=_EACH_MARK[3])),
        (
            *_over(_DRIVES, marks=[NOBODY, _EVERY_MARK, *_EACH_MARK, _EVERY_MARK - _EACH_MARK[3]]),
            replace(GO, marks=_EACH_MARK[0]),
            *_over(_DRIVES, ami=[Ami.ACCELERATION, Ami.NOT_SELECTED]),
        ),
        reactions=CHANGES,
    ),
    Scope(
        "wheel speeds",
        "wheel speeds beyond the database and beyond what a tyre can follow, on all wheels and on one; pulse counts "
        "that run while the wheels stand",
        _each(GO, {"rpm": IMPOSSIBLE}, {"counting": True}),
        (
            *_over(GO, rpm=[MOVING, TOO_FAST, (200, 200, 1251, 200), (200, 200, 1200, 200)]),
            *_over(GO, command=["finished"], counting=[False, True]),
        ),
    ),
    Scope(
        "restarts, any car",
        "the process dies and comes back beside a VCU that goes on as if nothing had happened",
        (
            *(_says(state) for state in (_OFF, _READY, _DRIVING)),
            _says(_DRIVING, rpm=MOVING),
            *(_says(state, event=RESTART) for state in (_OFF, _READY, _DRIVING)),
            *(_says(state, **_AUTONOMOUS) for state in (_OFF, _READY)),
        ),
        **_INSISTING,
    ),
    Scope(
        "plausibility",
        "steering that does not follow, a wheel that does not fit, planner driving and finished",
        (),
        (
            *_over(_DRIVES, steer_odd=[False, True], wheel_odd=[False, True], command=["drive", "finished"]),
            *_over(GO, steer_odd=[False, True], wheel_odd=[False, True]),
        ),
    ),
    Scope(
        "limits",
        "live ANGLE_MAX and TRQ_MAX, wheel speeds round the constant-power steps, steering left and right at its rate",
        (),
        (
            *_over(_DRIVES, command=["drive", "drive right"], angle_max_deg=[30.0, 5.0]),
            # no more than 300 rpm from one to the next: else they are not believed
            *_over(_RIGHT, rpm=[(450,) * 4, (450, 300, 300, 501), (401, 300, 601, 450), (450, 701, 450, 401)]),
            *_over(_RIGHT, rpm=[MOVING], torque_max_nm=[40.0, 0.0]),
        ),
        setting=SearchSetting(revision="2021", car=CARS["2021"], first_state=_OFF),
    ),
    Scope(
        "power-up",
        "a process that enters autonomous by itself: car off and on, manual asked for, wheels turning",
        _each(GO, {"car_off": True}, _MANUAL, _SIDEWAYS, {"rpm": MOVING}),
        setting=_AT_POWER_UP,
    ),
    Scope(
        "power-up, any car",
        "the same beside a VCU that says any of its states from the start, wheels standing and turning",
        tuple(_says(state, rpm=rpm) for state, rpm in product((_OFF, _READY, _DRIVING), (STANDING, MOVING))),
        **_INSISTING,
        setting=_AT_POWER_UP,
    ),
    replace(
        _RUN,
        name="official simulator",
        # Its motors brake more weakly: a deceleration has 2 s to show, not 0.5 s.
        endings=(STANDS, replace(MOVES, within_ns=MOVES.within_ns + 1500 * MS)),
        setting=SearchSetting(
            config=replace(official_simulator(), steer_rate_degps=1500.0),
            car=CARS["official-simulator"],
            profile=OFFICIAL_SIMULATOR,
            first_state=_OFF,
            limits=OperationalLimits(),
        ),
    ),
    Scope(
        "listen only",
        "a process that only listens: nothing that happens makes it send",
        (
            *(_says(state) for state in (_OFF, _READY, _DRIVING)),
            *_over(_SAYS_DRIVING, event=(HAPPENINGS[0], HAPPENINGS[1], HAPPENINGS[4])),
            replace(_SAYS_DRIVING, **_EMERGENCY),
            _says(_OFF, **_AUTONOMOUS),
        ),
        path=(),
        endings=(),  # a process that never sends brings no car to any end
        setting=SearchSetting(config=replace(_CONFIG, listen_only=True)),
    ),
)
"""Every scope of the full search."""


def scope(name: str) -> Scope:
    """The scope of that name; an unknown name raises a ValueError that lists the valid ones."""
    for one in SCOPES:
        if one.name == name:
            return one
    raise ValueError(f"unknown scope {name!r}: choose one of {', '.join(one.name for one in SCOPES)}")
