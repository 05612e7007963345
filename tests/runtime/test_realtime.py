"""Real-time scheduling and locked memory: taken where allowed, and said in words where not."""

from __future__ import annotations

import errno
import os
import resource

import pytest

from fsai_vcu.runtime import realtime


def test_what_is_not_allowed_is_said_with_what_would_allow_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda _what: (8 << 20, 8 << 20))
    scheduling, memory = realtime.go_real_time()
    assert "real-time scheduling not allowed (Operation not permitted)" in scheduling and "LimitRTPRIO=" in scheduling
    assert "memory not locked (limit is 8192 KiB)" in memory and "LimitMEMLOCK=infinity" in memory


def test_the_loop_stands_below_the_kernels_own_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda who, policy, param: asked.append((who, policy, param.sched_priority))
    )
    monkeypatch.setattr(realtime, "_lock_memory", lambda: "")
    assert realtime.go_real_time() == ()
    # What it starts is not in real time: a program that computes would hold up the whole machine.
    assert asked == [(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, realtime.FIFO_PRIORITY)]
    assert 40 <= realtime.FIFO_PRIORITY < 50
