"""A recorded run, driven once more against a bridge of today, gives the same decisions.

The run is driven in lockstep and recorded as `fsai-vcu drive --log` does. From the log a fresh bridge hears the car's
frames, and from the run the commands that the controller gave. Compared is everything that the AI computer says: its
five messages, every byte, at the same instants: AI_STATUS (mission status, direction, handshake, ESTOP_REQUEST),
steering, torque, motor speed limits, brake, laps and cones.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from recorded_runs import Recorded, record
from rerun import compare

from fsai_hil.simulator.tracks import load_track
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS


@pytest.fixture(scope="module")
def silenced(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A run in which the controller falls silent at speed: a service-brake stop, and FINISHED at rest."""
    path = tmp_path_factory.mktemp("run") / "run.log"
    setup = WorldSetup(missions=[Ami.ACCELERATION], gps=False, revision="2021")
    return record(path, setup, silent_from_ns=19_500 * MS)


def test_a_whole_mission_is_decided_in_the_same_way_to_the_last_byte(tmp_path: Path) -> None:
    driven = record(tmp_path / "run.log", WorldSetup(missions=[Ami.ACCELERATION]))
    statuses = [frame.data[1] >> 4 & 0x3 for frame in driven.frames if frame.can_id == 0x510]
    assert statuses[-1] == 3, "FINISHED belongs to a whole mission"
    comparison = compare(driven.frames, driven.again())
    assert comparison.equal, "\n".join(map(str, comparison.differences[:10]))
    assert set(comparison.same) == set(AI_IDS)
    assert min(comparison.same.values()) > 1000, "the run is too short to show anything"


def test_bends_are_decided_in_the_same_way_to_the_last_byte(tmp_path: Path) -> None:
    setup = WorldSetup(missions=[Ami.AUTOCROSS], track=load_track("small_oval"), gps=False)
    driven = record(tmp_path / "run.log", setup, until_ns=20_000 * MS)
    asked = {frame.data for frame in driven.frames if frame.can_id == 0x513}
    assert len(asked) > 50, "nothing was steered"
    comparison = compare(driven.frames, driven.again())
    assert comparison.equal, "\n".join(map(str, comparison.differences[:10]))


def test_a_run_that_a_fault_ended_is_decided_in_the_same_way(silenced: Recorded) -> None:
    comparison = compare(silenced.frames, silenced.again())
    assert comparison.equal, "\n".join(map(str, comparison.differences[:10]))


def test_a_bridge_that_decides_otherwise_is_noticed(silenced: Recorded) -> None:
    comparison = compare(silenced.frames, silenced.again(replace(BridgeConfig(), stop_brake_pct=41.0)))
    assert {difference.can_id for difference in comparison.differences} == {0x514}
    assert "0x514: then " in str(comparison.differences[0])


def test_what_the_car_says_is_what_decides(silenced: Recorded) -> None:
    without_go = [
        replace(frame, data=bytes([frame.data[0], frame.data[1] & ~0x08, *frame.data[2:]]))
        if frame.can_id == 0x520
        else frame
        for frame in silenced.frames
    ]
    assert not compare(silenced.frames, replace(silenced, frames=without_go).again()).equal
