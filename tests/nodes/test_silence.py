"""Whose silence makes a command stale is named, by the node that misses its input and by the bridge."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from fsai_msgs.msg import ConeArray, VehicleCommand
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_rig import STATUS, Driving, RosRig, ScriptedVcu, Stand, logged, while_driving

from fsai_nodes import qos
from fsai_nodes.clocks import LATE_NS, Input
from fsai_nodes.cone_detector import ConeDetector
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.vehicle_controller import VehicleController
from fsai_vcu.interface.enums import AsState, ShutdownCause
from fsai_vcu.interface.units import MS

warnings, errors = (partial(logged, level=level) for level in (30, 40))  # of rcl_interfaces/Log: its own are bytes


# ---------------------------------------------------------------- the words


def test_a_publisher_is_named_once_its_node_is_known() -> None:
    named = ["_NODE_NAME_UNKNOWN_"]
    node = SimpleNamespace(
        resolve_topic_name=lambda topic: f"/{topic}",
        get_publishers_info_by_topic=lambda _: [SimpleNamespace(node_name=each) for each in named],
    )
    topic = Input(node, "path")
    assert topic.who() == "/path"
    named.append("path_planner")
    assert topic.who() == "/path of path_planner"
    named.pop()
    assert topic.who() == "/path of path_planner"


def test_silence_and_old_data_are_told_with_topic_and_node(rig: RosRig) -> None:
    speaker = rig.add(Node("speaker"))
    topic = Input(rig.tester, "raw_cones")
    assert topic.late(0) == "/raw_cones, which nobody publishes: nothing received yet"
    publisher = speaker.create_publisher(ConeArray, "raw_cones", qos.SENSOR)
    rig.spin_until(lambda: bool(rig.tester.get_publishers_info_by_topic("/raw_cones")), "the publisher")
    topic.received(1000 * MS, age_ns=10 * MS)
    assert topic.late(1000 * MS + LATE_NS - 1) == ""
    assert topic.late(1000 * MS + LATE_NS) == "/raw_cones of speaker: nothing received for 250 ms"
    topic.received(2000 * MS, age_ns=LATE_NS)
    assert topic.late(2000 * MS) == "/raw_cones of speaker comes with data 250 ms old"
    topic.received(2000 * MS, age_ns=-300 * MS)
    assert topic.late(2000 * MS) == "/raw_cones of speaker is stamped 300 ms ahead of the clock"
    speaker.destroy_publisher(publisher)
    rig.spin_until(lambda: not rig.tester.get_publishers_info_by_topic("/raw_cones"), "the publisher's end")
    assert topic.late(3000 * MS) == "/raw_cones of speaker, which has ended: nothing received for 1000 ms"


# ---------------------------------------------------------------- the chain


def test_the_detector_says_that_its_sensor_fell_silent(rig: RosRig) -> None:
    log = rig.log()
    rig.start(ConeDetector)
    cones = rig.tester.create_publisher(ConeArray, "/raw_cones", qos.SENSOR)
    received = rig.subscribe(ConeArray, "/detected_cones", qos.SENSOR)

    def detected() -> bool:
        cones.publish(ConeArray())
        return bool(received)

    rig.spin_until(detected, "cones pass")
    rig.spin_until(lambda: bool(warnings(log, "/raw_cones of tester: nothing received for")), "the silence is said")
    rig.turns(30)
    assert len(warnings(log, "nothing received for")) == 1 + len(logged(log, "is in time again"))


def test_a_command_on_old_data_says_that_the_detector_is_silent(rig: RosRig) -> None:
    """Cones stop: the planner knows, the controller passes it on, with each command."""
    log = rig.log()
    planner, controller = rig.start(PathPlanner), rig.start(VehicleController)
    rig.announce()
    stand = Stand(rig)
    commands = rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)

    def planned() -> bool:
        stand.state()
        stand.cones()
        return planner._cones._received_ns is not None and bool(commands)

    def plan_taken() -> bool:
        stand.state()
        stand.plan()
        return controller._plan is not None

    def named() -> bool:
        stand.state()
        return "/detected_cones of tester: nothing received for" in commands[-1].note

    rig.spin_until(planned, "cones and commands")
    rig.spin_until(plan_taken, "a plan")
    rig.spin_until(named, "the command says what is late")
    assert "it, or the sensors before it" in commands[-1].note
    assert warnings(log, "not driving: /", "nothing received for")
    # An input that is late begins with its topic, what else keeps the car from driving does not.
    reasons = [line.partition("driving: ")[2].split("; ") for line in logged(log, "driving")]
    kinds = [{each.startswith("/") for each in said if each} for said in reasons]
    assert all(before != after for before, after in pairwise(kinds)), "each change once, not with each command"


def test_a_silent_planner_is_named_by_the_controller(rig: RosRig) -> None:
    controller = rig.start(VehicleController)
    rig.announce()
    stand = Stand(rig, rig.add(Node("some_planner")))
    commands = rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)

    def planned() -> bool:
        stand.state()
        stand.plan()
        return controller._plan is not None and bool(commands) and commands[-1].note == ""

    def named() -> bool:
        stand.state()
        return commands[-1].note.startswith("/path of some_planner: nothing received for")

    rig.spin_until(planned, "a plan, and a command that follows it")
    rig.spin_until(named, "the planner is named")


def test_a_path_in_another_frame_is_refused_in_words(rig: RosRig) -> None:
    controller = rig.start(VehicleController)
    rig.announce()
    stand = Stand(rig)
    commands = rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)

    def planned(frame: str) -> None:
        stand.state()
        stand.plan(frame=frame)

    rig.spin_until(lambda: planned("base_link") or controller._plan is not None, "a plan")
    rig.spin_until(lambda: planned("map") or controller._plan is None, "the plan is given up")
    words = "/path is in 'map', but must be in base_link"
    rig.spin_until(lambda: planned("map") or (commands and words in commands[-1].note), "words")
    assert controller._plan is None and commands[-1].throttle == 0.0 and commands[-1].brake > 0.0


# ---------------------------------------------------------------- the bridge


@pytest.mark.parametrize("promise", [qos.COMMAND, 10], ids=["ours", "as_ros2_topic_pub"])
def test_a_controller_that_falls_silent_is_named_and_stopped(promise: QoSProfile | int) -> None:
    """Whatever it promised to the middleware: the CAN loop's clock catches its silence, and no other."""

    def show(rig: RosRig, _: ScriptedVcu, make: Callable[[], Driving]) -> None:
        log = rig.log()
        car = make()
        words = ("the vehicle command is stale", "/vehicle_cmd of tester: nothing received for")
        rig.spin_until(lambda: bool(errors(log, *words)), words[-1])
        rig.spin_until(lambda: bool(car.node._loop.report().stopping), "the stop of the run")
        assert car.node._loop.report().mode == "manual"

    while_driving(show, promise)


def test_the_bridge_names_what_a_command_says_is_late() -> None:
    def show(rig: RosRig, _: ScriptedVcu, make: Callable[[], Driving]) -> None:
        log = rig.log()
        car = make()

        def stale() -> bool:
            car.command(age_ms=1100.0, note="/path of path_planner: nothing received for 1080 ms")
            return bool(errors(log, "command is stale", "(/path of path_planner: nothing received for 1080 ms)"))

        rig.spin_until(stale, "COMMAND_STALE, and what the command says is late")

    while_driving(show)


def test_emergency_brake_of_the_car_is_an_error_in_the_log(rig: RosRig, bus: str) -> None:
    log = rig.log()
    with ScriptedVcu(bus, STATUS) as vcu:
        rig.start(VcuBridge, can_interface=bus, real_time=False)
        vcu.say(as_state=AsState.EMERGENCY_BRAKE, shutdown_cause=ShutdownCause.EBS_FAULT)
        rig.spin_until(lambda: bool(errors(log, "EMERGENCY_BRAKE", "EBS_FAULT", "brake system")), "the error")


# ---------------------------------------------------------------- lifecycle


@pytest.mark.parametrize("autostart", [True, False])
def test_a_failed_transition_says_why_in_every_start_mode(
    rig: RosRig, bus: str, autostart: bool, tmp_path: Path
) -> None:
    log = rig.log()
    node = rig.start(VcuBridge, can_interface=bus, real_time=False, autostart=autostart)
    if autostart:
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
            assert change(rig, transition)
    limits = str(tmp_path / "absent.toml")
    node.set_parameters([Parameter("limits", value=limits)])
    assert not change(rig, Transition.TRANSITION_CONFIGURE)
    rig.spin_until(lambda: bool(errors(log, "transition failed", limits)), "the reason")


def test_an_unexpected_error_in_a_transition_is_said_too(
    rig: RosRig, bus: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.log()
    node = rig.start(VcuBridge, can_interface=bus, real_time=False, autostart=False)

    def broken() -> None:
        raise RuntimeError("nobody thought of this")

    monkeypatch.setattr(node, "_configure", broken)
    assert not change(rig, Transition.TRANSITION_CONFIGURE)
    words = ("transition failed", "RuntimeError: nobody thought of this")
    rig.spin_until(lambda: bool(errors(log, *words)), "the reason")
    monkeypatch.undo()
    assert change(rig, Transition.TRANSITION_CONFIGURE), "and it can be tried again"


def change(rig: RosRig, transition: int) -> bool:
    return bool(rig.ask(ChangeState, "/vcu_bridge/change_state", transition=Transition(id=transition)).success)
