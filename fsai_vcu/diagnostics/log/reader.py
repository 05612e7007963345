"""Logs of a bus, whatever wrote them: candump (text, gzip), BLF, ASC, MF4, TRC, and SavvyCAN's CSV.

The format is known by the content, not by the name. Everything readable is read: what is not becomes a `Problem` of the
log, with its place, and never an exception. Only a log that cannot be opened at all raises `LogError`.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import logging
import shutil
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np

from fsai_vcu.diagnostics.log.candump import parse_block
from fsai_vcu.diagnostics.log.candump_line import LONGEST_LINE, MAX_SECONDS, read_lines, too_long, whole_line
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of, joined
from fsai_vcu.diagnostics.log.gvret import HEAD, GvretLines, whole_gvret
from fsai_vcu.files import TOO_MUCH_PACKED, UNPACKED_BYTES, UNPACKED_TIMES, open_named
from fsai_vcu.interface.errors import UserError

if TYPE_CHECKING:
    import can

STDIN: Final = "-"
_BLOCK_BYTES: Final = 1 << 21  # more than that does not stay in a processor's cache
_BATCH: Final = 10_000

_KEPT_PROBLEMS: Final = 1000  # kept as text; all are counted
_GZIP: Final = b"\x1f\x8b"
_FORMATS: Final = (  # by the first bytes; the second of TRC: version 1.0
    ("BLF", (b"LOGG",)),
    ("MF4", (b"MDF ",)),
    ("ASC", (b"date ", b"base hex", b"base dec", b"// version")),
    ("TRC", (b";$FILEVERSION=", b";##############")),
    ("GVRET", (HEAD.encode(),)),
)


_OF_LINES: Final = ("candump", "GVRET")


class Problems:
    """What could not be read in a log. `texts` are whole lines for people, each with its place; all are counted."""

    def __init__(self) -> None:
        self.count = 0
        self.texts: list[str] = []

    def add(self, text: str) -> None:
        self.count += 1
        if len(self.texts) < _KEPT_PROBLEMS:
            self.texts.append(text)

    def __bool__(self) -> bool:
        return self.count > 0

    def summary(self) -> str:
        """One line."""
        more = f" (and {self.count - 1} more like it or worse)" if self.count > 1 else ""
        return self.texts[0] + more if self.count else ""


def kind_of(head: bytes) -> str:
    """The format of a log, from its first bytes."""
    starts = (head, head.lower())
    return next((kind for kind, begins in _FORMATS if any(each.startswith(begins) for each in starts)), "candump")


class LogError(UserError):
    """A log that cannot be opened; the message is one clear line."""


class Log:
    """An open log. `chunks` and `frames` read it once, from here on; `problems` grows while they do."""

    def __init__(self, name: str, stream: IO[bytes], path: Path | None) -> None:
        self.name = name
        self.problems = Problems()
        self._stream = stream
        self._path = path
        self._pipe = path is None
        self._broken: str | None = None  # why it cannot be read to its end
        self._announced_bytes = 0
        self._lines = 0
        self.kind = kind_of(_head(stream))

    def chunks(self) -> Iterator[Frames]:
        """All frames as columns, some ten thousand at a time."""
        channels: list[str] = []
        if self.kind == "MF4":
            yield from self._mf4_chunks()
            return
        if self.kind not in _OF_LINES:
            messages = self._messages()
            while batch := list(islice(messages, _BATCH)):
                yield frames_of(batch, channels)
            return
        parse_gvret = GvretLines()
        for block in self._blocks():
            if self.kind == "GVRET":
                lines = block.count(b"\n")
                singly, unreadable = read_lines(enumerate(block.replace(b"\r\n", b"\n").split(b"\n")), parse_gvret)
                columns = frames_of(singly.values(), channels)
            else:
                columns, unreadable, lines = parse_block(np.frombuffer(block, np.uint8), channels)
            for problem in unreadable:
                self._unreadable(problem.line, problem.reason)
            self._lines += lines
            if len(columns):
                yield columns

    def frames(self) -> Iterator[LogFrame]:
        """All frames one by one."""
        for frames in self.chunks():
            yield from frames

    # ------------------------------------------------------------ text

    def _blocks(self) -> Iterator[bytes]:
        """Whole lines, many at a time. A last line without its end may be cut off: only a whole frame counts.

        Of a line longer than any frame's nothing is kept but its beginning: a file may be one line of zeros.
        """
        carried, endless = b"", b""
        while read := self._read_block():
            if endless:
                _, end, read = read.partition(b"\n")
                if not end:
                    continue
                self._unreadable(0, too_long(endless))
                self._lines += 1
            whole, end, carried = (carried + read).rpartition(b"\n")
            if end:
                yield whole + end
            endless, carried = (carried, b"") if len(carried) > LONGEST_LINE else (b"", carried)
        if endless:
            self._unreadable(0, too_long(endless))
        elif carried.strip() and self._broken is None:
            if whole_gvret(carried) if self.kind == "GVRET" else whole_line(carried):
                yield carried + b"\n"
            else:
                self._unreadable(0, "cut off, without a line end; its frame is left out")
        if self._broken is not None:
            self.problems.add(f"{self.name}: cannot be read to its end: {self._broken}")

    def _unreadable(self, line: int, reason: str) -> None:
        """`line`: how many come between those that are done and this one."""
        self.problems.add(f"{self.name}: line {self._lines + line + 1}: {reason}")

    def _read_block(self) -> bytes:
        """As much as makes a block; from a pipe what there is, so that its reader need not wait."""
        parts: list[bytes] = []
        size = 0
        while size < _BLOCK_BYTES and not (self._pipe and parts) and self._broken is None:
            try:
                part = self._stream.read1(_BLOCK_BYTES - size)  # type: ignore[attr-defined]
            except (OSError, EOFError, zlib.error) as error:
                self._broken = _why(error)
                break
            if not part:
                break
            parts.append(part)
            size += len(part)
        return b"".join(parts)

    # ------------------------------------------------------------ other formats, through python-can

    def _messages(self) -> Iterator[LogFrame]:
        read = 0
        try:
            for message in self._reader():
                frame = _frame_of(message)
                if frame is None:
                    self.problems.add(f"{self.name}: after frame {read}: a time that is none: {message.timestamp}")
                    continue
                read += 1
                yield frame
            if self._is_cut_off():
                self.problems.add(f"{self.name}: cut off after frame {read}")
        except Exception as error:  # the readers have no common base class for what a broken file makes them raise
            self.problems.add(f"{self.name}: not readable as {self.kind} after frame {read}: {_why(error)}")

    def _reader(self) -> Iterator[can.Message]:
        import fsai_vcu.lean_can  # noqa: F401  before any other part of python-can

        if self.kind == "BLF":
            from fsai_vcu.diagnostics.log.blf import BoundedBlfReader

            reader = BoundedBlfReader(self._stream)
            self._announced_bytes = reader.file_size
            return iter(reader)
        from can.io.asc import ASCReader
        from can.io.trc import TRCReader

        text: Any = _Lines(self._stream, lambda line: self.problems.add(f"{self.name}: a line is {too_long(line)}"))
        if self.kind == "TRC":  # rows that its reader skips, error frames among them, are named in its own log only
            skipped = logging.getLogger(TRCReader.__module__)
            skipped.setLevel(logging.INFO)
            skipped.filters = [self._row_skipped]
        return iter(TRCReader(text) if self.kind == "TRC" else ASCReader(text, relative_timestamp=False))

    def _row_skipped(self, record: logging.LogRecord) -> bool:
        if record.levelno >= logging.INFO:
            self.problems.add(f"{self.name}: a row is left out: {record.getMessage().removeprefix('TRCReader: ')}")
        return False

    def _mf4_chunks(self) -> Iterator[Frames]:
        """Through asammdf alone: python-can's reader works on each frame."""
        if find_spec("asammdf") is None:
            self.problems.add(f"{self.name}: MF4 needs asammdf: pip install 'fsai-vcu[mf4]'")
            return
        from fsai_vcu.diagnostics.log.mf4 import read_mf4
        from fsai_vcu.runtime.bounded import BoundedError

        with contextlib.ExitStack() as stack:
            try:
                path = self._path
                if path is None or not isinstance(self._stream, io.BufferedReader):
                    unpacked = stack.enter_context(tempfile.NamedTemporaryFile(suffix=".mf4"))
                    shutil.copyfileobj(self._stream, unpacked, _BLOCK_BYTES)
                    unpacked.flush()
                    path = Path(unpacked.name)
                yield from read_mf4(path, lambda problem: self.problems.add(f"{self.name}: {problem}"))
            except (BoundedError, OSError, EOFError, zlib.error) as error:
                self.problems.add(f"{self.name}: not readable as MF4: {_why(error)}")

    def _is_cut_off(self) -> bool:
        """python-can's readers end quietly where a file ends: this looks whether it should have ended there."""
        if self._path is None or not isinstance(self._stream, io.BufferedReader):
            return False  # of a packed log the unpacking tells
        with open_named(self._path) as file:
            length = file.seek(0, io.SEEK_END)
            if self.kind in ("ASC", "TRC"):
                file.seek(max(0, length - 1))
                return file.read(1) != b"\n"
        return length < self._announced_bytes

    def close(self) -> None:
        self._stream.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Unpacked(gzip.GzipFile):
    """What a file packed with gzip holds; OSError where that is more than a packed log can be."""

    def __init__(self, packed: IO[bytes]) -> None:
        self._packed = _Counted(packed)
        self._bytes = 0
        super().__init__(fileobj=self._packed, mode="rb")

    def read(self, size: int | None = -1) -> bytes:
        parts, left = [], sys.maxsize if size is None or size < 0 else size
        while left and (part := self._checked(super().read(min(left, _BLOCK_BYTES)))):
            parts.append(part)
            left -= len(part)
        return b"".join(parts)

    def read1(self, size: int = -1) -> bytes:
        return self._checked(super().read1(size))

    def readline(self, size: int | None = -1) -> bytes:
        return self._checked(super().readline(_BLOCK_BYTES if size is None or size < 0 else size))

    def _checked(self, data: bytes) -> bytes:
        self._bytes += len(data)
        if self._bytes > UNPACKED_BYTES and self._bytes > UNPACKED_TIMES * self._packed.bytes:
            raise OSError(TOO_MUCH_PACKED)
        return data


class _Counted:
    """A file of which is counted how much of it has been read."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.bytes = 0

    def read(self, size: int = -1) -> bytes:
        data = self._file.read(size)
        self.bytes += len(data)
        return data

    def seek(self, offset: int) -> int:
        raise OSError("it is read once")

    def close(self) -> None:
        self._file.close()


class _Lines(io.TextIOBase):
    """A text file whose lines are never longer than `LONGEST_LINE`; `left_out` is told the beginning of one that is."""

    def __init__(self, stream: IO[bytes], left_out: Callable[[bytes], None]) -> None:
        self._stream = stream
        self._left_out = left_out

    def readline(self, size: int = -1) -> str:  # type: ignore[override]
        while len(line := self._stream.readline(LONGEST_LINE + 1)) > LONGEST_LINE and not line.endswith(b"\n"):
            self._left_out(line)
            while (part := self._stream.readline(_BLOCK_BYTES)) and not part.endswith(b"\n"):
                pass
        return line.decode("utf-8", "replace").replace("\r\n", "\n")

    def close(self) -> None:
        self._stream.close()
        super().close()


def open_log(path: Path | str) -> Log:
    """Open the log at `path`; '-' is standard input. Raises LogError."""
    stream: Any = sys.stdin.buffer
    name, file = "standard input", None
    if str(path) != STDIN:
        name, file = str(path), Path(path)
        try:
            stream = open_named(file, pipes=True)
        except (OSError, ValueError) as error:  # a name with a NUL in it is a ValueError
            raise LogError(f"{path}: {_why(error)}") from error
    if _head(stream).startswith(_GZIP):
        stream = _Unpacked(stream)
    return Log(name, stream, file if file and file.is_file() else None)


def read_log(path: Path | str) -> tuple[Frames, Problems]:
    """All frames of a log and what could not be read of it. Raises LogError."""
    with open_log(path) as log:
        return joined(log.chunks()), log.problems


def _head(stream: IO[bytes]) -> bytes:
    """The first bytes, without taking them from the stream."""
    try:
        return stream.peek(16)[:16]  # type: ignore[attr-defined, no-any-return]
    except (OSError, EOFError, zlib.error):
        return b""  # what is wrong is reported when the frames are asked for


def _frame_of(message: can.Message) -> LogFrame | None:
    """python-can's message as one of ours; None if its time is none."""
    if not 0 <= message.timestamp <= MAX_SECONDS:
        return None
    channel = message.channel
    return LogFrame(
        t_ns=round(message.timestamp * 1e6) * 1000,  # its floats are exact to less than a microsecond, not better
        channel=f"can{channel}" if isinstance(channel, int) else str(channel or "can0"),
        can_id=message.arbitration_id,
        data=b"" if message.is_remote_frame else bytes(message.data),
        extended=message.is_extended_id and not message.is_error_frame,
        remote=message.is_remote_frame,
        error=message.is_error_frame,
        fd=message.is_fd,
        brs=message.bitrate_switch,
        esi=message.error_state_indicator,
        sent=not message.is_rx,
        length=message.dlc if message.is_remote_frame else len(message.data),
    )


def _why(error: BaseException) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error or type(error).__name__).split())
