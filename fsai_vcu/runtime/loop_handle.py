"""The edge's side of the CAN loop: starts its process, hands commands and requests in, and takes reports out.

Nothing here waits for the loop but the answers to requests, and those have a deadline.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import subprocess
import time
from collections.abc import Callable

from msgspec.structs import replace

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.interface.values import DETAIL_LENGTH, shortened
from fsai_vcu.runtime.link import (
    Alive,
    Answer,
    Ask,
    Ended,
    Lanes,
    LinkEnd,
    LogLine,
    LoopReport,
    LoopSettings,
    Request,
    ResetConfirmed,
    link_pair,
)
from fsai_vcu.runtime.module_command import module_command

REQUEST_TIMEOUT_S = 0.5  # the loop answers in its next turn; meanwhile the edge does nothing else
_START_TIMEOUT_S = 60.0  # an interpreter's start on a slow processor
_STOP_TIMEOUT_S = 10.0
LOOP_SILENT_NS = 100_000_000  # a loop that reports nothing for so long is, to the edge, a car that is silent
_NOT_READ_NS = 500_000_000  # an edge that did not read for so long finds a full link, with old reports in it

_NOT_RUNNING = "the CAN loop does not run: nothing is sent"
NO_ANSWER = "the CAN loop does not answer"
NOT_DECODED = "messages not understood"


class LoopError(Exception):
    """The loop cannot start; the message is one clear line."""


class LoopHandle:
    """The loop at the far end of a link. For one thread."""

    def __init__(self, end: Lanes, process: subprocess.Popen[bytes] | None = None) -> None:
        """Hold the near end of the link.

        process: the process that has the other end; `start_loop_process` makes both.
        """
        self._link = LinkEnd(end)
        self._process = process
        self._newest: LoopReport | None = None
        self._read_ns = self._reads_since_ns = time.monotonic_ns()  # last; and since when it does so all the time
        self._number = 0  # of the last request
        self._awaited: int | None = None  # the request whose answer somebody waits for
        self._answer: Answer | None = None
        self._active = False
        self._hangs = False  # it did not end when it was asked to
        self.failure = ""  # why the loop ended by itself

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    @property
    def running(self) -> bool:
        """Return true while the loop runs, as far as is known."""
        self._take()
        return self._active and not self._link.closed

    # ------------------------------------------------------------ life

    def configure(self, settings: LoopSettings) -> None:
        """Hand over the settings; the loop's process reads the database. Raises LoopError."""
        self._settle("configure", settings, "does not start")

    def activate(self, first_run_id: int) -> None:
        """Take the interface's lock, open the bus and run. Raises LoopError."""
        self._newest, self.failure = None, ""
        self._settle("activate", first_run_id, "does not begin")
        self._active = True
        self._await(lambda: self._newest is not None or not self.running, _START_TIMEOUT_S)
        if self._newest is None:
            raise LoopError(f"the CAN loop ended at once: {self.failure or 'no reason known'}")

    def deactivate(self) -> bool:
        """Stop in order (at rest zeros and NEUTRAL; moving: brake and ESTOP_REQUEST), then silence. Idempotent.

        False when the loop does not answer any more.
        """
        if self.running:
            self._active = False
            answer = self._answer_to("deactivate", None, _STOP_TIMEOUT_S)
            self._hangs = answer is None and not self._link.closed
        return not self._hangs

    def close(self) -> None:
        """End the process as well. A process that hangs is killed: its silence stops the car."""
        hangs = not self.deactivate()
        self._link.close()
        if self._process is not None:
            try:
                self._process.wait(0.0 if hangs else _STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _settle(self, what: Request, argument: LoopSettings | int, does_not: str) -> None:
        answer = self._answer_to(what, argument, _START_TIMEOUT_S)
        if answer is None:
            ended = self._link.closed
            raise LoopError(
                f"the process of the CAN loop {'has ended' if ended else does_not}"
                + ("" if ended else f" within {_START_TIMEOUT_S:g} s")
            )
        if not answer.accepted:
            raise LoopError(answer.message)

    # ------------------------------------------------------------ what goes in

    def submit_command(self, command: VehicleCommand) -> str:
        """The newest command; the loop takes it in its next turn. Why it was refused; empty where it was not."""
        note = shortened(command.note, DETAIL_LENGTH)
        self._link.send(command if note == command.note else replace(command, note=note))
        return self._link.refusal

    def alive(self) -> None:
        """Tell the loop that the edge lives, once a second: else systemd's watchdog starts edge and loop again."""
        self._link.send(Alive())

    def confirm_reset(self, role: str, run_id: int) -> str:
        """`role` ('planner' or 'controller') has forgotten the previous run and is ready for `run_id`.

        Why it did not get to the loop; empty where it did.
        """
        return "" if self._link.send(ResetConfirmed(role, run_id)) else self._link.refusal or NO_ANSWER

    def set_mode(self, mode: str) -> tuple[bool, str]:
        return self._ask("set_mode", mode)

    def emergency_brake(self, why: str) -> tuple[bool, str]:
        return self._ask("emergency_brake", why, better_late=True)

    def reset(self) -> tuple[bool, str]:
        return self._ask("reset", None)

    def _ask(self, what: Request, argument: str | None, *, better_late: bool = False) -> tuple[bool, str]:
        if not self.running:
            return False, _NOT_RUNNING
        answer = self._answer_to(what, argument, REQUEST_TIMEOUT_S, better_late=better_late)
        if answer is None:
            return False, NO_ANSWER if self._active else _NOT_RUNNING
        return answer.accepted, answer.message

    def _answer_to(
        self, what: Request, argument: LoopSettings | int | str | None, timeout_s: float, *, better_late: bool = True
    ) -> Answer | None:
        """The answer; None where none comes in time. An answer that comes later is for nobody.

        A request that cannot be sent is refused at once; so is one for which a loop that does not read has no room.
        """
        self._number += 1
        self._awaited, self._answer = self._number, None
        active = self._active
        until_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        if not self._link.send(Ask(self._number, what, argument, until_ns, better_late)):
            return Answer(self._number, False, self._link.refusal) if self._link.refusal else None
        self._await(lambda: self._answer is not None or self._active is not active, timeout_s)
        self._awaited = None
        return self._answer

    # ------------------------------------------------------------ what comes out

    def report(self) -> BridgeReport:
        """The newest report. Of a loop that is silent, or ended by itself: that nothing is known of the car."""
        newest = self.loop_report().bridge
        silent_ns = time.monotonic_ns() - newest.t_ns
        if self.failure:
            words = f"the CAN loop ended by itself: {self.failure}"
        elif self.silent:
            words = f"the CAN loop has reported nothing for {silent_ns / 1e9:.1f} s: nothing is known of the car"
        else:
            return newest
        return replace(
            newest,
            vcu_lost=True,
            standing=False,
            why_not_driving=(words,),
            ages_ns={name: None if age is None else age + silent_ns for name, age in newest.ages_ns.items()},
        )

    @property
    def silent(self) -> bool:
        """Return true while the loop should report and does not. An edge that was held up itself cannot know yet."""
        reported_ns = self.loop_report().bridge.t_ns
        return self._active and time.monotonic_ns() - max(reported_ns, self._reads_since_ns) >= LOOP_SILENT_NS

    def loop_report(self) -> LoopReport:
        """The newest report as it came, with what the loop knows of itself."""
        self._take()
        assert self._newest is not None, "requested before the loop was active"
        return self._newest

    def link_trouble(self) -> dict[str, object]:
        """Return what went wrong on the link, for people: counts by the end that has them, and the newest words."""
        values: dict[str, object] = {}
        ends = ("node", self._link.trouble), ("loop", self.loop_report().link)
        for end, trouble in ends:
            values[f"{end}: messages without room"] = trouble.dropped
            values[f"{end}: messages refused"] = trouble.refused
            values[f"{end}: {NOT_DECODED}"] = trouble.undecoded
            if trouble.words:
                values[f"{end}: newest trouble"] = trouble.words
        return values

    def _take(self) -> None:
        """Take in what the loop has sent: reports, answers, log lines, its end."""
        now_ns = time.monotonic_ns()
        if now_ns - self._read_ns >= _NOT_READ_NS:
            self._reads_since_ns = now_ns
        self._read_ns = now_ns
        for message in self._link.receive():
            match message:
                case LoopReport():
                    self._newest = message
                case Answer() if message.number == self._awaited:
                    self._answer = message
                case LogLine():
                    logging.getLogger(message.logger).log(message.level, "%s", message.text)
                case Ended():
                    self.failure, self._active = message.failure, False
        if self._link.closed and self._active:
            self._active = False
            self.failure = self.failure or self._how_it_ended()

    def _how_it_ended(self) -> str:
        """Say how a process ended that said nothing itself."""
        if self._process is None:
            return "its end of the link is closed"
        with contextlib.suppress(subprocess.TimeoutExpired):
            status = self._process.wait(1.0)
            return f"its process was killed by signal {-status}" if status < 0 else f"its process ended with {status}"
        return "it has closed its link"

    def _await(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait until the condition holds, the link ends or the time is over."""
        until = time.monotonic() + timeout_s
        while True:
            self._take()
            left_s = until - time.monotonic()
            if condition() or self._link.closed or left_s <= 0.0:
                return
            select.select(self._link.descriptors, [], [], left_s)


def start_loop_process(bus: str) -> LoopHandle:
    """Start the loop's process. `bus` is for lists of processes; the settings name it for the loop."""
    ours, theirs = link_pair()
    environ = dict(os.environ, WATCHDOG_PID="")  # systemd named the edge; the watchdog is the loop's to feed
    descriptors = [lane.fileno() for lane in theirs]
    with theirs.ordinary, theirs.urgent:
        process = subprocess.Popen(
            module_command("fsai_vcu.runtime.loop_process", ",".join(map(str, descriptors)), bus),
            stdin=subprocess.DEVNULL,
            pass_fds=descriptors,
            env=environ,
            start_new_session=True,  # a Ctrl-C at the terminal is for the edge
        )
    return LoopHandle(ours, process)
