"""Scene of one run, as the nodes last told it, to be drawn: car, cones seen and remembered, path and its status."""

from __future__ import annotations

import math

import numpy as np
from fsai_msgs.msg import ConeArray, PlannerStatus, VehicleState
from nav_msgs.msg import Path

from fsai_nodes.clocks import Clocks
from fsai_nodes.conversions import cones_from_msg, motion_from_state
from fsai_vcu.core.driving import ConeObservation, Motion
from fsai_vcu.core.planning.pose import to_odometry
from fsai_vcu.core.vehicle.odometry import MotionHistory

SAME_CONE_M = 1.0  # two sightings nearer than that are of one cone
MOST_CONES = 1000  # remembered
STEP_M, MOST_STEPS = 0.5, 1000  # of the driven path


class Scene:
    """Remembers the newest of each topic, and the cones of the run; forgets them with a new run.

    Cones and paths from before the run's first state, which were on their way then, are of the last run and not taken.

    history: where the car was. remembered: (N, 3) x, y (odometry frame), colour. seen: the newest cones, in the
    vehicle frame of their instant. driven: x, y (odometry frame), speed.
    """

    def __init__(self, clocks: Clocks) -> None:
        self._clocks = clocks
        self._forget(VehicleState(), 0)

    def _forget(self, state: VehicleState, began_ns: int) -> None:
        self.state = state
        self._began_ns = began_ns
        self.history = MotionHistory()
        self.driven: list[tuple[float, float, float]] = []
        self.raw = ConeArray()
        self.cones = ConeArray()
        self.seen = cones_from_msg(self.cones, 0)
        self.path = Path()
        self.status = PlannerStatus(stop_distance_m=math.nan)
        self.remembered = np.empty((0, 3))

    def on_state(self, message: VehicleState) -> None:
        now_ns = self._clocks.now_ns()
        t_ns = self._clocks.steady_of(message.header.stamp, now_ns)
        if message.run_id != self.state.run_id:
            self._forget(message, min(t_ns, now_ns))
        self.state = message
        self.history.add(motion_from_state(message, t_ns))
        here = (message.x, message.y, message.speed_mps)
        if not self.driven or math.dist(here[:2], self.driven[-1][:2]) > STEP_M:
            self.driven = [*self.driven[1 - MOST_STEPS :], here]

    def on_raw_cones(self, message: ConeArray) -> None:
        self.raw = message

    def on_cones(self, message: ConeArray) -> None:
        seen = cones_from_msg(message, self._clocks.steady_of(message.header.stamp, self._clocks.now_ns()))
        if seen.t_ns < self._began_ns:
            return
        self.cones, self.seen = message, seen
        there = self.history.at(self.seen.t_ns)
        if there is not None:
            self.remembered = remembered(self.remembered, there, self.seen)

    def on_status(self, message: PlannerStatus) -> None:
        self.status = message

    def on_path(self, message: Path) -> None:
        if self._clocks.steady_of(message.header.stamp, self._clocks.now_ns()) >= self._began_ns:
            self.path = message


def remembered(cones: np.ndarray, there: Motion, seen: ConeObservation) -> np.ndarray:
    """(N, 3) x, y, colour in the odometry frame: those known, and where they have been seen again, as seen now."""
    new = np.column_stack([to_odometry(there, seen.xy_m), seen.color])
    apart = np.hypot(cones[:, None, 0] - new[None, :, 0], cones[:, None, 1] - new[None, :, 1])
    return np.vstack([cones[(apart > SAME_CONE_M).all(axis=1)], new])[-MOST_CONES:]
