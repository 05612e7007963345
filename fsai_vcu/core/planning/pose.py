"""Points and paths between the odometry frame and the vehicle frame, and along a path."""

from __future__ import annotations

import math

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion


def to_odometry(motion: Motion, xy_m: Floats) -> Floats:
    """(N, 2) points of the vehicle frame, in the odometry frame."""
    cos, sin = math.cos(motion.yaw_rad), math.sin(motion.yaw_rad)
    by_cos, by_sin = cos * xy_m, sin * xy_m
    out = np.empty_like(xy_m)
    np.subtract(motion.x_m + by_cos[:, 0], by_sin[:, 1], out=out[:, 0])
    np.add(motion.y_m + by_sin[:, 0], by_cos[:, 1], out=out[:, 1])
    return out


def to_vehicle(motion: Motion, xy_m: Floats) -> Floats:
    """(N, 2) points of the odometry frame, in the vehicle frame."""
    cos, sin = math.cos(motion.yaw_rad), math.sin(motion.yaw_rad)
    dx, dy = xy_m[:, 0] - motion.x_m, xy_m[:, 1] - motion.y_m
    out = np.empty_like(xy_m)
    np.add(cos * dx, sin * dy, out=out[:, 0])
    np.subtract(cos * dy, sin * dx, out=out[:, 1])
    return out


def gaps(a: Floats, b: Floats) -> Floats:
    """(N, M) distances between two sets of points."""
    return np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])


def lengths_along(path_m: Floats) -> Floats:
    """(N,) length of path up to each of its points."""
    along = np.zeros(len(path_m))
    steps = path_m[1:] - path_m[:-1]
    np.hypot(steps[:, 0], steps[:, 1]).cumsum(out=along[1:])
    return along


def resampled(path_m: Floats, step_m: float, most_m: float = math.inf) -> Floats:
    """The path with points every `step_m` from its first one, up to `most_m`; the rest of the last step is dropped."""
    along = lengths_along(path_m)
    at = np.arange(0.0, min(float(along[-1]), most_m) + 1e-9, step_m)
    points = np.empty((len(at), 2))
    points[:, 0], points[:, 1] = np.interp(at, along, path_m[:, 0]), np.interp(at, along, path_m[:, 1])
    return points


def resampled_ring(line_m: Floats, step_m: float) -> Floats:
    """The closed line with points about every `step_m`, evenly."""
    ring = np.concatenate((line_m, line_m[:1]))
    along = lengths_along(ring)
    at = np.linspace(0.0, along[-1], max(8, round(along[-1] / step_m)), endpoint=False)
    return np.column_stack((np.interp(at, along, ring[:, 0]), np.interp(at, along, ring[:, 1])))


def ring_curvature(line_m: Floats, over: int = 1) -> Floats:
    """(N,) signed curvature of a closed, evenly sampled line, 1/m (left positive): its turn over so many steps."""
    ring = line_m @ (1.0, 1j)
    chord = np.roll(ring, -over) - ring
    turn = np.angle(chord * np.roll(chord, over).conj())
    return np.asarray(turn / (over * np.abs(np.roll(ring, -1) - ring).mean()))


def headings_along(path_m: Floats) -> tuple[Floats, Floats]:
    """(N,) cosine and sine of the path's direction at each point. At least two points."""
    # The same as numpy's gradient, without the five sixths of the time in which that looks at its arguments.
    along = np.empty((2, len(path_m)))
    along[:, 1:-1] = (path_m[2:] - path_m[:-2]).T / 2.0
    along[:, 0], along[:, -1] = path_m[1] - path_m[0], path_m[-1] - path_m[-2]
    cos, sin = along / np.maximum(np.hypot(along[0], along[1]), 1e-9)
    return cos, sin


def within(value: Floats, most: float) -> Floats:
    """Return each value, but none beyond `most` to either side. (A third of the time of numpy's clip.)"""
    return np.minimum(np.maximum(value, -most), most)


NO_PATH: Floats = np.zeros((0, 2))
