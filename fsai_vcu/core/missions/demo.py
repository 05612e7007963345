"""The autonomous demo: steering left, right, straight at rest; accelerate, stop, accelerate, emergency brake."""

from __future__ import annotations

import math
from enum import Enum
from itertools import pairwise

from msgspec.structs import replace

from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.request import CarView, MissionRequest
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.steering_sweep import NOT_BEGUN, SweepState, advance_sweep
from fsai_vcu.interface.values import Value

STOP_BRAKE = 0.5  # half of full braking: from 5 m/s in some 4 m with the dead time
REST_BRAKE = 0.2
LENGTH_SHARE = 0.92  # of the length allowed to accelerate in: the rest is for the odometry's error
YAW_GAIN = 1.0  # steering per angle off the straight line
LATERAL_GAIN_1PM = 0.25
STEER_MAX_RAD = math.radians(8.0)


ORIGIN = Motion()


class DemoPhase(Enum):
    """Phases of the demo, in their order."""

    SWEEP = "sweep"
    ACCELERATE = "accelerate"
    STOP = "stop"
    PAUSE = "pause"
    ACCELERATE_AGAIN = "accelerate again"
    EMERGENCY_BRAKE = "emergency brake"


NEXT = dict(pairwise(DemoPhase))


class DemoState(Value, frozen=True):
    """State of the demo: its phase, and what that phase began with."""

    phase: DemoPhase = DemoPhase.SWEEP
    since_ns: int = 0
    distance_m: float = 0.0  # driven when the phase began
    line: Motion = ORIGIN  # the straight line: from here, along this yaw
    sweep: SweepState = NOT_BEGUN


def advance_demo(
    state: DemoState, view: CarView, full_steer_rad: float, settings: MissionSettings, max_speed_mps: float
) -> tuple[DemoState, MissionRequest]:
    """The demo at `view.now_ns`, and what it asks for."""
    motion = view.motion
    if state.phase is DemoPhase.SWEEP:
        sweep = advance_sweep(state.sweep, view, full_steer_rad, settings)
        state = replace(state, sweep=sweep, line=motion)
        return (_next(state, view) if sweep.done else state), MissionRequest(sweep.angle_rad, brake=REST_BRAKE)
    steering = _straight_on(state.line, motion)
    if state.phase is DemoPhase.EMERGENCY_BRAKE:
        return state, MissionRequest(steering, estop=True)
    if state.phase in (DemoPhase.ACCELERATE, DemoPhase.ACCELERATE_AGAIN):
        target = min(settings.demo_speed_mps + settings.demo_margin_mps, max_speed_mps)
        driven = motion.distance_m - state.distance_m
        if motion.speed_mps >= target or driven >= LENGTH_SHARE * settings.demo_length_m:
            return _next(state, view), MissionRequest(steering)
        return state, MissionRequest(steering, throttle=1.0, speed_limit_mps=min(target + 1.5, max_speed_mps))
    if state.phase is DemoPhase.STOP:
        stands = view.standing or motion.speed_mps < 0.05
        return (_next(state, view) if stands else state), MissionRequest(steering, brake=STOP_BRAKE)
    if view.now_ns - state.since_ns >= settings.demo_pause_s * 1e9:
        return _next(state, view), MissionRequest(steering)
    return state, MissionRequest(steering, brake=REST_BRAKE)


def _next(state: DemoState, view: CarView) -> DemoState:
    return replace(state, phase=NEXT[state.phase], since_ns=view.now_ns, distance_m=view.motion.distance_m)


def _straight_on(line: Motion, motion: Motion) -> float:
    """Steering that brings the car back to the line on which it started."""
    yaw = math.remainder(motion.yaw_rad - line.yaw_rad, 2.0 * math.pi)
    dx, dy = motion.x_m - line.x_m, motion.y_m - line.y_m
    left = math.cos(line.yaw_rad) * dy - math.sin(line.yaw_rad) * dx
    return min(max(-YAW_GAIN * yaw - LATERAL_GAIN_1PM * left, -STEER_MAX_RAD), STEER_MAX_RAD)
