"""Names and words of others are text, wherever they are shown: they move no cursor and are no formula."""

from __future__ import annotations

import re
from typing import Any, Final, TextIO

LINE: Final = 500
"""Most characters of a line that repeats what another program says; the project's nodes say less."""
_FORMULA: Final = tuple("=+-@\t\r＝＋－＠")
"""Characters that a spreadsheet takes for the beginning of a formula."""
_OWN: Final = r"\x1b\[[0-9;]{0,20}m|\r?\x1b\[K"
"""Sequences that the command line itself writes to a terminal: colours, and a line that is rewritten."""
_PLAIN: Final = re.compile(r"[\n\t\x20-\x7e]*")
_SPLIT: Final = re.compile(r"(\n|\t)")
_SPLIT_WITH_OWN: Final = re.compile(rf"({_OWN}|\n|\t)")


def printable(text: str, most: int | None = None) -> str:
    """The text with what is no character to be seen, line ends too, as Python writes it: '\\x1b'.

    most: characters; of a longer text the beginning is left, and its length.
    """
    shown = text[:most]
    if not shown.isprintable():
        shown = "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in shown)
    if most is None or (len(text) <= most and len(shown) <= 6 * most):
        return shown
    return f"{shown[:most]}… ({len(text)} characters)"


def cell(text: str) -> str:
    """The text as a cell of a table: a spreadsheet shows it, whatever it begins with."""
    text = printable(text)
    return f"'{text}" if text.startswith(_FORMULA) else text


def drawn(text: str) -> str:
    """The text as matplotlib draws it, which takes what stands between two dollars for mathematics."""
    return printable(text).replace("$", r"\$")


class PrintableStream:
    """A text stream onto which only what can be seen is written, and line ends; to a terminal also what `_OWN` has.

    What the stream's encoding does not have is written as Python writes it: '\\u2192'.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._encoding = stream.encoding or "utf-8"
        self._split = _SPLIT_WITH_OWN if stream.isatty() else _SPLIT

    def write(self, text: str) -> int:
        if not _PLAIN.fullmatch(text):
            parts = self._split.split(text)  # every other one is a separator
            text = "".join(part if number % 2 else printable(part) for number, part in enumerate(parts))
            text = text.encode(self._encoding, "backslashreplace").decode(self._encoding)
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
