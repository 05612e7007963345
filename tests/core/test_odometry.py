"""Dead reckoning."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from fsai_vcu.core.driving import Motion
from fsai_vcu.core.vehicle.odometry import (
    SETTINGS,
    MotionHistory,
    advance,
    begin_run,
    motion_at,
    slipped,
    standing_start,
)
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026, SLIP_RADPMPS2, VehicleParameters
from fsai_vcu.interface.messages import (
    GpsImu,
    LogDynamics2,
    RotationB,
    VcuBrake,
    VcuSteer,
    VehicleState,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.units import MS

CAR = ADS_DV_2026


class Odometry:
    """The states of one drive, one after the other."""

    def __init__(self, car: VehicleParameters) -> None:
        self._car = car
        self._state = standing_start(0)

    @property
    def motion(self) -> Motion:
        return self._state.motion

    def reset(self, now_ns: int) -> None:
        self._state = begin_run(self._state, now_ns)

    def update(self, vehicle: VehicleState, gps: GpsImu) -> Motion:
        self._state = advance(self._car, self._state, vehicle, gps)
        return self.motion


def wheels(car: VehicleParameters, speed_mps: float, steer_deg: float, t_ns: int) -> WheelSpeeds:
    """What the four wheels of a car say that rolls without slip."""
    curvature = math.tan(math.radians(steer_deg)) / car.wheelbase_m
    inner, outer = 1.0 - curvature * car.track_m / 2, 1.0 + curvature * car.track_m / 2
    reach = curvature * car.wheelbase_m
    road = (math.hypot(inner, reach), math.hypot(outer, reach), inner, outer)
    return WheelSpeeds(*(round(car.wheel_rpm_of_speed(speed_mps * share)) for share in road), t_rx_ns=t_ns)


def state(speed_mps: float, steer_deg: float, t_ns: int, car: VehicleParameters = CAR) -> VehicleState:
    return VehicleState(speeds=wheels(car, speed_mps, steer_deg, t_ns), steer=VcuSteer(steer_deg, t_rx_ns=t_ns))


def drive(
    odometry: Odometry, speed_mps: float, steer_deg: float, seconds: float, t_ns: int = 0, gps: GpsImu | None = None
) -> Motion:
    motion = odometry.motion
    for step in range(1, round(seconds * 100) + 1):
        now = t_ns + step * 10 * MS
        motion = odometry.update(state(speed_mps, steer_deg, now), gps or GpsImu())
    return motion


def test_a_straight_drive_is_as_long_as_the_wheels_say() -> None:
    motion = drive(Odometry(CAR), 8.0, 0.0, 5.0)
    assert motion.x_m == pytest.approx(40.0, abs=0.2)
    assert motion.y_m == pytest.approx(0.0)
    assert motion.distance_m == pytest.approx(motion.x_m)
    assert motion.speed_mps == pytest.approx(8.0, abs=0.03)


@pytest.mark.parametrize("steer_deg", [15.0, -15.0])
def test_a_full_circle_by_the_steering_ends_where_it_began(steer_deg: float) -> None:
    radius = CAR.wheelbase_m / math.tan(math.radians(15.0))
    motion = drive(Odometry(CAR), 4.0, steer_deg, 2.0 * math.pi * radius / 4.0)
    assert math.hypot(motion.x_m, motion.y_m) < 0.35
    assert math.copysign(1.0, motion.yaw_rate_radps) == math.copysign(1.0, steer_deg)
    assert abs(motion.yaw_rate_radps) == pytest.approx(4.0 / radius, rel=0.01)


def test_reset_makes_the_cars_pose_the_origin() -> None:
    odometry = Odometry(CAR)
    drive(odometry, 5.0, 5.0, 1.0)
    odometry.reset(2_000 * MS)
    assert odometry.motion == Motion(t_ns=2_000 * MS)


def test_time_that_runs_backwards_changes_nothing() -> None:
    odometry = Odometry(CAR)
    before = drive(odometry, 5.0, 0.0, 1.0)
    assert odometry.update(state(5.0, 0.0, 500 * MS), GpsImu()) == before


@pytest.mark.parametrize(
    ("car", "rpm", "brake_pct", "rolling_rpm"),
    [
        (ADS_DV_2026, (100, 100, 700, 700), 0.0, 100),  # free wheels, where the driven ones spin
        (ADS_DV_2021, (100, 100, 100, 700), 0.0, 100),
        (replace(ADS_DV_2026, driven_front=True, driven_rear=False), (700, 700, 100, 100), 0.0, 100),
        (ADS_DV_2026, (0, 0, 300, 300), 40.0, 300),  # those that turn, where the braked ones lock
    ],
)
def test_wheels_that_spin_or_lock_do_not_count(
    car: VehicleParameters, rpm: tuple[int, int, int, int], brake_pct: float, rolling_rpm: int
) -> None:
    speeds = WheelSpeeds(*rpm, t_rx_ns=10 * MS)
    brake = VcuBrake(front_pct=brake_pct, rear_pct=brake_pct, t_rx_ns=10 * MS) if brake_pct else None
    motion = Odometry(car).update(VehicleState(speeds=speeds, brake=brake), GpsImu())
    assert motion.speed_mps == pytest.approx(CAR.speed_of_wheel_rpm(rolling_rpm))


def test_a_constant_9_rpm_without_wheel_pulses_is_standstill() -> None:
    odometry = Odometry(CAR)
    for step in range(1, 101):
        now = step * 10 * MS
        vehicle = VehicleState(speeds=WheelSpeeds(9, 9, 9, 9, t_rx_ns=now), counts=WheelCounts(5, 5, 5, 5, t_rx_ns=now))
        motion = odometry.update(vehicle, GpsImu())
        assert motion.speed_mps == pytest.approx(0.0 if now >= 510 * MS else CAR.speed_of_wheel_rpm(9))
    assert motion.distance_m < 0.15


def test_a_slow_car_whose_pulses_go_on_is_moving() -> None:
    odometry = Odometry(CAR)
    for step in range(1, 201):
        now = step * 10 * MS
        counts = WheelCounts(step // 40, 0, 0, 0, t_rx_ns=now)
        motion = odometry.update(VehicleState(speeds=WheelSpeeds(9, 9, 9, 9, t_rx_ns=now), counts=counts), GpsImu())
    assert motion.speed_mps == pytest.approx(CAR.speed_of_wheel_rpm(9))


def test_a_motion_is_of_the_instant_of_its_wheel_speeds() -> None:
    motion = Odometry(CAR).update(VehicleState(speeds=WheelSpeeds(t_rx_ns=7), steer=VcuSteer(t_rx_ns=9)), GpsImu())
    assert motion.t_ns == 7


def test_a_car_that_falls_silent_is_where_it_was_received_last() -> None:
    """Whatever else is still received, and however often it is looked at."""
    odometry = Odometry(CAR)
    last = drive(odometry, 5.0, 0.0, 1.0)
    speeds = wheels(CAR, 5.0, 0.0, 1_000 * MS)
    for now in range(1_010 * MS, 88_000 * MS, 10 * MS):
        sensed = GpsImu(rotation_b=RotationB(5.0, now))
        assert odometry.update(VehicleState(speeds=speeds, steer=VcuSteer(5.0, t_rx_ns=now)), sensed) == last
    assert motion_at(last, 88_000 * MS) == replace(motion_at(last, last.t_ns + 300 * MS), t_ns=88_000 * MS)


def gap(silence_ms: int, speed_mps: float = 5.0) -> tuple[Motion, Motion]:
    """Motions on a straight before and after a silence of the wheel speeds."""
    odometry = Odometry(CAR)
    before = drive(odometry, speed_mps, 0.0, 1.0)
    return before, odometry.update(state(speed_mps, 0.0, (1_000 + silence_ms) * MS), GpsImu())


@pytest.mark.parametrize(("silence_ms", "bridged_ms"), [(10, 10), (500, 500), (501, 500), (87_000, 500)])
def test_a_silence_is_bridged_for_half_a_second(silence_ms: int, bridged_ms: int) -> None:
    before, after = gap(silence_ms)
    assert after.t_ns - before.t_ns == silence_ms * MS
    assert after.distance_m - before.distance_m == pytest.approx(5.0 * bridged_ms / 1e3, rel=0.01)


def test_a_car_at_rest_is_as_sure_as_at_the_start() -> None:
    motion = drive(Odometry(CAR), 0.0, 0.0, 100.0)
    assert (motion.position_sd_m, motion.yaw_sd_rad, motion.speed_sd_mps, motion.yaw_rate_sd_radps) == (0, 0, 0, 0)


def test_position_and_heading_get_less_sure_with_the_way() -> None:
    near, far = drive(Odometry(CAR), 5.0, 0.0, 2.0), drive(Odometry(CAR), 5.0, 0.0, 20.0)
    for motion in (near, far):
        way_m = motion.distance_m
        assert motion.yaw_sd_rad == pytest.approx(SETTINGS.yaw_sd_radpsqrtm * math.sqrt(way_m))
        heading = 0.5 * SETTINGS.yaw_sd_radpsqrtm**2 * way_m**2
        expected = math.sqrt(SETTINGS.error_length_m * (SETTINGS.position_sd_share**2 * way_m + heading))
        assert motion.position_sd_m == pytest.approx(expected, rel=0.02)


def test_what_was_driven_unreceived_is_added_whole() -> None:
    before, short = gap(100)
    _, long = gap(1_100)
    assert short.position_sd_m - before.position_sd_m < 0.1
    assert long.position_sd_m - before.position_sd_m > 5.0
    assert long.yaw_sd_rad - before.yaw_sd_rad > SETTINGS.missing_yaw_rate_radps
    _, stood = gap(87_000, speed_mps=0.0)
    assert (stood.position_sd_m, stood.yaw_sd_rad) == (0.0, 0.0)


def test_speed_is_as_sure_as_resolution_and_radius() -> None:
    slow, fast = drive(Odometry(CAR), 0.5, 0.0, 1.0), drive(Odometry(CAR), 20.0, 0.0, 1.0)
    assert slow.speed_sd_mps == pytest.approx(SETTINGS.speed_sd_mps, rel=0.1)
    assert fast.speed_sd_mps == pytest.approx(SETTINGS.speed_sd_share * 20.0, rel=0.01)


def test_a_yaw_rate_is_as_sure_as_what_it_is_taken_from() -> None:
    by_steering = drive(Odometry(CAR), 5.0, 10.0, 0.1)
    assert by_steering.yaw_rate_sd_radps == pytest.approx(5.0 * SETTINGS.curvature_sd_1pm, rel=0.01)
    now = 10 * MS
    sensed = GpsImu(rotation_b=RotationB(z_degps=SOUND_DEGPS, t_rx_ns=now))
    by_sensor = Odometry(CAR).update(state(5.0, 10.0, now), sensed)
    assert by_sensor.yaw_rate_sd_radps == SETTINGS.yaw_rate_sd_radps
    assert by_sensor.yaw_rate_radps == pytest.approx(math.radians(SOUND_DEGPS))


BY_STEERING = 5.0 * math.tan(math.radians(10.0)) / CAR.wheelbase_m  # rad/s at 5 m/s and 10 deg
SOUND_DEGPS = 38.0  # of a sensor near that


def turning(vehicle: VehicleState, sensed_degps: float, now_ns: int, age_ms: int = 0) -> float:
    """The yaw rate in rad/s that follows from one look at a car and its sensor."""
    gps = GpsImu(dynamics=LogDynamics2(yaw_rate_degps=sensed_degps, t_rx_ns=now_ns - age_ms * MS))
    return Odometry(CAR).update(vehicle, gps).yaw_rate_radps


def test_a_yaw_rate_that_is_older_than_100_ms_is_not_believed() -> None:
    for age_ms, believed in ((100, True), (101, False)):
        expected = math.radians(SOUND_DEGPS) if believed else BY_STEERING
        found = turning(state(5.0, 10.0, 500 * MS), SOUND_DEGPS, 500 * MS, age_ms)
        assert found == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("value", [math.nan, math.inf, -200.0])
def test_a_yaw_rate_that_cannot_be_is_not_believed(value: float) -> None:
    assert turning(state(5.0, 10.0, 10 * MS), value, 10 * MS) == pytest.approx(BY_STEERING, abs=0.01)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_yaw_rate_far_from_steering_and_wheels_is_invalid(side: float) -> None:
    """Beyond its margin and what rounded wheel speeds make of it."""
    margin = SETTINGS.yaw_rate_disagreement_radps
    near, far = BY_STEERING + side * (margin - 0.03), BY_STEERING + side * (margin + 0.06)
    now = 10 * MS
    assert turning(state(5.0, 10.0, now), math.degrees(near), now) == pytest.approx(near)
    assert turning(state(5.0, 10.0, now), math.degrees(far), now) == pytest.approx(BY_STEERING, abs=0.01)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_sliding_car_turns_as_gyro_and_wheels_measure(share: float) -> None:
    """Steered by 20 deg, its wheels roll as if it were steered by 5: anything between the two can be."""
    now = 10 * MS
    sliding = VehicleState(speeds=wheels(CAR, 8.0, 5.0, now), steer=VcuSteer(20.0, t_rx_ns=now))
    by_wheels, by_steering = (8.0 * math.tan(math.radians(deg)) / CAR.wheelbase_m for deg in (5.0, 20.0))
    real = by_wheels + share * 0.9 * (by_steering - by_wheels)
    assert turning(sliding, math.degrees(real), now) == pytest.approx(real)


def test_the_sensors_bias_is_learnt_at_rest_and_survives_a_reset() -> None:
    odometry = Odometry(CAR)
    for step in range(1, 401):
        now = step * 10 * MS
        odometry.update(state(0.0, 0.0, now), GpsImu(rotation_b=RotationB(1.0, now)))
    assert odometry.motion.yaw_rad == 0.0
    odometry.reset(4_000 * MS)
    for step in range(1, 101):
        now = 4_000 * MS + step * 10 * MS
        motion = odometry.update(state(5.0, 0.0, now), GpsImu(rotation_b=RotationB(1.0, now)))
    assert abs(motion.yaw_rate_radps) < math.radians(0.05)


def test_a_reading_changes_the_bias_only_once() -> None:
    odometry = Odometry(CAR)
    for step in range(1, 11):
        odometry.update(state(0.0, 0.0, step * MS), GpsImu(rotation_b=RotationB(2.0, 1)))
    now = 11 * MS
    motion = odometry.update(state(5.0, 0.0, now), GpsImu(rotation_b=RotationB(2.0, now)))
    learnt = SETTINGS.bias_gain * 2.0
    assert math.degrees(motion.yaw_rate_radps) == pytest.approx(2.0 - learnt, abs=1e-6)


def test_a_steering_angle_that_is_no_number_leaves_the_last_one() -> None:
    odometry = Odometry(CAR)
    odometry.update(state(5.0, 10.0, 10 * MS), GpsImu())
    speeds = wheels(CAR, 5.0, 10.0, 20 * MS)
    motion = odometry.update(VehicleState(speeds=speeds, steer=VcuSteer(math.nan, t_rx_ns=20 * MS)), GpsImu())
    assert motion.yaw_rate_radps == pytest.approx(5.0 * math.tan(math.radians(10.0)) / CAR.wheelbase_m, rel=0.01)


def test_a_motion_is_carried_along_its_arc_both_ways() -> None:
    here = Motion(t_ns=0, x_m=1.0, y_m=2.0, yaw_rad=math.pi / 2, speed_mps=10.0, yaw_rate_radps=1.0, distance_m=50.0)
    later = motion_at(here, 50 * MS)
    assert (later.x_m, later.y_m) == pytest.approx((1.0 - 0.5 * math.sin(0.025), 2.0 + 0.5 * math.cos(0.025)))
    assert later.distance_m == pytest.approx(50.5)
    back = motion_at(later, 0)
    assert (back.x_m, back.y_m, back.yaw_rad) == pytest.approx((1.0, 2.0, math.pi / 2))


def test_history_interpolates_across_the_wrap_of_the_angle() -> None:
    history = MotionHistory()
    history.add(Motion(t_ns=0, x_m=0.0, yaw_rad=3.1, distance_m=0.0))
    history.add(Motion(t_ns=100, x_m=1.0, yaw_rad=-3.1, distance_m=1.0))
    middle = history.at(50)
    assert middle is not None
    assert middle.x_m == pytest.approx(0.5)
    assert abs(math.remainder(middle.yaw_rad - math.pi, 2 * math.pi)) < 1e-9


def test_history_forgets_everything_when_odometry_begins_anew() -> None:
    history = MotionHistory()
    history.add(Motion(t_ns=0, x_m=90.0, distance_m=90.0))
    history.add(Motion(t_ns=10, x_m=0.0, distance_m=0.0))
    at = history.at(5)
    assert at is not None
    assert at.x_m == 0.0


def test_an_empty_history_knows_nothing() -> None:
    assert MotionHistory().at(0) is None


def test_history_keeps_no_more_than_its_span() -> None:
    history = MotionHistory(span_ns=100)
    for t in range(0, 1000, 10):
        history.add(Motion(t_ns=t, x_m=float(t), distance_m=float(t)))
    oldest = history.at(0)
    assert oldest is not None
    assert oldest.x_m == pytest.approx(890.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_slipping_car_moves_outward_of_where_it_points(side: float) -> None:
    speed, radius = 8.0, 8.0  # 8 m/s2
    last = place = Motion(speed_mps=speed, yaw_rate_radps=side * speed / radius)
    for degrees in range(1, 91):
        turned = math.radians(degrees)
        x, y = radius * math.sin(turned), side * radius * (1.0 - math.cos(turned))
        motion = replace(last, x_m=x, y_m=y, yaw_rad=side * turned, distance_m=radius * turned)
        place, last = slipped(place, last, motion), motion
    outward = SLIP_RADPMPS2 * 8.0  # the quarter circle is turned by it, and nothing else of the motion changes
    assert place.x_m == pytest.approx(last.x_m + outward * side * last.y_m, abs=1e-3)
    assert place.y_m == pytest.approx(last.y_m - outward * side * last.x_m, abs=1e-3)
    assert replace(place, x_m=last.x_m, y_m=last.y_m) == last


def test_a_car_that_drives_straight_on_does_not_slip() -> None:
    last = Motion(speed_mps=15.0)
    motion = replace(last, x_m=3.0, distance_m=3.0)
    assert slipped(replace(last, x_m=1.0, y_m=2.0), last, motion) == replace(motion, x_m=4.0, y_m=2.0)


def test_a_wild_yaw_rate_moves_the_car_no_more_than_tyres_slip() -> None:
    last = Motion(speed_mps=15.0)
    wild = replace(last, x_m=3.0, distance_m=3.0, yaw_rate_radps=1e3)
    assert abs(slipped(last, last, wild).y_m) < 0.3
