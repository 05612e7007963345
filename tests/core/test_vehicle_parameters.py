"""The cars' numbers."""

from __future__ import annotations

import math

import pytest

from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026


def test_the_2021_car_drives_both_axles_and_2026_the_rear() -> None:
    assert (ADS_DV_2021.driven_front, ADS_DV_2021.driven_rear, ADS_DV_2021.driven_axles) == (True, True, 2)
    assert (ADS_DV_2026.driven_front, ADS_DV_2026.driven_rear, ADS_DV_2026.driven_axles) == (False, True, 1)


def test_wheel_speed_and_road_speed_are_each_others_inverse() -> None:
    car = ADS_DV_2026
    assert car.speed_of_wheel_rpm(car.wheel_rpm_of_speed(7.3)) == pytest.approx(7.3)
    assert car.speed_of_wheel_rpm(60.0) == pytest.approx(2.0 * math.pi * car.rolling_radius_m)


def test_a_rear_driven_car_leaves_the_line_with_1_9_mps2() -> None:
    car = ADS_DV_2026
    force = car.axle_torque_max_nm / car.rolling_radius_m - car.rolling_resistance * car.mass_kg * 9.81
    assert force / (car.mass_kg + car.rotating_mass_kg) == pytest.approx(1.9, abs=0.05)
