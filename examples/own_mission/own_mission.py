"""A mission of your own, in place of path_planner and vehicle_controller: straight on for 10 m, stop, finished.

What a team changes is `step`. The rest is what a mission that needs no cones does: it is planner and controller in one,
so it confirms each new run for both, sends a command 50 times a second, and says when the mission is over.
"""

from fsai_msgs.msg import ResetConfirmation, RunState, VehicleCommand, VehicleState
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from fsai_nodes.process import run
from fsai_nodes.qos import TOPICS

MISSION = 7  # the number on the car's display that this node drives: autonomous demo; of others it does nothing
SPEED_MPS, LENGTH_M = 2.0, 10.0


def step(command, state):
    """Fill in the command from what the car reports. Change this."""
    if state.distance_m < LENGTH_M:
        command.throttle = max(0.0, min(0.4, 0.4 * (SPEED_MPS - state.speed_mps)))
    else:
        command.brake = 0.3  # never with throttle
        command.mission_finished = bool(state.standing)


class OwnMission(Node):
    """Confirms each run as planner and controller, and sends the mission's commands."""

    def __init__(self):
        super().__init__("own_mission")
        self.run, self.state = RunState(), None
        self.command = self.create_publisher(VehicleCommand, "vehicle_cmd", TOPICS["vehicle_cmd"])
        self.confirmation = self.create_publisher(ResetConfirmation, "reset_confirmation", TOPICS["reset_confirmation"])
        self.create_subscription(RunState, "run_state", self.on_run, TOPICS["run_state"])
        self.create_subscription(VehicleState, "vehicle_state", self.on_state, TOPICS["vehicle_state"])
        self.create_timer(0.02, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))  # none that is set

    def on_run(self, message):
        if message.run_id != self.run.run_id:  # a new run: forget everything, then say so
            self.state = None
            for role in (ResetConfirmation.PLANNER, ResetConfirmation.CONTROLLER) if message.mission == MISSION else ():
                self.confirmation.publish(ResetConfirmation(role=role, run_id=message.run_id))
        self.run = message

    def on_state(self, state):
        self.state = state if state.run_id == self.run.run_id else self.state

    def tick(self):
        if self.state is None or self.run.mission != MISSION:
            return
        command = VehicleCommand(header=self.state.header, run_id=self.run.run_id, speed_limit_mps=SPEED_MPS + 1.0)
        if self.run.may_move:  # not before: the car stands still for the first 3 s of AS_DRIVING
            step(command, self.state)
        self.command.publish(command)


def main():
    return run([OwnMission], "own_mission")


if __name__ == "__main__":
    raise SystemExit(main())
