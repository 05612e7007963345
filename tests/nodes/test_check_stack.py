"""fsai-vcu check-stack: a stack in order is left alone, and each thing that is wrong is named with what to do."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable

import pytest
from builtin_interfaces.msg import Time
from fsai_msgs.msg import ResetConfirmation, RunState, VehicleCommand, VehicleState
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.qos import QoSProfile
from ros_rig import RosRig

from fsai_nodes import qos
from fsai_vcu.cli.check_stack import StackWatch, mismatches
from fsai_vcu.cli.main import main
from fsai_vcu.core.supervision.supervisor import Asked

ROS_S = 1_000.0


def command(age_s: float = 0.0, **values: object) -> VehicleCommand:
    message = VehicleCommand(run_id=7, **values)
    stamp_s = ROS_S - age_s
    message.header.stamp = Time(sec=int(stamp_s), nanosec=int(stamp_s % 1 * 1e9))
    return message


def watched(message: Callable[[], VehicleCommand] = command, period_s: float = 0.02) -> StackWatch:
    """A stack in order for 2 s, but for its commands."""
    watch = StackWatch()
    watch.receive("run_state", RunState(run_id=7), 0.0, 0)
    for role in ("planner", "controller"):
        watch.receive("reset_confirmation", ResetConfirmation(role=role, run_id=7), 0.0, 0)
    for number in range(round(2.0 / period_s)):
        watch.receive("vehicle_cmd", message(), number * period_s, round(ROS_S * 1e9))
        state = VehicleState(run_id=7, steering_max_rad=0.36)
        state.header.stamp = Time(sec=int(ROS_S))
        watch.receive("vehicle_state", state, number * 0.02, round(ROS_S * 1e9))
    return watch


def wrong(watch: StackWatch) -> list[str]:
    return [f"{each.topic}: {each.wrong}; {each.to_do}" for each in watch.findings()]


def test_a_stack_in_order_has_nothing_wrong() -> None:
    assert wrong(watched()) == []


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (lambda: command(throttle=0.5, brake=0.1), ("throttle and brake together", "set one of them to 0")),
        (lambda: command(steering_rad=0.4), ("steering_rad is out of range", "+-0.36 rad")),
        (lambda: command(throttle=float("nan")), ("throttle is out of range or no number", "0 to 1")),
        (lambda: command(brake=1.1), ("brake is out of range", "0 to 1")),
        (lambda: command(age_s=0.6), ("0.60 s old", "pass the newest data on")),
        (lambda: command(age_s=-0.5), ("0.50 s in the future", "this computer's clock")),
        (lambda: VehicleCommand(run_id=7), ("100 of 100 messages have no stamp", "oldest data behind it")),
    ],
)
def test_a_wrong_command_is_named_with_what_to_do(
    message: Callable[[], VehicleCommand], words: tuple[str, ...]
) -> None:
    (line,) = wrong(watched(message))
    assert line.startswith("vehicle_cmd: ") and all(word in line for word in words), line


def test_too_slow_commands_are_named_with_their_rate() -> None:
    (line,) = wrong(watched(period_s=0.1))
    assert "10.0 Hz, at least 50 are needed" in line


def test_commands_of_another_run_and_missing_resets_are_named() -> None:
    watch = watched()
    watch.receive("run_state", RunState(run_id=8), 2.0, 0)
    watch.receive("vehicle_cmd", command(), 1.99, round(ROS_S * 1e9))
    planner, controller, stale = wrong(watch)
    assert "the planner has not confirmed run 8" in planner and "the controller has not" in controller
    assert "1 commands are of another run" in stale


def test_what_the_bridge_counted_meanwhile_is_told_with_detail() -> None:
    watch = watched()
    for count in (3, 5):
        watch.diagnose("count of command_refused", str(count))
        watch.diagnose("last detail of command_refused", "throttle is nan")
        watch.diagnose("count of steer_clamped", "2")  # long before
    (line,) = wrong(watch)
    assert "intervened 2 times" in line and "refused whole" in line and "(throttle is nan)" in line


@pytest.mark.parametrize("why", [Asked.MISSION_DONE.value, "wheel speeds (0x525) are missing"])
def test_a_stop_is_told_unless_somebody_asked_for_it(why: str) -> None:
    watch = watched()
    state = VehicleState(run_id=7, stopping=why)
    state.header.stamp = Time(sec=int(ROS_S))
    watch.receive("vehicle_state", state, 2.0, round(ROS_S * 1e9))
    told = wrong(watch)
    assert told == [] if why == "the mission is done" else why in told[0]


def test_a_silent_stack_is_named_topic_by_topic() -> None:
    lines = wrong(StackWatch())
    topics = ("vehicle_state", "run_state", "vehicle_cmd")
    assert [line.partition(": nothing was received")[0] for line in lines] == list(topics)


def test_a_mismatch_of_qos_and_a_missing_node_are_named(rig: RosRig) -> None:
    team, ours = rig.add(Node("team")), rig.add(Node("ours"))
    team.create_publisher(ResetConfirmation, "/reset_confirmation", QoSProfile(depth=1))  # not transient local
    ours.create_subscription(ResetConfirmation, "/reset_confirmation", lambda _: None, qos.CONFIRMATION)
    ours.create_subscription(Path, "/path", lambda _: None, qos.PLAN)
    for node in (team, ours):
        node.create_publisher(VehicleCommand, "/vehicle_cmd", 10)
    rig.spin_until(lambda: len(list(mismatches(rig.tester))) == 3, "three findings")
    found = {each.topic: each.wrong for each in mismatches(rig.tester)}
    assert found["vehicle_cmd"] == "2 nodes command the car: ours and team"
    assert found["path"] == "nobody publishes it, and ours waits for it"
    mismatch = "ours does not receive team: volatile publisher and transient local subscription"
    assert found["reset_confirmation"] == mismatch


def test_the_verb_says_it_in_lines_in_json_and_by_its_status(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["check-stack", "--wait", "0.5", "--namespace", "/nobody"]
    assert main(argv) == 1
    assert "/vehicle_cmd: nothing was received\n    it comes from the controller" in capsys.readouterr().out
    assert main([*argv, "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert [each["topic"] for each in told["wrong"]] == ["vehicle_state", "run_state", "vehicle_cmd"]


@pytest.mark.parametrize("brake", [0.0, 0.5])
def test_the_verb_tells_a_good_stack_from_a_bad_one(rig: RosRig, brake: float) -> None:
    make = rig.tester.create_publisher
    commands, states = make(VehicleCommand, "/vehicle_cmd", 10), make(VehicleState, "/vehicle_state", qos.STATE)
    confirmations = make(ResetConfirmation, "/reset_confirmation", qos.CONFIRMATION)
    for role in ("planner", "controller"):
        confirmations.publish(ResetConfirmation(role=role, run_id=7))
    rig.announce()
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", "check-stack", "--seconds", "1.5", "--json"]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        while process.poll() is None:
            for publisher, kind in ((commands, VehicleCommand), (states, VehicleState)):
                message = kind(run_id=7)
                message.header.stamp = rig.stamp()
                if kind is VehicleCommand:
                    message.throttle, message.brake = 0.5, brake
                publisher.publish(message)
            rig.turns(1)
        told = json.loads(process.communicate()[0])
    # A busy machine pauses, and with it this test: that is no fault of the stack.
    wrong = [each["wrong"] for each in told["wrong"] if "paused" not in each["wrong"] and " Hz" not in each["wrong"]]
    assert ["throttle and brake together" in each for each in wrong] == [True] * bool(brake), wrong
    assert process.returncode == bool(told["wrong"])
