"""The figure of eight: its path, and the car's place on it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.skidpad import (
    STEP_M,
    advance_skidpad,
    laps_done,
    path_ahead,
    skidpad_course,
    staged_on,
)

SETTINGS = MissionSettings()
COURSE = skidpad_course(SETTINGS, nose_m=2.17)
NOTHING = np.zeros((0, 2))


def test_the_driven_circles_have_the_rules_radius_and_centres() -> None:
    right = COURSE.xy_m[COURSE.xy_m[:, 1] < -0.01]
    left = COURSE.xy_m[COURSE.xy_m[:, 1] > 0.01]
    assert np.hypot(right[:, 0], right[:, 1] + 9.125) == pytest.approx(np.full(len(right), 9.125), abs=0.01)
    assert np.hypot(left[:, 0], left[:, 1] - 9.125) == pytest.approx(np.full(len(left), 9.125), abs=0.01)


def test_the_path_is_in_right_right_left_left_out() -> None:
    marks = [COURSE.entry_m + (lap + 0.5) * COURSE.lap_m for lap in range(4)]
    far = [COURSE.xy_m[round(mark / STEP_M)] for mark in marks]
    assert [np.sign(point[1]) for point in far] == [-1.0, -1.0, 1.0, 1.0]
    out = COURSE.xy_m[round((COURSE.finish_m + 10.0) / STEP_M)]
    assert out == pytest.approx([10.0, 0.0], abs=0.2)


def test_the_path_has_no_jumps() -> None:
    steps = np.hypot(*np.diff(COURSE.xy_m, axis=0).T)
    assert steps == pytest.approx(np.full(len(steps), STEP_M), abs=0.02)


def test_the_staged_cars_nose_is_15_m_before_the_crossing() -> None:
    state = staged_on(COURSE, Motion(x_m=3.0, y_m=-2.0, yaw_rad=0.7))
    x, y, yaw = state.course_pose(Motion(x_m=3.0, y_m=-2.0, yaw_rad=0.7))
    assert (x, y, yaw) == pytest.approx((-17.17, 0.0, 0.0))


def test_progress_never_decreases_nor_is_lost_at_the_crossing() -> None:
    state = staged_on(COURSE, Motion())
    driven = 0.0
    while driven < COURSE.finish_m - COURSE.staged_at_m:
        driven += 0.3
        index = (COURSE.staged_at_m + driven) / STEP_M
        at = np.array([np.interp(index, np.arange(len(COURSE.xy_m)), COURSE.xy_m[:, axis]) for axis in (0, 1)])
        here = Motion(
            x_m=float(at[0]) + 17.17,
            y_m=float(at[1]),
            yaw_rad=float(COURSE.heading_rad[round(index)]),
            distance_m=driven,
        )
        before = state.progress_m
        state = advance_skidpad(COURSE, state, here, NOTHING)
        assert state.progress_m >= before
        assert state.progress_m == pytest.approx(COURSE.staged_at_m + driven, abs=0.3)
    assert laps_done(COURSE, state) == 4


def test_cones_pull_a_drifted_position_back() -> None:
    angles = np.arange(0.3, 2.5, 0.35)
    inner = np.column_stack((7.625 * np.sin(angles), -9.125 + 7.625 * np.cos(angles)))
    outer = np.column_stack((10.625 * np.sin(angles), -9.125 + 10.625 * np.cos(angles)))
    far = np.array([[0.0, 9.125 - 7.625], [-3.0, 9.125 - math.sqrt(7.625**2 - 9.0)]])
    cones = np.concatenate((inner, outer, far)) + np.array([17.17, 0.0])  # in the odometry frame
    true = staged_on(COURSE, Motion())
    here = Motion(x_m=17.17 + 3.0, y_m=-0.5, yaw_rad=-0.33, distance_m=20.2)
    state = replace(true, x_m=true.x_m + 0.4, y_m=true.y_m - 0.3, progress_m=COURSE.entry_m + 3.0, distance_m=20.2)
    for _ in range(30):
        state = advance_skidpad(COURSE, state, here, cones)
    assert state.course_pose(here) == pytest.approx(true.course_pose(here), abs=0.15)


def test_beyond_the_paths_end_nothing_breaks() -> None:
    state = replace(staged_on(COURSE, Motion()), progress_m=COURSE.finish_m + 70.0)
    state = advance_skidpad(COURSE, state, Motion(distance_m=5.0), NOTHING)
    assert state.progress_m == pytest.approx(COURSE.finish_m + 75.0)
    assert path_ahead(COURSE, state, 20.0, 0.5).shape == (0, 2)
    assert laps_done(COURSE, state) == 4
