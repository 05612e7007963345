"""The straight lane: where in it the car is, and where it ends."""

from __future__ import annotations

import numpy as np
import pytest

from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.acceleration import closed_at, finish_seen, follow_lane, staged
from fsai_vcu.core.missions.course_fit import from_car, on_course

ROWS = np.array([(2.5 + 5.0 * i, side * 1.5) for i in range(20) for side in (1.0, -1.0)])


@pytest.mark.parametrize("half_width_m", [1.5, 2.2])
@pytest.mark.parametrize(("y_m", "yaw_rad"), [(0.3, 0.05), (-0.3, -0.05), (0.8, -0.15), (-0.3, 0.15)])
def test_a_lane_is_found_from_a_start_askew(half_width_m: float, y_m: float, yaw_rad: float) -> None:
    there, odometry = np.array([0.0, y_m, yaw_rad]), Motion(x_m=5.0, y_m=3.0, yaw_rad=2.0)
    random = np.random.default_rng(4)
    lane = staged(odometry)
    for _ in range(30):
        xy = from_car(there, ROWS[:6] * (1.0, half_width_m / 1.5))
        lane = follow_lane(lane, odometry, xy + random.normal(0.0, 0.05, xy.shape))
    assert lane.found
    assert (np.abs(on_course(there, lane.ahead(15.0, 0.5))[:, 1]) < 0.2).all()


def test_a_lane_is_tracked_while_odometry_turns_away() -> None:
    lane = staged(Motion())
    x = y = 0.0
    for step in range(70):
        there = np.array([float(step), 0.1, 0.0])
        seen = from_car(there, ROWS)
        ahead = (seen[:, 0] > 0.5) & (seen[:, 0] < 14.0)
        lane = follow_lane(lane, Motion(x_m=x, y_m=y, yaw_rad=0.004 * step), seen[ahead])
        x, y = x + np.cos(0.004 * step), y + np.sin(0.004 * step)
    assert np.abs(lane.pose - there)[1:] == pytest.approx((0.0, 0.0), abs=0.05)


def test_too_few_cones_turn_no_car() -> None:
    lane = follow_lane(staged(Motion()), Motion(), np.array([[6.0, 1.0], [8.0, 4.0], [9.0, -3.0]]))
    assert not lane.found and lane.pose == pytest.approx(np.zeros(3))


def test_the_finish_is_where_big_cones_stand_on_both_sides() -> None:
    gate = np.array([[80.0, 1.6], [80.6, -1.6]])
    assert finish_seen(77.5, gate) == pytest.approx(80.3)
    assert finish_seen(77.5, gate[:1]) == 77.5  # one side
    assert finish_seen(77.5, gate - (75.0, 0.0)) == 77.5  # the start's
    assert finish_seen(77.5, gate * (1.0, 4.0)) == 77.5  # of another lane
    assert finish_seen(77.5, np.zeros((0, 2))) == 77.5


def test_the_lane_is_closed_by_the_first_cone_in_its_middle() -> None:
    cones = np.array([[90.0, 1.5], [99.0, 0.5], [95.0, -0.5], [60.0, 0.0]])
    assert closed_at(77.5, cones) == 95.0
    assert closed_at(77.5, cones[[0, 3]]) is None
