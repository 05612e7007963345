"""A terminal as a place to draw on, and to leave as it was found, whatever ends the drawing."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Sequence
from typing import Any, Final

_ENTER: Final = "\x1b[?1049h\x1b[?25l"  # the alternate screen, without a cursor
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

    def __enter__(self) -> Screen:
        self._in = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._handler = signal.signal(signal.SIGTSTP, self._stop)
        self._take()
        return self

    def __exit__(self, *_: object) -> None:
        self._give_back()
        signal.signal(signal.SIGTSTP, self._handler)

    def draw(self, lines: Sequence[str]) -> None:
        """Show these lines from the top, and nothing else."""
        self._write("\x1b[H" + "\r\n".join(f"{line}\x1b[K" for line in lines) + "\x1b[J")

    def keys(self) -> str:
        """What has been typed since; it is not echoed."""
        if self._in is None or not select.select([self._in], [], [], 0)[0]:
            return ""
        return os.read(self._in, 1024).decode(errors="replace").lower()

    def _take(self) -> None:
        if self._in is not None:
            self._found: list[Any] = termios.tcgetattr(self._in)
            tty.setcbreak(self._in)
        self._write(_ENTER)

    def _give_back(self) -> None:
        with contextlib.suppress(OSError, termios.error):  # a terminal that has gone needs nothing back
            self._write(_LEAVE)
            if self._in is not None:
                termios.tcsetattr(self._in, termios.TCSADRAIN, self._found)

    def _stop(self, *_: object) -> None:
        self._give_back()
        os.kill(os.getpid(), signal.SIGSTOP)  # from here it goes on when it is continued
        self._take()

    def _write(self, text: str) -> None:
        data = text.encode(sys.stdout.encoding or "ascii", "replace")
        while data:
            data = data[os.write(sys.stdout.fileno(), data) :]
