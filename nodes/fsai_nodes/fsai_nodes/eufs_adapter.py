"""eufs_adapter: EUFS's interface to the car (its ros_can node, and what its simulator adds) on top of vcu_bridge.

It takes the place of path_planner and vehicle_controller: a stack that was written for ros_can publishes `/cmd` and two
flags, and this node makes a vehicle command of them. It needs ackermann_msgs and eufs_msgs (nodes/eufs has both).
"""

from __future__ import annotations

import math
from functools import partial

from fsai_msgs.msg import Cone, ConeArray, ResetConfirmation, RunState, VehicleCommand, VehicleState
from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from std_msgs.msg import Bool, Header, String
from std_srvs.srv import Trigger

from fsai_nodes.clocks import Clocks, nanoseconds
from fsai_nodes.conversions import BASE_FRAME, motion_from_state, odometry_to_msg
from fsai_nodes.door import Door
from fsai_nodes.parameters import NodeParameter, Settings
from fsai_nodes.process import run
from fsai_nodes.qos import SENSOR, publisher
from fsai_vcu.core.vehicle.forces import brake_for, throttle_for
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState

try:
    from ackermann_msgs.msg import AckermannDriveStamped
    from eufs_msgs.msg import (
        CanState,
        CarState,
        ConeArrayWithCovariance,
        ConeWithCovariance,
        VehicleCommands,
        VehicleCommandsStamped,
        WheelSpeedsStamped,
    )
    from eufs_msgs.srv import SetCanState
except ImportError as error:
    raise SystemExit(f"eufs_adapter: {error}: docs/bring-your-own-stack.md says who builds these messages") from None

FRAME = "base_footprint"  # ros_can's name for the car; ours is the rear axle's centre on the ground
PERIOD_S = 0.02  # 50 Hz, as the bridge asks for; stacks speak more slowly, and ros_can repeats what they said last
HOLDING_BRAKE = 0.2  # while the stack does not drive
COASTING_MPS2 = 0.5  # a smaller deceleration is left to the resistance of air and tyres
SPEED_GAIN_1PS = 1.0  # acceleration per speed error, where commands are speeds

AS_STATES = {
    AsState.AS_READY: CanState.AS_READY,
    AsState.AS_DRIVING: CanState.AS_DRIVING,
    AsState.EMERGENCY_BRAKE: CanState.AS_EMERGENCY_BRAKE,
    AsState.AS_FINISHED: CanState.AS_FINISHED,
}  # all others are AS_OFF
MISSIONS = {
    Ami.ACCELERATION: CanState.AMI_ACCELERATION,
    Ami.SKIDPAD: CanState.AMI_SKIDPAD,
    Ami.AUTOCROSS: CanState.AMI_AUTOCROSS,
    Ami.TRACKDRIVE: CanState.AMI_TRACK_DRIVE,
    Ami.STATIC_INSPECTION_A: CanState.AMI_DDT_INSPECTION_A,
    Ami.STATIC_INSPECTION_B: CanState.AMI_DDT_INSPECTION_B,
    Ami.AUTONOMOUS_DEMO: CanState.AMI_AUTONOMOUS_DEMO,
}
AS_WORDS = ("OFF", "READY", "DRIVING", "EMERGENCY", "FINISHED")
AMI_WORDS = {
    CanState.AMI_NOT_SELECTED: "NOT_SELECTED",
    CanState.AMI_ACCELERATION: "ACCELERATION",
    CanState.AMI_SKIDPAD: "SKIDPAD",
    CanState.AMI_AUTOCROSS: "AUTOCROSS",
    CanState.AMI_TRACK_DRIVE: "TRACKDRIVE",
    CanState.AMI_DDT_INSPECTION_A: "INSPECTION",
}  # the others' are NO_SUCH_MESSAGE, as ros_can has it
CONES = {
    Cone.BLUE: "blue_cones",
    Cone.YELLOW: "yellow_cones",
    Cone.ORANGE: "orange_cones",
    Cone.BIG_ORANGE: "big_orange_cones",
}

SETTINGS = (
    NodeParameter("car", "2026", "Vehicle parameters to drive with.", choices=tuple(CARS)),
    NodeParameter(
        "command_mode",
        "acceleration",
        "What counts of /cmd: its acceleration, as with ros_can, or its speed (eufs_sim's velocity).",
        choices=("acceleration", "velocity"),
    ),
    NodeParameter("max_speed", 30.0, "The car is driven no faster than this, in m/s.", low=0.5, high=30.0, live=True),
    NodeParameter(
        "cmd_timeout",
        0.2,
        "For so long is a /cmd repeated, in s; the bridge brakes 0.3 s later: together ros_can's 0.5 s.",
        low=0.05,
        high=0.5,
    ),
)


def can_state(state: VehicleState) -> CanState:
    """AS and AMI state in EUFS's numbers."""
    return CanState(
        as_state=AS_STATES.get(state.as_state, CanState.AS_OFF),
        ami_state=MISSIONS.get(state.mission, CanState.AMI_NOT_SELECTED),
    )


def words_of(state: CanState, driving: bool) -> str:
    """As on /ros_can/state_str."""
    ami = AMI_WORDS.get(state.ami_state, "NO_SUCH_MESSAGE")
    ami = ami if ami == "NO_SUCH_MESSAGE" else f"AMI:{ami}"
    return f"AS:{AS_WORDS[state.as_state]} {ami} DRIVING:{str(driving).upper()}"


def vehicle_commands(state: VehicleState) -> VehicleCommands:
    """What was sent, in the units of the wire. The motors' speed limit is in no VehicleState."""
    return VehicleCommands(
        handshake=int(state.handshake),
        ebs=int(state.sent_estop_request),
        direction=state.sent_direction,
        mission_status=state.sent_mission_status,
        braking=100.0 * state.sent_front_brake,
        torque=max(state.sent_front_torque_nm, state.sent_rear_torque_nm),  # a car of 2026 is driven by one of them
        steering=math.degrees(state.sent_steering_rad),
        rpm=math.nan,
    )


def car_state(state: VehicleState) -> CarState:
    """Where the run's odometry has the car; accelerations are not measured by it."""
    odometry = odometry_to_msg(motion_from_state(state, 0), state.header.stamp)
    message = CarState(header=odometry.header, child_frame_id=FRAME, pose=odometry.pose, twist=odometry.twist)
    message.linear_acceleration_covariance[0] = -1.0  # sensor_msgs/Imu's word for: none
    return message


class EufsAdapter(Node):
    """Commands at a steady rate, from the newest /cmd while the stack's driving flag is set, else at rest."""

    def __init__(self, **options: object) -> None:
        super().__init__("eufs_adapter", **options)
        self._settings = Settings(self, SETTINGS, lambda _name: None)
        self._car = CARS[self._settings.text("car")]
        self._clocks = Clocks(self)
        self._run = RunState()
        self._confirmed: int | None = None
        self._state: VehicleState | None = None
        self._forget()
        self._command = publisher(self, VehicleCommand, "vehicle_cmd")
        self._confirmation = publisher(self, ResetConfirmation, "reset_confirmation")
        self._can_state = self.create_publisher(CanState, "ros_can/state", 1)
        self._words = self.create_publisher(String, "ros_can/state_str", 1)
        self._wheels = self.create_publisher(WheelSpeedsStamped, "ros_can/wheel_speeds", 1)
        self._twist = self.create_publisher(TwistWithCovarianceStamped, "ros_can/twist", 1)
        self._sent = self.create_publisher(VehicleCommandsStamped, "ros_can/vehicle_commands", 1)
        self._car_state = self.create_publisher(CarState, "odometry_integration/car_state", 1)
        self._cones = self.create_publisher(ConeArrayWithCovariance, "fusion/cones", 1)
        door = Door(self)
        door.subscription(RunState, "run_state", self._on_run)
        door.subscription(VehicleState, "vehicle_state", self._on_state)
        door.subscription(ConeArray, "detected_cones", self._on_cones)
        # As best effort each of them is received, whatever the stack promises.
        door.subscription(AckermannDriveStamped, "cmd", self._on_cmd, qos=SENSOR)
        door.subscription(Bool, "state_machine/driving_flag", self._on_driving_flag, qos=SENSOR)
        door.subscription(Bool, "ros_can/mission_completed", self._on_completed, qos=SENSOR)
        # A group of their own: a service of this node waits for their answers.
        group = ReentrantCallbackGroup()
        self._asked = {
            name: self.create_client(Trigger, name, callback_group=group) for name in ("emergency_brake", "reset")
        }
        door.service(Trigger, "ros_can/ebs", partial(self._ask, self._asked["emergency_brake"]))
        door.service(Trigger, "ros_can/reset", partial(self._ask, self._asked["reset"]))
        door.service(SetCanState, "ros_can/set_mission", self._on_set_mission)
        self._clocks.watch()
        self._clocks.every(PERIOD_S, self._tick)

    def _forget(self) -> None:
        self._cmd: AckermannDriveStamped | None = None
        self._cmd_ns = 0  # when it came
        self._driving = self._completed = False

    # ------------------------------------------------------------ from the bridge to the stack

    def _on_run(self, message: RunState) -> None:
        if message.run_id != self._run.run_id:
            self._state = None
            self._forget()
        self._run = message

    def _on_state(self, state: VehicleState) -> None:
        if state.run_id != self._run.run_id:
            return
        self._state = state
        if state.as_state != AsState.AS_DRIVING:
            self._driving = False  # it counts in AS_DRIVING only
        said = can_state(state)
        self._can_state.publish(said)
        self._words.publish(String(data=words_of(said, self._driving)))
        wheels = WheelSpeedsStamped(header=Header(stamp=state.header.stamp, frame_id=FRAME))
        speeds = wheels.speeds
        speeds.steering = state.steering_rad
        speeds.lf_speed, speeds.rf_speed, speeds.lb_speed, speeds.rb_speed = map(float, state.wheel_speed_rpm)
        self._wheels.publish(wheels)
        twist = TwistWithCovarianceStamped(header=wheels.header)
        twist.twist.twist.linear.x, twist.twist.twist.angular.z = state.speed_mps, state.yaw_rate_radps
        self._twist.publish(twist)
        self._sent.publish(VehicleCommandsStamped(header=wheels.header, commands=vehicle_commands(state)))
        self._car_state.publish(car_state(state))

    def _on_cones(self, message: ConeArray) -> None:
        cones = ConeArrayWithCovariance(header=Header(stamp=message.header.stamp, frame_id=FRAME))
        for each in message.cones:
            cone = ConeWithCovariance()
            cone.point.x, cone.point.y = each.x, each.y
            getattr(cones, CONES.get(each.color, "unknown_color_cones")).append(cone)
        self._cones.publish(cones)

    # ------------------------------------------------------------ from the stack to the bridge

    def _on_cmd(self, message: AckermannDriveStamped) -> None:
        self._cmd, self._cmd_ns = message, self._clocks.now_ns()

    def _on_driving_flag(self, message: Bool) -> None:
        self._driving = message.data and self._state is not None and self._state.as_state == AsState.AS_DRIVING

    def _on_completed(self, message: Bool) -> None:
        self._completed = message.data

    def _tick(self) -> None:
        state = self._state
        if state is None:
            return
        self._confirm()
        now_ns = self._clocks.now_ns()
        command = VehicleCommand(run_id=self._run.run_id)
        command.header.stamp, command.header.frame_id = state.header.stamp, BASE_FRAME
        if self._run.may_move:
            command.mission_finished = self._completed
            command.speed_limit_mps = self._settings.number("max_speed")
            if not self._driving:
                command.brake = HOLDING_BRAKE
            elif self._cmd is None or now_ns - self._cmd_ns > self._settings.number("cmd_timeout") * 1e9:
                return  # the bridge takes silence for what it is
            else:
                self._fill(command, self._cmd, state)
        self._command.publish(command)

    def _confirm(self) -> None:
        """For planner and controller both, once a stack is there; EUFS has no word for it, its stacks see AS_OFF."""
        if self._confirmed != self._run.run_id and self.count_publishers("cmd"):
            self._confirmed = self._run.run_id
            for role in (ResetConfirmation.PLANNER, ResetConfirmation.CONTROLLER):
                self._confirmation.publish(ResetConfirmation(role=role, run_id=self._run.run_id))

    def _fill(self, command: VehicleCommand, cmd: AckermannDriveStamped, state: VehicleState) -> None:
        drive, limit = cmd.drive, self._car.steer_max_rad
        # Many stacks leave the stamp empty: then the command is as old as its arrival.
        unset = not nanoseconds(cmd.header.stamp)
        command.header.stamp = self._clocks.stamp_of(self._cmd_ns) if unset else cmd.header.stamp
        command.steering_rad = min(max(drive.steering_angle, -limit), limit)  # ros_can cuts it off as well
        acceleration_mps2 = drive.acceleration
        if self._settings.text("command_mode") == "velocity":
            acceleration_mps2 = SPEED_GAIN_1PS * (drive.speed - state.speed_mps)
        if acceleration_mps2 < -COASTING_MPS2:
            command.brake = brake_for(self._car, -acceleration_mps2, state.speed_mps)
        elif acceleration_mps2 > 0.0 and state.speed_mps < command.speed_limit_mps:
            command.throttle = throttle_for(self._car, acceleration_mps2, state.speed_mps)

    # ------------------------------------------------------------ services

    async def _ask(self, client: Client, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """The bridge's answer."""
        if not client.service_is_ready():
            response.message = f"no bridge offers {client.srv_name}"
            return response
        return await client.call_async(Trigger.Request())

    def _on_set_mission(self, request: SetCanState.Request, response: SetCanState.Response) -> SetCanState.Response:
        """A mission is chosen at the car, on the AMI; this says whether it is the one that is asked for."""
        shown = CanState.AMI_NOT_SELECTED if self._state is None else can_state(self._state).ami_state
        response.success = request.ami_state == shown
        if not response.success:
            response.message = f"the mission is chosen at the car: its AMI shows {shown}, not {request.ami_state}"
        return response


main = partial(run, [EufsAdapter], "eufs_adapter")


if __name__ == "__main__":
    raise SystemExit(main())
