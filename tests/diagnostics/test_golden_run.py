"""A run of long ago, kept with the project: the bridge still decides as it did then, byte for byte.

A mission from power-up through bends at speed, where the controller falls silent: a service-brake stop, and FINISHED
at rest. The car's frames and the controller's commands are read from the disk: neither the simulated car nor planner
and controller of today have a part in it. A deliberate change of the bridge's decisions makes the run anew:

    python tests/diagnostics/test_golden_run.py
"""

from __future__ import annotations

import gzip
import json
import tempfile
from dataclasses import astuple, replace
from pathlib import Path

import pytest
from recorded_runs import Recorded, read_frames, record
from rerun import compare

from fsai_hil.simulator.tracks import load_track
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.enums import Ami, MissionStatus
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS

LOG = Path(__file__).parent / "golden" / "bends.log.gz"
COMMANDS = LOG.with_name("bends.commands.gz")
REVISION = "2026"
SILENT_FROM_NS = 26_000 * MS


@pytest.fixture(scope="module")
def golden() -> Recorded:
    with gzip.open(COMMANDS, "rt", encoding="ascii") as file:
        given = [json.loads(line) for line in file]
    commands = [(now_ns, VehicleCommand(*fields)) for now_ns, *fields in given]
    frames = read_frames(LOG)
    return Recorded(frames, commands, REVISION, frames[-1].t_ns)


def test_the_bridge_decides_as_it_did_when_the_run_was_recorded(golden: Recorded) -> None:
    comparison = compare(golden.frames, golden.again())
    assert comparison.equal, "\n".join(map(str, comparison.differences[:10]))
    assert set(comparison.same) == set(AI_IDS)


def test_the_run_has_a_whole_mission_in_it(golden: Recorded) -> None:
    statuses = [frame.data[1] >> 4 & 0x3 for frame in golden.frames if frame.can_id == 0x510]
    assert [status for status, before in zip(statuses, [None, *statuses], strict=False) if status != before] == [
        MissionStatus.NOT_SELECTED,
        MissionStatus.SELECTED,
        MissionStatus.RUNNING,
        MissionStatus.FINISHED,
    ]
    for can_id in (0x512, 0x513, 0x514):
        asked = {frame.data for frame in golden.frames if frame.can_id == can_id}
        assert len(asked) > 20, f"little was asked for in 0x{can_id:03X}"


def test_a_bridge_that_decides_otherwise_is_noticed(golden: Recorded) -> None:
    differences = compare(golden.frames, golden.again(replace(BridgeConfig(), stop_brake_pct=41.0))).differences
    assert {difference.can_id for difference in differences} == {0x514}
    assert "0x514: then " in str(differences[0])


def test_what_the_car_says_is_what_decides(golden: Recorded) -> None:
    without_go = [
        replace(frame, data=bytes([frame.data[0], frame.data[1] & ~0x08, *frame.data[2:]]))
        if frame.can_id == 0x520
        else frame
        for frame in golden.frames
    ]
    assert not compare(golden.frames, replace(golden, frames=without_go).again()).equal


def make() -> None:
    """Drive the run anew, and keep it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.log"
        setup = WorldSetup(missions=[Ami.AUTOCROSS], track=load_track("small_oval"), gps=False, revision=REVISION)
        run = record(path, setup, silent_from_ns=SILENT_FROM_NS)
        log = path.read_bytes()
    commands = "".join(json.dumps([now_ns, *astuple(command)]) + "\n" for now_ns, command in run.commands).encode()
    for file, content in ((LOG, log), (COMMANDS, commands)):
        file.write_bytes(gzip.compress(content, mtime=0))
        print(f"{file}: {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    make()
