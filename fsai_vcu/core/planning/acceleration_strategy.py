"""Strategy for acceleration: a straight line between the cones."""

from __future__ import annotations

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, Motion
from fsai_vcu.core.missions.acceleration import closed_at, finish_seen, follow_lane, staged
from fsai_vcu.core.missions.course_fit import on_course
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.cone_memory import ConeMemory
from fsai_vcu.core.planning.course import DOUBTFUL, Blind, Course, Fit, braking_m
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import VehicleParameters

ACCELERATION_BRAKING_MPS2 = 4.5


class AccelerationStrategy:
    """Strategy that drives straight on to the finish."""

    BLIND_MAX_M = 15.0  # to be driven from the staging place without having found the lane
    HORIZON_M = 60.0  # long enough for the highest speed to brake in

    def __init__(self, car: VehicleParameters, settings: PlannerSettings, missions: MissionSettings) -> None:
        self._nose_m, self._step_m, self._missions = car.nose_ahead_of_rear_axle_m, settings.path_step_m, missions
        self.anchor(Motion())

    def anchor(self, motion: Motion) -> None:
        missions = self._missions
        # For the rear axle, where the nose is staged before the start line.
        self._finish_m = self._nose_m + missions.acceleration_staging_m + missions.acceleration_length_m
        self._lane = staged(motion)
        self._stop_m = missions.acceleration_stop_max_m  # until the finish only the rules' limit counts
        self._finished = False
        self._blind, self._fit = Blind(motion), Fit()

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        """Return the way along the lane, to the stop behind the finish."""
        cones = memory.around(motion)
        lost = self._blind.lost(seen_xy_m, motion)
        self._lane = lane = follow_lane(self._lane, motion, cones.xy_m)
        at, along_m = on_course(lane.pose, cones.xy_m), float(lane.pose[0])
        if along_m < self._finish_m:
            self._finish_m = finish_seen(self._finish_m, at[cones.color == ConeColor.BIG_ORANGE])
        elif not self._finished:  # the speed at the finish decides where to stop
            self._finished = True
            needed = braking_m(motion.speed_mps, ACCELERATION_BRAKING_MPS2)
            self._stop_m = min(max(self._missions.acceleration_stop_m, needed), self._stop_m)
        left = self._finish_m + self._stop_m - along_m
        wall = closed_at(max(self._finish_m, along_m), at)
        if wall is not None:
            left = min(left, wall - along_m - self._nose_m - 1.0)
        if lost is not None and not self._finished:
            return lost
        path = lane.ahead(self.HORIZON_M, self._step_m)
        sure, note = 0.3 if along_m < self.BLIND_MAX_M else 0.0, "straight on by odometry: no lane has been found"
        if lane.found:
            sure = self._fit.of(memory, cones, seen_xy_m, lane.off)
            note = "" if sure > DOUBTFUL else "the cones seen are not in two rows beside the lane"
        return Course(path, int(self._finished), self._finished, max(0.0, left), confidence=sure, note=note)
