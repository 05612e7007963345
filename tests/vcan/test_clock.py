"""The clock preloaded in User-Mode Linux is the kernel's clock, only cheaper to read.

It is tried here on the host, where the kernel's own clock can be read beside it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fsai_hil.vcan.clock import preloaded_clock

TOLERANCE_NS = 1_000_000  # what it may be off between two readings, at most

READ_KERNEL = """
import ctypes, threading, time
libc = ctypes.CDLL(None)
pair = (ctypes.c_long * 2)()
CLOCK_REALTIME, CLOCK_MONOTONIC, SYS_CLOCK_GETTIME = 0, 1, 228  # x86-64
def kernel_ns(clock):
    libc.syscall(SYS_CLOCK_GETTIME, clock, pair)
    return pair[0] * 1_000_000_000 + pair[1]
"""
COMPARE = """
PAUSE_NS = 5_000_000  # a pause of the machine's between two readings is not what is measured
worst, last = {}, {}
until = time.monotonic() + 0.4
while time.monotonic() < until:
    for name, clock, ours in (("monotonic", 1, time.monotonic_ns), ("realtime", 0, time.time_ns)):
        before = kernel_ns(clock)
        here = ours()
        after = kernel_ns(clock)
        if after - last.get(name, 0) < PAUSE_NS:
            worst[name] = max(worst.get(name, 0), before - here, here - after)
        last[name] = after
print(worst["monotonic"], worst["realtime"])
"""
NEVER_BACK = """
lock, last, readings = threading.Lock(), [0], [0]
until = time.monotonic() + 0.4
def read():
    while last[0] < until * 1e9:
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


@pytest.mark.parametrize("error", [1.0, 0.99, 1.01])
def test_it_keeps_to_the_kernels_time_even_when_its_scale_is_off(clock: dict[str, str], error: float) -> None:
    wrong = {**clock, "FSAI_NS_PER_COUNT": str(float(clock["FSAI_NS_PER_COUNT"]) * error)}
    assert max(map(int, run(COMPARE, wrong).split())) < 2 * TOLERANCE_NS


@pytest.mark.parametrize("error", [0.99, 1.01])
def test_it_never_runs_backwards_whichever_thread_reads_it(clock: dict[str, str], error: float) -> None:
    scale = {**clock, "FSAI_NS_PER_COUNT": str(float(clock["FSAI_NS_PER_COUNT"]) * error)}
    assert int(run(NEVER_BACK, scale)) > 1000


def test_without_its_scale_it_is_the_kernels_clock_itself(clock: dict[str, str]) -> None:
    assert max(map(int, run(COMPARE, {"LD_PRELOAD": clock["LD_PRELOAD"]}).split())) <= 0


def test_where_there_is_no_compiler_the_kernels_clock_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda *_: None)
    assert preloaded_clock(tmp_path) == {}
