"""The skidpad: its figure of eight, found in the cones, and how far along it the car is.

Course frame: origin where the two circles touch, x along the way in and out, y to the left. The right circle is driven
first. Progress is the length of path driven since the first passage of the origin, less than 0 before it. The path
crosses itself, so progress is advanced by the driven path and corrected only nearby.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.course_fit import GATE_M, TRACKED, carried, fitted, misfit, on_course
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.interface.values import Value

# Places that the car may have on the way in when the circles are searched for; y and yaw from its due place.
SEARCH_X_M = np.arange(-30.0, -1.9, 0.8)
SEARCH_ASIDE = np.array(
    [(y, yaw) for y in np.arange(-3.0, 3.1, 1.0) for yaw in np.radians(np.arange(-15.0, 16.0, 5.0))]
)
SEARCH_SIGMA = np.array([1.0, 1.0, 0.1])
NEARER = np.array([0.0, 1.0, 100.0])  # misfit per m2 and rad2 from where it should be: of places that fit alike
LANE_CONES_MIN = 6  # fewer fit anywhere: straight on by odometry
CONES_MIN = 8  # seen, before the circles count as found
MISFIT_MAX = 6.0  # of a cone in the mean: a sixth of them may stand on no border
ELSEWHERE_M = 1.5  # places nearer to each other than this are one
LEAD_MIN = 40.0  # misfit by which the best place must lead: more than a cone on no border
# Along the path, tried when tracking: a circle alone does not say where on it the car is, but a crossing does.
SLIPS_M = np.arange(-1.8, 1.9, 0.6)
# On the way out the lane does not say where along it the car is, and false cones fit the circles behind: odometry says.
TRACKED_OUT = TRACKED * np.array([0.1, 1.0, 1.0])
JUMP_M = 2.0  # progress is corrected by no more


class SkidpadCourse(Value, frozen=True):
    """The course by the rules."""

    radius_m: float  # driven; the circles' centres are so far to either side of the origin
    inner_m: float
    outer_m: float
    half_lane_m: float
    laps: int

    @property
    def lap_m(self) -> float:
        return 2.0 * math.pi * self.radius_m

    @property
    def finish_m(self) -> float:
        """Progress at the last passage of the origin."""
        return self.laps * self.lap_m

    def borders(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the distance from the nearest border, and its normal, as `course_fit.Borders` says."""
        left = np.abs(y)
        out = left - self.radius_m
        reach = np.maximum(np.sqrt(x * x + out * out), 1e-6)
        inner, outer = reach - self.inner_m, reach - self.outer_m
        circle = np.where(np.abs(inner) < np.abs(outer), inner, outer)
        lane = left - self.half_lane_m
        # The lanes in and out end where the circles begin.
        in_lane = (np.abs(lane) < np.abs(circle)) & (np.abs(x) > 0.75 * self.inner_m)
        normal_y = np.where(y < 0.0, -1.0, 1.0) * np.where(in_lane, 1.0, out / reach)
        return np.where(in_lane, lane, circle), np.where(in_lane, 0.0, x / reach), normal_y

    def path(self, progress_m: Floats) -> Floats:
        """(M, 2) the path's points at these progresses."""
        p = progress_m
        turn = p / self.radius_m
        circling = (p >= 0.0) & (p < self.finish_m)
        side = np.where(p < 0.5 * self.finish_m, -1.0, 1.0)
        x = np.where(circling, self.radius_m * np.sin(turn), np.where(p < 0.0, p, p - self.finish_m))
        return np.column_stack((x, np.where(circling, side * self.radius_m * (1.0 - np.cos(turn)), 0.0)))


def skidpad_course(settings: MissionSettings) -> SkidpadCourse:
    inner = 0.5 * settings.skidpad_inner_diameter_m
    lane = settings.skidpad_lane_m
    laps = 2 * settings.skidpad_laps_per_side
    return SkidpadCourse(0.5 * settings.skidpad_centres_m, inner, inner + lane, 0.5 * lane, laps)


class SkidpadState(Value, frozen=True, eq=False):
    """The car at `motion`: its pose (x, y, yaw) in the course frame, and its progress.

    Until the circles are `found` only y and yaw are known, from the lane in.
    """

    pose: Floats
    motion: Motion
    progress_m: float = -math.inf
    found: bool = False


def staged(motion: Motion) -> SkidpadState:
    """The state of a car that has been staged in the lane in, as straight as it could be."""
    return SkidpadState(np.zeros(3), motion)


def search_skidpad(
    course: SkidpadCourse, state: SkidpadState, xy_m: Floats, lane_in_m: float = math.inf
) -> SkidpadState:
    """The state with the car where it must be on the way in to see these cones (vehicle frame).

    `lane_in_m`: how far ahead the circles may be at most, by how far the car has come. Found is what two looks in a
    row agree on. The lane alone does not say where along it the car is: it is only followed then.
    """
    along = SEARCH_X_M[-lane_in_m <= SEARCH_X_M]
    if len(xy_m) < LANE_CONES_MIN or not len(along):
        return state
    cells = np.empty((len(along), len(SEARCH_ASIDE), 3))
    cells[..., 0], cells[..., 1:] = along[:, None], state.pose[1:] + SEARCH_ASIDE
    costs = misfit(course.borders, cells.reshape(-1, 3), xy_m).reshape(cells.shape[:-1])
    costs += (cells - state.pose) ** 2 @ NEARER
    poses = cells[np.arange(len(cells)), costs.argmin(axis=1)]
    poses = fitted(course.borders, poses, xy_m, SEARCH_SIGMA, 1.5 * GATE_M)
    costs = misfit(course.borders, poses, xy_m) + (poses - state.pose) ** 2 @ NEARER
    first = int(costs.argmin())
    pose = poses[first]
    elsewhere = np.hypot(*(poses[:, :2] - pose[:2]).T) > ELSEWHERE_M
    lead = costs[elsewhere].min(initial=math.inf) - costs[first]
    clear = len(xy_m) >= CONES_MIN and lead > LEAD_MIN and costs[first] < MISFIT_MAX * len(xy_m)
    agrees = math.dist(pose[:2], state.pose[:2]) < ELSEWHERE_M
    if state.found and (agrees or not clear):
        return state  # tracking knows it better
    found = bool(clear and agrees)  # false cones may look like the circles once, but not twice at the same place
    return SkidpadState(pose, state.motion, float(pose[0]) if found else -math.inf, found)


def advance_skidpad(course: SkidpadCourse, state: SkidpadState, motion: Motion, xy_m: Floats) -> SkidpadState:
    """The state with the car at `motion`, which sees these cones (vehicle frame)."""
    pose = carried(state.pose, state.motion, motion)
    if not state.found:
        return replace(state, pose=pose, motion=motion)
    expected = state.progress_m + max(0.0, motion.distance_m - state.motion.distance_m)
    side = 0.0 if not 0.0 <= expected < course.finish_m else -1.0 if expected < 0.5 * course.finish_m else 1.0
    out = expected >= course.finish_m
    if len(xy_m) >= 2 and out:
        pose = fitted(course.borders, pose[None], xy_m, TRACKED_OUT)[0]
    elif len(xy_m) >= 2:
        poses = fitted(course.borders, _slipped(course, pose, side), xy_m, TRACKED)
        costs = misfit(course.borders, poses, xy_m)
        costs[len(costs) // 2] -= LEAD_MIN  # of the one that has not slipped
        pose = poses[int(costs.argmin())]
    at = float(pose[0])
    if side:
        at = course.radius_m * math.atan2(at, course.radius_m - side * float(pose[1]))
        at = expected + math.remainder(at - expected, course.lap_m)
    elif expected > 0.0:
        at += course.finish_m
    at = min(max(at, expected - JUMP_M), expected + JUMP_M)
    return replace(state, pose=pose, motion=motion, progress_m=max(state.progress_m, at))


def _slipped(course: SkidpadCourse, pose: Floats, side: float) -> Floats:
    """(H, 3) the pose, and it moved along the lane (side 0) or round the circle on that side (-1 right, 1 left)."""
    turn = side * SLIPS_M / course.radius_m
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = pose[0] + (SLIPS_M if side == 0.0 else 0.0), pose[1] - side * course.radius_m
    return np.column_stack((cos * x - sin * y, sin * x + cos * y + side * course.radius_m, pose[2] + turn))


def laps_done(course: SkidpadCourse, state: SkidpadState) -> int:
    return min(course.laps, max(0, int((state.progress_m + 0.01) // course.lap_m))) if state.found else 0


def off_course(course: SkidpadCourse, state: SkidpadState, xy_m: Floats) -> Floats:
    """(N,) how far from the nearest border places (N, 2, vehicle frame) are."""
    x, y = on_course(state.pose, xy_m).T
    return np.abs(course.borders(x, y)[0])
