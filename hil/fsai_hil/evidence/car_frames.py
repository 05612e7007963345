"""The car's frames as a search sends them: each carries its image along, and the same few come again and again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Final

from fsai_vcu.interface.codec import Decoded
from fsai_vcu.interface.enums import Ami, AsState, ShutdownCause
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    Faults,
    Image,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    WheelSpeeds,
)

_SWITCHES: Final = ("AS_SWITCH_STATUS 0", "TS_SWITCH_STATUS 0")
_REQUEST: Final = "SHUTDOWN_REQUEST 1"
_BITS: Final[Mapping[str, str]] = {"BMS_FAULT 1": "bms", "EBS_FAULT 1": "ebs"}
_CAUSE: Final = "a SHUTDOWN_CAUSE"
MARKS: Final = (*_SWITCHES, _REQUEST, *_BITS, _CAUSE)
_NO_MARKS: Final[frozenset[str]] = frozenset()


@dataclass(frozen=True, slots=True)
class CarFrame(Frame):
    """A frame that carries its image along."""

    decoded: Decoded = field(default_factory=lambda: Decoded(None))


class PlainCodec:
    """The codec that hands on what a frame carries."""

    unknown = ""

    def decode(self, frame: CarFrame) -> Decoded:
        return frame.decoded


def _frame(can_id: int, image: Image | None, now: int, handshake: bool | None = None) -> CarFrame:
    return CarFrame(can_id, b"", now, decoded=Decoded(image, (), handshake))


@cache
def status_frame(
    bit: bool, go: bool, state: AsState, ami: Ami, fault: bool, marks: frozenset[str], now: int
) -> CarFrame:
    image = VcuStatus(
        handshake=bit,
        shutdown_request=_REQUEST in marks,
        as_switch=_SWITCHES[0] not in marks,
        ts_switch=_SWITCHES[1] not in marks,
        go_signal=go,
        as_state=state,
        ami=ami,
        fault=fault,
        faults=Faults(**{field: mark in marks for mark, field in _BITS.items()}),
        shutdown_cause=ShutdownCause.BMS_FAULT if _CAUSE in marks else ShutdownCause.NO_SHUTDOWN,
        t_rx_ns=now,
    )
    return _frame(0x520, image, now, bit)


@cache
def unreadable_frame(bit: bool, now: int) -> CarFrame:
    return _frame(0x520, None, now, bit)


@cache
def front_frame(torque_max_nm: float, now: int) -> CarFrame:
    return _frame(0x521, VcuDriveFront(0.0, 0.0, torque_max_nm, now), now)


@cache
def rear_frame(torque_max_nm: float, now: int) -> CarFrame:
    return _frame(0x522, VcuDriveRear(0.0, 0.0, torque_max_nm, now), now)


@cache
def steer_frame(angle_max_deg: float, now: int) -> CarFrame:
    return _frame(0x523, VcuSteer(0.0, angle_max_deg, 0.0, now), now)


@cache
def brake_frame(braking: bool, now: int) -> CarFrame:
    pct = 30.0 if braking else 0.0
    return _frame(0x524, VcuBrake(pct, pct, pct, pct, t_rx_ns=now), now)


@cache
def speeds_frame(rpm: tuple[int, int, int, int], now: int) -> CarFrame:
    return _frame(0x525, WheelSpeeds(*rpm, now), now)


def marks_of(status: VcuStatus) -> frozenset[str]:
    """What it shows besides, of `MARKS`."""
    shown = (
        not status.as_switch, not status.ts_switch, status.shutdown_request, status.faults.bms, status.faults.ebs,
        status.shutdown_cause is not ShutdownCause.NO_SHUTDOWN,
    )  # fmt: skip
    return frozenset(mark for mark, there in zip(MARKS, shown, strict=True) if there) if any(shown) else _NO_MARKS
