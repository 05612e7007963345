"""The planner: cones and motion in, plan out.

One strategy per family of missions: a lane found in the cones around the car (autocross, trackdrive), a straight line
(acceleration), a figure of eight known beforehand (skidpad). Missions without a path get no plan.
"""

from __future__ import annotations

import math

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Plan, Run
from fsai_vcu.core.missions.acceleration import advance_acceleration, closed_at, line_ahead, staged_before
from fsai_vcu.core.missions.laps import advance_laps, gate_seen, staged
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.skidpad import (
    advance_skidpad,
    laps_done,
    path_ahead,
    place_start,
    skidpad_course,
    staged_on,
)
from fsai_vcu.core.planning.cone_memory import ConeMemory, Cones, believable
from fsai_vcu.core.planning.lane import find_lane
from fsai_vcu.core.planning.pose import NO_PATH, headings_along, lengths_along, to_odometry, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.odometry import motion_at
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState

Course = tuple[Floats, int, bool, float | None]
"""Path (vehicle frame), laps completed, finished, way left to the stopping place."""


GATE_WIDER_M = 1.0  # a gate's cones may stand this much further out than the lane's border
LAP_BRAKING_MPS2 = 3.0  # comfortable, from the speed at the finish
ACCELERATION_BRAKING_MPS2 = 4.5
BRAKING_DELAY_S = 0.3


# How a family of missions finds its way. `anchor`: the car stands at its staging place, at `motion`; `plan`: the way
# on, after `memory` has taken in the cones seen (vehicle frame) from `motion`.


class LaneStrategy:
    """Follow the lane and count laps."""

    def __init__(self, car: VehicleParameters, settings: PlannerSettings, missions: MissionSettings, laps: int) -> None:
        self._settings = settings
        self._missions = missions
        self._laps = laps
        self._nose_m = car.nose_ahead_of_rear_axle_m
        self._line_ahead_m = self._nose_m + missions.lap_staging_m
        self.anchor(Motion())

    def anchor(self, motion: Motion) -> None:
        self._state = staged(motion, self._line_ahead_m)
        self._half_width_m = self._settings.lane_half_width_min_m
        self._kept: Floats = NO_PATH  # the last path, in the odometry frame
        self._kept_t_ns = 0
        self._finished_at_m: float | None = None
        self._stop_m = self._missions.lap_stop_m

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        cones = memory.around(motion)
        curvature = motion.yaw_rate_radps / max(motion.speed_mps, 1.0)
        lane = find_lane(cones, curvature, self._half_width_m, self._nose_m, self._settings)
        path = lane.path_m
        if len(path):
            self._half_width_m += 0.2 * (lane.half_width_m - self._half_width_m)
            memory.vote(cones.index, lane.side)
            self._kept, self._kept_t_ns = to_odometry(motion, path), motion.t_ns
        else:
            path = self._kept_path(motion)
        self._count(cones, path, motion)
        if self._finished_at_m is None:
            return path, self._state.laps, False, None
        left = self._finished_at_m + self._stop_m - motion.distance_m
        return path, self._state.laps, True, max(0.0, left)

    def _kept_path(self, motion: Motion) -> Floats:
        """What is left of the last path, if it is not too old."""
        if not len(self._kept) or motion.t_ns - self._kept_t_ns > self._settings.keep_path_ns:
            return NO_PATH
        path = to_vehicle(motion, self._kept)
        ahead = path[int(np.hypot(path[:, 0], path[:, 1]).argmin()) :]
        return ahead if len(ahead) >= 5 else NO_PATH

    def _count(self, cones: Cones, path: Floats, motion: Motion) -> None:
        gate = cones.xy_m[cones.color == ConeColor.BIG_ORANGE]
        if len(gate) >= 2 and len(path) >= 3:
            middle = _gate_middle(gate, path, self._half_width_m)
            if middle is not None:
                at = to_odometry(motion, middle[0][None, :])[0]
                self._state = gate_seen(
                    self._state,
                    float(at[0]),
                    float(at[1]),
                    motion.yaw_rad + middle[1],
                    motion,
                    self._missions.lap_min_m,
                )
        self._state = advance_laps(self._state, motion, self._missions.lap_min_m)
        if self._finished_at_m is None and self._state.laps >= self._laps:
            self._finished_at_m = motion.distance_m
            # Comfortable from any speed, within what the rules allow.
            needed = _braking_m(motion.speed_mps, LAP_BRAKING_MPS2)
            self._stop_m = min(max(self._missions.lap_stop_m, needed), self._missions.lap_stop_max_m)


def _gate_middle(gate_xy_m: Floats, path_m: Floats, half_width_m: float) -> tuple[Floats, float] | None:
    """Middle (vehicle frame) and direction of the nearest gate across the path, or None.

    Cones further off than the lane's border are not of this lane: another one may pass on the border's far side.
    """
    cos, sin = headings_along(path_m)
    along = lengths_along(path_m)
    dx, dy = gate_xy_m[:, None, 0] - path_m[None, :, 0], gate_xy_m[:, None, 1] - path_m[None, :, 1]
    nearest = (dx * dx + dy * dy).argmin(axis=1)
    rows = np.arange(len(nearest))
    dx, dy = dx[rows, nearest], dy[rows, nearest]
    ahead = dx * cos[nearest] + dy * sin[nearest]
    lateral = dy * cos[nearest] - dx * sin[nearest]
    station = along[nearest] + ahead
    of_lane = (np.abs(lateral) < half_width_m + GATE_WIDER_M) & (np.abs(lateral) > 0.6)
    good = of_lane & (np.abs(ahead) < 3.0) & (along[nearest] < 15.0)
    if not good.any():
        return None
    first = float(station[good].min())
    good &= station < first + 5.0
    left, right = good & (lateral > 0), good & (lateral < 0)
    if left.any() and right.any():
        middle = 0.5 * (gate_xy_m[left].mean(axis=0) + gate_xy_m[right].mean(axis=0))
        index = int(nearest[good][0])
    elif good.sum() < 2:
        return None
    else:
        # One side only: its cones' place along the path says where the line is.
        index = int(np.abs(along - station[good].mean()).argmin())
        middle = path_m[index]
    return middle, math.atan2(float(sin[index]), float(cos[index]))


def _braking_m(speed_mps: float, deceleration_mps2: float) -> float:
    """Way in which the car comes to rest."""
    return speed_mps * BRAKING_DELAY_S + speed_mps**2 / (2.0 * deceleration_mps2)


class AccelerationStrategy:
    """Straight on to the finish."""

    HORIZON_M = 60.0  # long enough for the highest speed to brake in

    def __init__(self, car: VehicleParameters, settings: PlannerSettings, missions: MissionSettings) -> None:
        self._car, self._settings, self._missions = car, settings, missions
        self.anchor(Motion())

    def anchor(self, motion: Motion) -> None:
        self._state = staged_before(motion, self._missions, self._car.nose_ahead_of_rear_axle_m)
        self._stop_m: float | None = None

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        cones = memory.around(motion)
        xy = to_odometry(motion, cones.xy_m)
        self._state = advance_acceleration(self._state, motion, xy, xy[cones.color == ConeColor.BIG_ORANGE])
        state = self._state
        finished = state.along_m >= state.finish_m
        stop_m = self._missions.acceleration_stop_max_m  # until the finish only the rules' limit counts
        if finished and self._stop_m is None:  # the speed at the finish decides where to stop
            needed = _braking_m(motion.speed_mps, ACCELERATION_BRAKING_MPS2)
            missions = self._missions
            self._stop_m = min(max(missions.acceleration_stop_m, needed), missions.acceleration_stop_max_m)
        if self._stop_m is not None:
            stop_m = self._stop_m
        left = state.finish_m + stop_m - state.along_m
        wall = closed_at(state, xy)
        if wall is not None:
            left = min(left, wall - state.along_m - self._car.nose_ahead_of_rear_axle_m - 1.0)
        path = to_vehicle(motion, line_ahead(self._state, self.HORIZON_M, self._settings.path_step_m))
        return path, int(finished), finished, max(0.0, left)


class SkidpadStrategy:
    """Along the figure of eight, corrected by what is seen."""

    HORIZON_M = 20.0
    PLACING = 5  # observations at rest by which the start is searched

    def __init__(self, car: VehicleParameters, settings: PlannerSettings, missions: MissionSettings) -> None:
        self._settings, self._missions = settings, missions
        self._course = skidpad_course(missions, car.nose_ahead_of_rear_axle_m)
        self.anchor(Motion())

    def anchor(self, motion: Motion) -> None:
        self._state = staged_on(self._course, motion)
        self._anchored_at_m = motion.distance_m

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        course, state = self._course, self._state
        at_start = motion.distance_m - self._anchored_at_m < 0.5
        if at_start and state.placed < self.PLACING:
            known = to_odometry(motion, memory.around(motion).xy_m)
            if len(known) >= 5:
                state = place_start(course, state, motion, known)
        state = advance_skidpad(course, state, motion, to_odometry(motion, seen_xy_m))
        self._state = state
        left = course.finish_m + self._missions.skidpad_stop_m - state.progress_m
        path = path_ahead(course, state, self.HORIZON_M, self._settings.path_step_m)
        return to_vehicle(motion, path), laps_done(course, state), state.progress_m >= course.finish_m, max(0.0, left)


Strategy = LaneStrategy | AccelerationStrategy | SkidpadStrategy


class Planner:
    """Cones to a path, for the run in hand. `reset` forgets everything."""

    def __init__(
        self,
        car: VehicleParameters,
        settings: PlannerSettings | None = None,
        missions: MissionSettings | None = None,
    ) -> None:
        self._car = car
        self._settings = settings or PlannerSettings()
        self._missions = missions or MissionSettings()
        self._memory = ConeMemory(self._settings)
        self.reset(Run(run_id=0))

    @property
    def run(self) -> Run:
        return self._run

    def reset(self, run: Run) -> None:
        """Forget everything: `run` begins. Until `on_run` says more, the staging place is the odometry's origin."""
        self._run = run
        self._memory.clear()
        self._strategy = self._strategy_for(run.mission)
        self._last: Motion | None = None

    def on_run(self, run: Run) -> None:
        """The run goes on, perhaps in another AS state; another run (id or mission) resets.

        With AS_DRIVING the place where the car stands is its staging place, however it was pushed there before.
        """
        if run.run_id != self._run.run_id or run.mission != self._run.mission:
            self.reset(run)
            return
        starts = run.as_state is AsState.AS_DRIVING and self._run.as_state is not AsState.AS_DRIVING
        self._run = run
        if starts and self._strategy is not None and self._last is not None:
            self._strategy.anchor(self._last)

    def on_cones(self, obs: ConeObservation, motion: Motion) -> Plan | None:
        """The plan after an observation; None where the mission needs no path.

        `motion` may be of another instant than the observation, by some tens of ms: it is carried to it.
        """
        there = motion_at(motion, obs.t_ns)
        if self._last is not None and there.distance_m < self._last.distance_m - 1.0:
            self.reset(self._run)  # odometry began anew: nothing remembered is where it was
        self._last = there
        if self._strategy is None:
            return None
        xy, color = believable(obs, self._settings)
        self._memory.add(xy, color, there)
        path, laps, finished, stop = self._strategy.plan(self._memory, xy, there)
        return Plan(
            t_sensor_ns=obs.t_ns,
            run_id=self._run.run_id,
            mission=self._run.mission,
            path_m=path,
            laps=laps,
            finished=finished,
            stop_distance_m=stop,
            cones_count_actual=len(xy),
            cones_count_all=self._memory.total,
        )

    def _strategy_for(self, mission: Ami) -> Strategy | None:
        car, settings, missions = self._car, self._settings, self._missions
        if mission is Ami.AUTOCROSS:
            return LaneStrategy(car, settings, missions, missions.autocross_laps)
        if mission is Ami.TRACKDRIVE:
            return LaneStrategy(car, settings, missions, missions.trackdrive_laps)
        if mission is Ami.ACCELERATION:
            return AccelerationStrategy(car, settings, missions)
        if mission is Ami.SKIDPAD:
            return SkidpadStrategy(car, settings, missions)
        return None
