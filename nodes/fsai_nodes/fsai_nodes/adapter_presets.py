"""The interfaces of FS-AI teams between their stack and their CAN node, as data: one preset each for ackermann_adapter.

A new team is a new entry of PRESETS; what no kind of adapter_outputs has yet is added there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

TYPES = ("AckermannDrive", "AckermannDriveStamped")
MODES = ("acceleration", "speed", "speed_or_finish")  # the last: a negative speed says that the mission is finished
TOPIC, SERVICE = "topic", "service"


@dataclass(frozen=True, slots=True)
class Preset:
    """One interface. Names are relative to the node's namespace; an empty one: the interface has no such thing.

    finish, brake and emergency are ways: 'topic:NAME' for a std_msgs/Bool, 'service:NAME' for a std_srvs/Trigger.
    """

    command: str  # topic of ackermann_msgs
    command_type: str = "AckermannDriveStamped"
    command_mode: str = "acceleration"
    driving: str = ""  # Bool that lets the car drive; without one it drives in AS_DRIVING when commands come
    finish: str = ""
    brake: str = ""
    emergency: str = ""
    reset: str = ""  # Trigger
    outputs: Mapping[str, str] = field(default_factory=dict)  # topic or service to its kind in adapter_outputs


_ROS_CAN = {
    "ros_can/state": "can_state",
    "ros_can/state_str": "ros_can_words",
    "ros_can/wheel_speeds": "wheel_speeds",
    "ros_can/twist": "twist",
    "ros_can/vehicle_commands": "vehicle_commands",
}

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        # ros_can, and what EUFS's first simulator adds to it
        "eufs": Preset(
            command="cmd",
            driving="state_machine/driving_flag",
            finish="topic:ros_can/mission_completed",
            emergency="service:ros_can/ebs",
            reset="ros_can/reset",
            outputs={
                **_ROS_CAN,
                "ros_can/set_mission": "set_can_state",
                "odometry_integration/car_state": "car_state",
                "fusion/cones": "cones",
            },
        ),
        # EUFS's node on the car
        "ros_can": Preset(
            command="cmd",
            driving="state_machine/driving_flag",
            finish="topic:ros_can/mission_completed",
            emergency="service:ros_can/ebs",
            outputs=_ROS_CAN,
        ),
        # EUFS's second simulator; its /reset is named as vcu_bridge's own is
        "eufs_sim2": Preset(
            command="cmd",
            finish="topic:ros_can/mission_completed",
            emergency="service:ebs",
            outputs={
                "sim/ros_can/state": "can_state",
                "sim/ros_can/state_str": "sim2_words",
                "ros_can/wheel_speeds": "wheel_turns",
                "ros_can/twist": "twist",
                "odom": "odometry",
                "cones": "cones_with_color",
                "set_mission": "set_mission",
                "go": "go",
            },
        ),
        # ackermann_can of Gryphon Racing AI's package fsai_api
        "fsai_api": Preset(
            command="ackermann_cmd",
            command_type="AckermannDrive",
            command_mode="speed_or_finish",
            finish="topic:chequered_flag",
            brake="topic:brake",
            emergency="topic:emergency_brake",
            outputs={"vcu2ai": "vcu2ai"},
        ),
        # Atlas Racing's node of this name
        "hydrakon_can": Preset(
            command="hydrakon_can/command",
            driving="hydrakon_can/driving_flag",
            finish="topic:hydrakon_can/is_mission_completed",
            emergency="service:hydrakon_can/ebs_request",
            outputs={
                "hydrakon_can/state_str": "hydrakon_words",
                "hydrakon_can/wheel_speed": "hydrakon_wheel_speed",
                "hydrakon_can/twist": "twist",
            },
        ),
    }
)
