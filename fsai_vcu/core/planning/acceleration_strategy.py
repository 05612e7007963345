"""Acceleration: a straight line between the cones."""

from __future__ import annotations

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, Motion
from fsai_vcu.core.missions.acceleration import advance_acceleration, closed_at, line_ahead, staged_before
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.cone_memory import ConeMemory
from fsai_vcu.core.planning.course import Course, braking_m
from fsai_vcu.core.planning.pose import to_odometry, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import VehicleParameters

ACCELERATION_BRAKING_MPS2 = 4.5


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
            needed = braking_m(motion.speed_mps, ACCELERATION_BRAKING_MPS2)
            missions = self._missions
            self._stop_m = min(max(missions.acceleration_stop_m, needed), missions.acceleration_stop_max_m)
        if self._stop_m is not None:
            stop_m = self._stop_m
        left = state.finish_m + stop_m - state.along_m
        wall = closed_at(state, xy)
        if wall is not None:
            left = min(left, wall - state.along_m - self._car.nose_ahead_of_rear_axle_m - 1.0)
        path = to_vehicle(motion, line_ahead(self._state, self.HORIZON_M, self._settings.path_step_m))
        return Course(path, int(finished), finished, max(0.0, left))
