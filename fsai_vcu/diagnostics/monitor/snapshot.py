"""One moment on the bus as plain data: what is drawn, what is printed as JSON or in a line. No terminal is touched.

A value is None where it was never received, or where its message has been missing for so long that it counts as lost: a
message that stops coming must not leave its last values looking fresh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final

from fsai_vcu.core.supervision.start_conditions import Obstacle
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY
from fsai_vcu.diagnostics.statistics.measure import BITRATE, Handshake, as_json
from fsai_vcu.printable import printable

NO_VALUE: Final = "-"


class Freshness(Enum):
    """Freshness of a message, in a word."""

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
    """Values that the AI computer asks of an actuator, and those that the car gives. `limit`: the most that the car
    takes now.
    """

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
    lap: int | None = None  # completed, as the AI computer counts
    laps: int | None = None  # of this mission, by the rules
    lap_times_s: tuple[float, ...] = ()  # of this run, or the last; the first from where the car moved off
    cones: int | None = None  # that it sees now
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
    load: float | None = None  # share of `bitrate`, over the last seconds
    bitrate: int = BITRATE  # bit/s
    link: tuple[str, ...] = ()  # what is wrong on the bus itself, in sentences
    findings: tuple[str, ...] = ()  # of a log: its verdict, and what was found up to here
    messages: tuple[MessagePicture, ...] = ()

    @property
    def response(self) -> str:
        """Time that the AI computer takes to answer the handshake."""
        median_ms = self.handshake.response_ms.p50_ms if self.handshake else None
        return "no answers" if median_ms is None else f"{median_ms:.1f} ms"

    @property
    def last_state(self) -> str:
        """Last AS state of a car that is silent, and its age."""
        if self.as_state_heard is None or self.status_age_s is None:
            return ""
        return f" ({self.as_state_heard} {duration(self.status_age_s)} ago)"

    @property
    def all_faults(self) -> list[str]:
        cause = [f"SHUTDOWN_CAUSE {self.shutdown_cause}"] if self.shutdown_cause else []
        return [*self.faults, *cause]

    def as_dict(self) -> dict[str, Any]:
        """Return the picture as JSON types, without the time, which is the caller's to name."""
        found: dict[str, Any] = as_json(self, 4)
        found["handshake"] = as_json(self.handshake, 6)
        for message in found["messages"]:
            message["id"], message["message"] = message.pop("can_id"), message.pop("name")
        del found["t_ns"]
        return found


# ---------------------------------------------------------------- in words


def plain_line(picture: Picture, clock: str, signals: Sequence[History] = ()) -> str:
    """Everything that matters in one line, for a log or a terminal that can do no more."""
    words = [
        clock,
        picture.as_state or f"no AS state{picture.last_state}",
        picture.mission or "",
        f"mode {picture.mode}",
        f"Go {on_off(picture.go)}",
        f"{number(picture.speed_mps)} m/s",
        *(f"{name} {number(one.asked)} > {number(one.given)} {one.unit}" for name, one in picture.actuators.items()),
        f"handshake {picture.response}",
        *(f"{one.name} {one.value}" for one in signals),
        f"faults: {', '.join(picture.all_faults)}" if picture.all_faults else "",
        *picture.link,
        *(text for text in picture.findings if not text.startswith("note")),
    ]
    if picture.why_not_driving:
        words.append("why not driving: " + "; ".join(one.words for one in picture.why_not_driving))
    return " | ".join(printable(word) for word in words if word)


def on_off(on: bool | None) -> str:
    return NO_VALUE if on is None else "on" if on else "off"


def number(value: float | None) -> str:
    return NO_VALUE if value is None else f"{value:.1f}"


def age(age_s: float) -> str:
    return f"{age_s * 1000:.0f} ms" if age_s < 1.0 else duration(age_s)


def duration(time_s: float) -> str:
    if time_s < 60.0:
        return f"{time_s:.1f} s"
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02} h" if hours else f"{minutes}:{seconds:02} min"
