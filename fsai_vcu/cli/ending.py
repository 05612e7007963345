"""End of a verb that must not lose what it has: Ctrl-C and a script's SIGTERM ask for it, and do not interrupt."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

_INSISTS_S: Final = 1.0


@contextmanager
def ending() -> Iterator[list[int]]:
    """A list that gets the signal that asks for the end. A later one interrupts whatever is being done."""
    asked: list[int] = []
    insists_s = float("inf")

    def ask(number: int, _frame: FrameType | None) -> None:
        nonlocal insists_s
        if time.monotonic() > insists_s:
            raise KeyboardInterrupt
        insists_s = min(insists_s, time.monotonic() + _INSISTS_S)  # Ctrl-C may come twice: from a shell and its script
        asked.append(number)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def interruptible() -> Iterator[None]:
    """A script's SIGTERM, and a terminal that is closed, interrupt as Ctrl-C does: what is half made is taken away."""
    numbers = [each for each in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(each) == signal.SIG_DFL]
    for number in numbers:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)
