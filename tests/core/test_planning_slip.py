"""The slip of the tyres as the map shows it."""

from __future__ import annotations

import math

import pytest

from fsai_vcu.core.planning.slip import CORNER_MPS2, LEARNT_M, LEFT_MOST_M, WAY_MOST_M, Slip
from fsai_vcu.core.vehicle.parameters import SLIP_LEAST_RADPMPS2, SLIP_MOST_RADPMPS2, SLIP_RADPMPS2


def cornered(true_radpmps2: float, lateral_mps2: float, share_seen: float = 1.0, way_m: float = 600.0) -> float:
    """The slip found in so much way of a corner, where cones bring this share of what is missing at each look."""
    slip, step_m = Slip(), 0.5
    for _ in range(round(way_m / step_m)):
        missing_m = (true_radpmps2 - slip.radpmps2) * lateral_mps2 * step_m
        slip = slip.after(step_m, lateral_mps2, -share_seen * missing_m)
    return slip.radpmps2


@pytest.mark.parametrize("lateral_mps2", [-7.0, 7.0])
@pytest.mark.parametrize("true_radpmps2", [0.008, 0.0125])
def test_the_slip_that_leaves_nothing_to_correct_is_found(true_radpmps2: float, lateral_mps2: float) -> None:
    for share_seen in (0.4, 1.0):
        assert cornered(true_radpmps2, lateral_mps2, share_seen) == pytest.approx(true_radpmps2, rel=0.05)


def test_a_lap_tells_most_of_it() -> None:
    found = cornered(0.0125, 6.5, share_seen=0.4, way_m=130.0)
    assert found - SLIP_RADPMPS2 > 0.6 * (0.0125 - SLIP_RADPMPS2)


@pytest.mark.parametrize(
    "look",
    [
        (0.5, CORNER_MPS2 - 0.1, -0.05),
        (0.5, 30.0, -0.05),
        (0.5, 7.0, -LEFT_MOST_M - 0.01),
        (WAY_MOST_M + 0.1, 7.0, -0.05),
        (0.5, math.nan, -0.05),
        (0.5, 7.0, math.nan),
    ],
)
def test_a_look_that_tells_nothing_changes_nothing(look: tuple[float, float, float]) -> None:
    assert Slip().after(*look) == Slip()


def test_no_slip_is_beyond_what_tyres_do() -> None:
    assert cornered(0.04, 7.0) == SLIP_MOST_RADPMPS2 and cornered(0.001, 7.0) == SLIP_LEAST_RADPMPS2


def test_slip_is_measured_once_enough_corners_have_told_it() -> None:
    slip = Slip()
    for _ in range(round(LEARNT_M) - 1):
        slip = slip.after(1.0, 7.0, 0.0).after(1.0, 0.0, 0.0)
    assert slip.measured_radpmps2 == 0.0
    assert slip.after(1.0, 7.0, 0.0).measured_radpmps2 == slip.radpmps2
