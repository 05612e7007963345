"""TOML of a file that anybody may have written, and on which line of it a key stands: Python's parser does not tell."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["TomlLines", "line_of", "parse_toml", "tomllib", "words_of"]

_AT_LINE = re.compile(r"\(at line (\d+), column \d+\)")
_DEEPEST = 32  # tables and lists in one another
_KEY = r"""(?:(?<![\w-])[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_DEEP_KEY = re.compile(rf"(?:{_KEY}[ \t]*\.[ \t]*){{{_DEEPEST}}}")  # the parser takes their third power in time
_WHOLE = 1 << 63  # what TOML calls a whole number
_LINES = 16  # of a value that goes on over lines, after each of which is tried whether it has ended


def parse_toml(text: str) -> dict[str, object]:
    """The document, in which every whole number has 64 bits and few things are in one another.

    Raises TOMLDecodeError, and nothing else.
    """
    try:
        if _DEEP_KEY.search(text):
            raise RecursionError
        document = tomllib.loads(text)
        _check(document)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError("Tables and lists are too deep in one another") from None
    except ValueError as error:  # digits without an end, an invalid date
        raise tomllib.TOMLDecodeError(f"Invalid value: {error}") from None
    return document


def _check(value: object, depth: int = 0) -> None:
    if depth > _DEEPEST:
        raise RecursionError
    if isinstance(value, int) and not -_WHOLE <= value < _WHOLE:
        raise tomllib.TOMLDecodeError("A whole number of more than 64 bits")
    if isinstance(value, Mapping):
        for each in value.values():
            _check(each, depth + 1)
    elif isinstance(value, list):
        for each in value:
            _check(each, depth + 1)


class TomlLines:
    """Lines of the tables and keys of a valid TOML text, counted from 1.

    The text is read statement by statement, so that reading takes a time as the text is long. For the end of a value
    over many lines it looks less and less often: what follows may then count as on its first line.
    """

    def __init__(self, text: str) -> None:
        """Find the lines of all tables and keys in `text`."""
        self._lines: dict[tuple[str, ...], int] = {}
        table: tuple[str, ...] = ()
        begun, waiting, tried = 1, list[str](), 0
        whole = text.split("\n")
        for number, line in enumerate(whole, 1):
            waiting.append(line)
            if _LINES < len(waiting) < 2 * tried and number < len(whole):
                continue
            tried = len(waiting)
            try:
                document = tomllib.loads("\n".join(waiting) + "\n")
            except (ValueError, RecursionError):
                continue  # inside a list or a text that goes on over lines
            head = waiting[0].lstrip().startswith("[")
            above = () if head else table
            for path in _paths(document):
                self._lines.setdefault((*above, *path), begun)
                table = path if head else table
            begun, waiting, tried = number + 1, [], 0

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
