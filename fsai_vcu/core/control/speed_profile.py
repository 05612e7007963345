"""How fast the path can be driven, and when to brake for what lies ahead on it."""

from __future__ import annotations

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.control.settings import ControllerSettings

CURVATURE_SPAN = 3  # points to either side between which the path's direction is compared


def curvature_along(path_m: Floats) -> Floats:
    """(N,) magnitude of curvature at each point, 1/m, from directions some points apart."""
    count = len(path_m)
    span = min(CURVATURE_SPAN, (count - 1) // 2)
    if span < 1:
        return np.zeros(count)
    chord = path_m[span:] - path_m[:-span]
    size = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-6)
    before, after = chord[:-span], chord[span:]
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    dot = before[:, 0] * after[:, 0] + before[:, 1] * after[:, 1]
    inner = np.abs(np.arctan2(cross, dot)) / (0.5 * (size[:-span] + size[span:]))
    return np.concatenate((np.full(span, inner[0]), inner, np.full(span, inner[-1])))


def speed_demand(
    path_m: Floats,
    ahead_m: Floats,
    speed_mps: float,
    max_speed_mps: float,
    stop_m: float | None,
    settings: ControllerSettings,
) -> tuple[float, float]:
    """The speed (m/s) from which planned braking still suffices for everything ahead, and the deceleration (m/s2) that
    the most pressing of it needs at the present speed.

    ahead_m: (N,) way from the car to each point; stop_m: way to the stopping place.
    """
    limit = np.minimum(settings.lateral_mps2 / np.maximum(curvature_along(path_m), 1e-6), max_speed_mps**2)
    limit[-1] = min(float(limit[-1]), settings.end_of_path_mps**2)
    room = np.maximum(ahead_m - speed_mps * settings.reaction_s, 0.0)
    square = min(float((limit + 2.0 * settings.braking_mps2 * room).min()), max_speed_mps**2)
    needed = float(((speed_mps**2 - limit) / (2.0 * np.maximum(room, 0.5))).max())
    if stop_m is not None:
        stop_room = max(stop_m - speed_mps * settings.reaction_s, 0.0)
        square = min(square, 2.0 * settings.stopping_mps2 * stop_room)
        needed = max(needed, speed_mps**2 / (2.0 * max(stop_room, 0.5)))
    return max(square, 0.0) ** 0.5, max(needed, 0.0)
