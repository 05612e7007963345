"""How fast logs are read: to text beside cantools' own command line, to values, to tables, and to a verdict.

A log of random payloads of every message, and one as it is recorded: a drive, again and again. Wall time, for `decode`
works on all processors, and the peer on the same log in turns; each command with its start.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from cantools.database.can import Database

from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.log.reader import open_log, read_log
from fsai_vcu.interface.database import dbc_dir
from fsai_vcu.interface.revisions import revision

REVISION = "2026"
RANDOM, RECORDED = "random", "recorded"
_PEER_FRAMES = 50_000  # cantools takes a second for so many
_FRAME_NS = 700_000  # of a full bus
_AT_ONCE = 200_000


def random_frames(count: int, seed: int = 1) -> Frames:
    """Payloads at random of every message of the revision."""
    chance = np.random.default_rng(seed)
    layouts = list(load_databases(revision=REVISION).layouts.values())
    which = chance.integers(0, len(layouts), count)
    length = np.array([layout.length for layout in layouts], np.uint8)[which]
    word = chance.integers(0, 1 << 64, count, dtype=np.uint64)
    return Frames(
        1_700_000_000_000_000_000 + np.arange(count) * _FRAME_NS,
        np.array([layout.can_id for layout in layouts], np.uint32)[which],
        np.zeros(count, np.uint8),
        length,
        word & np.array([(1 << 8 * layout.length) - 1 for layout in layouts], np.uint64)[which],
        np.zeros(count, np.int32),
        ["can0"],
    )


def recorded_frames(count: int, folder: Path) -> Frames:
    """Those of a drive, repeated."""
    log = folder / "drive.log"
    _fsai_vcu("drive", "--mission", "acceleration", "--log", log)
    frames = read_log(log)[0]
    lasts_ns = int(frames.t_ns[-1] - frames.t_ns[0]) + _FRAME_NS
    repeated = [frames.at(frames.t_ns + number * lasts_ns) for number in range(-(-count // len(frames)))]
    return joined(repeated).head(count)


def logs_us(count: int, rounds: int, *, recorded: bool) -> dict[str, list[float]]:
    """Microseconds a frame, round by round, of each figure: "decode random", "cantools random", "values random" …"""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = _figures(RANDOM, random_frames(count), folder, rounds)
        if recorded:
            found |= _figures(RECORDED, recorded_frames(count, folder), folder, rounds)
        return found


def _figures(kind: str, frames: Frames, folder: Path, rounds: int) -> dict[str, list[float]]:
    log, part, dbc = folder / "whole.log", folder / "part.log", folder / "car.dbc"
    few = frames.head(_PEER_FRAMES)
    _write(frames, log)
    _write(few, part)
    whole = Database()
    for name in revision(REVISION).dbc_files:
        whole.add_dbc_file(dbc_dir() / name)
    dbc.write_text(whole.as_dbc_string(), encoding="cp1252")  # cantools' command line takes one file
    assert _decoded(part) == _decoded_by_cantools(part, dbc), f"{kind}: cantools prints other lines"
    found: dict[str, list[float]] = {}
    for _ in range(rounds):
        with tempfile.TemporaryDirectory(dir=folder) as out:
            works: dict[str, tuple[Callable[[], object], int]] = {
                "cantools": (partial(_decoded_by_cantools, part, dbc), len(few)),
                "decode": (partial(_decoded, log, None), len(frames)),
                "values": (partial(_values, log), len(frames)),
                "parquet": (partial(_fsai_vcu, "export", log, "--to", "parquet", "-o", f"{out}/p"), len(frames)),
                "mcap": (partial(_fsai_vcu, "export", log, "--to", "mcap", "-o", f"{out}/m"), len(frames)),
                "check": (partial(_fsai_vcu, "check", log), len(frames)),
            }
            for figure, (work, count) in works.items():
                began = time.perf_counter()
                work()
                found.setdefault(f"{figure} {kind}", []).append((time.perf_counter() - began) * 1e6 / count)
    return found


def _write(frames: Frames, path: Path) -> None:
    with path.open("wb") as file:
        for begin in range(0, len(frames), _AT_ONCE):
            rows = np.arange(begin, min(begin + _AT_ONCE, len(frames)), dtype=np.int64)
            file.write(b"\n".join([*log_lines(frames.only(rows)), b""]))


def _decoded(log: Path, out: int | None = subprocess.PIPE) -> bytes:
    return _fsai_vcu("decode", log, "--revision", REVISION, out=out)


def _decoded_by_cantools(log: Path, dbc: Path) -> bytes:
    with log.open("rb") as source:
        command = [sys.executable, "-m", "cantools", "decode", "--single-line", str(dbc)]
        return subprocess.run(command, stdin=source, stdout=subprocess.PIPE, check=True).stdout


def _fsai_vcu(*argv: str | Path, out: int | None = None) -> bytes:
    """Its output if it is asked for; a verdict on the log is no failure."""
    command = [sys.executable, "-m", "fsai_vcu.cli.main", *map(str, argv)]
    done = subprocess.run(command, stdout=out or subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    assert done.returncode in (0, 1), f"{' '.join(command)}: status {done.returncode}"
    return done.stdout or b""


def _values(log: Path) -> None:
    """Every signal as a column, in windows."""
    decoder = Decoder(load_databases(revision=REVISION))
    with open_log(log) as opened:
        for frames in opened.chunks():
            decoder.tables(frames)
