"""Counting laps: the line of the start gate passed, as often as it is passed, and no oftener.

The line is where the big orange cones were last seen. Where none was ever seen it is where the staged car had it ahead,
or, if the lane bends away from there, where the car is a little later.
Both lines are defined here, for the judge of the simulation too.
Seeing the gate again corrects the line, so that odometry may drift by metres in a lap; without a gate the
line is laid again where the car passes it, so that only one lap's drift matters. A passage that only odometry has told
is taken back where the gate then comes into sight ahead of the car.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.values import Value

GATE_DEPTH_M = 5.0  # along the lane, between cones of one gate
ARMING_M = 15.0  # the line must have been ahead, within this distance, before it can be passed
PASSED_M = 6.0  # further behind it than this the car has not just passed it
BEFORE_M = 0.3
OVERDUE_M = 2.0  # so much further on than it was ahead, an assumed line has been missed
GATE_SHIFT_M = 3.0  # how far the middle of a gate may move from one sighting to the next …
DRIFT_MAX = 0.08  # … and by how much more of the driven path meanwhile
AGAIN_STEP_M, AGAIN_M, AGAIN_COS = 1.0, 1.2, 0.9  # so near its earlier way, the car drives it again …
CIRCLE_MIN_M = 10.0  # … if that was longer ago than this
DRIVEN_EVERY = 2  # of the places kept of the driven path
LAP_END_M = 30.0  # beyond the line, which may be in sight from before it
SIGHTED_M = 10.0  # of way in which a gate passed was seen right before


class GateLine(Value, frozen=True):
    """A line across the lane in the odometry frame: its middle and the direction in which it is passed."""

    x_m: float
    y_m: float
    yaw_rad: float
    seen: bool  # by its cones; else assumed
    at_distance_m: float  # distance driven when it was last seen or laid
    blind_m: float = 0.0  # way driven without seeing it, until it was laid there by odometry

    def shifted_m(self, motion: Motion) -> float:
        """The distance from its place at which it may come into sight, m: odometry drifts."""
        return GATE_SHIFT_M + DRIFT_MAX * (self.blind_m + max(0.0, motion.distance_m - self.at_distance_m))

    def position_of(self, motion: Motion) -> tuple[float, float]:
        """(ahead, left) of the line at which the car is, m."""
        dx, dy = motion.x_m - self.x_m, motion.y_m - self.y_m
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return dx * cos + dy * sin, dy * cos - dx * sin


class LapState(Value, frozen=True):
    """`passages` of the line: the first begins lap 1."""

    line: GateLine
    passages: int = 0
    armed: bool = False
    passed_at_m: float | None = None  # distance driven at the last passage …
    before_m: float | None = None  # … and at the one before it
    sighted: bool = False  # at the last one the line was where its gate had been seen right before
    due_m: float = math.inf  # distance driven at which a line that is only assumed would be passed first

    @property
    def laps(self) -> int:
        """Laps completed."""
        return max(0, self.passages - 1)


def staged(motion: Motion, line_ahead_m: float) -> LapState:
    """The state of a car that stands before the line."""
    return LapState(
        GateLine(
            motion.x_m + line_ahead_m * math.cos(motion.yaw_rad),
            motion.y_m + line_ahead_m * math.sin(motion.yaw_rad),
            motion.yaw_rad,
            seen=False,
            at_distance_m=motion.distance_m,
        ),
        due_m=motion.distance_m + line_ahead_m,
    )


def gate_middle(gate_xy_m: Floats, left: NDArray[np.bool_]) -> Floats:
    """(2,) the middle of the line at a gate of cones (N, 2): between the `left` ones (N, bool) and the others.

    Where all stand on one side it is beside the lane, where the line would be.
    """
    sides = (gate_xy_m[left], gate_xy_m[~left])
    return np.asarray(np.mean([side.mean(axis=0) for side in sides if len(side)], axis=0))


def gate_seen(state: LapState, x_m: float, y_m: float, yaw_rad: float, motion: Motion, lap_min_m: float) -> LapState:
    """The gate's cones are in sight, the middle between them at (x, y) of the odometry frame."""
    line = state.line
    since_m = math.inf if state.passed_at_m is None else motion.distance_m - state.passed_at_m
    if line.seen:
        # The line stays where it is; only odometry drifts. A gate elsewhere is none, nor one passed the other way: the
        # lane may come back beside it.
        if abs(math.remainder(yaw_rad - line.yaw_rad, 2.0 * math.pi)) > math.pi / 2.0:
            return state
        if math.hypot(x_m - line.x_m, y_m - line.y_m) > line.shifted_m(motion):
            return state
    gate = GateLine(x_m, y_m, yaw_rad, seen=True, at_distance_m=motion.distance_m)
    # The first line of all was a guess where no gate was in sight; another one may have been off by odometry's drift.
    wrong = since_m < line.shifted_m(motion) if line.seen else state.passages == 1
    if wrong and not state.sighted and gate.position_of(motion)[0] < -BEFORE_M:
        return LapState(gate, state.passages - 1, passed_at_m=state.before_m)
    if since_m < 0.5 * lap_min_m:
        return state  # just passed: what is in sight now may be the rest of the same gate
    return replace(state, line=gate)


def advance_laps(state: LapState, motion: Motion, lap_min_m: float) -> LapState:
    """The state with the car at `motion`."""
    ahead, left = state.line.position_of(motion)
    blind_m = max(0.0, motion.distance_m - state.line.at_distance_m)
    within = 3.0 + 0.02 * blind_m
    turned = abs(math.remainder(motion.yaw_rad - state.line.yaw_rad, 2.0 * math.pi))
    if state.passages == 0 and not state.line.seen and motion.distance_m > state.due_m + OVERDUE_M:
        # The car was staged in a bend: the line that it assumed is beside its lane.
        missed = GateLine(motion.x_m, motion.y_m, motion.yaw_rad, seen=False, at_distance_m=motion.distance_m)
        return LapState(missed, 1, passed_at_m=motion.distance_m)
    if abs(left) > within or turned > math.radians(60.0):
        return replace(state, armed=False) if state.armed and abs(left) > within + 3.0 else state
    if -ARMING_M < ahead < -BEFORE_M:
        far_enough = state.passed_at_m is None or motion.distance_m - state.passed_at_m >= lap_min_m - ARMING_M
        return replace(state, armed=True) if far_enough and not state.armed else state
    if not state.armed or not 0.0 <= ahead < PASSED_M:
        return state
    if state.passed_at_m is not None and motion.distance_m - state.passed_at_m < lap_min_m:
        return state
    line = state.line
    sighted = line.seen and blind_m < SIGHTED_M
    if blind_m > 0.5 * lap_min_m:
        here = motion.x_m, motion.y_m, motion.yaw_rad
        line = GateLine(*here, seen=line.seen, at_distance_m=motion.distance_m, blind_m=line.blind_m + blind_m)
    return LapState(line, state.passages + 1, False, motion.distance_m, state.passed_at_m, sighted)


class Circling:
    """Detector of a car that repeats a way driven since it last passed the line: no course has such a way.

    Where the lane was lost, a way round a hairpin's inside or round an island of cones may look like a lane for ever.
    """

    def __init__(self) -> None:
        self._passages = -1
        self._way: list[tuple[float, float, float, float]] = []  # distance driven, x, y and yaw, at every AGAIN_STEP_M
        self._again_m = 0.0

    def length_m(self, state: LapState, motion: Motion) -> float | None:
        """The length of the circle in which the car is; None where it is in none. To be asked with every motion."""
        if state.passages != self._passages:
            self._passages, self._way, self._again_m = state.passages, [], 0.0
        if self._way and motion.distance_m < self._way[-1][0] + AGAIN_STEP_M:
            return None
        found = [
            motion.distance_m - at_m
            for at_m, x_m, y_m, yaw_rad in self._way
            if abs(motion.x_m - x_m) < AGAIN_M
            and abs(motion.y_m - y_m) < AGAIN_M
            and math.cos(motion.yaw_rad - yaw_rad) > AGAIN_COS
            and motion.distance_m - at_m > CIRCLE_MIN_M
        ]
        self._way.append((motion.distance_m, motion.x_m, motion.y_m, motion.yaw_rad))
        self._again_m = self._again_m + AGAIN_STEP_M if found else 0.0
        # A line that lies further on than it did, by odometry, lets the car drive as much of its way again.
        return found[-1] if found and self._again_m > GATE_SHIFT_M + DRIFT_MAX * found[-1] else None

    def driven(self, motion: Motion, within_m: float, lately_m: float) -> list[tuple[float, float]]:
        """Places (odometry frame) within reach of the car at which its way on does not arrive: it has just been there.

        `lately_m`: of way, for which odometry holds. Not the way of this moment, nor that behind the line, where the
        lap ends; none where the car drives its way again.
        """
        if self._again_m > 0.0 or not self._way:
            return []
        first_m = max(self._way[0][0] + LAP_END_M, motion.distance_m - lately_m)
        places: list[tuple[float, float]] = []
        for at_m, x_m, y_m, _ in self._way[::-DRIVEN_EVERY]:
            if at_m < first_m:
                break
            near = math.hypot(x_m - motion.x_m, y_m - motion.y_m) < within_m
            if near and at_m < motion.distance_m - CIRCLE_MIN_M:
                places.append((x_m, y_m))
        return places


class LapCounter:
    """Laps for another planner: made again for each run, with the car where odometry begins: its staging place.

    It knows the line by odometry alone, and lays it again at each passage: a lap's drift counts, not the run's.
    """

    def __init__(self, missions: MissionSettings | None = None) -> None:
        self._missions = missions or MissionSettings()
        self._state = staged(Motion(), ADS_DV_2026.nose_ahead_of_rear_axle_m + self._missions.lap_staging_m)

    def laps(self, motion: Motion) -> int:
        """Laps completed, with the car at `motion`: to be asked with every motion."""
        self._state = advance_laps(self._state, motion, self._missions.lap_min_m)
        return self._state.laps
