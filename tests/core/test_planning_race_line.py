"""The race line in a lane, and laps that follow it in the map."""

from __future__ import annotations

import copy
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from lap_rig import CAR, STEP_M, Ride, clearance_m
from msgspec.structs import replace

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.sensing import ConeSensor, SensorSettings
from fsai_hil.simulator.tracks import Track, random_circuit, small_oval
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, Motion, Plan
from fsai_vcu.core.planning import cone_map
from fsai_vcu.core.planning.cone_map import located
from fsai_vcu.core.planning.pose import NO_PATH, lengths_along, ring_curvature, to_odometry, to_vehicle
from fsai_vcu.core.planning.race_line import CONE_RADIUS_M, MARGIN_M, RACED_MPS, RACED_MPS2, LineSearch, RaceLine
from fsai_vcu.core.planning.racing import (
    BEYOND_M,
    JOINING_M,
    JOINING_S,
    NOT_ON_LINE,
    ON_LINE,
    Racing,
    joining,
    way_onto,
)
from fsai_vcu.core.planning.settings import PlannerSettings

OVAL, WINDING = small_oval(), random_circuit(1)


def race_line(track: Track) -> RaceLine:
    search = LineSearch(track.centreline_m, track.cones_xy_m, CAR, 0.5)
    while (line := search.advance()) is None:
        pass
    return line


def squared_curvature(closed_m: Floats) -> float:
    """Integral along a closed line, 1/m."""
    ring = np.concatenate((closed_m, closed_m[:2]))
    steps = np.diff(ring, axis=0)
    turns = np.angle(np.exp(1j * np.diff(np.arctan2(steps[:, 1], steps[:, 0]))))
    lengths = np.hypot(*steps.T)
    return float((turns**2 / (0.5 * (lengths[1:] + lengths[:-1]))).sum())


@pytest.mark.parametrize("track", [OVAL, WINDING])
def test_the_whole_car_keeps_its_margin_on_the_line(track: Track) -> None:
    line = race_line(track)
    poses = [Pose(x, y, math.atan2(sin, cos)) for (x, y), cos, sin in zip(line.xy_m, line.cos, line.sin, strict=True)]
    assert min(clearance_m(pose, track.cones_xy_m) for pose in poses) > MARGIN_M - 0.01


@pytest.mark.parametrize("track", [OVAL, WINDING])
def test_turned_into_its_bend_the_nose_keeps_the_margin(track: Track) -> None:
    """By 0.115 rad at full lateral acceleration, as in one corner of ten; behind the rear axle the car swings out."""
    line = race_line(track)
    bends = ring_curvature(line.xy_m, over=2)
    turned = 0.115 * np.sign(bends) * np.minimum(1.0, RACED_MPS**2 / RACED_MPS2 * np.abs(bends))
    yaws = np.arctan2(line.sin, line.cos) + turned
    inner = [
        track.cones_xy_m[np.sign(bend) * Pose(x, y, yaw).seen(*track.cones_xy_m.T)[1] > 0.0]
        for (x, y), yaw, bend in zip(line.xy_m, yaws, bends, strict=True)
    ]
    poses = [Pose(x, y, yaw) for (x, y), yaw in zip(line.xy_m, yaws, strict=True)]
    assert min(map(clearance_m, poses, inner)) > MARGIN_M - 0.01


@pytest.mark.parametrize("track", [OVAL, WINDING])
def test_the_line_bends_less_than_the_middle_of_the_lane(track: Track) -> None:
    assert squared_curvature(race_line(track).xy_m) < 0.9 * squared_curvature(track.centreline_m)


@pytest.mark.parametrize("track", [OVAL, WINDING])
def test_the_line_bends_least_where_its_corners_are_tightest(track: Track, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may bend more in all than a line of the least sum of squares: how fast a corner is depends on its tightest."""
    uneven = race_line(track)
    monkeypatch.setattr("fsai_vcu.core.planning.race_line.EVEN_ROUNDS", 99)
    even = race_line(track)
    assert squared_curvature(uneven.xy_m) > squared_curvature(even.xy_m)
    fourth, of_even = ((ring_curvature(line.xy_m, over=2) ** 4).mean() for line in (uneven, even))
    assert fourth < 0.98 * of_even


@cache
def _mapped() -> tuple[Ride, Plan]:
    ride = Ride(OVAL, laps=4)
    return ride, ride.until_mapped()


def mapped() -> tuple[Ride, Plan]:
    """A ride of its own that has just got its first path of the map, and that path."""
    return copy.deepcopy(_mapped())


def test_every_look_has_a_path_and_lap_two_races() -> None:
    ride = Ride(OVAL, laps=2)
    mapped_from_m = ride.until_mapped() and ride.motion.distance_m  # step asserts the paths
    assert mapped_from_m < 1.4 * OVAL.length_m
    while not (plan := ride.step()).finished:
        path = plan.path_m
        assert plan.mapped and math.hypot(*path[0]) < 0.6
        assert plan.supported_m == pytest.approx(lengths_along(path)[-1], rel=0.05) and plan.supported_m > 50.0
        assert np.hypot(*np.diff(path, axis=0).T).max() < 0.6
        assert clearance_m(ride.pose, OVAL.cones_xy_m) > 0.1
    assert plan.laps == 2 and plan.stop_distance_m is not None
    assert abs(OVAL.start_line.seen(ride.pose.x_m, ride.pose.y_m)[0]) < 1.5  # counted where the line is


def test_the_path_comes_from_the_car_onto_the_line() -> None:
    ride, first = mapped()
    second = ride.step()
    assert math.hypot(*first.path_m[0]) < 0.3
    turned = np.abs(np.diff(np.unwrap(np.arctan2(*np.diff(first.path_m[:40], axis=0).T[::-1]))))
    assert turned.max() < 0.5 * 0.3 and second.mapped  # no tighter than the car can turn


@pytest.mark.parametrize("left_m", [-1.2, -0.3, 0.0, 0.6])
@pytest.mark.parametrize("turned_rad", [-0.3, 0.0, 0.2])
@pytest.mark.parametrize("bend_1pm", [-0.1, 0.0, 0.1])
def test_a_join_has_no_step_of_curvature(left_m: float, turned_rad: float, bend_1pm: float) -> None:
    length_m, step_m = 20.0, 0.01
    aside = joining(left_m, turned_rad, bend_1pm, length_m, step_m)
    path = np.append(aside, np.zeros(200))  # and on along the line
    slope = np.diff(path) / step_m
    bend = np.diff(slope) / step_m
    assert path[0] == pytest.approx(left_m)
    assert slope[0] == pytest.approx(math.tan(turned_rad), abs=0.001)
    assert bend[0] == pytest.approx(bend_1pm, abs=0.002)
    assert np.abs(np.diff(bend)).max() < 0.001  # a bend of 0.1 1/m that began at once would be a hundred times this
    least = (6.0 * abs(left_m) + 4.0 * length_m * abs(math.tan(turned_rad))) / length_m**2 + abs(bend_1pm)
    assert np.abs(bend).max() < 1.05 * least + 0.001  # no more than a bend that had to begin at once


def test_the_way_onto_a_line_keeps_to_the_room_beside_it() -> None:
    line = race_line(WINDING)
    cut_m = []  # off a way by the room's end: there it has a kink
    for at in range(len(line.xy_m)):
        here = Motion(speed_mps=12.0, yaw_rate_radps=12.0 * line.curvature_1pm(at))
        for left_m in (-0.15, 0.15):
            if -line.right_m[at] <= left_m <= line.left_m[at]:
                cut_m.append(line.beyond_m(at, way_onto(line, at, left_m, 0.0, here)))
    assert len(cut_m) > 400 and np.mean(np.array(cut_m) > 0.1) < 0.1  # of ways of one length a fifth


def test_a_line_without_room_for_the_way_onto_it_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    ride, _ = mapped()
    racing: Any = ride.planner._strategy
    racing = racing._racing
    racing._joined_at = None  # as by a line laid again …
    monkeypatch.setattr(RaceLine, "beyond_m", lambda *_: BEYOND_M + 0.01)
    plan = ride.step()
    assert not plan.mapped and NOT_ON_LINE in plan.note
    monkeypatch.undo()
    assert any(ride.step().mapped for _ in range(30))


def test_a_car_keeps_its_line_until_it_can_join_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    ride, _ = mapped()
    racing: Any = ride.planner._strategy
    racing = racing._racing
    assert all(ride.step().mapped for _ in range(20))
    first = racing._line
    monkeypatch.setattr(RaceLine, "beyond_m", lambda *_: BEYOND_M + 0.01)
    racing._map.changed = True
    assert all(ride.step().mapped for _ in range(20)) and racing._line is first
    monkeypatch.undo()
    assert ride.step().mapped and racing._line is not first


def test_a_line_tells_its_curvature() -> None:
    line = race_line(OVAL)
    near = ring_curvature(line.xy_m, over=2)
    assert [line.curvature_1pm(at) for at in range(len(near))] == pytest.approx(list(near), abs=0.01)


def move_cone(ride: Ride, ahead_m: float, inward_m: float) -> int:
    """The left cone nearest to a place of the lap ahead steps into the lane. Returns which one it is."""
    track = ride.track
    middle = track.centreline_m
    here = int(np.hypot(*(middle - (ride.pose.x_m, ride.pose.y_m)).T).argmin())
    along = lengths_along(middle)
    place = middle[int(np.abs(along - (along[here] + ahead_m) % along[-1]).argmin())]
    away = np.hypot(*(track.cones_xy_m - place).T) + np.where(track.cone_colors == ConeColor.BLUE, 0.0, np.inf)
    cone = int(away.argmin())
    inward = middle[int(np.hypot(*(middle - track.cones_xy_m[cone]).T).argmin())] - track.cones_xy_m[cone]
    moved = track.cones_xy_m.copy()
    moved[cone] += inward_m * inward / math.hypot(*inward)
    ride.track = replace(track, cones_xy_m=moved)
    ride.sensor = ConeSensor(ride.track, seed=1)
    return cone


def test_a_moved_cone_is_avoided_and_raced_around() -> None:
    ride, _ = mapped()
    cone = ride.track.cones_xy_m[move_cone(ride, 52.0, 0.7)]
    beside = []  # the moved cone: laps and whether the path is the map's
    while (plan := ride.step()).laps < 3:
        assert clearance_m(ride.pose, ride.track.cones_xy_m) > 0.05
        if math.hypot(*(cone - (ride.pose.x_m, ride.pose.y_m))) < 8.0:
            beside.append((plan.laps, plan.mapped))
    assert len(beside) > 20 and {mapped for laps, mapped in beside if laps == 2} == {True}


@pytest.mark.parametrize(("gap_m", "raced"), [(0.12, False), (0.22, True)])
def test_a_cone_seen_close_beside_the_body_ends_the_race(gap_m: float, raced: bool) -> None:
    """Seen 2 m ahead, it must be left 16 cm."""
    ride, _ = mapped()
    plan = ride.step()
    racing: Any = ride.planner._strategy
    racing = racing._racing
    (x, y), (next_x, next_y) = plan.path_m[4:6]
    away_m = 0.5 * CAR.width_m + CONE_RADIUS_M + gap_m
    heading = math.atan2(next_y - y, next_x - x)
    beside = np.array([[x - away_m * math.sin(heading), y + away_m * math.cos(heading)]])
    assert plan.mapped and racing._line.news(to_odometry(racing._map.here, beside)).all()
    assert bool(len(racing.path(beside, racing._map.here))) == raced


def test_a_cone_seen_on_the_line_outranks_the_map() -> None:
    ride, _ = mapped()
    move_cone(ride, 9.0, 1.2)
    plans = [ride.step() for _ in range(4)]
    assert not plans[-1].mapped and "cone" in plans[-1].note


def test_a_car_far_beside_the_middle_leaves_the_line_unlost(monkeypatch: pytest.MonkeyPatch) -> None:
    """One look with a cone on the line: the path goes on from where the car is, and comes into the lane."""
    ride, _ = mapped()
    racing: Any = ride.planner._strategy
    racing = racing._racing

    def aside_m() -> float:
        return float(np.hypot(*(OVAL.centreline_m - (ride.pose.x_m, ride.pose.y_m)).T).min())

    while aside_m() < 0.6:
        assert ride.step().mapped
    with monkeypatch.context() as changed:
        changed.setattr(racing, "_along_line", lambda *_: (NO_PATH, ON_LINE))
        plans = [ride.step()]
    while not plans[-1].mapped:
        plans.append(ride.step())
    assert len(plans) > 5 and not any(plan.lost for plan in plans) and min(plan.confidence for plan in plans) > 0.8
    assert max(math.hypot(*plan.path_m[0]) for plan in plans) < 0.3  # not beside the car
    assert not racing._leaving and racing._into_lane is None  # it is on its line again


HALF_WIDTH_M = 1.75
ROOM_M = HALF_WIDTH_M - 0.5 * CAR.width_m - CONE_RADIUS_M


def left_line() -> Racing:
    """The race planner of a car that has just left its line."""
    racing = Racing(CAR, PlannerSettings(), Motion())
    racing._leaving = True
    return racing


def straight_lane(left_m: float, turned_rad: float, driven_m: float = 0.0) -> Floats:
    """The middle of a straight lane, for a car so far left of it and turned to the left; it began as far behind."""
    along = np.arange(0.0, 30.0, STEP_M) + driven_m
    return to_vehicle(Motion(0, driven_m, left_m, turned_rad), np.column_stack((along, np.zeros(len(along)))))


@pytest.mark.parametrize("left_m", [-0.6, 0.0, 0.6])
@pytest.mark.parametrize("turned_rad", [-0.1, 0.0, 0.05])
def test_from_the_race_line_the_path_comes_into_the_lane(left_m: float, turned_rad: float) -> None:
    racing, motion = left_line(), Motion(speed_mps=8.0)
    lane = straight_lane(left_m, turned_rad)
    path = racing.into_lane(lane, HALF_WIDTH_M, motion)
    assert path[0] == pytest.approx([0.0, 0.0], abs=0.02)
    assert math.atan2(*(path[1] - path[0])[::-1]) == pytest.approx(0.0, abs=0.06)  # as the car points
    way_m = JOINING_M + JOINING_S * motion.speed_mps
    aside = np.hypot(*(path - lane).T)
    assert aside.max() < ROOM_M + 0.01 and aside[round(way_m / STEP_M) + 1] == 0.0
    # Further on the path is where it was: a car that follows it has come nearer to the middle.
    half = round(0.5 * way_m / STEP_M)
    later = racing.into_lane(lane[half:] - lane[half], HALF_WIDTH_M, replace(motion, distance_m=half * STEP_M))
    assert later[: len(path) - half] == pytest.approx(path[half:] - lane[half], abs=0.05)
    racing.into_lane(lane, HALF_WIDTH_M, replace(motion, distance_m=way_m + 1.0))
    assert racing.into_lane(lane, HALF_WIDTH_M, motion) is lane  # it has come


@pytest.mark.parametrize(
    ("left_m", "turned_rad"),
    [(1.0, 0.0), (0.5, 0.3), (0.0, 0.6), (1.0, -0.3)],
    ids=["beside", "nose", "turned", "inward"],
)
def test_a_car_out_of_its_lane_gets_no_way_into_it(left_m: float, turned_rad: float) -> None:
    racing, lane = left_line(), straight_lane(left_m, turned_rad)
    assert racing.into_lane(lane, HALF_WIDTH_M, Motion(speed_mps=8.0)) is lane
    # Another one that is found later has nothing to do with the race line.
    beside = straight_lane(0.5, 0.0)
    assert racing.into_lane(beside, HALF_WIDTH_M, Motion(speed_mps=8.0)) is beside


def test_an_older_look_finds_the_way_into_the_lane_begun() -> None:
    racing, lane = left_line(), straight_lane(0.6, 0.0)
    path = racing.into_lane(lane, HALF_WIDTH_M, Motion(speed_mps=8.0, distance_m=100.0))
    assert (racing.into_lane(lane, HALF_WIDTH_M, Motion(speed_mps=8.0, distance_m=99.0)) == path).all()


def test_a_line_laid_in_the_look_that_ends_the_race_is_left_too(monkeypatch: pytest.MonkeyPatch) -> None:
    ride, _ = mapped()
    racing: Any = ride.planner._strategy
    racing = racing._racing
    assert ride.step().mapped
    racing._next_line = racing._line
    monkeypatch.setattr(racing, "_along_line", lambda *_: (NO_PATH, ON_LINE))
    ride.step()
    assert racing._leaving


def test_a_car_that_races_goes_on_by_a_line_laid_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though the cones seen of late bear the map out less than they must where a car joins its first line."""
    ride, _ = mapped()
    racing: Any = ride.planner._strategy
    racing = racing._racing
    assert all(ride.step().mapped for _ in range(20))
    first, add = racing._line, racing._map.add

    def half_sure(*seen: Any) -> Motion:
        here: Motion = add(*seen)
        racing._map.fit = 0.6
        return here

    monkeypatch.setattr(racing._map, "add", half_sure)
    racing._map.changed = True
    assert all(ride.step().mapped for _ in range(20)) and racing._line is not first


def test_a_car_lost_in_the_map_follows_the_lane() -> None:
    ride, _ = mapped()
    elsewhere = ride.motion
    ride.motion = replace(elsewhere, x_m=elsewhere.x_m + 40.0, yaw_rad=elsewhere.yaw_rad + 1.0)
    for _ in range(3):  # until cones are known there
        ride.planner.on_cones(ride.see(), ride.motion)
    plans = [ride.step() for _ in range(8)]
    assert not plans[-1].mapped and "map" in plans[-1].note


@pytest.mark.parametrize("wrong", [1, pytest.param(1000, marks=pytest.mark.long)])
def test_a_map_closed_at_the_wrong_place_costs_no_cone(wrong: int, monkeypatch: pytest.MonkeyPatch) -> None:
    places = []  # the lap is closed at the first one; at the others the car is looked for in its map

    def elsewhere(*given: Any) -> Motion | None:
        found = located(*given)
        if found is None or len(places) >= wrong:
            return found
        places.append(replace(found, x_m=found.x_m + 2.0))
        return places[-1]

    monkeypatch.setattr(cone_map, "located", elsewhere)
    ride = Ride(WINDING)
    while ride.step().laps < 2:  # the whole lap behind it
        assert clearance_m(ride.pose, WINDING.cones_xy_m) > 0.05
    assert places


def test_two_false_cones_at_one_place_stop_no_race() -> None:
    ride, plan = mapped()
    place = ride.pose.ahead(*plan.path_m[16])  # 8 m ahead on the line
    true = ride.sensor
    cones, colors = np.vstack((OVAL.cones_xy_m, place)), np.append(OVAL.cone_colors, ConeColor.BLUE)
    ride.sensor = ConeSensor(replace(OVAL, cones_xy_m=cones, cone_colors=colors), SensorSettings(noise_level=0.0))
    plans = [ride.step() for _ in range(2)]
    ride.sensor = true
    assert all(plan.mapped for plan in (*plans, ride.step(), ride.step()))


def test_confidence_falls_as_looks_do_not_confirm_the_map() -> None:
    ride, _ = mapped()
    sure = ride.step().confidence
    ride.sensor = ConeSensor(replace(OVAL, cones_xy_m=OVAL.cones_xy_m + 1000.0), seed=1)
    first, second = ride.step(), ride.step()
    assert first.mapped and second.mapped
    assert 1.0 >= sure > 0.9 > first.confidence > second.confidence


def test_a_lap_after_joining_the_path_stays_where_it_was() -> None:
    ride, _ = mapped()
    before: list[tuple[float, float]] = []
    jumps = []
    for _ in range(round(1.3 * OVAL.length_m / STEP_M)):
        pose = ride.pose
        path = [pose.ahead(float(x), float(y)) for x, y in ride.step().path_m[:30]]
        if before:
            jumps.append(min(math.dist(before[12], point) for point in path))
        before = path
    assert max(jumps[30:]) < 0.15
