"""`fsai-vcu vcu`: the simulated VCU and car as a process on a bus, in real time.

One thread waits on the bus until the car next has something to send. Frames that wait are read before time moves on,
and a process that was held up for long lets the car's time stand still meanwhile: it must not take its own slowness for
the AI computer's. It needs no AI computer: without one it sends what a car sends, and waits.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import select
import signal
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final, TextIO

from msgspec.structs import asdict, replace

from fsai_hil.rules.response import ResponseTimes
from fsai_hil.simulator.ground_truth import TruthSender
from fsai_hil.simulator.judge import JudgeVerdict
from fsai_hil.simulator.power import POWER_UP
from fsai_hil.simulator.profiles import PROFILES
from fsai_hil.simulator.setup_arguments import add_setup_arguments, setup_of
from fsai_hil.simulator.switches import SWITCH_NAMES
from fsai_hil.simulator.world import World, WorldSetup, mission_named
from fsai_vcu.arguments import add_bus_argument
from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.database import DatabaseError
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.realtime import FIFO_PRIORITY, go_real_time
from fsai_vcu.runtime.recording import CandumpWriter

EXAMPLE: Final = "fsai-vcu vcu vcan0 --mission trackdrive --laps 2 --auto"
PROGRAM: Final = "fsai-vcu vcu"
MISSION: Final = "trackdrive"
TRUTH_PERIOD_NS: Final = 20_000_000  # faster than any sensor looks
HELD_UP_NS: Final = 50_000_000  # half of what the VCU grants the AI computer
REOPEN_NS: Final = 250_000_000
COMMANDS_PERIOD_NS: Final = 50_000_000
PROGRESS_NS: Final = 1_000_000_000  # between two looks for news
PROGRESS_AT_MOST_NS: Final = 5_000_000_000  # without news, between two lines
GO_OFF_NS: Final = 200_000_000
STATUS_ID: Final = BY_NAME["VCU2AI_Status"].can_id
LINGER_NS: Final = 2_000_000_000  # the car goes on speaking after the end, so that the AI side sees it

HELP: Final = f"""commands:
  on                     all switches on, in the order of this car's power-up
  off                    all switches off
  NAME on|off            one switch: {", ".join(name for name in SWITCH_NAMES if name.islower())}
  ami MISSION            choose a mission on the display ({", ".join(a.name.lower() for a in Ami)})
  go [off]               Go (off and on again if it is on already and nothing drives)
  estop [off]            the remote E-stop
  status                 what the car shows
  measure NAME           count the AI computer's response times from now on under NAME (in the result)
  help, quit"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_setup_arguments(parser, MISSION, "NAME[,NAME…]")
    add = parser.add_argument
    add_bus_argument(parser, "the bus: vcan0, loopback:NAME or KIND:CHANNEL (vcan0)", "vcan0")
    add("--auto", action="store_true", help="walk the switches, choose the mission, give Go, and end with it")
    add("--profile", default="specification", choices=list(PROFILES), help="how the VCU behaves (specification)")
    add("--truth", type=int, metavar="PORT", help="send the true pose to this UDP port of 127.0.0.1, for sensors")
    add("--no-gps", action="store_true", help="a car without the PCAN-GPS")
    add("--gps-decimation", type=int, default=1, metavar="N", help="send only each Nth of the PCAN-GPS's frames (1)")
    add("--log-decimation", type=int, default=1, metavar="N", help="send only each Nth of the logging frames (1)")
    add("--timeout", type=float, metavar="S", help="with --auto: give up after S seconds (the judge's own limits)")
    add("--log", metavar="FILE", help="record the bus as this process sees it, as a candump log")
    add("--plot", metavar="FILE.png", help="save a picture of track, path and speed")
    add("--result", metavar="FILE.json", help="save verdict, track and driven path")
    add("--json", action="store_true", help="print the result as one JSON object, the last line of stdout")
    add("--quiet", action="store_true", help="no progress lines")


def run(args: argparse.Namespace) -> int:
    """0: the judge passed every mission (or an interactive session ended); 1: not; 130: interrupted."""
    try:
        setup = _setup(args)
        world = World(setup)
        bus = open_bus(args.interface, receive=AI_IDS)
    except (BusError, DatabaseError, ValueError) as error:  # a TrackError is a ValueError
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 1
    try:
        process = VcuProcess(world, bus, args)
    except OSError as error:
        bus.close()
        print(f"{PROGRAM}: {args.log} cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    # A car is never late: this one is not either, where that is allowed. But the bridge under test goes first.
    go_real_time(FIFO_PRIORITY - 10)

    def end(number: int, frame: FrameType | None) -> None:
        process.stop(f"ended by {signal.Signals(number).name}")

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        process.loop()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        process.close()
    return _finish(process, args)


def _setup(args: argparse.Namespace) -> WorldSetup:
    """Return the world that the arguments ask for. Raises ValueError in words for the user."""
    if args.truth is not None and not 0 < args.truth < 65536:
        raise ValueError(f"--truth is {args.truth}, but a port is 1 to 65535")
    if args.timeout is not None and not 0.0 < args.timeout < float("inf"):
        raise ValueError(f"--timeout is {args.timeout:g}, but must be a time in seconds")
    return setup_of(
        args,
        (args.mission or MISSION).split(","),
        profile=args.profile,
        auto=args.auto,
        gps=not args.no_gps,
        gps_decimation=args.gps_decimation,
        log_decimation=args.log_decimation,
        start_ns=time.monotonic_ns(),
    )


# Monotonic time and time held up, in ns, losses of the AI computer, response times and times of 0x520 so far
Counts = tuple[int, int, int, int, int]


class VcuProcess:
    """A world that lives by the monotonic clock and talks on a bus."""

    RECEIVES: Sequence[int] | None = AI_IDS  # None: all that is on the bus

    def __init__(self, world: World, bus: CanBus, args: argparse.Namespace) -> None:
        """Begin with the world on an open bus; nothing has been sent."""
        self.world = world
        self._bus: CanBus | None = bus
        self._args = args
        self._timeout_ns = None if args.timeout is None else world.now_ns + int(args.timeout * 1e9)
        self._truth = None if args.truth is None else TruthSender(args.truth)
        offset_ns = time.time_ns() - time.monotonic_ns()
        self._log = None if not args.log else CandumpWriter(args.log, args.interface, offset_ns=offset_ns)
        self._stdin: TextIO | None = None if args.auto else sys.stdin
        self._typed = b""
        self._reopen_ns = 0
        self._go_again_ns: int | None = None
        self.interrupted: str | None = None
        self.why_ended = ""
        self.frames_in = self.frames_out = self.dropped = self.bus_losses = 0
        self.late_max_ns = 0
        self.held_up_ns = 0  # by so much the car's time is behind the monotonic clock
        self.held_up_in_ns: Counter[int] = Counter()  # of that, in the first mission, the second and so on
        self.status_late_ns: list[int] = []  # of each 0x520: from when it was due until it had been sent
        self._marks: list[tuple[str, Counts]] = []  # where measurements begin
        self._told, self._told_ns = [""], 0
        self._wake_ns = world.now_ns

    def stop(self, why: str) -> None:
        """End as soon as the loop looks (safe in a signal handler)."""
        self.interrupted = why

    # ------------------------------------------------------------ the loop

    def loop(self) -> None:
        """Drive the world in real time until it is done, its time is over or somebody interrupts."""
        world = self.world
        start = world.now_ns
        next_truth = next_progress = next_commands = start
        end_ns: int | None = None
        setup, track = world.setup, world.run.track.name
        self._say(f"simulated car on {self._args.interface}: {setup.revision}, {setup.profile}, {track}")
        while self.interrupted is None:
            self._listen(self._wake_ns)
            now = self._now_ns()
            if now < self._wake_ns:
                continue
            late_ns = now - self._wake_ns
            self.late_max_ns = max(self.late_max_ns, late_ns)
            if late_ns > HELD_UP_NS:
                self.held_up_ns += late_ns
                self.held_up_in_ns[len(world.verdicts)] += late_ns
                now = self._wake_ns
            self._speak(now)
            self._wake_ns = world.next_due_ns()
            if self._truth is not None and now >= next_truth:
                next_truth = max(next_truth + TRUTH_PERIOD_NS, now)
                truth = world.truth
                self._truth.send(replace(truth, t_ns=truth.t_ns + self.held_up_ns))
            if now >= next_commands:
                next_commands = now + COMMANDS_PERIOD_NS
                self._obey()
            if now >= next_progress:
                next_progress += PROGRESS_NS
                self._tell(now, start)
            if self._args.auto and world.done:
                end_ns = end_ns or now + LINGER_NS
                if now >= end_ns:
                    self.why_ended = "the mission is over"
                    return
            if self._timeout_ns is not None and now >= self._timeout_ns:
                self.why_ended = "the time is up"
                return
        self.why_ended = self.interrupted

    def _now_ns(self) -> int:
        """The car's time."""
        return time.monotonic_ns() - self.held_up_ns

    def _listen(self, until_ns: int) -> None:
        """Receive what arrives until then; always what has arrived already."""
        bus = self._bus
        if bus is None:
            time.sleep(max(0, until_ns - self._now_ns()) / 1e9)
            self._reopen(time.monotonic_ns())
            return
        try:
            frame = bus.recv(max(0, until_ns - self._now_ns()) / 1e9)
            received = 0
            while frame is not None:
                self.frames_in += 1
                if self._log is not None:
                    self._log.write(frame)
                self.world.on_frame(replace(frame, t_ns=frame.t_ns - self.held_up_ns))
                received += 1
                if received >= 100 or (self._now_ns() >= until_ns and received >= 20):
                    return  # a flooded bus must not stop the clock
                frame = bus.recv(0.0)
        except BusLost as error:
            self._lose(error)

    def _speak(self, now: int) -> None:
        """Send what the car has to say by now, as far as the bus takes it."""
        for frame in self.world.advance(now):
            if self._log is not None:
                self._log.write(replace(frame, t_ns=frame.t_ns + self.held_up_ns))
            if self._bus is None:
                continue
            try:
                if self._bus.send(frame):
                    self.frames_out += 1
                    if frame.can_id == STATUS_ID:
                        self.status_late_ns.append(self._now_ns() - frame.t_ns)
                else:
                    self.dropped += 1
            except BusLost as error:
                self._lose(error)

    def _lose(self, error: BusLost) -> None:
        """The bus is gone; the car lives on and comes back to it."""
        self.bus_losses += 1
        self._say(f"bus lost: {error}", important=True)
        if self._bus is not None:
            self._bus.close()
        self._bus = None
        self._reopen_ns = time.monotonic_ns() + REOPEN_NS

    def _reopen(self, now: int) -> None:
        if now < self._reopen_ns:
            return
        self._reopen_ns = now + REOPEN_NS
        with contextlib.suppress(BusError):  # still gone: asked again in a moment
            self._bus = open_bus(self._args.interface, receive=self.RECEIVES)
            self._say("bus is back", important=True)

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
        if self._truth is not None:
            self._truth.close()
        if self._log is not None:
            self._log.close()

    # ------------------------------------------------------------ people

    def _say(self, text: str, important: bool = False) -> None:
        if important or not self._args.quiet:
            print(f"{PROGRAM}: {text}", file=sys.stderr, flush=True)

    def describe(self) -> str:
        """The car in one line."""
        return " | ".join(self._words())

    def _tell(self, now: int, start: int) -> None:
        """Print the car in one line if more than its speed has changed, or after some seconds."""
        state, speed, *others = self._words()
        if self._args.quiet or ([state, *others] == self._told and now < self._told_ns + PROGRESS_AT_MOST_NS):
            return
        self._told, self._told_ns = [state, *others], now
        print(f"[{(now - start) / 1e9:6.1f} s] {' | '.join([state, speed, *others])}", file=sys.stderr, flush=True)

    def _words(self) -> list[str]:
        """State, speed, and what else is to be said of the car."""
        world = self.world
        vcu = world.vcu
        words = [
            f"{vcu.state.label:<15}",
            f"{world.car.speed_mps:5.1f} m/s",
            f"lap {world.run.judge.laps}/{world.run.judge.laps_wanted}",
            f"ASSI {vcu.assi}",
        ]
        if not vcu.powered:
            words.append("low voltage off")
        elif not self.frames_in:
            words.append("no frame of the AI computer yet")
        elif vcu.comms_lost:
            words.append("AI computer lost")
        if vcu.state is AsState.EMERGENCY_BRAKE:
            words.append(f"cause {vcu.shutdown_cause.label}")
        if self._args.auto and not world.operator.done:
            words.append(world.operator.doing)
        if self.dropped:
            words.append(f"{self.dropped} frames dropped")
        return words

    def _obey(self) -> None:
        """Commands typed since the last look."""
        if self._go_again_ns is not None and time.monotonic_ns() >= self._go_again_ns:
            self._go_again_ns = None
            self.world.vcu.switches.go = True
        if self._stdin is None:
            return
        try:
            number = self._stdin.fileno()
            ready, _, _ = select.select([number], [], [], 0.0)
            if not ready:
                return
            data = os.read(number, 4096)
        except (OSError, ValueError):
            self._stdin = None
            return
        if not data:
            self._stdin = None  # nobody types; the car goes on until it is ended
            return
        *lines, self._typed = (self._typed + data).split(b"\n")
        for line in lines:
            answer = self.command(line.decode(errors="replace"))
            if answer:
                print(answer, flush=True)

    def _counts(self) -> Counts:
        vcu, now_ns = self.world.vcu, time.monotonic_ns()
        return now_ns, self.held_up_ns, vcu.comms_losses, len(vcu.response_times_ns), len(self.status_late_ns)

    def measurements(self) -> list[dict[str, Any]]:
        """Response times, and how late this process itself was, from each `measure` to the next."""
        found = []
        for (name, begin), (_, end) in itertools.pairwise([*self._marks, ("end", self._counts())]):
            lasted_ns, held_up_ns, losses = (end[i] - begin[i] for i in range(3))
            found.append(
                {
                    "name": name,
                    "seconds": round(lasted_ns / 1e9, 3),
                    "response": ResponseTimes(self.world.vcu.response_times_ns[begin[3] : end[3]]).as_dict(),
                    "status_late": ResponseTimes(self.status_late_ns[begin[4] : end[4]]).as_dict(),
                    "comms_losses": losses,
                    "held_up_ms": round(held_up_ns / 1e6, 3),
                }
            )
        return found

    def command(self, line: str) -> str:
        """Do what a person types; the answer in words."""
        words = line.split()
        if not words:
            return ""
        verb, rest = words[0].lower(), [word.lower() for word in words[1:]]
        switches = self.world.vcu.switches
        power_up = POWER_UP[self.world.setup.revision]
        if verb == "help":
            return HELP
        if verb == "quit":
            self.stop("asked to quit")
            return ""
        if verb == "status":
            return self.describe()
        if verb == "measure":
            name = " ".join(rest) or str(len(self._marks) + 1)
            self._marks.append((name, self._counts()))
            return f"measuring: {name}"
        if verb in ("on", "off"):
            names = power_up.switches_on if verb == "on" else ("go", *reversed(power_up.switches_on))
            for name in names:
                setattr(switches, name, verb == "on")
            return f"{', '.join(names)}: {verb}"
        if verb == "ami":
            name = " ".join(rest)
            try:
                switches.ami = Ami.NOT_SELECTED if name == "not_selected" else mission_named(name)
            except ValueError as error:
                return str(error)
            return f"mission on the display: {switches.ami.name.lower()}"
        if verb == "estop":
            verb = "remote_estop"
        flag = {"on": True, "off": False, "1": True, "0": False}.get(rest[0] if rest else "on")
        if verb not in SWITCH_NAMES or not isinstance(getattr(switches, verb), bool) or flag is None:
            return f"unknown command {line.strip()!r}; help shows what there is"
        if verb == "go" and flag and switches.go and self.world.vcu.state is not AsState.AS_DRIVING:
            # only a rising edge starts the car: let it be seen off first
            switches.go = False
            self._go_again_ns = time.monotonic_ns() + GO_OFF_NS
            return "go: off and on again"
        setattr(switches, verb, flag)
        return f"{verb}: {'on' if flag else 'off'}"


# ---------------------------------------------------------------- the end


def verdicts_of(process: VcuProcess) -> list[JudgeVerdict]:
    """Return the verdicts on the missions that are over, and on the one in hand, as they are told.

    A mission that failed while this computer held even the simulated car up is not judged; what went wrong stays said.
    """
    world, found = process.world, []
    in_hand = world.verdict()
    verdicts = [*world.verdicts, *[in_hand] * (in_hand not in world.verdicts)]
    for place, verdict in enumerate(verdicts):
        held_up_ns = process.held_up_in_ns[place]
        busy = f"this computer was too busy: it held the simulated car up for {held_up_ns / 1e6:.0f} ms"
        excused = held_up_ns and not verdict.passed
        found.append(replace(verdict, result="not judged", reasons=(busy, *verdict.reasons)) if excused else verdict)
    return found


def result_of(process: VcuProcess) -> dict[str, Any]:
    """Return the session's result as a program wants to read it."""
    world, setup, verdicts = process.world, process.world.setup, verdicts_of(process)
    failed = any(each.result == "fail" for each in verdicts)
    return {
        **verdicts[-1].as_dict(),
        "result": "pass" if _passed(world) else "not judged" if not failed else "fail",
        "missions": [each.as_dict() for each in verdicts[: len(world.verdicts) or 1]],
        "ended": process.why_ended,
        "track": world.run.track.name,
        "revision": setup.revision,
        "profile": setup.profile,
        "seed": setup.seed,
        "sim_time_s": round((world.now_ns - setup.start_ns) / 1e9, 3),
        "faults": list(world.vcu.faults.names),
        "transitions": [
            {"t_s": round((each.t_ns - setup.start_ns) / 1e9, 3), "text": str(each)} for each in world.vcu.transitions
        ],
        "handshake": world.handshake(),
        "measurements": process.measurements(),
        "frames_in": process.frames_in,
        "frames_out": process.frames_out,
        "frames_dropped": process.dropped,
        "bus_losses": process.bus_losses,
        "late_max_ms": round(process.late_max_ns / 1e6, 3),
        "held_up_ms": round(process.held_up_ns / 1e6, 3),
    }


def _passed(world: World) -> bool:
    return world.done and all(verdict.passed for verdict in world.verdicts)


def _finish(process: VcuProcess, args: argparse.Namespace) -> int:
    """Save, plot and print the result; return the exit status."""
    world, result, saved_all = process.world, result_of(process), True
    first = world.runs[0]
    if args.result:
        track = first.track
        saved = {
            **result,
            "cones": [
                [round(float(x), 3), round(float(y), 3), int(color)]
                for (x, y), color in zip(track.cones_xy_m, track.cone_colors, strict=True)
            ],
            "path": [asdict(sample) for sample in first.samples],
        }
        try:
            lines = (f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in saved.items())
            Path(args.result).write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        except OSError as error:
            print(f"{PROGRAM}: {args.result} cannot be written: {error.strerror}", file=sys.stderr)
            saved_all = False
    if args.plot:
        from fsai_hil.simulator.plot import plotted

        saved_all &= plotted(PROGRAM, Path(args.plot), first)
    if args.auto or world.verdicts:
        for verdict in verdicts_of(process)[: len(world.verdicts) or 1]:
            print(verdict.summary(), file=sys.stderr if args.json else sys.stdout, flush=True)
    if args.json:
        print(json.dumps(result), flush=True)
    if not saved_all:
        return 1
    if not args.auto or _passed(world):
        return 0
    return 130 if process.interrupted == "ended by SIGINT" else 1
