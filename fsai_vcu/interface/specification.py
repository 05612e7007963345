"""Numbers of the interface specification v4.0 that no signal database holds.

They are facts of the car. The project's own limits and times, tighter than these, are in the core's BridgeConfig.
"""

from __future__ import annotations

from typing import Final

from fsai_vcu.interface.units import MS, S

PERIOD_NS: Final = 10 * MS
"""The five messages of the AI computer go out so often, and so do those of the VCU that answer them."""

COMMS_LOST_NS: Final = 100 * MS
"""AI_COMMS_LOST: an echo that does not match for so long, or ten messages of 10 ms missing in a row."""

READY_WAIT_NS: Final = 5 * S
"""The least time in AS_READY before AS_DRIVING."""

EMERGENCY_TIMER_NS: Final = 15 * S
"""EMERGENCY_BRAKE ends no earlier."""

READY_STEER_DEG: Final = 5.0
"""The measured steering is under it for AS_DRIVING to follow AS_READY."""

STANDING_RPM: Final = 10.0
"""Above it a wheel turns, below it the wheel stands."""

AXLE_TORQUE_MAX_NM: Final = 195.0
MOTOR_SPEED_MAX_RPM: Final = 4000
WHEEL_SPEED_MAX_RPM: Final = 1250
GEAR_RATIO: Final = 3.5
"""Turns of the motor for one of the axle."""

CONSTANT_POWER_RPM_NM: Final = ((700, 50.0), (600, 85.0), (500, 100.0), (400, 120.0), (300, 150.0))
"""Protection against an over-current trip: above this wheel speed at most this torque.

Steps, as they are written. The fastest wheel of the axle decides.
"""
