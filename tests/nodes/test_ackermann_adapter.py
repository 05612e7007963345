"""EUFS's interface on top of the bridge: what a stack written for ros_can says and hears."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest
from ackermann_msgs.msg import AckermannDriveStamped
from eufs_msgs.msg import CanState, CarState, ConeArrayWithCovariance, VehicleCommandsStamped, WheelSpeedsStamped
from eufs_msgs.srv import SetCanState
from fsai_msgs.msg import Cone, ConeArray, ResetConfirmation, VehicleCommand, VehicleState
from ros_rig import RosRig, driven
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from fsai_nodes import qos
from fsai_nodes.eufs_adapter import HOLDING_BRAKE, EufsAdapter, can_state, car_state, vehicle_commands
from fsai_vcu.core.vehicle.forces import brake_for, throttle_for
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami, AsState


class Stack:
    """The tester as bridge and stack around an adapter, in AS_DRIVING."""

    def __init__(self, rig: RosRig, **parameters: object) -> None:
        self.rig = rig
        self.node = rig.start(EufsAdapter, **parameters)
        make = rig.tester.create_publisher
        self._state = make(VehicleState, "/vehicle_state", qos.STATE)
        self.cmd = make(AckermannDriveStamped, "/cmd", 1)
        self._flag, self._completed = (
            make(Bool, "/state_machine/driving_flag", 1),
            make(Bool, "/ros_can/mission_completed", 1),
        )
        self.commands = rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)
        rig.announce()

    def says(
        self, acceleration: float = 0.0, steering: float = 0.0, driving: bool = True, completed: bool = False
    ) -> None:
        message = AckermannDriveStamped()
        message.drive.acceleration, message.drive.steering_angle = acceleration, steering
        self.cmd.publish(message)
        self._flag.publish(Bool(data=driving))
        self._completed.publish(Bool(data=completed))

    def state(self, as_state: AsState = AsState.AS_DRIVING, speed_mps: float = 0.0) -> None:
        message = VehicleState(run_id=7, as_state=int(as_state), mission=int(Ami.TRACKDRIVE), speed_mps=speed_mps)
        message.wheel_speed_rpm = [1, 2, 3, 4]
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


def test_states_and_missions_are_told_in_eufs_numbers() -> None:
    as_states = [can_state(VehicleState(as_state=value)).as_state for value in (*map(int, AsState), 255)]
    assert as_states == [0, 0, 1, 2, 3, 4, 0]
    missions = [can_state(VehicleState(mission=value)).ami_state for value in (*map(int, Ami), 255)]
    assert missions == [10, 11, 12, 13, 14, 18, 19, 15, 10]


def test_what_was_sent_and_the_pose_are_told_in_eufs_units() -> None:
    state = VehicleState(handshake=True, sent_mission_status=2, sent_direction=1, sent_front_brake=0.25)
    state.sent_rear_torque_nm, state.sent_steering_rad = 40.0, math.radians(-9.0)
    state.x, state.y, state.yaw_rad, state.speed_mps, state.yaw_rate_radps = 3.0, -2.0, math.pi / 2.0, 5.0, 0.5
    sent, pose = vehicle_commands(state), car_state(state)
    assert (sent.handshake, sent.ebs, sent.direction, sent.mission_status) == (1, 0, 1, 2)
    assert (sent.braking, sent.torque, sent.steering) == pytest.approx((25.0, 40.0, -9.0))
    assert vehicle_commands(VehicleState(sent_estop_request=True)).ebs == 1
    assert (pose.pose.pose.position.x, pose.pose.pose.position.y) == (3.0, -2.0)
    assert (pose.pose.pose.orientation.z, pose.pose.pose.orientation.w) == pytest.approx((0.5**0.5, 0.5**0.5))
    assert (pose.twist.twist.linear.x, pose.twist.twist.angular.z) == (5.0, 0.5)


def test_an_acceleration_becomes_throttle_or_brake(rig: RosRig) -> None:
    stack = Stack(rig)
    before = rig.stamp()
    command = stack.until(lambda c: c.throttle > 0.0, "throttle", 2.0, acceleration=1.0, steering=0.1)
    assert command.throttle == pytest.approx(throttle_for(ADS_DV_2026, 1.0, 2.0)) and command.brake == 0.0
    assert command.steering_rad == pytest.approx(0.1) and command.run_id == 7
    assert command.header.stamp.sec >= before.sec, "an unstamped /cmd is as old as its arrival"
    command = stack.until(lambda c: c.brake > HOLDING_BRAKE, "brake", 2.0, acceleration=-3.0, steering=-2.0)
    assert command.brake == pytest.approx(brake_for(ADS_DV_2026, 3.0, 2.0)) and command.throttle == 0.0
    assert command.steering_rad == -ADS_DV_2026.steer_max_rad, "cut off, as ros_can does: else it would be refused"
    stack.until(lambda c: c.mission_finished, "finished", completed=True)


def test_a_speed_is_held_where_commands_are_speeds(rig: RosRig) -> None:
    stack = Stack(rig, command_mode="velocity")
    assert stack.until(lambda c: c.brake > HOLDING_BRAKE, "brakes to speed 0", 4.0).throttle == 0.0


def test_without_the_driving_flag_the_car_is_held(rig: RosRig) -> None:
    stack = Stack(rig)
    command = stack.until(lambda c: c.brake > 0.0, "the holding brake", acceleration=2.0, driving=False)
    assert (command.brake, command.throttle, command.steering_rad) == (HOLDING_BRAKE, 0.0, 0.0)


def test_a_stack_that_falls_silent_is_not_spoken_for(rig: RosRig) -> None:
    stack = Stack(rig, cmd_timeout=0.1)
    stack.until(lambda c: c.throttle > 0.0, "throttle", acceleration=1.0)

    def silent() -> bool:
        stack.state()
        known = len(stack.commands)
        rig.turns(30)
        return len(stack.commands) == known

    rig.spin_until(silent, "no command any more, though the car still reports")


def test_a_run_is_confirmed_once_a_stack_is_there(rig: RosRig) -> None:
    said = rig.subscribe(ResetConfirmation, "/reset_confirmation", qos.CONFIRMATION)
    stack = Stack(rig)
    rig.tester.destroy_publisher(stack.cmd)
    rig.spin_until(lambda: not stack.node.count_publishers("cmd"), "no stack")
    said.clear()
    stack.node._confirmed = None
    before = len(stack.commands)

    def commanded() -> bool:
        stack.state()
        return len(stack.commands) > before + 3

    rig.spin_until(commanded, "commands")
    assert said == []
    stack.cmd = rig.tester.create_publisher(AckermannDriveStamped, "/cmd", 1)
    stack.until(lambda _: len(said) == 2, "both confirmations")
    assert {(each.role, each.run_id) for each in said} == {("planner", 7), ("controller", 7)}


def test_the_stack_hears_state_wheels_and_cones(rig: RosRig) -> None:
    states, words = rig.subscribe(CanState, "/ros_can/state", 1), rig.subscribe(String, "/ros_can/state_str", 1)
    wheels = rig.subscribe(WheelSpeedsStamped, "/ros_can/wheel_speeds", 1)
    seen = rig.subscribe(ConeArrayWithCovariance, "/fusion/cones", 1)
    sent = rig.subscribe(VehicleCommandsStamped, "/ros_can/vehicle_commands", 1)
    poses = rig.subscribe(CarState, "/odometry_integration/car_state", 1)
    stack = Stack(rig)
    cones = rig.tester.create_publisher(ConeArray, "/detected_cones", qos.SENSOR)

    def heard() -> bool:
        stack.state(AsState.AS_READY)
        cones.publish(ConeArray(cones=[Cone(x=3.0, color=Cone.BIG_ORANGE), Cone(x=4.0)]))
        return bool(states and words and wheels and seen and sent and poses)

    rig.spin_until(heard, "all of it")
    assert (states[-1].as_state, states[-1].ami_state) == (CanState.AS_READY, CanState.AMI_TRACK_DRIVE)
    assert words[-1].data == "AS:READY AMI:TRACKDRIVE DRIVING:FALSE"
    speeds = wheels[-1].speeds
    assert (speeds.lf_speed, speeds.rf_speed, speeds.lb_speed, speeds.rb_speed) == (1.0, 2.0, 3.0, 4.0)
    assert [cone.point.x for cone in seen[-1].big_orange_cones] == [3.0]
    assert [cone.point.x for cone in seen[-1].unknown_color_cones] == [4.0]


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


def test_an_eufs_stack_drives_the_acceleration_to_as_finished(tmp_path: Path) -> None:
    programs = ("--with", "fsai_nodes.eufs_adapter", "--with", str(Path(__file__).with_name("eufs_stack.py")))
    assert "acceleration: PASS" in driven(tmp_path, "--mission", "acceleration", *programs)


def test_without_eufs_messages_one_line_says_so() -> None:
    code = "import sys; sys.modules['eufs_msgs'] = None; import fsai_nodes.eufs_adapter"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and "eufs_msgs" in done.stderr
