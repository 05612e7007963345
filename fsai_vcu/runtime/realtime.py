"""Real-time scheduling for the loop's process, when the machine allows it; reported in words when not."""

from __future__ import annotations

import ctypes
import os
import resource

FIFO_PRIORITY = 45  # above ordinary threads, below the kernel's own interrupt threads (50)
# MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT: pages stay once touched; untouched thread stacks are not filled.
_MCL_FLAGS = 1 | 2 | 4


def go_real_time(priority: int = FIFO_PRIORITY) -> tuple[str, ...]:
    """SCHED_FIFO for the calling thread, but for none that it starts; the process's memory locked.

    Returns what was not allowed, in words.
    """
    refused = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (PermissionError, OSError) as error:
        refused.append(
            f"real-time scheduling not allowed ({error.strerror}): the loop may be late under load; "
            "LimitRTPRIO= in the unit or `ulimit -r` allows it"
        )
    memory_refusal = _lock_memory()
    if memory_refusal:
        refused.append(
            f"memory not locked ({memory_refusal}): a page fault may delay the loop; "
            "LimitMEMLOCK=infinity in the unit or `ulimit -l unlimited` allows it"
        )
    return tuple(refused)


def _lock_memory() -> str:
    """Lock the process's memory, and say why it could not be locked; empty when it is."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if os.geteuid() != 0 and limit != resource.RLIM_INFINITY:
        # Under a finite limit a later allocation would fail instead of this call.
        return f"limit is {limit // 1024} KiB"
    if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_FLAGS) != 0:
        return os.strerror(ctypes.get_errno())
    return ""
