"""ROS programs of others join, leave, are killed and hang while the car drives: none of them holds up the CAN loop."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from chain.conftest import CODEC, START_S, Chain, rules_kept
from fsai_hil.rehearsal.bus_watch import responses_in
from fsai_hil.rehearsal.stack import RunningProcess, await_condition
from fsai_hil.rules.checker import MS
from fsai_vcu.runtime.transport import LOOPBACK

RESPONSE_NS = 20 * MS  # no more than a missed cycle
CALM_S = 3.0
RECEIVED_S = 60.0  # on one slow processor, the last in line for it
HUNG_AT_ONCE = 3  # the loopback profile looks for 32 processes


class Programs:
    """Programs of others, each with the transport that it is started with."""

    def __init__(self, process: RunningProcess) -> None:
        self._process = process
        self._hung: list[int] = []

    def _started(self, what: str, transport: str) -> int:
        """The process id of a program that was started for `what` and has received a message."""
        before = self._lines("received")
        self._process.type(" ".join([what, *(f"{name}={value}" for name, value in TRANSPORTS[transport].items())]))
        await_condition(
            lambda: len(self._lines("received")) > len(before),
            RECEIVED_S,
            "a program receives of the bridge",
        )
        return int(self._lines("received")[-1])

    def _lines(self, what: str) -> list[str]:
        return [line.split()[0] for line in self._process.log().splitlines() if line.endswith(f" {what}")]

    def leaves(self, transport: str) -> None:
        pid = str(self._started("leave", transport))
        await_condition(lambda: pid in self._lines("left"), RECEIVED_S, "the program leaves")

    def killed(self, transport: str) -> None:
        os.kill(self._started("stay", transport), signal.SIGKILL)

    def hangs(self, transport: str) -> None:
        self._hung.append(self._started("stay", transport))
        os.kill(self._hung[-1], signal.SIGSTOP)
        if len(self._hung) > HUNG_AT_ONCE:
            os.kill(self._hung.pop(0), signal.SIGKILL)

    def end(self) -> None:
        for pid in self._hung:
            os.kill(pid, signal.SIGKILL)
        self._process.stop()


ACTS = {"leave": Programs.leaves, "killed": Programs.killed, "hang": Programs.hangs}
TRANSPORTS = {
    "shared memory": {},  # what ROS 2 does when nothing is set
    "loopback profile": LOOPBACK,
}


@contextmanager
def programs(chain: Chain, folder: Path) -> Iterator[Programs]:
    # The last in line for the processor: it is their joining that is to show, not their work.
    argv = ["nice", "-n", "19", sys.executable, str(Path(__file__).with_name("ros_programs.py"))]
    process = RunningProcess("programs", argv, folder / "programs.log", chain.stack.environ, stdin=subprocess.PIPE)
    started = Programs(process)
    try:
        process.await_log("ready", START_S)
        yield started
    finally:
        started.end()


def storm(chain: Chain, results: Path, kinds: Sequence[tuple[str, str]], count: int) -> None:
    """Programs of these kinds, each a transport and an act, `count` of each; the car is left driving."""
    windows: dict[str, tuple[int, int]] = {}  # from and to by the wall clock, as the bus log is stamped

    @contextmanager
    def window(of: str) -> Iterator[None]:
        began_ns = time.time_ns()
        yield
        windows[of] = began_ns, time.time_ns()

    # Before the car: the import of ROS 2 takes a slow processor's time, and that is not what is tested.
    with programs(chain, results) as visitors, chain.drive(results) as log:
        with window("calm"):
            chain.drives_on(CALM_S)
        for transport, act in kinds:
            with window(f"{transport}, {count} times {act}"):
                for _ in range(count):
                    ACTS[act](visitors, transport)
                    chain.drives_on()
    found = responses_in(log.frames, CODEC, windows)
    times = {what: each for what, (each, _) in found.items()}
    for what, each in times.items():
        words = ", ".join(f"{each.quantile_ms(share):.2f}" for share in (0.5, 0.99, 1.0)) if len(each) else "none"
        print(f"{what}: {len(each)} echoes, p50, p99, max {words} ms")
    rules_kept(log)
    assert all(len(each) for each in times.values())
    slow = [what for what, each in times.items() if each.count_above(RESPONSE_NS)]
    assert not slow, f"above {RESPONSE_NS // MS} ms: {slow}"


def test_the_car_drives_on_while_ros_programs_come_and_go(chain: Chain, results: Path) -> None:
    storm(chain, results, (("loopback profile", "hang"),), 1)  # it keeps what it has joined, and reads nothing


@pytest.mark.long
@pytest.mark.parametrize("transport", TRANSPORTS)
@pytest.mark.parametrize("act", ACTS)
def test_the_car_drives_on_while_sixty_ros_programs(chain: Chain, results: Path, transport: str, act: str) -> None:
    storm(chain, results, ((transport, act),), 60)
