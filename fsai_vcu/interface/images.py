"""Typed, immutable images of the car's messages: one class per message, fields in the car's units.

An image that was received carries `t_rx_ns`, the monotonic time of its frame, so that a message which stops
arriving can never look fresh. Signals which a revision or a database lacks are None.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

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
from fsai_vcu.interface.immutable import Immutable

# ---------------------------------------------------------------- AI -> VCU


@dataclass(frozen=True, slots=True)
class AiStatus(Immutable):
    """0x510 AI2VCU_Status."""

    handshake: bool = False
    estop_request: bool = False
    mission_status: MissionStatus = MissionStatus.NOT_SELECTED
    direction: Direction = Direction.NEUTRAL
    lap_counter: int = 0
    cones_count_actual: int = 0
    cones_count_all: int = 0
    speed_actual_kmh: int = 0
    speed_demand_kmh: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiDriveFront(Immutable):
    """0x511 AI2VCU_Drive_F."""

    torque_nm: float = 0.0
    motor_speed_max_rpm: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiDriveRear(Immutable):
    """0x512 AI2VCU_Drive_R."""

    torque_nm: float = 0.0
    motor_speed_max_rpm: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiSteer(Immutable):
    """0x513 AI2VCU_Steer: bicycle-model road angle, positive turns left (ISO 8855)."""

    steer_deg: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class AiBrake(Immutable):
    """0x514 AI2VCU_Brake."""

    front_pct: float = 0.0
    rear_pct: float = 0.0
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

    def images(self) -> tuple[AiStatus, AiDriveFront, AiDriveRear, AiSteer, AiBrake]:
        """The five messages in the order in which they go out."""
        return (
            AiStatus(
                self.handshake,
                self.estop_request,
                self.mission_status,
                self.direction,
                self.lap_counter,
                self.cones_count_actual,
                self.cones_count_all,
                self.speed_actual_kmh,
                self.speed_demand_kmh,
            ),
            AiDriveFront(self.front_torque_nm, self.front_motor_speed_max_rpm),
            AiDriveRear(self.rear_torque_nm, self.rear_motor_speed_max_rpm),
            AiSteer(self.steer_deg),
            AiBrake(self.front_brake_pct, self.rear_brake_pct),
        )


# ---------------------------------------------------------------- VCU -> AI


@dataclass(frozen=True, slots=True)
class Faults(Immutable):
    """The fault bits of 0x520. A bit that the database lacks is None."""

    ai_estop_request: bool | None = None
    hvil_open: bool | None = None
    hvil_short: bool | None = None
    ebs: bool | None = None
    offboard_charger: bool | None = None
    ai_comms_lost: bool | None = None
    autonomous_braking: bool | None = None
    mission_status: bool | None = None
    charge_procedure: bool | None = None
    bms: bool | None = None
    brake_plausibility: bool | None = None


@dataclass(frozen=True, slots=True)
class VcuStatus(Immutable):
    """0x520 VCU2AI_Status."""

    handshake: bool = False
    shutdown_request: bool = False
    as_switch: bool | None = False  # None: the database lacks the signal
    ts_switch: bool | None = False  # so here …
    go_signal: bool = False
    steering_status: SteeringStatus | None = SteeringStatus.OFF  # … and here
    as_state: AsState = AsState.AS_OFF
    ami: Ami = Ami.NOT_SELECTED
    fault: bool = False
    warning: bool = False
    warn_batt_temp_high: bool = False
    warn_batt_soc_low: bool = False
    faults: Faults = field(default_factory=Faults)
    shutdown_cause: ShutdownCause | None = None
    op_state: OpState | None = None
    ts_state: TsState | None = None
    ebs_state: EbsState | None = None
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuDriveFront(Immutable):
    """0x521 VCU2AI_Drive_F."""

    torque_nm: float = 0.0
    torque_request_nm: float = 0.0
    torque_max_nm: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuDriveRear(Immutable):
    """0x522 VCU2AI_Drive_R."""

    torque_nm: float = 0.0
    torque_request_nm: float = 0.0
    torque_max_nm: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuSteer(Immutable):
    """0x523 VCU2AI_Steer."""

    angle_deg: float = 0.0
    angle_max_deg: float = 0.0
    angle_request_deg: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuBrake(Immutable):
    """0x524 VCU2AI_Brake."""

    front_pct: float = 0.0
    front_request_pct: float = 0.0
    rear_pct: float = 0.0
    rear_request_pct: float = 0.0
    brake_status: BrakeStatus | None = None  # None: a value outside the table (reported)
    ebs_status: EbsStatus | None = None  # None: a value outside the table (the official simulator sends 0)
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class WheelSpeeds(Immutable):
    """0x525 VCU2AI_Speeds."""

    fl_rpm: int = 0
    fr_rpm: int = 0
    rl_rpm: int = 0
    rr_rpm: int = 0
    t_rx_ns: int = 0

    @property
    def all_rpm(self) -> tuple[int, int, int, int]:
        return (self.fl_rpm, self.fr_rpm, self.rl_rpm, self.rr_rpm)


@dataclass(frozen=True, slots=True)
class WheelCounts(Immutable):
    """0x526 VCU2AI_Wheel_counts: 16-bit pulse counters that wrap."""

    fl: int = 0
    fr: int = 0
    rl: int = 0
    rr: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class LogDynamics1(Immutable):
    """0x500 VCU2LOG_Dynamics1."""

    speed_actual_kmh: int = 0
    speed_target_kmh: int = 0
    steer_actual_deg: float = 0.0
    steer_target_deg: float = 0.0
    brake_actual_pct: int = 0
    brake_target_pct: int = 0
    torque_actual_pct: int = 0
    torque_target_pct: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class LogStatus(Immutable):
    """0x502 VCU2LOG_Status. The small state fields stay raw: they are for people and logs only."""

    assi: int = 0
    ebs: int = 0
    ami: int = 0
    steering: int = 0
    service_brake: int = 0
    lap_counter: int = 0
    cones_count_actual: int = 0
    cones_count_all: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class VcuSystemStatus(Immutable):
    """0x120 VCU_STATUS (2021 only): the VCU's inner state machine and its AI time-outs."""

    sm_sys: int = 0
    sm_as: int = 0
    sys_action_state: int = 0
    status_timeout: bool = False
    drive_front_timeout: bool = False
    drive_rear_timeout: bool = False
    steer_timeout: bool = False
    brake_timeout: bool = False
    handshake_timeout: bool = False
    warn_brake_plausibility: bool = False
    warn_kl15_under_v: bool = False
    warn_ai_estop_req: bool = False
    warn_ai_comms_lost: bool = False
    warn_auto_braking: bool = False
    warn_mission_status: bool = False
    t_rx_ns: int = 0


VcuImage = (
    VcuStatus
    | VcuDriveFront
    | VcuDriveRear
    | VcuSteer
    | VcuBrake
    | WheelSpeeds
    | WheelCounts
    | LogDynamics1
    | LogStatus
    | VcuSystemStatus
)


@dataclass(frozen=True, slots=True)
class VehicleState(Immutable):
    """What the car has said so far. None means never heard; each image carries the time of its frame.

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

    def with_image(self, image: VcuImage) -> VehicleState:
        """The state after `image` has been received."""
        if isinstance(image, VcuStatus):
            return replace(self, status=image, handshake=image.handshake, status_known=True)
        changed: dict[str, Any] = {VEHICLE_FIELD_OF[type(image)]: image}
        return replace(self, **changed)


VEHICLE_FIELD_OF: dict[type, str] = {
    VcuStatus: "status",
    VcuDriveFront: "drive_front",
    VcuDriveRear: "drive_rear",
    VcuSteer: "steer",
    VcuBrake: "brake",
    WheelSpeeds: "speeds",
    WheelCounts: "counts",
    LogDynamics1: "log_dynamics",
    LogStatus: "log_status",
    VcuSystemStatus: "system",
}


# ---------------------------------------------------------------- PCAN-GPS


@dataclass(frozen=True, slots=True)
class Acceleration(Immutable):
    """0x600 BMC_Acceleration, in the sensor's axes."""

    x_mg: float = 0.0
    y_mg: float = 0.0
    z_mg: float = 0.0
    temperature_degc: float = 0.0
    vertical_axis: int = 0
    orientation: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class RotationA(Immutable):
    """0x610 L3GD20_Rotation_A."""

    x_degps: float = 0.0
    y_degps: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class RotationB(Immutable):
    """0x611 L3GD20_Rotation_B."""

    z_degps: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsStatus(Immutable):
    """0x620 GPS_Status."""

    antenna: int = 0
    satellites: int = 0
    navigation_method: int = 0  # 0 INIT, 1 NONE, 2 2D, 3 3D
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsCourseSpeed(Immutable):
    """0x621 GPS_CourseSpeed."""

    course_deg: float = 0.0
    speed_kmh: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsLongitude(Immutable):
    """0x622 GPS_PositionLongitude: whole degrees, minutes and a letter (0 before a fix)."""

    minutes: float = 0.0
    degrees: int = 0
    indicator: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsLatitude(Immutable):
    """0x623 GPS_PositionLatitude: whole degrees, minutes and a letter (0 before a fix)."""

    minutes: float = 0.0
    degrees: int = 0
    indicator: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsAltitude(Immutable):
    """0x624 GPS_PositionAltitude."""

    altitude_m: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsDilutionA(Immutable):
    """0x625: PDOP, then HDOP."""

    pdop: float = 0.0
    hdop: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsDilutionB(Immutable):
    """0x626: VDOP."""

    vdop: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class GpsDateTime(Immutable):
    """0x627 GPS_DateTime (UTC; the year counts from 2000)."""

    year: int = 0
    month: int = 0
    day: int = 0
    hour: int = 0
    minute: int = 0
    second: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class MagneticField(Immutable):
    """0x628 BMC_MagneticField, in the sensor's axes."""

    x_ut: float = 0.0
    y_ut: float = 0.0
    z_ut: float = 0.0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class DeviceIo(Immutable):
    """0x630 IO: the device's own inputs and outputs."""

    input_1: bool = False
    input_2: bool = False
    output: bool = False
    sd_card: bool = False
    gps_power: bool = False
    device_id: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class DeviceClock(Immutable):
    """0x640 RTC_DateTime: the device's own clock, with the full year."""

    second: int = 0
    minute: int = 0
    hour: int = 0
    day_of_week: int = 0  # 0 Monday
    day: int = 0
    month: int = 0
    year: int = 0
    t_rx_ns: int = 0


@dataclass(frozen=True, slots=True)
class LogDynamics2(Immutable):
    """0x501 AI2LOG_Dynamics2: sent by the PCAN-GPS, or by the AI computer on a car without one."""

    accel_longitudinal_mps2: float = 0.0
    accel_lateral_mps2: float = 0.0
    yaw_rate_degps: float = 0.0
    t_rx_ns: int = 0


GpsImage = (
    Acceleration
    | RotationA
    | RotationB
    | GpsStatus
    | GpsCourseSpeed
    | GpsLongitude
    | GpsLatitude
    | GpsAltitude
    | GpsDilutionA
    | GpsDilutionB
    | GpsDateTime
    | MagneticField
    | DeviceIo
    | DeviceClock
    | LogDynamics2
)


@dataclass(frozen=True, slots=True)
class GpsImu(Immutable):
    """What the PCAN-GPS has said so far. None means never heard."""

    acceleration: Acceleration | None = None
    rotation_a: RotationA | None = None
    rotation_b: RotationB | None = None
    status: GpsStatus | None = None
    course_speed: GpsCourseSpeed | None = None
    longitude: GpsLongitude | None = None
    latitude: GpsLatitude | None = None
    altitude: GpsAltitude | None = None
    dilution_a: GpsDilutionA | None = None
    dilution_b: GpsDilutionB | None = None
    date_time: GpsDateTime | None = None
    magnetic_field: MagneticField | None = None
    io: DeviceIo | None = None
    clock: DeviceClock | None = None
    dynamics: LogDynamics2 | None = None

    def with_image(self, image: GpsImage) -> GpsImu:
        """The state after `image` has been received."""
        changed: dict[str, Any] = {GPS_FIELD_OF[type(image)]: image}
        return replace(self, **changed)


GPS_FIELD_OF: dict[type, str] = {
    Acceleration: "acceleration",
    RotationA: "rotation_a",
    RotationB: "rotation_b",
    GpsStatus: "status",
    GpsCourseSpeed: "course_speed",
    GpsLongitude: "longitude",
    GpsLatitude: "latitude",
    GpsAltitude: "altitude",
    GpsDilutionA: "dilution_a",
    GpsDilutionB: "dilution_b",
    GpsDateTime: "date_time",
    MagneticField: "magnetic_field",
    DeviceIo: "io",
    DeviceClock: "clock",
    LogDynamics2: "dynamics",
}

Image = AiImage | VcuImage | GpsImage
