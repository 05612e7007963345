"""Steering against its model, and one wheel against the others."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from msgspec.structs import replace

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.plausibility import (
    SteeringCheck,
    WheelCheck,
    check_steering,
    check_wheels,
    forget_wheels,
    wheel_factors,
)
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026, VehicleParameters
from fsai_vcu.interface.messages import AiCommand, VcuSteer, WheelSpeeds
from fsai_vcu.interface.units import MS

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
def test_steering_within_delay_rate_and_backlash_is_plausible(
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


def test_stuck_steering_is_implausible_within_200_ms() -> None:
    check = run(Actuator(), 3000, stuck_from=1020)
    assert check.implausible_since_ns is not None
    assert 1020 * CYCLE < check.implausible_since_ns <= 1040 * CYCLE


def test_steering_that_turns_without_a_request_is_implausible() -> None:
    check = SteeringCheck()
    for n in range(10):
        check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(0.0, 30.0, 0.0, n * CYCLE), n * CYCLE)
    allowed_deg = math.degrees(CAR.steer_backlash_rad) + CONFIG.steer_margin_deg
    for angle_deg, since_ns in ((allowed_deg - 0.01, None), (allowed_deg + 0.01, 11 * CYCLE)):
        measured = VcuSteer(angle_deg, 30.0, 0.0, 11 * CYCLE)
        assert check_steering(CONFIG, CAR, check, 0.0, measured, 11 * CYCLE).implausible_since_ns == since_ns


def test_implausible_since_is_the_first_time_until_a_good_one() -> None:
    check = SteeringCheck()
    for n, angle in ((0, 0.0), (1, 9.0), (2, 9.0)):
        check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(angle, 30.0, 0.0, n * CYCLE), n * CYCLE)
    assert check.implausible_since_ns == 1 * CYCLE
    check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(0.0, 30.0, 0.0, 3 * CYCLE), 3 * CYCLE)
    assert check.implausible_since_ns is None


def test_steering_turned_at_the_start_has_time_to_straighten() -> None:
    check, angle = SteeringCheck(), 4.9
    for n in range(100):
        if n >= 5:
            angle = max(0.0, angle - 0.4)
        check = check_steering(CONFIG, CAR, check, 0.0, VcuSteer(angle, 30.0, 0.0, n * CYCLE), n * CYCLE)
        assert check.implausible_since_ns is None


@pytest.mark.parametrize("measured", [None, VcuSteer(9.0, 30.0, 0.0, 0)])
def test_without_fresh_feedback_the_steering_model_starts_anew(measured: VcuSteer | None) -> None:
    before = SteeringCheck(((0, 3.0),), 2.0, 2.0, 2.0, 90 * MS, 50 * MS)
    after = check_steering(CONFIG, CAR, before, 3.0, measured, 100 * MS)
    assert (after.implausible_since_ns, after.slow_deg, after.target_deg) == (None, None, 2.0)
    assert after.pending == ((0, 3.0),)


def measured(angle_deg: float, t_ns: int) -> VcuSteer:
    return VcuSteer(angle_deg, 30.0, 0.0, t_ns)


def test_the_model_begins_where_the_steering_is_measured() -> None:
    check = check_steering(CONFIG, CAR, SteeringCheck(), 7.0, measured(3.0, 5 * MS), 10 * MS)
    assert check == SteeringCheck(((10 * MS, 7.0),), 0.0, 3.0, 3.0, 10 * MS, None)


def test_steering_is_expected_straight_until_the_dead_time() -> None:
    check = check_steering(CONFIG, CAR, SteeringCheck(), 20.0, measured(0.2, 0), 0)
    check = check_steering(CONFIG, CAR, check, 20.0, measured(0.2, 10 * MS), 10 * MS)
    assert (check.slow_deg, check.fast_deg) == (0.0, 0.0)


@pytest.mark.parametrize("dead_s", [0.05, 2.0])
def test_a_request_acts_exactly_after_the_dead_time(dead_s: float) -> None:
    car = replace(CAR, steer_dead_time_s=dead_s)
    dead_ns = round(dead_s * 1000) * MS
    begun = SteeringCheck(((0, 3.0), (10 * MS, 5.0), (20 * MS, 9.0)), 1.0, 1.0, 1.0, 0)
    for now_ns, target_deg, left in (
        (dead_ns - 1, 1.0, 3),
        (dead_ns, 3.0, 2),
        (dead_ns + 10 * MS - 1, 3.0, 2),
        (dead_ns + 10 * MS, 5.0, 1),
        (dead_ns + 20 * MS, 9.0, 0),
    ):
        check = check_steering(CONFIG, car, begun, 9.0, measured(1.0, now_ns), now_ns)
        assert check.target_deg == target_deg
        assert check.pending[: left or None] == (begun.pending[3 - left :] or ((now_ns, 9.0),))
        assert len(check.pending) == (left or 1)


def test_only_changes_of_the_request_are_remembered() -> None:
    check = SteeringCheck()
    for n, request_deg in enumerate((1.0, 1.0, 2.0, 2.0, 1.0)):
        check = check_steering(CONFIG, CAR, check, request_deg, measured(0.0, n * CYCLE), n * CYCLE)
    assert check.pending == ((0, 1.0), (2 * CYCLE, 2.0), (4 * CYCLE, 1.0))


def test_what_was_asked_for_last_survives_a_loss_of_feedback() -> None:
    before = SteeringCheck(((0, 1.0), (10 * MS, 2.0), (20 * MS, 3.0)), 0.5, 0.0, 0.0, 20 * MS)
    assert check_steering(CONFIG, CAR, before, 3.0, None, 30 * MS).pending == ((20 * MS, 3.0),)
    assert check_steering(CONFIG, CAR, SteeringCheck(), 3.0, None, 30 * MS).pending == ()


def test_feedback_is_compared_until_it_is_100_ms_old() -> None:
    begun = SteeringCheck(((0, 0.0),), 0.0, 0.0, 0.0, 0)
    for age_ns, compared in ((100 * MS - 1, True), (100 * MS, False)):
        check = check_steering(CONFIG, CAR, begun, 0.0, measured(9.0, 500 * MS - age_ns), 500 * MS)
        assert (check.implausible_since_ns is not None) is compared


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_steering_model_spans_75_to_125_percent_of_the_rate(sign: float) -> None:
    begun = SteeringCheck(((0, sign * 90.0),), sign * 90.0, sign * 10.0, sign * 20.0, 0)
    check = check_steering(CONFIG, CAR, begun, sign * 90.0, measured(0.0, 1000 * MS), 1000 * MS)
    assert check.slow_deg == pytest.approx(sign * 40.0, abs=1e-9)
    assert check.fast_deg == pytest.approx(sign * 70.0, abs=1e-9)
    for now_ns in (0, -10 * MS):  # time that does not pass turns nothing
        still = check_steering(CONFIG, CAR, begun, sign * 90.0, measured(0.0, now_ns), now_ns)
        assert (still.slow_deg, still.fast_deg) == (sign * 10.0, sign * 20.0)


def test_at_the_margin_itself_the_steering_is_plausible() -> None:
    exact = replace(CAR, steer_backlash_rad=0.0)
    for slow_deg, fast_deg in ((1.0, 3.0), (3.0, 1.0)):
        begun = SteeringCheck(((0, 9.0),), 2.0, slow_deg, fast_deg, 10 * MS)
        for angle_deg, plausible in ((-1.001, False), (-1.0, True), (5.0, True), (5.001, False)):
            check = check_steering(CONFIG, exact, begun, 9.0, measured(angle_deg, 10 * MS), 10 * MS)
            assert (check.implausible_since_ns is None) is plausible


# ---------------------------------------------------------------- wheels

T = 5_000 * MS
COASTING = AiCommand(rear_motor_speed_max_rpm=4000)
DRIVING = AiCommand(rear_torque_nm=50.0, rear_motor_speed_max_rpm=4000)
BRAKING = AiCommand(front_brake_pct=50.0, rear_brake_pct=50.0)
DRAGGING = AiCommand(rear_torque_nm=50.0, rear_motor_speed_max_rpm=500)


FRONT_DRIVEN = replace(CAR, driven_front=True, driven_rear=False)
STRICT = BridgeConfig(wheel_margin_rpm=0.0, wheel_margin_fraction=0.0)
NAMES = ("front left", "front right", "rear left", "rear right")
Four = tuple[int, int, int, int]


def odd(
    asked: AiCommand,
    rpm: Sequence[int],
    steer_deg: float | None = 0.0,
    car: VehicleParameters = CAR,
    config: BridgeConfig = CONFIG,
) -> str:
    """What is said of one look at wheels that were plausible before. steer_deg None: nothing is known of it."""
    steer = None if steer_deg is None else VcuSteer(steer_deg, 30, 0, T)
    check = check_wheels(config, car, WheelCheck(), asked, WheelSpeeds(*rpm, t_rx_ns=T), steer, T)
    assert (check.implausible_since_ns == T) is bool(check.detail)
    return check.detail


def motor(axle: str, limit_rpm: int, torque_nm: float = 50.0) -> AiCommand:
    return AiCommand(**{f"{axle}_torque_nm": torque_nm, f"{axle}_motor_speed_max_rpm": limit_rpm})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("asked", "rpm", "named"),
    [
        (COASTING, (500, 500, 500, 500), ""),
        (COASTING, (0, 0, 0, 0), ""),
        (COASTING, (710, 500, 500, 500), ""),  # the margin is 60 rpm and 30 %
        (COASTING, (711, 500, 500, 500), "front left 711 rpm of 711, 500, 500, 500"),
        (COASTING, (290, 500, 500, 500), ""),
        (COASTING, (289, 500, 500, 500), "front left 289 rpm"),
        (COASTING, (400, 500, 700, 700), "front left 400 rpm"),  # of the middle of the other three
        (COASTING, (300, 300, 420, 700), "rear right 700 rpm"),
        (COASTING, (300, 420, 420, 700), "rear right 700 rpm"),
        (motor("rear", 1049), (300, 300, 50, 300), ""),  # 300 rpm of the wheel are 1050 of the motor
        (motor("rear", 1050), (300, 300, 50, 300), "rear left 50 rpm"),
        (motor("rear", 1049, 0.0), (300, 300, 50, 300), "rear left 50 rpm"),
        (motor("rear", 1050, 0.0), (300, 300, 50, 300), "rear left 50 rpm"),
    ],
)
def test_a_wheel_far_from_the_middle_of_the_others_is_named(asked: AiCommand, rpm: Four, named: str) -> None:
    assert odd(asked, rpm).startswith(named) and bool(odd(asked, rpm)) is bool(named)


@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize(("front", "rear"), [(True, False), (False, True), (True, True)])
def test_brake_and_torque_explain_slip_of_the_wheels_they_act_on(wheel: int, front: bool, rear: bool) -> None:
    car = replace(CAR, driven_front=front, driven_rear=rear)
    driven = front if wheel < 2 else rear
    for asked, rpm, explained in (
        (COASTING, 0, False),
        (COASTING, 1250, False),
        (BRAKING, 0, True),
        (BRAKING, 1200, False),
        (DRIVING, 900, driven),
        (DRIVING, 0, False),
        (DRAGGING, 50, driven),
    ):
        speeds = [300] * 4
        speeds[wheel] = rpm
        named = odd(asked, speeds, car=car)
        assert named == "" if explained else named.startswith(f"{NAMES[wheel]} {rpm} rpm of ")


@pytest.mark.parametrize(
    ("asked", "rpm", "explained"),
    [(DRIVING, 301, True), (BRAKING, 301, False), (DRIVING, 299, False), (BRAKING, 299, True)],
)
def test_too_fast_and_too_slow_differ_at_any_margin(asked: AiCommand, rpm: int, explained: bool) -> None:
    assert (odd(asked, (300, 300, rpm, 300), config=STRICT) == "") is explained


@pytest.mark.parametrize(("limit_rpm", "held"), [(4000, False), (500, True)])
def test_the_speed_limit_of_the_driven_axle_counts(limit_rpm: int, held: bool) -> None:
    assert (odd(motor("front", limit_rpm), (50, 300, 300, 300), car=FRONT_DRIVEN) == "") is held


@pytest.mark.parametrize(
    ("steer_deg", "rpm", "named"),
    [
        (30.0, (1000, 1000, 1060, 1000), False),  # equal wheel speeds are plausible at any steering
        (30.0, (1000, 1000, 1061, 1000), True),
        (None, (500, 500, 710, 500), False),  # without feedback they are held to go straight
        (None, (500, 500, 711, 500), True),
        (None, (710, 500, 500, 500), False),
        (None, (500, 711, 500, 500), True),
    ],
)
def test_wheels_that_turn_alike_are_plausible_at_any_steering(steer_deg: float | None, rpm: Four, named: bool) -> None:
    assert bool(odd(COASTING, rpm, steer_deg)) is named


@pytest.mark.parametrize("steer_deg", [-30.0, -15.0, 15.0, 30.0])
def test_wheels_on_their_own_circles_are_plausible(steer_deg: float) -> None:
    rolling = [round(900 * factor) for factor in wheel_factors(CAR, steer_deg)]
    assert max(rolling) - min(rolling) > 60
    assert odd(COASTING, rolling, steer_deg) == ""


@pytest.mark.parametrize(
    ("asked", "rpm"),
    [(DRIVING, (300, 300, 1200, 300)), (BRAKING, (0, 300, 300, 300)), (DRAGGING, (300, 300, 50, 300))],
)
def test_slip_is_remembered_for_a_second(asked: AiCommand, rpm: tuple[int, int, int, int]) -> None:
    check = check_wheels(CONFIG, CAR, WheelCheck(), asked, WheelSpeeds(*rpm, T), None, T)
    # As often as it is asked for: what was so last counts
    check = check_wheels(CONFIG, CAR, check, asked, WheelSpeeds(*rpm, T), None, T)
    for after_ns, odd_wheel in ((1000 * MS - 1, False), (1000 * MS, True)):
        now_ns = T + after_ns
        later = check_wheels(CONFIG, CAR, check, COASTING, WheelSpeeds(*rpm, now_ns), None, now_ns)
        assert (later.implausible_since_ns is not None) is odd_wheel


@pytest.mark.parametrize("rpm", [(300, 300, 1200, 300), (0, 300, 300, 300), (300, 300, 50, 300)])
def test_at_the_first_instant_of_the_clock_nothing_explains_slip(rpm: tuple[int, int, int, int]) -> None:
    assert check_wheels(CONFIG, CAR, WheelCheck(), COASTING, WheelSpeeds(*rpm, 0), None, 0).implausible_since_ns == 0
    assert WheelCheck().detail == ""


def test_in_a_left_turn_right_and_front_wheels_go_further() -> None:
    front_left, front_right, rear_left, rear_right = wheel_factors(CAR, 20.0)
    assert rear_left < 1.0 < rear_right and front_left < front_right
    assert front_left > rear_left and front_right > rear_right
    assert wheel_factors(CAR, 0.0) == (1.0, 1.0, 1.0, 1.0)
    for beyond_deg in (45.5, 1000.0):
        assert wheel_factors(CAR, beyond_deg) == wheel_factors(CAR, 45.0) != wheel_factors(CAR, 44.5)
        assert wheel_factors(CAR, -beyond_deg) == wheel_factors(CAR, -45.0) != wheel_factors(CAR, -44.5)


@pytest.mark.parametrize("steer_deg", [-30.0, -1.0, 1.0, 20.0, 44.0])
def test_each_wheel_rolls_on_the_circle_that_ackermann_gives_it(steer_deg: float) -> None:
    """Radius by radius: the rear axle's centre turns about a point `centre` metres to its left."""
    centre = CAR.wheelbase_m / math.tan(math.radians(steer_deg))
    rear_left, rear_right = centre - CAR.track_m / 2, centre + CAR.track_m / 2
    assert wheel_factors(CAR, steer_deg) == pytest.approx(
        (
            math.hypot(rear_left, CAR.wheelbase_m) / abs(centre),
            math.hypot(rear_right, CAR.wheelbase_m) / abs(centre),
            rear_left / centre,
            rear_right / centre,
        )
    )


@pytest.mark.parametrize(("asked", "since_ns"), [(COASTING, T), (BRAKING, None)])
def test_a_wheel_odd_after_doubts_has_been_since_they_began(asked: AiCommand, since_ns: int | None) -> None:
    """Unless what is asked for explains it, before and all through the doubts."""
    fitting, odd = WheelSpeeds(500, 500, 500, 500, T), WheelSpeeds(0, 500, 500, 500, T + 200 * MS)
    doubted = check_wheels(CONFIG, CAR, WheelCheck(), asked, fitting, None, T, doubted=True)
    doubted = check_wheels(CONFIG, CAR, doubted, asked, fitting, None, T + 150 * MS, doubted=True)
    found = check_wheels(CONFIG, CAR, doubted, COASTING, odd, None, T + 200 * MS)
    assert doubted.implausible_since_ns is None, "a doubt alone is as if missing"
    assert found.implausible_since_ns == since_ns
    assert check_wheels(CONFIG, CAR, doubted, asked, fitting, None, T + 50 * MS).implausible_since_ns is None


def test_stale_speeds_do_not_change_the_start_of_an_odd_wheel() -> None:
    check = check_wheels(CONFIG, CAR, WheelCheck(), COASTING, WheelSpeeds(0, 500, 500, 500, T), None, T)
    later = check_wheels(CONFIG, CAR, check, COASTING, WheelSpeeds(0, 500, 500, 500, T), None, T + 99 * MS)
    assert later.implausible_since_ns == T
    stale = check_wheels(CONFIG, CAR, check, COASTING, WheelSpeeds(9, 9, 9, 9, T), None, T + 100 * MS)
    assert stale.implausible_since_ns == T
    assert check_wheels(CONFIG, CAR, check, COASTING, None, None, T).implausible_since_ns == T
    good = check_wheels(CONFIG, CAR, check, COASTING, WheelSpeeds(9, 9, 9, 9, T), None, T + 99 * MS)
    assert good.implausible_since_ns is None


def test_an_odd_wheel_is_not_explained_by_the_brake_it_causes() -> None:
    check = check_wheels(CONFIG, CAR, WheelCheck(), COASTING, WheelSpeeds(0, 500, 500, 500, T), None, T)
    later = check_wheels(CONFIG, CAR, check, BRAKING, WheelSpeeds(0, 400, 400, 400, T), None, T + 50 * MS)
    assert later.implausible_since_ns == T


@pytest.mark.parametrize(("asked", "rpm"), [(DRIVING, (300, 300, 1200, 300)), (DRAGGING, (300, 300, 50, 300))])
def test_an_odd_wheel_is_not_explained_by_torque_after_it(asked: AiCommand, rpm: tuple[int, int, int, int]) -> None:
    """Neither as wheelspin nor as a motor held by its speed limit; with torque before it, both would have."""
    speeds = WheelSpeeds(*rpm, t_rx_ns=T)
    assert check_wheels(CONFIG, CAR, WheelCheck(), asked, speeds, None, T).implausible_since_ns is None
    check = check_wheels(CONFIG, CAR, WheelCheck(), COASTING, speeds, None, T)
    assert check_wheels(CONFIG, CAR, check, asked, speeds, None, T + 50 * MS).implausible_since_ns == T


def test_outside_as_driving_only_slip_causes_are_kept() -> None:
    check = WheelCheck(T, "front left", 1, 2, 3, T)
    assert forget_wheels(check) == WheelCheck(None, "", 1, 2, 3)
    # So they are by wheels that are believed and fit.
    fitting = WheelSpeeds(500, 500, 500, 500, T)
    assert check_wheels(CONFIG, CAR, check, COASTING, fitting, None, T) == WheelCheck(None, "", 1, 2, 3)
    assert forget_wheels(WheelCheck()) == WheelCheck()
