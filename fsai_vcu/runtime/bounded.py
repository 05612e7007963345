"""Work on a file of others in a process of its own, which may take so much memory and time and is ended beyond that.

For libraries that trust a file: how much it unpacks to, how many things it names, where its lists lead.
"""

from __future__ import annotations

import math
import os
import pickle
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fsai_vcu.files import MIB, bytes_on_disk
from fsai_vcu.runtime.module_command import module_command

_TOO_MUCH: Final = "it takes more memory or time than a file of its size does"


class BoundedError(Exception):
    """Reason why the work could not be done, as the end of a sentence."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds on what the process may take beside what it has before it looks at the file."""

    memory_bytes: int
    memory_times: int  # as many for each byte of the file
    seconds: int  # of the processor
    seconds_per_mib: float


@dataclass(frozen=True, slots=True)
class _End:
    why: str | None  # None: all has been sent


def results_of(module: str, *words: str) -> Iterator[Any]:
    """Yield what the module, run as a program with these words, sends by `send_results`. Raises BoundedError."""
    environ = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # each takes 30 MB of addresses, and none computes there
    null = subprocess.DEVNULL
    command = module_command(module, *words)
    with subprocess.Popen(command, env=environ, stdin=null, stdout=subprocess.PIPE, stderr=null) as process:
        assert process.stdout is not None
        try:
            while not isinstance(sent := pickle.load(process.stdout), _End):
                yield sent
        except (EOFError, pickle.UnpicklingError):  # ended by the kernel
            raise BoundedError(_TOO_MUCH) from None
        finally:
            process.kill()
    if sent.why is not None:
        raise BoundedError(sent.why)


def send_results(path: Path, bounds: Bounds, work: Callable[[Callable[[Any], None]], None]) -> None:
    """The process itself: does the work on that file, which gets a function that sends; never returns."""
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    sys.stdout = sys.stderr  # what others print is none of it
    why: str | None = None

    def send(what: Any) -> None:
        out.write(pickle.dumps(what))  # all of it or nothing: it may be what cannot be sent
        out.flush()

    try:
        _limit(path, bounds)
        work(send)
    except MemoryError:
        why = _TOO_MUCH
    except Exception as error:  # such libraries have no common base class for what a broken file makes them raise
        why = " ".join(str(error)[:2000].split())[:300] or type(error).__name__
    send(_End(why))
    os._exit(0)  # what a library cannot read it may also be unable to close


def _limit(path: Path, bounds: Bounds) -> None:
    """Limit this process from here on."""
    size = bytes_on_disk(path.stat())
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    usage = resource.getrusage(resource.RUSAGE_SELF)
    seconds = usage.ru_utime + usage.ru_stime + bounds.seconds + bounds.seconds_per_mib * size / MIB
    for limit, most in (
        (resource.RLIMIT_AS, used + bounds.memory_bytes + bounds.memory_times * size),
        (resource.RLIMIT_CPU, math.ceil(seconds)),
    ):
        hard = resource.getrlimit(limit)[1]
        resource.setrlimit(limit, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
