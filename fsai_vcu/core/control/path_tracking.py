"""Steering along a path: pure pursuit from where the car will be when the steering answers."""

from __future__ import annotations

import math

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.control.settings import ControllerSettings


def lookahead_m(speed_mps: float, settings: ControllerSettings) -> float:
    reach = settings.lookahead_m + settings.lookahead_s * speed_mps
    return min(max(reach, settings.lookahead_min_m), settings.lookahead_max_m)


def pursue(path_m: Floats, along_m: Floats, nearest: int, reach_m: float, wheelbase_m: float) -> float | None:
    """Steering angle (rad) towards the point `reach_m` further along than point `nearest`.

    path_m: (N, 2) in the frame of the rear axle; along_m: (N,) length of path up to each point. None where the path
    ends too near to steer by.
    """
    target_along = along_m[nearest] + reach_m
    if target_along >= along_m[-1]:
        x, y = float(path_m[-1, 0]), float(path_m[-1, 1])
    else:
        x = float(np.interp(target_along, along_m, path_m[:, 0]))
        y = float(np.interp(target_along, along_m, path_m[:, 1]))
    square = x * x + y * y
    if x < 0.3 or square < 0.5:
        if square < 0.5 or abs(y) < 0.5:
            return None
        return math.copysign(math.pi / 4.0, y)  # beside or behind the car: as far round as it goes
    return math.atan(wheelbase_m * 2.0 * y / square)
