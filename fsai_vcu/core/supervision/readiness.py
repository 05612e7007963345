"""*Why not driving?* Every condition that stands between now and driving, on both sides, in the car's own words.

Those that the bus shows are `start_conditions.py`; here are those that only this process knows.
"""

from __future__ import annotations

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.start_conditions import Moment
from fsai_vcu.core.supervision.start_conditions import why_not_driving as car_not_driving
from fsai_vcu.core.supervision.supervisor import ROLES, Mode, Phase, Sequence, SupervisorState, vcu_lost
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.messages import AiCommand, VehicleState
from fsai_vcu.interface.values import Value


class Circumstances(Value, frozen=True):
    """Circumstances that the bridge itself knows besides the supervisor's state."""

    phase: Phase
    command: AiCommand = AiCommand()  # the last one sent
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
    car_side = (one.sentence for one in car_not_driving(_moment(config, state, vehicle, now, now_ns)))
    held = _held(config, state, now_ns) if state.as_state is AsState.AS_DRIVING else ()
    return (*_own_side(config, state, now), *car_side, *held, *reported)


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
        unmet.append(f"stopping for the rest of this run because {state.stop.words}")
    elif state.as_state in (AsState.AS_READY, AsState.AS_DRIVING) and state.sequence is Sequence.NONE:
        unmet.append(
            f"this process did not see AS_OFF, AS_READY and AS_DRIVING follow one another (the car is in "
            f"{state.as_state.label}): the car must go through AS_OFF first"
        )
    if state.as_state is AsState.AS_READY and config.short_sequence_allowed:
        unmet.append("AS_DRIVING is accepted without the 5 s and an edge of Go (short_sequence_allowed)")
    return unmet


def _moment(
    config: BridgeConfig, state: SupervisorState, vehicle: VehicleState, now: Circumstances, now_ns: int
) -> Moment:
    if state.status_ns is None:
        return Moment(VehicleState())
    silent_ns = now_ns - state.status_ns if vcu_lost(config, state, now_ns) else None
    ready_ns = now_ns if state.ready_since_ns is None else state.ready_since_ns
    return Moment(vehicle, now.command, silent_ns, now_ns - ready_ns)


def _held(config: BridgeConfig, state: SupervisorState, now_ns: int) -> tuple[str, ...]:
    """Say why torque is held in AS_DRIVING."""
    since_ns = now_ns if state.driving_since_ns is None else state.driving_since_ns
    left_ns = config.launch_wait_ns - (now_ns - since_ns)
    if left_ns > 0:
        return (f"waiting 3 s at standstill after AS_DRIVING: {left_ns / 1e9:.1f} s left",)
    if state.stop is None and state.emergency is None:
        return ("no fresh command from the controller, or 0x520 is late or not known: torque is held at 0",)
    return ()
