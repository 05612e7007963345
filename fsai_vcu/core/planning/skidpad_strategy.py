"""Skidpad: a figure of eight known beforehand, placed by the cones seen."""

from __future__ import annotations

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.skidpad import (
    advance_skidpad,
    laps_done,
    path_ahead,
    place_start,
    skidpad_course,
    staged_on,
)
from fsai_vcu.core.planning.cone_memory import ConeMemory
from fsai_vcu.core.planning.course import Course
from fsai_vcu.core.planning.pose import to_odometry, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import VehicleParameters


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
        finished = state.progress_m >= course.finish_m
        return Course(to_vehicle(motion, path), laps_done(course, state), finished, max(0.0, left))
