"""The bridge as a node: what it answers, refuses and reports, and the reset that planner and controller confirm."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fsai_msgs.action import RunMission
from fsai_msgs.msg import RunState, VehicleCommand, VehicleState
from fsai_msgs.srv import SetMode
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from ros_rig import PATIENCE_S, Driving, RosRig, ScriptedVcu, logged, while_driving
from std_srvs.srv import Trigger

from fsai_nodes import qos
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.vehicle_controller import VehicleController
from fsai_vcu.interface.enums import Ami, AsState, EbsState, MissionStatus, TsState
from fsai_vcu.interface.messages import AiStatus, VcuStatus
from fsai_vcu.runtime.bus import open_bus


@pytest.fixture
def vcu(bus: str) -> Iterator[ScriptedVcu]:
    """A car that stands in AS_OFF with everything ready and no mission chosen."""
    status = VcuStatus(
        as_state=AsState.AS_OFF,
        as_switch=True,
        ts_switch=True,
        ts_state=TsState.TS_RUNNING,
        ebs_state=EbsState.EBS_ARMED,
    )
    with ScriptedVcu(bus, status) as started:
        yield started


def start_bridge(rig: RosRig, bus: str, **parameters: object) -> tuple[VcuBridge, list[VehicleState]]:
    node = rig.start(VcuBridge, can_interface=bus, real_time=False, **parameters)
    return node, rig.subscribe(VehicleState, "/vehicle_state", qos.STATE)


def wait_for_car(rig: RosRig, states: list[VehicleState]) -> None:
    rig.spin_until(lambda: bool(states) and states[-1].as_state == VehicleState.AS_OFF, "AS_OFF in /vehicle_state")


@pytest.mark.parametrize("ahead_s", [0, 60])
def test_a_command_that_is_none_is_refused_and_reported(rig: RosRig, bus: str, ahead_s: int) -> None:
    """One with a throttle that is no number; one stamped in the future."""
    log = rig.log()
    node, states = start_bridge(rig, bus)
    diagnostics = rig.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
    publisher = rig.tester.create_publisher(VehicleCommand, "/vehicle_cmd", qos.COMMAND)
    rig.spin_until(lambda: publisher.get_subscription_count() > 0 and bool(states), "the bridge listens")
    command = VehicleCommand(run_id=states[-1].run_id, throttle=0.0 if ahead_s else math.inf)

    def taken() -> bool:
        came = bool(node._sensor_ns if ahead_s else node._refused_commands)
        if not came:  # a command lives for 100 ms
            command.header.stamp = rig.stamp(age_ms=-1000.0 * ahead_s)
            publisher.publish(command)
        return came

    rig.spin_until(taken, "the command comes to the bridge")
    words = "in the future" if ahead_s else "throttle"

    def reported() -> bool:
        return any(
            value.key == "last detail of command_refused" and words in value.value
            for message in diagnostics
            for status in message.status
            for value in status.values
        )

    rig.spin_until(reported, "the refusal in /diagnostics")
    counted = {
        value.value
        for each in diagnostics
        for status in each.status
        for value in status.values
        if value.key == "count of command_refused"
    }
    assert counted == {"1"}, "by the loop, or before it by the door"
    rig.spin_until(lambda: bool(logged(log, "refused", words)), "the refusal in the log")


def test_selected_waits_for_planner_and_controller(rig: RosRig, bus: str, vcu: ScriptedVcu) -> None:
    node, states = start_bridge(rig, bus)
    wait_for_car(rig, states)
    assert rig.ask(SetMode, "/set_mode", mode="autonomous").success
    vcu.say(ami=Ami.TRACKDRIVE)
    rig.spin_until(lambda: states[-1].mission == int(Ami.TRACKDRIVE), "the mission in /vehicle_state")
    assert vcu.last_status().mission_status is MissionStatus.NOT_SELECTED

    rig.start(PathPlanner)
    rig.spin_until(lambda: "planner" in node._loop.report().confirmed, "the planner's confirmation")
    assert vcu.last_status().mission_status is MissionStatus.NOT_SELECTED, "the controller has not confirmed yet"
    rig.start(VehicleController)
    rig.spin_until(lambda: vcu.last_status().mission_status is MissionStatus.SELECTED, "SELECTED on the bus")

    run_id = states[-1].run_id
    vcu.say(ami=Ami.SKIDPAD)
    rig.spin_until(lambda: states[-1].run_id != run_id, "a new run for a new mission")
    rig.spin_until(
        lambda: len(node._loop.report().confirmed) == 2 and vcu.last_status().mission_status is MissionStatus.SELECTED,
        "the new run's confirmation",
    )


def test_a_late_listener_learns_the_run_in_hand(rig: RosRig, bus: str) -> None:
    """Which is another one after each activation."""
    node, states = start_bridge(rig, bus)
    rig.spin_until(lambda: bool(states), "the bridge publishes")
    runs = rig.subscribe(RunState, "/run_state", qos.STATE)
    rig.spin_until(lambda: bool(runs), "the latched run")
    assert runs[0].run_id == states[-1].run_id
    node.trigger_deactivate()
    node.trigger_activate()
    assert node._loop.report().run.run_id != runs[0].run_id


def test_commands_carry_the_run_and_the_stamp_of_their_data(rig: RosRig, bus: str, vcu: ScriptedVcu) -> None:
    _, states = start_bridge(rig, bus)
    rig.start(VehicleController)
    commands = rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)
    vcu.say(ami=Ami.STATIC_INSPECTION_A)
    rig.spin_until(
        lambda: bool(commands) and bool(states) and commands[-1].run_id == states[-1].run_id, "commands of the run"
    )
    now_ns = rig.tester.get_clock().now().nanoseconds
    stamp = commands[-1].header.stamp
    assert 0 <= now_ns - (stamp.sec * 10**9 + stamp.nanosec) < PATIENCE_S * 10**9


def test_a_car_that_falls_silent_has_no_odometry_of_now(rig: RosRig, bus: str, vcu: ScriptedVcu) -> None:
    _, states = start_bridge(rig, bus)
    received = rig.subscribe(Odometry, "/odometry", qos.SENSOR)
    rig.spin_until(lambda: len(received) > 10, "odometry")
    assert (received[0].header.frame_id, received[0].child_frame_id) == ("odom", "base_link")
    vcu.__exit__()
    rig.spin_until(lambda: bool(states) and states[-1].speeds_age_s > 0.3, "the car is silent")
    seen = len(states)
    rig.spin_until(lambda: len(states) > seen + 2, "what was on its way")
    said, count = len(received), len(states)
    rig.spin_until(lambda: len(states) > count + 20, "states of a silent car")
    assert len(received) == said
    stamps_ns = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in states[count:]]
    assert max(stamps_ns) - min(stamps_ns) < 10_000_000  # one measurement, whatever the two clocks do


def test_listen_only_is_shown_and_nothing_is_ever_sent(rig: RosRig, bus: str, vcu: ScriptedVcu) -> None:
    _, states = start_bridge(rig, bus, listen_only=True)
    wait_for_car(rig, states)
    rig.spin_until(lambda: len(states) > 20, "states")
    assert states[-1].listen_only
    assert vcu.received == []


def test_limits_come_from_a_file_or_from_the_parameter(rig: RosRig, bus: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "limits.toml"
    file.write_text("max_speed_mps = 4.5\n")
    node, _ = start_bridge(rig, bus, limits=str(file))
    assert node._loop.report().limits.max_speed_mps == 4.5
    node.stop()
    other, _ = start_bridge(rig, bus + "b", limits="max_speed_mps=3.5, max_steer_deg=20")
    assert other._loop.report().limits.max_speed_mps == 3.5
    assert other._loop.report().limits.max_steer_deg == 20.0


def test_a_database_that_lacks_a_signal_is_taken_and_said(
    rig: RosRig, bus: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = (Path(__file__).parents[2] / "dbc" / "ads_dv_2026.dbc").read_text()
    file = tmp_path / "car.dbc"
    file.write_text("".join(line for line in whole.splitlines(True) if " FAULT_STATUS " not in line))
    start_bridge(rig, bus, dbc_files=str(file))
    (line,) = [each.getMessage() for each in caplog.records if "lacks signals" in each.getMessage()]
    assert "FAULT_STATUS" in line


# ---------------------------------------------------------------- lifecycle


def state_of(rig: RosRig) -> str:
    return str(rig.ask(GetState, "/vcu_bridge/get_state").current_state.label)


def change(rig: RosRig, transition: int) -> bool:
    return bool(rig.ask(ChangeState, "/vcu_bridge/change_state", transition=Transition(id=transition)).success)


def test_deactivation_silences_the_bus_until_activation(rig: RosRig, bus: str) -> None:
    start_bridge(rig, bus, autostart=False)
    assert state_of(rig) == "unconfigured"
    assert not rig.ask(SetMode, "/set_mode", mode="manual").success
    with open_bus(bus) as listener:

        def somebody_sends() -> bool:
            return listener.recv(0.0) is not None

        assert change(rig, Transition.TRANSITION_CONFIGURE) and state_of(rig) == "inactive"
        assert listener.recv(0.3) is None
        assert change(rig, Transition.TRANSITION_ACTIVATE)
        rig.spin_until(somebody_sends, "frames after activation")
        assert change(rig, Transition.TRANSITION_DEACTIVATE) and state_of(rig) == "inactive"
        while listener.recv(0.0) is not None:
            pass
        assert listener.recv(0.3) is None
        answer = rig.ask(Trigger, "/emergency_brake")
        assert not answer.success and "not active" in answer.message
        assert change(rig, Transition.TRANSITION_ACTIVATE)
        rig.spin_until(somebody_sends, "frames after activation")


# ---------------------------------------------------------------- /run_mission


def follow(rig: RosRig, **goal: object):  # type: ignore[no-untyped-def]
    """The goal's handle and the feedback so far."""
    feedback: list[RunMission.Feedback] = []
    client = ActionClient(rig.tester, RunMission, "/run_mission")
    rig.spin_until(client.server_is_ready, "the action server")
    future = client.send_goal_async(
        RunMission.Goal(**goal), feedback_callback=lambda message: feedback.append(message.feedback)
    )
    rig.spin_until(future.done, "the goal's answer")
    return future.result(), feedback


def result_of(rig: RosRig, handle) -> RunMission.Result:  # type: ignore[no-untyped-def]
    future = handle.get_result_async()
    rig.spin_until(future.done, "the goal's result")
    return future.result().result


def cancel(rig: RosRig, handle) -> None:  # type: ignore[no-untyped-def]
    """The goal; again where the loop was held up and its cancellation rejected."""

    def taken() -> bool:
        future = handle.cancel_goal_async()
        rig.spin_until(future.done, "the answer")
        return bool(future.result().goals_canceling)

    rig.spin_until(taken, "the cancellation is taken")


def test_a_goal_is_followed_with_feedback_to_either_end(rig: RosRig, bus: str, vcu: ScriptedVcu) -> None:
    _, states = start_bridge(rig, bus)
    wait_for_car(rig, states)
    vcu.say(ami=Ami.TRACKDRIVE)
    handle, feedback = follow(rig, mission="trackdrive", until="ready")
    assert handle.accepted
    rig.spin_until(lambda: bool(feedback), "feedback")
    assert feedback[0].as_state_label == "AS_OFF" and feedback[0].why_not_driving
    vcu.say(as_state=AsState.AS_READY)
    result = result_of(rig, handle)
    assert result.success and result.ended == "reached" and result.as_state == "AS_READY"
    handle, feedback = follow(rig, until="finished")
    rig.spin_until(lambda: bool(feedback), "feedback")
    vcu.say(as_state=AsState.EMERGENCY_BRAKE)
    result = result_of(rig, handle)
    assert not result.success and result.ended == "missed" and "EMERGENCY_BRAKE" in result.message


def test_a_goal_is_rejected_cancelled_or_times_out(rig: RosRig, bus: str) -> None:
    start_bridge(rig, bus)
    assert not follow(rig, until="lunch")[0].accepted
    assert not follow(rig, mission="drag race")[0].accepted
    handle, _ = follow(rig, until="finished")
    cancel(rig, handle)
    assert result_of(rig, handle).ended == "cancelled"
    handle, _ = follow(rig, until="finished", timeout_s=0.1)
    assert result_of(rig, handle).ended == "timeout"


def test_cancelling_ends_the_drive_in_order() -> None:
    """As mode manual does: commands no longer count, FINISHED at rest, no emergency; then comes the result."""

    def show(rig: RosRig, vcu: ScriptedVcu, make: Callable[[], Driving]) -> None:
        car = make()
        handle, _ = follow(rig, until="finished")
        cancel(rig, handle)
        result = handle.get_result_async()

        def finished() -> bool:
            car.command()
            assert not vcu.last_status().estop_request, "an emergency brake was asked for"
            return vcu.last_status().mission_status is MissionStatus.FINISHED

        rig.spin_until(finished, "FINISHED at rest")
        assert not result.done(), "the car is in AS_DRIVING still"
        vcu.say(as_state=AsState.AS_FINISHED)
        rig.spin_until(result.done, "the goal's result")
        ended = result.result().result
        assert (ended.ended, ended.as_state, ended.success) == ("cancelled", "AS_FINISHED", False)
        assert not any(image.estop_request for image in vcu.received if isinstance(image, AiStatus))

    while_driving(show)


def test_a_loop_held_up_does_not_end_a_cancelled_drive() -> None:
    def show(rig: RosRig, vcu: ScriptedVcu, make: Callable[[], Driving]) -> None:
        node = make().node
        handle, _ = follow(rig, until="finished")
        cancel(rig, handle)
        result = handle.get_result_async()
        os.kill(node._loop.pid, signal.SIGSTOP)
        rig.spin_until(lambda: node._loop_silent, "the loop's silence")
        rig.turns()
        os.kill(node._loop.pid, signal.SIGCONT)
        rig.spin_until(lambda: not node._loop_silent, "the loop reports again")
        assert not result.done(), "the car is in AS_DRIVING still"
        vcu.say(as_state=AsState.EMERGENCY_BRAKE)
        rig.spin_until(result.done, "the goal's result")
        assert (result.result().result.ended, result.result().result.as_state) == ("cancelled", "EMERGENCY_BRAKE")

    while_driving(show)


def test_a_cancelled_drive_ends_with_a_loop_that_hangs() -> None:
    def show(rig: RosRig, _: ScriptedVcu, make: Callable[[], Driving]) -> None:
        node = make().node
        handle, _ = follow(rig, until="finished")
        cancel(rig, handle)
        os.kill(node._loop.pid, signal.SIGSTOP)
        ended = result_of(rig, handle)
        os.kill(node._loop.pid, signal.SIGCONT)
        assert (ended.ended, "nothing is received" in ended.message) == ("cancelled", True)

    while_driving(show)


@pytest.mark.parametrize("state", [AsState.AS_OFF, AsState.AS_READY])
def test_cancelling_before_the_drive_keeps_it_from_starting(
    rig: RosRig, bus: str, vcu: ScriptedVcu, state: AsState
) -> None:
    _, states = start_bridge(rig, bus, vcu_stale_ms=1000.0, vcu_lost_ms=2000.0)  # the car is in this process
    wait_for_car(rig, states)
    assert rig.ask(SetMode, "/set_mode", mode="autonomous").message == "mode is autonomous"
    assert rig.ask(SetMode, "/set_mode", mode="autonomous").message == "mode is autonomous already"
    vcu.say(as_state=state, ami=Ami.TRACKDRIVE)
    rig.spin_until(lambda: states[-1].as_state == int(state), state.label)
    handle, _ = follow(rig, until="finished")
    cancel(rig, handle)
    result = result_of(rig, handle)
    assert (result.ended, result.message) == ("cancelled", f"cancelled, mode is manual: the car is in {state.label}")
    assert result.duration_s >= 0.0
    rig.spin_until(lambda: states[-1].mode == "manual", "the mode in /vehicle_state")


def test_a_cancel_that_the_loop_does_not_take_is_rejected(rig: RosRig, bus: str) -> None:
    node, _ = start_bridge(rig, bus)
    handle, _ = follow(rig, until="finished")
    node._loop.set_mode = lambda mode: (False, "the CAN loop does not answer")
    future = handle.cancel_goal_async()
    rig.spin_until(future.done, "the answer")
    assert not future.result().goals_canceling
    del node._loop.set_mode
    cancel(rig, handle)
    assert result_of(rig, handle).ended == "cancelled"


def test_stopping_the_bridge_ends_the_goals_that_it_follows(rig: RosRig, bus: str) -> None:
    node, _ = start_bridge(rig, bus)
    handle, feedback = follow(rig, until="finished")
    rig.spin_until(lambda: bool(feedback), "feedback")
    node.trigger_deactivate()
    assert result_of(rig, handle).ended == "bridge_stopped"
