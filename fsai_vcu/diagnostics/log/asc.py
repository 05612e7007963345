"""Vector's text format ASC: a head with the date and the manner of the rows, then a row for each event."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import datetime
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.log.candump_line import MAX_NS
from fsai_vcu.diagnostics.log.frames import Ints, LogFrame
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.rows import (
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    OVERLOAD,
    PASSIVE,
    PROTOCOL,
    REQUESTS,
    WARNING,
    WAYS,
    Pattern,
    Rows,
    bytes_of,
    counted_errors,
    error_frame,
    frame_of,
    ns_of,
)

HEAD: Final = re.compile(
    r"date\s+\S|base\s+(hex|dec)\b|// version\s+\d|begin triggerblock|"
    r"-?\d+[.,]\d+\s+\d+\s+[0-9a-f]+x?\s+(rx|tx)\s+[dr]\b",
    re.IGNORECASE,
)
"""A line that tells this format."""

_ROW = re.compile(r"(-?\d+(?:[.,]\d+)?)\s+(\S.*)")
_PLAIN = re.compile(
    rb" *(?P<time>\d{1,10})\.(?P<decimals>\d{1,9}) +(?P<channel>\d{1,3}) +(?P<id>[0-9A-Fa-f]{1,8})(?P<wide>[xX]?) +"
    rb"(?P<way>[RT])x +d (?P<length>[0-8])"
)
_TAIL: Final = b"  Length = "  # what Vector's tools write behind the data
_BYTE = {16: re.compile(r"[0-9A-Fa-f]{2}"), 10: re.compile(r"\d{1,3}")}  # by the base of the numbers
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})(?:[.,:](\d{1,6}))?\s*([ap])?\.?m?\.?\b", re.IGNORECASE)
# By the first letters in English, German, French, Italian, Spanish, Portuguese; ? is a letter that was garbled.
_MONTHS: Final = (
    "jan jän gen ene", "feb fév fev f?v", "mar mär mrz m?r", "apr avr abr", "may mai mag maj",
    "jun juin giu", "jul juil lug", "aug aoû ago ao?", "sep set", "oct okt ott out", "nov", "dec dez dic déc d?c",
)  # fmt: skip
_NO_FRAMES: Final = re.compile(
    r"log trigger event|log direct|j1939|(li|lin|fr|eth|l\d+|tfs|afdx|most|gps|sv|wlan|tp|sys|msgtext)\b|"
    r"\S+\s*:=|//|;|\d+\s+(statistic|j1939|bus|//)",
    re.IGNORECASE,
)
_STATISTICS: Final = re.compile(r"statistic: .*\be (\d{1,10}) o (\d{1,10})\b")  # error frames, overload frames
_STATES: Final = (
    ("busoff", BUS_OFF, 0),
    ("bus off", BUS_OFF, 0),
    ("passive", CONTROLLER, PASSIVE),
    ("warn", CONTROLLER, WARNING),
)


class AscRows(Rows):
    """Reads the rows of one file: times from its date on, or from the row before where the head says so."""

    def __init__(self, told: Problems) -> None:
        super().__init__(told)
        self._start_ns = self._at_ns = 0  # of the date in the head; of the row
        self._now_ns = self._begun_ns = self._passed_ns = 0  # where times are differences: see times
        self._base = 16
        self._relative = self._block_open = False

    def pattern(self) -> Pattern | None:
        if self._base != 16:
            return None
        return Pattern(
            _PLAIN,
            lambda found: _channel(found["channel"].decode()),
            lambda found: bool(found["wide"]),
            begin_ns=0 if self._relative else self._start_ns,
            tail=_TAIL,
        )

    def state(self) -> object:
        return self._relative, self._base, self._start_ns, self._begun_ns, self._passed_ns

    def times(self) -> Callable[[Ints], Ints] | None:
        return self._added_up if self._relative else None

    def _added_up(self, t_ns: Ints) -> Ints:
        """Add up the times of frames whose rows say differences; a date, or a row that takes time, may follow."""
        if self._now_ns + float(t_ns.sum(dtype=np.float64)) > MAX_NS:
            t_ns = np.minimum(np.cumsum(t_ns, dtype=np.float64), float(MAX_NS - self._now_ns)).astype(np.int64)
        else:
            t_ns = np.cumsum(t_ns)
        t_ns = t_ns + self._now_ns
        last_ns = int(t_ns[-1]) if len(t_ns) else self._now_ns
        self._now_ns = min(max(last_ns + self._passed_ns, self._begun_ns, 0), MAX_NS)
        self._passed_ns = self._begun_ns = 0
        return t_ns

    def is_whole(self, line: str) -> bool:
        return super().is_whole(line) or line.strip().lower() == "end triggerblock"

    def missing(self) -> str:
        return "its last trigger block has no end" if self._block_open else ""

    def __call__(self, line: str) -> LogFrame | None:
        """Return the frame on a line; take in lines of the head, and skip those that are no frames."""
        text = line.strip()
        lower = text.lower()
        if lower.startswith(("date ", "begin triggerblock")):
            self._block_open = lower.startswith("begin")
            self._begin(text[len("begin triggerblock") :] if self._block_open else text.partition(" ")[2])
        elif lower.startswith("base "):
            self._base = 10 if lower.split()[1].startswith("dec") else 16
            self._relative = "relative" in lower
        elif row := _ROW.match(text):
            self._at_ns = ns_of(row[1]) + (0 if self._relative else self._start_ns)
            frame = None
            try:
                frame = self._event(row[2])
            finally:
                self._passed_ns += self._at_ns if self._relative and frame is None else 0
            return frame
        elif lower.startswith("end triggerblock"):
            self._block_open = False
        elif line.startswith((";", "//")) or lower.startswith(("no internal events", "internal events")):
            return None
        elif text:
            raise ValueError("not a row of ASC")
        return None

    def _begin(self, date: str) -> None:
        if not date.strip():
            return
        begin_ns = date_ns(date)
        if begin_ns is None or begin_ns > MAX_NS:
            self.told.note(f"the date in the head cannot be read, and times count from 0: '{date.strip()[:60]}'")
        elif self._relative:
            self._begun_ns = begin_ns
        else:
            self._start_ns = self._now_ns = begin_ns

    def _event(self, text: str) -> LogFrame | None:
        """Return the frame of a row: CAN FD, classic, error or state of a controller."""
        words = text.split()
        lower = text.lower()
        if words[0] == "CANFD" and len(words) > 3:
            channel = _channel(words[1])
            return self._error(channel) if words[3] == "ErrorFrame" else self._fd(channel, words)
        if words[0] == "CAN" and len(words) > 2 and "status" in lower:
            return self._state(_channel(words[1]), lower)
        if words[0].isdigit() and len(words) > 1:
            channel = _channel(words[0])
            if words[1].lower().startswith("errorframe"):
                return self._error(channel)
            if words[1].lower().startswith("overloadframe"):
                return error_frame(self._at_ns, channel, PROTOCOL, protocol=OVERLOAD)
            if "status:" in lower:
                return self._state(channel, lower)
            if (counted := _STATISTICS.search(lower)) and (int(counted[1]) or int(counted[2])):
                return counted_errors(self._at_ns, channel, int(counted[1]))
            if len(words) > 3 and words[2].lower() in ("rx", "tx", "txrq", "txerr"):
                return self._classic(channel, words)
        if lower.startswith("start of measurement"):
            return None
        if _NO_FRAMES.match(text):
            self.told.note(f"a row of {' '.join(words[:2]) if words[0].isdigit() else words[0]}, which is not a frame")
            return None
        raise ValueError("not a row of ASC")

    def _classic(self, channel: str, words: list[str]) -> LogFrame | None:
        """Return the classic frame of a row, split into words."""
        way, kind = words[2].lower(), words[3].lower()
        id_text, extended = _identifier(words[1])
        remote = kind == "r"
        if kind not in ("d", "r"):
            raise ValueError("not a row of ASC")
        try:
            dlc = int(words[4], 16) if len(words) > 4 else 0
        except ValueError:
            if not remote:
                raise ValueError(f"invalid length: {words[4][:40]}") from None
            dlc = 0
        length = min(dlc, 8) if dlc < 16 else dlc
        if not WAYS.keys().isdisjoint(word.lower() for word in words[5:]):
            raise ValueError("two rows in one line")
        data = b"" if remote else bytes_of(words[5 : 5 + length], self._base)
        if not remote and len(words) > 5 + length and _BYTE[self._base].fullmatch(words[5 + length]):
            raise ValueError(f"more data bytes than the {length} that are announced")
        frame = frame_of(
            self._at_ns, channel, id_text, data, length,
            base=self._base, extended=extended, remote=remote, sent=WAYS.get(way),
        )  # fmt: skip
        return self._on_the_bus(frame, way)

    def _fd(self, channel: str, words: list[str]) -> LogFrame | None:
        """CANFD channel way id [name] BRS ESI DLC length data… duration bits flags …"""
        way = words[2].lower()
        at = 4 if len(words) > 4 and words[4] in ("0", "1") else 5
        try:
            brs, esi, length = words[at] == "1", words[at + 1] == "1", int(words[at + 3])
        except (IndexError, ValueError):
            raise ValueError("not a row of ASC") from None
        data = bytes_of(words[at + 4 : at + 4 + length], self._base)
        behind = words[at + 4 + length :]
        try:
            flags = int(behind[2], 16)
        except (IndexError, ValueError):
            flags = 0x1000
        remote = bool(flags & 0x10)
        id_text, extended = _identifier(words[3])
        frame = frame_of(
            self._at_ns, channel, id_text, data, length if not remote else min(int(words[at + 2], 16), 8),
            base=self._base, extended=extended, remote=remote, fd=bool(flags & 0x1000), brs=brs, esi=esi,
            sent=WAYS.get(way),
        )  # fmt: skip
        return self._on_the_bus(frame, way)

    def _on_the_bus(self, frame: LogFrame, way: str) -> LogFrame | None:
        """The frame, unless it was only to be sent; a frame that nobody took is an error of the bus."""
        if way == "txrq":
            self.told.note(REQUESTS)
            return None
        return self._error(frame.channel) if way == "txerr" else frame

    def _error(self, channel: str) -> LogFrame:
        return error_frame(self._at_ns, channel, BUS_ERROR)

    def _state(self, channel: str, lower: str) -> LogFrame | None:
        for word, kinds, controller in _STATES:
            if word in lower:
                return error_frame(self._at_ns, channel, kinds, controller=controller)
        self.told.note("a row of a controller's status that is no error")
        return None


def _channel(text: str) -> str:
    if not text.isdigit() or len(text) > 5:
        raise ValueError(f"invalid channel: {text[:40]}")
    return f"can{max(int(text), 1) - 1}"


def _identifier(text: str) -> tuple[str, bool]:
    extended = text[-1:] in ("x", "X")
    return (text[:-1] if extended else text), extended


def date_ns(text: str) -> int | None:
    """Local date and time of a head: month by name or number, time in 12 or 24 hours. None if it cannot be read."""
    clock = _CLOCK.search(text)
    if clock is None:
        return None
    rest = text[: clock.start()] + " " + text[clock.end() :]
    numbers = re.findall(r"(?<![\w?])\d+", rest)
    years = [int(each) for each in numbers if len(each) == 4]
    days = [int(each) for each in numbers if len(each) <= 2]
    names = re.findall(r"[^\W\d_][\w�]*|[^\W\d_]*�[\w�]*", rest)
    month = next((n for name in names for n, known in enumerate(_MONTHS, 1) if _called(name, known)), None)
    if month is None and len(days) > 1:  # 23.11.2024, and what Vector's tools write in other languages: 11 23
        month, days = (days[1], days[:1]) if "." in rest or days[0] > 12 else (days[0], days[1:])
    if month is None or not years or not days:
        return None
    hour, half = int(clock[1]), (clock[5] or "").lower()
    if half == "p" and hour < 12:
        hour += 12
    elif half == "a" and hour == 12:
        hour = 0
    micros = int((clock[4] or "0").ljust(6, "0"))
    try:
        seconds = datetime(years[-1], month, days[0], hour, int(clock[2]), int(clock[3])).timestamp()
    except (ValueError, OverflowError):
        return None
    return max(0, int(seconds)) * 1_000_000_000 + micros * 1000


def _called(name: str, known: str) -> bool:
    spelt = name.lower().replace("�", "?")
    return any(spelt.startswith(each) for each in known.split())
