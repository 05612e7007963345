"""From accelerations to pedals: with the pedal that is computed, the car's own forces give what was asked for."""

from __future__ import annotations

import pytest

from fsai_vcu.core.vehicle.forces import brake_for, resistance_n, throttle_for, traction_mps2
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026, VehicleParameters


@pytest.mark.parametrize("car", [ADS_DV_2021, ADS_DV_2026], ids=lambda car: car.name)
@pytest.mark.parametrize("speed_mps", [0.0, 5.0])
def test_throttle_gives_the_acceleration_up_to_all_there_is(car: VehicleParameters, speed_mps: float) -> None:
    throttle = throttle_for(car, 0.8, speed_mps)
    force_n = throttle * car.axle_torque_max_nm * car.driven_axles / car.rolling_radius_m
    inertia_kg = car.mass_kg + car.rotating_mass_kg
    assert (force_n - resistance_n(car, speed_mps)) / inertia_kg == pytest.approx(0.8)
    assert throttle_for(car, 50.0, speed_mps) == 1.0
    assert throttle_for(car, -5.0, speed_mps) == 0.0


def test_fast_a_fraction_is_one_of_the_torque_allowed_there() -> None:
    assert throttle_for(ADS_DV_2026, 0.3, 15.0) > 1.5 * throttle_for(ADS_DV_2026, 0.3, 5.0)


def test_brake_gives_the_deceleration_and_never_less_than_none() -> None:
    car = ADS_DV_2026
    brake = brake_for(car, 4.0, 10.0)
    braked_mps2 = brake * car.brake_full_mps2 * car.brake_excess
    assert braked_mps2 + resistance_n(car, 10.0) / car.mass_kg == pytest.approx(4.0)
    assert brake_for(car, 0.1, 10.0) == 0.0 and brake_for(car, 99.0, 10.0) == 1.0


def test_driven_tyres_have_left_what_the_corner_does_not_take() -> None:
    """Both axles' tyres of the one car, those of half the weight of the other."""
    for car, weight in ((ADS_DV_2021, 1.0), (ADS_DV_2026, 0.5)):
        left = [traction_mps2(car, 10.0, lateral) / weight for lateral in (0.0, 6.0, -6.0, 10.0, 12.0)]
        assert left == pytest.approx([10.0, 8.0, 8.0, 0.0, 0.0])
