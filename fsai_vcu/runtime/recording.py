"""Recording of a bus as a candump log, the format that every CAN tool reads."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import TextIO

from fsai_vcu.interface.frames import Frame

_EXTENDED, _ERROR = 0x8000_0000, 0x2000_0000


def candump_line(frame: Frame, interface: str, time_ns: int) -> str:
    """One line of a `candump -L` log, without its line end."""
    if frame.error:
        name = f"{frame.can_id | _ERROR:08X}"
    elif frame.extended:
        name = f"{frame.can_id:08X}"
    else:
        name = f"{frame.can_id:03X}"
    payload = "R" if frame.remote else frame.data.hex().upper()
    return f"({time_ns // 1_000_000_000}.{time_ns // 1000 % 1_000_000:06d}) {interface} {name}#{payload}"


class CandumpWriter:
    """Writes frames to `path`, one line each; line-buffered only at close or every `flush_every` frames."""

    def __init__(self, path: Path | str, interface: str, *, offset_ns: int = 0, flush_every: int = 500) -> None:
        """`offset_ns` is added to each frame's time: wall clock minus monotonic, so that logs of tools agree."""
        pack = str(path).endswith(".gz")
        self._file: TextIO = (gzip.open if pack else open)(path, "wt", encoding="ascii")
        self._interface = interface
        self._offset_ns = offset_ns
        self._flush_every = flush_every
        self.frames = 0

    def write(self, frame: Frame, stamp_ns: int | None = None) -> None:
        """Write one line; `stamp_ns` is the bus's own wall-clock stamp, where it has one."""
        time_ns = frame.t_ns + self._offset_ns if stamp_ns is None else stamp_ns
        self._file.write(candump_line(frame, self._interface, time_ns) + "\n")
        self.frames += 1
        if self.frames % self._flush_every == 0:
            self._file.flush()

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> CandumpWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
