"""Runs as they are recorded, and driven once more against a bridge of today."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rerun import rerun

from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.diagnostics.log.reader import read_log
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime.recording import CandumpWriter


@dataclass(frozen=True)
class Recorded:
    """A run as it is on the disk, and the commands of it."""

    frames: list[Frame]
    commands: list[tuple[int, VehicleCommand]]
    revision: str
    end_ns: int

    def again(self, config: BridgeConfig | None = None) -> list[Frame]:
        chosen = revision(self.revision)
        codec = Codec(chosen)
        bridge = Bridge(codec, chosen, CARS[self.revision], config or BridgeConfig())
        car = [frame for frame in self.frames if frame.can_id not in AI_IDS]
        return rerun(bridge, codec, self.commands, car, 0, self.end_ns)


def record(
    path: Path, setup: WorldSetup, *, silent_from_ns: int | None = None, until_ns: int | None = None
) -> Recorded:
    """Drive and record, to the end or `until_ns`; from `silent_from_ns` on the controller's commands are lost."""
    commands: list[tuple[int, VehicleCommand]] = []

    def tap(command: VehicleCommand, now_ns: int) -> VehicleCommand | None:
        if silent_from_ns is not None and now_ns >= silent_from_ns:
            return None
        commands.append((now_ns, command))
        return command

    with CandumpWriter(path, "vcan0") as writer:
        lockstep = Lockstep(setup, on_frame=writer.write)
        lockstep.computer.command_filter = tap
        while not lockstep.world.done and (until_ns is None or lockstep.now_ns < until_ns):
            lockstep.step()
    return Recorded(read_frames(path), commands, setup.revision, lockstep.now_ns)


def read_frames(path: Path) -> list[Frame]:
    """The frames of a log that is wholly readable."""
    frames, problems = read_log(path)
    assert not problems
    return [Frame(frame.can_id, frame.data, frame.t_ns, frame.extended) for frame in frames]
