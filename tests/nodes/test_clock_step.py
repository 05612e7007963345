"""A wall clock that is set wakes whoever waits by it; nobody asks it again and again."""

from __future__ import annotations

import ctypes
import os
import threading
import time
from typing import Any

import pytest


def test_a_clock_step_is_called_out_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from fsai_nodes.clock_step import on_clock_step

    # The machine's own clock is left alone: what the kernel says when it is set is said in its place.
    steps = iter([True])
    forever = threading.Event()

    def read(timer: int, size: int) -> bytes:
        if next(steps, None):
            raise OSError(125, "Operation canceled")
        forever.wait()
        return bytes(size)

    calls: list[float] = []
    twice = threading.Event()

    def called() -> None:
        calls.append(time.monotonic())
        if len(calls) == 2:
            twice.set()

    monkeypatch.setattr(os, "read", read)
    assert on_clock_step(called)
    assert twice.wait(60.0)
    assert calls[1] - calls[0] >= 0.06
    assert len(calls) == 2


def test_without_a_clock_step_the_kernels_timer_stays() -> None:
    from fsai_nodes.clock_step import on_clock_step

    # The machine's own clock may be set at any time; it is not set in every one of these spans.
    called = threading.Event()
    assert on_clock_step(called.set)
    for _ in range(20):
        called.clear()
        if not called.wait(0.2):
            return
    pytest.fail("called in every span of 0.2 s")


def test_without_such_a_timer_the_node_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    from fsai_nodes.clock_step import on_clock_step

    class Refusing:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def timerfd_create(self, *_: Any) -> int:
            return -1

    monkeypatch.setattr(ctypes, "CDLL", Refusing)
    assert not on_clock_step(lambda: None)
