"""The stall monitor: on each processor a tiny process that sleeps, and notes when it was woken late.

A rehearsal in real time is judged by milliseconds, and a shared machine may stand still for longer: another guest has
the processor, the host flushes its disk, the kernel of User-Mode Linux cannot be interrupted. The bridge must answer
that with a stop, for on a car it is a fault; but a test then shows nothing about the bridge. The stall monitor
separates the two. It shares nothing with bridge and simulated car and goes before both (a higher real-time priority):
when it wakes late, nothing on that processor could have run in time.

    with StallMonitor(Path("out/stalls")) as monitor:
        since_ns = time.monotonic_ns()
        ...
        why = monitor.disturbed(since_ns)

Its processes are this file run as a script, with the standard library only: small, and soon there.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

SLEEP_NS = 10_000_000  # 2 % of a processor in User-Mode Linux; a stall may be longer than noted by so much
NOTED_NS = 10_000_000  # woken later than this: noted, and a run that fails shows nothing
BUSY_NS = 50_000_000  # a pause that leaves the CAN loop only half of the time after which its messages count as lost
# What every bound allows for, on top, that the machine holds somebody up: more than goes unnoted (NOTED_NS + SLEEP_NS).
STOOD_STILL_NS = 30_000_000
PRIORITY = 60  # above the bridge's loop (45), the simulated car (35) and a kernel's interrupt threads (50)
_START_S = 60.0
RUNS = 3  # of what failed on a disturbed machine
_ALWAYS_LOCKED = 1 | 2  # MCL_CURRENT | MCL_FUTURE


_WATCHES = "it watches\n"  # each process begins with it


class StallMonitor:
    """The stall monitor's processes, and what they have noted so far in the file `path` (best in memory)."""

    def __init__(self, path: Path) -> None:
        """Returns once it watches. Raises OSError if it does not start."""
        self._path = path
        path.unlink(missing_ok=True)
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, str(path)], stdin=subprocess.DEVNULL, start_new_session=True
        )
        until = time.monotonic() + _START_S
        while not (path.exists() and path.read_text().count(_WATCHES) == len(os.sched_getaffinity(0))):
            if self._process.poll() is not None or time.monotonic() > until:
                self.stop()
                raise OSError("the stall monitor to the machine's own delays does not start")
            time.sleep(SLEEP_NS / 1e9)

    def stalls(self, since_ns: int, at_least_ns: int = NOTED_NS) -> list[tuple[int, int]]:
        """Return from and to of each time since then at which the machine stood still, by CLOCK_MONOTONIC.

        at_least_ns: shorter ones do not count.
        """
        lines = self._path.read_text().rpartition("\n")[0].splitlines()  # the last may be just being written
        stalls = [(int(due), int(woken)) for due, woken in map(str.split, lines) if due.isdigit()]
        return [(due, woken) for due, woken in stalls if woken >= since_ns and woken - due >= at_least_ns]

    def stalls_ns(self, since_ns: int, at_least_ns: int = NOTED_NS) -> list[int]:
        """The lengths of `stalls`."""
        return [woken_ns - due_ns for due_ns, woken_ns in self.stalls(since_ns, at_least_ns)]

    def disturbed(self, since_ns: int, at_least_ns: int = NOTED_NS) -> str:
        """Say that the machine stood still since then; '' if it did not. What is rehearsed then shows nothing."""
        stalls = self.stalls_ns(since_ns, at_least_ns)
        more = f" (the longest of {len(stalls)} times)" if len(stalls) > 1 else ""
        return f"stood still for {max(stalls) / 1e6:.0f} ms{more}" if stalls else ""

    def stop(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def __enter__(self) -> StallMonitor:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def on_wall_clock(stalls: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """The same times in ns since 1970, as the clock stands now."""
    ahead_ns = time.time_ns() - time.monotonic_ns()
    return [(due_ns + ahead_ns, woken_ns + ahead_ns) for due_ns, woken_ns in stalls]


def _stand_first() -> None:
    """Go before everything that is rehearsed here, where that is allowed, and be held up by nothing of one's own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).mlockall(_ALWAYS_LOCKED)  # where it is refused, a page fault may only make it see more
    gc.disable()
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def watch(path: str) -> None:
    """Watch every processor with a process of its own, until they are killed or their parent is gone."""
    first, parent = os.getpid(), os.getppid()
    processor, *others = os.sched_getaffinity(0)
    for other in others:
        if not os.fork():
            processor, parent = other, first
            break
    os.sched_setaffinity(0, {processor})
    _stand_first()
    notes = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.write(notes, _WATCHES.encode())
    woken_ns = time.monotonic_ns()
    while os.getppid() == parent:
        due_ns = woken_ns + SLEEP_NS  # from the last look on, so that nothing between two rounds goes unseen
        time.sleep(SLEEP_NS / 1e9)
        woken_ns = time.monotonic_ns()
        if woken_ns - due_ns >= NOTED_NS:
            os.write(notes, f"{due_ns} {woken_ns}\n".encode())


if __name__ == "__main__":
    watch(sys.argv[1])
