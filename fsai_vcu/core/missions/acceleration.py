"""The acceleration mission: a straight lane between cones, and where on it the car is.

The lane is a straight line in the odometry frame: lateral = offset + slope * along, in the frame of the staged car.
Every observation fits it again to the cones around, starting from the line so far; so odometry may drift slowly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.interface.immutable import Immutable

CONE_SIGMA_M = 0.2
OFFSET_SIGMA_M = 0.15  # how far the line may move at the car from one observation to the next
SLOPE_SIGMA = 0.02
WIDTH_SIGMA_M = 0.5
GATE_M = 0.9
IN_THE_WAY_M = 0.9  # a cone nearer to the lane's middle closes it
FINISH_GATE_M = 8.0  # big orange cones count as the finish within this distance from where it is expected


@dataclass(frozen=True, slots=True)
class AccelerationState(Immutable):
    """The lane's line in the frame of the staged car at (x, y, yaw) of the odometry frame."""

    x_m: float
    y_m: float
    yaw_rad: float
    finish_m: float  # along the line, for the rear axle
    offset_m: float = 0.0
    slope: float = 0.0
    half_width_m: float = 1.5
    along_m: float = 0.0  # where the car is


def staged_before(motion: Motion, settings: MissionSettings, nose_m: float) -> AccelerationState:
    """The state of a car that stands before the start line, straight."""
    finish = nose_m + settings.acceleration_staging_m + settings.acceleration_length_m
    return AccelerationState(motion.x_m, motion.y_m, motion.yaw_rad, finish)


def _in_lane_frame(state: AccelerationState, xy_m: Floats) -> Floats:
    cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    dx, dy = xy_m[:, 0] - state.x_m, xy_m[:, 1] - state.y_m
    return np.column_stack((cos * dx + sin * dy, cos * dy - sin * dx))


def advance_acceleration(
    state: AccelerationState, motion: Motion, cones_m: Floats, big_orange_m: Floats
) -> AccelerationState:
    """The state with the car at `motion` and these cones, all of them and the big orange ones (odometry frame)."""
    car = _in_lane_frame(state, np.array([[motion.x_m, motion.y_m]]))[0]
    along = float(car[0])
    state = replace(state, along_m=along)
    if len(cones_m):
        points = _in_lane_frame(state, cones_m)
        from_line = points[:, 1] - (state.offset_m + state.slope * points[:, 0])
        side = np.sign(from_line)
        # Unknowns: offset at the car, slope, half width. The line so far is the first guess.
        rows = np.column_stack((np.ones(len(points)), points[:, 0] - along, side))
        guess = np.array([state.offset_m + state.slope * along, state.slope, state.half_width_m])
        prior = np.diag([OFFSET_SIGMA_M**-2, SLOPE_SIGMA**-2, WIDTH_SIGMA_M**-2])
        fitted = guess.copy()
        for _ in range(3):
            residual = points[:, 1] - rows @ fitted
            weight = np.where(np.abs(residual) < GATE_M, CONE_SIGMA_M**-2, 0.0)
            weight = weight * np.minimum(1.0, 2.0 * CONE_SIGMA_M / np.maximum(np.abs(residual), 1e-9))  # Huber's
            weighted = rows * weight[:, None]
            fitted = fitted + np.linalg.solve(
                weighted.T @ rows + prior, weighted.T @ residual + prior @ (guess - fitted)
            )
        slope = float(fitted[1])
        state = replace(
            state,
            offset_m=float(fitted[0]) - slope * along,
            slope=slope,
            half_width_m=min(max(float(fitted[2]), 1.2), 3.0),
        )
    if len(big_orange_m):
        gate = _in_lane_frame(state, big_orange_m)
        lateral = gate[:, 1] - (state.offset_m + state.slope * gate[:, 0])
        of_finish = (np.abs(gate[:, 0] - state.finish_m) < FINISH_GATE_M) & (np.abs(lateral) < 4.0)
        if (of_finish & (lateral > 0)).any() and (of_finish & (lateral < 0)).any() and along < state.finish_m:
            state = replace(state, finish_m=float(gate[of_finish, 0].mean()))
    return state


def closed_at(state: AccelerationState, cones_m: Floats) -> float | None:
    """Where along the line cones close the lane behind the finish, or None: there is an end to every exit lane."""
    if not len(cones_m):
        return None
    points = _in_lane_frame(state, cones_m)
    lateral = np.abs(points[:, 1] - (state.offset_m + state.slope * points[:, 0]))
    wall = points[(lateral < IN_THE_WAY_M) & (points[:, 0] > state.finish_m) & (points[:, 0] > state.along_m), 0]
    return float(wall.min()) if len(wall) else None


def line_ahead(state: AccelerationState, length_m: float, step_m: float) -> Floats:
    """(M, 2) of the lane's middle from beside the car on, in the odometry frame."""
    run = np.arange(0.0, length_m + 1e-9, step_m) / math.hypot(1.0, state.slope)
    x = state.along_m + run
    y = state.offset_m + state.slope * x
    cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    return np.column_stack((state.x_m + cos * x - sin * y, state.y_m + sin * x + cos * y))
