"""Driving by sight: where looks bear out the path well for a while, the car is as fast as it can stop within sight.

Sight is the way from the front wheels on that cones bear out, and a little more. Until then, and soon after looks no
longer bear it out so well, the car is careful.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.control.speed_profile import braking_share

# A look bears out the path well with such a confidence (displaced cones leave 0.8 at worst: `DOUBT_BY_CONES`), so long
# a supported path, and so little way since the last one.
CLEAR, CLEAR_M, CLEAR_APART_M = 0.81, 8.0, 1.5
CLEAR_OVER_M = 15.0  # of way, on which the looks must have done so …
CLEAR_AGAIN_M = 8.0  # … or of less, after a doubt on a path that was driven by sight, …
# … but for such a share of the looks within STEADY_M, with at least so much confidence: the others outvote them.
UNSURE_MOST, DOUBTFUL = 0.25, 0.5
STEADY_M = 4.0  # of way: cones come into sight one by one, and the speed follows the shortest sight among them
UNCLEAR_MPS2 = 2.0  # with which the speed falls from then on: one doubtful look must not brake hard
# So far beyond the last cones seen the front wheels may stop, and the rear axle before them. On that way the sharpest
# lane, 3 m wide with a middle of 2.9 m of radius, leads 0.4 m aside, and the wheels have 0.8 m; to the nose it leads
# 0.8 m, as much as there is.
BEYOND_CONES_M = 1.5
STRAIGHT_1PM = 1e-6
# What a bend takes of the grip, from none to all; and the way to a stop from there, times twice the bend.
_USED = np.linspace(0.0, 1.0, 401)  # by 0.0025
_WAYS = np.append(0.0, np.cumsum([0.0025 / braking_share(float(used)) for used in _USED[1:] - 0.00125]))


def stopping_m(square_m2ps2: float, bend_1pm: float, grip_mps2: float) -> float:
    """Return the way on which tyres of such a grip stop a car in such a bend, from the square of its speed.

    What the bend takes of the grip, the brakes do not have: along the way d(v2)/ds is -2 grip braking_share(v2 bend /
    grip). A car too fast for the bend sheds what is too much with all of the grip.
    """
    bend_1pm = max(bend_1pm, STRAIGHT_1PM)
    used = square_m2ps2 * bend_1pm / grip_mps2
    return (float(np.interp(used, _USED, _WAYS)) + max(used - 1.0, 0.0)) / (2.0 * bend_1pm)


def stops_from_m2ps2(way_m: float, bend_1pm: float, grip_mps2: float) -> float:
    """Return the square of the speed from which `stopping_m` is so much way, or of the most that the bend allows."""
    bend_1pm = max(bend_1pm, STRAIGHT_1PM)
    return grip_mps2 / bend_1pm * float(np.interp(2.0 * bend_1pm * way_m, _WAYS, _USED))


class Sight:
    """The looks of a run, and whether the car drives by sight."""

    def __init__(self) -> None:
        # How far driven (m), the sight from there (m), whether the look was sure, and how old (s) the look before it
        # was when it came.
        self._lately: deque[tuple[float, float, bool, float]] = deque()
        self._unclear_m = 0.0  # how far driven when a look last did not bear out the path well
        self._driven: tuple[float, float] | None = None  # how far, and how fast, when the car last drove by sight

    def look(self, confidence: float, supported_m: float, sight_m: float, seen_from_m: float, age_s: float) -> None:
        """Take in the next look, from a place so far driven; `age_s`: how old the last one was when it came."""
        lately = self._lately
        doubtful = confidence < DOUBTFUL or supported_m < CLEAR_M
        followed = bool(lately) and seen_from_m - lately[-1][0] <= CLEAR_APART_M
        lately.append((seen_from_m, sight_m, confidence >= CLEAR, age_s))
        while lately[0][0] < seen_from_m - STEADY_M:
            lately.popleft()
        if doubtful or not followed or sum(not sure for _, _, sure, _ in lately) > UNSURE_MOST * len(lately):
            self._unclear_m = seen_from_m

    def look_without_path(self, seen_from_m: float, age_s: float) -> None:
        """Take in a look that found no path: doubtful, and its sight is what is left of the last one's."""
        last_m, sight_m, _, _ = self._lately[-1] if self._lately else (seen_from_m, 0.0, False, 0.0)
        self.look(0.0, 0.0, max(0.0, last_m + sight_m - seen_from_m), seen_from_m, age_s)

    def ceiling(
        self, grip_mps2: float, reaction_s: float, bend_1pm: float, now_m: float, speed: float, at_m: Floats
    ) -> Floats:
        """(N,) square of the speed that sight allows at places along the driven path; 0 where the car must be careful.

        With tyres of such a grip on a path so bent, and such a time after the next look has come, the car stops within
        the shortest sight lately. The next look comes as late as the latest one lately.
        """
        falling: Floats = np.full(len(at_m), math.inf)
        clear_m = CLEAR_OVER_M if self._driven is None else CLEAR_AGAIN_M
        if self._lately[-1][0] - self._unclear_m >= clear_m:
            self._driven = now_m, speed
        elif self._driven is None:
            return np.zeros(len(at_m))
        else:
            last_m, last_mps = self._driven
            falling = np.maximum(last_mps**2 - 2.0 * UNCLEAR_MPS2 * (at_m - last_m), 0.0)
        sight_m = max(0.0, min(sight_m for _, sight_m, _, _ in self._lately))
        late_s = reaction_s + max(age_s for *_, age_s in self._lately)
        late_mps = grip_mps2 * late_s
        straight_mps = math.sqrt(late_mps**2 + 2.0 * grip_mps2 * sight_m) - late_mps
        way_m = sight_m - straight_mps * late_s
        allowed: Floats = np.minimum(falling, stops_from_m2ps2(way_m, bend_1pm, grip_mps2))
        return allowed
