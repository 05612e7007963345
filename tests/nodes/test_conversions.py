"""Pure types to messages and back, units, and what is unknown stays unknown."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from fsai_msgs.msg import ConeArray, VehicleState
from msgspec.structs import replace
from sensor_msgs.msg import NavSatStatus

from fsai_nodes import conversions as to
from fsai_nodes.diagnosis import diagnostics_of
from fsai_vcu.cli.status import _as_dict, _as_text
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Plan, Run
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, ShutdownCause
from fsai_vcu.interface.messages import (
    Acceleration,
    Faults,
    GpsAltitude,
    GpsImu,
    GpsLatitude,
    GpsLongitude,
    GpsStatus,
    LogDynamics2,
    RotationA,
    RotationB,
    VcuBrake,
    VcuStatus,
    VcuSteer,
    WheelSpeeds,
)
from fsai_vcu.interface.messages import VehicleState as VehicleImages
from fsai_vcu.interface.revisions import revision

STAMP = Time(sec=12, nanosec=34)


def stamp_of(t_ns: int) -> Time:
    return Time(sec=t_ns // 10**9, nanosec=t_ns % 10**9)


def test_cones_come_back_as_they_were() -> None:
    seen = ConeObservation(
        99, np.array([[1.0, 2.0], [3.5, -4.25]]), np.array([ConeColor.BLUE, ConeColor.BIG_ORANGE]), np.array([0.5, 1.0])
    )
    back = to.cones_from_msg(to.cones_to_msg(seen, STAMP), 99)
    assert back.t_ns == 99
    np.testing.assert_array_equal(back.xy_m, seen.xy_m)
    np.testing.assert_array_equal(back.color, seen.color)
    np.testing.assert_array_equal(back.confidence, seen.confidence)


def test_no_cones_are_a_table_without_rows() -> None:
    back = to.cones_from_msg(ConeArray(), 1)
    assert back.xy_m.shape == (0, 2) and len(back.color) == 0 and len(back.confidence) == 0


@pytest.mark.parametrize("stop_distance_m", [None, 0.0, 12.5])
def test_a_plan_comes_back_as_it_was(stop_distance_m: float | None) -> None:
    path_m = np.array([[0.5, 0.0], [1.0, 0.1], [1.5, 0.3]])
    plan = Plan(7, 3, Ami.TRACKDRIVE, path_m, 4, True, stop_distance_m, 12, 345, 9.5, 0.5, True, "a gap", 0.0125)
    status, path = to.plan_to_msgs(plan, STAMP)
    assert status.header.stamp == path.header.stamp == STAMP
    back = to.plan_from_msgs(status, path, 7)
    np.testing.assert_array_equal(back.path_m, path_m)
    for name in ("t_sensor_ns", "run_id", "mission", "laps", "finished", "stop_distance_m", "cones_count_all"):
        assert getattr(back, name) == getattr(plan, name), name
    for name in ("supported_m", "confidence", "mapped", "note", "slip_radpmps2"):
        assert getattr(back, name) == getattr(plan, name), name


@pytest.mark.parametrize(("supported_m", "back_m"), [(0.0, to.NO_WAY_M), (math.inf, math.inf)])
def test_a_plan_that_bears_out_no_way_says_so(supported_m: float, back_m: float) -> None:
    plan = Plan(7, 3, Ami.TRACKDRIVE, np.zeros((0, 2)), supported_m=supported_m)
    assert to.plan_from_msgs(*to.plan_to_msgs(plan, STAMP), 7).supported_m == back_m


def test_the_poses_of_a_path_look_along_it() -> None:
    path = to.path_to_msg(np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 2.0]]), STAMP)
    for pose in path.poses:
        yaw = 2 * math.atan2(pose.pose.orientation.z, pose.pose.orientation.w)
        assert yaw == pytest.approx(math.pi / 2)


def test_an_empty_path_comes_with_its_reason() -> None:
    plan = Plan(7, 3, Ami.TRACKDRIVE, np.zeros((0, 2)), note="no lane among 7 cones")
    back = to.plan_from_msgs(*to.plan_to_msgs(plan, STAMP), 7)
    assert (len(back.path_m), back.note) == (0, plan.note)


def test_a_command_comes_back_as_it_was_even_a_bad_one() -> None:
    command = VehicleCommand(5, 9, 0.1, 0.2, 0.0, 7.5, True, False, 3, 10, 200)
    assert to.command_from_msg(to.command_to_msg(command, STAMP), 5) == command
    bad = to.command_from_msg(to.command_to_msg(VehicleCommand(5, 9, math.nan, math.inf), STAMP), 5)
    assert math.isnan(bad.steering_rad) and math.isinf(bad.throttle)


def test_counters_saturate() -> None:
    message = to.command_to_msg(VehicleCommand(5, 9, laps=-1, cones_count_all=2**40), STAMP)
    assert message.laps == 0 and message.cones_count_all == 2**32 - 1


@pytest.mark.parametrize("as_state", [None, *AsState])
def test_a_run_comes_back_as_it_was(as_state: AsState | None) -> None:
    run = Run(17, Ami.SKIDPAD, as_state, as_state is AsState.AS_DRIVING)
    message = to.run_to_msg(run, "autonomous", STAMP)
    assert to.run_from_msg(message) == run and message.mode == "autonomous"


def report_after(*images: object, now_ns: int = 1_000_000_000):  # type: ignore[no-untyped-def]
    """A bridge's report after the car has said `images`."""
    codec = Codec(revision("2026"))
    bridge = Bridge(codec, revision("2026"), CARS["2026"], now_ns=0)
    for image in images:
        frame = codec.encode(image)  # type: ignore[arg-type]
        bridge.on_frame(type(frame)(frame.can_id, frame.data, now_ns - 40_000_000))
    bridge.cycle(now_ns)
    return bridge.report(now_ns)


def test_diagnostics_say_what_the_database_lacks() -> None:
    status = VcuStatus(as_switch=None, steering_status=None)
    report = replace(report_after(), vehicle=VehicleImages(status=status), unknown="car.dbc: lacks FAULT_STATUS")
    link, _, car, _ = diagnostics_of(report, STAMP, {}).status
    assert ("not known", "car.dbc: lacks FAULT_STATUS") in [(value.key, value.value) for value in link.values]
    told = {value.key: value.value for value in car.values}
    assert (told["ASMS"], told["TSMS"], told["steering"]) == ("unknown", "False", "unknown")
    assert not any(value.key == "not known" for value in diagnostics_of(report_after(), STAMP, {}).status[0].values)


def test_the_limits_in_force_are_published_and_in_status() -> None:
    state = to.state_to_msg(replace(report_after(), limits=OperationalLimits(max_speed_mps=3.5)), STAMP, math.nan)
    assert "limits    max_speed_mps = 3.5, max_axle_torque_nm = not limited" in _as_text(state)
    assert _as_dict(state)["operational_limits"][0] == "max_speed_mps = 3.5"


def test_what_any_program_may_publish_is_a_short_status() -> None:
    hostile = "\x1b]0;PWN\x07\n\x7f\ud800" + "x" * 100_000
    texts = {name: hostile for name, kind in VehicleState.get_fields_and_field_types().items() if kind == "string"}
    lists = {name: [hostile] * 200 for name in ("faults", "gate_reasons", "why_not_driving", "operational_limits")}
    state = VehicleState(**texts, **lists, status_age_s=math.nan, speed_mps=math.inf, steering_rad=-math.inf)
    lines = _as_text(state).splitlines()
    assert len(lines) < 150 and all(line.isprintable() and len(line) < 600 for line in lines)
    told = json.dumps(_as_dict(state), allow_nan=False)
    assert told.isprintable() and len(told) < 200_000 and json.loads(told)["speed_mps"] is None


def test_before_the_car_has_said_anything_everything_is_unknown() -> None:
    message = to.state_to_msg(report_after(), STAMP, math.nan)
    assert message.as_state == message.mission == VehicleState.UNKNOWN
    assert message.as_state_label == "UNKNOWN"
    assert message.steering_status == message.brake_status == message.ebs_status == VehicleState.UNKNOWN
    for name in ("status_age_s", "steer_age_s", "speeds_age_s", "brake_age_s", "command_age_s"):
        assert math.isnan(getattr(message, name)), name


def test_the_vehicle_state_is_in_si_units_and_in_the_cars_words() -> None:
    message = to.state_to_msg(
        report_after(
            VcuStatus(
                as_state=AsState.EMERGENCY_BRAKE,
                ami=Ami.TRACKDRIVE,
                fault=True,
                go_signal=True,
                faults=Faults(ai_comms_lost=True, bms=False),
                shutdown_cause=ShutdownCause.AI_COMMS_FAULT,
            ),
            VcuSteer(angle_deg=-10.0, angle_max_deg=21.0),
            VcuBrake(front_pct=50.0, rear_pct=25.0),
            WheelSpeeds(101, 102, 103, 104),
        ),
        STAMP,
        0.25,
    )
    assert (message.as_state, message.as_state_label) == (VehicleState.EMERGENCY_BRAKE, "EMERGENCY_BRAKE")
    assert message.mission_label == "TRACKDRIVE"
    assert message.faults == ["AI_COMMS_LOST"] and message.shutdown_cause_label == "AI_COMMS_FAULT"
    assert message.steering_rad == pytest.approx(math.radians(-10.0))
    assert message.steering_max_rad == pytest.approx(math.radians(21.0))
    assert (message.front_brake, message.rear_brake) == (0.5, 0.25)
    assert message.wheel_speed_rpm.tolist() == [101, 102, 103, 104]
    assert message.status_age_s == pytest.approx(0.040) and message.command_age_s == 0.25
    assert message.why_not_driving


def test_the_controller_knows_how_sure_the_yaw_rate_is() -> None:
    motion = Motion(7, 1.0, 2.0, 0.5, 5.0, 0.25, 12.0, yaw_rate_sd_radps=0.03)
    state = to.state_to_msg(replace(report_after(), motion=motion), STAMP, math.nan)
    assert to.motion_from_state(state, 7) == motion


def test_odometry_says_how_sure_it_is() -> None:
    motion = Motion(x_m=1.0, speed_mps=5.0, position_sd_m=2.0, yaw_sd_rad=0.5, speed_sd_mps=0.25, yaw_rate_sd_radps=0.1)
    message = to.odometry_to_msg(motion, STAMP)
    assert {i: value for i, value in enumerate(message.pose.covariance) if value} == {0: 4.0, 7: 4.0, 35: 0.25}
    assert {i: value for i, value in enumerate(message.twist.covariance) if value} == pytest.approx(
        {0: 0.0625, 35: 0.01}
    )
    assert (message.pose.pose.position.x, message.twist.twist.linear.x) == (1.0, 5.0)


def test_the_imu_is_in_si_units_in_the_sensors_axes() -> None:
    gps = GpsImu(
        acceleration=Acceleration(1000.0, -500.0, 0.0, t_rx_ns=3),
        rotation_a=RotationA(180.0, 0.0),
        rotation_b=RotationB(-90.0),
    )
    message = to.imu_to_msg(gps, "imu_link", stamp_of)
    assert message is not None and message.header.frame_id == "imu_link" and message.header.stamp.nanosec == 3
    assert message.linear_acceleration.x == pytest.approx(9.80665)
    assert message.linear_acceleration.y == pytest.approx(-4.903325)
    assert message.angular_velocity.x == pytest.approx(math.pi)
    assert message.angular_velocity.z == pytest.approx(-math.pi / 2)
    assert message.orientation_covariance[0] == -1.0  # REP-145: not measured


def test_a_car_without_the_pcan_gps_has_the_imu_of_0x501() -> None:
    message = to.imu_to_msg(GpsImu(dynamics=LogDynamics2(1.5, -2.5, 90.0)), "imu_link", stamp_of)
    assert message is not None
    assert (message.linear_acceleration.x, message.linear_acceleration.y) == (1.5, -2.5)
    assert message.angular_velocity.z == pytest.approx(math.pi / 2)
    assert to.imu_to_msg(GpsImu(), "imu_link", stamp_of) is None


@pytest.mark.parametrize(
    ("letters", "latitude", "longitude"),
    [("NE", 52.5, 1.25), ("SE", -52.5, 1.25), ("NW", 52.5, -1.25), ("SW", -52.5, -1.25)],
)
def test_degrees_minutes_and_a_letter_become_degrees(letters: str, latitude: float, longitude: float) -> None:
    gps = GpsImu(
        status=GpsStatus(navigation_method=3),
        latitude=GpsLatitude(30.0, 52, ord(letters[0])),
        longitude=GpsLongitude(15.0, 1, ord(letters[1])),
        altitude=GpsAltitude(77.0),
    )
    fix = to.fix_to_msg(gps, "gps_link", stamp_of)
    assert fix is not None and fix.status.status == NavSatStatus.STATUS_FIX
    assert (fix.latitude, fix.longitude, fix.altitude) == pytest.approx((latitude, longitude, 77.0))


@pytest.mark.parametrize(("method", "letter"), [(0, "N"), (1, "N"), (3, "\0")])
def test_without_a_fix_there_is_no_position(method: int, letter: str) -> None:
    gps = GpsImu(
        status=GpsStatus(navigation_method=method),
        latitude=GpsLatitude(30.0, 52, ord(letter)),
        longitude=GpsLongitude(15.0, 1, ord("E")),
    )
    fix = to.fix_to_msg(gps, "gps_link", stamp_of)
    assert fix is not None and fix.status.status == NavSatStatus.STATUS_NO_FIX
    assert math.isnan(fix.latitude) and math.isnan(fix.longitude)
    assert to.fix_to_msg(GpsImu(), "gps_link", stamp_of) is None
