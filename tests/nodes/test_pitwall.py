"""What the pit wall shows of the nodes: cones, path and pose in one frame, their words, and nothing old."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from fsai_msgs.msg import Cone, ConeArray, PlannerStatus, VehicleCommand, VehicleState
from nav_msgs.msg import Path
from rclpy.qos import ReliabilityPolicy
from ros_rig import RosRig

from fsai_nodes import qos
from fsai_nodes.conversions import path_to_msg
from fsai_nodes.pitwall import SHOWN_NS, PitWall
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.report import loop_fault_words
from fsai_vcu.interface.enums import AsState

BLUE, YELLOW = int(ConeColor.BLUE), int(ConeColor.YELLOW)
TOPICS = ("vehicle_state", "detected_cones", "planner_status", "path", "vehicle_cmd")


class Nodes:
    """Stand-ins that say all that is shown, of a car that looks along y at x = 10 m."""

    def __init__(self, rig: RosRig) -> None:
        self.rig, self.run_id, self.x = rig, 7, 10.0
        self.state: dict[str, Any] = {"phase": "driving", "as_state": int(AsState.AS_DRIVING)}
        self.status: dict[str, Any] = {"confidence": 0.8, "supported_m": 2.0, "stop_distance_m": 4.0}
        self.command: dict[str, Any] = {"speed_limit_mps": 5.0}
        kinds = (VehicleState, ConeArray, PlannerStatus, Path, VehicleCommand)
        make = rig.tester.create_publisher
        self._to = {topic: make(kind, topic, qos.TOPICS[topic]) for topic, kind in zip(TOPICS, kinds, strict=True)}

    def say(self, *topics: str, age_ms: float = 0.0) -> None:
        """All of them, where none is named; with stamps so old, the state's aside."""
        stamp = self.rig.stamp(age_ms)
        cones = [Cone(x=4.0, y=1.5, color=BLUE, confidence=1.0), Cone(x=4.0, y=-1.5, color=YELLOW, confidence=1.0)]
        said = {
            "vehicle_state": VehicleState(run_id=self.run_id, x=self.x, yaw_rad=math.pi / 2, **self.state),
            "detected_cones": ConeArray(cones=cones),
            "planner_status": PlannerStatus(run_id=self.run_id, mission=5, **self.status),
            "path": path_to_msg(np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [6.0, 0.0]]), stamp),
            "vehicle_cmd": VehicleCommand(run_id=self.run_id, **self.command),
        }
        for topic in topics or TOPICS:
            said[topic].header.stamp = self.rig.stamp() if topic == "vehicle_state" else stamp
            self._to[topic].publish(said[topic])
            self.rig.turns(1)


@pytest.fixture
def nodes(rig: RosRig) -> Nodes:
    return Nodes(rig)


@pytest.fixture
def wall(rig: RosRig) -> Iterator[PitWall]:
    listening = PitWall()
    listening.start()
    yield listening
    listening.stop()


def drawn(wall: PitWall) -> dict[str, Any]:
    return wall.look()[0]


def words(wall: PitWall) -> dict[str, str]:
    """What is said, and how urgent it is."""
    return dict(drawn(wall)["nodes"])


def lags(now: dict[str, Any]) -> bool:
    """A machine that was held up says so, before all else."""
    return any(said.startswith("this display lags by ") for said, _ in now["nodes"])


def await_all(nodes: Nodes, wall: PitWall) -> tuple[dict[str, Any], dict[str, Any]]:
    """The first look at which all of it is there."""
    looks = [wall.look()]

    def complete() -> bool:
        nodes.say()
        looks.append(wall.look())
        now, before = looks[-1]
        there = now.get("seen_cm") and now["path_cm"] and before["cones_cm"]
        said = {"planner: path of 6 m, 80 % sure, stop in 4 m", "controller: at most 5.0 m/s"}
        return bool(there) and not lags(now) and said <= {words for words, _ in now["nodes"]}

    nodes.rig.spin_until(complete, "all of it")
    return looks[-1]


def test_cones_path_and_pose_are_in_the_odometrys_frame(nodes: Nodes, wall: PitWall) -> None:
    now, before = await_all(nodes, wall)
    assert now["pose"] == [10.0, 0.0, pytest.approx(math.pi / 2, abs=1e-3)]
    assert now["seen_cm"] == before["cones_cm"] == [850, 400, BLUE, 1150, 400, YELLOW]
    assert now["path_cm"] == [1000, 0, 1000, 200, 1000, 400, 1000, 600]
    assert (now["borne_out"], now["stop"], before["way_cm"]) == (2, 2, [1000, 0])
    assert now["nodes"][0] == ("bridge: driving", "")
    assert now["nodes"][1] == ("planner: path of 6 m, 80 % sure, stop in 4 m", "")
    assert json.dumps((now, before), allow_nan=False)


def test_a_new_run_has_no_cones_and_no_way_of_the_last(nodes: Nodes, wall: PitWall) -> None:
    await_all(nodes, wall)
    nodes.run_id, nodes.x = 8, 0.0
    looks = []

    def begun() -> bool:
        nodes.say("vehicle_state")
        looks.append(wall.look())
        return looks[-1][0].get("run") == 8

    nodes.rig.spin_until(begun, "the new run")
    now, before = looks[-1]
    assert (now["seen_cm"], now["path_cm"], before) == ([], [], {"way_cm": [0, 0], "cones_cm": []})


def test_old_cones_and_paths_are_not_drawn_as_of_now(nodes: Nodes, wall: PitWall) -> None:
    await_all(nodes, wall)

    def gone() -> bool:
        nodes.say("vehicle_state", "vehicle_cmd")
        nodes.say("detected_cones", "path", age_ms=600.0)
        now, before = wall.look()
        return now.get("seen_cm") == [] == now["path_cm"] and len(before["cones_cm"]) == 6

    nodes.rig.spin_until(gone, "nothing old is drawn, and cones are remembered")


def test_a_silent_planner_is_named_and_its_path_gone(nodes: Nodes, wall: PitWall) -> None:
    await_all(nodes, wall)

    def named() -> bool:
        nodes.say("vehicle_state", "detected_cones", "vehicle_cmd")
        now = drawn(wall)
        silent = [urgency for said, urgency in now["nodes"] if said.startswith("/path of tester: nothing received for")]
        return silent == ["warning"] and now.get("path_cm") == [] and bool(now["seen_cm"])

    nodes.rig.spin_until(named, "the planner's silence")


def test_of_silent_nodes_nothing_is_left_to_draw(nodes: Nodes, wall: PitWall) -> None:
    looks = [wall.look()]

    def silent() -> bool:
        looks.append(wall.look())
        return "pose" not in looks[-1][0] and not lags(looks[-1][0])

    nodes.rig.spin_until(silent, "a first look")
    ((said, urgency),) = looks[-1][0]["nodes"]
    assert said.startswith("/vehicle_state") and said.endswith(": nothing received yet") and urgency == "warning"
    await_all(nodes, wall)
    nodes.rig.spin_until(silent, "the bridge's silence")
    now, before = looks[-1]
    ((said, urgency),) = now.pop("nodes")
    assert said.startswith("/vehicle_state of tester: nothing received for") and urgency == "warning"
    assert (now, before) == ({}, {})


def test_a_display_that_lags_calls_no_node_silent(nodes: Nodes, wall: PitWall) -> None:
    await_all(nodes, wall)
    wall._ended.set()  # no message is taken any more
    wall._thread.join()
    wall.heard_ns = min(wall.heard_ns, wall._newest_ns["path"] + SHOWN_NS // 2)  # a held up thread looked once more
    nodes.rig.spin_until(lambda: lags(drawn(wall)), "its lag")
    now = drawn(wall)
    assert not any("silent" in said for said in words(wall)) and now["path_cm"] and now["seen_cm"]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_listener_that_fails_says_why(nodes: Nodes, wall: PitWall, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ArithmeticError("of the test")

    await_all(nodes, wall)
    monkeypatch.setattr(wall._executor, "spin_once", fails)
    wall._thread.join()
    ((said, urgency),) = drawn(wall)["nodes"]
    assert said.startswith("nothing of the nodes is received any more: ArithmeticError('of the test')")
    assert urgency == "fault"


def test_what_bridge_planner_and_controller_say_is_shown(nodes: Nodes, wall: PitWall) -> None:
    emergency = "the emergency brake was asked for: by /emergency_brake"
    nodes.state |= {"emergency": emergency, "gate_reasons": ["torque held"], "stopping": "stale", "loop_faults": 2}
    nodes.status |= {"note": "no cones ahead", "stop_distance_m": math.nan}
    nodes.command |= {"note": "no path"}
    wanted = {
        f"bridge: ESTOP_REQUEST: {emergency}": "fault",
        "bridge: stale": "warning",
        "bridge: torque held": "warning",
        f"bridge: {loop_fault_words(2)}": "warning",
        "bridge: driving": "",
        "planner: no cones ahead, path of 6 m, 80 % sure": "warning",
        "controller: no path": "warning",
    }

    def said() -> bool:
        nodes.say()
        return words(wall) == wanted

    nodes.rig.spin_until(said, "all words")
    nodes.status["late"] = "/detected_cones of x: nothing received for 300 ms"

    def late() -> bool:
        nodes.say()
        return words(wall).get(f"planner: {nodes.status['late']}") == "warning"

    nodes.rig.spin_until(late, "what the planner waits for")


def test_it_reads_best_effort_and_says_nothing(rig: RosRig, wall: PitWall) -> None:
    see = rig.tester
    rig.spin_until(lambda: "pitwall" in see.get_node_names(), "the pit wall")

    def readers() -> list[ReliabilityPolicy]:
        infos = [info for topic in TOPICS for info in see.get_subscriptions_info_by_topic(f"/{topic}")]
        return [info.qos_profile.reliability for info in infos if info.node_name == "pitwall"]

    rig.spin_until(lambda: readers() == [ReliabilityPolicy.BEST_EFFORT] * len(TOPICS), "its subscriptions")
    assert {name for name, _ in see.get_publisher_names_and_types_by_node("pitwall", "/")} <= {"/parameter_events"}
    assert {name for name, _ in see.get_service_names_and_types_by_node("pitwall", "/")} <= {
        "/pitwall/get_type_description"
    }
    with pytest.raises(ValueError, match="car one is not a ROS namespace"):
        PitWall("car one")


@pytest.mark.parametrize("words", [["pitwall", "BUS", "--ros", "--port", "0"], ["status"]])
def test_keys_that_are_missing_are_one_line(bus: str, tmp_path: FilePath, words: list[str]) -> None:
    (tmp_path / "enclaves").mkdir()
    keys = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(tmp_path)}
    command = [sys.executable, "-m", "fsai_vcu.cli.main", *(word.replace("BUS", bus) for word in words)]
    done = subprocess.run(command, env=os.environ | keys, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith(f"fsai-vcu {words[0]}: DDS encryption is switched on, but does not start (")
    assert f"keys of `fsai-vcu enclaves` that this user may read, in {tmp_path}" in done.stderr


def test_the_verb_serves_bus_and_nodes_and_then_the_bus(nodes: Nodes, bus: str) -> None:
    command = [sys.executable, "-m", "fsai_vcu.cli.main", "pitwall", bus, "--ros", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().split(" ")[0].rpartition(":")[2])
            client = HTTPConnection("127.0.0.1", port, timeout=60)
            client.request("GET", "/events")
            answer = client.getresponse()
            known: set[str] = set()
            for line in map(bytes.decode, answer):
                if "stop" not in known:
                    nodes.say()
                if line.startswith("data: "):
                    event = json.loads(line.removeprefix("data: "))
                    if "pose" in event and "stop" in known and "seen_cm" not in event and not lags(event):
                        break
                    known |= set(event) & {"stop", "cones_cm"}
        finally:
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=60)
    assert (process.returncode, said) == (0, ("", ""))
    assert known == {"stop", "cones_cm"} and event["pose"] == [0.0, 0.0, 0.0]
    assert event["nodes"][0][0].startswith("/vehicle_state of tester: nothing received for")
