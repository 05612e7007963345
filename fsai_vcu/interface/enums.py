"""The enumerations of the ADS-DV's interface, with the names that the car's documents use.

Members are raw values on the wire; logic compares members, people read `.label`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class CarEnum(IntEnum):
    """An enumeration of raw signal values whose label is the car's own word for it."""

    @property
    def label(self) -> str:
        return self.name


class AsState(CarEnum):
    """AS_STATE of 0x520: the autonomous-system state machine as the VCU runs it."""

    AS_INIT = 0
    AS_OFF = 1
    AS_READY = 2
    AS_DRIVING = 3
    EMERGENCY_BRAKE = 4
    AS_FINISHED = 5


OFF_LIKE: Final = frozenset((AsState.AS_INIT, AsState.AS_OFF))
"""The AS states before a run, in which nothing may move and everything may be reset."""


class Ami(CarEnum):
    """AMI_STATE: the mission chosen on the car's display."""

    NOT_SELECTED = 0
    ACCELERATION = 1
    SKIDPAD = 2
    AUTOCROSS = 3
    TRACKDRIVE = 4
    STATIC_INSPECTION_A = 5
    STATIC_INSPECTION_B = 6
    AUTONOMOUS_DEMO = 7


class MissionStatus(CarEnum):
    """MISSION_STATUS of 0x510."""

    NOT_SELECTED = 0
    SELECTED = 1
    RUNNING = 2
    FINISHED = 3


class Direction(CarEnum):
    """DIRECTION_REQUEST of 0x510."""

    NEUTRAL = 0
    FORWARD = 1
    REVERSE = 2


class ShutdownCause(CarEnum):
    """SHUTDOWN_CAUSE of 0x520."""

    NO_SHUTDOWN = 0
    AI_COMPUTER_REQUEST = 1
    HVIL_OPEN_FAULT = 2
    HVIL_SHORT_FAULT = 3
    EBS_FAULT = 4
    OFFBOARD_CHARGER_FAULT = 5
    AI_COMMS_FAULT = 6
    AUTONOMOUS_BRAKING_FAULT = 7
    MISSION_STATUS_FAULT = 8
    CHARGE_PROCEDURE_FAULT = 9
    BMS_FAULT = 10
    BRAKE_PLAUSIBILITY_FAULT = 11


class SteeringStatus(CarEnum):
    """STEERING_STATUS of 0x520."""

    OFF = 0
    ACTIVE = 1


class BrakeStatus(CarEnum):
    """STATUS_BRK of 0x524."""

    INITIALISING = 0
    READY = 1
    SHUTTING_DOWN = 2
    SHUTDOWN_COMPLETE = 3
    FAULT = 4


class EbsStatus(CarEnum):
    """STATUS_EBS of 0x524."""

    UNAVAILABLE = 1
    ARMED = 2
    TRIGGERED = 3


class OpState(CarEnum):
    """OP_STATE of 0x520 (2026)."""

    OP_INIT = 0
    OP_PUSHBAR = 1
    OP_AUTO = 2
    OP_CHARGE = 3
    OP_FAULT = 15


class TsState(CarEnum):
    """TS_STATE of 0x520 (2026)."""

    TS_INIT = 0
    TS_PRECHARGE = 1
    TS_ACTIVATE = 2
    TS_RUNNING = 3
    TS_SHUTDOWN = 4
    TS_FAULT = 15


class EbsState(CarEnum):
    """EBS_STATE of 0x520 (2026)."""

    EBS_INIT = 0
    EBS_CHARGING = 1
    EBS_ARMED = 2
    EBS_TRIGGERED = 3
    EBS_DISCHARGING = 4
    EBS_FAULT = 15
