"""The planner as its users see it, with the small rig as the car."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from driving_rig import Eyes, Result, Rig, Track, along_midline, figure_of_eight, oval, straight_lane, winding

from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026, VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState

HALF_WIDTH_M = 1.75
WORN = Eyes(noise_m=0.1, miss=0.1)
BLIND_TO_COLOR = Eyes(noise_m=0.1, miss=0.1, colors=False)


def driven(
    track: Track,
    mission: Ami,
    eyes: Eyes | None = None,
    laps: int = 2,
    car: VehicleParameters = ADS_DV_2026,
    seed: int = 1,
    seconds: float = 150.0,
) -> tuple[Rig, Result]:
    missions = MissionSettings(trackdrive_laps=laps)
    rig = Rig(track, mission, car, Planner(car, missions=missions), Controller(car, missions=missions), eyes, seed)
    return rig, rig.drive(seconds)


def assert_clean(result: Result, line_m: np.ndarray, laps: int) -> None:
    assert result.hits == set()
    assert result.off_line_m(line_m) < HALF_WIDTH_M - 0.5 * ADS_DV_2026.width_m
    assert (result.finished, result.stands, result.laps) == (True, True, laps)


@pytest.mark.parametrize(
    "eyes",
    [WORN, BLIND_TO_COLOR, replace(WORN, false_per_look=0.3)],
    ids=["colors", "no colors", "false cones"],
)
@pytest.mark.parametrize("car", [ADS_DV_2021, ADS_DV_2026], ids=lambda car: car.name)
def test_an_oval_is_driven_for_its_laps_without_leaving_the_lane(eyes: Eyes, car: VehicleParameters) -> None:
    line = oval()
    _, result = driven(along_midline(line, HALF_WIDTH_M, 4.0), Ami.TRACKDRIVE, eyes, laps=3, car=car)
    assert_clean(result, line, laps=3)


@pytest.mark.parametrize("eyes", [WORN, BLIND_TO_COLOR], ids=["colors", "no colors"])
def test_bends_to_both_sides_are_driven_without_leaving_the_lane(eyes: Eyes) -> None:
    line = winding()
    _, result = driven(along_midline(line, HALF_WIDTH_M, 4.0), Ami.TRACKDRIVE, eyes, laps=2)
    assert_clean(result, line, laps=2)


def test_an_autocross_is_one_lap_and_a_stop_within_30_m() -> None:
    line = oval()
    rig, result = driven(along_midline(line, HALF_WIDTH_M, 4.0), Ami.AUTOCROSS, WORN)
    assert_clean(result, line, laps=1)
    crossed = next(plan for plan in result.plans if plan.finished)
    at = next(motion.distance_m for motion in result.motions if motion.t_ns >= crossed.t_sensor_ns)
    length = 2 * 25.0 + 2 * math.pi * 9.0
    assert at == pytest.approx(6.0 + 2.17 + length, abs=2.5)
    assert 5.0 < rig.motion.distance_m - at < 28.0


def test_laps_without_a_gate_count_at_the_return_to_the_start() -> None:
    line = oval()
    track = along_midline(line, HALF_WIDTH_M, 4.0)
    gateless = track.color != ConeColor.BIG_ORANGE
    track = Track(track.xy_m[gateless], track.color[gateless], track.start, line)
    _, result = driven(track, Ami.TRACKDRIVE, WORN, laps=3)
    assert_clean(result, line, laps=3)


def test_a_gate_beyond_the_lane_border_belongs_to_another_lane() -> None:
    """A second lane passes the gate's far side, as on tracks whose two sides lie back to back."""
    xy, color = [], []
    for x in np.arange(0.0, 60.0, 3.0):
        xy += [(x, 1.75), (x, -1.75)]
        color += [int(ConeColor.BLUE), int(ConeColor.YELLOW)]
    for x in (29.8, 30.8):
        xy += [(x, 4.2), (x, 7.7)]
        color += [int(ConeColor.BIG_ORANGE)] * 2
    rig, result = driven(Track(np.array(xy), np.array(color), (1.0, 0.0, 0.0)), Ami.TRACKDRIVE, seconds=14.0, laps=1)
    assert rig.x > 40.0
    assert not any(plan.finished for plan in result.plans)


def test_the_same_run_gives_the_same_plans() -> None:
    track = along_midline(winding(), HALF_WIDTH_M, 4.0)
    _, first = driven(track, Ami.TRACKDRIVE, BLIND_TO_COLOR, seconds=12.0)
    _, second = driven(track, Ami.TRACKDRIVE, BLIND_TO_COLOR, seconds=12.0)
    assert len(first.plans) == len(second.plans) > 50
    for one, other in zip(first.plans, second.plans, strict=True):
        assert np.array_equal(one.path_m, other.path_m)


@pytest.mark.parametrize("car", [ADS_DV_2021, ADS_DV_2026], ids=lambda car: car.name)
def test_the_acceleration_is_straight_and_ends_within_100_m(car: VehicleParameters) -> None:
    rig, result = driven(straight_lane(), Ami.ACCELERATION, replace(WORN, false_per_look=0.2), car=car, seconds=40.0)
    assert result.hits == set()
    assert max(abs(y) for _, y in result.path_m) < 0.4
    assert result.finished and result.stands
    assert 77.5 < rig.x < 77.5 + 100.0


def test_acceleration_goes_straight_from_an_oblique_start() -> None:
    track = replace(straight_lane(), start=(0.0, 0.2, 0.03))
    _, result = driven(track, Ami.ACCELERATION, WORN, seconds=40.0)
    assert result.hits == set()
    assert max(abs(y) for x, y in result.path_m if x > 30.0) < 0.4


def test_acceleration_has_full_throttle_to_the_finish() -> None:
    _, result = driven(straight_lane(), Ami.ACCELERATION, WORN, seconds=40.0)
    for command, (x, _) in zip(result.commands, result.path_m, strict=True):
        if 0.5 < x < 75.0:
            assert command.throttle > 0.95
            assert command.brake == 0.0


def test_cones_that_close_the_exit_lane_are_not_driven_over() -> None:
    track = straight_lane()
    wall = np.array([[77.5 + 24.5, y] for y in (-0.75, 0.0, 0.75)])
    shorter = track.xy_m[:, 0] < 77.5 + 25.0
    closed = Track(
        np.vstack((track.xy_m[shorter], wall)),
        np.concatenate((track.color[shorter], [int(ConeColor.ORANGE)] * 3)),
        track.start,
    )
    _, result = driven(closed, Ami.ACCELERATION, WORN, seconds=40.0)
    assert result.hits == set()
    assert result.stands


@pytest.mark.parametrize("car", [ADS_DV_2021, ADS_DV_2026], ids=lambda car: car.name)
@pytest.mark.parametrize("eyes", [WORN, BLIND_TO_COLOR], ids=["colors", "no colors"])
def test_skidpad_is_two_laps_right_two_left_and_a_stop_in_25_m(car: VehicleParameters, eyes: Eyes) -> None:
    rig, result = driven(figure_of_eight(), Ami.SKIDPAD, eyes, car=car, seconds=90.0)
    assert result.hits == set()
    assert (result.finished, result.stands, result.laps) == (True, True, 4)
    assert 0.0 < rig.x < 25.0
    assert abs(rig.y) < 0.5
    turned = np.diff(np.unwrap([math.atan2(y + 9.125, x) for x, y in result.path_m if y < -0.5]))
    assert np.abs(turned.sum()) == pytest.approx(4.0 * math.pi, abs=1.2)
    sides = [np.sign(y) for _, y in result.path_m if abs(y) > 5.0]
    changes = [side for side, last in zip(sides[1:], sides, strict=False) if side != last]
    assert (sides[0], changes) == (-1.0, [1.0])


@pytest.mark.parametrize("staged_m", [-20.0, -14.5])
def test_skidpad_is_found_from_a_displaced_start(staged_m: float) -> None:
    rig, result = driven(figure_of_eight(staged_m), Ami.SKIDPAD, WORN, seconds=90.0)
    assert result.hits == set()
    assert result.laps == 4
    assert 0.0 < rig.x < 25.0


def test_odometrys_drift_does_not_matter_on_the_skidpad() -> None:
    missions = MissionSettings()
    car = ADS_DV_2026
    rig = Rig(
        figure_of_eight(),
        Ami.SKIDPAD,
        car,
        Planner(car, missions=missions),
        Controller(car, missions=missions),
        WORN,
        speed_error=0.03,
        yaw_rate_error_radps=0.01,
    )
    result = rig.drive(90.0)
    assert result.hits == set()
    assert result.laps == 4
    assert 0.0 < rig.x < 25.0


@pytest.mark.parametrize("mission", [Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B, Ami.AUTONOMOUS_DEMO])
def test_missions_without_a_path_get_no_plan(mission: Ami) -> None:
    planner = Planner(ADS_DV_2026)
    planner.reset(Run(1, mission))
    assert planner.on_cones(observation([(5.0, 1.5)]), Motion()) is None


def observation(xy: list[tuple[float, float]], t_ns: int = 0) -> ConeObservation:
    count = len(xy)
    return ConeObservation(t_ns, np.array(xy).reshape(-1, 2), np.zeros(count, dtype=np.int64), np.full(count, 0.9))


LANE = [(float(x), y) for x in range(0, 16, 3) for y in (1.6, -1.6)]


def planner_for(mission: Ami) -> Planner:
    planner = Planner(ADS_DV_2026)
    planner.reset(Run(3, mission))
    return planner


@pytest.mark.parametrize("mission", [Ami.AUTOCROSS, Ami.TRACKDRIVE, Ami.ACCELERATION, Ami.SKIDPAD])
def test_a_plan_carries_stamp_run_and_mission(mission: Ami) -> None:
    plan = planner_for(mission).on_cones(observation(LANE, t_ns=123), Motion(t_ns=100))
    assert plan is not None
    assert (plan.t_sensor_ns, plan.run_id, plan.mission) == (123, 3, mission)
    assert plan.cones_count_actual == len(LANE)


@pytest.mark.parametrize("mission", [Ami.AUTOCROSS, Ami.ACCELERATION, Ami.SKIDPAD])
@pytest.mark.parametrize("xy", [[], [(math.nan, 1.0), (5.0, math.inf)], [(0.0, 0.0)] * 5])
def test_an_observation_without_any_good_cone_does_no_harm(mission: Ami, xy: list[tuple[float, float]]) -> None:
    planner = planner_for(mission)
    for step in range(4):
        plan = planner.on_cones(observation(xy, step * 100_000_000), Motion(t_ns=step * 100_000_000))
        assert plan is not None
        assert np.isfinite(plan.path_m).all()


def test_the_last_path_is_kept_for_one_second_without_cones() -> None:
    planner = planner_for(Ami.AUTOCROSS)
    second = 1_000_000_000
    for step in range(3):
        plan = planner.on_cones(observation(LANE, step), Motion(t_ns=step))
    assert plan is not None and len(plan.path_m) > 10
    for t_ns, kept in ((second, True), (second + 3, False)):
        # Seen again nowhere near: the memory drops the cones, for the car has been turned round.
        there = Motion(t_ns=t_ns, x_m=2.0, distance_m=400.0)
        plan = planner.on_cones(observation([], t_ns), there)
        assert plan is not None
        assert (len(plan.path_m) > 0) is kept


def test_a_reset_forgets_cones_and_laps() -> None:
    planner = planner_for(Ami.TRACKDRIVE)
    for step in range(3):
        planner.on_cones(observation(LANE, step), Motion(t_ns=step))
    planner.reset(Run(4, Ami.TRACKDRIVE))
    plan = planner.on_cones(observation([], 10), Motion(t_ns=10))
    assert plan is not None
    assert (plan.run_id, len(plan.path_m), plan.cones_count_all, plan.laps) == (4, 0, 0, 0)


def test_odometry_that_begins_anew_makes_the_planner_forget() -> None:
    planner = planner_for(Ami.TRACKDRIVE)
    for step in range(3):
        planner.on_cones(observation(LANE, step), Motion(t_ns=step, distance_m=50.0))
    plan = planner.on_cones(observation([], 10), Motion(t_ns=10, distance_m=0.0))
    assert plan is not None
    assert plan.cones_count_all == 0


def test_another_run_or_mission_resets_and_the_same_run_does_not() -> None:
    planner = planner_for(Ami.TRACKDRIVE)
    for step in range(3):
        planner.on_cones(observation(LANE, step), Motion(t_ns=step))
    planner.on_run(Run(3, Ami.TRACKDRIVE, AsState.AS_READY))
    plan = planner.on_cones(observation(LANE, 5), Motion(t_ns=5))
    assert plan is not None and plan.cones_count_all > 0
    planner.on_run(Run(3, Ami.AUTOCROSS, AsState.AS_READY))
    assert planner.run.mission is Ami.AUTOCROSS
    plan = planner.on_cones(observation(LANE, 6), Motion(t_ns=6))
    assert plan is not None
    assert (plan.mission, plan.cones_count_all) == (Ami.AUTOCROSS, 0)


def test_the_staging_place_is_where_the_pushed_car_starts() -> None:
    planner = planner_for(Ami.ACCELERATION)
    pushed = Motion(t_ns=5, x_m=40.0, y_m=30.0, yaw_rad=1.0, distance_m=60.0)
    planner.on_cones(observation([], 5), pushed)
    planner.on_run(Run(3, Ami.ACCELERATION, AsState.AS_READY))
    planner.on_run(Run(3, Ami.ACCELERATION, AsState.AS_DRIVING))
    plan = planner.on_cones(observation([], 6), replace(pushed, t_ns=6))
    assert plan is not None
    assert not plan.finished
    assert plan.path_m[:, 1] == pytest.approx(np.zeros(len(plan.path_m)), abs=1e-6)
    assert plan.path_m[-1, 0] > 50.0
