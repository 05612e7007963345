"""fsai-vcu check-stack: what the middleware knows of a stack, and the verb on a good and on a bad one."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time

import pytest
from fsai_msgs.msg import ResetConfirmation, VehicleCommand, VehicleState
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_rig import PATIENCE_S, RosRig

from fsai_nodes import qos
from fsai_vcu.cli.check_stack import by_clock, ends_of
from fsai_vcu.cli.main import main


class Spinning:
    """The rig's nodes answer from a thread of their own."""

    def __init__(self, rig: RosRig) -> None:
        self._rig = rig
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self._ended.is_set():
            self._rig.turns(1)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()


def test_a_reader_that_does_not_hear_a_publisher_is_found(rig: RosRig) -> None:
    team, ours = rig.add(Node("team")), rig.add(Node("ours"))
    team.create_publisher(ResetConfirmation, "/reset_confirmation", QoSProfile(depth=1))  # not transient local
    ours.create_subscription(ResetConfirmation, "/reset_confirmation", lambda _: None, qos.CONFIRMATION)
    rig.spin_until(lambda: bool(ends_of(rig.tester, "reset_confirmation").deaf), "the mismatch")
    ends = ends_of(rig.tester, "reset_confirmation")
    assert (ends.publishers, ends.readers) == (["team"], ["ours"])
    assert ends.deaf == [("ours", "team", "volatile publisher and transient local subscription")]


def test_the_verb_says_it_in_lines_in_json_and_by_its_status(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["check-stack", "--wait", "0.5", "--namespace", "/nobody"]
    assert main(argv) == 1
    assert "/vehicle_cmd: nothing was received\n    the controller sends it" in capsys.readouterr().out
    assert main([*argv, "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert [each["topic"] for each in told["wrong"]] == ["vehicle_cmd", "vehicle_state", "run_state"]


@pytest.mark.parametrize("brake", [0.0, 0.5])
def test_the_verb_tells_a_good_stack_from_a_bad_one(rig: RosRig, brake: float) -> None:
    make = rig.tester.create_publisher
    commands, states = make(VehicleCommand, "/vehicle_cmd", 10), make(VehicleState, "/vehicle_state", qos.STATE)
    confirmations = make(ResetConfirmation, "/reset_confirmation", qos.CONFIRMATION)
    for role in ("planner", "controller"):
        confirmations.publish(ResetConfirmation(role=role, run_id=7))
    rig.announce()
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", "check-stack", "--seconds", "3", "--wait", "60", "--json"]
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
    # What a busy machine adds (pauses, rates, ages) is no fault of the stack, and judged without a clock elsewhere.
    assert any("throttle and brake together" in each["wrong"] for each in told["wrong"]) == bool(brake), told
    assert process.returncode == bool(told["wrong"])


def test_nodes_say_whose_time_they_go_by(rig: RosRig) -> None:
    """Without a /clock that time stands still: check-stack says so."""
    rig.add(Node("by_clock", parameter_overrides=[Parameter("use_sim_time", value=True)]))
    rig.add(Node("by_itself"))
    names = ["by_clock", "by_itself", "gone"]
    with Spinning(rig):
        asking = Node("asking")
        try:
            until = time.monotonic() + PATIENCE_S
            while (found := by_clock(asking, names)) != {"by_clock": True, "by_itself": False}:
                assert time.monotonic() < until, found
        finally:
            asking.destroy_node()
