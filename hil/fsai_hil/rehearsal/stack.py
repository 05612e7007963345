"""The real processes of one rehearsal: simulated VCU, nodes, recorder; started, watched and ended together."""

from __future__ import annotations

import math
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO

from fsai_vcu.runtime.bus import split_spec
from fsai_vcu.runtime.lock import holder_pid
from fsai_vcu.runtime.transport import loopback_environment

VERDICT, PLOT = "verdict.json", "run.png"  # what the simulated car leaves of a run
NODES = ("vcu_bridge", "sensor_simulator", "cone_detector", "path_planner", "vehicle_controller")
# Half as often as on the car: half the wake-ups, and those are what a slow machine spends its time on.
SLOW_PLACE: Mapping[str, Mapping[str, object]] = {
    "vcu_bridge": {"publish_rate_hz": 25.0},
    "sensor_simulator": {"rate_hz": 10.0},
}
STOP_TIMEOUT_S = 60.0
GO_AGAIN_S = 1.5
_POLL_S = 0.02


class StackError(Exception):
    """A process did not do what was awaited; the message is for a person, with the process's last words."""


def simulated_car(bus: str, truth_port: int, options: Mapping[str, object]) -> list[str]:
    """The words of `fsai-vcu` that start the car: it walks its switches, drives a mission, gives a verdict and ends.

    options: more of `fsai-vcu vcu`, by name; None and False leave one out, True is one without a value.
    """
    words = ["vcu", "-i", bus, "--auto", "--truth", str(truth_port)]
    given = {name: value for name, value in options.items() if value is not None and value is not False}
    return words + [f"--{name}" + ("" if value is True else f"={value}") for name, value in given.items()]


def program(named: str) -> list[str]:
    """The words that start a program of others: a Python file, a file that can be executed, or a Python module."""
    if not named.endswith(".py") and os.access(named, os.X_OK):
        return [str(Path(named).absolute())]
    return [sys.executable, *([named] if named.endswith(".py") else ["-m", named])]


def words_of(other: str) -> list[str]:
    """A program of others and its arguments, of one text. Raises ValueError for a quotation that does not end."""
    return [other] if Path(other).is_file() else shlex.split(other)


def holds_within(condition: Callable[[], bool], timeout_s: float, turn: Callable[[], None]) -> bool:
    """True as soon as `condition` holds, False when it does not in time; `turn` passes the time between two looks."""
    until = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > until:
            return False
        turn()
    return True


def await_condition(condition: Callable[[], bool], timeout_s: float, what: str) -> None:
    """Return as soon as `condition` holds. Raises StackError naming `what` after `timeout_s`."""
    if not holds_within(condition, timeout_s, lambda: time.sleep(_POLL_S)):
        raise StackError(f"waited {timeout_s:g} s in vain: {what}")


class RunningProcess:
    """One child process with its output in a log file."""

    def __init__(
        self,
        name: str,
        argv: Sequence[str],
        log_path: Path,
        environ: Mapping[str, str],
        *,
        stdin: int | None = subprocess.DEVNULL,
        stderr: int | IO[bytes] = subprocess.STDOUT,
    ) -> None:
        """Start the program in a session of its own; its output goes into the log."""
        self.name = name
        self.log_path = log_path
        self._log: IO[bytes] = log_path.open("ab")
        self.popen = subprocess.Popen(
            list(argv),
            stdin=stdin,
            stdout=self._log,
            stderr=stderr,
            env=dict(environ),
            # A Ctrl-C at the terminal is for the one who started the rehearsal; it ends the others properly.
            start_new_session=True,
        )

    @property
    def alive(self) -> bool:
        return self.popen.poll() is None

    def log(self) -> str:
        return self.log_path.read_text(errors="replace")

    def check_alive(self) -> None:
        """Raises StackError when it has ended by itself."""
        if not self.alive:
            raise StackError(f"{self.name} ended with status {self.popen.returncode}:{self.last_words()}")

    def await_log(self, words: str, timeout_s: float) -> None:
        """Wait until the process has printed `words`. Raises StackError when it ends without, or is late."""

        def printed() -> bool:
            alive = self.alive  # what it printed before its end counts
            if words not in self.log() and not alive:
                self.check_alive()
            return words in self.log()

        await_condition(printed, timeout_s, f"{self.name} prints '{words}'")

    def last_words(self, lines: int = 15) -> str:
        return "".join(f"\n    {line}" for line in self.log().splitlines()[-lines:])

    def type(self, line: str) -> None:
        """A line on its standard input, which is a pipe."""
        self.check_alive()
        assert self.popen.stdin is not None
        self.popen.stdin.write(line.encode() + b"\n")
        self.popen.stdin.flush()

    def give_go(self, taken: Callable[[], bool], timeout_s: float, turn: Callable[[], object]) -> None:
        """Type `go` into a simulated car, and again until it is `taken`; `turn` listens to the car for a moment.

        A car ignores a Go that comes before its own 5 s of AS_READY are over, and where its process was held up they
        end later than those of the bridge.
        """
        typed_s = -math.inf

        def insist() -> None:
            nonlocal typed_s
            if time.monotonic() - typed_s >= GO_AGAIN_S:
                self.type("go")
                typed_s = time.monotonic()
            turn()

        holds_within(taken, timeout_s, insist)

    def ask(self, line: str, answer: str, timeout_s: float) -> str:
        """Write it a line; return what it has printed before its answer."""
        answers = self.log().count(answer)
        self.type(line)
        await_condition(lambda: self.log().count(answer) > answers, timeout_s, f"{self.name} answers '{line}'")
        return self.log().rpartition(answer)[0]

    def signal(self, number: signal.Signals) -> None:
        if self.alive:
            self.popen.send_signal(number)

    def wait(self, timeout_s: float) -> int:
        """The exit status. Raises StackError if it does not end in time."""
        try:
            return self.popen.wait(timeout_s)
        except subprocess.TimeoutExpired as error:
            raise StackError(f"{self.name} did not end in {timeout_s:g} s:{self.last_words()}") from error

    def ask_to_end(self) -> None:
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)

    def stop(self) -> int:
        """Ask it to end, insist if it does not; its exit status."""
        self.ask_to_end()
        return self.end()

    def end(self) -> int:
        """Its exit status, once it has been asked to end. Asked again, a node would leave the bus without a goodbye."""
        try:
            self.popen.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
        self._log.close()
        return self.popen.returncode


class Stack:
    """Starts processes that share a bus, a ROS domain and a folder for their logs; ends them all on exit."""

    def __init__(
        self, bus: str, folder: Path, *, slow_place: bool = False, own: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        """slow_place: one slow processor for all of it, as in User-Mode Linux: what can be, is done less often.

        own: programs of others that are started in place of nodes, and under their names.
        """
        self.bus = bus
        self._own = own
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        # Two rehearsals side by side must not receive each other's messages; ids up to 101 are safe on every platform.
        self.domain_id = 1 + os.getpid() % 100
        self.truth_port = 30000 + os.getpid() % 20000
        self.processes: dict[str, RunningProcess] = {}
        self._parameters: dict[str, dict[str, object]] = {name: {} for name in NODES}
        self._parameters["vcu_bridge"] |= {"can_interface": bus}
        self._parameters["sensor_simulator"] |= {"truth_port": self.truth_port}
        if slow_place:
            for name, parameters in SLOW_PLACE.items():
                self._parameters[name] |= parameters
        self.environ = {
            **loopback_environment(os.environ),
            "ROS_DOMAIN_ID": str(self.domain_id),
            "PYTHONUNBUFFERED": "1",
        }

    def start(self, name: str, argv: Sequence[str], *, stdin: int | None = subprocess.DEVNULL) -> RunningProcess:
        """Start `argv` under `name`; its output goes to NAME.log in the folder."""
        process = RunningProcess(name, argv, self.folder / f"{name}.log", self.environ, stdin=stdin)
        self.processes[name] = process
        return process

    def start_verb(self, name: str, *arguments: str, stdin: int | None = subprocess.DEVNULL) -> RunningProcess:
        """Start `fsai-vcu ARGUMENTS…`."""
        return self.start(name, [sys.executable, "-m", "fsai_vcu.cli.main", *arguments], stdin=stdin)

    def start_node(self, name: str, **parameters: object) -> RunningProcess:
        """Start one ROS node: with the rehearsal's parameters, those of its last start, and `parameters` on top."""
        self._parameters[name] |= parameters
        words = ["--ros-args"]
        for parameter, value in self._parameters[name].items():
            words += ["-p", f"{parameter}:={value}"]
        if name in self._own:  # it has parameters of its own
            words = ["--ros-args", "-r", f"__node:={name}"]
        return self.start(name, [*program(self._own.get(name, f"fsai_nodes.{name}")), *words])

    def start_nodes(
        self, parameters: Mapping[str, Mapping[str, object]], without: Sequence[str] = (), others: Sequence[str] = ()
    ) -> tuple[str, ...]:
        """Start the five nodes, each its own process; `parameters` by node name. The names of what was started.

        without: those of the five that are not; others: files and modules of others that are, each with its arguments.
        """
        started = [name for name in NODES if name not in without]
        for name in started:
            self.start_node(name, **parameters.get(name, {}))
        for other in others:
            named, *words = words_of(other)
            started.append(Path(named).stem if Path(named).is_file() else named.rpartition(".")[2])
            self.start(started[-1], [*program(named), *words])
        return tuple(started)

    def check_alive(self, *names: str) -> None:
        """Raises StackError naming the first of `names` (all, if none are given) that has ended by itself."""
        for name in names or tuple(self.processes):
            self.processes[name].check_alive()

    def __enter__(self) -> Stack:
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self.processes.values()):
            process.ask_to_end()
        for process in reversed(self.processes.values()):
            process.end()
        if "vcu_bridge" in self.processes and split_spec(self.bus)[0] == "socketcan":
            # A bridge that was killed leaves a CAN loop that brakes the car to rest, and speaks until it has.
            holds_within(lambda: holder_pid(self.bus) is None, STOP_TIMEOUT_S, lambda: time.sleep(_POLL_S))
