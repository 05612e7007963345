"""The car's messages: one class each, its fields in the car's units with the signals that fill them.

An image that was received carries `t_rx_ns`, the monotonic time of its frame, so that a message which stops
arriving can never look fresh. Signals which a revision or a database lacks are None.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, get_args

from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    BrakeStatus,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.fields import NOT_READ, Message, by_message, fields_of, signal
from fsai_vcu.interface.immutable import Immutable

# What follows where a database lacks a signal.
_NOT_SENT: Final = "not sent"
_NO_FAULT: Final = "these faults are not seen"
_NO_SWITCH: Final = "that a switch goes off is not seen"
_NO_WARNING: Final = "these warnings are not seen"
_NO_STATE: Final = "the states of the car's systems are not reported"

# ---------------------------------------------------------------- AI -> VCU


@dataclass(frozen=True, slots=True)
class AiStatus(Message, name="AI2VCU_Status", required=True):
    """0x510 AI2VCU_Status."""

    handshake: bool = signal("HANDSHAKE", False)
    estop_request: bool = signal("ESTOP_REQUEST", False)
    mission_status: MissionStatus = signal("MISSION_STATUS", MissionStatus.NOT_SELECTED)
    direction: Direction = signal("DIRECTION_REQUEST", Direction.NEUTRAL)
    lap_counter: int = signal("LAP_COUNTER", 0, saturates=True, absent=_NOT_SENT)
    cones_count_actual: int = signal("CONES_COUNT_ACTUAL", 0, saturates=True, absent=_NOT_SENT)
    cones_count_all: int = signal("CONES_COUNT_ALL", 0, saturates=True, absent=_NOT_SENT)
    speed_actual_kmh: int = signal("VEH_SPEED_ACTUAL", 0, saturates=True, absent=_NOT_SENT)
    speed_demand_kmh: int = signal("VEH_SPEED_DEMAND", 0, saturates=True, absent=_NOT_SENT)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiDriveFront(Message, name="AI2VCU_Drive_F", required=True):
    """0x511 AI2VCU_Drive_F."""

    torque_nm: float = signal("FRONT_AXLE_TRQ_REQUEST", 0.0, command="front_torque_nm")
    motor_speed_max_rpm: int = signal("FRONT_MOTOR_SPEED_MAX", 0, command="front_motor_speed_max_rpm")
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiDriveRear(Message, name="AI2VCU_Drive_R", required=True):
    """0x512 AI2VCU_Drive_R."""

    torque_nm: float = signal("REAR_AXLE_TRQ_REQUEST", 0.0, command="rear_torque_nm")
    motor_speed_max_rpm: int = signal("REAR_MOTOR_SPEED_MAX", 0, command="rear_motor_speed_max_rpm")
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiSteer(Message, name="AI2VCU_Steer", required=True):
    """0x513 AI2VCU_Steer: bicycle-model road angle, positive turns left (ISO 8855)."""

    steer_deg: float = signal("STEER_REQUEST", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiBrake(Message, name="AI2VCU_Brake", required=True):
    """0x514 AI2VCU_Brake."""

    front_pct: float = signal("HYD_PRESS_F_REQ_pct", 0.0, command="front_brake_pct")
    rear_pct: float = signal("HYD_PRESS_R_REQ_pct", 0.0, command="rear_brake_pct")
    t_rx_ns: int = 0


AiImage = AiStatus | AiDriveFront | AiDriveRear | AiSteer | AiBrake


@dataclass(frozen=True, slots=True)
class AiCommand(Immutable):
    """Everything that the AI computer says in one cycle: 0x510 to 0x514. The default is safe."""

    handshake: bool = False
    estop_request: bool = False
    mission_status: MissionStatus = MissionStatus.NOT_SELECTED
    direction: Direction = Direction.NEUTRAL
    steer_deg: float = 0.0
    front_torque_nm: float = 0.0
    rear_torque_nm: float = 0.0
    front_motor_speed_max_rpm: int = 0
    rear_motor_speed_max_rpm: int = 0
    front_brake_pct: float = 0.0
    rear_brake_pct: float = 0.0
    lap_counter: int = 0
    cones_count_actual: int = 0
    cones_count_all: int = 0
    speed_actual_kmh: int = 0
    speed_demand_kmh: int = 0

    @property
    def torque_requested(self) -> bool:
        return self.front_torque_nm > 0 or self.rear_torque_nm > 0

    @property
    def brake_requested(self) -> bool:
        return self.front_brake_pct > 0 or self.rear_brake_pct > 0


COMMAND_FIELDS: Final[Mapping[type[AiImage], Mapping[str, str]]] = {
    message: {one.name: one.command or one.name for one in fields_of(message)} for message in get_args(AiImage)
}
"""For each message of the AI computer, in sending order: its fields and those of AiCommand."""


# ---------------------------------------------------------------- VCU -> AI


@dataclass(frozen=True, slots=True)
class Faults(Immutable):
    """The fault bits of 0x520. A bit that the database lacks is None."""

    ai_estop_request: bool | None = signal("AI_ESTOP_REQUEST", None, absent=_NO_FAULT)
    hvil_open: bool | None = signal("HVIL_OPEN_FAULT", None, absent=_NO_FAULT)
    hvil_short: bool | None = signal("HVIL_SHORT_FAULT", None, absent=_NO_FAULT)
    ebs: bool | None = signal("EBS_FAULT", None, absent=_NO_FAULT)
    offboard_charger: bool | None = signal("OFFBOARD_CHARGER_FAULT", None, absent=_NO_FAULT)
    ai_comms_lost: bool | None = signal("AI_COMMS_LOST", None, absent=_NO_FAULT)
    autonomous_braking: bool | None = signal("AUTONOMOUS_BRAKING_FAULT", None, absent=_NO_FAULT)
    mission_status: bool | None = signal("MISSION_STATUS_FAULT", None, absent=_NO_FAULT)
    charge_procedure: bool | None = signal("CHARGE_PROCEDURE_FAULT", None, absent=_NO_FAULT)
    bms: bool | None = signal("BMS_FAULT", None, absent=_NO_FAULT)
    brake_plausibility: bool | None = signal("BRAKE_PLAUSIBILITY_FAULT", None, absent=_NO_FAULT)

    @property
    def names(self) -> tuple[str, ...]:
        """The bits that are set, as the databases call them."""
        return tuple(name for field, name in FAULT_NAMES.items() if getattr(self, field))


FAULT_NAMES: Final[Mapping[str, str]] = {one.name: one.signal for one in fields_of(Faults)}
"""For each field of Faults the databases' name, which is also the one for people."""


@dataclass(frozen=True, slots=True)
class VcuStatus(Message, name="VCU2AI_Status", required=True):
    """0x520 VCU2AI_Status."""

    handshake: bool = signal("HANDSHAKE", False)
    shutdown_request: bool = signal("SHUTDOWN_REQUEST", False, absent="no request to shut down is seen")
    as_switch: bool | None = signal("AS_SWITCH_STATUS", False, absent=_NO_SWITCH)
    ts_switch: bool | None = signal("TS_SWITCH_STATUS", False, absent=_NO_SWITCH)
    go_signal: bool = signal("GO_SIGNAL", False)
    steering_status: SteeringStatus | None = signal(
        "STEERING_STATUS",
        SteeringStatus.OFF,
        unknown=SteeringStatus.OFF,
        absent="that the steering is not active is not seen",
    )
    as_state: AsState = signal("AS_STATE", AsState.AS_OFF)
    ami: Ami = signal("AMI_STATE", Ami.NOT_SELECTED, unknown=Ami.NOT_SELECTED)
    fault: bool = signal("FAULT_STATUS", False, absent="that the VCU has found a fault is not seen")
    warning: bool = signal("WARNING_STATUS", False, absent=_NO_WARNING)
    warn_batt_temp_high: bool = signal("WARN_BATT_TEMP_HIGH", False, absent=_NO_WARNING)
    warn_batt_soc_low: bool = signal("WARN_BATT_SOC_LOW", False, absent=_NO_WARNING)
    faults: Faults = field(default_factory=Faults)
    shutdown_cause: ShutdownCause | None = signal(
        "SHUTDOWN_CAUSE", None, unknown=None, absent="why the car shut down is not reported"
    )
    # The interface's tables give 255 for fault in a field of four bits: 15 and anything unknown is a fault.
    op_state: OpState | None = signal("OP_STATE", None, unknown=OpState.OP_FAULT, absent=_NO_STATE)
    ts_state: TsState | None = signal("TS_STATE", None, unknown=TsState.TS_FAULT, absent=_NO_STATE)
    ebs_state: EbsState | None = signal("EBS_STATE", None, unknown=EbsState.EBS_FAULT, absent=_NO_STATE)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuDriveFront(Message, name="VCU2AI_Drive_F", required=True):
    """0x521 VCU2AI_Drive_F."""

    torque_nm: float = signal("FRONT_AXLE_TRQ", 0.0)
    torque_request_nm: float = signal("FRONT_AXLE_TRQ_REQUEST", 0.0)
    torque_max_nm: float = signal("FRONT_AXLE_TRQ_MAX", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuDriveRear(Message, name="VCU2AI_Drive_R", required=True):
    """0x522 VCU2AI_Drive_R."""

    torque_nm: float = signal("REAR_AXLE_TRQ", 0.0)
    torque_request_nm: float = signal("REAR_AXLE_TRQ_REQUEST", 0.0)
    torque_max_nm: float = signal("REAR_AXLE_TRQ_MAX", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuSteer(Message, name="VCU2AI_Steer", required=True):
    """0x523 VCU2AI_Steer."""

    angle_deg: float = signal("ANGLE", 0.0)
    angle_max_deg: float = signal("ANGLE_MAX", 0.0)
    angle_request_deg: float = signal("ANGLE_REQUEST", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuBrake(Message, name="VCU2AI_Brake", required=True):
    """0x524 VCU2AI_Brake."""

    front_pct: float = signal("HYD_PRESS_F_pct", 0.0)
    front_request_pct: float = signal("HYD_PRESS_F_REQ_pct", 0.0)
    rear_pct: float = signal("HYD_PRESS_R_pct", 0.0)
    rear_request_pct: float = signal("HYD_PRESS_R_REQ_pct", 0.0)
    brake_status: BrakeStatus | None = signal("STATUS_BRK", None, unknown=None)
    # 0 is not in the table, and yet what the official simulator always sends.
    ebs_status: EbsStatus | None = signal("STATUS_EBS", None, unknown=None, unremarkable=(0,))
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class WheelSpeeds(Message, name="VCU2AI_Speeds", required=True):
    """0x525 VCU2AI_Speeds."""

    fl_rpm: int = signal("{fl}_WHEEL_SPEED", 0)
    fr_rpm: int = signal("{fr}_WHEEL_SPEED", 0)
    rl_rpm: int = signal("{rl}_WHEEL_SPEED", 0)
    rr_rpm: int = signal("{rr}_WHEEL_SPEED", 0)
    t_rx_ns: int = 0

    @property
    def all_rpm(self) -> tuple[int, int, int, int]:
        return (self.fl_rpm, self.fr_rpm, self.rl_rpm, self.rr_rpm)


@dataclass(frozen=True, slots=True)
class WheelCounts(Message, name="VCU2AI_Wheel_counts", required=True):
    """0x526 VCU2AI_Wheel_counts: 16-bit pulse counters that wrap."""

    fl: int = signal("{fl}_PULSE_COUNT", 0)
    fr: int = signal("{fr}_PULSE_COUNT", 0)
    rl: int = signal("{rl}_PULSE_COUNT", 0)
    rr: int = signal("{rr}_PULSE_COUNT", 0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class LogDynamics1(Message, name="VCU2LOG_Dynamics1"):
    """0x500 VCU2LOG_Dynamics1."""

    speed_actual_kmh: int = signal("Speed_actual", 0, saturates=True)
    speed_target_kmh: int = signal("Speed_target", 0, saturates=True)
    steer_actual_deg: float = signal("Steer_actual", 0.0, saturates=True)
    steer_target_deg: float = signal("Steer_target", 0.0, saturates=True)
    brake_actual_pct: int = signal("Brake_actual_pct", 0, saturates=True)
    brake_target_pct: int = signal("Brake_target_pct", 0, saturates=True)
    torque_actual_pct: int = signal("Drive_trq_actual_pct", 0, saturates=True)
    torque_target_pct: int = signal("Drive_trq_target_pct", 0, saturates=True)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class LogStatus(Message, name="VCU2LOG_Status"):
    """0x502 VCU2LOG_Status. The small state fields stay raw: they are for people and logs only."""

    assi: int = signal("State_ASSI", 0)
    ebs: int = signal("State_EBS", 0)
    ami: int = signal("AMI_STATE", 0)
    steering: int = signal("State_steering", 0)
    service_brake: int = signal("State_service_brake", 0)
    lap_counter: int = signal("Lap_counter", 0, saturates=True)
    cones_count_actual: int = signal("Cones_count_actual", 0, saturates=True)
    cones_count_all: int = signal("Cones_count_all", 0, saturates=True)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuSystemStatus(Message, name="VCU_STATUS"):
    """0x120 VCU_STATUS (2021 only): the VCU's inner state machine and its AI time-outs."""

    sm_sys: int = signal("SM_SYS", 0)
    sm_as: int = signal("SM_AS", 0)
    sys_action_state: int = signal("SYS_ACTION_STATE", 0)
    status_timeout: bool = signal("R1_AI2VCU_STATUS_TIMEOUT_ERROR", False, absent=NOT_READ)
    drive_front_timeout: bool = signal("R1_AI2VCU_DRIVE_F_TIMEOUT_ERROR", False, absent=NOT_READ)
    drive_rear_timeout: bool = signal("R1_AI2VCU_DRIVE_R_TIMEOUT_ERROR", False, absent=NOT_READ)
    steer_timeout: bool = signal("R1_AI2VCU_STEER_TIMEOUT_ERROR", False, absent=NOT_READ)
    brake_timeout: bool = signal("R1_AI2VCU_BRAKE_TIMEOUT_ERROR", False, absent=NOT_READ)
    handshake_timeout: bool = signal("R1_AI2VCU_STATUS_HANDSHAKE_TIMEOUT_ERROR", False, absent=NOT_READ)
    warn_brake_plausibility: bool = signal("WARN_BRAKE_PLAUSIBILITY", False, absent=NOT_READ)
    warn_kl15_under_v: bool = signal("WARN_KL15_UNDER_V", False, absent=NOT_READ)
    warn_ai_estop_req: bool = signal("WARN_AI_ESTOP_REQ", False, absent=NOT_READ)
    warn_ai_comms_lost: bool = signal("WARN_AI_COMMS_LOST", False, absent=NOT_READ)
    warn_auto_braking: bool = signal("WARN_AUTO_BRAKING", False, absent=NOT_READ)
    warn_mission_status: bool = signal("WARN_MISSION_STATUS", False, absent=NOT_READ)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VehicleState(Immutable):
    """What the car has reported so far. None means never received; each image carries the time of its frame.

    `handshake` is the bit of the newest 0x520, believed even when the rest of that frame was not
    (an AS_STATE outside the table leaves `status` as it was, to grow stale); `status_known` tells of such a frame.
    """

    handshake: bool = False
    status: VcuStatus | None = None
    drive_front: VcuDriveFront | None = None
    drive_rear: VcuDriveRear | None = None
    steer: VcuSteer | None = None
    brake: VcuBrake | None = None
    speeds: WheelSpeeds | None = None
    counts: WheelCounts | None = None
    log_dynamics: LogDynamics1 | None = None
    log_status: LogStatus | None = None
    system: VcuSystemStatus | None = None
    status_known: bool = True  # False: the newest 0x520 is not the one in `status`, nobody knows what it says


VEHICLE_FIELD_OF: Final = by_message(VehicleState)


# ---------------------------------------------------------------- PCAN-GPS


@dataclass(frozen=True, slots=True)
class Acceleration(Message, name="BMC_Acceleration"):
    """0x600 BMC_Acceleration, in the sensor's axes."""

    x_mg: float = signal("Acceleration_X", 0.0)
    y_mg: float = signal("Acceleration_Y", 0.0)
    z_mg: float = signal("Acceleration_Z", 0.0)
    temperature_degc: float = signal("Temperature", 0.0)
    vertical_axis: int = signal("VerticalAxis", 0)
    orientation: int = signal("Orientation", 0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class RotationA(Message, name="L3GD20_Rotation_A"):
    """0x610 L3GD20_Rotation_A."""

    x_degps: float = signal("Rotation_X", 0.0)
    y_degps: float = signal("Rotation_Y", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class RotationB(Message, name="L3GD20_Rotation_B"):
    """0x611 L3GD20_Rotation_B."""

    z_degps: float = signal("Rotation_Z", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsStatus(Message, name="GPS_Status"):
    """0x620 GPS_Status."""

    antenna: int = signal("GPS_AntennaStatus", 0)
    satellites: int = signal("GPS_NumSatellites", 0)
    navigation_method: int = signal("GPS_NavigationMethod", 0)  # 0 INIT, 1 NONE, 2 2D, 3 3D
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsLongitude(Message, name="GPS_PositionLongitude"):
    """0x622 GPS_PositionLongitude: whole degrees, minutes and a letter (0 before a fix)."""

    minutes: float = signal("GPS_Longitude_Minutes", 0.0)
    degrees: int = signal("GPS_Longitude_Degree", 0)
    indicator: int = signal("GPS_IndicatorEW", 0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsLatitude(Message, name="GPS_PositionLatitude"):
    """0x623 GPS_PositionLatitude: whole degrees, minutes and a letter (0 before a fix)."""

    minutes: float = signal("GPS_Latitude_Minutes", 0.0)
    degrees: int = signal("GPS_Latitude_Degree", 0)
    indicator: int = signal("GPS_IndicatorNS", 0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsAltitude(Message, name="GPS_PositionAltitude"):
    """0x624 GPS_PositionAltitude."""

    altitude_m: float = signal("GPS_Altitude", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsDilutionA(Message, name="GPS_Delusions_A"):
    """0x625 GPS_Delusions_A: PDOP, then HDOP."""

    pdop: float = signal("GPS_PDOP", 0.0)
    hdop: float = signal("GPS_HDOP", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsDilutionB(Message, name="GPS_Delusions_B"):
    """0x626: VDOP."""

    vdop: float = signal("GPS_VDOP", 0.0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class LogDynamics2(Message, name="AI2LOG_Dynamics2"):
    """0x501 AI2LOG_Dynamics2: sent by the PCAN-GPS, or by the AI computer on a car without one."""

    accel_longitudinal_mps2: float = signal("Accel_longitudinal_mps2", 0.0, saturates=True)
    accel_lateral_mps2: float = signal("Accel_lateral_mps2", 0.0, saturates=True)
    yaw_rate_degps: float = signal("Yaw_rate_degps", 0.0, saturates=True)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsImu(Immutable):
    """What the PCAN-GPS has reported so far, of what is read of it. None: never received."""

    acceleration: Acceleration | None = None
    rotation_a: RotationA | None = None
    rotation_b: RotationB | None = None
    status: GpsStatus | None = None
    longitude: GpsLongitude | None = None
    latitude: GpsLatitude | None = None
    altitude: GpsAltitude | None = None
    dilution_a: GpsDilutionA | None = None
    dilution_b: GpsDilutionB | None = None
    dynamics: LogDynamics2 | None = None


GPS_FIELD_OF: Final = by_message(GpsImu)

Image = Message
MESSAGES: Final[tuple[type[Image], ...]] = (*get_args(AiImage), *VEHICLE_FIELD_OF, *GPS_FIELD_OF)
"""Every message that has a class, those of the AI computer first and in sending order."""
