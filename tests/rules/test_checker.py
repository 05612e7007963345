"""The rules one by one: for each a sequence that keeps it, and one that breaks it and names it."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from msgspec.structs import replace

from fsai_hil.evidence.small_car import SmallCar
from fsai_hil.rules import bus_view, reactions
from fsai_hil.rules.checker import RULES, WireChecker, check_candump
from fsai_hil.rules.seen import Process
from fsai_hil.rules.shown import Shown
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.diagnostics.log.reader import LogError
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, Direction, EbsState, MissionStatus, OpState, ShutdownCause, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiCommand,
    Faults,
    RotationB,
    VcuBrake,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision

MS = 1_000_000
CODEC = Codec(revision("2026"))
OFF, READY, DRIVING = AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
EXACT: dict[str, Any] = {
    "in_flight_ns": 0,
    "handshake_in_flight_ns": 0,
    "clock_slack_ns": 0,
    "car": CARS["2026"],
    "from_start": True,
}
IDLE = AiCommand()
SELECTED = AiCommand(mission_status=MissionStatus.SELECTED)
RUNNING = AiCommand(mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD)
FINISHED = AiCommand(mission_status=MissionStatus.FINISHED)
FINISHED_FORWARD = replace(FINISHED, direction=Direction.FORWARD)
ASKING = replace(RUNNING, estop_request=True)


def braked(command: AiCommand, pct: float = 30.0) -> AiCommand:
    return replace(command, front_brake_pct=pct, rear_brake_pct=pct)


def drive(torque_nm: float = 50.0, steer_deg: float = 0.0, rpm: int = 500) -> AiCommand:
    return replace(RUNNING, rear_torque_nm=torque_nm, rear_motor_speed_max_rpm=rpm, steer_deg=steer_deg)


class Sender(SmallCar):
    """Car and AI computer by hand, a cycle every 10 ms; the checker sees what the AI computer sees."""

    answer_ns = 0  # how long after the car
    dense = 40  # where nothing happens for longer, 0x520 every 80 ms is enough until so many cycles are left

    def __init__(self, **options: Any) -> None:
        self.now_ns = 1000 * MS
        self.checker = WireChecker(CODEC, **{**EXACT, **options})
        self.frames: list[Frame] = []
        self.counts: int | None = None
        self.mute: tuple[type, ...] = ()
        self.echo: bool | None = None
        self.cycles = 0

    def puts(self, frame: Frame) -> None:
        self.frames.append(frame)
        self.checker.on_frame(frame)

    def receives_the_car(self) -> None:
        if VcuStatus not in self.mute:
            self.status = replace(self.status, handshake=not self.status.handshake)
        counts = [] if self.counts is None else [WheelCounts(*[self.counts] * 4)]
        for image in (*self.images(), *counts):
            if not isinstance(image, self.mute):
                self.puts(CODEC.encode(replace(image, t_rx_ns=self.now_ns)))

    def cycle(self, command: AiCommand, cycles: int = 1, *, car: bool = True, frames: int = 5) -> Any:
        step = 1
        while cycles > 0:
            cycles -= step
            self.now_ns += step * 10 * MS
            if car:
                self.receives_the_car()
            self.says(command, frames)
            step = 8 if cycles > self.dense else 1
        return self

    def says(self, command: AiCommand, frames: int = 5) -> None:
        bit = self.status.handshake if self.echo is None else self.echo
        said = CODEC.encode_command(replace(command, handshake=bit), self.now_ns + self.answer_ns)
        for frame in said[:frames]:
            self.puts(frame)
        self.heard, self.cycles = command, self.cycles + 1

    def car(self, **says: Any) -> Any:
        self.status = replace(self.status, **says)
        return self

    def has(self, **what: Any) -> Any:
        for name, value in what.items():
            setattr(self, name, value)
        return self

    def state(self, as_state: AsState) -> Any:
        return self.car(as_state=as_state, go_signal=as_state is DRIVING)

    def ready(self, cycles: int = 495) -> Any:
        return self.cycle(SELECTED, 3).state(READY).cycle(SELECTED, cycles)

    def launches(self) -> Any:
        return self.state(DRIVING).cycle(RUNNING, 301)

    def driving(self) -> Any:
        return self.ready().launches()

    def frame(self, frame: Frame) -> Any:
        self.puts(replace(frame, t_ns=self.now_ns))
        return self

    def cycle_after(self, ms: int, command: AiCommand) -> Any:
        self.now_ns += (ms - 10) * MS
        return self.cycle(command)

    def stood(self) -> Any:
        """In AS_DRIVING, and at rest for long enough."""
        return self.driving().cycle(drive(), 10).has(rpm=0).cycle(RUNNING, 52)

    def deaf(self, kind: type, cycles: int) -> Any:
        return self.driving().cycle(drive(), 3).has(mute=(kind,)).cycle(drive(), cycles)

    def unknown(self, as_state: int, said: AiCommand) -> Any:
        self.now_ns += 10 * MS
        frame = CODEC.encode(replace(self.status, t_rx_ns=self.now_ns))
        self.puts(replace(frame, data=frame.data[:2] + bytes((0x40 | as_state,)) + frame.data[3:]))
        return self.cycle(said, car=False)

    def happens(self, what: str, *values: object) -> Any:
        getattr(self.checker, what)(*values)
        return self

    def happens_now(self, what: str, *values: object) -> Any:
        return self.happens(what, *values, self.now_ns)

    @property
    def rules(self) -> list[str]:
        return [violation.rule for _, violation in self.checker.found]


class Fed(Sender):
    """The same, whose checker is given what the process is given: a planner's command in each cycle, modes, resets."""

    def __init__(self, motor_brakes: bool = False, **process: Any) -> None:
        super().__init__(process=Process(**process), motor_brakes=motor_brakes)
        self.command: VehicleCommand | None = VehicleCommand(0, 1, throttle=0.5, speed_limit_mps=10.0)
        self.mode = "manual"
        self.odd_ns: dict[str, int] = {}  # since when it takes what for implausible
        self.data_ms = 0  # the age of what is behind each command
        self.cycle(IDLE, 40, frames=0).confirms().asks("autonomous")

    def confirms(self) -> Any:
        """Planner and controller have reset themselves."""
        return self.happens("on_confirmed", "planner").happens("on_confirmed", "controller")

    def asks(self, mode: str, done: bool = True) -> Any:
        self.checker.on_mode(mode, (done, "autonomous or manual"), self.now_ns)
        self.mode = mode if done else self.mode
        return self

    def plans(self, refused: bool = False, age_ms: int = 0, current: bool = True, **fields: Any) -> Any:
        command = replace(self.command or VehicleCommand(0, 1), t_sensor_ns=self.now_ns - age_ms * MS, **fields)
        self.checker.on_command(command, refused, self.now_ns, current=current)
        return self

    def says(self, command: AiCommand, frames: int = 5) -> None:
        if self.command is not None:
            self.plans(age_ms=self.data_ms)
        self.checker.on_cycle(self.now_ns, self.mode, self.odd_ns.get("steering"), self.odd_ns.get("a wheel"))
        if frames:
            self.checker.on_sending()
        super().says(command, frames)
        self.checker.cycle_over(self.now_ns)

    def ready(self, cycles: int = 495) -> Any:
        return self.cycle(SELECTED, 3).state(READY).cycle(braked(SELECTED), cycles)

    def driving(self) -> Any:
        self.ready().state(DRIVING).cycle(braked(RUNNING), 300).cycle(RUNNING)
        return self.cycle(drive(), 20).has(rpm=100)

    def silent(self, cycles: int) -> Any:
        """The planner falls silent."""
        self.driving().cycle(drive()).has(command=None).cycle(drive(), 9)
        return self.cycle(RUNNING, cycles - 9)

    def wants(self, **fields: Any) -> Any:
        """The planner asks for something else than driving."""
        assert self.command is not None
        self.driving().cycle(drive(), 3).command = replace(self.command, **fields)
        return self

    def odd(self, what: str) -> Any:
        """From the next cycle on the process takes it for implausible."""
        return self.has(odd_ns={what: self.now_ns + 10 * MS})

    def contradicted(self, cycles: int) -> Any:
        """Pulse counts run at 4 turns/s, and 0x525 says 0 rpm: not believed after some 200 ms, missing 100 ms later."""
        self.driving().has(rpm=0, counts=0).cycle(drive())
        for cycle in range(cycles):
            self.has(counts=8 * cycle // 10).cycle(drive())
        return self


class Then:
    """Steps of a sender: of one that runs, `then.cycle(IDLE)`, or of a new one, `new.cycle(IDLE)`."""

    def __init__(self, *steps: Callable[[Any], Any]) -> None:
        self.steps = steps

    def __getattr__(self, name: str) -> Callable[..., Then]:
        return lambda *values, **named: Then(*self.steps, lambda sender: getattr(sender, name)(*values, **named))

    def __call__(self, sender: Any = None) -> Any:
        for step in self.steps:
            sender = step(sender)
        return sender


def made(kind: type[Sender], **options: Any) -> Then:
    return Then(lambda _: kind(**options))


then = Then()
new, fed, exact = made(Sender), made(Fed), made(Fed, nothing_hidden=True)
driving, idle, drives = new.driving(), new.cycle(IDLE), then.driving().cycle(drive())
rolling = driving.has(rpm=100).cycle(RUNNING, 2)
moving = fed.driving()
ends = exact.driving().happens("on_end")
stops = moving.asks("manual").cycle(RUNNING)
ends_at_rest = moving.has(rpm=0).cycle(drive(), 52).happens("on_end")
motors = made(Fed, motor_brakes=True, nothing_hidden=True).cycle(SELECTED, 3).state(READY).cycle(SELECTED, 495)
venue = made(Sender, limits=OperationalLimits(max_speed_mps=2.0, max_axle_torque_nm=40.0, max_steer_deg=0.3)).driving()

NEUTRAL = replace(RUNNING, direction=Direction.NEUTRAL)
ESTOP = replace(IDLE, estop_request=True)
STOPPING, BRAKING, PLANNED = braked(RUNNING, 80.0), braked(ASKING, 80.0), braked(RUNNING, 40.0)
BRAKE_FRAME = CODEC.encode_command(STOPPING)[4]

# Steering that nobody asked for, and a wheel faster than the other three: the planner brakes, so no torque spins it.
BRAKES = made(Fed, follows=True).wants(throttle=0.0, brake=0.4).cycle(RUNNING).cycle(PLANNED, 110)
ODD = {
    "steering": BRAKES.has(angle_deg=9.0).cycle(PLANNED, 33),
    "a wheel": BRAKES.has(rpm=(240, 100, 100, 100)).cycle(PLANNED, 33),
}

Make = Callable[[], Any]
End = AiCommand | Callable[[Any], Any] | None  # another cycle that says this, or what is done


def at(as_state: AsState) -> Make:
    return new.cycle(IDLE, 60).state(as_state)


def ended_by(start: Make, end: End) -> Any:
    sender = start()
    return sender if end is None else sender.cycle(end) if isinstance(end, AiCommand) else end(sender)


class Case(NamedTuple):
    """A rule, and what of it."""

    rule: str
    what: str

    def of(self, start: Make, keeps: End, breaks: End) -> tuple[str, str, Make, End, End]:
        """A beginning, and what keeps and what breaks the rule from there."""
        return (self.rule, self.what, start, keeps, breaks)


CASES: list[tuple[str, str, Make, End, End]] = [
    Case("1", "both in one cycle").of(driving, drive(), braked(drive())),
    Case("1", "torque after one quiet cycle").of(
        driving.cycle(braked(RUNNING), 3).cycle(RUNNING), drive(), then.has(mute=(VcuBrake,)).cycle(drive())
    ),
    Case("1", "torque after a cycle that was cut short").of(
        driving.cycle(braked(RUNNING), 3),
        then.cycle(RUNNING, 2).cycle(drive()),
        then.cycle(RUNNING, 2, frames=4).cycle(drive()),
    ),
    Case("1", "the first brake of a process").of(
        new.state(READY),
        then.cycle(IDLE).cycle(braked(SELECTED)),
        then.cycle(IDLE, frames=4).cycle(braked(SELECTED)),
    ),
    Case("1", "torque in a log that begins with a brake").of(
        made(Sender, from_start=False).state(DRIVING).frame(BRAKE_FRAME), then.cycle(RUNNING).cycle(drive()), drive()
    ),
    Case("1", "brake after torque").of(driving.cycle(drive()), then.cycle(RUNNING).cycle(STOPPING), STOPPING),
    Case("1", "brake after the torque of a process that died").of(
        driving.cycle(drive(), 3).happens("restarted"), then.cycle(RUNNING).cycle(STOPPING), STOPPING
    ),
    Case("2", "3 s of AS_DRIVING").of(
        new.ready().state(DRIVING).cycle(RUNNING, 299), then.cycle(RUNNING).cycle(drive()), drive()
    ),
    Case("2", "any 0x520").of(Sender, then.cycle(IDLE, car=False), then.cycle(drive(), car=False)),
    Case("2", "AS_DRIVING").of(Sender, drives, then.ready().car(go_signal=True).cycle(drive())),
    Case("2", "Go").of(driving, drive(), then.car(go_signal=False).cycle(drive())),
    Case("2", "0x520 younger than 50 ms").of(
        driving.cycle(drive()), then.cycle(drive(), 4, car=False), then.cycle(drive(), 5, car=False)
    ),
    Case("2", "an AS_STATE of the table").of(driving, then.unknown(3, drive()), then.unknown(15, drive())),
    Case("2", "100 ms of known AS states after one that is none").of(
        driving.cycle(drive()).unknown(15, RUNNING).cycle(RUNNING, 9), then.cycle(RUNNING).cycle(drive()), drive()
    ),
    Case("2", "FORWARD").of(driving, drive(), replace(drive(), direction=Direction.REVERSE)),
    Case("2", "no emergency").of(driving, drive(), replace(drive(), estop_request=True)),
    Case("2", "a mission").of(Sender, drives, then.car(ami=Ami.NOT_SELECTED).driving().cycle(drive())),
    Case("2", "SELECTED in a whole cycle").of(
        Sender, drives, then.cycle(SELECTED, 3, frames=4).state(READY).cycle(IDLE, 495).launches().cycle(drive())
    ),
    Case("2", "5 s in AS_READY").of(
        Sender, then.ready(491).launches().cycle(drive()), then.ready(490).launches().cycle(drive())
    ),
    Case("2", "Go after the 5 s").of(
        new.cycle(SELECTED, 3),
        then.state(READY).cycle(SELECTED, 495).launches().cycle(drive()),
        then.car(as_state=READY, go_signal=True).cycle(SELECTED, 495).launches().cycle(drive()),
    ),
    Case("2", "AS_OFF, AS_READY, AS_DRIVING in turn").of(
        driving,
        then.cycle(RUNNING, 98, car=False).cycle(RUNNING, 301).cycle(drive()),
        then.cycle(RUNNING, 99, car=False).cycle(RUNNING, 301).cycle(drive()),
    ),
    Case("3", "FINISHED at rest").of(rolling, then.has(rpm=0).cycle(RUNNING, 50).cycle(FINISHED), FINISHED_FORWARD),
    Case("3", "NEUTRAL at rest for 0.5 s").of(
        rolling.has(rpm=0).cycle(RUNNING, 49), then.cycle(RUNNING).cycle(NEUTRAL), NEUTRAL
    ),
    Case("3", "wheel speeds younger than 100 ms").of(
        new.stood().has(mute=(WheelSpeeds,)).cycle(RUNNING, 8), FINISHED, then.cycle(RUNNING).cycle(FINISHED)
    ),
    Case("3", "no count runs").of(
        new.has(counts=0).stood(), then.has(counts=1).cycle(FINISHED), then.has(counts=2).cycle(FINISHED)
    ),
    Case("4", "steering within ANGLE_MAX").of(
        made(Sender, car=None).driving().has(angle_max_deg=21.0).cycle(RUNNING), drive(0.0, 21.0), drive(0.0, -21.1)
    ),
    Case("4", "steering rate").of(driving, then.cycle(drive(0.0, 0.4)).cycle(drive(0.0, 0.8)), drive(0.0, 0.6)),
    Case("4", "a lowered limit is no haste").of(
        made(Sender, steer_rate_degps=1000.0).driving().cycle(drive(0.0, 10.0)),
        then.has(angle_max_deg=2.0).cycle(drive(0.0, 2.0)),
        drive(0.0, -2.0),
    ),
    Case("4", "no steering in AS_FINISHED").of(at(AsState.AS_FINISHED), FINISHED, replace(FINISHED, steer_deg=0.1)),
    Case("4", "steering of the venue").of(venue, drive(40.0, 0.3, 260), drive(40.0, 0.4, 260)),
    Case("4", "torque of the venue").of(venue, drive(40.0, 0.3, 260), drive(40.1, 0.3, 260)),
    Case("4", "motor speed of the venue").of(venue, drive(40.0, 0.3, 260), drive(40.0, 0.3, 270)),
    Case("4", "torque within TRQ_MAX").of(new.has(torque_max_nm=100.0).driving(), drive(100.0), drive(100.1)),
    Case("4", "a live TRQ_MAX").of(new.deaf(VcuDriveRear, 8), drive(), then.cycle(drive(), 2)),
    Case("4", "an axle with a motor").of(driving, drive(), replace(drive(), front_torque_nm=1.0)),
    Case("5", "at most SELECTED").of(at(READY), SELECTED, replace(SELECTED, mission_status=MissionStatus.RUNNING)),
    Case("5", "no steering in AS_READY").of(at(READY), SELECTED, replace(SELECTED, steer_deg=0.1)),
    Case("6", "an emergency cleared in AS_OFF").of(new.cycle(ESTOP).state(READY), IDLE, then.cycle(ESTOP).cycle(IDLE)),
    Case("8", "what nobody should send").of(idle, None, then.frame(Frame(0x7FF, b""))),
    Case("8", "an extended identifier").of(idle, None, then.frame(Frame(0x510, bytes(8), extended=True))),
    Case("7", "a frame that makes sense").of(idle, None, then.frame(Frame(0x511, b"\x00"))),
    Case("9", "the last bit").of(idle, None, then.has(echo=True).cycle(IDLE, 2)),
    Case("9", "no bit yet").of(Sender, then.cycle(IDLE, car=False), then.has(echo=True).cycle(IDLE, car=False)),
    Case("10", "AS_OFF seen after a restart").of(
        driving.cycle(drive(), 3).cycle(RUNNING).happens("restarted"),
        then.state(OFF).driving().cycle(RUNNING, 301).cycle(drive()),
        then.cycle(RUNNING, 301).cycle(drive()),
    ),
    Case("interval", "8 ms").of(idle, then.cycle_after(8, IDLE), then.cycle_after(7, IDLE)),
    Case("output table", "NEUTRAL in AS_FINISHED").of(at(AsState.AS_FINISHED), FINISHED, FINISHED_FORWARD),
    Case("output table", "never REVERSE").of(at(DRIVING), RUNNING, replace(RUNNING, direction=Direction.REVERSE)),
    Case("output table", "NEUTRAL in EMERGENCY_BRAKE for wheels that stand").of(
        at(AsState.EMERGENCY_BRAKE), then.cycle(NEUTRAL, 2), then.has(rpm=10).cycle(NEUTRAL, 2)
    ),
    Case("output table", "FORWARD in EMERGENCY_BRAKE for wheels that turn").of(
        at(AsState.EMERGENCY_BRAKE), then.has(rpm=10).cycle(RUNNING, 2), then.cycle(RUNNING, 2)
    ),
    Case("output table", "front and rear alike").of(
        at(READY), braked(SELECTED), replace(braked(SELECTED), rear_brake_pct=20.0)
    ),
    Case("output table", "no hydraulic brake where motors brake").of(
        made(Sender, motor_brakes=True).ready(), None, braked(SELECTED)
    ),
    Case("2", "autonomous").of(Fed, drives, then.asks("manual").driving()),
    Case("2", "a command younger than 100 ms").of(fed.silent(9), RUNNING, drive()),
    Case("2", "a command that pushes").of(Fed, drives, then.wants(throttle=0.0).cycle(drive())),
    Case("4", "the share of the command").of(moving, drive(97.5), drive(97.6)),
    Case("4", "the speed of the command").of(
        fed.wants(speed_limit_mps=1.0), drive(50.0, 0.0, 130), drive(50.0, 0.0, 140)
    ),
    Case("5", "SELECTED by who is autonomous").of(Fed, SELECTED, then.asks("manual").cycle(SELECTED)),
    Case("5", "SELECTED for a mission").of(fed.car(ami=Ami.NOT_SELECTED).cycle(IDLE).confirms(), IDLE, SELECTED),
    Case("5", "SELECTED after both resets").of(Fed, SELECTED, then.car(ami=Ami.SKIDPAD).cycle(SELECTED)),
    Case("5", "SELECTED with no emergency").of(
        fed.happens("on_emergency", True), ESTOP, replace(SELECTED, estop_request=True)
    ),
    Case("6", "a granted emergency is asked for").of(fed.cycle(SELECTED).happens("on_emergency", True), ESTOP, IDLE),
    Case("6", "a reset in AS_OFF").of(
        fed.cycle(SELECTED).happens("on_emergency", True),
        then.cycle(ESTOP).happens_now("on_reset", True),
        then.state(READY).cycle(braked(replace(SELECTED, estop_request=True))).happens_now("on_reset", True),
    ),
    Case("7", "an invalid command").of(Fed, then.plans(throttle=1.5, refused=True), then.plans(throttle=1.5)),
    Case("7", "a valid command").of(Fed, then.plans(), then.plans(refused=True)),
    Case("7", "data of the future").of(Fed, then.plans(age_ms=-20), then.plans(age_ms=-21)),
    Case("7", "a command of another run").of(Fed, then.plans(current=False, refused=True), then.plans(current=False)),
    Case("8", "200 ms of listening").of(Fed, SELECTED, then.happens("restarted").cycle(SELECTED)),
    Case("8", "who only listens").of(
        Sender, lambda _: Fed(listen_only=False).cycle(SELECTED), lambda _: Fed(listen_only=True).cycle(IDLE)
    ),
    Case("8", "a lost bus").of(
        moving.happens_now("on_bus_lost"), then.happens_now("on_bus_back").cycle(RUNNING), RUNNING
    ),
    Case("8", "five cycles at the end").of(ends.cycle(ASKING), then.cycle(BRAKING, 4), then.cycle(BRAKING, 5)),
    Case("modes", "manual is granted").of(Fed, then.asks("manual"), then.asks("manual", done=False)),
    Case("modes", "autonomous where the car may not launch, or is that already").of(
        Fed,
        then.asks("autonomous").driving().asks("autonomous"),
        then.driving().asks("manual").asks("autonomous"),
    ),
    Case("modes", "an unknown mode").of(Fed, then.asks("sideways", done=False), then.asks("sideways")),
    Case("modes", "autonomous as it was chosen").of(
        Fed, SELECTED, then.asks("manual").has(mode="autonomous").cycle(IDLE)
    ),
    Case("modes", "manual after a lost command").of(fed.silent(29), then.has(mode="manual").cycle(STOPPING), STOPPING),
    Case("reactions", "a stop for manual").of(stops, STOPPING, drive()),
    Case("reactions", "a stop for a lost bus").of(
        moving.happens_now("on_bus_lost").happens_now("on_bus_back"), RUNNING, drive()
    ),
    Case("reactions", "a stop for FAULT_STATUS").of(moving.car(fault=True), RUNNING, drive()),
    Case("reactions", "a stop for a planner that was restarted").of(
        moving,
        then.happens("on_confirmed", "other").cycle(drive()),
        then.happens("on_confirmed", "planner").cycle(drive()),
    ),
    Case("reactions", "a stop for a finished mission").of(fed.wants(mission_finished=True), RUNNING, drive()),
    Case("reactions", "ESTOP_REQUEST for a lost 0x520").of(fed.deaf(VcuStatus, 4).cycle(RUNNING, 5), BRAKING, RUNNING),
    Case("reactions", "ESTOP_REQUEST for an intruder").of(moving.happens("on_intruder", "a frame"), ASKING, RUNNING),
    Case("reactions", "ESTOP_REQUEST for a fault of the loop").of(moving.happens("on_loop_fault"), ASKING, RUNNING),
    Case("reactions", "ESTOP_REQUEST for both pedals").of(fed.wants(brake=0.4).cycle(RUNNING, 10), BRAKING, RUNNING),
    Case("reactions", "ESTOP_REQUEST of the mission").of(fed.wants(estop_request=True), ASKING, RUNNING),
    Case("reactions", "ESTOP_REQUEST at the end of a car that moves").of(
        ends, then.cycle(ASKING).cycle(BRAKING), RUNNING
    ),
    Case("reactions", "NEUTRAL or ESTOP_REQUEST at the end of a car at rest").of(ends_at_rest, FINISHED, RUNNING),
    Case("reactions", "ESTOP_REQUEST for a stop without effect").of(
        stops, then.cycle(STOPPING, 300), then.cycle(STOPPING, 311)
    ),
    Case("output table", "the first 3 s do not steer").of(
        fed.ready().state(DRIVING), braked(RUNNING), braked(replace(RUNNING, steer_deg=0.1))
    ),
    Case("output table", "steering towards the command").of(
        fed.wants(steering_rad=0.1), drive(50.0, 0.4), drive(50.0, -0.4)
    ),
    Case("output table", "steering is held without a command").of(
        fed.silent(12), RUNNING, replace(RUNNING, steer_deg=0.3)
    ),
    Case("output table", "a holding brake in AS_READY").of(fed.ready(3), None, SELECTED),
    Case("output table", "a holding brake in the first 3 s").of(
        fed.ready().state(DRIVING), then.cycle(braked(RUNNING), 2), then.cycle(RUNNING, 2)
    ),
    Case("output table", "no steering at the end of a car at rest").of(
        ends_at_rest, FINISHED, replace(FINISHED, steer_deg=0.1)
    ),
    Case("output table", "no brake at the end of a car at rest").of(ends_at_rest, FINISHED, braked(FINISHED)),
    Case("output table", "the service brake in a stop").of(stops, STOPPING, braked(RUNNING, 30.0)),
    Case("output table", "the brake is not let go without a command").of(
        fed.wants(brake=0.4, throttle=0.0).cycle(RUNNING).cycle(PLANNED).has(command=None).cycle(PLANNED, 11),
        None,
        RUNNING,
    ),
    Case("output table", "SELECTED where a mission is chosen").of(exact, SELECTED, IDLE),
    Case("output table", "FINISHED where a stop is over").of(
        exact.driving().asks("manual").cycle(RUNNING).cycle(STOPPING).has(rpm=0).cycle(STOPPING, 50),
        braked(FINISHED),
        STOPPING,
    ),
    Case("output table", "FORWARD in an emergency").of(
        exact.driving().happens("on_emergency", True), ASKING, replace(ASKING, direction=Direction.NEUTRAL)
    ),
    Case("output table", "RUNNING where none is").of(exact, drives, then.stood().cycle(FINISHED)),
    Case("output table", "motors brake in a stop").of(
        motors.launches().has(rpm=100).cycle(drive(), 3).asks("manual"), drive(rpm=0), RUNNING
    ),
    Case("output table", "the command steers").of(exact.wants(steering_rad=0.1), drive(50.0, 0.4), drive()),
    Case("output table", "the command brakes").of(
        exact.wants(brake=0.4, throttle=0.0).cycle(RUNNING), PLANNED, braked(RUNNING, 30.0)
    ),
    Case("reactions", "ESTOP_REQUEST for a reason").of(
        exact, then.wants(estop_request=True).cycle(ASKING), then.driving().cycle(ASKING)
    ),
    *(
        Case("reactions", f"ESTOP_REQUEST for {what} that is implausible").of(
            exact.driving().odd(what).cycle(drive(), 30).cycle(RUNNING).cycle(STOPPING, 29), BRAKING, STOPPING
        )
        for what in ODD
    ),
    Case("reactions", "a stop for Go that is off").of(moving.car(go_signal=False), RUNNING, drive()),
    Case("reactions", "a stop for less than 5 s in AS_READY").of(
        fed.ready(490).state(DRIVING).cycle(braked(RUNNING)), braked(RUNNING), drive()
    ),
    Case("reactions", "a stop for a mission that was not acknowledged").of(
        fed.cycle(IDLE).state(READY).cycle(braked(IDLE), 495).state(DRIVING).cycle(braked(RUNNING)),
        braked(RUNNING),
        drive(),
    ),
    Case("reactions", "a stop for a process that ends").of(
        ends_at_rest, FINISHED, replace(drive(), estop_request=True)
    ),
    Case("reactions", "a stop for 50 ms without a whole cycle").of(
        moving.cycle(drive(), 4, frames=4), drive(), then.cycle(drive(), frames=4).cycle(drive())
    ),
    Case("reactions", "a stop for speeds that the counts contradict").of(
        Fed, then.contradicted(15), then.contradicted(40)
    ),
    *(
        Case("reactions", f"ESTOP_REQUEST for {what} that is certainly odd").of(
            odd.cycle(STOPPING, 30), BRAKING, STOPPING
        )
        for what, odd in ODD.items()
    ),
    *(Case("output table", f"a stop for {what} that is odd").of(odd, STOPPING, PLANNED) for what, odd in ODD.items()),
    Case("modes", "autonomous for as long as nothing ends it").of(
        exact, SELECTED, then.has(mode="manual").cycle(SELECTED)
    ),
    *(
        Case("4", f"constant power above {rpm - 1} rpm").of(
            driving.cycle(drive()).has(rpm=300).cycle(drive(), 60).has(rpm=rpm).cycle(drive(), 2),
            drive(most_nm),
            drive(most_nm + 0.1),
        )
        for rpm, most_nm in ((301, 150.0), (401, 120.0), (501, 100.0), (600, 100.0))
    ),
    *(
        Case(rule, f"a process sends {what}").of(
            Fed, then.happens("well_formed", BRAKE_FRAME), then.happens("well_formed", Frame(can_id, data))
        )
        for rule, what, can_id, data in (
            ("7", "values within their range", 0x511, b"\xd0\x07\x00\x00"),
            ("7", "bits of signals only", 0x510, b"\x02" + bytes(7)),
            ("8", "its five identifiers", 0x520, bytes(8)),
            ("8", "frames of their length", 0x514, bytes(3)),
        )
    ),
    *(
        Case("5", f"NEUTRAL in {state.label}").of(at(state), SELECTED, replace(SELECTED, direction=Direction.FORWARD))
        for state in (AsState.AS_INIT, OFF, READY)
    ),
    *(
        Case("output table", f"status in {state.label}").of(at(state), right, wrong)
        for state, right, wrong in (
            (AsState.AS_FINISHED, FINISHED, replace(FINISHED, mission_status=MissionStatus.RUNNING)),
            (AsState.EMERGENCY_BRAKE, NEUTRAL, FINISHED),
            (DRIVING, RUNNING, replace(RUNNING, mission_status=MissionStatus.SELECTED)),
        )
    ),
    *(
        Case("output table", f"no brake in {state.label}").of(at(state), said, braked(said))
        for state, said in ((OFF, IDLE), (AsState.AS_INIT, IDLE), (AsState.EMERGENCY_BRAKE, NEUTRAL))
    ),
    *(
        Case("reactions", f"a run is over by {name}").of(
            Sender,
            then.car(**{name: value}).driving().cycle(drive()),  # what was there before the run says nothing
            then.driving().car(**{name: value}).cycle(drive()),
        )
        for name, value in (
            ("as_switch", False),
            ("ts_switch", False),
            ("shutdown_request", True),
            ("faults", Faults(ebs=True)),
            ("shutdown_cause", ShutdownCause.EBS_FAULT),
            ("ebs_state", EbsState.EBS_FAULT),
            ("ts_state", TsState.TS_FAULT),
            ("op_state", OpState.OP_FAULT),
            ("ami", Ami.SKIDPAD),
        )
    ),
    *(
        case
        for kind in (WheelSpeeds, VcuSteer)
        for case in (
            Case("reactions", f"a stop for a stale {kind.__name__}").of(
                fed.deaf(kind, 8), drive(), then.cycle(drive(), 2)
            ),
            Case("reactions", f"ESTOP_REQUEST for a lost {kind.__name__}").of(
                fed.deaf(kind, 9).cycle(RUNNING).cycle(STOPPING, 19), BRAKING, STOPPING
            ),
        )
    ),
]


@pytest.mark.parametrize(
    ("rule", "what", "start", "keeps", "breaks"), CASES, ids=lambda one: one if isinstance(one, str) else ""
)
def test_the_rule_is_kept_and_broken(rule: str, what: str, start: Make, keeps: End, breaks: End) -> None:
    assert ended_by(start, keeps).checker.violations == []
    assert rule in ended_by(start, breaks).rules


@pytest.mark.parametrize(("asked", "frame"), [(braked(RUNNING), 2), (drive(), 4)], ids=["brake", "torque"])
def test_what_a_dead_process_asked_for_stays_at_the_vcu(asked: AiCommand, frame: int) -> None:
    """The next process meets its brake with torque (0x512), and its torque with a brake (0x514)."""
    sender = driving.cycle(asked, 3).happens("restarted").frame(CODEC.encode_command(braked(drive()))[frame])()
    assert "torque 50.0 Nm and brake 30.0 % together" in [violation.words for _, violation in sender.checker.found]


@pytest.mark.parametrize(
    ("cycles", "data_ms", "broken"), [(30, 600, []), (31, 600, ["modes", "output table"]), (31, 499, [])]
)
def test_commands_on_old_data_are_lost_after_300_ms(cycles: int, data_ms: int, broken: list[str]) -> None:
    sender = Fed().driving().cycle(drive(), 3).has(data_ms=data_ms)
    assert sender.cycle(RUNNING, cycles).rules == broken


def test_what_a_message_shows_ends_the_run_in_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of `SHOWN` whose message is not 0x520, due after 200 ms and 500 ms."""
    row = Shown(VcuSteer, "far left", lambda steer: steer.angle_deg > 20.0, 200 * MS, 500 * MS)
    for module in (bus_view, reactions):
        monkeypatch.setattr(module, "SHOWN", (row,))
    not_yet = moving.has(angle_deg=25.0).cycle(drive(), 3).has(angle_deg=0.0).cycle(drive())
    shown = not_yet.has(angle_deg=25.0).cycle(drive(), 20)
    assert shown.cycle(RUNNING)().rules == []
    assert shown.cycle(drive())().rules == ["reactions"]
    stopped = shown.cycle(RUNNING).cycle(STOPPING, 29)
    assert stopped.cycle(BRAKING)().rules == []
    assert stopped.cycle(STOPPING)().rules == ["reactions"]


@pytest.mark.parametrize(("cycles", "broken"), [(28, []), (29, ["reactions"])])
def test_after_a_lost_bus_a_message_is_missing_from_then_on(cycles: int, broken: list[str]) -> None:
    """A message that the lost bus kept back for 400 ms is due 300 ms after its return, whatever else comes then."""
    sender = moving.happens_now("on_bus_lost")()
    sender.now_ns += 400 * MS
    sender.happens_now("on_bus_back").has(mute=(VcuSteer,)).cycle(RUNNING).cycle(STOPPING, cycles)
    assert sender.rules == broken


def test_a_log_with_an_as_state_that_flickers_shows_torque_in_it() -> None:
    """A frame that a sender may not have seen yet does not excuse those that it has seen before."""
    sender = logged()
    for _ in range(5):
        sender.unknown(15, RUNNING).cycle(drive())
    assert "2" in judged(sender)
    assert judged(logged().unknown(15, drive())) == []


def test_each_rule_has_a_case() -> None:
    assert {rule for rule, *_ in CASES} == set(RULES) - {"safe end"}


# ---------------------------------------------------------------- logs: what is in flight, and what was before


def judged(sender: Sender, since: int = 0) -> list[str]:
    """The rules that a reader of the log finds broken."""
    checker = WireChecker(CODEC)
    for frame in sender.frames[since:]:
        checker.on_frame(frame)
    return [violation.rule for _, violation in checker.found]


def logged() -> Any:
    return Sender().has(answer_ns=MS).driving().cycle(drive(), 20)


def test_a_whole_drive_in_a_log_breaks_no_rule() -> None:
    sender = logged().has(rpm=100).cycle(drive(), 50).cycle(RUNNING, 2).cycle(braked(RUNNING), 10)
    sender.has(rpm=0).cycle(braked(RUNNING), 60).cycle(braked(FINISHED), 5)
    sender.state(AsState.AS_FINISHED).cycle(braked(FINISHED), 20).state(OFF).has(heard=IDLE).cycle(IDLE, 20)
    assert judged(sender) == []
    assert judged(sender, since=5000) == [], "what was before the log is not judged"


@pytest.mark.parametrize(("cycles", "broken"), [(2, []), (3, ["rule 2"])])
def test_what_the_sender_cannot_have_seen_is_no_violation(cycles: int, broken: list[str]) -> None:
    assert [f"rule {rule}" for rule in judged(logged().car(go_signal=False).cycle(drive(), cycles))] == broken


@pytest.mark.parametrize(("age_ns", "broken"), [(2 * MS - 1, []), (2 * MS, ["9"])])
def test_a_bit_of_the_last_2_ms_may_be_unseen(age_ns: int, broken: list[str]) -> None:
    assert judged(Sender().has(answer_ns=age_ns, echo=False).cycle(IDLE)) == broken


def test_a_restart_in_a_log_is_seen_by_its_pause() -> None:
    sender = logged().cycle(ASKING).cycle(ASKING, 30, frames=0)
    assert judged(sender.cycle(RUNNING, 5)) == [], "a new process knows nothing of the old one's emergency"
    assert "10" in judged(sender.cycle(drive()))


def test_a_log_does_not_know_how_long_a_car_had_stood() -> None:
    assert judged(Sender().has(rpm=0).state(AsState.EMERGENCY_BRAKE).cycle(NEUTRAL, 10)) == []
    assert judged(Sender().has(rpm=100).state(AsState.EMERGENCY_BRAKE).cycle(NEUTRAL, 10)) == ["output table"]
    began = Sender().has(dense=100, answer_ns=MS, mute=(WheelSpeeds,)).state(AsState.EMERGENCY_BRAKE).cycle(NEUTRAL)
    assert judged(began.has(mute=()).cycle(NEUTRAL, 100)) == [], "the first speeds came a cycle after the first frame"


def test_a_lasting_violation_is_told_once_each_time() -> None:
    sender = Sender().driving()
    for _ in range(2):
        sender.car(go_signal=False).cycle(drive(), 20).car(go_signal=True).cycle(drive(), 20)
    assert sender.rules == ["2", "2"]


def test_response_times_run_from_each_toggle_to_its_echo() -> None:
    sender = Sender(in_flight_ns=20 * MS, handshake_in_flight_ns=4 * MS).has(answer_ns=MS, dense=100).cycle(IDLE, 100)
    sender.has(answer_ns=3 * MS).cycle(IDLE, 2)
    sender.now_ns += 2_000 * MS  # silence of the AI computer is no response time
    times = sender.cycle(IDLE, 50).checker.responses
    assert len(times) == 150
    assert times.quantile_ms(0.5) in (pytest.approx(1.0), pytest.approx(3.0))
    assert times.quantile_ms(1.0) == pytest.approx(3.0)
    assert "response time: 150 echoes" in str(sender.checker)


def test_a_saved_state_goes_on_as_one_that_was_never_saved() -> None:
    saved, living = exact().driving(), exact().driving()
    state = saved.checker.saved(saved.now_ns, data_may_be_lost=False)
    saved.checker = WireChecker(CODEC, **EXACT, process=Process(nothing_hidden=True))
    saved.checker.load(state, saved.now_ns)
    for sender in (saved, living):
        sender.has(command=None).cycle(drive(), 9).cycle(RUNNING, 2).cycle(drive())
    assert saved.rules == living.rules != []


def test_error_frames_are_counted_and_break_no_rule() -> None:
    report = Sender().frame(Frame(0x040, bytes(8), error=True)).checker
    assert report.ok and report.error_frames == 1
    assert str(report).endswith("no rule broken")


def test_an_identifier_that_repeats_is_named_once_and_counted() -> None:
    report = Sender().frame(Frame(0x7FF, b"")).frame(Frame(0x7FF, b"")).checker
    assert (len(report.violations), report.violation_count) == (1, 2)
    assert str(report).endswith("… and 1 more")


def test_a_candump_log_is_checked_like_the_bus(tmp_path: Path) -> None:
    sender = logged().car(go_signal=False).cycle(drive(), 20)
    log = tmp_path / "run.log.gz"
    with gzip.open(log, "wt") as out:
        out.writelines(f"({frame.t_ns / 1e9:.6f}) vcan0 {frame}\n" for frame in sender.frames)
    report = check_candump(log, CODEC)
    assert (report.frames, report.cycles, report.incomplete) == (len(sender.frames), sender.cycles, 0)
    assert [state for _, state in report.as_states] == [OFF, READY, DRIVING]
    assert not report.ok and "s: rule 2: rear torque without the Go signal" in str(report)


def test_a_log_with_a_line_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "bad.log"
    log.write_text("(1.0) vcan0 511#9E07A00F\nrubbish\n")
    with pytest.raises(LogError, match="line 2"):
        check_candump(log, CODEC)


def test_a_payload_that_repeats_hides_nothing() -> None:
    """The message is one that no rule heeds."""
    checker, sound = WireChecker(CODEC), CODEC.encode(RotationB(1.0, 1 * MS))
    short = replace(sound, data=sound.data[:-1])
    sent = [sound, sound, short, sound, replace(sound, extended=True), sound]
    checker.on_frames([replace(frame, t_ns=(1 + place) * MS) for place, frame in enumerate(sent)])
    assert (checker.frames, checker.now_ns) == (6, 6 * MS)
    assert "1 x" in str(checker) and "3 bytes" in str(checker)
    assert [f"extended identifier 0x{sound.can_id:03X}" in violation for violation in checker.violations] == [True]
