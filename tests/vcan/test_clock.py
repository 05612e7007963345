"""The clock preloaded in User-Mode Linux is the kernel's clock, only cheaper to read.

It is tried here on the host, where the kernel's own clock can be read beside it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fsai_hil.vcan.clock import preloaded_clock

TOLERANCE_NS = 1_000_000  # what it may be off between two readings, at most

READ_KERNEL = """
import ctypes, sys, threading, time
libc = ctypes.CDLL(None)
pair = (ctypes.c_long * 2)()
CLOCK_REALTIME, CLOCK_MONOTONIC, SYS_CLOCK_GETTIME = 0, 1, 228  # x86-64
def kernel_ns(clock):
    libc.syscall(SYS_CLOCK_GETTIME, clock, pair)
    return pair[0] * 1_000_000_000 + pair[1]
"""
COMPARE = """
PAUSE_NS = 5_000_000  # a pause of the machine's between two readings is not what is measured
LONG_PAUSE_NS = 100_000_000  # after one, a wrong scale is felt in the readings that follow as well
limit = kernel_ns(1) + 10_000_000_000
while time.monotonic_ns() > kernel_ns(1) + 1_000_000 and kernel_ns(1) < limit:
    pass  # a pause while the interpreter started is worked off
worst, last = {}, {"monotonic": kernel_ns(1), "realtime": kernel_ns(0)}
until = time.monotonic() + 0.4
while time.monotonic() < until:
    for name, clock, ours in (("monotonic", 1, time.monotonic_ns), ("realtime", 0, time.time_ns)):
        before = kernel_ns(clock)
        here = ours()
        after = kernel_ns(clock)
        if after - last[name] > LONG_PAUSE_NS:
            sys.exit(print("paused"))
        if after - last[name] < PAUSE_NS:
            worst[name] = max(worst.get(name, 0), before - here, here - after)
        last[name] = after
print(worst["monotonic"], worst["realtime"]) if len(worst) == 2 else print("paused")
"""
NEVER_BACK = """
lock, last, readings = threading.Lock(), [0], [0]
until = time.monotonic() + 0.4
def read():
    while last[0] < until * 1e9 or readings[0] <= 1000:
        with lock:
            now = time.monotonic_ns()
            assert now >= last[0], f"ran back by {last[0] - now} ns"
            last[0] = now
            readings[0] += 1
threads = [threading.Thread(target=read) for _ in range(3)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(readings[0])
"""


@pytest.fixture(scope="module")
def clock(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    environment = preloaded_clock(tmp_path_factory.mktemp("clock"))
    if not environment:
        pytest.skip("this processor has no steady counter, or there is no C compiler: the kernel's clock is used")
    return environment


def run(program: str, clock: dict[str, str]) -> str:
    """The output of a Python program that has the clock. On one processor, as in User-Mode Linux."""
    done = subprocess.run(
        [sys.executable, "-c", READ_KERNEL + program],
        env={**os.environ, **clock},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}),
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    return done.stdout


def worst_ns(clock: dict[str, str]) -> int:
    """How far the clock was off the kernel's, at most; while the machine pauses it is tried again, for a minute."""
    until = time.monotonic() + 60.0
    while (said := run(COMPARE, clock).split()) == ["paused"] and time.monotonic() < until:
        pass
    return max(map(int, said))


@pytest.mark.parametrize("error", [1.0, 0.99, 1.01])
def test_it_keeps_to_the_kernels_time_even_when_its_scale_is_off(clock: dict[str, str], error: float) -> None:
    wrong = {**clock, "FSAI_NS_PER_COUNT": str(float(clock["FSAI_NS_PER_COUNT"]) * error)}
    assert worst_ns(wrong) < 2 * TOLERANCE_NS


@pytest.mark.parametrize("error", [0.99, 1.01])
def test_it_never_runs_backwards_whichever_thread_reads_it(clock: dict[str, str], error: float) -> None:
    scale = {**clock, "FSAI_NS_PER_COUNT": str(float(clock["FSAI_NS_PER_COUNT"]) * error)}
    assert int(run(NEVER_BACK, scale)) > 1000


def test_without_its_scale_it_is_the_kernels_clock_itself(clock: dict[str, str]) -> None:
    assert worst_ns({"LD_PRELOAD": clock["LD_PRELOAD"]}) <= 0


def test_where_there_is_no_compiler_the_kernels_clock_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda *_: None)
    assert preloaded_clock(tmp_path) == {}
