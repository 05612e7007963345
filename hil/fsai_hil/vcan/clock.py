"""Builds the preloaded clocks of User-Mode Linux: for the programs inside, and for the kernel itself.

clock.c and slow_clock.c say why. The scale of the counter that the former reads is measured here.
"""

from __future__ import annotations

import ctypes
import mmap
import time
from pathlib import Path

from fsai_hil.vcan.native import VcanError
from fsai_hil.vcan.preload import COMPILER, built

SKIPPED = "/dev/mmapper"  # inside: the page that says how much idle time was skipped (`iomem=` of the kernel)
SLOWEST_PACE = 100.0  # seconds of this machine for one inside; beyond it nobody waits for the end
_STEADY = {"constant_tsc", "nonstop_tsc"}  # without these the counter is no clock
_MEASURE_S = 0.2
_TRIES = 20


def preloaded_clock(folder: Path, pace: float = 1.0) -> dict[str, str]:
    """The environment variables that give a program in User-Mode Linux a fast clock; none where that is not possible.

    The library is built into `folder`. Takes a good third of a second.
    pace: as given to the kernel inside, with `slowed_clock`; where it is not 1, idle time is skipped.
    """
    library = built("clock", folder) if _counter_is_steady() else None
    if library is None:
        return {}
    skipped = {} if pace == 1.0 else {"FSAI_SKIPPED": SKIPPED}
    return {"LD_PRELOAD": str(library), "FSAI_NS_PER_COUNT": f"{_ns_per_count(library) / pace:.12g}", **skipped}


def slowed_clock(folder: Path, pace: float) -> dict[str, str]:
    """The environment variables for User-Mode Linux itself that make a second of work inside last `pace` seconds.

    Idle time takes none then. None for 1. The library is built into `folder`. Raises VcanError where there is no
    compiler.
    """
    if pace == 1.0:
        return {}
    library = built("slow_clock", folder)
    if library is None:
        raise VcanError(f"a slower clock for User-Mode Linux needs a C compiler; as root: {COMPILER}")
    page = folder / "skipped"
    page.write_bytes(bytes(mmap.PAGESIZE))
    return {"LD_PRELOAD": str(library), "FSAI_PACE": f"{pace:.12g}", "FSAI_SKIPPED": str(page)}


def _counter_is_steady() -> bool:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return any(line.startswith("flags") and set(line.split()) >= _STEADY for line in lines)


def _ns_per_count(library: Path) -> float:
    counter = ctypes.CDLL(str(library)).fsai_counter
    counter.restype = ctypes.c_uint64

    def reading() -> tuple[float, int]:
        """A time and the counter's value then, from the tightest of some tries."""
        tries = [(time.monotonic_ns(), counter(), time.monotonic_ns()) for _ in range(_TRIES)]
        before_ns, count, after_ns = min(tries, key=lambda each: each[2] - each[0])
        return (before_ns + after_ns) / 2, count

    first_ns, first = reading()
    time.sleep(_MEASURE_S)
    last_ns, last = reading()
    return (last_ns - first_ns) / (last - first)
