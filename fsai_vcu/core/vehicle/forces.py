"""Forces on the level: from an acceleration that is wanted to the pedal that gives it."""

from __future__ import annotations

import math

from fsai_vcu.core.vehicle.parameters import GRAVITY_MPS2, VehicleParameters
from fsai_vcu.interface.specification import CONSTANT_POWER_RPM_NM

AIR_DENSITY_KGPM3 = 1.2


def resistance_n(car: VehicleParameters, speed_mps: float) -> float:
    """Return the force (N) with which tyres and air slow the car."""
    rolling = car.rolling_resistance * car.mass_kg * GRAVITY_MPS2
    return rolling + 0.5 * AIR_DENSITY_KGPM3 * car.drag_area_m2 * speed_mps**2


def axle_torque_nm(car: VehicleParameters, speed_mps: float) -> float:
    """Return the torque (Nm) that one axle may be asked for at a speed, which full throttle means."""
    rpm = car.wheel_rpm_of_speed(speed_mps)
    allowed_nm = min((torque for above_rpm, torque in CONSTANT_POWER_RPM_NM if rpm > above_rpm), default=math.inf)
    return min(allowed_nm, car.axle_torque_max_nm)


def most_mps2(car: VehicleParameters, speed_mps: float) -> float:
    """The acceleration at full throttle."""
    force_n = car.driven_axles * axle_torque_nm(car, speed_mps) / car.rolling_radius_m - resistance_n(car, speed_mps)
    return force_n / (car.mass_kg + car.rotating_mass_kg)


def traction_mps2(car: VehicleParameters, grip_mps2: float, lateral_mps2: float) -> float:
    """The acceleration that the driven tyres, of such a grip, have left beside a lateral acceleration."""
    ahead = car.cog_ahead_of_rear_axle_m / car.wheelbase_m
    driven_weight = ahead * car.driven_front + (1.0 - ahead) * car.driven_rear
    return driven_weight * math.sqrt(max(grip_mps2**2 - lateral_mps2**2, 0.0))


def throttle_for(car: VehicleParameters, acceleration_mps2: float, speed_mps: float) -> float:
    """Fraction 0…1 of the axle torque that is allowed at a speed; 0 also where only brakes would do."""
    force_n = (car.mass_kg + car.rotating_mass_kg) * acceleration_mps2 + resistance_n(car, speed_mps)
    axle_nm = force_n * car.rolling_radius_m / max(car.driven_axles, 1)
    return min(max(axle_nm / axle_torque_nm(car, speed_mps), 0.0), 1.0)


def brake_for(car: VehicleParameters, deceleration_mps2: float, speed_mps: float) -> float:
    """Fraction 0…1 of full pressure that gives a deceleration, with what tyres and air do by themselves."""
    left_mps2 = deceleration_mps2 - resistance_n(car, speed_mps) / car.mass_kg
    return min(max(left_mps2 / (car.brake_full_mps2 * car.brake_excess), 0.0), 1.0)
