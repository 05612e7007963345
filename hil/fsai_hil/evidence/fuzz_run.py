"""The real Bridge and loop beside a car of a few lines in virtual time, with the checker of the rules between them.

The loop is `runtime.turns.Turns`, as in the real-time process; its bus is what is done to it here. What the car reports
is what was set; its wheels and its steering follow what is asked for where nothing else was set.
"""

from __future__ import annotations

import copy
import math
import random
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from operator import methodcaller as call
from types import MappingProxyType
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.model import Setting, WatchedBridge
from fsai_hil.rules.numbers import CYCLE_NS, MS, STOP_TIMEOUT_NS
from fsai_vcu.core.bridge import BridgeConfig, official_simulator
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState, BrakeStatus, EbsStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiDriveFront,
    AiDriveRear,
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
from fsai_vcu.runtime.link import Ask, Message, Request, ResetConfirmed
from fsai_vcu.runtime.turns import Action, Do, Send, Turns

RESTART_NS: Final = 500 * MS  # a process needs at least so long to start
START_NS: Final = 1_000 * MS
MAX_CYCLES: Final = 1_500  # of the car, after a station: longer runs show nothing more
READY_CYCLES: Final = 495  # of AS_READY with Go off, before a drive counts as valid
SPOKEN: Final = (VcuStatus, VcuDriveFront, VcuDriveRear, VcuSteer, VcuBrake, WheelSpeeds, WheelCounts)
"""What the car sends in each of its cycles: 0x520 to 0x526."""

Rpm = tuple[int, int, int, int]


def _setup(config: BridgeConfig | None = None, car: str = "2026", **changes: Any) -> Setting:
    return Setting(**{"config": config or BridgeConfig(), "car": CARS[car], "limits": UNLIMITED, **changes})


SETUPS: Mapping[str, Setting] = MappingProxyType(
    {
        "2026": _setup(),
        "2021": _setup(car="2021", revision="2021"),
        "venue": _setup(limits=OperationalLimits(5.0, 60.0, 15.0)),
        "staging": _setup(BridgeConfig(autonomous_at_power_up=True)),
        "official simulator": _setup(official_simulator(), "official-simulator"),
        "listening": _setup(BridgeConfig(listen_only=True)),
    }
)
"""Cars, venues and configurations under test."""


class RuleBroken(Exception):
    """A rule is broken on the wire."""


@cache
def _broken(rule: str) -> type[RuleBroken]:
    """A type for each rule: hypothesis takes failures of one type for the same, and shrinks them together."""
    return type(f"RuleBroken_{rule}", (RuleBroken,), {})


class Run:
    """One process under test, the car it talks to and the checker between them, at one instant of virtual time.

    Whatever the process raises comes through: it never may.
    """

    def __init__(self, setup: Setting) -> None:
        self._setup, self.codec, self._car = setup, setup.codec, setup.car
        self.now_ns = START_NS
        self.cycles = 0
        self.reached: set[tuple[str, str]] = set()
        # A car that brakes by its motors alone is given longer; the table's 3 s are everybody else's.
        config = setup.config
        self._checker = setup.checker(
            stop_timeout_ns=config.stop_timeout_ns if config.motor_brakes else STOP_TIMEOUT_NS
        )
        self._first_run_id = 1
        self._new_process()
        # the car, as it is until something changes it; None: what follows from torque, brake and requests
        self.status = VcuStatus(as_switch=True, ts_switch=True, as_state=AsState.AS_OFF, ami=Ami.TRACKDRIVE)
        self.rpm: Rpm | None = None
        self.pulses: float | None = None  # by which each wheel's counter grows in a cycle
        self.angle_deg: float | None = None
        self.echo_pct: float | None = None  # the brake requests in 0x524
        self.angle_max_deg = 30.0
        self.front_max_nm = self.rear_max_nm = 195.0
        self.handshake = "alternate"  # or stuck, or wild
        self.period_ns = CYCLE_NS
        self.status_last = False  # of the messages of a cycle
        self.answered_first = False  # the loop turns between 0x520 and the others
        self.late_ns = 0  # by which the loop turns late
        self.silent = False  # the controller sends nothing
        self.confirming = True  # planner and controller confirm their resets by themselves
        self._fields: dict[str, Any] = {}  # of the controller's command
        self._confirmed_run: int | None = None
        self._next_car_ns = self.now_ns
        self._chance = random.Random(0)
        self._speed_rpm = self._followed_deg = 0.0
        self._turns = [0.0] * 4  # of the wheels, as their pulses count them
        self._muted: dict[type, int] = {}  # until which cycle
        self._raw: dict[type, tuple[tuple[str, ...], int, int]] = {}  # fields, their bits, and until which cycle
        # what the VCU saw last
        self.torque_nm = [0.0, 0.0]
        self.brake_pct = (0.0, 0.0)
        self._motor_brakes = False  # the rear motor's speed limit is 0, so its torque brakes
        self._request_deg = 0.0
        self._dropping = (0, 0)
        self._breaks_at, self._broken_ms = math.inf, 0.0
        self._taken = 0

    def _new_process(self) -> None:
        codec, setup = self.codec, self._setup
        args = (self._car, setup.config, setup.limits, self._first_run_id, self.now_ns)
        self._bridge = WatchedBridge(codec, codec.revision, *args)
        self._bridge.checker = self._checker
        self._loop = Turns(self._bridge, codec, self.now_ns)
        self._no_bus_until_ns = self.now_ns

    def judge(self) -> None:
        """Raise RuleBroken if a rule has been broken by now."""
        for one in self._checker.taken():
            raise _broken(one.rule)(f"rule {one.rule}, at {self.now_ns / 1e6:.6f} ms: {one.words}")

    # ------------------------------------------------------------ time

    def run(self, cycles: int) -> None:
        """Ordinary traffic: the car sends its messages, the controller its command, the loop answers."""
        for _ in range(min(cycles, MAX_CYCLES - self.cycles)):
            if self._checker.found:
                return
            self._pass(max(0, self._next_car_ns - self.now_ns))
            self._next_car_ns = self.now_ns + self.period_ns
            self._car_sends()
            self._control()
            self._turn()
            self.cycles += 1

    def aim(self, ms: float, ns: int) -> None:
        """Ordinary traffic until `ms` and `ns` after AS_DRIVING began: the car's last messages come at that instant."""
        since_ns = self._bridge.state.supervisor.driving_since_ns
        if since_ns is not None:
            cycles, rest_ns = divmod(since_ns + round(ms * MS) + ns - self.now_ns, self.period_ns)
            if cycles > 0:
                self._next_car_ns = self.now_ns + self.period_ns + rest_ns  # the rest goes first: the others keep step
                self.run(cycles)

    def quiet(self, ms: float) -> None:
        """Neither car nor controller sends anything."""
        self._pass(round(ms * MS))

    def hang(self, ms: float) -> None:
        """The loop does not turn."""
        self.now_ns += round(ms * MS)
        self._turn()

    # ------------------------------------------------------------ what the car reports

    def car(self, **status: Any) -> None:
        """Fields of 0x520 from now on."""
        self.status = replace(self.status, **status)

    def mute(self, messages: tuple[type[Image], ...], cycles: int) -> None:
        """These messages are missing for a while."""
        self._muted.update(dict.fromkeys(messages, self.cycles + cycles))

    def raw(self, message: type[Image], names: tuple[str, ...], bits: int, cycles: int) -> None:
        """For a while these fields of a message carry `bits`, whatever the car does; cut to the field's width."""
        self._raw[message] = (names, bits, self.cycles + cycles)

    def frame(self, frame: Frame, ahead_ns: int = 0) -> None:
        """One frame of anybody's, now; its stamp is ahead by so much."""
        self._deliver(replace(frame, t_ns=self.now_ns + ahead_ns))
        self._turn()

    # ------------------------------------------------------------ planner, controller, operator

    def command(self, **fields: Any) -> None:
        """Fields of the controller's command from now on; `age_ms`: of its sensor data, `run_offset`: to its run."""
        self._fields.update(fields)

    def once(self, **fields: Any) -> None:
        """One command besides the controller's own."""
        self._hand_in({**self._fields, **fields})

    def confirm(self, role: str, offset: int = 0) -> None:
        """`role` confirms its reset for the run in hand plus `offset`."""
        self._tell(ResetConfirmed(role, self._bridge.run.run_id + offset))

    def mode(self, mode: str) -> None:
        """The operator asks for a mode."""
        self._ask("set_mode", mode)

    def emergency(self, words: str = "") -> None:
        """The operator asks for the emergency brake."""
        self._ask("emergency_brake", words)

    def reset(self) -> None:
        """The operator asks to clear the emergency."""
        self._ask("reset")

    # ------------------------------------------------------------ bus and process

    def drops(self, cycles: int, takes: int) -> None:
        """Of the next cycles, only so many frames are taken."""
        self._dropping = (cycles, takes)

    def breaks(self, takes: int, ms: float) -> None:
        """The bus breaks in the next cycle after so many frames, and can be opened again after `ms`."""
        self._breaks_at, self._broken_ms = takes, ms

    def lost(self, ms: float) -> None:
        """The bus is lost, and can be opened again after `ms`."""
        if self._loop.has_bus and self._running:
            self._no_bus_until_ns = self.now_ns + round(ms * MS)
            self._loop.lost("Network is down", self.now_ns)

    def restart(self) -> None:
        """The process is killed and starts again."""
        self.now_ns += RESTART_NS
        self._first_run_id = self._bridge.run.run_id + 1000
        self._confirmed_run = None
        self._checker.restarted()
        self._new_process()
        self._turn()

    def end(self) -> None:
        """The software is stopped by its operator."""
        self._ask("deactivate")

    # ------------------------------------------------------------ the car

    def images(self) -> tuple[Image, ...]:
        """What the car reports in one of its cycles."""
        most_deg = self.codec.revision.steer_limit_deg  # that this revision's messages can carry
        angle_deg = self._followed_deg if self.angle_deg is None else max(-most_deg, min(most_deg, self.angle_deg))
        front_pct, rear_pct = self.brake_pct if self.echo_pct is None else (self.echo_pct, self.echo_pct)
        return (
            self.status,
            VcuDriveFront(0.0, self.torque_nm[0], self.front_max_nm),
            VcuDriveRear(0.0, self.torque_nm[1], self.rear_max_nm),
            VcuSteer(angle_deg, min(most_deg, self.angle_max_deg), self._request_deg),
            VcuBrake(front_pct, front_pct, rear_pct, rear_pct, BrakeStatus.READY, EbsStatus.ARMED),
            WheelSpeeds(*self._turning_rpm),
            WheelCounts(*(int(turns * self._car.wheel_pulses_per_rev) % 0x10000 for turns in self._turns)),
        )

    @property
    def _turning_rpm(self) -> Rpm:
        return self.rpm or (round(self._speed_rpm),) * 4

    def _car_sends(self) -> None:
        """All that the car sends in one of its cycles, and what its wheels and steering do meanwhile."""
        if self.handshake == "alternate" or (self.handshake == "wild" and self._chance.random() < 0.5):
            self.status = replace(self.status, handshake=not self.status.handshake)
        self._move()
        images = self.images()
        for image in (*images[1:], images[0]) if self.status_last else images:
            kind = type(image)
            if self.cycles < self._muted.get(kind, 0):
                continue
            frame = self.codec.encode(image)
            self._deliver(Frame(frame.can_id, self._with_raw(kind, frame.data), self.now_ns))
            if self.answered_first and kind is VcuStatus:
                self._turn()

    def _with_raw(self, kind: type[Image], data: bytes) -> bytes:
        names, bits, until = self._raw.get(kind, ((), 0, 0))
        if self.cycles >= until:
            return data
        word = int.from_bytes(data, "little")
        for name in names:
            mask = self.codec.mask(kind, name)
            word = word & ~mask | bits * (mask & -mask) & mask
        return word.to_bytes(len(data), "little")

    def _move(self) -> None:
        driving = self.status.as_state is AsState.AS_DRIVING
        share = self.period_ns / CYCLE_NS
        if driving and max(self.torque_nm) > 0.0 and not self._motor_brakes:
            self._speed_rpm = min(800.0, self._speed_rpm + 1.5 * share)
        elif self.status.as_state is AsState.EMERGENCY_BRAKE:
            self._speed_rpm = max(0.0, self._speed_rpm - 3.0 * share)
        elif self.brake_pct[0] > 0.0 or (driving and self._motor_brakes):
            self._speed_rpm = max(0.0, self._speed_rpm - 2.0 * share)
        for wheel, rpm in enumerate(self._turning_rpm):
            turned = rpm / 60.0 * self.period_ns / 1e9
            self._turns[wheel] += turned if self.pulses is None else self.pulses / self._car.wheel_pulses_per_rev
        step = math.degrees(self._car.steer_rate_radps) * self.period_ns / 1e9
        target = self._request_deg if driving else 0.0
        self._followed_deg += max(-step, min(step, target - self._followed_deg))

    def _deliver(self, frame: Frame) -> None:
        if self._loop.has_bus and self._running:
            self._loop.on_frames((frame,), frame.t_ns)
            self._checker.received(frame)

    # ------------------------------------------------------------ planner and controller

    def _control(self) -> None:
        run_id = self._bridge.run.run_id
        if self.confirming and run_id != self._confirmed_run and self._running:
            self._confirmed_run = run_id
            self.confirm("planner")
            self.confirm("controller")
        if not self.silent:
            self._hand_in(self._fields)

    def _hand_in(self, fields: dict[str, Any]) -> None:
        fields = dict(fields)
        age_ns, offset = round(fields.pop("age_ms", 0.0) * MS), fields.pop("run_offset", 0)
        self._tell(VehicleCommand(self.now_ns - age_ns, self._bridge.run.run_id + offset, **fields))

    def _tell(self, message: Message) -> None:
        if self._running:
            self._loop.on_edge((message,), self.now_ns)

    def _ask(self, what: Request, argument: str | None = None) -> None:
        if self._running:
            self._loop.answer(Ask(0, what, argument, self.now_ns + 1, better_late=False), self.now_ns)

    # ------------------------------------------------------------ the loop

    @property
    def _running(self) -> bool:
        return not self._bridge.stopped

    def _pass(self, ns: int) -> None:
        """Let time pass; the loop turns whenever something is due."""
        until_ns = self.now_ns + ns
        while self._running and (due_ns := self._loop.due_ns() + self.late_ns) <= until_ns:
            self.now_ns = max(self.now_ns, due_ns)
            self._turn()
        self.now_ns = until_ns

    def _turn(self) -> None:
        """What the loop does between two frames, where it is not late."""
        loop, now_ns = self._loop, self.now_ns
        if self._running and now_ns >= loop.due_ns() + self.late_ns:
            loop.awake(now_ns)
            if loop.has_bus:
                self._checker.before_cycle(now_ns)
            self._do(loop.act(now_ns))

    def _do(self, actions: Iterable[Action]) -> None:
        """Carry out the actions; reports, the log and the watchdog are not simulated."""
        loop, now_ns = self._loop, self.now_ns
        for action in actions:
            match action:
                case Send(frames):
                    self._send_all(frames)
                case Do.OPEN if now_ns < self._no_bus_until_ns:
                    self._do(loop.refused("no such device", now_ns))
                case Do.OPEN:
                    loop.opened(now_ns)
                    self._turn()

    def _send_all(self, frames: tuple[Frame, ...]) -> None:
        now_ns = self.now_ns
        self._taken = 0
        complete = all(map(self._send, frames))
        self._checker.cycle_over(now_ns, bool(frames))
        if frames and self._taken >= self._breaks_at:
            self._breaks_at = math.inf
            self.lost(self._broken_ms)
            return
        if frames and self._dropping[0] > 0:
            self._dropping = (self._dropping[0] - 1, self._dropping[1])
        self._do(self._loop.sent(complete, now_ns if frames else None, now_ns))
        if self._loop.has_bus:
            self._checker.on_mode_shown(self._bridge.state.supervisor.mode.value)
            self._note_reached()

    def _send(self, frame: Frame) -> bool:
        if self._taken >= self._breaks_at or (self._dropping[0] > 0 and self._taken >= self._dropping[1]):
            return False
        self._taken += 1
        image = self._checker.sent(Frame(frame.can_id, frame.data, self.now_ns))
        if isinstance(image, AiDriveFront | AiDriveRear):
            self.torque_nm[isinstance(image, AiDriveRear)] = image.torque_nm
            self._motor_brakes = image.torque_nm > 0.0 and image.motor_speed_max_rpm == 0
        elif isinstance(image, AiSteer):
            self._request_deg = image.steer_deg
        elif isinstance(image, AiBrake):
            self.brake_pct = (image.front_pct, image.rear_pct)
        return True

    def _note_reached(self) -> None:
        state, decision = self._bridge.state.supervisor, self._bridge.state.decision
        if state.as_state is not None:
            self.reached.add(("AS state", state.as_state.name))
        self.reached.add(("phase", decision.phase.name))
        self.reached.update(("reason", reason.slug) for reason in self._bridge.tally.active)


# ---------------------------------------------------------------- stations

STATIONS: Final[Mapping[str, tuple[str, tuple[Callable[[Run], None], ...]]]] = {
    "start": ("", ()),
    "awake": ("start", (call("run", 25),)),
    "off": ("awake", (call("mode", "autonomous"), call("run", 55))),
    "ready": ("off", (call("car", as_state=AsState.AS_READY), call("run", READY_CYCLES))),
    "launched": ("ready", (call("car", as_state=AsState.AS_DRIVING, go_signal=True), call("run", 2))),
    "driving": ("launched", (call("command", throttle=0.4, speed_limit_mps=8.0), call("run", 303))),
    "moving": ("driving", (call("command", steering_rad=0.05), call("run", 150))),
    "emergency": (
        "moving",
        (call("emergency", "asked"), call("run", 3), call("car", as_state=AsState.EMERGENCY_BRAKE), call("run", 5)),
    ),
    "finished": (
        "moving",
        (
            call("command", throttle=0.0, mission_finished=True),
            call("run", 250),
            call("car", as_state=AsState.AS_FINISHED),
            call("run", 5),
        ),
    ),
}
"""The way of an ordinary car, operator and controller: the station before each, and what leads on from it."""


def at_station(setup: str, station: str) -> Run:
    """A run that has come as far as `station`. Raises RuleBroken where a rule is broken on the ordinary way there."""
    return copy.deepcopy(_kept(setup, station))


@cache
def _kept(setup: str, station: str) -> Run:
    """The way is always the same: kept, and copied."""
    before, steps = STATIONS[station]
    run = at_station(setup, before) if before else Run(SETUPS[setup])
    for step in steps:
        step(run)
    run.judge()
    run.cycles, run.reached = 0, set()
    return run


forget_stations = _kept.cache_clear  # where the code is changed on purpose, the ways must be gone again
