"""The simulated car: actuators, straight-line performance, corners, wheels in the air."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.optimize import brentq

from fsai_hil.simulator import car as car_module
from fsai_hil.simulator.car import Car, Pose
from fsai_hil.simulator.vcu import Actuation
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026, CARS, VehicleParameters
from fsai_vcu.interface.units import MS

FULL = Actuation(rear_torque_nm=195.0, rear_motor_speed_max_rpm=4000, tractive_system_live=True)
COAST = Actuation(tractive_system_live=True)


def drive(car: Car, order: Actuation, seconds: float) -> None:
    """In steps of 10 ms, as the VCU orders."""
    end = car.t_ns + round(seconds * 1e9)
    while car.t_ns < end:
        car.advance(min(end, car.t_ns + 10 * MS), order)


def at_speed(speed_mps: float, facts: VehicleParameters = CARS["2026"]) -> Car:
    car = Car(facts)
    while car.speed_mps < speed_mps:
        drive(car, FULL, 0.01)
    return car


def stopping(car: Car, order: Actuation) -> tuple[float, float]:
    """(metres, seconds) until it stands."""
    begin_m, begin_ns = car.truth().distance_m, car.t_ns
    while car.speed_mps > 0.0:
        drive(car, order, 0.01)
        assert car.t_ns - begin_ns < 60e9, "it never stops"
    return car.truth().distance_m - begin_m, (car.t_ns - begin_ns) / 1e9


# ------------------------------------------------------------ straight ahead


def test_full_throttle_is_1_9_mps2_75_m_in_9_8_s_and_21_mps() -> None:
    car = Car(CARS["2026"])
    drive(car, FULL, 0.3)
    assert car.feedback().accel_xyz_mps2[0] == pytest.approx(1.9, abs=0.1)
    while car.truth().distance_m < 75.3:
        drive(car, FULL, 0.01)
    assert car.t_ns / 1e9 == pytest.approx(9.8, abs=0.3)
    drive(car, FULL, 50.0)
    assert car.speed_mps == pytest.approx(21.0, abs=0.7), "and no more"


def test_both_axles_drive_in_2021_and_only_the_rear_one_in_2026() -> None:
    order = replace(FULL, front_torque_nm=195.0, front_motor_speed_max_rpm=4000)
    both, rear = Car(CARS["2021"]), Car(CARS["2026"])
    drive(both, order, 1.0)
    drive(rear, order, 1.0)
    assert both.speed_mps > 1.8 * rear.speed_mps
    assert rear.feedback().front_torque_nm == 0.0


def test_torque_slews_by_50_nm_in_10_ms() -> None:
    car = Car(CARS["2026"])
    car.advance(10 * MS, FULL)
    assert car.feedback().rear_torque_nm == pytest.approx(50.0, abs=0.1)
    car.advance(20 * MS, COAST)
    assert car.feedback().rear_torque_nm == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(
    ("rpm", "torque_nm"), [(0, 195), (525, 172.5), (1050, 150), (1400, 120), (1750, 100), (2450, 50), (3150, 10)]
)
def test_available_torque_falls_with_motor_speed(rpm: float, torque_nm: float) -> None:
    assert Car(CARS["2026"]).available_torque_nm(rpm) == pytest.approx(torque_nm)


def test_no_torque_comes_without_a_live_tractive_system() -> None:
    car = Car(CARS["2026"])
    drive(car, replace(FULL, tractive_system_live=False), 1.0)
    assert car.speed_mps == 0.0


def test_a_motor_above_its_speed_limit_brakes_and_never_reverses() -> None:
    car, order = at_speed(5.0), replace(FULL, rear_torque_nm=100.0, rear_motor_speed_max_rpm=0)
    drive(car, order, 0.3)
    assert car.feedback().rear_torque_nm == pytest.approx(-100.0)
    _, seconds = stopping(car, order)
    assert seconds < 9.0
    where = car.pose
    drive(car, order, 2.0)
    assert car.pose == where


def test_the_motor_speed_limit_holds_the_speed() -> None:
    car = Car(CARS["2026"])
    limit_rpm = 1000
    drive(car, replace(FULL, rear_motor_speed_max_rpm=limit_rpm), 15.0)
    assert max(car.truth().wheel_rpm) * 3.5 == pytest.approx(limit_rpm, rel=0.05)


# ------------------------------------------------------------ brakes


def test_brakes_wait_80_ms_and_then_act() -> None:
    car = at_speed(10.0)
    order = replace(COAST, front_brake_pct=50.0, rear_brake_pct=50.0)
    begin = car.t_ns
    while car.feedback().front_brake_pct == 0.0:
        car.advance(car.t_ns + 2 * MS, order)
    assert 80 * MS <= car.t_ns - begin <= 84 * MS


@pytest.mark.parametrize(
    ("asked", "comes"), [(0.0, 0.0), (0.5, 13.0), (10.0, 13.0), (20.0, 21.2), (50.0, 53.0), (100.0, 100.0)]
)
def test_brake_pressure_is_6_percent_over_the_request_or_13(asked: float, comes: float) -> None:
    car = Car(CARS["2026"])
    drive(car, replace(COAST, front_brake_pct=asked, rear_brake_pct=asked), 1.0)
    assert car.feedback().rear_brake_pct == pytest.approx(comes)


def test_full_braking_and_the_ebs_decelerate_with_9_mps2() -> None:
    speed = 12.0
    by_request = stopping(at_speed(speed), replace(COAST, front_brake_pct=100.0, rear_brake_pct=100.0))
    # 80 ms of dead time, and half of the 100 ms in which the pressure rises
    assert by_request[0] == pytest.approx(speed**2 / (2 * 9.0) + speed * 0.13, rel=0.03)
    assert stopping(at_speed(speed), replace(COAST, ebs_engaged=True)) == pytest.approx(by_request)


def test_the_least_brake_request_is_a_step_of_1_2_mps2() -> None:
    coasting, braking = at_speed(10.0), at_speed(10.0)
    drive(coasting, COAST, 1.0)
    drive(braking, replace(COAST, front_brake_pct=0.5, rear_brake_pct=0.5), 1.0)
    assert coasting.speed_mps - braking.speed_mps == pytest.approx(0.13 * 9.0 * 0.91, abs=0.03)


def test_a_braked_car_does_not_pull_away_against_its_brakes() -> None:
    car = Car(CARS["2026"])
    drive(car, replace(COAST, front_brake_pct=100.0, rear_brake_pct=100.0), 0.5)
    drive(car, replace(FULL, front_brake_pct=100.0, rear_brake_pct=100.0), 2.0)
    assert car.speed_mps == 0.0


# ------------------------------------------------------------ steering


def test_steering_turns_after_50_ms_with_40_degps_less_its_play() -> None:
    car = Car(CARS["2026"])
    order = replace(COAST, steer_deg=20.0)
    drive(car, order, 0.05)
    assert car.feedback().steer_deg == 0.0
    drive(car, order, 0.25)
    assert car.feedback().steer_deg == pytest.approx(40.0 * 0.25 - 0.9, abs=0.1)
    drive(car, order, 1.0)
    assert car.feedback().steer_deg == pytest.approx(20.0 - 0.9)


def test_requests_keep_their_order_through_the_dead_time() -> None:
    car = Car(CARS["2026"])
    car.advance(10 * MS, replace(COAST, steer_deg=10.0))
    car.advance(20 * MS, replace(COAST, steer_deg=-10.0))
    drive(car, replace(COAST, steer_deg=-10.0), 1.0)
    assert car.feedback().steer_deg == pytest.approx(-10.0 + 0.9)


@pytest.mark.parametrize("revision", ["2021", "2026"])
def test_the_road_wheels_stop_at_the_cars_own_limit(revision: str) -> None:
    car = Car(CARS[revision])
    facts = car.facts
    drive(car, replace(COAST, steer_deg=60.0), 3.0)
    assert car.truth().steer_deg == pytest.approx(math.degrees(facts.steer_max_rad - facts.steer_backlash_rad))


def test_a_slow_circle_has_the_radius_of_the_steering_geometry() -> None:
    car = Car(CARS["2026"])
    order = replace(FULL, rear_torque_nm=60.0, rear_motor_speed_max_rpm=250, steer_deg=21.9)
    drive(car, order, 6.0)
    points = []
    for _ in range(320):  # more than once round
        drive(car, order, 0.05)
        points.append((car.pose.x_m, car.pose.y_m))
    width = max(x for x, _ in points) - min(x for x, _ in points)
    assert width / 2.0 == pytest.approx(1.53 / math.tan(math.radians(21.0)), rel=0.02)  # missions.md: 3.99 m


def test_tyres_limit_the_lateral_acceleration() -> None:
    car = at_speed(12.0)
    drive(car, replace(COAST, steer_deg=25.0), 0.6)
    peak = 0.0
    for _ in range(50):
        drive(car, replace(COAST, steer_deg=25.0), 0.01)
        peak = max(peak, abs(car.feedback().accel_xyz_mps2[1]))
    assert 6.0 < peak < 1.1 * car_module.FRICTION * 9.81


@pytest.mark.parametrize("cog_m", [0.6, 0.765, 0.95])
@pytest.mark.parametrize("speed_mps", [4.0, 8.0, 12.0])
def test_steady_cornering_is_neutral_with_the_tyres_slip(speed_mps: float, cog_m: float) -> None:
    """Wherever the weight is: the same tyres, stiffness by load, no understeer. At 2 m/s2 the tyres are linear."""
    car, lateral_mps2 = at_speed(speed_mps, replace(CARS["2026"], cog_ahead_of_rear_axle_m=cog_m)), 2.0
    steer_deg = math.degrees(math.atan(1.53 * lateral_mps2 / speed_mps**2)) + 0.9  # and the play
    motor_rpm = round(car.facts.wheel_rpm_of_speed(speed_mps) * 3.5) + 20
    drive(car, replace(FULL, rear_torque_nm=60.0, rear_motor_speed_max_rpm=motor_rpm, steer_deg=steer_deg), 5.0)
    before = car.truth()
    drive(car, replace(FULL, rear_torque_nm=60.0, rear_motor_speed_max_rpm=motor_rpm, steer_deg=steer_deg), 0.02)
    now = car.truth()
    curvature = math.tan(math.radians(now.steer_deg)) / 1.53
    assert now.yaw_rate_radps == pytest.approx(now.speed_mps * curvature, rel=0.01)
    dx, dy = now.pose.x_m - before.pose.x_m, now.pose.y_m - before.pose.y_m
    outwards = 0.5 * (before.pose.yaw_rad + now.pose.yaw_rad) - math.atan2(dy, dx)  # of the rear axle, by its tyres
    stiffness = car_module.TYRE_B * car_module.TYRE_C * car_module.FRICTION  # lateral force by angle and load
    lateral_g = now.speed_mps * now.yaw_rate_radps / 9.81
    assert math.remainder(outwards, math.tau) == pytest.approx(lateral_g / stiffness, rel=0.05)


def test_positive_steering_turns_left_right_wheels_run_faster() -> None:
    car = at_speed(4.0)
    drive(car, replace(FULL, rear_torque_nm=30.0, steer_deg=10.0), 1.0)
    fl, fr, rl, rr = car.truth().wheel_rpm
    assert car.truth().yaw_rate_radps > 0.0
    assert fr > fl
    assert rr > rl


def test_the_yaw_rate_is_steady_down_to_walking_pace() -> None:
    car = at_speed(5.0)
    order = replace(COAST, steer_deg=8.0)
    drive(car, order, 0.5)
    before = car.truth().yaw_rate_radps
    while car.speed_mps > 0.05:
        drive(car, order, 0.01)
        now = car.truth().yaw_rate_radps
        assert abs(now - before) < 0.02
        before = now


# ------------------------------------------------------------ standing, sensors


def test_a_car_that_nobody_moves_stands_exactly_still() -> None:
    car = Car(CARS["2026"], Pose(3.0, -4.0, 1.0))
    drive(car, replace(COAST, steer_deg=20.0), 5.0)
    assert (car.pose.x_m, car.pose.y_m, car.pose.yaw_rad) == pytest.approx((3.0, -4.0, 1.0), abs=1e-12)
    assert car.feedback().wheel_rpm == (0.0, 0.0, 0.0, 0.0)


def test_wheel_speeds_are_those_of_the_rolling_radius() -> None:
    car = at_speed(8.0)
    drive(car, COAST, 0.5)
    expected = car.speed_mps / (2.0 * math.pi * car.facts.rolling_radius_m) * 60.0
    assert car.feedback().wheel_rpm == pytest.approx([expected] * 4, rel=0.01)


def test_on_a_slippery_track_wheels_spin_and_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    spinning, car = Car(CARS["2026"]), at_speed(8.0)
    monkeypatch.setattr(car_module, "FRICTION", 0.2)
    drive(spinning, FULL, 1.0)
    fl, _, rl, _ = spinning.truth().wheel_rpm
    assert rl > 1.5 * fl
    drive(car, replace(COAST, front_brake_pct=100.0, rear_brake_pct=100.0), 0.4)
    rolling = car.speed_mps / (2.0 * math.pi * car.facts.rolling_radius_m) * 60.0
    assert car.truth().wheel_rpm[0] < 0.5 * rolling


def test_pulse_counters_wrap_at_16_bits_and_lose_no_pulse() -> None:
    car = Car(replace(ADS_DV_2026, wheel_pulses_per_rev=6000))
    total, last = 0, car.feedback().pulses[2]
    seen_wrap = False
    revolutions = 0.0
    for _ in range(800):
        drive(car, FULL, 0.01)
        revolutions += car.truth().wheel_rpm[2] * 0.01 / 60.0
        now = car.feedback().pulses[2]
        assert 0 <= now <= 0xFFFF
        seen_wrap |= now < last
        total += (now - last) & 0xFFFF
        last = now
    assert seen_wrap
    assert total == pytest.approx(revolutions * 6000, rel=0.02)


def test_wheel_speeds_rest_at_9_rpm_for_a_second_after_the_stop() -> None:
    car = at_speed(2.0)
    stopping(car, replace(COAST, front_brake_pct=30.0, rear_brake_pct=30.0))
    assert car.feedback().wheel_rpm == (9.0, 9.0, 9.0, 9.0)
    assert car.standing
    drive(car, COAST, 0.9)
    assert car.feedback().wheel_rpm == (9.0, 9.0, 9.0, 9.0)
    drive(car, COAST, 0.15)
    assert car.feedback().wheel_rpm == (0.0, 0.0, 0.0, 0.0)


def test_the_gps_sees_100_m_north_and_east_and_the_course() -> None:
    origin, moved = Car(ADS_DV_2026).feedback(), Car(ADS_DV_2026, Pose(100.0, 100.0)).feedback()
    assert origin.course_deg == pytest.approx(90.0)  # east
    assert Car(ADS_DV_2026, Pose(yaw_rad=math.pi / 2)).feedback().course_deg == pytest.approx(0.0)  # north
    north_m = (moved.latitude_deg - origin.latitude_deg) * 111_320.0
    east_m = (moved.longitude_deg - origin.longitude_deg) * 111_320.0 * math.cos(math.radians(origin.latitude_deg))
    assert (east_m, north_m) == pytest.approx((100.0, 100.0), abs=0.1)


# ------------------------------------------------------------ in the air, and other cars


def test_wheels_in_the_air_turn_and_the_car_stays() -> None:
    car = Car(CARS["2026"], wheels_in_air=True)
    rpm = 200
    order = replace(FULL, rear_torque_nm=30.0, rear_motor_speed_max_rpm=round(rpm * 3.5))
    drive(car, order, 8.0)
    fl, fr, rl, rr = car.truth().wheel_rpm
    assert (rl, rr) == pytest.approx((rpm, rpm), rel=0.1)
    assert (fl, fr) == (0.0, 0.0)
    assert car.pose == Pose()
    drive(car, replace(COAST, rear_brake_pct=30.0), 3.0)
    assert car.standing


def test_the_same_orders_give_the_same_run_in_whatever_portions() -> None:
    one, two = Car(CARS["2026"]), Car(CARS["2026"])
    order = replace(FULL, steer_deg=5.0)
    one.advance(3_000 * MS, order)
    for t in range(2, 3_001, 2):
        two.advance(t * MS, order)
    assert one.truth() == two.truth()


def test_placing_the_car_stops_it_and_keeps_its_pulse_counters() -> None:
    car = at_speed(5.0)
    pulses = car.feedback().pulses
    assert pulses[2] > 0
    car.place(Pose(1.0, 2.0, 0.5))
    assert car.pose == Pose(1.0, 2.0, 0.5)
    assert car.speed_mps == 0.0
    assert car.feedback().pulses == pulses


def pushing_n(speed_mps: float) -> float:
    """At full throttle, by the torque schedule and the resistances; without the driven tyres' slip."""
    motor_rpm = ADS_DV_2026.wheel_rpm_of_speed(speed_mps) * 3.5
    nm = np.interp(motor_rpm, *zip(*ADS_DV_2026.torque_curve_rpm_nm, strict=True))
    drive_n = float(nm) * car_module.DRIVELINE_EFFICIENCY / ADS_DV_2026.rolling_radius_m
    return drive_n - car_module.ROLLING_RESISTANCE * 300.0 * 9.81 - 0.6 * car_module.DRAG_AREA_M2 * speed_mps**2


def test_the_top_speed_is_that_of_the_forces() -> None:
    car = Car(CARS["2026"])
    drive(car, FULL, 90.0)
    assert car.speed_mps == pytest.approx(brentq(pushing_n, 10.0, 24.0), rel=0.01)
