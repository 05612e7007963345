"""A rehearsal on a bus: the program as a process of its own, the car by the monotonic clock, busy processors."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Final

from fsai_hil.rehearsal.inspection.rehearsal import RehearsalWorld
from fsai_hil.rehearsal.inspection.scenes import SCENES
from fsai_hil.rehearsal.stack import RunningProcess
from fsai_hil.simulator.process import VcuProcess
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.bus import CanBus
from fsai_vcu.runtime.realtime import FIFO_PRIORITY, go_real_time

MOST_BUSY_NS: Final = 15 * S  # the car's time stands still while it is held up; without an end it never comes
BUSY: Final = (sys.executable, "-m", "fsai_hil.rehearsal.scrutineering.load", "processor")


class RehearsalProcess(VcuProcess):
    """The simulated car of a rehearsal on its bus, and beside it the program that is rehearsed.

    `command`: how the program is started; empty: it is started by somebody else. Its output goes to program.log.
    """

    RECEIVES = None  # what an AI computer must never send is looked for too

    def __init__(
        self, world: RehearsalWorld, bus: CanBus, args: argparse.Namespace, command: Sequence[str], folder: Path
    ) -> None:
        super().__init__(world, bus, argparse.Namespace(**{**vars(args), "quiet": True}))
        self._quiet = args.quiet
        self._rehearsal = world
        self._command, self._folder = command, folder
        self._scene = ""
        self._program: RunningProcess | None = None
        self._gone = False
        self._busy: list[RunningProcess] = []
        self._busy_since = 0

    def start(self) -> None:
        """Start the program. Raises OSError where it cannot be."""
        if self._command:
            self._program = RunningProcess("the program", self._command, self._folder / "program.log", os.environ)

    def _obey(self) -> None:
        """Twenty times a second: what the rehearsal asks of its processes."""
        rehearsal = self._rehearsal
        if rehearsal.scene != self._scene and not rehearsal.done:
            self._scene = rehearsal.scene
            number = rehearsal.planned.index(self._scene) + 1
            self._say(f"{number} of {len(rehearsal.planned)}, {self._scene}: {SCENES[self._scene].words}")
        if rehearsal.load_wanted and not self._busy and not rehearsal.load_failed:
            log = self._folder / "load.log"
            self._busy = [RunningProcess("load", BUSY, log, os.environ) for _ in range(os.cpu_count() or 1)]
            self._busy_since = time.monotonic_ns()
        elif self._busy and time.monotonic_ns() - self._busy_since > MOST_BUSY_NS:
            rehearsal.load_failed = "the busy processors held up the simulated car itself"
            self._end_load()
        elif self._busy and not rehearsal.load_wanted:
            self._end_load()
        self._watch_program()

    def _watch_program(self) -> None:
        """Tell the rehearsal when the program has ended, or when nobody is there to end it."""
        program, rehearsal = self._program, self._rehearsal
        if self._gone:
            return
        if program is None:
            if rehearsal.end_wanted_ns is not None:
                self._gone = True
                rehearsal.nobody_to_end()
        elif not program.alive:
            self._gone = True
            rehearsal.program_ended(program.popen.returncode)
        elif rehearsal.overdue:
            self._gone = True
            self._kill()
            rehearsal.program_was_killed()
        elif rehearsal.end_wanted_ns is not None:
            program.ask_to_end()

    def _kill(self) -> None:
        """Kill what is left of the program's own session, and of nobody else's."""
        if self._program is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._program.popen.pid, signal.SIGKILL)

    def _end_load(self) -> None:
        for each in self._busy:
            each.stop()
        self._busy = []

    def close(self) -> None:
        self._end_load()
        if self._program is not None:
            if self._program.alive:
                self._program.ask_to_end()
                until = time.monotonic() + 5.0
                while self._program.alive and time.monotonic() < until:
                    time.sleep(0.02)
            self._kill()
            self._program.end()
        super().close()

    def _say(self, text: str, important: bool = False) -> None:
        if important or not self._quiet:
            at_s = (self.world.now_ns - self.world.setup.start_ns) / S
            print(f"[{at_s:5.0f} s] {text}", file=sys.stderr, flush=True)


def run_rehearsal(process: RehearsalProcess) -> None:
    """Run a rehearsal until its end or a signal; the program and all that was started end with it. Raises OSError."""
    # A car is never late: this one is not either, where that is allowed. But the program under test goes first.
    go_real_time(FIFO_PRIORITY - 10)

    def end(number: int, frame: FrameType | None) -> None:
        process.stop(f"ended by {signal.Signals(number).name}")

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        process.start()
        process.loop()
    finally:
        process.close()
        for number, handler in before.items():
            signal.signal(number, handler)
