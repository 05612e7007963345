"""The car's frames as a search sends them: each carries its image along, and the same few come again and again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

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

_SWITCHES: Final = ("AS_SWITCH_STATUS falls", "TS_SWITCH_STATUS falls")
_REQUEST: Final = "SHUTDOWN_REQUEST rises"
_BITS: Final[Mapping[str, str]] = {f"fault bit {name} rises": name for name in ("bms", "ebs")}
_CAUSE: Final = "SHUTDOWN_CAUSE rises"
MARKS: Final = (*_SWITCHES, _REQUEST, *_BITS, _CAUSE)  # of those that `rules.seen.marks_of` knows
_IDS: Final[Mapping[type[Image], int]] = {
    kind: can_id for can_id, kind in enumerate((VcuDriveFront, VcuDriveRear, VcuSteer, VcuBrake, WheelSpeeds), 0x521)
}


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
def car_frame(kind: type[Any], now: int, *values: float) -> CarFrame:
    """A frame of 0x521 to 0x525, by what it carries in the order of its fields."""
    return _frame(_IDS[kind], kind(*values, t_rx_ns=now), now)


@cache
def brake_frame(braking: bool, now: int) -> CarFrame:
    return car_frame(VcuBrake, now, *[30.0 if braking else 0.0] * 4)
