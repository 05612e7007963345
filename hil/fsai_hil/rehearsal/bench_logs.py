"""How fast logs are read: to text beside cantools' own command line, to values, to tables, and to a verdict.

A log of random payloads of every message, and one as it is recorded: a drive, again and again. Wall time, for `decode`
works on all processors, and the peer on the same log in turns; each command with its start.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from timeit import timeit

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
KINDS = ("random", "recorded")
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


def cantools_database() -> Database:
    """The revision's files, as anybody would load them."""
    database = Database()
    for name in revision(REVISION).dbc_files:
        database.add_dbc_file(str(dbc_dir() / name))
    return database


def logs_us(kinds: Sequence[str], count: int, rounds: int) -> Iterator[tuple[str, list[float], list[float]]]:
    """(what, microseconds a frame, those of cantools where it does the same), round by round: "decode random" …"""
    for kind in kinds:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            frames = random_frames(count) if kind == "random" else recorded_frames(count, folder)
            found = _figures(kind, frames, folder, rounds)
        peer = found.pop("cantools")
        yield from ((f"{what} {kind}", ours, peer if what == "decode" else []) for what, ours in found.items())


def _figures(kind: str, frames: Frames, folder: Path, rounds: int) -> dict[str, list[float]]:
    log, part, dbc = folder / "whole.log", folder / "part.log", folder / "car.dbc"
    few = frames.head(_PEER_FRAMES)
    _write(frames, log)
    _write(few, part)
    dbc.write_text(cantools_database().as_dbc_string(), encoding="cp1252")  # cantools' command line takes one file
    assert _decoded(part) == _decoded_by_cantools(part, dbc), f"{kind}: cantools prints other lines"
    works: dict[str, tuple[Callable[[], object], Frames]] = {
        "cantools": (lambda: _decoded_by_cantools(part, dbc), few),
        "decode": (lambda: _decoded(log, None), frames),
        "values": (lambda: _values(log), frames),
        "parquet": (lambda: _exported("parquet", log, folder), frames),
        "mcap": (lambda: _exported("mcap", log, folder), frames),
        "check": (lambda: _fsai_vcu("check", log), frames),
    }
    found: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, (work, read) in works.items():
            found[name].append(timeit(work, number=1) * 1e6 / len(read))
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


def _exported(kind: str, log: Path, folder: Path) -> None:
    with tempfile.TemporaryDirectory(dir=folder) as out:
        _fsai_vcu("export", log, "--to", kind, "-o", f"{out}/tables")


def _values(log: Path) -> None:
    """Every signal as a column, in windows."""
    decoder = Decoder(load_databases(revision=REVISION))
    with open_log(log) as opened:
        for frames in opened.chunks():
            decoder.tables(frames)
