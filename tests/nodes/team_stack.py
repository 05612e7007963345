"""A stack as teams write them, on one team's interface: team_stack.py PRESET. It stands in for that team's.

It drives the acceleration: calmly between the cones for 75 m by its own odometry, then it brakes and says that the
mission is finished. It speaks ten times a second and leaves stamps empty, as many do. Where an interface has no cones
they are those of the simulated sensor: the team has its own perception.
"""

import math
import sys
from contextlib import suppress

import rclpy
from ackermann_msgs.msg import AckermannDrive, AckermannDriveStamped
from eufs_msgs.msg import CanState, ConeArrayWithCovariance, ConeWithColorProbabilityArray, WheelSpeedsStamped
from fsai_api.msg import VCU2AI
from fsai_msgs.msg import Cone, ConeArray
from hydrakon_can.msg import WheelSpeed
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Bool, String

PERIOD_S, RADIUS_M, WHEELBASE_M = 0.1, 0.2535, 1.53
BRAKE_AFTER_M = 77.0
SPEED_MPS = 7.0  # enough to be judged by, and calm with steering that comes late on a busy machine
STANDING_MPS = 0.25


def _mps(*rpm):
    return sum(rpm) / len(rpm) * 2.0 * math.pi / 60.0 * RADIUS_M


def _sides(cones):
    """Of an EUFS array with a list for each colour."""
    return [[cone.point for cone in side] for side in (cones.blue_cones, cones.yellow_cones)]


def _probable(cones):
    return [[c.point for c in cones.cones if getattr(c, name) > 0.5] for name in ("blue_prob", "yellow_prob")]


CONES = (
    ConeArray,
    "/detected_cones",
    lambda m: [[c for c in m.cones if c.color == s] for s in (Cone.BLUE, Cone.YELLOW)],
)
STATE = (CanState, "/ros_can/state", lambda m: (m.as_state, m.ami_state) == (CanState.AS_DRIVING, 11))
WHEELS = (WheelSpeedsStamped, "/ros_can/wheel_speeds", lambda m: _mps(m.speeds.lb_speed, m.speeds.rb_speed))
ROS_CAN = {
    "state": STATE,
    "speed": WHEELS,
    "cones": CONES,
    "command": "/cmd",
    "driving": "/state_machine/driving_flag",
    "finish": "/ros_can/mission_completed",
}
INTERFACES = {
    "eufs": ROS_CAN | {"cones": (ConeArrayWithCovariance, "/fusion/cones", _sides)},
    "ros_can": ROS_CAN,
    "eufs_sim2": {
        "state": (
            String,
            "/sim/ros_can/state_str",
            lambda m: "AMIState: ACCELERATION" in m.data and "ASState: DRIVING" in m.data,
        ),
        "speed": (Odometry, "/odom", lambda m: m.twist.twist.linear.x),
        "cones": (ConeWithColorProbabilityArray, "/cones", _probable),
        "command": "/cmd",
        "finish": "/ros_can/mission_completed",
    },
    "fsai_api": {
        "state": (
            VCU2AI,
            "/vcu2ai",
            lambda m: (m.as_state, m.ami_state) == (VCU2AI.AS_DRIVING, VCU2AI.AMI_ACCELERATION),
        ),
        "speed": (VCU2AI, "/vcu2ai", lambda m: _mps(m.rl_wheel_speed_rpm, m.rr_wheel_speed_rpm)),
        "cones": CONES,
        "command": "/ackermann_cmd",
        "brake": "/brake",
        "finish": "/chequered_flag",
    },
    "hydrakon_can": {
        "state": (String, "/hydrakon_can/state_str", lambda m: m.data.startswith("AS:DRIVING AMI:ACCELERATION ")),
        "speed": (WheelSpeed, "/hydrakon_can/wheel_speed", lambda m: _mps(m.lb_speed, m.rb_speed)),
        "cones": CONES,
        "command": "/hydrakon_can/command",
        "driving": "/hydrakon_can/driving_flag",
        "finish": "/hydrakon_can/is_mission_completed",
    },
}


class TeamStack(Node):
    def __init__(self, preset):
        super().__init__("team_stack")
        self.interface = INTERFACES[preset]
        self.state, self.speed, self.distance_m, self.steering = False, 0.0, 0.0, 0.0
        for name in ("state", "speed", "cones"):
            kind, topic, read = self.interface[name]
            take = self.on_cones if name == "cones" else lambda value, name=name: setattr(self, name, value)
            self.create_subscription(
                kind, topic, lambda message, take=take, read=read: take(read(message)), qos_profile_sensor_data
            )
        self.plain = "brake" in self.interface  # unstamped, and commands are speeds
        kind = AckermannDrive if self.plain else AckermannDriveStamped
        self.command = self.create_publisher(kind, self.interface["command"], 1)
        self.flags = {
            name: self.create_publisher(Bool, self.interface[name], 1)
            for name in ("driving", "brake", "finish")
            if name in self.interface
        }
        self.create_timer(PERIOD_S, self.tick)

    def on_cones(self, sides):
        left, right = ([cone.y for cone in side if 2.0 < cone.x < 10.0] for side in sides)
        if left and right:
            y = (sum(left) / len(left) + sum(right) / len(right)) / 2.0
            self.steering = math.atan(2.0 * WHEELBASE_M * y / 36.0)

    def tick(self):
        self.distance_m = self.distance_m + self.speed * PERIOD_S if self.state else 0.0
        braking = self.distance_m > BRAKE_AFTER_M
        drive = AckermannDrive(steering_angle=self.steering)
        if self.plain:
            drive.speed = 0.0 if braking else SPEED_MPS
        else:
            drive.acceleration = -4.0 if braking else 0.0 if self.speed > SPEED_MPS else 2.5
        self.command.publish(drive if self.plain else AckermannDriveStamped(drive=drive))
        said = {"driving": self.state, "brake": braking, "finish": self.state and braking and self.speed < STANDING_MPS}
        for name, flag in self.flags.items():
            flag.publish(Bool(data=said[name]))


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(TeamStack(sys.argv[1]))
