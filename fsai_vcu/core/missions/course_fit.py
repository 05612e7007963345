"""Pose of the car on a course of known shape: the pose from which the cones seen stand on the course's borders.

One least-squares fit serves the search (many guesses, each free to move far) and tracking (one guess, by dead
reckoning, which may be off a little). Where along its border a cone stands does not matter, nor does its colour, so
the course may be laid with any number of cones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion

CONE_SIGMA_M = 0.15
GATE_M = 0.9  # a cone further from every border is none of the course's
TRACKED = np.array([0.05, 0.05, 0.01])  # m, m, rad: drift of odometry between two observations, generously
ITERATIONS = 5

Borders = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]
"""x and y (H, N) in the course frame to the distance from the nearest border, signed, and its normal's x and y."""


def on_course(pose: Floats, xy_m: Floats) -> Floats:
    """(…, N, 2) points of the vehicle frame in the course frame, for a car at `pose` (…, 3): x, y, yaw."""
    cos, sin = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    x = pose[..., 0, None] + cos * xy_m[:, 0] - sin * xy_m[:, 1]
    return np.stack((x, pose[..., 1, None] + sin * xy_m[:, 0] + cos * xy_m[:, 1]), axis=-1)


def from_car(pose: Floats, xy_m: Floats) -> Floats:
    """(N, 2) points of the course frame in the vehicle frame, for a car at `pose` (3,)."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray((xy_m - pose[:2]) @ np.array([[cos, -sin], [sin, cos]]))


def carried(pose: Floats, before: Motion, now: Motion) -> Floats:
    """The pose after the odometry's way from `before` to `now`."""
    turn = pose[2] - before.yaw_rad
    dx, dy = now.x_m - before.x_m, now.y_m - before.y_m
    x, y = np.cos(turn) * dx - np.sin(turn) * dy, np.sin(turn) * dx + np.cos(turn) * dy
    return np.asarray(pose + np.array([x, y, now.yaw_rad - before.yaw_rad]))


def _seen_at(poses: Floats, xy_m: Floats) -> tuple[Floats, Floats]:
    """(H, N) x and (H, N) y of the cones (N, 2, vehicle frame) from the car at each pose, turned as the course is."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = np.array(((cos, -sin), (sin, cos))).swapaxes(1, 2) @ xy_m.T
    return x, y


def fitted(borders: Borders, guesses: Floats, xy_m: Floats, sigma: Floats = TRACKED, gate_m: float = GATE_M) -> Floats:
    """(H, 3) the guesses, each moved so that the cones (N, 2, vehicle frame) stand on the course.

    `sigma` (3,) says how far a guess may be off: it holds what the cones do not determine.
    """
    poses: Floats = guesses.copy()
    precision = sigma**-2.0
    prior, jacobian = np.diag(precision), np.empty((len(poses), 3, len(xy_m)))
    for _ in range(ITERATIONS):
        arm_x, arm_y = _seen_at(poses, xy_m)
        residual, jacobian[:, 0], jacobian[:, 1] = borders(arm_x + poses[:, :1], arm_y + poses[:, 1:2])
        jacobian[:, 2] = jacobian[:, 1] * arm_x - jacobian[:, 0] * arm_y
        size = np.abs(residual)
        # Huber's; nothing beyond the gate
        weight = (size < gate_m) * CONE_SIGMA_M**-2 * np.minimum(1.0, 2.0 * CONE_SIGMA_M / np.maximum(size, 1e-9))
        weighted = jacobian * weight[:, None]
        slope = weighted @ residual[..., None] + (precision * (poses - guesses))[..., None]
        step = np.linalg.solve(weighted @ jacobian.swapaxes(1, 2) + prior, slope)[..., 0]
        poses = poses - step
        if np.abs(step).max() < 1e-3:
            break
    return poses


def misfit(borders: Borders, poses: Floats, xy_m: Floats) -> Floats:
    """(H,) sum of the cones' squared distances from the course in sigmas; a cone of no border costs no more than 36."""
    arm_x, arm_y = _seen_at(poses, xy_m)
    residual = borders(arm_x + poses[:, :1], arm_y + poses[:, 1:2])[0]
    return np.asarray((np.minimum(np.abs(residual), GATE_M) ** 2).sum(axis=-1) / CONE_SIGMA_M**2)
