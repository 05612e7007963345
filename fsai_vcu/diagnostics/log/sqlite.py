"""Databases of SQLite with frames: python-can's, and bags of ROS 2 with can_msgs/Frame."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Final

from fsai_vcu.diagnostics.log.candump_line import MAX_SECONDS
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of
from fsai_vcu.diagnostics.log.problems import Problems, ReadingEnds
from fsai_vcu.diagnostics.log.rows import frame_of, told_error

MAGIC: Final = b"SQLite format 3\0"
_HEAD: Final = struct.Struct(">16xH10xI")  # bytes of a page (1: 65536), and pages
_BATCH: Final = 10_000
_STEPS: Final = 100_000_000  # of SQLite's machine for a batch: a query that goes round in circles is given up
_BAG: Final = (
    "SELECT messages.timestamp, messages.data, topics.name FROM messages LEFT JOIN topics"
    " ON messages.topic_id = topics.id WHERE topics.type = 'can_msgs/msg/Frame' OR topics.type IS NULL"
    " ORDER BY messages.rowid"
)
_QUERY: Final = "SELECT ts, arbitration_id, extended, remote, error, dlc, data FROM messages"


def read_sqlite(path: Path, told: Problems, name: str) -> Iterator[Frames]:
    """All frames in the order in which they were written. Raises ReadingEnds."""
    channels: list[str] = []
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            told_bytes, found_bytes = _announced_bytes(path), path.stat().st_size
            if found_bytes < told_bytes:  # SQLite takes what is missing for zeros
                words = (
                    f"the file ends after {found_bytes} of {told_bytes} bytes: frames are missing, others may be wrong"
                )
                told.add(f"{name}: {words}")
            if "messages" not in tables:
                raise ReadingEnds("an SQLite database without the messages of python-can or of a ROS 2 bag")
            bag = "topics" in tables
            database.set_progress_handler(lambda: 1, _STEPS)
            rows = database.execute(_BAG if bag else _QUERY)
            read = _bag_frame if bag else _frame
            before = 0
            while batch := rows.fetchmany(_BATCH):
                frames: list[LogFrame] = []
                for number, row in enumerate(batch, before + 1):
                    try:
                        frames.append(read(*row))
                    except (ValueError, TypeError, OverflowError, struct.error) as error:
                        words = str(error) if type(error) is ValueError else "not the fields of a frame"
                        told.add(f"{name}: row {number} is left out: {' '.join(words.split())[:200]}")
                before += len(batch)
                yield frames_of(frames, channels)
            if bag and not before:
                raise ReadingEnds("a bag of ROS 2 without a topic of can_msgs/Frame: record the bus itself")
    except (sqlite3.Error, OSError) as error:
        raise ReadingEnds(" ".join(str(error).split())[:200]) from None


def _announced_bytes(path: Path) -> int:
    """Return the length of a database by its head (sqlite.org/fileformat.html, 1.3)."""
    with path.open("rb") as file:
        page_bytes, pages = _HEAD.unpack(file.read(_HEAD.size))
    return int(65536 if page_bytes == 1 else page_bytes) * int(pages)


def _frame(
    time_s: object, can_id: int, extended: int, remote: int, error: int, dlc: int, data: bytes | None
) -> LogFrame:
    if not isinstance(time_s, float | int) or not 0 <= time_s <= MAX_SECONDS:
        raise ValueError(f"invalid time: {time_s}")
    t_ns = round(time_s * 1e6) * 1000
    if not isinstance(data, bytes | None):  # bytes(N) would be N zeros
        raise ValueError(f"no data bytes: {str(data)[:40]}")
    payload = data or b""
    if error:
        return told_error(t_ns, "can0", can_id, payload)
    return frame_of(
        t_ns, "can0", f"{can_id:X}", payload, int(dlc) if remote else len(payload),
        extended=bool(extended), remote=bool(remote), fd=len(payload) > 8,
    )  # fmt: skip


def _bag_frame(bag_ns: int, data: bytes, topic: object) -> LogFrame:
    """A can_msgs/Frame as CDR: header (stamp, frame_id), id, three flags, DLC, eight bytes of data."""
    if not isinstance(topic, str):
        raise ValueError("it is of no topic")
    order = "<" if data[1:2] == b"\x01" else ">"
    body = data[4:]
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", body)
    at = 12 + length + -length % 4
    can_id, remote, extended, error, dlc = struct.unpack_from(f"{order}IBBBB", body, at)
    payload = bytes(body[at + 8 : at + 16])
    t_ns = seconds * 1_000_000_000 + nanoseconds or bag_ns
    if error:
        return told_error(t_ns, topic, can_id, payload)
    return frame_of(
        t_ns, topic, f"{can_id & 0x1FFF_FFFF:X}", payload[: dlc if not remote else 0], dlc,
        extended=bool(extended), remote=bool(remote),
    )  # fmt: skip
