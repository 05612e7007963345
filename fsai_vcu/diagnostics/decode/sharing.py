"""A long log decoded by several processes, its lines written in the order of the log.

The log is cut into pieces of whole lines, dealt out in turn. Each process writes its own pieces itself, when the turn
comes round to it: nothing but the turn and, at the end, the problems pass between them.
"""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from fsai_vcu.diagnostics.decode.printing import Printed
from fsai_vcu.diagnostics.log.files import Problems, kind_of, last_line

PIECE_BYTES: Final = 1 << 18  # some seven thousand frames: their text still fits a processor's cache
LARGE_PIECE_BYTES: Final = 1 << 21  # what is done for many frames at once is worth its while from here on
_WORTH_IT: Final = 4 * PIECE_BYTES

Pieces = Sequence[tuple[int, int]]
Print = Callable[[bytes], Printed]
Write = Callable[[bytes], object]


class _Found:
    """What a process found in its pieces: frames, and for each piece its lines and what was wrong in them."""

    def __init__(self) -> None:
        self.frames = 0
        self.pieces: dict[int, tuple[int, list[tuple[int, str]]]] = {}

    def written(self) -> bytes:
        return json.dumps([self.frames, list(self.pieces.items())]).encode()

    @classmethod
    def read(cls, written: bytes) -> _Found:
        """From what another process has written; nothing, if it could not."""
        found = cls()
        if written:
            found.frames, pieces = json.loads(written)
            found.pieces = {
                index: (lines, [(line, words) for line, words in wrong]) for index, (lines, wrong) in pieces
            }
        return found


class _TurnLost(Exception):
    """Another process has ended before its last turn."""


def processes_for(name: str) -> int:
    """How many processes are worth their start for this log; 0 for what cannot be cut into pieces."""
    path = Path(name)
    try:
        if not path.is_file():
            return 0
        with path.open("rb") as file:
            head = file.read(16)
        long = path.stat().st_size >= _WORTH_IT
    except OSError:
        return 0
    if kind_of(head) != "candump":
        return 0
    return len(os.sched_getaffinity(0)) if long else 1


def pieces_of(path: Path, piece_bytes: int) -> Iterator[bytes]:
    """The whole lines of the candump log at `path`, a few at a time: what must be known before it is shared out."""
    for begin in range(0, path.stat().st_size, piece_bytes):
        yield _piece(path, begin, begin + piece_bytes)[0]


def write_lines(
    path: Path, print_block: Print, write: Write, processes: int, piece_bytes: int = PIECE_BYTES
) -> tuple[int, Problems]:
    """Write the lines of all frames of the candump log at `path`; in several processes `write` must not gather.

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
            _child(_Turn(number, turns), path, pieces, print_block, write, ours)
        os.close(ours)
        children.append((child, theirs))
    turn = _Turn(0, turns)
    found: list[_Found] = []
    try:
        turn.begin()
        found.append(_work(turn, path, pieces, print_block, write))
        for _, theirs in children:
            with os.fdopen(theirs, "rb", closefd=False) as answer:
                found.append(_Found.read(answer.read()))
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


def write_all(out: int, text: bytes) -> None:
    """To a file descriptor, at once."""
    left = memoryview(text)
    while left:
        left = left[os.write(out, left) :]


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


def _child(turn: _Turn, path: Path, pieces: Pieces, print_block: Print, write: Write, answer: int) -> None:
    """Never returns: its exit status is the number of the error that ended it."""
    status = errno.EIO
    try:
        found = _work(turn, path, pieces, print_block, write)
        with os.fdopen(answer, "wb") as file:
            file.write(found.written())
        status = 0
    except OSError as error:
        status = error.errno or status
    except _TurnLost:
        status = 0  # the other one tells
    except KeyboardInterrupt:
        pass  # the other one has heard it too
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        os._exit(status)


def _work(turn: _Turn, path: Path, pieces: Pieces, print_block: Print, write: Write) -> _Found:
    """Decode and write every piece whose turn is that of this process."""
    found = _Found()
    for index in range(turn.number, len(pieces), turn.count):
        block, reason = _piece(path, *pieces[index])
        printed = print_block(block)
        problems = printed.problems if reason is None else [*printed.problems, (printed.lines, reason)]
        found.frames += printed.frames
        found.pieces[index] = printed.lines, problems
        turn.await_it()
        write(printed.text)
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
