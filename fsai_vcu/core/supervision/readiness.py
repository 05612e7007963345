"""*Why not driving?* Every condition that stands between now and driving, on both sides, in the car's own words."""

from __future__ import annotations

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.supervisor import ROLES, Mode, Phase, Sequence, SupervisorState, acknowledged, vcu_lost
from fsai_vcu.interface.enums import (
    OFF_LIKE,
    Ami,
    AsState,
    BrakeStatus,
    EbsState,
    EbsStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.messages import VcuStatus, VehicleState
from fsai_vcu.interface.specification import READY_STEER_DEG, READY_WAIT_NS
from fsai_vcu.interface.values import Value


class Circumstances(Value, frozen=True):
    """What the bridge itself knows besides the supervisor's state."""

    phase: Phase
    listening: bool = False
    bus_lost: str | None = None
    stopped: bool = False
    wrong: tuple[str, ...] = ()  # received that should not be on the bus, in words
    note: str = ""  # why the controller does not drive


def why_not_driving(
    config: BridgeConfig, state: SupervisorState, vehicle: VehicleState, now: Circumstances, now_ns: int
) -> tuple[str, ...]:
    """Every unmet condition; empty while the car drives by command."""
    heard = now.phase in (Phase.DRIVING, Phase.HOLDING) and now.note
    reported = (f"the controller reports: {now.note}",) if heard else ()
    if now.phase is Phase.DRIVING and not (now.stopped or now.bus_lost or config.listen_only):
        return reported
    return (*_own_side(config, state, now), *_car_side(config, state, vehicle, now_ns), *reported)


def _own_side(config: BridgeConfig, state: SupervisorState, now: Circumstances) -> list[str]:
    """Conditions that the AI side has to meet."""
    unmet: list[str] = []
    if config.listen_only:
        unmet.append("listen_only: this process never sends")
    if now.stopped:
        unmet.append("this software was stopped and sends nothing any more")
    elif now.listening:
        unmet.append("listening before the first cycle is sent")
    if now.bus_lost is not None:
        unmet.append(f"the bus is lost: {now.bus_lost}")
    unmet.extend(now.wrong)
    if state.emergency is not None:
        unmet.append(
            f"ESTOP_REQUEST is latched because {state.emergency.words}: "
            "reset in AS_INIT or AS_OFF, or switch the car off and on"
        )
    if state.mode is Mode.MANUAL:
        unmet.append("mode is manual: set autonomous in AS_INIT, AS_OFF or AS_READY")
    if state.mission is not Ami.NOT_SELECTED:
        unmet.extend(
            f"the {role} has not confirmed its reset for run {state.run_id} ({state.mission.label})"
            for role in ROLES
            if role not in state.confirmed
        )
    if state.stop is not None:
        unmet.append(f"stopping for good in this run because {state.stop.words}")
    elif state.as_state in (AsState.AS_READY, AsState.AS_DRIVING) and state.sequence is Sequence.NONE:
        unmet.append(
            f"this process did not see AS_OFF, AS_READY and AS_DRIVING follow one another (the car is in "
            f"{state.as_state.label}): it takes AS_OFF first"
        )
    return unmet


def _car_side(config: BridgeConfig, state: SupervisorState, vehicle: VehicleState, now_ns: int) -> list[str]:
    """Conditions that the car and the people around it have to meet."""
    status = vehicle.status
    if status is None or state.status_ns is None:
        return ["no 0x520 from the car yet"]
    unmet: list[str] = []
    if vcu_lost(config, state, now_ns):
        unmet.append(f"0x520 is missing for {(now_ns - state.status_ns) / 1e9:.1f} s")
    if state.mission is Ami.NOT_SELECTED:
        unmet.append("no mission is chosen on the AMI")
    if status.as_switch is False:  # not where the database lacks it
        unmet.append("ASMS is off (AS_SWITCH_STATUS 0)")
    if status.ts_switch is False:
        unmet.append("TSMS is off (TS_SWITCH_STATUS 0)")
    brake = vehicle.brake
    if status.ebs_state is not None:
        if status.ebs_state is not EbsState.EBS_ARMED:
            unmet.append(f"EBS is not armed ({status.ebs_state.label})")
    elif brake is not None and brake.ebs_status is not None and brake.ebs_status is not EbsStatus.ARMED:
        unmet.append(f"EBS is not armed (STATUS_EBS {brake.ebs_status.label})")
    if status.ts_state is not None and status.ts_state is not TsState.TS_RUNNING:
        unmet.append(f"the tractive system does not run ({status.ts_state.label})")
    if status.op_state is OpState.OP_FAULT:
        unmet.append("OP_STATE is OP_FAULT")
    if status.fault:
        unmet.append("FAULT_STATUS is 1" + _named_faults(status))
    if status.shutdown_request:
        unmet.append("the car asks for shutdown (SHUTDOWN_REQUEST)")
    unmet.extend(_in_state(config, state, vehicle, status, now_ns))
    return unmet


def _named_faults(status: VcuStatus) -> str:
    names = list(status.faults.names)
    if status.shutdown_cause is not None and status.shutdown_cause is not ShutdownCause.NO_SHUTDOWN:
        names.append(f"SHUTDOWN_CAUSE {status.shutdown_cause.label}")
    return f": {', '.join(names)}" if names else ""


def _in_state(
    config: BridgeConfig, state: SupervisorState, vehicle: VehicleState, status: VcuStatus, now_ns: int
) -> list[str]:
    """What the AS state itself still waits for."""
    now = status.as_state
    if now in OFF_LIKE:
        if acknowledged(state):
            return [f"waiting for AS_READY: the car is in {now.label}, SELECTED is being sent"]
        return [f"the car is in {now.label}"]
    if now is AsState.EMERGENCY_BRAKE:
        return [
            "the car is in EMERGENCY_BRAKE"
            + _named_faults(status)
            + ": wait 15 s, ASMS off, then switch the car off and on"
        ]
    if now is AsState.AS_FINISHED:
        return ["the mission is finished (AS_FINISHED): ASMS off ends the run"]
    unmet: list[str] = []
    if status.steering_status is SteeringStatus.OFF:
        unmet.append("the steering is not active (STEERING_STATUS 0)")
    if vehicle.brake is not None and vehicle.brake.brake_status is not BrakeStatus.READY:
        words = "an unknown value" if vehicle.brake.brake_status is None else vehicle.brake.brake_status.label
        unmet.append(f"the brakes are not ready (STATUS_BRK {words})")
    if now is AsState.AS_READY:
        waited_ns = now_ns - (state.ready_since_ns if state.ready_since_ns is not None else now_ns)
        if vehicle.steer is not None and abs(vehicle.steer.angle_deg) >= READY_STEER_DEG:
            unmet.append(f"the steering is measured at {vehicle.steer.angle_deg:.1f} deg: under 5 deg is needed")
        if waited_ns < READY_WAIT_NS:
            unmet.append(f"waiting in AS_READY: {(READY_WAIT_NS - waited_ns) / 1e9:.1f} s of 5 s left")
        if config.short_sequence_allowed:
            unmet.append("AS_DRIVING is accepted without these 5 s and an edge of Go (short_sequence_allowed)")
        if status.go_signal:
            unmet.append("Go is already on: it must go off and on again")
        else:
            unmet.append("waiting for Go")
        return unmet
    # AS_DRIVING
    if not status.go_signal:
        unmet.append("Go is off (GO_SIGNAL 0)")
    since_ns = now_ns if state.driving_since_ns is None else state.driving_since_ns
    left_ns = config.launch_wait_ns - (now_ns - since_ns)
    if left_ns > 0:
        unmet.append(f"standing still after AS_DRIVING: {left_ns / 1e9:.1f} s of 3 s left")
    elif state.stop is None and state.emergency is None:
        unmet.append("no fresh command from the controller, or 0x520 is late: torque is held at 0")
    return unmet
