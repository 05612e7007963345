"""Faults put into the rules on purpose: the search must find every one, and tell the shortest way to its harm.

A search that finds nothing proves nothing unless it can find something. Each seed is one small mistake that a person
could make in a table, a time or a function of supervisor, gate or bridge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from inspect import signature
from types import SimpleNamespace
from typing import Any, Final
from unittest.mock import patch

from msgspec.structs import astuple, replace

from fsai_hil.evidence.model import Composition
from fsai_hil.evidence.scopes import SCOPES, scope
from fsai_hil.evidence.search import Search, explore
from fsai_hil.evidence.searched import SearchSetting
from fsai_hil.rules.numbers import MS
from fsai_vcu.core import bridge
from fsai_vcu.core.bridge import BridgeConfig
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision import gate as gating
from fsai_vcu.core.supervision import supervisor, wheel_speeds
from fsai_vcu.core.supervision.config import Reason
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
from fsai_vcu.interface.values import Value

Patches = tuple[tuple[Any, str, object], ...]
"""The names that have another value while a seed is in force: owner, name, and the value."""


class Seed(Value, frozen=True):
    """One mistake: where to look for its harm, the rule it breaks, and how it is made.

    Without a scope it is for the fuzz alone: what the pulse counts say of a wheel speed is no part of the search.
    """

    name: str
    rule: str
    scope: str
    patches: Patches = ()

    def configured(self, setting: SearchSetting) -> SearchSetting:
        """The setting with what this mistake configures otherwise."""
        changed = {name: value for owner, name, value in self.patches if owner is BridgeConfig}
        return replace(setting, config=replace(setting.config, **changed))


def _config(**changed: object) -> Patches:
    return tuple((BridgeConfig, name, value) for name, value in changed.items())


def _reactions(changed: Mapping[Reason, tuple[Step, ...]]) -> Patches:
    return ((supervisor, "REACTIONS", {**REACTIONS, **changed}),)


def _reported(*reasons: Reason) -> Patches:
    """These are only reported. Several make one mistake only together: one guard stands behind the other."""
    return _reactions(dict.fromkeys(reasons, (Step(None, Consequence.REPORT),)))


def _first_step(reason: Reason) -> Patches:
    """Leave only the first step of a graded reaction."""
    return _reactions({reason: REACTIONS[reason][:1]})


def _output(phase: Phase, **changes: object) -> Patches:
    row = replace(OUTPUT[phase], **changes)
    return ((supervisor, "OUTPUT", {**OUTPUT, phase: row}),)


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


def _rounded_up(limit_nm: float | None, share: float) -> float:
    return 0.0 if limit_nm is None else math.ceil(limit_nm * share * 10.0 - 1e-9) / 10.0


def _first_bit_alone(now: VcuStatus, before: VcuStatus) -> VcuStatus:
    """Let no other fault bit rise while one is shown."""
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

_MISTAKES: Final[Mapping[str, Mapping[str, tuple[str, Patches]]]] = {
    "1": {
        "torque rises right after the brake": ("commands", _always(gating, "_released", True)),
        "a cycle cut short counts as whole": ("sends", _given(bridge, "sent", complete=lambda _: True)),
        "torque is forgotten as soon as a cycle with it is over": (
            "commands",
            _wrapped(bridge, "sent", lambda original, *rest: replace(original(*rest), torque_there=False)),
        ),
    },
    "2": {
        "the 3 s of standing still last 2.9 s": ("run", _config(launch_wait_ns=2900 * MS)),
        "the 3 s of standing still end 1 ns early": ("official simulator", _config(launch_wait_ns=3000 * MS - 1)),
        "the driving row is taken from the start": (
            "run",
            _output(Phase.LAUNCH_WAIT, torque=True, steer=Steer.COMMAND, brake=Brake.COMMAND)
            + _given(bridge, "gate", decision=lambda a: replace(a.decision, may_move=True)),
        ),
        "a command lasts 150 ms": ("commands", _config(command_stale_ns=150 * MS)),
        "a command lasts 1 ns too long": ("commands", _config(command_stale_ns=100 * MS + 1)),
        "sensor data lasts 1 ns too long": ("commands", _config(sensor_stale_ns=500 * MS + 1)),
        "0x520 lasts 1 ns too long": ("messages", _config(vcu_stale_ns=50 * MS + 1)),
        "a VCU that skips AS_READY is trusted": (
            "any car",
            (
                (supervisor, "NEXT", {**supervisor.NEXT, (Sequence.OFF_SEEN, AsState.AS_DRIVING): Sequence.COMPLETE}),
                (BridgeConfig, "short_sequence_allowed", True),  # else the 5 s in AS_READY are missed as well
            ),
        ),
        "Go that was on all along counts as given": ("beginnings", _wrapped(supervisor, "on_status", _go_on_counts)),
        "AS_READY for 4.8 s is enough": ("beginnings", _config(ready_wait_ns=4800 * MS)),
        "AS_READY is enough 1 ns early": ("beginnings", _config(ready_wait_ns=4900 * MS - 1)),
        "a short sequence is only reported": ("beginnings", _reported(Reason.SEQUENCE_SHORT)),
        "torque without a mission": ("beginnings", _reported(Reason.NO_MISSION) + _ACKNOWLEDGED),
        "SELECTED counts though its cycle was cut short": (
            "beginnings",
            _wrapped(bridge.Bridge, "on_sent", _cut_short_counts),
        ),
        "an AS_STATE that nobody knows is only reported": (
            "messages",
            _reported(Reason.AS_STATE_UNKNOWN)
            + _given(bridge, "gate", vehicle=lambda a: replace(a.vehicle, status_known=True)),
        ),
        "torque returns with the first AS_STATE that is known": ("messages", _config(as_state_known_ns=0)),
        "an AS_STATE is known again 1 ns early": ("messages", _config(as_state_known_ns=100 * MS - 1)),
        "a lost bus does not break the sequence": (
            "trouble",
            _wrapped(supervisor, "bus_lost", lambda original, config, state, *rest: state),
        ),
    },
    "3": {
        "one look at the wheels proves rest": ("run", ((supervisor, "standing", _only_fast),)),
        "rest is proven after 400 ms": ("run", _config(standstill_ns=400 * MS)),
        "a wheel under 301 rpm stands": ("limits", _config(standstill_rpm=301)),
        "pulse counts are not asked whether the wheels stand": (
            "wheel speeds",
            _always(supervisor, "turning", False) + _always(gating, "turning", False),
        ),
    },
    "4": {
        "a jump that no tyre can follow is believed": ("limits", _config(wheel_change_max_rpm=65535)),
        "ANGLE_MAX is not looked at": ("limits", _always(gating, "_live_limit_deg", 30.0)),
        "TRQ_MAX is not looked at": (
            "limits",
            _given(gating, "_axle_limit_nm", axle=lambda a: a.axle and replace(a.axle, torque_max_nm=195.0)),
        ),
        "TRQ_MAX is believed for ever": (
            "messages",
            _given(gating, "_axle_limit_nm", now_ns=lambda a: a.axle.t_rx_ns if a.axle else a.now_ns),
        ),
        "no constant-power steps": ("limits", _always(gating, "constant_power_nm", 195.0)),
        "a torque share is rounded up": ("commands", ((gating, "_share_nm", _rounded_up),)),
        "the operational speed limit is forgotten": ("run", _always(gating, "motor_rpm", 4000)),
    },
    "5": {
        "FORWARD in AS_READY": ("run", _output(Phase.READY, direction=Direction.FORWARD)),
        "RUNNING in AS_OFF": ("run", _output(Phase.IDLE, mission_status=MissionStatus.RUNNING)),
        "SELECTED whatever the mode": ("run", _always(supervisor, "acknowledged", True)),
        "a reset that is confirmed for another run counts": (
            "confirmations",
            _given(supervisor, "confirm", run_id=lambda a: a.state.run_id),
        ),
        "SELECTED before the resets are confirmed": (
            "run",
            _given(supervisor, "acknowledged", state=lambda a: replace(a.state, confirmed=frozenset(supervisor.ROLES))),
        ),
    },
    "6": {
        "AS_OFF clears the emergency": ("run", _wrapped(supervisor, "on_status", _clears_latch)),
        "reset works everywhere": (
            "run",
            _wrapped(
                supervisor, "reset", lambda _, config, state, now_ns: (replace(state, emergency=None), True, "cleared")
            ),
        ),
        "half a second of silence is a power cycle": ("power cycle", _config(power_cycle_ns=500 * MS)),
    },
    "7": {
        "no command is out of order": ("commands", _always(VehicleCommand, "problems", ())),
        "data from the future is taken": ("commands", _config(sensor_future_ns=50 * MS)),
    },
    "8": {
        "a process that only listens sends": ("listen only", _wrapped(bridge.Bridge, "cycle", _sends_all_the_same)),
        "the fifth frame has an id that is not ours": (
            "run",
            _wrapped(Codec, "encode_command", _last_frame_by_another_name),
        ),
        "a process listens for 190 ms only": ("run", _config(listen_first_ns=190 * MS)),
        "what is lost is sent to all the same": ("trouble", _wrapped(bridge.Bridge, "bus_lost", _loses_nothing)),
    },
    "9": {
        "the echo follows believed frames only": ("messages", _wrapped(bridge, "gate", _believed_bit)),
    },
    "10": {
        "a new process believes that it saw AS_OFF and AS_READY": (
            "restarts, any car",
            ((bridge, "SupervisorState", partial(SupervisorState, sequence=Sequence.READY_SEEN)),),
        ),
    },
    "reactions": {
        "a lost 0x520 is only held": ("messages", _first_step(Reason.VCU_SILENT)),
        "lost wheel speeds are only reported": (
            "messages",
            _reactions({Reason.WHEELS_STALE: (Step("feedback_stale_ns", Consequence.REPORT),)}),
        ),
        "lost steering feedback never asks for the emergency": ("messages", _first_step(Reason.STEERING_STALE)),
        "a fault of the loop only stops": ("trouble", _reactions({Reason.LOOP_FAULT: (Step(None, Consequence.STOP),)})),
        "a stale command asks for the emergency at once": ("commands", _reactions({Reason.COMMAND_STALE: _AT_ONCE})),
        "a lost command is only held": ("commands", _first_step(Reason.COMMAND_STALE)),
        "commands on old data are held for ever": (
            "commands",
            _given(supervisor, "_command_age_ns", state=lambda a: replace(a.state, command_stale_since_ns=None)),
        ),
        "one fault bit hides the others": (
            "marks",
            _given(bridge, "changes", now=lambda a: _first_bit_alone(a.now, a.before)),
        ),
        "a jump that stays is believed at once": ("wheel speeds", _config(wheel_jump_ns=20 * MS)),
        "65535 rpm is believed": ("wheel speeds", _config(wheel_max_rpm=65535)),
        "a pulse count contradicts no wheel speed": ("", _always(wheel_speeds, "_contradicted", "")),
        "odd steering never asks for the emergency": ("plausibility", _first_step(Reason.STEERING_IMPLAUSIBLE)),
        "odd wheels never ask for the emergency": ("plausibility", _first_step(Reason.WHEEL_IMPLAUSIBLE)),
        "a lost bus and a broken sequence are only reported": ("trouble", _reported(Reason.BUS_LOST, Reason.NOT_SEEN)),
        "resets that nobody confirmed are no matter": (
            "confirmations",  # SELECTED waits for them: two more guards miss it
            _reactions({Reason.NOT_CONFIRMED: (), Reason.NO_MISSION: (Step(None, Consequence.REPORT),)})
            + _ACKNOWLEDGED,
        ),
    },
    "output table": {
        "what has been shown since before the run stops it": (
            "marks",
            _given(bridge, "changes", before=lambda a: replace(_NOTHING_SHOWN, ami=a.now.ami)),
        ),
        "a stop without the brake": ("run", _output(Phase.STOPPING, brake=Brake.ZERO)),
        "a stop by the motors without the motors": ("official simulator", _output(Phase.STOPPING, brake=Brake.ZERO)),
        "a stop by the holding brake": ("run", _output(Phase.STOPPING, brake=Brake.HOLDING)),
        "ESTOP_REQUEST without the brake": ("run", _output(Phase.ESTOP_ASKED, brake=Brake.ZERO)),
        "AS_READY without the holding brake": ("run", _output(Phase.READY, brake=Brake.ZERO)),
        "the first 3 s without the brake": ("run", _output(Phase.LAUNCH_WAIT, brake=Brake.ZERO)),
        "a stop that is over lets the brake go": ("run", _output(Phase.STOPPED, brake=Brake.ZERO)),
        "AS_FINISHED lets the brake go": ("run", _output(Phase.FINISHED, brake=Brake.ZERO)),
        "NEUTRAL in EMERGENCY_BRAKE while wheels turn": (
            "run",
            _output(Phase.EMERGENCY_MOVING, direction=Direction.NEUTRAL),
        ),
        "FORWARD in EMERGENCY_BRAKE for ever": ("run", _output(Phase.EMERGENCY_STANDING, direction=Direction.FORWARD)),
        "a brake in EMERGENCY_BRAKE": ("run", _output(Phase.EMERGENCY_MOVING, brake=Brake.SERVICE)),
        "a stale command turns the steering to zero": ("commands", _output(Phase.HOLDING, steer=Steer.ZERO)),
        "a stale command lets the brake go": ("commands", _output(Phase.HOLDING, brake=Brake.ZERO)),
        "ESTOP_REQUEST and not RUNNING": ("run", _output(Phase.ESTOP_ASKED, mission_status=MissionStatus.SELECTED)),
        "steering in the first 3 s": ("run", _output(Phase.LAUNCH_WAIT, steer=Steer.COMMAND)),
        "manual, and the planner still steers": ("run", _output(Phase.STOPPING, steer=Steer.COMMAND)),
        "a stop that is over is never FINISHED": (
            "run",
            _output(Phase.STOPPED, mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD),
        ),
        "the command does not steer": ("commands", _output(Phase.DRIVING, steer=Steer.HELD)),
    },
    "modes": {
        "autonomous is accepted in every state": ("run", ((supervisor, "IDLE_STATES", frozenset(AsState)),)),
        "an unknown mode counts as autonomous": (
            "power-up",
            _given(supervisor, "set_mode", mode=lambda a: "autonomous" if a.mode == "sideways" else a.mode),
        ),
        "a lost command leaves the mode autonomous": ("commands", _reactions({Reason.COMMAND_STALE: _LATE_STOP})),
        "autonomous at power-up in every AS state": (
            "power-up, any car",
            _powers_up_in(frozenset(AsState), moving=False),
        ),
        "autonomous at power-up while wheels turn": ("power-up", _powers_up_in(supervisor.OFF_LIKE, moving=True)),
    },
    "safe end": {
        "a stop without effect goes unnoticed": ("limits", _reactions({Reason.STOP_INEFFECTIVE: ()})),
    },
}
"""The mistakes of each rule, by name: the scope in which the mistake breaks it, and how it is made."""

SEEDS: Final = (
    *(
        Seed(name, rule, where, patches)
        for rule, mistakes in _MISTAKES.items()
        for name, (where, patches) in mistakes.items()
    ),
    *(
        Seed(f"{reason.slug} is only reported", "reactions", one.name, _reported(reason))
        for one in SCOPES
        for reason in one.reactions
    ),
)


@contextmanager
def patched(patches: Patches) -> Iterator[None]:
    """These are in force, but for what is configured."""
    with ExitStack() as stack:
        for owner, name, value in patches:
            if owner is not BridgeConfig:
                stack.enter_context(patch.object(owner, name, value))
        yield


def search_for(seed: Seed) -> tuple[Search, Composition]:
    """Search the seed's scope for its rule alone."""
    searched = scope(seed.scope)
    with patched(seed.patches):
        model = Composition(replace(searched, setting=seed.configured(searched.setting)), seed.rule)
        return explore(model), model
