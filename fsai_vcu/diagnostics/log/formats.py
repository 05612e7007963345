"""The formats of logs: how each is recognised by its content, what reads it, and what it may lose.

A new format is one row here, with its reader beside, and one in docs/logs.md.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import IO, Final

from fsai_vcu.diagnostics.log import asc, candump_rows, gvret, other_tools, tables, trc
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.rows import Rows

_LINES: Final = 60  # of the beginning, which may be comments


@dataclass(frozen=True, slots=True)
class Format:
    """One format, told by its first bytes or by a line near its beginning, with one of three kinds of readers.

    rows: of a text, line by line. frames: of a stream of bytes. columns: of a
    file with a name. All but rows raise ReadingEnds, OSError or BoundedError where that comes before the end.
    """

    name: str
    begins: tuple[bytes, ...] = ()
    line: re.Pattern[str] | None = None
    rows: Callable[[Problems], Rows] | None = None
    frames: Callable[[IO[bytes], Problems, str], Iterator[LogFrame | Frames]] | None = None
    columns: Callable[[Path, Problems, str], Iterator[Frames]] | None = None


def _blf(stream: IO[bytes], told: Problems, name: str) -> Iterator[LogFrame | Frames]:
    from fsai_vcu.diagnostics.log.blf import BlfFile

    return BlfFile(stream, told, name).frames()


def _capture(stream: IO[bytes], told: Problems, name: str) -> Iterator[LogFrame | Frames]:
    from fsai_vcu.diagnostics.log.captures import read_capture

    return read_capture(stream, told, name)


def _mf4(path: Path, told: Problems, name: str) -> Iterator[Frames]:
    if find_spec("asammdf") is None:
        told.add(f"{name}: MF4 needs asammdf: pip install 'fsai-vcu[mf4]'")
        return iter(())
    from fsai_vcu.diagnostics.log.mf4 import read_mf4

    return read_mf4(path, lambda problem: told.add(f"{name}: {problem}"))


def _sqlite(path: Path, told: Problems, name: str) -> Iterator[Frames]:
    from fsai_vcu.diagnostics.log.sqlite import read_sqlite

    return read_sqlite(path, told, name)


CANDUMP: Final = Format("candump", line=candump_rows.HEAD, rows=candump_rows.CandumpRows)
FORMATS: Final = (
    Format("BLF", (b"LOGG",), frames=_blf),
    Format("MF4", (b"MDF     4", b"UnFinMF 4"), columns=_mf4),
    Format(
        "pcap", (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d"), frames=_capture
    ),
    Format("pcapng", (b"\x0a\x0d\x0d\x0a",), frames=_capture),
    Format("SQLite", (b"SQLite format 3\0",), columns=_sqlite),
    Format("ASC", line=asc.HEAD, rows=asc.AscRows),
    Format("TRC", line=trc.HEAD, rows=trc.TrcRows),
    Format("GVRET", line=gvret.HEAD, rows=gvret.GvretRows),
    Format("CSV", line=tables.HEAD, rows=tables.TableRows),
    Format("BusMaster", line=other_tools.BUSMASTER, rows=other_tools.BusmasterRows),
    Format("Kvaser", line=other_tools.KVASER, rows=other_tools.KvaserRows),
    Format("CRTD", line=other_tools.CRTD, rows=other_tools.CrtdRows),
    CANDUMP,
)

# Files of other kinds: a person is told what it is, and the way.
_FOREIGN: Final = (
    (b"MDF ", "an MDF older than version 4: convert it to MF4 (asammdf does)"),
    (b"UnFinMF ", "an MDF older than version 4: convert it to MF4 (asammdf does)"),
    (
        b"\x89MCAP0",
        "an MCAP: convert a ROS 2 bag to sqlite3 (ros2 bag convert); for an export, use the log it came from",
    ),
    (b"#ROSBAG", "a bag of ROS 1: record the bus itself (fsai-vcu record)"),
    (b"PAR1", "a Parquet table: take the log that it was made from"),
    (b"\x89HDF", "an HDF5 or MATLAB file: export the log as MF4, BLF or ASC"),
    (b"MATLAB", "a MATLAB file: export the log as MF4, BLF or ASC"),
    (b"\x1f\x8b", "packed twice: unpack it once more"),
    (b"\xfd7zXZ\0", "packed twice: unpack it once more"),
    (b"BZh", "packed twice: unpack it once more"),
    (b"\x28\xb5\x2f\xfd", "packed twice: unpack it once more"),
    (b"\x04\x22\x4d\x18", "packed with lz4: unpack it first (lz4 -d)"),
    (b"\x1f\x9d", "packed with compress: unpack it first (uncompress)"),
    (b"\x5d\0\0", "packed with lzma: unpack it first (unlzma)"),
    (b"\xff\xfe\0\0", "text in UTF-32: save it as UTF-8"),
    (b"\0\0\xfe\xff", "text in UTF-32: save it as UTF-8"),
    (b"7z\xbc\xaf", "a 7z archive: unpack it first"),
    (b"Rar!", "a RAR archive: unpack it first"),
    (b"PK", "a zip archive: unpack it first"),
    (b"%PDF", "a PDF"),
    (b"<?xml", "an XML file"),
    (b"<!DOCTYPE", "a page of HTML"),
)
_TAR_AT: Final = 257


def format_of(head: bytes) -> Format | None:
    """The format of a log, from its first bytes; None where it is none that is read."""
    for each in FORMATS:
        if head.startswith(each.begins) and each.begins:
            return each
    if foreign_words(head):
        return None
    lines = [line.strip("\r") for line in islice(head.decode("utf-8", "replace").split("\n"), _LINES)]
    for line in lines:
        for each in FORMATS:
            if each.line is not None and each.line.match(line if each is CANDUMP else line.lstrip()):
                return each
    return None


def foreign_words(head: bytes) -> str:
    """Kind of a file that is no readable log, and the way to convert it: the end of a sentence; '' if not known."""
    if head[_TAR_AT : _TAR_AT + 5] == b"ustar":
        return "a tar archive: unpack it first (tar -xf)"
    return next((words for begin, words in _FOREIGN if head.startswith(begin)), "")
