"""Measures and abilities of a car: one frozen set of numbers per car. A new car is a new entry in `CARS`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from msgspec.structs import replace

from fsai_vcu.interface.specification import AXLE_TORQUE_MAX_NM, CONSTANT_POWER_RPM_NM, GEAR_RATIO, MOTOR_SPEED_MAX_RPM
from fsai_vcu.interface.values import Value

GRAVITY_MPS2 = 9.81
SLIP_RADPMPS2 = 0.009  # slip angle of a rear axle that holds the car in a corner, by its lateral acceleration …
SLIP_LEAST_RADPMPS2, SLIP_MOST_RADPMPS2 = 0.5 * SLIP_RADPMPS2, 2.5 * SLIP_RADPMPS2  # … of tyres and roads that differ


class VehicleParameters(Value, frozen=True):
    """Geometry, masses and actuators of one car. SI units unless the name says otherwise.

    The reference point is the rear axle's centre on the ground. Steering angles are those of the bicycle model.
    """

    name: str

    # Geometry and mass
    wheelbase_m: float = 1.530
    track_m: float = 1.20  # front and rear
    length_m: float = 2.815
    width_m: float = 1.43
    mass_kg: float = 300.0
    cog_ahead_of_rear_axle_m: float = 0.765
    cog_height_m: float = 0.165
    yaw_inertia_kgm2: float = 95.0
    nose_ahead_of_rear_axle_m: float = 2.17  # wheelbase plus half of what the length leaves over
    rolling_radius_m: float = 0.2535  # 225/45 R13 under load: 0.251 to 0.258

    # Drive line
    driven_front: bool = False
    driven_rear: bool = True
    gear_ratio: float = GEAR_RATIO  # motor turns per wheel turn
    motor_speed_max_rpm: float = MOTOR_SPEED_MAX_RPM
    axle_torque_max_nm: float = AXLE_TORQUE_MAX_NM
    torque_rate_nmps: float = 5000.0  # 50 Nm per 10 ms
    # Available axle torque by motor speed: what 5 kW and 200 A leave of the peak.
    torque_curve_rpm_nm: tuple[tuple[float, float], ...] = (
        (0.0, AXLE_TORQUE_MAX_NM),
        *((GEAR_RATIO * wheel_rpm, torque_nm) for wheel_rpm, torque_nm in reversed(CONSTANT_POWER_RPM_NM)),
        (2800.0, 30.0),
        (3150.0, 10.0),
    )
    # The inertia of wheels, gears and rotors as mass; with it a rear-driven car leaves the line with 1.9 m/s2.
    rotating_mass_kg: float = 80.0
    rolling_resistance: float = 0.015
    drag_area_m2: float = 1.0  # cd * A

    # Steering
    steer_max_rad: float = math.radians(21.0)
    steer_rate_radps: float = math.radians(40.0)
    steer_dead_time_s: float = 0.050
    steer_backlash_rad: float = math.radians(0.9)  # to either side

    # Brakes
    brake_dead_time_s: float = 0.080
    brake_full_mps2: float = 9.0  # deceleration with 100 % pressure
    brake_minimum: float = 0.13  # any request above zero gives at least this fraction
    brake_excess: float = 1.06  # the pressure that comes over the pressure asked for

    # Sensors
    wheel_pulses_per_rev: int = 20
    yaw_rate_sign: float = 1.0  # +1 where the yaw-rate sensor counts a left turn positive, as ISO 8855 does

    @property
    def driven_axles(self) -> int:
        return int(self.driven_front) + int(self.driven_rear)

    @property
    def least_radius_m(self) -> float:
        """Radius of the tightest bend that the rear axle can drive."""
        return self.wheelbase_m / math.tan(self.steer_max_rad)

    @property
    def speed_max_mps(self) -> float:
        """Road speed at the motors' highest speed."""
        return self.speed_of_wheel_rpm(self.motor_speed_max_rpm / self.gear_ratio)

    def speed_of_wheel_rpm(self, wheel_rpm: float) -> float:
        """Road speed in m/s at which a wheel turns at `wheel_rpm`."""
        return wheel_rpm * (2.0 * math.pi / 60.0) * self.rolling_radius_m

    def wheel_rpm_of_speed(self, speed_mps: float) -> float:
        return speed_mps / (2.0 * math.pi / 60.0 * self.rolling_radius_m)

    def with_steer_limit(self, steer_limit_deg: float) -> VehicleParameters:
        """The same car behind an interface whose steering limit is another one."""
        return replace(self, steer_max_rad=math.radians(steer_limit_deg))


ADS_DV_2021 = VehicleParameters(name="2021", driven_front=True, driven_rear=True, steer_max_rad=math.radians(21.0))
ADS_DV_2026 = VehicleParameters(name="2026", driven_front=False, driven_rear=True, steer_max_rad=math.radians(30.0))
# The car of the official simulator, on which teams are examined: small wheels, driven by the rear torque only.
OFFICIAL_SIMULATOR = VehicleParameters(
    name="official-simulator",
    mass_kg=325.0,
    rolling_radius_m=0.15,
    wheel_pulses_per_rev=36,
    steer_max_rad=math.radians(30.0),
)

CARS: Mapping[str, VehicleParameters] = MappingProxyType(
    {car.name: car for car in (ADS_DV_2021, ADS_DV_2026, OFFICIAL_SIMULATOR)}
)
