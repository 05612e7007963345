"""Missions on a real bus, from power-up to finish.

After each run the bus log is checked against the rules that can be seen on the wire.
"""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import pytest

from chain.conftest import CODEC, DRIVE_S, MISSION, OWN, POWER_UP_S, START_S, STOP_S, Chain
from fsai_hil.rehearsal.soak import Sampler, judge, response_parts
from fsai_hil.rehearsal.stack import NODES
from fsai_hil.rules.checker import check_candump, checker_for, read_candump
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.reserved import AI_IDS, RESERVED_IDS
from fsai_vcu.interface.revisions import revision

SAMPLED_S = 0.5
OTHER_REVISION = "2021"


def test_every_node_topic_and_service_has_its_name(chain: Chain) -> None:
    node = chain.operator.node
    expected = {
        "/raw_cones": "fsai_msgs/msg/ConeArray",
        "/detected_cones": "fsai_msgs/msg/ConeArray",
        "/path": "nav_msgs/msg/Path",
        "/vehicle_cmd": "fsai_msgs/msg/VehicleCommand",
    }

    def complete() -> bool:
        names = {name for name, _ in node.get_node_names_and_namespaces()}
        topics = dict(node.get_topic_names_and_types())
        return set(NODES) <= names and all(topics.get(topic) == [kind] for topic, kind in expected.items())

    chain.operator.await_that(complete, START_S, "all nodes and topics are there", *NODES)
    for name in NODES:  # with --with a program of one's own
        started = Path(f"/proc/{chain.stack.processes[name].popen.pid}/cmdline").read_text().split("\0")
        assert OWN.get(name, f"fsai_nodes.{name}") in started
    services = dict(node.get_service_names_and_types())
    assert services["/set_mode"] == ["fsai_msgs/srv/SetMode"]
    assert "/emergency_brake" in services and "/reset" in services


def test_power_up_mission_set_mode_go_a_lap_and_finished(chain: Chain) -> None:
    pids = chain.pids
    with chain.car("lap", "--mission", "autocross") as run:
        chain.autonomous()
        chain.operator.await_state(lambda s: s.as_state == AsState.AS_DRIVING, POWER_UP_S, "AS_DRIVING")
        began_ns = time.time_ns()
        with Sampler(pids, SAMPLED_S) as sampler:
            result = chain.operator.run_mission("autocross", "end", DRIVE_S, None, *NODES)
        status = run.vcu.wait(STOP_S)
    verdict = run.verdict()
    assert verdict["result"] == "pass", verdict["reasons"]
    assert status == 0
    assert result.success and result.as_state == "AS_FINISHED", result.message
    assert (verdict["laps"], verdict["off_course"]) == (1, 0)
    frames = list(read_candump(run.log_path))
    wire = checker_for(CODEC, busy_machine=True)
    wire.on_frames(frames)
    assert wire.ok, wire
    states = [state.label for _, state in wire.as_states]
    assert states[-4:] == ["AS_OFF", "AS_READY", "AS_DRIVING", "AS_FINISHED"]
    no_reserved_id_and_every_handshake([(frame.can_id, frame.data) for frame in frames])
    # The short form of `fsai-vcu hil --soak`; it counts from the drive on, for nodes that have driven before.
    flatness = judge(sampler.samples, response_parts(run.log_path, CODEC, began_ns))
    assert flatness.flat, str(flatness)


def no_reserved_id_and_every_handshake(frames: list[tuple[int, bytes]]) -> None:
    """What the log of a lap holds."""
    ids = {frame_id for frame_id, _ in frames}
    from_the_car = {message.frame_id for message in CODEC.database.messages if "AI" not in message.senders}
    assert not (ids - from_the_car) & RESERVED_IDS
    assert ids - from_the_car == set(AI_IDS)
    toggles = [data[0] & 1 for frame_id, data in frames if frame_id == 0x520]
    assert sum(a != b for a, b in itertools.pairwise(toggles)) > 1000, "the handshake stood still"


@pytest.mark.long
def test_a_car_of_another_revision_is_named_and_rules_are_kept(chain: Chain) -> None:
    with chain.car("other_revision", "--revision", OTHER_REVISION, auto=False) as run:
        run.type("on")
        chain.autonomous()
        chain.operator.await_state(lambda s: s.as_state == AsState.AS_OFF, POWER_UP_S, "AS_OFF")
        run.type(f"ami {MISSION}")
        words = f"the car uses interface revision {OTHER_REVISION}"
        chain.operator.await_state(
            lambda s: any(each.startswith(words) for each in s.why_not_driving), POWER_UP_S, "the revision is named"
        )
        chain.operator.await_state(
            lambda s: s.as_state == AsState.AS_READY and not any("of 5 s left" in each for each in s.why_not_driving),
            POWER_UP_S,
            "ready for Go",
        )
        chain.go(run)
        run.type("estop")
        state = chain.operator.await_state(lambda s: s.as_state != AsState.AS_DRIVING, STOP_S, "the run ends")
        assert state.as_state == AsState.EMERGENCY_BRAKE
    report = check_candump(run.log_path, Codec(revision(OTHER_REVISION)), busy_machine=True)
    assert report.ok, report
