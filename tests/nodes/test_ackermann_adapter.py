"""ackermann_adapter: what a team's stack says and hears on its own interface."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest
from ackermann_msgs.msg import AckermannDrive, AckermannDriveStamped
from eufs_msgs.msg import (
    CanState,
    CarState,
    ConeArrayWithCovariance,
    ConeWithColorProbabilityArray,
    VehicleCommandsStamped,
    WheelSpeedsStamped,
)
from eufs_msgs.srv import SetCanState, SetMission
from fsai_api.msg import VCU2AI
from fsai_msgs.msg import Cone, ConeArray, ResetConfirmation, RunState, VehicleCommand, VehicleState
from ros_rig import RosRig
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from fsai_nodes import adapter_outputs as made
from fsai_nodes import qos
from fsai_nodes.ackermann_adapter import (
    ASKED_BRAKE,
    HOLDING_BRAKE,
    MOST_REPEATED_S,
    SETTINGS,
    AckermannAdapter,
    interface_of,
)
from fsai_nodes.adapter_presets import PRESETS, Preset
from fsai_nodes.parameters import NodeError
from fsai_vcu.core.vehicle.forces import brake_for, throttle_for
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami, AsState


class Stack:
    """The tester as bridge and stack around an adapter, in AS_DRIVING."""

    def __init__(self, rig: RosRig, **parameters: object) -> None:
        self.rig = rig
        self.node = rig.start(AckermannAdapter, **parameters)
        self.has: Preset = self.node._interface
        make = rig.tester.create_publisher
        self._state = make(VehicleState, "/vehicle_state", qos.STATE)
        self._plain = self.has.command_type == "AckermannDrive"
        self.commanding = make(AckermannDrive if self._plain else AckermannDriveStamped, f"/{self.has.command}", 1)
        ways = {name: getattr(self.has, name).partition(":") for name in ("finish", "brake", "emergency")}
        topics = {"driving": self.has.driving, **{name: way[2] for name, way in ways.items() if way[0] == "topic"}}
        self.flags = {name: make(Bool, f"/{topic}", 1) for name, topic in topics.items() if topic}
        self.commands = rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)
        rig.announce()

    def says(
        self, acceleration: float = 0.0, steering: float = 0.0, speed: float = 0.0, driving: bool = True, **flags: bool
    ) -> None:
        drive = AckermannDrive(acceleration=acceleration, steering_angle=steering, speed=speed)
        self.commanding.publish(drive if self._plain else AckermannDriveStamped(drive=drive))
        for name, flag in (flags | ({"driving": driving} if self.has.driving else {})).items():
            self.flags[name].publish(Bool(data=flag))

    def state(self, as_state: AsState = AsState.AS_DRIVING, speed_mps: float = 0.0) -> None:
        message = VehicleState(run_id=7, as_state=int(as_state), mission=int(Ami.TRACKDRIVE), speed_mps=speed_mps)
        message.wheel_speed_rpm = [60, 120, 180, 240]
        message.header.stamp = self.rig.stamp()
        self._state.publish(message)

    def until(self, wanted: object, what: str, speed_mps: float = 0.0, **said: object) -> VehicleCommand:
        """The first command that is as wanted, while the stack keeps saying so."""

        def came() -> bool:
            self.state(speed_mps=speed_mps)
            self.says(**said)
            return bool(self.commands) and wanted(self.commands[-1])

        self.rig.spin_until(came, what)
        return self.commands[-1]

    def commanded(self) -> None:
        """Three more commands, while the stack says nothing."""
        before = len(self.commands)

        def more() -> bool:
            self.state()
            return len(self.commands) > before + 3

        self.rig.spin_until(more, "commands")


# ---------------------------------------------------------------- numbers, units, words


def test_states_and_missions_are_told_in_eufs_numbers() -> None:
    states = [VehicleState(as_state=value) for value in (*map(int, AsState), 255)]
    assert [made.can_state(CanState, state, False).as_state for state in states] == [0, 0, 1, 2, 3, 4, 0]
    missions = [VehicleState(mission=value) for value in (*map(int, Ami), 255)]
    numbers = [made.can_state(CanState, state, False).ami_state for state in missions]
    assert numbers == [10, 11, 12, 13, 14, 18, 19, 15, 10]
    named = [getattr(CanState, f"AMI_{made._SIM2_AMI.get(state.mission, 'NOT_SELECTED')}") for state in missions]
    assert named == numbers, "the simulator's words are the names of the numbers"


def test_the_car_is_told_in_each_teams_words() -> None:
    state = VehicleState(as_state=int(AsState.EMERGENCY_BRAKE), mission=int(Ami.STATIC_INSPECTION_B))
    words = [getattr(made, f"{team}_words")(String, state, True).data for team in ("ros_can", "hydrakon", "sim2")]
    assert words == [
        "AS:EMERGENCY NO_SUCH_MESSAGE DRIVING:TRUE",
        "AS:EMERGENCY AMI:INSPECTION_B DRIVING:TRUE",
        "AMIState: DDT_INSPECTION_B  ASState: EMERGENCY_BRAKE",
    ]


def test_what_was_sent_and_the_pose_are_told_in_eufs_units() -> None:
    state = VehicleState(handshake=True, sent_mission_status=2, sent_direction=1, sent_front_brake=0.25)
    state.sent_rear_torque_nm, state.sent_steering_rad = 40.0, math.radians(-9.0)
    state.x, state.y, state.yaw_rad, state.speed_mps, state.yaw_rate_radps = 3.0, -2.0, math.pi / 2.0, 5.0, 0.5
    sent = made.vehicle_commands(VehicleCommandsStamped, state, True).commands
    pose = made.car_state(CarState, state, True)
    assert (sent.handshake, sent.ebs, sent.direction, sent.mission_status) == (1, 0, 1, 2)
    assert (sent.braking, sent.torque, sent.steering) == pytest.approx((25.0, 40.0, -9.0))
    stopped = made.vehicle_commands(VehicleCommandsStamped, VehicleState(sent_estop_request=True), True)
    assert stopped.commands.ebs == 1
    assert (pose.pose.pose.position.x, pose.pose.pose.position.y) == (3.0, -2.0)
    assert (pose.pose.pose.orientation.z, pose.pose.pose.orientation.w) == pytest.approx((0.5**0.5, 0.5**0.5))
    assert (pose.twist.twist.linear.x, pose.twist.twist.angular.z) == (5.0, 0.5)


def test_wheels_turn_per_minute_here_per_second_in_the_simulator() -> None:
    state = VehicleState(steering_rad=0.1, wheel_speed_rpm=[60, 120, 180, 240])
    for make, turns in ((made.wheel_speeds, 60.0), (made.wheel_turns, 1.0)):
        speeds = make(WheelSpeedsStamped, state, True).speeds
        assert speeds.steering == pytest.approx(0.1)
        told = (speeds.lf_speed, speeds.rf_speed, speeds.lb_speed, speeds.rb_speed)
        assert told == (turns, 2.0 * turns, 3.0 * turns, 4.0 * turns)


def test_vcu2ai_has_the_cars_numbers_degrees_and_per_cent() -> None:
    state = VehicleState(handshake=True, go_signal=True, as_state=3, mission=1, steering_rad=math.radians(-9.0))
    state.front_brake, state.rear_brake = 0.25, 0.5
    state.wheel_speed_rpm, state.wheel_pulses = [1, 2, 3, 4], [5, 6, 7, 65535]
    told = made.vcu2ai(VCU2AI, state, True)
    assert (told.handshake_receive_bit, told.res_go_signal) == (True, True)
    assert (told.as_state, told.ami_state) == (VCU2AI.AS_DRIVING, VCU2AI.AMI_ACCELERATION)
    assert (told.steer_angle_deg, told.brake_press_f_pct, told.brake_press_r_pct) == pytest.approx((-9.0, 25.0, 50.0))
    assert (told.fl_wheel_speed_rpm, told.rr_wheel_speed_rpm, told.rr_pulse_count) == (1.0, 4.0, 65535)
    unknown = made.vcu2ai(VCU2AI, VehicleState(as_state=255, mission=255), True)
    assert (unknown.as_state, unknown.ami_state) == (0, 0)


def test_cones_keep_place_and_color() -> None:
    seen = ConeArray(cones=[Cone(x=3.0, y=1.0, color=Cone.BIG_ORANGE), Cone(x=4.0)])
    lists = made.cones(ConeArrayWithCovariance, seen, True)
    assert [cone.point.x for cone in lists.big_orange_cones] == [3.0]
    assert [cone.point.x for cone in lists.unknown_color_cones] == [4.0]
    first, second = made.cones_with_color(ConeWithColorProbabilityArray, seen, True).cones
    assert (first.id, first.point.x, first.point.y, first.big_orange_prob, first.unknown_prob) == (
        0,
        3.0,
        1.0,
        1.0,
        0.0,
    )
    assert (second.id, second.unknown_prob) == (1, 1.0)


# ---------------------------------------------------------------- commands


def test_an_acceleration_becomes_throttle_or_brake(rig: RosRig) -> None:
    stack = Stack(rig)
    before = rig.stamp()
    command = stack.until(lambda c: c.throttle > 0.0, "throttle", 2.0, acceleration=1.0, steering=0.1)
    assert command.throttle == pytest.approx(throttle_for(ADS_DV_2026, 1.0, 2.0)) and command.brake == 0.0
    assert command.steering_rad == pytest.approx(0.1) and command.run_id == 7
    assert command.header.stamp.sec >= before.sec, "an unstamped command is as old as its arrival"
    command = stack.until(lambda c: c.brake > HOLDING_BRAKE, "brake", 2.0, acceleration=-3.0, steering=-2.0)
    assert command.brake == pytest.approx(brake_for(ADS_DV_2026, 3.0, 2.0)) and command.throttle == 0.0
    assert command.steering_rad == -ADS_DV_2026.steer_max_rad, "cut off, as ros_can does: else it would be refused"
    stack.until(lambda c: c.mission_finished, "finished", finish=True)
    assert stack.until(lambda c: c.brake == HOLDING_BRAKE, "held", acceleration=1.0).mission_finished, "it stays so"


def test_a_speed_is_held_where_commands_are_speeds(rig: RosRig) -> None:
    stack = Stack(rig, command_mode="speed")
    assert stack.until(lambda c: c.brake > HOLDING_BRAKE, "brakes to speed 0", 4.0).throttle == 0.0
    assert stack.until(lambda c: c.throttle > 0.0, "drives faster", 4.0, speed=5.0).brake == 0.0
    assert not stack.until(lambda c: c.brake > 0.0, "a negative one brakes", 4.0, speed=-1.0).mission_finished


def test_fsai_api_brakes_and_finishes_by_topics(rig: RosRig) -> None:
    stack = Stack(rig, preset="fsai_api")
    stack.until(lambda c: c.throttle > 0.0, "throttle", 2.0, speed=4.0)
    command = stack.until(lambda c: c.brake == ASKED_BRAKE, "the brake that is asked for", 2.0, speed=4.0, brake=True)
    assert command.throttle == 0.0
    stack.until(lambda c: c.throttle > 0.0, "throttle again", 2.0, speed=4.0, brake=False)
    stack.flags["finish"].publish(Bool(data=True))  # once
    stack.until(lambda c: c.mission_finished, "finished", 2.0, speed=4.0)


def test_a_negative_speed_finishes_where_the_team_has_it_so(rig: RosRig) -> None:
    Stack(rig, preset="fsai_api").until(lambda c: c.mission_finished, "finished", speed=-0.1)


def test_a_finish_before_the_car_may_move_is_the_last_runs(rig: RosRig) -> None:
    stack = Stack(rig)
    runs = rig.tester.create_publisher(RunState, "/run_state", qos.STATE)
    stack.until(lambda c: c.throttle > 0.0, "throttle", acceleration=1.0)
    runs.publish(RunState(run_id=7, mission=int(Ami.TRACKDRIVE), as_state=int(AsState.AS_READY)))
    rig.spin_until(lambda: not stack.node._run.may_move, "it may not move")
    many = len(stack.commands) + 10
    stack.until(lambda _: len(stack.commands) > many, "it has heard it", finish=True)
    rig.turns(50)  # all of them
    runs.publish(RunState(run_id=7, mission=int(Ami.TRACKDRIVE), as_state=int(AsState.AS_DRIVING), may_move=True))
    assert not stack.until(lambda c: c.throttle > 0.0, "throttle", acceleration=1.0).mission_finished


def test_flags_may_be_services(rig: RosRig) -> None:
    stack = Stack(rig, finish="service:done", brake="service:slow")
    stack.until(lambda c: c.throttle > 0.0, "throttle", acceleration=1.0)
    assert rig.ask(Trigger, "/slow").success
    stack.until(lambda c: c.brake == ASKED_BRAKE, "the brake", acceleration=1.0)
    assert rig.ask(Trigger, "/done").success
    stack.until(lambda c: c.mission_finished, "finished", acceleration=1.0)


def test_without_the_driving_flag_the_car_is_held(rig: RosRig) -> None:
    stack = Stack(rig)
    command = stack.until(lambda c: c.brake > 0.0, "the holding brake", acceleration=2.0, driving=False)
    assert (command.brake, command.throttle, command.steering_rad) == (HOLDING_BRAKE, 0.0, 0.0)


def test_the_car_is_held_until_the_first_command_and_says_why(rig: RosRig) -> None:
    stack = Stack(rig, preset="eufs_sim2")
    stack.commanded()
    assert stack.commands[-1].brake == HOLDING_BRAKE and "/cmd" in stack.commands[-1].note


def test_a_stack_that_falls_silent_is_not_spoken_for(rig: RosRig) -> None:
    stack = Stack(rig, cmd_timeout=0.1)
    stack.until(lambda c: c.throttle > 0.0, "throttle", acceleration=1.0)

    def silent() -> bool:
        stack.state()
        known = len(stack.commands)
        rig.turns(30)
        return len(stack.commands) == known

    rig.spin_until(silent, "no command any more, though the car still reports")


def test_a_command_is_repeated_for_less_than_its_data_may_be_old() -> None:
    (timeout,) = (each for each in SETTINGS if each.name == "cmd_timeout")
    assert timeout.high == MOST_REPEATED_S == pytest.approx(0.4)
    assert timeout.low < 0.1 < timeout.default, "a stack that speaks ten times a second is spoken for"


def test_a_run_is_confirmed_once_a_stack_is_there(rig: RosRig) -> None:
    said = rig.subscribe(ResetConfirmation, "/reset_confirmation", qos.CONFIRMATION)
    stack = Stack(rig)
    rig.tester.destroy_publisher(stack.commanding)
    rig.spin_until(lambda: not stack.node.count_publishers("cmd"), "no stack")
    said.clear()
    stack.node._confirmed = None
    stack.commanded()
    assert said == []
    stack.commanding = rig.tester.create_publisher(AckermannDriveStamped, "/cmd", 1)
    stack.until(lambda _: len(said) == 2, "both confirmations")
    assert {(each.role, each.run_id) for each in said} == {("planner", 7), ("controller", 7)}


# ---------------------------------------------------------------- what the stack hears and may ask


@pytest.mark.parametrize("preset", PRESETS)
def test_each_output_of_a_preset_is_heard(rig: RosRig, preset: str) -> None:
    has = PRESETS[preset]
    outputs = {name: made.OUTPUTS[kind] for name, kind in has.outputs.items() if kind in made.OUTPUTS}
    heard = {name: rig.subscribe(made.ros_type(output.kind), f"/{name}", 1) for name, output in outputs.items()}
    stack = Stack(rig, preset=preset)
    cones = rig.tester.create_publisher(ConeArray, "/detected_cones", qos.SENSOR)

    def all_heard() -> bool:
        stack.state(AsState.AS_READY)
        cones.publish(ConeArray(cones=[Cone(x=3.0, color=Cone.BLUE)]))
        return all(heard.values())

    rig.spin_until(all_heard, "all of it")
    assert outputs and rig.tester.count_subscribers(f"/{has.command}") == 1


def test_services_by_eufs_names_are_the_bridges(rig: RosRig) -> None:
    stack = Stack(rig)
    assert not rig.ask(Trigger, "/ros_can/ebs").success, "no bridge, and it is said"
    rig.tester.create_service(
        Trigger, "/emergency_brake", lambda _, answer: Trigger.Response(success=True, message="it is")
    )
    rig.spin_until(stack.node._asked["emergency_brake"].service_is_ready, "the bridge's service")
    answer = rig.ask(Trigger, "/ros_can/ebs")
    assert (answer.success, answer.message) == (True, "it is")
    stack.until(lambda _: True, "the mission is known")
    assert rig.ask(SetCanState, "/ros_can/set_mission", ami_state=CanState.AMI_TRACK_DRIVE).success
    refused = rig.ask(SetCanState, "/ros_can/set_mission", ami_state=CanState.AMI_SKIDPAD)
    assert not refused.success and "AMI shows 14, not 12" in refused.message


def test_mission_and_go_of_eufs_sim2_are_the_cars(rig: RosRig) -> None:
    stack = Stack(rig, preset="eufs_sim2")
    assert "the RES; the car says nothing yet" in rig.ask(Trigger, "/go").message
    stack.until(lambda _: True, "the mission is known")
    assert rig.ask(Trigger, "/go").success
    assert rig.ask(SetMission, "/set_mission", mission=SetMission.Request.TRACK_DRIVE).success
    assert "AMI shows 4, not 1" in rig.ask(SetMission, "/set_mission", mission=1).message


def test_an_emergency_on_a_topic_latches_until_it_is_released(rig: RosRig) -> None:
    asked: list[str] = []

    def answer(name: str, response: Trigger.Response) -> Trigger.Response:
        asked.append(name)
        response.success = name != "reset" or asked.count("reset") > 1  # refused at first: the car still drives
        return response

    for name in ("emergency_brake", "reset"):
        rig.tester.create_service(Trigger, f"/{name}", lambda _, response, name=name: answer(name, response))
    stack = Stack(rig, preset="fsai_api")
    for client in stack.node._asked.values():
        rig.spin_until(client.service_is_ready, "the bridge's services")
    stack.until(lambda c: c.estop_request, "the emergency", speed=4.0, emergency=True)
    rig.spin_until(lambda: stack.node._told, "the bridge has it")
    for _ in range(3):
        stack.until(lambda c: c.estop_request, "it holds", speed=4.0, emergency=True)
    assert asked == ["emergency_brake"], "told once"
    stack.until(lambda c: not c.estop_request, "released", speed=4.0, emergency=False)
    rig.spin_until(lambda: not stack.node._told, "the release has come through")
    assert asked == ["emergency_brake", "reset", "reset"], "until it is not refused"


def test_an_emergency_is_passed_on_once_there_is_a_bridge(rig: RosRig) -> None:
    node = rig.start(AckermannAdapter, preset="fsai_api")
    rig.tester.create_publisher(Bool, "/emergency_brake", qos.STATE).publish(Bool(data=True))
    rig.spin_until(lambda: node._emergency, "the emergency")
    rig.announce()
    rig.spin_until(lambda: node._run.run_id == 7, "a new run")
    rig.tester.create_service(Trigger, "/emergency_brake", lambda _, answer: Trigger.Response(success=True))
    rig.spin_until(lambda: node._told, "the bridge has it")


# ---------------------------------------------------------------- parameters


def test_parameters_change_a_preset(rig: RosRig) -> None:
    node = rig.start(
        AckermannAdapter, preset="fsai_api", command="/our/cmd", brake="none", outputs="car=vcu2ai, /where=odometry"
    )
    has = interface_of(node._settings)
    assert (has.command, has.command_type, has.brake) == ("/our/cmd", "AckermannDrive", "")
    assert has.outputs == {"car": "vcu2ai", "/where": "odometry"}
    assert rig.tester.count_subscribers("/our/cmd") == 1 and not rig.tester.count_subscribers("/brake")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"command": "none"}, "without commands there is nothing"),
        ({"finish": "done"}, "finish must be topic:NAME or service:NAME, not done"),
        ({"outputs": "ros_can/state=word"}, "ros_can/state is of no known kind: word"),
        ({"driving": "a topic"}, "'a topic' is not a name of a topic or service: topic name must not contain"),
        ({"finish": "topic:"}, "finish must be topic:NAME"),
        ({"preset": "ours"}, "preset must be one of eufs, "),
        ({"cmd_timeout": 0.5}, "cmd_timeout"),
    ],
)
def test_an_interface_that_cannot_be_is_refused_in_words(rig: RosRig, given: dict[str, object], words: str) -> None:
    with pytest.raises(NodeError, match=words):
        rig.start(AckermannAdapter, **given)


def test_only_the_messages_of_the_own_team_are_needed(rig: RosRig, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("eufs_msgs.msg", "eufs_msgs.srv", "fsai_api.msg"):
        monkeypatch.setitem(sys.modules, package, None)
    assert rig.start(AckermannAdapter, preset="hydrakon_can")._outputs
    with pytest.raises(NodeError, match=r"eufs_msgs.*bring-your-own-stack"):
        rig.start(AckermannAdapter)


def test_without_a_teams_messages_one_line_says_so() -> None:
    code = (
        "import sys; sys.modules['eufs_msgs'] = None; from fsai_nodes.ackermann_adapter import main; sys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and "eufs_msgs" in done.stderr
