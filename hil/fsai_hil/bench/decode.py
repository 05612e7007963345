"""Logs read to text, tables and a verdict, beside cantools.

One log has random payloads of every message, the other is as it is recorded: a drive, again and again. What is packed
by other threads or read by other processes is measured in wall time; each command with its start.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from fsai_hil.bench.loop import REVISION, cantools_database
from fsai_hil.bench.rows import Ratio, in_turns, timed
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.log.reader import read_log

FRAMES = 2_000_000
ROUNDS = 3
PEER_FRAMES = 50_000  # cantools takes a second for so many
FRAME_NS = 700_000  # of a full bus
LEAN = "import sys; sys.modules['asammdf'] = None\n"  # python-can alone: here asammdf would triple a peer's start


def rows() -> list[Ratio]:
    """Read logs to text, tables and a verdict."""
    found = []
    for kind, made in (("random", random_frames), ("recorded", recorded_frames)):
        with tempfile.TemporaryDirectory() as name:
            found += _commands(kind, made(Path(name)), Path(name))
    return found


def _commands(kind: str, frames: Frames, folder: Path) -> list[Ratio]:
    """Measure what the commands make of a log, beside cantools' own command line."""
    log, part, dbc = folder / "whole.log", folder / "part.log", folder / "car.dbc"
    for path, some in ((log, frames), (part, frames.head(PEER_FRAMES))):
        path.write_bytes(b"\n".join([*log_lines(some), b""]))
    dbc.write_text(cantools_database().as_dbc_string(), encoding="cp1252")  # cantools' command line takes one file
    cantools = [sys.executable, "-c", f"{LEAN}import cantools; cantools._main()", "decode", "--single-line", str(dbc)]

    def decoded_by_cantools() -> bytes:
        with part.open("rb") as source:
            return subprocess.run(cantools, stdin=source, stdout=subprocess.PIPE, check=True).stdout

    decode = ("decode", "--revision", REVISION)
    assert fsai_vcu(*decode, part, out=subprocess.PIPE) == decoded_by_cantools(), f"{kind}: cantools prints other lines"

    def exported(to: str) -> None:
        with tempfile.TemporaryDirectory(dir=folder) as out:
            fsai_vcu("export", log, "--to", to, "-o", f"{out}/tables")

    wall = partial(timed, scale=1e6, timer=time.perf_counter)
    ours = partial(wall, of=len(frames))
    return in_turns(
        "us/frame",
        ROUNDS,
        ("cantools decode", wall(decoded_by_cantools, of=len(frames.head(PEER_FRAMES)))),
        (f"decode {kind}, wall", ours(partial(fsai_vcu, *decode, log))),
        (f"check {kind}, wall", ours(partial(fsai_vcu, "check", log))),
        # Last those after which the machine goes on writing to the disk for a while.
        *((f"{to} {kind}, wall", ours(partial(exported, to))) for to in ("parquet", "mcap")),
    )


def random_frames(_: Path) -> Frames:
    """Return frames of every message of the revision with random payloads."""
    chance = np.random.default_rng(1)
    layouts = list(load_databases(revision=REVISION).layouts.values())
    which = chance.integers(0, len(layouts), FRAMES)
    word = chance.integers(0, 1 << 64, FRAMES, dtype=np.uint64)
    return Frames(
        1_700_000_000_000_000_000 + np.arange(FRAMES) * FRAME_NS,
        np.array([layout.can_id for layout in layouts], np.uint32)[which],
        np.zeros(FRAMES, np.uint8),
        np.array([layout.length for layout in layouts], np.uint8)[which],
        word & np.array([(1 << 8 * layout.length) - 1 for layout in layouts], np.uint64)[which],
        np.zeros(FRAMES, np.int32),
        ["can0"],
    )


def recorded_frames(folder: Path) -> Frames:
    """Return the frames of a drive, repeated."""
    log = folder / "drive.log"
    fsai_vcu("drive", "--mission", "acceleration", "--log", log)
    frames = read_log(log)[0]
    lasts_ns = int(frames.t_ns[-1] - frames.t_ns[0]) + FRAME_NS
    repeated = [frames.at(frames.t_ns + number * lasts_ns) for number in range(-(-FRAMES // len(frames)))]
    return joined(repeated).head(FRAMES)


def fsai_vcu(*argv: str | Path, out: int = subprocess.DEVNULL) -> bytes:
    """Run a verb in a process of its own; return its output where `out` is a pipe. A verdict is no failure."""
    command = [sys.executable, "-m", "fsai_vcu.cli.main", *map(str, argv)]
    done = subprocess.run(command, stdout=out, stderr=subprocess.DEVNULL)
    assert done.returncode in (0, 1), f"{' '.join(command)}: status {done.returncode}"
    return done.stdout or b""
