"""Strategy for the skidpad: a figure of eight known by the rules, found in the cones; until then along the lane in."""

from __future__ import annotations

from functools import partial

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.course_fit import from_car
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.skidpad import (
    advance_skidpad,
    laps_done,
    off_course,
    search_skidpad,
    skidpad_course,
    staged,
)
from fsai_vcu.core.planning.cone_memory import ConeMemory
from fsai_vcu.core.planning.course import DOUBTFUL, Blind, Course, Fit
from fsai_vcu.core.planning.pose import NO_PATH
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import VehicleParameters


class SkidpadStrategy:
    """Strategy that drives along the figure of eight, found and corrected by what is seen."""

    HORIZON_M = 20.0
    SEARCHED_UNTIL_M = -8.0  # before the crossing, from where on the place found is only tracked
    LANE_IN_MAX_M = 30.0  # to be driven from the staging place without having found the circles

    def __init__(self, car: VehicleParameters, settings: PlannerSettings, missions: MissionSettings) -> None:
        self._step_m, self._missions = settings.path_step_m, missions
        self._course = skidpad_course(missions)
        self.anchor(Motion())

    def anchor(self, motion: Motion) -> None:
        self._state = staged(motion)
        self._anchored_at_m = motion.distance_m
        self._blind, self._fit = Blind(motion), Fit()

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        """Return the way along the figure of eight from where the cones show the car to be."""
        course = self._course
        self._state = state = advance_skidpad(course, self._state, motion, seen_xy_m)
        lane_in_m = self.LANE_IN_MAX_M - (motion.distance_m - self._anchored_at_m)
        if state.progress_m < self.SEARCHED_UNTIL_M:
            self._state = state = search_skidpad(course, state, seen_xy_m, lane_in_m)
        lost = self._blind.lost(seen_xy_m, motion)
        finished = state.progress_m >= course.finish_m
        if lost is not None and not finished:
            return lost
        ahead = np.arange(0.0, self.HORIZON_M + 1e-9, self._step_m)
        if not state.found:
            if lane_in_m < 0.0:
                return Course(NO_PATH, confidence=0.0, note="the skidpad's circles are nowhere in the cones seen")
            lane = from_car(state.pose, np.column_stack((state.pose[0] + ahead, np.zeros_like(ahead))))
            return Course(lane, confidence=0.5, note="along the lane in: the circles have not been found yet")
        path = from_car(state.pose, course.path(state.progress_m + ahead))
        left = course.finish_m + self._missions.skidpad_stop_m - state.progress_m
        sure = self._fit.of(memory, memory.around(motion), seen_xy_m, partial(off_course, course, state))
        note = "" if sure > DOUBTFUL else "the cones seen do not stand where the skidpad has them"
        left = max(0.0, left)
        return Course(path, laps_done(course, state), finished, left, memory.view_m, confidence=sure, note=note)
