"""The signals that an explanation is about, and a few words that several of its parts share."""

from __future__ import annotations

from typing import Final

from fsai_vcu.core.vehicle.parameters import CARS, VehicleParameters
from fsai_vcu.diagnostics.explain.record import Record, Signal
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    BrakeStatus,
    CarEnum,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.messages import FAULT_NAMES
from fsai_vcu.interface.reserved import AI_IDS

DRIVING: Final = float(AsState.AS_DRIVING)
READY: Final = float(AsState.AS_READY)
EMERGENCY: Final = float(AsState.EMERGENCY_BRAKE)
FINISHED: Final = float(AsState.AS_FINISHED)

STATUS: Final = 0x520
AS_STATE: Final = Signal("VCU2AI_Status", "AS_STATE")
AS_SWITCH: Final = Signal("VCU2AI_Status", "AS_SWITCH_STATUS")
TS_SWITCH: Final = Signal("VCU2AI_Status", "TS_SWITCH_STATUS")
GO: Final = Signal("VCU2AI_Status", "GO_SIGNAL")
STEERING_STATUS: Final = Signal("VCU2AI_Status", "STEERING_STATUS")
AMI: Final = Signal("VCU2AI_Status", "AMI_STATE")
FAULT_STATUS: Final = Signal("VCU2AI_Status", "FAULT_STATUS")
WARNING_STATUS: Final = Signal("VCU2AI_Status", "WARNING_STATUS")
SHUTDOWN_REQUEST: Final = Signal("VCU2AI_Status", "SHUTDOWN_REQUEST")
SHUTDOWN_CAUSE: Final = Signal("VCU2AI_Status", "SHUTDOWN_CAUSE")
OP_STATE: Final = Signal("VCU2AI_Status", "OP_STATE")
TS_STATE: Final = Signal("VCU2AI_Status", "TS_STATE")
EBS_STATE: Final = Signal("VCU2AI_Status", "EBS_STATE")
FAULTS: Final = tuple(Signal("VCU2AI_Status", name) for name in FAULT_NAMES.values())
WARNINGS: Final = tuple(Signal("VCU2AI_Status", name) for name in ("WARN_BATT_TEMP_HIGH", "WARN_BATT_SOC_LOW"))
WHEEL_NAMES: Final = ("FL", "FR", "RL", "RR")
WHEELS: Final = tuple(Signal("VCU2AI_Speeds", f"{name}_WHEEL_SPEED") for name in WHEEL_NAMES)
PULSES: Final = tuple(Signal("VCU2AI_Wheel_counts", f"{name}_PULSE_COUNT") for name in WHEEL_NAMES)
ANGLE: Final = Signal("VCU2AI_Steer", "ANGLE")
ANGLE_MAX: Final = Signal("VCU2AI_Steer", "ANGLE_MAX")
STATUS_BRK: Final = Signal("VCU2AI_Brake", "STATUS_BRK")
STATUS_EBS: Final = Signal("VCU2AI_Brake", "STATUS_EBS")
BRAKE_F: Final = Signal("VCU2AI_Brake", "HYD_PRESS_F_pct")
BRAKE_R: Final = Signal("VCU2AI_Brake", "HYD_PRESS_R_pct")

ESTOP: Final = Signal("AI2VCU_Status", "ESTOP_REQUEST")
MISSION_STATUS: Final = Signal("AI2VCU_Status", "MISSION_STATUS")
DIRECTION: Final = Signal("AI2VCU_Status", "DIRECTION_REQUEST")
TORQUE_F: Final = Signal("AI2VCU_Drive_F", "FRONT_AXLE_TRQ_REQUEST")
TORQUE_R: Final = Signal("AI2VCU_Drive_R", "REAR_AXLE_TRQ_REQUEST")
SPEED_MAX_F: Final = Signal("AI2VCU_Drive_F", "FRONT_MOTOR_SPEED_MAX")
SPEED_MAX_R: Final = Signal("AI2VCU_Drive_R", "REAR_MOTOR_SPEED_MAX")
STEER: Final = Signal("AI2VCU_Steer", "STEER_REQUEST")
BRAKE_REQ_F: Final = Signal("AI2VCU_Brake", "HYD_PRESS_F_REQ_pct")
BRAKE_REQ_R: Final = Signal("AI2VCU_Brake", "HYD_PRESS_R_REQ_pct")

SYSTEM: Final = "VCU_STATUS"
SM_SYS: Final = Signal(SYSTEM, "SM_SYS")
# What 0x120 (2021) reports as missing
MISSED: Final = {
    **{
        Signal(SYSTEM, f"R1_AI2VCU_{name}_TIMEOUT_ERROR"): str(BY_ID[can_id])
        for can_id, name in zip(AI_IDS, ("STATUS", "DRIVE_F", "DRIVE_R", "STEER", "BRAKE"), strict=True)
    },
    Signal(SYSTEM, "R1_AI2VCU_STATUS_HANDSHAKE_TIMEOUT_ERROR"): "the handshake's echo",
}
_WARNINGS = ("BRAKE_PLAUSIBILITY", "KL15_UNDER_V", "AI_ESTOP_REQ", "AI_COMMS_LOST", "AUTO_BRAKING", "MISSION_STATUS")
SYSTEM_WARNINGS: Final = tuple(Signal(SYSTEM, f"WARN_{name}") for name in _WARNINGS)
REMOTE_ESTOP: Final = Signal("RES_TPDO", "ESTOP_STATUS")
RADIO_STRENGTH: Final = Signal("RES_TPDO", "RADIO_STRENGTH")

# Where a number has the car's own word
LABELS: Final[dict[Signal, type[CarEnum]]] = {
    AS_STATE: AsState,
    AMI: Ami,
    SHUTDOWN_CAUSE: ShutdownCause,
    OP_STATE: OpState,
    TS_STATE: TsState,
    EBS_STATE: EbsState,
    STEERING_STATUS: SteeringStatus,
    STATUS_BRK: BrakeStatus,
    STATUS_EBS: EbsStatus,
    MISSION_STATUS: MissionStatus,
    DIRECTION: Direction,
}


def label(signal: Signal, value: float | None) -> str:
    """A value in the car's own word; its number where there is none."""
    if value is None:
        return "nothing yet"
    if signal not in LABELS:
        return f"{value:g}"
    try:
        return LABELS[signal](int(value)).label
    except ValueError:
        return f"{int(value)} (not in the interface's table)"


def car_of(record: Record) -> VehicleParameters:
    """The figures of the car that wrote the log."""
    return CARS["official-simulator" if like_official_simulator(record) else record.revision.name]


def like_official_simulator(record: Record) -> bool:
    """The official simulator sends STATUS_BRK and STATUS_EBS as 0, always; a car in AS_READY never does."""
    brake, ebs = record.series(STATUS_BRK), record.series(STATUS_EBS)
    beyond_off = (record.series(AS_STATE).values >= READY).any()
    return bool(beyond_off and len(brake) and not brake.values.any() and not ebs.values.any())
