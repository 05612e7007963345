"""Every message, request and goal that a node of this package takes, each of its fields declared once.

The one place for it: `fsai_nodes.door` refuses what does not fit, and makes no subscription or service of a type that
is not here. A field that no node reads is UNREAD; FREE is one whose own type says enough (a flag, a counter). Types are
keyed as ROS has them, without the 'msg' or 'srv' in the middle. Parameters are declared in the nodes' SETTINGS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from fsai_nodes.fields import FREE, UNREAD, Number, Parts, Several, Text, Whole
from fsai_nodes.mission_goal import GOALS, MISSIONS
from fsai_vcu.core.supervision.supervisor import ROLES
from fsai_vcu.core.vehicle.parameters import SLIP_MOST_RADPMPS2
from fsai_vcu.interface.enums import Ami, AsState

MOST_BYTES = 64 * 1024  # of a message; a larger one is refused before it is unpacked
MOST_CONES = 2000
MOST_POSES = 1000
UNKNOWN = 255

_TURNS_RAD = Number(-1e6, 1e6)  # an angle that may count turns
_PLACE_M = Number(-1e6, 1e6)
_LENGTH_M = Number(0.0, 1e9)
_SPEED_MPS = Number(-1e4, 1e4)
_SHARE = Number(0.0, 1.0)
_NAME = Text(200)
_NOTE = Text(1000)  # in words, for people
_WORDS = Text(4000, lines=True)  # of the bridge alone
_SENTENCES = Several(_WORDS, 500)
_STAMP = Parts(sec=Whole(0, 2**31 - 1), nanosec=Whole(0, 999_999_999))
_HEADER = Parts(stamp=_STAMP, frame_id=_NAME)
_UNREAD_STAMP = Parts(sec=UNREAD, nanosec=UNREAD)
_UNREAD_POINT = Parts(x=UNREAD, y=UNREAD, z=UNREAD)
_AMI = Whole(min(Ami), max(Ami))
_AS_STATE = Whole(min(AsState), max(AsState), also=(UNKNOWN,))

_CONE = Parts(x=Number(-1e3, 1e3), y=Number(-1e3, 1e3), color=Whole(0, 4), confidence=_SHARE)
_POSE = Parts(
    header=Parts(stamp=_UNREAD_STAMP, frame_id=UNREAD),
    pose=Parts(
        position=Parts(x=_PLACE_M, y=_PLACE_M, z=UNREAD),
        orientation=Parts(x=UNREAD, y=UNREAD, z=UNREAD, w=UNREAD),
    ),
)
_DRIVE = Parts(
    steering_angle=Number(-1e3, 1e3),  # what is beyond the car's is cut off, as teams' CAN nodes do
    steering_angle_velocity=UNREAD,
    speed=_SPEED_MPS,
    acceleration=Number(-1e3, 1e3),
    jerk=UNREAD,
)
# A parameter's own declaration decides on its value; here only that it is of a type there is, and short.
_LISTS = {f"{kind}_array_value": Several(FREE, 1000) for kind in ("byte", "bool", "integer", "double")}
_VALUE = Parts(
    type=Whole(0, 9),
    bool_value=FREE,
    integer_value=FREE,
    double_value=FREE,
    string_value=_WORDS,
    string_array_value=Several(_WORDS, 100),
    **_LISTS,
)
_PARAMETERS = Several(Parts(name=_NAME, value=_VALUE), 100)
_NAMES = Several(_NAME, 100)

DECLARED: Mapping[str, Parts] = MappingProxyType(
    {
        # ------------------------------------------------ messages
        "fsai_msgs/ConeArray": Parts(header=_HEADER, cones=Several(_CONE, MOST_CONES, leave_out=True)),
        "nav_msgs/Path": Parts(header=_HEADER, poses=Several(_POSE, MOST_POSES)),
        "fsai_msgs/PlannerStatus": Parts(
            header=_HEADER,
            run_id=FREE,
            mission=_AMI,
            laps=FREE,
            finished=FREE,
            stop_distance_m=Number(0.0, 1e6, nan="no stop known"),
            cones_count_actual=FREE,
            cones_count_all=FREE,
            supported_m=Number(0.0, 1e6),
            confidence=_SHARE,
            mapped=FREE,
            slip_radpmps2=Number(0.0, SLIP_MOST_RADPMPS2),
            note=_NOTE,
            late=_NOTE,
        ),
        # The car's own, live limits of it are the command gate's.
        "fsai_msgs/VehicleCommand": Parts(
            header=_HEADER,
            run_id=FREE,
            steering_rad=Number(-math.pi, math.pi),
            throttle=_SHARE,
            brake=_SHARE,
            speed_limit_mps=Number(0.0, 1e3),
            mission_finished=FREE,
            estop_request=FREE,
            laps=FREE,
            cones_count_actual=FREE,
            cones_count_all=FREE,
            note=_NOTE,
        ),
        "fsai_msgs/RunState": Parts(
            header=Parts(stamp=_UNREAD_STAMP, frame_id=UNREAD),
            run_id=FREE,
            mission=_AMI,
            as_state=_AS_STATE,
            may_move=FREE,
            mode=UNREAD,
        ),
        "fsai_msgs/ResetConfirmation": Parts(role=Text(20, ROLES), run_id=FREE),
        "fsai_msgs/VehicleState": Parts(
            header=_HEADER,
            as_state=_AS_STATE,
            as_state_label=_NAME,
            mission=Whole(min(Ami), max(Ami), also=(UNKNOWN,)),
            mission_label=_NAME,
            mode=UNREAD,
            run_id=FREE,
            handshake=FREE,
            go_signal=FREE,
            as_switch=UNREAD,
            ts_switch=UNREAD,
            shutdown_request=UNREAD,
            fault=UNREAD,
            warning=UNREAD,
            faults=UNREAD,
            shutdown_cause=UNREAD,
            shutdown_cause_label=UNREAD,
            steering_status=UNREAD,
            op_state=UNREAD,
            ts_state=UNREAD,
            ebs_state=UNREAD,
            steering_rad=Number(-math.pi, math.pi),
            steering_max_rad=UNREAD,
            front_axle_torque_nm=UNREAD,
            rear_axle_torque_nm=UNREAD,
            front_brake=Number(0.0, 1.3),  # the signal is a byte of half per cents
            rear_brake=Number(0.0, 1.3),
            brake_status=UNREAD,
            ebs_status=UNREAD,
            wheel_speed_rpm=FREE,
            wheel_pulses=FREE,
            standing=FREE,
            x=_PLACE_M,
            y=_PLACE_M,
            yaw_rad=_TURNS_RAD,
            speed_mps=_SPEED_MPS,
            yaw_rate_radps=Number(-1e3, 1e3),
            yaw_rate_sd_radps=Number(0.0, 1e3),
            distance_m=_LENGTH_M,
            status_age_s=UNREAD,
            steer_age_s=UNREAD,
            speeds_age_s=UNREAD,
            brake_age_s=UNREAD,
            command_age_s=UNREAD,
            sent_mission_status=Whole(0, 127),  # ackermann_adapter passes it on in a field so wide
            sent_direction=Whole(0, 127),
            sent_estop_request=FREE,
            sent_steering_rad=Number(-math.pi, math.pi),
            sent_front_torque_nm=Number(-1e4, 1e4),
            sent_rear_torque_nm=Number(-1e4, 1e4),
            sent_front_brake=_SHARE,
            sent_rear_brake=UNREAD,
            laps=UNREAD,
            listen_only=UNREAD,
            phase=_WORDS,
            emergency=_WORDS,
            stopping=_WORDS,
            loop_faults=FREE,
            gate_reasons=_SENTENCES,
            why_not_driving=UNREAD,
            operational_limits=_SENTENCES,
        ),
        # ackermann_adapter's
        "ackermann_msgs/AckermannDrive": _DRIVE,
        "ackermann_msgs/AckermannDriveStamped": Parts(header=_HEADER, drive=_DRIVE),
        "std_msgs/Bool": Parts(data=FREE),
        # ------------------------------------------------ requests and goals
        "std_srvs/Trigger_Request": Parts(),
        "fsai_msgs/SetMode_Request": Parts(mode=_NAME),  # the loop names the modes there are
        "eufs_msgs/SetCanState_Request": Parts(ami_state=FREE, as_state=UNREAD),
        "eufs_msgs/SetMission_Request": Parts(mission=FREE),
        "fsai_msgs/RunMission_Goal": Parts(
            mission=Text(40, ("", *MISSIONS), any_case=True),
            until=Text(40, ("", *GOALS)),
            timeout_s=Number(0.0, 604_800.0),  # a week; 0 is no limit
        ),
        # rclpy's own
        "rcl_interfaces/DescribeParameters_Request": Parts(names=_NAMES),
        "rcl_interfaces/GetParameters_Request": Parts(names=_NAMES),
        "rcl_interfaces/GetParameterTypes_Request": Parts(names=_NAMES),
        "rcl_interfaces/ListParameters_Request": Parts(prefixes=_NAMES, depth=Whole(0, 100)),
        "rcl_interfaces/SetParameters_Request": Parts(parameters=_PARAMETERS),
        "rcl_interfaces/SetParametersAtomically_Request": Parts(parameters=_PARAMETERS),
        "type_description_interfaces/GetTypeDescription_Request": Parts(
            type_name=_NAME, type_hash=_NAME, include_type_sources=FREE
        ),
        "lifecycle_msgs/ChangeState_Request": Parts(transition=Parts(id=FREE, label=_NAME)),
        "lifecycle_msgs/GetState_Request": Parts(),
        "lifecycle_msgs/GetAvailableStates_Request": Parts(),
        "lifecycle_msgs/GetAvailableTransitions_Request": Parts(),
    }
)
BYTES: Mapping[str, int] = MappingProxyType({"nav_msgs/Path": 2 * MOST_BYTES})  # of types that need more room


def key_of(kind: type[Any]) -> str:
    """Return a message class's key in DECLARED: 'fsai_msgs/ConeArray', 'fsai_msgs/SetMode_Request'."""
    return f"{kind.__module__.partition('.')[0]}/{kind.__name__}"


def declared(kind: type[Any]) -> Parts:
    """Return what is declared of a type. Raises LookupError where nothing is."""
    key = key_of(kind)
    if key not in DECLARED:
        raise LookupError(f"{key} is taken by a node and not declared in fsai_nodes.declarations")
    return DECLARED[key]
