"""A planner of your own, in place of path_planner: the middle between blue and yellow cones, one lap (or ten), stop.

What a team changes is `middle`. The rest is what every planner does: confirm each new run, answer every set of cones
with a PlannerStatus and a Path of the same stamp, and say where to stop once the laps are driven.
"""

import numpy as np
from fsai_msgs.msg import Cone, ConeArray, PlannerStatus, ResetConfirmation, RunState, VehicleState
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node

from fsai_nodes.conversions import motion_from_state
from fsai_nodes.process import run
from fsai_nodes.qos import TOPICS
from fsai_vcu.core.missions.laps import LapCounter

LAPS = {3: 1, 4: 10}  # by mission number: autocross, trackdrive
STOP_M = 12.0  # stand so far behind the line; the rules allow 30 m


def middle(cones):
    """The way ahead, (N, 2) metres in the car's frame (x forward, y left). Change this."""
    blue, yellow = (np.array([(c.x, c.y) for c in cones if c.color == side]) for side in (Cone.BLUE, Cone.YELLOW))
    if not len(blue) or not len(yellow):
        return []  # an empty path: no way known, and the controller brakes
    gap_m = np.linalg.norm(blue[:, None] - yellow[None], axis=2)
    facing = (gap_m <= gap_m.min(axis=0)) | (gap_m <= gap_m.min(axis=1)[:, None])  # each with the nearest across
    left, right = np.nonzero(facing & (gap_m < 5.0))
    points = (blue[left] + yellow[right]) / 2.0
    points = np.vstack(([0.0, 0.0], points[np.argsort(np.hypot(*points.T))]))
    along = np.append(0.0, np.hypot(*np.diff(points, axis=0).T).cumsum())
    at = np.arange(0.0, along[-1], 0.5)  # the controller wants points near each other
    return np.column_stack((np.interp(at, along, points[:, 0]), np.interp(at, along, points[:, 1])))


class OwnPlanner(Node):
    """Answers each set of cones with a path, and says where to stop after the last lap."""

    def __init__(self):
        super().__init__("own_planner")
        self.run, self.state = RunState(), None
        self.confirmation = self.create_publisher(ResetConfirmation, "reset_confirmation", TOPICS["reset_confirmation"])
        self.status = self.create_publisher(PlannerStatus, "planner_status", TOPICS["planner_status"])
        self.path = self.create_publisher(Path, "path", TOPICS["path"])
        self.create_subscription(RunState, "run_state", self.on_run, TOPICS["run_state"])
        self.create_subscription(VehicleState, "vehicle_state", self.on_state, TOPICS["vehicle_state"])
        self.create_subscription(ConeArray, "detected_cones", self.on_cones, TOPICS["detected_cones"])

    def on_run(self, message):
        if message.run_id != self.run.run_id:  # a new run: forget everything, then say so
            self.state, self.counter, self.laps, self.end_m = None, LapCounter(), 0, None
            self.confirmation.publish(ResetConfirmation(role=ResetConfirmation.PLANNER, run_id=message.run_id))
        self.run = message

    def on_state(self, state):
        if state.run_id == self.run.run_id:
            self.state, self.laps = state, self.counter.laps(motion_from_state(state, 0))
            if self.end_m is None and self.laps >= LAPS.get(self.run.mission, 1):
                self.end_m = state.distance_m + STOP_M

    def on_cones(self, cones):
        if self.state is None:
            return
        status = PlannerStatus(header=cones.header, run_id=self.run.run_id, mission=self.run.mission, laps=self.laps)
        status.finished = self.end_m is not None
        status.stop_distance_m = max(0.0, self.end_m - self.state.distance_m) if status.finished else float("nan")
        path = Path(header=cones.header)
        for x, y in middle(cones.cones):
            path.poses.append(PoseStamped(header=cones.header))
            path.poses[-1].pose.position.x, path.poses[-1].pose.position.y = float(x), float(y)
        self.status.publish(status)
        self.path.publish(path)


def main():
    return run([OwnPlanner], "own_planner")


if __name__ == "__main__":
    raise SystemExit(main())
