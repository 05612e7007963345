"""A picture as lines of a terminal: what matters most on top, so that any height shows it. No terminal is touched."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from fsai_vcu.diagnostics.monitor.snapshot import Actuator, Freshness, MessagePicture, Obstacle, Picture
from fsai_vcu.interface.units import KMH_PER_MPS

_RESET: Final = "\x1b[0m"
_STYLES: Final = {
    "": "",
    "head": "\x1b[7m",
    "strong": "\x1b[1m",
    "faint": "\x1b[2m",
    "good": "\x1b[32m",
    "warn": "\x1b[33m",
    "bad": "\x1b[1;31m",
    "blue": "\x1b[1;34m",
}
# As the car's own lights show it: interface specification v4.0, ASSI
_STATE_STYLES: Final = {
    "AS_READY": "warn",
    "AS_DRIVING": "good",
    "EMERGENCY_BRAKE": "bad",
    "AS_FINISHED": "blue",
}
_FRESHNESS_STYLES: Final = {
    Freshness.FRESH: "",
    Freshness.LATE: "warn",
    Freshness.LOST: "bad",
    Freshness.NEVER: "faint",
}
_MARKS: Final = {Freshness.LATE: " late", Freshness.LOST: " LOST"}
_NO_VALUE: Final = "-"
_MESSAGE_WIDTH: Final = 39
_LEAST_MESSAGE_LINES: Final = 3
_LEAST_REASON_LINES: Final = 8


class Part(NamedTuple):
    """Some text of one style."""

    text: str
    style: str = ""


Line = Sequence[Part]


def screen_lines(picture: Picture, width: int, height: int, clock: str = "", *, color: bool = True) -> list[str]:
    """At most `height` lines of at most `width` characters. clock: what stands in the corner."""
    head = [_title(picture, width, clock), *_state(picture)]
    figures = [*_values(picture), _handshake(picture)]
    trouble = [_faults(picture), *([Part(f"! {text}", "bad")] for text in picture.link)]
    room = height - len(head) - len(trouble)
    if room - len(figures) < _LEAST_REASON_LINES:  # the reasons go before the figures
        figures = []
    room -= len(figures)
    why = _why(picture, width, max(2, room - _LEAST_MESSAGE_LINES) if figures else room)
    lines = [*head, *figures, *trouble, *why, *_messages(picture.messages, width, room - len(why))]
    return [_drawn(line, width, color) for line in lines[:height]]


def plain_line(picture: Picture, clock: str) -> str:
    """Everything that matters in one line, for a log or a terminal that can do no more."""
    steering = picture.actuators.get("steering")
    words = [
        clock,
        picture.as_state or f"no 0x520{_last_state(picture)}",
        picture.mission or "",
        f"mode {picture.mode}",
        f"Go {_on(picture.go)}",
        f"{_number(picture.speed_mps)} m/s",
        f"steering {_asked_given(steering)} deg",
        f"torque {_axles(picture, 'torque')} Nm",
        f"brake {_axles(picture, 'brake')} %",
        f"handshake {_response(picture)}",
    ]
    if picture.faults or picture.shutdown_cause:
        words.append(f"faults: {', '.join(_all_faults(picture))}")
    words += picture.link
    if picture.why_not_driving:
        words.append("why not driving: " + "; ".join(one.words for one in picture.why_not_driving))
    return " | ".join(word for word in words if word)


# ---------------------------------------------------------------- parts of the screen


def _title(picture: Picture, width: int, clock: str) -> Line:
    load = "" if picture.load is None else f"load {picture.load:.0%}   "
    left = f" {picture.channel}   revision {picture.revision}   {load}"
    right = f"  listening only   {clock} "
    return [Part(left[: max(0, width - len(right))].ljust(max(0, width - len(right))) + right, "head")]


def _state(picture: Picture) -> Iterable[Line]:
    state = picture.as_state
    held = f" for {_duration(picture.as_state_s)}" if picture.as_state_s is not None else ""
    shown = Part(state, _STATE_STYLES.get(state, "strong")) if state else Part("no AS state", "bad")
    yield [
        shown,
        Part(held if state else _last_state(picture)),
        Part("  Go "),
        _switch(picture.go),
        Part("  ASMS "),
        _switch(picture.as_switch),
        Part("  TSMS "),
        _switch(picture.ts_switch),
        Part(f"  mode {picture.mode}"),
    ]
    asked = [word for word in (picture.mission_status, picture.direction) if word]
    ai = f"sends {' '.join(asked)}" if asked else "is silent"
    estop = [Part("   ESTOP_REQUEST 1", "bad")] if picture.estop_request else []
    yield [
        Part("mission "),
        Part(picture.mission or _NO_VALUE, "strong"),
        Part(f"   AI {ai}"),
        *estop,
    ]
    names = {"STEERING_STATUS": "steering ", "STATUS_BRK": "brakes ", "STATUS_EBS": "STATUS_EBS "}
    if picture.states:
        yield [Part("  ".join(f"{names.get(name, '')}{word}" for name, word in picture.states.items()), "faint")]


def _values(picture: Picture) -> Iterable[Line]:
    yield [Part(f"{'':12}{'asked':>8}{'given':>8}{'most':>8}{'':6}{'':12}{'asked':>8}{'given':>8}", "faint")]
    wheels = "  ".join(f"{name} {rpm:.0f}" for name, rpm in picture.wheels_rpm.items())
    speed = "-" if picture.speed_mps is None else f"{picture.speed_mps:.1f} m/s, {picture.speed_mps * KMH_PER_MPS:.0f}"
    beside = (
        _pair(picture, "brake front"),
        _pair(picture, "brake rear"),
        [Part(f"{'speed':12}"), Part(f"{speed} km/h" if speed != "-" else speed, "strong")],
    )
    for name, right in zip(("steering", "torque front", "torque rear"), beside, strict=True):
        actuator = picture.actuators.get(name)
        most = _number(actuator.limit) if actuator else _NO_VALUE
        unit = actuator.unit if actuator else ""
        yield [*_pair(picture, name, unit=False), Part(f"{most:>8} {unit:<5}"), *right]
    yield [Part(f"{'wheels':12}"), Part(f"{wheels} rpm" if wheels else _NO_VALUE)]


def _pair(picture: Picture, name: str, *, unit: bool = True) -> Line:
    actuator = picture.actuators.get(name)
    asked, given = (actuator.asked, actuator.given) if actuator else (None, None)
    tail = f" {actuator.unit}" if actuator and unit else ""
    return [Part(f"{name:12}"), Part(f"{_number(asked):>8}"), Part(f"{_number(given):>8}", "strong"), Part(tail)]


def _handshake(picture: Picture) -> Line:
    handshake = picture.handshake
    if handshake is None or handshake.response.p50_ms is None:
        return [Part(f"{'handshake':12}"), Part("no answers", "warn" if picture.as_state else "faint")]
    spread = handshake.response
    text = f"answered in {spread.p50_ms:.1f} ms, at most {spread.max_ms:.1f} ms, {handshake.answered} times in 3 s"
    late = [Part(f", {handshake.unanswered} unanswered", "bad")] if handshake.unanswered else []
    return [Part(f"{'handshake':12}"), Part(text), *late]


def _faults(picture: Picture) -> Line:
    faults = _all_faults(picture)
    line = [Part(f"{'faults':12}"), Part(", ".join(faults) if faults else "none", "bad" if faults else "good")]
    if picture.as_state is None:
        line = [Part(f"{'faults':12}"), Part(_NO_VALUE)]
    if picture.warnings:
        line.append(Part(f"   {', '.join(picture.warnings)}", "warn"))
    return line


def _why(picture: Picture, width: int, room: int) -> list[Line]:
    if picture.driving:
        return [[Part("driving", "good")]]
    if not picture.why_not_driving:
        return []
    reasons = [_reason(one, width) for one in picture.why_not_driving]
    spare = room - 1 - sum(map(len, reasons))
    if spare < 0:
        reasons = [reason[:1] for reason in reasons]
    lines: list[Line] = []
    for one, reason in zip(picture.why_not_driving, reasons, strict=True):
        remedy = _wrapped(one.remedy, "    ", "faint", width) if not one.follows else []
        lines += reason
        if len(remedy) <= spare:
            lines += remedy
            spare -= len(remedy)
    if len(lines) > room - 1:
        lines[room - 2 :] = [[Part(f"  … and {len(lines) - (room - 2)} more", "faint")]]
    return [[Part("why not driving:", "strong")], *lines]


def _reason(one: Obstacle, width: int) -> list[Line]:
    repeated = one.evidence in one.words or one.evidence.replace(" is ", " ") in one.words
    evidence = "" if repeated else f" ({one.evidence})"
    return _wrapped(f"{one.words}{evidence}", "  - ", "faint" if one.follows else "warn", width)


def _wrapped(text: str, indent: str, style: str, width: int) -> list[Line]:
    lines = textwrap.wrap(text, max(20, width), initial_indent=indent, subsequent_indent="    ")
    return [[Part(line, style)] for line in lines]


def _messages(messages: Sequence[MessagePicture], width: int, room: int) -> list[Line]:
    """As many as fit, in columns; where not all fit, those first that are not as they should be."""
    columns = max(1, (width + 2) // (_MESSAGE_WIDTH + 2))
    if room < 1 or not messages:
        return []
    cells = [_cell(message) for message in messages]
    if len(cells) > room * columns:
        worst_first = sorted(messages, key=lambda m: m.freshness in (Freshness.FRESH, Freshness.NEVER))
        cells = [_cell(message) for message in worst_first[: room * columns - 1]]
        cells.append(Part(f"… and {len(messages) - len(cells)} more".ljust(_MESSAGE_WIDTH), "faint"))
    rows = -(-len(cells) // columns)
    return [[part for cell in cells[row::rows] for part in (cell, Part("  "))][:-1] for row in range(rows)]


def _cell(message: MessagePicture) -> Part:
    name = (message.name or "in no database")[:19]
    if message.freshness is Freshness.NEVER:
        tail = message.freshness.value
    else:
        age = _age(message.age_s or 0.0)
        mark = _MARKS.get(message.freshness, "")
        tail = f"{message.rate_hz:4.0f}/s {age:>6}" if not mark else f"{age}{mark}"
    style = "warn" if message.wrong_length else _FRESHNESS_STYLES[message.freshness]
    text = f"{message.number[-8:]:3} {name:19}"
    return Part(f"{text} {tail:>{max(0, _MESSAGE_WIDTH - len(text) - 1)}}"[:_MESSAGE_WIDTH], style)


# ---------------------------------------------------------------- words


def _last_state(picture: Picture) -> str:
    if picture.as_state_heard is None or picture.status_age_s is None:
        return ""
    return f" ({picture.as_state_heard} {_duration(picture.status_age_s)} ago)"


def _all_faults(picture: Picture) -> list[str]:
    cause = [f"SHUTDOWN_CAUSE {picture.shutdown_cause}"] if picture.shutdown_cause else []
    return [*picture.faults, *cause]


def _switch(on: bool | None) -> Part:
    return Part(_on(on), "" if on is None else "good" if on else "warn")


def _on(on: bool | None) -> str:
    return _NO_VALUE if on is None else "on" if on else "off"


def _number(value: float | None) -> str:
    return _NO_VALUE if value is None else f"{value:.1f}"


def _asked_given(actuator: Actuator | None) -> str:
    return f"{_number(actuator.asked)} > {_number(actuator.given)}" if actuator else _NO_VALUE


def _axles(picture: Picture, what: str) -> str:
    both = [picture.actuators.get(f"{what} {axle}") for axle in ("front", "rear")]
    asked = "/".join(_number(one.asked if one else None) for one in both)
    given = "/".join(_number(one.given if one else None) for one in both)
    return f"{asked} > {given}"


def _response(picture: Picture) -> str:
    if picture.handshake is None or picture.handshake.response.p50_ms is None:
        return "no answers"
    return f"{picture.handshake.response.p50_ms:.1f} ms"


def _age(age_s: float) -> str:
    return f"{age_s * 1000:.0f} ms" if age_s < 1.0 else _duration(age_s)


def _duration(time_s: float) -> str:
    if time_s < 60.0:
        return f"{time_s:.1f} s"
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02} h" if hours else f"{minutes}:{seconds:02} min"


def _drawn(line: Line, width: int, color: bool) -> str:
    """Cut to the width; control characters of foreign names never reach the terminal."""
    shown: list[str] = []
    left = width
    for text, style in line:
        piece = "".join(char if char.isprintable() else "?" for char in text)[:left]
        left -= len(piece)
        code = _STYLES[style] if color else ""
        shown.append(f"{code}{piece}{_RESET}" if code and piece else piece)
    return "".join(shown)
