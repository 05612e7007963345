"""Tells at once when the wall clock is stepped, without asking it again and again.

The middleware of the ROS 2 packages on the package index is built for old C libraries, whose timed waits are by the
wall clock: set that back by an hour, and a wait of 5 ms that is under way lasts an hour, unless something wakes it. So
somebody must: the kernel ends a timer of the wall clock when that clock is set (timerfd_create(2)).
"""

from __future__ import annotations

import ctypes
import logging
import os
import threading
import time
from collections.abc import Callable

_ABSTIME_CANCEL_ON_SET = 1 | 2  # linux/timerfd.h: TFD_TIMER_ABSTIME | TFD_TIMER_CANCEL_ON_SET
_FAR_AWAY_S = 1 << 40  # a date that never comes
_AGAIN_S = 0.06  # before anybody is missed; and preloaded clocks know of it by then

logger = logging.getLogger("fsai_vcu.clock_step")


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("it_interval", _Timespec), ("it_value", _Timespec))


def on_clock_step(call: Callable[[], object]) -> bool:
    """Have `call` called, from a thread of its own, whenever the wall clock is set, and again a little later.

    False where that is not possible.
    A clock that is slewed, as network time does it, is not set.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    timer = libc.timerfd_create(time.CLOCK_REALTIME, os.O_CLOEXEC)
    if timer < 0:
        return False
    never = _Itimerspec(it_value=_Timespec(tv_sec=_FAR_AWAY_S))
    if libc.timerfd_settime(timer, _ABSTIME_CANCEL_ON_SET, ctypes.byref(never), None) != 0:
        os.close(timer)
        return False

    def watch() -> None:
        while True:
            try:
                os.read(timer, 8)
            except OSError:  # ECANCELED, and the timer is armed as before
                call()
                logger.warning("the wall clock was set; deadlines are by the monotonic clock and go on")
                # A thread that had read the clock just before, and began to wait just after, could not be woken yet.
                time.sleep(_AGAIN_S)
                call()

    threading.Thread(target=watch, name="clock-step", daemon=True).start()
    return True
