"""Logs read to text, values, tables and a verdict, beside cantools, asammdf and python-can.

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

import can
import numpy as np

from fsai_hil.bench.loop import LEAN, REVISION, cantools_database
from fsai_hil.bench.rows import Row, in_turns, timed
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.log.reader import open_log, read_log
from fsai_vcu.interface.units import S

PEER_FRAMES = 50_000  # cantools takes a second for so many
FRAME_NS = 700_000  # of a full bus
PARTS = 10  # in which a long log is written
US_PER_FRAME = "us/frame"


def rows(count: int, rounds: int) -> list[Row]:
    """Measure logs of `count` frames: of both kinds where they are long, else of random payloads alone."""
    found = []
    for kind, made in (("random", random_frames), ("recorded", recorded_frames))[: 2 if rounds > 1 else 1]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            frames = made(count, folder)
            found += _commands(kind, frames, folder, rounds)
            if kind == "random":
                found += _readers(frames, folder, rounds)
    return found


def _commands(kind: str, frames: Frames, folder: Path, rounds: int) -> list[Row]:
    """Measure what the commands make of a log, beside cantools' own command line."""
    log, part, dbc = folder / "whole.log", folder / "part.log", folder / "car.dbc"
    write(frames, log)
    write(frames.head(PEER_FRAMES), part)
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
    return in_turns(US_PER_FRAME, rounds, peer, *ours)


def _readers(frames: Frames, folder: Path, rounds: int) -> list[Row]:
    """Measure logs read to columns: beside python-can's readers as it writes them, and an MF4 beside asammdf alone."""
    found, part, mf4 = [], frames.head(PEER_FRAMES), folder / "whole.mf4"
    _write_mf4(frames, mf4)
    # asammdf reads in a process that does no more.
    code = "import sys, asammdf; print(len(asammdf.MDF(sys.argv[1]).get('CAN_DataFrame', 0, raw=True).samples))"
    asammdf = partial(subprocess.check_output, [sys.executable, "-c", code, mf4])
    works: list[tuple[str, Path, Frames, Callable[[], float], str, Callable[[], int]]]
    works = [("mf4, wall", mf4, frames, time.perf_counter, "asammdf", lambda: int(asammdf()))]
    for kind in ("log", "asc", "trc", "blf"):
        path = folder / f"part-by-python-can.{kind}"
        with can.Logger(path) as writer:
            for one in part:
                message = can.Message(one.t_ns / S, one.can_id, one.extended, data=one.data, channel=0)
                writer.on_message_received(message)
        by_python_can = partial(_read_by_python_can, path)
        works.append((f"read {kind}", path, part, time.process_time, "python-can", by_python_can))
    for name, path, there, timer, peer_name, peer in works:
        assert _read(path) == peer() == len(there), f"{name}: not every frame is read"
        took = partial(timed, scale=1e6, of=len(there), timer=timer)
        pair = (peer_name, took(peer)), (name, took(partial(_read, path)))
        found += in_turns(US_PER_FRAME, max(2, rounds), *pair, cold=1)
    return found


def _read(path: Path) -> int:
    with open_log(path) as log:
        return sum(map(len, log.chunks()))


def _read_by_python_can(path: Path) -> int:
    with can.LogReader(path) as reader:
        return sum(1 for _ in reader)


def _write_mf4(frames: Frames, path: Path) -> None:
    """Write an MF4 as python-can does, if by the frame."""
    import asammdf

    names = "BusChannel", "ID", "IDE", "DLC", "DataLength", "DataBytes"
    kinds = "u1", "<u4", "u1", "u1", "u1", "(64,)u1"
    samples = np.zeros(len(frames), [(f"CAN_DataFrame.{name}", kind) for name, kind in zip(names, kinds, strict=True)])
    samples["CAN_DataFrame.ID"] = frames.can_id
    samples["CAN_DataFrame.DLC"] = samples["CAN_DataFrame.DataLength"] = frames.length
    samples["CAN_DataFrame.DataBytes"][:, :8] = frames.word.view(np.uint8).reshape(-1, 8)
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(asammdf.Signal(samples, (frames.t_ns - frames.t_ns[0]) / S, name="CAN_DataFrame"))
        mdf.save(path, compression=2)


def random_frames(count: int, _: Path) -> Frames:
    """Return frames of every message of the revision with random payloads."""
    chance = np.random.default_rng(1)
    layouts = list(load_databases(revision=REVISION).layouts.values())
    which = chance.integers(0, len(layouts), count)
    word = chance.integers(0, 1 << 64, count, dtype=np.uint64)
    return Frames(
        1_700_000_000_000_000_000 + np.arange(count) * FRAME_NS,
        np.array([layout.can_id for layout in layouts], np.uint32)[which],
        np.zeros(count, np.uint8),
        np.array([layout.length for layout in layouts], np.uint8)[which],
        word & np.array([(1 << 8 * layout.length) - 1 for layout in layouts], np.uint64)[which],
        np.zeros(count, np.int32),
        ["can0"],
    )


def recorded_frames(count: int, folder: Path) -> Frames:
    """Return the frames of a drive, repeated."""
    log = folder / "drive.log"
    fsai_vcu("drive", "--mission", "acceleration", "--log", log)
    frames = read_log(log)[0]
    lasts_ns = int(frames.t_ns[-1] - frames.t_ns[0]) + FRAME_NS
    repeated = [frames.at(frames.t_ns + number * lasts_ns) for number in range(-(-count // len(frames)))]
    return joined(repeated).head(count)


def write(frames: Frames, path: Path) -> None:
    """Write a candump log."""
    with path.open("wb") as file:
        for some in np.array_split(np.arange(len(frames)), PARTS):
            file.write(b"\n".join([*log_lines(frames.only(some)), b""]))


def fsai_vcu(*argv: str | Path, out: int = subprocess.DEVNULL) -> bytes:
    """Run a verb in a process of its own; return its output where `out` is a pipe. A verdict is no failure."""
    command = [sys.executable, "-m", "fsai_vcu.cli.main", *map(str, argv)]
    done = subprocess.run(command, stdout=out, stderr=subprocess.DEVNULL)
    assert done.returncode in (0, 1), f"{' '.join(command)}: status {done.returncode}"
    return done.stdout or b""
