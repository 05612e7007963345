"""From cones around the car to the middle of the lane, with colours or without.

First a beam search tries chains of short arcs from the car forward. A chain is good when cones stand to its left and
right at the distance of a border, blue ones left and yellow ones right, each counted once; bad when it drives into
cones, has colours on the wrong side, or jerks. So a missing cone costs nothing, a false one little, and a lone border
is enough; where cones have no colour, the order in which they stand along the chain decides what is left and right.
Then the chain is moved to the middle between the borders and smoothed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsai_vcu.core.driving import Floats, Ints
from fsai_vcu.core.planning.cone_memory import Cones
from fsai_vcu.core.planning.pose import NO_PATH, headings_along, lengths_along, resampled
from fsai_vcu.core.planning.settings import PlannerSettings

# Distances of a cone from the lane's middle, m: nearer than INSIDE it stands in the way, from BORDER_NEAR to BORDER_FAR
# it is a border, beyond OUTSIDE it belongs to something else. The car is 1.43 m wide.
INSIDE_M, BORDER_NEAR_M, BORDER_FAR_M, OUTSIDE_M = 0.8, 1.2, 2.8, 4.0

REWARD_KNOWN, REWARD_UNKNOWN = 1.0, 0.8
COST_IN_THE_WAY = 2.5
COST_WRONG_SIDE = 1.5
COST_BENDING = 0.8  # of a change from straight to the tightest arc
COST_CURVATURE = 0.25

VOTE_M = 12.0  # how far ahead cones are told to be left or right, for the next time; the nearer the surer

BACKWARD_M = 4.0  # how far behind the car the borders are used


@dataclass(frozen=True, slots=True)
class Lane:
    """The lane ahead. path_m: (M, 2) vehicle frame, from beside the car forward, empty when no lane was found;
    side: (N,) for each cone given, +1 surely on its left … -1 surely on its right, 0 neither;
    half_width_m: estimate."""

    path_m: Floats
    side: Floats
    half_width_m: float


def find_lane(
    cones: Cones, curvature_1pm: float, half_width_m: float, nose_m: float, settings: PlannerSettings
) -> Lane:
    """The lane through `cones` from a car at the origin that looks along x and drives with `curvature_1pm` now.

    `nose_m`: from the car's rear axle, which follows the path, to its nose.
    """
    none = Lane(NO_PATH, np.zeros(len(cones.xy_m)), half_width_m)
    if len(cones.xy_m) < 2:
        return none
    line = _with_backward(_search(cones.xy_m, cones.side, settings), curvature_1pm, settings)
    half_width = half_width_m
    for _ in range(2):
        line, sides, along, half_width, end_m = _centred(line, cones, half_width, settings)
        if end_m <= 0.0:
            return none
    line = _swept(line, nose_m, settings)
    stations = lengths_along(line)
    start = int(np.argmin(np.hypot(line[:, 0], line[:, 1])))
    ahead = line[(np.arange(len(line)) >= start) & (stations <= end_m + BACKWARD_M)]
    if len(ahead) < 3:
        return none
    vote = np.where((along > -2.0) & (along < VOTE_M), sides * np.clip(1.2 - along / VOTE_M, 0.2, 1.0), 0.0)
    return Lane(
        resampled(ahead, settings.path_step_m),
        vote,
        half_width,
    )


def _ramp(value: Floats, low: float, high: float) -> Floats:
    """0 below `low`, 1 above `high`, straight between."""
    return np.clip((value - low) / (high - low), 0.0, 1.0)


def _search(xy: Floats, side: Floats, settings: PlannerSettings) -> Floats:
    """The best chain of arcs from the origin along x, as (M, 2) points every quarter of a step."""
    step, levels = settings.step_m, max(2, round(settings.horizon_m / settings.step_m))
    bends = np.array([-1.0, -0.62, -0.34, -0.14, 0.0, 0.14, 0.34, 0.62, 1.0]) * settings.curvature_max_1pm
    n_bends, n_cones = len(bends), len(xy)

    x, y, heading, bend, cost = (np.zeros(1) for _ in range(5))
    counted = np.zeros((1, n_cones), dtype=bool)  # by each chain so far
    history: list[tuple[Ints, Floats, Floats, Floats, Floats]] = []  # parent, start x, start y, start heading, bend

    # Each cone's reward for either side: what its colour (or earlier lanes) say.
    reward_left = np.where(side == 0.0, REWARD_UNKNOWN, REWARD_KNOWN) * (side > -0.3)
    reward_right = np.where(side == 0.0, REWARD_UNKNOWN, REWARD_KNOWN) * (side < 0.3)

    for _ in range(levels):
        parent = np.repeat(np.arange(len(x)), n_bends)
        b = np.tile(bends, len(x))
        middle = heading[parent] + 0.5 * step * b
        end_x, end_y = x[parent] + step * np.cos(middle), y[parent] + step * np.sin(middle)
        end_heading = heading[parent] + step * b

        # Cones in the frames of each arc's start and end; those between the two frames belong to the arc.
        dx, dy = xy[None, :, 0] - x[:, None], xy[None, :, 1] - y[:, None]
        cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
        u0, v0 = (dx * cos + dy * sin)[parent], (dy * cos - dx * sin)[parent]
        dx, dy = xy[None, :, 0] - end_x[:, None], xy[None, :, 1] - end_y[:, None]
        cos, sin = np.cos(end_heading)[:, None], np.sin(end_heading)[:, None]
        u1, v1 = dx * cos + dy * sin, dy * cos - dx * sin
        beside = (u0 >= 0.0) & (u1 < 0.0)
        share = u0 / np.where(beside, u0 - u1, 1.0)
        lateral = v0 + share * (v1 - v0) - (0.5 * step * step) * b[:, None] * share * (1.0 - share)

        size = np.abs(lateral)
        is_left = lateral > 0.0
        as_border = _ramp(size, INSIDE_M, BORDER_NEAR_M) * (1.0 - _ramp(size, BORDER_FAR_M, OUTSIDE_M))
        in_the_way = 1.0 - _ramp(size, INSIDE_M, BORDER_NEAR_M)
        reward = np.where(is_left, reward_left, reward_right)
        wrong = np.maximum(0.0, np.where(is_left, -side, side)) * (1.0 - _ramp(size, BORDER_FAR_M, OUTSIDE_M))
        was = counted[parent]
        charge = COST_IN_THE_WAY * in_the_way + COST_WRONG_SIDE * wrong - reward * as_border * ~was
        jerk = np.abs(b - bend[parent]) / settings.curvature_max_1pm
        new_cost = (
            cost[parent]
            + (charge * beside).sum(axis=1)
            + COST_BENDING * jerk * jerk * 0.5
            + COST_CURVATURE * (b / settings.curvature_max_1pm) ** 2
        )

        # Keep the best; of chains that end at about the same pose only the best one.
        order = np.argsort(new_cost, kind="stable")
        cell = (
            np.floor(end_x[order] / 0.7).astype(np.int64) * 1_000_003
            + np.floor(end_y[order] / 0.7).astype(np.int64) * 1009
            + np.floor(end_heading[order] / 0.3).astype(np.int64)
        )
        _, first = np.unique(cell, return_index=True)
        kept = order[np.sort(first)[: settings.beam]]

        history.append((parent[kept], x[parent[kept]], y[parent[kept]], heading[parent[kept]], b[kept]))
        counted = was[kept] | (beside[kept] & (as_border[kept] > 0.3))
        x, y, heading, bend, cost = end_x[kept], end_y[kept], end_heading[kept], b[kept], new_cost[kept]
        x, y = _drawn_to_middle(x, y, heading, bend, xy, side)

    pieces: list[Floats] = []
    at = int(np.argmin(cost))
    last = np.array([[x[at], y[at]]])
    for parents, start_x, start_y, start_heading, arc_bend in reversed(history):
        s = np.arange(0.0, step - 1e-9, step / 4.0)
        turn = start_heading[at] + 0.5 * s * arc_bend[at]
        pieces.append(np.column_stack((start_x[at] + s * np.cos(turn), start_y[at] + s * np.sin(turn))))
        at = int(parents[at])
    return np.concatenate([*reversed(pieces), last])


def _drawn_to_middle(
    x: Floats, y: Floats, heading: Floats, bend: Floats, xy: Floats, side: Floats
) -> tuple[Floats, Floats]:
    """The poses, moved sideways to the middle between their nearest cones left and right where there are both."""
    dx, dy = xy[None, :, 0] - x[:, None], xy[None, :, 1] - y[:, None]
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    u = dx * cos + dy * sin
    v = dy * cos - dx * sin - 0.5 * bend[:, None] * u * u
    near = np.abs(u) < 3.0
    left = np.where(near & (v > 0.4) & (v < OUTSIDE_M) & (side > -0.3)[None, :], v, np.inf).min(axis=1)
    right = np.where(near & (v < -0.4) & (v > -OUTSIDE_M) & (side < 0.3)[None, :], -v, np.inf).min(axis=1)
    both = np.isfinite(left) & np.isfinite(right)
    shift = np.where(both, np.clip(0.5 * (np.where(both, left, 0.0) - np.where(both, right, 0.0)), -0.5, 0.5), 0.0)
    return x - shift * sin[:, 0], y + shift * cos[:, 0]


def _with_backward(line: Floats, curvature_1pm: float, settings: PlannerSettings) -> Floats:
    """The line carried on behind the car along the arc on which the car has come, resampled."""
    curvature = min(max(curvature_1pm, -settings.curvature_max_1pm), settings.curvature_max_1pm)
    s = -np.arange(BACKWARD_M, 0.1, -settings.path_step_m)
    turn = 0.5 * s * curvature
    behind = np.column_stack((s * np.cos(turn), s * np.sin(turn)))
    return resampled(np.concatenate((behind, line)), settings.path_step_m)


def _smoothed(line: Floats, settings: PlannerSettings) -> Floats:
    """Averaged with a bell of `smoothing_m`, ends carried on straight."""
    reach = max(1, round(2.0 * settings.smoothing_m / settings.path_step_m))
    offsets = np.arange(-reach, reach + 1) * settings.path_step_m
    bell = np.exp(-0.5 * (offsets / settings.smoothing_m) ** 2)
    bell /= bell.sum()
    steps = np.arange(reach, 0, -1)[:, None]
    before = line[0] - steps * (line[1] - line[0])
    after = line[-1] + steps[::-1] * (line[-1] - line[-2])
    padded = np.concatenate((before, line, after))
    return np.column_stack([np.convolve(padded[:, axis], bell, mode="valid") for axis in (0, 1)])


def _swept(line: Floats, nose_m: float, settings: PlannerSettings) -> Floats:
    """The line moved inward in bends, so that the car as a whole is in the middle when its rear axle follows the line.

    The nose's outer corner swings out by nose² / 2R more than the rear wheels' inner side cuts in: half of that.
    """
    cos, sin = headings_along(line)
    heading = np.unwrap(np.arctan2(sin, cos))
    span = max(1, round(1.0 / settings.path_step_m))
    curvature = np.zeros(len(line))
    curvature[span:-span] = (heading[2 * span :] - heading[: -2 * span]) / (2.0 * span * settings.path_step_m)
    curvature = np.clip(curvature, -settings.curvature_max_1pm, settings.curvature_max_1pm)
    inward = 0.25 * nose_m * nose_m * curvature
    return np.column_stack((line[:, 0] - inward * sin, line[:, 1] + inward * cos))


def _centred(
    line: Floats, cones: Cones, half_width_m: float, settings: PlannerSettings
) -> tuple[Floats, Floats, Floats, float, float]:
    """The line moved to the middle between the borders.

    Returns it with each cone's side (+1, -1, 0: no border), each cone's way along the line from the car (m), the lane's
    half width (m), and how far ahead the borders are seen (m from the car).
    """
    stations = lengths_along(line)
    cos, sin = headings_along(line)
    dx, dy = cones.xy_m[:, None, 0] - line[None, :, 0], cones.xy_m[:, None, 1] - line[None, :, 1]
    nearest = (dx * dx + dy * dy).argmin(axis=1)
    rows = np.arange(len(nearest))
    dx, dy = dx[rows, nearest], dy[rows, nearest]
    along_here = dx * cos[nearest] + dy * sin[nearest]
    lateral = dy * cos[nearest] - dx * sin[nearest]
    along = stations[nearest] + np.clip(along_here, -settings.path_step_m, settings.path_step_m)
    size = np.abs(lateral)
    sides = np.sign(lateral)
    usable = (np.abs(along_here) < 1.0) & (size > 0.6) & (size < OUTSIDE_M + 0.5) & (cones.side * sides > -0.5)
    sides = np.where(usable, sides, 0.0)
    # Of cones of one side beside each other only the nearer one is the border.
    for sign in (1.0, -1.0):
        mine = np.flatnonzero(sides == sign)
        if len(mine) > 1:
            close = np.abs(along[mine][:, None] - along[mine][None, :]) < 3.0
            nearest_size = np.where(close, size[mine][None, :], np.inf).min(axis=1)
            sides[mine[size[mine] > nearest_size + 1.2]] = 0.0

    left, left_known = _border(stations, along, lateral, sides > 0, settings)
    right, right_known = _border(stations, along, lateral, sides < 0, settings)
    both = left_known & right_known
    width = half_width_m
    if both.any():
        seen = float(np.median(0.5 * (left[both] - right[both])))
        width = min(max(seen, settings.lane_half_width_min_m), settings.lane_half_width_max_m)
    shift = np.where(
        both,
        0.5 * (left + right),
        np.where(left_known, left - width, np.where(right_known, right + width, np.nan)),
    )
    known = np.isfinite(shift)
    car_m = BACKWARD_M
    if not known.any():
        return line, sides, along - car_m, width, 0.0
    shift = np.interp(stations, stations[known], shift[known])
    shift = np.clip(shift, -2.5, 2.5)
    moved = np.column_stack((line[:, 0] - shift * sin, line[:, 1] + shift * cos))
    moved = _smoothed(moved, settings)

    # How far the borders reach without too long a gap.
    reached = car_m
    for station in np.sort(along[(sides != 0.0) & (along > car_m)]):
        if station - reached > settings.border_gap_max_m:
            break
        reached = float(station)
    return moved, sides, along - car_m, width, reached - car_m


def _border(
    stations: Floats,
    along: Floats,
    lateral: Floats,
    mine: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    settings: PlannerSettings,
) -> tuple[Floats, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """A border's lateral position at each station, and where it is known: between cones not too far apart, and a
    little beyond the first and last one."""
    if not mine.any():
        return np.zeros(len(stations)), np.zeros(len(stations), dtype=bool)
    order = np.argsort(along[mine], kind="stable")
    s, v = along[mine][order], lateral[mine][order]
    value = np.interp(stations, s, v)
    after = np.searchsorted(s, stations)
    to_next = np.where(after < len(s), s[np.minimum(after, len(s) - 1)] - stations, np.inf)
    to_last = np.where(after > 0, stations - s[np.maximum(after - 1, 0)], np.inf)
    inside = to_next + to_last <= settings.border_gap_max_m
    return value, inside | (to_next <= 2.0) | (to_last <= 2.0)
