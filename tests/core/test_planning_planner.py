"""The planner as its users see it, with the small rig as the car."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from driving_rig import Eyes, Result, Rig, Track, staged

from fsai_hil.simulator.tracks import acceleration_track, random_circuit, skidpad_track, small_oval
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026, VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState

OVAL = staged(small_oval(), Ami.TRACKDRIVE)
WINDING = staged(random_circuit(1), Ami.TRACKDRIVE)
STRAIGHT = staged(acceleration_track(), Ami.ACCELERATION)
FINISH_M = 75.0  # there
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


def assert_clean(track: Track, result: Result) -> None:
    assert result.hits == set()
    assert track.midline_m is not None and result.off_line_m(track.midline_m) < 1.75 - 0.5 * ADS_DV_2026.width_m
    assert (result.finished, result.stands, result.laps) == (True, True, 2)


@pytest.mark.parametrize(
    ("track", "eyes", "car"),
    [
        (OVAL, replace(WORN, false_per_look=0.3), ADS_DV_2021),
        (WINDING, BLIND_TO_COLOR, ADS_DV_2026),
    ],
    ids=["oval, false cones", "winding, no colors"],
)
def test_a_trackdrive_keeps_to_its_lane_for_all_laps(track: Track, eyes: Eyes, car: VehicleParameters) -> None:
    _, result = driven(track, Ami.TRACKDRIVE, eyes, car=car)
    assert_clean(track, result)


def test_laps_without_a_gate_count_at_the_return_to_the_start() -> None:
    gateless = OVAL.color != ConeColor.BIG_ORANGE
    track = replace(OVAL, xy_m=OVAL.xy_m[gateless], color=OVAL.color[gateless])
    _, result = driven(track, Ami.TRACKDRIVE, WORN)
    assert_clean(track, result)


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
    _, first = driven(WINDING, Ami.TRACKDRIVE, BLIND_TO_COLOR, seconds=12.0)
    _, second = driven(WINDING, Ami.TRACKDRIVE, BLIND_TO_COLOR, seconds=12.0)
    assert len(first.plans) == len(second.plans) > 50
    for one, other in zip(first.plans, second.plans, strict=True):
        assert np.array_equal(one.path_m, other.path_m)


def test_acceleration_goes_straight_from_an_oblique_start() -> None:
    track = replace(STRAIGHT, start=(STRAIGHT.start[0], 0.2, 0.03))
    _, result = driven(track, Ami.ACCELERATION, WORN, seconds=40.0)
    assert result.hits == set()
    assert max(abs(y) for x, y in result.path_m if x > 30.0) < 0.4


def test_acceleration_has_full_throttle_to_the_finish() -> None:
    _, result = driven(STRAIGHT, Ami.ACCELERATION, WORN, seconds=40.0)
    for command, (x, _) in zip(result.commands, result.path_m, strict=True):
        if STRAIGHT.start[0] + 0.5 < x < FINISH_M - 2.5:
            assert command.throttle > 0.95
            assert command.brake == 0.0


def test_cones_that_close_the_exit_lane_are_not_driven_over() -> None:
    wall = np.array([[FINISH_M + 24.5, y] for y in (-0.75, 0.0, 0.75)])
    shorter = STRAIGHT.xy_m[:, 0] < FINISH_M + 25.0
    closed = replace(
        STRAIGHT,
        xy_m=np.vstack((STRAIGHT.xy_m[shorter], wall)),
        color=np.concatenate((STRAIGHT.color[shorter], [int(ConeColor.ORANGE)] * 3)),
    )
    _, result = driven(closed, Ami.ACCELERATION, WORN, seconds=40.0)
    assert result.hits == set()
    assert result.stands


@pytest.mark.parametrize(("back_m", "eyes"), [(2.8, WORN), (-2.7, BLIND_TO_COLOR)])
def test_skidpad_is_found_from_a_displaced_start(back_m: float, eyes: Eyes) -> None:
    rig, result = driven(staged(skidpad_track(), Ami.SKIDPAD, back_m), Ami.SKIDPAD, eyes, seconds=90.0)
    assert result.hits == set()
    assert result.laps == 4
    assert 0.0 < rig.x < 25.0


def test_odometrys_drift_does_not_matter_on_the_skidpad() -> None:
    missions = MissionSettings()
    car = ADS_DV_2026
    rig = Rig(
        staged(skidpad_track(), Ami.SKIDPAD),
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
