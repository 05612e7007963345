"""The acceleration mission: a straight lane between two rows of cones, where in it the car is, and where it ends.

Lane frame: x along the middle, 0 where the car was staged; y to the left.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.course_fit import GATE_M, TRACKED, carried, fitted, from_car, misfit, on_course
from fsai_vcu.interface.values import Value

SEARCH = np.array([[0.0, y, yaw] for y in np.arange(-2.0, 2.1, 0.5) for yaw in np.radians(np.arange(-18.0, 19.0, 3.0))])
SEARCH_SIGMA = np.array([0.01, 0.5, 0.05])
SEARCH_HALF_WIDTHS_M = (1.5, 2.0, 2.5)
SEARCH_M = 1.0  # of way after the staging place in which the lane is searched for, not tracked
CONES_MIN = 6  # in its borders, before a lane is tracked; until then straight on by odometry
NEARER = np.array([0.0, 1.0, 100.0])  # misfit per m2 and rad2 from where it should be: of places that fit alike
IN_THE_WAY_M = 0.9  # a cone nearer to the lane's middle closes it
FINISH_GATE_M = 12.0  # big orange cones count as the finish within this distance from where it is expected
GATE_WIDEST_M = 4.0  # of its cones from the lane's middle
HALF_WIDTH_MIN_M, HALF_WIDTH_MAX_M = 1.2, 3.0


class StraightLane(Value, frozen=True, eq=False):
    """The car at `motion`: its pose (x, y, yaw) in the lane frame."""

    pose: Floats
    motion: Motion
    half_width_m: float = 1.5
    found: bool = False

    def borders(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the distance from the lane's nearest border, and its normal, as `course_fit.Borders` says."""
        return np.abs(y) - self.half_width_m, np.zeros_like(x), np.where(y < 0.0, -1.0, 1.0)

    def off(self, xy_m: Floats) -> Floats:
        """(N,) how far from the nearest border places (N, 2, vehicle frame) are."""
        return np.abs(np.abs(on_course(self.pose, xy_m)[:, 1]) - self.half_width_m)

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
    if len(xy_m) < (1 if lane.found else CONES_MIN):
        return replace(lane, pose=pose, motion=motion)
    if lane.found and pose[0] > SEARCH_M:
        pose = fitted(lane.borders, pose[None, :], xy_m, TRACKED)[0]
    else:
        wide = (replace(lane, half_width_m=half_width) for half_width in SEARCH_HALF_WIDTHS_M)
        _, pose, lane = min((_searched(one, pose, xy_m) for one in wide), key=lambda found: found[0])
    off = np.abs(on_course(pose, xy_m)[:, 1]) - lane.half_width_m
    near = off[np.abs(off) < GATE_M]
    wider = 0.1 * float(np.median(near)) if len(near) >= CONES_MIN else 0.0
    half_width = min(max(lane.half_width_m + wider, HALF_WIDTH_MIN_M), HALF_WIDTH_MAX_M)
    return StraightLane(pose, motion, half_width, lane.found or len(near) >= CONES_MIN)


def _searched(lane: StraightLane, pose: Floats, xy_m: Floats) -> tuple[float, Floats, StraightLane]:
    """Return how badly the best place fits to a lane of this width, that place, and the lane."""
    poses = fitted(lane.borders, pose + SEARCH, xy_m, SEARCH_SIGMA, 1.5 * GATE_M)
    costs = misfit(lane.borders, poses, xy_m) + (poses - pose) ** 2 @ NEARER
    best = int(costs.argmin())
    return float(costs[best]), poses[best], lane


def finish_seen(finish_m: float, big_orange_m: Floats) -> float:
    """Return where along the lane (m) the finish is: amid big orange cones (lane frame) that stand on both sides.

    Without such cones it stays at `finish_m`.
    """
    of_finish = np.abs(big_orange_m - (finish_m, 0.0)) < (FINISH_GATE_M, GATE_WIDEST_M)
    gate = big_orange_m[of_finish.all(axis=1)]
    both_sides = (gate[:, 1] > 0.0).any() and (gate[:, 1] < 0.0).any()
    return float(gate[:, 0].mean()) if both_sides else finish_m


def closed_at(after_m: float, cones_m: Floats) -> float | None:
    """Return where beyond `after_m` (m along the lane) cones (lane frame) close it; None where none do.

    There is an end to every exit lane.
    """
    wall = cones_m[(np.abs(cones_m[:, 1]) < IN_THE_WAY_M) & (cones_m[:, 0] > after_m), 0]
    return float(wall.min()) if len(wall) else None
