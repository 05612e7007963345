"""One moment on the bus as plain data: what is drawn, and what is printed as JSON.

A value is None where it was never received, or where its message has been missing for so long that it counts as lost: a
message that stops coming must not leave its last values looking fresh.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY
from fsai_vcu.diagnostics.statistics.measure import Handshake


class Freshness(Enum):
    """How a message does, in a word."""

    FRESH = "ok"
    LATE = "late"  # frames are missing, but not enough to count as lost
    LOST = "lost"  # missing for as long as the interface calls a loss
    NEVER = "never received"


@dataclass(frozen=True, slots=True)
class MessagePicture:
    """One identifier. Rate over the last seconds; `age_s` since its newest frame."""

    can_id: int
    extended: bool
    name: str | None
    rate_hz: float
    expected_hz: float | None
    age_s: float | None
    freshness: Freshness
    wrong_length: bool  # its newest frames have a length that is not the message's
    data: bytes = b""
    changed: tuple[int, ...] = ()  # the bytes that changed within the last second

    @property
    def key(self) -> int:
        return self.can_id | (EXTENDED_KEY if self.extended else 0)

    @property
    def number(self) -> str:
        return f"{self.can_id:08X}" if self.extended else f"{self.can_id:03X}"


@dataclass(frozen=True, slots=True)
class Actuator:
    """What the AI computer asks for and what the car gives. `limit`: the most that the car takes now."""

    asked: float | None
    given: float | None
    limit: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class History:
    """A signal, or a byte of a message: its newest value, and how it changed within the last 30 s."""

    name: str
    value: str
    age_s: float
    changes: int
    changed_s: float | None  # since the newest change
    before: str = ""  # the value before that
    extent: str = ""  # least and most


@dataclass(frozen=True, slots=True)
class Obstacle:
    """One thing that stands between now and driving. `follows`: it goes by itself once the ones above it are gone."""

    words: str
    evidence: str = ""
    remedy: str = ""
    follows: bool = False


@dataclass(frozen=True, slots=True)
class Picture:
    """Everything at one moment of the view's clock. Labels are the interface's own words."""

    t_ns: int
    channel: str
    revision: str
    revision_reason: str
    frames: int  # received so far
    as_state: str | None = None
    as_state_s: float | None = None  # for how long
    as_state_heard: str | None = None  # the last one received, however long ago
    status_age_s: float | None = None
    mission: str | None = None
    mode: str = "unknown"
    mission_status: str | None = None
    direction: str | None = None
    estop_request: bool | None = None
    go: bool | None = None
    as_switch: bool | None = None
    ts_switch: bool | None = None
    states: Mapping[str, str] = field(default_factory=dict)  # OP_STATE, TS_STATE, EBS_STATE, … by signal
    driving: bool = False
    why_not_driving: tuple[Obstacle, ...] = ()
    wheels_rpm: Mapping[str, float] = field(default_factory=dict)
    speed_mps: float | None = None  # mean of the wheels
    speed_actual_kmh: float | None = None  # Speed_actual of 0x500
    actuators: Mapping[str, Actuator] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    shutdown_cause: str | None = None
    handshake: Handshake | None = None
    handshake_waiting_s: float | None = None  # since a toggle that has not been answered yet
    load: float | None = None
    link: tuple[str, ...] = ()  # what is wrong on the bus itself, in sentences
    messages: tuple[MessagePicture, ...] = ()

    @property
    def response(self) -> str:
        """How fast the AI computer answers the handshake."""
        median_ms = self.handshake.response.p50_ms if self.handshake else None
        return "no answers" if median_ms is None else f"{median_ms:.1f} ms"

    def as_dict(self) -> dict[str, Any]:
        """As JSON types, without the time, which is the caller's to name."""
        found: dict[str, Any] = _plain({each.name: getattr(self, each.name) for each in dataclasses.fields(self)})
        found["handshake"] = self.handshake.as_dict() if self.handshake else None
        for message in found["messages"]:
            message["id"], message["message"] = message.pop("can_id"), message.pop("name")
        del found["t_ns"]
        return found


def _plain(value: Any) -> Any:
    """Dataclasses, tuples, words and bytes as JSON types; numbers with four digits."""
    if isinstance(value, float):
        return round(value, 4)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, Mapping):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return _plain(dataclasses.asdict(value)) if dataclasses.is_dataclass(value) else value  # type: ignore[arg-type]
