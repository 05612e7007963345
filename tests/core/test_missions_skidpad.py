"""The figure of eight: its path, where it is found in the cones, and the car's place on it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeObservation, Motion, Run
from fsai_vcu.core.missions.course_fit import from_car, on_course
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.skidpad import (
    SkidpadState,
    advance_skidpad,
    laps_done,
    search_skidpad,
    skidpad_course,
    staged,
)
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami

COURSE = skidpad_course(MissionSettings())
NOTHING = np.zeros((0, 2))


def ring(radius_m: float, side: float, count: int, free_m: float = 0.0) -> Floats:
    """Cones round a centre; none within `free_m` of the way in and out."""
    angles = np.arange(count) * 2.0 * math.pi / count
    xy = np.column_stack((radius_m * np.sin(angles), side * (9.125 - radius_m * np.cos(angles))))
    return xy[side * xy[:, 1] > free_m]


LANE_IN = np.array([(x, y) for x in np.arange(-30.0, -7.9, 2.5) for y in (1.5, -1.5)])
CIRCLES = np.concatenate(
    [ring(7.625, side, 16) for side in (1.0, -1.0)] + [ring(10.625, s, 16, 1.5) for s in (1.0, -1.0)]
)
CONES = np.concatenate((LANE_IN, CIRCLES))


def seen_from(pose: Floats, cones: Floats, noise_m: float = 0.0) -> Floats:
    """The cones up to 14 m ahead, in the vehicle frame, one in ten missing where there is noise."""
    random = np.random.default_rng(5)
    xy = from_car(pose, cones)
    there = (np.hypot(xy[:, 0], xy[:, 1]) < 14.0) & (np.abs(np.arctan2(xy[:, 1], xy[:, 0])) < 0.96)
    there &= random.random(len(xy)) >= (0.1 if noise_m else 0.0)
    return np.asarray(xy[there] + random.normal(0.0, 1.0, (int(there.sum()), 2)) * noise_m)


def searched(xy: Floats) -> SkidpadState:
    """What two looks at these cones say."""
    once = search_skidpad(COURSE, staged(Motion()), xy)
    assert not once.found
    return search_skidpad(COURSE, once, xy)


def test_the_path_is_in_right_right_left_left_out_without_jumps() -> None:
    far = COURSE.path((np.arange(4) + 0.5) * COURSE.lap_m)
    assert far == pytest.approx(np.array([[0.0, -18.25], [0.0, -18.25], [0.0, 18.25], [0.0, 18.25]]))
    ends = COURSE.path(np.array([-10.0, COURSE.finish_m + 10.0]))
    assert ends == pytest.approx(np.array([[-10.0, 0.0], [10.0, 0.0]]))
    steps = np.hypot(*np.diff(COURSE.path(np.arange(-20.0, COURSE.finish_m + 20.0, 0.25)), axis=0).T)
    assert steps == pytest.approx(np.full(len(steps), 0.25), abs=0.001)


@pytest.mark.parametrize("pose", [(-17.2, 0.0, 0.0), (-10.2, 1.5, -0.26), (-14.0, -1.5, 0.26), (-17.0, 1.5, 0.26)])
@pytest.mark.parametrize("noise_m", [0.0, 0.1])
def test_the_circles_are_found_from_wherever_the_car_stands(pose: tuple[float, float, float], noise_m: float) -> None:
    there = np.array(pose)
    found = searched(seen_from(there, CONES, noise_m))
    assert found.found
    assert (np.abs(found.pose - there) < (0.2, 0.2, 0.04)).all(), found.pose
    assert found.progress_m == found.pose[0]


@pytest.mark.parametrize("x_m", [-27.0, -20.0])
def test_a_lane_alone_does_not_say_where_the_circles_are(x_m: float) -> None:
    lane = np.array([(x, y) for x in np.arange(-30.0, 30.0, 2.5) for y in (1.5, -1.5)])
    there = np.array([x_m, 0.3, 0.05])
    found = searched(seen_from(there, lane))
    assert not found.found
    assert found.pose[1:] == pytest.approx(there[1:], abs=0.02)


def test_the_circles_are_no_further_off_than_the_lane_in_allows() -> None:
    """A car that has passed the crossing sees a ring of cones, and must not take it for the one ahead."""
    xy = seen_from(np.array([-10.2, 0.0, 0.0]), CONES)
    once = search_skidpad(COURSE, staged(Motion()), xy, lane_in_m=5.0)
    assert not search_skidpad(COURSE, once, xy, lane_in_m=5.0).found
    assert search_skidpad(COURSE, once, xy, lane_in_m=0.0) is once


def test_cones_anywhere_are_not_taken_for_the_circles() -> None:
    random = np.random.default_rng(2)
    for _ in range(20):
        cones = random.uniform((2.0, -9.0), (14.0, 9.0), (15, 2))
        assert not searched(cones).found


def test_progress_never_decreases_nor_is_lost_at_the_crossing() -> None:
    state = SkidpadState(np.array([-17.0, 0.0, 0.0]), Motion(), -17.0, found=True)
    for progress in np.arange(-17.0, COURSE.finish_m + 10.0, 0.3):
        (x, y), (ahead_x, ahead_y) = COURSE.path(np.array([progress, progress + 0.01])).tolist()
        here = Motion(
            x_m=x + 17.0, y_m=y, yaw_rad=math.atan2(ahead_y - y, ahead_x - x), distance_m=float(progress) + 17.0
        )
        before, state = state, advance_skidpad(COURSE, state, here, NOTHING)
        assert state.progress_m >= before.progress_m
        assert state.progress_m == pytest.approx(progress, abs=0.05)
        assert laps_done(COURSE, state) == min(4, max(0, math.floor((state.progress_m + 0.01) / COURSE.lap_m)))
    assert laps_done(COURSE, state) == 4


def test_a_drift_along_the_circle_is_found_at_the_crossing() -> None:
    """The circle itself does not say where on it the car is; the other one and the lanes do."""
    true = np.array([-1.6, -0.14, 0.17])  # 1.6 m before the crossing, on the right circle
    drifted = np.array([0.0, 0.0, 0.0])
    here = Motion(distance_m=80.0)
    state = SkidpadState(drifted, here, COURSE.lap_m, found=True)
    for _ in range(10):
        state = advance_skidpad(COURSE, state, here, seen_from(true, CONES, 0.05))
    assert (np.abs(state.pose - true) < (0.2, 0.1, 0.03)).all(), state.pose


def test_false_cones_do_not_hold_the_car_back_on_the_way_out() -> None:
    draw = np.random.default_rng(1)
    cones = np.concatenate((CONES, -LANE_IN))
    state = SkidpadState(np.zeros(3), Motion(), COURSE.finish_m, found=True)
    for way in np.arange(0.3, 18.0, 0.3):
        far, angle = 14.0 * np.sqrt(draw.random(4)), draw.uniform(-0.96, 0.96, 4)
        false = np.column_stack((far * np.cos(angle), far * np.sin(angle)))
        seen = np.concatenate((seen_from(np.array([way, 0.0, 0.0]), cones, 0.05), false))
        state = advance_skidpad(COURSE, state, Motion(x_m=float(way), distance_m=float(way)), seen)
        assert state.progress_m - COURSE.finish_m == pytest.approx(way, abs=1.0)


def test_the_lane_in_is_followed_until_the_circles_are_found() -> None:
    """25 m before the crossing, askew: what is seen there could be anywhere along the lane."""
    planner = Planner(ADS_DV_2026)
    planner.reset(Run(1, Ami.SKIDPAD))
    for start, said in ((np.array([-27.2, 0.5, 0.1]), "lane in"), (np.array([-16.0, 0.0, 0.0]), "")):
        x, y, yaw = start.tolist()
        for t_ns in range(1, 5):
            moved = Motion(t_ns, x, y, yaw, distance_m=x + 27.2)  # the odometry frame lies in the course frame
            xy = seen_from(start, CONES)
            many = np.full(len(xy), 0.9)
            plan = planner.on_cones(ConeObservation(t_ns, xy, np.zeros(len(xy), dtype=np.int64), many), moved)
        assert plan is not None and said in plan.note
        assert np.abs(on_course(start, plan.path_m[:10])[:, 1]).max() < 0.15
    assert plan.note == ""


def test_without_circles_there_is_no_path_beyond_the_lane_in() -> None:
    planner = Planner(ADS_DV_2026)
    planner.reset(Run(1, Ami.SKIDPAD))
    lane = np.array([[5.0, 1.5], [5.0, -1.5]])
    seen = ConeObservation(1, lane, np.zeros(2, dtype=np.int64), np.ones(2))
    lengths = []
    for x in (0.0, 29.0, 31.0):
        plan = planner.on_cones(replace(seen, t_ns=int(x)), Motion(int(x), x_m=x, distance_m=x))
        assert plan is not None and plan.note
        lengths.append(len(plan.path_m))
    assert lengths[0] == lengths[1] > 20 and lengths[2] == 0


@pytest.mark.parametrize("mission", [Ami.SKIDPAD, Ami.ACCELERATION])
def test_where_no_cones_are_seen_any_more_there_is_no_path(mission: Ami) -> None:
    planner = Planner(ADS_DV_2026)
    planner.reset(Run(1, mission))
    nothing = ConeObservation(1, NOTHING, np.zeros(0, dtype=np.int64), np.zeros(0))
    plans = []
    for x in (0.0, 11.0, 13.0):
        plans.append(planner.on_cones(replace(nothing, t_ns=int(x)), Motion(int(x), x_m=x, distance_m=x)))
    assert [bool(len(plan.path_m)) for plan in plans if plan is not None] == [True, True, False]
    assert plans[-1] is not None and plans[-1].note == "no cones are seen for 13 m"
