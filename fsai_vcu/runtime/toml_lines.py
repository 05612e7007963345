"""On which line of a TOML file a key stands: Python's parser does not tell, and a person wants to know."""

from __future__ import annotations

import re
import tomllib

_HEADER = re.compile(r"\s*\[{1,2}\s*([^\[\]]+?)\s*\]{1,2}\s*(?:#.*)?$")
_KEY = re.compile(r"""\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*'))*)\s*=""")
_PART = re.compile(r"""[A-Za-z0-9_-]+|"[^"]*"|'[^']*'""")
_AT_LINE = re.compile(r"\(at line (\d+), column \d+\)")
_LONG_QUOTES = ('"""', "'''")


class TomlLines:
    """Where the tables and keys of a text stand. Made for valid TOML; lines count from 1."""

    def __init__(self, text: str) -> None:
        self._lines: dict[tuple[str, ...], int] = {}
        table: tuple[str, ...] = ()
        inside = ""  # the quotes of a text that goes on over lines
        for number, line in enumerate(text.splitlines(), 1):
            if inside:
                if line.count(inside) % 2:
                    inside = ""
                continue
            header = _HEADER.match(line)
            if header:
                table = _parts(header[1])
                self._note(table, number)
                continue
            key = _KEY.match(line)
            if key:
                path = table + _parts(key[1])
                for length in range(len(table) + 1, len(path) + 1):
                    self._note(path[:length], number)
            for quotes in _LONG_QUOTES:
                if line.count(quotes) % 2:
                    inside = quotes

    def _note(self, path: tuple[str, ...], number: int) -> None:
        self._lines.setdefault(path, number)

    def of(self, *path: str) -> int | None:
        """The line of a key, or of the nearest table around it that has a line of its own."""
        for length in range(len(path), 0, -1):
            if path[:length] in self._lines:
                return self._lines[path[:length]]
        return None


def line_of(error: tomllib.TOMLDecodeError) -> int | None:
    """The line that a parser's complaint is about."""
    found = _AT_LINE.search(str(error))
    return int(found[1]) if found else None


def words_of(error: tomllib.TOMLDecodeError) -> str:
    """A parser's complaint without its place, in lower case as a part of a sentence."""
    words = _AT_LINE.sub("", str(error)).strip()
    return words[:1].lower() + words[1:]


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip("\"'") for part in _PART.findall(dotted))
