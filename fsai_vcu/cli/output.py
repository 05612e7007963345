"""Output of the diagnostic verbs: blocks of lines, and the progress of long work."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass

_PROGRESS_S = 1.0


class Progress:
    """Display of how far the work is, rewritten on a terminal every second."""

    def __init__(self) -> None:
        self._next_s = time.monotonic() + _PROGRESS_S if sys.stderr.isatty() else math.inf
        self._shown = False

    def reading(self, frames: int) -> None:
        self.show(lambda: f"{frames} frames read")

    def writing(self, done: int, of: int) -> None:
        self.show(lambda: f"{100 * done // max(of, 1)} % written")

    def end(self) -> None:
        if self._shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def show(self, text: Callable[[], str]) -> None:
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + _PROGRESS_S
            self._shown = True
            print(f"\r\x1b[K{text()}", end="", file=sys.stderr, flush=True)


def write_out(block: bytes | bytearray) -> None:
    """Write the block to standard output, at once. What it cannot take is reported by `main`."""
    sys.stdout.flush()
    left = memoryview(block)
    while left:  # an unbuffered output (PYTHONUNBUFFERED) may take a part only
        left = left[sys.stdout.buffer.write(left) :]
    sys.stdout.buffer.flush()
