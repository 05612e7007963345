"""Dead reckoning from what the car reports: wheel speeds, steering and, while it is fresh, the yaw-rate sensor.

Pure: state in, state out (`standing_start`, `advance`, `begin_run`). Positions are those of the rear axle's centre in
the odometry frame. They drift: over more than some tens of metres they must be corrected by what is seen.

The instant of a motion is that of the wheel speeds behind it: where the car says nothing, nothing goes on. How sure it
is follows from the driven path, as a random walk (`OdometrySettings`): over `ds` metres the heading's variance grows by
yaw_sd^2 ds, the position's by (share^2 + heading's variance) error_length ds. What may have been driven and turned
while wheel speeds were missing for longer than they are fresh is added whole.
"""

from __future__ import annotations

import math
from collections import deque

from msgspec.structs import replace

from fsai_vcu.core.driving import Motion
from fsai_vcu.core.vehicle.parameters import GRAVITY_MPS2, SLIP_RADPMPS2, VehicleParameters
from fsai_vcu.interface.messages import GpsImu, VcuBrake, VehicleState, WheelCounts, WheelSpeeds
from fsai_vcu.interface.units import S
from fsai_vcu.interface.values import Value


class OdometrySettings(Value, frozen=True):
    """Times in ns, the rest in SI units unless the name says otherwise."""

    fresh_ns: int = 100_000_000  # an older message is not believed: ten cycles of the bus
    longest_step_ns: int = 500_000_000  # a longer silence of the wheel speeds is not bridged
    resting_rpm: int = 12  # a reading may rest at 9 rpm after the car has stopped …
    resting_ns: int = 500_000_000  # … so without one wheel pulse for this long the car stands
    braking_pct: float = 1.0  # pressure from which on a wheel may turn slower than the road
    yaw_rate_disagreement_radps: float = 0.15  # five times what a sound sensor differs from steering and wheels
    bias_gain: float = 0.02  # of the yaw-rate sensor's bias, per reading at rest
    bias_max_radps: float = 0.05

    # Certainty of the motion: standard deviations, or what they are made of.
    position_sd_share: float = 0.02  # of the driven path: the rolling radius under load is 0.251 … 0.258 m, and slip
    yaw_sd_radpsqrtm: float = 0.005  # of the heading after one metre: the sensor's bias, or the steering's backlash
    error_length_m: float = 10.0  # an error keeps its sign for about so long
    speed_sd_mps: float = 0.03  # 1 rpm, the resolution of a wheel speed …
    speed_sd_share: float = 0.02  # … and of the speed, as for the way
    yaw_rate_sd_radps: float = 0.03  # of the sensor
    curvature_sd_1pm: float = 0.01  # of the steering angle: 0.9 deg of backlash on a wheelbase of 1.53 m
    missing_yaw_rate_radps: float = 0.5  # a moving car may have turned so fast while it was not received


SETTINGS = OdometrySettings()


class OdometryState(Value, frozen=True):
    """Everything that dead reckoning remembers."""

    motion: Motion
    counts: WheelCounts | None = None  # the last ones that differed
    counts_changed_ns: int = 0
    yaw_rate_bias_radps: float = 0.0
    bias_t_rx_ns: int = -1  # the sensor's reading that the bias was last learnt from
    curvature_1pm: float = 0.0  # of the last steering angle believed


def standing_start(now_ns: int) -> OdometryState:
    """The state at a run's beginning: at the origin, at rest."""
    return OdometryState(motion=Motion(t_ns=now_ns), counts_changed_ns=now_ns)


def begin_run(state: OdometryState, now_ns: int) -> OdometryState:
    """The car's pose is the origin from now on. What was learnt of the sensor stays."""
    return replace(
        standing_start(now_ns), yaw_rate_bias_radps=state.yaw_rate_bias_radps, bias_t_rx_ns=state.bias_t_rx_ns
    )


def _fresh(t_rx_ns: int, now_ns: int) -> bool:
    return now_ns - t_rx_ns <= SETTINGS.fresh_ns


def wheel_speed_mps(car: VehicleParameters, speeds: WheelSpeeds, brake: VcuBrake | None, curvature_1pm: float) -> float:
    """Speed of the rear axle's centre by the wheels.

    Each wheel runs on its own circle; brought back to the rear axle's centre all four say the same unless they slip.
    While braking a wheel can only be too slow, so the faster axle is right. Otherwise an axle without a motor is right,
    and where both are driven the middle two wheels are.
    """
    half_track = 0.5 * car.track_m
    inner, outer = 1.0 - curvature_1pm * half_track, 1.0 + curvature_1pm * half_track
    reach = curvature_1pm * car.wheelbase_m
    road = [car.speed_of_wheel_rpm(rpm) for rpm in speeds.all_rpm]
    fl, fr = road[0] / math.hypot(inner, reach), road[1] / math.hypot(outer, reach)
    rl, rr = road[2] / inner, road[3] / outer
    front, rear = 0.5 * (fl + fr), 0.5 * (rl + rr)
    braking = (
        brake is not None
        and _fresh(brake.t_rx_ns, speeds.t_rx_ns)
        and max(brake.front_pct, brake.rear_pct) >= SETTINGS.braking_pct
    )
    if braking:
        return max(front, rear)
    if not car.driven_front:
        return front
    if not car.driven_rear:
        return rear
    ordered = sorted((fl, fr, rl, rr))
    return 0.5 * (ordered[1] + ordered[2])


def sensed_yaw_rate_radps(car: VehicleParameters, gps: GpsImu, t_ns: int) -> tuple[float, int] | None:
    """The newest reading of the yaw-rate sensor, fresh at `t_ns`, with its time, before its bias is taken off."""
    found: tuple[float, int] | None = None
    if gps.dynamics is not None:
        found = (gps.dynamics.yaw_rate_degps, gps.dynamics.t_rx_ns)
    if gps.rotation_b is not None and (found is None or gps.rotation_b.t_rx_ns >= found[1]):
        found = (gps.rotation_b.z_degps, gps.rotation_b.t_rx_ns)
    if found is None or not math.isfinite(found[0]) or not _fresh(found[1], t_ns):
        return None
    return car.yaw_rate_sign * math.radians(found[0]), found[1]


def _yaw_rates_by_wheels(car: VehicleParameters, speeds: WheelSpeeds, curvature_1pm: float) -> tuple[float, float]:
    """Yaw rates in rad/s by the left and right wheel of either axle."""
    fl, fr, rl, rr = [car.speed_of_wheel_rpm(rpm) for rpm in speeds.all_rpm]
    along = math.hypot(1.0, curvature_1pm * car.wheelbase_m)  # the front wheels roll where they are steered to
    return (fr - fl) / car.track_m * along, (rr - rl) / car.track_m


def advance(car: VehicleParameters, state: OdometryState, vehicle: VehicleState, gps: GpsImu) -> OdometryState:
    """The state when the newest wheel speeds were received. Without newer ones nothing changes."""
    before, speeds = state.motion, vehicle.speeds
    if speeds is None or speeds.t_rx_ns <= before.t_ns:
        return state
    t_ns = speeds.t_rx_ns
    step_ns = t_ns - before.t_ns
    dt_s = min(step_ns, SETTINGS.longest_step_ns) / S

    curvature = state.curvature_1pm
    steer = vehicle.steer
    if steer is not None and math.isfinite(steer.angle_deg) and _fresh(steer.t_rx_ns, t_ns):
        limit_deg = 45.0  # no car of this kind steers further: a wild value must not turn the tangent over
        curvature = math.tan(math.radians(max(-limit_deg, min(limit_deg, steer.angle_deg)))) / car.wheelbase_m

    counts, counts_changed_ns = state.counts, state.counts_changed_ns
    received = vehicle.counts
    pulses = received is not None and _fresh(received.t_rx_ns, t_ns)
    if received is not None and (
        counts is None
        or (received.fl, received.fr, received.rl, received.rr) != (counts.fl, counts.fr, counts.rl, counts.rr)
    ):
        counts, counts_changed_ns = received, t_ns

    speed = wheel_speed_mps(car, speeds, vehicle.brake, curvature)
    fastest_rpm = max(speeds.all_rpm)
    if fastest_rpm <= SETTINGS.resting_rpm:
        silent_ns = t_ns - counts_changed_ns
        if (pulses and silent_ns >= SETTINGS.resting_ns) or fastest_rpm == 0:
            speed = 0.0

    kinematic = speed * curvature
    bias, bias_t_rx_ns = state.yaw_rate_bias_radps, state.bias_t_rx_ns
    sensed = sensed_yaw_rate_radps(car, gps, t_ns)
    if sensed is not None and speed == 0.0 and sensed[1] != bias_t_rx_ns:
        bias_t_rx_ns = sensed[1]
        bias += SETTINGS.bias_gain * (sensed[0] - bias)
        bias = max(-SETTINGS.bias_max_radps, min(SETTINGS.bias_max_radps, bias))
    yaw_rate, yaw_rate_sd = kinematic, speed * SETTINGS.curvature_sd_1pm
    if speed > 0.0 and sensed is not None:
        # A sliding car turns otherwise than it is steered, and a spinning wheel otherwise than the car: what lies
        # between them, or near, can be. A sensor that drifts is found out before the car has lost its way.
        others = (kinematic, *_yaw_rates_by_wheels(car, speeds, curvature))
        margin = SETTINGS.yaw_rate_disagreement_radps
        if min(others) - margin <= sensed[0] - bias <= max(others) + margin:
            yaw_rate, yaw_rate_sd = sensed[0] - bias, SETTINGS.yaw_rate_sd_radps

    way = 0.5 * (speed + before.speed_mps) * dt_s
    middle_yaw = before.yaw_rad + 0.5 * yaw_rate * dt_s
    faster = max(speed, before.speed_mps)
    missing_s = max(0, step_ns - SETTINGS.fresh_ns) / S if faster > 0.0 else 0.0
    yaw_sd = math.sqrt(before.yaw_sd_rad**2 + SETTINGS.yaw_sd_radpsqrtm**2 * way)
    position_sd = math.sqrt(
        before.position_sd_m**2 + (SETTINGS.position_sd_share**2 + yaw_sd**2) * SETTINGS.error_length_m * way
    )
    motion = Motion(
        t_ns=t_ns,
        x_m=before.x_m + way * math.cos(middle_yaw),
        y_m=before.y_m + way * math.sin(middle_yaw),
        yaw_rad=math.remainder(before.yaw_rad + yaw_rate * dt_s, 2.0 * math.pi),
        speed_mps=speed,
        yaw_rate_radps=yaw_rate,
        distance_m=before.distance_m + way,
        position_sd_m=position_sd + faster * missing_s,
        yaw_sd_rad=yaw_sd + SETTINGS.missing_yaw_rate_radps * missing_s,
        speed_sd_mps=math.hypot(SETTINGS.speed_sd_mps, SETTINGS.speed_sd_share * speed) if speed > 0.0 else 0.0,
        yaw_rate_sd_radps=yaw_rate_sd,
    )
    return replace(
        state,
        motion=motion,
        counts=counts,
        counts_changed_ns=counts_changed_ns,
        yaw_rate_bias_radps=bias,
        bias_t_rx_ns=bias_t_rx_ns,
        curvature_1pm=curvature,
    )


CARRIED_NS = 300_000_000
"""A motion is carried on for no longer: 100 ms for which wheel speeds are fresh, and what actuators take to answer."""


def motion_at(motion: Motion, t_ns: int) -> Motion:
    """`motion` carried to another instant with speed and yaw rate held, but by no more than `CARRIED_NS`."""
    dt_s = min(max(t_ns - motion.t_ns, -CARRIED_NS), CARRIED_NS) / S
    if dt_s == 0.0:
        return motion
    way = motion.speed_mps * dt_s
    middle_yaw = motion.yaw_rad + 0.5 * motion.yaw_rate_radps * dt_s
    return replace(
        motion,
        t_ns=t_ns,
        x_m=motion.x_m + way * math.cos(middle_yaw),
        y_m=motion.y_m + way * math.sin(middle_yaw),
        yaw_rad=motion.yaw_rad + motion.yaw_rate_radps * dt_s,
        distance_m=motion.distance_m + way,
    )


def slipped(place: Motion, last: Motion, motion: Motion, slip_radpmps2: float = SLIP_RADPMPS2) -> Motion:
    """The motion where the car really is: from `place` on, where it was at `last`, as odometry went from there.

    Odometry moves the car to where it points. In a corner the rear axle moves further outward, by its slip angle: at
    9 m/s and 8 m/s2 that is 0.6 m in each second, by which cones remembered and cones seen would differ.
    """
    dx, dy = motion.x_m - last.x_m, motion.y_m - last.y_m
    # A wild reading must not throw the car further than tyres can slip.
    lateral_mps2 = min(max(motion.speed_mps * motion.yaw_rate_radps, -GRAVITY_MPS2), GRAVITY_MPS2)
    right_m = slip_radpmps2 * lateral_mps2 * (motion.distance_m - last.distance_m)
    yaw = last.yaw_rad + 0.5 * math.remainder(motion.yaw_rad - last.yaw_rad, 2.0 * math.pi)
    return replace(motion, x_m=place.x_m + dx + right_m * math.sin(yaw), y_m=place.y_m + dy - right_m * math.cos(yaw))


class MotionHistory:
    """The motions of the last moments, to know where the car was when a sensor looked."""

    def __init__(self, span_ns: int = 2 * S) -> None:
        self._span_ns = span_ns
        self._motions: deque[Motion] = deque()

    def clear(self) -> None:
        self._motions.clear()

    def add(self, motion: Motion) -> None:
        """Remember `motion`. A distance that shrinks means that odometry began again: all before is void."""
        motions = self._motions
        if motions:
            if motion.distance_m < motions[-1].distance_m - 1e-6:
                motions.clear()
            elif motion.t_ns <= motions[-1].t_ns:
                return
        motions.append(motion)
        while motion.t_ns - motions[0].t_ns > self._span_ns:
            motions.popleft()

    def at(self, t_ns: int) -> Motion | None:
        """The motion at an instant, between two remembered ones or carried on from the nearest; None when empty."""
        motions = self._motions
        if not motions:
            return None
        later = motions[-1]
        if t_ns >= later.t_ns:
            return motion_at(later, t_ns)
        for index in range(len(motions) - 2, -1, -1):
            earlier = motions[index]
            if earlier.t_ns <= t_ns:
                share = (t_ns - earlier.t_ns) / (later.t_ns - earlier.t_ns)
                turn = math.remainder(later.yaw_rad - earlier.yaw_rad, 2.0 * math.pi)
                return replace(
                    later,
                    t_ns=t_ns,
                    x_m=earlier.x_m + share * (later.x_m - earlier.x_m),
                    y_m=earlier.y_m + share * (later.y_m - earlier.y_m),
                    yaw_rad=earlier.yaw_rad + share * turn,
                    speed_mps=earlier.speed_mps + share * (later.speed_mps - earlier.speed_mps),
                    yaw_rate_radps=earlier.yaw_rate_radps + share * (later.yaw_rate_radps - earlier.yaw_rate_radps),
                    distance_m=earlier.distance_m + share * (later.distance_m - earlier.distance_m),
                )
            later = earlier
        return motion_at(later, t_ns)
