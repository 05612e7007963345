"""A controller of your own, in place of vehicle_controller: pure pursuit on /path, and a speed that is held.

What a team changes is `drive`. The rest is what every controller does: confirm each new run, send a command 50 times a
second, always, stamped with the oldest data behind it, and say when the mission is over.
"""

import math

from fsai_msgs.msg import PlannerStatus, ResetConfirmation, RunState, VehicleCommand, VehicleState
from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from fsai_nodes.process import run
from fsai_nodes.qos import TOPICS

SPEED_MPS, LOOKAHEAD_M, WHEELBASE_M, STEER_MAX_RAD = 6.0, 4.0, 1.53, math.radians(21.0)


def drive(command, state, status, points):
    """Fill in steering, throttle and brake (never both) from the path's points in the car's frame. Change this."""
    ahead = next(((x, y) for x, y in points if x > 0.0 and math.hypot(x, y) >= LOOKAHEAD_M), points[-1])
    steering = math.atan2(2.0 * WHEELBASE_M * ahead[1], ahead[0] ** 2 + ahead[1] ** 2)
    command.steering_rad = max(-STEER_MAX_RAD, min(STEER_MAX_RAD, steering))
    stop_m = max(0.0, status.stop_distance_m - 0.5) if status.finished else math.inf
    error_mps = min(SPEED_MPS, math.sqrt(2.0 * 2.0 * stop_m)) - state.speed_mps  # brake with 2 m/s2 to the stop
    command.throttle = max(0.0, min(1.0, 0.5 * error_mps))
    command.brake = max(0.0, min(0.6, -0.3 * error_mps)) if error_mps < -0.7 else 0.0
    command.mission_finished = status.finished and state.speed_mps < 0.8


class OwnController(Node):
    """Sends commands along the path, and says when the mission is over."""

    def __init__(self):
        super().__init__("own_controller")
        self.run, self.state, self.status, self.path = RunState(), None, None, None
        self.command = self.create_publisher(VehicleCommand, "vehicle_cmd", TOPICS["vehicle_cmd"])
        self.confirmation = self.create_publisher(ResetConfirmation, "reset_confirmation", TOPICS["reset_confirmation"])
        self.create_subscription(RunState, "run_state", self.on_run, TOPICS["run_state"])
        self.create_subscription(VehicleState, "vehicle_state", self.on_state, TOPICS["vehicle_state"])
        self.create_subscription(PlannerStatus, "planner_status", self.on_status, TOPICS["planner_status"])
        self.create_subscription(Path, "path", self.on_path, TOPICS["path"])
        self.create_timer(0.02, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))  # none that is set

    def on_run(self, message):
        if message.run_id != self.run.run_id:  # a new run: forget everything, then say so
            self.state = self.status = self.path = None
            self.confirmation.publish(ResetConfirmation(role=ResetConfirmation.CONTROLLER, run_id=message.run_id))
        self.run = message

    def on_state(self, state):
        self.state = state if state.run_id == self.run.run_id else self.state

    def on_status(self, status):
        self.status = self.status if status.late else status  # with `late` it comes without a path

    def on_path(self, path):
        self.path = path

    def tick(self):
        if self.state is None:
            return
        command = VehicleCommand(header=self.state.header, run_id=self.run.run_id, speed_limit_mps=SPEED_MPS + 1.0)
        if self.run.may_move:  # not before: the car stands still for the first 3 s of AS_DRIVING
            command.brake = 0.3  # where no way is known
            if self.path and self.path.poses and self.status:
                command.header = self.path.header  # an old path makes the command stale, and the car stops
                command.laps = self.status.laps
                points = [(pose.pose.position.x, pose.pose.position.y) for pose in self.path.poses]
                drive(command, self.state, self.status, points)
        self.command.publish(command)


def main():
    return run([OwnController], "own_controller")


if __name__ == "__main__":
    raise SystemExit(main())
