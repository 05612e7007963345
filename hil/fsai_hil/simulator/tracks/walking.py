"""What the cones of a file make: the kind of track, its lines, and the borders, found by walking the lane."""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import groupby
from typing import Final

import numpy as np
from msgspec.structs import replace

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks.built_in import skidpad_track
from fsai_hil.simulator.tracks.layout import (
    LANE_M,
    NOSE_M,
    SKIDPAD_CENTRES_APART_M,
    SKIDPAD_INNER_DIAMETER_M,
    STAGED_BEFORE_LINE_M,
    Track,
    TrackError,
    TrackKind,
    as_array,
    smoothed,
    with_circuit,
    with_line,
    with_straight,
)
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, Motion
from fsai_vcu.core.missions.laps import GATE_DEPTH_M, gate_middle, staged
from fsai_vcu.core.planning.pose import resampled_ring
from fsai_vcu.interface.enums import Ami

GATE_M: Final = 8.0  # no two cones of one gate stand further apart, be it across the lane
FAR_M: Final = 1000.0


def measured(track: Track, start: Pose, line: Pose | None = None) -> Track:
    """Find out what kind of track the cones make, its lines and its borders.

    Without a `line` it is where the planner has it: at the gate, else where the staged car has it ahead.
    """
    gates = _gates(track, start)
    if line is None:
        line = _across(gates[0], start) if gates else _staged_line(start)
    if gates and _skidpad_like(track, squared := _squared(gates[0], line)):
        return _with_skidpad(track, squared)
    if (walked := _walk(track, start)) is not None:
        left, right, middle = walked
        middle = smoothed(resampled_ring(middle, 0.25), 2.0)
        if gates:
            line = _across(gates[0], _at(middle, _on(middle, line)))
        middle = np.roll(middle, -_on(middle, line), axis=0)
        return with_circuit(track, _at(middle, 0), middle, left, right)
    if len(gates) >= 2:
        first, finish = (line.x_m, line.y_m), gates[-1].mean(axis=0).tolist()
        ahead_m, left_m = line.seen(*track.cones_xy_m.T)
        beside = (ahead_m > 0.0) & (ahead_m < math.dist(first, finish))
        half = float(np.median(np.abs(left_m[beside]))) if beside.any() else LANE_M / 2.0
        return with_straight(replace(track, kind=TrackKind.ACCELERATION), first, finish, half)
    # cones that make no circuit which can be walked: it can be driven and timed, but nothing is off course
    return with_line(track, line)


def staged_before(track: Track) -> tuple[Track, str]:
    """The track of a file that does not say where the car starts, and what the car is staged before."""
    by_color = (ConeColor.BLUE, ConeColor.YELLOW, ConeColor.BIG_ORANGE)
    blue, yellow, big = (track.cones_xy_m[track.cone_colors == color] for color in by_color)
    if min(len(blue), len(yellow)) == 0:
        raise TrackError(f"{track.source}: no car_start, so nobody knows where the car begins and which way it points")
    pair = _nearest(big, big[0], GATE_M) if len(big) else np.stack((blue[0], _nearest(yellow, blue[0])[0]))
    at = pair.mean(axis=0)
    x, y = _nearest(blue, at)[:2].mean(axis=0) - _nearest(yellow, at)[:2].mean(axis=0)
    line = Pose(float(at[0]), float(at[1]), math.atan2(y, x) - math.pi / 2.0)
    if gates := _gates(track, Pose(*line.ahead(-FAR_M), line.yaw_rad)):  # of two gates the first one
        line = _across(gates[0], line)
    before_m = STAGED_BEFORE_LINE_M[Ami.AUTOCROSS] + NOSE_M
    found = measured(track, Pose(*line.ahead(-before_m), line.yaw_rad), line)
    if found.closed and found.centreline_m is not None:
        steps = round(before_m / found.length_m * len(found.centreline_m))
        found = replace(found, car_start=_at(found.centreline_m, -steps))
    return found, "gate" if gates else "first pair of cones"


def _nearest(cones: Floats, at: Floats, within_m: float = math.inf) -> Floats:
    """The cones no further from a point than that, the nearest first."""
    apart_m = np.hypot(*(cones - at).T)
    return np.asarray(cones[np.argsort(apart_m)][: np.count_nonzero(apart_m <= within_m)])


def _at(middle: Floats, index: int) -> Pose:
    """A point of a closed line, and its direction there."""
    count = len(middle)
    toward = middle[(index + 2) % count] - middle[(index - 2) % count]
    return Pose(float(middle[index, 0]), float(middle[index, 1]), math.atan2(toward[1], toward[0]))


def _on(middle: Floats, line: Pose) -> int:
    """The nearest point of a closed line."""
    return int(np.argmin(np.hypot(middle[:, 0] - line.x_m, middle[:, 1] - line.y_m)))


def _staged_line(start: Pose) -> Pose:
    """Where the planner lays the line of a staged car that sees no gate."""
    ahead_m = STAGED_BEFORE_LINE_M[Ami.AUTOCROSS] + NOSE_M
    line = staged(Motion(x_m=start.x_m, y_m=start.y_m, yaw_rad=start.yaw_rad), ahead_m).line
    return Pose(line.x_m, line.y_m, line.yaw_rad)


def _across(gate: Floats, axis: Pose) -> Pose:
    """The middle between a gate's left and its right cones, in the direction of the axis."""
    x, y = gate_middle(gate, axis.seen(*gate.T)[1] > 0.0).tolist()
    return Pose(x, y, axis.yaw_rad)


def _gates(track: Track, start: Pose) -> list[Floats]:
    """Groups of big orange cones, GATE_DEPTH_M apart along the starting direction or more: those before the car."""
    big = track.cones_xy_m[track.cone_colors == ConeColor.BIG_ORANGE]
    ahead_m = start.seen(*big.T)[0]
    order = np.argsort(ahead_m, kind="stable")
    breaks = np.flatnonzero(np.diff(ahead_m[order]) >= GATE_DEPTH_M) + 1
    return [big[group] for group in np.split(order, breaks) if len(group) and ahead_m[group[-1]] > 0.0]


def _skidpad_like(track: Track, gate: Pose) -> bool:
    """Two rings of blue and yellow cones to the left and to the right of the first gate."""
    apart, inner = SKIDPAD_CENTRES_APART_M / 2.0, SKIDPAD_INNER_DIAMETER_M / 2.0
    for side, color in ((1.0, ConeColor.BLUE), (-1.0, ConeColor.YELLOW)):
        from_centre = track.cones_xy_m[track.cone_colors == color] - gate.ahead(0.0, side * apart)
        if np.count_nonzero(np.abs(np.hypot(*from_centre.T) - inner) < 0.75) < 10:
            return False
    return True


def _squared(gate: Floats, line: Pose) -> Pose:
    """The line square to the gate: from its right to its left cones is across, so that a start askew does no harm."""
    left = line.seen(*gate.T)[1] > 0.0
    if left.all() or not left.any():
        return line
    x, y = gate[left].mean(axis=0) - gate[~left].mean(axis=0)
    return Pose(line.x_m, line.y_m, math.atan2(y, x) - math.pi / 2.0)


def _with_skidpad(track: Track, origin: Pose) -> Track:
    """The rules' skidpad, laid over the cones of a file."""
    ideal = skidpad_track()
    assert ideal.centreline_m is not None  # skidpad_track always has one
    route = as_array([origin.ahead(float(x), float(y)) for x, y in ideal.centreline_m])
    lane = tuple(tuple(tuple(origin.ahead(x, y) for x, y in ring) for ring in rings) for rings in ideal.lane)
    return with_line(replace(track, kind=TrackKind.SKIDPAD, centreline_m=route, lane=lane), origin)


def _walk(track: Track, start: Pose) -> tuple[Floats, Floats, Floats] | None:
    """Walk the lane from triangle to triangle through the edges that join a left cone to a right one.

    In a triangulation of all cones each triangle inside the lane has exactly two such edges, so the way on is always
    the other one. Left border, right border (the cones passed on either side) and the middle between them; None where
    the walk does not come back to its beginning.
    """
    colors = track.cone_colors
    ahead_m, left_m = start.seen(*track.cones_xy_m.T)
    sides = (colors == ConeColor.BLUE).astype(int) - (colors == ConeColor.YELLOW)
    gate = (colors == ConeColor.BIG_ORANGE) & (ahead_m > -15.0)
    sides[gate] = np.where(left_m[gate] > 0.0, 1, -1)
    xy, ahead_m, left_m, sides = (each[sides != 0] for each in (track.cones_xy_m, ahead_m, left_m, sides))
    if min(np.count_nonzero(sides > 0), np.count_nonzero(sides < 0)) < 3:
        return None
    from scipy.spatial import Delaunay, QhullError  # type: ignore[import-untyped]  # slow to import, for files only

    try:
        triangles = Delaunay(xy).simplices
    except QhullError:
        return None
    onward: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)  # the edges with a triangle in common
    begin: tuple[float, tuple[int, int], tuple[int, int]] | None = None  # the edge which the car's axis crosses first
    for triangle in triangles.tolist():
        edges = [(a, b) for a in triangle if sides[a] > 0 for b in triangle if sides[b] < 0]
        for (a, b), following in zip(edges, reversed(edges), strict=True):
            onward[a, b].append(following)
            if left_m[a] * left_m[b] > 0.0 or abs(left_m[a]) + abs(left_m[b]) > 8.0:
                continue
            share = left_m[a] / (left_m[a] - left_m[b]) if left_m[a] != left_m[b] else 0.5
            crossing = (1.0 - share) * ahead_m[a] + share * ahead_m[b]
            (opposite,) = {*triangle} - {a, b}
            # this triangle lies behind the edge as the car sees it
            if 0.0 < crossing < ahead_m[opposite] and (begin is None or crossing < begin[0]):
                begin = (crossing, (a, b), following)
    if begin is None:
        return None
    _, before, edge = begin
    walked = [before]
    while edge != walked[0]:
        walked.append(edge)
        further = [other for other in onward[edge] if other != before]
        if not further:
            return None
        before, edge = edge, further[0]
    borders = [[cone for cone, _ in groupby(side)] for side in zip(*walked, strict=True)]
    for border in borders:
        if border[0] == border[-1]:
            border.pop()
    passed = np.array(walked)
    return xy[borders[0]], xy[borders[1]], (xy[passed[:, 0]] + xy[passed[:, 1]]) / 2.0
