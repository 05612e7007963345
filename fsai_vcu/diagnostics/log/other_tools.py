"""Text logs of other tools: BusMaster, Kvaser's CANKing, CRTD of Open Vehicles."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Final

from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.rows import (
    BUS_ERROR,
    REQUESTS,
    Rows,
    bytes_of,
    error_frame,
    frame_of,
    ns_of,
    state_frame,
)
from fsai_vcu.interface.units import S

BUSMASTER: Final = re.compile(r"\*\*\*BUSMASTER", re.IGNORECASE)
KVASER: Final = re.compile(r"\s*Chn\s+Identifier\s+Flg\s+DLC", re.IGNORECASE)
CRTD: Final = re.compile(r"\d{1,11}\.\d{1,9} \d?[RTC](11|29|[A-Z]{2})\b")
"""Lines that tell these formats."""

_BUSMASTER_ROW = re.compile(
    r"(?P<time>-?[\d:.]+)\s+(?P<way>[RT]x)\s+(?P<bus>\d{1,3})\s+(?P<id>\S+)\s+(?P<kind>[sx]r?|err)(?:\s+(?P<length>\d{1,2})(?P<data>.*))?",
    re.IGNORECASE,
)
_BUSMASTER_DATE = re.compile(r"START DATE AND TIME (\d+):(\d+):(\d+) (\d+):(\d+):(\d+):(\d+)")
_KVASER_ROW = re.compile(
    r"(?P<bus>\d{1,3})\s+(?P<id>[0-9A-Fa-f]{1,8})\s+(?:(?P<flags>[A-Za-z]+)\s+)?(?P<length>\d{1,2})\s+"
    r"(?P<data>(?:[0-9A-Fa-f]{2}\s+)*?)(?P<time>\d+\.\d+)\s+(?P<way>[RT])"
)
_CRTD_ROW = re.compile(r"(?P<time>\d{1,11}\.\d{1,9}) (?P<bus>\d?)(?P<way>[RT])(?P<bits>11|29) (?P<id>\w+)(?P<data>.*)")
_CRTD_SIDE = re.compile(r"(?P<time>\d{1,11}\.\d{1,9}) (?P<bus>\d?)C(?P<kind>[A-Z]{2})\b(?P<text>.*)")
_CRTD_COUNT = re.compile(r"\b(rxerr|txerr|rxovr)=(\d{1,9})\b")
_HOUR_S: Final = 3600


class BusmasterRows(Rows):
    """Reads the rows of one file of BusMaster: times of day, or since the row before or the start, in 0.1 ms."""

    def __init__(self, told: Problems) -> None:
        super().__init__(told)
        self._begin_ns = self._day_ns = self._now_ns = 0
        self._mode, self._base = "system", 16
        self._session_open = False

    def is_whole(self, line: str) -> bool:
        return super().is_whole(line) or line.rstrip().endswith("***")

    def missing(self) -> str:
        return "its last logging session has no end" if self._session_open else ""

    def __call__(self, line: str) -> LogFrame | None:
        """Return the frame on a line of BusMaster; None for lines of its head."""
        text = line.strip()
        if text.startswith("***"):
            self._head(text.strip("*"))
            return None
        found = _BUSMASTER_ROW.fullmatch(text)
        if found is None:
            raise ValueError("not a row of BusMaster")
        t_ns = self._time_ns(found["time"])
        channel, kind = f"can{max(int(found['bus']), 1) - 1}", found["kind"].lower()
        if kind == "err":
            return error_frame(t_ns, channel, BUS_ERROR)
        remote = kind.endswith("r")
        words = (found["data"] or "").split()
        data = b"" if remote else bytes_of(words, self._base)
        id_text = found["id"] if self._base == 16 else found["id"].lstrip("0") or "0"
        return frame_of(
            t_ns, channel, id_text, data, int(found["length"] or 0), base=self._base, extended=kind[0] == "x",
            remote=remote, sent=found["way"].lower() == "tx",
        )  # fmt: skip

    def _head(self, text: str) -> None:
        """Take in a line of the head: session, date, manner of the times, base of the numbers."""
        if text.endswith("LOGGING SESSION]"):
            self._session_open = "START" in text
        elif date := _BUSMASTER_DATE.search(text):
            day, month, year, hour, minute, second, millis = map(int, date.groups())
            try:
                began = datetime(year, month, day, hour, minute, second)
                self._day_ns = int(datetime(year, month, day).timestamp()) * 1_000_000_000
                self._begin_ns = self._now_ns = int(began.timestamp()) * 1_000_000_000 + millis * 1_000_000
            except (ValueError, OverflowError):
                self.told.note(f"the date in the head cannot be read: '{text[:60]}'")
        elif text.endswith(" MODE"):
            self._mode = text.split()[0].lower()
        elif text in ("HEX", "DEC"):
            self._base = 16 if text == "HEX" else 10

    def _time_ns(self, text: str) -> int:
        try:
            hour, minute, second, tenths = (int(each) for each in re.split("[:.]", text))
        except ValueError:
            raise ValueError(f"invalid time: {text[:40]}") from None
        time_ns = (hour * _HOUR_S + minute * 60 + second) * 1_000_000_000 + tenths * 100_000
        if self._mode == "system":
            if self._day_ns + time_ns < self._now_ns - _HOUR_S * S * 12:  # it is past midnight
                self._day_ns += _HOUR_S * S * 24
            self._now_ns = self._day_ns + time_ns
            return self._now_ns
        if self._mode == "absolute":
            return self._begin_ns + time_ns
        self._now_ns += time_ns
        return self._now_ns


class KvaserRows(Rows):
    """Reads the rows of one file of CANKing: time and direction end a row."""

    def is_whole(self, line: str) -> bool:
        return False  # a row of which the direction is missing is none, and one cut in its time looks whole

    def __call__(self, line: str) -> LogFrame | None:
        """Return the frame on a line of CANKing; None for any other line."""
        text = line.strip()
        if KVASER.match(line) or not text:
            return None
        if re.search(r"error\s*frame", text, re.IGNORECASE) and (time := re.search(r"\d+\.\d+", text)):
            bus = text.split()[0]
            return error_frame(ns_of(time[0]), f"can{bus if bus.isdigit() and len(bus) < 4 else 0}", BUS_ERROR)
        found = _KVASER_ROW.fullmatch(text)
        if found is None:
            if re.match(r"(trigger|logging|begin|end)\b", text, re.IGNORECASE):
                self.told.note("a row of the logger's, which is not a frame")
                return None
            raise ValueError("not a row of Kvaser's CANKing")
        flags = (found["flags"] or "").upper()
        remote = "R" in flags
        length = int(found["length"])
        data = b"" if remote else bytes_of(found["data"].split())
        return frame_of(
            ns_of(found["time"]), f"can{int(found['bus'])}", found["id"], data, length,
            extended="X" in flags, remote=remote, fd=length > 8 or "F" in flags, sent=found["way"] == "T",
        )  # fmt: skip


class CrtdRows(Rows):
    """Reads the rows of one file of CRTD, which ends a row with its data and says no length."""

    def __init__(self, told: Problems) -> None:
        super().__init__(told)
        self._overruns: dict[str, int] = {}  # by bus: all up to now

    def is_whole(self, line: str) -> bool:
        return False

    def __call__(self, line: str) -> LogFrame | None:
        text = line.strip()
        found = _CRTD_ROW.fullmatch(text)
        if found is None:
            side = _CRTD_SIDE.fullmatch(text)
            if side is None:
                raise ValueError("not a row of CRTD")
            return self._beside(side)
        bus = _crtd_bus(found["bus"])
        data = bytes_of(found["data"].split())
        extended, sent = found["bits"] == "29", found["way"] == "T"
        return frame_of(ns_of(found["time"]), bus, found["id"], data, extended=extended, sent=sent)

    def _beside(self, row: re.Match[str]) -> LogFrame | None:
        """Return the error frame of an error; count the lost frames of a status; note any other row."""
        counts = {name: int(count) for name, count in _CRTD_COUNT.findall(row["text"])}
        bus = _crtd_bus(row["bus"])
        if "rxovr" in counts:
            self.told.lost += max(counts["rxovr"] - self._overruns.get(bus, 0), 0)
            self._overruns[bus] = counts["rxovr"]
        if row["kind"] != "ER":
            self.told.note("a comment, an event or a status, which is not a frame")
            return None
        if "TX_Queue" in row["text"]:
            self.told.note(REQUESTS)
            return None
        return state_frame(ns_of(row["time"]), bus, counts.get("txerr", 0), counts.get("rxerr", 0))


def _crtd_bus(text: str) -> str:
    return f"can{max(int(text or 1), 1) - 1}"
