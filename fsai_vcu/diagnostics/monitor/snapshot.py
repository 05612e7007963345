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

    def as_dict(self) -> dict[str, Any]:
        """As JSON types, without the time, which is the caller's to name."""
        found = {each.name: getattr(self, each.name) for each in dataclasses.fields(self) if each.name != "t_ns"}
        found["handshake"] = self.handshake.as_dict() if self.handshake else None
        found["messages"] = [_message_dict(message) for message in self.messages]
        found["actuators"] = {name: _rounded(dataclasses.asdict(each)) for name, each in self.actuators.items()}
        found["why_not_driving"] = [dataclasses.asdict(each) for each in self.why_not_driving]
        for name in ("states", "wheels_rpm"):
            found[name] = dict(found[name])
        for name in ("faults", "warnings", "link"):
            found[name] = list(found[name])
        return _rounded(found)


def _message_dict(message: MessagePicture) -> dict[str, Any]:
    return {
        "id": message.can_id,
        "extended": message.extended,
        "message": message.name,
        "rate_hz": round(message.rate_hz, 2),
        "expected_hz": message.expected_hz,
        "age_s": None if message.age_s is None else round(message.age_s, 4),
        "freshness": message.freshness.value,
        "wrong_length": message.wrong_length,
    }


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {name: round(value, 4) if isinstance(value, float) else value for name, value in values.items()}
