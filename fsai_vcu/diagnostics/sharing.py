"""A long log decoded by several processes, its lines written in the order of the log.

The log is cut into pieces of whole lines, dealt out in turn. Each process writes its own pieces itself, when the turn
comes round to it: nothing but the turn and, at the end, the problems pass between them.
"""

from __future__ import annotations

import errno
import os
import pickle
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.candump import parse_block
from fsai_vcu.diagnostics.frames import Frames
from fsai_vcu.diagnostics.logs import Problems, kind_of, last_line

PIECE_BYTES: Final = 1 << 21  # some sixty thousand frames
_WORTH_IT: Final = 2 * PIECE_BYTES

Pieces = Sequence[tuple[int, int]]


@dataclass
class _Found:
    """What a process found in its pieces: frames, and for each piece its lines and what was wrong in them."""

    frames: int = 0
    pieces: dict[int, tuple[int, list[tuple[int, str]]]] = field(default_factory=dict)


class _TurnLost(Exception):
    """Another process has ended before its last turn."""


def processes_for(name: str) -> int:
    """How many processes are worth their start for this log; 1 for what cannot be cut into pieces."""
    path = Path(name)
    try:
        if not path.is_file() or path.stat().st_size < _WORTH_IT:
            return 1
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return 1
    return len(os.sched_getaffinity(0)) if kind_of(head) == "candump" else 1


def write_lines(
    path: Path, lines_of: Callable[[Frames], bytes], out: int, processes: int, piece_bytes: int = PIECE_BYTES
) -> tuple[int, Problems]:
    """Write the lines of all frames of the candump log at `path` to the file descriptor `out`.

    Returns (frames, what could not be read). Raises OSError where reading or writing fails.
    """
    size = path.stat().st_size
    pieces = [(begin, min(begin + piece_bytes, size)) for begin in range(0, size, piece_bytes)]
    processes = max(1, min(processes, len(pieces)))
    turns = [os.pipe() for _ in range(processes)]
    sys.stdout.flush()
    children: list[tuple[int, int]] = []  # (process, where its findings come from)
    for number in range(1, processes):
        theirs, ours = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(theirs)
            _child(_Turn(number, turns), path, pieces, lines_of, out, ours)
        os.close(ours)
        children.append((child, theirs))
    turn = _Turn(0, turns)
    found: list[_Found] = []
    try:
        turn.begin()
        found.append(_work(turn, path, pieces, lines_of, out))
        for _, theirs in children:
            with os.fdopen(theirs, "rb", closefd=False) as answer:
                found.append(pickle.loads(answer.read() or pickle.dumps(_Found())))
    except _TurnLost:
        found = []  # how the other one ended tells why
    finally:
        turn.close()
        for _, theirs in children:
            os.close(theirs)
        statuses = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child, _ in children]
    failed = next((status for status in statuses if status), 0 if found else errno.EIO)
    if failed:
        failed = failed if failed > 0 else errno.EIO
        raise OSError(failed, os.strerror(failed))
    return _together(path, found, len(pieces))


class _Turn:
    """The turn to write, passed from process to process in a ring."""

    def __init__(self, number: int, ring: Sequence[tuple[int, int]]) -> None:
        """Keeps two of the ring's ends and closes all others: if a neighbour ends, this process notices."""
        self.number, self.count = number, len(ring)
        following = (number + 1) % len(ring)
        self._reading, self._writing = ring[number][0], ring[following][1]
        self._to_oneself = ring[number][1] if number == 0 else None
        for other, (reading, writing) in enumerate(ring):
            if other != number:
                os.close(reading)
            if writing not in (self._writing, self._to_oneself):
                os.close(writing)

    def begin(self) -> None:
        """The first turn is that of process 0."""
        assert self._to_oneself is not None
        os.write(self._to_oneself, b"x")
        if self._to_oneself != self._writing:
            os.close(self._to_oneself)
        self._to_oneself = None

    def await_it(self) -> None:
        if not os.read(self._reading, 1):
            raise _TurnLost

    def pass_on(self) -> None:
        try:
            os.write(self._writing, b"x")
        except BrokenPipeError:
            raise _TurnLost from None

    def close(self) -> None:
        os.close(self._reading)
        os.close(self._writing)


def _child(turn: _Turn, path: Path, pieces: Pieces, lines_of: Callable[[Frames], bytes], out: int, answer: int) -> None:
    """Never returns: its exit status is the number of the error that ended it."""
    status = errno.EIO
    try:
        found = _work(turn, path, pieces, lines_of, out)
        with os.fdopen(answer, "wb") as file:
            file.write(pickle.dumps(found))
        status = 0
    except OSError as error:
        status = error.errno or status
    except _TurnLost:
        status = 0  # the other one tells
    except KeyboardInterrupt:
        pass  # the other one has heard it too
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def _work(turn: _Turn, path: Path, pieces: Pieces, lines_of: Callable[[Frames], bytes], out: int) -> _Found:
    """Decode and write every piece whose turn is that of this process."""
    found = _Found()
    channels: list[str] = []
    for index in range(turn.number, len(pieces), turn.count):
        block, reason = _piece(path, *pieces[index])
        frames, unreadable, lines = parse_block(np.frombuffer(block, np.uint8), channels)
        problems = [(line, words) for line, words in unreadable]
        if reason is not None:
            problems.append((lines, reason))
        found.frames += len(frames)
        found.pieces[index] = lines, problems
        text = memoryview(lines_of(frames))
        turn.await_it()
        while text:
            text = text[os.write(out, text) :]
        if index + 1 < len(pieces):
            turn.pass_on()
    return found


def _piece(path: Path, begin: int, end: int) -> tuple[bytes, str | None]:
    """The whole lines that begin in this part of the file, and what is wrong with its very last one."""
    with path.open("rb") as file:
        file.seek(max(0, begin - 1))
        if begin:
            file.readline()  # it began in the piece before
        first = file.tell()
        block = file.read(max(0, end - first))
        if block and not block.endswith(b"\n"):
            block += file.readline()
        if not block or block.endswith(b"\n"):
            return block, None
        whole, _, rest = block.rpartition(b"\n")
        last, reason = last_line(rest)
        return (whole + b"\n" if whole else b"") + last, reason


def _together(path: Path, found: Sequence[_Found], count: int) -> tuple[int, Problems]:
    """Findings of all processes, their lines numbered from the beginning of the log."""
    problems = Problems()
    pieces = {index: piece for each in found for index, piece in each.pieces.items()}
    before = 0
    for index in range(count):
        lines, several = pieces[index]
        for line, words in several:
            problems.add(f"{path}: line {before + line + 1}: {words}")
        before += lines
    return sum(each.frames for each in found), problems
