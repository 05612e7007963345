"""A log decoded by several processes is the same text, in the same order, with the same problems, as by one."""

from __future__ import annotations

import errno
import os
import random
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from fsai_vcu.diagnostics.decode.printing import Printed
from fsai_vcu.diagnostics.decode.sharing import PIECE_BYTES, processes_for, write_all, write_lines
from fsai_vcu.diagnostics.log.candump import log_lines, parse_block
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of
from fsai_vcu.diagnostics.log.reader import open_log


def lines_of(frames: Frames) -> bytes:
    return b"".join(line + b"\n" for line in log_lines(frames))


def printed(block: bytes) -> Printed:
    frames, unreadable, lines = parse_block(np.frombuffer(block, np.uint8), [])
    return Printed(lines_of(frames), len(frames), lines, [(line, words) for line, words in unreadable])


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Lines of all lengths, some of them no frames, and the last one cut off."""
    chance = random.Random(2)
    frames = frames_of(
        LogFrame(n * 1_000_000, "can0", chance.randrange(0x800), chance.randbytes(chance.randrange(9)))
        for n in range(600)
    )
    lines = log_lines(frames)
    for at in (0, 77, 78, 300, 598):
        lines[at] = b"garbage" * chance.randrange(1, 9)
    path = tmp_path_factory.mktemp("shared") / "run.log"
    path.write_bytes(b"\n".join(lines)[:-2])
    return path


def alone(path: Path) -> tuple[bytes, int, list[str]]:
    with open_log(path) as opened:
        text = b"".join(lines_of(frames) for frames in opened.chunks())
    return text, text.count(b"\n"), opened.problems.texts


@pytest.mark.parametrize("processes", [1, 2, 3, 5])
@pytest.mark.parametrize("piece_bytes", [40, 61, 500, 7919, 10**6])
def test_a_log_cut_anywhere_loses_doubles_and_moves_nothing(
    log: Path, tmp_path: Path, processes: int, piece_bytes: int
) -> None:
    out = tmp_path / "out.txt"
    with out.open("wb") as file:
        frames, problems = write_lines(log, printed, partial(write_all, file.fileno()), processes, piece_bytes)
    text, count, texts = alone(log)
    assert out.read_bytes() == text
    assert frames == count
    assert problems.texts == texts
    assert problems.count == len(texts) > 4


def test_a_full_disk_ends_all_processes_with_its_error(log: Path) -> None:
    with Path("/dev/full").open("wb") as full, pytest.raises(OSError) as refused:
        write_lines(log, printed, partial(write_all, full.fileno()), 2, 500)
    assert refused.value.errno == errno.ENOSPC


def test_a_closed_pipe_ends_all_processes_as_a_broken_pipe(log: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        with pytest.raises(BrokenPipeError):
            write_lines(log, printed, partial(write_all, writing), 2, 500)
    finally:
        os.close(writing)


@pytest.mark.parametrize("bad_piece", [0, 1])
def test_an_error_in_one_process_ends_the_others_too(log: Path, tmp_path: Path, bad_piece: int) -> None:
    """Whichever of the two processes meets it."""
    with open_log(log) as opened:
        first = next(iter(opened.chunks()))
    limit = int(first.t_ns[len(first) // 2])

    def failing(block: bytes) -> Printed:
        frames = parse_block(np.frombuffer(block, np.uint8), [])[0]
        if len(frames) and bool(frames.t_ns[0] > limit) == bool(bad_piece):
            raise OSError(errno.EIO, "Input/output error")
        return printed(block)

    with (tmp_path / "out.txt").open("wb") as file, pytest.raises(OSError) as refused:
        write_lines(log, failing, partial(write_all, file.fileno()), 2, log.stat().st_size // 2 + 100)
    assert refused.value.errno == errno.EIO


def test_only_a_long_candump_log_is_shared_out(tmp_path: Path) -> None:
    short, long, packed = tmp_path / "short.log", tmp_path / "long.log", tmp_path / "packed.log"
    short.write_bytes(b"(1.000000) can0 520#01\n")
    long.write_bytes(b"(1.000000) can0 520#01\n" * (4 * PIECE_BYTES // 23 + 1))
    packed.write_bytes(b"\x1f\x8b" + bytes(4 * PIECE_BYTES))
    assert [processes_for(str(path)) for path in (short, packed, tmp_path / "gone.log", tmp_path)] == [1, 0, 0, 0]
    assert processes_for(str(long)) == len(os.sched_getaffinity(0))
