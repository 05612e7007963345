"""The signals that an explanation is about, and a few words that several of its parts share."""

from __future__ import annotations

from typing import Final, NamedTuple

from fsai_vcu.diagnostics.explain.incident import ChainLink, Claim
from fsai_vcu.interface.bus_table import BY_ID, BY_NAME
from fsai_vcu.interface.enums import AsState, CarEnum
from fsai_vcu.interface.fields import fields_of
from fsai_vcu.interface.messages import FAULT_NAMES, AiStatus, VcuBrake, VcuStatus
from fsai_vcu.interface.reserved import AI_IDS


class Signal(NamedTuple):
    """A signal by the names of the databases."""

    message: str
    name: str

    @property
    def can_id(self) -> int:
        return BY_NAME[self.message].can_id

    def step(self, t_ns: int, words: str, *claims: Claim) -> ChainLink:
        """A link of a cause chain which a frame with this signal shows."""
        return ChainLink(t_ns, words, self.can_id, self.name, claims)

    def was(self, value: float, begin_ns: int, end_ns: int | None = None) -> Claim:
        """The claim that it had this value then: all the time, or at `begin_ns`."""
        return Claim(self, value, value, begin_ns, begin_ns if end_ns is None else end_ns)


DRIVING: Final = float(AsState.AS_DRIVING)
READY: Final = float(AsState.AS_READY)
EMERGENCY: Final = float(AsState.EMERGENCY_BRAKE)
FINISHED: Final = float(AsState.AS_FINISHED)

STATUS: Final = 0x520
AS_STATE: Final = Signal("VCU2AI_Status", "AS_STATE")
AS_SWITCH: Final = Signal("VCU2AI_Status", "AS_SWITCH_STATUS")
TS_SWITCH: Final = Signal("VCU2AI_Status", "TS_SWITCH_STATUS")
HANDSHAKE: Final = Signal("VCU2AI_Status", "HANDSHAKE")
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
COMMS_LOST: Final = Signal("VCU2AI_Status", "AI_COMMS_LOST")
FAULTS: Final = tuple(Signal("VCU2AI_Status", name) for name in FAULT_NAMES.values())
WARNINGS: Final = tuple(Signal("VCU2AI_Status", name) for name in ("WARN_BATT_TEMP_HIGH", "WARN_BATT_SOC_LOW"))
WHEEL_NAMES: Final = ("FL", "FR", "RL", "RR")
WHEELS: Final = tuple(Signal("VCU2AI_Speeds", f"{name}_WHEEL_SPEED") for name in WHEEL_NAMES)
PULSES: Final = tuple(Signal("VCU2AI_Wheel_counts", f"{name}_PULSE_COUNT") for name in WHEEL_NAMES)
ANGLE: Final = Signal("VCU2AI_Steer", "ANGLE")
ANGLE_MAX: Final = Signal("VCU2AI_Steer", "ANGLE_MAX")
CAR_TORQUE: Final = (Signal("VCU2AI_Drive_F", "FRONT_AXLE_TRQ"), Signal("VCU2AI_Drive_R", "REAR_AXLE_TRQ"))
CAR_TORQUE_MAX: Final = (Signal("VCU2AI_Drive_F", "FRONT_AXLE_TRQ_MAX"), Signal("VCU2AI_Drive_R", "REAR_AXLE_TRQ_MAX"))
STATUS_BRK: Final = Signal("VCU2AI_Brake", "STATUS_BRK")
STATUS_EBS: Final = Signal("VCU2AI_Brake", "STATUS_EBS")
BRAKE_F: Final = Signal("VCU2AI_Brake", "HYD_PRESS_F_pct")
BRAKE_R: Final = Signal("VCU2AI_Brake", "HYD_PRESS_R_pct")

ECHO: Final = Signal("AI2VCU_Status", "HANDSHAKE")
ESTOP: Final = Signal("AI2VCU_Status", "ESTOP_REQUEST")
MISSION_STATUS: Final = Signal("AI2VCU_Status", "MISSION_STATUS")
DIRECTION: Final = Signal("AI2VCU_Status", "DIRECTION_REQUEST")
LAP: Final = Signal("AI2VCU_Status", "LAP_COUNTER")
CONES: Final = Signal("AI2VCU_Status", "CONES_COUNT_ACTUAL")
TORQUE_F: Final = Signal("AI2VCU_Drive_F", "FRONT_AXLE_TRQ_REQUEST")
TORQUE_R: Final = Signal("AI2VCU_Drive_R", "REAR_AXLE_TRQ_REQUEST")
SPEED_MAX_F: Final = Signal("AI2VCU_Drive_F", "FRONT_MOTOR_SPEED_MAX")
SPEED_MAX_R: Final = Signal("AI2VCU_Drive_R", "REAR_MOTOR_SPEED_MAX")
STEER: Final = Signal("AI2VCU_Steer", "STEER_REQUEST")
BRAKE_REQ_F: Final = Signal("AI2VCU_Brake", "HYD_PRESS_F_REQ_pct")
BRAKE_REQ_R: Final = Signal("AI2VCU_Brake", "HYD_PRESS_R_REQ_pct")

SYSTEM: Final = "VCU_STATUS"
SM_SYS: Final = Signal(SYSTEM, "SM_SYS")
DRIVE_AUTONOMOUS: Final = 4.0  # of SM_SYS (interface specification v4.0)
# Messages that 0x120 (2021) reports as missing
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
REMOTE_GO: Final = Signal("RES_TPDO", "K2_SWITCH_GO_STATUS")
RADIO_STRENGTH: Final = Signal("RES_TPDO", "RADIO_STRENGTH")
SUPPLY: Final = Signal("VCU2OPUS_1", "VBAT_ADC")
ACCUMULATORS: Final = (
    Signal("VCU2OPUS_2", "EBS_FRONT_ACC_PRESS"),
    Signal("VCU2OPUS_2", "EBS_REAR_ACC_PRESS"),
)

# Numbers that have the car's own word
LABELS: Final[dict[Signal, type[CarEnum]]] = {
    Signal(message.dbc_name, one.signal): one.holds
    for message in (AiStatus, VcuStatus, VcuBrake)
    for one in fields_of(message)
    if issubclass(one.holds, CarEnum)
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
