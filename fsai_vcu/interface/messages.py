"""The car's messages: one class each, its fields in the car's units with the signals that fill them.

An image that was received carries `t_rx_ns`, the monotonic time of its frame, so that a message which stops
arriving can never look fresh. Signals which a revision or a database lacks are None.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, get_args

from msgspec import field

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
from fsai_vcu.interface.fields import NOT_READ, Message, Signal, by_message, fields_of
from fsai_vcu.interface.values import Value

# Consequences of a database that lacks a signal.
_NOT_SENT: Final = "not sent"
_NO_FAULT: Final = "these faults are not seen"
_NO_SWITCH: Final = "that a switch goes off is not seen"
_NO_WARNING: Final = "these warnings are not seen"
_NO_STATE: Final = "the states of the car's systems are not reported"

# ---------------------------------------------------------------- AI -> VCU


class AiStatus(Message, frozen=True):
    """0x510 AI2VCU_Status."""

    dbc_name, required = "AI2VCU_Status", True

    handshake: Annotated[bool, Signal("HANDSHAKE")] = False
    estop_request: Annotated[bool, Signal("ESTOP_REQUEST")] = False
    mission_status: Annotated[MissionStatus, Signal("MISSION_STATUS")] = MissionStatus.NOT_SELECTED
    direction: Annotated[Direction, Signal("DIRECTION_REQUEST")] = Direction.NEUTRAL
    lap_counter: Annotated[int, Signal("LAP_COUNTER", saturates=True, absent=_NOT_SENT)] = 0
    cones_count_actual: Annotated[int, Signal("CONES_COUNT_ACTUAL", saturates=True, absent=_NOT_SENT)] = 0
    cones_count_all: Annotated[int, Signal("CONES_COUNT_ALL", saturates=True, absent=_NOT_SENT)] = 0
    speed_actual_kmh: Annotated[int, Signal("VEH_SPEED_ACTUAL", saturates=True, absent=_NOT_SENT)] = 0
    speed_demand_kmh: Annotated[int, Signal("VEH_SPEED_DEMAND", saturates=True, absent=_NOT_SENT)] = 0
    t_rx_ns: int = 0


class AiDriveFront(Message, frozen=True):
    """0x511 AI2VCU_Drive_F."""

    dbc_name, required = "AI2VCU_Drive_F", True

    torque_nm: Annotated[float, Signal("FRONT_AXLE_TRQ_REQUEST", command="front_torque_nm")] = 0.0
    motor_speed_max_rpm: Annotated[int, Signal("FRONT_MOTOR_SPEED_MAX", command="front_motor_speed_max_rpm")] = 0
    t_rx_ns: int = 0


class AiDriveRear(Message, frozen=True):
    """0x512 AI2VCU_Drive_R."""

    dbc_name, required = "AI2VCU_Drive_R", True

    torque_nm: Annotated[float, Signal("REAR_AXLE_TRQ_REQUEST", command="rear_torque_nm")] = 0.0
    motor_speed_max_rpm: Annotated[int, Signal("REAR_MOTOR_SPEED_MAX", command="rear_motor_speed_max_rpm")] = 0
    t_rx_ns: int = 0


class AiSteer(Message, frozen=True):
    """0x513 AI2VCU_Steer: bicycle-model road angle, positive turns left (ISO 8855)."""

    dbc_name, required = "AI2VCU_Steer", True

    steer_deg: Annotated[float, Signal("STEER_REQUEST")] = 0.0
    t_rx_ns: int = 0


class AiBrake(Message, frozen=True):
    """0x514 AI2VCU_Brake."""

    dbc_name, required = "AI2VCU_Brake", True

    front_pct: Annotated[float, Signal("HYD_PRESS_F_REQ_pct", command="front_brake_pct")] = 0.0
    rear_pct: Annotated[float, Signal("HYD_PRESS_R_REQ_pct", command="rear_brake_pct")] = 0.0
    t_rx_ns: int = 0


AiImage = AiStatus | AiDriveFront | AiDriveRear | AiSteer | AiBrake


class AiCommand(Value, frozen=True):
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
"""Fields of each message of the AI computer, in sending order, and those of AiCommand."""


def command_of(images: Mapping[type, AiImage]) -> AiCommand:
    """One command out of the newest image of each of the five messages; those not received count as safe defaults."""
    values: dict[str, Any] = {}
    for image_type, names in COMMAND_FIELDS.items():
        image = images.get(image_type)
        if image is not None:
            values.update({theirs: getattr(image, ours) for ours, theirs in names.items()})
    return AiCommand(**values)


# ---------------------------------------------------------------- VCU -> AI


class Faults(Value, frozen=True):
    """The fault bits of 0x520. A bit that the database lacks is None."""

    ai_estop_request: Annotated[bool | None, Signal("AI_ESTOP_REQUEST", absent=_NO_FAULT)] = None
    hvil_open: Annotated[bool | None, Signal("HVIL_OPEN_FAULT", absent=_NO_FAULT)] = None
    hvil_short: Annotated[bool | None, Signal("HVIL_SHORT_FAULT", absent=_NO_FAULT)] = None
    ebs: Annotated[bool | None, Signal("EBS_FAULT", absent=_NO_FAULT)] = None
    offboard_charger: Annotated[bool | None, Signal("OFFBOARD_CHARGER_FAULT", absent=_NO_FAULT)] = None
    ai_comms_lost: Annotated[bool | None, Signal("AI_COMMS_LOST", absent=_NO_FAULT)] = None
    autonomous_braking: Annotated[bool | None, Signal("AUTONOMOUS_BRAKING_FAULT", absent=_NO_FAULT)] = None
    mission_status: Annotated[bool | None, Signal("MISSION_STATUS_FAULT", absent=_NO_FAULT)] = None
    charge_procedure: Annotated[bool | None, Signal("CHARGE_PROCEDURE_FAULT", absent=_NO_FAULT)] = None
    bms: Annotated[bool | None, Signal("BMS_FAULT", absent=_NO_FAULT)] = None
    brake_plausibility: Annotated[bool | None, Signal("BRAKE_PLAUSIBILITY_FAULT", absent=_NO_FAULT)] = None

    @property
    def names(self) -> tuple[str, ...]:
        """The bits that are set, as the databases call them."""
        return tuple(name for field, name in FAULT_NAMES.items() if getattr(self, field))


FAULT_NAMES: Final[Mapping[str, str]] = {one.name: one.signal for one in fields_of(Faults)}
"""Databases' name for each field of Faults, which is also the name for people."""


class VcuStatus(Message, frozen=True):
    """0x520 VCU2AI_Status."""

    dbc_name, required = "VCU2AI_Status", True

    handshake: Annotated[bool, Signal("HANDSHAKE")] = False
    shutdown_request: Annotated[bool, Signal("SHUTDOWN_REQUEST", absent="no request to shut down is seen")] = False
    as_switch: Annotated[bool | None, Signal("AS_SWITCH_STATUS", absent=_NO_SWITCH)] = False
    ts_switch: Annotated[bool | None, Signal("TS_SWITCH_STATUS", absent=_NO_SWITCH)] = False
    go_signal: Annotated[bool, Signal("GO_SIGNAL")] = False
    steering_status: Annotated[
        SteeringStatus | None,
        Signal("STEERING_STATUS", unknown=SteeringStatus.OFF, absent="that the steering is not active is not seen"),
    ] = SteeringStatus.OFF
    as_state: Annotated[AsState, Signal("AS_STATE")] = AsState.AS_OFF
    ami: Annotated[Ami, Signal("AMI_STATE", unknown=Ami.NOT_SELECTED)] = Ami.NOT_SELECTED
    fault: Annotated[bool, Signal("FAULT_STATUS", absent="that the VCU has found a fault is not seen")] = False
    warning: Annotated[bool, Signal("WARNING_STATUS", absent=_NO_WARNING)] = False
    warn_batt_temp_high: Annotated[bool, Signal("WARN_BATT_TEMP_HIGH", absent=_NO_WARNING)] = False
    warn_batt_soc_low: Annotated[bool, Signal("WARN_BATT_SOC_LOW", absent=_NO_WARNING)] = False
    faults: Faults = field(default_factory=Faults)
    shutdown_cause: Annotated[
        ShutdownCause | None, Signal("SHUTDOWN_CAUSE", unknown=None, absent="why the car shut down is not reported")
    ] = None
    # The interface's tables give 255 for fault in a field of four bits: 15 and anything unknown is a fault.
    op_state: Annotated[OpState | None, Signal("OP_STATE", unknown=OpState.OP_FAULT, absent=_NO_STATE)] = None
    ts_state: Annotated[TsState | None, Signal("TS_STATE", unknown=TsState.TS_FAULT, absent=_NO_STATE)] = None
    ebs_state: Annotated[EbsState | None, Signal("EBS_STATE", unknown=EbsState.EBS_FAULT, absent=_NO_STATE)] = None
    t_rx_ns: int = 0


class VcuDriveFront(Message, frozen=True):
    """0x521 VCU2AI_Drive_F."""

    dbc_name, required = "VCU2AI_Drive_F", True

    torque_nm: Annotated[float, Signal("FRONT_AXLE_TRQ")] = 0.0
    torque_request_nm: Annotated[float, Signal("FRONT_AXLE_TRQ_REQUEST")] = 0.0
    torque_max_nm: Annotated[float, Signal("FRONT_AXLE_TRQ_MAX")] = 0.0
    t_rx_ns: int = 0


class VcuDriveRear(Message, frozen=True):
    """0x522 VCU2AI_Drive_R."""

    dbc_name, required = "VCU2AI_Drive_R", True

    torque_nm: Annotated[float, Signal("REAR_AXLE_TRQ")] = 0.0
    torque_request_nm: Annotated[float, Signal("REAR_AXLE_TRQ_REQUEST")] = 0.0
    torque_max_nm: Annotated[float, Signal("REAR_AXLE_TRQ_MAX")] = 0.0
    t_rx_ns: int = 0


class VcuSteer(Message, frozen=True):
    """0x523 VCU2AI_Steer."""

    dbc_name, required = "VCU2AI_Steer", True

    angle_deg: Annotated[float, Signal("ANGLE")] = 0.0
    angle_max_deg: Annotated[float, Signal("ANGLE_MAX")] = 0.0
    angle_request_deg: Annotated[float, Signal("ANGLE_REQUEST")] = 0.0
    t_rx_ns: int = 0


class VcuBrake(Message, frozen=True):
    """0x524 VCU2AI_Brake."""

    dbc_name, required = "VCU2AI_Brake", True

    front_pct: Annotated[float, Signal("HYD_PRESS_F_pct")] = 0.0
    front_request_pct: Annotated[float, Signal("HYD_PRESS_F_REQ_pct")] = 0.0
    rear_pct: Annotated[float, Signal("HYD_PRESS_R_pct")] = 0.0
    rear_request_pct: Annotated[float, Signal("HYD_PRESS_R_REQ_pct")] = 0.0
    brake_status: Annotated[BrakeStatus | None, Signal("STATUS_BRK", unknown=None)] = None
    # 0 is not in the table, and yet what the official simulator always sends.
    ebs_status: Annotated[EbsStatus | None, Signal("STATUS_EBS", unknown=None, unremarkable=(0,))] = None
    t_rx_ns: int = 0


class WheelSpeeds(Message, frozen=True):
    """0x525 VCU2AI_Speeds."""

    dbc_name, required = "VCU2AI_Speeds", True

    fl_rpm: Annotated[int, Signal("{fl}_WHEEL_SPEED")] = 0
    fr_rpm: Annotated[int, Signal("{fr}_WHEEL_SPEED")] = 0
    rl_rpm: Annotated[int, Signal("{rl}_WHEEL_SPEED")] = 0
    rr_rpm: Annotated[int, Signal("{rr}_WHEEL_SPEED")] = 0
    t_rx_ns: int = 0

    @property
    def all_rpm(self) -> tuple[int, int, int, int]:
        return (self.fl_rpm, self.fr_rpm, self.rl_rpm, self.rr_rpm)


class WheelCounts(Message, frozen=True):
    """0x526 VCU2AI_Wheel_counts: 16-bit pulse counters that wrap."""

    dbc_name, required = "VCU2AI_Wheel_counts", True

    fl: Annotated[int, Signal("{fl}_PULSE_COUNT")] = 0
    fr: Annotated[int, Signal("{fr}_PULSE_COUNT")] = 0
    rl: Annotated[int, Signal("{rl}_PULSE_COUNT")] = 0
    rr: Annotated[int, Signal("{rr}_PULSE_COUNT")] = 0
    t_rx_ns: int = 0


class LogDynamics1(Message, frozen=True):
    """0x500 VCU2LOG_Dynamics1."""

    dbc_name = "VCU2LOG_Dynamics1"

    speed_actual_kmh: Annotated[int, Signal("Speed_actual", saturates=True)] = 0
    speed_target_kmh: Annotated[int, Signal("Speed_target", saturates=True)] = 0
    steer_actual_deg: Annotated[float, Signal("Steer_actual", saturates=True)] = 0.0
    steer_target_deg: Annotated[float, Signal("Steer_target", saturates=True)] = 0.0
    brake_actual_pct: Annotated[int, Signal("Brake_actual_pct", saturates=True)] = 0
    brake_target_pct: Annotated[int, Signal("Brake_target_pct", saturates=True)] = 0
    torque_actual_pct: Annotated[int, Signal("Drive_trq_actual_pct", saturates=True)] = 0
    torque_target_pct: Annotated[int, Signal("Drive_trq_target_pct", saturates=True)] = 0
    t_rx_ns: int = 0


class LogStatus(Message, frozen=True):
    """0x502 VCU2LOG_Status. The small state fields stay raw: they are for people and logs only."""

    dbc_name = "VCU2LOG_Status"

    assi: Annotated[int, Signal("State_ASSI")] = 0
    ebs: Annotated[int, Signal("State_EBS")] = 0
    ami: Annotated[int, Signal("AMI_STATE")] = 0
    steering: Annotated[int, Signal("State_steering")] = 0
    service_brake: Annotated[int, Signal("State_service_brake")] = 0
    lap_counter: Annotated[int, Signal("Lap_counter", saturates=True)] = 0
    cones_count_actual: Annotated[int, Signal("Cones_count_actual", saturates=True)] = 0
    cones_count_all: Annotated[int, Signal("Cones_count_all", saturates=True)] = 0
    t_rx_ns: int = 0


class VcuSystemStatus(Message, frozen=True):
    """0x120 VCU_STATUS (2021 only): the VCU's inner state machine and its AI time-outs."""

    dbc_name = "VCU_STATUS"

    sm_sys: Annotated[int, Signal("SM_SYS")] = 0
    sm_as: Annotated[int, Signal("SM_AS")] = 0
    sys_action_state: Annotated[int, Signal("SYS_ACTION_STATE")] = 0
    status_timeout: Annotated[bool, Signal("R1_AI2VCU_STATUS_TIMEOUT_ERROR", absent=NOT_READ)] = False
    drive_front_timeout: Annotated[bool, Signal("R1_AI2VCU_DRIVE_F_TIMEOUT_ERROR", absent=NOT_READ)] = False
    drive_rear_timeout: Annotated[bool, Signal("R1_AI2VCU_DRIVE_R_TIMEOUT_ERROR", absent=NOT_READ)] = False
    steer_timeout: Annotated[bool, Signal("R1_AI2VCU_STEER_TIMEOUT_ERROR", absent=NOT_READ)] = False
    brake_timeout: Annotated[bool, Signal("R1_AI2VCU_BRAKE_TIMEOUT_ERROR", absent=NOT_READ)] = False
    handshake_timeout: Annotated[bool, Signal("R1_AI2VCU_STATUS_HANDSHAKE_TIMEOUT_ERROR", absent=NOT_READ)] = False
    warn_brake_plausibility: Annotated[bool, Signal("WARN_BRAKE_PLAUSIBILITY", absent=NOT_READ)] = False
    warn_kl15_under_v: Annotated[bool, Signal("WARN_KL15_UNDER_V", absent=NOT_READ)] = False
    warn_ai_estop_req: Annotated[bool, Signal("WARN_AI_ESTOP_REQ", absent=NOT_READ)] = False
    warn_ai_comms_lost: Annotated[bool, Signal("WARN_AI_COMMS_LOST", absent=NOT_READ)] = False
    warn_auto_braking: Annotated[bool, Signal("WARN_AUTO_BRAKING", absent=NOT_READ)] = False
    warn_mission_status: Annotated[bool, Signal("WARN_MISSION_STATUS", absent=NOT_READ)] = False
    t_rx_ns: int = 0


class VehicleState(Value, frozen=True):
    """State that the car has reported so far. None means never received; each image carries the time of its frame.

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


class Acceleration(Message, frozen=True):
    """0x600 BMC_Acceleration, in the sensor's axes."""

    dbc_name = "BMC_Acceleration"

    x_mg: Annotated[float, Signal("Acceleration_X")] = 0.0
    y_mg: Annotated[float, Signal("Acceleration_Y")] = 0.0
    z_mg: Annotated[float, Signal("Acceleration_Z")] = 0.0
    temperature_degc: Annotated[float, Signal("Temperature")] = 0.0
    vertical_axis: Annotated[int, Signal("VerticalAxis")] = 0
    orientation: Annotated[int, Signal("Orientation")] = 0
    t_rx_ns: int = 0


class RotationA(Message, frozen=True):
    """0x610 L3GD20_Rotation_A."""

    dbc_name = "L3GD20_Rotation_A"

    x_degps: Annotated[float, Signal("Rotation_X")] = 0.0
    y_degps: Annotated[float, Signal("Rotation_Y")] = 0.0
    t_rx_ns: int = 0


class RotationB(Message, frozen=True):
    """0x611 L3GD20_Rotation_B."""

    dbc_name = "L3GD20_Rotation_B"

    z_degps: Annotated[float, Signal("Rotation_Z")] = 0.0
    t_rx_ns: int = 0


class GpsStatus(Message, frozen=True):
    """0x620 GPS_Status."""

    dbc_name = "GPS_Status"

    antenna: Annotated[int, Signal("GPS_AntennaStatus")] = 0
    satellites: Annotated[int, Signal("GPS_NumSatellites")] = 0
    navigation_method: Annotated[int, Signal("GPS_NavigationMethod")] = 0  # 0 INIT, 1 NONE, 2 2D, 3 3D
    t_rx_ns: int = 0


class GpsLongitude(Message, frozen=True):
    """0x622 GPS_PositionLongitude: whole degrees, minutes and a letter (0 before a fix)."""

    dbc_name = "GPS_PositionLongitude"

    minutes: Annotated[float, Signal("GPS_Longitude_Minutes")] = 0.0
    degrees: Annotated[int, Signal("GPS_Longitude_Degree")] = 0
    indicator: Annotated[int, Signal("GPS_IndicatorEW")] = 0
    t_rx_ns: int = 0


class GpsLatitude(Message, frozen=True):
    """0x623 GPS_PositionLatitude: whole degrees, minutes and a letter (0 before a fix)."""

    dbc_name = "GPS_PositionLatitude"

    minutes: Annotated[float, Signal("GPS_Latitude_Minutes")] = 0.0
    degrees: Annotated[int, Signal("GPS_Latitude_Degree")] = 0
    indicator: Annotated[int, Signal("GPS_IndicatorNS")] = 0
    t_rx_ns: int = 0


class GpsAltitude(Message, frozen=True):
    """0x624 GPS_PositionAltitude."""

    dbc_name = "GPS_PositionAltitude"

    altitude_m: Annotated[float, Signal("GPS_Altitude")] = 0.0
    t_rx_ns: int = 0


class GpsDilutionA(Message, frozen=True):
    """0x625 GPS_Delusions_A: PDOP, then HDOP."""

    dbc_name = "GPS_Delusions_A"

    pdop: Annotated[float, Signal("GPS_PDOP")] = 0.0
    hdop: Annotated[float, Signal("GPS_HDOP")] = 0.0
    t_rx_ns: int = 0


class GpsDilutionB(Message, frozen=True):
    """0x626: VDOP."""

    dbc_name = "GPS_Delusions_B"

    vdop: Annotated[float, Signal("GPS_VDOP")] = 0.0
    t_rx_ns: int = 0


class LogDynamics2(Message, frozen=True):
    """0x501 AI2LOG_Dynamics2: sent by the PCAN-GPS, or by the AI computer on a car without one."""

    dbc_name = "AI2LOG_Dynamics2"

    accel_longitudinal_mps2: Annotated[float, Signal("Accel_longitudinal_mps2", saturates=True)] = 0.0
    accel_lateral_mps2: Annotated[float, Signal("Accel_lateral_mps2", saturates=True)] = 0.0
    yaw_rate_degps: Annotated[float, Signal("Yaw_rate_degps", saturates=True)] = 0.0
    t_rx_ns: int = 0


class GpsImu(Value, frozen=True):
    """State that the PCAN-GPS has reported so far, of what is read of it. None: never received."""

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
