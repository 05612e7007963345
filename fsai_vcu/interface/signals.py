"""Which signal fills which field of which image: the one table behind the codec.

Names only. Positions, widths, scales and ranges come from the signal database that is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, auto

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
from fsai_vcu.interface.images import (
    Acceleration,
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiImage,
    AiStatus,
    AiSteer,
    DeviceClock,
    DeviceIo,
    GpsAltitude,
    GpsCourseSpeed,
    GpsDateTime,
    GpsDilutionA,
    GpsDilutionB,
    GpsLatitude,
    GpsLongitude,
    GpsStatus,
    LogDynamics1,
    LogDynamics2,
    LogStatus,
    MagneticField,
    RotationA,
    RotationB,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    VcuSystemStatus,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.wheels import WheelMapping


class Kind(Enum):
    """What a field holds."""

    FLAG = auto()
    WHOLE = auto()  # int
    REAL = auto()  # float
    CHOICE = auto()  # a member of an enumeration


class Refuse(Enum):
    """What an unknown value of a choice does when no substitute may stand for it."""

    FRAME = auto()  # the whole frame is not believed


@dataclass(frozen=True, slots=True)
class Field:
    """One field of an image and its signal.

    `optional`: a database may lack the signal; the field is then left out on encoding, and on decoding keeps its
    default, or is None (`none_if_absent`: where the default would say something of the car). `absent` says what
    follows, after "not known: ". `saturates`: a logging field, clamped to the signal's range instead of refused. For
    choices, `unknown` is what a raw value outside the enumeration becomes, and `unremarkable` are such values that need
    no report.
    """

    name: str
    signal: str
    kind: Kind
    optional: bool = False
    saturates: bool = False
    choices: type[IntEnum] | None = None
    unknown: IntEnum | Refuse | None = Refuse.FRAME
    unremarkable: frozenset[int] = frozenset()
    absent: str = ""
    none_if_absent: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One message: its name in the databases, its image, its fields; `faults` fill the nested Faults."""

    message: str
    image: type
    fields: tuple[Field, ...]
    faults: tuple[Field, ...] = ()
    required: bool = False  # a database without this message is not this car's


def _flag(name: str, signal: str, *, optional: bool = False) -> Field:
    return Field(name, signal, Kind.FLAG, optional)


def _whole(name: str, signal: str, *, optional: bool = False, saturates: bool = False) -> Field:
    return Field(name, signal, Kind.WHOLE, optional, saturates)


def _real(name: str, signal: str, *, saturates: bool = False) -> Field:
    return Field(name, signal, Kind.REAL, saturates=saturates)


def _choice(
    name: str,
    signal: str,
    choices: type[IntEnum],
    unknown: IntEnum | Refuse | None = Refuse.FRAME,
    *,
    optional: bool = False,
    unremarkable: tuple[int, ...] = (),
) -> Field:
    return Field(name, signal, Kind.CHOICE, optional, False, choices, unknown, frozenset(unremarkable))


def _fault(name: str, signal: str) -> Field:
    return Field(name, signal, Kind.FLAG, optional=True, absent="these faults are not seen")


def _logged(name: str, signal: str) -> Field:
    return Field(name, signal, Kind.WHOLE, optional=True, saturates=True, absent="not sent")


def _told(field: Field, absent: str, *, none_if_absent: bool = False) -> Field:
    """A field of 0x520 that the car can be driven without; `absent` says what is not known then."""
    return replace(field, optional=True, absent=absent, none_if_absent=none_if_absent)


def rows(wheels: WheelMapping) -> tuple[Row, ...]:
    """Every message that has an image, with the wheel signals as this car is wired."""

    def per_wheel(field: Callable[[str], str], signal: str) -> tuple[Field, ...]:
        return tuple(
            _whole(field(wheel), wheels.source_of(wheel).upper() + signal) for wheel in ("fl", "fr", "rl", "rr")
        )

    return (
        *_FIXED_ROWS,
        Row("VCU2AI_Speeds", WheelSpeeds, per_wheel("{}_rpm".format, "_WHEEL_SPEED"), required=True),
        Row("VCU2AI_Wheel_counts", WheelCounts, per_wheel("{}".format, "_PULSE_COUNT"), required=True),
    )


_AI_ROWS = (
    Row(
        "AI2VCU_Status",
        AiStatus,
        (
            _flag("handshake", "HANDSHAKE"),
            _flag("estop_request", "ESTOP_REQUEST"),
            _choice("mission_status", "MISSION_STATUS", MissionStatus),
            _choice("direction", "DIRECTION_REQUEST", Direction),
            _logged("lap_counter", "LAP_COUNTER"),
            _logged("cones_count_actual", "CONES_COUNT_ACTUAL"),
            _logged("cones_count_all", "CONES_COUNT_ALL"),
            _logged("speed_actual_kmh", "VEH_SPEED_ACTUAL"),
            _logged("speed_demand_kmh", "VEH_SPEED_DEMAND"),
        ),
        required=True,
    ),
    Row(
        "AI2VCU_Drive_F",
        AiDriveFront,
        (_real("torque_nm", "FRONT_AXLE_TRQ_REQUEST"), _whole("motor_speed_max_rpm", "FRONT_MOTOR_SPEED_MAX")),
        required=True,
    ),
    Row(
        "AI2VCU_Drive_R",
        AiDriveRear,
        (_real("torque_nm", "REAR_AXLE_TRQ_REQUEST"), _whole("motor_speed_max_rpm", "REAR_MOTOR_SPEED_MAX")),
        required=True,
    ),
    Row("AI2VCU_Steer", AiSteer, (_real("steer_deg", "STEER_REQUEST"),), required=True),
    Row(
        "AI2VCU_Brake",
        AiBrake,
        (_real("front_pct", "HYD_PRESS_F_REQ_pct"), _real("rear_pct", "HYD_PRESS_R_REQ_pct")),
        required=True,
    ),
)

_NO_SWITCH = "that a switch goes off is not seen"
_NO_WARNING = "these warnings are not seen"
_NO_STATE = "the states of the car's systems are not told"

_VCU_ROWS = (
    Row(
        "VCU2AI_Status",
        VcuStatus,
        (
            _flag("handshake", "HANDSHAKE"),
            _told(_flag("shutdown_request", "SHUTDOWN_REQUEST"), "no request to shut down is seen"),
            _told(_flag("as_switch", "AS_SWITCH_STATUS"), _NO_SWITCH, none_if_absent=True),
            _told(_flag("ts_switch", "TS_SWITCH_STATUS"), _NO_SWITCH, none_if_absent=True),
            _flag("go_signal", "GO_SIGNAL"),
            _told(
                _choice("steering_status", "STEERING_STATUS", SteeringStatus, SteeringStatus.OFF),
                "that the steering is not active is not seen",
                none_if_absent=True,
            ),
            _choice("as_state", "AS_STATE", AsState),
            _choice("ami", "AMI_STATE", Ami, Ami.NOT_SELECTED),
            _told(_flag("fault", "FAULT_STATUS"), "that the VCU has found a fault is not seen"),
            _told(_flag("warning", "WARNING_STATUS"), _NO_WARNING),
            _told(_flag("warn_batt_temp_high", "WARN_BATT_TEMP_HIGH"), _NO_WARNING),
            _told(_flag("warn_batt_soc_low", "WARN_BATT_SOC_LOW"), _NO_WARNING),
            _told(
                _choice("shutdown_cause", "SHUTDOWN_CAUSE", ShutdownCause, None), "why the car shut down is not told"
            ),
            # The interface's tables give 255 for fault in a field of four bits: 15 and anything unknown is a fault.
            _told(_choice("op_state", "OP_STATE", OpState, OpState.OP_FAULT), _NO_STATE),
            _told(_choice("ts_state", "TS_STATE", TsState, TsState.TS_FAULT), _NO_STATE),
            _told(_choice("ebs_state", "EBS_STATE", EbsState, EbsState.EBS_FAULT), _NO_STATE),
        ),
        faults=(
            _fault("ai_estop_request", "AI_ESTOP_REQUEST"),
            _fault("hvil_open", "HVIL_OPEN_FAULT"),
            _fault("hvil_short", "HVIL_SHORT_FAULT"),
            _fault("ebs", "EBS_FAULT"),
            _fault("offboard_charger", "OFFBOARD_CHARGER_FAULT"),
            _fault("ai_comms_lost", "AI_COMMS_LOST"),
            _fault("autonomous_braking", "AUTONOMOUS_BRAKING_FAULT"),
            _fault("mission_status", "MISSION_STATUS_FAULT"),
            _fault("charge_procedure", "CHARGE_PROCEDURE_FAULT"),
            _fault("bms", "BMS_FAULT"),
            _fault("brake_plausibility", "BRAKE_PLAUSIBILITY_FAULT"),
        ),
        required=True,
    ),
    Row(
        "VCU2AI_Drive_F",
        VcuDriveFront,
        (
            _real("torque_nm", "FRONT_AXLE_TRQ"),
            _real("torque_request_nm", "FRONT_AXLE_TRQ_REQUEST"),
            _real("torque_max_nm", "FRONT_AXLE_TRQ_MAX"),
        ),
        required=True,
    ),
    Row(
        "VCU2AI_Drive_R",
        VcuDriveRear,
        (
            _real("torque_nm", "REAR_AXLE_TRQ"),
            _real("torque_request_nm", "REAR_AXLE_TRQ_REQUEST"),
            _real("torque_max_nm", "REAR_AXLE_TRQ_MAX"),
        ),
        required=True,
    ),
    Row(
        "VCU2AI_Steer",
        VcuSteer,
        (
            _real("angle_deg", "ANGLE"),
            _real("angle_max_deg", "ANGLE_MAX"),
            _real("angle_request_deg", "ANGLE_REQUEST"),
        ),
        required=True,
    ),
    Row(
        "VCU2AI_Brake",
        VcuBrake,
        (
            _real("front_pct", "HYD_PRESS_F_pct"),
            _real("front_request_pct", "HYD_PRESS_F_REQ_pct"),
            _real("rear_pct", "HYD_PRESS_R_pct"),
            _real("rear_request_pct", "HYD_PRESS_R_REQ_pct"),
            _choice("brake_status", "STATUS_BRK", BrakeStatus, None),
            # 0 is not in the table, and yet what the official simulator always sends.
            _choice("ebs_status", "STATUS_EBS", EbsStatus, None, unremarkable=(0,)),
        ),
        required=True,
    ),
    Row(
        "VCU2LOG_Dynamics1",
        LogDynamics1,
        (
            _whole("speed_actual_kmh", "Speed_actual", saturates=True),
            _whole("speed_target_kmh", "Speed_target", saturates=True),
            _real("steer_actual_deg", "Steer_actual", saturates=True),
            _real("steer_target_deg", "Steer_target", saturates=True),
            _whole("brake_actual_pct", "Brake_actual_pct", saturates=True),
            _whole("brake_target_pct", "Brake_target_pct", saturates=True),
            _whole("torque_actual_pct", "Drive_trq_actual_pct", saturates=True),
            _whole("torque_target_pct", "Drive_trq_target_pct", saturates=True),
        ),
    ),
    Row(
        "VCU2LOG_Status",
        LogStatus,
        (
            _whole("assi", "State_ASSI"),
            _whole("ebs", "State_EBS"),
            _whole("ami", "AMI_STATE"),
            _whole("steering", "State_steering"),
            _whole("service_brake", "State_service_brake"),
            _whole("lap_counter", "Lap_counter", saturates=True),
            _whole("cones_count_actual", "Cones_count_actual", saturates=True),
            _whole("cones_count_all", "Cones_count_all", saturates=True),
        ),
    ),
    Row(
        "VCU_STATUS",
        VcuSystemStatus,
        (
            _whole("sm_sys", "SM_SYS"),
            _whole("sm_as", "SM_AS"),
            _whole("sys_action_state", "SYS_ACTION_STATE"),
            _flag("status_timeout", "R1_AI2VCU_STATUS_TIMEOUT_ERROR", optional=True),
            _flag("drive_front_timeout", "R1_AI2VCU_DRIVE_F_TIMEOUT_ERROR", optional=True),
            _flag("drive_rear_timeout", "R1_AI2VCU_DRIVE_R_TIMEOUT_ERROR", optional=True),
            _flag("steer_timeout", "R1_AI2VCU_STEER_TIMEOUT_ERROR", optional=True),
            _flag("brake_timeout", "R1_AI2VCU_BRAKE_TIMEOUT_ERROR", optional=True),
            _flag("handshake_timeout", "R1_AI2VCU_STATUS_HANDSHAKE_TIMEOUT_ERROR", optional=True),
            _flag("warn_brake_plausibility", "WARN_BRAKE_PLAUSIBILITY", optional=True),
            _flag("warn_kl15_under_v", "WARN_KL15_UNDER_V", optional=True),
            _flag("warn_ai_estop_req", "WARN_AI_ESTOP_REQ", optional=True),
            _flag("warn_ai_comms_lost", "WARN_AI_COMMS_LOST", optional=True),
            _flag("warn_auto_braking", "WARN_AUTO_BRAKING", optional=True),
            _flag("warn_mission_status", "WARN_MISSION_STATUS", optional=True),
        ),
    ),
)

_SENSOR_ROWS = (
    Row(
        "AI2LOG_Dynamics2",
        LogDynamics2,
        (
            _real("accel_longitudinal_mps2", "Accel_longitudinal_mps2", saturates=True),
            _real("accel_lateral_mps2", "Accel_lateral_mps2", saturates=True),
            _real("yaw_rate_degps", "Yaw_rate_degps", saturates=True),
        ),
    ),
    Row(
        "BMC_Acceleration",
        Acceleration,
        (
            _real("x_mg", "Acceleration_X"),
            _real("y_mg", "Acceleration_Y"),
            _real("z_mg", "Acceleration_Z"),
            _real("temperature_degc", "Temperature"),
            _whole("vertical_axis", "VerticalAxis"),
            _whole("orientation", "Orientation"),
        ),
    ),
    Row("L3GD20_Rotation_A", RotationA, (_real("x_degps", "Rotation_X"), _real("y_degps", "Rotation_Y"))),
    Row("L3GD20_Rotation_B", RotationB, (_real("z_degps", "Rotation_Z"),)),
    Row(
        "GPS_Status",
        GpsStatus,
        (
            _whole("antenna", "GPS_AntennaStatus"),
            _whole("satellites", "GPS_NumSatellites"),
            _whole("navigation_method", "GPS_NavigationMethod"),
        ),
    ),
    Row("GPS_CourseSpeed", GpsCourseSpeed, (_real("course_deg", "GPS_Course"), _real("speed_kmh", "GPS_Speed"))),
    Row(
        "GPS_PositionLongitude",
        GpsLongitude,
        (
            _real("minutes", "GPS_Longitude_Minutes"),
            _whole("degrees", "GPS_Longitude_Degree"),
            _whole("indicator", "GPS_IndicatorEW"),
        ),
    ),
    Row(
        "GPS_PositionLatitude",
        GpsLatitude,
        (
            _real("minutes", "GPS_Latitude_Minutes"),
            _whole("degrees", "GPS_Latitude_Degree"),
            _whole("indicator", "GPS_IndicatorNS"),
        ),
    ),
    Row("GPS_PositionAltitude", GpsAltitude, (_real("altitude_m", "GPS_Altitude"),)),
    # HDOP is the second float of 0x625.
    Row("GPS_Delusions_A", GpsDilutionA, (_real("pdop", "GPS_PDOP"), _real("hdop", "GPS_HDOP"))),
    Row("GPS_Delusions_B", GpsDilutionB, (_real("vdop", "GPS_VDOP"),)),
    Row(
        "GPS_DateTime",
        GpsDateTime,
        (
            _whole("year", "UTC_Year"),
            _whole("month", "UTC_Month"),
            _whole("day", "UTC_DayOfMonth"),
            _whole("hour", "UTC_Hour"),
            _whole("minute", "UTC_Minute"),
            _whole("second", "UTC_Second"),
        ),
    ),
    Row(
        "BMC_MagneticField",
        MagneticField,
        (_real("x_ut", "MagneticField_X"), _real("y_ut", "MagneticField_Y"), _real("z_ut", "MagneticField_Z")),
    ),
    Row(
        "IO",
        DeviceIo,
        (
            _flag("input_1", "Din1_Status"),
            _flag("input_2", "Din2_Status"),
            _flag("output", "Dout_Status"),
            _flag("sd_card", "SD_Present"),
            _flag("gps_power", "GPS_PowerStatus"),
            _whole("device_id", "Device_ID"),
        ),
    ),
    Row(
        "RTC_DateTime",
        DeviceClock,
        (
            _whole("second", "RTC_Sec"),
            _whole("minute", "RTC_Min"),
            _whole("hour", "RTC_Hour"),
            _whole("day_of_week", "RTC_DayOfWeek"),
            _whole("day", "RTC_DayOfMonth"),
            _whole("month", "RTC_Month"),
            _whole("year", "RTC_Year"),
        ),
    ),
)

_FIXED_ROWS = (*_AI_ROWS, *_VCU_ROWS, *_SENSOR_ROWS)

COMMAND_FIELDS: Mapping[type[AiImage], Mapping[str, str]] = {
    AiStatus: {field.name: field.name for field in _AI_ROWS[0].fields},
    AiDriveFront: {"torque_nm": "front_torque_nm", "motor_speed_max_rpm": "front_motor_speed_max_rpm"},
    AiDriveRear: {"torque_nm": "rear_torque_nm", "motor_speed_max_rpm": "rear_motor_speed_max_rpm"},
    AiSteer: {"steer_deg": "steer_deg"},
    AiBrake: {"front_pct": "front_brake_pct", "rear_pct": "rear_brake_pct"},
}
"""For each message of the AI computer, in sending order: its image's fields and those of AiCommand."""
