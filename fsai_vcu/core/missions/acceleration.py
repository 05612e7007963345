"""The acceleration mission: where along its straight lane the finish is, and where cones close the lane behind it."""

from __future__ import annotations

import numpy as np

from fsai_vcu.core.arrays import Floats

IN_THE_WAY_M = 0.9  # a cone nearer to the lane's middle closes it
FINISH_GATE_M = 12.0  # big orange cones count as the finish within this distance from where it is expected
GATE_WIDEST_M = 4.0  # of its cones from the lane's middle


def finish_seen(finish_m: float, big_orange_m: Floats) -> float:
    """Where along the lane the finish is, seen these big orange cones (lane frame): between those on both sides."""
    of_finish = np.abs(big_orange_m - (finish_m, 0.0)) < (FINISH_GATE_M, GATE_WIDEST_M)
    gate = big_orange_m[of_finish.all(axis=1)]
    both_sides = (gate[:, 1] > 0.0).any() and (gate[:, 1] < 0.0).any()
    return float(gate[:, 0].mean()) if both_sides else finish_m


def closed_at(after_m: float, cones_m: Floats) -> float | None:
    """Where along the lane cones (lane frame) close it further on, or None: there is an end to every exit lane."""
    wall = cones_m[(np.abs(cones_m[:, 1]) < IN_THE_WAY_M) & (cones_m[:, 0] > after_m), 0]
    return float(wall.min()) if len(wall) else None
