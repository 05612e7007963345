"""A straight lane between two rows of cones, and where in it the car is.

Lane frame: x along the middle, 0 where the car was staged; y to the left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.registration import GATE_M, TRACKED, carried, fitted, from_car, misfit, on_course

SEARCH = np.array([[0.0, y, yaw] for y in np.arange(-2.0, 2.1, 0.5) for yaw in np.radians(np.arange(-18.0, 19.0, 3.0))])
SEARCH_SIGMA = np.array([0.01, 0.5, 0.05])
SEARCH_M = 1.0  # of way after the staging place in which the lane is searched for, not tracked
CONES_MIN = 6  # in its borders, before a lane is tracked
NEARER = np.array([0.0, 1.0, 100.0])  # misfit per m2 and rad2 from where it should be: of places that fit alike
HALF_WIDTH_MIN_M, HALF_WIDTH_MAX_M = 1.2, 3.0


@dataclass(frozen=True, slots=True, eq=False)
class StraightLane:
    """The car at `motion`: its pose (x, y, yaw) in the lane frame."""

    pose: Floats
    motion: Motion
    half_width_m: float = 1.5
    found: bool = False

    def borders(self, q: Floats) -> tuple[Floats, Floats]:
        """As `registration.Borders`."""
        y = q[..., 1]
        normal = np.stack((np.zeros_like(y), np.where(y < 0.0, -1.0, 1.0)), axis=-1)
        return np.abs(y) - self.half_width_m, normal

    def ahead(self, length_m: float, step_m: float) -> Floats:
        """(M, 2) of the lane's middle from beside the car on, in the vehicle frame."""
        x = self.pose[0] + np.arange(0.0, length_m + 1e-9, step_m)
        return from_car(self.pose, np.column_stack((x, np.zeros_like(x))))


def staged(motion: Motion) -> StraightLane:
    """The lane of a car that has been staged in it, as straight as it could be."""
    return StraightLane(np.zeros(3), motion)


def follow_lane(lane: StraightLane, motion: Motion, xy_m: Floats) -> StraightLane:
    """The lane with the car at `motion`, which sees these cones (vehicle frame)."""
    pose = carried(lane.pose, lane.motion, motion)
    if not len(xy_m):
        return replace(lane, pose=pose, motion=motion)
    if lane.found and pose[0] > SEARCH_M:
        pose = fitted(lane.borders, pose[None, :], xy_m, TRACKED)[0]
    else:
        poses = fitted(lane.borders, pose + SEARCH, xy_m, SEARCH_SIGMA, 1.5 * GATE_M)
        costs = misfit(lane.borders, poses, xy_m) + (poses - pose) ** 2 @ NEARER
        pose = poses[int(costs.argmin())]
    off = np.abs(on_course(pose, xy_m)[:, 1]) - lane.half_width_m
    near = off[np.abs(off) < GATE_M]
    wider = 0.1 * float(np.median(near)) if len(near) >= CONES_MIN else 0.0
    half_width = min(max(lane.half_width_m + wider, HALF_WIDTH_MIN_M), HALF_WIDTH_MAX_M)
    return StraightLane(pose, motion, half_width, lane.found or len(near) >= CONES_MIN)
