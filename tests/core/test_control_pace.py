"""The pace of racing laps: it follows the slip of the tyres, and is taken back at once where the car shows trouble."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from fsai_vcu.core.control.pace import (
    ANGLE_RAD,
    BLIND_ANGLE_RAD,
    BLIND_MOST,
    GROWS_1PM,
    LEAST,
    LOST_M,
    MOST,
    SLIPPING,
    STEP,
    Pace,
    Signs,
    axle_slip,
)

WELL = Signs(distance_m=0.0, aside_m=0.1, axle_slip=0.02, angle_rad=ANGLE_RAD, sure=True, turn_sensed=True)


def raced(way_m: int, share: float, pace: Pace | None = None, **trouble: Any) -> Pace:
    """The pace after so much way with such a share of the slip aimed at; `trouble` is shown at the end."""
    pace = pace or Pace()
    for _ in range(way_m):
        pace = pace.after(replace(WELL, distance_m=pace.distance_m + 1.0, angle_rad=share * ANGLE_RAD))
    return pace.after(replace(WELL, distance_m=pace.distance_m, angle_rad=share * ANGLE_RAD, **trouble))


def test_the_slip_aimed_at_leaves_the_pace_alone() -> None:
    assert raced(500, 1.0).gain == pytest.approx(1.0)


@pytest.mark.parametrize(("share", "gain"), [(0.9, 1.0 / 0.9), (1.1, 1.0 / 1.1), (0.5, MOST), (2.0, LEAST)])
def test_the_pace_becomes_what_makes_the_slip_aimed_at(share: float, gain: float) -> None:
    assert raced(1000, share).gain == pytest.approx(gain)


def test_without_a_sensed_yaw_rate_the_car_is_asked_for_less() -> None:
    blind, sensed, slip_rad = Pace(), Pace(), 0.085
    for metre in range(1000):
        seen = replace(WELL, distance_m=float(metre), angle_rad=slip_rad)
        sensed, blind = sensed.after(seen), blind.after(replace(seen, turn_sensed=False))
    assert (sensed.gain, blind.gain) == pytest.approx((ANGLE_RAD / slip_rad, BLIND_ANGLE_RAD / slip_rad))
    fast = raced(1000, 0.5)
    for _ in range(50):  # the sensor falls silent
        fast = fast.after(replace(WELL, distance_m=fast.distance_m + 1.0, angle_rad=0.5 * ANGLE_RAD, turn_sensed=False))
    assert fast.gain == BLIND_MOST


def test_the_pace_grows_only_where_the_slip_is_measured() -> None:
    assert raced(100, 0.5).gain == pytest.approx(1.0 + 100 * GROWS_1PM)
    assert raced(1000, 0.0).gain == 1.0


def test_a_slip_no_longer_measured_takes_the_pace_back() -> None:
    assert raced(1000, 0.0, raced(1000, 0.5)).gain == 1.0


def test_the_pace_sinks_faster_than_it_grows() -> None:
    fast = raced(1000, 0.5)
    assert fast.gain - raced(20, 2.0, fast).gain > 3 * 20 * GROWS_1PM


@pytest.mark.parametrize(
    "trouble",
    [{"aside_m": LOST_M + 0.01}, {"aside_m": -LOST_M - 0.01}, {"axle_slip": SLIPPING + 0.01}, {"sure": False}],
)
def test_trouble_takes_the_whole_pace_back_at_once(trouble: dict[str, Any]) -> None:
    assert raced(1000, 0.5, **trouble).gain == 1.0
    assert raced(1000, 2.0, **trouble).gain == LEAST  # no more than before


def test_a_pace_at_which_the_path_was_lost_is_not_tried_again() -> None:
    assert raced(1000, 0.5, raced(1000, 0.5, aside_m=1.0)).gain == pytest.approx(MOST - STEP)
    assert raced(1000, 0.5, raced(1000, 0.5, sure=False)).gain == MOST  # the map was in doubt


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_takes_the_pace_back(value: float) -> None:
    assert raced(1000, 0.5, axle_slip=value).gain == raced(1000, 0.5, aside_m=value).gain == 1.0


def test_an_axle_that_spins_or_locks_slips() -> None:
    assert axle_slip((300.0, 320.0, 298.0, 318.0)) < 0.01
    assert axle_slip((300.0, 320.0, 400.0, 420.0)) > SLIPPING
    assert axle_slip((0.0, 100.0, 298.0, 318.0)) > SLIPPING
    assert axle_slip((0.0, 0.0, 0.0, 0.0)) == 0.0
