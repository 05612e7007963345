"""A terminal as a place to draw on, and to leave as it was found, whatever ends the drawing."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
from collections.abc import Sequence
from types import FrameType
from typing import Any, Final

_ENTER: Final = "\x1b[?1049h\x1b[?25l\x1b[2J"  # the alternate screen, without a cursor
_LEAVE: Final = "\x1b[0m\x1b[?25h\x1b[?1049l"
USUAL_SIZE: Final = (80, 24)


def is_terminal() -> bool:
    """Whether standard output is a terminal that can be drawn on."""
    return sys.stdout.isatty() and os.environ.get("TERM", "") not in ("", "dumb")


def size() -> tuple[int, int]:
    """Columns and lines of the terminal."""
    with contextlib.suppress(OSError):
        columns, lines = os.get_terminal_size(sys.stdout.fileno())
        if columns > 0 and lines > 0:
            return columns, lines
    return USUAL_SIZE


class Screen:
    """The whole terminal while it is entered. Ctrl-Z gives it back for as long as it lasts."""

    def __init__(self) -> None:
        self._out = sys.stdout.fileno()
        self._in = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._found: list[Any] | None = None
        self._shown: list[str] = []
        self._size = (0, 0)
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Screen:
        self._handlers = {
            number: signal.signal(number, handler)
            for number, handler in ((signal.SIGTSTP, self._stop), (signal.SIGCONT, self._continue))
        }
        self._take()
        return self

    def __exit__(self, *_: object) -> None:
        self._give_back()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def draw(self, lines: Sequence[str]) -> None:
        """Show these lines from the top; only those that are new go over the wire."""
        now = size()
        whole = now != self._size
        self._size = now
        out = ["\x1b[2J"] if whole else []
        before = [] if whole else self._shown
        for row in range(max(len(lines), len(before))):
            line = lines[row] if row < len(lines) else ""
            if row >= len(before) or before[row] != line:
                out.append(f"\x1b[{row + 1};1H{line}\x1b[K")
        self._shown = list(lines)
        self._write("".join(out))

    def asked_to_quit(self) -> bool:
        """Whether somebody pressed q. Other keys do nothing, and are not echoed."""
        if self._in is None or not select.select([self._in], [], [], 0)[0]:
            return False
        typed = os.read(self._in, 1024)
        return b"q" in typed.lower()

    def _take(self) -> None:
        self._size = (0, 0)
        if self._in is not None:
            self._found = termios.tcgetattr(self._in)
            changed = termios.tcgetattr(self._in)
            changed[3] &= ~(termios.ECHO | termios.ICANON)
            termios.tcsetattr(self._in, termios.TCSADRAIN, changed)
        self._write(_ENTER)

    def _give_back(self) -> None:
        with contextlib.suppress(OSError):  # a terminal that has gone needs nothing back
            self._write(_LEAVE)
        if self._in is not None and self._found is not None:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._in, termios.TCSADRAIN, self._found)

    def _stop(self, _number: int, _frame: FrameType | None) -> None:
        self._give_back()
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)

    def _continue(self, _number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTSTP, self._stop)
        self._take()

    def _write(self, text: str) -> None:
        data = text.encode(sys.stdout.encoding or "ascii", "replace")
        while data:
            data = data[os.write(self._out, data) :]
