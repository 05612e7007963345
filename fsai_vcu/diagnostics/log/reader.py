"""Every format of logs behind one call: frames as columns, with everything that could not be read.

The format is told by the content (formats.py). A line or an end that is not a frame becomes a `Problem` of the
log, with its place, and never an exception. Only a log that cannot be opened at all raises `LogError`.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from fsai_vcu.diagnostics.log.blocks import parse_block
from fsai_vcu.diagnostics.log.candump_line import LONGEST_LINE, MAX_NS, too_long
from fsai_vcu.diagnostics.log.formats import CANDUMP, Format, foreign_words, format_of
from fsai_vcu.diagnostics.log.frames import Frames, Ints, LogFrame, frames_of, joined
from fsai_vcu.diagnostics.log.problems import Problems, ReadingEnds
from fsai_vcu.diagnostics.log.rows import Rows
from fsai_vcu.diagnostics.log.stream import as_utf8, head_of, unpacked
from fsai_vcu.files import open_named
from fsai_vcu.interface.errors import UserError, did_you_mean
from fsai_vcu.runtime.bounded import BoundedError

STDIN: Final = "-"
_BLOCK_BYTES: Final = 1 << 21  # more than that does not stay in a processor's cache
_BATCH: Final = 10_000
_BESIDE: Final = 10_000  # files, among which one that is not there may be

# Times that are differences, each from the frame before, step back often, and never far on.
_FEW: Final = 20
_STEPS_BACK: Final = 0.02
_LONGEST_STEP_NS: Final = 86_400_000_000_000
_OF_KNOWN_TIMES: Final = ("ASC", "TRC", "BusMaster")  # their heads say it


class LogError(UserError):
    """A log that cannot be opened; the message is one clear line."""


class Log:
    """An open log. `chunks` and `frames` read it once, from here on; `problems` grows while they do."""

    def __init__(self, name: str, stream: IO[bytes], path: Path | None, broken: str | None = None) -> None:
        """path: of the file itself, where the stream is what is in it, not packed. broken: why it cannot be read."""
        self.name = name
        self.problems = Problems()
        self._stream = stream
        self._path = path
        self._pipe = path is None
        self._broken = broken  # why it cannot be read to its end
        self._cut = False  # in a line
        self._lines = 0
        self._head = head_of(stream)
        self._format = format_of(self._head)
        self.kind = (self._format or CANDUMP).name

    def chunks(self) -> Iterator[Frames]:
        """All frames as columns, some ten thousand at a time."""
        format_ = self._format or CANDUMP
        words = self._broken or ("" if self._format else foreign_words(self._head))
        if words:
            self.problems.add(f"{self.name}: {words}")
            return
        count = 0
        if format_.rows is not None:
            chunks = self._row_chunks(format_.rows(self.problems))
        else:
            chunks = self._binary_chunks(format_)
        for frames in chunks:
            count += len(frames)
            if len(frames):
                yield frames
        if self._format is None and not count and self.problems:
            self.problems.texts[0] += ": not a log format that can be read"

    def frames(self) -> Iterator[LogFrame]:
        """All frames one by one."""
        for frames in self.chunks():
            yield from frames

    # ------------------------------------------------------------ text

    def _row_chunks(self, rows: Rows) -> Iterator[Frames]:
        channels: list[str] = []
        added = _AddedUp(self.problems) if self.kind not in _OF_KNOWN_TIMES else None
        for block in self._blocks(rows):
            columns, unreadable, lines = parse_block(np.frombuffer(block, np.uint8), channels, rows)
            for problem in unreadable:
                self._unreadable(problem.line, problem.reason)
            self._lines += lines
            if len(columns):
                yield added(columns) if added else columns
        if (missing := rows.missing()) and not self._cut:
            self.problems.add(f"{self.name}: cut off: {missing}")

    def _blocks(self, rows: Rows) -> Iterator[bytes]:
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
            if rows.is_whole(carried.decode("utf-8", "replace")):
                yield carried + b"\n"
            else:
                self._cut = True
                self._unreadable(0, "cut off, without a line end; its frame is left out")
        if self._broken is not None:
            self.problems.add(f"{self.name}: cannot be read to its end: {self._broken}")

    def _unreadable(self, line: int, reason: str) -> None:
        """Add a problem; `line`: how many lines come between those that are done and this one."""
        self.problems.add(f"{self.name}: line {self._lines + line + 1}: {reason}")

    def _read_block(self) -> bytes:
        """Read as much as makes a block; from a pipe what there is, so that its reader need not wait."""
        parts: list[bytes] = []
        size = 0
        while size < _BLOCK_BYTES and not (self._pipe and parts) and self._broken is None:
            try:
                part = self._stream.read1(_BLOCK_BYTES - size)  # type: ignore[attr-defined]
            except OSError as error:
                self._broken = _why(error)
                break
            if not part:
                break
            parts.append(part)
            size += len(part)
        return b"".join(parts)

    # ------------------------------------------------------------ other formats

    def _binary_chunks(self, format_: Format) -> Iterator[Frames]:
        read = 0
        try:
            for columns in self._of_frames(format_) if format_.frames is not None else self._of_file(format_):
                read += len(columns)
                yield columns
        except (ReadingEnds, BoundedError, OSError) as error:
            after = f" after frame {read}" if read else ""
            self.problems.add(f"{self.name}: not readable as {self.kind}{after}: {_why(error)}")

    def _of_frames(self, format_: Format) -> Iterator[Frames]:
        """Read through a reader of single frames, or of some; those before its end are kept."""
        assert format_.frames is not None
        channels: list[str] = []
        batch: list[LogFrame] = []
        try:
            for frame in format_.frames(self._stream, self.problems, self.name):
                if isinstance(frame, Frames):
                    yield frames_of(batch, channels)
                    batch = []
                    yield frame
                    continue
                batch.append(frame)
                if len(batch) == _BATCH:
                    yield frames_of(batch, channels)
                    batch = []
        except (ReadingEnds, OSError):
            yield frames_of(batch, channels)
            raise
        yield frames_of(batch, channels)

    def _of_file(self, format_: Format) -> Iterator[Frames]:
        """Read through a reader that needs a file with a name."""
        assert format_.columns is not None
        if self._path is not None:
            yield from format_.columns(self._path, self.problems, self.name)
            return
        with tempfile.NamedTemporaryFile() as copy:
            shutil.copyfileobj(self._stream, copy, _BLOCK_BYTES)
            copy.flush()
            yield from format_.columns(Path(copy.name), self.problems, self.name)

    def close(self) -> None:
        self._stream.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_log(path: Path | str) -> Log:
    """Open the log at `path`; '-' is standard input. Raises LogError."""
    stream: Any = sys.stdin.buffer
    name, file = "standard input", None
    if str(path) != STDIN:
        name, file = str(path), Path(path)
        try:
            stream = open_named(file, pipes=True)
        except (OSError, ValueError) as error:  # a name with a NUL in it is a ValueError
            raise LogError(f"{path}: {_why(error)}{_meant(file, error)}") from error
    plain, broken = stream, None
    try:
        stream = as_utf8(unpacked(stream))
    except OSError as error:
        broken = _why(error)
    is_file = file is not None and file.is_file() and stream is plain
    return Log(name, stream, file if is_file else None, broken)


class _AddedUp:
    """Adds up times that are differences, each from the frame before, as candump -t d writes them.

    The first frames that are enough to tell decide: such times fall to less than half again and again; none is long.
    """

    def __init__(self, told: Problems) -> None:
        self._told = told
        self._are_differences: bool | None = None
        self._now_ns = 0

    def __call__(self, frames: Frames) -> Frames:
        if self._are_differences is None and len(frames) >= _FEW:
            back = int(np.count_nonzero(frames.t_ns[1:] < frames.t_ns[:-1] // 2))
            short = int(frames.t_ns.max()) < _LONGEST_STEP_NS
            self._are_differences = short and back > _STEPS_BACK * len(frames)
            if self._are_differences:
                self._told.note("its times are differences (candump -t d), and are added up")
        if not self._are_differences:
            return frames
        t_ns: Ints = self._now_ns + np.cumsum(frames.t_ns)
        self._now_ns = int(t_ns[-1])
        return frames.at(np.minimum(t_ns, MAX_NS))


def read_log(path: Path | str) -> tuple[Frames, Problems]:
    """All frames of a log and what could not be read of it. Raises LogError."""
    with open_log(path) as log:
        return joined(log.chunks()), log.problems


NO_LOGS: Final = frozenset({".json", ".png", ".svg", ".html"})
"""Endings of files that a recording or a drive leaves beside its log, and that nobody takes for a log."""


def _meant(path: Path, error: BaseException) -> str:
    """The files beside one that is not there which were perhaps meant."""
    if not isinstance(error, FileNotFoundError):
        return ""
    with suppress(OSError):
        beside = islice(path.parent.iterdir(), _BESIDE)
        names = (each.name for each in beside if each.suffix.lower() not in NO_LOGS)
        return did_you_mean(path.name, names, few=0)
    return ""


def _why(error: BaseException) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error or type(error).__name__).split())
