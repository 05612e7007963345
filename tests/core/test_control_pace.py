"""The pace of racing laps: it grows only where the car follows its path, and is taken back at once."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from fsai_vcu.core.control.pace import FOLLOWED_M, LEAST_M, LOST_M, SLIPPING, STEP, Pace, Shown, axle_slip

WELL = Shown(laps=1, distance_m=0.0, aside_m=0.1, slip=0.02, sure=True)
LAP_M = 200.0


def raced(laps: int, pace: Pace | None = None, first: int = 1, **trouble: Any) -> Pace:
    """The pace behind so many laps, from lap `first` on; `trouble` is shown in the middle of the last one."""
    pace = pace or Pace()
    for metre in range(round(laps * LAP_M) + 1):
        shown = replace(WELL, laps=first + int(metre / LAP_M), distance_m=float(first * LAP_M + metre))
        if metre == round((laps - 0.5) * LAP_M):
            shown = replace(shown, **trouble)
        pace = pace.after(shown)
    return pace


def test_the_pace_grows_a_step_a_lap_and_no_further() -> None:
    assert [raced(laps).share for laps in range(5)] == [0.0, STEP, 2.0 * STEP, 1.0, 1.0]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_lap_not_followed_closely_earns_nothing(side: float) -> None:
    # Half a lap is followed closely behind it, so that the rest of the lap must be shorter than what counts.
    late = replace(WELL, distance_m=LAP_M - 0.5 * LEAST_M, aside_m=side * (FOLLOWED_M + 0.01))
    pace = Pace(since_m=0.0, laps=1).after(late)
    assert pace.after(replace(WELL, laps=2, distance_m=LAP_M)).share == 0.0
    assert Pace(since_m=0.0, laps=1).after(replace(WELL, laps=2, distance_m=LAP_M)).share == STEP


@pytest.mark.parametrize(
    "trouble", [{"aside_m": LOST_M + 0.01}, {"aside_m": -LOST_M - 0.01}, {"slip": SLIPPING + 0.01}, {"sure": False}]
)
def test_trouble_takes_the_whole_pace_back_at_once(trouble: dict[str, Any]) -> None:
    assert Pace(share=1.0, laps=1, since_m=0.0).after(replace(WELL, distance_m=9.0, **trouble)).share == 0.0


def test_a_pace_at_which_the_path_was_lost_is_not_tried_again() -> None:
    fast = raced(3)
    assert raced(6, fast.after(replace(WELL, laps=4, aside_m=1.0)), first=4).share == 1.0 - STEP
    assert raced(6, fast.after(replace(WELL, laps=4, sure=False)), first=4).share == 1.0  # the map was in doubt


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_takes_the_pace_back(value: float) -> None:
    fast = Pace(share=1.0, laps=1, since_m=0.0)
    assert fast.after(replace(WELL, slip=value)).share == fast.after(replace(WELL, aside_m=value)).share == 0.0


def test_an_axle_that_spins_or_locks_slips() -> None:
    assert axle_slip((300.0, 320.0, 298.0, 318.0)) < 0.01
    assert axle_slip((300.0, 320.0, 400.0, 420.0)) > SLIPPING
    assert axle_slip((0.0, 100.0, 298.0, 318.0)) > SLIPPING
    assert axle_slip((0.0, 0.0, 0.0, 0.0)) == 0.0
