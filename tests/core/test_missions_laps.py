"""Counting the passages of a line."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.laps import Circling, LapCounter, LapState, advance_laps, gate_seen, staged

LAP_MIN_M = 20.0
RADIUS_M = 20.0


def straight_to(state: LapState, start_m: float, end_m: float, y_m: float = 0.0, yaw_rad: float = 0.0) -> LapState:
    x = start_m
    while x <= end_m:
        state = advance_laps(state, Motion(x_m=x, y_m=y_m, yaw_rad=yaw_rad, distance_m=x), LAP_MIN_M)
        x += 0.5
    return state


def circling(laps: float, drift_m_per_lap: float = 0.0, gate: bool = False, start: LapState | None = None) -> LapState:
    """Round a circle that touches the origin along x, the line 8 m ahead of it."""
    state = start or staged(Motion(), 8.0)
    length = 2.0 * math.pi * RADIUS_M
    for step in range(round(laps * length / 0.5)):
        way = step * 0.5
        angle = way / RADIUS_M
        drift = drift_m_per_lap * way / length
        here = Motion(
            x_m=RADIUS_M * math.sin(angle) + drift,
            y_m=RADIUS_M * (1.0 - math.cos(angle)),
            yaw_rad=math.remainder(angle, 2.0 * math.pi),
            distance_m=way,
        )
        along = (8.0 - way) % length
        if gate and along < 10.0:
            at = (way + along) / RADIUS_M
            state = gate_seen(
                state,
                RADIUS_M * math.sin(at) + drift,
                RADIUS_M * (1.0 - math.cos(at)),
                math.remainder(at, 2.0 * math.pi),
                here,
                LAP_MIN_M,
            )
        state = advance_laps(state, here, LAP_MIN_M)
    return state


def test_the_first_passage_begins_lap_1_and_completes_none() -> None:
    state = straight_to(staged(Motion(), 8.0), 0.0, 7.5)
    assert (state.passages, state.laps) == (0, 0)
    state = straight_to(state, 7.6, 9.0)
    assert (state.passages, state.laps) == (1, 0)


def test_a_passage_is_counted_once() -> None:
    assert straight_to(staged(Motion(), 8.0), 0.0, 40.0).passages == 1


@pytest.mark.parametrize("gate", [True, False])
@pytest.mark.parametrize("drift", [0.0, 3.0, -3.0])
def test_ten_laps_are_ten_with_or_without_drift_and_gate(gate: bool, drift: float) -> None:
    assert circling(10.5, drift, gate).laps == 10


@pytest.mark.parametrize("gate", [False, True])
def test_a_passage_says_whether_its_gate_was_seen(gate: bool) -> None:
    assert circling(2.2, 5.0, gate).sighted == gate


def test_standing_on_the_line_and_rocking_over_it_counts_once() -> None:
    state = staged(Motion(), 8.0)
    distance = 0.0
    for x in [*[0.5 * i for i in range(18)], *[7.5, 8.5] * 30]:
        distance += 0.5
        state = advance_laps(state, Motion(x_m=x, distance_m=min(distance, 19.0)), LAP_MIN_M)
    assert state.passages == 1


def test_a_line_beside_which_the_car_passes_is_not_passed() -> None:
    seen = gate_seen(staged(Motion(), 8.0), 8.0, 0.0, 0.0, Motion(), LAP_MIN_M)
    assert straight_to(seen, 0.0, 30.0, y_m=6.0).passages == 0


def test_a_line_assumed_beside_the_lane_is_laid_anew() -> None:
    """The car was staged in a bend of 6 m without a gate: straight ahead is no lane."""
    state, passed_m = staged(Motion(), 8.0), []
    for step in range(400):
        way_m = 0.5 * step
        bend = min(way_m, 3.0 * math.pi) / 6.0  # a quarter, then laps of a wider circle that comes back to it
        after = max(0.0, way_m - 3.0 * math.pi) / RADIUS_M
        x_m = 6.0 * math.sin(bend) - RADIUS_M * (1.0 - math.cos(after))
        y_m = 6.0 * (1.0 - math.cos(bend)) + RADIUS_M * math.sin(after)
        yaw_rad = math.remainder(bend + after, 2.0 * math.pi)
        before = state.passages
        state = advance_laps(state, Motion(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, distance_m=way_m), LAP_MIN_M)
        passed_m += [way_m] * (state.passages - before)
    assert passed_m[0] == pytest.approx(10.0, abs=1.0)
    assert passed_m[1] - passed_m[0] == pytest.approx(2.0 * math.pi * RADIUS_M, abs=1.0)


def test_a_line_that_is_passed_the_wrong_way_is_not_passed() -> None:
    state = gate_seen(staged(Motion(), 8.0), 8.0, 0.0, 0.0, Motion(), LAP_MIN_M)
    for step in range(60):
        here = Motion(x_m=20.0 - 0.5 * step, yaw_rad=math.pi, distance_m=0.5 * step)
        state = advance_laps(state, here, LAP_MIN_M)
    assert state.passages == 0


def test_the_rest_of_a_gate_just_passed_is_not_another_gate() -> None:
    state = gate_seen(staged(Motion(), 8.0), 8.0, 0.0, 0.0, Motion(), LAP_MIN_M)
    state = straight_to(state, 0.0, 9.0)
    here = Motion(x_m=9.0, distance_m=9.0)
    assert gate_seen(state, 10.0, 0.0, 0.0, here, LAP_MIN_M) == state


def sighted_start(lap_m: float = 500.0) -> LapState:
    """The line at 8 m was passed in sight of its gate, and a lap of way later the car is 20 m before it."""
    state = gate_seen(staged(Motion(), 8.0), 8.0, 0.0, 0.0, Motion(), LAP_MIN_M)
    state = straight_to(state, 0.0, 9.0)
    assert (state.passages, state.sighted) == (1, True)
    return along(state, lap_m - 12.0, lap_m - 12.0, lap_m)


def along(state: LapState, start_m: float, end_m: float, lap_m: float) -> LapState:
    """Drive along the straight at a lap's end, by the distance driven."""
    distance_m = start_m
    while distance_m <= end_m:
        state = advance_laps(state, Motion(x_m=distance_m - lap_m, distance_m=distance_m), LAP_MIN_M)
        distance_m += 0.5
    return state


@pytest.mark.parametrize("early_m", [1.0, 5.0, 13.0, 25.0, 40.0])
def test_a_passage_told_early_is_taken_back_at_sight_of_the_gate(early_m: float) -> None:
    state = along(sighted_start(), 488.0, 508.0 + max(0.0, early_m - 11.0), 500.0)
    assert (state.passages, state.sighted) == (2, False)
    at_m = 508.0 + max(0.0, early_m - 11.0)
    seen_from = Motion(x_m=at_m - 500.0, distance_m=at_m)
    state = gate_seen(state, 8.0 + early_m, 0.0, 0.0, seen_from, LAP_MIN_M)
    assert (state.passages, state.laps) == (1, 0)
    state = along(state, at_m, 507.5 + early_m, 500.0)
    assert state.passages == 1, "the gate has not been passed"
    assert along(state, 507.5 + early_m, 509.0 + early_m, 500.0).laps == 1


def test_a_lap_that_was_driven_is_not_taken_back_a_lap_later() -> None:
    state = along(sighted_start(), 488.0, 530.0, 500.0)
    assert (state.laps, state.sighted) == (1, False)
    seen = gate_seen(state, 8.0, 0.0, 0.0, Motion(x_m=-2.0, distance_m=998.0), LAP_MIN_M)
    assert seen.laps == 1


@pytest.mark.parametrize("way_m", [10.0, 40.0, 500.0])
def test_the_first_gate_in_sight_is_the_line_however_late(way_m: float) -> None:
    """The car began with the gate round a bend, or behind it."""
    state = straight_to(staged(Motion(), 8.0), 0.0, way_m)
    assert state.passages == 1
    state = gate_seen(state, way_m + 10.0, 0.0, 0.0, Motion(x_m=way_m, distance_m=way_m), LAP_MIN_M)
    assert state.passages == 0
    assert straight_to(state, way_m, way_m + 11.0).passages == 1


def test_a_gate_that_is_behind_the_car_takes_nothing_back() -> None:
    state = straight_to(staged(Motion(), 8.0), 0.0, 9.0)
    assert gate_seen(state, 8.5, 0.0, 0.0, Motion(x_m=9.0, distance_m=9.0), LAP_MIN_M).passages == 1


def test_a_gate_that_is_seen_replaces_the_line_that_was_assumed() -> None:
    state = gate_seen(staged(Motion(), 8.0), 11.0, 0.0, 0.0, Motion(), LAP_MIN_M)
    assert straight_to(state, 0.0, 10.5).passages == 0
    assert straight_to(state, 0.0, 11.5).passages == 1


def test_the_gate_seen_from_a_lane_that_comes_back_is_none() -> None:
    state = gate_seen(staged(Motion(), 8.0), 11.0, 0.0, 0.0, Motion(), LAP_MIN_M)
    back = Motion(x_m=20.0, y_m=-6.0, yaw_rad=math.pi, distance_m=45.0)
    assert gate_seen(state, 11.0, -4.0, math.pi, back, LAP_MIN_M) == state
    assert gate_seen(state, 11.5, 0.0, 0.1, replace(back, yaw_rad=0.0), LAP_MIN_M) != state


def test_a_lap_counter_counts_from_the_staging_place() -> None:
    """Round an oval of 102.8 m: the line is 8.17 m ahead of where the car began."""
    counter, laps = LapCounter(), []
    straight_m, radius_m = 20.0, 10.0
    lap_m = 2.0 * (straight_m + math.pi * radius_m)
    for step in range(1300):
        distance_m = 0.25 * step
        half, along_m = divmod(distance_m + 4.0, lap_m / 2.0)  # the car begins 4 m into the straight
        angle = max(0.0, along_m - straight_m) / radius_m
        x_m = min(along_m, straight_m) - 4.0 + radius_m * math.sin(angle)
        y_m = radius_m * (1.0 - math.cos(angle))
        if half % 2.0:
            x_m, y_m, angle = straight_m - 8.0 - x_m, 2.0 * radius_m - y_m, angle + math.pi
        laps.append(counter.laps(Motion(x_m=x_m, y_m=y_m, yaw_rad=angle, distance_m=distance_m)))
    assert laps == sorted(laps) and laps[-1] == 3
    assert laps.index(1) * 0.25 == pytest.approx(lap_m + 8.17, abs=1.0)


def test_the_way_driven_is_none_of_just_now_or_the_laps_end() -> None:
    circle, state = Circling(), staged(Motion(), 8.0)
    for x_m in range(101):
        here = Motion(x_m=float(x_m), distance_m=float(x_m))
        circle.length_m(state, here)
    every = [x_m for x_m, _ in circle.driven(here, 1000.0, 1000.0)]
    assert (min(every), max(every)) == (30.0, 88.0)
    assert min(circle.driven(here, 20.0, 1000.0)) == (82.0, 0.0)
    assert min(circle.driven(here, 1000.0, 60.0)) == (40.0, 0.0)


def test_a_car_that_drives_its_way_again_is_not_kept_from_it() -> None:
    circle, state = Circling(), staged(Motion(), 8.0)
    for way_m in range(150):  # a circle of 126 m
        angle = way_m / RADIUS_M
        x_m, y_m = RADIUS_M * math.sin(angle), RADIUS_M * (1.0 - math.cos(angle))
        here = Motion(x_m=x_m, y_m=y_m, yaw_rad=angle, distance_m=float(way_m))
        circle.length_m(state, here)
    assert circle.driven(here, 1000.0, 1000.0) == []
