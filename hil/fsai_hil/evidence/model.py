"""The bridge, composed with the VCU's state machine and the checker of the rules, as one thing that can be searched.

What runs is the real code: a `Bridge` with its supervisor and gate, and the VCU's transition table of `as_machine`.
This module saves its state, puts it back, and says what the environment may do. What stands in for something:

- the codec hands images on as they are (each command is encoded by the real one, once per different command);
- the environment chooses what the plausibility checks say, and whether a wheel turns by the pulse counts (`LEFT_OUT`
  says what cannot be seen because of that);
- wheels may change their speed from one cycle to the next: more than any car can do.

Time. A state holds ages, not times, and an age is rounded down to the nearest point that the rules can tell apart:
0, and T - 1 ns and T of every timer that looks at it. One move is one cycle of 10 ms under one choice of the
environment. Where that changes nothing, waiting is what matters: then the move waits until the next timer has run for
T - 1 ns, or for T, with the same choice kept up all the while. So all timers run as they do on the car, the cycle at
T - 1 ns and the one at T are both made, and what happens at an age in between counts as happening right after the
last edge before it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple, cast

from msgspec.structs import replace

from fsai_hil.evidence.abstraction import NOW, Abstraction, TimeFields, edges_of
from fsai_hil.evidence.scopes import (
    COMMANDS,
    EVENTS,
    NO_COMMAND,
    RESTART,
    Choice,
    PlainCodec,
    Scope,
    Vcu,
    frames_of,
    unusual,
)
from fsai_hil.evidence.search import Move
from fsai_hil.evidence.searched import SearchedBridge
from fsai_hil.rules.numbers import CAR_PATIENCE_NS, CYCLE_NS
from fsai_hil.rules.seen import EDGES, Violation
from fsai_hil.simulator.as_machine import Situation, taken, transition_table
from fsai_vcu.core.bridge import BridgeState
from fsai_vcu.core.supervision import supervisor
from fsai_vcu.core.supervision.wheel_speeds import Pulses
from fsai_vcu.interface.codec import Codec, EncodeError
from fsai_vcu.interface.enums import AsState, MissionStatus
from fsai_vcu.interface.messages import AiCommand, AiImage
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.specification import READY_WAIT_NS

LEFT_OUT: Final = (
    "whether the plausibility checks find what they should: the model of the steering, each wheel's factor in a curve, "
    "what explains slip and for how long (tests of their own; what is far off, the campaign)",
    "what pulse counts say of a wheel speed (the fuzz, the campaign)",
    "what the codec reads of a frame's bytes (tests of its own, the fuzz, the campaign)",
    "odometry, and words for people",
)
"""The parts in which a mistake leaves no trace in this search, and what looks at them instead."""


# ---------------------------------------------------------------- the composition

_VCU: Final = TimeFields(Vcu)


class State(NamedTuple):
    """A state of the composition: what can be told apart in it without a clock, and the ages of all times in it."""

    bridge: BridgeState
    vcu: Vcu
    wire: Any
    ages: tuple[int, ...]


class Encoded(NamedTuple):
    """A command on the wire: what is wrong with its frames (rule 8), the decoded frames, what each shows the VCU."""

    problems: tuple[Violation, ...]
    images: tuple[tuple[int, AiImage], ...]
    shown: tuple[dict[str, Any], ...]


Outcome = tuple[State, tuple[Violation, ...], AiCommand | None]


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
        ways = [ending.choice for ending in scope.endings]
        path = dict.fromkeys((*scope.path, *ways) if scope.path else ())
        first = path | dict.fromkeys((*scope.everywhere, *ways))
        self.choices = list(first | dict.fromkeys(scope.driving))
        self._path, self._anywhere = len(path), len(first)
        self.endings = {end.words: (self.choices.index(end.choice), end.within_ns) for end in scope.endings}
        self._codec = setting.codec
        self._leaves_emergency = any(not choice.asms or choice.car_off for choice in self.choices)
        # A command whose data alone is that old is lost at once: then it matters how long commands have been awaited.
        self._data_may_be_lost = any(
            -COMMANDS[choice.command].t_sensor_ns >= setting.config.sensor_stale_ns
            for choice in self.choices
            if choice.command != NO_COMMAND
        )
        self._table_runs = all(choice.says is None for choice in self.choices)
        self._table = transition_table(setting.profile)
        self._abstraction = Abstraction(
            setting.config,
            sends_fail=any(choice.frames < 5 for choice in self.choices),
            data_may_be_lost=self._data_may_be_lost,
        )
        self._edges = (*edges_of(_VCU, setting.config), *self._abstraction.edges, *EDGES)
        self._points = [sorted({0, *edges, *(edge - 1 for edge in edges)}) for edges in self._edges]
        self._encoded: dict[AiCommand, Encoded] = {}
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
        self._vcu = Vcu(self.scope.setting.first_state)
        return self._rounded(self._save(NOW))

    def _rounded(self, state: State) -> State:
        both = zip(state.ages, self._points, strict=True)
        ages = [age if age <= 0 else points[bisect_right(points, age) - 1] for age, points in both]
        return State(state.bridge, state.vcu, state.wire, tuple(ages))

    def _save(self, now: int) -> State:
        """The whole composition at `now`, with the ages not yet rounded."""
        v, seen = self._vcu, self._checker.seen
        seen.handshake = bool(seen.handshake) != v.bit
        wire, wire_ages = self._checker.saved(now, data_may_be_lost=self._data_may_be_lost)
        ages: list[int] = []
        vcu = _VCU.apart(self._looked_at(now), now, ages)
        bridge = self._abstraction.apart(self._bridge.state, v.bit, now, ages)
        return State(bridge, vcu, wire, (*ages, *wire_ages))

    def _looked_at(self, now: int) -> Vcu:
        """The VCU without what nobody looks at any more."""
        v, since_ns = self._vcu, now
        go_before = v.go_before or v.state is not AsState.AS_READY
        if not self._table_runs:  # it is whatever the environment says
            return replace(v, go_before=go_before, bit=False, since_ns=now, received=False, ai_ns=None, echo_ns=None)
        if v.state is AsState.AS_READY:
            since_ns = max(v.since_ns, now - READY_WAIT_NS)
        elif v.state is AsState.EMERGENCY_BRAKE and self._leaves_emergency:
            since_ns = v.since_ns
        return replace(v, go_before=go_before, bit=False, since_ns=since_ns)

    def bridge_of(self, state: State) -> BridgeState:
        """The bridge's part of it, at `NOW`."""
        return self._abstraction.whole(state.bridge, state.ages[len(_VCU.ages) :])

    def _load(self, state: State, bridge: BridgeState | None = None) -> None:
        """Put the composition back as it was saved, at `NOW`; `bridge` is the bridge's part where it is known."""
        self._bridge.state = bridge or self.bridge_of(state)
        self._vcu = _VCU.whole(state.vcu, iter(state.ages))
        self._checker.load((state.wire, state.ages[-len(EDGES) :]), NOW)

    # ------------------------------------------------------------ moves

    def safe(self, state: State) -> bool:
        """The car is out of AS_DRIVING: finished, off, or braking by itself. There the VCU ignores torque requests.

        Where the VCU says whatever the environment wants, all that the AI side can do counts: the VCU has been told
        ESTOP_REQUEST, or FINISHED (which rule 3 allows at rest only), and holds no torque request.
        """
        v = state.vcu
        if v.state is not AsState.AS_DRIVING:
            return True
        told_to_stop = v.estop or v.status is MissionStatus.FINISHED
        return not self._table_runs and told_to_stop and not (v.front or v.rear)

    def moves(self, state: State) -> Iterable[Move]:
        bridge = self.bridge_of(state)
        for label in self.labels(state, bridge):
            yield from self.moves_under(label, state, bridge)

    def labels(self, state: State, bridge: BridgeState) -> range:
        """Return the choices that the environment has in a state."""
        driving_ns, listening_ns = bridge.supervisor.driving_since_ns, bridge.listening_since_ns
        braked = state.vcu.state is AsState.EMERGENCY_BRAKE and not self._leaves_emergency
        if self._path and (braked or bridge.stop_cycles_left == 0):
            return range(self._path)  # the car brakes by itself until the end, or the software has stopped
        if driving_ns is not None and NOW - driving_ns >= self.config.launch_wait_ns - 1:
            return range(len(self.choices))
        listening = listening_ns is None or NOW - listening_ns < self.config.listen_first_ns
        return range(self._path if self._path and listening else self._anywhere)

    def moves_under(self, label: int, state: State, bridge: BridgeState) -> Iterable[Move]:
        """Yield what one choice brings: the next cycle, or, where that changes nothing, the next timers."""
        choice = self.choices[label]
        raw, problems, asked = self._cycle(state, choice, CYCLE_NS, bridge)
        target = self._rounded(raw)
        if problems or target != state:
            yield Move(label, CYCLE_NS, target, problems, asked)
            return
        waits = self._waits(state.ages, raw.ages)
        if not waits:
            yield Move(label, CYCLE_NS, target, (), asked)
        for wait_ns in waits:
            step_ns = min(CYCLE_NS, wait_ns)
            # An age that grew in the cycle just tried grows for as long as the same choice is kept up.
            both = zip(state.ages, raw.ages, strict=True)
            ages = [old + wait_ns - step_ns if old >= 0 and new == old + CYCLE_NS else old for old, new in both]
            later, problems, asked = self._cycle(state._replace(ages=tuple(ages)), choice, step_ns)
            yield Move(label, wait_ns, self._rounded(later), problems, asked)

    def _waits(self, ages: Sequence[int], raw: Sequence[int]) -> tuple[int, ...]:
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
        checker = self._checker
        if choice.event == RESTART:
            self._bridge = self._new_bridge()
            checker.restarted()
        if choice.car_off:
            self._vcu = Vcu(self.scope.setting.first_state, since_ns=now)
        else:
            self._look(choice, now)
            self._car_speaks(choice, now)
        b = self._bridge
        b.steer_odd, b.wheel_odd = choice.steer_odd, choice.wheel_odd
        if choice.event in EVENTS:
            EVENTS[choice.event](b, now)
        supervising = b.state.supervisor
        for role in choice.confirm - supervising.confirmed:
            b.on_reset_confirmed(role, supervising.run_id)
        for role in choice.confirm_other:
            b.on_reset_confirmed(role, supervising.run_id - 1)
        if choice.command != NO_COMMAND:
            sent = COMMANDS[choice.command]
            run_id = b.state.supervisor.run_id + sent.run_id
            b.on_command(replace(sent, t_sensor_ns=now + sent.t_sensor_ns, run_id=run_id), now)
        asked = b.cycle(now)
        if asked is not None:
            encoded = self._encode(asked)
            problems = encoded.problems
            self._sent(choice, asked, encoded, now)
        problems += checker.taken()
        if problems and self._only_rule:
            problems = tuple(problem for problem in problems if problem.rule == self._only_rule)
        return self._save(now), problems, asked

    # ------------------------------------------------------------ the car

    def _look(self, choice: Choice, now: int) -> None:
        """The VCU looks at everything once."""
        v, profile = self._vcu, self.scope.setting.profile
        if choice.says is not None:
            if v.state is not choice.says:
                self._vcu = replace(v, state=choice.says, since_ns=now)
            return
        lost = v.received and any(t_ns is not None and now - t_ns >= CAR_PATIENCE_NS for t_ns in (v.ai_ns, v.echo_ns))
        up = v.received and not v.needs_power_cycle and v.state is not AsState.EMERGENCY_BRAKE
        row = taken(
            self._table,
            v.state,
            Situation(
                asms=choice.asms,
                tsms=choice.tsms,
                go=choice.go,
                go_rising=choice.go and not v.go_before,
                ami=choice.ami,
                sdc_open=choice.sdc_open,
                ebs_armed=up,
                tractive_system_running=up,
                power_cycle_needed=v.needs_power_cycle,
                slowest_wheel_rpm=min(choice.rpm),
                fastest_wheel_rpm=max(choice.rpm),
                bms_fault=choice.fault,
                comms_lost=lost,
                estop_request=v.estop,
                mission_status=MissionStatus.NOT_SELECTED if lost else v.status,
                direction=v.direction,
                torque_requested=v.front or v.rear,
                brake_requested=v.brake,
                steer_requested=v.steer,
                ready_wait_over=now - v.since_ns >= profile.ready_wait_ns,
                emergency_timer_over=now - v.since_ns >= profile.emergency_timer_ns,
            ),
        )
        if row is not None:
            braked = v.needs_power_cycle or row.target is AsState.EMERGENCY_BRAKE
            since_ns = v.since_ns if row.target is v.state else now
            v = replace(v, needs_power_cycle=braked and not row.reset, state=row.target, since_ns=since_ns)
        self._vcu = v if v.go_before == choice.go else replace(v, go_before=choice.go)

    def _car_speaks(self, choice: Choice, now: int) -> None:
        """Send the car's messages of one cycle to the bridge and the checker."""
        if self._vcu.echo_ns is None:
            self._vcu = replace(self._vcu, bit=not self._vcu.bit, echo_ns=now)
        for frame in frames_of(choice, self._vcu, now):
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

    def _encode(self, asked: AiCommand) -> Encoded:
        """Return a command on the wire; each command that differs is encoded and checked once."""
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
            shown: tuple[dict[str, Any], ...] = (
                {"estop": asked.estop_request, "status": asked.mission_status, "direction": asked.direction},
                {"front": asked.front_torque_nm > 0.0},
                {"rear": asked.rear_torque_nm > 0.0},
                {"steer": asked.steer_deg != 0.0},
                {"brake": asked.brake_requested},
            )
            made = self._encoded[asked] = Encoded(problems, tuple(images), shown)
        return made

    def _sent(self, choice: Choice, asked: AiCommand, encoded: Encoded, now: int) -> None:
        """The frames leave one after another; the VCU looks after each, and keeps what it saw last."""
        checker = self._checker
        checker.on_sending()
        for can_id, image in encoded.images[: choice.frames]:
            checker.on_ai(can_id, image, now)
        for number, shown in enumerate(() if choice.car_off else encoded.shown[: choice.frames]):
            v = self._vcu
            if number == 0:
                echo_ns = None if asked.handshake == v.bit else v.echo_ns
                self._vcu = replace(v, received=True, ai_ns=v.ai_ns or now, echo_ns=echo_ns)
            elif number == 4:
                self._vcu = replace(v, ai_ns=now)
            if any(getattr(v, name) != value for name, value in shown.items()):
                self._vcu = replace(self._vcu, **shown)
                self._look(choice, now)
        self._bridge.on_sent(choice.frames == 5, now)

    # ------------------------------------------------------------ words

    def described(self, trace: Sequence[Move]) -> list[str]:
        """A trace in words, one line per move; moves alike are given once, with the time of the last of them."""
        lines: list[str] = []
        before = ""
        time_ns = 0
        for move in trace:
            time_ns += move.duration_ns
            state = cast(State, move.target).bridge.supervisor.as_state
            seen = "no AS state seen" if state is None else f"{state.label} seen"
            asked = cast("AiCommand | None", move.seen)
            sent = "nothing" if asked is None else unusual(replace(asked, handshake=False)) or "the safe default"
            chosen = unusual(self.choices[move.label]) or "nothing out of the ordinary"
            words = f"{chosen}\n            -> {seen}; sent: {sent}"
            if words == before:
                lines.pop()
            lines.append(f"{time_ns / 1e9:8.3f} s  {words}")
            before = words
        return lines
