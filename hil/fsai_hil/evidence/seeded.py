"""Faults put into the rules on purpose: the search must find every one, and tell the shortest way to its harm.

A search that finds nothing proves nothing unless it can find something. Each seed is one small mistake that a person
could make in a table, a time or a function of supervisor, gate or bridge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, Final

from fsai_hil.evidence.model import Composition, Scope, State, patched
from fsai_hil.evidence.scopes import scope
from fsai_hil.evidence.search import Search, explore
from fsai_hil.rules.numbers import MS
from fsai_vcu.core import bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision import gate as gating
from fsai_vcu.core.supervision import supervisor, wheel_speeds
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.supervisor import (
    OUTPUT,
    REACTIONS,
    Brake,
    Consequence,
    Phase,
    Sequence,
    Steer,
    Step,
    SupervisorState,
)
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState, Direction, MissionStatus, ShutdownCause
from fsai_vcu.interface.messages import Faults, VcuStatus


@dataclass(frozen=True, slots=True)
class Seed:
    """One mistake: where to look for its harm, the rule it breaks, and how it is made.

    Without a scope it is for the fuzz alone: what the pulse counts say of a wheel speed is no part of the search.
    """

    name: str
    rule: str
    scope: str
    patches: Callable[[], tuple[tuple[Any, str, object], ...]] = tuple
    config: Mapping[str, object] = field(default_factory=dict)
    shows_in_fuzz: bool = True


def _reaction(reason: Reason, *steps: Step) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    return lambda: ((supervisor, "REACTIONS", {**REACTIONS, reason: steps}),)


def _reactions(changed: Mapping[Reason, tuple[Step, ...]]) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    """Several changes that make one mistake only together: one guard stands behind the other."""
    return lambda: ((supervisor, "REACTIONS", {**REACTIONS, **changed}),)


def _output(phase: Phase, **changes: object) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    row = replace(OUTPUT[phase], **changes)  # type: ignore[arg-type]
    return lambda: ((supervisor, "OUTPUT", {**OUTPUT, phase: row}),)


def _follows(before: Sequence, now: AsState, then: Sequence) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    return lambda: ((supervisor, "NEXT", {**supervisor.NEXT, (before, now): then}),)


def _wrapped(owner: Any, name: str, change: Callable[..., Any]) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    """`owner.name` is called through `change(original, *arguments)`."""
    return lambda: ((owner, name, partial(change, getattr(owner, name))),)


def _method(owner: Any, name: str, change: Callable[..., Any]) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    """The same for a method: what takes its place is bound to the instance as it was."""

    def patches() -> tuple[tuple[Any, str, object], ...]:
        original = getattr(owner, name)

        def changed(instance: Any, *arguments: Any, **named: Any) -> Any:
            return change(original, instance, *arguments, **named)

        return ((owner, name, changed),)

    return patches


def _always(owner: Any, name: str, value: object) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    return _wrapped(owner, name, lambda original, *arguments: value)


def _clears_latch(original: Callable[..., Any], config: Any, state: Any, status: Any) -> Any:
    after = original(config, state, status)
    return replace(after, emergency=None) if after.as_state is AsState.AS_OFF else after


def _any_reset(original: Callable[..., Any], config: Any, state: Any, now_ns: int) -> Any:
    return replace(state, emergency=None), True, "cleared"


def _only_fast(config: Any, state: Any, now_ns: int) -> bool:
    return state.speeds_ns is not None and state.fastest_rpm < config.standstill_rpm


def _go_on_counts(original: Callable[..., Any], config: Any, state: Any, status: Any) -> Any:
    after = original(config, state, status)
    if after.ready_since_ns is None:
        return after
    return replace(after, ready_waited_ns=status.t_rx_ns - after.ready_since_ns)


def _cut_short_counts(original: Callable[..., Any], instance: Any, complete: bool, now_ns: int) -> None:
    original(instance, complete, now_ns)
    state = instance.state
    if state.asked.mission_status is MissionStatus.SELECTED:
        run_id = state.decision.run_id
        selected = supervisor.on_selected_sent(state.supervisor, run_id)
        instance.state = replace(state, supervisor=selected, gate=replace(state.gate, acknowledged_run_id=run_id))


def _gate_knows(original: Callable[..., Any], config: Any, state: Any, decision: Any, command: Any, vehicle: Any,
                *rest: Any) -> Any:  # fmt: skip
    return original(config, state, decision, command, replace(vehicle, status_known=True), *rest)


def _gate_acknowledged(original: Callable[..., Any], config: Any, state: Any, decision: Any, *rest: Any) -> Any:
    return original(config, replace(state, acknowledged_run_id=decision.run_id), decision, *rest)


def _levels_for_edges(original: Callable[..., Any], before: Any, now: Any) -> Any:
    return original(_NOTHING_SHOWN, now)


def _one_bit_hides_others(original: Callable[..., Any], before: Any, now: Any) -> Any:
    shown = any(getattr(before.faults, bit.name) for bit in fields(Faults))
    return original(before, replace(now, faults=before.faults) if shown else now)


def _believed_bit(original: Callable[..., Any], config: Any, state: Any, decision: Any, command: Any, vehicle: Any,
                  *rest: Any) -> Any:  # fmt: skip
    after, asked, reasons = original(config, state, decision, command, vehicle, *rest)
    bit = vehicle.handshake if vehicle.status is None else vehicle.status.handshake
    return after, replace(asked, handshake=bit), reasons


def _forgets_the_live_limit(original: Callable[..., Any], config: Any, axle: Any, *rest: Any) -> Any:
    return original(config, None if axle is None else replace(axle, torque_max_nm=195.0), *rest)


def _believes_old_limits(original: Callable[..., Any], config: Any, axle: Any, left_rpm: int, right_rpm: int,
                         now_ns: int) -> Any:  # fmt: skip
    return original(config, axle, left_rpm, right_rpm, now_ns if axle is None else axle.t_rx_ns)


def _gate_may_move(original: Callable[..., Any], config: Any, state: Any, decision: Any, *rest: Any) -> Any:
    return original(config, state, replace(decision, may_move=True), *rest)


def _powers_up_in(where: frozenset[AsState], moving: bool, original: Callable[..., Any], config: Any, state: Any,
                  inputs: Any) -> Any:  # fmt: skip
    stands = moving or supervisor.standing(config, state, inputs.now_ns)
    may = config.autonomous_at_power_up and not config.listen_only
    if may and state.power_up and state.as_state in where and stands:
        state = replace(state, mode=supervisor.Mode.AUTONOMOUS, power_up=False)
    return original(config, state, inputs)


def _sends_all_the_same(original: Callable[..., Any], instance: Any, now_ns: int) -> Any:
    config = instance._config
    instance._config = replace(config, listen_only=False)
    try:
        return original(instance, now_ns)
    finally:
        instance._config = config


def _loses_nothing(original: Callable[..., Any], instance: Any, why: str, now_ns: int) -> None:
    original(instance, why, now_ns)
    instance.state = replace(instance.state, bus_lost=None)


def _last_frame_by_another_name(original: Callable[..., Any], instance: Any, command: Any, t_ns: int = 0) -> Any:
    *frames, last = original(instance, command, t_ns)
    return (*frames, replace(last, can_id=last.can_id + 1))


_NOTHING_SHOWN: Final = VcuStatus(as_switch=True, ts_switch=True, shutdown_cause=ShutdownCause.NO_SHUTDOWN)
_REPORTED: Final = (Step(None, Consequence.REPORT),)

SEEDS: Final[tuple[Seed, ...]] = (
    # ---- torque and brake
    Seed("torque rises right after the brake", "1", "commands", _always(gating, "_released", True)),
    Seed(
        "a cycle cut short counts as whole",
        "1",
        "sends",
        _wrapped(bridge, "sent", lambda original, state, complete, now_ns: original(state, True, now_ns)),
    ),
    Seed(
        "torque is forgotten as soon as a cycle with it is over",
        "1",
        "commands",
        _wrapped(
            bridge,
            "sent",
            lambda original, *arguments: replace(original(*arguments), torque_there=False),
        ),
    ),
    # ---- what torque needs
    Seed("the 3 s of standing still last 2.9 s", "2", "run", config={"launch_wait_ns": 2900 * MS}),
    Seed(
        "the 3 s of standing still end 1 ns early", "2", "official simulator", config={"launch_wait_ns": 3000 * MS - 1}
    ),
    Seed(
        "the driving row is taken from the start",
        "2",
        "run",
        lambda: (
            *_output(Phase.LAUNCH_WAIT, torque=True, steer=Steer.COMMAND, brake=Brake.COMMAND)(),
            (bridge, "gate", partial(_gate_may_move, gating.gate)),
        ),
    ),
    Seed("a command lasts 150 ms", "2", "commands", config={"command_stale_ns": 150 * MS}),
    Seed("a command lasts 1 ns too long", "2", "commands", config={"command_stale_ns": 100 * MS + 1}),
    Seed("sensor data lasts 1 ns too long", "2", "commands", config={"sensor_stale_ns": 500 * MS + 1}),
    Seed("0x520 lasts 1 ns too long", "2", "messages", config={"vcu_stale_ns": 50 * MS + 1}),
    Seed(
        "a VCU that skips AS_READY is trusted",
        "2",
        "any car",
        _follows(Sequence.OFF_SEEN, AsState.AS_DRIVING, Sequence.COMPLETE),
        config={"short_sequence_allowed": True},  # else the 5 s in AS_READY are missed as well
    ),
    Seed(
        "autonomous is accepted in every state",
        "modes",
        "run",
        lambda: ((supervisor, "IDLE_STATES", frozenset(AsState)),),
    ),
    Seed(
        "an unknown mode counts as autonomous",
        "modes",
        "power-up",
        _wrapped(
            supervisor,
            "set_mode",
            lambda original, config, state, mode, now_ns: original(
                config, state, "autonomous" if mode == "sideways" else mode, now_ns
            ),
        ),
    ),
    Seed(
        "Go that was on all along counts as given",
        "2",
        "beginnings",
        _wrapped(supervisor, "on_status", _go_on_counts),
    ),
    Seed("AS_READY for 4.8 s is enough", "2", "beginnings", config={"ready_wait_ns": 4800 * MS}),
    Seed(
        "AS_READY is enough 1 ns early",
        "2",
        "beginnings",
        config={"ready_wait_ns": 4900 * MS - 1},
        shows_in_fuzz=False,  # its AS_READY lasts whole cycles
    ),
    Seed("a short sequence is only reported", "2", "beginnings", _reaction(Reason.SEQUENCE_SHORT, *_REPORTED)),
    Seed(
        "torque without a mission",
        "2",
        "beginnings",
        lambda: (
            *_reaction(Reason.NO_MISSION, *_REPORTED)(),
            (bridge, "gate", partial(_gate_acknowledged, gating.gate)),
        ),
    ),
    Seed(
        "SELECTED counts though its cycle was cut short",
        "2",
        "beginnings",
        _method(bridge.Bridge, "on_sent", _cut_short_counts),
        shows_in_fuzz=False,  # SELECTED goes out again and again: that no cycle was whole for 5 s is too rare
    ),
    Seed(
        "an AS_STATE that nobody knows is only reported",
        "2",
        "messages",
        lambda: (
            *_reaction(Reason.AS_STATE_UNKNOWN, *_REPORTED)(),
            (bridge, "gate", partial(_gate_knows, gating.gate)),
        ),
    ),
    # ---- rest
    Seed("one look at the wheels proves rest", "3", "run", lambda: ((supervisor, "standing", _only_fast),)),
    Seed("rest is proven after 400 ms", "3", "run", config={"standstill_ns": 400 * MS}),
    Seed("a wheel under 301 rpm stands", "3", "limits", config={"standstill_rpm": 301}),
    Seed(
        "pulse counts are not asked whether the wheels stand",
        "3",
        "wheel speeds",
        lambda: ((supervisor, "turning", lambda *_: False), (gating, "turning", lambda *_: False)),
    ),
    # ---- limits
    Seed(
        "a jump that no tyre can follow is believed",
        "4",
        "limits",
        config={"wheel_change_max_rpm": 65535},
    ),
    Seed("a jump that stays is believed at once", "reactions", "wheel speeds", config={"wheel_jump_ns": 20 * MS}),
    Seed("ANGLE_MAX is not looked at", "4", "limits", _always(gating, "_live_limit_deg", 30.0)),
    Seed("TRQ_MAX is not looked at", "4", "limits", _wrapped(gating, "_axle_limit_nm", _forgets_the_live_limit)),
    Seed("TRQ_MAX is believed for ever", "4", "messages", _wrapped(gating, "_axle_limit_nm", _believes_old_limits)),
    Seed("no constant-power steps", "4", "limits", _always(gating, "constant_power_nm", 195.0)),
    Seed("the operational speed limit is forgotten", "4", "run", _always(gating, "motor_rpm", 4000)),
    # ---- before AS_DRIVING
    Seed("FORWARD in AS_READY", "5", "run", _output(Phase.READY, direction=Direction.FORWARD)),
    Seed("RUNNING in AS_OFF", "5", "run", _output(Phase.IDLE, mission_status=MissionStatus.RUNNING)),
    Seed("SELECTED whatever the mode", "5", "run", _always(supervisor, "acknowledged", True)),
    Seed(
        "SELECTED before the resets are confirmed",
        "5",
        "run",
        _wrapped(
            supervisor,
            "acknowledged",
            lambda original, state: original(replace(state, confirmed=frozenset(supervisor.ROLES))),
        ),
    ),
    # ---- the latch
    Seed("AS_OFF clears the emergency", "6", "run", _wrapped(supervisor, "on_status", _clears_latch)),
    Seed("reset works everywhere", "6", "run", _wrapped(supervisor, "reset", _any_reset)),
    Seed("half a second of silence is a power cycle", "6", "power cycle", config={"power_cycle_ns": 500 * MS}),
    # ---- commands
    Seed("no command is out of order", "7", "commands", _always(VehicleCommand, "problems", ())),
    Seed("data from the future is taken", "7", "commands", config={"sensor_future_ns": 50 * MS}),
    # ---- the wire
    Seed(
        "a process that only listens sends",
        "8",
        "listen only",
        _method(bridge.Bridge, "cycle", _sends_all_the_same),
    ),
    Seed(
        "the fifth frame has an id that is not ours",
        "8",
        "run",
        _method(Codec, "encode_command", _last_frame_by_another_name),
    ),
    Seed("a process listens for 190 ms only", "8", "run", config={"listen_first_ns": 190 * MS}),
    Seed(
        "what is lost is sent to all the same",
        "8",
        "trouble",
        _method(bridge.Bridge, "bus_lost", _loses_nothing),
        shows_in_fuzz=False,  # its loop sends nothing to a bus that is lost, whatever the bridge says
    ),
    Seed("the echo follows believed frames only", "9", "messages", _wrapped(bridge, "gate", _believed_bit)),
    # ---- restarts
    Seed(
        "a new process believes that it saw AS_OFF and AS_READY",
        "10",
        "restarts, any car",
        lambda: (
            (
                bridge,
                "SupervisorState",
                partial(SupervisorState, sequence=Sequence.READY_SEEN),
            ),
        ),
    ),
    Seed(
        "a lost bus does not break the sequence",
        "2",
        "trouble",
        _wrapped(supervisor, "bus_lost", lambda original, config, state, *rest: state),
    ),
    # ---- reactions
    Seed(
        "a lost 0x520 is only held",
        "reactions",
        "messages",
        _reaction(Reason.VCU_SILENT, REACTIONS[Reason.VCU_SILENT][0]),
    ),
    Seed(
        "lost wheel speeds are only reported",
        "reactions",
        "messages",
        _reaction(Reason.WHEELS_STALE, Step("feedback_stale_ns", Consequence.REPORT)),
    ),
    Seed(
        "lost steering feedback never asks for the emergency",
        "reactions",
        "messages",
        _reaction(Reason.STEERING_STALE, REACTIONS[Reason.STEERING_STALE][0]),
    ),
    Seed(
        "both pedals are only reported",
        "reactions",
        "commands",
        _reaction(Reason.BOTH_PEDALS, Step(None, Consequence.REPORT)),
    ),
    Seed(
        "an intruder is only reported",
        "reactions",
        "trouble",
        _reaction(Reason.INTRUDER, Step(None, Consequence.REPORT)),
    ),
    Seed(
        "a fault of the loop only stops",
        "reactions",
        "trouble",
        _reaction(Reason.LOOP_FAULT, Step(None, Consequence.STOP)),
    ),
    Seed(
        "a stale command asks for the emergency at once",
        "reactions",
        "commands",
        _reaction(
            Reason.COMMAND_STALE, Step("command_stale_ns", Consequence.ESTOP), REACTIONS[Reason.COMMAND_STALE][1]
        ),
        shows_in_fuzz=False,  # who looks at frames alone takes any ESTOP_REQUEST
    ),
    *(
        Seed(f"{words} is only reported", "reactions", "marks", _reaction(reason, *_REPORTED))
        for reason, words in (
            (Reason.AS_SWITCH_OFF, "an AS switch that falls"),
            (Reason.TS_SWITCH_OFF, "a TS switch that falls"),
            (Reason.SHUTDOWN_REQUESTED, "SHUTDOWN_REQUEST that rises"),
            (Reason.FAULT_BIT, "a fault bit that rises"),
            (Reason.SHUTDOWN_CAUSE, "a SHUTDOWN_CAUSE that rises"),
        )
    ),
    Seed(
        "one fault bit hides the others",
        "reactions",
        "marks",
        _wrapped(bridge, "changes", _one_bit_hides_others),
        shows_in_fuzz=False,  # two bits one after the other, and no other stop before, are too rare
    ),
    Seed(
        "what has been shown since before the run stops it",
        "output table",
        "marks",
        _wrapped(bridge, "changes", _levels_for_edges),
        shows_in_fuzz=False,  # who looks at frames alone takes any stop
    ),
    Seed("65535 rpm is believed", "reactions", "wheel speeds", config={"wheel_max_rpm": 65535}),
    Seed(
        "a pulse count contradicts no wheel speed",
        "reactions",
        "",
        _always(wheel_speeds, "_contradicted", ""),
    ),
    Seed("Go off is only reported", "reactions", "any car", _reaction(Reason.GO_OFF, Step(None, Consequence.REPORT))),
    Seed(
        "odd wheels never ask for the emergency",
        "reactions",
        "plausibility",
        _reaction(Reason.WHEEL_IMPLAUSIBLE, REACTIONS[Reason.WHEEL_IMPLAUSIBLE][0]),
        shows_in_fuzz=False,  # a wheel that is odd beyond all doubt for 600 ms is too rare for its chance
    ),
    Seed(
        "a lost bus and a broken sequence are only reported",
        "reactions",
        "trouble",
        _reactions({Reason.BUS_LOST: _REPORTED, Reason.NOT_SEEN: _REPORTED}),
    ),
    Seed(
        "resets that nobody confirmed are no matter",
        "reactions",
        "confirmations",
        lambda: (  # SELECTED waits for them: two more guards miss it
            *_reactions({Reason.NOT_CONFIRMED: (), Reason.NO_MISSION: _REPORTED})(),
            (bridge, "gate", partial(_gate_acknowledged, gating.gate)),
        ),
    ),
    # ---- the output table
    Seed("a stop without the brake", "output table", "run", _output(Phase.STOPPING, brake=Brake.ZERO)),
    Seed(
        "a stop by the motors without the motors",
        "output table",
        "official simulator",
        _output(Phase.STOPPING, brake=Brake.ZERO),
    ),
    Seed("a stop by the holding brake", "output table", "run", _output(Phase.STOPPING, brake=Brake.HOLDING)),
    Seed("ESTOP_REQUEST without the brake", "output table", "run", _output(Phase.ESTOP_ASKED, brake=Brake.ZERO)),
    Seed("AS_READY without the holding brake", "output table", "run", _output(Phase.READY, brake=Brake.ZERO)),
    Seed("the first 3 s without the brake", "output table", "run", _output(Phase.LAUNCH_WAIT, brake=Brake.ZERO)),
    Seed("a stop that is over lets the brake go", "output table", "run", _output(Phase.STOPPED, brake=Brake.ZERO)),
    Seed("AS_FINISHED lets the brake go", "output table", "run", _output(Phase.FINISHED, brake=Brake.ZERO)),
    Seed(
        "NEUTRAL in EMERGENCY_BRAKE while wheels turn",
        "output table",
        "run",
        _output(Phase.EMERGENCY_MOVING, direction=Direction.NEUTRAL),
    ),
    Seed(
        "FORWARD in EMERGENCY_BRAKE for ever",
        "output table",
        "run",
        _output(Phase.EMERGENCY_STANDING, direction=Direction.FORWARD),
    ),
    Seed("a brake in EMERGENCY_BRAKE", "output table", "run", _output(Phase.EMERGENCY_MOVING, brake=Brake.SERVICE)),
    Seed(
        "a stale command turns the steering to zero",
        "output table",
        "commands",
        _output(Phase.HOLDING, steer=Steer.ZERO),
    ),
    Seed("a stale command lets the brake go", "output table", "commands", _output(Phase.HOLDING, brake=Brake.ZERO)),
    Seed(
        "the command does not steer",
        "output table",
        "commands",
        _output(Phase.DRIVING, steer=Steer.HELD),
        shows_in_fuzz=False,  # who looks at frames alone does not ask that steering moves
    ),
    Seed(
        "ESTOP_REQUEST and not RUNNING",
        "output table",
        "run",
        _output(Phase.ESTOP_ASKED, mission_status=MissionStatus.SELECTED),
    ),
    Seed("steering in the first 3 s", "output table", "run", _output(Phase.LAUNCH_WAIT, steer=Steer.COMMAND)),
    Seed(
        "manual, and the planner still steers",
        "output table",
        "run",
        _output(Phase.STOPPING, steer=Steer.COMMAND),
    ),
    Seed(
        "a stop that is over is never FINISHED",
        "output table",
        "run",
        _output(Phase.STOPPED, mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD),
    ),
    # ---- modes
    Seed(
        "a lost command leaves the mode autonomous",
        "modes",
        "commands",
        _reaction(Reason.COMMAND_STALE, REACTIONS[Reason.COMMAND_STALE][0], Step("command_lost_ns", Consequence.STOP)),
    ),
    Seed(
        "autonomous at power-up in every AS state",
        "modes",
        "power-up, any car",
        _wrapped(supervisor, "supervise", partial(_powers_up_in, frozenset(AsState), False)),
    ),
    Seed(
        "autonomous at power-up while wheels turn",
        "modes",
        "power-up",
        _wrapped(supervisor, "supervise", partial(_powers_up_in, supervisor.OFF_LIKE, True)),
    ),
    # ---- the safe end
    Seed(
        "a lost command is only held",
        "reactions",
        "commands",
        _reaction(Reason.COMMAND_STALE, REACTIONS[Reason.COMMAND_STALE][0]),
    ),
    Seed("a stop without effect goes unnoticed", "safe end", "limits", _reaction(Reason.STOP_INEFFECTIVE)),
)


@contextmanager
def sown(seed: Seed) -> Iterator[Scope]:
    """The seed's scope, with its mistake in force."""
    found = scope(seed.scope)
    if seed.config:
        setting = replace(found.setting, config=replace(found.setting.config, **seed.config))  # type: ignore[arg-type]
        found = replace(found, setting=setting)
    with ExitStack() as stack:
        for owner, name, value in seed.patches():
            stack.enter_context(patched(owner, name, value))
        yield found


def search_seed(seed: Seed) -> tuple[Search[State], list[str]]:
    """Search the seed's scope for its rule alone: what was found, and its trace in words."""
    with sown(seed) as searched:
        model = Composition(searched, seed.rule)
        found = explore(model, bounds_ns=searched.bounds_ns)
        return found, model.told(found.trace)
