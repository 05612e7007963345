"""Conversion between the pure types of the driving chain and ROS messages, and from the car's units to SI.

Pure but for the message classes. Every number is made a plain int or float here: the middleware does not check.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import get_type_hints

import numpy as np
from builtin_interfaces.msg import Time
from fsai_msgs.msg import Cone, ConeArray, PlannerStatus, RunState
from fsai_msgs.msg import VehicleCommand as VehicleCommandMsg
from fsai_msgs.msg import VehicleState as VehicleStateMsg
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import Imu, NavSatFix, NavSatStatus

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.driving import ConeObservation, Motion, Plan, Run
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.messages import GpsImu, Image
from fsai_vcu.interface.units import STANDARD_GRAVITY_MPS2

BASE_FRAME = "base_link"  # REP-105: the car; its origin is the rear axle's centre on the ground
ODOM_FRAME = "odom"  # REP-105: where the run began

UNKNOWN = 255
NEVER = math.nan
NO_WAY_M = 0.01  # a plan that bears out no way at all: 0 would say that it does not tell
_UINT32_MAX = 2**32 - 1


def _count(value: int) -> int:
    """Counters are for logs: they saturate."""
    return min(max(int(value), 0), _UINT32_MAX)


def _raw(value: IntEnum | None) -> int:
    return UNKNOWN if value is None else int(value)


# ---------------------------------------------------------------- cones


def cones_to_msg(observation: ConeObservation, stamp: Time) -> ConeArray:
    message = ConeArray()
    message.header.stamp = stamp
    message.header.frame_id = BASE_FRAME
    message.cones = [
        Cone(x=x, y=y, color=color, confidence=confidence)
        for (x, y), color, confidence in zip(
            observation.xy_m.tolist(), observation.color.tolist(), observation.confidence.tolist(), strict=True
        )
    ]
    return message


def cones_from_msg(message: ConeArray, t_ns: int) -> ConeObservation:
    """Make cones of a message. `t_ns`: the monotonic time of the message's stamp."""
    rows = [(cone.x, cone.y, cone.color, cone.confidence) for cone in message.cones]
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return ConeObservation(t_ns, table[:, :2].copy(), table[:, 2].astype(np.int64), table[:, 3].copy())


# ---------------------------------------------------------------- plan


def path_to_msg(xy_m: np.ndarray, stamp: Time) -> Path:
    """Make a path's message. xy_m: (M, 2), vehicle frame of the stamp's instant. Each pose looks along the path."""
    message = Path()
    message.header.stamp = stamp
    message.header.frame_id = BASE_FRAME
    points = xy_m.tolist()
    poses = []
    for index, (x, y) in enumerate(points):
        following, before = points[min(index + 1, len(points) - 1)], points[max(index - 1, 0)]
        yaw = math.atan2(following[1] - before[1], following[0] - before[0])
        pose = PoseStamped()
        pose.header = message.header
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.z, pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        poses.append(pose)
    message.poses = poses
    return message


def plan_to_msgs(plan: Plan, stamp: Time) -> tuple[PlannerStatus, Path]:
    """Make a status and a path of the plan, both with `stamp`."""
    status = PlannerStatus(
        run_id=plan.run_id,
        mission=int(plan.mission),
        laps=_count(plan.laps),
        finished=bool(plan.finished),
        stop_distance_m=NEVER if plan.stop_distance_m is None else float(plan.stop_distance_m),
        cones_count_actual=_count(plan.cones_count_actual),
        cones_count_all=_count(plan.cones_count_all),
        supported_m=max(float(plan.supported_m), NO_WAY_M) if math.isfinite(plan.supported_m) else 0.0,
        confidence=float(plan.confidence),
        mapped=bool(plan.mapped),
        slip_radpmps2=float(plan.slip_radpmps2),
        note=plan.note,
    )
    status.header.stamp = stamp
    status.header.frame_id = BASE_FRAME
    return status, path_to_msg(plan.path_m, stamp)


def plan_from_msgs(status: PlannerStatus, path: Path, t_sensor_ns: int) -> Plan:
    """Make a plan of a status and its path; `t_sensor_ns`: the monotonic time of their stamp."""
    points = [(pose.pose.position.x, pose.pose.position.y) for pose in path.poses]
    return Plan(
        t_sensor_ns=t_sensor_ns,
        run_id=status.run_id,
        mission=Ami(status.mission),
        path_m=np.array(points, dtype=np.float64).reshape(-1, 2),
        laps=status.laps,
        finished=status.finished,
        stop_distance_m=None if math.isnan(status.stop_distance_m) else status.stop_distance_m,
        cones_count_actual=status.cones_count_actual,
        cones_count_all=status.cones_count_all,
        supported_m=status.supported_m or math.inf,
        confidence=status.confidence,
        mapped=status.mapped,
        note=status.note,
        slip_radpmps2=status.slip_radpmps2,
    )


# ---------------------------------------------------------------- command


_COMMANDED = {name: kind for name, kind in get_type_hints(VehicleCommand).items() if name != "t_sensor_ns"}
"""The fields of a command that the message has by the same names, and their types."""


def command_to_msg(command: VehicleCommand, stamp: Time) -> VehicleCommandMsg:
    plain = {bool: bool, float: float, int: _count, str: str}
    message = VehicleCommandMsg(**{name: plain[kind](getattr(command, name)) for name, kind in _COMMANDED.items()})
    message.header.stamp = stamp
    message.header.frame_id = BASE_FRAME
    return message


def command_from_msg(message: VehicleCommandMsg, t_sensor_ns: int) -> VehicleCommand:
    """Make a command of a message, as received: what the car's own limits say of it is the gate's decision."""
    return VehicleCommand(t_sensor_ns, **{name: getattr(message, name) for name in _COMMANDED})


# ---------------------------------------------------------------- run and motion


def run_to_msg(run: Run, mode: str, stamp: Time) -> RunState:
    message = RunState(
        run_id=run.run_id,
        mission=int(run.mission),
        as_state=_raw(run.as_state),
        may_move=bool(run.may_move),
        mode=mode,
    )
    message.header.stamp = stamp
    return message


def run_from_msg(message: RunState) -> Run:
    as_state = None if message.as_state == UNKNOWN else AsState(message.as_state)
    return Run(message.run_id, Ami(message.mission), as_state, message.may_move)


def motion_from_state(message: VehicleStateMsg, t_ns: int) -> Motion:
    return Motion(
        t_ns,
        message.x,
        message.y,
        message.yaw_rad,
        message.speed_mps,
        message.yaw_rate_radps,
        message.distance_m,
        yaw_rate_sd_radps=message.yaw_rate_sd_radps,
    )


def odometry_to_msg(motion: Motion, stamp: Time) -> Odometry:
    """Make an Odometry of the motion, with its standard deviations as covariances."""
    message = Odometry()
    message.header.stamp = stamp
    message.header.frame_id = ODOM_FRAME
    message.child_frame_id = BASE_FRAME
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = float(motion.x_m), float(motion.y_m)
    pose.orientation.z, pose.orientation.w = math.sin(motion.yaw_rad / 2), math.cos(motion.yaw_rad / 2)
    twist.linear.x, twist.angular.z = float(motion.speed_mps), float(motion.yaw_rate_radps)
    # Row by row 6 x 6 of x, y, z and the rotations about them; what is 0 by definition on a plane is known.
    message.pose.covariance[0] = message.pose.covariance[7] = float(motion.position_sd_m) ** 2
    message.pose.covariance[35] = float(motion.yaw_sd_rad) ** 2
    message.twist.covariance[0] = float(motion.speed_sd_mps) ** 2
    message.twist.covariance[35] = float(motion.yaw_rate_sd_radps) ** 2
    return message


# ---------------------------------------------------------------- vehicle state


# Fields of 0x520 that have the same names in the message.
_FLAGS = ("go_signal", "as_switch", "ts_switch", "shutdown_request", "fault", "warning")
_STATES = ("shutdown_cause", "steering_status", "op_state", "ts_state", "ebs_state")


def state_to_msg(report: BridgeReport, stamp: Time, command_age_s: float) -> VehicleStateMsg:
    """Make a VehicleState of the report; ages in s, NaN for what was never received."""
    message = VehicleStateMsg()
    message.header.stamp = stamp
    message.header.frame_id = ODOM_FRAME
    vehicle, now_ns = report.vehicle, report.t_ns

    def age_s(image: Image | None) -> float:
        return NEVER if image is None else (now_ns - image.t_rx_ns) / 1e9

    for name in ("as_state", "mission", "brake_status", "ebs_status", *_STATES):
        setattr(message, name, UNKNOWN)
    message.as_state_label = message.mission_label = "UNKNOWN"
    message.mode, message.run_id = report.mode, report.run.run_id
    message.handshake = bool(vehicle.handshake)

    status = vehicle.status
    if status is not None:
        message.as_state, message.as_state_label = int(status.as_state), status.as_state.label
        message.mission, message.mission_label = int(status.ami), status.ami.label
        for name in _FLAGS:
            setattr(message, name, bool(getattr(status, name)))
        for name in _STATES:
            setattr(message, name, _raw(getattr(status, name)))
        message.faults = list(status.faults.names)
        message.shutdown_cause_label = "" if status.shutdown_cause is None else status.shutdown_cause.label
    message.status_age_s = age_s(status)

    steer = vehicle.steer
    if steer is not None:
        message.steering_rad = math.radians(steer.angle_deg)
        message.steering_max_rad = math.radians(steer.angle_max_deg)
    message.steer_age_s = age_s(steer)
    if vehicle.drive_front is not None:
        message.front_axle_torque_nm = float(vehicle.drive_front.torque_nm)
    if vehicle.drive_rear is not None:
        message.rear_axle_torque_nm = float(vehicle.drive_rear.torque_nm)
    brake = vehicle.brake
    if brake is not None:
        message.front_brake, message.rear_brake = brake.front_pct / 100.0, brake.rear_pct / 100.0
        message.brake_status, message.ebs_status = _raw(brake.brake_status), _raw(brake.ebs_status)
    message.brake_age_s = age_s(brake)
    speeds = vehicle.speeds
    if speeds is not None:
        message.wheel_speed_rpm = np.array(speeds.all_rpm, dtype=np.uint16)
    message.speeds_age_s = age_s(speeds)
    if vehicle.counts is not None:
        counts = vehicle.counts
        message.wheel_pulses = np.array((counts.fl, counts.fr, counts.rl, counts.rr), dtype=np.uint16)

    message.command_age_s = float(command_age_s)
    message.standing = bool(report.standing)

    motion = report.motion
    message.x, message.y, message.yaw_rad = float(motion.x_m), float(motion.y_m), float(motion.yaw_rad)
    message.speed_mps, message.yaw_rate_radps = float(motion.speed_mps), float(motion.yaw_rate_radps)
    message.yaw_rate_sd_radps, message.distance_m = float(motion.yaw_rate_sd_radps), float(motion.distance_m)

    sent = report.command
    message.sent_mission_status, message.sent_direction = int(sent.mission_status), int(sent.direction)
    message.sent_estop_request = bool(sent.estop_request)
    message.sent_steering_rad = math.radians(sent.steer_deg)
    message.sent_front_torque_nm, message.sent_rear_torque_nm = (
        float(sent.front_torque_nm),
        float(sent.rear_torque_nm),
    )
    message.sent_front_brake, message.sent_rear_brake = sent.front_brake_pct / 100.0, sent.rear_brake_pct / 100.0
    message.laps = _count(sent.lap_counter)
    message.listen_only = bool(report.listen_only)

    message.phase, message.emergency, message.stopping = report.phase, report.emergency or "", report.stopping or ""
    message.loop_faults = _count(report.loop_faults)
    message.gate_reasons = list(report.sentences)
    message.why_not_driving = list(report.why_not_driving)
    message.operational_limits = list(report.limits.described())
    return message


# ---------------------------------------------------------------- IMU and GPS


def imu_to_msg(gps: GpsImu, frame_id: str, stamp_of: Callable[[int], Time]) -> Imu | None:
    """Make an Imu of the PCAN-GPS's own sensors, in the sensor's axes, or else of 0x501.

    Returns None while neither has been received. What was not measured is marked as REP-145 has it: -1 in the first
    element of its covariance.
    """
    message = Imu()
    message.header.frame_id = frame_id
    message.orientation_covariance[0] = -1.0
    acceleration, dynamics = gps.acceleration, gps.dynamics
    rotation_a, rotation_b = gps.rotation_a, gps.rotation_b
    if acceleration is not None:
        for axis in "xyz":
            mps2 = getattr(acceleration, f"{axis}_mg") * 1e-3 * STANDARD_GRAVITY_MPS2
            setattr(message.linear_acceleration, axis, mps2)
        if rotation_a is not None:
            message.angular_velocity.x = math.radians(rotation_a.x_degps)
            message.angular_velocity.y = math.radians(rotation_a.y_degps)
        if rotation_b is not None:
            message.angular_velocity.z = math.radians(rotation_b.z_degps)
        else:
            message.angular_velocity_covariance[0] = -1.0
        message.header.stamp = stamp_of(acceleration.t_rx_ns)
        return message
    if dynamics is not None:
        message.linear_acceleration.x = float(dynamics.accel_longitudinal_mps2)
        message.linear_acceleration.y = float(dynamics.accel_lateral_mps2)
        message.angular_velocity.z = math.radians(dynamics.yaw_rate_degps)
        message.header.stamp = stamp_of(dynamics.t_rx_ns)
        return message
    return None


# GPS_NavigationMethod of 0x620 (PCAN-GPS): 2 is a 2D, 3 a 3D fix.
_FIX_2D, _FIX_3D = 2, 3
# A typical user range error: DOP times this is the standard deviation that the fix's covariance claims.
_RANGE_ERROR_M = 3.0


def fix_to_msg(gps: GpsImu, frame_id: str, stamp_of: Callable[[int], Time]) -> NavSatFix | None:
    """Make a NavSatFix, with STATUS_NO_FIX and NaN while the receiver has none; None before any position."""
    latitude, longitude = gps.latitude, gps.longitude
    if latitude is None or longitude is None:
        return None
    message = NavSatFix()
    message.header.frame_id = frame_id
    message.header.stamp = stamp_of(min(latitude.t_rx_ns, longitude.t_rx_ns))
    message.status.service = NavSatStatus.SERVICE_GPS
    method = gps.status.navigation_method if gps.status is not None else 0
    north, east = _SIGN_OF_LETTER.get(latitude.indicator), _SIGN_OF_LETTER.get(longitude.indicator)
    if method not in (_FIX_2D, _FIX_3D) or north is None or east is None:
        message.status.status = NavSatStatus.STATUS_NO_FIX
        message.latitude = message.longitude = message.altitude = math.nan
        return message
    message.status.status = NavSatStatus.STATUS_FIX
    message.latitude = north * (latitude.degrees + latitude.minutes / 60.0)
    message.longitude = east * (longitude.degrees + longitude.minutes / 60.0)
    known_altitude = method == _FIX_3D and gps.altitude is not None
    message.altitude = float(gps.altitude.altitude_m) if known_altitude and gps.altitude is not None else math.nan
    if gps.dilution_a is not None:
        horizontal_m2 = (gps.dilution_a.hdop * _RANGE_ERROR_M) ** 2
        vertical_dop = gps.dilution_b.vdop if gps.dilution_b is not None else gps.dilution_a.pdop
        message.position_covariance[0] = message.position_covariance[4] = horizontal_m2
        message.position_covariance[8] = (vertical_dop * _RANGE_ERROR_M) ** 2
        message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_APPROXIMATED
    return message


_SIGN_OF_LETTER = {ord("N"): 1.0, ord("E"): 1.0, ord("S"): -1.0, ord("W"): -1.0}
