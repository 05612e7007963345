"""The AS supervisor: what the AI side says in each AS state, and what it does when something breaks.

Pure: a `SupervisorState` goes in with what happened, a state comes out. `received` and `on_status` take frames of
0x520, `TAKES` those of other messages that are believed, `on_pulses` what 0x526 says of standing still,
`on_selected_sent` learns what went out; the requests are `set_mode`, `ask_emergency`, `reset` and `confirm`; `strike`
takes what happens at one instant. Once a cycle `supervise` looks at the clock and decides, in this order:

1. In AS_DRIVING, `_react`: what is wrong, and for how long (`_ages`); after how long what follows (`REACTIONS`). What
   was asked for comes last: manual mode, then an emergency brake or the end of the mission by the command.
2. `_phase`: where the run stands. The AS state decides first; in AS_DRIVING an emergency comes before a stop, a stop
   before the 3 s of standing still, and those before holding the torque back.
3. `OUTPUT`: the phase's row says mission status, direction, where steering and brake come from, whether torque may be.

What latches: a stop until the AS state changes (the first cause stays); an emergency until `reset` in AS_INIT or
AS_OFF, or a power cycle of the car (safety rule 6). A stop for a lost command also ends autonomous mode. Nothing else
latches: torque that is held back returns by itself with what was missing.

A drive needs what only the car's own life brings, in this order and seen by this process (safety rules 2 and 10):
AS_OFF, 5 s of AS_READY without Go, Go, AS_DRIVING (`NEXT`); and a mission that was acknowledged, with planner and
controller reset for it. Each entry into AS_OFF, and each change of the AMI, begins a run, which forgets that of the
last.

"Stale after T" means an age of T or more; an age of T - 1 ns is still in time. docs/supervision.md shows the tables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum, IntEnum, auto
from types import MappingProxyType
from typing import Annotated, Any

from msgspec import field
from msgspec.structs import replace

from fsai_vcu.core.ages import Ages, NoAge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig, Reason
from fsai_vcu.core.supervision.wheel_speeds import turning
from fsai_vcu.interface.enums import OFF_LIKE, Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import VcuStatus, WheelSpeeds
from fsai_vcu.interface.values import WORD_LENGTH, Value, shortened

IDLE_STATES = OFF_LIKE | {AsState.AS_READY}
"""AS states in which a mode may be chosen and the AMI is followed."""

ROLES = ("planner", "controller")


class Mode(Enum):
    """Driver of the car: nobody, or the planner through the gate."""

    MANUAL = "manual"
    AUTONOMOUS = "autonomous"


MODES = tuple(mode.value for mode in Mode)


class Sequence(IntEnum):
    """Part of AS_OFF -> AS_READY -> AS_DRIVING that this process has itself seen, without a break."""

    NONE = auto()
    OFF_SEEN = auto()
    READY_SEEN = auto()
    COMPLETE = auto()


NEXT: Mapping[tuple[Sequence, AsState], Sequence] = MappingProxyType(
    {
        (Sequence.OFF_SEEN, AsState.AS_READY): Sequence.READY_SEEN,
        (Sequence.READY_SEEN, AsState.AS_READY): Sequence.READY_SEEN,
        (Sequence.READY_SEEN, AsState.AS_DRIVING): Sequence.COMPLETE,
        (Sequence.COMPLETE, AsState.AS_DRIVING): Sequence.COMPLETE,
        **{(seen, state): Sequence.OFF_SEEN for seen in Sequence for state in OFF_LIKE},
    }
)
"""Every pair that is not here leads to NONE: the drive needs the whole sequence again."""


# ---------------------------------------------------------------- what is sent


class Phase(Enum):
    """Phase of a run, seen from the AI side. Each has one row in `OUTPUT`."""

    IDLE = "no AS state yet, AS_INIT or AS_OFF"
    READY = "AS_READY"
    LAUNCH_WAIT = "AS_DRIVING, standing still for the first 3 s"
    DRIVING = "AS_DRIVING, driving by command"
    HOLDING = "AS_DRIVING, torque 0 until the stale input is fresh again"
    STOPPING = "AS_DRIVING, stopping by the service brake"
    STOPPED = "AS_DRIVING, stopped"
    ESTOP_ASKED = "AS_DRIVING, emergency brake asked for"
    FINISHED = "AS_FINISHED"
    EMERGENCY_MOVING = "EMERGENCY_BRAKE, a wheel turns"
    EMERGENCY_STANDING = "EMERGENCY_BRAKE, standing"


class Steer(Enum):
    """Source of the steering request."""

    ZERO = auto()
    HELD = auto()
    COMMAND = auto()
    HELD_OR_COMMAND = auto()  # by command while the planner may still speak


class Brake(Enum):
    """Source of the brake request."""

    ZERO = auto()
    HOLDING = auto()
    COMMAND = auto()
    KEPT = auto()  # as in the cycle before: a stale command must not release a brake
    SERVICE = auto()


class Output(Value, frozen=True):
    """One row of the output table. `mission_status` None: SELECTED once the mission is acknowledged."""

    mission_status: MissionStatus | None
    direction: Direction
    steer: Steer
    brake: Brake
    torque: bool = False


OUTPUT: Mapping[Phase, Output] = MappingProxyType(
    {
        Phase.IDLE: Output(None, Direction.NEUTRAL, Steer.ZERO, Brake.ZERO),
        Phase.READY: Output(None, Direction.NEUTRAL, Steer.ZERO, Brake.HOLDING),
        Phase.LAUNCH_WAIT: Output(MissionStatus.RUNNING, Direction.FORWARD, Steer.ZERO, Brake.HOLDING),
        Phase.DRIVING: Output(MissionStatus.RUNNING, Direction.FORWARD, Steer.COMMAND, Brake.COMMAND, torque=True),
        Phase.HOLDING: Output(MissionStatus.RUNNING, Direction.FORWARD, Steer.HELD, Brake.KEPT),
        Phase.STOPPING: Output(MissionStatus.RUNNING, Direction.FORWARD, Steer.HELD_OR_COMMAND, Brake.SERVICE),
        Phase.STOPPED: Output(MissionStatus.FINISHED, Direction.NEUTRAL, Steer.HELD, Brake.HOLDING),
        Phase.ESTOP_ASKED: Output(MissionStatus.RUNNING, Direction.FORWARD, Steer.HELD, Brake.SERVICE),
        Phase.FINISHED: Output(MissionStatus.FINISHED, Direction.NEUTRAL, Steer.ZERO, Brake.HOLDING),
        Phase.EMERGENCY_MOVING: Output(MissionStatus.RUNNING, Direction.FORWARD, Steer.ZERO, Brake.ZERO),
        Phase.EMERGENCY_STANDING: Output(MissionStatus.RUNNING, Direction.NEUTRAL, Steer.ZERO, Brake.ZERO),
    }
)


# ---------------------------------------------------------------- what happens when something breaks


class Consequence(IntEnum):
    """Consequence of a fault, the graver the higher."""

    REPORT = auto()
    HOLD = auto()  # torque 0 while it lasts
    STOP = auto()  # service-brake stop, latched for this run
    STOP_MANUAL = auto()  # the same, and the mode becomes manual
    ESTOP = auto()  # ESTOP_REQUEST, latched


class Step(Value, frozen=True):
    """Step of a reaction: at an age of `after` (a time's name in BridgeConfig, None: at once), `consequence`."""

    after: str | None
    consequence: Consequence


CHANGES = (
    Reason.AS_SWITCH_OFF,
    Reason.TS_SWITCH_OFF,
    Reason.SHUTDOWN_REQUESTED,
    Reason.FAULT_BIT,
    Reason.SHUTDOWN_CAUSE,
    Reason.STATE_FAULT,
    Reason.AMI_CHANGED,
)
"""Reasons that name a change of 0x520 that AS_DRIVING must not see though FAULT_STATUS stays 0 (see `changes`)."""

UNPREPARED = (Reason.NOT_SEEN, Reason.SEQUENCE_SHORT, Reason.NO_MISSION, Reason.NOT_CONFIRMED)
"""Reasons that name what AS_DRIVING may lack of a drive that was begun in order (see `_unprepared`)."""

_STOP_AT_ONCE = (Step(None, Consequence.STOP),)
_FEEDBACK = (Step("feedback_stale_ns", Consequence.STOP), Step("feedback_lost_ns", Consequence.ESTOP))
_IMPLAUSIBLE = (Step("implausible_ns", Consequence.STOP), Step("implausible_lost_ns", Consequence.ESTOP))

REACTIONS: Mapping[Reason, tuple[Step, ...]] = MappingProxyType(
    {
        Reason.COMMAND_STALE: (
            Step("command_stale_ns", Consequence.HOLD),
            Step("command_lost_ns", Consequence.STOP_MANUAL),
        ),
        Reason.STOP_INEFFECTIVE: (Step(None, Consequence.ESTOP),),
        Reason.BOTH_PEDALS: (Step(None, Consequence.REPORT), Step("both_pedals_ns", Consequence.ESTOP)),
        Reason.VCU_SILENT: (Step("vcu_stale_ns", Consequence.HOLD), Step("vcu_lost_ns", Consequence.ESTOP)),
        Reason.WHEELS_STALE: _FEEDBACK,
        Reason.STEERING_STALE: _FEEDBACK,
        Reason.STEERING_IMPLAUSIBLE: _IMPLAUSIBLE,
        Reason.WHEEL_IMPLAUSIBLE: _IMPLAUSIBLE,
        Reason.GO_OFF: _STOP_AT_ONCE,
        Reason.FAULT_STATUS: _STOP_AT_ONCE,
        Reason.AS_STATE_UNKNOWN: (Step(None, Consequence.HOLD),),
        **dict.fromkeys(CHANGES, _STOP_AT_ONCE),
        Reason.INTRUDER: (Step(None, Consequence.ESTOP),),
        Reason.LOOP_FAULT: (Step(None, Consequence.ESTOP),),
        Reason.BUS_LOST: _STOP_AT_ONCE,
        Reason.BACKLOG: (Step("backlog_ns", Consequence.REPORT),),
        **dict.fromkeys(UNPREPARED, _STOP_AT_ONCE),
        Reason.STACK_RESTARTED: _STOP_AT_ONCE,
    }
)


class Asked(Enum):
    """A stop or an emergency brake that somebody asked for: nothing is broken."""

    MANUAL = "manual mode was asked for"
    MISSION_DONE = "mission complete: braking to a stop"
    OPERATOR = "the emergency brake was asked for"
    MISSION = "the mission or its controller asked for the emergency brake"
    SHUTDOWN = "this software was stopped"


STEERS_WHILE_STOPPING = frozenset(
    (
        Asked.MISSION_DONE,
        Reason.GO_OFF,
        Reason.FAULT_STATUS,
        *CHANGES,
        Reason.WHEELS_STALE,
        Reason.WHEEL_IMPLAUSIBLE,
    )
)
"""Stops in which the planner is not what failed, nor the steering: a curve is better followed than left."""


class Latch(Value, frozen=True):
    """A stop or an emergency, with its cause and since when."""

    cause: Reason | Asked
    since_ns: Annotated[int, Ages("stop_timeout_ns")]
    detail: str = ""

    @property
    def words(self) -> str:
        text = self.cause.words if isinstance(self.cause, Reason) else self.cause.value
        return f"{text}: {self.detail}" if self.detail else text


# ---------------------------------------------------------------- state


class SupervisorState(Value, frozen=True):
    """Everything that the supervisor remembers. Times are of the monotonic clock, None: never."""

    # Reported by 0x520
    as_state: AsState | None = None
    go: bool = False
    fault: bool = False
    status_ns: Annotated[int | None, Ages("vcu_stale_ns", "vcu_lost_ns")] = None  # the last 0x520 that was believed
    received_ns: Annotated[int | None, Ages(gap=("power_cycle_ns",))] = None  # the last 0x520 of any content
    was_silent: bool = False  # a power cycle's silence lies before the next believed 0x520
    doubted: bool = False  # the newest 0x520 is not believed
    known_again_ns: Annotated[int | None, Ages("as_state_known_ns")] = None  # the first one believed after that
    sequence: Sequence = Sequence.NONE
    ready_since_ns: Annotated[int | None, Ages("ready_wait_ns")] = None
    # From the first AS_READY to the last one in which Go was off, kept in AS_DRIVING
    ready_waited_ns: Annotated[int, NoAge("a duration: long enough or not")] = 0
    driving_since_ns: Annotated[
        int | None,
        Ages("launch_wait_ns", "launch_wait_ns + command_stale_ns", "launch_wait_ns + command_lost_ns"),
    ] = None

    # Reported by 0x525, and by 0x526 of the wheels' turning (see wheel_speeds.Pulses)
    speeds_ns: Annotated[
        int | None, Ages("feedback_stale_ns", "feedback_lost_ns", gap=("feedback_stale_ns", "wheel_jump_ns"))
    ] = None
    fastest_rpm: int = 0
    still_since_ns: Annotated[int | None, Ages("standstill_ns")] = None
    turning_ns: Annotated[int | None, Ages("standstill_ns")] = None

    # The run
    run_id: int = 1
    mission: Ami = Ami.NOT_SELECTED
    confirmed: frozenset[str] = frozenset()
    selected_sent: bool = False  # a cycle with SELECTED has gone out whole in this run

    # Mode and latches
    mode: Mode = Mode.MANUAL
    power_up: bool = True  # autonomous_at_power_up has not acted since the car was switched on
    stop: Latch | None = None
    emergency: Latch | None = None
    # Where the window began over which a deceleration must show
    stop_window_ns: Annotated[int, Ages("stop_window_ns")] = 0
    stop_window_rpm: int | None = None  # None: not measured yet
    both_pedals_since_ns: Annotated[int | None, Ages("both_pedals_ns")] = None
    # The first cycle without a fresh command; None: the last one had one
    command_stale_since_ns: Annotated[int | None, Ages("command_lost_ns")] = None

    @property
    def is_confirmed(self) -> bool:
        return len(self.confirmed) == len(ROLES)

    @property
    def driving(self) -> bool:
        return self.as_state is AsState.AS_DRIVING


class Inputs(Value, frozen=True):
    """Inputs of a cycle besides the state: the clock, the command slot, and the plausibility checks' verdicts."""

    now_ns: int
    command: VehicleCommand | None = None
    command_ns: int = 0  # when it was handed in
    steer_ns: int | None = None  # the last 0x523
    steer_implausible_since_ns: int | None = None
    wheel_implausible_since_ns: int | None = None
    wheel_detail: str = ""
    status_doubt: str = ""  # why the newest 0x520 is none that is known
    speeds_doubt: str = ""  # why the newest 0x525 was not believed


class Decision(Value, frozen=True):
    """Decision on what this cycle is to say; the gate turns it into values. The default is safe."""

    phase: Phase = Phase.IDLE
    mission_status: MissionStatus = MissionStatus.NOT_SELECTED
    direction: Direction = Direction.NEUTRAL
    estop: bool = False
    steer: Steer = Steer.ZERO
    brake: Brake = Brake.ZERO
    torque: bool = False
    run_id: int = 0
    may_move: bool = False
    reasons: frozenset[Reason] = field(default_factory=frozenset)
    details: tuple[tuple[Reason, str], ...] = ()  # of the same reasons


# ---------------------------------------------------------------- frames


def received(config: BridgeConfig, state: SupervisorState, t_ns: int) -> SupervisorState:
    """A frame of 0x520 came that is not believed: the car is switched on, and its state is not known."""
    return replace(state, received_ns=t_ns, was_silent=_was_silent(config, state, t_ns), doubted=True)


def _was_silent(config: BridgeConfig, state: SupervisorState, now_ns: int) -> bool:
    """Return true where the car has been silent for a power cycle's time since it was last believed."""
    return state.was_silent or (state.received_ns is not None and now_ns - state.received_ns >= config.power_cycle_ns)


def on_status(config: BridgeConfig, state: SupervisorState, status: VcuStatus) -> SupervisorState:
    """A believed 0x520. Follows the AS states, the AMI and the runs; clears what the car's own life clears."""
    t_ns = status.t_rx_ns
    now, before = status.as_state, state.as_state
    off = now in OFF_LIKE
    power_cycle = _was_silent(config, state, t_ns)
    anew = power_cycle or now is not before

    # A power cycle breaks the sequence even if the state is the same before and after.
    seen = Sequence.NONE if power_cycle else state.sequence
    sequence = NEXT.get((seen, now), Sequence.NONE)

    run_id, mission, confirmed, selected_sent = state.run_id, state.mission, state.confirmed, state.selected_sent
    entered_off = off and before is not None and (before not in OFF_LIKE or power_cycle)
    ami_changed = status.ami is not mission and (now in IDLE_STATES or before is None)
    if entered_off or ami_changed:
        run_id, mission, confirmed, selected_sent = run_id + 1, status.ami, frozenset(), False
    elif anew and status.ami is not mission:
        sequence = Sequence.NONE  # the car enters AS_DRIVING for another mission than was acknowledged

    driving, ready = now is AsState.AS_DRIVING, now is AsState.AS_READY
    ready_since_ns = (t_ns if anew else state.ready_since_ns) if ready else None
    waited_ns = state.ready_waited_ns if driving or not anew else 0
    if ready_since_ns is not None and not status.go_signal:
        waited_ns = t_ns - ready_since_ns
    return replace(
        state,
        as_state=now,
        go=status.go_signal,
        fault=status.fault,
        status_ns=t_ns,
        received_ns=t_ns,
        was_silent=False,
        doubted=False,
        known_again_ns=t_ns if state.doubted else state.known_again_ns,
        sequence=sequence,
        ready_since_ns=ready_since_ns,
        ready_waited_ns=waited_ns,
        driving_since_ns=(t_ns if anew else state.driving_since_ns) if driving else None,
        run_id=run_id,
        mission=mission,
        confirmed=confirmed,
        selected_sent=selected_sent,
        power_up=state.power_up or power_cycle,
        stop=None if anew else state.stop,
        emergency=None if power_cycle and off else state.emergency,
        both_pedals_since_ns=state.both_pedals_since_ns if driving else None,
        command_stale_since_ns=state.command_stale_since_ns if driving else None,
    )


def on_speeds(config: BridgeConfig, state: SupervisorState, speeds: WheelSpeeds) -> SupervisorState:
    """A frame of 0x525 that is believed. Standing still must be seen without a gap."""
    t_ns = speeds.t_rx_ns
    fastest = max(speeds.all_rpm)
    still_since = state.still_since_ns
    if fastest >= config.standstill_rpm:
        still_since = None
    elif still_since is None or not wheels_fresh(config, state, t_ns):
        still_since = t_ns
    return replace(state, speeds_ns=t_ns, fastest_rpm=fastest, still_since_ns=still_since)


TAKES: Mapping[type, Callable[[BridgeConfig, SupervisorState, Any], SupervisorState]] = MappingProxyType(
    {WheelSpeeds: on_speeds}
)
"""Messages of the car that are taken in as they come, once they are believed; `on_status` needs more than that."""


def on_pulses(state: SupervisorState, turning_ns: int | None) -> SupervisorState:
    """A frame of 0x526: when, by the pulse counts, a wheel last turned."""
    return state if turning_ns == state.turning_ns else replace(state, turning_ns=turning_ns)


def on_selected_sent(state: SupervisorState, run_id: int) -> SupervisorState:
    """A cycle of run `run_id` with SELECTED went out whole: the mission is acknowledged."""
    return state if state.selected_sent or run_id != state.run_id else replace(state, selected_sent=True)


def wheels_fresh(config: BridgeConfig, state: SupervisorState, now_ns: int) -> bool:
    return state.speeds_ns is not None and now_ns - state.speeds_ns < config.feedback_stale_ns


def standing(config: BridgeConfig, state: SupervisorState, now_ns: int) -> bool:
    """All four wheel speeds are fresh and have been seen under 10 rpm for 0.5 s (safety rule 3); so have the counts."""
    return (
        state.speeds_ns is not None
        and state.still_since_ns is not None
        and now_ns - state.speeds_ns < config.feedback_stale_ns
        and state.speeds_ns - state.still_since_ns >= config.standstill_ns
        and not turning(config.standstill_ns, state.turning_ns, now_ns)
    )


def vcu_lost(config: BridgeConfig, state: SupervisorState, now_ns: int) -> bool:
    """No believed 0x520 for so long that the last AS state seen says nothing about now."""
    return state.status_ns is None or now_ns - state.status_ns >= config.vcu_lost_ns


# ---------------------------------------------------------------- requests


def _state_name(state: SupervisorState) -> str:
    assert state.as_state is not None  # every 0x520 that is believed has one
    return state.as_state.label


def _unknown_state(config: BridgeConfig, state: SupervisorState, now_ns: int) -> str | None:
    """Say why nobody can know the AS state now; None if it is known."""
    if state.status_ns is None:
        return "the car has not reported its AS state yet (no 0x520)"
    if vcu_lost(config, state, now_ns):
        return (
            f"the car is silent: the last 0x520 ({_state_name(state)}) is {(now_ns - state.status_ns) / 1e9:.1f} s old"
        )
    return None


def set_mode(config: BridgeConfig, state: SupervisorState, mode: str, now_ns: int) -> tuple[SupervisorState, bool, str]:
    """Choose the mode: manual at any time, autonomous only where the car cannot launch at once, or is so already."""
    if mode == Mode.MANUAL.value:
        return (
            replace(state, mode=Mode.MANUAL, power_up=False),
            True,
            "mode is manual" + (": the car is being stopped" if state.driving else ""),
        )
    if mode != Mode.AUTONOMOUS.value:
        return state, False, f"unknown mode {shortened(mode, WORD_LENGTH)!r}: the modes are {', '.join(MODES)}"
    if config.listen_only:
        return state, False, "autonomous refused: this process only listens (listen_only)"
    latched = "" if state.emergency is None else f", but the emergency brake is latched because {state.emergency.words}"
    if state.mode is Mode.AUTONOMOUS:
        stop = "" if state.stop is None or latched else f", but the car is being stopped because {state.stop.words}"
        return replace(state, power_up=False), True, f"mode is autonomous already{latched}{stop}"
    unknown = _unknown_state(config, state, now_ns)
    if unknown is not None:
        return state, False, f"autonomous refused: {unknown}"
    if state.as_state not in IDLE_STATES:
        return (
            state,
            False,
            f"autonomous refused in {_state_name(state)}: accepted in AS_INIT, AS_OFF and AS_READY only",
        )
    return replace(state, mode=Mode.AUTONOMOUS, power_up=False), True, f"mode is autonomous{latched}"


def confirm(state: SupervisorState, role: str, run_id: int) -> SupervisorState:
    """`role` has forgotten everything before run `run_id`. Another run's confirmation says nothing.

    Each says so once for a run: a role that says it again is a new process, and after a restart of any process the car
    does not resume driving (safety rule 10).
    """
    if role not in ROLES or run_id != state.run_id:
        return state
    if role in state.confirmed and state.driving:
        assert state.status_ns is not None  # AS_DRIVING was seen
        state = strike(state, Reason.STACK_RESTARTED, role, state.status_ns)
    return replace(state, confirmed=state.confirmed | {role})


def ask_emergency(state: SupervisorState, cause: Reason | Asked, detail: str, now_ns: int) -> SupervisorState:
    """Latch ESTOP_REQUEST. The first cause stays (safety rule 6)."""
    if state.emergency is not None:
        return state
    return replace(state, emergency=Latch(cause, now_ns, detail))


def reset(config: BridgeConfig, state: SupervisorState, now_ns: int) -> tuple[SupervisorState, bool, str]:
    """Clear the emergency latch: in AS_INIT and AS_OFF only (safety rule 6)."""
    unknown = _unknown_state(config, state, now_ns)
    if unknown is not None:
        return state, False, f"reset refused: {unknown}"
    if state.as_state not in OFF_LIKE:
        return state, False, f"reset refused in {_state_name(state)}: accepted in AS_INIT and AS_OFF only"
    if state.emergency is None:
        return state, True, "nothing was latched"
    return replace(state, emergency=None), True, f"cleared the emergency brake latched because {state.emergency.words}"


# ---------------------------------------------------------------- reactions


def _begin_stop(state: SupervisorState, cause: Reason | Asked, detail: str, now_ns: int) -> SupervisorState:
    if state.stop is not None:
        return state
    return replace(state, stop=Latch(cause, now_ns, detail), stop_window_rpm=None)


def _apply(
    state: SupervisorState, reason: Reason, consequence: Consequence, detail: str, now_ns: int
) -> SupervisorState:
    """Latch what `consequence` latches."""
    if consequence is Consequence.ESTOP:
        return ask_emergency(state, reason, detail, now_ns)
    if consequence >= Consequence.STOP:
        if consequence is Consequence.STOP_MANUAL:
            state = replace(state, mode=Mode.MANUAL)
        return _begin_stop(state, reason, detail, now_ns)
    return state


def strike(state: SupervisorState, reason: Reason, detail: str, now_ns: int) -> SupervisorState:
    """Something that happens at one instant: an intruder, a fault of the loop, the loss of the bus.

    Automatic reactions act only while the last AS state seen was AS_DRIVING.
    """
    if not state.driving:
        return state
    for step in REACTIONS[reason]:
        state = _apply(state, reason, step.consequence, detail, now_ns)
    return state


def bus_lost(config: BridgeConfig, state: SupervisorState, detail: str, now_ns: int) -> SupervisorState:
    """The bus is gone: whatever follows, the drive needs the whole sequence again."""
    silent = _was_silent(config, state, now_ns)
    return replace(strike(state, Reason.BUS_LOST, detail, now_ns), sequence=Sequence.NONE, was_silent=silent)


def bus_back(state: SupervisorState, now_ns: int) -> SupervisorState:
    """The bus is open again. While it was lost nothing could be received or sent: that time is no silence of
    the car's (an emergency asked for meanwhile has not even been sent), no missing feedback, and no part of a stop.
    """
    return replace(
        state,
        received_ns=None if state.received_ns is None else now_ns,
        driving_since_ns=now_ns if state.driving else None,
        stop=None if state.stop is None else replace(state.stop, since_ns=now_ns),
        stop_window_rpm=None,
    )


def valid_command(config: BridgeConfig, state: SupervisorState, inputs: Inputs) -> VehicleCommand | None:
    """The command in the slot if it may still be obeyed: of this run, and neither it nor its data too old."""
    command = inputs.command
    if (
        command is None
        or command.run_id != state.run_id
        or inputs.now_ns - inputs.command_ns >= config.command_stale_ns
        or inputs.now_ns - command.t_sensor_ns >= config.sensor_stale_ns
    ):
        return None
    return command


def _command_age_ns(config: BridgeConfig, state: SupervisorState, inputs: Inputs, supervised_ns: int) -> int:
    """Return for how long (ns) there has been no new command; data of 500 ms ages like a command of 100 ms.

    A stale command counts on until a cycle has a fresh one, however regularly others on old data come.
    """
    age_ns = supervised_ns
    command = inputs.command
    if command is not None and command.run_id == state.run_id:
        data_allowance_ns = config.sensor_stale_ns - config.command_stale_ns
        data_ns = inputs.now_ns - command.t_sensor_ns - data_allowance_ns
        age_ns = min(age_ns, max(inputs.now_ns - inputs.command_ns, data_ns))
    if age_ns >= config.command_stale_ns and state.command_stale_since_ns is not None:
        age_ns = max(age_ns, inputs.now_ns - state.command_stale_since_ns)
    return age_ns


def _command_age_words(config: BridgeConfig, state: SupervisorState, inputs: Inputs) -> str:
    """Say in words what makes the command stale."""
    command = inputs.command
    if command is None or command.run_id != state.run_id:
        return f"no command has come in run {state.run_id}"
    silent_ns, data_ns = inputs.now_ns - inputs.command_ns, inputs.now_ns - command.t_sensor_ns
    if silent_ns >= config.command_stale_ns:
        return f"no command for {silent_ns / 1e6:.0f} ms"
    return f"commands keep coming, but the data behind them is {data_ns / 1e6:.0f} ms old"


def _unprepared(config: BridgeConfig, state: SupervisorState) -> tuple[Reason, str] | None:
    """Return what this AS_DRIVING lacks of a drive that was begun in order (safety rule 2); None: nothing."""
    if state.sequence is not Sequence.COMPLETE:
        return Reason.NOT_SEEN, ""
    if state.ready_waited_ns < config.ready_wait_ns and not config.short_sequence_allowed:
        waited_s = state.ready_waited_ns / 1e9
        return Reason.SEQUENCE_SHORT, f"AS_DRIVING, but the car was in AS_READY with Go off for only {waited_s:.2f} s"
    if state.mission is Ami.NOT_SELECTED:
        return Reason.NO_MISSION, "none is chosen on the AMI"
    if not state.is_confirmed:
        missing = " and ".join(role for role in ROLES if role not in state.confirmed)
        return Reason.NOT_CONFIRMED, f"run {state.run_id} by the {missing}"
    if not state.selected_sent:
        return Reason.NO_MISSION, f"SELECTED was not sent for {state.mission.label}"
    return None


def _stop_ineffective(
    config: BridgeConfig, state: SupervisorState, stop: Latch, now_ns: int
) -> tuple[SupervisorState, bool]:
    """Return the state, and whether a service-brake stop does not work.

    It moves the window over which a deceleration must show.
    """
    fresh = wheels_fresh(config, state, now_ns)
    if fresh and state.fastest_rpm < config.standstill_rpm:
        return state, False
    if now_ns - stop.since_ns >= config.stop_timeout_ns:
        return state, True  # still moving, or nobody can say that it stands
    if not fresh:
        return state, False
    if state.stop_window_rpm is not None:
        if now_ns - state.stop_window_ns < config.stop_window_ns:
            return state, False
        if state.fastest_rpm > state.stop_window_rpm - config.stop_min_drop_rpm:
            return state, True
    return replace(state, stop_window_ns=now_ns, stop_window_rpm=state.fastest_rpm), False


_AT_ONCE_NS = 0
"""The age of what has no time: its only step waits for nothing."""


def _ages(
    config: BridgeConfig, state: SupervisorState, inputs: Inputs, command: VehicleCommand | None
) -> tuple[SupervisorState, list[tuple[Reason, int, str]]]:
    """List what is wrong in AS_DRIVING, for how long, and the details. `command` is a valid one."""
    now_ns = inputs.now_ns
    found: list[tuple[Reason, int, str]] = []
    assert state.status_ns is not None and state.driving_since_ns is not None  # AS_DRIVING was seen
    supervised_ns = now_ns - state.driving_since_ns - config.launch_wait_ns
    running = state.stop is None

    found.append((Reason.VCU_SILENT, now_ns - state.status_ns, ""))
    if state.doubted:
        found.append((Reason.AS_STATE_UNKNOWN, _AT_ONCE_NS, inputs.status_doubt))
    elif state.known_again_ns is not None and now_ns - state.known_again_ns < config.as_state_known_ns:
        words = f"known again for {(now_ns - state.known_again_ns) / 1e6:.0f} ms"
        found.append((Reason.AS_STATE_UNKNOWN, _AT_ONCE_NS, words))
    if running and (lack := _unprepared(config, state)) is not None:
        found.append((lack[0], _AT_ONCE_NS, lack[1]))
    if not state.go:
        found.append((Reason.GO_OFF, _AT_ONCE_NS, ""))
    if state.fault:
        found.append((Reason.FAULT_STATUS, _AT_ONCE_NS, ""))

    if state.stop is not None:
        state, ineffective = _stop_ineffective(config, state, state.stop, now_ns)
        if ineffective:
            found.append((Reason.STOP_INEFFECTIVE, _AT_ONCE_NS, f"{state.fastest_rpm} rpm"))

    if supervised_ns < 0:
        return state, found

    autonomous = state.mode is Mode.AUTONOMOUS
    if autonomous and running:
        age_ns = _command_age_ns(config, state, inputs, supervised_ns)
        found.append((Reason.COMMAND_STALE, age_ns, _command_age_words(config, state, inputs)))
        stale_since = state.command_stale_since_ns
        if age_ns < config.command_stale_ns:
            stale_since = None
        elif stale_since is None:
            stale_since = now_ns
        both_since = state.both_pedals_since_ns
        if command is not None and command.throttle > 0.0 and command.brake > 0.0:
            if both_since is None:
                both_since = max(inputs.command_ns, now_ns - supervised_ns)
            found.append((Reason.BOTH_PEDALS, now_ns - both_since, ""))
        else:
            both_since = None
        state = replace(state, both_pedals_since_ns=both_since, command_stale_since_ns=stale_since)

    # A message that never came is as old as it takes.
    never_ns = config.feedback_lost_ns
    speeds_age_ns = never_ns if state.speeds_ns is None else now_ns - state.speeds_ns
    found.append((Reason.WHEELS_STALE, speeds_age_ns, inputs.speeds_doubt))
    found.append((Reason.STEERING_STALE, never_ns if inputs.steer_ns is None else now_ns - inputs.steer_ns, ""))
    if inputs.steer_implausible_since_ns is not None:
        found.append((Reason.STEERING_IMPLAUSIBLE, now_ns - inputs.steer_implausible_since_ns, ""))
    if inputs.wheel_implausible_since_ns is not None:
        found.append((Reason.WHEEL_IMPLAUSIBLE, now_ns - inputs.wheel_implausible_since_ns, inputs.wheel_detail))
    return state, found


def _react(
    config: BridgeConfig, state: SupervisorState, inputs: Inputs, command: VehicleCommand | None
) -> tuple[SupervisorState, bool, dict[Reason, str]]:
    """Everything that the clock and the car's words ask for in AS_DRIVING: state, torque held back, reasons."""
    now_ns = inputs.now_ns
    state, found = _ages(config, state, inputs, command)
    hold = command is None
    reasons: dict[Reason, str] = {}
    for reason, age_ns, detail in found:
        for step in REACTIONS[reason]:
            if step.after is None or age_ns >= getattr(config, step.after):
                reasons[reason] = detail
                hold = hold or step.consequence is Consequence.HOLD
                state = _apply(state, reason, step.consequence, detail, now_ns)

    if state.mode is Mode.MANUAL:
        return _begin_stop(state, Asked.MANUAL, "", now_ns), hold, reasons
    if command is not None:
        if command.estop_request:
            state = ask_emergency(state, Asked.MISSION, command.note, now_ns)
        if command.mission_finished and may_move(config, state, now_ns):
            state = _begin_stop(state, Asked.MISSION_DONE, "", now_ns)
    return state, hold, reasons


def may_move(config: BridgeConfig, state: SupervisorState, now_ns: int) -> bool:
    """AS_DRIVING has lasted the 3 s in which the car must stand still."""
    return state.driving_since_ns is not None and now_ns - state.driving_since_ns >= config.launch_wait_ns


def _phase(config: BridgeConfig, state: SupervisorState, hold: bool, now_ns: int) -> Phase:
    """Return the phase of the run; `hold` says that torque is held back."""
    now = state.as_state
    if now is None or now in OFF_LIKE:
        return Phase.IDLE
    if now is AsState.AS_READY:
        return Phase.READY
    if now is AsState.AS_FINISHED:
        return Phase.FINISHED
    if now is AsState.EMERGENCY_BRAKE:
        return Phase.EMERGENCY_STANDING if standing(config, state, now_ns) else Phase.EMERGENCY_MOVING
    if state.emergency is not None:
        return Phase.ESTOP_ASKED
    if state.stop is not None:
        return Phase.STOPPED if standing(config, state, now_ns) else Phase.STOPPING
    if not may_move(config, state, now_ns):
        return Phase.LAUNCH_WAIT
    return Phase.HOLDING if hold else Phase.DRIVING


def acknowledged(state: SupervisorState) -> bool:
    """Return true where SELECTED may be sent in this AS state.

    With an emergency latched it is not sent in AS_OFF: the car would come as far as AS_DRIVING only to brake.
    """
    chosen = state.mission is not Ami.NOT_SELECTED and state.is_confirmed
    if state.as_state is AsState.AS_READY:
        return chosen
    return chosen and state.mode is Mode.AUTONOMOUS and state.emergency is None


def supervise(config: BridgeConfig, state: SupervisorState, inputs: Inputs) -> tuple[SupervisorState, Decision]:
    """Supervise one cycle: what has become of the run by now, and what is to be sent."""
    now_ns = inputs.now_ns
    hold = True
    reasons: dict[Reason, str] = {}
    command = valid_command(config, state, inputs)
    if state.driving:
        state, hold, reasons = _react(config, state, inputs, command)
    elif (
        config.autonomous_at_power_up
        and state.power_up
        and state.as_state in OFF_LIKE
        and not config.listen_only
        and standing(config, state, now_ns)
    ):
        state = replace(state, mode=Mode.AUTONOMOUS, power_up=False)

    phase = _phase(config, state, hold, now_ns)
    row = OUTPUT[phase]
    mission_status = row.mission_status
    if mission_status is None:
        mission_status = MissionStatus.SELECTED if acknowledged(state) else MissionStatus.NOT_SELECTED
    steer = row.steer
    if steer is Steer.HELD_OR_COMMAND:
        assert state.stop is not None  # this phase is a stop
        speaks = command is not None and state.mode is Mode.AUTONOMOUS and may_move(config, state, now_ns)
        steer = Steer.COMMAND if speaks and state.stop.cause in STEERS_WHILE_STOPPING else Steer.HELD
    return state, Decision(
        phase,
        mission_status,
        row.direction,
        state.emergency is not None,
        steer,
        row.brake,
        row.torque,
        state.run_id,
        may_move(config, state, now_ns),
        frozenset(reasons),
        tuple(reasons.items()),
    )


def begin_end(config: BridgeConfig, state: SupervisorState, now_ns: int) -> SupervisorState:
    """The software is being stopped: moving, the car is left to its emergency brake; at rest the run simply ends."""
    if not state.driving:
        return state
    if standing(config, state, now_ns):
        return _begin_stop(state, Asked.SHUTDOWN, "", now_ns)
    return ask_emergency(
        state, Asked.SHUTDOWN, "the car was in AS_DRIVING, and its standstill was not confirmed", now_ns
    )


def ending(decision: Decision) -> Decision:
    """Return the decision of the last cycles before the silence: with NEUTRAL, zeros and no acknowledged mission."""
    if decision.direction is not Direction.NEUTRAL:
        return decision
    acknowledging = OUTPUT[decision.phase].mission_status is None
    status = MissionStatus.NOT_SELECTED if acknowledging else decision.mission_status
    return replace(decision, mission_status=status, steer=Steer.ZERO, brake=Brake.ZERO)
