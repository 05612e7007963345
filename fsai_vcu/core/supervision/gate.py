"""The command gate: the last stage before the wire, and the only place where a request becomes a value on it.

Pure: `gate` makes one cycle's command, `sent` tells it whether that cycle went out whole. Whatever the supervisor has
let through, the gate checks again what it can see for itself (safety rules 1 to 5); the default is zero.

Torque and brake (rule 1): the VCU sees five frames one after another and keeps what it saw last, so what counts is not
what was asked for but what may still be there. A request above zero *may be there* from the moment it is tried until a
complete cycle with zero has gone out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.supervisor import Brake, Decision, Steer
from fsai_vcu.core.supervision.wheel_speeds import NO_PULSES, Pulses, pulses_of, pulses_per_s, turning
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.enums import AsState, Direction, MissionStatus
from fsai_vcu.interface.immutable import Immutable
from fsai_vcu.interface.messages import AiCommand, VcuDriveFront, VcuDriveRear, VehicleState, WheelSpeeds
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.specification import AXLE_TORQUE_MAX_NM, CONSTANT_POWER_RPM_NM, MOTOR_SPEED_MAX_RPM
from fsai_vcu.interface.units import KMH_PER_MPS

LAPS_MAX, CONES_ACTUAL_MAX, CONES_ALL_MAX, SPEED_KMH_MAX = 15, 255, 65535, 255  # widths of the fields of 0x510

_LONGEST_STEP_NS = 20_000_000  # after a longer pause the steering does not jump by what it could have turned meanwhile
_TINY = 1e-9  # so that 12.3 / 0.1 counts as 123


@dataclass(frozen=True, slots=True)
class GateConfig(Immutable):
    """The limits in force, each already the smallest of what revision, car, configuration and official allow."""

    steer_limit_deg: float
    steer_rate_degps: float
    torque_limit_nm: float
    driven_front: bool
    driven_rear: bool
    motor_rpm_per_mps: float
    motor_speed_limit_rpm: int
    holding_brake_pct: float
    stop_brake_pct: float
    motor_brakes: bool
    standstill_rpm: int
    standstill_ns: int
    pulses_per_s: float
    sensor_stale_ns: int
    vcu_stale_ns: int
    feedback_stale_ns: int


def gate_config(
    config: BridgeConfig, revision: Revision, car: VehicleParameters, limits: OperationalLimits | None = None
) -> GateConfig:
    """The gate's limits for this car on this interface revision at this venue."""
    official = limits or UNLIMITED
    rpm_per_mps = car.wheel_rpm_of_speed(1.0) * car.gear_ratio
    rate = config.steer_rate_degps
    return GateConfig(
        steer_limit_deg=min(revision.steer_limit_deg, official.max_steer_deg),
        steer_rate_degps=math.degrees(car.steer_rate_radps) if rate is None else rate,
        torque_limit_nm=min(AXLE_TORQUE_MAX_NM, car.axle_torque_max_nm, official.max_axle_torque_nm),
        driven_front=car.driven_front,
        driven_rear=car.driven_rear,
        motor_rpm_per_mps=rpm_per_mps,
        motor_speed_limit_rpm=motor_rpm(official.max_speed_mps, rpm_per_mps, MOTOR_SPEED_MAX_RPM),
        holding_brake_pct=config.held_brake_pct,
        stop_brake_pct=config.stop_brake_pct,
        motor_brakes=config.motor_brakes,
        standstill_rpm=config.standstill_rpm,
        standstill_ns=config.standstill_ns,
        pulses_per_s=pulses_per_s(config, car),
        sensor_stale_ns=config.sensor_stale_ns,
        vcu_stale_ns=config.vcu_stale_ns,
        feedback_stale_ns=config.feedback_stale_ns,
    )


@dataclass(frozen=True, slots=True)
class GateState(Immutable):
    """What the gate remembers between cycles."""

    steer_deg: float = 0.0  # before rounding to the signal's 0.1 deg
    brake: float = 0.0  # fraction last asked for, for when it must be kept
    cycle_ns: int | None = None

    # The interlock. Before the first complete cycle the VCU may still hold what an earlier process said.
    torque_there: bool = True
    zero_cycles: int = 0  # complete cycles with both at zero since anything above it was tried; 2 means more
    zero_since_ns: int = 0  # while there is one of them: when it was sent
    torque_running: bool = False  # torque rose properly and has not been back at zero since
    tried_torque: bool = False  # what the cycle that is out now asks for
    tried_brake: bool = False
    awaiting: bool = False  # a cycle was made and nobody has said yet whether it went out

    # What else it has seen for itself
    tried_selected: bool = False  # the cycle that is out now says SELECTED
    acknowledged_run_id: int | None = None  # the last run for which such a cycle went out whole
    pulses: Pulses = NO_PULSES

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
    """The cycle made last went out: whole or not. One that did not go out whole may have left anything it asked for."""
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


def _steering(
    config: GateConfig,
    state: GateState,
    decision: Decision,
    command: VehicleCommand | None,
    vehicle: VehicleState,
    now_ns: int,
) -> tuple[float, bool]:
    """The steering request before rounding, and whether more was asked for than is allowed."""
    if decision.steer is Steer.ZERO:
        return 0.0, False
    live_deg = 0.0 if vehicle.steer is None else max(0.0, vehicle.steer.angle_max_deg)
    limit_deg = min(config.steer_limit_deg, live_deg)
    wanted_deg = state.steer_deg
    beyond = False
    if decision.steer is Steer.COMMAND and command is not None:
        wanted_deg = math.degrees(command.steering_rad)
        # The signal's own resolution, or half of it, is nobody's fault.
        beyond = abs(wanted_deg) > limit_deg + 0.05
    step_ns = 0 if state.cycle_ns is None else max(0, min(now_ns - state.cycle_ns, _LONGEST_STEP_NS))
    most_deg = config.steer_rate_degps * step_ns / 1e9
    turned_deg = max(state.steer_deg - most_deg, min(state.steer_deg + most_deg, wanted_deg))
    # The limit after the rate: one that the car lowers is obeyed at once, however far that is.
    return max(-limit_deg, min(limit_deg, turned_deg)), beyond


def _axle_limit_nm(
    config: GateConfig,
    axle: VcuDriveFront | VcuDriveRear | None,
    left_rpm: int,
    right_rpm: int,
    now_ns: int,
) -> float | None:
    """The most torque this axle may be asked for now; None when the car's own limit is not known."""
    if axle is None or now_ns - axle.t_rx_ns >= config.feedback_stale_ns:
        return None
    return min(config.torque_limit_nm, max(0.0, axle.torque_max_nm), constant_power_nm(max(left_rpm, right_rpm)))


def _obeys(config: GateConfig, decision: Decision, command: VehicleCommand | None, now_ns: int) -> bool:
    """Whether there is a command of this run that may be turned into values."""
    return (
        command is not None
        and command.run_id == decision.run_id
        and now_ns - command.t_sensor_ns < config.sensor_stale_ns
        and not command.problems(math.pi)
    )


def gate(
    config: GateConfig,
    state: GateState,
    decision: Decision,
    command: VehicleCommand | None,
    vehicle: VehicleState,
    now_ns: int,
    speed_mps: float = 0.0,
) -> tuple[GateState, AiCommand, frozenset[Reason]]:
    """What goes on the wire in this cycle. `speed_mps` is for the logging field only."""
    reasons: set[Reason] = set()
    status, speeds = vehicle.status, vehicle.speeds
    driving = status is not None and status.as_state is AsState.AS_DRIVING
    state = sent(state, False, now_ns)  # if nobody has said what became of the cycle before, it counts as broken

    if not _obeys(config, decision, command, now_ns):
        command = None

    # Rule 3, as far as one frame of wheel speeds tells, and 0.5 s of pulse counts: the supervisor watches both.
    pulses = state.pulses
    if vehicle.counts is not None and vehicle.counts is not pulses.counts:
        pulses = pulses_of(config.pulses_per_s, pulses, vehicle.counts)
    mission_status, direction = decision.mission_status, decision.direction
    if (
        driving
        and (direction is not Direction.FORWARD or mission_status is MissionStatus.FINISHED)
        and not _still(config, speeds, pulses, now_ns)
    ):
        mission_status, direction = MissionStatus.RUNNING, Direction.FORWARD
        reasons.add(Reason.STILLNESS_UNPROVEN)

    # Rules 4 and 5: steering only in AS_DRIVING.
    steer_deg, beyond = _steering(config, state, decision, command, vehicle, now_ns) if driving else (0.0, False)
    if beyond:
        reasons.add(Reason.STEER_CLAMPED)

    brake = _brake(config, state, decision, command)
    throttle = 0.0
    if decision.torque and command is not None and brake == 0.0:
        throttle = command.throttle

    # Rule 2, as far as the gate sees it itself.
    fresh = status is not None and now_ns - status.t_rx_ns < config.vcu_stale_ns
    go = status is not None and status.go_signal
    torque_allowed = (
        driving and fresh and vehicle.status_known and direction is Direction.FORWARD and not decision.estop
    )
    acknowledged = state.acknowledged_run_id == decision.run_id
    if throttle > 0.0 and not (torque_allowed and go and acknowledged and decision.may_move):
        throttle = 0.0
        reasons.add(Reason.TORQUE_BLOCKED)

    brake_pct = 0.0
    share, speed_max_rpm = throttle, 0
    if command is not None and decision.torque:
        speed_max_rpm = motor_rpm(command.speed_limit_mps, config.motor_rpm_per_mps, config.motor_speed_limit_rpm)
    if config.motor_brakes:
        if brake > 0.0:
            # No hydraulic request ever: torque against a motor speed limit of zero brakes (the exception to rule 2).
            share, speed_max_rpm = (brake if torque_allowed else 0.0), 0
    else:
        brake_pct = math.floor(brake * 200.0 + 0.5) / 2.0  # the signal's 0.5 %

    front_nm, rear_nm, unknown = _torque(config, vehicle, share, now_ns) if share > 0.0 else (0.0, 0.0, False)
    if unknown:
        reasons.add(Reason.TORQUE_LIMIT_UNKNOWN)

    # Rule 1.
    if state.torque_there:
        brake_pct = 0.0
    if not (state.torque_running or _released(state, vehicle)):
        front_nm = rear_nm = 0.0
    torque = front_nm > 0.0 or rear_nm > 0.0

    laps, cones_actual, cones_all = state.laps, state.cones_actual, state.cones_all
    if decision.run_id != state.run_id:
        laps = cones_actual = cones_all = 0
    if command is not None and driving:
        laps = _saturated(command.laps, LAPS_MAX)
        cones_actual = _saturated(command.cones_count_actual, CONES_ACTUAL_MAX)
        cones_all = _saturated(command.cones_count_all, CONES_ALL_MAX)

    asked = AiCommand(
        vehicle.handshake,
        decision.estop,
        mission_status,
        direction,
        math.trunc(steer_deg * 10.0 + math.copysign(_TINY, steer_deg)) / 10.0,
        front_nm,
        rear_nm,
        speed_max_rpm if config.driven_front else 0,
        speed_max_rpm if config.driven_rear else 0,
        brake_pct,
        brake_pct,
        laps,
        cones_actual,
        cones_all,
        _saturated(speed_mps * KMH_PER_MPS, SPEED_KMH_MAX),
        _saturated(command.speed_limit_mps * KMH_PER_MPS, SPEED_KMH_MAX)
        if command is not None and decision.torque
        else 0,
    )
    return (
        GateState(
            steer_deg,
            brake,
            now_ns,
            state.torque_there,
            state.zero_cycles,
            state.zero_since_ns,
            torque,
            torque,
            brake_pct > 0.0,
            True,
            mission_status is MissionStatus.SELECTED,
            state.acknowledged_run_id,
            pulses,
            decision.run_id,
            laps,
            cones_actual,
            cones_all,
        ),
        asked,
        frozenset(reasons),
    )


def _still(config: GateConfig, speeds: WheelSpeeds | None, pulses: Pulses, now_ns: int) -> bool:
    return (
        speeds is not None
        and now_ns - speeds.t_rx_ns < config.feedback_stale_ns
        and max(speeds.all_rpm) < config.standstill_rpm
        and not turning(config.standstill_ns, pulses.turning_ns, now_ns)
    )


def _brake(config: GateConfig, state: GateState, decision: Decision, command: VehicleCommand | None) -> float:
    """The brake asked for, as a fraction of the most."""
    match decision.brake:
        case Brake.ZERO:
            return 0.0
        case Brake.HOLDING:
            return config.holding_brake_pct / 100.0
        case Brake.SERVICE:
            return config.stop_brake_pct / 100.0
        case Brake.COMMAND if command is not None:
            return command.brake
        case _:
            return state.brake


def _torque(config: GateConfig, vehicle: VehicleState, share: float, now_ns: int) -> tuple[float, float, bool]:
    """Torque requests of both axles for a share of the most that is allowed now; whether a limit was unknown."""
    speeds = vehicle.speeds
    if speeds is None or now_ns - speeds.t_rx_ns >= config.feedback_stale_ns:
        return 0.0, 0.0, False  # the supervisor names it: without wheel speeds there is no constant-power limit
    front = rear = 0.0
    unknown = False
    if config.driven_front:
        limit = _axle_limit_nm(config, vehicle.drive_front, speeds.fl_rpm, speeds.fr_rpm, now_ns)
        unknown = limit is None
        front = _share_nm(limit, share)
    if config.driven_rear:
        limit = _axle_limit_nm(config, vehicle.drive_rear, speeds.rl_rpm, speeds.rr_rpm, now_ns)
        unknown = unknown or limit is None
        rear = _share_nm(limit, share)
    return front, rear, unknown


def _share_nm(limit_nm: float | None, share: float) -> float:
    return 0.0 if limit_nm is None else math.floor(limit_nm * share * 10.0 + _TINY) / 10.0  # the signal's 0.1 Nm


def _saturated(value: float, most: int) -> int:
    """A logging field within its width: saturated, never refused, 0 for what is no number."""
    if math.isnan(value):
        return 0
    return int(max(0, min(most, value)))
