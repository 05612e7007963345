"""A stack as teams write them for EUFS's ros_can and simulator; it knows nothing of this project.

It drives the acceleration: calmly between the cones for 75 m by its own wheel odometry, then it brakes and says
that the mission is completed. Its commands are unstamped and come 20 times a second, as those of many such stacks.
"""

import math
from contextlib import suppress

import rclpy
from ackermann_msgs.msg import AckermannDriveStamped
from eufs_msgs.msg import CanState, ConeArrayWithCovariance, WheelSpeedsStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Bool

PERIOD_S, RADIUS_M, WHEELBASE_M = 0.05, 0.2535, 1.53
BRAKE_AFTER_M = 77.0
SPEED_MPS = 7.0  # enough to be judged by, and calm with steering that comes late on a busy machine


class EufsStack(Node):
    def __init__(self):
        super().__init__("eufs_stack")
        self.state, self.rpm, self.distance_m, self.steering = CanState(), 0.0, 0.0, 0.0
        self.cmd = self.create_publisher(AckermannDriveStamped, "/cmd", 1)
        self.driving = self.create_publisher(Bool, "/state_machine/driving_flag", 1)
        self.completed = self.create_publisher(Bool, "/ros_can/mission_completed", 1)
        self.create_subscription(CanState, "/ros_can/state", self.on_state, 1)
        self.create_subscription(WheelSpeedsStamped, "/ros_can/wheel_speeds", self.on_wheels, 1)
        self.create_subscription(ConeArrayWithCovariance, "/fusion/cones", self.on_cones, 1)
        self.create_timer(PERIOD_S, self.tick)

    def on_state(self, state):
        self.state = state

    def on_wheels(self, wheels):
        self.rpm = (wheels.speeds.lb_speed + wheels.speeds.rb_speed) / 2.0

    def on_cones(self, cones):
        left, right = (
            [cone.point for cone in side if 2.0 < cone.point.x < 10.0]
            for side in (cones.blue_cones, cones.yellow_cones)
        )
        if left and right:
            y = (sum(p.y for p in left) / len(left) + sum(p.y for p in right) / len(right)) / 2.0
            self.steering = math.atan(2.0 * WHEELBASE_M * y / 36.0)

    def tick(self):
        driving = self.state.as_state == CanState.AS_DRIVING and self.state.ami_state == CanState.AMI_ACCELERATION
        self.distance_m = self.distance_m + self.rpm * 2.0 * math.pi / 60.0 * RADIUS_M * PERIOD_S if driving else 0.0
        braking = self.distance_m > BRAKE_AFTER_M
        command = AckermannDriveStamped()
        command.drive.steering_angle = self.steering
        fast = self.rpm * 2.0 * math.pi / 60.0 * RADIUS_M > SPEED_MPS
        command.drive.acceleration = -4.0 if braking else 0.0 if fast else 2.5
        self.cmd.publish(command)
        self.driving.publish(Bool(data=driving))
        self.completed.publish(Bool(data=driving and braking and self.rpm < 10.0))


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(EufsStack())
