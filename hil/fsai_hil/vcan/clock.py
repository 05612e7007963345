"""Builds the preloaded clock of User-Mode Linux (clock.c says why) and measures the scale of the counter it reads."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import time
from pathlib import Path

_SOURCE = Path(__file__).with_name("clock.c")
_STEADY = {"constant_tsc", "nonstop_tsc"}  # without these the counter is no clock
_MEASURE_S = 0.2
_TRIES = 20


def preloaded_clock(folder: Path) -> dict[str, str]:
    """The environment variables that give a program in User-Mode Linux a fast clock; none where that is not possible.

    The library is built into `folder`. Takes a good third of a second.
    """
    compiler = shutil.which("cc")
    if compiler is None or not _counter_is_steady():
        return {}
    library = folder / "clock.so"
    command = [compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(_SOURCE)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        return {}
    return {"LD_PRELOAD": str(library), "FSAI_NS_PER_COUNT": f"{_ns_per_count(library):.12g}"}


def _counter_is_steady() -> bool:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("flags"):
            return set(line.split()) >= _STEADY
    return False


def _ns_per_count(library: Path) -> float:
    counter = ctypes.CDLL(str(library)).fsai_counter
    counter.restype = ctypes.c_uint64

    def reading() -> tuple[float, int]:
        """A time and the counter's value then, from the tightest of some tries."""
        tries = []
        for _ in range(_TRIES):
            before_ns = time.monotonic_ns()
            count = counter()
            after_ns = time.monotonic_ns()
            tries.append((after_ns - before_ns, (before_ns + after_ns) / 2, count))
        _, at_ns, count = min(tries)
        return at_ns, count

    first_ns, first = reading()
    time.sleep(_MEASURE_S)
    last_ns, last = reading()
    return (last_ns - first_ns) / (last - first)
