"""Faults put into the rules on purpose: the search must find every one, and tell the shortest way to its harm.

A search that finds nothing proves nothing unless it can find something. Each seed is one small mistake that a person
could make in a table, a time or a function of supervisor, gate or bridge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import astuple, dataclass, field, replace
from functools import partial
from inspect import signature
from types import SimpleNamespace
from typing import Any, Final
from unittest.mock import patch

from fsai_hil.evidence.model import Composition
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
from fsai_vcu.interface.messages import VcuStatus

Patches = tuple[tuple[Any, str, object], ...]
"""What another value stands for while a seed is in force: its owner, its name, and the value."""


@dataclass(frozen=True, slots=True)
class Seed:
    """One mistake: where to look for its harm, the rule it breaks, and how it is made.

    Without a scope it is for the fuzz alone: what the pulse counts say of a wheel speed is no part of the search.
    """

    name: str
    rule: str
    scope: str
    patches: Patches = ()
    config: Mapping[str, object] = field(default_factory=dict)
    shows_in_fuzz: bool = True


def _reactions(changed: Mapping[Reason, tuple[Step, ...]]) -> Patches:
    return ((supervisor, "REACTIONS", {**REACTIONS, **changed}),)


def _reported(*reasons: Reason) -> Patches:
    """These are only reported. Several make one mistake only together: one guard stands behind the other."""
    return _reactions(dict.fromkeys(reasons, (Step(None, Consequence.REPORT),)))


def _first_step(reason: Reason) -> Patches:
    """Of a graded reaction only the first step is left."""
    return _reactions({reason: REACTIONS[reason][:1]})


def _output(phase: Phase, **changes: object) -> Patches:
    row = replace(OUTPUT[phase], **changes)  # type: ignore[arg-type]
    return ((supervisor, "OUTPUT", {**OUTPUT, phase: row}),)


def _row(name: str, phase: Phase, where: str = "run", **changes: object) -> Seed:
    return Seed(name, "output table", where, _output(phase, **changes))


def _wrapped(owner: Any, name: str, change: Callable[..., Any]) -> Patches:
    """`owner.name` is called through `change(original, *arguments)`."""
    original = getattr(owner, name)
    # A function and no partial: what takes a method's place is bound to the instance as it was.
    return ((owner, name, lambda *arguments, **named: change(original, *arguments, **named)),)


def _given(owner: Any, name: str, **changed: Callable[[Any], Any]) -> Patches:
    """`owner.name` is called with these arguments changed; each follows from all of them."""
    names = list(signature(getattr(owner, name)).parameters)

    def call(original: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        given = SimpleNamespace(**dict(zip(names, arguments, strict=False)), **named)
        return original(**vars(given) | {name: change(given) for name, change in changed.items()})

    return _wrapped(owner, name, call)


def _always(owner: Any, name: str, value: object) -> Patches:
    return ((owner, name, lambda *arguments: value),)


def _clears_latch(original: Callable[..., Any], *arguments: Any) -> Any:
    after = original(*arguments)
    return replace(after, emergency=None) if after.as_state is AsState.AS_OFF else after


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


def _first_bit_alone(now: VcuStatus, before: VcuStatus) -> VcuStatus:
    """Where a fault bit is shown already, no other rises."""
    return replace(now, faults=before.faults) if any(astuple(before.faults)) else now


def _believed_bit(original: Callable[..., Any], config: Any, state: Any, decision: Any, command: Any, vehicle: Any,
                  *rest: Any) -> Any:  # fmt: skip
    after, asked, reasons = original(config, state, decision, command, vehicle, *rest)
    bit = vehicle.handshake if vehicle.status is None else vehicle.status.handshake
    return after, replace(asked, handshake=bit), reasons


def _powers_up_in(where: frozenset[AsState], *, moving: bool) -> Patches:
    """Autonomous at power-up in these AS states, also while wheels turn."""

    def supervise(original: Callable[..., Any], config: Any, state: Any, inputs: Any) -> Any:
        stands = moving or supervisor.standing(config, state, inputs.now_ns)
        may = config.autonomous_at_power_up and not config.listen_only
        if may and state.power_up and state.as_state in where and stands:
            state = replace(state, mode=supervisor.Mode.AUTONOMOUS, power_up=False)
        return original(config, state, inputs)

    return _wrapped(supervisor, "supervise", supervise)


def _sends_all_the_same(original: Callable[..., Any], instance: Any, now_ns: int) -> Any:
    with patch.object(instance, "_config", replace(instance._config, listen_only=False)):
        return original(instance, now_ns)


def _loses_nothing(original: Callable[..., Any], instance: Any, why: str, now_ns: int) -> None:
    original(instance, why, now_ns)
    instance.state = replace(instance.state, bus_lost=None)


def _last_frame_by_another_name(original: Callable[..., Any], instance: Any, command: Any, t_ns: int = 0) -> Any:
    *frames, last = original(instance, command, t_ns)
    return (*frames, replace(last, can_id=last.can_id + 1))


_NOTHING_SHOWN: Final = VcuStatus(as_switch=True, ts_switch=True, shutdown_cause=ShutdownCause.NO_SHUTDOWN)
_ACKNOWLEDGED: Final = _given(bridge, "gate", state=lambda a: replace(a.state, acknowledged_run_id=a.decision.run_id))
_LATE_STOP: Final = (REACTIONS[Reason.COMMAND_STALE][0], Step("command_lost_ns", Consequence.STOP))
_AT_ONCE: Final = (Step("command_stale_ns", Consequence.ESTOP), REACTIONS[Reason.COMMAND_STALE][1])

SEEDS: Final[tuple[Seed, ...]] = (
    # ---- torque and brake
    Seed("torque rises right after the brake", "1", "commands", _always(gating, "_released", True)),
    Seed("a cycle cut short counts as whole", "1", "sends", _given(bridge, "sent", complete=lambda _: True)),
    Seed(
        "torque is forgotten as soon as a cycle with it is over",
        "1",
        "commands",
        _wrapped(bridge, "sent", lambda original, *rest: replace(original(*rest), torque_there=False)),
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
        _output(Phase.LAUNCH_WAIT, torque=True, steer=Steer.COMMAND, brake=Brake.COMMAND)
        + _given(bridge, "gate", decision=lambda a: replace(a.decision, may_move=True)),
    ),
    Seed("a command lasts 150 ms", "2", "commands", config={"command_stale_ns": 150 * MS}),
    Seed("a command lasts 1 ns too long", "2", "commands", config={"command_stale_ns": 100 * MS + 1}),
    Seed("sensor data lasts 1 ns too long", "2", "commands", config={"sensor_stale_ns": 500 * MS + 1}),
    Seed("0x520 lasts 1 ns too long", "2", "messages", config={"vcu_stale_ns": 50 * MS + 1}),
    Seed(
        "a VCU that skips AS_READY is trusted",
        "2",
        "any car",
        ((supervisor, "NEXT", {**supervisor.NEXT, (Sequence.OFF_SEEN, AsState.AS_DRIVING): Sequence.COMPLETE}),),
        config={"short_sequence_allowed": True},  # else the 5 s in AS_READY are missed as well
    ),
    Seed(
        "Go that was on all along counts as given", "2", "beginnings", _wrapped(supervisor, "on_status", _go_on_counts)
    ),
    Seed("AS_READY for 4.8 s is enough", "2", "beginnings", config={"ready_wait_ns": 4800 * MS}),
    Seed(
        "AS_READY is enough 1 ns early",
        "2",
        "beginnings",
        config={"ready_wait_ns": 4900 * MS - 1},
        shows_in_fuzz=False,  # its AS_READY lasts whole cycles
    ),
    Seed("a short sequence is only reported", "2", "beginnings", _reported(Reason.SEQUENCE_SHORT)),
    Seed("torque without a mission", "2", "beginnings", _reported(Reason.NO_MISSION) + _ACKNOWLEDGED),
    Seed(
        "SELECTED counts though its cycle was cut short",
        "2",
        "beginnings",
        _wrapped(bridge.Bridge, "on_sent", _cut_short_counts),
        shows_in_fuzz=False,  # SELECTED goes out again and again: that no cycle was whole for 5 s is too rare
    ),
    Seed(
        "an AS_STATE that nobody knows is only reported",
        "2",
        "messages",
        _reported(Reason.AS_STATE_UNKNOWN)
        + _given(bridge, "gate", vehicle=lambda a: replace(a.vehicle, status_known=True)),
    ),
    Seed(
        "a lost bus does not break the sequence",
        "2",
        "trouble",
        _wrapped(supervisor, "bus_lost", lambda original, config, state, *rest: state),
    ),
    # ---- rest
    Seed("one look at the wheels proves rest", "3", "run", ((supervisor, "standing", _only_fast),)),
    Seed("rest is proven after 400 ms", "3", "run", config={"standstill_ns": 400 * MS}),
    Seed("a wheel under 301 rpm stands", "3", "limits", config={"standstill_rpm": 301}),
    Seed(
        "pulse counts are not asked whether the wheels stand",
        "3",
        "wheel speeds",
        _always(supervisor, "turning", False) + _always(gating, "turning", False),
    ),
    # ---- limits
    Seed("a jump that no tyre can follow is believed", "4", "limits", config={"wheel_change_max_rpm": 65535}),
    Seed("ANGLE_MAX is not looked at", "4", "limits", _always(gating, "_live_limit_deg", 30.0)),
    Seed(
        "TRQ_MAX is not looked at",
        "4",
        "limits",
        _given(gating, "_axle_limit_nm", axle=lambda a: a.axle and replace(a.axle, torque_max_nm=195.0)),
    ),
    Seed(
        "TRQ_MAX is believed for ever",
        "4",
        "messages",
        _given(gating, "_axle_limit_nm", now_ns=lambda a: a.axle.t_rx_ns if a.axle else a.now_ns),
    ),
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
        _given(supervisor, "acknowledged", state=lambda a: replace(a.state, confirmed=frozenset(supervisor.ROLES))),
    ),
    # ---- the latch
    Seed("AS_OFF clears the emergency", "6", "run", _wrapped(supervisor, "on_status", _clears_latch)),
    Seed(
        "reset works everywhere",
        "6",
        "run",
        _wrapped(
            supervisor, "reset", lambda _, config, state, now_ns: (replace(state, emergency=None), True, "cleared")
        ),
    ),
    Seed("half a second of silence is a power cycle", "6", "power cycle", config={"power_cycle_ns": 500 * MS}),
    # ---- commands
    Seed("no command is out of order", "7", "commands", _always(VehicleCommand, "problems", ())),
    Seed("data from the future is taken", "7", "commands", config={"sensor_future_ns": 50 * MS}),
    # ---- the wire
    Seed(
        "a process that only listens sends", "8", "listen only", _wrapped(bridge.Bridge, "cycle", _sends_all_the_same)
    ),
    Seed(
        "the fifth frame has an id that is not ours",
        "8",
        "run",
        _wrapped(Codec, "encode_command", _last_frame_by_another_name),
    ),
    Seed("a process listens for 190 ms only", "8", "run", config={"listen_first_ns": 190 * MS}),
    Seed(
        "what is lost is sent to all the same",
        "8",
        "trouble",
        _wrapped(bridge.Bridge, "bus_lost", _loses_nothing),
        shows_in_fuzz=False,  # its loop sends nothing to a bus that is lost, whatever the bridge says
    ),
    Seed("the echo follows believed frames only", "9", "messages", _wrapped(bridge, "gate", _believed_bit)),
    # ---- restarts
    Seed(
        "a new process believes that it saw AS_OFF and AS_READY",
        "10",
        "restarts, any car",
        ((bridge, "SupervisorState", partial(SupervisorState, sequence=Sequence.READY_SEEN)),),
    ),
    # ---- reactions
    Seed("a lost 0x520 is only held", "reactions", "messages", _first_step(Reason.VCU_SILENT)),
    Seed(
        "lost wheel speeds are only reported",
        "reactions",
        "messages",
        _reactions({Reason.WHEELS_STALE: (Step("feedback_stale_ns", Consequence.REPORT),)}),
    ),
    Seed(
        "lost steering feedback never asks for the emergency",
        "reactions",
        "messages",
        _first_step(Reason.STEERING_STALE),
    ),
    Seed("both pedals are only reported", "reactions", "commands", _reported(Reason.BOTH_PEDALS)),
    Seed("an intruder is only reported", "reactions", "trouble", _reported(Reason.INTRUDER)),
    Seed(
        "a fault of the loop only stops",
        "reactions",
        "trouble",
        _reactions({Reason.LOOP_FAULT: (Step(None, Consequence.STOP),)}),
    ),
    Seed(
        "a stale command asks for the emergency at once",
        "reactions",
        "commands",
        _reactions({Reason.COMMAND_STALE: _AT_ONCE}),
        shows_in_fuzz=False,  # who looks at frames alone takes any ESTOP_REQUEST
    ),
    Seed("a lost command is only held", "reactions", "commands", _first_step(Reason.COMMAND_STALE)),
    *(
        Seed(f"{words} is only reported", "reactions", "marks", _reported(reason))
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
        _given(bridge, "changes", now=lambda a: _first_bit_alone(a.now, a.before)),
        shows_in_fuzz=False,  # two bits one after the other, and no other stop before, are too rare
    ),
    Seed("a jump that stays is believed at once", "reactions", "wheel speeds", config={"wheel_jump_ns": 20 * MS}),
    Seed("65535 rpm is believed", "reactions", "wheel speeds", config={"wheel_max_rpm": 65535}),
    Seed("a pulse count contradicts no wheel speed", "reactions", "", _always(wheel_speeds, "_contradicted", "")),
    Seed("Go off is only reported", "reactions", "any car", _reported(Reason.GO_OFF)),
    Seed(
        "odd wheels never ask for the emergency",
        "reactions",
        "plausibility",
        _first_step(Reason.WHEEL_IMPLAUSIBLE),
        shows_in_fuzz=False,  # what the process takes for implausible is hidden from it
    ),
    Seed(
        "a lost bus and a broken sequence are only reported",
        "reactions",
        "trouble",
        _reported(Reason.BUS_LOST, Reason.NOT_SEEN),
    ),
    Seed(
        "resets that nobody confirmed are no matter",
        "reactions",
        "confirmations",  # SELECTED waits for them: two more guards miss it
        _reactions({Reason.NOT_CONFIRMED: (), Reason.NO_MISSION: (Step(None, Consequence.REPORT),)}) + _ACKNOWLEDGED,
    ),
    # ---- the output table
    Seed(
        "what has been shown since before the run stops it",
        "output table",
        "marks",
        _given(bridge, "changes", before=lambda _: _NOTHING_SHOWN),
        shows_in_fuzz=False,  # who looks at frames alone takes any stop
    ),
    _row("a stop without the brake", Phase.STOPPING, brake=Brake.ZERO),
    _row("a stop by the motors without the motors", Phase.STOPPING, "official simulator", brake=Brake.ZERO),
    _row("a stop by the holding brake", Phase.STOPPING, brake=Brake.HOLDING),
    _row("ESTOP_REQUEST without the brake", Phase.ESTOP_ASKED, brake=Brake.ZERO),
    _row("AS_READY without the holding brake", Phase.READY, brake=Brake.ZERO),
    _row("the first 3 s without the brake", Phase.LAUNCH_WAIT, brake=Brake.ZERO),
    _row("a stop that is over lets the brake go", Phase.STOPPED, brake=Brake.ZERO),
    _row("AS_FINISHED lets the brake go", Phase.FINISHED, brake=Brake.ZERO),
    _row("NEUTRAL in EMERGENCY_BRAKE while wheels turn", Phase.EMERGENCY_MOVING, direction=Direction.NEUTRAL),
    _row("FORWARD in EMERGENCY_BRAKE for ever", Phase.EMERGENCY_STANDING, direction=Direction.FORWARD),
    _row("a brake in EMERGENCY_BRAKE", Phase.EMERGENCY_MOVING, brake=Brake.SERVICE),
    _row("a stale command turns the steering to zero", Phase.HOLDING, "commands", steer=Steer.ZERO),
    _row("a stale command lets the brake go", Phase.HOLDING, "commands", brake=Brake.ZERO),
    _row("ESTOP_REQUEST and not RUNNING", Phase.ESTOP_ASKED, mission_status=MissionStatus.SELECTED),
    _row("steering in the first 3 s", Phase.LAUNCH_WAIT, steer=Steer.COMMAND),
    _row("manual, and the planner still steers", Phase.STOPPING, steer=Steer.COMMAND),
    _row(
        "a stop that is over is never FINISHED",
        Phase.STOPPED,
        mission_status=MissionStatus.RUNNING,
        direction=Direction.FORWARD,
    ),
    Seed(
        "the command does not steer",
        "output table",
        "commands",
        _output(Phase.DRIVING, steer=Steer.HELD),
        shows_in_fuzz=False,  # who looks at frames alone does not ask that steering moves
    ),
    # ---- modes
    Seed("autonomous is accepted in every state", "modes", "run", ((supervisor, "IDLE_STATES", frozenset(AsState)),)),
    Seed(
        "an unknown mode counts as autonomous",
        "modes",
        "power-up",
        _given(supervisor, "set_mode", mode=lambda a: "autonomous" if a.mode == "sideways" else a.mode),
    ),
    Seed(
        "a lost command leaves the mode autonomous", "modes", "commands", _reactions({Reason.COMMAND_STALE: _LATE_STOP})
    ),
    Seed(
        "autonomous at power-up in every AS state",
        "modes",
        "power-up, any car",
        _powers_up_in(frozenset(AsState), moving=False),
    ),
    Seed(
        "autonomous at power-up while wheels turn", "modes", "power-up", _powers_up_in(supervisor.OFF_LIKE, moving=True)
    ),
    # ---- the safe end
    Seed("a stop without effect goes unnoticed", "safe end", "limits", _reactions({Reason.STOP_INEFFECTIVE: ()})),
)


@contextmanager
def patched(patches: Patches) -> Iterator[None]:
    """These are in force."""
    with ExitStack() as stack:
        for owner, name, value in patches:
            stack.enter_context(patch.object(owner, name, value))
        yield


def search_seed(seed: Seed) -> tuple[Search, list[str]]:
    """Search the seed's scope for its rule alone: what was found, and its trace in words."""
    searched = scope(seed.scope)
    setting = replace(searched.setting, config=replace(searched.setting.config, **seed.config))  # type: ignore[arg-type]
    with patched(seed.patches):
        model = Composition(replace(searched, setting=setting), seed.rule)
        found = explore(model, bounds_ns=searched.bounds_ns)
        return found, model.described(found.trace)
