"""Steering against its model, and one wheel against the others."""

from __future__ import annotations

import math

import pytest

from fsai_vcu.core.supervision.config import MS, BridgeConfig
from fsai_vcu.core.supervision.plausibility import (
    SteeringCheck,
    WheelCheck,
    check_steering,
    check_wheels,
    forget_steering,
    forget_wheels,
    wheel_factors,
)
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026
from fsai_vcu.interface.images import AiCommand, VcuSteer, WheelSpeeds

CONFIG = BridgeConfig()
CAR = ADS_DV_2026
CYCLE = 10 * MS


class Actuator:
    """A steering with dead time, rate and backlash of its own."""

    def __init__(self, dead_ms: int = 50, rate_degps: float = 40.0, play_deg: float = 0.9) -> None:
        self.delayed = [0.0] * (dead_ms // 10)
        self.step_deg = rate_degps * 0.01
        self.play_deg = play_deg
        self.angle_deg = 0.0

    def step(self, request_deg: float) -> float:
        self.delayed.append(request_deg)
        target = self.delayed.pop(0)
        self.angle_deg += max(-self.step_deg, min(self.step_deg, target - self.angle_deg))
        return self.angle_deg + (self.play_deg if target < self.angle_deg else -self.play_deg)


def request_at(n: int, rate_degps: float = 40.0, most_deg: float = 30.0) -> float:
    """A sweep over the full range at the actuator's rate: what the gate lets through at its fastest."""
    period = round(4 * most_deg / (rate_degps * 0.01))
    phase = n % period / period
    return most_deg * (4 * phase if phase < 0.25 else 2 - 4 * phase if phase < 0.75 else 4 * phase - 4)


def run(actuator: Actuator, cycles: int, stuck_from: int | None = None, angle_deg: float = 0.0) -> SteeringCheck:
    check = SteeringCheck()
    measured = angle_deg
    for n in range(cycles):
        request = request_at(n)
        moved = actuator.step(request)
        if stuck_from is None or n < stuck_from:
            measured = moved
        check = check_steering(CONFIG, CAR, check, request, VcuSteer(measured, 30.0, request, n * CYCLE), n * CYCLE)
        if check.implausible_since_ns is not None:
            return check
    return check


@pytest.mark.parametrize(
    "actuator", [(50, 40.0, 0.9), (30, 40.0, 0.0), (70, 40.0, 0.9), (50, 60.0, 0.9), (50, 32.0, 0.9)]
)
def test_a_steering_that_follows_within_delay_rate_and_backlash_is_plausible(
    actuator: tuple[int, float, float],
) -> None:
    check = run(Actuator(*actuator), 3000)
    assert check.implausible_since_ns is None


def test_whole_degrees_are_plausible() -> None:
    actuator, check = Actuator(), SteeringCheck()
    for n in range(3000):
        request = request_at(n)
        measured = VcuSteer(float(round(actuator.step(request))), 30.0, request, n * CYCLE)
        check = check_steering(CONFIG, CAR, check, request, measured, n * CYCLE)
        assert check.implausible_since_ns is None


def test_a_steering_that_sticks_is_implausible_within_a_fifth_of_a_second() -> None:
    check = run(Actuator(), 3000, stuck_from=1020)
    assert check.implausible_since_ns is not None
    assert 1020 * CYCLE < check.implausible_since_ns <= 1040 * CYCLE


def test_a_steering_without_a_request_that_turns_by_itself_is_implausible() -> None:
    check = SteeringCheck()
    for n in range(10):
        check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(0.0, 30.0, 0.0, n * CYCLE), n * CYCLE)
    allowed_deg = math.degrees(CAR.steer_backlash_rad) + CONFIG.steer_margin_deg
    for angle_deg, since_ns in ((allowed_deg - 0.01, None), (allowed_deg + 0.01, 11 * CYCLE)):
        measured = VcuSteer(angle_deg, 30.0, 0.0, 11 * CYCLE)
        assert check_steering(CONFIG, CAR, check, 0.0, measured, 11 * CYCLE).implausible_since_ns == since_ns


def test_implausible_since_is_the_first_moment_and_ends_with_a_good_one() -> None:
    check = SteeringCheck()
    for n, angle in ((0, 0.0), (1, 9.0), (2, 9.0)):
        check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(angle, 30.0, 0.0, n * CYCLE), n * CYCLE)
    assert check.implausible_since_ns == 1 * CYCLE
    check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(0.0, 30.0, 0.0, 3 * CYCLE), 3 * CYCLE)
    assert check.implausible_since_ns is None


def test_a_steering_that_is_turned_at_the_start_has_the_time_to_come_straight() -> None:
    check, angle = SteeringCheck(), 4.9
    for n in range(100):
        if n >= 5:
            angle = max(0.0, angle - 0.4)
        check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(angle, 30.0, 0.0, n * CYCLE), n * CYCLE)
        assert check.implausible_since_ns is None


@pytest.mark.parametrize("measured", [None, VcuSteer(9.0, 30.0, 0.0, 0)])
def test_without_fresh_feedback_nothing_is_compared_and_the_model_begins_anew(measured: VcuSteer | None) -> None:
    before = SteeringCheck(((0, 3.0),), 2.0, 2.0, 2.0, 90 * MS, 50 * MS)
    after = check_steering(CONFIG, CAR, before, 3.0, measured, 100 * MS)
    assert (after.implausible_since_ns, after.slow_deg, after.target_deg) == (None, None, 2.0)
    assert after.pending == ((0, 3.0),)


def test_outside_as_driving_the_steering_model_is_forgotten() -> None:
    assert forget_steering(SteeringCheck(((0, 3.0),), 2.0, 2.0, 2.0, 90 * MS, 50 * MS)) == SteeringCheck()


# ---------------------------------------------------------------- wheels

T = 5_000 * MS
COASTING = AiCommand(rear_motor_speed_max_rpm=4000)
DRIVING = AiCommand(rear_torque_nm=50.0, rear_motor_speed_max_rpm=4000)
BRAKING = AiCommand(front_brake_pct=50.0, rear_brake_pct=50.0)
DRAGGING = AiCommand(rear_torque_nm=50.0, rear_motor_speed_max_rpm=500)


def odd(asked: AiCommand, rpm: tuple[int, int, int, int], steer_deg: float = 0.0, car: object = CAR) -> str:
    assert car in (ADS_DV_2021, ADS_DV_2026)
    check = check_wheels(
        CONFIG,
        car,
        WheelCheck(),
        asked,
        WheelSpeeds(*rpm, t_rx_ns=T),
        VcuSteer(steer_deg, 30, 0, T),
        T,  # type: ignore[arg-type]
    )
    assert (check.implausible_since_ns == T) is bool(check.detail)
    return check.detail


def test_wheels_that_turn_alike_are_plausible() -> None:
    assert odd(COASTING, (500, 500, 500, 500)) == ""
    assert odd(COASTING, (0, 0, 0, 0)) == ""


@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("rpm", [0, 1250])
def test_one_wheel_far_from_the_others_is_named_while_coasting(wheel: int, rpm: int) -> None:
    speeds = [500, 500, 500, 500]
    speeds[wheel] = rpm
    names = ("front left", "front right", "rear left", "rear right")
    assert odd(COASTING, tuple(speeds)).startswith(f"{names[wheel]} {rpm} rpm of ")  # type: ignore[arg-type]


def test_the_margin_is_60_rpm_and_30_percent() -> None:
    assert odd(COASTING, (710, 500, 500, 500)) == ""
    assert odd(COASTING, (711, 500, 500, 500)) != ""
    assert odd(COASTING, (290, 500, 500, 500)) == ""
    assert odd(COASTING, (289, 500, 500, 500)) != ""


def test_torque_explains_a_driven_wheel_that_spins_and_no_other() -> None:
    assert odd(DRIVING, (300, 300, 1200, 300)) == ""
    assert odd(DRIVING, (1200, 300, 300, 300)) != ""
    assert odd(DRIVING, (1200, 300, 300, 300), car=ADS_DV_2021) == ""
    assert odd(DRIVING, (300, 300, 0, 300)) != ""


def test_braking_explains_any_wheel_that_locks_and_none_that_spins() -> None:
    for wheel in range(4):
        speeds = [500, 500, 500, 500]
        speeds[wheel] = 0
        assert odd(BRAKING, tuple(speeds)) == ""  # type: ignore[arg-type]
        speeds[wheel] = 1200
        assert odd(BRAKING, tuple(speeds)) != ""  # type: ignore[arg-type]


def test_a_motor_held_by_its_speed_limit_explains_a_driven_wheel_that_is_slow() -> None:
    assert odd(DRAGGING, (300, 300, 50, 300)) == ""
    assert odd(DRAGGING, (50, 300, 300, 300)) != ""


def test_slip_is_remembered_for_a_second() -> None:
    check = check_wheels(CONFIG, CAR, WheelCheck(), DRIVING, WheelSpeeds(300, 300, 1200, 300, T), None, T)
    for after_ns, odd_wheel in ((1000 * MS - 1, False), (1000 * MS, True)):
        now_ns = T + after_ns
        speeds = WheelSpeeds(300, 300, 1200, 300, now_ns)
        later = check_wheels(CONFIG, CAR, check, COASTING, speeds, None, now_ns)
        assert (later.implausible_since_ns is not None) is odd_wheel


@pytest.mark.parametrize("steer_deg", [-30.0, -15.0, 15.0, 30.0])
def test_wheels_on_their_own_circles_are_plausible(steer_deg: float) -> None:
    rolling = tuple(round(400 * factor) for factor in wheel_factors(CAR, steer_deg))
    assert max(rolling) - min(rolling) > 60
    assert odd(COASTING, rolling, steer_deg) == ""  # type: ignore[arg-type]


def test_on_a_left_turn_the_right_wheels_go_farther_and_the_front_more_than_the_rear() -> None:
    front_left, front_right, rear_left, rear_right = wheel_factors(CAR, 20.0)
    assert rear_left < 1.0 < rear_right and front_left < front_right
    assert front_left > rear_left and front_right > rear_right
    assert wheel_factors(CAR, 0.0) == (1.0, 1.0, 1.0, 1.0)
    assert wheel_factors(CAR, 1000.0) == wheel_factors(CAR, 45.0)


def test_an_odd_wheel_counts_from_its_first_moment_and_stale_speeds_change_nothing() -> None:
    check = check_wheels(CONFIG, CAR, WheelCheck(), COASTING, WheelSpeeds(0, 500, 500, 500, T), None, T)
    later = check_wheels(CONFIG, CAR, check, COASTING, WheelSpeeds(0, 500, 500, 500, T), None, T + 99 * MS)
    assert later.implausible_since_ns == T
    stale = check_wheels(CONFIG, CAR, check, COASTING, WheelSpeeds(9, 9, 9, 9, T), None, T + 100 * MS)
    assert stale.implausible_since_ns == T
    assert check_wheels(CONFIG, CAR, check, COASTING, None, None, T).implausible_since_ns == T
    good = check_wheels(CONFIG, CAR, check, COASTING, WheelSpeeds(9, 9, 9, 9, T), None, T + 99 * MS)
    assert good.implausible_since_ns is None


def test_the_brake_that_follows_from_an_odd_wheel_does_not_explain_it() -> None:
    check = check_wheels(CONFIG, CAR, WheelCheck(), COASTING, WheelSpeeds(0, 500, 500, 500, T), None, T)
    later = check_wheels(CONFIG, CAR, check, BRAKING, WheelSpeeds(0, 400, 400, 400, T), None, T + 50 * MS)
    assert later.implausible_since_ns == T


def test_outside_as_driving_an_odd_wheel_is_forgotten_but_not_what_explains_slip() -> None:
    check = WheelCheck(T, "front left", 1, 2, 3)
    assert forget_wheels(check) == WheelCheck(None, "", 1, 2, 3)
    assert forget_wheels(WheelCheck()) == WheelCheck()
