"""An observer's knowledge of the car and the AI computer.

A `BusView` is given, in the order of time, what the car sends and what happens to the process that answers it.
`reactions.py` says what is due by it, the rules in `frame_rules.py` look at it, `checker.py` feeds it.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final

from msgspec.structs import astuple

from fsai_hil.rules.numbers import (
    AS_STATE_KNOWN_NS,
    COMMAND_FRESH_NS,
    CYCLE_NS,
    DATA_FRESH_NS,
    FUTURE_NS,
    LAUNCH_NS,
    LISTEN_FIRST_NS,
    MOST_MOTOR_RPM,
    MOST_TORQUE_NM,
    MS,
    POWER_CYCLE_NS,
    READY_SEEN_NS,
    SEND_LOST_NS,
    STATUS_FRESH_NS,
    STATUS_LOST_NS,
    STILL_NS,
)
from fsai_hil.rules.plausible import Plausibility
from fsai_hil.rules.response import ResponseTimes
from fsai_hil.rules.seen import NOBODY, PARTS, Order, Process, Seen, Violation
from fsai_hil.rules.shown import SHOWN, marks_of
from fsai_hil.rules.wheels import Belief, WheelAges, Wheels
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS, VehicleParameters
from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.codec import Codec, Decoded
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.messages import (
    AiStatus,
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

ROLES: Final = frozenset(("planner", "controller"))
OFF: Final = (AsState.AS_INIT, AsState.AS_OFF)
IDLE: Final = (*OFF, AsState.AS_READY)
IN_THE_AIR: Final = (Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B)  # each wheel turns for itself
_OFF_SEEN, _READY_SEEN, WHOLE = 1, 2, 3  # how far AS_OFF, AS_READY, AS_DRIVING were seen in turn
_LOOKED_AT: Final = (
    *(VcuStatus, VcuDriveFront, VcuDriveRear, VcuSteer, VcuBrake, WheelSpeeds, WheelCounts),
    *(row.message for row in SHOWN),
)
HEEDED_IDS: Final = frozenset((*AI_IDS, *(BY_NAME[kind.dbc_name].can_id for kind in _LOOKED_AT)))
"""The identifiers of which a rule asks for something: of the rest, most of a bus, none does."""
RESTART_GAP_NS: Final = 150 * MS  # a process that starts listens for 200 ms before its first frame
BRAKE_STEP_PCT: Final = 0.5  # interface specification v4.0: the signal's resolution
Saved = tuple[tuple[object, ...], tuple[int, ...]]
_KEPT: Final = 1000  # violations kept as text; all are counted


@dataclass(slots=True)
class SeenCycle:
    """The frames of one cycle as they came."""

    ids: list[int] = field(default_factory=list)
    selected: bool = False
    torque: bool = False
    brake: bool = False
    motor_rpm: int = 0


class BusView:
    """See `checker.WireChecker` for what is given. Times are ns."""

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
        """Begin with a bus on which nothing has been seen; `WireChecker` explains the arguments."""
        self.found: list[tuple[int, Violation]] = []
        self.violation_count = 0
        self.codec = codec
        self.process = process
        self.nothing_hidden = process is not None and process.nothing_hidden
        self.slack_ns = clock_slack_ns
        self.handshake_in_flight_ns = handshake_in_flight_ns
        self.in_flight_ns = in_flight_ns
        self.from_start = from_start
        self.motor_brakes = motor_brakes
        self.short_sequence = short_sequence
        self._car = car
        self._pulses_per_rev = max(one.wheel_pulses_per_rev for one in ((car,) if car else CARS.values()))
        self.driven = (True, True) if car is None else (car.driven_front, car.driven_rear)
        self.steer_rate_degps = math.inf if car is None else math.degrees(car.steer_rate_radps)
        if steer_rate_degps is not None:
            self.steer_rate_degps = steer_rate_degps
        self.steer_limit_deg = min(codec.revision.steer_limit_deg, limits.max_steer_deg)
        self._command_limit_deg = codec.revision.steer_limit_deg
        self.torque_limit_nm = min(MOST_TORQUE_NM, limits.max_axle_torque_nm)
        self.motor_limit_rpm = MOST_MOTOR_RPM
        self.rpm_per_mps = math.inf
        if car is not None:
            self.torque_limit_nm = min(self.torque_limit_nm, car.axle_torque_max_nm)
            self.rpm_per_mps = car.wheel_rpm_of_speed(1.0) * car.gear_ratio
            self.motor_limit_rpm = min(MOST_MOTOR_RPM, min(limits.max_speed_mps, 1000.0) * self.rpm_per_mps)

        self.start_ns: int | None = None
        self.now_ns = 0
        self.as_states: list[tuple[int, AsState]] = []
        self.certain_ns: dict[int, int] = {}  # from when to when steering or a wheel was certainly implausible
        self.cycles = 0
        self.incomplete = 0
        # of what is judged
        self.responses = ResponseTimes()
        self._known_ids = frozenset(message.frame_id for message in codec.database.messages)
        self.frames = self.error_frames = 0
        self._problems: Counter[str] = Counter()
        self._broken: dict[tuple[str, int], set[str]] = {}
        self._strange_ids: set[int] = set()
        self._sound: dict[int, bytes] = {}  # of what no rule heeds, each identifier's last payload in order
        self._well_formed: set[tuple[int, bytes]] = set()
        self._know_nothing()

    def _know_nothing(self) -> None:
        """The process that sends has received nothing yet."""
        known = self.from_start  # what a log does not show is taken in favour of the sender
        self.seen = Seen(restarted=known, acknowledged=not known, torque_may_be_there=known, torque_runs=not known)
        self.wheels = Wheels(self._pulses_per_rev, self.in_flight_ns, self.slack_ns)
        follows = self._car is not None and self.process is not None and self.process.follows
        self._plausibility = Plausibility(self._car) if follows and self._car is not None else None
        # Since when AS_DRIVING shows each row of it; or where a row is of a missing message, when one came last.
        self.shown_ns: list[int | None] = [None] * len(SHOWN)
        self._late: dict[str, deque[tuple[int, Any]]] = {}
        self.toggle: tuple[int, bool] | None = None
        self._ai_silent = False
        self.was_off = False  # AS_INIT or AS_OFF was the state at some time since the last 0x510
        self.ai = AiStatus()
        self.cycle = SeenCycle()
        self.cycle_ns: int | None = None
        self.interval_ns: int | None = None
        self._zero_echo_ns: int | None = None
        self.states: tuple[AsState, ...] = ()
        # of the cycle in hand
        self.order: Order | None = None  # the command that may be obeyed
        self.over = False  # the stop was latched in an earlier cycle
        # only where stops may be hidden
        self.whole_in_a_row = 0

    def wrong(self, rule: str, words: str) -> None:
        self.violation_count += 1
        if len(self.found) < _KEPT:
            self.found.append((self.now_ns, Violation(rule, words)))

    # ------------------------------------------------------------ as a value

    def saved(self, now_ns: int, *, data_may_be_lost: bool) -> Saved:
        """Return what has been seen without the times, and the ages of the times in ns, below 0: never.

        What no rule looks at any more is forgotten. Where nothing is hidden, between two cycles.
        `data_may_be_lost`: a command may come that is lost as it comes, for its data is too old.
        """
        self._forget(now_ns, data_may_be_lost)
        rpm, wheel_ages = self.wheels.saved(now_ns)
        times = *PARTS.times_of(self.seen), *self.shown_ns
        ages = [-1 if t_ns is None else now_ns - t_ns for t_ns in times]
        return (rpm, *PARTS.others_of(self.seen)), (*ages, *astuple(wheel_ages))

    def load(self, saved: Saved, now_ns: int) -> None:
        """Put back what was saved."""
        (rpm, *plain), ages = saved[0], iter(saved[1])  # each part takes its own off them, in the order of `saved`
        times = (None if age < 0 else now_ns - age for age in ages)
        self.seen, self.shown_ns = Seen(**PARTS.values(plain, times)), list(islice(times, len(SHOWN)))
        self.was_off, self.cycle_ns, self.toggle = False, None, None
        self.wheels.load(rpm, WheelAges(*ages), now_ns)  # type: ignore[arg-type]

    def _forget(self, now_ns: int, data_may_be_lost: bool) -> None:
        """Drop what no rule can ask for any more, so that a search need not tell it apart."""
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
            s.stopped, s.pedals_ns, s.stale_ns = "a stop is due", None, None
        if s.alarm is not None:
            s.alarm = None if s.latched else "an emergency is due"
        if not driving:
            s.go, s.braked_pct, s.back_ns = False, 0.0, None
        if not driving or s.stopped:
            s.front_ns = s.front_ns and now_ns
            s.rear_ns = s.rear_ns and now_ns
        if not driving or (s.stopped and s.latched):
            s.complete_ns = s.complete_ns and now_ns
            s.steer_odd_ns = s.wheel_odd_ns = None
            self.shown_ns = [t_ns and now_ns for t_ns in self._only_missing_ns()]
        if s.command_ns is not None and s.driving_ns is not None and not data_may_be_lost and age_ns < CYCLE_NS:
            s.driving_ns = max(s.driving_ns, now_ns - LAUNCH_NS)  # how long it has waited for commands is no matter
        if s.back_ns is not None and not s.reopening:
            missing = (t_ns for row, t_ns in zip(SHOWN, self.shown_ns, strict=True) if row.shows is None)
            times = s.status_ns, self.wheels.may_count_ns, *missing
            if s.latched or all(t_ns is not None and t_ns >= s.back_ns for t_ns in times):
                s.back_ns = None  # everything has been received since
        s.echoed = s.echoed and s.zeros == 1
        s.torque_nm = (float(s.torque_nm[0] > 0.0), float(s.torque_nm[1] > 0.0))
        s.brake_pct = (float(s.brake_pct[0] > 0.0), float(s.brake_pct[1] > 0.0))

    # ------------------------------------------------------------ what the car sends

    def on_car(self, image: Image | None, t_ns: int) -> None:
        """A frame of the car that can be believed, which carries `image`."""
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
            s.angle_max_deg = max(0.0, image.angle_max_deg)
            self._note("angle", t_ns, s.angle_max_deg)
            if self._plausibility is not None:
                self._plausibility.on_angle(image.angle_deg, t_ns, judges=s.as_state is AsState.AS_DRIVING)
        elif isinstance(image, VcuBrake):
            zero = image.front_request_pct == image.rear_request_pct == 0.0
            s.echoed = (zero or (s.echoed and self.in_flight_ns > 0)) and s.zeros > 0
            self._zero_echo_ns = t_ns if zero else self._zero_echo_ns
        elif isinstance(image, WheelSpeeds):
            if self.wheels.on_speeds(image.all_rpm, t_ns) is not Belief.NO:
                self._note("rpm", t_ns, image.all_rpm)
                launched = s.driving_ns is not None and t_ns - s.driving_ns >= LAUNCH_NS
                if self._plausibility is not None and launched and s.mission not in IN_THE_AIR:
                    self._plausibility.on_speeds(image.all_rpm, t_ns)
        elif isinstance(image, WheelCounts):
            self.wheels.on_counts((image.fl, image.fr, image.rl, image.rr), t_ns)
        for place, row in enumerate(SHOWN):
            if isinstance(image, row.message):
                self.shown_ns[place] = row.since_ns(self.shown_ns[place], image, t_ns)

    def _only_missing_ns(self) -> list[int | None]:
        """Since when each row of `SHOWN` is shown, with what may be missing alone: it was received then."""
        return [t_ns if row.shows is None else None for row, t_ns in zip(SHOWN, self.shown_ns, strict=True)]

    def _note(self, name: str, t_ns: int, value: Any, in_flight_ns: int | None = None) -> None:
        """Keep a value and those before it that a sender may have seen last instead."""
        in_flight_ns = self.in_flight_ns if in_flight_ns is None else in_flight_ns
        if not in_flight_ns:
            return
        values = self._late.setdefault(name, deque())
        if values and values[-1][1] == value:
            return  # for as long as it stays, it is one that may have been seen
        values.append((t_ns, value))
        while len(values) > 1 and t_ns - values[1][0] >= in_flight_ns:
            values.popleft()

    def possible(self, name: str, newest: Any, in_flight_ns: int | None = None) -> list[Any]:
        """Return what a sender can have seen last by now."""
        in_flight_ns = self.in_flight_ns if in_flight_ns is None else in_flight_ns
        values = self._late.get(name)
        if not in_flight_ns or not values:
            return [] if newest is None else [newest]
        while len(values) > 1 and self.now_ns - values[1][0] >= in_flight_ns:
            values.popleft()
        return [value for _, value in values]

    def on_any_status(self, decoded: Decoded, t_ns: int) -> None:
        """Note a 0x520, believed or not: silence before it, and since when its AS state is known."""
        s = self.seen
        if s.any_status_ns is not None and t_ns - s.any_status_ns >= POWER_CYCLE_NS + self.in_flight_ns:
            s.silent = True
        s.any_status_ns = t_ns
        if decoded.image is None:
            s.known_ns = None
        elif s.known_ns is None:
            before_the_log = s.as_state is None and not self.from_start
            s.known_ns = t_ns - AS_STATE_KNOWN_NS if before_the_log else t_ns
        self._note("known", t_ns, s.known_ns)
        bit = decoded.handshake
        if bit is None:
            return
        if s.handshake is not bit:
            alive = self.cycle_ns is not None and t_ns - self.cycle_ns < 100 * MS
            self.toggle = (t_ns, bit) if alive else None
        s.handshake = bit
        if self.handshake_in_flight_ns:
            if "bit" not in self._late:
                self._late["bit"] = deque([(t_ns, False)])  # before the first one there was nothing to echo
            self._note("bit", t_ns, bit, self.handshake_in_flight_ns)

    def _on_status(self, status: VcuStatus, t_ns: int) -> None:
        """Follow AS state, Go and mission of a 0x520 that may be believed."""
        s, state, first = self.seen, status.as_state, self.seen.as_state is None
        unjudged = first and not self.from_start  # what was before a log is not known
        self._note("state", t_ns, state)
        self._note("go", t_ns, status.go_signal)
        self.was_off = self.was_off or state in OFF
        entered_off = state in OFF and not first and (s.as_state not in OFF or s.silent)
        if entered_off or (status.ami is not s.mission and (state in IDLE or first)):
            s.mission, s.confirmed, s.acknowledged = status.ami, NOBODY, unjudged
            s.order, s.command_ns = None, None  # of the run before
        anew = s.silent or state is not s.as_state
        self._follow_path(status, anew, unjudged, t_ns)
        s.as_state, s.go, s.status_ns = state, status.go_signal, t_ns
        marks = marks_of(status)
        if anew:
            self.as_states.append((t_ns, state))
            s.pedals_ns = None
            if state is AsState.AS_DRIVING:
                s.driving_ns = None if unjudged else t_ns
                s.stopped, s.alarm = None, None
                self.shown_ns = self._only_missing_ns()
        if state is not AsState.AS_DRIVING:
            if s.alarm is not None and (s.bus_gone or s.reopening):
                s.latched = True  # what a lost bus did not carry is asked for when it is back
            s.driving_ns, s.stopped, s.alarm, s.stale_ns = None, None, None, None
        elif s.marks is not None and not marks <= s.marks:
            words = "; ".join(sorted(marks - s.marks))
            self._stop(words if self.process is None else f"in AS_DRIVING {words}")
        s.marks = marks
        s.reopening = False

    def _follow_path(self, status: VcuStatus, anew: bool, unjudged: bool, t_ns: int) -> None:
        """AS_OFF, AS_READY, AS_DRIVING in turn, and 5 s of AS_READY with Go off."""
        s, state = self.seen, status.as_state
        silent = self.cycle_ns is not None and t_ns - self.cycle_ns >= RESTART_GAP_NS
        if silent and not self._ai_silent and not self.from_start:
            s.path, s.restarted = 0, True  # the next process must see the whole way again
        self._ai_silent = silent
        if s.silent:
            s.path, s.power_up = 0, True
            if state in OFF and self.process is not None:
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
                s.waited = t_ns - s.ready_ns + self.in_flight_ns >= READY_SEEN_NS
        else:
            s.ready_ns = None
            s.waited = s.waited and state is AsState.AS_DRIVING
        if state in OFF:
            s.path, s.restarted = _OFF_SEEN, False
        elif state is AsState.AS_READY:
            s.path = _READY_SEEN if s.path in (_OFF_SEEN, _READY_SEEN) else 0
        elif state is AsState.AS_DRIVING:
            s.path = WHOLE if s.path in (_READY_SEEN, WHOLE) else 0
        else:
            s.path = 0

    # ------------------------------------------------------------ what the AI computer sends

    def cycle_over(self, now_ns: int, made: bool = True) -> None:
        """No more frames of this cycle come; else the next one's first says so. `made`: it was to be sent at all."""
        s, cycle = self.seen, self.cycle
        complete = tuple(cycle.ids) == AI_IDS
        drives = AI_IDS[1] in cycle.ids and AI_IDS[2] in cycle.ids
        if cycle.ids and not complete:
            self.incomplete += 1
        if cycle.ids and self._plausibility is not None:
            self._plausibility.on_cycle(torque=cycle.torque, brake=cycle.brake, t_ns=self.cycle_ns or now_ns)
        if complete:
            s.acknowledged = s.acknowledged or cycle.selected
            if not cycle.torque:
                s.torque_may_be_there = False
                if not cycle.brake:
                    s.zeros = min(2, s.zeros + 1)
                    began_ns = (self.cycle_ns or now_ns) - self.in_flight_ns
                    s.echoed = s.echoed or (self._zero_echo_ns is not None and self._zero_echo_ns > began_ns)
        if drives:
            s.torque_runs = cycle.torque
        self.whole_in_a_row = self.whole_in_a_row + 1 if complete else 0
        if self.process is not None and made:
            s.whole = complete
            if complete or s.complete_ns is None:
                s.complete_ns = now_ns
            elif now_ns - s.complete_ns >= SEND_LOST_NS and s.as_state is AsState.AS_DRIVING:
                self._lose("no cycle went out whole for 50 ms")
                s.complete_ns = now_ns
        self.cycle = SeenCycle()

    # ------------------------------------------------------------ what happens to the process

    def on_sending(self) -> None:
        """Safety rule 8, and the 200 ms of listening: whether the process may send at all."""
        s, process = self.seen, self.process
        assert process is not None
        if process.listen_only:
            self.wrong("8", "a process that only listens sends")
        if s.bus_gone:
            self.wrong("8", "frames are sent on a lost bus")
        if s.began_ns is None or self.now_ns - s.began_ns < LISTEN_FIRST_NS:
            self.wrong("8", "frames are sent before the process has listened for 200 ms")

    def on_command(self, command: VehicleCommand, refused: bool, now_ns: int, *, current: bool) -> None:
        """Safety rule 7: a command was handed in, of the run in hand (`current`) or of another."""
        s = self.seen
        self.now_ns = now_ns
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
            self.wrong("7", f"taken, though invalid or of another run: {command}")
        if refused and takes:
            self.wrong("7", f"refused, though valid: {command}")
        if takes:
            steer_deg = math.degrees(command.steering_rad)
            wishes = command.mission_finished, command.estop_request
            s.order = Order(steer_deg, command.throttle, command.brake, command.speed_limit_mps, *wishes)
            s.command_ns = min(now_ns, command.t_sensor_ns + DATA_FRESH_NS - COMMAND_FRESH_NS)

    def on_mode(self, mode: str, answer: tuple[bool, str], now_ns: int) -> None:
        """Somebody asked for a mode."""
        (done, words), s, process = answer, self.seen, self.process
        assert process is not None
        self.now_ns = now_ns
        if mode == "manual":
            if not done:
                self.wrong("modes", f"manual was refused: {words}")
            s.autonomous = s.power_up = False
            self._stop("manual was asked for")
        elif mode == "autonomous":
            known = s.status_ns is not None and now_ns - s.status_ns < STATUS_LOST_NS
            if done and not s.autonomous and (not known or s.as_state not in IDLE or process.listen_only):
                self.wrong("modes", f"autonomous was accepted in {self.where}")
            s.autonomous = s.autonomous or done
            s.power_up = s.power_up and not done
        elif done or "manual" not in words or "autonomous" not in words:
            self.wrong("modes", f"mode {mode!r} was answered with {done}, {words!r}")

    def on_emergency(self, granted: bool) -> None:
        """The operator asked for the emergency brake."""
        self.seen.latched = self.seen.latched or granted

    def on_reset(self, granted: bool, now_ns: int) -> None:
        """Safety rule 6: a reset is granted in AS_INIT and AS_OFF only."""
        s = self.seen
        self.now_ns = now_ns
        known = s.status_ns is not None and now_ns - s.status_ns < STATUS_LOST_NS
        if granted and (s.as_state not in OFF or not known):
            self.wrong("6", f"a reset was granted in {self.where}")
        s.latched = s.latched and not granted

    def on_confirmed(self, role: str) -> None:
        """Planner or controller confirms that it has reset itself for the run in hand."""
        s = self.seen
        if role in s.confirmed:
            self._stop(f"the {role} was restarted")
        s.confirmed = s.confirmed | (ROLES & {role})

    def on_intruder(self, words: str) -> None:
        if self.process is not None and not self.process.listen_only:
            self._alarm(words)

    def on_loop_fault(self) -> None:
        self._alarm("the loop missed its deadline")

    def on_bus_lost(self, now_ns: int | None = None) -> None:
        """The sender has lost the bus: whatever follows, its drive needs the whole way again."""
        s = self.seen
        if self.process is None or now_ns is None:
            s.path, s.any_status_ns = 0, None  # what it cannot receive is no silence of the car's
            return
        if s.bus_gone:
            return
        if s.any_status_ns is not None and now_ns - s.any_status_ns >= POWER_CYCLE_NS:
            s.silent = True
        s.bus_gone = True
        self._lose("the bus was lost")

    def on_bus_back(self, now_ns: int) -> None:
        s = self.seen
        if s.bus_gone:
            s.bus_gone, s.reopening, s.back_ns, s.complete_ns = False, True, now_ns, None
            s.any_status_ns = None if s.any_status_ns is None else now_ns
            s.stopped_ns = now_ns
            self.whole_in_a_row = 0

    def on_end(self) -> None:
        """The software is asked to stop."""
        if self.seen.ended is None:
            self.seen.ended = 0

    def restarted(self) -> None:
        """Another process takes the sender's place: it knows nothing, the VCU keeps what it saw last."""
        self.cycle_over(self.now_ns, made=False)
        before = self.seen
        self._know_nothing()
        self.seen.torque_nm, self.seen.brake_pct = before.torque_nm, before.brake_pct

    def _lose(self, why: str) -> None:
        """Commands are dropped, and a drive needs the whole sequence again."""
        s = self.seen
        self._stop(why)
        s.path, s.order, s.command_ns = 0, None, None

    def _stop(self, why: str) -> None:
        s = self.seen
        if s.stopped is None and s.as_state is AsState.AS_DRIVING:
            s.stopped, s.stopped_ns = why, self.now_ns

    def _alarm(self, why: str) -> None:
        if self.seen.as_state is AsState.AS_DRIVING:
            self.seen.alarm = self.seen.alarm or why

    # ------------------------------------------------------------ what several rules look at

    @property
    def driving(self) -> bool:
        return bool(self.states) and all(state is AsState.AS_DRIVING for state in self.states)

    @property
    def idle(self) -> bool:
        return all(state in IDLE for state in self.states) and (bool(self.states) or self.from_start)

    @property
    def status_fresh(self) -> bool:
        """The last 0x520 is one that is known, and not stale."""
        s = self.seen
        return s.known_ns is not None and s.status_ns is not None and self.now_ns - s.status_ns < STATUS_FRESH_NS

    @property
    def state_settled(self) -> bool:
        """AS_STATE has been known for so long that torque may return, in what the sender can have seen."""
        known = self.possible("known", self.seen.known_ns)
        return any(t is not None and self.now_ns - t >= AS_STATE_KNOWN_NS - self.slack_ns for t in known)

    @property
    def commands_count(self) -> bool:
        """Return whether commands count: the AS state in 0x520 is fresh and settled."""
        return self.status_fresh and self.state_settled

    @property
    def stood_before(self) -> bool:
        """Return whether a log may have begun with a standing car, of which it cannot yet show that it stands.

        Its first wheel speeds come up to a cycle after its first frame, and those that prove rest up to a cycle later.
        """
        since_ns = self.now_ns - (self.start_ns or 0)
        return not self.from_start and not self.wheels.turned and since_ns < STILL_NS + 2 * CYCLE_NS

    @property
    def may_rise(self) -> bool:
        return self.seen.zeros >= 2 or (self.seen.zeros == 1 and self.seen.echoed)

    @property
    def where(self) -> str:
        return "no AS state yet" if self.seen.as_state is None else self.seen.as_state.label
