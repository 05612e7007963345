"""A run of long ago, kept with the project: the bridge still decides as it did then, byte for byte.

A mission from power-up through bends at speed, where the controller falls silent: a service-brake stop, and FINISHED
at rest. In virtual time and without a bus a bridge of today receives the car's frames and the controller's commands
from the disk, at the instants of then: neither the simulated car nor planner and controller of today have a part in
it. A deliberate change of the bridge's decisions makes the run again:

    python tests/diagnostics/test_golden_run.py
"""

from __future__ import annotations

import gzip
import json
import tempfile
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import pytest
from msgspec.structs import astuple

from fsai_hil.simulator.ai_computer import OnboardComputer
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.tracks import load_track
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.driving import Run
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.diagnostics.log.reader import read_log
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS
from fsai_vcu.runtime.recording import CandumpWriter

LOG = Path(__file__).parent / "golden" / "bends.log.gz"
COMMANDS = LOG.with_name("bends.commands.gz")
REVISION = "2026"
SILENT_FROM_NS = 26_000 * MS
STEP_NS = 1 * MS  # how often the clock is looked at: as in the lockstep simulation, whose logs are exact to the byte

Sent = dict[tuple[int, int], bytes]  # the payload by time and id


class RecordedCommands:
    """In the place of planner and controller: confirms every run, and commands what was commanded then."""

    def __init__(self, commands: Sequence[tuple[int, VehicleCommand]]) -> None:
        """(when it was given, command), in order of time."""
        self._given = deque(commands)

    def reset(self, run: Run) -> None:
        """Nothing is remembered."""

    on_run = reset

    def on_cones(self, *seen: object) -> None:
        """Cones were seen then: what came of them is in the commands."""

    def command(self, *seen: Any) -> VehicleCommand:
        """As a controller is asked, with the run and the instant last; `given` decides what becomes of it."""
        return VehicleCommand(seen[-1], seen[-2].run_id)

    def given(self, command: VehicleCommand, now_ns: int) -> VehicleCommand | None:
        """What was commanded by now and has not been passed on; None where there was silence."""
        newest = None
        while self._given and self._given[0][0] <= now_ns:
            newest = self._given.popleft()[1]
        return newest


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    found, problems = read_log(LOG)
    assert not problems
    return [Frame(frame.can_id, frame.data, frame.t_ns, frame.extended) for frame in found]


def sent(frames: Sequence[Frame]) -> Sent:
    return {(frame.t_ns, frame.can_id): frame.data for frame in frames if frame.can_id in AI_IDS}


def again(frames: Sequence[Frame]) -> Sent:
    """What a bridge of today sends while it receives the car's frames and the commands of then."""
    with gzip.open(COMMANDS, "rt", encoding="ascii") as file:
        given = [json.loads(line) for line in file]
    stack = RecordedCommands([(now_ns, VehicleCommand(*fields)) for now_ns, *fields in given])
    chosen = revision(REVISION)
    codec = Codec(chosen)
    bridge = Bridge(codec, chosen, CARS[REVISION], BridgeConfig())
    computer = OnboardComputer(bridge, codec, cast(Planner, stack), cast(Controller, stack), 0)
    computer.command_filter = stack.given
    car = deque(frame for frame in frames if frame.can_id not in AI_IDS)
    answers: list[Frame] = []
    autonomous = False
    for now_ns in range(STEP_NS, frames[-1].t_ns + 1, STEP_NS):
        while car and car[0].t_ns <= now_ns:
            computer.on_frames([car.popleft()])
        autonomous = autonomous or bridge.set_mode("autonomous", now_ns)[0]
        answers += computer.advance(now_ns)
    return sent(answers)


def differences(then: Sent, now: Sent) -> list[tuple[int, int]]:
    return sorted(key for key in then.keys() | now.keys() if then.get(key) != now.get(key))


def test_the_bridge_decides_as_it_did_when_the_run_was_recorded(frames: list[Frame]) -> None:
    then, now = sent(frames), again(frames)
    assert [(key, then.get(key), now.get(key)) for key in differences(then, now)][:10] == []
    assert {can_id for _, can_id in then} == set(AI_IDS)
    otherwise = {**now, min(now): b"another payload"}
    assert differences(then, otherwise) == [min(now)], "a bridge that decides otherwise is noticed"


def test_the_run_has_a_whole_mission_in_it(frames: list[Frame]) -> None:
    statuses = [frame.data[1] >> 4 & 0x3 for frame in frames if frame.can_id == 0x510]
    assert [status for status, before in zip(statuses, [None, *statuses], strict=False) if status != before] == [
        MissionStatus.NOT_SELECTED,
        MissionStatus.SELECTED,
        MissionStatus.RUNNING,
        MissionStatus.FINISHED,
    ]
    for can_id in (0x512, 0x513, 0x514):
        asked = {frame.data for frame in frames if frame.can_id == can_id}
        assert len(asked) > 20, f"little was asked for in 0x{can_id:03X}"


def make() -> None:
    """Drive the run again, and keep it; from SILENT_FROM_NS on the controller's commands are lost."""
    commands: list[tuple[int, VehicleCommand]] = []

    def tap(command: VehicleCommand, now_ns: int) -> VehicleCommand | None:
        if now_ns >= SILENT_FROM_NS:
            return None
        commands.append((now_ns, command))
        return command

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.log"
        setup = WorldSetup(missions=[Ami.AUTOCROSS], track=load_track("small_oval"), gps=False, revision=REVISION)
        with CandumpWriter(path, "vcan0") as writer:
            lockstep = Lockstep(setup, on_frame=writer.write)
            lockstep.computer.command_filter = tap
            while not lockstep.world.done:
                lockstep.step()
        log = path.read_bytes()
    lines = "".join(json.dumps([now_ns, *astuple(command)]) + "\n" for now_ns, command in commands).encode()
    for file, content in ((LOG, log), (COMMANDS, lines)):
        file.write_bytes(gzip.compress(content, mtime=0))
        print(f"{file}: {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    make()
