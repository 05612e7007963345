"""The bridge, composed with the VCU's state machine and the checker of the rules, as one thing that can be searched.

What runs is the real code: a `Bridge` with its supervisor and gate, and the VCU's transition table of `as_machine`.
This module saves its state, puts it back, and says what the environment may do. What stands in for something:

- the codec hands images on as they are (each command is encoded by the real one, once per different command);
- odometry is left out: it fills a logging field;
- the plausibility checks' verdicts are the environment's choice: a mistake inside a check (a wheel's factor in a curve,
  for how long torque explains a wheel that spins) shows nothing here;
- so is whether a wheel turns by the pulse counts, which are not sent: what they say of a wheel speed shows in nothing
  but that it is not believed, and speeds that may not be believed are sent;
- wheels may change their speed from one cycle to the next: more than any car can do.

Time. A state holds ages, not times, and an age is rounded down to the nearest point that the rules can tell apart:
0, and T - 1 ns and T of every timer that looks at it. One move is one cycle of 10 ms under one choice of the
environment. Where that changes nothing, waiting is what matters: then the move waits until the next timer has run for
T - 1 ns, or for T, with the same choice kept up all the while. So all timers run as they do on the car, the cycle at
T - 1 ns and the one at T are both made, and what happens at an age in between counts as happening right after the
last edge before it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import chain
from operator import attrgetter
from typing import Any, Final, cast

from msgspec import field
from msgspec.structs import replace

from fsai_hil.evidence.abstraction import (
    CLOCKS,
    NEVER,
    NOW,
    Abstraction,
    Content,
    PlainCodec,
    brake_frame,
    car_frame,
    status_frame,
    unreadable_frame,
)
from fsai_hil.evidence.search import Move
from fsai_hil.rules.checker import WireChecker
from fsai_hil.rules.numbers import BACKLOG_NS, CAR_PATIENCE_NS, CYCLE_NS, MS, S
from fsai_hil.rules.seen import EDGES, Violation
from fsai_hil.simulator.as_machine import Situation, Table, taken, transition_table
from fsai_hil.simulator.profiles import SPECIFICATION, Profile
from fsai_hil.simulator.watched_bridge import WatchedBridge, process_of
from fsai_vcu.core.bridge import Bridge, BridgeConfig, BridgeState
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.supervision import supervisor
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck
from fsai_vcu.core.supervision.wheel_speeds import Pulses
from fsai_vcu.core.vehicle.odometry import OdometryState
from fsai_vcu.core.vehicle.parameters import CARS, VehicleParameters
from fsai_vcu.interface.codec import Codec, EncodeError, codec_of
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiCommand, AiImage, VcuDriveFront, VcuDriveRear, VcuSteer, WheelSpeeds
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.values import Value

LEFT_OUT: Final = (
    "whether the plausibility checks find what they should: the model of the steering, each wheel's factor in a curve, "
    "what explains slip and for how long (tests of their own; what is far off, the campaign)",
    "what pulse counts say of a wheel speed (the fuzz, the campaign)",
    "what the codec reads of a frame's bytes (tests of its own, the fuzz, the campaign)",
    "odometry, and words for people",
)
"""The parts in which a mistake leaves no trace in this search, and what looks at them instead."""

STATUS, SPEEDS, STEER, AXLES, BRAKE = "0x520", "0x525", "0x523", "0x521/2", "0x524"
CAR_MESSAGES: Final = (STATUS, SPEEDS, STEER, AXLES, BRAKE)


# ---------------------------------------------------------------- what the environment may choose

_NO_COMMAND = "none"
BOTH: Final = frozenset(("planner", "controller"))
_THIS_RUN, _OTHER_RUN = 0, -1


class Ask(Value, frozen=True):
    """A command as the searched controller sends it."""

    fields: Mapping[str, Any]
    data_age_ns: int = 0
    run: int = _THIS_RUN


_LEFT = math.radians(20.0)
_DRIVES: Final = {"steering_rad": _LEFT, "throttle": 0.123}  # no share of it is whole tenths of Nm
COMMANDS: Final[Mapping[str, Ask]] = {
    "drive": Ask(_DRIVES),
    "drive right": Ask({"steering_rad": -_LEFT, "throttle": 1.0}),
    "coast": Ask({}),
    "brake": Ask({"steering_rad": _LEFT, "brake": 0.4}),
    "both": Ask(_DRIVES | {"brake": 0.4}),
    "finished": Ask(_DRIVES | {"mission_finished": True}),
    "estop": Ask(_DRIVES | {"estop_request": True}),
    "old": Ask(_DRIVES, 500 * MS - 1),
    "too old": Ask(_DRIVES, 500 * MS),
    "far too old": Ask(_DRIVES, 700 * MS),
    "future": Ask(_DRIVES, -21 * MS),
    "other run": Ask(_DRIVES, run=_OTHER_RUN),
    "nan": Ask(_DRIVES | {"steering_rad": math.nan}),
    "infinite": Ask(_DRIVES | {"throttle": math.inf}),
    "beyond": Ask(_DRIVES | {"throttle": 1.5}),
    "negative": Ask(_DRIVES | {"brake": -0.1}),
    "beyond steering": Ask(_DRIVES | {"steering_rad": math.radians(31.0)}),
}


class Choice(Value, frozen=True):
    """The environment's part of one cycle. The defaults: a car that is well and at rest, a planner that drives."""

    command: str = "drive"
    lost: frozenset[str] = frozenset()  # messages of the car that do not come
    unreadable: bool = False  # 0x520 comes, but its AS_STATE is none
    marks: frozenset[str] = frozenset()  # of MARKS: what 0x520 shows besides, FAULT_STATUS stays 0
    counting: bool = False  # a wheel turns by the pulse counts
    rpm: tuple[int, int, int, int] = (0, 0, 0, 0)
    go: bool = False
    asms: bool = True
    tsms: bool = True
    sdc_open: bool = False
    ami: Ami = Ami.TRACKDRIVE
    car_off: bool = False
    says: AsState | None = None  # whatever the VCU's state machine thinks
    fault: bool = False
    angle_max_deg: float = 30.0
    torque_max_nm: float = 195.0
    request: str | None = None
    confirm: frozenset[str] = BOTH  # who says that he has reset himself
    confirm_other: frozenset[str] = frozenset()  # who says so of another run
    frames: int = 5  # how many of the cycle's five frames go out
    event: str | None = None
    steer_odd: bool = False
    wheel_odd: bool = False

    @property
    def words(self) -> str:
        """Name what is out of the ordinary in it, by the names above."""
        given = zip(self.__struct_fields__, self.__struct_defaults__, strict=True)
        chosen = {name: value for name, default in given if (value := getattr(self, name)) != default}
        return "; ".join(f"{name} {_plain(value)}" for name, value in chosen.items()) or "nothing out of the ordinary"


def _plain(value: object) -> str:
    match value:
        case Enum():
            return value.name
        case frozenset():
            return ", ".join(sorted(value)) or "nobody"
        case tuple():
            return "/".join(map(str, value))
    return str(value)


class Setting(Value, frozen=True):
    """The subject of a search: the configuration of the AI side and the car at the other end."""

    config: BridgeConfig = field(default_factory=lambda: BridgeConfig(steer_rate_degps=1500.0))
    revision: str = "2026"
    car: VehicleParameters = CARS["2026"]
    profile: Profile = SPECIFICATION
    first_state: AsState = AsState.AS_INIT
    limits: OperationalLimits = field(default_factory=lambda: OperationalLimits(8.0, 120.0, 12.0))

    @property
    def codec(self) -> Codec:
        return codec_of(revision(self.revision))

    def checker(self, **process: Any) -> WireChecker:
        """The checker of the rules at the sender's own place; `process`: what else it knows of the configuration."""
        config = self.config
        return WireChecker(
            self.codec,
            in_flight_ns=0,
            handshake_in_flight_ns=0,
            clock_slack_ns=0,
            car=self.car,
            limits=self.limits,
            steer_rate_degps=config.steer_rate_degps,
            from_start=True,
            motor_brakes=config.motor_brakes,
            short_sequence=config.short_sequence_allowed,
            process=process_of(config, **process),
        )


# ---------------------------------------------------------------- the clocks


_OTHER_EDGES: Final = ((5 * S, 15 * S), (100 * MS,), (100 * MS,), *EDGES)
"""The ages at which the VCU's three times and the checker's matter, in the order of `Composition._save`."""

_LISTENING_CLOCK: Final = CLOCKS.index("listening_since_ns")
_DRIVING_CLOCK: Final = CLOCKS.index("driving_since_ns")
_READY_NS: Final = 5 * S


# ---------------------------------------------------------------- what stands in for the rest of the world


class SearchedBridge(WatchedBridge):
    """The bridge, whose plausibility checks say what the environment wants."""

    steer_odd = False
    wheel_odd = False

    def on_frame(self, frame: Frame) -> None:
        """Take in a frame that has an image and no bytes; the checker is given it decoded."""
        Bridge.on_frame(self, frame)

    def _on_revision(self, frame: Frame) -> None:
        """A searched frame has an image and no bytes; what they tell of its revision reaches words only."""

    def _moved(self, state: BridgeState) -> OdometryState:
        return state.odometry

    def _checked(self, state: BridgeState, asked: AiCommand, now_ns: int) -> tuple[SteeringCheck, WheelCheck]:
        steering, wheels = SteeringCheck(), WheelCheck()
        if self.steer_odd and state.supervisor.driving:
            since_ns = state.steering.implausible_since_ns
            steering = SteeringCheck(implausible_since_ns=now_ns if since_ns is None else since_ns)
        if self.wheel_odd and state.supervisor.driving:
            since_ns = state.wheels.implausible_since_ns
            wheels = WheelCheck(implausible_since_ns=now_ns if since_ns is None else since_ns)
        return steering, wheels


TROUBLES: Final[Mapping[str, Callable[[WatchedBridge, int], object]]] = {
    "an intruder sends 0x511": lambda b, now: (b.on_frame(Frame(0x511, bytes(4), now)), b.checker.on_intruder("0x511")),
    "the loop misses its deadline": lambda b, now: b.loop_fault("a deadline was missed by 50 ms", now),
    "the bus is lost": lambda b, now: b.bus_lost("the interface is gone", now),
    "the bus is back": lambda b, now: b.bus_back(now),
    "the software is stopped": lambda b, now: b.begin_stop(now),
    "frames waited for 20 ms": lambda b, now: b.backlog(BACKLOG_NS, now),
}
RESTART: Final = "restart"  # another process takes the bridge's place
"""The troubles that befall the process in a cycle, by the name in `Choice.event`."""


@dataclass(slots=True)
class _Vcu:
    """The other end: the real transition table, what it received last, and the handshake."""

    state: AsState
    received: bool = False
    go_before: bool = True
    needs_power_cycle: bool = False
    estop: bool = False
    status: MissionStatus = MissionStatus.NOT_SELECTED
    direction: Direction = Direction.NEUTRAL
    front: bool = False
    rear: bool = False
    steer: bool = False
    brake: bool = False
    since_ns: int = NOW
    ai_ns: int | None = None  # the last complete cycle
    echo_ns: int | None = None  # since when the echo is awaited
    bit: bool = False


_asked_of = attrgetter("estop", "status", "direction", "front", "rear", "steer", "brake")


# ---------------------------------------------------------------- the composition

# A state: what can be distinguished without a clock (of the bridge, the VCU and the witness), and the ages.
Contents = tuple[Content, Content, Content]
State = tuple[Contents, tuple[int, ...]]
Outcome = tuple[tuple[Contents, list[int]], tuple[Violation, ...], AiCommand | None]


class Scope(Value, frozen=True):
    """A closed part of everything that can happen: a setting, and what the environment may do in it."""

    name: str
    covers: str
    choices: tuple[Choice, ...]
    """All of them from the last ns of the 3 s of standing still on; before and elsewhere those below `anywhere`."""
    anywhere: int
    path: int = 0  # those numbered below it while nothing has been sent yet; 0: all
    setting: Setting = field(default_factory=Setting)
    endings: Mapping[str, Choice] = field(default_factory=dict)
    bounds_ns: Mapping[str, int] = field(default_factory=dict)
    endless: str = ""  # why no ending can be asked for, in words


class Composition:
    """Bridge, VCU and the checker under one scope's environment: a model for `search.explore`.

    With `only_rule` the problems of all other rules are passed over: can this rule alone find it?
    """

    def __init__(self, scope: Scope, only_rule: str = "") -> None:
        """Begin with a bridge, a VCU and a checker that have seen nothing."""
        setting = scope.setting
        assert setting.config.steer_rate_degps is not None, "a cycle must be enough for the steering"
        self._only_rule = only_rule
        self.scope = scope
        self.config = setting.config
        self.choices = list(scope.choices)
        self.endings = {name: self.choices.index(choice) for name, choice in scope.endings.items()}
        self._codec = setting.codec
        self._leaves_emergency = any(not choice.asms or choice.car_off for choice in scope.choices)
        # A command whose data alone is that old is lost at once: then it matters how long commands have been awaited.
        self._data_may_be_lost = any(
            COMMANDS[choice.command].data_age_ns >= setting.config.sensor_stale_ns
            for choice in scope.choices
            if choice.command != _NO_COMMAND
        )
        self._table_runs = all(choice.says is None for choice in scope.choices)
        self._table: Table = transition_table(setting.profile)
        self._situation = Situation()
        self._abstraction = Abstraction(
            setting.config,
            sends_fail=any(choice.frames < 5 for choice in scope.choices),
            data_may_be_lost=self._data_may_be_lost,
        )
        self._edges = (*self._abstraction.edges, *_OTHER_EDGES)
        self._ages = tuple(
            tuple(sorted({0, *(age for edge in edges for age in (edge - 1, edge))})) for edges in self._edges
        )
        self._encoded: dict[AiCommand, tuple[tuple[Violation, ...], tuple[tuple[int, AiImage], ...]]] = {}
        self.initial()

    def _new_bridge(self) -> SearchedBridge:
        setting = self.scope.setting
        args = (setting.car, setting.config, setting.limits, 1, NOW)
        made = SearchedBridge(cast(Codec, PlainCodec()), revision(setting.revision), *args)
        made.checker = self._checker
        return made

    # ------------------------------------------------------------ states

    def initial(self) -> State:
        """Both sides have just been switched on: nothing has been sent or received."""
        self._checker = self.scope.setting.checker(nothing_hidden=True)
        self._bridge = self._new_bridge()
        self._vcu = _Vcu(self.scope.setting.first_state)
        disc, raw = self._save(NOW)
        return disc, self._rounded(raw)

    def _rounded(self, raw: Sequence[int]) -> tuple[int, ...]:
        ages = zip(raw, self._ages, strict=True)
        return tuple([age if age <= 0 else points[bisect_right(points, age) - 1] for age, points in ages])

    def _save(self, now: int) -> tuple[Contents, list[int]]:
        """The whole composition at `now`: what is no time, and the ages, not yet rounded."""
        v = self._vcu
        bridge = self._bridge.state

        def age(t_ns: int | None) -> int:
            return NEVER if t_ns is None else max(0, now - t_ns)

        table = self._table_runs  # else the VCU is whatever the environment says

        seen = self._checker.seen
        seen.handshake = bool(seen.handshake) != v.bit
        wire, wire_ages = self._checker.saved(now, data_may_be_lost=self._data_may_be_lost)
        content, ages = self._abstraction.apart(bridge, v.bit, now)
        disc = (
            content,
            # VCU
            (v.state, v.received and table, v.go_before or v.state is not AsState.AS_READY, v.needs_power_cycle,
             *_asked_of(v)),
            wire,
        )  # fmt: skip
        vcu_age = NEVER
        if v.state is AsState.AS_READY:
            vcu_age = min(age(v.since_ns), _READY_NS)
        elif v.state is AsState.EMERGENCY_BRAKE:
            vcu_age = age(v.since_ns) if self._leaves_emergency else 0
        vcu_ages = (vcu_age, age(v.ai_ns), age(v.echo_ns)) if table else (NEVER, NEVER, NEVER)
        return disc, [*ages, *vcu_ages, *wire_ages]

    def bridge_of(self, state: State) -> BridgeState:
        """The bridge's half of it, at `NOW`."""
        return self._abstraction.whole(state[0][0], state[1][: len(CLOCKS)])

    def _load(self, state: State, bridge: BridgeState | None = None) -> None:
        """Put the composition back as it was saved, at `NOW`; `bridge` is the bridge's half where it is known."""
        (_, vcu, wire), ages = cast(Any, state)
        self._bridge.state = bridge or self.bridge_of(state)
        t = [None if age < 0 else NOW - age for age in ages[len(CLOCKS) : -len(EDGES)]]
        self._vcu = v = _Vcu(*vcu)
        v.since_ns, v.ai_ns, v.echo_ns = NOW if t[0] is None else t[0], t[1], t[2]
        self._checker.load((wire, ages[-len(EDGES) :]), NOW)

    # ------------------------------------------------------------ moves

    def safe(self, state: State) -> bool:
        """The car is out of AS_DRIVING: finished, off, or braking by itself. There the VCU ignores torque requests.

        Where the VCU says whatever the environment wants, all that the AI side can do counts: the VCU has been told
        ESTOP_REQUEST, or FINISHED (which rule 3 allows at rest only), and holds no torque request.
        """
        as_state, _, _, _, estop, status, _, front, rear, *_ = cast(Any, state[0][1])
        if as_state is not AsState.AS_DRIVING:
            return True
        told_to_stop = estop or status is MissionStatus.FINISHED
        return not self._table_runs and told_to_stop and not (front or rear)

    def moves(self, state: State) -> Iterable[Move]:
        bridge = self.bridge_of(state)
        for label in self.labels(state, bridge):
            yield from self.moves_under(label, state, bridge)

    def labels(self, state: State, bridge: BridgeState) -> range:
        """Return the choices that the environment has in a state."""
        driving = state[1][_DRIVING_CLOCK] >= self.config.launch_wait_ns - 1
        listening = state[1][_LISTENING_CLOCK] < self.config.listen_first_ns and self.scope.path
        count = len(self.choices) if driving else self.scope.path if listening else self.scope.anywhere
        braked = state[0][1][0] is AsState.EMERGENCY_BRAKE and not self._leaves_emergency
        if self.scope.path and (braked or bridge.stop_cycles_left == 0):
            count = self.scope.path  # the car brakes by itself until the end, or the software has stopped
        return range(count)

    def moves_under(self, label: int, state: State, bridge: BridgeState) -> Iterable[Move]:
        """Yield what one choice brings: the next cycle, or, where that changes nothing, the next timers."""
        choice = self.choices[label]
        (disc, raw), problems, asked = self._cycle(state, choice, CYCLE_NS, bridge)
        target = disc, self._rounded(raw)
        if problems or target != state:
            yield Move(label, CYCLE_NS, target, problems, asked)
            return
        waits = self._waits(state[1], raw)
        if not waits:
            yield Move(label, CYCLE_NS, target, (), asked)
        for wait_ns in waits:
            step_ns = min(CYCLE_NS, wait_ns)
            ages = state[1]
            if wait_ns > step_ns:
                # An age that grew in the cycle just tried grows for as long as the same choice is kept up.
                grown_ns = wait_ns - step_ns
                both = zip(ages, raw, strict=True)
                ages = tuple([old + grown_ns if old >= 0 and new == old + CYCLE_NS else old for old, new in both])
            (disc, later), problems, asked = self._cycle((state[0], ages), choice, step_ns)
            yield Move(label, wait_ns, (disc, self._rounded(later)), problems, asked)

    def _waits(self, ages: tuple[int, ...], raw: Sequence[int]) -> tuple[int, ...]:
        """Return the times until the next timer has run for T - 1 ns and for T; none where all have run out."""
        left = [
            edge - age
            for age, new, edges in zip(ages, raw, self._edges, strict=True)
            if age >= 0 and new == age + CYCLE_NS
            for edge in edges
            if edge > age
        ]
        return (min(left) - 1, min(left)) if left else ()

    def _cycle(self, state: State, choice: Choice, step_ns: int, bridge: BridgeState | None = None) -> Outcome:
        """One cycle of the whole composition, `step_ns` after the state was saved."""
        self._load(state, bridge)
        return self.live(choice, NOW + step_ns)

    def live(self, choice: Choice, now: int) -> Outcome:
        """One cycle at `now`: what the composition is then, what is wrong with it, and what was sent."""
        problems: tuple[Violation, ...] = ()
        if choice.event == RESTART:
            self._bridge = self._new_bridge()
            self._checker.restarted()
        checker = self._checker
        if choice.car_off:
            self._vcu = _Vcu(self.scope.setting.first_state)
        else:
            self._look(choice, now)
            self._car_speaks(choice, now)
        b = self._bridge
        b.steer_odd, b.wheel_odd = choice.steer_odd, choice.wheel_odd
        if choice.event in TROUBLES:
            TROUBLES[choice.event](b, now)
        match choice.request:
            case None:
                pass
            case "the emergency brake":
                b.emergency_brake("somebody asked for it", now)
            case "reset":
                b.reset(now)
            case mode:
                b.set_mode(mode, now)
        supervising = b.state.supervisor
        for role in choice.confirm - supervising.confirmed:
            b.on_reset_confirmed(role, supervising.run_id)
        for role in choice.confirm_other:
            b.on_reset_confirmed(role, supervising.run_id + _OTHER_RUN)
        if choice.command != _NO_COMMAND:
            ask = COMMANDS[choice.command]
            run_id = b.state.supervisor.run_id + ask.run
            b.on_command(VehicleCommand(now - ask.data_age_ns, run_id, **{"speed_limit_mps": 50.0} | ask.fields), now)
        asked = b.cycle(now)
        if asked is not None:
            problems, images = self._images(asked)
            self._sent(choice, asked, images, now)
        problems += checker.taken()
        if problems and self._only_rule:
            problems = tuple(problem for problem in problems if problem.rule == self._only_rule)
        return self._save(now), problems, asked

    # ------------------------------------------------------------ the car

    def _look(self, choice: Choice, now: int) -> None:
        """The VCU looks at everything once."""
        v = self._vcu
        if choice.says is not None:
            if v.state is not choice.says:
                v.state, v.since_ns = choice.says, now
            return
        s = self._situation
        oldest_ns = min((t_ns for t_ns in (v.ai_ns, v.echo_ns) if t_ns is not None), default=now)
        lost = v.received and now - oldest_ns >= CAR_PATIENCE_NS
        up = v.received and not v.needs_power_cycle and v.state is not AsState.EMERGENCY_BRAKE
        s.asms, s.tsms, s.go, s.ami, s.sdc_open = choice.asms, choice.tsms, choice.go, choice.ami, choice.sdc_open
        s.go_rising = choice.go and not v.go_before
        v.go_before = choice.go
        s.ebs_armed = s.tractive_system_running = up
        s.power_cycle_needed = v.needs_power_cycle
        s.slowest_wheel_rpm, s.fastest_wheel_rpm = min(choice.rpm), max(choice.rpm)
        s.bms_fault = choice.fault
        s.comms_lost = lost
        s.estop_request = v.estop
        s.mission_status = MissionStatus.NOT_SELECTED if lost else v.status
        s.direction = v.direction
        s.torque_requested, s.brake_requested, s.steer_requested = v.front or v.rear, v.brake, v.steer
        s.ready_wait_over = now - v.since_ns >= self.scope.setting.profile.ready_wait_ns
        s.emergency_timer_over = now - v.since_ns >= self.scope.setting.profile.emergency_timer_ns
        row = taken(self._table, v.state, s)
        if row is not None:
            if row.target is AsState.EMERGENCY_BRAKE:
                v.needs_power_cycle = True
            if row.reset:
                v.needs_power_cycle = False
            if row.target is not v.state:
                v.state, v.since_ns = row.target, now

    def _car_speaks(self, choice: Choice, now: int) -> None:
        """Send the car's messages of one cycle to the bridge and the checker."""
        v = self._vcu
        if v.echo_ns is None:
            v.bit = not v.bit
            v.echo_ns = now
        status = status_frame(v.bit, choice.go, v.state, choice.ami, choice.fault, choice.marks, now)
        axles = [car_frame(kind, now, 0.0, 0.0, choice.torque_max_nm) for kind in (VcuDriveFront, VcuDriveRear)]
        frames = {
            STATUS: [unreadable_frame(v.bit, now) if choice.unreadable else status],
            AXLES: axles,
            STEER: [car_frame(VcuSteer, now, 0.0, choice.angle_max_deg)],
            BRAKE: [brake_frame(v.brake, now)],
            SPEEDS: [car_frame(WheelSpeeds, now, *choice.rpm)],
        }
        for frame in chain.from_iterable(sent for name, sent in frames.items() if name not in choice.lost):
            self._bridge.on_frame(frame)
            self._checker.on_decoded(frame.can_id, frame.decoded, now)
        if choice.counting:
            self._checker.wheels.turning_ns = now
            b = self._bridge.state
            self._bridge.state = replace(
                b,
                supervisor=supervisor.on_pulses(b.supervisor, now),
                gate=replace(b.gate, pulses=Pulses(turning_ns=now)),
            )

    # ------------------------------------------------------------ the wire

    def _images(self, asked: AiCommand) -> tuple[tuple[Violation, ...], tuple[tuple[int, AiImage], ...]]:
        """Return the real codec's five frames of it, decoded again, and what is wrong with them (rule 8)."""
        made = self._encoded.get(asked)
        if made is None:
            images: list[tuple[int, AiImage]] = []
            try:
                for frame in self._codec.encode_command(asked):
                    if self._checker.well_formed(frame):
                        images.append((frame.can_id, cast(AiImage, self._codec.decode(frame).image)))
                problems = self._checker.taken()
            except EncodeError as error:
                problems = (Violation("8", str(error)),)
            made = self._encoded[asked] = problems, tuple(images)
        return made

    def _sent(self, choice: Choice, asked: AiCommand, images: Sequence[tuple[int, AiImage]], now: int) -> None:
        """The frames leave one after another; the VCU looks after each, and keeps what it saw last."""
        b, v, checker = self._bridge, self._vcu, self._checker
        checker.on_sending()
        for can_id, image in images[: choice.frames]:
            checker.on_ai(can_id, image, now)
        if not choice.car_off:
            shown: tuple[dict[str, object], ...] = (
                {"estop": asked.estop_request, "status": asked.mission_status, "direction": asked.direction},
                {"front": asked.front_torque_nm > 0.0},
                {"rear": asked.rear_torque_nm > 0.0},
                {"steer": asked.steer_deg != 0.0},
                {"brake": asked.brake_requested},
            )
            for number, changed in enumerate(shown[: choice.frames]):
                before = _asked_of(v)
                v.received = True
                for name, value in changed.items():
                    setattr(v, name, value)
                if number == 0 and asked.handshake == v.bit:
                    v.echo_ns = None
                if number == 4 or v.ai_ns is None:
                    v.ai_ns = now
                if before != _asked_of(v):
                    self._look(choice, now)
        b.on_sent(choice.frames == 5, now)

    # ------------------------------------------------------------ words

    def described(self, trace: Sequence[Move]) -> list[str]:
        """A trace in words, one line per move; moves alike are given once, with the time of the last of them."""
        lines: list[str] = []
        before = ""
        time_ns = 0
        for move in trace:
            time_ns += move.duration_ns
            state = self.bridge_of(cast(State, move.target)).supervisor.as_state
            seen = "no AS state seen" if state is None else f"{state.label} seen"
            words = (
                f"{self.choices[move.label].words}\n"
                f"            -> {seen}; sent: {_command_words(cast('AiCommand | None', move.seen))}"
            )
            if words == before:
                lines.pop()
            lines.append(f"{time_ns / 1e9:8.3f} s  {words}")
            before = words
        return lines


def _command_words(asked: AiCommand | None) -> str:
    if asked is None:
        return "nothing"
    parts = (
        asked.mission_status.label,
        asked.direction.label,
        asked.estop_request and "ESTOP_REQUEST",
        asked.torque_requested and f"torque {asked.front_torque_nm:g}/{asked.rear_torque_nm:g} Nm",
        asked.brake_requested and f"brake {asked.front_brake_pct:g} %",
        asked.steer_deg and f"steering {asked.steer_deg:g} deg",
    )
    return " ".join(str(part) for part in parts if part)
