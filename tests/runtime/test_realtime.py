"""Real-time scheduling and locked memory: taken where allowed, and said in words where not."""

from __future__ import annotations

import errno
import os
import resource
import sys
from collections.abc import Iterator

import pytest

from fsai_vcu.runtime import realtime


@pytest.fixture(autouse=True)
def switch_interval() -> Iterator[None]:
    before_s = sys.getswitchinterval()
    yield
    sys.setswitchinterval(before_s)


def test_what_is_not_allowed_is_said_with_what_would_allow_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda _what: (8 << 20, 8 << 20))
    scheduling, memory = realtime.go_real_time()
    assert "real-time scheduling not allowed (Operation not permitted)" in scheduling and "LimitRTPRIO=" in scheduling
    assert "memory not locked (limit is 8192 KiB)" in memory and "LimitMEMLOCK=infinity" in memory


def test_the_calling_thread_stands_above_the_processs_others_and_nothing_is_said_where_all_is_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda who, policy, param: asked.append((who, policy, param.sched_priority))
    )
    monkeypatch.setattr(realtime, "_lock_memory", lambda: "")
    assert realtime.go_real_time() == ()
    *others, own = asked
    assert own == (0, os.SCHED_FIFO, realtime.FIFO_PRIORITY)
    assert all(policy == os.SCHED_FIFO and priority < realtime.FIFO_PRIORITY for _, policy, priority in others)
    assert 40 <= realtime.FIFO_PRIORITY < 50  # below the kernel's own interrupt threads
