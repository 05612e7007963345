"""The environment of the searched bridge: what it may choose in one cycle, the car's frames, and the VCU's memory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from enum import Enum
from functools import cache
from typing import Annotated, Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.abstraction import NOW
from fsai_hil.evidence.small_car import WELL
from fsai_hil.rules.numbers import CAR_PATIENCE_NS, MS
from fsai_vcu.core.ages import Ages
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.interface import messages as m
from fsai_vcu.interface.codec import Decoded
from fsai_vcu.interface.enums import Ami, AsState, Direction, EbsState, MissionStatus, OpState, ShutdownCause, TsState
from fsai_vcu.interface.frames import Frame
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
_DRIVES: Final = {"steering_rad": _LEFT, "throttle": 0.123}  # no share of it is whole tenths of Nm
COMMANDS: Final[Mapping[str, VehicleCommand]] = {
    "drive": _command(**_DRIVES),
    "drive right": _command(steering_rad=-_LEFT, throttle=1.0),
    "coast": _command(),
    "brake": _command(steering_rad=_LEFT, brake=0.4),
    "both": _command(**_DRIVES, brake=0.4),
    "finished": _command(**_DRIVES, mission_finished=True),
    "estop": _command(**_DRIVES, estop_request=True),
    "old": _command(**_DRIVES, data_age_ns=500 * MS - 1),
    "too old": _command(**_DRIVES, data_age_ns=500 * MS),
    "far too old": _command(**_DRIVES, data_age_ns=700 * MS),
    "future": _command(**_DRIVES, data_age_ns=-21 * MS),
    "other run": _command(**_DRIVES, run=-1),
    "nan": _command(**_DRIVES | {"steering_rad": math.nan}),
    "infinite": _command(**_DRIVES | {"throttle": math.inf}),
    "beyond": _command(**_DRIVES | {"throttle": 1.5}),
    "negative": _command(**_DRIVES, brake=-0.1),
    "beyond steering": _command(**_DRIVES | {"steering_rad": math.radians(31.0)}),
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

    @property
    def words(self) -> str:
        """Name what is out of the ordinary in it, by the names above."""
        given = zip(self.__struct_fields__, self.__struct_defaults__, strict=True)
        chosen = {name: value for name, default in given if (value := getattr(self, name)) != default}
        return "; ".join(f"{name} {_plain(value)}" for name, value in chosen.items()) or "nothing out of the ordinary"


def _plain(value: object) -> str:
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, frozenset):
        return ", ".join(sorted(value)) or "nobody"
    return "/".join(map(str, value)) if isinstance(value, tuple) else str(value)


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


_WELL: Final = replace(WELL, shutdown_cause=ShutdownCause.NO_SHUTDOWN)
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
_BITS: Final = m.Faults.__struct_fields__
_IDS: Final[Mapping[type, int]] = {
    kind: can_id
    for can_id, kind in enumerate((m.VcuDriveFront, m.VcuDriveRear, m.VcuSteer, m.VcuBrake, m.WheelSpeeds), 0x521)
}


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
        yield _frame(m.VcuDriveFront, now, 0.0, 0.0, choice.torque_max_nm)
        yield _frame(m.VcuDriveRear, now, 0.0, 0.0, choice.torque_max_nm)
    if STEER not in choice.lost:
        yield _frame(m.VcuSteer, now, 0.0, choice.angle_max_deg)
    if BRAKE not in choice.lost:
        yield _frame(m.VcuBrake, now, *[30.0 if vcu.brake else 0.0] * 4)
    if SPEEDS not in choice.lost:
        yield _frame(m.WheelSpeeds, now, *choice.rpm)


@cache  # the same few come again and again
def _frame(kind: type[Any], now: int, *values: float) -> CarFrame:
    image: m.Image = kind(*values, t_rx_ns=now)
    return CarFrame(_IDS[kind], b"", now, decoded=Decoded(image, (), None))


@cache
def _status_frame(
    bit: bool, go: bool, state: AsState, ami: Ami, fault: bool, marks: frozenset[str], now: int
) -> CarFrame:
    shown = {name: value for mark in marks for name, value in MARKS[mark].items()}
    faults = m.Faults(**{name: shown.pop(name) for name in _BITS if name in shown})
    image = replace(
        _WELL, handshake=bit, go_signal=go, as_state=state, ami=ami, fault=fault, faults=faults, t_rx_ns=now, **shown
    )
    return CarFrame(0x520, b"", now, decoded=Decoded(image, (), bit))
