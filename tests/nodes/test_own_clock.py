"""A node whose own clock stands still, or is another than this computer's, says that of itself and accuses nobody."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fsai_msgs.msg import VehicleCommand
from rclpy.time import Time
from ros_rig import RosRig, Stand, logged
from rosgraph_msgs.msg import Clock

from fsai_nodes import qos
from fsai_nodes.clocks import Clocks, Input
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.vehicle_controller import VehicleController
from fsai_vcu.interface.units import MS, S

STILL = "this node's own clock stands still at 0 s: use_sim_time is set, and nothing comes on /clock"


def node_with(ros_ns: list[int], *, simulated: bool) -> Any:
    clock = SimpleNamespace(now=lambda: Time(nanoseconds=ros_ns[0]), ros_time_is_active=simulated)
    return SimpleNamespace(get_clock=lambda: clock)


def test_a_clock_not_moved_for_half_a_second_stands_still() -> None:
    clocks = Clocks(node_with([0], simulated=True))
    assert not clocks.wrong(clocks._moved_ns + 500 * MS - 1).startswith("this node's own clock stands still")
    assert clocks.wrong(clocks._moved_ns + 500 * MS) == STILL


def test_a_clock_that_moves_elsewhere_is_told_with_how_far(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(node_with([100 * S], simulated=True))
    monkeypatch.setattr("time.time_ns", lambda: 5000 * S)
    words = "this node's own clock is 4900 s behind this computer's: use_sim_time is set, and /clock says so"
    assert clocks.wrong(clocks._moved_ns) == words
    monkeypatch.setattr("time.time_ns", lambda: 101 * S - 1)
    assert clocks.wrong(clocks._moved_ns) == ""


def test_this_computers_own_clock_is_never_wrong_by_itself() -> None:
    clocks = Clocks(node_with([0], simulated=False))
    assert clocks.wrong(clocks._moved_ns + 3600 * S) == ""


def test_nodes_without_a_clock_say_so_and_accuse_nobody(rig: RosRig) -> None:
    log = rig.log()
    told = rig.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
    names = {rig.start(kind, use_sim_time=True).get_name() for kind in (PathPlanner, VehicleController)}
    rig.announce()
    stand = Stand(rig)

    def said() -> bool:
        stand.state()
        stand.cones()
        stand.plan()
        by = {line.name for line in log if line.msg.startswith(STILL)}
        refused = logged(log, STILL, "/vehicle_state is refused, as its stamp is meaningless")
        statuses = {each.name for array in told for each in array.status if STILL in each.message}
        return names <= by and bool(refused) and {f"{name}: clock" for name in names} <= statuses

    rig.spin_until(said, STILL)
    assert not logged(log, "is the sender's clock right"), "nobody is accused"


def test_data_by_a_clock_elsewhere_are_not_called_old(rig: RosRig) -> None:
    """/clock is ahead: everything that comes looks old."""
    controller = rig.start(VehicleController, use_sim_time=True)
    clock = rig.tester.create_publisher(Clock, "/clock", 10)
    rig.announce()
    stand = Stand(rig)
    commands = rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)

    def named() -> bool:
        message = Clock()
        message.clock = rig.stamp(age_ms=-3_600_000.0)
        clock.publish(message)
        rig.turns(3)
        stand.state()
        stand.plan()
        return bool(commands) and "this node's own clock is 3600 s ahead of this computer's" in commands[-1].note

    rig.spin_until(named, "the clock is named")
    assert "data" not in commands[-1].note and controller._clocks.wrong(0)


def test_what_is_refused_is_not_called_silent(rig: RosRig) -> None:
    topic = Input(rig.tester, "vehicle_cmd")
    topic.refused("/vehicle_cmd of x refused: throttle is nan")
    refused_ns = topic._refused[1]
    assert topic.silence(refused_ns) == "/vehicle_cmd of x refused: throttle is nan"
    assert topic.silence(refused_ns + S) == "/vehicle_cmd, which nobody publishes: nothing received yet"


def test_a_bridge_without_a_clock_does_not_accuse_the_controller(rig: RosRig, bus: str) -> None:
    log = rig.log()
    bridge = rig.start(VcuBridge, can_interface=bus, real_time=False, use_sim_time=True)
    commands = rig.tester.create_publisher(VehicleCommand, "/vehicle_cmd", qos.COMMAND)

    def refused() -> bool:
        command = VehicleCommand()
        command.header.stamp = rig.stamp()
        commands.publish(command)
        rig.turns(2)
        return bool(logged(log, STILL, "/vehicle_cmd is refused"))

    rig.spin_until(refused, "the bridge's own clock")
    assert not bridge._loop.report().reason_counts.get("command_refused")
