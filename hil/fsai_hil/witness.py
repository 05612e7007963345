"""A witness to the machine: a tiny process that only sleeps, and notes each time it was woken late.

A rehearsal in real time is judged by milliseconds, and a shared machine may stand still for longer: another guest has
the processor, the host flushes its disk, the kernel of User-Mode Linux cannot be interrupted. The bridge must answer
that with an emergency stop, for on a car it is a fault; but a test then shows nothing about the bridge. The witness
tells the two apart. It shares nothing with the bridge or the simulated car, goes before both (a higher real-time
priority) and does nothing: when it wakes late, nothing on this machine could have run in time.

    with Witness(Path("/tmp/witness")) as witness:
        since_ns = time.monotonic_ns()
        ...
        stalls = witness.stalls(since_ns)

Its own process is this file run as a script, with the standard library only: small, and soon there.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

SLEEP_NS = 10_000_000  # 2 % of a processor in User-Mode Linux; a stall may be longer than noted by so much
NOTED_NS = 20_000_000  # woken later than this: noted
STOOD_STILL_NS = (
    30_000_000  # noted when the loop, allowed 50 ms, is held up for longer; no run that shows so much shows anything
)
PRIORITY = 60  # above the bridge's loop (45), the simulated car (35) and a kernel's interrupt threads (50)
_START_S = 20.0
_ALWAYS_LOCKED = 1 | 2  # MCL_CURRENT | MCL_FUTURE


@dataclass(frozen=True)
class Stall:
    """The machine should have woken the witness at `due_ns` (CLOCK_MONOTONIC), and did `late_ns` later."""

    due_ns: int
    late_ns: int

    def overlaps(self, since_ns: int, until_ns: int) -> bool:
        return self.due_ns + self.late_ns >= since_ns and self.due_ns <= until_ns


def describe(stalls: Sequence[Stall]) -> str:
    """How long and how often, in words: 'for 87 ms', 'for 87 ms (the longest of 3 times)'."""
    longest_ms = max(stall.late_ns for stall in stalls) / 1e6
    return f"for {longest_ms:.0f} ms" + (f" (the longest of {len(stalls)} times)" if len(stalls) > 1 else "")


class Witness:
    """The witness's process, and what it has noted so far in the file `path` (best in memory)."""

    def __init__(self, path: Path) -> None:
        """Returns once it watches. Raises OSError if it does not start."""
        self._path = path
        path.unlink(missing_ok=True)
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, str(path)], stdin=subprocess.DEVNULL, start_new_session=True
        )
        until = time.monotonic() + _START_S
        while not self._lines():
            if self._process.poll() is not None or time.monotonic() > until:
                self.stop()
                raise OSError("the witness to the machine's own delays does not start")
            time.sleep(SLEEP_NS / 1e9)

    @property
    def real_time(self) -> bool:
        """Whether it goes before bridge and car; where that is not allowed, others may hold it up too."""
        return self._lines()[0] == "real-time"

    def stalls(self, since_ns: int, until_ns: int | None = None, *, at_least_ns: int = STOOD_STILL_NS) -> list[Stall]:
        """When the machine stood still for `at_least_ns` or longer between two instants of CLOCK_MONOTONIC."""
        noted = [Stall(*map(int, line.split())) for line in self._lines()[1:]]
        last_ns = time.monotonic_ns() if until_ns is None else until_ns
        return [stall for stall in noted if stall.late_ns >= at_least_ns and stall.overlaps(since_ns, last_ns)]

    def _lines(self) -> list[str]:
        """Whole lines only: the last may be just being written."""
        try:
            return self._path.read_text().rpartition("\n")[0].splitlines()
        except FileNotFoundError:
            return []

    def stop(self) -> None:
        self._process.kill()
        self._process.wait()

    def __enter__(self) -> Witness:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def watch(path: str) -> None:
    """What the process does, until it is killed or its parent is gone."""
    parent = os.getppid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        standing = "real-time"
    except OSError:
        standing = "ordinary"
    ctypes.CDLL(None).mlockall(_ALWAYS_LOCKED)  # where it is refused, a page fault may only make it see more
    gc.disable()
    notes = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.write(notes, f"{standing}\n".encode())
    due_ns = time.monotonic_ns()
    while os.getppid() == parent:
        due_ns = time.monotonic_ns() + SLEEP_NS
        time.sleep(SLEEP_NS / 1e9)
        late_ns = time.monotonic_ns() - due_ns
        if late_ns >= NOTED_NS:
            os.write(notes, f"{due_ns} {late_ns}\n".encode())


if __name__ == "__main__":
    watch(sys.argv[1])
