"""The real Bridge and its loop beside a car of a few lines in virtual time, with the checker of the rules between them.

The loop is `runtime.turns.Turns`, as in the real-time process; its bus is what is done to it here. What the car reports
is what was set; wheels and steering follow what is asked for where nothing else was set.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.searched import SearchSetting
from fsai_hil.evidence.small_car import SmallCar
from fsai_hil.rules.numbers import CYCLE_NS, MS
from fsai_hil.simulator.watched_bridge import WatchedBridge
from fsai_vcu.core.bridge import BridgeConfig
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiBrake, AiDriveFront, AiDriveRear, AiSteer, Image, WheelCounts, command_of
from fsai_vcu.runtime.link import Ask, Message, ResetConfirmed
from fsai_vcu.runtime.turns import Action, Do, Send, Turns

MAX_CYCLES: Final = 1_500  # of the car, after a station: longer runs show nothing more
SETUPS: Final = {
    "2026": SearchSetting(config=BridgeConfig(), limits=UNLIMITED),
    "2021": SearchSetting(config=BridgeConfig(), limits=UNLIMITED, revision="2021", car=CARS["2021"]),
    "venue": SearchSetting(config=BridgeConfig(), limits=OperationalLimits(5.0, 60.0, 15.0)),
    "staging": SearchSetting(config=BridgeConfig(autonomous_at_power_up=True), limits=UNLIMITED),
    "listening": SearchSetting(config=BridgeConfig(listen_only=True), limits=UNLIMITED),
}
WELL: Final = {"throttle": 0.4, "brake": 0.0, "speed_limit_mps": 8.0, "age_ms": 0.0, "run_offset": 0}

Step = tuple[str, dict[str, Any]]
"""A method of `Drive`, and its arguments."""

STATIONS: Final[dict[str, tuple[Step, ...]]] = {
    "start": (),
    "awake": (("run", {"cycles": 25}),),
    "off": (("ask", {"what": "set_mode", "words": "autonomous"}), ("run", {"cycles": 55})),
    "ready": (("car", {"as_state": AsState.AS_READY}), ("run", {"cycles": 495})),
    "launched": (("car", {"as_state": AsState.AS_DRIVING, "go_signal": True}), ("run", {"cycles": 2})),
    "driving": (("command", WELL), ("run", {"cycles": 303})),
    "moving": (("command", {"steering_rad": 0.05}), ("run", {"cycles": 150})),
}
"""The way of an ordinary car, operator and controller: each station follows the one before."""


class RuleBroken(Exception):
    """A rule is broken on the wire."""


class Drive(SmallCar):
    """One process under test, a car of a few lines and the checker between them, at one instant of virtual time."""

    def __init__(self, setting: SearchSetting) -> None:
        self.setting, self.codec, self.checker = setting, setting.codec, setting.checker()
        self.now_ns, self.cycles, self.reached = 1_000 * MS, 0, set[str]()
        self.angle_max_deg = self.codec.revision.steer_limit_deg
        self.held_rpm: int | None = None  # of the wheels; None: what follows from torque and brake
        self.silent = self.unconfirmed = self.stuck = False  # the controller; the resets; the handshake
        self.period_ns, self.late_ns = CYCLE_NS, 0  # of the car; of the loop
        self.fields: dict[str, Any] = {}  # of the controller's command
        self.spoilt: dict[type, tuple[tuple[str, ...], int | None, int]] = {}  # fields, their bits, until which cycle
        self.asked = {kind: kind() for kind in (AiDriveFront, AiDriveRear, AiSteer, AiBrake)}
        self.speed_rpm, self.turned, self.dropping = 0.0, 0.0, (0, 0)
        self.begin(1)

    def begin(self, run_id: int) -> None:
        setting, self.confirmed, self.next_ns, self.no_bus_until_ns = self.setting, 0, self.now_ns, 0
        self.ended = False
        args = setting.car, setting.config, setting.limits, run_id, self.now_ns
        self.bridge = WatchedBridge(self.codec, self.codec.revision, *args)
        self.bridge.checker, self.loop = self.checker, Turns(self.bridge, self.codec, self.now_ns)

    def play(self, script: Sequence[Step]) -> Drive:
        """Take the steps. Raises RuleBroken, and what the process raises, which it never may."""
        for name, arguments in script:
            getattr(self, name)(**arguments)
            for one in self.checker.taken():
                raise RuleBroken(f"rule {one.rule}, at {self.now_ns / 1e6:.6f} ms: {one.words}")
        return self

    # ------------------------------------------------------------ steps

    def run(self, cycles: int) -> None:
        """Let the car send its messages, the controller its command, and the loop answer."""
        for _ in range(min(cycles, MAX_CYCLES - self.cycles)):
            self.quiet(max(0, self.next_ns - self.now_ns) / MS)
            self.next_ns = self.now_ns + self.period_ns
            self.car_sends()
            if not self.unconfirmed and self.confirmed != self.bridge.run.run_id:
                self.confirmed = self.bridge.run.run_id
                self.confirm("planner")
                self.confirm("controller")
            if not self.silent:
                self.once()
            self.turn()
            self.cycles += 1

    def quiet(self, ms: float) -> None:
        """Let time pass in which nothing comes; the loop turns whenever something is due."""
        until_ns = self.now_ns + round(ms * MS)
        while not self.ended and (due_ns := self.loop.due_ns() + self.late_ns) <= until_ns:
            self.now_ns = max(self.now_ns, due_ns)
            self.turn()
        self.now_ns = until_ns

    def hang(self, ms: float) -> None:
        """Let time pass in which the loop does not turn."""
        self.now_ns += round(ms * MS)
        self.turn()

    def now(self, **values: Any) -> None:
        """Set what car, controller and loop do from now on, by the names of `__init__`."""
        vars(self).update(values)

    def car(self, **status: Any) -> None:
        """Set fields of 0x520 from now on."""
        self.status = replace(self.status, **status)

    def spoil(self, kinds: list[type], names: tuple[str, ...], bits: int | None, cycles: int) -> None:
        """Put `bits` into fields of the car's messages for a while; None: the messages are missing."""
        self.spoilt.update(dict.fromkeys(kinds, (names, bits, self.cycles + cycles)))

    def frame(self, frame: Frame, ahead_ns: int = 0) -> None:
        """Put a frame of anybody's on the bus; its stamp is ahead by so much."""
        self.receive(replace(frame, t_ns=self.now_ns + ahead_ns))
        self.turn()

    def command(self, **fields: Any) -> None:
        """Set fields of the controller's command; `age_ms`: of its sensor data, `run_offset`: to its run."""
        self.fields.update(fields)

    def once(self, **fields: Any) -> None:
        """Send a command, with other fields than the controller's own."""
        given = {"age_ms": 0.0, "run_offset": 0, **self.fields, **fields}
        t_ns, run_id = self.now_ns - round(given.pop("age_ms") * MS), self.bridge.run.run_id + given.pop("run_offset")
        self.tell(VehicleCommand(t_ns, run_id, **given))

    def confirm(self, role: str, offset: int = 0) -> None:
        self.tell(ResetConfirmed(role, self.bridge.run.run_id + offset))

    def ask(self, what: Any, words: str | None = None) -> None:
        """Call a service as the operator."""
        if not self.ended:
            self.loop.answer(Ask(0, what, words, self.now_ns + 1, better_late=False), self.now_ns)

    def drop(self, cycles: int, takes: int) -> None:
        """Let the bus take only so many frames of each of the next cycles."""
        self.dropping = cycles, takes

    def lose(self, ms: float) -> None:
        """Lose the bus, which can be opened again after `ms`."""
        if self.loop.has_bus and not self.ended:
            self.no_bus_until_ns = self.now_ns + round(ms * MS)
            self.loop.lost("Network is down", self.now_ns)

    def restart(self) -> None:
        """Kill the process and start another."""
        self.now_ns += 500 * MS  # a process needs at least so long to start
        self.checker.restarted()
        self.begin(self.bridge.run.run_id + 1000)

    # ------------------------------------------------------------ car and loop

    def images(self) -> tuple[Image, ...]:
        """Return what the car reports in one of its cycles."""
        self.rpm, self.heard = round(self.speed_rpm), command_of(self.asked)
        count = int(self.turned * self.setting.car.wheel_pulses_per_rev) % 0x10000
        return (*super().images(), WheelCounts(*[count] * 4))

    def car_sends(self) -> None:
        """Move the car by one of its cycles, and send the messages that it has not lost."""
        front, rear, _, brake = self.asked.values()
        self.car(handshake=self.status.handshake ^ (not self.stuck))
        pushed = self.status.as_state is AsState.AS_DRIVING and max(front.torque_nm, rear.torque_nm) > 0.0
        braked = brake.front_pct > 0.0 or self.status.as_state is AsState.EMERGENCY_BRAKE
        faster_rpm = (1.5 * pushed - 3.0 * braked) * self.period_ns / CYCLE_NS
        self.speed_rpm = max(0.0, min(800.0, self.speed_rpm + faster_rpm)) if self.held_rpm is None else self.held_rpm
        self.turned += self.speed_rpm / 60.0 * self.period_ns / 1e9
        self.spoilt = {kind: one for kind, one in self.spoilt.items() if self.cycles < one[2]}
        for image in self.images():
            names, bits, _ = self.spoilt.get(type(image), ((), 0, 0))
            if bits is not None:
                frame = self.codec.encode(image)
                word = int.from_bytes(frame.data, "little")
                for mask in (self.codec.mask(type(image), name) for name in names):
                    word = word & ~mask | bits * (mask & -mask) & mask
                self.receive(Frame(frame.can_id, word.to_bytes(len(frame.data), "little"), self.now_ns))

    def receive(self, frame: Frame) -> None:
        if self.loop.has_bus and not self.ended:
            self.loop.on_frames((frame,), frame.t_ns)

    def tell(self, message: Message) -> None:
        if not self.ended:
            self.loop.on_edge((message,), self.now_ns)

    def turn(self) -> None:
        """Do what the loop does between two frames, where it is not late."""
        if not self.ended and self.now_ns >= self.loop.due_ns() + self.late_ns:
            self.loop.awake(self.now_ns)
            self.act(self.loop.act(self.now_ns))

    def act(self, actions: Sequence[Action]) -> None:
        """Carry out the actions; reports, the log and the watchdog are not simulated."""
        for action in actions:
            if isinstance(action, Send):
                self.send(action.frames)
            elif action is Do.OPEN and self.now_ns < self.no_bus_until_ns:
                self.act(self.loop.refused("no such device", self.now_ns))
            elif action is Do.END:
                self.ended = True
            elif action is Do.OPEN:
                self.loop.opened(self.now_ns)
                self.turn()

    def send(self, frames: tuple[Frame, ...]) -> None:
        cycles, takes = self.dropping
        taken = frames[:takes] if cycles else frames
        self.dropping = max(0, cycles - bool(frames)), takes
        for frame in taken:
            image = self.checker.sent(Frame(frame.can_id, frame.data, self.now_ns))
            if type(image) in self.asked:
                self.asked[type(image)] = image
        self.act(self.loop.sent(taken == frames, self.now_ns if frames else None, self.now_ns))
        if self.loop.has_bus:
            self.reached |= {self.bridge.state.decision.phase.name, *(one.slug for one in self.bridge.tally.active)}


@cache
def kept(setup: str, station: str) -> Drive:
    """Return a drive at a station; the way is always the same: kept, and copied."""
    before = list(STATIONS)[list(STATIONS).index(station) - 1]
    drive = Drive(SETUPS[setup]) if station == "start" else copy.deepcopy(kept(setup, before))
    drive.play(STATIONS[station])
    drive.cycles, drive.reached = 0, set()
    return drive
