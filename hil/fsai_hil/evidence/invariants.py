"""The safety rules as a witness beside the bus sees them, written without a look into supervisor or gate.

The witness knows what the car said and when, what people asked and were granted, which commands were in order, and
what went out. Its numbers come from the safety rules and from the interface specification, not from the code under
search. Every problem names the rule it breaks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from fsai_hil.evidence.search import Problem
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.images import AiCommand

MS: Final = 1_000_000
S: Final = 1_000_000_000

RULES: Final = {
    "1": "torque and brake never meet at the VCU",
    "2": "torque only with everything that allows it",
    "3": "NEUTRAL or FINISHED in AS_DRIVING only at proven rest",
    "4": "steering, torque and motor speed within every limit",
    "5": "before AS_DRIVING: zeros, NEUTRAL, at most SELECTED",
    "6": "an emergency request latches",
    "7": "commands out of order are refused whole",
    "8": "the five frames and no other",
    "9": "the handshake echoes the last bit received",
    "10": "no drive goes on after a restart",
    "reactions": "graded reactions come in time",
    "safe end": "a safe end is reached from every state",
}

# safety rules 2, 3 and 6, and the graded reactions
STATUS_FRESH_NS: Final = 50 * MS
LAUNCH_NS: Final = 3 * S
COMMAND_FRESH_NS: Final = 100 * MS
DATA_FRESH_NS: Final = 500 * MS
SPEEDS_FRESH_NS: Final = 100 * MS
STILL_NS: Final = 500 * MS
STILL_RPM: Final = 10
POWER_CYCLE_NS: Final = 1 * S
STATUS_LOST_NS: Final = 100 * MS
COMMAND_LOST_NS: Final = 300 * MS
FEEDBACK_STALE_NS: Final = 100 * MS
FEEDBACK_LOST_NS: Final = 300 * MS
ODD_NS: Final = 300 * MS
ODD_LOST_NS: Final = 600 * MS
PEDALS_NS: Final = 100 * MS

Wrong = Callable[[str, str], None]

OFF: Final = (AsState.AS_INIT, AsState.AS_OFF)


@dataclass(frozen=True, slots=True)
class Limits:
    """What rule 4 allows on the car, the interface revision and at the venue under search."""

    steer_deg: float
    steer_step_deg: float  # in the longest time between two cycles
    torque_nm: float
    motor_rpm: int
    front_driven: bool
    rear_driven: bool
    brakes_by_motor: bool = False  # the official simulator: torque against a motor speed limit of zero is a brake
    command_brake_pct: float = 40.0  # what the searched commands that press the brake ask for
    may_send: bool = True


def constant_power_nm(fastest_rpm: int) -> float:
    """Interface specification v4.0: the most torque of an axle by its fastest wheel."""
    if fastest_rpm > 700:
        return 50.0
    if fastest_rpm > 600:
        return 85.0
    if fastest_rpm > 500:
        return 100.0
    if fastest_rpm > 400:
        return 120.0
    return 150.0 if fastest_rpm > 300 else 195.0


class Witness:
    """What has been seen on the bus and heard from people. Times are ns; None: never."""

    __slots__ = (
        "alarm",
        "angle_max_deg",
        "as_state",
        "autonomous",
        "axle_ns",
        "bus_gone",
        "command_ns",
        "confirmed",
        "data_ns",
        "driving_ns",
        "echoed",
        "go",
        "handshake",
        "heard_ns",
        "latched",
        "mission",
        "no_more_torque",
        "path",
        "pedals_ns",
        "pushes",
        "restarted",
        "rpm",
        "silence",
        "speeds_ns",
        "status_ns",
        "steer_deg",
        "steer_ns",
        "steer_odd_ns",
        "still_ns",
        "torque_max_nm",
        "torque_may_be_there",
        "torque_runs",
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
        self.path = 0  # 1 AS_OFF, 2 then AS_READY, 3 then AS_DRIVING; 0 anything else
        self.driving_ns: int | None = None
        self.rpm: tuple[int, int, int, int] | None = None
        self.speeds_ns: int | None = None
        self.still_ns: int | None = None
        self.angle_max_deg: float | None = None
        self.steer_ns: int | None = None
        self.torque_max_nm: float | None = None
        self.axle_ns: int | None = None
        self.handshake = False
        # what people and the planner said
        self.autonomous = False
        self.confirmed = False  # planner and controller have reset themselves for this mission
        self.latched = False
        self.pushes = False  # the newest command in order asks for throttle and no brake
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
        # what went out
        self.torque_may_be_there = True
        self.zeros = 0  # complete cycles with both at zero
        self.echoed = False  # and a 0x524 after them says so
        self.torque_runs = False
        self.steer_deg = 0.0

    # ------------------------------------------------------------ what happens

    def on_any_status(self, now_ns: int) -> None:
        if self.heard_ns is not None and now_ns - self.heard_ns >= POWER_CYCLE_NS:
            self.silence = True
        self.heard_ns = now_ns

    def on_status(self, as_state: AsState, go: bool, fault: bool, ami: Ami, now_ns: int) -> None:
        self.on_any_status(now_ns)
        idle = as_state in (*OFF, AsState.AS_READY)
        entered_off = as_state in OFF and self.as_state is not None and (self.as_state not in OFF or self.silence)
        if entered_off or (ami is not self.mission and (idle or self.as_state is None)):
            self.mission, self.confirmed = ami, False
        if self.silence:
            self.path = 0
            if as_state in OFF:
                self.latched = False
        anew = as_state is not self.as_state or self.silence
        self.silence = False
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
            self.driving_ns = None
            self.no_more_torque = False
            self.alarm = False
        elif anew:
            self.driving_ns = now_ns
            self.no_more_torque = False
        if as_state is AsState.AS_DRIVING and (not go or fault):
            self.no_more_torque = True
        self.as_state, self.go, self.status_ns = as_state, go, now_ns

    def on_speeds(self, rpm: tuple[int, int, int, int], now_ns: int) -> None:
        gap = self.speeds_ns is None or now_ns - self.speeds_ns >= SPEEDS_FRESH_NS
        if max(rpm) >= STILL_RPM:
            self.still_ns = None
        elif self.still_ns is None or gap:
            self.still_ns = now_ns
        self.rpm, self.speeds_ns = rpm, now_ns

    def on_brake(self, zero: bool) -> None:
        self.echoed = self.echoed or (zero and self.zeros > 0)

    def on_command(self, pushes: bool, both: bool, data_ns: int, now_ns: int) -> None:
        """A command that is in order."""
        self.pushes, self.command_ns, self.data_ns = pushes, now_ns, data_ns
        if not both:
            self.pedals_ns = None
        elif self.pedals_ns is None:
            self.pedals_ns = now_ns

    def restart(self) -> None:
        """The process dies and another takes its place: it knows nothing; the car goes on as it is."""
        fresh = Witness()
        for name in self.__slots__:
            setattr(self, name, getattr(fresh, name))

    # ------------------------------------------------------------ what went out

    def on_cycle(self, asked: AiCommand, limits: Limits, now_ns: int) -> list[Problem]:
        """Hold one cycle against the rules, before its frames leave."""
        found: list[Problem] = []

        def wrong(rule: str, words: str) -> None:
            found.append(Problem(rule, words))

        state = self.as_state
        driving = state is AsState.AS_DRIVING
        torque = asked.front_torque_nm > 0.0 or asked.rear_torque_nm > 0.0
        brake = asked.front_brake_pct > 0.0 or asked.rear_brake_pct > 0.0
        status_age = None if self.status_ns is None else now_ns - self.status_ns
        supervised = self.driving_ns is not None and now_ns - self.driving_ns >= LAUNCH_NS

        if not limits.may_send:
            wrong("8", "a process that only listens sends")
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
            elif self.still_ns is None or now_ns - self.still_ns < STILL_NS:
                wrong("3", "NEUTRAL or FINISHED in AS_DRIVING, and the wheels have not stood for 0.5 s")

        if not driving and asked.steer_deg != 0.0:
            wrong("4", "steering outside AS_DRIVING")
        if driving:
            live_deg = 0.0 if self.angle_max_deg is None else self.angle_max_deg
            most_deg = min(limits.steer_deg, live_deg)
            if abs(asked.steer_deg) > most_deg + 1e-9:
                wrong("4", f"steering {asked.steer_deg} deg beyond {most_deg} deg")
            step = abs(asked.steer_deg - self.steer_deg)
            if step > limits.steer_step_deg + 0.1 and abs(self.steer_deg) <= most_deg:
                wrong("4", f"steering turns by {step} deg in one cycle")
        motor_rpm = max(asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm)
        if motor_rpm > limits.motor_rpm:
            wrong("4", f"motor speed limit {motor_rpm} rpm beyond {limits.motor_rpm} rpm")

        if state in (None, *OFF, AsState.AS_READY):
            if torque or asked.steer_deg != 0.0:
                wrong("5", "torque or steering before AS_DRIVING")
            if asked.direction is not Direction.NEUTRAL:
                wrong("5", "not NEUTRAL before AS_DRIVING")
            if asked.mission_status not in (MissionStatus.NOT_SELECTED, MissionStatus.SELECTED):
                wrong("5", f"{asked.mission_status.name} before AS_DRIVING")
            if asked.mission_status is MissionStatus.SELECTED and state is not AsState.AS_READY and not self.autonomous:
                wrong("5", "SELECTED though nobody chose autonomous")
            if asked.mission_status is MissionStatus.SELECTED and (
                self.mission is Ami.NOT_SELECTED or not self.confirmed
            ):
                wrong("5", "SELECTED without a mission, or before planner and controller have reset themselves")

        if self.latched and not asked.estop_request:
            wrong("6", "ESTOP_REQUEST falls back to 0 and nobody cleared it")
        if asked.estop_request:
            self.latched = True
        if driving:
            self._check_reactions(asked, limits, status_age, supervised, now_ns, wrong)

        # what may stand at the VCU from now on
        self.torque_runs = torque
        self.steer_deg = asked.steer_deg
        return found

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
        if asked.direction is not Direction.FORWARD:
            wrong("2", "torque without FORWARD")
        if asked.estop_request or self.latched:
            wrong("2", "torque with an emergency latched")
        if not brakes:
            if self.restarted:
                wrong("10", "torque after a restart without AS_OFF seen anew")
            if self.path != 3:
                wrong("2", "torque without AS_OFF, AS_READY, AS_DRIVING seen by this process")
            if not supervised:
                wrong("2", "torque in the first 3 s of AS_DRIVING")
            if not self.go:
                wrong("2", "torque with Go off")
            if not self.autonomous:
                wrong("2", "torque and the mode is not autonomous")
            if not self.pushes or self.command_ns is None:
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
            most_nm = min(limits.torque_nm, self.torque_max_nm, constant_power_nm(max(self.rpm[side : side + 2])))
            if torque_nm > most_nm + 1e-9:
                wrong("4", f"{name} torque {torque_nm} Nm beyond {most_nm} Nm")

    def _check_reactions(
        self, asked: AiCommand, limits: Limits, status_age: int | None, supervised: bool, now_ns: int, wrong: Wrong
    ) -> None:
        """The graded reactions in AS_DRIVING, as far as they are due at once."""
        due: str | None = None
        if status_age is None or status_age >= STATUS_LOST_NS:
            due = "0x520 is lost for 100 ms"
        elif self.alarm:
            due = "an intruder or a fault of the loop"
        if supervised:
            for name, t_ns in (("wheel speeds", self.speeds_ns), ("steering feedback", self.steer_ns)):
                if t_ns is None or now_ns - t_ns >= FEEDBACK_LOST_NS:
                    due = f"{name} lost for 300 ms"
                if t_ns is None or now_ns - t_ns >= FEEDBACK_STALE_NS:
                    self.no_more_torque = True
            for name, t_ns in (("the steering", self.steer_odd_ns), ("a wheel", self.wheel_odd_ns)):
                if t_ns is not None and now_ns - t_ns >= ODD_LOST_NS:
                    due = f"{name} implausible for 600 ms"
                if t_ns is not None and now_ns - t_ns >= ODD_NS:
                    self.no_more_torque = True
            if self.command_ns is not None and self.autonomous and self.driving_ns is not None:
                supervised_ns = self.driving_ns + LAUNCH_NS
                if now_ns - max(self.command_ns, supervised_ns) >= COMMAND_LOST_NS:
                    self.no_more_torque = True
                if now_ns - self.command_ns >= COMMAND_FRESH_NS or now_ns - self.data_ns >= DATA_FRESH_NS:
                    self.pedals_ns = None  # for as long as no command counts, none asks for both
                if (
                    self.pedals_ns is not None
                    and now_ns - max(self.pedals_ns, supervised_ns) >= PEDALS_NS
                    and asked.front_brake_pct == limits.command_brake_pct  # the planner's word counts
                    and not self.no_more_torque
                ):
                    due = "throttle and brake together for 100 ms"
        if due is not None and not asked.estop_request:
            wrong("reactions", f"no ESTOP_REQUEST: {due}")

    def on_sent(self, asked: AiCommand, complete: bool) -> None:
        """Whether all five frames of that cycle went out."""
        torque = asked.front_torque_nm > 0.0 or asked.rear_torque_nm > 0.0
        brake = asked.front_brake_pct > 0.0 or asked.rear_brake_pct > 0.0
        if torque or brake:
            self.zeros, self.echoed = 0, False
            self.torque_may_be_there = torque or (self.torque_may_be_there and not complete)
        elif complete:
            if self.zeros < 2:
                self.zeros += 1
            self.torque_may_be_there = False
