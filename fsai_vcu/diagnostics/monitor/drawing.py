"""Pictures as rich text, what matters most on top. No terminal is touched."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from rich.text import Text

from fsai_vcu.diagnostics.explain.incident import TimelineEntry, Weight
from fsai_vcu.diagnostics.explain.record import Series
from fsai_vcu.diagnostics.monitor import snapshot
from fsai_vcu.diagnostics.monitor.snapshot import Actuator, Freshness, History, MessagePicture, Picture
from fsai_vcu.diagnostics.monitor.view import TREND_NS
from fsai_vcu.interface.lights import light_of
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import AXLE_TORQUE_MAX_NM
from fsai_vcu.interface.units import KMH_PER_MPS, MS
from fsai_vcu.printable import printable

STRONG, FAINT, GOOD, WARN, BAD = "bold", "dim", "green", "yellow", "bold red"
_LIGHT_STYLES: Final = {"yellow": "bold black on yellow", "blue": "bold white on blue"}
_FRESHNESS_STYLES: Final = {Freshness.LATE: WARN, Freshness.LOST: BAD, Freshness.NEVER: FAINT}
_WEIGHT_STYLES: Final = {Weight.NOTE: FAINT, Weight.STATE: "", Weight.WARNING: WARN, Weight.FAULT: BAD}
_FINDING_STYLES: Final = {"problem": BAD, "unknown": WARN, "note": FAINT}
_SHORT: Final = 20  # lines: on fewer the reasons go before everything else
_NARROW: Final = 70
_MANY_REASONS: Final = 4
_BLOCKS: Final = "▁▂▃▄▅▆▇█"
_OLD_NS: Final = 250 * MS  # a value so old is not drawn on
STEER_SHOWN_DEG: Final = 30.0


def line(*parts: str | tuple[str, str], wrap: bool = False) -> Text:
    """Make a line of texts of several styles."""
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

    width, height: of the screen. dark_phase: a lamp that flashes is off at the moment.
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
    """Draw an event; `later`: it comes only after the moment that is shown."""
    return line((f"{clock:>12}  ", FAINT), (event.text, FAINT if later else _WEIGHT_STYLES[event.weight]))


def badges(keys: Sequence[tuple[str, str]], width: int) -> Text:
    """Keys, each with what it does: as many as fit."""
    text = Text(no_wrap=True)
    for key, word in keys:
        gap = " " if text else ""
        if len(text) + len(gap) + len(key) + len(word) + 3 > width:
            break
        text.append(gap).append(f" {key} ", "reverse").append(f" {word}")
    return text


def instruments(picture: Picture, trends: Mapping[str, Series], width: int) -> Text:
    """Bars and the last ten seconds, for the space beside the overview. trends: by name, as of View.trends."""
    lines = []
    speed = snapshot.NO_VALUE if picture.speed_mps is None else f"{picture.speed_mps:.1f} m/s"
    lap = "" if picture.lap is None else f"laps driven: {picture.lap}"
    if picture.laps and picture.lap is not None and picture.mission_status != "FINISHED":
        lap = f"lap {min(picture.lap + 1, picture.laps)} of {picture.laps}"
    lines.append(line(f"{'speed':13}", (speed, STRONG), f"   {lap}"))
    lines.append(_trend(trends.get("speed"), picture.t_ns, width, least=1.0))
    if picture.lap_times_s:
        times = (f"{place}: {time_s:.1f} s" for place, time_s in enumerate(picture.lap_times_s, 1))
        lines.append(line(f"{'lap times':13}", "  ".join([*times][-3:])))
    lines.append(line(""))
    for name, one in picture.actuators.items():
        both = name == "steering"
        full = STEER_SHOWN_DEG if both else 100.0 if one.unit == "%" else AXLE_TORQUE_MAX_NM
        lines.append(_bar(name, one, full, width, both=both))
        lines += [_trend(trends.get(f"{name} given"), picture.t_ns, width, least=full / 20), line("")]
    load = "" if picture.load is None else f" {picture.load:4.0%} of {picture.bitrate / 1000:.0f} kbit/s"
    whole = Actuator(None, picture.load, None, "")
    return Text("\n").join([*lines, _bar("bus load", whole, 1.0, width - len(load), both=False).append(load)])


def _bar(name: str, one: Actuator, full: float, width: int, *, both: bool) -> Text:
    """A bar from 0 to what is given, a mark at what is asked for, an edge at the limit; left is positive."""
    room = max(8, width - 13)
    zero = room // 2 if both else 0

    def place(value: float) -> int:
        share = value / full
        return min(room - 1, max(0, round(zero - share * zero if both else share * (room - 1))))

    cells = [("·", FAINT)] * room
    if one.limit is not None:
        for edge in {place(one.limit), place(-one.limit if both else one.limit)}:
            cells[edge] = ("╎", WARN)
    if one.given is not None:
        low, high = sorted((zero, place(one.given)))
        cells[low : high + 1] = [("█", "blue")] * (high + 1 - low)
    if one.asked is not None:
        cells[place(one.asked)] = ("┃", STRONG)
    return line(f"{name:13}", *cells)


def _trend(series: Series | None, now_ns: int, width: int, *, least: float) -> Text:
    """The last ten seconds, a column for each part of them; `least`: so high is the top at least."""
    room = max(8, width - 13)
    if series is None or not len(series):
        return line("")
    t_ns = now_ns - TREND_NS + np.arange(1, room + 1) * (TREND_NS // room)
    rows = np.searchsorted(series.t_ns, t_ns, side="right") - 1
    known = (rows >= 0) & (t_ns - series.t_ns[np.maximum(rows, 0)] < _OLD_NS)
    values = series.values[np.maximum(rows, 0)]
    low, high = min(0.0, float(values.min())), max(least, float(values.max()))
    if low < 0.0:
        low, high = min(low, -high), max(high, -low)
    levels = np.rint((values - low) / (high - low) * (len(_BLOCKS) - 1)).astype(int).tolist()
    text = "".join(_BLOCKS[level] if shown else " " for level, shown in zip(levels, known.tolist(), strict=True))
    return line(" " * 13, (text, "blue"))


# ---------------------------------------------------------------- parts of the overview


def _state(picture: Picture, dark_phase: bool) -> list[Text]:
    """Return the lines on the car's state: lamp, time in the state, switches, and what the AI computer says."""
    state = picture.as_state
    light = light_of(state)
    lamp = "" if light.colour not in _LIGHT_STYLES else "○ " if dark_phase and light.flashes else "● "
    shown = (lamp + state, _LIGHT_STYLES.get(light.colour, STRONG)) if state else ("no AS state", BAD)
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
    return [*lines, line("speed       ", (speed, STRONG), f"   rpm{wheels}" if wheels else "", wrap=True)]


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
