"""Static inspections A and B: the wheels are in the air, so only the wheels' own speeds say anything.

A: steering sweep, driven wheels to a speed, hold it, to rest, finished. B: driven wheels to a speed, then the emergency
brake. The phases are a table of what follows what.
"""

from __future__ import annotations

from enum import Enum

from msgspec.structs import replace

from fsai_vcu.core.missions.request import CarView, MissionRequest
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.steering_sweep import NOT_BEGUN, SweepState, advance_sweep
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.values import Value

# In the air a few newton metres spin the wheels: proportional and integral throttle, and never much of it.
SPIN_GAIN = 0.06  # throttle per relative error
SPIN_INTEGRAL_GAIN = 0.03  # throttle per second and relative error
SPIN_THROTTLE_MAX = 0.25
SPIN_MARGIN = 1.05  # aim a little higher than asked for
SPIN_LIMIT = 1.15  # the motors' own speed limit, over the speed asked for
REST_BRAKE = 0.3


class InspectionPhase(Enum):
    """Phase of an inspection."""

    SWEEP = "sweep"
    SPIN_UP = "spin up"
    HOLD = "hold"
    REST = "rest"
    EMERGENCY_BRAKE = "emergency brake"


class Inspection(Value, frozen=True):
    """One of the two inspections: its phases in order, the speed and for how long it is held."""

    phases: tuple[InspectionPhase, ...]
    rpm: float
    hold_s: float


class InspectionState(Value, frozen=True):
    """State of an inspection: the phase under way (`index`), since when, and the speed control's integral."""

    index: int = 0
    since_ns: int | None = None  # when the phase began
    t_ns: int | None = None
    sweep: SweepState = NOT_BEGUN
    integral: float = 0.0


def inspection_of(mission: Ami, settings: MissionSettings) -> Inspection:
    sweep, spin_up, hold, rest, brake = InspectionPhase
    if mission is Ami.STATIC_INSPECTION_A:
        return Inspection((sweep, spin_up, hold, rest), settings.inspection_a_rpm, settings.inspection_a_hold_s)
    return Inspection((spin_up, hold, brake), settings.inspection_b_rpm, settings.inspection_b_hold_s)


def driven_rpm(car: VehicleParameters, wheel_rpm: tuple[float, float, float, float]) -> float:
    """Speed of the slowest driven wheel; of a much faster one where an open differential leaves one behind."""
    driven = (wheel_rpm[:2] if car.driven_front else ()) + (wheel_rpm[2:] if car.driven_rear else ())
    return max(min(driven), 0.75 * max(driven))


def advance_inspection(
    inspection: Inspection,
    state: InspectionState,
    view: CarView,
    car: VehicleParameters,
    full_steer_rad: float,
    settings: MissionSettings,
    max_speed_mps: float,
) -> tuple[InspectionState, MissionRequest]:
    """The inspection at `view.now_ns`, and what it asks for."""
    since_ns = view.now_ns if state.since_ns is None else state.since_ns
    dt_s = 0.0 if state.t_ns is None else min(max(0, view.now_ns - state.t_ns) / 1e9, 0.1)
    state = replace(state, since_ns=since_ns, t_ns=view.now_ns)
    phase = inspection.phases[state.index]
    in_phase_s = (view.now_ns - since_ns) / 1e9

    if phase is InspectionPhase.SWEEP:
        sweep = advance_sweep(state.sweep, view, full_steer_rad, settings)
        state = replace(state, sweep=sweep)
        return (_next(state, view) if sweep.done else state), MissionRequest(steering_rad=sweep.angle_rad)
    if phase is InspectionPhase.REST:
        return state, MissionRequest(brake=REST_BRAKE, finished=True)
    if phase is InspectionPhase.EMERGENCY_BRAKE:
        return state, MissionRequest(estop=True)

    rpm = driven_rpm(car, view.wheel_rpm)
    aim_rpm = min(SPIN_MARGIN * inspection.rpm, car.wheel_rpm_of_speed(max_speed_mps))
    error = (aim_rpm - rpm) / inspection.rpm
    integral = min(max(state.integral + SPIN_INTEGRAL_GAIN * error * dt_s, 0.0), SPIN_THROTTLE_MAX)
    state = replace(state, integral=integral)
    request = MissionRequest(
        throttle=min(max(SPIN_GAIN * error + integral, 0.0), SPIN_THROTTLE_MAX),
        speed_limit_mps=min(car.speed_of_wheel_rpm(SPIN_LIMIT * inspection.rpm), max_speed_mps),
    )
    reached = rpm >= inspection.rpm
    if phase is InspectionPhase.SPIN_UP and (reached or in_phase_s >= settings.inspection_a_spin_up_s):
        return _next(state, view), request
    if phase is InspectionPhase.HOLD and in_phase_s >= inspection.hold_s:
        return _next(state, view), request
    return state, request


def _next(state: InspectionState, view: CarView) -> InspectionState:
    return replace(state, index=state.index + 1, since_ns=view.now_ns)
