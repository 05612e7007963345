"""The command gate: the last stage before the wire, and the only place where a request becomes a value on it.

Pure: `gate` makes one cycle's command, `sent` tells it whether that cycle went out whole. What comes in is the
supervisor's `Decision` (one row of its output table: which mission status and direction, where steering and brake come
from, whether torque is let through), the command in the slot, and what the car has reported. `_wish` makes a `Request`
of them, and each of `LIMITERS` takes from it, in that order, what one safety rule forbids:

    stillness    3     neither NEUTRAL nor FINISHED in AS_DRIVING while a wheel may turn
    steering     4, 5  zero outside AS_DRIVING; the smallest of all limits, and the rate
    permission   2     torque only with everything that the gate can see of what it needs
    actuators          the brake is the hydraulic one, or the motors against a speed limit of zero
    axle_torque  4     the smallest of all limits of either axle; zero while one is not known
    interlock    1     torque and brake never meet at the VCU

The gate does not trust the supervisor: what it can see for itself it checks again, and a guard that acts gives its
reason, for it means a mistake further up. The default is zero; handshake and ESTOP_REQUEST pass through untouched.

What the interlock remembers: the VCU sees five frames one after another and keeps what it saw last, so what counts is
not what was asked for but what may still be there. A request above zero *may be there* from the moment it is tried
until a complete cycle with zero has gone out. Nothing latches here, but that torque rises from zero only once it is
released, and needs no release again until it has been back at zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

from msgspec.structs import replace

from fsai_vcu.core.ages import Ages, NoAge, NotSearched
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.supervision.config import BridgeConfig, Reason
from fsai_vcu.core.supervision.supervisor import Brake, Decision, Steer
from fsai_vcu.core.supervision.wheel_speeds import NO_PULSES, Pulses, pulses_of, pulses_per_s, turning
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.enums import AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import (
    AiCommand,
    VcuDriveFront,
    VcuDriveRear,
    VcuSteer,
    VehicleState,
    WheelCounts,
)
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.specification import AXLE_TORQUE_MAX_NM, CONSTANT_POWER_RPM_NM, MOTOR_SPEED_MAX_RPM
from fsai_vcu.interface.units import KMH_PER_MPS
from fsai_vcu.interface.values import Value

LAPS_MAX, CONES_ACTUAL_MAX, CONES_ALL_MAX, SPEED_KMH_MAX = 15, 255, 65535, 255  # widths of the fields of 0x510

_LONGEST_STEP_NS = 20_000_000  # after a longer pause the steering does not jump by what it could have turned meanwhile
_TINY = 1e-9  # so that 12.3 / 0.1 counts as 123


class GateConfig(Value, frozen=True):
    """The limits in force, each already the smallest of what revision, car, configuration and official allow."""

    bridge: BridgeConfig
    steer_limit_deg: float
    steer_rate_degps: float
    torque_limit_nm: float
    driven_front: bool
    driven_rear: bool
    motor_rpm_per_mps: float
    motor_speed_limit_rpm: int
    pulses_per_s: float


def gate_config(
    config: BridgeConfig, revision: Revision, car: VehicleParameters, limits: OperationalLimits | None = None
) -> GateConfig:
    """The gate's limits for this car on this interface revision at this venue."""
    official = limits or UNLIMITED
    rpm_per_mps = car.wheel_rpm_of_speed(1.0) * car.gear_ratio
    rate = config.steer_rate_degps
    return GateConfig(
        bridge=config,
        steer_limit_deg=min(revision.steer_limit_deg, official.max_steer_deg),
        steer_rate_degps=math.degrees(car.steer_rate_radps) if rate is None else rate,
        torque_limit_nm=min(AXLE_TORQUE_MAX_NM, car.axle_torque_max_nm, official.max_axle_torque_nm),
        driven_front=car.driven_front,
        driven_rear=car.driven_rear,
        motor_rpm_per_mps=rpm_per_mps,
        motor_speed_limit_rpm=motor_rpm(official.max_speed_mps, rpm_per_mps, MOTOR_SPEED_MAX_RPM),
        pulses_per_s=pulses_per_s(config, car),
    )


class GateState(Value, frozen=True):
    """Memory of the gate between cycles."""

    steer_deg: float = 0.0  # before rounding to the signal's 0.1 deg
    brake: float = 0.0  # fraction last asked for, for when it must be kept
    cycle_ns: Annotated[int | None, Ages()] = None  # one cycle ago, or longer: the steering's rate is no timer

    # The interlock. Before the first complete cycle the VCU may still hold what an earlier process sent.
    torque_there: bool = True
    zero_cycles: int = 0  # complete cycles with both at zero since anything above it was tried; 2 means more
    # While there is one of them: when it was sent
    zero_since_ns: Annotated[int, NoAge("it is compared with the time of one 0x524: newer or not")] = 0
    torque_running: bool = False  # torque rose properly and has not been back at zero since
    tried_torque: bool = False  # what the cycle that is out now asks for
    tried_brake: bool = False
    awaiting: bool = False  # a cycle was made and it is not reported yet whether it went out

    # Other things that the gate has seen for itself
    tried_selected: bool = False  # the cycle that is out now says SELECTED
    acknowledged_run_id: int | None = None  # the last run for which such a cycle went out whole
    pulses: Annotated[Pulses, NotSearched("a wheel turns as SupervisorState.turning_ns says")] = NO_PULSES

    # Logging
    run_id: int = 0
    laps: int = 0
    cones_actual: int = 0
    cones_all: int = 0


def motor_rpm(speed_mps: float, rpm_per_mps: float, limit_rpm: int) -> int:
    """Motor speed for a road speed, rounded down, never above `limit_rpm`."""
    return max(0, int(min(speed_mps * rpm_per_mps, limit_rpm) + _TINY))


def constant_power_nm(fastest_rpm: int) -> float:
    """The most torque an axle may be asked for while its fastest wheel turns at `fastest_rpm`."""
    for above_rpm, torque_nm in CONSTANT_POWER_RPM_NM:
        if fastest_rpm > above_rpm:
            return torque_nm
    return AXLE_TORQUE_MAX_NM


def sent(state: GateState, complete: bool, now_ns: int) -> GateState:
    """Take in whether the cycle made last went out whole; if not, it may have left anything it asked for."""
    if not state.awaiting:
        return state
    torque, brake = state.tried_torque, state.tried_brake
    if not complete:
        return replace(
            state,
            awaiting=False,
            torque_there=state.torque_there or torque,
            zero_cycles=0 if torque or brake else state.zero_cycles,
        )
    zero = not torque and not brake
    return replace(
        state,
        awaiting=False,
        torque_there=torque,
        zero_cycles=min(state.zero_cycles + 1, 2) if zero else 0,
        zero_since_ns=now_ns,
        acknowledged_run_id=state.run_id if state.tried_selected else state.acknowledged_run_id,
    )


# ---------------------------------------------------------------- one cycle


class Cycle(Value, frozen=True):
    """Facts of one cycle that every step looks at. `command` is None unless it may be turned into values."""

    config: GateConfig
    state: GateState
    decision: Decision
    command: VehicleCommand | None
    vehicle: VehicleState
    driving: bool  # the car has reported AS_DRIVING last
    now_ns: int

    def feedback_fresh(self, t_rx_ns: int) -> bool:
        return self.now_ns - t_rx_ns < self.config.bridge.feedback_stale_ns


class Request(Value, frozen=True):
    """A cycle's command in the making, and why something was taken from it."""

    mission_status: MissionStatus
    direction: Direction
    brake: float  # fraction of the most
    torque: float  # fraction of the most that is allowed
    motor_speed_max_rpm: int
    steer_deg: float = 0.0  # before rounding to the signal's 0.1 deg
    front_nm: float = 0.0
    rear_nm: float = 0.0
    brake_pct: float = 0.0
    reasons: frozenset[Reason] = frozenset()


def gate(
    config: GateConfig,
    state: GateState,
    decision: Decision,
    command: VehicleCommand | None,
    vehicle: VehicleState,
    now_ns: int,
    speed_mps: float = 0.0,
) -> tuple[GateState, AiCommand, frozenset[Reason]]:
    """Turn decision and command into what goes on the wire in this cycle. `speed_mps` is for the logging field only."""
    state = sent(state, False, now_ns)  # the cycle before, if it was not reported sent, counts as broken
    if not _obeys(config, decision, command, now_ns):
        command = None
    status = vehicle.status
    driving = status is not None and status.as_state is AsState.AS_DRIVING
    state = _log(_watch(config, state, vehicle.counts), decision, command if driving else None)
    cycle = Cycle(config, state, decision, command, vehicle, driving, now_ns)
    request = _wish(cycle)
    for limiter in LIMITERS:
        request = limiter(cycle, request)
    torque = request.front_nm > 0.0 or request.rear_nm > 0.0
    after = replace(
        state,
        steer_deg=request.steer_deg,
        brake=request.brake,
        cycle_ns=now_ns,
        torque_running=torque,
        tried_torque=torque,
        tried_brake=request.brake_pct > 0.0,
        tried_selected=request.mission_status is MissionStatus.SELECTED,
        awaiting=True,
    )
    return after, _on_the_wire(cycle, request, speed_mps), request.reasons


def _obeys(config: GateConfig, decision: Decision, command: VehicleCommand | None, now_ns: int) -> bool:
    """Return true where there is a command of this run that may be turned into values."""
    return (
        command is not None
        and command.run_id == decision.run_id
        and now_ns - command.t_sensor_ns < config.bridge.sensor_stale_ns
        and not command.problems(math.pi)
    )


def _watch(config: GateConfig, state: GateState, counts: WheelCounts | None) -> GateState:
    """The pulse counts of the newest 0x526."""
    if counts is None or counts is state.pulses.counts:
        return state
    return replace(state, pulses=pulses_of(config.pulses_per_s, state.pulses, counts))


def _log(state: GateState, decision: Decision, command: VehicleCommand | None) -> GateState:
    """The logging fields: kept until the next run while no command in AS_DRIVING has them."""
    if command is None and decision.run_id == state.run_id:
        return state
    return replace(
        state,
        run_id=decision.run_id,
        laps=0 if command is None else _saturated(command.laps, LAPS_MAX),
        cones_actual=0 if command is None else _saturated(command.cones_count_actual, CONES_ACTUAL_MAX),
        cones_all=0 if command is None else _saturated(command.cones_count_all, CONES_ALL_MAX),
    )


def _wish(cycle: Cycle) -> Request:
    """Return what decision and command ask for. A brake wins over the throttle."""
    config, decision, command = cycle.config, cycle.decision, cycle.command
    brake = _brake(cycle)
    throttle, rpm = 0.0, 0
    if decision.torque and command is not None:
        throttle = command.throttle if brake == 0.0 else 0.0
        rpm = motor_rpm(command.speed_limit_mps, config.motor_rpm_per_mps, config.motor_speed_limit_rpm)
    return Request(decision.mission_status, decision.direction, brake, throttle, rpm)


def _brake(cycle: Cycle) -> float:
    """The brake asked for, as a fraction of the most."""
    match cycle.decision.brake:
        case Brake.ZERO:
            return 0.0
        case Brake.HOLDING:
            return cycle.config.bridge.held_brake_pct / 100.0
        case Brake.SERVICE:
            return cycle.config.bridge.stop_brake_pct / 100.0
        case Brake.COMMAND if cycle.command is not None:
            return cycle.command.brake
        case _:
            return cycle.state.brake


# ---------------------------------------------------------------- the limiters


def _stillness(cycle: Cycle, request: Request) -> Request:
    """Rule 3, as far as one frame of wheel speeds tells, and 0.5 s of pulse counts: the supervisor watches both."""
    going = request.direction is Direction.FORWARD and request.mission_status is not MissionStatus.FINISHED
    if going or not cycle.driving or _still(cycle):
        return request
    return replace(
        request,
        mission_status=MissionStatus.RUNNING,
        direction=Direction.FORWARD,
        reasons=request.reasons | {Reason.STILLNESS_UNPROVEN},
    )


def _still(cycle: Cycle) -> bool:
    config, speeds, pulses = cycle.config, cycle.vehicle.speeds, cycle.state.pulses
    return (
        speeds is not None
        and cycle.feedback_fresh(speeds.t_rx_ns)
        and max(speeds.all_rpm) < config.bridge.standstill_rpm
        and not turning(config.bridge.standstill_ns, pulses.turning_ns, cycle.now_ns)
    )


def _steering(cycle: Cycle, request: Request) -> Request:
    """Rules 4 and 5: in AS_DRIVING only, within all limits, and no faster than the rate."""
    config, state, decision, command = cycle.config, cycle.state, cycle.decision, cycle.command
    if not cycle.driving or decision.steer is Steer.ZERO:
        return request
    limit_deg = min(config.steer_limit_deg, _live_limit_deg(cycle.vehicle.steer))
    wanted_deg, reasons = state.steer_deg, request.reasons
    if decision.steer is Steer.COMMAND and command is not None:
        wanted_deg = math.degrees(command.steering_rad)
        if abs(wanted_deg) > limit_deg + 0.05:  # the signal's own resolution, or half of it, is nobody's fault
            reasons |= {Reason.STEER_CLAMPED}
    step_ns = 0 if state.cycle_ns is None else max(0, min(cycle.now_ns - state.cycle_ns, _LONGEST_STEP_NS))
    most_deg = config.steer_rate_degps * step_ns / 1e9
    turned_deg = max(state.steer_deg - most_deg, min(state.steer_deg + most_deg, wanted_deg))
    # The limit comes after the rate: a limit that the car lowers is obeyed at once, however far that is.
    return replace(request, steer_deg=max(-limit_deg, min(limit_deg, turned_deg)), reasons=reasons)


def _live_limit_deg(steer: VcuSteer | None) -> float:
    """The car's own ANGLE_MAX."""
    return 0.0 if steer is None else max(0.0, steer.angle_max_deg)


def _permission(cycle: Cycle, request: Request) -> Request:
    """Rule 2, as far as the gate sees it itself."""
    decision, status = cycle.decision, cycle.vehicle.status
    go = status is not None and status.go_signal
    acknowledged = cycle.state.acknowledged_run_id == decision.run_id
    if request.torque <= 0.0 or (_motors_allowed(cycle, request) and go and acknowledged and decision.may_move):
        return request
    return replace(request, torque=0.0, reasons=request.reasons | {Reason.TORQUE_BLOCKED})


def _motors_allowed(cycle: Cycle, request: Request) -> bool:
    """Return true where the motors may be asked for torque, to drive or to brake."""
    status = cycle.vehicle.status
    fresh = status is not None and cycle.now_ns - status.t_rx_ns < cycle.config.bridge.vcu_stale_ns
    return (
        cycle.driving
        and fresh
        and cycle.vehicle.status_known
        and request.direction is Direction.FORWARD
        and not cycle.decision.estop
    )


def _actuators(cycle: Cycle, request: Request) -> Request:
    """Choose the actuator that brakes."""
    if request.brake <= 0.0:
        return request
    if cycle.config.bridge.motor_brakes:
        # No hydraulic request ever: torque against a motor speed limit of zero brakes (the exception to rule 2).
        share = request.brake if _motors_allowed(cycle, request) else 0.0
        return replace(request, torque=share, motor_speed_max_rpm=0)
    return replace(request, brake_pct=math.floor(request.brake * 200.0 + 0.5) / 2.0)  # the signal's 0.5 %


def _axle_torque(cycle: Cycle, request: Request) -> Request:
    """Rule 4: either axle's share of the most that it is allowed now."""
    config, vehicle, speeds = cycle.config, cycle.vehicle, cycle.vehicle.speeds
    # Without wheel speeds there is no constant-power limit: the supervisor names it.
    if request.torque <= 0.0 or speeds is None or not cycle.feedback_fresh(speeds.t_rx_ns):
        return request
    front: float | None = 0.0
    rear: float | None = 0.0
    if config.driven_front:
        front = _axle_limit_nm(config, vehicle.drive_front, speeds.fl_rpm, speeds.fr_rpm, cycle.now_ns)
    if config.driven_rear:
        rear = _axle_limit_nm(config, vehicle.drive_rear, speeds.rl_rpm, speeds.rr_rpm, cycle.now_ns)
    unknown = front is None or rear is None
    return replace(
        request,
        front_nm=_share_nm(front, request.torque),
        rear_nm=_share_nm(rear, request.torque),
        reasons=request.reasons | {Reason.TORQUE_LIMIT_UNKNOWN} if unknown else request.reasons,
    )


def _axle_limit_nm(
    config: GateConfig,
    axle: VcuDriveFront | VcuDriveRear | None,
    left_rpm: int,
    right_rpm: int,
    now_ns: int,
) -> float | None:
    """The most torque this axle may be asked for now; None when the car's own limit is not known."""
    if axle is None or now_ns - axle.t_rx_ns >= config.bridge.feedback_stale_ns:
        return None
    return min(config.torque_limit_nm, max(0.0, axle.torque_max_nm), constant_power_nm(max(left_rpm, right_rpm)))


def _share_nm(limit_nm: float | None, share: float) -> float:
    return 0.0 if limit_nm is None else math.floor(limit_nm * share * 10.0 + _TINY) / 10.0  # the signal's 0.1 Nm


def _interlock(cycle: Cycle, request: Request) -> Request:
    """Rule 1: no brake while torque may be there, and no torque before it is released."""
    state = cycle.state
    if state.torque_there:
        request = replace(request, brake_pct=0.0)
    if not (state.torque_running or _released(state, cycle.vehicle)):
        request = replace(request, front_nm=0.0, rear_nm=0.0)
    return request


def _released(state: GateState, vehicle: VehicleState) -> bool:
    """Torque may rise from zero: a complete zero cycle that 0x524 has echoed, or two of them (safety rule 1)."""
    if state.zero_cycles > 1:
        return True
    echo = vehicle.brake
    return (
        state.zero_cycles == 1
        and echo is not None
        and echo.t_rx_ns > state.zero_since_ns
        and echo.front_request_pct == 0.0
        and echo.rear_request_pct == 0.0
    )


LIMITERS: tuple[Callable[[Cycle, Request], Request], ...] = (
    _stillness,
    _steering,
    _permission,
    _actuators,
    _axle_torque,
    _interlock,
)

# ---------------------------------------------------------------- values


def _on_the_wire(cycle: Cycle, request: Request, speed_mps: float) -> AiCommand:
    """The request in the signals' own resolution."""
    config, state, command, decision = cycle.config, cycle.state, cycle.command, cycle.decision
    steer_deg, rpm = request.steer_deg, request.motor_speed_max_rpm
    demand_mps = command.speed_limit_mps if command is not None and decision.torque else 0.0
    return AiCommand(
        handshake=cycle.vehicle.handshake,
        estop_request=decision.estop,
        mission_status=request.mission_status,
        direction=request.direction,
        steer_deg=math.trunc(steer_deg * 10.0 + math.copysign(_TINY, steer_deg)) / 10.0,
        front_torque_nm=request.front_nm,
        rear_torque_nm=request.rear_nm,
        front_motor_speed_max_rpm=rpm if config.driven_front else 0,
        rear_motor_speed_max_rpm=rpm if config.driven_rear else 0,
        front_brake_pct=request.brake_pct,
        rear_brake_pct=request.brake_pct,
        lap_counter=state.laps,
        cones_count_actual=state.cones_actual,
        cones_count_all=state.cones_all,
        speed_actual_kmh=_saturated(speed_mps * KMH_PER_MPS, SPEED_KMH_MAX),
        speed_demand_kmh=_saturated(demand_mps * KMH_PER_MPS, SPEED_KMH_MAX),
    )


def _saturated(value: float, most: int) -> int:
    """A logging field within its width: saturated, never refused, 0 for what is no number."""
    if math.isnan(value):
        return 0
    return int(max(0, min(most, value)))
