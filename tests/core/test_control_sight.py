"""Driving by sight: which looks earn it, and what ends it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.control.sight import (
    BEYOND_CONES_M,
    CLEAR,
    CLEAR_AGAIN_M,
    CLEAR_APART_M,
    CLEAR_M,
    CLEAR_OVER_M,
    DOUBTFUL,
    STEADY_M,
    Sight,
    stopping_m,
    stops_from_m2ps2,
)
from fsai_vcu.core.control.speed_profile import braking_share
from fsai_vcu.core.planning.planner import DOUBT_BY_CONES
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami

BRAKING_MPS2, REACTION_S, AGE_S, SPEED_MPS = 6.0, 0.1, 0.1, 9.0
SIGHT_M = CLEAR_M + 1.0
HERE = np.zeros(1)
Looks = list[tuple[float, float, float]]  # how far driven, confidence, sight


def looks(way_m: float, every_m: float = 0.5, confidence: float = 1.0, sight_m: float = SIGHT_M) -> Looks:
    return [(at_m, confidence, sight_m) for at_m in np.arange(0.0, way_m, every_m).tolist()]


def allowed_mps(seen: Looks, ahead_m: float = 0.0, bend_1pm: float = 0.0) -> float:
    """The speed allowed after the last look, so far ahead of it, in such a bend; 0 where the car must be careful."""
    sight = Sight()
    square = math.nan
    for at_m, confidence, sight_m in seen:
        sight.look(confidence, sight_m, sight_m, at_m, AGE_S)
        square = float(sight.ceiling(BRAKING_MPS2, REACTION_S, bend_1pm, at_m, SPEED_MPS, HERE + at_m + ahead_m)[0])
    return math.sqrt(square)


def test_what_sight_takes_from_planner_and_car_is_so() -> None:
    """Displaced cones alone never make a look sure; the rear axle stops where cones bear out the path."""
    assert CLEAR > 1.0 - DOUBT_BY_CONES
    assert all(car.wheelbase_m > BEYOND_CONES_M for car in CARS.values())


def test_clear_looks_on_enough_way_earn_a_speed_by_sight() -> None:
    assert allowed_mps(looks(CLEAR_OVER_M - 0.5)) == 0.0
    assert allowed_mps(looks(CLEAR_OVER_M + 1.0)) > 0.0


@pytest.mark.parametrize("sight_m", [SIGHT_M, 2.0 * SIGHT_M])
def test_the_speed_allowed_stops_within_sight(sight_m: float) -> None:
    """Braked with what is planned with, after the brakes' delay and the time until the next look."""
    speed = allowed_mps(looks(30.0, sight_m=sight_m))
    assert speed * (REACTION_S + AGE_S) + speed**2 / (2.0 * BRAKING_MPS2) == pytest.approx(sight_m)


@pytest.mark.parametrize(("bend_1pm", "mps"), [(0.0, 9.0), (0.05, 9.0), (0.1, 7.5), (0.3, 4.0)])
def test_in_a_bend_brakes_have_what_it_leaves_of_the_grip(bend_1pm: float, mps: float) -> None:
    """The way of a car braked step by step is the way that is reckoned with, there and back."""
    speed, way_m, step_s = mps, 0.0, 1e-4
    while speed > 0.0:
        way_m += speed * step_s
        speed -= step_s * BRAKING_MPS2 * braking_share(speed**2 * bend_1pm / BRAKING_MPS2)
    assert stopping_m(mps**2, bend_1pm, BRAKING_MPS2) == pytest.approx(way_m, abs=0.01)
    assert stops_from_m2ps2(way_m, bend_1pm, BRAKING_MPS2) == pytest.approx(mps**2, abs=0.1)


def test_a_car_too_fast_for_its_bend_needs_more_way_to_stop() -> None:
    ways_m = [stopping_m(mps**2, 0.2, BRAKING_MPS2) for mps in (5.0, 6.0, 8.0, 12.0)]
    assert all(way_m > mps**2 / (2.0 * BRAKING_MPS2) for way_m, mps in zip(ways_m, (5.0, 6.0, 8.0, 12.0), strict=True))
    assert ways_m == sorted(ways_m)


def test_sight_in_a_bend_allows_no_more_than_its_grip() -> None:
    seen = looks(30.0)
    allowed = [allowed_mps(seen, bend_1pm=bend_1pm) for bend_1pm in (0.0, 0.05, 0.1)]
    assert allowed == sorted(allowed, reverse=True)
    assert allowed_mps(seen, bend_1pm=0.3) == pytest.approx(math.sqrt(BRAKING_MPS2 / 0.3))


def test_after_a_doubt_less_way_is_enough() -> None:
    seen = [*looks(30.0, sight_m=2.0 * SIGHT_M), (30.0, DOUBTFUL - 0.01, 2.0 * SIGHT_M)]
    after = [(30.0 + at_m, sure, m) for at_m, sure, m in looks(CLEAR_AGAIN_M + 1.0, sight_m=2.0 * SIGHT_M)[1:]]
    slowed = [look for look in after if look[0] < 30.0 + CLEAR_AGAIN_M]
    assert allowed_mps(seen + slowed) < SPEED_MPS < allowed_mps(seen + after) == allowed_mps(seen[:-1])


def test_the_shortest_sight_lately_counts() -> None:
    seen = looks(30.0, sight_m=2.0 * SIGHT_M)
    shorter = [(at_m, sure, SIGHT_M if at_m == 20.0 else sight_m) for at_m, sure, sight_m in seen]
    least, most = allowed_mps(looks(30.0)), allowed_mps(seen)
    until = {way_m: allowed_mps([look for look in shorter if look[0] <= way_m]) for way_m in (19.5, 20.0, 24.0, 24.5)}
    assert list(until.values()) == pytest.approx([most, least, least, most])
    assert STEADY_M == 4.0


UNCLEAR: dict[str, Callable[[Looks], Looks]] = {
    "doubt": lambda seen: [(at_m, CLEAR - 0.01, sight_m) for at_m, _, sight_m in seen],
    "much doubt": lambda seen: [(at_m, DOUBTFUL - 0.01, sight_m) for at_m, _, sight_m in seen],
    "short sight": lambda seen: [(at_m, sure, CLEAR_M - 0.1) for at_m, sure, _ in seen],
    "doubt in every fourth look": lambda seen: [
        (at, CLEAR - 0.1 if at % 2.0 == 0.0 else sure, m) for at, sure, m in seen
    ],
    "much doubt now and then": lambda seen: [(at, 0.4 if at % 14.0 == 0.0 else sure, m) for at, sure, m in seen],
    "looks far apart": lambda seen: seen[:: round((CLEAR_APART_M + 0.5) / 0.5)],
}


@pytest.mark.parametrize("why", UNCLEAR)
def test_looks_that_are_not_clear_earn_none(why: str) -> None:
    assert allowed_mps(UNCLEAR[why](looks(100.0))) == 0.0


def test_a_look_in_doubt_that_others_outvote_ends_nothing() -> None:
    seen = [(at_m, DOUBTFUL if at_m % 3.0 == 0.0 else sure, sight_m) for at_m, sure, sight_m in looks(100.0)]
    assert allowed_mps(seen) == allowed_mps(looks(100.0)) > 0.0


@pytest.mark.parametrize("why", ["much doubt", "short sight"])
def test_from_an_unclear_look_on_the_allowed_speed_falls(why: str) -> None:
    """By so little in the first metre that it does not brake hard, and to nothing until it is earned again."""
    seen = looks(30.0, sight_m=2.0 * SIGHT_M)
    unclear = UNCLEAR[why]([(30.0, 1.0, 2.0 * SIGHT_M)])
    assert allowed_mps(seen + unclear, 1.0) == pytest.approx(SPEED_MPS, abs=0.5)
    assert allowed_mps(seen + unclear, 30.0) == 0.0


@pytest.mark.parametrize("mission", [Ami.AUTOCROSS, Ami.TRACKDRIVE])
def test_a_lap_without_a_map_may_be_driven_by_sight(mission: Ami) -> None:
    controller, settings = Controller(CARS["2026"]), ControllerSettings()
    assert controller.max_speed_mps(mission) == settings.lap_max_speed_mps > settings.careful_mps
    assert controller.max_speed_mps(mission, mapped=True) == settings.race_max_speed_mps
