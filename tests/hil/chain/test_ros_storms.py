"""ROS programs of others join, leave, are killed and hang while the car drives: none of them holds up the CAN loop."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from chain.conftest import CODEC, START_S, Chain
from fsai_hil.rehearsal.stack import RunningProcess, await_condition
from fsai_hil.rules.checker import MS, checker_for, read_candump
from fsai_hil.rules.response import ResponseTimes
from fsai_vcu.runtime.transport import VARIABLES

RESPONSE_NS = 20 * MS  # no more than a missed cycle
CALM_S = 3.0
HEARD_S = 60.0  # on one slow processor, the last in line for it
HUNG_AT_ONCE = 3  # the loopback profile looks for 32 processes

Windows = dict[str, tuple[int, int]]  # from and to by the wall clock, as the bus log is stamped


class Programs:
    """Programs with the transports that `environ` gives them."""

    def __init__(self, process: RunningProcess) -> None:
        self._process = process
        self._hung: list[int] = []

    def _heard(self, what: str) -> int:
        """The process id of a program that has heard since it was told `what`."""
        before = self._lines("heard")
        self._process.type(what)
        await_condition(lambda: len(self._lines("heard")) > len(before), HEARD_S, "a program receives of the bridge")
        return int(self._lines("heard")[-1])

    def _lines(self, what: str) -> list[str]:
        return [line.split()[0] for line in self._process.log().splitlines() if line.endswith(f" {what}")]

    def leaves(self) -> None:
        pid = str(self._heard("leave"))
        await_condition(lambda: pid in self._lines("left"), HEARD_S, "the program leaves")

    def killed(self) -> None:
        os.kill(self._heard("stay"), signal.SIGKILL)

    def hangs(self) -> None:
        self._hung.append(self._heard("stay"))
        os.kill(self._hung[-1], signal.SIGSTOP)
        if len(self._hung) > HUNG_AT_ONCE:
            os.kill(self._hung.pop(0), signal.SIGKILL)

    def end(self) -> None:
        for pid in self._hung:
            os.kill(pid, signal.SIGKILL)
        self._process.stop()


ACTS = {"leave": Programs.leaves, "killed": Programs.killed, "hang": Programs.hangs}
TRANSPORTS = ("shared memory", "loopback profile")


@contextmanager
def programs(chain: Chain, transport: str, folder: Path) -> Iterator[Programs]:
    environ = chain.stack.environ
    if transport == "shared memory":  # what ROS 2 does if it is told nothing
        environ = {name: value for name, value in environ.items() if name not in VARIABLES}
    # The last in line for the processor: it is their joining that is to show, not their work.
    argv = ["nice", "-n", "19", sys.executable, str(Path(__file__).with_name("ros_programs.py"))]
    log = folder / f"programs-{transport.replace(' ', '-')}.log"
    process = RunningProcess("programs", argv, log, environ, stdin=subprocess.PIPE)
    started = Programs(process)
    try:
        process.await_log("ready", START_S)
        yield started
    finally:
        started.end()


def responses(log: Path, windows: Windows) -> dict[str, ResponseTimes]:
    """How long echoes took in each of the windows, which follow one another, by the kernel's stamps of both frames."""
    checker, found, frames = checker_for(CODEC, busy_machine=True), {}, read_candump(log)
    for name, (began_ns, ended_ns) in windows.items():
        for frame in itertools.takewhile(lambda frame, began_ns=began_ns: frame.t_ns < began_ns, frames):
            checker.on_frame(frame)
        found[name] = checker.responses = ResponseTimes()
        for frame in itertools.takewhile(lambda frame, ended_ns=ended_ns: frame.t_ns < ended_ns, frames):
            checker.on_frame(frame)
    return found


def storm(chain: Chain, results: Path, name: str, transports: Sequence[str], acts: Sequence[str], count: int) -> None:
    windows: Windows = {}

    @contextmanager
    def window(of: str) -> Iterator[None]:
        began_ns = time.time_ns()
        yield
        windows[of] = began_ns, time.time_ns()

    with ExitStack() as started:
        # Before the car: the import of ROS 2 takes a slow processor's time, and that is not what is tested.
        visitors = {each: started.enter_context(programs(chain, each, results)) for each in transports}
        with chain.drive(name) as run:
            with window("calm"):
                chain.drives_on(CALM_S)
            for transport, act in itertools.product(transports, acts):
                with window(f"{transport}, {count} times {act}"):
                    for _ in range(count):
                        ACTS[act](visitors[transport])
                        chain.drives_on()
    times = responses(run.log_path, windows)
    for what, each in times.items():
        words = ", ".join(f"{each.quantile_ms(share):.2f}" for share in (0.5, 0.99, 1.0)) if len(each) else "none"
        print(f"{what}: {len(each)} echoes, p50, p99, max {words} ms")
    assert chain.wire is not None and chain.wire.ok, chain.wire
    assert all(len(each) for each in times.values())
    slow = [what for what, each in times.items() if each.count_above(RESPONSE_NS)]
    assert not slow, f"above {RESPONSE_NS // MS} ms: {slow}"


def test_the_car_drives_on_while_ros_programs_come_and_go(chain: Chain, results: Path) -> None:
    storm(chain, results, "storm", TRANSPORTS, tuple(ACTS), 1)


@pytest.mark.long
@pytest.mark.parametrize("transport", TRANSPORTS)
@pytest.mark.parametrize("act", ACTS)
def test_the_car_drives_on_while_sixty_ros_programs(chain: Chain, results: Path, transport: str, act: str) -> None:
    storm(chain, results, f"storm_{act}_{transport.replace(' ', '_')}", (transport,), (act,), 60)
