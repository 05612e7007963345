"""Logs read to text, values, tables and a verdict, beside cantools, and an MF4 beside asammdf.

One log has random payloads of every message, the other is as it is recorded: a drive, again and again. What is packed
by other threads or read by other processes is measured in wall time; each command with its start.
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

from fsai_hil.bench.loop import LEAN, REVISION, cantools_database
from fsai_hil.bench.rows import Ratio, in_turns, timed
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.log.reader import open_log, read_log
from fsai_vcu.interface.units import S

FRAMES = 2_000_000
ROUNDS = 3
PEER_FRAMES = 50_000  # cantools takes a second for so many
FRAME_NS = 700_000  # of a full bus
BY_ASAMMDF = "import sys, asammdf; print(len(asammdf.MDF(sys.argv[1]).get('CAN_DataFrame', 0, raw=True).samples))"


def rows() -> list[Ratio]:
    """Read logs to text, values, tables and a verdict."""
    found = []
    for kind, made in (("random", random_frames), ("recorded", recorded_frames)):
        with tempfile.TemporaryDirectory() as name:
            frames = made(Path(name))
            found += _commands(kind, frames, Path(name))
            if kind == "random":
                found += _mf4(frames, Path(name) / "whole.mf4")
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

    def values() -> None:
        decoder = Decoder(load_databases(revision=REVISION))
        with open_log(log) as opened:
            for chunk in opened.chunks():
                decoder.tables(chunk)

    def exported(to: str) -> None:
        with tempfile.TemporaryDirectory(dir=folder) as out:
            fsai_vcu("export", log, "--to", to, "-o", f"{out}/tables")

    works: dict[str, Callable[[], object]] = {
        "decode": partial(fsai_vcu, *decode, log),
        "values": values,
        "check": partial(fsai_vcu, "check", log),
        "stats": partial(fsai_vcu, "check", "--figures", log),
        # Last those after which the machine goes on writing to the disk for a while.
        "parquet": partial(exported, "parquet"),
        "mcap": partial(exported, "mcap"),
    }
    wall = partial(timed, scale=1e6, timer=time.perf_counter)
    peer = ("cantools decode", wall(decoded_by_cantools, of=len(frames.head(PEER_FRAMES))))
    ours = [(f"{name} {kind}, wall", wall(work, of=len(frames))) for name, work in works.items()]
    return in_turns("us/frame", ROUNDS, peer, *ours)


def _mf4(frames: Frames, path: Path) -> list[Ratio]:
    """Measure an MF4 as python-can writes it read to columns; asammdf alone reads in a process that does no more."""
    import asammdf

    kinds = {"BusChannel": "u1", "ID": "<u4", "IDE": "u1", "DLC": "u1", "DataLength": "u1", "DataBytes": "(64,)u1"}
    samples = np.zeros(len(frames), [(f"CAN_DataFrame.{name}", kind) for name, kind in kinds.items()])
    samples["CAN_DataFrame.ID"] = frames.can_id
    samples["CAN_DataFrame.DLC"] = samples["CAN_DataFrame.DataLength"] = frames.length
    samples["CAN_DataFrame.DataBytes"][:, :8] = frames.word.view(np.uint8).reshape(-1, 8)
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(asammdf.Signal(samples, (frames.t_ns - frames.t_ns[0]) / S, name="CAN_DataFrame"))
        mdf.save(path, compression=2)

    def read() -> int:
        with open_log(path) as log:
            return sum(map(len, log.chunks()))

    by_asammdf = partial(subprocess.check_output, [sys.executable, "-c", BY_ASAMMDF, path])
    assert read() == int(by_asammdf()) == len(frames), "not every frame of the MF4 is read"
    wall = partial(timed, scale=1e6, of=len(frames), timer=time.perf_counter)
    return in_turns("us/frame", ROUNDS, ("asammdf", wall(by_asammdf)), ("mf4, wall", wall(read)), cold=1)


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
