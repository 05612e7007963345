"""Steering along a path: the rate of steering that keeps a kinematic car nearest to it over the next second."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.planning.pose import headings_along, resampled
from fsai_vcu.interface.values import Value

STEP_M = 0.5
FEWEST = 5  # points of a path, `STEP_M` apart
LONGEST_M = 120.0  # of a path nothing further is looked at
NEAREST_WITHIN_M = 12.0  # of a path that crosses or comes back only so much of its beginning can be beside the car
APPROACH_MAX_RAD = 0.25  # a car far beside the path returns to it no more steeply …
BACK_MAX_1PM = 0.12  # … and no more sharply, beside the path's own curvature
SLOWEST_MPS = 4.0  # a slower car steers as at this speed

HORIZON_STEPS, HORIZON_STEP_S = 20, 0.05
# These weigh the same: so far beside the path, so fast away from it, and so much jerk across.
DEVIATION_M, DRIFT_MPS, JERK_MPS3 = 0.2, 0.6, 14.0


class PathLine(Value, frozen=True):
    """A path with what tracking needs of it, every `STEP_M`. Its frame is that of the path it was made of."""

    path_m: Floats  # (N, 2)
    along_m: Floats  # (N,)
    heading_rad: Floats  # (N,) without jumps
    curvature_1pm: Floats  # (N,) left positive

    def beside(self, x_m: float, y_m: float, reach_m: float = 0.0) -> tuple[float, float]:
        """The station (m along; may lie before or behind the path) of a point and how far left of it the path is.

        reach_m: how much further along than near its beginning the path may pass the point.
        """
        head = self.path_m[: round((NEAREST_WITHIN_M + reach_m) / STEP_M)]
        away = head - (x_m, y_m)
        at = int((away[:, 0] ** 2 + away[:, 1] ** 2).argmin())
        dx, dy = away[at]
        cos, sin = math.cos(self.heading_rad[at]), math.sin(self.heading_rad[at])
        return float(self.along_m[at] - dx * cos - dy * sin), float(dy * cos - dx * sin)


def line_of(path_m: Floats) -> PathLine | None:
    """The line of an (M, 2) path; None where it is none."""
    if len(path_m) < 2 or not np.isfinite(path_m).all():
        return None
    path = resampled(path_m, STEP_M, LONGEST_M)
    if len(path) < FEWEST:
        return None
    cos, sin = headings_along(path)
    heading: Floats = np.unwrap(np.arctan2(sin, cos))
    # From directions 1 m apart, each of 1 m of path: some centimetres of noise do not show, and the ramp that a step
    # of curvature becomes is one that the steering can follow.
    inner = (heading[3:-1] - heading[1:-3]) / (2.0 * STEP_M)
    curvature = np.concatenate((inner[:1], inner[:1], inner, inner[-1:], inner[-1:]))
    heading[0], heading[-1] = heading[1] - STEP_M * inner[0], heading[-2] + STEP_M * inner[-1]
    return PathLine(path, np.arange(len(path), dtype=np.float64) * STEP_M, heading, curvature)


def steering_rate(
    line: PathLine, station_m: float, right_m: float, course_rad: float, curvature_1pm: float, speed_mps: float
) -> float:
    """Return the rate, 1/(m s), at which the curvature that the car drives with must change.

    The car is at a station, `right_m` beside the line to its right (negative: left of it), moves to `course_rad` (in
    the line's frame) with `curvature_1pm` and `speed_mps`. Among all changes within the horizon it takes those that
    weigh deviation and effort by their least squares: so the steering begins before a bend by the time it takes.
    """
    speed = max(round(2.0 * speed_mps) / 2.0, SLOWEST_MPS)
    gains = _gains(speed)
    ahead = station_m + speed * HORIZON_STEP_S * (np.arange(HORIZON_STEPS) + 0.5)
    heading = float(np.interp(station_m, line.along_m, line.heading_rad))
    askew = math.remainder(course_rad - heading, 2.0 * math.pi)
    # The way back from far off must not ask for more than the steering can take back in time.
    far = APPROACH_MAX_RAD * gains[1] / gains[0]
    back = min(max(-right_m, -far), far) * gains[0] + askew * gains[1]
    most = -BACK_MAX_1PM * gains[2]
    back = min(max(back, -most), most) + curvature_1pm * gains[2]
    return float(back + gains[3:] @ np.interp(ahead, line.along_m, line.curvature_1pm))


@cache
def _gains(speed_mps: float) -> Floats:
    """Return the gains (3 + HORIZON_STEPS,) that make the first change of curvature.

    They weigh the deviation to the left (m), the course (rad) and the curvature (1/m) of now, and the line's curvature
    (1/m) in each step.
    """
    sums = np.tri(HORIZON_STEPS)
    ones = np.ones((HORIZON_STEPS, 1))
    none = 0.0 * ones
    turning = speed_mps * HORIZON_STEP_S * sums  # a curvature in each step to the course after it, a course to a place
    courses = np.hstack((none, ones, turning @ ones, -turning))
    places = np.hstack((ones, turning @ courses[:, 1:]))
    by_change = turning @ (HORIZON_STEP_S * sums)
    drift, jerk = speed_mps / DRIFT_MPS, speed_mps**2 / JERK_MPS3
    effect = np.vstack((turning @ by_change / DEVIATION_M, by_change * drift, np.eye(HORIZON_STEPS) * jerk))
    left_alone = np.vstack((places / DEVIATION_M, courses * drift, np.zeros((HORIZON_STEPS, 3 + HORIZON_STEPS))))
    gains: Floats = -np.linalg.solve(effect.T @ effect, effect.T @ left_alone)[0]
    return gains
