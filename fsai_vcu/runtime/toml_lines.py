"""On which line of a TOML file a key stands: Python's parser does not report it, and a person needs it."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["TomlLines", "line_of", "tomllib", "words_of"]

_AT_LINE = re.compile(r"\(at line (\d+), column \d+\)")


class TomlLines:
    """Where the tables and keys of a valid TOML text stand; lines count from 1."""

    def __init__(self, text: str) -> None:
        self._lines: dict[tuple[str, ...], int] = {}
        begun, so_far = 1, ""
        for number, line in enumerate(text.split("\n"), 1):
            so_far += line + "\n"
            try:
                document = tomllib.loads(so_far)
            except tomllib.TOMLDecodeError:
                continue  # inside a list or a text that goes on over lines
            for path in _paths(document):
                self._lines.setdefault(path, begun)
            begun = number + 1

    def of(self, *path: str) -> int | None:
        """The line of a key, or of the nearest table around it that has a line of its own."""
        return next((self._lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self._lines), None)


def _paths(table: Mapping[str, object], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name, value in table.items():
        yield (*above, name)
        if isinstance(value, Mapping):
            yield from _paths(value, (*above, name))


def line_of(error: tomllib.TOMLDecodeError) -> int | None:
    """The line that a parser's complaint is about."""
    found = _AT_LINE.search(str(error))
    return int(found[1]) if found else None


def words_of(error: tomllib.TOMLDecodeError) -> str:
    """A parser's complaint without its place, in lower case as a part of a sentence."""
    words = _AT_LINE.sub("", str(error)).strip()
    return words[:1].lower() + words[1:]
