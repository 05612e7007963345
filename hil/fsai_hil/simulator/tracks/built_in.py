"""The built-in tracks, laid out by rule geometry."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks.layout import (
    ACCELERATION_RUN_M,
    ACCELERATION_STOP_M,
    BETWEEN_RINGS,
    CIRCUIT_LANE_M,
    CIRCUIT_MIN_RADIUS_M,
    LANE_M,
    SKIDPAD_CENTRES_APART_M,
    SKIDPAD_INNER_DIAMETER_M,
    Point,
    Track,
    TrackKind,
    as_array,
    closest_m,
    cones_of,
    offset_line,
    with_circuit,
    with_line,
    with_straight,
)
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.planning.pose import resampled_ring, ring_curvature
from fsai_vcu.interface.enums import Ami


def acceleration_track() -> Track:
    """75 m straight from the start line at x = 0, and 100 m of exit lane to stop in."""
    half = LANE_M / 2.0
    finish = ACCELERATION_RUN_M
    rows = [5.0 * i for i in range(1, 15)]
    exits = [finish + 5.0 * i for i in range(1, int(ACCELERATION_STOP_M / 5.0) + 2)]
    gate = [(x, y) for line in (0.0, finish) for x in (line - 0.3, line + 0.3) for y in (half, -half)]
    xy, colors = cones_of(
        (
            (ConeColor.BLUE, [(x, half) for x in rows]),
            (ConeColor.YELLOW, [(x, -half) for x in rows]),
            (ConeColor.BIG_ORANGE, gate),
            (ConeColor.ORANGE, [(x, y) for x in exits for y in (half, -half)]),
            (ConeColor.ORANGE, [(exits[-1], y) for y in (0.5, -0.5)]),
        )
    )
    track = Track("acceleration", TrackKind.ACCELERATION, xy, colors, source="acceleration")
    return with_straight(track, (0.0, 0.0), (finish, 0.0), half)


def skidpad_track() -> Track:
    """Two circles side by side; cars come along x, cross the timing line at x = 0, and turn right first."""
    inner = SKIDPAD_INNER_DIAMETER_M / 2.0
    outer = inner + LANE_M
    middle = SKIDPAD_CENTRES_APART_M / 2.0  # also the radius of the driven circle
    half = LANE_M / 2.0
    steps = 16  # inner cones of a circle; of the outer ones the three at the crossing are left out
    blue: list[Point] = []
    yellow: list[Point] = []
    for side, inner_cones, outer_cones in ((1.0, blue, yellow), (-1.0, yellow, blue)):
        for i in range(steps):
            angle = 2.0 * math.pi * i / steps  # from the side of the crossing
            dx, dy = math.sin(angle), -side * math.cos(angle)
            inner_cones.append((inner * dx, side * middle + inner * dy))
            if min(i, steps - i) > 1:
                outer_cones.append((outer * dx, side * middle + outer * dy))
    gate_x = 1.75
    gate_y = middle - math.sqrt(inner**2 - gate_x**2)
    entry = [-9.0 - 2.0 * i for i in range(6)]
    leave = [9.0 + 2.0 * i for i in range(10)]
    end = leave[-1] + 1.0
    xy, colors = cones_of(
        (
            (ConeColor.BLUE, blue),
            (ConeColor.YELLOW, yellow),
            (ConeColor.BIG_ORANGE, [(x, y) for x in (-gate_x, gate_x) for y in (gate_y, -gate_y)]),
            (ConeColor.ORANGE, [(x, y) for x in entry + leave for y in (half + 0.14, -half - 0.14)]),
            (ConeColor.ORANGE, [(end, y) for y in (0.5, -0.5)]),
        )
    )
    begin = -22.0

    def circle(centre_y: float, radius: float) -> tuple[Point, ...]:
        angles = (2.0 * math.pi * i / 180 for i in range(180))
        return tuple((radius * math.cos(a), centre_y + radius * math.sin(a)) for a in angles)

    route: list[Point] = [(begin + 0.25 * i, 0.0) for i in range(int(-begin * 4))]
    per_lap = int(2.0 * math.pi * middle * 4)
    for side in (-1.0, -1.0, 1.0, 1.0):
        for i in range(per_lap):
            angle = 2.0 * math.pi * i / per_lap
            route.append((middle * math.sin(angle), side * middle * (1.0 - math.cos(angle))))
    route += [(0.25 * i, 0.0) for i in range(int(end * 4) + 1)]
    straight = ((begin, -half), (end, -half), (end, half), (begin, half))
    lane = (
        (circle(middle, inner), circle(middle, outer)),
        (circle(-middle, inner), circle(-middle, outer)),
        (straight,),
    )
    track = Track("skidpad", TrackKind.SKIDPAD, xy, colors, centreline_m=as_array(route), lane=lane, source="skidpad")
    return with_line(track, Pose(), BETWEEN_RINGS)


BEND_APART_M: Final = 2.0


def _stretched(ring: Floats, straight_m: float) -> Floats:
    """The ring with a straight put in at its first point, and its twin where the tangent is opposite."""
    tangent = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    angle = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    far = int(np.argmin(np.abs(angle - angle[0] - math.pi)))
    along = tangent[0] / np.hypot(*tangent[0])
    steps = np.arange(0.25, straight_m, 0.25)[:, None]
    first_straight = ring[0] + steps * along
    outward = ring[1 : far + 1] + straight_m * along
    back_straight = ring[far] + straight_m * along - steps * along
    return np.vstack([ring[:1], first_straight, ring[:1] + straight_m * along, outward, back_straight, ring[far:]])


def circuit_from(
    name: str,
    centreline: Floats,
    line_at_m: float,
    lane_m: float,
    apart_m: float = 4.5,
    bend_apart_m: float = BEND_APART_M,
) -> Track:
    """A closed circuit round a centreline that begins at the start of its straight.

    Its cones stand `apart_m` from each other on straights, and nearer in bends, or `bend_apart_m` at least.
    """
    step = 0.25
    middle = resampled_ring(centreline, step)
    middle = np.roll(middle, -round(line_at_m / step), axis=0)
    toward = middle[1] - middle[-1]
    heading = math.atan2(toward[1], toward[0])
    # the start line becomes the origin, crossed along x
    c, s = math.cos(-heading), math.sin(-heading)
    middle = (middle - middle[0]) @ np.array([[c, s], [-s, c]])
    left, right = offset_line(middle, lane_m / 2.0), offset_line(middle, -lane_m / 2.0)
    curvature = np.abs(ring_curvature(middle))
    smooth = np.convolve(np.concatenate([curvature[-12:], curvature, curvature[:12]]), np.ones(25) / 25.0, "valid")
    rows: list[list[Point]] = []
    for border, phase in ((left, 0.0), (right, 0.4)):
        steps = np.hypot(*(np.roll(border, -1, axis=0) - border).T)
        row: list[Point] = []
        due = phase * 3.0
        for i, point in enumerate(border):
            if due <= 0.0:
                row.append((float(point[0]), float(point[1])))
                # Cones stand closer in tight corners; 5 m is the rules' most.
                wanted_m = 0.35 / max(float(smooth[i]), 1e-3)
                due += apart_m if wanted_m >= apart_m else max(bend_apart_m, wanted_m)
            due -= float(steps[i])
        if math.dist(row[0], row[-1]) < 1.2:
            row.pop()
        rows.append([p for p in row if not (abs(p[0]) < 1.2 and abs(p[1]) < lane_m)])
    gate = [(x, y) for x in (-0.4, 0.4) for y in (lane_m / 2.0, -lane_m / 2.0)]
    xy, colors = cones_of(((ConeColor.BLUE, rows[0]), (ConeColor.YELLOW, rows[1]), (ConeColor.BIG_ORANGE, gate)))
    return with_circuit(Track(name, TrackKind.CIRCUIT, xy, colors, source=name), Pose(), middle, left, right)


def small_oval() -> Track:
    """Two half circles of 10 m and two straights of 20 m: 103 m."""
    angles = np.linspace(-math.pi / 2.0, 1.5 * math.pi, 252, endpoint=False)
    circle = 10.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    return circuit_from("small_oval", _stretched(circle, 20.0), 12.0, CIRCUIT_LANE_M)


def random_circuit(seed: int, name: str = "", length_m: float = 250.0, straight_m: float = 24.0) -> Track:
    """A closed circuit of about `length_m`, always the same for a seed, no centreline tighter than 6 m + half a lane.

    A circle bent by a few harmonics, then stretched by a starting straight and its twin on the far side.
    """
    draw = random.Random(seed)
    angles = np.linspace(-math.pi / 2.0, 1.5 * math.pi, 720, endpoint=False)
    while True:
        radius = np.ones_like(angles)
        for harmonic, size in ((2, 0.25), (3, 0.22), (4, 0.13), (5, 0.08)):
            amplitude, phase = draw.uniform(0.3, 1.0) * size, draw.uniform(0.0, 2.0 * math.pi)
            radius += amplitude * np.cos(harmonic * angles + phase)
        shape = radius[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        perimeter = float(np.hypot(*np.diff(np.vstack([shape, shape[:1]]), axis=0).T).sum())
        shape = resampled_ring(shape * (length_m - 2.0 * straight_m) / perimeter, 0.25)
        # the straight goes where the circle bends least to the left, so that no kink is left behind
        bend = ring_curvature(shape)
        flattest = int(np.argmin(np.abs(bend - 0.01)))
        whole = resampled_ring(_stretched(np.roll(shape, -flattest, axis=0), straight_m), 0.25)
        if draw.random() < 0.5:
            whole[:, 1] *= -1.0  # the other way round
        if _drivable(whole):
            return circuit_from(name or f"random-{seed}", whole, straight_m * 0.55, CIRCUIT_LANE_M)


def _drivable(middle: Floats) -> bool:
    """No corner too tight, and no two parts of the lane so close that their cones mix."""
    tightest = CIRCUIT_MIN_RADIUS_M + CIRCUIT_LANE_M / 2.0
    if float(np.abs(ring_curvature(middle)).max()) > 1.0 / tightest:
        return False
    return closest_m(middle, 20.0) > CIRCUIT_LANE_M + 4.5


AUTOCROSS_SEED: Final = 4
TRACKDRIVE_SEED: Final = 11

BUILT_IN: Final[Mapping[str, Callable[[], Track]]] = {
    "static": lambda: Track("static", TrackKind.STATIC, *cones_of(()), source="static"),  # open ground
    "acceleration": acceleration_track,
    "skidpad": skidpad_track,
    "autocross": lambda: random_circuit(AUTOCROSS_SEED, "autocross", 230.0),
    "trackdrive": lambda: random_circuit(TRACKDRIVE_SEED, "trackdrive", 290.0),
    "small_oval": small_oval,
}

MISSION_TRACK: Final[Mapping[Ami, str]] = {
    Ami.ACCELERATION: "acceleration",
    Ami.SKIDPAD: "skidpad",
    Ami.AUTOCROSS: "autocross",
    Ami.TRACKDRIVE: "trackdrive",
}  # the others need no track: "static"
