"""Faults put into the rules on purpose: the search must find every one, and tell the shortest way to its harm.

A search that finds nothing proves nothing unless it can find something. Each seed is one small mistake that a person
could make in a table, a time or a function of supervisor, gate or bridge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

from fsai_hil.evidence.model import Composition, Scope, State, patched, swift_copies
from fsai_hil.evidence.scopes import scope
from fsai_hil.evidence.search import Search, explore
from fsai_vcu.core import bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision import gate as gating
from fsai_vcu.core.supervision import supervisor
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
from fsai_vcu.interface.enums import AsState, Direction, MissionStatus
from fsai_vcu.interface.images import VcuSteer

MS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Seed:
    """One mistake: where to look for its harm, the rule it breaks, and how it is made."""

    name: str
    rule: str
    scope: str
    patches: Callable[[], tuple[tuple[Any, str, object], ...]] = tuple
    config: Mapping[str, object] = field(default_factory=dict)


def _reaction(reason: Reason, *steps: Step) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    return lambda: ((supervisor, "REACTIONS", {**REACTIONS, reason: steps}),)


def _output(phase: Phase, **changes: object) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    row = replace(OUTPUT[phase], **changes)  # type: ignore[arg-type]
    return lambda: ((supervisor, "OUTPUT", {**OUTPUT, phase: row}),)


def _follows(before: Sequence, now: AsState, then: Sequence) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    return lambda: ((supervisor, "_NEXT", {**supervisor._NEXT, (before, now): then}),)


def _wrapped(owner: Any, name: str, change: Callable[..., Any]) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    """`owner.name` is called through `change(original, *arguments)`."""
    return lambda: ((owner, name, partial(change, getattr(owner, name))),)


def _always(owner: Any, name: str, value: object) -> Callable[[], tuple[tuple[Any, str, object], ...]]:
    return _wrapped(owner, name, lambda original, *arguments: value)


def _clears_latch(original: Callable[..., Any], config: Any, state: Any, status: Any) -> Any:
    after = original(config, state, status)
    return replace(after, emergency=None) if after.as_state is AsState.AS_OFF else after


def _any_reset(original: Callable[..., Any], config: Any, state: Any, now_ns: int) -> Any:
    return replace(state, emergency=None), True, "cleared"


def _only_fast(config: Any, state: Any, now_ns: int) -> bool:
    return state.speeds_ns is not None and state.fastest_rpm < config.standstill_rpm


def _believed_bit(original: Callable[..., Any], config: Any, state: Any, decision: Any, command: Any, vehicle: Any,
                  *rest: Any) -> Any:  # fmt: skip
    after, asked, reasons = original(config, state, decision, command, vehicle, *rest)
    bit = vehicle.handshake if vehicle.status is None else vehicle.status.handshake
    return after, replace(asked, handshake=bit), reasons


def _unlimited_steering(original: Callable[..., Any], config: Any, state: Any, decision: Any, command: Any,
                        vehicle: Any, now_ns: int) -> Any:  # fmt: skip
    return original(config, state, decision, command, replace(vehicle, steer=_FULL_ANGLE), now_ns)


def _forgets_the_live_limit(original: Callable[..., Any], config: Any, axle: Any, *rest: Any) -> Any:
    return original(config, None if axle is None else replace(axle, torque_max_nm=195.0), *rest)


def _gate_may_move(original: Callable[..., Any], config: Any, state: Any, decision: Any, *rest: Any) -> Any:
    return original(config, state, replace(decision, may_move=True), *rest)


_FULL_ANGLE: Final = VcuSteer(0.0, 30.0, 0.0)

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
    ),
    Seed(
        "autonomous is accepted in every state", "2", "run", lambda: ((supervisor, "IDLE_STATES", frozenset(AsState)),)
    ),
    Seed(
        "an unknown mode counts as autonomous",
        "2",
        "power-up",
        _wrapped(
            supervisor,
            "set_mode",
            lambda original, config, state, mode, now_ns: original(
                config, state, "autonomous" if mode == "sideways" else mode, now_ns
            ),
        ),
    ),
    # ---- rest
    Seed("one look at the wheels proves rest", "3", "run", lambda: ((supervisor, "standing", _only_fast),)),
    Seed("rest is proven after 400 ms", "3", "run", config={"standstill_ns": 400 * MS}),
    Seed("a wheel under 301 rpm stands", "3", "limits", config={"standstill_rpm": 301}),
    # ---- limits
    Seed("ANGLE_MAX is not looked at", "4", "limits", _wrapped(gating, "_steering", _unlimited_steering)),
    Seed("TRQ_MAX is not looked at", "4", "limits", _wrapped(gating, "_axle_limit_nm", _forgets_the_live_limit)),
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
    Seed("Go off is only reported", "reactions", "any car", _reaction(Reason.GO_OFF, Step(None, Consequence.REPORT))),
    Seed(
        "odd wheels never ask for the emergency",
        "reactions",
        "plausibility",
        _reaction(Reason.WHEEL_IMPLAUSIBLE, REACTIONS[Reason.WHEEL_IMPLAUSIBLE][0]),
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
    """Search the seed's scope: what was found, and its trace in words."""
    with swift_copies(), sown(seed) as searched:
        model = Composition(searched)
        found = explore(model, bounds_ns=searched.bounds_ns)
        return found, model.told(found.trace)
