"""Plays the events of a case to the real Bridge and Engine in virtual time, with the checker on the wire between them.

The loop round them is the one of `runtime.loop.BridgeLoop` without its thread: a frame is answered, a broken bus is
given up and reopened, a turn that is 50 ms late is reported, a killed process begins anew. The car is a few lines: it
says what the events have set, its wheels and its steering follow what is asked for where nothing else was set.
"""

from __future__ import annotations

import copy
import math
import random
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Final

from fsai_hil.evidence.fuzz_events import SETUPS, STATIONS, FuzzCase, FuzzEvent, Setup
from fsai_hil.rules.checker import WireChecker
from fsai_hil.rules.numbers import DEADLINE_MISS_NS, MS, STOP_TIMEOUT_NS
from fsai_hil.rules.seen import Process
from fsai_hil.rules.violation import Violation
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface import messages
from fsai_vcu.interface.codec import Codec, EncodeError, command_of
from fsai_vcu.interface.enums import Ami, AsState, BrakeStatus, CarEnum, EbsStatus, ShutdownCause
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiCommand,
    AiDriveFront,
    AiDriveRear,
    AiImage,
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
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime.bus import BusLost
from fsai_vcu.runtime.engine import Engine

PERIOD_NS: Final = 10 * MS
REOPEN_FIRST_NS: Final = 10 * MS  # the loop's first pause before it tries a lost bus again
RESTART_NS: Final = 500 * MS  # a process needs at least so long to start
START_NS: Final = 1_000 * MS
MAX_CYCLES: Final = 1_500  # of one case: longer ones say no more


@cache
def codec_of(name: str) -> Codec:
    return Codec(revision(name))


class Broken(Exception):
    """The process raised an exception: it never may."""


class Played:
    """One process under test, the car it talks to and the checker between them, at one instant of virtual time."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.codec = codec_of(setup.revision)
        self.car = CARS[setup.car]
        self.now_ns = START_NS
        self.cycles = 0
        self.began_ns = START_NS
        self.reached: set[tuple[str, ...]] = set()  # by whoever watches
        self.seen: object = None
        self.watch: Callable[[Played], None] | None = None
        self.say: Callable[[str], None] | None = None  # what is told of, in words
        config = setup.config
        self.checker = WireChecker(
            self.codec,
            in_flight_ns=0,
            handshake_in_flight_ns=0,
            clock_slack_ns=0,
            car=self.car,
            limits=setup.limits,
            from_start=True,
            motor_brakes=config.motor_brakes,
            short_sequence=config.short_sequence_allowed,
            process=Process(
                listen_only=config.listen_only,
                autonomous_at_power_up=config.autonomous_at_power_up,
                service_brake_pct=config.stop_brake_pct,
                # A car that brakes by its motors alone is given longer; the table's 3 s are everybody else's.
                stop_timeout_ns=config.stop_timeout_ns if config.motor_brakes else STOP_TIMEOUT_NS,
            ),
        )
        self.problems: list[Violation] = []
        self.frames = 0
        self._first_run_id = 1
        self._new_process()
        self._next_car_ns = self.now_ns
        self._chance = random.Random(0)
        # the car
        self.status = VcuStatus(as_switch=True, ts_switch=True, as_state=AsState.AS_OFF, ami=Ami.TRACKDRIVE)
        self.rpm: tuple[int, int, int, int] | None = None
        self.speed_rpm = 0.0
        self.raw_rpm: tuple[int, int, int, int] | None = None  # on the wire, whatever the wheels do
        self.turns = [0.0] * 4  # of the wheels, as their pulses count them
        self.counting: str = "pulses"
        self.extra_pulses = 0.0
        self.angle_deg: float | None = None
        self.followed_deg = 0.0
        self.angle_max_deg = self.codec.revision.steer_limit_deg
        self.torque_max_nm = (195.0, 195.0)
        self.echo_pct: float | None = None
        self.handshake = "alternate"
        self.muted: dict[int, int] = {}
        self.flips: dict[int, int] = {}
        self.period_ns = PERIOD_NS
        self.first, self.answered = True, False
        self._late_ns = 0
        # what the VCU saw last
        self.torque_nm = [0.0, 0.0]
        self.brake_pct = (0.0, 0.0)
        self.motor_brakes = False  # the rear motor's speed limit is 0, so its torque brakes
        self.request_deg = 0.0
        # planner and controller
        self.command: dict[str, Any] = {}
        self.silent = False
        self.confirming = True
        self._confirmed_run: int | None = None
        # the way out
        self._dropping = (0, 0)
        self._breaking: tuple[int, int] | None = None
        self._taken = 0
        self._told: AiCommand | None = None
        self._last_said: dict[type, AiImage] = {}

    def _new_process(self) -> None:
        self.bridge = Bridge(
            self.codec,
            self.codec.revision,
            self.car,
            self.setup.config,
            self.setup.limits,
            self._first_run_id,
            self.now_ns,
        )
        self.engine = Engine(self.bridge, self.codec, self._send, self.now_ns)
        self._back_ns: int | None = None  # the bus is lost until then
        self._made = False

    @property
    def played_ns(self) -> int:
        """Virtual time since the station."""
        return self.now_ns - self.began_ns

    # ------------------------------------------------------------ events

    def play(self, events: Iterable[FuzzEvent]) -> list[Violation]:
        """Let `events` happen until a rule is broken. What was found; an exception of the process is a problem too."""
        for one in events:
            if self.say is not None:
                self.say(f"{self.now_ns / 1e6:12.3f} ms  {one}")
            try:
                getattr(self, f"_do_{one.name}")(**one.values)
            except Broken as error:
                cause = error.__cause__
                self.problems.append(Violation("never an exception", f"{type(cause).__name__}: {cause}"))
            self.problems += self.checker.taken()
            if self.problems or self.cycles >= MAX_CYCLES:
                break
        return self.problems

    def _do_run(self, cycles: int) -> None:
        for _ in range(cycles):
            if self.checker.found:
                return
            self._pass(max(0, self._next_car_ns - self.now_ns))
            self._next_car_ns = self.now_ns + self.period_ns
            self._speak()
            self._control()
            self._turn()

    def _do_aim(self, ms: float, ns: int) -> None:
        since_ns = self.bridge.state.supervisor.driving_since_ns
        if since_ns is None:
            return
        cycles, rest_ns = divmod(since_ns + round(ms * MS) + ns - self.now_ns, self.period_ns)
        if cycles > 0:
            self._next_car_ns = self.now_ns + self.period_ns + rest_ns  # the rest goes first: the others are in step
            self._do_run(cycles)

    def _do_quiet(self, ms: float) -> None:
        self._pass(round(ms * MS))

    def _do_hang(self, ms: float) -> None:
        self.now_ns += round(ms * MS)
        self._turn()

    def _do_late(self, ns: int) -> None:
        self._late_ns = ns

    def _do_pace(self, ns: int, first: bool, answered: bool) -> None:
        self.period_ns, self.first, self.answered = max(MS // 10, ns), first, answered

    def _do_car(self, **says: Any) -> None:
        if "as_state" in says:
            self.status = replace(self.status, as_state=AsState(says["as_state"]))
        if "ami" in says:
            self.status = replace(self.status, ami=Ami(says["ami"]))
        if "go" in says:
            self.status = replace(self.status, go_signal=says["go"])
        if "fault" in says:
            self.status = replace(self.status, fault=says["fault"])
        if "shutdown" in says:
            self.status = replace(self.status, shutdown_request=says["shutdown"])
        if "switches" in says:
            asms, tsms = says["switches"]
            self.status = replace(self.status, as_switch=asms, ts_switch=tsms)
        if "bits" in says:
            self.status = replace(self.status, faults=Faults(**dict.fromkeys(says["bits"], True)))
        if "cause" in says:
            self.status = replace(self.status, shutdown_cause=ShutdownCause(says["cause"]))

    def _do_wheels(self, rpm: list[int] | None) -> None:
        self.rpm = None if rpm is None else (rpm[0], rpm[1], rpm[2], rpm[3])

    def _do_speeds(self, rpm: list[int] | None) -> None:
        self.raw_rpm = None if rpm is None else (rpm[0], rpm[1], rpm[2], rpm[3])

    def _do_counts(self, how: str, pulses: float = 0.0) -> None:
        self.counting, self.extra_pulses = how, pulses

    def _do_steering(self, deg: float | None) -> None:
        self.angle_deg = None if deg is None else self._measurable(deg)

    def _do_limits(self, angle_deg: float, front_nm: float, rear_nm: float) -> None:
        self.angle_max_deg, self.torque_max_nm = self._measurable(angle_deg), (front_nm, rear_nm)

    def _measurable(self, deg: float) -> float:
        """The nearest angle that this revision's messages can carry."""
        most = self.codec.revision.steer_limit_deg
        return max(-most, min(most, deg))

    def _do_echo(self, pct: float | None) -> None:
        self.echo_pct = pct

    def _do_handshake(self, how: str) -> None:
        self.handshake = how

    def _do_mute(self, ids: list[int], cycles: int) -> None:
        self.muted.update(dict.fromkeys(ids, cycles))

    def _do_frame(self, id: int, data: str, kind: str = "standard") -> None:
        self._deliver(
            Frame(
                id,
                bytes.fromhex(data),
                self.now_ns,
                extended=kind == "extended",
                remote=kind == "remote",
                error=kind == "error",
            )
        )
        self._turn()

    def _do_flip(self, id: int, bit: int) -> None:
        self.flips[id] = bit

    def _do_says(self, image: str, field: str, value: Any) -> None:
        try:
            changed = replace(self._image(image), **{field: value})
            frame = self.codec.encode(changed)
        except EncodeError:
            return  # the wire cannot carry that
        self._deliver(replace(frame, t_ns=self.now_ns))
        self._turn()

    def _image(self, name: str) -> Image:
        own: dict[str, Image] = {type(one).__name__: one for one in self._images()}
        found: Image = own[name] if name in own else getattr(messages, name)()
        return found

    def _do_command(self, **fields: Any) -> None:
        self.command.update(fields)

    def _do_silence(self, on: bool) -> None:
        self.silent = on

    def _do_once(self, **fields: Any) -> None:
        self._hand_in({**self.command, **fields})

    def _do_confirm(self, role: str, offset: int = 0) -> None:
        if self._running:
            run_id = self._ask(lambda: self.bridge.run.run_id) + offset
            self._ask(lambda: self.bridge.on_reset_confirmed(role, run_id))
            if offset == 0:
                self.checker.on_confirmed(role)

    def _do_confirming(self, on: bool) -> None:
        self.confirming = on

    def _do_service(self, name: str, text: str = "") -> None:
        now_ns = self.now_ns
        if name == "mode":
            answer = self._ask(lambda: self.bridge.set_mode(text, now_ns))
            self.checker.on_mode(text, answer, now_ns)
        elif name == "emergency":
            answer = self._ask(lambda: self.bridge.emergency_brake(text, now_ns))
            self.checker.on_emergency(answer[0])
        else:
            answer = self._ask(lambda: self.bridge.reset(now_ns))
            self.checker.on_reset(answer[0], now_ns)
        if self.say is not None:
            self.say(f"{'':17}answered: {'yes' if answer[0] else 'no'}, {answer[1]}")

    def _do_drops(self, cycles: int, takes: int) -> None:
        self._dropping = (cycles, takes)

    def _do_breaks(self, takes: int, ms: float) -> None:
        self._breaking = (takes, max(REOPEN_FIRST_NS, round(ms * MS)))

    def _do_lost(self, ms: float) -> None:
        self._lose("Network is down", max(REOPEN_FIRST_NS, round(ms * MS)))

    def _do_restart(self) -> None:
        self.now_ns += RESTART_NS
        self._first_run_id = self._ask(lambda: self.bridge.run.run_id) + 1000
        self._confirmed_run = None
        self.checker.restarted()
        self._new_process()
        self._turn()

    def _do_end(self) -> None:
        if self._back_ns is None:
            self._ask(lambda: self.bridge.begin_stop(self.now_ns))
            self.checker.on_end()

    # ------------------------------------------------------------ the car

    def _images(self) -> tuple[Image, ...]:
        rpm = self.rpm or (round(self.speed_rpm),) * 4
        angle = self.followed_deg if self.angle_deg is None else self.angle_deg
        echo = self.brake_pct if self.echo_pct is None else (self.echo_pct, self.echo_pct)
        return (
            self.status,
            VcuDriveFront(0.0, self.torque_nm[0], self.torque_max_nm[0]),
            VcuDriveRear(0.0, self.torque_nm[1], self.torque_max_nm[1]),
            VcuSteer(angle, self.angle_max_deg, self.request_deg),
            VcuBrake(echo[0], echo[0], echo[1], echo[1], BrakeStatus.READY, EbsStatus.ARMED),
            WheelSpeeds(rpm[0], rpm[1], rpm[2], rpm[3]),
            WheelCounts(*(int(turns * self.car.wheel_pulses_per_rev) % 0x10000 for turns in self.turns)),
        )

    def _speak(self) -> None:
        """All that the car says in one of its cycles, and what its wheels and steering do meanwhile."""
        if self.handshake == "alternate" or (self.handshake == "wild" and self._chance.random() < 0.5):
            self.status = replace(self.status, handshake=not self.status.handshake)
        driving = self.status.as_state is AsState.AS_DRIVING
        share = self.period_ns / PERIOD_NS
        if driving and max(self.torque_nm) > 0.0 and not self.motor_brakes:
            self.speed_rpm = min(800.0, self.speed_rpm + 1.5 * share)
        elif self.status.as_state is AsState.EMERGENCY_BRAKE:
            self.speed_rpm = max(0.0, self.speed_rpm - 3.0 * share)
        elif self.brake_pct[0] > 0.0 or (driving and self.motor_brakes):
            self.speed_rpm = max(0.0, self.speed_rpm - 2.0 * share)
        self._count(self.rpm or (round(self.speed_rpm),) * 4)
        step = math.degrees(self.car.steer_rate_radps) * self.period_ns / 1e9
        target = self.request_deg if driving else 0.0
        self.followed_deg += max(-step, min(step, target - self.followed_deg))
        said = [one for one in self._images() if not self._mute(one)]
        if not self.first:
            said = [*said[1:], *said[:1]]
        for one in said:
            frame = self.codec.encode(one)
            data = frame.data
            if self.raw_rpm is not None and frame.can_id == 0x525:
                data = struct.pack("<4H", *self.raw_rpm)
            bit = self.flips.pop(frame.can_id, None) if self.flips else None
            if bit is not None:
                flipped = int.from_bytes(data, "little") ^ 1 << bit % (8 * len(data))
                data = flipped.to_bytes(len(data), "little")
            self._deliver(Frame(frame.can_id, data, self.now_ns))
            if self.answered and frame.can_id == 0x520:
                self._turn()

    def _count(self, rpm: Sequence[int]) -> None:
        """The wheels turn, and their pulses count: as they turn, not at all, or some on top."""
        if self.counting == "pulses":
            for wheel in range(4):
                self.turns[wheel] += rpm[wheel] / 60.0 * self.period_ns / 1e9
        elif self.counting == "more":
            for wheel in range(4):
                self.turns[wheel] += self.extra_pulses / self.car.wheel_pulses_per_rev

    def _mute(self, one: Image) -> bool:
        if not self.muted:
            return False
        can_id = _ID_OF[type(one)]
        left = self.muted.get(can_id, 0)
        if left > 0:
            self.muted[can_id] = left - 1
        return left > 0

    def _deliver(self, frame: Frame) -> None:
        if self._back_ns is None and self._running:
            self._ask(lambda: self.engine.on_frame(frame))
            self.checker.received(frame)

    # ------------------------------------------------------------ planner and controller

    def _control(self) -> None:
        run_id = self._ask(lambda: self.bridge.run.run_id)
        if self.confirming and run_id != self._confirmed_run and self._running:
            self._confirmed_run = run_id
            for role in ("planner", "controller"):
                self._do_confirm(role)
        if not self.silent:
            self._hand_in(self.command)

    def _hand_in(self, fields: dict[str, Any]) -> None:
        if self._back_ns is not None or not self._running:
            return
        said = dict(fields)
        now_ns = self.now_ns
        age_ns = round(said.pop("age_ms", 0.0) * MS)
        offset = said.pop("run_offset", 0)
        run_id = self._ask(lambda: self.bridge.run.run_id) + offset
        command = VehicleCommand(now_ns - age_ns, run_id, **said)
        refused = bool(self._ask(lambda: self.bridge.on_command(command, now_ns)))
        self.checker.on_command(command, refused, now_ns, current=offset == 0)

    # ------------------------------------------------------------ the loop

    @property
    def _running(self) -> bool:
        return not self.bridge.stopped

    def _ask(self, call: Callable[[], Any]) -> Any:
        """Call into the process under test; whatever it raises but the loss of its bus breaks a rule."""
        try:
            return call()
        except BusLost:
            raise
        except Exception as error:
            raise Broken from error

    def _pass(self, ns: int) -> None:
        """Let time pass; the loop turns whenever something is due."""
        until_ns = self.now_ns + ns
        while True:
            due_ns = self._back_ns if self._back_ns is not None else self.engine.due_ns() + self._late_ns
            if due_ns > until_ns or not self._running:
                break
            self.now_ns = max(self.now_ns, due_ns)
            self._turn()
        self.now_ns = max(self.now_ns, until_ns)

    def _turn(self) -> None:
        """What the loop does between two frames."""
        now_ns = self.now_ns
        if self._back_ns is not None:
            if now_ns < self._back_ns:
                return
            self._back_ns = None
            self.engine = Engine(self.bridge, self.codec, self._send, now_ns)
            self._ask(lambda: self.bridge.bus_back(now_ns))
            self.checker.on_bus_back(now_ns)
            if self.say is not None:
                self.say(f"{now_ns / 1e6:12.3f} ms  the bus is back")
        due_ns = self.engine.due_ns()
        if now_ns < due_ns + self._late_ns or not self._running:
            return
        if now_ns - due_ns >= DEADLINE_MISS_NS:
            why = f"the CAN loop was {(now_ns - due_ns) / 1e6:.0f} ms late"
            self._ask(lambda: self.bridge.loop_fault(why, now_ns))
            self.checker.on_loop_fault()
        self.checker.before_cycle(now_ns)
        self._taken, self._made = 0, False
        try:
            self._ask(lambda: self.engine.poll(now_ns))
        except BusLost as lost:
            self.checker.cycle_over(now_ns)
            assert self._breaking is not None
            back_ns = self._breaking[1]
            self._breaking = None
            self._lose(str(lost), back_ns)
            return
        self.checker.cycle_over(now_ns, self._made)
        self.checker.on_mode_shown(self.bridge.state.supervisor.mode.value)
        if self.say is not None:
            self._tell()
        self.cycles += 1
        if self._made and self._dropping[0] > 0:
            self._dropping = (self._dropping[0] - 1, self._dropping[1])
        if self.watch is not None:
            self.watch(self)

    def _send(self, frame: Frame) -> bool:
        self._made = True
        if self._breaking is not None and self._taken >= self._breaking[0]:
            raise BusLost("Network is down")
        if self._dropping[0] > 0 and self._taken >= self._dropping[1]:
            return False
        self._taken += 1
        frame = Frame(frame.can_id, frame.data, self.now_ns)
        self.frames += 1
        image = self.checker.sent(frame)
        if isinstance(image, AiDriveFront | AiDriveRear):
            axle = 0 if isinstance(image, AiDriveFront) else 1
            self.torque_nm[axle] = image.torque_nm
            self.motor_brakes = image.torque_nm > 0.0 and image.motor_speed_max_rpm == 0
        elif isinstance(image, AiSteer):
            self.request_deg = image.steer_deg
        elif isinstance(image, AiBrake):
            self.brake_pct = (image.front_pct, image.rear_pct)
        if self.say is not None and image is not None:
            self._last_said[type(image)] = replace(image, t_rx_ns=0)
        return True

    def _tell(self) -> None:
        """What the VCU sees otherwise than before, in words; the handshake and the logging fields aside."""
        assert self.say is not None
        now, before = command_of(self._last_said), self._told or AiCommand()
        changes = [
            f"{name} {value.label if isinstance(value, CarEnum) else value}"
            for name in _TOLD
            if (value := getattr(now, name)) != getattr(before, name)
        ]
        if changes:
            self.say(f"{self.now_ns / 1e6:12.3f} ms      sent: {', '.join(changes)}")
        self._told = now

    def _lose(self, why: str, for_ns: int) -> None:
        if self._back_ns is not None or not self._running:
            return
        self._back_ns = self.now_ns + for_ns
        self._ask(lambda: self.bridge.bus_lost(why, self.now_ns))
        self.checker.on_bus_lost(self.now_ns)


_TOLD: Final = (
    "estop_request",
    "mission_status",
    "direction",
    "steer_deg",
    "front_torque_nm",
    "rear_torque_nm",
    "rear_motor_speed_max_rpm",
    "front_brake_pct",
    "rear_brake_pct",
)

_ID_OF: Final[dict[type, int]] = {
    VcuStatus: 0x520,
    VcuDriveFront: 0x521,
    VcuDriveRear: 0x522,
    VcuSteer: 0x523,
    VcuBrake: 0x524,
    WheelSpeeds: 0x525,
    WheelCounts: 0x526,
}


class NotOrdinary(Exception):
    """A rule is broken already on the ordinary way to a station."""

    def __init__(self, setup: str, station: str, problem: Violation) -> None:
        super().__init__(f"{setup}, on the ordinary way to {station}: rule {problem.rule}: {problem.words}")
        self.problem = problem


_stations: dict[tuple[str, str], Played] = {}


def at_station(setup: str, station: str) -> Played:
    """A process that has come as far as `station` by itself. Kept and copied, for the way there is always the same."""
    key = (setup, station)
    if key not in _stations:
        before, events = STATIONS[station]
        played = Played(SETUPS[setup]) if before is None else at_station(setup, before)
        problems = played.play(events)
        if problems:
            raise NotOrdinary(setup, station, problems[0])
        played.cycles, played.began_ns, played.frames = 0, played.now_ns, 0
        _stations[key] = played
    kept = _stations[key]
    shared = (kept.codec, kept.car, kept.setup)
    return copy.deepcopy(kept, {id(one): one for one in shared})


def forget_stations() -> None:
    """The rules have been changed on purpose: the ways to the stations must be gone anew."""
    _stations.clear()


def play(case: FuzzCase, watch: Callable[[Played], None] | None = None) -> tuple[Played, list[Violation]]:
    """Play a case; the process as it is at the end, and what was found."""
    played = at_station(case.setup, case.station)
    played.watch = watch
    return played, played.play(case.events)
