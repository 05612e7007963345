"""Signals between the VCU and the car: what its sensors read, and what its actuators are ordered."""

from __future__ import annotations

from fsai_vcu.core.vehicle.parameters import GRAVITY_MPS2
from fsai_vcu.interface.values import Value


class CarFeedback(Value, frozen=True):
    """The readings of the VCU's sensors, and of the PCAN-GPS, at one instant."""

    wheel_rpm: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # FL FR RL RR, never negative
    pulses: tuple[int, int, int, int] = (0, 0, 0, 0)  # 16-bit counters that wrap
    steer_deg: float = 0.0  # road angle, positive to the left
    front_torque_nm: float = 0.0  # at the axle; negative brakes
    rear_torque_nm: float = 0.0
    front_brake_pct: float = 0.0
    rear_brake_pct: float = 0.0
    speed_mps: float = 0.0
    # as an accelerometer reads it: z holds gravity
    accel_xyz_mps2: tuple[float, float, float] = (0.0, 0.0, GRAVITY_MPS2)
    yaw_rate_radps: float = 0.0
    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    course_deg: float = 0.0  # clockwise from north


class Actuation(Value, frozen=True):
    """The orders of the VCU to the car's actuators now."""

    steer_deg: float = 0.0
    front_torque_nm: float = 0.0
    rear_torque_nm: float = 0.0
    front_motor_speed_max_rpm: int = 0
    rear_motor_speed_max_rpm: int = 0
    front_brake_pct: float = 0.0
    rear_brake_pct: float = 0.0
    ebs_engaged: bool = False
    tractive_system_live: bool = False


def limited(value: float, most: float, least: float | None = None) -> float:
    """The value, kept from `least` (else from `-most`) to `most`, as a signal's range has it."""
    low = -most if least is None else least
    value = value if value > low else low
    return value if value < most else most
