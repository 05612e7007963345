"""Outputs of ackermann_adapter: this project's messages in the types, numbers and words of the teams' interfaces. Pure.

Each kind has the type that it makes. Types are looked for only when a preset asks for them: a team has its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Any

from fsai_msgs.msg import Cone, ConeArray, VehicleState

from fsai_nodes.conversions import motion_from_state, odometry_to_msg
from fsai_vcu.interface.enums import Ami, AsState

FRAME = "base_footprint"  # the teams' name for the car; here its origin is the rear axle's centre on the ground
RPM_PER_TURN_PS = 60.0

# ---------------------------------------------------------------- numbers and words

AS_STATES = {AsState.AS_READY: 1, AsState.AS_DRIVING: 2, AsState.EMERGENCY_BRAKE: 3, AsState.AS_FINISHED: 4}
"""Numbers of eufs_msgs/CanState; all other states are AS_OFF, 0."""
CAN_MISSIONS = {
    Ami.ACCELERATION: 11,
    Ami.SKIDPAD: 12,
    Ami.AUTOCROSS: 13,
    Ami.TRACKDRIVE: 14,
    Ami.AUTONOMOUS_DEMO: 15,
    Ami.STATIC_INSPECTION_A: 18,
    Ami.STATIC_INSPECTION_B: 19,
}
"""Numbers of eufs_msgs/CanState."""
NO_CAN_MISSION = 10
SET_MISSIONS = {
    Ami.ACCELERATION: 1,
    Ami.SKIDPAD: 2,
    Ami.AUTOCROSS: 3,
    Ami.TRACKDRIVE: 4,
    Ami.STATIC_INSPECTION_A: 8,
    Ami.STATIC_INSPECTION_B: 9,
    Ami.AUTONOMOUS_DEMO: 10,
}
"""Numbers of eufs_msgs/SetMission; 0 is none."""
_AS_WORDS = {
    AsState.AS_READY: "READY",
    AsState.AS_DRIVING: "DRIVING",
    AsState.EMERGENCY_BRAKE: "EMERGENCY",
    AsState.AS_FINISHED: "FINISHED",
}
_ROS_CAN_AMI = {
    Ami.ACCELERATION: "AMI:ACCELERATION",
    Ami.SKIDPAD: "AMI:SKIDPAD",
    Ami.AUTOCROSS: "AMI:AUTOCROSS",
    Ami.TRACKDRIVE: "AMI:TRACKDRIVE",
    Ami.STATIC_INSPECTION_A: "AMI:INSPECTION",
    Ami.STATIC_INSPECTION_B: "NO_SUCH_MESSAGE",
    Ami.AUTONOMOUS_DEMO: "NO_SUCH_MESSAGE",
}
_HYDRAKON_AMI = _ROS_CAN_AMI | {
    Ami.STATIC_INSPECTION_A: "AMI:INSPECTION_A",
    Ami.STATIC_INSPECTION_B: "AMI:INSPECTION_B",
    Ami.AUTONOMOUS_DEMO: "AMI:AUTONOMOUS_DEMO",
}
_SIM2_AMI = {
    Ami.ACCELERATION: "ACCELERATION",
    Ami.SKIDPAD: "SKIDPAD",
    Ami.AUTOCROSS: "AUTOCROSS",
    Ami.TRACKDRIVE: "TRACK_DRIVE",
    Ami.STATIC_INSPECTION_A: "DDT_INSPECTION_A",
    Ami.STATIC_INSPECTION_B: "DDT_INSPECTION_B",
    Ami.AUTONOMOUS_DEMO: "AUTONOMOUS_DEMO",
}
_CONES = {
    Cone.BLUE: "blue",
    Cone.YELLOW: "yellow",
    Cone.ORANGE: "orange",
    Cone.BIG_ORANGE: "big_orange",
}  # all others are unknown


@dataclass(frozen=True, slots=True)
class OutputKind:
    """One kind: its type as 'package/Name', what makes it, and of which message it is made."""

    kind: str
    make: Callable[..., Any]
    of: type[Any]


def ros_type(name: str, of: str = "msg") -> type[Any]:
    """The class of 'package/Name'; of: msg or srv. Raises ImportError where it is not there."""
    package, _, kind = name.partition("/")
    try:
        return getattr(import_module(f"{package}.{of}"), kind)  # type: ignore[no-any-return]
    except AttributeError:
        raise ImportError(f"{kind} is not in this {package}") from None


OUTPUTS: dict[str, OutputKind] = {}


def _output(kind: str, of: type[Any] = VehicleState) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The function (type, the project's message, whether the stack drives) makes the output of its name."""

    def entered(make: Callable[..., Any]) -> Callable[..., Any]:
        OUTPUTS[make.__name__] = OutputKind(kind, make, of)
        return make

    return entered


def _stamped(kind: type[Any], state: VehicleState) -> Any:
    message = kind()
    message.header.stamp, message.header.frame_id = state.header.stamp, FRAME
    return message


# ---------------------------------------------------------------- states


@_output("eufs_msgs/CanState")
def can_state(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    return kind(as_state=AS_STATES.get(state.as_state, 0), ami_state=CAN_MISSIONS.get(state.mission, NO_CAN_MISSION))


def _words(missions: Mapping[Ami, str], state: VehicleState, driving: bool) -> str:
    mission = missions.get(state.mission, "AMI:NOT_SELECTED")
    return f"AS:{_AS_WORDS.get(state.as_state, 'OFF')} {mission} DRIVING:{str(driving).upper()}"


@_output("std_msgs/String")
def ros_can_words(kind: type[Any], state: VehicleState, driving: bool) -> Any:
    return kind(data=_words(_ROS_CAN_AMI, state, driving))


@_output("std_msgs/String")
def hydrakon_words(kind: type[Any], state: VehicleState, driving: bool) -> Any:
    return kind(data=_words(_HYDRAKON_AMI, state, driving))


@_output("std_msgs/String")
def sim2_words(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    as_word = _AS_WORDS.get(state.as_state, "OFF").replace("EMERGENCY", "EMERGENCY_BRAKE")
    return kind(data=f"AMIState: {_SIM2_AMI.get(state.mission, 'NOT_SELECTED')}  ASState: {as_word}")


@_output("fsai_api/VCU2AI")
def vcu2ai(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    """The car's own numbers, degrees and per cent; 0 for what it has not said."""
    fl, fr, rl, rr = map(float, state.wheel_speed_rpm)
    fl_count, fr_count, rl_count, rr_count = map(int, state.wheel_pulses)
    return kind(
        handshake_receive_bit=state.handshake,
        res_go_signal=state.go_signal,
        as_state=0 if state.as_state == VehicleState.UNKNOWN else state.as_state,
        ami_state=0 if state.mission == VehicleState.UNKNOWN else state.mission,
        steer_angle_deg=math.degrees(state.steering_rad),
        brake_press_f_pct=100.0 * state.front_brake,
        brake_press_r_pct=100.0 * state.rear_brake,
        fl_wheel_speed_rpm=fl,
        fr_wheel_speed_rpm=fr,
        rl_wheel_speed_rpm=rl,
        rr_wheel_speed_rpm=rr,
        fl_pulse_count=fl_count,
        fr_pulse_count=fr_count,
        rl_pulse_count=rl_count,
        rr_pulse_count=rr_count,
    )


# ---------------------------------------------------------------- motion


def _wheels(message: Any, state: VehicleState, rpm_per_unit: float = 1.0) -> Any:
    message.steering = state.steering_rad
    speeds = (float(rpm) / rpm_per_unit for rpm in state.wheel_speed_rpm)
    message.lf_speed, message.rf_speed, message.lb_speed, message.rb_speed = speeds
    return message


@_output("eufs_msgs/WheelSpeedsStamped")
def wheel_speeds(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    message = _stamped(kind, state)
    _wheels(message.speeds, state)
    return message


@_output("eufs_msgs/WheelSpeedsStamped")
def wheel_turns(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    """Return the wheels in turns per second, as eufs_sim2 sends them."""
    message = _stamped(kind, state)
    _wheels(message.speeds, state, RPM_PER_TURN_PS)
    return message


@_output("hydrakon_can/WheelSpeed")
def hydrakon_wheel_speed(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    return _wheels(kind(), state)


@_output("geometry_msgs/TwistWithCovarianceStamped")
def twist(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    message = _stamped(kind, state)
    message.twist.twist.linear.x, message.twist.twist.angular.z = state.speed_mps, state.yaw_rate_radps
    return message


@_output("eufs_msgs/VehicleCommandsStamped")
def vehicle_commands(kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    """Return the commands that were sent, in the units of the wire. The motors' speed limit is in no VehicleState."""
    message = _stamped(kind, state)
    sent = message.commands
    sent.handshake, sent.ebs = int(state.handshake), int(state.sent_estop_request)
    sent.direction, sent.mission_status = state.sent_direction, state.sent_mission_status
    sent.braking = 100.0 * state.sent_front_brake
    sent.torque = max(state.sent_front_torque_nm, state.sent_rear_torque_nm)  # a car of 2026 is driven by one of them
    sent.steering, sent.rpm = math.degrees(state.sent_steering_rad), math.nan
    return message


@_output("nav_msgs/Odometry")
def odometry(_kind: type[Any], state: VehicleState, _driving: bool) -> Any:
    """Return where the run's odometry has the car."""
    message = odometry_to_msg(motion_from_state(state, 0), state.header.stamp)
    message.child_frame_id = FRAME
    return message


@_output("eufs_msgs/CarState")
def car_state(kind: type[Any], state: VehicleState, driving: bool) -> Any:
    """Return where the run's odometry has the car, as CarState; accelerations are not measured by it."""
    place = odometry(kind, state, driving)
    message = kind(header=place.header, child_frame_id=FRAME, pose=place.pose, twist=place.twist)
    message.linear_acceleration_covariance[0] = -1.0  # sensor_msgs/Imu's word for: none
    return message


# ---------------------------------------------------------------- cones


@_output("eufs_msgs/ConeArrayWithCovariance", ConeArray)
def cones(kind: type[Any], seen: ConeArray, _driving: bool) -> Any:
    message = _stamped(kind, seen)
    one = ros_type("eufs_msgs/ConeWithCovariance")
    for each in seen.cones:
        cone = one()
        cone.point.x, cone.point.y = each.x, each.y
        color = _CONES.get(each.color, "unknown_color")
        getattr(message, f"{color}_cones").append(cone)
    return message


@_output("eufs_msgs/ConeWithColorProbabilityArray", ConeArray)
def cones_with_color(kind: type[Any], seen: ConeArray, _driving: bool) -> Any:
    message = _stamped(kind, seen)
    one = ros_type("eufs_msgs/ConeWithColorProbability")
    for number, each in enumerate(seen.cones):
        cone = one(id=number)
        cone.point.x, cone.point.y = each.x, each.y
        setattr(cone, f"{_CONES.get(each.color, 'unknown')}_prob", 1.0)
        message.cones.append(cone)
    return message


# ---------------------------------------------------------------- services that only answer


def set_can_state(request: Any, state: VehicleState | None) -> str:
    """Return why the car's display does not show the mission that is asked for; empty where it does."""
    return _chosen(request.ami_state, CAN_MISSIONS.get(getattr(state, "mission", None), NO_CAN_MISSION))


def set_mission(request: Any, state: VehicleState | None) -> str:
    """Return the same as `set_can_state`, in the numbers of SetMission."""
    return _chosen(request.mission, SET_MISSIONS.get(getattr(state, "mission", None), 0))


def _chosen(asked: int, shown: int) -> str:
    return "" if asked == shown else f"the mission is chosen at the car: its AMI shows {shown}, not {asked}"


def go(_request: Any, state: VehicleState | None) -> str:
    """Return why the car does not drive; empty where it does. Go is the remote control's."""
    if state is not None and state.as_state == AsState.AS_DRIVING:
        return ""
    shown = "nothing yet" if state is None else state.as_state_label or str(state.as_state)
    return f"Go is given by the remote control, the RES; the car says {shown}"


ANSWERS: Mapping[str, tuple[str, Callable[[Any, VehicleState | None], str]]] = MappingProxyType(
    {
        "set_can_state": ("eufs_msgs/SetCanState", set_can_state),
        "set_mission": ("eufs_msgs/SetMission", set_mission),
        "go": ("std_srvs/Trigger", go),
    }
)
"""Services by their kind: the type, and what says why the answer is no."""
