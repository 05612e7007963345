"""The rules on the wire, judged by one who stands beside the bus and knows nothing of supervisor and gate.

`WireChecker` is fed with what was on the bus, of the car and of the AI computer, in the order of time: as frames, or as
their decoded images. That is enough for a log. Who drives the process itself also tells what the process is told
(commands, modes, confirmations, lost buses) by a `Process`; what can be known only so is checked only then. And where
everything is told that can stop a drive (`nothing_hidden`), each output has exactly one right value, and is held to it.

What is on the wire at an instant was decided a little earlier: a value that the car sent less than `in_flight_ns` ago
may not have been seen yet. A rule is broken only when it is broken for every value that the sender can have seen.

A rule is a function below the decorator `_rule`, which says what it is called and which frames it is held against; what
it yields is what is wrong. The clauses are those of the safety rules, the numbers are in `numbers.py`.
"""

from __future__ import annotations

import math
import re
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from fsai_hil.rules.numbers import (
    CAR_PATIENCE_NS,
    COMMAND_FRESH_NS,
    COMMAND_LOST_NS,
    CYCLE_GAP_NS,
    CYCLE_NS,
    DATA_FRESH_NS,
    FEEDBACK_LOST_NS,
    FEEDBACK_STALE_NS,
    FUTURE_NS,
    LAUNCH_NS,
    LISTEN_FIRST_NS,
    MOST_MOTOR_RPM,
    MOST_TORQUE_NM,
    MS,
    ODD_LOST_NS,
    ODD_NS,
    ODD_STEER_DEG,
    ODD_STEER_SETTLED_NS,
    ODD_WHEEL_RPM,
    PEDALS_NS,
    POWER_CYCLE_NS,
    READY_SEEN_NS,
    SEND_LOST_NS,
    STATUS_FRESH_NS,
    STATUS_LOST_NS,
    STILL_NS,
    STILL_RPM,
    S,
    constant_power_nm,
)
from fsai_hil.rules.response import ResponseTimes
from fsai_hil.rules.seen import NOBODY, Order, Process, Seen, marks_of, plain_of, put_plain, put_times, times_of
from fsai_hil.rules.violation import Violation
from fsai_hil.rules.wheels import Belief, Wheels
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS, VehicleParameters
from fsai_vcu.diagnostics.log.reader import LogError, open_log
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.codec import Codec, Decoded
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiImage,
    AiStatus,
    AiSteer,
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

RULES: Final = {
    "1": "torque and brake never meet at the VCU",
    "2": "torque only with everything that allows it",
    "3": "NEUTRAL or FINISHED in AS_DRIVING only at proven rest",
    "4": "steering, torque and motor speed within every limit",
    "5": "before AS_DRIVING: zeros, NEUTRAL, at most SELECTED",
    "6": "an emergency request latches",
    "7": "commands out of order are refused whole",
    "8": "the five frames and no other, and only of a process that may send",
    "9": "the handshake echoes the last bit received",
    "10": "no drive goes on after a restart",
    "output table": "status, direction, steering and brake are those of the AS state and of what is due",
    "modes": "autonomous only as it was chosen, manual after a lost command",
    "reactions": "graded reactions come in time",
    "interval": "two cycles are never closer than 8 ms",
    "safe end": "a safe end is reached from every state",
}

ROLES: Final = frozenset(("planner", "controller"))
OFF: Final = (AsState.AS_INIT, AsState.AS_OFF)
IDLE: Final = (*OFF, AsState.AS_READY)
UNBRAKED: Final = (*OFF, AsState.EMERGENCY_BRAKE)  # output table: the car holds or brakes itself there
_OFF_SEEN, _READY_SEEN, _WHOLE = 1, 2, 3  # how far AS_OFF, AS_READY, AS_DRIVING were seen in turn
STATUS_ID: Final = 0x520
RESTART_GAP_NS: Final = 150 * MS  # a process that starts listens for 200 ms before its first frame
STEER_STEP_DEG: Final = 0.1  # interface specification v4.0: the signals' resolution
BRAKE_STEP_PCT: Final = 0.5
LONGEST_TURN_NS: Final = 2 * CYCLE_NS  # after a longer pause nobody turns by all that was missed
TINY: Final = 1e-6  # of a float
Saved = tuple[tuple[object, ...], tuple[int, ...]]
_KEPT: Final = 1000  # violations kept as text; all are counted


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
    """The frames of one cycle as they came."""

    ids: list[int] = field(default_factory=list)
    selected: bool = False
    torque: bool = False
    brake: bool = False
    motor_rpm: int = 0


Check = Callable[["WireChecker", Any], Iterator[str]]
_CHECKS: Final[dict[str, list[tuple[str, Check]]]] = {
    kind: [] for kind in ("0x510", "drive", "torque", "0x513", "0x514")
}


def _rule(name: str, *kinds: str) -> Callable[[Check], Check]:
    """The function holds rule `name` against each frame of these kinds; what it yields is wrong.

    "drive" is 0x511 and 0x512, "torque" those of them that ask for some.
    """

    def registered(check: Check) -> Check:
        for kind in kinds:
            _CHECKS[kind].append((name, check))
        return check

    return registered


_DIGITS: Final = re.compile(r"[\d.,]+")


class WireChecker:
    """Feed it with `on_frame`; read `violations` at any time and `report()` at the end. Times are ns.

    `handshake_in_flight_ns` is how young a 0x520 may be and not yet be echoed; `clock_slack_ns` covers the difference
    between a sender's clock reading and the time stamp on the bus. All three at 0 is the view of the sender itself.

    `car` and `limits` add what rule 4 says of steering rate, driven axles and the venue. `from_start`: the first frame
    is the first that the sending process could hear, and `restarted` says when another takes its place; without it
    what was before the log is not judged. `motor_brakes`: the car on which torque against a motor speed limit of zero
    is the brake, which rule 2 does not mean. `short_sequence`: the car whose VCU does not keep to the 5 s in AS_READY.

    With a `process` the caller tells what the process is told, by the methods `on_…` and round each cycle by
    `before_cycle`, `on_mode_shown` and `cycle_over`. An intruder on the AI computer's own ids cannot be told apart on
    a log; whoever knows it keeps his frames from `on_frame`, or uses `received` and `sent`.
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
        steer_rate_degps: float | None = None,
        from_start: bool = False,
        motor_brakes: bool = False,
        short_sequence: bool = False,
        process: Process | None = None,
    ) -> None:
        self.found: list[tuple[int, Violation]] = []
        self.violation_count = 0
        self.responses = ResponseTimes()
        self._codec = codec
        self._known_ids = frozenset(message.frame_id for message in codec.database.messages)
        self._process = process
        self._all_told = process is not None and process.nothing_hidden
        self._slack_ns = clock_slack_ns
        self._handshake_in_flight_ns = handshake_in_flight_ns
        self._in_flight_ns = in_flight_ns
        self._from_start = from_start
        self._motor_brakes = motor_brakes
        self._short_sequence = short_sequence
        self._pulses_per_rev = max(one.wheel_pulses_per_rev for one in ((car,) if car else CARS.values()))
        self._driven = (True, True) if car is None else (car.driven_front, car.driven_rear)
        self._steer_rate_degps = math.inf if car is None else math.degrees(car.steer_rate_radps)
        if steer_rate_degps is not None:
            self._steer_rate_degps = steer_rate_degps
        self._steer_limit_deg = min(codec.revision.steer_limit_deg, limits.max_steer_deg)
        self._command_limit_deg = codec.revision.steer_limit_deg
        self._torque_limit_nm = min(MOST_TORQUE_NM, limits.max_axle_torque_nm)
        self._motor_limit_rpm = MOST_MOTOR_RPM
        self._rpm_per_mps = math.inf
        if car is not None:
            self._torque_limit_nm = min(self._torque_limit_nm, car.axle_torque_max_nm)
            self._rpm_per_mps = car.wheel_rpm_of_speed(1.0) * car.gear_ratio
            self._motor_limit_rpm = min(MOST_MOTOR_RPM, min(limits.max_speed_mps, 1000.0) * self._rpm_per_mps)

        self._start_ns: int | None = None
        self._now_ns = 0
        self._frames = 0
        self._error_frames = 0
        self._problems: Counter[str] = Counter()
        self._broken: dict[str, set[str]] = {}
        self._strange_ids: set[int] = set()
        self._well_formed: set[tuple[int, bytes]] = set()
        self._as_states: list[tuple[int, AsState]] = []
        self._cycles = 0
        self._incomplete = 0
        self._shortest_ns: int | None = None
        self._know_nothing()

    def _know_nothing(self) -> None:
        """Nothing has been heard yet, by the process that sends."""
        known = self._from_start  # what a log does not show is taken in favour of the sender
        self.seen = Seen(restarted=known, acknowledged=not known, torque_may_be_there=known, torque_runs=not known)
        self.wheels = Wheels(self._pulses_per_rev, self._in_flight_ns, self._slack_ns)
        self._late: dict[str, deque[tuple[int, Any]]] = {}
        self._toggle: tuple[int, bool] | None = None
        self._ai_silent = False
        self._was_off = False  # AS_INIT or AS_OFF was the state at some time since the last 0x510
        self._ai = AiStatus()
        self._cycle = _Cycle()
        self._cycle_ns: int | None = None
        self._interval_ns: int | None = None
        self._zero_echo_ns: int | None = None
        self._states: tuple[AsState, ...] = ()
        # of the cycle in hand
        self._told: Order | None = None  # the command that may be obeyed
        self._over = False  # the stop was latched in an earlier cycle
        self._may_turn_manual = self._must_turn_manual = False
        # only where stops may be hidden
        self._whole_in_a_row = 0
        self._asked_deg: tuple[float, int] = (0.0, 0)  # steering, and since when it has been the same

    # ------------------------------------------------------------ what was found

    @property
    def violations(self) -> list[str]:
        """What broke a rule, with its time in the log."""
        start_ns = self._start_ns or 0
        return [
            f"{(t_ns - start_ns) / S:.3f} s: {'rule ' if one.rule.isdigit() else ''}{one.rule}: {one.words}"
            for t_ns, one in self.found
        ]

    def report(self) -> WireReport:
        """What has been seen so far."""
        start = self._start_ns or 0
        return WireReport(
            frames=self._frames,
            duration_s=(self._now_ns - start) / S,
            cycles=self._cycles,
            incomplete_cycles=self._incomplete,
            shortest_cycle_ms=None if self._shortest_ns is None else self._shortest_ns / MS,
            responses=len(self.responses),
            response_p50_ms=self.responses.quantile_ms(0.5),
            response_p99_ms=self.responses.quantile_ms(0.99),
            response_p999_ms=self.responses.quantile_ms(0.999),
            response_max_ms=self.responses.quantile_ms(1.0),
            error_frames=self._error_frames,
            as_states=tuple(((t_ns - start) / S, state.label) for t_ns, state in self._as_states),
            problems=dict(self._problems),
            violation_count=self.violation_count,
            violations=tuple(self.violations),
        )

    def taken(self) -> tuple[Violation, ...]:
        """What has been found since the last time, which is forgotten."""
        found, self._broken = tuple(one for _, one in self.found), {}
        self.found = []
        return found

    def _wrong(self, rule: str, words: str) -> None:
        self.violation_count += 1
        if len(self.found) < _KEPT:
            self.found.append((self._now_ns, Violation(rule, words)))

    def _judge(self, kind: str, image: Any, frame: str) -> None:
        """Hold a frame against its rules: said is the moment at which something turns wrong, not how long it stays."""
        wrong: set[str] = set()
        before = self._broken.get(frame, ())
        for rule, check in _CHECKS[kind]:
            for words in check(self, image):
                key = rule + _DIGITS.sub("", words)
                if key not in wrong and key not in before:
                    self._wrong(rule, words)
                wrong.add(key)
        if wrong or before:
            self._broken[frame] = wrong

    # ------------------------------------------------------------ as a value

    def saved(self, now_ns: int, *, data_may_be_lost: bool) -> Saved:
        """What has been seen without the times, and the ages of the times in ns, below 0: never.

        What no rule looks at any more is forgotten. For who tells everything, between two cycles.
        `data_may_be_lost`: a command may come that is lost as it comes, for its data is too old.
        """
        self._forget(now_ns, data_may_be_lost)
        rpm, wheel_ages = self.wheels.saved(now_ns)
        ages = [-1 if t_ns is None else now_ns - t_ns for t_ns in times_of(self.seen)]
        return (rpm, *plain_of(self.seen)), (*ages, *wheel_ages)

    def load(self, saved: Saved, now_ns: int) -> None:
        """Put back what was saved."""
        (rpm, *plain), ages = saved
        seen = self.seen
        for put, value in zip(put_plain, plain, strict=True):
            put(seen, value)
        for put, age in zip(put_times, ages, strict=False):
            put(seen, None if age < 0 else now_ns - age)
        seen.turned, self._was_off, self._cycle_ns, self._toggle = None, False, None, None
        self.wheels.load(rpm, ages[-4:], now_ns)  # type: ignore[arg-type]

    def _forget(self, now_ns: int, data_may_be_lost: bool) -> None:
        s = self.seen
        driving = s.as_state is AsState.AS_DRIVING
        age_ns = -1 if s.command_ns is None else now_ns - s.command_ns
        if not driving or s.latched or not s.autonomous or (s.stopped and age_ns >= COMMAND_FRESH_NS):
            s.order = s.command_ns = None  # no command counts any more
        elif age_ns >= COMMAND_FRESH_NS:
            s.order = None
        elif s.stopped and s.order is not None:  # only its steering counts
            s.order = s.order._replace(throttle=0.0, brake=0.0, finished=False, estop=False)
        if s.stopped or s.order is None:
            s.pedals_ns = None
        if s.stopped:
            s.stopped, s.pedals_ns = "a stop is due", None
        if s.alarm is not None:
            s.alarm = None if s.latched else "an emergency is due"
        if not driving:
            s.go = s.fault = False
            s.braked_pct, s.back_ns = 0.0, None
        if not driving or s.stopped:
            s.front_ns = s.front_ns and now_ns
            s.rear_ns = s.rear_ns and now_ns
        if not driving or (s.stopped and s.latched):
            s.steer_ns = s.steer_ns and now_ns
            s.complete_ns = s.complete_ns and now_ns
            s.steer_odd_ns = s.wheel_odd_ns = None
        if s.command_ns is not None and s.driving_ns is not None and not data_may_be_lost and age_ns < CYCLE_NS:
            s.driving_ns = max(s.driving_ns, now_ns - LAUNCH_NS)  # how long it has waited for commands is no matter
        if s.back_ns is not None and not s.reopening:
            times = s.status_ns, s.steer_ns, self.wheels.may_count_ns
            if s.latched or all(t_ns is not None and t_ns >= s.back_ns for t_ns in times):
                s.back_ns = None  # everything has been heard since
        s.echoed = s.echoed and s.zeros == 1
        s.torque_nm = (float(s.torque_nm[0] > 0.0), float(s.torque_nm[1] > 0.0))
        s.brake_pct = (float(s.brake_pct[0] > 0.0), float(s.brake_pct[1] > 0.0))

    # ------------------------------------------------------------ what is on the bus

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
        return self.on_decoded(frame.can_id, self._codec.decode(frame), frame.t_ns)

    def on_decoded(self, can_id: int, decoded: Decoded, t_ns: int) -> Image | None:
        """The same, decoded already."""
        self._now_ns = t_ns
        image = decoded.image
        for problem in decoded.problems:
            self._problems[problem] += 1
        if can_id == STATUS_ID:
            self._on_any_status(decoded, t_ns)
        if can_id in AI_IDS:
            if image is None:
                self._wrong("7", f"0x{can_id:03X} cannot be believed: {'; '.join(decoded.problems)}")
            else:
                self.on_ai(can_id, image, t_ns)  # type: ignore[arg-type]
            return image
        s = self.seen
        if isinstance(image, VcuStatus):
            self._on_status(image, t_ns)
        elif isinstance(image, VcuDriveFront):
            s.front_max_nm, s.front_ns = image.torque_max_nm, t_ns
            self._note("front", t_ns, image.torque_max_nm)
        elif isinstance(image, VcuDriveRear):
            s.rear_max_nm, s.rear_ns = image.torque_max_nm, t_ns
            self._note("rear", t_ns, image.torque_max_nm)
        elif isinstance(image, VcuSteer):
            s.angle_deg, s.angle_max_deg, s.steer_ns = image.angle_deg, max(0.0, image.angle_max_deg), t_ns
            self._note("angle", t_ns, s.angle_max_deg)
        elif isinstance(image, VcuBrake):
            zero = image.front_request_pct == image.rear_request_pct == 0.0
            s.echoed = (zero or (s.echoed and self._in_flight_ns > 0)) and s.zeros > 0
            self._zero_echo_ns = t_ns if zero else self._zero_echo_ns
        elif isinstance(image, WheelSpeeds):
            if self.wheels.on_speeds(image.all_rpm, t_ns) is not Belief.NO:
                self._note("rpm", t_ns, image.all_rpm)
        elif isinstance(image, WheelCounts):
            self.wheels.on_counts((image.fl, image.fr, image.rl, image.rr), t_ns)
        return image

    def _note(self, name: str, t_ns: int, value: Any, in_flight_ns: int | None = None) -> None:
        """Keep a value and those before it that a sender may have seen last instead."""
        in_flight_ns = self._in_flight_ns if in_flight_ns is None else in_flight_ns
        if not in_flight_ns:
            return
        values = self._late.setdefault(name, deque())
        values.append((t_ns, value))
        while len(values) > 1 and t_ns - values[1][0] >= in_flight_ns:
            values.popleft()

    def _possible(self, name: str, newest: Any, in_flight_ns: int | None = None) -> list[Any]:
        """What a sender can have seen last by now."""
        in_flight_ns = self._in_flight_ns if in_flight_ns is None else in_flight_ns
        values = self._late.get(name)
        if not in_flight_ns or not values:
            return [] if newest is None else [newest]
        while len(values) > 1 and self._now_ns - values[1][0] >= in_flight_ns:
            values.popleft()
        return [value for _, value in values]

    def _strange(self, frame: Frame) -> None:
        """Safety rule 8: a log does not name senders, so: what nobody on this bus should send."""
        kind = "extended " if frame.extended else "remote " if frame.remote else ""
        if frame.can_id in self._strange_ids:
            self.violation_count += 1
            return
        self._strange_ids.add(frame.can_id)
        self._wrong("8", f"{kind}identifier 0x{frame.can_id:03X}, which nobody on this bus should send")

    # ------------------------------------------------------------ what the car says

    def _on_any_status(self, decoded: Decoded, t_ns: int) -> None:
        s = self.seen
        if s.heard_ns is not None and t_ns - s.heard_ns >= POWER_CYCLE_NS + self._in_flight_ns:
            s.silent = True
        s.heard_ns, s.unknown = t_ns, decoded.image is None
        self._note("known", t_ns, decoded.image is not None)
        bit = decoded.handshake
        if bit is None:
            return
        if s.handshake is not bit:
            alive = self._cycle_ns is not None and t_ns - self._cycle_ns < 100 * MS
            self._toggle = (t_ns, bit) if alive else None
        s.handshake = bit
        if self._handshake_in_flight_ns:
            if "bit" not in self._late:
                self._late["bit"] = deque([(t_ns, False)])  # before the first one there was nothing to echo
            self._note("bit", t_ns, bit, self._handshake_in_flight_ns)

    def _on_status(self, status: VcuStatus, t_ns: int) -> None:
        s, state, first = self.seen, status.as_state, self.seen.as_state is None
        unjudged = first and not self._from_start  # what was before a log is not known
        self._note("state", t_ns, state)
        self._note("go", t_ns, status.go_signal)
        self._was_off = self._was_off or state in OFF
        entered_off = state in OFF and not first and (s.as_state not in OFF or s.silent)
        if entered_off or (status.ami is not s.mission and (state in IDLE or first)):
            s.mission, s.confirmed, s.acknowledged = status.ami, NOBODY, unjudged
            s.order, s.command_ns = None, None  # of the run before
        anew = s.silent or state is not s.as_state
        self._follow_path(status, anew, unjudged, t_ns)
        s.as_state, s.go, s.fault, s.status_ns = state, status.go_signal, status.fault, t_ns
        marks = marks_of(status)
        if anew:
            self._as_states.append((t_ns, state))
            s.pedals_ns = None
            if state is AsState.AS_DRIVING:
                s.driving_ns = None if unjudged else t_ns
                s.turned, s.stopped, s.alarm = None, None, None
        if state is not AsState.AS_DRIVING:
            if s.alarm is not None and (s.bus_gone or s.reopening):
                s.latched = True  # what a lost bus did not carry is asked for when it is back
            s.driving_ns, s.turned, s.stopped, s.alarm = None, None, None, None
        elif s.marks is not None and not marks <= s.marks:
            words = "; ".join(sorted(marks - s.marks))
            if self._process is not None:
                self._stop(f"in AS_DRIVING {words}")
            else:
                s.turned = s.turned or (t_ns, words)
        s.marks = marks
        s.reopening = False

    def _follow_path(self, status: VcuStatus, anew: bool, unjudged: bool, t_ns: int) -> None:
        """AS_OFF, AS_READY, AS_DRIVING in turn, and 5 s of AS_READY with Go off."""
        s, state = self.seen, status.as_state
        silent = self._cycle_ns is not None and t_ns - self._cycle_ns >= RESTART_GAP_NS
        if silent and not self._ai_silent and not self._from_start:
            s.path, s.restarted = 0, True  # whoever speaks next must see the whole way anew
        self._ai_silent = silent
        if s.silent:
            s.path, s.power_up = 0, True
            if state in OFF and self._process is not None:
                s.latched = False
        if anew and status.ami is not s.mission:
            s.path = 0  # the car enters a state for a mission that nobody has acknowledged
        s.silent = False
        if unjudged:
            s.path = {AsState.AS_READY: _OFF_SEEN, AsState.AS_DRIVING: _READY_SEEN}.get(state, 0)
            s.waited = True
        if state is AsState.AS_READY:
            if anew and not unjudged:
                s.ready_ns, s.waited = t_ns, False
            if not status.go_signal and s.ready_ns is not None:
                s.waited = t_ns - s.ready_ns + self._in_flight_ns >= READY_SEEN_NS
        else:
            s.ready_ns = None
            s.waited = s.waited and state is AsState.AS_DRIVING
        if state in OFF:
            s.path, s.restarted = _OFF_SEEN, False
        elif state is AsState.AS_READY:
            s.path = _READY_SEEN if s.path in (_OFF_SEEN, _READY_SEEN) else 0
        elif state is AsState.AS_DRIVING:
            s.path = _WHOLE if s.path in (_READY_SEEN, _WHOLE) else 0
        else:
            s.path = 0

    # ------------------------------------------------------------ what the AI computer says

    def on_ai(self, can_id: int, image: AiImage, t_ns: int) -> None:
        """A frame of the AI computer, which says `image`."""
        self._now_ns, s = t_ns, self.seen
        if self._in_flight_ns:
            self._states = tuple(self._possible("state", None))
        else:
            self._states = () if s.as_state is None else (s.as_state,)
        cycle = self._cycle
        if isinstance(image, AiStatus):
            self._begin_cycle(t_ns)
            self._ai = image
            self._cycle.selected = image.mission_status is MissionStatus.SELECTED
            if s.ended is not None:
                s.ended += 1
            self._judge("0x510", image, "0x510")
            self._answered(image.handshake, t_ns)
            s.latched = image.estop_request or (s.latched and self._process is not None)
            self._was_off = bool(self._states) and self._states[-1] in OFF
            return
        cycle.ids.append(can_id)
        if isinstance(image, AiDriveFront | AiDriveRear):
            front = isinstance(image, AiDriveFront)
            s.torque_nm = (image.torque_nm, s.torque_nm[1]) if front else (s.torque_nm[0], image.torque_nm)
            cycle.motor_rpm = max(cycle.motor_rpm, image.motor_speed_max_rpm)
            self._judge("drive", image, f"0x{can_id:03X}")
            if image.torque_nm > 0.0:
                self._judge("torque", image, f"torque of 0x{can_id:03X}")
                cycle.torque = s.torque_runs = s.torque_may_be_there = True
                s.zeros, s.echoed = 0, False
            else:
                self._broken.pop(f"torque of 0x{can_id:03X}", None)
        elif isinstance(image, AiSteer):
            self._judge("0x513", image, "0x513")
            if image.steer_deg != self._asked_deg[0]:
                self._asked_deg = image.steer_deg, t_ns
            s.steer_deg, s.steered_ns = image.steer_deg, t_ns
        elif isinstance(image, AiBrake):
            s.brake_pct = image.front_pct, image.rear_pct
            self._judge("0x514", image, "0x514")
            s.braked_pct = max(s.brake_pct)
            if any(s.brake_pct):
                cycle.brake = True
                s.zeros, s.echoed = 0, False

    def _begin_cycle(self, t_ns: int) -> None:
        if self._cycle.ids:
            self.cycle_over(t_ns)
        self._interval_ns = None if self._cycle_ns is None else t_ns - self._cycle_ns
        if self._interval_ns is not None:
            shortest = self._interval_ns if self._shortest_ns is None else self._shortest_ns
            self._shortest_ns = min(self._interval_ns, shortest)
            if self._interval_ns >= RESTART_GAP_NS and not self._from_start:
                self.seen.latched = False  # another process
        self._cycle_ns = t_ns
        self._cycles += 1
        self._cycle.ids.append(AI_IDS[0])

    def cycle_over(self, now_ns: int, made: bool = True) -> None:
        """No more frames of this cycle come; else the next one's first says so. `made`: it was to be sent at all."""
        s, cycle = self.seen, self._cycle
        complete = tuple(cycle.ids) == AI_IDS
        drives = AI_IDS[1] in cycle.ids and AI_IDS[2] in cycle.ids
        if cycle.ids and not complete:
            self._incomplete += 1
        if complete:
            s.acknowledged = s.acknowledged or cycle.selected
            if not cycle.torque:
                s.torque_may_be_there = False
                if not cycle.brake:
                    s.zeros = min(2, s.zeros + 1)
                    began_ns = (self._cycle_ns or now_ns) - self._in_flight_ns
                    s.echoed = s.echoed or (self._zero_echo_ns is not None and self._zero_echo_ns > began_ns)
        if drives:
            s.torque_runs = cycle.torque
        self._whole_in_a_row = self._whole_in_a_row + 1 if complete else 0
        if self._process is not None and made:
            s.whole = complete
            if complete or s.complete_ns is None:
                s.complete_ns = now_ns
            elif now_ns - s.complete_ns >= SEND_LOST_NS and s.as_state is AsState.AS_DRIVING:
                self._lose("no cycle went out whole for 50 ms")
                s.complete_ns = now_ns
        self._cycle = _Cycle()

    def _answered(self, bit: bool, t_ns: int) -> None:
        """How long the car waited for its echo."""
        if self._toggle is not None and bit == self._toggle[1]:
            self.responses.add(t_ns - self._toggle[0])
            self._toggle = None

    # ------------------------------------------------------------ what happens to the process

    def received(self, frame: Frame) -> None:
        """A frame that reached the process, of whoever's."""
        if frame.error:
            return
        if frame.can_id in AI_IDS and not frame.extended:
            self.on_intruder(f"0x{frame.can_id:03X} of somebody else was received")
        elif not frame.extended and not frame.remote and self._codec.knows(frame.can_id):
            self.on_frame(frame)

    def sent(self, frame: Frame) -> AiImage | None:
        """A frame of the process went out. Returns what it says, None for what should never have been sent."""
        self._now_ns = frame.t_ns
        self.on_sending()
        if not self.well_formed(frame):
            return None
        image = self.on_frame(frame)
        return image if isinstance(image, AiStatus | AiDriveFront | AiDriveRear | AiSteer | AiBrake) else None

    def on_sending(self) -> None:
        """Safety rule 8, and the 200 ms of listening: whether the process may send at all."""
        s, process = self.seen, self._process
        assert process is not None
        if process.listen_only:
            self._wrong("8", "a process that only listens sends")
        if s.bus_gone:
            self._wrong("8", "frames are sent on a lost bus")
        if s.began_ns is None or self._now_ns - s.began_ns < LISTEN_FIRST_NS:
            self._wrong("8", "frames are sent before the process has listened for 200 ms")

    def well_formed(self, frame: Frame) -> bool:
        """Safety rules 7 and 8: one of the five ids, its length, and values that cantools takes and gives back."""
        key = (frame.can_id, frame.data)
        if key in self._well_formed:
            return True
        if frame.extended or frame.remote or frame.error or frame.can_id not in AI_IDS:
            self._wrong("8", f"0x{frame.can_id:X} was sent")
            return False
        if len(frame.data) != BY_ID[frame.can_id].dlc:
            self._wrong("8", f"0x{frame.can_id:03X} was sent with {len(frame.data)} bytes")
            return False
        message = self._codec.database.get_message_by_frame_id(frame.can_id)
        values = message.decode(frame.data, decode_choices=False, allow_truncated=False)
        assert isinstance(values, dict)
        for signal in message.signals:
            value = values[signal.name]
            low, high = signal.minimum, signal.maximum
            assert isinstance(value, int | float)
            if (low is not None and value < low) or (high is not None and value > high):
                self._wrong("7", f"{signal.name} is {value} on the wire, outside {low} … {high}")
                return False
        if bytes(message.encode(values, strict=True)) != frame.data:
            self._wrong("7", f"0x{frame.can_id:03X} carries bits of no signal: {frame.data.hex(' ')}")
            return False
        if len(self._well_formed) < 200_000:
            self._well_formed.add(key)
        return True

    def on_command(self, command: VehicleCommand, refused: bool, now_ns: int, *, current: bool) -> None:
        """Safety rule 7: a command was handed in, of the run in hand (`current`) or of another."""
        s = self.seen
        self._now_ns = now_ns
        fit = (
            all(map(math.isfinite, (command.steering_rad, command.throttle, command.brake, command.speed_limit_mps)))
            and abs(command.steering_rad) <= math.radians(self._command_limit_deg) + 1e-9
            and 0.0 <= command.throttle <= 1.0
            and 0.0 <= command.brake <= 1.0
            and command.speed_limit_mps >= 0.0
            and command.t_sensor_ns - now_ns <= FUTURE_NS
        )
        takes = fit and current and not s.bus_gone
        if not refused and not (fit and current):
            self._wrong("7", f"taken, though out of order or of another run: {command}")
        if refused and takes:
            self._wrong("7", f"refused, though in order: {command}")
        if takes:
            steer_deg = math.degrees(command.steering_rad)
            wishes = command.mission_finished, command.estop_request
            s.order = Order(steer_deg, command.throttle, command.brake, command.speed_limit_mps, *wishes)
            s.command_ns = min(now_ns, command.t_sensor_ns + DATA_FRESH_NS - COMMAND_FRESH_NS)

    def on_mode(self, mode: str, answer: tuple[bool, str], now_ns: int) -> None:
        """Somebody asked for a mode."""
        (done, words), s, process = answer, self.seen, self._process
        assert process is not None
        self._now_ns = now_ns
        if mode == "manual":
            if not done:
                self._wrong("modes", f"manual was refused: {words}")
            s.autonomous = s.power_up = False
            self._stop("manual was asked for")
        elif mode == "autonomous":
            known = s.status_ns is not None and now_ns - s.status_ns < STATUS_LOST_NS
            if done and (not known or s.as_state not in IDLE or process.listen_only):
                self._wrong("modes", f"autonomous was accepted in {self._where}")
            s.autonomous = s.autonomous or done
            s.power_up = s.power_up and not done
        elif done or "manual" not in words or "autonomous" not in words:
            self._wrong("modes", f"mode {mode!r} was answered with {done}, {words!r}")

    def on_emergency(self, granted: bool) -> None:
        """The operator asked for the emergency brake."""
        self.seen.latched = self.seen.latched or granted

    def on_reset(self, granted: bool, now_ns: int) -> None:
        """Safety rule 6: a reset is granted in AS_INIT and AS_OFF only."""
        s = self.seen
        self._now_ns = now_ns
        known = s.status_ns is not None and now_ns - s.status_ns < STATUS_LOST_NS
        if granted and (s.as_state not in OFF or not known):
            self._wrong("6", f"a reset was granted in {self._where}")
        s.latched = s.latched and not granted

    def on_confirmed(self, role: str) -> None:
        """Planner or controller says that it has reset itself for the run in hand."""
        s = self.seen
        if role in s.confirmed:
            self._stop(f"the {role} was restarted")
        s.confirmed = s.confirmed | (ROLES & {role})

    def on_intruder(self, words: str) -> None:
        if self._process is not None and not self._process.listen_only:
            self._alarm(words)

    def on_loop_fault(self) -> None:
        self._alarm("the loop missed its deadline")

    def on_implausible(self, steering_ns: int | None, wheel_ns: int | None) -> None:
        """Since when the process takes steering and wheels for implausible, where nothing is hidden."""
        self.seen.steer_odd_ns, self.seen.wheel_odd_ns = steering_ns, wheel_ns

    def on_bus_lost(self, now_ns: int | None = None) -> None:
        """The sender has lost the bus: whatever follows, its drive needs the whole way anew."""
        s = self.seen
        if self._process is None or now_ns is None:
            s.path, s.heard_ns = 0, None  # what it cannot hear is no silence of the car's
            return
        if s.bus_gone:
            return
        if s.heard_ns is not None and now_ns - s.heard_ns >= POWER_CYCLE_NS:
            s.silent = True
        s.bus_gone = True
        self._lose("the bus was lost")

    def on_bus_back(self, now_ns: int) -> None:
        s = self.seen
        if s.bus_gone:
            s.bus_gone, s.reopening, s.back_ns, s.complete_ns = False, True, now_ns, None
            s.heard_ns = None if s.heard_ns is None else now_ns
            s.stopped_ns = now_ns
            self._whole_in_a_row = 0

    def on_end(self) -> None:
        """The software is told to stop in order."""
        if self.seen.ended is None:
            self.seen.ended = 0

    def restarted(self) -> None:
        """Another process takes the sender's place: it knows nothing, the VCU keeps what it saw last."""
        self.cycle_over(self._now_ns, made=False)
        before = self.seen
        self._know_nothing()
        self.seen.torque_nm, self.seen.brake_pct = before.torque_nm, before.brake_pct

    def _lose(self, why: str) -> None:
        """Commands are dropped, and a drive needs the whole sequence anew."""
        s = self.seen
        self._stop(why)
        s.path, s.order, s.command_ns = 0, None, None

    def _stop(self, why: str) -> None:
        s = self.seen
        if s.stopped is None and s.as_state is AsState.AS_DRIVING:
            s.stopped, s.stopped_ns = why, self._now_ns

    def _alarm(self, why: str) -> None:
        if self.seen.as_state is AsState.AS_DRIVING:
            self.seen.alarm = self.seen.alarm or why

    # ------------------------------------------------------------ what is due

    def before_cycle(self, now_ns: int) -> None:
        """The process decides what to send: what is due by now is due in these frames."""
        s, process = self.seen, self._process
        assert process is not None
        self._now_ns = now_ns
        self._may_turn_manual = self._must_turn_manual = False
        self._told = None
        waits = s.reopening and s.back_ns is not None and now_ns - s.back_ns < STATUS_LOST_NS
        if s.bus_gone or waits or (s.ended is not None and s.ended >= process.stop_cycles):
            return
        if s.began_ns is None:
            s.began_ns = now_ns
        self._over = s.stopped is not None
        age_ns = None if s.command_ns is None else now_ns - s.command_ns
        self._told = s.order if age_ns is not None and age_ns < COMMAND_FRESH_NS else None
        if s.as_state is AsState.AS_DRIVING and s.driving_ns is not None:
            self._look_at_the_run(age_ns, now_ns)
        elif (
            process.autonomous_at_power_up
            and not process.listen_only
            and s.power_up
            and s.as_state in OFF
            and self.wheels.may_stand(now_ns)
        ):
            s.autonomous, s.power_up = True, False

    def _look_at_the_run(self, age_ns: int | None, now_ns: int) -> None:
        """What stops a run in AS_DRIVING by now, and what asks for the emergency brake (graded reactions)."""
        s, process = self.seen, self._process
        assert process is not None and s.driving_ns is not None
        for why, holds in (
            ("AS_OFF, AS_READY and AS_DRIVING were not seen in turn", s.path != _WHOLE),
            ("AS_READY did not last 5 s before Go", not s.waited and not self._short_sequence),
            ("no mission was acknowledged", s.mission is Ami.NOT_SELECTED or not s.acknowledged),
            ("not both resets are confirmed", len(s.confirmed) < len(ROLES)),
            ("Go is off", not s.go),
            ("FAULT_STATUS is 1", s.fault),
            ("the software was stopped", s.ended is not None),
        ):
            if holds:
                self._stop(why)
        if self._unheard_ns(s.status_ns) >= STATUS_LOST_NS:
            self._alarm("0x520 is lost for 100 ms")
        if s.ended is not None and not self.wheels.may_stand(now_ns):
            self._alarm("the software ends, and the car is not known to stand")
        supervised_ns = now_ns - s.driving_ns - LAUNCH_NS
        lost = False
        if supervised_ns >= 0:
            lost = s.autonomous and min(supervised_ns, supervised_ns if age_ns is None else age_ns) >= COMMAND_LOST_NS
            self._look_at_feedback(now_ns)
            runs = not self._over and not s.latched
            if not self._all_told:  # no stop or emergency has begun for another reason: there would be a brake
                unbraked = self._whole_in_a_row > 2 and s.braked_pct == 0.0 and not self._motor_brakes
                runs = unbraked and s.stopped is None and not s.latched and s.alarm is None
            self._must_turn_manual = lost and runs
            if lost:
                self._stop("no valid command for 300 ms")
            self._look_at_wishes(s.driving_ns + LAUNCH_NS, now_ns)
        self._may_turn_manual = lost or s.latched  # once an emergency is latched nobody asks what becomes of commands
        if not s.autonomous:
            self._stop("the mode is manual")
        if not self._all_told and s.stopped is not None:
            wheels = self.wheels
            slow = (
                wheels.rpm is not None
                and (max(wheels.rpm) < STILL_RPM or wheels.open)
                and wheels.may_count_ns is not None
                and now_ns - wheels.may_count_ns < FEEDBACK_STALE_NS
            )
            # A stop began no later than it is known here, but what began it may have been seen a cycle before.
            if now_ns - s.stopped_ns >= process.stop_timeout_ns + 100 * MS and not slow:
                self._alarm("the car still moves long after the stop began")

    def _unheard_ns(self, t_ns: int | None) -> int:
        """For how long something has not been heard that could have been."""
        if t_ns is None:
            return S
        return self._now_ns - (t_ns if self.seen.back_ns is None else max(t_ns, self.seen.back_ns))

    def _look_at_feedback(self, now_ns: int) -> None:
        """Wheel speeds and steering feedback that are stale, missing or implausible."""
        s = self.seen
        for name, t_ns in (("wheel speeds", self.wheels.may_count_ns), ("steering feedback", s.steer_ns)):
            if self._unheard_ns(t_ns) >= FEEDBACK_STALE_NS:
                self._stop(f"{name} missing for 100 ms")
            if self._unheard_ns(t_ns) >= FEEDBACK_LOST_NS:
                self._alarm(f"{name} missing for 300 ms")
        if not self._all_told:
            s.steer_odd_ns = (s.steer_odd_ns or now_ns) if self._steering_is_odd(now_ns) else None
            s.wheel_odd_ns = (s.wheel_odd_ns or now_ns) if self._wheel_is_odd(now_ns) else None
        for name, t_ns in (("the steering", s.steer_odd_ns), ("a wheel", s.wheel_odd_ns)):
            if t_ns is not None and now_ns - t_ns >= ODD_NS:
                self._stop(f"{name} implausible for 300 ms")
            if t_ns is not None and now_ns - t_ns >= ODD_LOST_NS:
                self._alarm(f"{name} implausible for 600 ms")

    def _steering_is_odd(self, now_ns: int) -> bool:
        """The angle is far from a request that has not changed for two seconds: no delay explains that."""
        s, (asked_deg, since_ns) = self.seen, self._asked_deg
        assert s.driving_ns is not None
        since_ns = max(since_ns, s.driving_ns + LAUNCH_NS, 0 if s.back_ns is None else s.back_ns + LAUNCH_NS)
        fresh = s.steer_ns is not None and now_ns - s.steer_ns < FEEDBACK_STALE_NS
        settled = now_ns - since_ns >= ODD_STEER_SETTLED_NS and s.whole
        return fresh and settled and abs(s.angle_deg - asked_deg) > ODD_STEER_DEG

    def _wheel_is_odd(self, now_ns: int) -> bool:
        """One wheel without a motor spins while the three others nearly stand: no slip explains that."""
        rpm, believed_ns = self.wheels.rpm, self.wheels.believed_ns
        if rpm is None or believed_ns is None or now_ns - believed_ns >= FEEDBACK_STALE_NS or self._driven[0]:
            return False
        if self.seen.mission in (Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B):
            return False
        return any(rpm[one] > ODD_WHEEL_RPM and max(rpm[:one] + rpm[one + 1 :]) < STILL_RPM for one in (0, 1))

    def _look_at_wishes(self, launched_ns: int, now_ns: int) -> None:
        """What the planner asks for besides driving: the end of the mission, the emergency brake, both pedals."""
        s, told = self.seen, self._told
        both = told is not None and told.throttle > 0.0 and told.brake > 0.0
        if both and told is not None and not self._all_told:
            # The planner still brakes, not a stop for a reason that cannot be seen here.
            said = s.braked_pct == 0.0 or abs(s.braked_pct - 100.0 * told.brake) <= BRAKE_STEP_PCT / 2
            both = said and s.stopped is None and not self._motor_brakes
        if not both or s.command_ns is None:
            s.pedals_ns = None  # for as long as no command counts, none asks for both
        elif s.pedals_ns is None:
            s.pedals_ns = max(s.command_ns, launched_ns) if self._all_told else now_ns
        listens = not self._over if self._all_told else s.stopped is None
        if told is not None and s.autonomous and listens and not s.latched:
            if s.pedals_ns is not None and now_ns - s.pedals_ns >= PEDALS_NS:
                self._alarm("throttle and brake together for 100 ms")
            if told.estop:
                self._alarm("the mission asks for the emergency brake")
            if told.finished:
                self._stop("the mission is done")

    def on_mode_shown(self, mode: str) -> None:
        """What the process says of its mode once it has decided what to send."""
        s = self.seen
        if mode == "autonomous":
            if s.autonomous and self._must_turn_manual:
                self._wrong("modes", "the mode is autonomous after 300 ms without a command")
            elif not s.autonomous:
                self._wrong("modes", f"the mode is autonomous in {self._where}, and nobody chose that")
        elif s.autonomous and not self._may_turn_manual and self._all_told:
            self._wrong("modes", "the mode has become manual, and nothing asked for that")
        if self._must_turn_manual or (mode != "autonomous" and (self._may_turn_manual or not self._all_told)):
            s.autonomous = False
            self._stop("the mode is manual")

    @property
    def _where(self) -> str:
        return "no AS state yet" if self.seen.as_state is None else self.seen.as_state.label

    # ------------------------------------------------------------ the rules: 0x510

    @_rule("interval", "0x510")
    def _apart(self, ai: AiStatus) -> Iterator[str]:
        """Two sends are never closer than 8 ms."""
        if self._interval_ns is not None and self._interval_ns < CYCLE_GAP_NS - self._slack_ns:
            yield f"two cycles only {self._interval_ns / MS:.2f} ms apart"

    @_rule("8", "0x510")
    def _ends(self, ai: AiStatus) -> Iterator[str]:
        """On stop: five cycles, then silence."""
        ended, process = self.seen.ended, self._process
        if ended is not None and process is not None and ended > process.stop_cycles:
            yield "frames are sent after the orderly end"

    @_rule("9", "0x510")
    def _echoes(self, ai: AiStatus) -> Iterator[str]:
        """The handshake echo equals the last received handshake bit."""
        if self.seen.handshake is None:
            if self._from_start and ai.handshake:
                yield "handshake 1 where nothing was received"
        elif ai.handshake not in self._possible("bit", self.seen.handshake, self._handshake_in_flight_ns):
            yield f"handshake {int(ai.handshake)} where {int(not ai.handshake)} was received"

    @_rule("6", "0x510")
    def _latches(self, ai: AiStatus) -> Iterator[str]:
        """ESTOP_REQUEST stays 1 until it is cleared by a reset in AS_INIT or AS_OFF, or by the car's power cycle."""
        if not self.seen.latched or ai.estop_request:
            return
        if self._process is not None:
            yield "ESTOP_REQUEST is 0 though it was asked for, and nobody cleared it"
        elif not self._was_off and not any(state in OFF for state in self._states):
            yield f"ESTOP_REQUEST released in {self._states[-1].label if self._states else 'no state'}"

    @_rule("3", "0x510")
    def _stands(self, ai: AiStatus) -> Iterator[str]:
        """NEUTRAL or FINISHED is never sent in AS_DRIVING unless all wheels have been under 10 rpm for 0.5 s."""
        if self._driving and not self.wheels.may_stand(self._now_ns):
            if ai.direction is Direction.NEUTRAL:
                yield "NEUTRAL in AS_DRIVING before standstill"
            if ai.mission_status is MissionStatus.FINISHED:
                yield "FINISHED in AS_DRIVING before standstill"

    @_rule("5", "0x510")
    def _waits(self, ai: AiStatus) -> Iterator[str]:
        """In AS_INIT, AS_OFF and AS_READY: NEUTRAL, MISSION_STATUS at most SELECTED, as the output table says."""
        if not self._idle:
            return
        s = self.seen
        where = self._states[-1].label if self._states else "no AS state yet"
        if ai.direction is not Direction.NEUTRAL:
            yield f"direction {ai.direction.label} in {where}"
        if ai.mission_status not in (MissionStatus.NOT_SELECTED, MissionStatus.SELECTED):
            yield f"MISSION_STATUS {ai.mission_status.label} in {where}"
        if ai.mission_status is MissionStatus.SELECTED and self._process is not None:
            if s.mission is Ami.NOT_SELECTED:
                yield "SELECTED without a mission on the AMI"
            if len(s.confirmed) < len(ROLES):
                yield "SELECTED before planner and controller have confirmed their reset"
            if s.as_state is not AsState.AS_READY and not s.autonomous:
                yield "SELECTED though autonomous was not chosen"
            if s.as_state is not AsState.AS_READY and s.latched:
                yield "SELECTED with an emergency latched"

    @_rule("output table", "0x510")
    def _says(self, ai: AiStatus) -> Iterator[str]:
        """MISSION_STATUS and direction of each AS state: what is wrong whatever the reason for a stop."""
        if not self._states or any(state is not self._states[-1] for state in self._states):
            return
        state, mission, direction = self._states[-1], ai.mission_status, ai.direction
        right_status = right_direction = True
        if state is AsState.AS_DRIVING:
            right_status = mission in (MissionStatus.RUNNING, MissionStatus.FINISHED)
            right_direction = direction is not Direction.REVERSE
        elif state is AsState.AS_FINISHED:
            right_status = mission is MissionStatus.FINISHED
            right_direction = direction is Direction.NEUTRAL
        elif state is AsState.EMERGENCY_BRAKE:
            right_status = mission is MissionStatus.RUNNING
            if direction is Direction.FORWARD:
                right_direction = self._in_flight_ns > 0 or not self.wheels.surely_stand(self._now_ns)
            else:
                right_direction = direction is Direction.NEUTRAL and (
                    self.wheels.may_stand(self._now_ns) or self._stood_before
                )
        if not right_status:
            yield f"MISSION_STATUS {mission.label} in {state.label}"
        if not right_direction:
            yield f"direction {direction.label} in {state.label}"

    @_rule("output table", "0x510")
    def _says_exactly(self, ai: AiStatus) -> Iterator[str]:
        """MISSION_STATUS and direction as what is due has them, where every reason for a stop is told."""
        if not self._all_told:
            return
        s = self.seen
        if ai.mission_status is MissionStatus.NOT_SELECTED and self._idle:
            chosen = s.mission is not Ami.NOT_SELECTED and len(s.confirmed) == len(ROLES) and s.ended is None
            if chosen and (s.as_state is AsState.AS_READY or (s.autonomous and not s.latched)):
                yield "NOT_SELECTED, and a mission is chosen and confirmed"
        if s.as_state is not AsState.AS_DRIVING:
            return
        rest = self.wheels.may_stand(self._now_ns)
        runs = ai.mission_status is MissionStatus.RUNNING and ai.direction is Direction.FORWARD
        finished = ai.mission_status is MissionStatus.FINISHED and ai.direction is Direction.NEUTRAL
        if s.latched or ai.estop_request:
            if not runs and not (rest and finished):
                yield "an emergency is asked for, and it is not RUNNING and FORWARD"
        elif s.stopped is not None and rest:
            if not finished:
                yield "a stop is due, the car stands, and it is not FINISHED and NEUTRAL"
        elif not runs:
            yield "not RUNNING and FORWARD in AS_DRIVING, and no stop is over"

    @_rule("reactions", "0x510")
    def _asks_for_the_emergency(self, ai: AiStatus) -> Iterator[str]:
        """Graded reactions: ESTOP_REQUEST when it is due; and not otherwise, where every reason for it is told."""
        s = self.seen
        if self._process is None:
            return
        if not ai.estop_request and s.as_state is AsState.AS_DRIVING:
            if s.alarm is not None and ai.direction is not Direction.NEUTRAL:
                yield f"no ESTOP_REQUEST: {s.alarm}"
            elif s.ended is not None and ai.direction is not Direction.NEUTRAL:
                yield "the software ends in AS_DRIVING, neither at rest nor with ESTOP_REQUEST"
        # A stop that goes on may turn out to be without effect, which is not judged here, nor what did not go out.
        asked = s.latched or s.alarm is not None or self._over or not s.whole
        asked = asked or (self._told is not None and self._told.estop)
        if self._all_told and ai.estop_request and not asked:
            yield "ESTOP_REQUEST, and nothing that happened asks for it"

    # ------------------------------------------------------------ the rules: 0x511 and 0x512

    @_rule("1", "torque", "0x514")
    def _meet(self, image: Any) -> Iterator[str]:
        """Axle torque above 0 and brake above 0 never meet at the VCU, which sees the frames one after another."""
        if max(self.seen.torque_nm) > 0.0 and max(self.seen.brake_pct) > 0.0:
            torque_nm, brake_pct = max(self.seen.torque_nm), max(self.seen.brake_pct)
            yield f"torque {torque_nm:.1f} Nm and brake {brake_pct:.1f} % together"

    @_rule("1", "torque")
    def _rises(self, axle: Any) -> Iterator[str]:
        """Torque rises only after a whole cycle with both at zero and a 0x524 that echoes it, or two such cycles."""
        if not self.seen.torque_runs and not self._may_rise:
            yield f"torque rose after {self.seen.zeros} complete cycles without torque and brake"

    @property
    def _may_rise(self) -> bool:
        return self.seen.zeros >= 2 or (self.seen.zeros == 1 and self.seen.echoed)

    @_rule("2", "torque")
    def _may_drive(self, axle: AiDriveFront | AiDriveRear) -> Iterator[str]:
        """Torque only with AS_DRIVING in a 0x520 not older than 50 ms, FORWARD, and no emergency; and it must drive.

        Against a motor speed limit of zero it may be a brake: that needs no Go, no 3 s and no command.
        """
        s, t_ns, name = self.seen, self._now_ns, _name(axle)
        if not self._states:
            if self._from_start or t_ns - (self._start_ns or 0) >= STATUS_FRESH_NS:
                yield f"{name} torque before any 0x520"
            return
        if AsState.AS_DRIVING not in self._states:
            yield f"{name} torque in {self._states[-1].label}"
        if not any(self._possible("known", not s.unknown)):
            yield f"{name} torque after a 0x520 whose AS_STATE no table knows"
        age_ns = t_ns - (s.status_ns or 0)
        if age_ns >= STATUS_FRESH_NS + self._in_flight_ns:  # stale after 50 ms is stale at 50 ms
            yield f"{name} torque with a 0x520 {age_ns / MS:.0f} ms old"
        if self._ai.direction is not Direction.FORWARD and self._cycles:
            yield f"{name} torque with direction {self._ai.direction.label}"
        if self._ai.estop_request or s.latched:
            yield f"{name} torque with an emergency asked for"
        if not self._brakes_by(axle):
            yield from self._may_move(name, t_ns)

    def _may_move(self, name: str, t_ns: int) -> Iterator[str]:
        """Go, the sequence and the mission behind it, 3 s in AS_DRIVING, the mode, and a command that asks for it."""
        s, told = self.seen, self._told
        if not any(self._possible("go", s.go)):
            yield f"{name} torque without the Go signal"
        if s.as_state is AsState.AS_DRIVING:
            if s.path != _WHOLE:
                yield f"{name} torque without AS_OFF, AS_READY and AS_DRIVING seen in turn by this process"
            if not s.waited and not self._short_sequence:
                yield f"{name} torque without 5 s in AS_READY before Go"
            if s.mission is Ami.NOT_SELECTED or not s.acknowledged:
                yield f"{name} torque without a mission that was acknowledged"
            if s.driving_ns is not None and t_ns - s.driving_ns < LAUNCH_NS - self._slack_ns:
                yield f"{name} torque {(t_ns - s.driving_ns) / S:.3f} s after AS_DRIVING began"
        if self._process is None:
            return
        if not s.autonomous:
            yield f"{name} torque though the mode is not autonomous"
        if told is None:
            yield f"{name} torque without a command younger than 100 ms, on data younger than 500 ms"
        elif told.throttle <= 0.0 or told.brake > 0.0:
            yield f"{name} torque though the command does not ask for it"

    @_rule("10", "torque")
    def _resumes(self, axle: AiDriveFront | AiDriveRear) -> Iterator[str]:
        """After a restart the car never resumes driving by itself: AS_OFF must be seen anew."""
        if self.seen.restarted and not self._brakes_by(axle):
            yield f"{_name(axle)} torque of a process that has not seen AS_OFF"

    @_rule("reactions", "torque")
    def _goes_on(self, axle: AiDriveFront | AiDriveRear) -> Iterator[str]:
        """No torque in a run that is over: by a switch, a fault bit or what else stops it."""
        s = self.seen
        if self._brakes_by(axle):
            return
        if s.stopped is not None:
            yield f"{_name(axle)} torque in a run that is over: {s.stopped}"
        elif s.turned is not None and self._now_ns - s.turned[0] >= self._in_flight_ns:
            yield f"{_name(axle)} torque in a run that is over: {s.turned[1]}"

    @_rule("4", "torque")
    def _within_torque(self, axle: AiDriveFront | AiDriveRear) -> Iterator[str]:
        """Torque at most 195 Nm, a live TRQ_MAX, the constant-power schedule, the operational limit, and its share."""
        s, front = self.seen, isinstance(axle, AiDriveFront)
        most_nm = self._torque_limit_nm if self._driven[0 if front else 1] else 0.0
        newest, max_ns = (s.front_max_nm, s.front_ns) if front else (s.rear_max_nm, s.rear_ns)
        if newest is not None:
            most_nm = min(most_nm, max(self._possible("front" if front else "rear", newest)))
        elif self._from_start:
            most_nm = 0.0  # the car has not said yet what it takes
        speeds = self._possible("rpm", self.wheels.rpm)
        if speeds and not self.wheels.open:
            fastest = min(max(rpm[:2] if front else rpm[2:]) for rpm in speeds)
            most_nm = min(most_nm, constant_power_nm(fastest))
        elif self._from_start and not speeds:
            most_nm = 0.0
        if self._told is not None and not self._brakes_by(axle):
            most_nm *= self._told.throttle
        if axle.torque_nm > most_nm + TINY:
            yield f"{_name(axle)} torque {axle.torque_nm:.1f} Nm above its limit {most_nm:.1f}"
        age_ns = 0 if max_ns is None else self._now_ns - max_ns
        if age_ns >= FEEDBACK_STALE_NS + self._in_flight_ns:
            yield f"{_name(axle)} torque by a live limit {age_ns / MS:.0f} ms old"

    @_rule("4", "drive")
    def _within_speed(self, axle: AiDriveFront | AiDriveRear) -> Iterator[str]:
        """Motor speed limit at most the operational speed limit, and what the command allows."""
        most_rpm = self._motor_limit_rpm
        if axle.torque_nm > 0.0 and self._told is not None:
            most_rpm = min(most_rpm, self._told.speed_limit_mps * self._rpm_per_mps)
        if axle.motor_speed_max_rpm > most_rpm + TINY:
            yield f"{_name(axle)} motor speed limit {axle.motor_speed_max_rpm} rpm above {most_rpm:.0f} rpm"

    def _brakes_by(self, axle: AiDriveFront | AiDriveRear) -> bool:
        """The official simulator: torque against a motor speed limit of zero is a brake."""
        return self._motor_brakes and axle.motor_speed_max_rpm == 0

    # ------------------------------------------------------------ the rules: 0x513

    @_rule("5", "0x513")
    def _steers_idle(self, steer: AiSteer) -> Iterator[str]:
        """In AS_INIT, AS_OFF and AS_READY: zero steering."""
        if steer.steer_deg != 0.0 and self._idle:
            yield f"steering {steer.steer_deg:.1f} deg in {self._states[-1].label if self._states else 'no AS state'}"

    @_rule("4", "0x513")
    def _steers_outside(self, steer: AiSteer) -> Iterator[str]:
        """Outside AS_DRIVING steering is zero at once."""
        if steer.steer_deg != 0.0 and self._states and AsState.AS_DRIVING not in self._states and not self._idle:
            yield f"steering {steer.steer_deg:.1f} deg in {self._states[-1].label}"

    def _angles(self) -> tuple[float, float]:
        """The most steering by the limits that the sender can have seen: the widest, and the narrowest."""
        live = self._possible("angle", self.seen.angle_max_deg)
        if not live:
            return (0.0, 0.0) if self._from_start else (self._steer_limit_deg, self._steer_limit_deg)
        return min(self._steer_limit_deg, max(live)), min(self._steer_limit_deg, min(live))

    @_rule("4", "0x513")
    def _within_angle(self, steer: AiSteer) -> Iterator[str]:
        """Steering at most the revision's limit, the live ANGLE_MAX and the operational limit."""
        most_deg, _ = self._angles()
        if abs(steer.steer_deg) > most_deg + TINY:
            yield f"steering {steer.steer_deg:.1f} deg beyond its limit {most_deg:.1f}"

    @_rule("4", "0x513")
    def _within_rate(self, steer: AiSteer) -> Iterator[str]:
        """Steering turns no faster than the car; a limit that the car lowers is obeyed at once.

        So is zero at the orderly end of a car at rest, and where AS_DRIVING begins.
        """
        s, deg = self.seen, steer.steer_deg
        if s.steered_ns is None or not all(state is AsState.AS_DRIVING for state in self._states):
            return
        begins = s.driving_ns is not None and s.steered_ns < s.driving_ns
        if (deg == 0.0 and (begins or self._ai.direction is Direction.NEUTRAL)) or not s.whole:
            return
        step_ns = self._now_ns - s.steered_ns
        if self._process is not None:
            step_ns = min(step_ns, LONGEST_TURN_NS)
        step_ns += self._in_flight_ns
        most_deg = self._steer_rate_degps * step_ns / S + STEER_STEP_DEG
        turned_deg = abs(deg - s.steer_deg)
        if turned_deg > most_deg + TINY and abs(s.steer_deg) <= self._angles()[1] + TINY:
            yield f"steering turned by {turned_deg:.1f} deg in {step_ns / MS:.1f} ms"

    @_rule("output table", "0x513")
    def _steers(self, steer: AiSteer) -> Iterator[str]:
        """In AS_DRIVING steering follows the command, or is held; it is zero in the first 3 s and at the end."""
        s, deg, told = self.seen, steer.steer_deg, self._told
        if self._process is None or s.as_state is not AsState.AS_DRIVING or s.driving_ns is None:
            return
        if s.ended is not None and self._ai.direction is Direction.NEUTRAL:
            if deg != 0.0:
                yield "the software ends at rest, and not with zeros"
            return
        stopping = s.stopped is not None or s.latched
        if self._now_ns - s.driving_ns < LAUNCH_NS and not stopping:
            if deg != 0.0:
                yield f"steering {deg} deg in the first 3 s of AS_DRIVING"
            return
        begins = s.steered_ns is not None and s.steered_ns < s.driving_ns
        if not s.whole or (begins and deg == 0.0):
            return
        _, most_deg = self._angles()
        held_deg = max(-most_deg, min(most_deg, s.steer_deg))  # a limit that was lowered is obeyed at once
        held = abs(deg - held_deg) <= STEER_STEP_DEG / 2
        if told is None or not s.autonomous:
            if abs(deg - held_deg) > (STEER_STEP_DEG / 2 if self._all_told else STEER_STEP_DEG + TINY):
                yield f"steering from {s.steer_deg} to {deg} deg, and no command counts"
            return
        if not self._all_told:  # it may be held for a reason that cannot be seen: it never turns elsewhere
            target_deg = max(-most_deg, min(most_deg, told.steer_deg))
            low, high = min(held_deg, target_deg) - STEER_STEP_DEG, max(held_deg, target_deg) + STEER_STEP_DEG
            if not low - TINY <= deg <= high + TINY:
                yield f"steering from {s.steer_deg} to {deg} deg, and the command asks for {target_deg:.2f}"
            return
        step_ns = 0 if s.steered_ns is None else min(self._now_ns - s.steered_ns, LONGEST_TURN_NS)
        most_turn_deg = self._steer_rate_degps * step_ns / S
        turn_deg = max(-most_turn_deg, min(most_turn_deg, told.steer_deg - s.steer_deg))
        wanted_deg = max(-most_deg, min(most_deg, s.steer_deg + turn_deg))
        if abs(deg - wanted_deg) > STEER_STEP_DEG + TINY and not (held and (stopping or not self._status_counts)):
            yield f"steering {deg} deg, and the command asks for {told.steer_deg:.2f}"

    # ------------------------------------------------------------ the rules: 0x514

    @_rule("1", "0x514")
    def _brake_rises(self, brake: AiBrake) -> Iterator[str]:
        """Brake rises only after a complete cycle with zero torque."""
        if any(self.seen.brake_pct) and self.seen.braked_pct == 0.0 and self.seen.torque_may_be_there:
            yield "brake rose before a complete cycle without torque"

    @_rule("output table", "0x514")
    def _brakes_where_the_car_does(self, brake: AiBrake) -> Iterator[str]:
        """Front and rear alike; no brake in AS_INIT, AS_OFF and EMERGENCY_BRAKE, and none where the motors brake."""
        if brake.front_pct != brake.rear_pct:
            yield f"brake {brake.front_pct} % in front and {brake.rear_pct} % at the rear"
        none = not self._states and self._from_start
        if any(self.seen.brake_pct) and (none or (self._states and all(one in UNBRAKED for one in self._states))):
            yield f"brake {max(self.seen.brake_pct):.1f} % in {'no AS state yet' if none else self._states[-1].label}"
        if any(self.seen.brake_pct) and self._motor_brakes:
            yield "a hydraulic brake on a car that brakes by its motors"

    @_rule("output table", "0x514")
    def _brakes(self, brake: AiBrake) -> Iterator[str]:
        """The brake that the output table and the reactions ask for, as soon as rule 1 lets it rise."""
        s, process, told, pct = self.seen, self._process, self._told, brake.front_pct
        if process is None or self._motor_brakes or s.as_state is None or s.as_state in UNBRAKED:
            return
        if s.ended is not None and self._ai.direction is Direction.NEUTRAL:
            if pct > 0.0:
                yield "the software ends at rest, and not with zeros"
            return
        if s.torque_may_be_there or not s.whole:  # what did not go out may have asked for torque
            return
        rest = self.wheels.may_stand(self._now_ns)
        if s.as_state is not AsState.AS_DRIVING:
            if pct <= 0.0:
                yield f"no holding brake in {s.as_state.label}"
        elif s.latched or (s.stopped is not None and not rest):
            if pct != process.service_brake_pct:
                why = "an emergency is asked for" if s.latched else s.stopped
                yield f"brake {pct} %, not the service brake: {why}"
        elif s.stopped is not None or (s.driving_ns is not None and self._now_ns - s.driving_ns < LAUNCH_NS):
            if pct <= 0.0:
                yield f"no holding brake: {s.stopped or 'the first 3 s of AS_DRIVING'}"
        elif told is None:
            falls = pct < s.braked_pct
            if falls and (self._all_told or (pct == 0.0 and self._whole_in_a_row > 0)):
                yield f"the brake falls from {s.braked_pct} % to {pct} %, and no command counts"
        elif self._all_told and self._status_counts and abs(pct - 100.0 * told.brake) > BRAKE_STEP_PCT / 2:
            yield f"brake {pct} %, and the command asks for {100.0 * told.brake:g} %"

    @_rule("output table", "0x514")
    def _brakes_by_motors(self, brake: AiBrake) -> Iterator[str]:
        """A car that must never be asked for a hydraulic brake stops by torque against a speed limit of zero."""
        s, now_ns, wheels = self.seen, self._now_ns, self.wheels
        if not (self._all_told and self._motor_brakes) or s.as_state is not AsState.AS_DRIVING:
            return
        times = wheels.believed_ns, s.front_ns, s.rear_ns
        known = self._status_counts and all(t is not None and now_ns - t < FEEDBACK_STALE_NS for t in times)
        due = s.stopped is not None and not s.latched and not wheels.may_stand(now_ns)
        if (
            due
            and known
            and (s.torque_runs or self._may_rise)
            and not (self._cycle.torque and not self._cycle.motor_rpm)
        ):
            yield "the motors do not brake, and a stop is due"

    # ------------------------------------------------------------ what several rules look at

    @property
    def _driving(self) -> bool:
        return bool(self._states) and all(state is AsState.AS_DRIVING for state in self._states)

    @property
    def _idle(self) -> bool:
        return all(state in IDLE for state in self._states) and (bool(self._states) or self._from_start)

    @property
    def _status_counts(self) -> bool:
        s = self.seen
        return not s.unknown and s.status_ns is not None and self._now_ns - s.status_ns < STATUS_FRESH_NS

    @property
    def _stood_before(self) -> bool:
        """Whether a log that began less than half a second ago may have begun with a standing car."""
        return not self._from_start and not self.wheels.turned and self._now_ns - (self._start_ns or 0) < STILL_NS


def _name(axle: AiDriveFront | AiDriveRear) -> str:
    return "front" if isinstance(axle, AiDriveFront) else "rear"


# ---------------------------------------------------------------- logs


def read_candump(path: Path | str) -> Iterator[Frame]:
    """The frames of a log, with their times in nanoseconds. Raises LogError, also for what cannot be read of it."""
    with open_log(path) as log:
        for one in log.frames():
            flags = {"extended": one.extended, "remote": one.remote, "error": one.error}
            yield Frame(one.can_id, one.data, one.t_ns, **flags)
        if log.problems:
            raise LogError(log.problems.summary())


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
