"""The kinds of fields that a message from outside has, and what each may hold. Pure.

A declaration is made of them: `Parts(x=Number(-1e3, 1e3), note=Text(200), picture=UNREAD)`. `misfit` says in words what
does not fit. Columns of numbers in arrays are judged as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from fsai_vcu.printable import printable as whole_printable

SHOWN = 60  # characters of a value that a sentence repeats
NAMED = 3  # things that a sentence names; the others are counted


def printable(text: str, most: int = SHOWN) -> str:
    """A line of at most `most` characters: control characters are escaped, what is longer is cut and counted."""
    return whole_printable(text, most)


def shown(value: object) -> str:
    """A value as a sentence names it."""
    if isinstance(value, str):
        return f"'{printable(value)}'"
    if isinstance(value, float):
        return f"{value:g}"
    return printable(str(value)) if isinstance(value, (int, bytes)) else f"of type {type(value).__name__}"


def listed(names: Iterable[str], last: str) -> str:
    """Names of others as a sentence has them, such as 'a or b': the first ones, and how many more there are."""
    those = sorted(set(names))
    more = len(those) - NAMED
    return f" {last} ".join([*map(printable, those[:NAMED]), *([f"{more} more"] if more > 0 else [])])


class Kind:
    """Kind of content that one field may hold."""

    checked = True

    def misfit(self, value: Any, name: str) -> str:
        """Say in words what is wrong with `value`, which is called `name`; empty where it fits."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Unread(Kind):
    """No node reads it."""

    checked = False

    def misfit(self, value: Any, name: str) -> str:
        return ""


@dataclass(frozen=True, slots=True)
class Free(Kind):
    """Kind of a field with no bound but the message's own type: a flag, a counter."""

    checked = False

    def misfit(self, value: Any, name: str) -> str:
        return ""


@dataclass(frozen=True, slots=True)
class Number(Kind):
    """A finite number from `low` to `high`; nan: what NaN means in this field, where it means something."""

    low: float
    high: float
    nan: str = ""

    def misfit(self, value: Any, name: str) -> str:
        if self.low <= value <= self.high or (self.nan and math.isnan(value)):
            return ""
        return f"{name} is {shown(float(value))}, not a number from {self.low:g} to {self.high:g}" + (
            f" or NaN ({self.nan})" if self.nan else ""
        )

    def fits(self, column: np.ndarray) -> np.ndarray:
        """(N,) whether each one fits."""
        within: np.ndarray = (column >= self.low) & (column <= self.high)
        return within | np.isnan(column) if self.nan else within


@dataclass(frozen=True, slots=True)
class Whole(Kind):
    """A whole number from `low` to `high`; or one of `also`."""

    low: int
    high: int
    also: tuple[int, ...] = ()

    def misfit(self, value: Any, name: str) -> str:
        if self.low <= value <= self.high or value in self.also:
            return ""
        also = "".join(f" or {each}" for each in self.also)
        return f"{name} is {shown(int(value))}, not {self.low} to {self.high}{also}"

    def fits(self, column: np.ndarray) -> np.ndarray:
        """(N,) whether each one fits."""
        within: np.ndarray = (column >= self.low) & (column <= self.high)
        return within | np.isin(column, self.also) if self.also else within


@dataclass(frozen=True, slots=True)
class Text(Kind):
    """Text of at most `most` characters on one printable line; choices: it is one of them.

    any_case: in small letters or not. lines: it may have several, and control characters: it is not put into a log.
    """

    most: int
    choices: tuple[str, ...] = ()
    any_case: bool = False
    lines: bool = False

    def misfit(self, value: Any, name: str) -> str:
        if len(value) > self.most:
            return f"{name} is {shown(value)}, longer than {self.most} characters"
        if self.choices and (value.lower() if self.any_case else value) not in self.choices:
            return f"{name} is {shown(value)}, not one of {', '.join(each or 'nothing' for each in self.choices)}"
        if not self.lines and not value.isprintable():
            return f"{name} is {shown(value)}, which has control characters"
        return ""


class Parts(Kind):
    """A message in a message, or a whole one: each of its fields by name."""

    def __init__(self, **fields: Kind) -> None:
        self.fields: Mapping[str, Kind] = fields
        self._checked = [(name, kind) for name, kind in fields.items() if kind.checked]
        self.checked = bool(self._checked)

    def misfit(self, value: Any, name: str) -> str:
        for field, kind in self._checked:
            if words := kind.misfit(getattr(value, field), f"{name}.{field}" if name else field):
                return words
        return ""

    def leaves(self, path: str = "") -> Iterator[tuple[str, Kind]]:
        """Every checked field below, by its dotted path."""
        for name, kind in self._checked:
            whole = f"{path}.{name}" if path else name
            if isinstance(kind, Parts):
                yield from kind.leaves(whole)
            else:
                yield whole, kind


class Several(Kind):
    """An array of at most `most`.

    leave_out: items that do not fit are to be left out, and the others stay; else the whole message does not fit.
    """

    def __init__(self, each: Kind, most: int, *, leave_out: bool = False) -> None:
        self.each, self.most, self.leave_out = each, most, leave_out
        leaves = list(each.leaves()) if isinstance(each, Parts) else [("", each)] if each.checked else []
        # Kinds that judge a column of numbers, and kinds that have to be looked at one by one.
        self._columns = [(path, kind) for path, kind in leaves if isinstance(kind, (Number, Whole))]
        self._others = [(path, kind) for path, kind in leaves if not isinstance(kind, (Number, Whole))]

    def misfit(self, value: Any, name: str) -> str:
        if len(value) > self.most:
            return f"{name} has {len(value)} items, more than {self.most}"
        if not len(value) or self.leave_out:
            return ""
        return self.unfit(value, name)[1]

    def unfit(self, items: Sequence[Any], name: str) -> tuple[np.ndarray, str]:
        """(N,) which items do not fit, and in words the first thing that is wrong."""
        bad = np.zeros(len(items), dtype=bool)
        first = ""
        for path, kind in self._columns:
            column = np.asarray(items) if not path else np.array(list(map(attrgetter(path), items)))
            found = ~kind.fits(column)
            if found.any():
                index = int(found.argmax())
                first = first or kind.misfit(column[index].item(), _item(name, index, path))
                bad |= found
        for path, kind in self._others:
            for index, item in enumerate(items):
                words = kind.misfit(attrgetter(path)(item) if path else item, _item(name, index, path))
                if words:
                    first = first or words
                    bad[index] = True
        return bad, first


def _item(name: str, index: int, path: str) -> str:
    return f"{name}[{index}].{path}" if path else f"{name}[{index}]"


UNREAD, FREE = Unread(), Free()
