"""The least time of a lap: by closed formulas on a circle and on a straight, and on a track below what is driven."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fsai_hil.bench import __main__ as command
from fsai_hil.bench.laps import GRIP_MPS2, Forces, quickest_line
from fsai_hil.simulator.tracks import small_oval
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.planning.pose import gaps
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026

CAR, GAIN_MPS2 = ADS_DV_2026, 0.5


class Pushed(Forces):
    """A car that gains the same at any speed, in any bend."""

    def gained(self, speed: Floats, lateral: Floats) -> Floats:
        return np.full(np.shape(speed), GAIN_MPS2)


def circle(radius_m: float) -> Floats:
    angles = np.linspace(0.0, math.tau, 600, endpoint=False)
    return radius_m * np.stack((np.cos(angles), np.sin(angles)), axis=-1)[None]


@pytest.mark.parametrize("radius_m", [6.0, 20.0])
def test_a_circle_takes_what_grip_sideways_allows(radius_m: float) -> None:
    assert Pushed(CAR).lap_s(circle(radius_m)) == pytest.approx(math.tau * math.sqrt(radius_m / GRIP_MPS2), rel=1e-3)


def test_a_circle_is_slower_by_the_drag_of_its_tyres() -> None:
    """The speed at which what drives the car is what its tyres lose in the bend."""
    forces, radius_m = Forces(CAR), 15.0
    speed_mps = math.tau * radius_m / float(forces.lap_s(circle(radius_m))[0])
    assert abs(forces.gained(np.array([speed_mps]), np.array([speed_mps**2 / radius_m]))[0]) < 0.05
    assert speed_mps < math.sqrt(GRIP_MPS2 * radius_m)


def test_a_straight_from_rest_takes_what_uniform_gain_takes() -> None:
    """Rolled up, as wide as grip never matters: 90 m after 6 m of run-up."""
    straight_m, before_m = 90.0, 6.0
    taken_s = math.sqrt(2.0 / GAIN_MPS2) * (math.sqrt(straight_m + before_m) - math.sqrt(before_m))
    assert Pushed(CAR).lap_s(circle(straight_m / math.tau), before_m) == pytest.approx(taken_s, rel=0.01)


def test_tyres_that_hold_the_car_in_its_bend_have_none_left() -> None:
    forces, at = Forces(CAR), np.full(2, 8.0)
    straight, bend = np.stack(
        (forces.gained(at, GRIP_MPS2 * np.arange(2)), forces.braked(at, GRIP_MPS2 * np.arange(2)))
    ).T
    assert straight[0] == pytest.approx(1.6, abs=0.3) and straight[1] == pytest.approx(CAR.brake_full_mps2, abs=0.2)
    assert bend[0] < 1.0 and bend[1] < 5.0


def test_the_line_stays_between_the_borders_and_is_quicker() -> None:
    track = small_oval()
    assert track.centreline_m is not None and track.left_border_m is not None and track.right_border_m is not None
    line, forces = quickest_line(track, CAR, 10), Forces(CAR)
    for border in (track.left_border_m, track.right_border_m):
        assert gaps(line, border).min() > 0.5 * CAR.width_m - 0.05
    assert forces.lap_s(line[None])[0] < 0.97 * forces.lap_s(track.centreline_m[None, ::2])[0]


def test_a_track_that_is_no_circuit_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["laps", "skidpad"]) == 2
    assert "skidpad" in capsys.readouterr().err
