"""Checks that the car does what it was asked, and that its wheels agree with one another.

Pure: each check is a state and a step, called once a cycle. Neither decides anything: they say since when something
has been implausible, and the supervisor's table says what follows after how long.
"""

from __future__ import annotations

import math
from typing import Annotated

from msgspec.structs import replace

from fsai_vcu.core.ages import CHOSEN, Ages
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.messages import AiCommand, VcuSteer, WheelSpeeds
from fsai_vcu.interface.values import Value

WHEEL_NAMES = ("front left", "front right", "rear left", "rear right")

# ---------------------------------------------------------------- steering


class SteeringCheck(Value, frozen=True):
    """A model of the steering actuator, fed with the requests that were sent.

    `pending` are requests (time, deg) that have not passed the dead time yet. Two actuators follow those that have, a
    slow and a fast one: the true steering rate was never published, and between the two every angle is plausible.
    """

    pending: tuple[tuple[int, float], ...] = ()
    target_deg: float = 0.0
    slow_deg: float | None = None  # None: begins where the steering is measured
    fast_deg: float = 0.0
    t_ns: Annotated[int, CHOSEN] = 0
    implausible_since_ns: Annotated[int | None, Ages("implausible_ns", "implausible_lost_ns")] = None


def check_steering(
    config: BridgeConfig,
    car: VehicleParameters,
    check: SteeringCheck,
    request_deg: float,
    measured: VcuSteer | None,
    now_ns: int,
) -> SteeringCheck:
    """Check one cycle in AS_DRIVING: `request_deg` is what this cycle asks for. Outside AS_DRIVING begin again."""
    if measured is None or now_ns - measured.t_rx_ns >= config.feedback_stale_ns:
        # Nothing to compare with (the supervisor names that); the model goes on from the next measurement.
        return SteeringCheck(pending=check.pending[-1:], target_deg=check.target_deg)
    dead_ns = round(car.steer_dead_time_s * 1e9)
    pending, target = check.pending, check.target_deg
    while pending and now_ns - pending[0][0] >= dead_ns:
        target = pending[0][1]
        pending = pending[1:]
    if not pending or pending[-1][1] != request_deg:
        pending = (*pending, (now_ns, request_deg))
    angle = measured.angle_deg
    if check.slow_deg is None:
        return SteeringCheck(pending, target, angle, angle, now_ns)
    step_deg = math.degrees(car.steer_rate_radps) * max(0, now_ns - check.t_ns) / 1e9
    spread_deg = config.steer_rate_spread * step_deg
    slow = _towards(check.slow_deg, target, step_deg - spread_deg)
    fast = _towards(check.fast_deg, target, step_deg + spread_deg)
    allowed_deg = math.degrees(car.steer_backlash_rad) + config.steer_margin_deg
    since = check.implausible_since_ns
    if min(slow, fast) - allowed_deg <= angle <= max(slow, fast) + allowed_deg:
        since = None
    elif since is None:
        since = now_ns
    return SteeringCheck(pending, target, slow, fast, now_ns, since)


def _towards(angle_deg: float, target_deg: float, step_deg: float) -> float:
    return max(angle_deg - step_deg, min(angle_deg + step_deg, target_deg))


# ---------------------------------------------------------------- wheels


class WheelCheck(Value, frozen=True):
    """State of the wheels' check: since when one has not fitted the others, and until when slip explains what."""

    implausible_since_ns: Annotated[int | None, Ages("implausible_ns", "implausible_lost_ns")] = None
    detail: str = ""
    spin_until_ns: Annotated[int, CHOSEN] = 0  # torque so recently explains a driven wheel that is too fast
    lock_until_ns: Annotated[int, CHOSEN] = 0  # brake so recently explains any wheel that is too slow
    drag_until_ns: Annotated[int, CHOSEN] = 0  # a motor at its speed limit explains a driven wheel that is too slow
    doubted_since_ns: Annotated[int | None, CHOSEN] = None  # no reading has been believed since


def wheel_factors(car: VehicleParameters, steer_deg: float) -> tuple[float, float, float, float]:
    """Return how fast each wheel rolls on its own circle, relative to the rear axle's centre (FL, FR, RL, RR)."""
    curvature = math.tan(math.radians(max(-45.0, min(45.0, steer_deg)))) / car.wheelbase_m
    left, right = 1.0 - curvature * 0.5 * car.track_m, 1.0 + curvature * 0.5 * car.track_m
    reach = curvature * car.wheelbase_m
    return math.hypot(left, reach), math.hypot(right, reach), left, right


def check_wheels(
    config: BridgeConfig,
    car: VehicleParameters,
    check: WheelCheck,
    asked: AiCommand,
    speeds: WheelSpeeds | None,
    steer: VcuSteer | None,
    now_ns: int,
    *,
    doubted: bool = False,
) -> WheelCheck:
    """Check one cycle in AS_DRIVING: `asked` is the command that this cycle sends.

    doubted: the newest frame of 0x525 was not believed. A wheel that is believed again and does not fit has not fitted
    since then.
    """
    # A request made once a wheel is odd (the stop that follows from it brakes) does not explain it afterwards.
    explains = check.implausible_since_ns is None
    until = now_ns + config.slip_memory_ns
    spin_until = until if explains and asked.torque_requested else check.spin_until_ns
    lock_until = until if explains and asked.brake_requested else check.lock_until_ns
    drag_until = check.drag_until_ns
    since, detail, doubted_since = check.implausible_since_ns, check.detail, check.doubted_since_ns
    if doubted:
        doubted_since = now_ns if doubted_since is None else doubted_since
    elif speeds is not None and now_ns - speeds.t_rx_ns < config.feedback_stale_ns:
        rpm = speeds.all_rpm
        limit_rpm = max(asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm)
        if explains and asked.torque_requested and max(rpm) * car.gear_ratio > limit_rpm:
            drag_until = until
        wheel = None
        if max(rpm) - min(rpm) > config.wheel_margin_rpm:  # wheels that turn alike are never odd
            wheel = _odd_wheel(
                config,
                car,
                rpm,
                0.0 if steer is None else steer.angle_deg,
                spins=now_ns < spin_until,
                locks=now_ns < lock_until,
                drags=now_ns < drag_until,
            )
        if wheel is None:
            since, detail = None, ""
        else:
            since = next(each for each in (since, doubted_since, now_ns) if each is not None)
            detail = f"{WHEEL_NAMES[wheel]} {rpm[wheel]} rpm of {rpm[0]}, {rpm[1]}, {rpm[2]}, {rpm[3]}"
        doubted_since = None
    return WheelCheck(since, detail, spin_until, lock_until, drag_until, doubted_since)


def _odd_wheel(
    config: BridgeConfig,
    car: VehicleParameters,
    rpm: tuple[int, int, int, int],
    steer_deg: float,
    *,
    spins: bool,
    locks: bool,
    drags: bool,
) -> int | None:
    """The wheel that is farther from the others than wheelspin or locking explain; None if there is none."""
    driven = (car.driven_front, car.driven_front, car.driven_rear, car.driven_rear)
    factors = wheel_factors(car, steer_deg)
    rolling = [value / factor for value, factor in zip(rpm, factors, strict=True)]
    for wheel in range(4):
        others = sorted(rolling[:wheel] + rolling[wheel + 1 :])
        middle = others[1]
        if abs(rolling[wheel] - middle) <= config.wheel_margin_rpm + config.wheel_margin_fraction * middle:
            continue
        fast = rolling[wheel] > middle
        explained = (spins and driven[wheel]) if fast else (locks or (drags and driven[wheel]))
        if not explained:
            return wheel
    return None


NEW_STEERING = SteeringCheck()
"""Outside AS_DRIVING the car ignores steering requests: the model begins again."""


def forget_wheels(check: WheelCheck) -> WheelCheck:
    """Begin the wheels' check again; what explains slip is remembered."""
    return replace(check, implausible_since_ns=None, detail="", doubted_since_ns=None)
