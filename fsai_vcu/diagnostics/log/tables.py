"""Tables of frames, a head that names their columns: those of python-can, cabana, CANedge's and CL2000's converters."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable
from typing import Final, NamedTuple

from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.rows import Rows, frame_of, ns_of, told_error
from fsai_vcu.interface.units import MS, S

_Row = dict[str, str]


class _Table(NamedTuple):
    """head: its first columns. bus: its name from the row's. data: how the bytes are written."""

    name: str
    head: tuple[str, ...]
    time: str
    unit_ns: int
    id: str
    is_extended: Callable[[_Row], bool]
    data: Callable[[str], bytes]
    length: str = ""
    sent: Callable[[_Row], bool | None] = lambda row: {"0": False, "1": True}.get(row.get("dir", ""))


_FLAGS: Final = {"": False, "0": False, "false": False, "1": True, "true": True}


def _base64(text: str) -> bytes:
    return base64.b64decode(text, validate=True)


def _hex(text: str) -> bytes:
    return bytes.fromhex(text.removeprefix("0x"))


def _flag(name: str) -> Callable[[_Row], bool]:
    return lambda row: _FLAGS[row.get(name, "").lower()]


def _by_number(row: _Row) -> bool:
    """Return true where the number needs an extended identifier, for a table in which no column says it."""
    return int(row["addr"], 0) > 0x7FF


_TABLES: Final = (
    _Table("python-can CSV", ("timestamp", "arbitration_id", "extended"), "timestamp", S, "arbitration_id",
           _flag("extended"), _base64, "dlc"),
    _Table("cabana CSV", ("time", "addr", "bus"), "time", S, "addr", _by_number, _hex),
    _Table("CANedge CSV", ("timestampepoch", "buschannel", "id"), "timestampepoch", S, "id", _flag("ide"), _hex,
           "datalength"),
    _Table("CL2000", ("timestamp", "type", "id"), "timestamp", MS, "id",
           lambda row: bool(int(row["type"]) & 1), _hex, sent=lambda row: bool(int(row["type"]) & 8)),
)  # fmt: skip
HEAD: Final = re.compile("(?:# )?(?:" + "|".join(r"\W".join(table.head) for table in _TABLES) + r")\W", re.IGNORECASE)
"""A line that tells these formats."""


class TableRows(Rows):
    """Reads the rows of one file, the head first."""

    def __init__(self, told: Problems) -> None:
        super().__init__(told)
        self._table: _Table | None = None
        self._columns: list[str] = []
        self._separator = ","

    def is_whole(self, line: str) -> bool:
        return self._table is not None and self._table.length != ""  # which is checked when it is read

    def __call__(self, line: str) -> LogFrame | None:
        """Return the frame on a line; None for the head and for comments."""
        text = line.strip()
        if text.startswith("#"):
            if text.lower().startswith("# time format:") and text.partition(":")[2].strip() != "0":
                raise ValueError("a manner of times that is not read: convert the log with time format 0")
            return None
        if HEAD.match(text):
            found = re.search(r"\W", text)
            self._separator = found[0] if found else ","
            self._columns = [word.strip().lower() for word in text.split(self._separator)]
            self._table = next((table for table in _TABLES if tuple(self._columns[:3]) == table.head), None)
            if self._table is None:
                raise ValueError("not a head of this table")
            return None
        table = self._table
        words = [word.strip() for word in text.split(self._separator)]
        if table is None or len(words) != len(self._columns):
            raise ValueError("not a row of this table")
        row = dict(zip(self._columns, words, strict=True))
        try:
            data = table.data(row["data"] if "data" in row else row["databytes"])
            extended, sent = table.is_extended(row), table.sent(row)
            error, remote = _flag("error")(row), _flag("remote" if "remote" in row else "rtr")(row)
            length = int(row[table.length]) if table.length else len(data)
        except (KeyError, ValueError, binascii.Error):
            raise ValueError("not a row of this table") from None
        t_ns = ns_of(row[table.time], table.unit_ns)
        if error:
            return told_error(t_ns, "can0", int(row[table.id], 16), data)
        fd = row.get("edl", "0") == "1" or length > 8
        bus = row.get("bus", row.get("buschannel", "0"))
        if not bus.isdigit() or len(bus) > 5:
            raise ValueError(f"invalid bus: {bus[:40]}")
        return frame_of(
            t_ns, f"can{int(bus)}", row[table.id], data, length, extended=extended, remote=remote, fd=fd,
            brs=row.get("brs", "0") == "1", esi=row.get("esi", "0") == "1", sent=sent,
        )  # fmt: skip
