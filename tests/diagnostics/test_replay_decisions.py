"""A recorded run, driven once more against a bridge of today, gives the same decisions.

The run is driven in lockstep and recorded as `fsai-vcu drive --log` does. From the log a fresh bridge hears the car's
frames, and from the run the commands that the controller gave. Compared is everything that the AI computer says: its
five messages, every byte, at the same instants: AI_STATUS (mission status, direction, handshake, ESTOP_REQUEST),
steering, torque, motor speed limits, brake, laps and cones.
"""

from __future__ import annotations

from pathlib import Path

from recorded_runs import record
from rerun import compare

from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.reserved import AI_IDS


def test_a_replayed_mission_is_decided_the_same_to_the_byte(tmp_path: Path) -> None:
    driven = record(tmp_path / "run.log", WorldSetup(missions=[Ami.ACCELERATION]))
    statuses = [frame.data[1] >> 4 & 0x3 for frame in driven.frames if frame.can_id == 0x510]
    assert statuses[-1] == 3, "FINISHED belongs to a whole mission"
    comparison = compare(driven.frames, driven.again())
    assert comparison.equal, "\n".join(map(str, comparison.differences[:10]))
    assert set(comparison.same) == set(AI_IDS)
    assert min(comparison.same.values()) > 1000, "the run is too short to show anything"
