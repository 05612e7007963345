"""An independent look at a bus: do the frames that were on it keep the rules that can be seen there?

The checker knows the interface (through the codec) and nothing of the gate that is to keep the rules. It is fed with
every frame of a bus, of the AI computer and of the car, in the order of time.

What is on the wire at an instant was decided a little earlier: a value that the car sent less than `in_flight_ns` ago
may not have been seen yet. A rule is broken only when it is broken for every value that the sender can have seen.

Which safety rule is checked how, by frames alone:

1. torque and brake: never above zero together in what the VCU saw last of each frame; torque rises from zero only after
   a whole cycle without both and a 0x524 after it that echoes zero, or two such cycles; brake rises only after a whole
   cycle without torque. A cycle that lacks a frame is not whole.
2. each frame with torque against the 0x520 seen: AS_DRIVING, Go, its age, 3 s in AS_DRIVING, FORWARD, no ESTOP_REQUEST;
   an AS_STATE that is known, and a mission for which SELECTED was sent. The mode and the command behind it are not on
   the wire: see `evidence/wire_rules.py`.
3. NEUTRAL and FINISHED in AS_DRIVING against the wheel speeds and pulse counts seen; speeds that may not be believed
   count as missing (`evidence/wheel_rules.py`).
4. steering against the revision's limit, ANGLE_MAX and the operational limit, and its change against the car's steering
   rate; torque against 195 Nm, a live TRQ_MAX, the constant-power schedule and the operational limit, none on an axle
   without a motor; motor speed limit against the operational speed limit.
5. MISSION_STATUS, direction, steering and torque in AS_INIT, AS_OFF and AS_READY. What SELECTED needs besides is not on
   the wire.
6. ESTOP_REQUEST goes back to 0 only in AS_INIT and AS_OFF. Who cleared it is not on the wire.
7. every frame of the AI computer has its length, and values of the interface's table.
8. no identifier that is not of this bus, none extended or remote. An intruder on the AI computer's own ids cannot be
   told apart on a log; whoever knows it keeps his frames from the checker.
9. the handshake echo against the bits received.
10. torque only after AS_OFF, AS_READY and AS_DRIVING were seen in turn by the process that sends, 5 s of AS_READY with
    Go off among them: a pause in its frames or a second without 0x520 (a power cycle) begins anew.

And besides: no torque after a switch, SHUTDOWN_REQUEST, a fault bit or SHUTDOWN_CAUSE turned in AS_DRIVING; two cycles
are never closer than 8 ms; and what the output table says of each AS state as far as it is one value: MISSION_STATUS,
direction, and no brake in AS_INIT, AS_OFF and EMERGENCY_BRAKE.
"""

from __future__ import annotations

import gzip
import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum, auto
from pathlib import Path
from typing import IO, Generic, TypeVar

from fsai_hil.rules.numbers import (
    CAR_PATIENCE_NS,
    CYCLE_GAP_NS,
    FEEDBACK_STALE_NS,
    LAUNCH_NS,
    MOST_MOTOR_RPM,
    MOST_TORQUE_NM,
    POWER_CYCLE_NS,
    READY_SEEN_NS,
    STATUS_FRESH_NS,
    STILL_NS,
    constant_power_nm,
)
from fsai_hil.rules.response import ResponseTimes
from fsai_hil.rules.wheels import Belief, Wheels
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS, VehicleParameters
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus, ShutdownCause
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiStatus,
    AiSteer,
    Faults,
    Image,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.reserved import AI_IDS

MS = 1_000_000
SECOND = 1_000_000_000

RESTART_GAP_NS = 150 * MS  # a process that starts listens for 200 ms before its first frame
STATUS_ID = 0x520
RESOLUTION = 0.051  # half a raw step of torque and steering, and a float's rounding

OFF = (AsState.AS_INIT, AsState.AS_OFF)
IDLE = (*OFF, AsState.AS_READY)
UNBRAKED = (*OFF, AsState.EMERGENCY_BRAKE)  # output table: the car holds or brakes itself there
_TORQUE_KEYS = ("state", "wait", "go", "direction", "emergency", "age", "known", "mission")
_KEPT = 1000  # violations kept as text; all are counted

T = TypeVar("T")


class _Recent(Generic[T]):
    """The values that a sender can have seen last: all younger than the time in flight, and the one before them."""

    def __init__(self, in_flight_ns: int) -> None:
        self._in_flight_ns = in_flight_ns
        self._values: deque[tuple[int, T]] = deque()

    def add(self, t_ns: int, value: T) -> None:
        self._values.append((t_ns, value))

    def at(self, t_ns: int) -> list[T]:
        values = self._values
        while len(values) > 1 and t_ns - values[1][0] >= self._in_flight_ns:
            values.popleft()
        return [value for _, value in values]


@dataclass(frozen=True, slots=True)
class WireReport:
    """What a bus showed. Times in milliseconds and seconds; `ok` means that no rule was seen broken."""

    frames: int
    duration_s: float
    cycles: int
    incomplete_cycles: int
    shortest_cycle_ms: float | None
    responses: int
    response_p50_ms: float | None
    response_p99_ms: float | None
    response_p999_ms: float | None
    response_max_ms: float | None
    error_frames: int
    as_states: tuple[tuple[float, str], ...]
    problems: Mapping[str, int]
    violation_count: int
    violations: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return self.violation_count == 0

    def __str__(self) -> str:
        lines = [
            f"{self.frames} frames in {self.duration_s:.3f} s, {self.cycles} command cycles"
            f" ({self.incomplete_cycles} incomplete), {self.error_frames} error frames",
            "AS states: " + (", ".join(f"{name} at {t_s:.3f} s" for t_s, name in self.as_states) or "none heard"),
        ]
        if self.responses:
            lines.append(
                f"response time: {self.responses} echoes, p50 {self.response_p50_ms:.2f} ms,"
                f" p99 {self.response_p99_ms:.2f} ms, p99.9 {self.response_p999_ms:.2f} ms,"
                f" max {self.response_max_ms:.2f} ms"
            )
        lines += [f"{count} x {problem}" for problem, count in self.problems.items()]
        lines += list(self.violations) or ["no rule broken"]
        if self.violation_count > len(self.violations):
            lines.append(f"… and {self.violation_count - len(self.violations)} more")
        return "\n".join(lines)


@dataclass(slots=True)
class _Cycle:
    """The five frames of one cycle as they came."""

    ids: list[int] = field(default_factory=list)
    selected: bool = False
    torque: bool = False
    brake: bool = False

    @property
    def complete(self) -> bool:
        return tuple(self.ids) == AI_IDS


class _Path(Enum):
    """How far the AI computer's process has seen the car come on AS_OFF, AS_READY, AS_DRIVING."""

    GONE = auto()
    OFF = auto()
    READY = auto()
    DRIVING = auto()

    @staticmethod
    def at_first_sight(state: AsState) -> _Path:
        """Where a log begins its beginning is not known: in favour of the sender."""
        return {AsState.AS_READY: _Path.OFF, AsState.AS_DRIVING: _Path.READY}.get(state, _Path.GONE)

    def then(self, state: AsState) -> _Path:
        if state in (AsState.AS_INIT, AsState.AS_OFF):
            return _Path.OFF
        if state is AsState.AS_READY and self in (_Path.OFF, _Path.READY):
            return _Path.READY
        if state is AsState.AS_DRIVING and self in (_Path.READY, _Path.DRIVING):
            return _Path.DRIVING
        return _Path.GONE


def turned(before: VcuStatus, now: VcuStatus) -> list[str]:
    """What of 0x520 ends a drive by turning in AS_DRIVING, though FAULT_STATUS stays 0."""
    found = []
    if before.as_switch and not now.as_switch:
        found.append("AS_SWITCH_STATUS falls")
    if before.ts_switch and not now.ts_switch:
        found.append("TS_SWITCH_STATUS falls")
    if now.shutdown_request and not before.shutdown_request:
        found.append("SHUTDOWN_REQUEST rises")
    names = [bit.name for bit in fields(Faults)]
    risen = [name for name in names if getattr(now.faults, name) and not getattr(before.faults, name)]
    if risen:
        found.append(f"fault bits rise: {', '.join(risen)}")
    if before.shutdown_cause is ShutdownCause.NO_SHUTDOWN and now.shutdown_cause is not ShutdownCause.NO_SHUTDOWN:
        found.append("SHUTDOWN_CAUSE rises")
    return found


class WireChecker:
    """Feed it with `on_frame`; read `violations` at any time and `report()` at the end.

    `handshake_in_flight_ns` is how young a 0x520 may be and not yet be echoed; `clock_slack_ns` covers the difference
    between a sender's clock reading and the time stamp on the bus. All three at 0 is the view of the sender itself.

    `car` and `limits` add what rule 4 says of steering rate, driven axles and the venue. `from_start`: the first frame
    is the first that the sending process could hear, and `restarted` says when another takes its place; without it
    what was before the log is not judged. `motor_brakes`: the car on which torque against a motor speed limit of zero
    is the brake, which rule 2 does not mean. `short_sequence`: the car whose VCU does not keep to the 5 s in AS_READY.
    """

    def __init__(
        self,
        codec: Codec,
        *,
        in_flight_ns: int = 20 * MS,
        handshake_in_flight_ns: int = 2 * MS,
        clock_slack_ns: int = MS // 2,
        car: VehicleParameters | None = None,
        limits: OperationalLimits = UNLIMITED,
        from_start: bool = False,
        motor_brakes: bool = False,
        short_sequence: bool = False,
    ) -> None:
        self.violations: list[str] = []
        self.violation_count = 0
        self._codec = codec
        self._known_ids = frozenset(message.frame_id for message in codec.database.messages)
        self._slack_ns = clock_slack_ns
        self._handshake_in_flight_ns = handshake_in_flight_ns
        self._in_flight_ns = in_flight_ns
        self._from_start = from_start
        self._motor_brakes = motor_brakes
        self._short_sequence = short_sequence
        self._pulses_per_rev = max(one.wheel_pulses_per_rev for one in ((car,) if car else CARS.values()))
        self._driven = (True, True) if car is None else (car.driven_front, car.driven_rear)
        self._steer_rate_degps = math.inf if car is None else math.degrees(car.steer_rate_radps)
        self._steer_limit_deg = min(codec.revision.steer_limit_deg, limits.max_steer_deg)
        self._torque_limit_nm = min(MOST_TORQUE_NM, limits.max_axle_torque_nm)
        self._motor_limit_rpm = MOST_MOTOR_RPM
        if car is not None:
            self._torque_limit_nm = min(self._torque_limit_nm, car.axle_torque_max_nm)
            wheel_rpm = car.wheel_rpm_of_speed(min(limits.max_speed_mps, 1000.0))
            self._motor_limit_rpm = min(MOST_MOTOR_RPM, wheel_rpm * car.gear_ratio)

        self._start_ns: int | None = None
        self._now_ns = 0
        self._frames = 0
        self._error_frames = 0
        self._problems: Counter[str] = Counter()
        self._broken: set[str] = set()
        self._strange_ids: set[int] = set()

        self._as_states: list[tuple[int, AsState]] = []
        self.responses = ResponseTimes()
        self._know_nothing()

        self._ai: AiStatus | None = None
        # Front and rear, as the VCU has last seen them; None: not known. A process that starts cannot know either, but
        # has not asked for anything yet.
        self._torque: list[float | None] = [0.0, 0.0] if from_start else [None, None]
        self._brakes: tuple[float, float] | None = (0.0, 0.0) if from_start else None
        self._steered: tuple[int, float] | None = None
        self._cycle = _Cycle()
        self._cycles = 0
        self._incomplete = 0
        self._cycle_start_ns: int | None = None
        self._shortest_ns: int | None = None
        self._quiet_cycles = 0  # complete cycles without torque and brake since the brake was last asked for
        self._quiet_since_ns = 0  # when the first of them began
        self._torqueless_cycles = 0  # complete cycles without torque since torque was last asked for

    def _know_nothing(self) -> None:
        """Nothing has been heard yet, by the process that sends."""
        self._status: _Recent[VcuStatus] = _Recent(self._in_flight_ns)
        self._known: _Recent[bool] = _Recent(self._in_flight_ns)  # of each 0x520: whether it is one
        self._newest_status: VcuStatus | None = None
        self._mission = Ami.NOT_SELECTED
        self._acknowledged = not self._from_start  # SELECTED was sent for the mission; a log may begin after it
        self._ready_ns: int | None = None  # since when it has been AS_READY
        self._ready_seen_ns = 0  # until Go was last seen off
        self.turned: tuple[int, str] | None = None  # what ended the drive by turning, and when
        self._front: _Recent[VcuDriveFront] = _Recent(self._in_flight_ns)
        self._rear: _Recent[VcuDriveRear] = _Recent(self._in_flight_ns)
        self._steer: _Recent[VcuSteer] = _Recent(self._in_flight_ns)
        self._brake_echo: _Recent[VcuBrake] = _Recent(self._in_flight_ns)
        self._speeds: _Recent[WheelSpeeds] = _Recent(self._in_flight_ns)
        self._as_state: AsState | None = None
        self._heard_ns: int | None = None  # the last 0x520, whatever was in it
        self._driving_since_ns: int | None = None  # None: not driving, or since before the log began
        self._came_by = _Path.GONE
        self._silent = False
        self._car_was_off = False
        self._off_meanwhile = False  # AS_INIT or AS_OFF was the state at some time since the last 0x510
        self.wheels = Wheels(self._pulses_per_rev, self._in_flight_ns, self._slack_ns)
        self._bits: deque[tuple[int, bool]] = deque(maxlen=16)
        self._toggle: tuple[int, bool] | None = None

    # ------------------------------------------------------------ input

    @property
    def came_the_whole_way(self) -> bool:
        """Whether AS_OFF, AS_READY and AS_DRIVING were seen in turn by the process that sends (safety rule 10)."""
        return self._came_by is _Path.DRIVING

    @property
    def acknowledged(self) -> bool:
        """Whether there is a mission, and SELECTED was sent for it (safety rule 2)."""
        return self._mission is not Ami.NOT_SELECTED and self._acknowledged

    def unknown(self, t_ns: int) -> bool:
        """Whether the last 0x520 that was received is none that anybody knows."""
        known = self._known.at(t_ns)
        return bool(known) and not any(known)

    def restarted(self) -> None:
        """Another process takes the sender's place: it knows nothing, the VCU keeps what it saw last."""
        self.cycle_over()
        self._cycle_start_ns = None
        self._ai = None
        self._steered = None
        self._quiet_cycles = 0
        self._know_nothing()

    def cycle_over(self) -> None:
        """No more frames of this cycle come; else the next cycle's first frame says so."""
        if self._cycle.ids:
            self._end_cycle()
        self._cycle = _Cycle()

    def on_bus_lost(self) -> None:
        """The sender has lost the bus: whatever follows, its drive needs the whole way anew."""
        self._came_by = _Path.GONE
        self._heard_ns = None  # what it cannot hear is no silence of the car's

    def on_frame(self, frame: Frame) -> Image | None:
        """One frame of the bus, at `frame.t_ns`. Returns what it says, None for nothing that may be believed."""
        if self._start_ns is None:
            self._start_ns = frame.t_ns
        self._now_ns = frame.t_ns
        self._frames += 1
        if frame.error:
            self._error_frames += 1
            return None
        if frame.extended or frame.remote or frame.can_id not in self._known_ids:
            self._strange(frame)
            return None
        if frame.can_id == STATUS_ID:
            self._on_any_status(frame.t_ns)
        decoded = self._codec.decode(frame)
        for problem in decoded.problems:
            self._problems[problem] += 1
        if frame.can_id == STATUS_ID:
            self._known.add(frame.t_ns, decoded.image is not None)
        if decoded.handshake is not None:
            self._on_handshake(frame.t_ns, decoded.handshake)
        image = decoded.image
        if frame.can_id in AI_IDS:
            if image is None:
                self._break("rule 7", f"0x{frame.can_id:03X} cannot be believed: {'; '.join(decoded.problems)}")
            elif isinstance(image, AiStatus):
                self._on_ai_status(frame.t_ns, image)
            elif isinstance(image, AiDriveFront):
                self._on_torque(frame, 0, image.torque_nm, image.motor_speed_max_rpm)
            elif isinstance(image, AiDriveRear):
                self._on_torque(frame, 1, image.torque_nm, image.motor_speed_max_rpm)
            elif isinstance(image, AiSteer):
                self._on_steer(frame, image.steer_deg)
            elif isinstance(image, AiBrake):
                self._on_brake(frame, image)
        elif isinstance(image, VcuStatus):
            self._on_status(frame.t_ns, image)
        elif isinstance(image, VcuDriveFront):
            self._front.add(frame.t_ns, image)
        elif isinstance(image, VcuDriveRear):
            self._rear.add(frame.t_ns, image)
        elif isinstance(image, VcuSteer):
            self._steer.add(frame.t_ns, image)
        elif isinstance(image, VcuBrake):
            self._brake_echo.add(frame.t_ns, image)
        elif isinstance(image, WheelSpeeds):
            if self.wheels.on_speeds(image.all_rpm, frame.t_ns) is not Belief.NO:
                self._speeds.add(frame.t_ns, image)
        elif isinstance(image, WheelCounts):
            self.wheels.on_counts((image.fl, image.fr, image.rl, image.rr), frame.t_ns)
        return image

    def report(self) -> WireReport:
        """What has been seen so far."""
        start = self._start_ns or 0
        return WireReport(
            frames=self._frames,
            duration_s=(self._now_ns - start) / SECOND,
            cycles=self._cycles,
            incomplete_cycles=self._incomplete,
            shortest_cycle_ms=None if self._shortest_ns is None else self._shortest_ns / MS,
            responses=len(self.responses),
            response_p50_ms=self.responses.quantile_ms(0.5),
            response_p99_ms=self.responses.quantile_ms(0.99),
            response_p999_ms=self.responses.quantile_ms(0.999),
            response_max_ms=self.responses.quantile_ms(1.0),
            error_frames=self._error_frames,
            as_states=tuple(((t_ns - start) / SECOND, state.label) for t_ns, state in self._as_states),
            problems=dict(self._problems),
            violation_count=self.violation_count,
            violations=tuple(self.violations),
        )

    # ------------------------------------------------------------ what the car says

    def _on_handshake(self, t_ns: int, bit: bool) -> None:
        if not self._bits or self._bits[-1][1] != bit:
            alive = self._cycle_start_ns is not None and t_ns - self._cycle_start_ns < 100 * MS
            self._toggle = (t_ns, bit) if alive else None
        self._bits.append((t_ns, bit))

    def _on_any_status(self, t_ns: int) -> None:
        if self._heard_ns is not None and t_ns - self._heard_ns >= POWER_CYCLE_NS + self._in_flight_ns:
            self._car_was_off = True
        self._heard_ns = t_ns

    def _on_status(self, t_ns: int, status: VcuStatus) -> None:
        self._status.add(t_ns, status)
        state = status.as_state
        self._off_meanwhile = self._off_meanwhile or state in OFF
        entered_off = state in OFF and self._as_state is not None and (self._as_state not in OFF or self._car_was_off)
        chosen = status.ami is not self._mission and (state in IDLE or self._as_state is None)
        if entered_off or chosen:
            first = self._as_state is None and not self._from_start
            self._mission, self._acknowledged = status.ami, first
        silent = self._cycle_start_ns is not None and t_ns - self._cycle_start_ns >= RESTART_GAP_NS
        if (silent and not self._silent and not self._from_start) or self._car_was_off:
            self._came_by = _Path.GONE  # safety rule 10: whoever speaks next must see the whole way anew
        elif self._as_state is None and not self._from_start:
            self._came_by = _Path.at_first_sight(state)
        self._silent = silent
        self._came_by = self._came_by.then(state)
        anew = self._car_was_off or state is not self._as_state
        self._car_was_off = False
        self._follow_ready(t_ns, status, anew)
        self._follow_turns(t_ns, status, anew)
        if not anew:
            return
        if self._from_start:
            self._driving_since_ns = t_ns if state is AsState.AS_DRIVING else None
            self._as_state = state
            self._as_states.append((t_ns, state))
            return
        self._driving_since_ns = t_ns if state is AsState.AS_DRIVING and self._as_state is not None else None
        self._as_state = state
        self._as_states.append((t_ns, state))

    def _follow_ready(self, t_ns: int, status: VcuStatus, anew: bool) -> None:
        """AS_READY lasts 5 s before Go, which is off until then; what a log does not show is not judged."""
        if status.as_state is AsState.AS_READY:
            if anew:
                self._ready_ns = t_ns if self._as_state is not None or self._from_start else None
                self._ready_seen_ns = t_ns
            if not status.go_signal:
                self._ready_seen_ns = t_ns
        elif status.as_state is AsState.AS_DRIVING and anew and self._ready_ns is not None:
            waited_ns = self._ready_seen_ns - self._ready_ns + self._in_flight_ns
            if waited_ns < READY_SEEN_NS and not self._short_sequence:
                self._came_by = _Path.GONE
        if status.as_state is not AsState.AS_READY:
            self._ready_ns = None

    def _follow_turns(self, t_ns: int, status: VcuStatus, anew: bool) -> None:
        before, self._newest_status = self._newest_status, status
        if anew:
            self.turned = None
        if status.as_state is AsState.AS_DRIVING and before is not None and self.turned is None:
            what = turned(before, status)
            if what:
                self.turned = t_ns, "; ".join(what)

    # ------------------------------------------------------------ what the AI computer says

    def _on_ai_status(self, t_ns: int, ai: AiStatus) -> None:
        restarted = self._cycle_start_ns is not None and t_ns - self._cycle_start_ns >= RESTART_GAP_NS
        self._begin_cycle(t_ns)
        self._cycle.selected = ai.mission_status is MissionStatus.SELECTED
        self._check_echo(t_ns, ai.handshake)
        states = self._states(t_ns)
        self._check_latch(ai, states, restarted)
        if states and all(state is AsState.AS_DRIVING for state in states):
            for name, said in (
                ("NEUTRAL", ai.direction is Direction.NEUTRAL),
                ("FINISHED", ai.mission_status is MissionStatus.FINISHED),
            ):
                self._rule("rule 3", name, said and not self._standing(t_ns), f"{name} in AS_DRIVING before standstill")
        if states:
            self._check_table(t_ns, ai, states)
        if all(state in IDLE for state in states) and (states or self._from_start):
            where = states[-1].label if states else "no AS state yet"
            self._rule(
                "rule 5",
                "direction",
                ai.direction is not Direction.NEUTRAL,
                f"direction {ai.direction.label} in {where}",
            )
            self._rule(
                "rule 5",
                "mission status",
                ai.mission_status not in (MissionStatus.NOT_SELECTED, MissionStatus.SELECTED),
                f"MISSION_STATUS {ai.mission_status.label} in {where}",
            )
        self._ai = ai
        self._off_meanwhile = bool(states) and states[-1] in OFF

    def _check_table(self, t_ns: int, ai: AiStatus, states: list[AsState]) -> None:
        """The output table's rows of AS_DRIVING, AS_FINISHED and EMERGENCY_BRAKE; rule 5 is about the others."""
        if any(state is not states[-1] for state in states):
            return
        state = states[-1]
        mission, direction = ai.mission_status, ai.direction
        right_status, right_direction = True, True
        if state is AsState.AS_DRIVING:
            right_status = mission in (MissionStatus.RUNNING, MissionStatus.FINISHED)
            right_direction = direction is not Direction.REVERSE
        elif state is AsState.AS_FINISHED:
            right_status = mission is MissionStatus.FINISHED
            right_direction = direction is Direction.NEUTRAL
        elif state is AsState.EMERGENCY_BRAKE:
            right_status = mission is MissionStatus.RUNNING
            right_direction = direction is Direction.FORWARD or (
                direction is Direction.NEUTRAL and (self._standing(t_ns) or self._stood_before(t_ns))
            )
        where = state.label
        self._rule("output table", "status", not right_status, f"MISSION_STATUS {mission.label} in {where}")
        self._rule("output table", "direction", not right_direction, f"direction {direction.label} in {where}")

    def _begin_cycle(self, t_ns: int) -> None:
        self.cycle_over()
        if self._cycle_start_ns is not None:
            interval_ns = t_ns - self._cycle_start_ns
            self._shortest_ns = interval_ns if self._shortest_ns is None else min(self._shortest_ns, interval_ns)
            self._rule(
                "interval",
                "",
                interval_ns < CYCLE_GAP_NS - self._slack_ns,
                f"two cycles only {interval_ns / MS:.2f} ms apart",
            )
        self._cycle_start_ns = t_ns
        self._cycles += 1
        self._cycle = _Cycle([AI_IDS[0]])

    def _end_cycle(self) -> None:
        if not self._cycle.complete:
            self._incomplete += 1
            return
        self._acknowledged = self._acknowledged or self._cycle.selected
        if not self._cycle.torque:
            self._torqueless_cycles += 1
            if not self._cycle.brake:
                if self._quiet_cycles == 0:
                    self._quiet_since_ns = self._cycle_start_ns or 0
                self._quiet_cycles += 1

    def _check_echo(self, t_ns: int, bit: bool) -> None:
        if not self._bits:
            self._rule("rule 9", "", self._from_start and bit, "handshake 1 where nothing was received")
            return
        possible = {self._bits[-1][1]}
        for index in range(len(self._bits) - 1, 0, -1):
            if t_ns - self._bits[index][0] >= self._handshake_in_flight_ns:
                break
            possible.add(self._bits[index - 1][1])
        if t_ns - self._bits[0][0] < self._handshake_in_flight_ns:
            possible.add(False)  # not even the first 0x520 need have been received: there was nothing to echo
        self._rule("rule 9", "", bit not in possible, f"handshake {int(bit)} where {int(not bit)} was received")
        if self._toggle is not None and bit == self._toggle[1] and bit == self._bits[-1][1]:
            self.responses.add(t_ns - self._toggle[0])
            self._toggle = None

    def _check_latch(self, ai: AiStatus, states: list[AsState], restarted: bool) -> None:
        if self._ai is None or (restarted and not self._from_start):
            return
        released = self._ai.estop_request and not ai.estop_request
        allowed = self._off_meanwhile or any(state in OFF for state in states)
        if released and not allowed:
            where = states[-1].label if states else "no state"
            self._break("rule 6", f"ESTOP_REQUEST released in {where}")

    def _on_torque(self, frame: Frame, axle: int, torque_nm: float, motor_rpm: int) -> None:
        t_ns = frame.t_ns
        name = ("front", "rear")[axle]
        had_none = self._torque == [0.0, 0.0]  # a log may begin in the middle of a drive: what was before is not judged
        self._torque[axle] = torque_nm
        self._cycle.ids.append(frame.can_id)
        self._check_both()
        self._rule("rule 4", f"{name} torque", *self._over_torque(t_ns, axle, torque_nm))
        limits = self._front.at(t_ns) if axle == 0 else self._rear.at(t_ns)
        limit_age_ns = t_ns - limits[-1].t_rx_ns if limits else 0
        self._rule(
            "rule 4",
            f"{name} limit age",
            torque_nm > 0 and limit_age_ns >= FEEDBACK_STALE_NS + self._in_flight_ns,
            f"{name} torque {torque_nm:.1f} Nm by a live limit {limit_age_ns / MS:.0f} ms old",
        )
        self._rule(
            "rule 4",
            f"{name} speed",
            motor_rpm > self._motor_limit_rpm + RESOLUTION,
            f"{name} motor speed limit {motor_rpm} rpm above {self._motor_limit_rpm:.0f} rpm",
        )
        if torque_nm <= 0:
            self._broken -= {f"rule 2 {name} {key}" for key in _TORQUE_KEYS}
            self._broken -= {f"rule 10 {name}", f"reactions {name}"}
            return
        if had_none:
            self._check_torque_may_rise(t_ns)
        self._cycle.torque = True
        self._torqueless_cycles = 0
        self._check_torque_allowed(t_ns, name, brakes=self._motor_brakes and motor_rpm == 0)

    def _check_torque_may_rise(self, t_ns: int) -> None:
        """Safety rule 1: after a complete quiet cycle, and the car's echo of it or a second one."""
        since_ns = self._quiet_since_ns - self._in_flight_ns
        echoed = any(
            echo.front_request_pct == 0 and echo.rear_request_pct == 0 and echo.t_rx_ns > since_ns
            for echo in self._brake_echo.at(t_ns)
        )
        if self._quiet_cycles < (1 if echoed else 2):
            self._break("rule 1", f"torque rose after {self._quiet_cycles} complete cycles without torque and brake")

    def _check_torque_allowed(self, t_ns: int, name: str, *, brakes: bool) -> None:
        statuses = self._status.at(t_ns)
        if not statuses:
            if (
                self._from_start or t_ns - (self._start_ns or 0) >= STATUS_FRESH_NS
            ):  # a log may begin in the middle of a drive
                self._rule("rule 2", f"{name} state", True, f"{name} torque before any 0x520")
            return
        newest = statuses[-1]
        driving = [status for status in statuses if status.as_state is AsState.AS_DRIVING]
        self._rule("rule 2", f"{name} state", not driving, f"{name} torque in {newest.as_state.label}")
        self._rule(
            "rule 2",
            f"{name} go",
            not brakes and not any(status.go_signal for status in statuses),
            f"{name} torque without the Go signal",
        )
        self._rule(
            "rule 2",
            f"{name} known",
            self.unknown(t_ns),
            f"{name} torque after a 0x520 whose AS_STATE no table knows",
        )
        self._rule(
            "rule 2",
            f"{name} mission",
            newest.as_state is AsState.AS_DRIVING and not self.acknowledged and not brakes,
            f"{name} torque without a mission that was acknowledged",
        )
        turned_by = self.turned
        self._rule(
            "reactions",
            name,
            turned_by is not None and t_ns - turned_by[0] >= self._in_flight_ns and not brakes,
            f"{name} torque in a run that is over: {'' if turned_by is None else turned_by[1]}",
        )
        age_ns = t_ns - newest.t_rx_ns
        self._rule(
            "rule 2",
            f"{name} age",
            age_ns >= STATUS_FRESH_NS + self._in_flight_ns,  # stale after 50 ms is stale at 50 ms
            f"{name} torque with a 0x520 {age_ns / MS:.0f} ms old",
        )
        self._rule(
            "rule 10",
            name,
            newest.as_state is AsState.AS_DRIVING and self._came_by is _Path.GONE and not brakes,
            f"{name} torque though this process has not seen AS_OFF, 5 s of AS_READY before Go, and AS_DRIVING in turn",
        )
        if self._driving_since_ns is not None:
            waited_ns = t_ns - self._driving_since_ns
            self._rule(
                "rule 2",
                f"{name} wait",
                waited_ns < LAUNCH_NS - self._slack_ns and not brakes,
                f"{name} torque {waited_ns / SECOND:.3f} s after AS_DRIVING began",
            )
        ai = self._ai
        if ai is not None:
            self._rule(
                "rule 2",
                f"{name} direction",
                ai.direction is not Direction.FORWARD,
                f"{name} torque with direction {ai.direction.label}",
            )
            self._rule("rule 2", f"{name} emergency", ai.estop_request, f"{name} torque with ESTOP_REQUEST")

    def _over_torque(self, t_ns: int, axle: int, torque_nm: float) -> tuple[bool, str]:
        limits: list[float] = [self._torque_limit_nm if self._driven[axle] else 0.0]
        echoes = self._front.at(t_ns) if axle == 0 else self._rear.at(t_ns)
        if echoes:
            limits.append(max(echo.torque_max_nm for echo in echoes))
        elif self._from_start:
            limits.append(0.0)  # the car has not said yet what it takes
        speeds = self._speeds.at(t_ns)
        if speeds and not self.wheels.open:
            fastest = min(max(one.all_rpm[2 * axle : 2 * axle + 2]) for one in speeds)
            limits.append(constant_power_nm(fastest))
        limit = min(limits)
        name = ("front", "rear")[axle]
        return torque_nm > limit + RESOLUTION, f"{name} torque {torque_nm:.1f} Nm above its limit {limit:.1f}"

    def _on_steer(self, frame: Frame, steer_deg: float) -> None:
        self._cycle.ids.append(frame.can_id)
        states = self._states(frame.t_ns)
        if states:
            where = states[-1].label
            out_of_place = steer_deg != 0 and AsState.AS_DRIVING not in states
            rule = "rule 5" if states[-1] in IDLE else "rule 4"
            self._rule(rule, "steering", out_of_place, f"steering {steer_deg:.1f} deg in {where}")
        limit = lowest = self._steer_limit_deg
        live = self._steer.at(frame.t_ns)
        if live:
            limit = min(limit, max(0.0, *(one.angle_max_deg for one in live)))
            lowest = min(limit, *(one.angle_max_deg for one in live))  # a limit that was lowered may have been seen
        elif self._from_start:
            limit = lowest = 0.0
        self._check_steering_rate(frame.t_ns, steer_deg, lowest, states)
        self._rule(
            "rule 4",
            "steering limit",
            abs(steer_deg) > limit + RESOLUTION,
            f"steering {steer_deg:.1f} deg beyond its limit {limit:.1f}",
        )

    def _check_steering_rate(self, t_ns: int, steer_deg: float, limit_deg: float, states: list[AsState]) -> None:
        """Safety rule 4; a limit that the car lowers is obeyed at once, and outside AS_DRIVING it is zero at once.

        So it is at the orderly end of the software, where a car at rest is sent zeros and NEUTRAL.
        """
        before, self._steered = self._steered, (t_ns, steer_deg)
        if before is None or not all(state is AsState.AS_DRIVING for state in states):
            return
        if steer_deg == 0.0 and self._ai is not None and self._ai.direction is Direction.NEUTRAL:
            return
        if steer_deg == 0.0 and self._driving_since_ns is not None and before[0] < self._driving_since_ns:
            return  # AS_DRIVING began between the two: before it, zero was due at once
        step_ns = t_ns - before[0] + self._in_flight_ns
        most_deg = self._steer_rate_degps * step_ns / SECOND + 0.1  # the signal's resolution
        turned_deg = abs(steer_deg - before[1])
        self._rule(
            "rule 4",
            "steering rate",
            turned_deg > most_deg + RESOLUTION and abs(before[1]) <= limit_deg + RESOLUTION,
            f"steering turned by {turned_deg:.1f} deg in {step_ns / MS:.1f} ms",
        )

    def _on_brake(self, frame: Frame, brake: AiBrake) -> None:
        had_none = self._brakes == (0.0, 0.0)
        self._brakes = (brake.front_pct, brake.rear_pct)
        self._cycle.ids.append(frame.can_id)
        self._check_both()
        states = self._states(frame.t_ns)
        unbraked = bool(states) and all(state in UNBRAKED for state in states)
        self._rule(
            "output table",
            "brake",
            unbraked and any(self._brakes),
            f"brake {max(self._brakes):.1f} % in {states[-1].label if states else 'no AS state'}",
        )
        if not any(self._brakes):
            return
        self._cycle.brake = True
        self._quiet_cycles = 0
        if had_none and self._torqueless_cycles < 1:
            self._break("rule 1", "brake rose before a complete cycle without torque")

    def _check_both(self) -> None:
        torque_nm = max(one or 0.0 for one in self._torque)
        brake_pct = max(self._brakes or (0.0,))
        self._rule(
            "rule 1",
            "both",
            torque_nm > 0 and brake_pct > 0,
            f"torque {torque_nm:.1f} Nm and brake {brake_pct:.1f} % together",
        )

    # ------------------------------------------------------------ bookkeeping

    def _states(self, t_ns: int) -> list[AsState]:
        return [status.as_state for status in self._status.at(t_ns)]

    def _standing(self, t_ns: int) -> bool:
        """Safety rule 3: fresh wheel speeds, all under 10 rpm for half a second, and pulse counts that do not run."""
        return self.wheels.may_stand(t_ns)

    def _stood_before(self, t_ns: int) -> bool:
        """Whether a log that began less than half a second ago may have begun with a standing car."""
        return not self._from_start and not self.wheels.turned and t_ns - (self._start_ns or 0) < STILL_NS

    def _strange(self, frame: Frame) -> None:
        """Safety rule 8: a log does not name senders, so: what nobody on this bus should send."""
        if frame.can_id in self._strange_ids:
            self.violation_count += 1
            return
        self._strange_ids.add(frame.can_id)
        kind = "extended " if frame.extended else "remote " if frame.remote else ""
        self._break("rule 8", f"{kind}identifier 0x{frame.can_id:03X}, which nobody on this bus should send")

    def _rule(self, rule: str, key: str, broken: bool, text: str) -> None:
        """Record the moment at which a condition turns bad, not every frame for which it stays so."""
        name = f"{rule} {key}"
        if not broken:
            self._broken.discard(name)
        elif name not in self._broken:
            self._broken.add(name)
            self._break(rule, text)

    def _break(self, rule: str, text: str) -> None:
        self.violation_count += 1
        if len(self.violations) < _KEPT:
            t_s = (self._now_ns - (self._start_ns or 0)) / SECOND
            self.violations.append(f"{t_s:.3f} s: {rule}: {text}")


# ---------------------------------------------------------------- logs


class LogError(ValueError):
    """A line that is not of a candump log."""


def read_candump(path: Path | str) -> Iterator[Frame]:
    """The frames of a `candump -L` log (plain or .gz), with their times in nanoseconds. Raises LogError, OSError."""
    path = Path(path)
    with _open(path) as lines:
        for number, line in enumerate(lines, start=1):
            if line.strip():
                try:
                    yield _parse(line)
                except (ValueError, IndexError):
                    raise LogError(f"{path}:{number}: not a line of a candump log: {line.strip()[:80]}") from None


def _open(path: Path) -> IO[str]:
    if path.suffix == ".gz":
        return gzip.open(path, "rt", errors="replace")
    return path.open(errors="replace")


def _parse(line: str) -> Frame:
    stamp, _channel, text, *_direction = line.split()
    seconds, _, fraction = stamp.strip("()").partition(".")
    t_ns = int(seconds) * SECOND + int(fraction.ljust(9, "0")[:9])
    identifier, sharp, payload = text.partition("#")
    if not sharp:
        raise ValueError(text)
    number = int(identifier, 16)
    extended = len(identifier) > 3
    if extended and number & 0x2000_0000:  # CAN_ERR_FLAG of SocketCAN
        return Frame(number & 0x1FFF_FFFF, bytes.fromhex(payload), t_ns, error=True)
    if payload.startswith("R"):
        return Frame(number, b"", t_ns, extended=extended, remote=True)
    return Frame(number, bytes.fromhex(payload), t_ns, extended=extended)


def check_candump(path: Path | str, codec: Codec, *, busy_machine: bool = False) -> WireReport:
    """Check a whole log; for `busy_machine` see `checker_for`."""
    checker = checker_for(codec, busy_machine=busy_machine)
    for frame in read_candump(path):
        checker.on_frame(frame)
    return checker.report()


def checker_for(codec: Codec, *, busy_machine: bool) -> WireChecker:
    """A checker for a bus of processes in real time.

    busy_machine: sender and receiver shared their processors with much else, so a frame on the bus may not have been
    received for some time. An echo is then missed when the car itself would call it missed, after 100 ms.
    """
    if not busy_machine:
        return WireChecker(codec)
    return WireChecker(codec, in_flight_ns=CAR_PATIENCE_NS // 2, handshake_in_flight_ns=CAR_PATIENCE_NS)
