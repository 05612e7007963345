"""The planner as its users see it, with the simulated car around it where it drives."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lap_rig import Ride, clearance_m
from msgspec.structs import replace

from fsai_hil.simulator.sensing import SensorSettings
from fsai_hil.simulator.tracks import random_circuit
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Plan, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning import lap_strategy
from fsai_vcu.core.planning.cone_memory import Cones
from fsai_vcu.core.planning.lane import Known, Lane, find_lane
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.planning.pose import NO_PATH, gaps, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami, AsState

WINDING = random_circuit(1)
NOSE_M = ADS_DV_2026.nose_ahead_of_rear_axle_m
EARLY_M = 0.06  # by which odometry is further on after each step
BIG = int(ConeColor.BIG_ORANGE)


def test_a_winding_lane_is_kept_to_without_colours() -> None:
    ride = Ride(WINDING, laps=1, sensor=SensorSettings(colours=False))
    while not ride.step().finished:
        assert clearance_m(ride.pose, WINDING.cones_xy_m) > 0.0 and ride.motion.distance_m < 1.2 * WINDING.length_m
    assert ride.motion.distance_m > WINDING.length_m


def test_a_gate_beyond_the_lane_border_belongs_to_another_lane() -> None:
    """A second lane passes the gate's far side, as on tracks whose two sides lie back to back."""
    lane = [(x, y) for x in np.arange(0.0, 60.0, 3.0) for y in (1.75, -1.75)]
    xy = np.array([*lane, *((x, y) for x in (29.8, 30.8) for y in (4.2, 7.7))])
    color = np.array([int(ConeColor.BLUE), int(ConeColor.YELLOW)] * 20 + [BIG] * 4)
    planner = Planner(ADS_DV_2026, missions=MissionSettings(trackdrive_laps=1))
    planner.reset(Run(3, Ami.TRACKDRIVE))
    for x in np.arange(1.0, 45.0, 0.4):
        seen = (xy[:, 0] > x) & (xy[:, 0] < x + 14.0)
        t_ns = round(x * 1e8)
        observation = ConeObservation(t_ns, xy[seen] - (x, 0.0), color[seen], np.ones(int(seen.sum())))
        plan = planner.on_cones(observation, Motion(t_ns, x_m=x, speed_mps=4.0, distance_m=x))
        assert plan is not None and (plan.laps, plan.finished) == (0, False)


def test_a_lap_ends_at_its_gate_though_odometry_is_early() -> None:
    """Odometry has come to the line before the gate is in sight; the car stops behind the gate all the same."""
    ride, early = Ride(WINDING, laps=1), False
    while not ((plan := ride.step()).finished and plan.stop_distance_m is not None and plan.stop_distance_m < 0.5):
        assert ride.motion.distance_m < 1.2 * WINDING.length_m
        if 30.0 < ride.motion.distance_m < WINDING.length_m - 30.0:
            ride.motion = replace(ride.motion, x_m=ride.motion.x_m + EARLY_M)
        early |= plan.finished and ride.pose.ahead(NOSE_M)[0] < -8.0
    assert early, "else odometry was not early enough to show anything"
    assert 0.0 < ride.pose.ahead(NOSE_M)[0] < 30.0


@pytest.mark.parametrize("mission", [Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B, Ami.AUTONOMOUS_DEMO])
def test_missions_without_a_path_get_no_plan(mission: Ami) -> None:
    planner = Planner(ADS_DV_2026)
    planner.reset(Run(1, mission))
    assert planner.on_cones(observation([(5.0, 1.5)]), Motion()) is None


@pytest.mark.parametrize("step_m", (2.0, 2.5, 3.5))
@pytest.mark.parametrize("side", (1.6, -1.6))
def test_two_wrong_colours_in_a_row_do_not_bend_the_path(side: float, step_m: float) -> None:
    xy = np.array([(step_m * place, y) for place in range(30) for y in (1.6, -1.6)])
    blue = (xy[:, 1] > 0.0) ^ ((xy[:, 1] == side) & np.isin(xy[:, 0], (5.0 * step_m, 6.0 * step_m)))
    planner = planner_for(Ami.AUTOCROSS)
    for x in np.arange(0.0, 25.0, 0.5):
        ahead = xy - (x, 0.0)
        seen = (np.hypot(*ahead.T) < 15.0) & (ahead[:, 0] > 1.0)
        color = np.where(blue, ConeColor.BLUE, ConeColor.YELLOW)[seen]
        observation = ConeObservation(round(x * 1e8), ahead[seen], color, np.ones(len(color)))
        plan = planner.on_cones(observation, Motion(observation.t_ns, x_m=x, speed_mps=5.0, distance_m=x))
        assert plan is not None and np.abs(plan.path_m[:, 1]).max(initial=0.0) < 0.2


def test_a_way_that_leads_in_a_circle_is_given_up_with_a_word() -> None:
    """The course goes on straight; the car was led round a ring that never passes the line."""
    ahead = [(x, y) for x in np.arange(0.0, 45.0, 3.0) for y in (1.6, -1.6)]
    turns = np.arange(0.3, 2.0 * np.pi - 0.3, 0.3)
    ring = [(30.0 + r * np.sin(a), 10.0 - r * np.cos(a)) for a in turns for r in (8.4, 11.6)]
    xy, planner = np.array(ahead + ring), planner_for(Ami.AUTOCROSS)
    notes = {}
    for s in np.arange(0.0, 160.0, 0.5):
        turn = max(0.0, s - 30.0) / 10.0
        motion = Motion(
            round(s * 1e8),
            min(s, 30.0) + 10.0 * np.sin(turn),
            10.0 - 10.0 * np.cos(turn),
            turn,
            5.0,
            0.5 if turn else 0.0,
            distance_m=s,
        )
        seen = to_vehicle(motion, xy)
        seen = seen[(np.hypot(*seen.T) < 15.0) & (seen[:, 0] > 1.0)]
        plan = planner.on_cones(observation(list(map(tuple, seen.tolist())), motion.t_ns), motion)
        assert plan is not None
        assert s == 0.0 or (plan.supported_m > NOSE_M) == (not plan.lost and "circle" not in plan.note)
        notes[s] = plan.note
    assert not any("circle" in note for s, note in notes.items() if s < 92.0)
    assert all("a circle of 62 m that does not pass the line" in note for s, note in notes.items() if s > 110.0)


NONE = np.zeros(0, dtype=np.int64)


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


def after_three_looks(mission: Ami = Ami.AUTOCROSS) -> tuple[Planner, Plan]:
    planner = planner_for(mission)
    for step in range(3):
        plan = planner.on_cones(observation(LANE, step), Motion(t_ns=step))
    assert plan is not None and len(plan.path_m) > 10
    return planner, plan


def test_without_cones_a_path_is_kept_as_far_as_borne_out() -> None:
    planner, plan = after_three_looks()
    for driven_m in (0.0, 3.0, plan.supported_m - 4.0, plan.supported_m + 0.1):
        kept = planner.on_cones(observation([], 1_000_000_000), Motion(1_000_000_000, driven_m, distance_m=driven_m))
        left_m = plan.supported_m - driven_m
        assert kept is not None and (len(kept.path_m) > 0) is (left_m > 0.0)
        assert kept.supported_m == pytest.approx(max(0.0, left_m))
        assert kept.note == "no cones are seen" + ": path kept from 1.0 s ago" * (left_m > 0.0)


def test_a_path_is_kept_as_far_as_the_looks_before_it_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last look before the detector fails may be the one that false cones have bent."""
    planner, plan = after_three_looks()
    assert plan.supported_m > 9.0

    def bent(cones: Cones, *known: Any) -> Lane:
        lane = find_lane(cones, *known)
        path = lane.path_m.copy()
        path[10:, 1] += 0.2 * np.arange(1, len(path) - 9)
        return replace(lane, path_m=path)

    monkeypatch.setattr(lap_strategy, "find_lane", bent)
    planner.on_cones(observation(LANE, 4), Motion(4))
    kept = planner.on_cones(observation([], 5), Motion(5))
    assert kept is not None and len(kept.path_m) > 0
    assert 4.5 < kept.supported_m < 6.5


@pytest.mark.parametrize(("speed_mps", "hz"), [(5.0, 20), (5.0, 4), (12.0, 10)])
def test_a_slow_detector_keeps_its_path_as_well(speed_mps: float, hz: int) -> None:
    lane = [(x, y) for x in np.arange(0.0, 80.0, 3.0) for y in (1.5, -1.5)]
    planner = planner_for(Ami.AUTOCROSS)
    for look in range(round(40.0 / speed_mps * hz) + 1):
        x_m, t_ns = look * speed_mps / hz, look * 1_000_000_000 // hz
        there = Motion(t_ns, x_m, speed_mps=speed_mps, distance_m=x_m)
        seen = [(x - x_m, y) for x, y in lane if 0.5 < x - x_m < 13.0]
        plan = planner.on_cones(observation(seen if x_m < 40.0 else [], t_ns), there)
    assert plan is not None and plan.supported_m > 3.0 and plan.confidence > 0.9


@pytest.mark.parametrize(
    ("speed_mps", "colored", "doubted"), [(2.0, True, False), (8.0, True, True), (2.0, False, True)]
)
def test_a_fork_is_a_doubt_by_speed_and_by_colours(
    monkeypatch: pytest.MonkeyPatch, speed_mps: float, colored: bool, doubted: bool
) -> None:
    """Ways that part so far ahead: a slow car among cones with colours sees more of them before it has to know."""
    planner, asked = planner_for(Ami.AUTOCROSS), []
    monkeypatch.setattr(
        lap_strategy, "find_lane", lambda cones, known, *_: asked.append(known) or find_lane(cones, known, *_)
    )
    colour = {True: (int(ConeColor.BLUE), int(ConeColor.YELLOW)), False: (0, 0)}[colored]
    for step in range(60):
        look = ConeObservation(step, np.array(LANE), np.array([colour[y < 0.0] for _, y in LANE]), np.ones(len(LANE)))
        planner.on_cones(look, Motion(step, speed_mps=speed_mps))
    assert bool(asked[-1].need_m > 8.0) is doubted


def test_with_cones_that_are_no_lane_a_path_is_kept_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    planner, _ = after_three_looks()
    nowhere = find_lane(Cones(NO_PATH, NONE, NONE, NONE), Known(0.0, 1.5), 0.0, PlannerSettings())
    monkeypatch.setattr(lap_strategy, "find_lane", lambda cones, *_: replace(nowhere, side=np.zeros(len(cones.index))))
    second = 1_000_000_000
    for t_ns, kept in ((second, True), (second + 3, False)):
        plan = planner.on_cones(observation(LANE, t_ns), Motion(t_ns=t_ns))
        assert plan is not None and (len(plan.path_m) > 0) is kept and plan.confidence < 0.1
        assert plan.note == "no cones" + ": path kept from 1.0 s ago" * kept


def test_the_way_is_borne_out_no_further_than_cones_are_seen() -> None:
    planner, plan = after_three_looks()
    assert plan.supported_m > 8.0
    near = [(x, y) for x, y in LANE if math.hypot(x, y) < 6.0]
    planner._memory.view_m = 0.0
    plan = planner.on_cones(observation(near, 3), Motion(t_ns=3))
    assert plan is not None and plan.supported_m < 6.0


def test_a_car_that_stands_learns_no_sides_from_its_looks() -> None:
    planner, _ = after_three_looks()
    assert not planner._memory._cones["side"].any()
    planner.on_cones(observation(LANE, 4), Motion(t_ns=4, distance_m=0.1))
    assert planner._memory._cones["side"].any()


def test_a_slow_car_learns_sides_however_often_it_looks() -> None:
    planner, _ = after_three_looks()
    for step in range(1, 30):
        planner.on_cones(observation(LANE, 4 + step), Motion(t_ns=4 + step, distance_m=0.001 * step))
    assert planner._memory._cones["side"].any()


def test_among_false_cones_only_sure_ones_make_the_lane(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Floats] = []

    def looked_at(cones: Cones, *others: Any) -> Lane:
        given.append(cones.xy_m)
        return find_lane(cones, *others)

    monkeypatch.setattr(lap_strategy, "find_lane", looked_at)
    planner, draw = planner_for(Ami.AUTOCROSS), np.random.default_rng(1)
    for step in range(60):
        false = draw.uniform((2.0, -6.0), (12.0, 6.0), (8, 2))
        planner.on_cones(observation([*LANE, *map(tuple, false)], step), Motion(t_ns=step))
    off_m = [gaps(xy_m, np.array(LANE)).min(axis=1) for xy_m in given[20:]]
    assert all(len(off) >= len(LANE) - 2 for off in off_m)
    assert np.mean(np.concatenate(off_m) > 1.0) < 0.1


def resets(planner: Planner) -> None:
    planner.reset(Run(4, Ami.TRACKDRIVE))


def another_mission(planner: Planner) -> None:
    planner.on_run(Run(3, Ami.AUTOCROSS, AsState.AS_READY))


def another_run(planner: Planner) -> None:
    planner.on_run(Run(4, Ami.TRACKDRIVE, AsState.AS_READY))


def same_run(planner: Planner) -> None:
    planner.on_run(Run(3, Ami.TRACKDRIVE, AsState.AS_READY))


@pytest.mark.parametrize(
    ("happens", "distance_m", "forgets"),
    [
        (resets, 50.0, True),
        (another_mission, 50.0, True),
        (another_run, 50.0, True),
        (same_run, 0.0, True),  # odometry began again
        (same_run, 50.0, False),
    ],
)
def test_a_new_run_or_odometry_makes_the_planner_forget(
    happens: Callable[[Planner], None], distance_m: float, forgets: bool
) -> None:
    planner = planner_for(Ami.TRACKDRIVE)
    for step in range(3):
        planner.on_cones(observation(LANE, step), Motion(t_ns=step, distance_m=50.0))
    happens(planner)
    plan = planner.on_cones(observation([], 10), Motion(t_ns=10, distance_m=distance_m))
    assert plan is not None and (plan.run_id, plan.mission) == (planner.run.run_id, planner.run.mission)
    assert (plan.cones_count_all == 0 and not len(plan.path_m)) is forgets


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
