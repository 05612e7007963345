"""A picture in one line of plain text, and the words that all pages share. No terminal is touched."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from fsai_vcu.diagnostics.monitor.snapshot import History, Picture

NO_VALUE: Final = "-"


def plain_line(picture: Picture, clock: str, signals: Sequence[History] = ()) -> str:
    """Everything that matters in one line, for a log or a terminal that can do no more."""
    words = [
        clock,
        picture.as_state or f"no 0x520{last_state(picture)}",
        picture.mission or "",
        f"mode {picture.mode}",
        f"Go {on_off(picture.go)}",
        f"{number(picture.speed_mps)} m/s",
        *(f"{name} {number(one.asked)} > {number(one.given)} {one.unit}" for name, one in picture.actuators.items()),
        f"handshake {picture.response}",
        *(f"{one.name} {one.value}" for one in signals),
        f"faults: {', '.join(all_faults(picture))}" if all_faults(picture) else "",
        *picture.link,
    ]
    if picture.why_not_driving:
        words.append("why not driving: " + "; ".join(one.words for one in picture.why_not_driving))
    return " | ".join(printable(word) for word in words if word)


def printable(text: str) -> str:
    """Control characters of foreign names never reach the terminal."""
    return "".join(char if char.isprintable() else "?" for char in text)


def last_state(picture: Picture) -> str:
    if picture.as_state_heard is None or picture.status_age_s is None:
        return ""
    return f" ({picture.as_state_heard} {duration(picture.status_age_s)} ago)"


def all_faults(picture: Picture) -> list[str]:
    cause = [f"SHUTDOWN_CAUSE {picture.shutdown_cause}"] if picture.shutdown_cause else []
    return [*picture.faults, *cause]


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
