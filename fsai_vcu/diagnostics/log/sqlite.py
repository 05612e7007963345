"""python-can's SQLite database of frames."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Final

from fsai_vcu.diagnostics.log.candump_line import MAX_SECONDS
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of
from fsai_vcu.diagnostics.log.problems import Problems, ReadingEnds
from fsai_vcu.diagnostics.log.rows import frame_of

MAGIC: Final = b"SQLite format 3\0"
_BATCH: Final = 10_000
_STEPS: Final = 100_000_000  # of SQLite's machine for a batch: a query that goes round in circles is given up
_QUERY: Final = "SELECT ts, arbitration_id, extended, remote, error, dlc, data FROM messages"


def read_sqlite(path: Path, told: Problems, name: str) -> Iterator[Frames]:
    """All frames in the order in which they were written. Raises ReadingEnds."""
    channels: list[str] = []
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if "messages" not in tables or "topics" in tables:
                kind = (
                    "of a ROS 2 bag: convert it with ros2 bag convert, or record the bus" if "topics" in tables else ""
                )
                raise ReadingEnds(f"an SQLite database {kind or 'without the messages of python-can'}")
            database.set_progress_handler(lambda: 1, _STEPS)
            rows = database.execute(_QUERY)
            before = 0
            while batch := rows.fetchmany(_BATCH):
                frames: list[LogFrame] = []
                for number, row in enumerate(batch, before + 1):
                    try:
                        frames.append(_frame(*row))
                    except (ValueError, TypeError, OverflowError) as error:
                        told.add(f"{name}: row {number} is left out: {' '.join(str(error).split())[:200]}")
                before += len(batch)
                yield frames_of(frames, channels)
    except (sqlite3.Error, OSError) as error:
        raise ReadingEnds(" ".join(str(error).split())[:200]) from None


def _frame(
    time_s: float, can_id: int, extended: int, remote: int, error: int, dlc: int, data: bytes | None
) -> LogFrame:
    if not 0 <= time_s <= MAX_SECONDS:
        raise ValueError(f"no time: {time_s}")
    t_ns = round(time_s * 1e6) * 1000
    payload = bytes(data or b"")
    if error:
        return LogFrame(t_ns, "can0", can_id & 0x1FFF_FFFF, payload[:8], error=True)
    return frame_of(
        t_ns, "can0", f"{can_id:X}", payload, int(dlc) if remote else len(payload),
        extended=bool(extended), remote=bool(remote), fd=len(payload) > 8,
    )  # fmt: skip
