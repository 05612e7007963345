"""The race line through a closed lane, between cones whose places are known.

Round by round: along a closed line, how far the car may be to its left and right; the sideways displacements within
that which make the weighted sum of squared curvatures, and of their changes, least (a quadratic problem, solved by an
interior-point method); the line moved by them. It is worked out in shares of some milliseconds.

The first rounds weigh all places the same. Each of the others weighs a place by the square of the curvature there, so
that the sum of fourth powers becomes least: the line bends less where a corner is tightest, for how fast the car comes
in and goes out depends on the speed there. It bends evenly, too, for the steering takes time. By the controller's speed
profile a lap of ten layouts takes 0.2 to 3 % less along it than along the line of the least sum of squares.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solveh_banded  # type: ignore[import-untyped]

from fsai_vcu.core.arrays import Bools, Floats, Ints
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.planning.pose import headings_along, lengths_along, resampled_ring, ring_curvature, to_vehicle
from fsai_vcu.core.vehicle.parameters import SLIP_RADPMPS2, VehicleParameters
from fsai_vcu.interface.values import Value

MARGIN_M = 0.25  # between body and cones
RACED_MPS2, RACED_MPS = 9.0, 13.0  # at most, in corners: the tyres' slip turns the nose inward …
TURNED_MORE = 1.4  # … and by so much more in one corner of ten, into which the car brakes or turns late
CONE_RADIUS_M = 0.14
NEWS_M = 0.35  # a cone seen so far from all known ones is not one of them; less is the doubt of two places compared
REACH_M = 5.0  # a cone further from the line is none of this lane's border
BESIDE_M, BEYOND_M = 4.0, 1.0  # among cones so near to each other, a cone so much further out is no border
NARROW_M = 0.02  # left to the line where a lane is too narrow for the margin
ROUNDS, EVEN_ROUNDS, STEPS = 6, 2, 15
BEND_1PM, BEND_LEAST_1PM = 0.12, 0.03  # a place so bent weighs 1; bent so little or less, it weighs a sixteenth
BEND_OVER_M = 2.0  # to either side, over which a place's bend is averaged
NEWER = 0.25  # share of a round in its weights; the rest is that of the rounds before, or they would go to and fro
CHANGE_WEIGHT = 20.0  # of a change of curvature from point to point
SHARE = 4000  # points of the line times steps at once: about a millisecond
STRETCH = 8  # points of the line
SMOOTHING_M = 1.5  # of the driven path
BODY_BEHIND_M = 0.65  # of the rear axle


class RaceLine(Value, frozen=True, eq=False):
    """A closed line for the rear axle. xy_m: (N, 2) map frame; cos, sin: (N,) of its direction; left_m, right_m: (N,)
    how far the car may be beside it with its margin kept."""

    xy_m: Floats
    cos: Floats
    sin: Floats
    left_m: Floats
    right_m: Floats
    step_m: float
    cones_xy_m: Floats  # between which it was laid

    def news(self, xy_m: Floats) -> Bools:
        """Select those of these cones (map frame) that stand where the line was laid without them."""
        dx, dy = xy_m[:, None, 0] - self.cones_xy_m[:, 0], xy_m[:, None, 1] - self.cones_xy_m[:, 1]
        return np.asarray((dx * dx + dy * dy).min(axis=1) > NEWS_M**2)

    def beside(self, here: Motion) -> tuple[int, float, float]:
        """The point that the car is beside, how far to its left the car is (m), and how far turned to the left."""
        dx, dy = here.x_m - self.xy_m[:, 0], here.y_m - self.xy_m[:, 1]
        along = self.cos * math.cos(here.yaw_rad) + self.sin * math.sin(here.yaw_rad)
        index = int((np.hypot(dx, dy) + 3.0 * (1.0 - along)).argmin())
        cos, sin = float(self.cos[index]), float(self.sin[index])
        left = float(dy[index]) * cos - float(dx[index]) * sin
        return index, left, math.remainder(here.yaw_rad - math.atan2(sin, cos), 2.0 * math.pi)

    def curvature_1pm(self, index: int) -> float:
        """Curvature at a point, left positive, by the turn from 1 m before it to 1 m behind it."""
        points, reach = len(self.xy_m), max(1, round(1.0 / self.step_m))
        there = [(index - reach) % points, (index + reach) % points]
        (cos, cos_on), (sin, sin_on) = self.cos[there].tolist(), self.sin[there].tolist()
        return math.atan2(cos * sin_on - sin * cos_on, cos * cos_on + sin * sin_on) / (2.0 * reach * self.step_m)

    def beyond_m(self, first: int, offsets_m: Floats) -> float:
        """Return by how much a way so far left of the line from point `first` on leaves the room beside it, at most."""
        at = np.arange(first, first + len(offsets_m)) % len(self.xy_m)
        return float(np.maximum(offsets_m - self.left_m[at], -offsets_m - self.right_m[at]).max(initial=0.0))

    def path(self, first: int, length_m: float, offsets_m: Floats, here: Motion) -> Floats:
        """(M, 2) the line from point `first` on, in the frame of the car at `here`, its first points so far left."""
        count = min(round(length_m / self.step_m), round(0.7 * len(self.xy_m)))
        at = np.arange(first, first + count) % len(self.xy_m)
        xy = self.xy_m.take(at, axis=0)
        head = at[: len(offsets_m)]
        offsets_m = offsets_m[:count].clip(-self.right_m[head], self.left_m[head])
        xy[: len(head), 0] -= offsets_m * self.sin[head]
        xy[: len(head), 1] += offsets_m * self.cos[head]
        return to_vehicle(here, xy)


class LineSearch:
    """Works out the line through the lane that was driven along `lap_xy_m` (closed), between these cones."""

    def __init__(self, lap_xy_m: Floats, cones_xy_m: Floats, car: VehicleParameters, step_m: float) -> None:
        self._line = _smoothed(resampled_ring(lap_xy_m, step_m), step_m)
        self._cones, self._car, self._step_m = cones_xy_m, car, step_m
        self._rounds = self._steps = 0
        self._problem: _Problem | None = None
        self._log_weights: Floats | None = None

    def advance(self) -> RaceLine | None:
        """Do a share of the work; the line once it is done."""
        problem = self._problem
        if problem is None:
            cos, sin = _directions(self._line)
            left, right = _bounds(self._line, cos, sin, self._cones, self._car)
            self._problem = _Problem(self._line, cos, sin, right, left, self._weights())
            return None
        steps = min(max(1, SHARE // len(self._line)), STEPS - self._steps)
        for _ in range(steps):
            problem.improve()
        self._steps += steps
        if self._steps < STEPS:
            return None
        line, left, right = problem.moved()
        self._rounds, self._steps, self._problem = self._rounds + 1, 0, None
        if self._rounds < ROUNDS:
            self._line = resampled_ring(line, self._step_m)
            return None
        return RaceLine(line, *_directions(line), left, right, self._step_m, self._cones)

    def _weights(self) -> Floats:
        """(N,) weights of this round at the line's points: by its bends, and by the weights of the rounds before."""
        count = len(self._line)
        if self._rounds < EVEN_ROUNDS:
            return np.ones(count)
        over = round(BEND_OVER_M / self._step_m)
        bends = ring_curvature(self._line, over=2).take(np.arange(-over, count + over), mode="wrap")
        mean = np.convolve(np.abs(bends), np.full(2 * over + 1, 1.0 / (2 * over + 1)), mode="valid")
        log: Floats = 2.0 * np.log(np.hypot(mean, BEND_LEAST_1PM) / BEND_1PM)
        before = self._log_weights
        if before is not None:
            place, places = np.arange(count) / count, np.arange(len(before)) / len(before)
            log = NEWER * log + (1.0 - NEWER) * np.interp(place, places, before, period=1.0)
        self._log_weights = log
        return np.exp(log)


def clear(path_m: Floats, cones_xy_m: Floats, beside_m: Floats, car: VehicleParameters) -> bool:
    """Return true where the car's body passes each cone (frame of the path) by that cone's `beside_m` at least."""
    cos, sin = headings_along(path_m)
    dx = cones_xy_m[:, None, 0] - path_m[:, 0]
    dy = cones_xy_m[:, None, 1] - path_m[:, 1]
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
    inside = (ahead > -BODY_BEHIND_M) & (ahead < car.nose_ahead_of_rear_axle_m)
    return not (inside & (np.abs(left) < 0.5 * car.width_m + CONE_RADIUS_M + beside_m[:, None])).any()


class _Problem:
    """Displacements to the left, within `low` and `high`, of least weighted sum of squares of the moved line's bends.

    A bend is the curvature times the step squared; the squares of its changes from point to point count as well.
    """

    def __init__(self, line: Floats, cos: Floats, sin: Floats, low: Floats, high: Floats, weights: Floats) -> None:
        """Set up the problem for the closed `line` (N, 2) with its direction, bounds (N,) and weights (N,) of bends."""
        normal = np.column_stack((-sin, cos))
        self._line, self._normal = line, normal
        # Both by the displacements of points so many places on, and by what they are without any.
        before = (normal * np.roll(normal, 1, axis=0)).sum(axis=1)
        after = (normal * np.roll(normal, -1, axis=0)).sum(axis=1)
        bend = {-1: before, 0: np.full(len(line), -2.0), 1: after}
        own = (normal * (np.roll(line, 1, axis=0) - 2.0 * line + np.roll(line, -1, axis=0))).sum(axis=1)
        change = {-1: -before, 0: np.roll(before, -1) + 2.0, 1: -2.0 - after, 2: np.roll(after, -1)}
        even = np.full(len(line), CHANGE_WEIGHT)
        self._diagonals, self._gradient = np.zeros((4, len(line))), np.zeros(len(line))
        for weight, by_place, alone in ((weights, bend, own), (even, change, np.roll(own, -1) - own)):
            for one, values in by_place.items():
                self._gradient += np.roll(weight * values * alone, one)
                for other in range(one, max(by_place) + 1):
                    self._diagonals[other - one] += np.roll(weight * values * by_place[other], one)
        # A ring folded flat, its two sides interleaved: points three apart are six places away from each other at most.
        count = len(line)
        index = np.arange(count)
        self._place: Ints = np.where(index < (count + 1) // 2, 2 * index, 2 * (count - index) - 1)
        self._banded = np.zeros((7, count))
        for apart, values in enumerate(self._diagonals):
            other_place = self._place[(index + apart) % count]
            self._banded[np.abs(self._place - other_place), np.minimum(self._place, other_place)] = values
        self._low, self._high = low, high
        self.at = 0.5 * (low + high)
        self._push = np.full((2, count), 0.1 * float(np.abs(self._gradient).mean()) + 1e-6)  # multipliers of the bounds

    def moved(self) -> tuple[Floats, Floats, Floats]:
        """The line moved, and the room left to its left and right."""
        return self._line + self.at[:, None] * self._normal, self._high - self.at, self.at - self._low

    def improve(self) -> None:
        """One step of Newton's of the primal-dual interior-point method."""
        at = self.at
        slope = self._diagonals[0] * at + self._gradient
        for apart, values in enumerate(self._diagonals[1:], 1):
            slope += values * np.roll(at, -apart) + np.roll(values * at, apart)
        room = np.stack((at - self._low, self._high - at))
        aim = 0.1 * float((room * self._push).mean())
        banded = self._banded.copy()
        banded[0, self._place] += (self._push / room).sum(axis=0)
        right_side = np.empty(len(at))
        right_side[self._place] = -slope + aim / room[0] - aim / room[1]
        step = solveh_banded(banded, right_side, lower=True, check_finite=False)[self._place]
        closing = np.stack((step, -step))
        push = aim / room - self._push - self._push / room * closing
        self.at = at + _longest(room, closing) * step
        self._push += _longest(self._push, push) * push


def _longest(value: Floats, step: Floats) -> float:
    """The share of a step, up to the whole, with which all values stay positive."""
    return min(1.0, 0.95 / max(float((-step / value).max()), 1e-9))


def _bounds(
    line: Floats, cos: Floats, sin: Floats, cones_xy_m: Floats, car: VehicleParameters
) -> tuple[Floats, Floats]:
    """(N,) how far to the left (positive) and to the right (negative) of each point the rear axle may be."""
    stations = np.arange(len(line), dtype=np.float64) * (_length(line) / len(line))
    cone, at = _beside(line, float(stations[1]), cones_xy_m)
    dx, dy = (cones_xy_m[cone] - line[at]).T
    lateral = dy * cos[at] - dx * sin[at]
    half = 0.5 * car.width_m + CONE_RADIUS_M + MARGIN_M
    curvature = ring_curvature(line, over=2)  # over one its noise would narrow the lane in a hairpin
    bounds = []
    for side in (1.0, -1.0):
        mine = side * lateral > 0.0
        border = _border(stations, stations.take(at[mine]), side * lateral.compress(mine), _length(line))
        # The nose swings out: what turned the car in its last metres counts.
        outward = np.maximum(-side * curvature, 0.0)
        back = max(1, round(car.nose_ahead_of_rear_axle_m / (stations[1] - stations[0])))
        swing = np.max([np.roll(outward, shift) for shift in range(back + 1)], axis=0)
        inner_m = _turned_in_m(np.maximum(side * curvature, 1e-6), car)
        bounds.append(side * (border - half - 0.5 * car.nose_ahead_of_rear_axle_m**2 * swing - inner_m))
    left, right = bounds
    middle = 0.5 * (left + right)
    narrow = left - right < 2.0 * NARROW_M
    return np.where(narrow, middle + NARROW_M, left), np.where(narrow, middle - NARROW_M, right)


def _turned_in_m(curvature_1pm: Floats, car: VehicleParameters) -> Floats:
    """(N,) how far the body stands to the inner side of the rear axle's path, turned by the slip at racing speed."""
    slip_rad = TURNED_MORE * SLIP_RADPMPS2 * np.minimum(RACED_MPS2, RACED_MPS**2 * curvature_1pm)
    ahead_m = np.minimum(slip_rad / curvature_1pm, car.nose_ahead_of_rear_axle_m)
    return np.asarray(ahead_m * slip_rad - 0.5 * ahead_m**2 * curvature_1pm)


def _beside(line: Floats, step_m: float, cones_xy_m: Floats) -> tuple[Ints, Ints]:
    """Pairs of a cone within reach and a point of the line that it is beside: one nearer than its neighbours.

    A cone may stand beside several stretches. Only stretches in whose middle it is near are looked at point by point.
    """
    middles = line.take(np.arange(STRETCH // 2, len(line) + STRETCH // 2, STRETCH), axis=0, mode="wrap")
    near_m = REACH_M + step_m * STRETCH
    cone, stretch = np.nonzero(np.hypot(*(cones_xy_m[:, None] - middles).transpose(2, 0, 1)) < near_m)
    at = STRETCH * stretch[:, None] + np.arange(-1, STRETCH + 1)
    away = cones_xy_m[cone, None] - line.take(at, axis=0, mode="wrap")
    gap = away[..., 0] ** 2 + away[..., 1] ** 2
    here = gap[:, 1:-1]
    pair, place = np.nonzero((here < REACH_M**2) & (here <= gap[:, :-2]) & (here < gap[:, 2:]))
    at = at[pair, place + 1]
    whole = at < len(line)  # the last stretch may go on into the first
    return cone[pair[whole]], at[whole]


def _border(stations: Floats, at_m: Floats, lateral_m: Floats, length_m: float) -> Floats:
    """(N,) how far off a border is at each station of the ring, between its cones (at these stations, so far off)."""
    if not len(at_m):
        return np.full(len(stations), REACH_M)
    apart = np.abs(at_m[:, None] - at_m)
    beside = np.minimum(apart, length_m - apart) < BESIDE_M
    own = lateral_m <= np.where(beside, lateral_m, np.inf).min(axis=1) + BEYOND_M
    return np.asarray(np.interp(stations, at_m[own], lateral_m[own], period=length_m))


def _directions(ring: Floats) -> tuple[Floats, Floats]:
    """(N,) cosine and sine of a closed line's direction at each of its points."""
    along = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    along /= np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
    return along[:, 0], along[:, 1]


def _length(line: Floats) -> float:
    return float(lengths_along(np.concatenate((line, line[:1])))[-1])


def _smoothed(line: Floats, step_m: float) -> Floats:
    """The closed line averaged with a bell of `SMOOTHING_M`."""
    reach = round(2.0 * SMOOTHING_M / step_m)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_m / SMOOTHING_M) ** 2)
    moved = [np.roll(line, shift, axis=0) for shift in range(-reach, reach + 1)]
    return np.asarray(np.tensordot(weights / weights.sum(), np.array(moved), axes=1))
