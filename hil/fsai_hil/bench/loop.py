"""The CAN loop beside cantools and python-can: codec, the answer to a 0x520, a node's start, and missions driven."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import can
import numpy as np
from cantools.database.can import Database

from fsai_hil.bench.rows import Ratio, in_turns, timed
from fsai_hil.rehearsal.stack import RunningProcess
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import World, WorldSetup, mission_named
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
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
ROUNDS, TURNS = 15, 2000  # of a comparison; in each of its rounds
STARTS = 7  # of a process
MISSIONS, DRIVES = ("acceleration", "skidpad", "autocross", "trackdrive"), 2
NODE_START = "start bridge node"
NODE_START_S = 1.0  # of a normal machine, as carpc/scenes.py has it
NODE_PATIENCE_S = 60.0  # of a loaded machine
COMMAND = AiCommand(True, False, MissionStatus.RUNNING, Direction.FORWARD, steer_deg=-7.3, rear_torque_nm=81.5)
PEER_NODE = "import rclpy"


def cantools_database() -> Database:
    """Return the revision's files as anybody would load them."""
    database = Database()
    for name in revision(REVISION).dbc_files:
        database.add_dbc_file(str(dbc_dir() / name))
    return database


def codec_rows() -> list[Ratio]:
    """Decode frames of a car that comes up, encode a command, answer a 0x520 with five frames.

    Both answers go over the loopback bus: the product's is supervised and limited, the peer's is not.
    """
    codec = Codec(revision(REVISION))
    database: Any = cantools_database()
    read = partial(database.decode_message, decode_choices=False)
    sent = World(WorldSetup(missions=[Ami.TRACKDRIVE], revision=REVISION)).advance(5 * S)
    frames = [frame for frame in sent if frame.can_id in VCU_IDS][-20 * len(VCU_IDS) :]
    values = [(frame.can_id, read(frame.can_id, frame.data)) for frame in codec.encode_command(COMMAND)]
    status = codec.encode(VcuStatus(as_state=AsState.AS_OFF))

    def answer_by_cantools() -> None:
        received = read(status.can_id, status.data)
        for can_id, signals in values:
            if can_id == AI_IDS[0]:
                signals = {**signals, "HANDSHAKE": received["HANDSHAKE"]}
            data = database.encode_message(can_id, signals)
            plain.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    read_all = partial(_each, codec.decode, [(frame,) for frame in frames])
    read_by_cantools = partial(_each, read, [(frame.can_id, frame.data) for frame in frames])
    encode, encode_by_cantools = partial(codec.encode_command, COMMAND), partial(_each, database.encode_message, values)
    with (
        answering() as (turn, bridge),
        can.Bus(interface="fsai_loopback", channel=f"bench-{os.getpid()}-peer") as plain,
    ):
        before, found = bridge.tally.cycles, []
        for name, unit, of, ours, peer_name, peer in (
            ("decode a frame", "us/frame", len(frames), read_all, "cantools", read_by_cantools),
            ("encode a frame", "us/frame", len(values), encode, "cantools", encode_by_cantools),
            ("answer a 0x520", "us/cycle", 1, turn, "cantools + python-can", answer_by_cantools),
        ):
            took = partial(timed, scale=1e6, turns=TURNS // (20 if of == len(frames) else 1), of=of)
            found += in_turns(unit, ROUNDS, (peer_name, took(peer)), (name, took(ours)), cold=1)
        assert bridge.tally.cycles - before >= ROUNDS * TURNS, "not every 0x520 was answered"
    return found


def _each(call: Callable[..., object], arguments: Sequence[tuple[Any, ...]]) -> None:
    for one in arguments:
        call(*one)


@contextmanager
def answering() -> Iterator[tuple[Callable[[], None], Bridge]]:
    """Yield a turn that answers one 0x520 on a loopback bus, past the time in which a bridge only listens."""
    codec = Codec(revision(REVISION))
    statuses = [codec.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)) for bit in (False, True)]
    with open_bus(f"loopback:bench-{os.getpid()}", may_send=AI_IDS) as bus:
        bridge = Bridge(codec, revision(REVISION), CARS[REVISION], BridgeConfig(), None, now_ns=0)
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


def _children_s() -> float:
    return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])  # user and kernel


def node_rows() -> list[Ratio]:
    """Start the bridge node as the car does, from exec to its first frame, on a loopback bus of its own.

    Beside it is what any node takes before its first line. Raises AssertionError where no frame comes.
    """
    name = f"loopback:bench-node-{os.getpid()}"
    with tempfile.TemporaryDirectory() as folder, open_bus(name) as bus:
        configuration = Path(folder) / "fsai.toml"
        configuration.write_text(f"[ros]\ndomain_id = {1 + os.getpid() % 100}\n", encoding="utf-8")
        argv = [sys.executable, "-m", "fsai_nodes.vcu_bridge", "--config", str(configuration), "--interface", name]

        def started_s() -> float:
            while bus.recv(0.0) is not None:
                pass  # the last frames of one node are not the first of the next
            began_s = time.monotonic()
            node = RunningProcess("vcu_bridge", argv, Path(folder) / "vcu_bridge.log", os.environ)
            try:
                while bus.recv(0.1) is None:
                    in_time = node.alive and time.monotonic() - began_s < NODE_PATIENCE_S
                    assert in_time, f"no frame of vcu_bridge: {node.last_words(1).strip()}"
                # The edge, and the process of its loop.
                return sum(_processor_s(pid) for pid in (node.popen.pid, holder_pid(name)) if pid)
            finally:
                node.stop()

        peer = partial(subprocess.run, [sys.executable, "-c", PEER_NODE], check=True)
        peer()
        return in_turns("s", STARTS, (PEER_NODE, timed(peer, 1.0, timer=_children_s)), (NODE_START, started_s))


def _processor_s(pid: int) -> float:
    """Return the processor time of a process so far, to 10 ms (proc(5): utime and stime)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def mission_rows() -> list[Ratio]:
    """Drive whole missions in lockstep, beside a loop that is the same in every version.

    The unit is the mission: by the second driven, a car that is sooner at its end would count as slower software.
    Raises AssertionError where a mission does not pass.
    """

    def drive(mission: str) -> None:
        laps = 1 if mission == "trackdrive" else None
        done = Lockstep(WorldSetup(missions=[mission_named(mission)], laps=laps)).run()
        assert done.passed, f"{mission}: {done.verdict.reasons}"

    peer = ("a fixed loop", timed(_fixed_loop, 1.0))
    works = [(f"drive {mission}", timed(partial(drive, mission), 1.0)) for mission in MISSIONS]
    return [row for work in works for row in in_turns("s", DRIVES, peer, work)]


def _fixed_loop() -> None:
    """Do what a drive is made of: objects, dictionaries, numbers of Python, and small arrays."""
    points, seen = np.linspace(0.0, 20.0, 60), {}
    for number in range(60_000):
        seen[number % 97] = (number, str(number), [step * 0.5 for step in range(8)])
        if number % 5 == 0:
            np.hypot(points - number, points).argmin()


if __name__ == "__main__":  # what `make profile` looks at
    with answering() as (answer, _):
        for _number in range(60_000):
            answer()
