"""Pictures as rich text, what matters most on top. No terminal is touched."""

from __future__ import annotations

import textwrap
from typing import Final

from rich.text import Text

from fsai_vcu.diagnostics.explain.incident import TimelineEntry, Weight
from fsai_vcu.diagnostics.monitor import snapshot
from fsai_vcu.diagnostics.monitor.snapshot import Freshness, History, MessagePicture, Picture
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import KMH_PER_MPS
from fsai_vcu.printable import printable

STRONG, FAINT, GOOD, WARN, BAD = "bold", "dim", "green", "yellow", "bold red"
_LIGHT_STYLES: Final = {"yellow": "bold black on yellow", "blue": "bold white on blue"}
_FRESHNESS_STYLES: Final = {Freshness.LATE: WARN, Freshness.LOST: BAD, Freshness.NEVER: FAINT}
_WEIGHT_STYLES: Final = {Weight.NOTE: FAINT, Weight.STATE: "", Weight.WARNING: WARN, Weight.FAULT: BAD}
_FINDING_STYLES: Final = {"problem": BAD, "unknown": WARN, "note": FAINT}
_SHORT: Final = 20  # lines: on fewer the reasons go before everything else
_NARROW: Final = 70
_MANY_REASONS: Final = 4


def line(*parts: str | tuple[str, str], wrap: bool = False) -> Text:
    """Some text of several styles."""
    pairs = [(part, "") if isinstance(part, str) else part for part in parts]
    shown = [(printable(text), style) for text, style in pairs]
    return Text.assemble(*shown, no_wrap=not wrap, overflow="fold" if wrap else "crop")


def head(picture: Picture, clock: str, width: int, page: str = "") -> Text:
    load = "" if picture.load is None else f"load {picture.load:.0%}   "
    left = f" {picture.channel}   revision {picture.revision}   {load}{page}" if width >= 60 else f" {picture.channel}"
    room = max(0, width - len(clock) - 2)
    return line((f"{left[:room]:{room}} {clock} ", "reverse"))


def overview(picture: Picture, width: int, height: int, *, dark_phase: bool = False) -> Text:
    """The state, why the car is not driving, what is wrong, what is asked and given, the messages.

    width, height: of the screen. dark_phase: what flashes is off at the moment.
    """
    short = height < _SHORT
    lines = [*_state(picture, dark_phase)[: 2 if short else 3], *_why(picture, width, remedies=not short)]
    lines += [_faults(picture), *(line((f"! {text}", BAD), wrap=True) for text in picture.link)]
    findings = [(text, _FINDING_STYLES.get(text.partition(":")[0], "")) for text in picture.findings]
    lines += [line(one, wrap=True) for one in findings if one[1] != FAINT]
    if any(one.asked is not None or one.given is not None for one in picture.actuators.values()):
        lines += _figures(picture)
    if picture.as_state and not short:
        lines.append(_handshake(picture))
    worst_first = sorted(picture.messages, key=lambda m: m.freshness in (Freshness.FRESH, Freshness.NEVER))
    if picture.frames:
        lines += [message_row(message, width) for message in worst_first]
    lines += [line(one, wrap=True) for one in findings if one[1] == FAINT]
    return Text("\n").join(lines)


def message_row(message: MessagePicture, width: int) -> Text:
    """Its bytes, those that changed within the last second highlighted."""
    style = WARN if message.wrong_length else _FRESHNESS_STYLES.get(message.freshness, "")
    head = f"{message.number:3} "
    tail = f"{_tail(message):>8}  "
    if width >= _NARROW:
        head += f"{message.name or 'in no database':22.22}"
        tail = f"{message.rate_hz:4.0f}/s {tail}"
    data: list[tuple[str, str]] = []
    for place, byte in enumerate(message.data):
        data += [(f"{byte:02X}", "bold reverse" if place in message.changed else style), (" ", "")]
    return line((head, style), (tail, style), *data)[:width]


def history_row(history: History, width: int, *, full: bool = False) -> Text:
    """A signal or a byte; its value is highlighted where it changed within the last second. full: with the message."""
    room = max(16, min(44, width - 42))
    name = history.name if full else history.name.rpartition(".")[2]
    name = name if len(name) <= room else f"…{name[1 - room :]}"
    changed = ""
    if history.changed_s is not None:
        beyond = history.extent or f"was {history.before}"
        changed = f"{snapshot.age(history.changed_s):>6}"
        if width >= _NARROW:
            changed = f" {changed} ago, {history.changes}×, {beyond}"
    old = f"   {snapshot.age(history.age_s)} old" if history.age_s > 1.0 else ""
    style = STRONG if history.changed_s is None or history.changed_s > 1.0 else "bold reverse"
    blanks = " " * (14 - len(history.value))
    row = line(f"{name:{room}} {blanks}", (history.value, style), (f" {changed}{old}", FAINT))
    row.truncate(width, overflow="ellipsis")
    return row


def event_row(event: TimelineEntry, clock: str, *, later: bool) -> Text:
    """`later`: it comes only after the moment that is shown."""
    return line((f"{clock:>12}  ", FAINT), (event.text, FAINT if later else _WEIGHT_STYLES[event.weight]))


# ---------------------------------------------------------------- parts of the overview


def _state(picture: Picture, dark_phase: bool) -> list[Text]:
    state = picture.as_state
    colour, flashes = snapshot.LIGHTS.get(state or "", ("", False))
    style = STRONG if dark_phase and flashes else _LIGHT_STYLES.get(colour, STRONG)
    shown = (state, style) if state else ("no AS state", BAD)
    held = f" for {snapshot.duration(picture.as_state_s)}" if picture.as_state_s is not None else ""
    switches = (("Go", picture.go), ("ASMS", picture.as_switch), ("TSMS", picture.ts_switch))
    styles = {None: "", True: GOOD, False: WARN}
    parts = [part for name, on in switches for part in (f"  {name} ", (snapshot.on_off(on), styles[on]))]
    asked = [word for word in (picture.mission_status, picture.direction) if word]
    heard = any(m.can_id in AI_IDS and not m.extended and m.freshness is Freshness.FRESH for m in picture.messages)
    ai = f"sends {' '.join(asked)}" if asked else "sends what the database does not name" if heard else "is silent"
    estop = [("   ESTOP_REQUEST 1", BAD)] if picture.estop_request else []
    names = {"STEERING_STATUS": "steering ", "STATUS_BRK": "brakes ", "STATUS_EBS": "STATUS_EBS "}
    states = "  ".join(f"{names.get(name, '')}{word}" for name, word in picture.states.items())
    return [
        line(shown, held if state else picture.last_state, *parts, f"  mode {picture.mode}", wrap=True),
        line("mission ", (picture.mission or snapshot.NO_VALUE, STRONG), f"   AI {ai}", *estop, wrap=True),
        *([line((states, FAINT))] if states else []),
    ]


def _why(picture: Picture, width: int, *, remedies: bool) -> list[Text]:
    if picture.driving:
        return [line(("driving", GOOD))]
    lines = []
    for one in picture.why_not_driving:
        lines.append(_wrapped(one.sentence, "  - ", FAINT if one.follows else WARN, width))
        if remedies and one.remedy and not one.follows and len(picture.why_not_driving) <= _MANY_REASONS:
            lines.append(_wrapped(one.remedy, "    ", FAINT, width))
    return [line(("why not driving:", STRONG)), *lines] if lines else []


def _wrapped(text: str, indent: str, style: str, width: int) -> Text:
    text = printable(text)
    return Text(textwrap.fill(text, max(20, width), initial_indent=indent, subsequent_indent="    "), style)


def _faults(picture: Picture) -> Text:
    faults = picture.all_faults
    shown = (", ".join(faults) or "none", BAD if faults else GOOD) if picture.as_state else snapshot.NO_VALUE
    return line("faults      ", shown, (f"   {', '.join(picture.warnings)}", WARN), wrap=True)


def _figures(picture: Picture) -> list[Text]:
    lines = [line((f"{'':12}{'asked':>7}{'given':>7}{'most':>7}", FAINT))]
    for name, one in picture.actuators.items():
        most = "" if one.limit is None else snapshot.number(one.limit)
        given = (f"{snapshot.number(one.given):>7}", STRONG)
        lines.append(line(f"{name:12}{snapshot.number(one.asked):>7}", given, f"{most:>7} {one.unit}"))
    speed = snapshot.NO_VALUE
    if picture.speed_mps is not None:
        speed = f"{picture.speed_mps:.1f} m/s, {picture.speed_mps * KMH_PER_MPS:.0f} km/h"
    wheels = "".join(f"  {name} {rpm:.0f}" for name, rpm in picture.wheels_rpm.items())
    return [*lines, line("speed       ", (speed, STRONG), f"   wheels{wheels} rpm" if wheels else "", wrap=True)]


def _handshake(picture: Picture) -> Text:
    shown = picture.handshake
    if shown is None or shown.response_ms.max_ms is None:
        return line("handshake   ", ("no answers", WARN))
    late = (f", {shown.unanswered} unanswered" if shown.unanswered else "", BAD)
    text = f"answered in {picture.response}, at most {shown.response_ms.max_ms:.1f} ms, {shown.answered} times in 3 s"
    return line("handshake   ", text, late)


def _tail(message: MessagePicture) -> str:
    """Its age, and what is wrong with that."""
    if message.age_s is None:
        return message.freshness.value
    marks = {Freshness.LATE: " late", Freshness.LOST: " LOST"}
    return f"{snapshot.age(message.age_s):>6}{marks.get(message.freshness, '')}"
