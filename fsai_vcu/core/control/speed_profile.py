"""Speed at which each point of a path can be passed, with everything that lies behind it.

This is the backward half. What motors and power can gain, the forward half, the controller asks again each cycle from
the speed that the car really has; planned ahead as well, it cost 0.1 to 0.15 s of each lap of 27 s and changed nothing
else.
"""

from __future__ import annotations

import math

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.control.path_tracking import STEP_M

SMOOTHED_OVER = 5  # points: a curvature counts for the speed when it lasts
GENTLE_END_M, GENTLE_STOP_MPS2 = 1.5, 1.5  # before the place where the car must stand: no jolt
# Of the braking, left in a corner at the limit of grip; and by the share of the lateral grip that is left: braking
# lightens the rear axle, which then holds the car in the corner less well than the front one.
BRAKING_SHARE_MIN, LIGHTENED = 0.05, 2.2


def braking_share(sideways: float) -> float:
    """Return the share of the braking that is left beside so much of the lateral grip: an ellipse, but for its end."""
    left = 1.0 - sideways * sideways
    return max(min(math.sqrt(max(left, 0.0)), LIGHTENED * (1.0 - sideways)), BRAKING_SHARE_MIN)


def speed_profile(
    curvature_1pm: Floats,
    ceiling_m2ps2: Floats,
    end: tuple[float, float],
    stop_m: float | None,
    grip_mps2: tuple[float, float, float],
    curvature_rate_1pms: float,
) -> Floats:
    """(N,) square of the highest speed (m2/s2) at each point of a path with points every `STEP_M`.

    ceiling_m2ps2: (N,) square of the speed allowed at each point, whatever the path;
    end: how far (m) the path is supported, and the speed (m/s) there; stop_m: where the car must stand;
    grip_mps2: lateral, braking before corners and braking to the stop.
    curvature_rate_1pms: how fast (1/(m s)) the steering changes the curvature.
    """
    lateral, braking, stopping = grip_mps2
    count = len(curvature_1pm)
    along = STEP_M * np.arange(count)
    padded = np.pad(curvature_1pm, SMOOTHED_OVER // 2, mode="edge")
    curvature = np.convolve(padded, np.full(SMOOTHED_OVER, 1.0 / SMOOTHED_OVER), mode="valid")
    change = np.abs(np.gradient(curvature, STEP_M)) if count > 1 else np.zeros(count)
    limit = np.minimum(lateral / np.maximum(np.abs(curvature), 1e-6), ceiling_m2ps2)
    limit = np.minimum(limit, (curvature_rate_1pms / np.maximum(change, 1e-6)) ** 2)
    end_m, end_mps = end
    limit = np.minimum(limit, end_mps**2 + 2.0 * braking * np.maximum(end_m - along, 0.0))
    squares = limit.tolist()
    used = (np.abs(curvature) / lateral).tolist()  # of the lateral grip, by the square of the speed
    square = squares[-1]
    for at in range(count - 2, -1, -1):
        square = min(squares[at], square + 2.0 * STEP_M * braking * braking_share(used[at + 1] * square))
        squares[at] = square
    whole = np.array(squares)
    if stop_m is None:
        return whole
    left_m = np.maximum(stop_m - along, 0.0)
    gentle_m = np.minimum(left_m, GENTLE_END_M)
    stop: Floats = 2.0 * (min(GENTLE_STOP_MPS2, stopping) * gentle_m + stopping * (left_m - gentle_m))
    profile: Floats = np.minimum(whole, stop)
    return profile
