"""`python -m fsai_hil.rehearsal.bench`: how fast, as ratios to what everybody would take instead, in the same run.

    python -m fsai_hil.rehearsal.bench --quick -o out/bench
    python -m fsai_hil.rehearsal.bench --check

Ours and the peer's take turns, so that a machine that slows down slows both; each figure is the median of the rounds,
with the quickest and the slowest beside it. What is counted is processor time, the kernel's part too, so other programs
on the machine cost nothing. That both give the same values is shown in `tests/interface`. One figure is judged, but for
`--quick`: the bridge node, real rclpy and all, must come to its first frame within a second of processor time.

`--check` compares the ratios, and nothing else, with those of `docs/evidence/bench.json`, which `--write` renews.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from timeit import timeit
from typing import Any, NamedTuple

import can
import numpy as np
from cantools.database.can import Database

from fsai_hil import CHECKOUT
from fsai_hil.rehearsal.scrutineering.machine import facts, machine
from fsai_hil.rehearsal.stack import RunningProcess
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import World, WorldSetup, mission_named
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.log.reader import open_log, read_log
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.database import dbc_dir
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiCommand, VcuStatus
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.bus import open_bus
from fsai_vcu.runtime.lock import holder_pid
from fsai_vcu.runtime.turns import Send, Turns

REVISION = "2026"
MISSIONS = ("acceleration", "skidpad", "autocross", "trackdrive")
TRACKDRIVE_LAPS = 1
NODE_START = "start bridge node"
NODE_START_S = 1.0  # of a normal machine, as carpc/scenes.py has it
BASELINE = CHECKOUT / "docs" / "evidence" / "bench.json"
BETWEEN_RUNS = 0.1  # by how much a ratio differs between two runs of the same code, beside the spread of their rounds
TOO_NOISY = 0.5  # what differs by more within a run shows no fall
SPEED = "x real time"
_PEER_FRAMES = 50_000  # cantools takes a second for so many
_FRAME_NS = 700_000  # of a full bus
_PARTS = 10  # in which a long log is written
_NODE_PATIENCE_S = 60.0  # of a loaded machine
Row = dict[str, Any]
Work = Callable[[], object]
COMMAND = AiCommand(
    handshake=True,
    mission_status=MissionStatus.RUNNING,
    direction=Direction.FORWARD,
    steer_deg=-7.3,
    rear_torque_nm=81.5,
)


class Effort(NamedTuple):
    """How much is run."""

    rounds: int
    turns: int  # of a comparison in each round
    starts: int  # of a process
    missions: tuple[str, ...]
    drives: int  # of each mission
    log_frames: int
    log_rounds: int


FULL = Effort(rounds=15, turns=2000, starts=7, missions=MISSIONS, drives=2, log_frames=2_000_000, log_rounds=3)
QUICK = Effort(rounds=5, turns=300, starts=2, missions=MISSIONS[:1], drives=1, log_frames=50_000, log_rounds=1)


def spread(values: Sequence[float]) -> dict[str, float] | None:
    """Of one figure over the rounds, to four digits."""
    figures = {"median": statistics.median, "least": min, "most": max}
    return {name: float(f"{figure(values):.4g}") for name, figure in figures.items()} if values else None


def row(name: str, unit: str, ours: Sequence[float], peer_name: str = "", peer: Sequence[float] = ()) -> Row:
    """One row of the table. `ratio` is the peer's time by ours, round by round; None where there is no peer."""
    # A speed is the greater the better: how much of it there is in the peer's time.
    ratios = [theirs * own if unit == SPEED else theirs / own for own, theirs in zip(ours, peer, strict=False)]
    figures = {"ours": spread(ours), "peer": spread(peer), "ratio": spread(ratios)}
    return {"name": name, "unit": unit, "peer_name": peer_name, **figures}


def compared(
    *words: str, ours: Work, peer: Work, effort: Effort, scale: float, timer: Callable[[], float] = time.process_time
) -> Row:
    """The row of both, timed in turns: `scale` times the seconds of a call. words: name, unit and the peer's name."""
    times: dict[Work, list[float]] = {ours: [], peer: []}
    for number in range(effort.rounds + 1):
        # Neither is always the one that finds the caches warm.
        for work in (ours, peer)[:: 1 if number % 2 else -1]:
            times[work].append(scale * timeit(work, timer=timer, number=effort.turns) / effort.turns)
    name, unit, peer_name = words
    return row(name, unit, times[ours][1:], peer_name, times[peer][1:])  # what is only done once was done in the first


# ---------------------------------------------------------------- codec


def cantools_database() -> Database:
    """The revision's files, as anybody would load them."""
    database = Database()
    for name in revision(REVISION).dbc_files:
        database.add_dbc_file(str(dbc_dir() / name))
    return database


def car_frames() -> list[Frame]:
    """The VCU's own frames while it comes up: twenty of each message."""
    sent = World(WorldSetup(missions=[Ami.TRACKDRIVE], revision=REVISION)).advance(5 * S)
    return [frame for frame in sent if frame.can_id in VCU_IDS][-20 * len(VCU_IDS) :]


def bench_decode(codec: Codec, database: Any, effort: Effort) -> Row:
    frames = car_frames()

    def ours() -> None:
        for frame in frames:
            codec.decode(frame)

    def peer() -> None:
        for frame in frames:
            database.decode_message(frame.can_id, frame.data, decode_choices=False)

    fewer = effort._replace(turns=effort.turns // 20)
    words = "decode a frame", "us/frame", "cantools"
    return compared(*words, ours=ours, peer=peer, effort=fewer, scale=1e6 / len(frames))


def command_values(database: Any, frames: Sequence[Frame]) -> list[tuple[int, dict[str, float]]]:
    """What cantools encodes into these frames."""
    return [(frame.can_id, database.decode_message(frame.can_id, frame.data, decode_choices=False)) for frame in frames]


def bench_encode(codec: Codec, database: Any, effort: Effort) -> Row:
    values = command_values(database, codec.encode_command(COMMAND))

    def peer() -> None:
        for can_id, signals in values:
            database.encode_message(can_id, signals)

    ours = partial(codec.encode_command, COMMAND)
    words = "encode a frame", "us/frame", "cantools"
    return compared(*words, ours=ours, peer=peer, effort=effort, scale=1e6 / len(values))


# ---------------------------------------------------------------- the answer


@contextmanager
def answering(codec: Codec) -> Iterator[tuple[Work, Bridge]]:
    """What answers one 0x520 after the other on a loopback bus, past the time in which a bridge only listens."""
    chosen = revision(REVISION)
    statuses = [codec.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)) for bit in (False, True)]
    with open_bus(f"loopback:bench-{os.getpid()}", may_send=AI_IDS) as bus:
        bridge = Bridge(codec, chosen, CARS[REVISION], BridgeConfig(), None, now_ns=0)
        turns, numbers = Turns(bridge, codec, 0), count(1)

        def turn() -> None:
            number = next(numbers)
            now_ns, status = number * PERIOD_NS, statuses[number & 1]
            turns.on_frames((Frame(status.can_id, status.data, now_ns),), now_ns)
            for action in turns.act(now_ns):
                if isinstance(action, Send):
                    turns.sent(all(map(bus.send, action.frames)), now_ns if action.frames else None, now_ns)

        for _ in range(100):
            turn()
        yield turn, bridge


def bench_answer(codec: Codec, database: Any, effort: Effort) -> Row:
    """From a 0x520 received to five frames sent, on the loopback bus: ours supervised and limited, theirs not."""
    values = command_values(database, codec.encode_command(COMMAND))
    status = codec.encode(VcuStatus(as_state=AsState.AS_OFF))
    with answering(codec) as (ours, bridge):
        plain = can.Bus(interface="fsai_loopback", channel=f"bench-{os.getpid()}-peer")

        def peer() -> None:
            received = database.decode_message(status.can_id, status.data, decode_choices=False)
            for can_id, signals in values:
                if can_id == AI_IDS[0]:
                    signals = {**signals, "HANDSHAKE": received["HANDSHAKE"]}
                data = database.encode_message(can_id, signals)
                plain.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

        try:
            before = bridge.tally.cycles
            words = "answer a 0x520", "us/cycle", "cantools + python-can"
            found = compared(*words, ours=ours, peer=peer, effort=effort, scale=1e6)
            assert bridge.tally.cycles - before >= effort.rounds * effort.turns, "not every 0x520 was answered"
        finally:
            plain.shutdown()
    return found


# ---------------------------------------------------------------- logs


def bench_logs(effort: Effort) -> list[Row]:
    """Logs read to text beside cantools' own command line, to values, to tables, and to a verdict.

    One with random payloads of every message, and one as it is recorded: a drive, again and again. Wall time, for
    Parquet is packed beside the rest; each command with its start, which of a short log is most of it.
    """
    rows = []
    for kind, made in (("random", random_frames), ("recorded", recorded_frames))[: 2 if effort is FULL else 1]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            frames = made(effort.log_frames, folder)
            rows += bench_log(kind, frames, folder, effort.log_rounds)
            if kind == "random":
                rows.append(bench_mf4(frames, folder / "whole.mf4", effort))
                rows += bench_readers(frames.head(_PEER_FRAMES), folder, effort)
    return rows


def bench_readers(frames: Frames, folder: Path, effort: Effort) -> list[Row]:
    """Logs as python-can writes them to columns, beside python-can's own readers."""
    rows = []
    once = effort._replace(rounds=max(3, effort.log_rounds), turns=1)
    for kind in ("log", "asc", "trc", "blf"):
        path = folder / f"part-by-python-can.{kind}"
        with can.Logger(path) as writer:
            for frame in frames:
                message = can.Message(frame.t_ns / S, frame.can_id, frame.extended, data=frame.data, channel=0)
                writer.on_message_received(message)

        def read(path: Path = path) -> int:
            with open_log(path) as log:
                return sum(map(len, log.chunks()))

        def read_by_python_can(path: Path = path) -> int:
            with can.LogReader(path) as reader:
                return sum(1 for _ in reader)

        assert read() == read_by_python_can() == len(frames), f"{kind}: not every frame is read"
        words, scale = (f"read {kind}", "us/frame", "python-can"), 1e6 / len(frames)
        rows.append(compared(*words, ours=read, peer=read_by_python_can, effort=once, scale=scale))
    return rows


def bench_mf4(frames: Frames, path: Path, effort: Effort) -> Row:
    """An MF4 log to columns, beside a process in which asammdf reads it and no more. Wall time."""
    import asammdf

    names = "BusChannel", "ID", "IDE", "DLC", "DataLength", "DataBytes"
    kinds = "u1", "<u4", "u1", "u1", "u1", "(64,)u1"  # as python-can writes them, if by the frame
    fields = [(f"CAN_DataFrame.{name}", kind) for name, kind in zip(names, kinds, strict=True)]
    samples = np.zeros(len(frames), fields)
    samples["CAN_DataFrame.ID"] = frames.can_id
    samples["CAN_DataFrame.DLC"] = samples["CAN_DataFrame.DataLength"] = frames.length
    samples["CAN_DataFrame.DataBytes"][:, :8] = frames.word.view(np.uint8).reshape(-1, 8)
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(asammdf.Signal(samples, (frames.t_ns - frames.t_ns[0]) / S, name="CAN_DataFrame"))
        mdf.save(path, compression=2)

    def read() -> int:
        with open_log(path) as log:
            return sum(map(len, log.chunks()))

    code = "import sys, asammdf; print(len(asammdf.MDF(sys.argv[1]).get('CAN_DataFrame', 0, raw=True).samples))"

    def read_by_asammdf() -> int:
        done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, check=True)
        return int(done.stdout)

    assert read() == read_by_asammdf() == len(frames)
    once = effort._replace(rounds=max(2, effort.log_rounds), turns=1)
    words, scale = ("mf4, wall", "us/frame", "asammdf"), 1e6 / len(frames)
    return compared(*words, ours=read, peer=read_by_asammdf, effort=once, scale=scale, timer=time.perf_counter)


def bench_log(kind: str, frames: Frames, folder: Path, rounds: int) -> list[Row]:
    log, part, dbc = folder / "whole.log", folder / "part.log", folder / "car.dbc"
    few = frames.head(_PEER_FRAMES)
    write(frames, log)
    write(few, part)
    dbc.write_text(cantools_database().as_dbc_string(), encoding="cp1252")  # cantools' command line takes one file
    assert _decoded(part) == _decoded_by_cantools(part, dbc), f"{kind}: cantools prints other lines"
    works: dict[str, tuple[Work, Frames]] = {
        "cantools": (lambda: _decoded_by_cantools(part, dbc), few),
        "decode": (lambda: _decoded(log, None), frames),
        "values": (lambda: _values(log), frames),
        "check": (lambda: _fsai_vcu("check", log), frames),
        "stats": (lambda: _fsai_vcu("check", "--figures", log), frames),
        # Last those after which the machine goes on writing to the disk for a while.
        "parquet": (lambda: _exported("parquet", log, folder), frames),
        "mcap": (lambda: _exported("mcap", log, folder), frames),
    }
    rounds_us = [[timeit(work, number=1) * 1e6 / len(read) for work, read in works.values()] for _ in range(rounds)]
    peer, *ours = zip(*rounds_us, strict=True)
    return [
        row(f"{what} {kind}, wall", "us/frame", times, "cantools decode", peer)
        for what, times in zip(list(works)[1:], ours, strict=True)
    ]


def random_frames(count: int, _: Path) -> Frames:
    """Payloads at random of every message of the revision."""
    chance = np.random.default_rng(1)
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


def write(frames: Frames, path: Path) -> None:
    with path.open("wb") as file:
        for rows in np.array_split(np.arange(len(frames)), _PARTS):
            file.write(b"\n".join([*log_lines(frames.only(rows)), b""]))


def _decoded(log: Path, out: int | None = subprocess.PIPE) -> bytes:
    return _fsai_vcu("decode", log, "--revision", REVISION, out=out)


def _decoded_by_cantools(log: Path, dbc: Path) -> bytes:
    with log.open("rb") as source:
        code = f"{_LEAN}import cantools; cantools._main()"
        command = [sys.executable, "-c", code, "decode", "--single-line", str(dbc)]
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


# ---------------------------------------------------------------- lockstep


def bench_missions(effort: Effort) -> list[Row]:
    """How many times faster than real time a whole mission is driven. Raises AssertionError where it does not pass."""
    return [row(f"drive {name}", SPEED, *_driven(name, effort.drives)) for name in effort.missions]


def _driven(mission: str, drives: int) -> tuple[list[float], str, list[float]]:
    """The speed of each drive, and beside it the seconds of a loop that is the same in every version."""
    speeds, loops_s = [], []
    laps = TRACKDRIVE_LAPS if mission == "trackdrive" else None
    for _ in range(drives):
        lockstep = Lockstep(WorldSetup(missions=[mission_named(mission)], laps=laps))
        loops_s.append(timeit(_fixed_loop, timer=time.process_time, number=1))
        began = time.process_time()
        done = lockstep.run()
        speeds.append(done.sim_time_s / (time.process_time() - began))
        assert done.passed, f"{mission}: {done.verdict.reasons}"
    return speeds, "a fixed loop (ratio: seconds driven in its time)", loops_s


def _fixed_loop() -> None:
    """What a drive is made of: objects, dictionaries, numbers of Python, and small arrays."""
    points, seen = np.linspace(0.0, 20.0, 60), {}
    for number in range(60_000):
        seen[number % 97] = (number, str(number), [step * 0.5 for step in range(8)])
        if number % 5 == 0:
            np.hypot(points - number, points).argmin()


# ---------------------------------------------------------------- starting

_LEAN = "import sys; sys.modules['asammdf'] = None\n"  # python-can alone: here asammdf would triple a peer's start
_PEER_START = "import can, cantools"
_PEER_NODE = "import rclpy"
_OUR_START = f"""
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.messages import AiCommand
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime.loop import BridgeLoop
codec = Codec(revision("{REVISION}"))
bridge = Bridge(codec, revision("{REVISION}"), CARS["{REVISION}"], BridgeConfig(), None, now_ns=0)
bridge.cycle(0)
codec.encode_command(AiCommand())
"""


def bench_start(effort: Effort) -> Row:
    """A process that could send its first frame now, with database and bridge; and one with the libraries alone."""
    words = "start to a first frame", "s", _PEER_START
    once = effort._replace(rounds=effort.starts, turns=1)
    works = {"ours": partial(_python, _OUR_START), "peer": partial(_python, _LEAN + _PEER_START)}
    return compared(*words, **works, effort=once, scale=1.0, timer=_children_s)


def _python(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True)


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def bench_node(effort: Effort) -> Row:
    """From exec to the first frame of the bridge node as the car starts it, on a loopback bus with nobody else on it.

    Its processor time, and beside it what any node takes before its first line. Raises AssertionError where no frame
    comes.
    """
    processor_s, peer_s = [], []
    _python(_PEER_NODE)
    name = f"loopback:bench-node-{os.getpid()}"
    with tempfile.TemporaryDirectory() as folder, open_bus(name) as bus:
        configuration = Path(folder) / "fsai.toml"
        configuration.write_text(f"[ros]\ndomain_id = {1 + os.getpid() % 100}\n", encoding="utf-8")
        argv = [sys.executable, "-m", "fsai_nodes.vcu_bridge", "--config", str(configuration), "--interface", name]
        for _ in range(effort.starts):
            peer_s.append(timeit(partial(_python, _PEER_NODE), timer=_children_s, number=1))
            began = time.monotonic()
            node = RunningProcess("vcu_bridge", argv, Path(folder) / "vcu_bridge.log", os.environ)
            try:
                while bus.recv(0.1) is None:
                    waited_s = time.monotonic() - began
                    assert node.alive and waited_s < _NODE_PATIENCE_S, (
                        f"no frame of vcu_bridge: {node.last_words(1).strip()}"
                    )
                # The edge, and the process of its loop.
                processor_s.append(sum(_processor_s(pid) for pid in (node.popen.pid, holder_pid(name)) if pid))
            finally:
                node.stop()
            while bus.recv(0.0) is not None:
                pass  # the last of this one are not the first of the next
    return row(NODE_START, "s", processor_s, _PEER_NODE, peer_s)


def _processor_s(pid: int) -> float:
    """Processor time of a process so far, to 10 ms (proc(5): utime and stime)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def too_slow(rows: Sequence[Row]) -> str | None:
    """What is wrong with the one figure that is judged, by the quickest start: others are held up by other programs."""
    least_s = next((each["ours"]["least"] for each in rows if each["name"] == NODE_START), 0.0)
    if least_s <= NODE_START_S:
        return None
    return f"{NODE_START}: {least_s:.3g} s of processor time to its first frame, more than {NODE_START_S:g} s"


# ---------------------------------------------------------------- table and command


def run(effort: Effort) -> list[Row]:
    codec, database = Codec(revision(REVISION)), cantools_database()
    ros = all(find_spec(name) for name in ("rclpy", "fsai_msgs", "fsai_nodes"))
    steps: tuple[tuple[str, Callable[[], list[Row]]], ...] = (
        ("decoding", lambda: [bench_decode(codec, database, effort)]),
        ("encoding", lambda: [bench_encode(codec, database, effort)]),
        ("answering on the loopback bus", lambda: [bench_answer(codec, database, effort)]),
        ("starting processes", lambda: [bench_start(effort)]),
        ("starting the bridge node", lambda: [bench_node(effort)])
        if ros
        else ("not measured: the bridge node; ROS 2 is not in this environment", list),
        (f"reading logs of {effort.log_frames} frames", lambda: bench_logs(effort)),
        ("driving in lockstep", lambda: bench_missions(effort)),
    )
    rows: list[Row] = []
    for number, (words, step) in enumerate(steps, start=1):
        print(f"[{number}/{len(steps)}] {words}", flush=True)
        rows += step()
    return rows


def table(rows: Sequence[Row]) -> str:
    lines = [f"{'what':<24}{'unit':<12}{'ours':>24}{'peer':>24}{'peer / ours':>24}  peer is"]
    for each in rows:
        figures = "".join(f"{_words(each[figure]):>24}" for figure in ("ours", "peer", "ratio"))
        lines.append(f"{each['name']:<24}{each['unit']:<12}{figures}  {each['peer_name']}".rstrip())
    lines.append("median (quickest to slowest round), of processor time where not wall time")
    return "\n".join(lines)


def _words(figure: dict[str, float] | None) -> str:
    if figure is None:
        return "-"
    least, most = figure["least"], figure["most"]
    return f"{figure['median']:.3g}" + (f" ({least:.3g} to {most:.3g})" if least != most else "")


def compare(rows: Sequence[Row], baseline: dict[str, Any], here: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Each ratio beside the baseline's, a line for each; and the names of those that fell by more than their noise."""
    before = {each["name"]: each["ratio"] for each in baseline["results"]}
    processors = baseline["machine"]["processors"]
    lines, fell = [f"{'ratio':<24}{'baseline':>10}{'now':>10}{'change':>9}{'noise':>9}"], []
    for name, now in ((each["name"], each["ratio"]) for each in rows if each["name"] in before):
        was = before[name]
        change = now["median"] / was["median"] - 1
        noise = BETWEEN_RUNS + sum((each["most"] - each["least"]) / 2 / each["median"] for each in (now, was))
        words = f"{name:<24}{was['median']:>10.3g}{now['median']:>10.3g}{change:>9.0%}{noise:>9.0%}"
        if name.endswith(", wall") and here["processors"] != processors:
            words += f"  not judged: {here['processors']} processors, and {processors} in the baseline"
        elif noise > TOO_NOISY:
            words += "  not judged: too noisy"
        elif change < -noise:
            words += "  FELL"
            fell.append(name)
        lines.append(words)
    return lines, fell


def parsed(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="fsai_hil.rehearsal.bench",
        description="How fast: codec, answer, logs, start and whole missions, as ratios to what others take.",
        epilog="example:\n  python -m fsai_hil.rehearsal.bench --quick -o out/bench",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--quick", action="store_true", help="a quarter of a minute, more spread, the start is not judged"
    )
    parser.add_argument("--check", action="store_true", help="fail where a ratio fell by more than its noise")
    parser.add_argument("--write", action="store_true", help="let this run be what --check compares with")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("out/bench"), metavar="DIR", help="folder for bench.json"
    )
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    args = parsed(argv)
    here = machine()
    print(f"{here['processor']} x {here['processors']}, {here['kernel']}, Python {here['python']}", flush=True)
    if args.quick and (args.check or args.write):
        return complain("--quick is too short to be compared: without --check and --write", 2)
    if args.check and not args.write and not BASELINE.exists():
        return complain(f"there is no {BASELINE}; this makes one: make bench-check ARGS=--write")
    began = time.monotonic()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        baseline = json.loads(BASELINE.read_text("utf-8")) if args.check and not args.write else None
        rows = run(QUICK if args.quick else FULL)
        whole = {
            **facts(CHECKOUT),
            "quick": args.quick,
            "time": "processor time, user and kernel",
            "seconds": round(time.monotonic() - began, 1),
            "machine": here,
            "results": rows,
        }
        saved = [args.out / "bench.json", *[BASELINE] * args.write]
        for path in saved:
            path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    except AssertionError as error:
        return complain(f"nothing to compare: {error}")
    except json.JSONDecodeError as error:
        return complain(f"{BASELINE}: {error}; this makes it again: make bench-check ARGS=--write")
    except OSError as error:
        return complain(f"{error.filename or args.out}: {error.strerror}")
    except KeyboardInterrupt:
        return complain("interrupted", 130)
    print(f"\n{table(rows)}\nsaved {' and '.join(map(str, saved))}")
    problems = [] if args.quick else [words for words in (too_slow(rows),) if words]
    if baseline:
        lines, fell = compare(rows, baseline, here)
        print("", *lines, sep="\n")
        absent = {each["name"] for each in baseline["results"]} - {each["name"] for each in rows}
        if absent:
            problems.append(f"in {BASELINE}, and not measured: {', '.join(sorted(absent))}")
        if fell:
            problems.append(f"slower than in {BASELINE}, by more than the noise: {', '.join(fell)}")
    return complain("; ".join(problems)) if problems else 0


def complain(words: str, status: int = 1) -> int:
    print(f"fsai_hil.rehearsal.bench: {words}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
