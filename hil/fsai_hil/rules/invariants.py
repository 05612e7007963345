"""The safety rules as a witness beside the bus sees them, written without a look into supervisor or gate.

The witness knows what the car said and when, what people asked and were granted, which commands were in order, and
what went out. Its numbers come from the safety rules and from the interface specification, not from the code under
search. Every problem names the rule it breaks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from fsai_hil.rules.numbers import (
    COMMAND_FRESH_NS,
    COMMAND_LOST_NS,
    COUNTED_NS,
    CYCLE_NS,
    DATA_FRESH_NS,
    FEEDBACK_LOST_NS,
    FEEDBACK_STALE_NS,
    LAUNCH_NS,
    LISTEN_FIRST_NS,
    ODD_LOST_NS,
    ODD_NS,
    PEDALS_NS,
    POWER_CYCLE_NS,
    READY_SEEN_NS,
    SEND_LOST_NS,
    SPEED_CHANGE_MOST_RPM,
    SPEED_JUMP_NS,
    SPEED_MOST_RPM,
    SPEEDS_FRESH_NS,
    STATUS_FRESH_NS,
    STATUS_LOST_NS,
    STILL_NS,
    STILL_RPM,
    STOP_CYCLES,
    constant_power_nm,
)
from fsai_hil.rules.violation import Violation
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import AiCommand

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
    "safe end": "a safe end is reached from every state",
}

Wrong = Callable[[str, str], None]

OFF: Final = (AsState.AS_INIT, AsState.AS_OFF)
STEER_STEP_DEG: Final = 0.1  # interface specification v4.0: the signals' resolution
BRAKE_STEP_PCT: Final = 0.5
LONGEST_TURN_NS: Final = 2 * CYCLE_NS  # after a longer pause nobody turns by all that was missed


class Order(NamedTuple):
    """What a command in order asks for."""

    steer_deg: float
    throttle: float
    brake: float
    finished: bool
    estop: bool


@dataclass(frozen=True, slots=True)
class Limits:
    """What holds on the car, the interface revision and at the venue under search."""

    steer_deg: float
    steer_rate_degps: float
    torque_nm: float
    motor_rpm: int
    front_driven: bool
    rear_driven: bool
    brakes_by_motor: bool = False  # the official simulator: torque against a motor speed limit of zero is a brake
    service_brake_pct: float = 80.0  # what a stop is made with
    may_send: bool = True
    autonomous_at_power_up: bool = False
    stop_cycles: int = STOP_CYCLES
    short_sequence: bool = False  # AS_DRIVING may come sooner than after 5 s in AS_READY, and without an edge of Go


class Witness:
    """What has been seen on the bus and heard from people. Times are ns; None: never."""

    __slots__ = (
        "acknowledged",
        "alarm",
        "angle_max_deg",
        "as_state",
        "autonomous",
        "axle_ns",
        "began_ns",
        "brake_pct",
        "bus_gone",
        "command_ns",
        "complete_ns",
        "confirmed",
        "cycle_ns",
        "data_ns",
        "driving_ns",
        "due",
        "echoed",
        "ended",
        "go",
        "handshake",
        "heard_ns",
        "latched",
        "marks",
        "mission",
        "no_more_torque",
        "order",
        "over",
        "path",
        "pedals_ns",
        "power_up",
        "ready_ns",
        "reopening",
        "restarted",
        "rpm",
        "silence",
        "speeds_ns",
        "status_ns",
        "steer_deg",
        "steer_ns",
        "steer_odd_ns",
        "still_ns",
        "told",
        "torque_max_nm",
        "torque_may_be_there",
        "torque_runs",
        "turning_ns",
        "unknown",
        "waited",
        "wheel_odd_ns",
        "zeros",
    )

    def __init__(self) -> None:
        # what the car said
        self.as_state: AsState | None = None
        self.go = False
        self.status_ns: int | None = None
        self.heard_ns: int | None = None  # any 0x520, believed or not
        self.mission = Ami.NOT_SELECTED
        self.silence = False  # the car was silent for as long as a power cycle takes, and was not believed since
        self.unknown = False  # the last 0x520 is none that anybody knows
        self.marks: frozenset[str] | None = None  # what 0x520 shows that must not turn up in AS_DRIVING
        self.ready_ns: int | None = None  # since when it has been AS_READY
        self.waited = False  # for 5 s before Go
        self.path = 0  # 1 AS_OFF, 2 then AS_READY, 3 then AS_DRIVING; 0 anything else
        self.driving_ns: int | None = None
        self.rpm: tuple[int, int, int, int] | None = None
        self.speeds_ns: int | None = None
        self.still_ns: int | None = None
        self.turning_ns: int | None = None  # a wheel turned then, by its pulse count
        self.angle_max_deg: float | None = None
        self.steer_ns: int | None = None
        self.torque_max_nm: float | None = None
        self.axle_ns: int | None = None
        self.handshake = False
        # what people and the planner said
        self.autonomous = False
        self.power_up = True  # autonomous has not been entered by itself, nor chosen, since the car was switched on
        self.confirmed: frozenset[str] = frozenset()  # who has reset himself for this mission
        self.acknowledged = False  # SELECTED went out whole for it
        self.latched = False
        self.order: Order | None = None  # the newest command in order
        self.command_ns: int | None = None
        self.data_ns = 0
        self.pedals_ns: int | None = None  # since when every command has asked for both
        # what went wrong
        self.alarm = False  # an emergency is due: an intruder, or a fault of the loop, in AS_DRIVING
        self.no_more_torque = False  # a stop is latched for this run
        self.steer_odd_ns: int | None = None
        self.wheel_odd_ns: int | None = None
        self.restarted = True  # the process is new and has not seen AS_OFF yet
        self.bus_gone = False
        self.reopening = False  # the bus is back, and the car has not been heard on it
        self.ended: int | None = None  # cycles sent since the software was told to stop
        # what is due in this cycle
        self.over = False  # the stop was latched in an earlier cycle
        self.due: str | None = None  # why ESTOP_REQUEST is
        self.told: Order | None = None  # the command that may be obeyed
        # what went out
        self.began_ns: int | None = None  # the first cycle, sent or not
        self.complete_ns: int | None = None  # the last cycle that went out whole, or the first that was tried
        self.torque_may_be_there = True
        self.zeros = 0  # complete cycles with both at zero
        self.echoed = False  # and a 0x524 after them says so
        self.torque_runs = False
        self.steer_deg = 0.0
        self.brake_pct = 0.0
        self.cycle_ns: int | None = None

    # ------------------------------------------------------------ what happens

    def on_any_status(self, now_ns: int) -> None:
        if self.heard_ns is not None and now_ns - self.heard_ns >= POWER_CYCLE_NS:
            self.silence = True
        self.heard_ns = now_ns

    def on_unknown_status(self, now_ns: int) -> None:
        self.on_any_status(now_ns)
        self.unknown = True

    def on_status(self, as_state: AsState, go: bool, fault: bool, ami: Ami, marks: frozenset[str], now_ns: int) -> None:
        self.on_any_status(now_ns)
        self.unknown = False
        idle = as_state in (*OFF, AsState.AS_READY)
        entered_off = as_state in OFF and self.as_state is not None and (self.as_state not in OFF or self.silence)
        if entered_off or (ami is not self.mission and (idle or self.as_state is None)):
            self.mission, self.confirmed, self.acknowledged = ami, frozenset(), False
            self.order, self.command_ns = None, None  # of the run before
        anew = as_state is not self.as_state or self.silence
        if self.silence:
            self.path = 0
            self.power_up = True
            if as_state in OFF:
                self.latched = False
        if anew and ami is not self.mission:
            self.path = 0  # the car enters a state for a mission that nobody has acknowledged
        self.silence = False
        if as_state is AsState.AS_READY:
            if anew or self.ready_ns is None:
                self.ready_ns, self.waited = now_ns, False
            if not go:
                self.waited = now_ns - self.ready_ns >= READY_SEEN_NS
        else:
            self.ready_ns = None
            self.waited = self.waited and as_state is AsState.AS_DRIVING
        if as_state in OFF:
            self.path = 1
            self.restarted = False
        elif as_state is AsState.AS_READY:
            self.path = 2 if self.path in (1, 2) else 0
        elif as_state is AsState.AS_DRIVING:
            self.path = 3 if self.path in (2, 3) else 0
        else:
            self.path = 0
        if as_state is not AsState.AS_DRIVING:
            if self.alarm and (self.bus_gone or self.reopening):
                self.latched = True  # what a lost bus did not carry is asked for when it is back
            self.driving_ns = None
            self.no_more_torque = False
            self.alarm = False
        elif anew:
            self.driving_ns = now_ns
            self.no_more_torque = False
        new_marks = self.marks is not None and bool(marks - self.marks)
        if as_state is AsState.AS_DRIVING and (not go or fault or new_marks):
            self.no_more_torque = True
        self.marks = marks
        self.reopening = False
        self.as_state, self.go, self.status_ns = as_state, go, now_ns

    def on_speeds(self, rpm: tuple[int, int, int, int], now_ns: int) -> None:
        if max(rpm) > SPEED_MOST_RPM:
            return
        if (
            self.rpm is not None
            and self.speeds_ns is not None
            and now_ns - self.speeds_ns < SPEED_JUMP_NS
            and any(abs(now - then) > SPEED_CHANGE_MOST_RPM for now, then in zip(rpm, self.rpm, strict=True))
        ):
            return
        gap = self.speeds_ns is None or now_ns - self.speeds_ns >= SPEEDS_FRESH_NS
        if max(rpm) >= STILL_RPM:
            self.still_ns = None
        elif self.still_ns is None or gap:
            self.still_ns = now_ns
        self.rpm, self.speeds_ns = rpm, now_ns

    def on_brake(self, zero: bool) -> None:
        self.echoed = self.echoed or (zero and self.zeros > 0)

    def on_command(self, order: Order, data_ns: int, now_ns: int) -> None:
        """A command that is in order."""
        self.order, self.command_ns, self.data_ns = order, now_ns, data_ns

    def on_bus_lost(self) -> None:
        """Commands are dropped, and a drive needs the whole sequence anew."""
        self.no_more_torque = self.no_more_torque or self.as_state is AsState.AS_DRIVING
        self.path = 0
        self.order, self.command_ns = None, None

    def on_bus_gone(self, now_ns: int) -> None:
        if self.heard_ns is not None and now_ns - self.heard_ns >= POWER_CYCLE_NS:
            self.silence = True
        self.bus_gone = True
        self.on_bus_lost()

    def on_bus_back(self, now_ns: int) -> None:
        """What could not be heard on a lost bus was no silence of the car's."""
        self.bus_gone, self.reopening = False, True
        self.complete_ns = None
        if self.heard_ns is not None:
            self.heard_ns = now_ns

    def on_end(self) -> None:
        if self.ended is None:
            self.ended = 0

    def restart(self) -> None:
        """The process dies and another takes its place: it knows nothing; the car goes on as it is."""
        fresh = Witness()
        for name in self.__slots__:
            setattr(self, name, getattr(fresh, name))

    # ------------------------------------------------------------ what is due

    def at_rest(self, now_ns: int) -> bool:
        """All wheel speeds are fresh and have been seen under 10 rpm for 0.5 s, and no count ran (safety rule 3)."""
        return (
            (self.turning_ns is None or now_ns - self.turning_ns >= COUNTED_NS)
            and self.speeds_ns is not None
            and self.still_ns is not None
            and now_ns - self.speeds_ns < SPEEDS_FRESH_NS
            and self.speeds_ns - self.still_ns >= STILL_NS
        )

    def _command_age_ns(self, now_ns: int) -> int | None:
        """For how long there has been no new command. Data of 500 ms ages like a command of 100 ms."""
        if self.command_ns is None:
            return None
        return max(now_ns - self.command_ns, now_ns - self.data_ns - (DATA_FRESH_NS - COMMAND_FRESH_NS))

    def speaks(self, limits: Limits) -> bool:
        """The process decides what to send: its bus is there, and its orderly end is not over."""
        over = self.ended is not None and self.ended >= limits.stop_cycles
        return not (self.bus_gone or self.reopening or over)

    def before_cycle(self, mode: str, limits: Limits, now_ns: int) -> list[Violation]:
        """The process decides what to send: what is due by now is due in this cycle. `mode` is what it says then."""
        if self.began_ns is None:
            self.began_ns = now_ns
        self.over, self.due = self.no_more_torque, None
        age_ns = self._command_age_ns(now_ns)
        self.told = self.order if age_ns is not None and age_ns < COMMAND_FRESH_NS else None
        may_turn_manual = must_turn_manual = False
        if self.as_state is AsState.AS_DRIVING and self.driving_ns is not None:
            lost = self._look_at_the_clock(limits, age_ns, now_ns)
            # Once an emergency is latched nobody asks what becomes of the commands.
            may_turn_manual = lost or self.latched
            must_turn_manual = lost and not self.over and not self.latched
        elif limits.autonomous_at_power_up and self.power_up and self.as_state in OFF and self.at_rest(now_ns):
            self.autonomous, self.power_up = True, False
        found: list[Violation] = []
        if mode == "autonomous":
            if self.autonomous and must_turn_manual:
                found.append(Violation("modes", "the mode is autonomous after 300 ms without a command"))
            elif not self.autonomous:
                found.append(Violation("modes", "the mode is autonomous, and nobody chose that"))
        elif self.autonomous and not may_turn_manual:
            found.append(Violation("modes", "the mode has become manual, and nothing asked for that"))
        if must_turn_manual or (may_turn_manual and mode != "autonomous"):
            self.autonomous = False
        if self.as_state is AsState.AS_DRIVING and not self.autonomous:
            self.no_more_torque = True
        return found

    def _began_in_order(self, limits: Limits) -> bool:
        """AS_OFF, AS_READY and AS_DRIVING in turn, 5 s before Go, for a mission that was acknowledged."""
        whole = self.path == 3 and (self.waited or limits.short_sequence)
        return whole and self.mission is not Ami.NOT_SELECTED and self.acknowledged

    def _look_at_the_clock(self, limits: Limits, age_ns: int | None, now_ns: int) -> bool:
        """The graded reactions in AS_DRIVING: what stops the run, and what asks for the emergency brake.

        Returns whether the command is lost.
        """
        assert self.driving_ns is not None
        if not self._began_in_order(limits) or len(self.confirmed) < 2 or self.ended is not None:
            self.no_more_torque = True
        if self.status_ns is None or now_ns - self.status_ns >= STATUS_LOST_NS:
            self.due = "0x520 is lost for 100 ms"
        elif self.alarm:
            self.due = "an intruder or a fault of the loop"
        elif self.ended is not None and not self.at_rest(now_ns):
            self.due = "the software ends, and the car is not known to stand"
        supervised_ns = now_ns - self.driving_ns - LAUNCH_NS
        if supervised_ns < 0:
            return False
        lost = self.autonomous and min(supervised_ns, supervised_ns if age_ns is None else age_ns) >= COMMAND_LOST_NS
        if lost:
            self.no_more_torque = True
        for name, t_ns in (("wheel speeds", self.speeds_ns), ("steering feedback", self.steer_ns)):
            if t_ns is None or now_ns - t_ns >= FEEDBACK_LOST_NS:
                self.due = f"{name} lost for 300 ms"
            if t_ns is None or now_ns - t_ns >= FEEDBACK_STALE_NS:
                self.no_more_torque = True
        for name, t_ns in (("the steering", self.steer_odd_ns), ("a wheel", self.wheel_odd_ns)):
            if t_ns is not None and now_ns - t_ns >= ODD_LOST_NS:
                self.due = f"{name} implausible for 600 ms"
            if t_ns is not None and now_ns - t_ns >= ODD_NS:
                self.no_more_torque = True
        if self.told is None or self.told.throttle <= 0.0 or self.told.brake <= 0.0:
            self.pedals_ns = None  # for as long as no command counts, none asks for both
        elif self.pedals_ns is None:
            assert self.command_ns is not None
            self.pedals_ns = max(self.command_ns, now_ns - supervised_ns)
        if self.told is not None and self.autonomous and not self.over and not self.latched:
            if self.pedals_ns is not None and now_ns - self.pedals_ns >= PEDALS_NS:
                self.due = "throttle and brake together for 100 ms"
            if self.told.estop:
                self.due = "the mission asks for the emergency brake"
            if self.told.finished:
                self.no_more_torque = True
        return lost

    # ------------------------------------------------------------ what went out

    def on_cycle(self, asked: AiCommand, limits: Limits, now_ns: int) -> list[Violation]:
        """Hold one cycle against the rules, before its frames leave."""
        found: list[Violation] = []

        def wrong(rule: str, words: str) -> None:
            found.append(Violation(rule, words))

        state = self.as_state
        driving = state is AsState.AS_DRIVING
        torque = asked.front_torque_nm > 0.0 or asked.rear_torque_nm > 0.0
        brake = asked.front_brake_pct > 0.0 or asked.rear_brake_pct > 0.0
        status_age = None if self.status_ns is None else now_ns - self.status_ns
        supervised = self.driving_ns is not None and now_ns - self.driving_ns >= LAUNCH_NS

        if not limits.may_send:
            wrong("8", "a process that only listens sends")
        if self.bus_gone:
            wrong("8", "frames are sent on a lost bus")
        if self.began_ns is None or now_ns - self.began_ns < LISTEN_FIRST_NS:
            wrong("8", "frames are sent before the process has listened for 200 ms")
        if self.ended is not None:
            self.ended += 1
            if self.ended > limits.stop_cycles:
                wrong("8", "frames are sent after the orderly end")
        if asked.handshake != self.handshake:
            wrong("9", "the echo is not the last bit received")

        if torque:
            if brake:
                wrong("1", "one cycle asks for torque and brake")
            if not self.torque_runs and not (self.zeros >= 2 or (self.zeros == 1 and self.echoed)):
                wrong("1", "torque rises from zero without a complete zero cycle that the car has echoed, or two")
            self._check_torque(asked, limits, status_age, supervised, now_ns, wrong)
        if brake and self.torque_may_be_there:
            wrong("1", "brake rises while torque may still stand at the VCU")

        if driving and (asked.direction is not Direction.FORWARD or asked.mission_status is MissionStatus.FINISHED):
            fresh = self.speeds_ns is not None and now_ns - self.speeds_ns < SPEEDS_FRESH_NS
            if not fresh:
                wrong("3", "NEUTRAL or FINISHED in AS_DRIVING without fresh wheel speeds")
            elif not self.at_rest(now_ns):
                wrong("3", "NEUTRAL or FINISHED in AS_DRIVING, and the wheels have not stood for 0.5 s")

        if not driving and asked.steer_deg != 0.0:
            wrong("4", "steering outside AS_DRIVING")
        if driving:
            self._check_steering(asked, limits, status_age, supervised, now_ns, wrong)
        motor_rpm = max(asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm)
        if motor_rpm > limits.motor_rpm:
            wrong("4", f"motor speed limit {motor_rpm} rpm beyond {limits.motor_rpm} rpm")

        if state in (None, *OFF, AsState.AS_READY):
            if torque or asked.steer_deg != 0.0:
                wrong("5", "torque or steering before AS_DRIVING")
            if asked.direction is not Direction.NEUTRAL:
                wrong("5", "not NEUTRAL before AS_DRIVING")
            self._check_acknowledgement(asked, wrong)

        if self.latched and not asked.estop_request:
            wrong("6", "ESTOP_REQUEST falls back to 0 and nobody cleared it")
        if asked.estop_request and not self.latched:
            # A stop that goes on may turn out to be without effect, which is not judged here.
            asks = self.due is not None or self.over or (self.told is not None and self.told.estop)
            if not asks:
                wrong("reactions", "ESTOP_REQUEST, and nothing that happened asks for it")
            self.latched = True
        if self.due is not None and not asked.estop_request:
            wrong("reactions", f"no ESTOP_REQUEST: {self.due}")
        self._check_status(asked, now_ns, wrong)
        if limits.brakes_by_motor:
            self._check_motor_brake(asked, status_age, now_ns, wrong)
        else:
            self._check_brake(asked, limits, status_age, supervised, now_ns, wrong)

        # what may stand at the VCU from now on
        self.torque_runs = torque
        self.steer_deg, self.brake_pct, self.cycle_ns = asked.steer_deg, asked.front_brake_pct, now_ns
        return found

    def _check_acknowledgement(self, asked: AiCommand, wrong: Wrong) -> None:
        """MISSION_STATUS before AS_DRIVING."""
        if asked.mission_status not in (MissionStatus.NOT_SELECTED, MissionStatus.SELECTED):
            wrong("5", f"{asked.mission_status.name} before AS_DRIVING")
        elif asked.mission_status is MissionStatus.SELECTED:
            if self.as_state is not AsState.AS_READY and not self.autonomous:
                wrong("5", "SELECTED though nobody chose autonomous")
            if self.as_state is not AsState.AS_READY and self.latched:
                wrong("5", "SELECTED with an emergency latched")
            if self.mission is Ami.NOT_SELECTED or len(self.confirmed) < 2:
                wrong("5", "SELECTED without a mission, or before planner and controller have reset themselves")
        elif (
            self.mission is not Ami.NOT_SELECTED
            and len(self.confirmed) == 2
            and self.ended is None
            and (self.as_state is AsState.AS_READY or (self.autonomous and not self.latched))
        ):
            wrong("output table", "NOT_SELECTED, and a mission is chosen and confirmed")

    def _check_status(self, asked: AiCommand, now_ns: int, wrong: Wrong) -> None:
        """MISSION_STATUS and direction from AS_DRIVING on, as the output table has them."""
        says = asked.mission_status, asked.direction
        finished = says == (MissionStatus.FINISHED, Direction.NEUTRAL)
        rest = self.at_rest(now_ns)
        match self.as_state:
            case AsState.AS_FINISHED if not finished:
                wrong("output table", "not FINISHED and NEUTRAL in AS_FINISHED")
            case AsState.EMERGENCY_BRAKE:
                direction = Direction.NEUTRAL if rest else Direction.FORWARD
                if says != (MissionStatus.RUNNING, direction):
                    stands = "stand" if rest else "are not known to stand"
                    wrong(
                        "output table", f"not RUNNING and {direction.name} in EMERGENCY_BRAKE, and the wheels {stands}"
                    )
            case AsState.AS_DRIVING if self.latched:
                if says != (MissionStatus.RUNNING, Direction.FORWARD) and not (rest and finished):
                    wrong("output table", "an emergency is asked for, and it is not RUNNING and FORWARD")
            case AsState.AS_DRIVING:
                if self.no_more_torque and rest:
                    if not finished:
                        wrong("output table", "a stop is due, the car stands, and it is not FINISHED and NEUTRAL")
                elif says != (MissionStatus.RUNNING, Direction.FORWARD):
                    wrong("output table", "not RUNNING and FORWARD in AS_DRIVING, and no stop is over")

    def _check_steering(
        self, asked: AiCommand, limits: Limits, status_age: int | None, supervised: bool, now_ns: int, wrong: Wrong
    ) -> None:
        live_deg = 0.0 if self.angle_max_deg is None else self.angle_max_deg
        most_deg = min(limits.steer_deg, live_deg)
        if abs(asked.steer_deg) > most_deg + 1e-9:
            wrong("4", f"steering {asked.steer_deg} deg beyond {most_deg} deg")
        step = abs(asked.steer_deg - self.steer_deg)
        if step > limits.steer_rate_degps * CYCLE_NS / 1e9 + STEER_STEP_DEG and abs(self.steer_deg) <= most_deg:
            wrong("4", f"steering turns by {step} deg in one cycle")
        if self.ended is not None and asked.direction is Direction.NEUTRAL:
            if asked.steer_deg != 0.0:
                wrong("output table", "the software ends at rest, and not with zeros")
            return
        held_deg = max(-most_deg, min(most_deg, self.steer_deg))  # a limit that was lowered is obeyed at once
        held = abs(asked.steer_deg - held_deg) <= STEER_STEP_DEG / 2
        stopping = self.no_more_torque or self.latched or asked.estop_request
        if not supervised and not stopping:
            if asked.steer_deg != 0.0:
                wrong("output table", "steering in the first 3 s of AS_DRIVING")
            return
        if self.told is None or not self.autonomous:
            if not held:
                wrong("output table", f"steering from {self.steer_deg} to {asked.steer_deg} deg, and no command counts")
            return
        most_turn_deg = 0.0
        if self.cycle_ns is not None:
            most_turn_deg = limits.steer_rate_degps * min(now_ns - self.cycle_ns, LONGEST_TURN_NS) / 1e9
        turn_deg = max(-most_turn_deg, min(most_turn_deg, self.told.steer_deg - self.steer_deg))
        wanted_deg = max(-most_deg, min(most_deg, self.steer_deg + turn_deg))
        obeyed = abs(asked.steer_deg - wanted_deg) <= STEER_STEP_DEG
        stale = self.unknown or status_age is None or status_age >= STATUS_FRESH_NS
        if not obeyed and not (held and (stopping or stale)):
            wrong("output table", f"steering {asked.steer_deg} deg, and the command asks for {self.told.steer_deg:.2f}")

    def _check_brake(
        self, asked: AiCommand, limits: Limits, status_age: int | None, supervised: bool, now_ns: int, wrong: Wrong
    ) -> None:
        """The brake that the output table and the reactions ask for, as soon as rule 1 lets it rise."""
        front, rear = asked.front_brake_pct, asked.rear_brake_pct
        if front != rear:
            wrong("output table", f"brake {front} % in front and {rear} % at the rear")
        state = self.as_state
        if state in (None, *OFF, AsState.EMERGENCY_BRAKE) or (
            self.ended is not None and asked.direction is Direction.NEUTRAL
        ):
            if front > 0.0:
                wrong("output table", f"brake in {'no AS state yet' if state is None else state.label}")
            return
        if self.torque_may_be_there:
            return
        if state is not AsState.AS_DRIVING:
            if front <= 0.0:
                wrong("output table", f"no holding brake in {'' if state is None else state.label}")
        elif self.latched or (self.no_more_torque and not self.at_rest(now_ns)):
            if front != limits.service_brake_pct:
                why = "an emergency is asked for" if self.latched else "a stop is due"
                wrong("output table", f"brake {front} %, not the service brake, and {why}")
        elif self.no_more_torque or not supervised:
            if front <= 0.0:
                wrong("output table", "no holding brake " + ("at rest" if self.no_more_torque else "in the first 3 s"))
        elif (
            self.told is not None
            and not self.unknown
            and status_age is not None
            and status_age < STATUS_FRESH_NS
            and abs(front - 100.0 * self.told.brake) > BRAKE_STEP_PCT / 2
        ):
            wrong("output table", f"brake {front} %, and the command asks for {100.0 * self.told.brake:g} %")
        elif self.told is None and front < self.brake_pct:
            wrong("output table", f"the brake falls from {self.brake_pct} % to {front} %, and no command counts")

    def _check_motor_brake(self, asked: AiCommand, status_age: int | None, now_ns: int, wrong: Wrong) -> None:
        """A car that must never be asked for a hydraulic brake is stopped by torque against a speed limit of zero."""
        if asked.front_brake_pct > 0.0 or asked.rear_brake_pct > 0.0:
            wrong("output table", "a hydraulic brake on a car that brakes by its motors")
        due = self.as_state is AsState.AS_DRIVING and self.no_more_torque and not self.latched
        known = all(
            t_ns is not None and now_ns - t_ns < FEEDBACK_STALE_NS for t_ns in (self.speeds_ns, self.axle_ns)
        ) and (not self.unknown and status_age is not None and status_age < STATUS_FRESH_NS)
        may_rise = self.torque_runs or self.zeros >= 2 or (self.zeros == 1 and self.echoed)
        if not (due and known and may_rise) or self.at_rest(now_ns):
            return
        torque = asked.front_torque_nm > 0.0 or asked.rear_torque_nm > 0.0
        if not torque or max(asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm) > 0:
            wrong("output table", "the motors do not brake, and a stop is due")

    def _check_torque(
        self,
        asked: AiCommand,
        limits: Limits,
        status_age: int | None,
        supervised: bool,
        now_ns: int,
        wrong: Wrong,
    ) -> None:
        motor_rpm = max(asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm)
        brakes = limits.brakes_by_motor and motor_rpm == 0
        if self.as_state is not AsState.AS_DRIVING:
            wrong("2", "torque and the last AS state seen is not AS_DRIVING")
        if status_age is None or status_age >= STATUS_FRESH_NS:
            wrong("2", "torque on a 0x520 older than 50 ms")
        if self.unknown:
            wrong("2", "torque, and the last 0x520 has an AS_STATE that no table knows")
        if asked.direction is not Direction.FORWARD:
            wrong("2", "torque without FORWARD")
        if asked.estop_request or self.latched:
            wrong("2", "torque with an emergency latched")
        if not brakes:
            if self.restarted:
                wrong("10", "torque after a restart without AS_OFF seen anew")
            if self.path != 3:
                wrong("2", "torque without AS_OFF, AS_READY, AS_DRIVING seen by this process")
            if not self.waited and not limits.short_sequence:
                wrong("2", "torque without 5 s in AS_READY before Go")
            if self.mission is Ami.NOT_SELECTED or not self.acknowledged:
                wrong("2", "torque without a mission that was acknowledged")
            if not supervised:
                wrong("2", "torque in the first 3 s of AS_DRIVING")
            if not self.go:
                wrong("2", "torque with Go off")
            if not self.autonomous:
                wrong("2", "torque and the mode is not autonomous")
            if self.order is None or self.command_ns is None or self.order.throttle <= 0.0 or self.order.brake > 0.0:
                wrong("2", "torque and no command asks for it")
            elif now_ns - self.command_ns >= COMMAND_FRESH_NS:
                wrong("2", "torque on a command older than 100 ms")
            elif now_ns - self.data_ns >= DATA_FRESH_NS:
                wrong("2", "torque on sensor data older than 500 ms")
            if self.no_more_torque:
                wrong("reactions", "torque in a run whose stop is latched")
        for name, torque_nm, driven, side in (
            ("front", asked.front_torque_nm, limits.front_driven, 0),
            ("rear", asked.rear_torque_nm, limits.rear_driven, 2),
        ):
            if torque_nm <= 0.0:
                continue
            if not driven:
                wrong("4", f"torque on the {name} axle, which has no motor")
            if self.rpm is None or self.torque_max_nm is None:
                wrong("4", "torque without the car's limits known")
                continue
            if self.axle_ns is None or now_ns - self.axle_ns >= FEEDBACK_STALE_NS:
                wrong("4", "torque by a TRQ_MAX older than 100 ms")
            most_nm = min(limits.torque_nm, self.torque_max_nm, constant_power_nm(max(self.rpm[side : side + 2])))
            if not brakes and self.order is not None:
                most_nm *= self.order.throttle
            if torque_nm > most_nm + 1e-9:
                wrong("4", f"{name} torque {torque_nm} Nm beyond {most_nm} Nm")

    def on_sent(self, asked: AiCommand, complete: bool, now_ns: int) -> None:
        """Whether all five frames of that cycle went out."""
        self.acknowledged = self.acknowledged or (complete and asked.mission_status is MissionStatus.SELECTED)
        if complete or self.complete_ns is None:
            self.complete_ns = now_ns
        elif now_ns - self.complete_ns >= SEND_LOST_NS and self.as_state is AsState.AS_DRIVING:
            self.on_bus_lost()
            self.complete_ns = now_ns
        torque = asked.front_torque_nm > 0.0 or asked.rear_torque_nm > 0.0
        brake = asked.front_brake_pct > 0.0 or asked.rear_brake_pct > 0.0
        if torque or brake:
            self.zeros, self.echoed = 0, False
            self.torque_may_be_there = torque or (self.torque_may_be_there and not complete)
        elif complete:
            if self.zeros < 2:
                self.zeros += 1
            self.torque_may_be_there = False
