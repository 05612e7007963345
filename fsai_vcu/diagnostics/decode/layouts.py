"""Layouts of messages and their signals: plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Final, NamedTuple

EXTENDED_KEY: Final = 1 << 29
"""Mark in the key of a message: its identifier is one of 29 bits."""
_WORD: Final = 4  # letters, from which on a word is looked for in names


class SignalLayout(NamedTuple):
    """Layout of a signal of a plain message: its place and the meaning of its bits.

    start: its lowest bit in the eight bytes (zeros behind the message's own) as a number, little-endian or big-endian.
    The value is raw * scale + offset, reckoned with the very types that the database has: int or float. minimum,
    maximum: in the unit; None: the database names none.
    """

    name: str
    start: int
    length: int
    big_endian: bool
    signed: bool
    is_float: bool
    scale: float
    offset: float
    unit: str
    choices: Mapping[int, str]
    minimum: float | None = None
    maximum: float | None = None
    comment: str = ""


class MessageLayout(NamedTuple):
    """One message of a database. `period_ms` is its GenMsgCycleTime, None where it has none.

    plain: every signal can be taken out by shifting and masking. Of other messages the signals have names and units,
    and their places are cantools' business.
    """

    name: str
    can_id: int
    extended: bool
    length: int
    period_ms: int | None
    senders: tuple[str, ...]
    signals: tuple[SignalLayout, ...]
    plain: bool
    comment: str = ""

    def is_called(self, name: str) -> bool:
        """Return true where that is its name (with * and ?) or its identifier (520 or 0x520)."""
        return fnmatchcase(self.name.lower(), name.lower()) or name.lower().removeprefix("0x") == f"{self.can_id:x}"

    def has_in_name(self, word: str) -> bool:
        """Return true where the word, or its beginning, is in the name: steer and steering are in VCU2AI_Steer."""
        sought = word.casefold()
        if len(sought) < _WORD or "_" in sought:
            return False
        parts = self.name.casefold().split("_")
        return any(sought in part or (len(part) >= _WORD and sought.startswith(part)) for part in parts)

    def signals_like(self, patterns: Sequence[str]) -> tuple[SignalLayout, ...]:
        """The signals that NAME or MESSAGE.NAME means (with * and ?), in any case; NAME_Nm of 2026 is NAME too."""
        wanted = [pattern.lower() for pattern in patterns]

        def is_wanted(signal: SignalLayout) -> bool:
            name = signal.name.lower()
            names = (each for one in {name, name.removesuffix("_nm")} for each in (one, f"{self.name.lower()}.{one}"))
            return any(fnmatchcase(each, pattern) for each in names for pattern in wanted)

        return tuple(filter(is_wanted, self.signals))

    @property
    def mask(self) -> int:
        """The bits of its signals in the payload as a little-endian number; all bits where it is not plain."""
        return sum(((1 << s.length) - 1) << s.start for s in self.signals) if self.plain else ~0

    @property
    def key(self) -> int:
        return self.can_id | (EXTENDED_KEY if self.extended else 0)
