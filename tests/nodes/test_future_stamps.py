"""A message stamped more than 20 ms ahead of now is refused by every node that reads stamps, and named in the log."""

from __future__ import annotations

import os
import time
from itertools import count

import pytest

from fsai_vcu.interface.units import MS

pytest.importorskip("rclpy", reason="rclpy is not installed (pip install 'fsai-vcu[ros]')")
pytest.importorskip("fsai_msgs", reason="fsai_msgs is not built into this environment (nodes/build-messages)")

from builtin_interfaces.msg import Time
from fsai_msgs.msg import ConeArray, PlannerStatus, RunState, VehicleCommand, VehicleState
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.duration import Duration
from ros_rig import RosRig

from fsai_nodes import qos
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.vehicle_controller import VehicleController
from fsai_vcu.interface.enums import Ami, AsState

_numbers = count()


def stamp(rig: RosRig, ahead_ms: float) -> Time:
    return (rig.tester.get_clock().now() + Duration(nanoseconds=round(ahead_ms * MS))).to_msg()


def announce(rig: RosRig) -> None:
    """A run that drives, to whoever listens now or later."""
    runs = rig.tester.create_publisher(RunState, "/run_state", qos.TOPICS["run_state"])
    runs.publish(RunState(run_id=7, mission=int(Ami.TRACKDRIVE), as_state=int(AsState.AS_DRIVING), may_move=True))


def said(log: list[object], *words: str) -> list[str]:
    return [line.msg for line in log if all(word in line.msg for word in words)]  # type: ignore[attr-defined]


def test_the_planner_refuses_cones_and_states_of_the_future(rig: RosRig) -> None:
    log = rig.log()
    planner = rig.start(PathPlanner)
    announce(rig)
    states = rig.tester.create_publisher(VehicleState, "/vehicle_state", qos.TOPICS["vehicle_state"])
    cones = rig.tester.create_publisher(ConeArray, "/detected_cones", qos.TOPICS["detected_cones"])
    paths = rig.hear(Path, "/path", qos.TOPICS["path"])

    def state_refused() -> bool:
        message = VehicleState(run_id=7)
        message.header.stamp = stamp(rig, 1000.0)
        states.publish(message)
        return bool(said(log, "/vehicle_state refused", "ms ahead"))

    rig.spin_until(state_refused, "the state is refused")
    assert planner._motion is None

    def ready() -> bool:
        message = VehicleState(run_id=7)
        message.header.stamp = stamp(rig, 0.0)
        states.publish(message)
        return planner._motion is not None

    rig.spin_until(ready, "the planner knows where the car is")

    def cones_refused() -> bool:
        message = ConeArray()
        message.header.stamp = stamp(rig, 1000.0)
        cones.publish(message)
        return bool(said(log, "/detected_cones refused", "ms ahead"))

    rig.spin_until(cones_refused, "the cones are refused")
    assert paths == []

    def planned() -> bool:
        message = ConeArray()
        message.header.stamp = stamp(rig, 0.0)
        cones.publish(message)
        return bool(paths)

    rig.spin_until(planned, "cones of now are planned with")


def test_the_controller_refuses_a_path_of_the_future(rig: RosRig) -> None:
    log = rig.log()
    controller = rig.start(VehicleController)
    announce(rig)
    statuses = rig.tester.create_publisher(PlannerStatus, "/planner_status", qos.TOPICS["planner_status"])
    paths = rig.tester.create_publisher(Path, "/path", qos.TOPICS["path"])

    def plan(ahead_ms: float) -> None:
        at = stamp(rig, ahead_ms)
        status = PlannerStatus(run_id=7, mission=int(Ami.TRACKDRIVE))
        path = Path(poses=[PoseStamped(), PoseStamped(), PoseStamped()])
        status.header.stamp = path.header.stamp = at
        statuses.publish(status)
        paths.publish(path)
        for _ in range(5):  # both are taken before the next pair comes
            rig.executor.spin_once(timeout_sec=0.02)

    def refused() -> bool:
        plan(100.0)
        return bool(said(log, "/path refused", "ms ahead"))

    rig.spin_until(refused, "the path is refused")
    assert controller._plan is None

    def taken() -> bool:
        plan(0.0)
        return controller._plan is not None

    rig.spin_until(taken, "a path of now is taken")


def test_a_refusal_is_not_logged_with_every_message(rig: RosRig) -> None:
    log = rig.log()
    rig.start(PathPlanner)
    announce(rig)
    states = rig.tester.create_publisher(VehicleState, "/vehicle_state", qos.TOPICS["vehicle_state"])
    sent = 0
    began_s = time.monotonic()

    def many() -> bool:
        nonlocal sent
        message = VehicleState(run_id=7)
        message.header.stamp = stamp(rig, 5000.0)
        states.publish(message)
        sent += bool(states.get_subscription_count())
        return sent >= 40

    rig.spin_until(many, "forty states of the future")
    rig.spin_until(lambda: bool(said(log, "refused")), "the refusal")
    assert len(said(log, "/vehicle_state refused")) <= 1 + (time.monotonic() - began_s)


def test_the_bridge_counts_a_command_of_the_future_as_refused(rig: RosRig) -> None:
    log = rig.log()
    bridge = rig.start(VcuBridge, can_interface=f"loopback:future-{os.getpid()}-{next(_numbers)}", real_time=False)
    commands = rig.tester.create_publisher(VehicleCommand, "/vehicle_cmd", qos.TOPICS["vehicle_cmd"])

    def refused() -> bool:
        command = VehicleCommand(run_id=bridge._loop.report().run.run_id)
        command.header.stamp = stamp(rig, 6000.0)
        commands.publish(command)
        return "command_refused" in bridge._loop.report().reason_counts

    rig.spin_until(refused, "the command is refused")
    report = bridge._loop.report()
    assert "in the future" in report.reason_details["command_refused"]
    rig.spin_until(lambda: bool(said(log, "refused", "in the future")), "the refusal in the log")
