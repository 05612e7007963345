"""Slots between the raw number of a signal and the value of a field, both ways."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from fractions import Fraction
from numbers import Real
from typing import TYPE_CHECKING, Any, Final

from fsai_vcu.interface.fields import Field, Refuse

if TYPE_CHECKING:
    from cantools.database.can import Signal

_FLOAT32_MAX: Final = 3.4028234663852886e38
_FAULT_BIT: Final = "__F__"
_FEW_BITS: Final = 8  # so wide a number takes few values: each is computed once
# Physical values are products of a raw integer and a decimal scale: equal up to the last bits of a float.
_ROUNDING: Final = 1e-9


class EncodeError(ValueError):
    """A value that the wire cannot carry faithfully: out of range, not a number, unknown."""


class Odd(Exception):
    """A raw number that is no value of its field: what stands for it, and what is to be told, if anything."""

    def __init__(self, value: Any, problem: str) -> None:
        self.value, self.problem = value, problem


def unit_of(signal: Signal) -> str:
    """The unit as people read it; the interface's databases mark a fault bit there, which is none."""
    return signal.unit if signal.unit and signal.unit != _FAULT_BIT else ""


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not math.isnan(value)


class _Table(dict[Any, Any]):
    """Table of what each of a few things becomes; any other is for `otherwise`."""

    def __init__(self, known: Mapping[Any, Any], otherwise: Callable[[Any], Any]) -> None:
        super().__init__(known)
        self._otherwise = otherwise

    def __missing__(self, thing: Any) -> Any:
        return self._otherwise(thing)


class Slot:
    """A field together with the signal that fills it.

    `read` makes the field's value of a raw number, or raises Odd; `write` the raw number of a value, or raises
    EncodeError. `place`: which of the class's fields it is; `ones`: as many as the signal has bits.
    """

    def __init__(self, field: Field, signal: Signal, message: str, place: int) -> None:
        """Join a field to the signal that fills it, with the readers and writers that fit its kind."""
        self.field, self.signal, self.place = field, signal, place
        self.ones = (1 << signal.length) - 1
        self._what = f"{message}: {signal.name}"
        least = -(1 << signal.length - 1) if signal.is_signed else 0
        raws = range(least, least + self.ones + 1)
        ends = sorted(raw * signal.scale + signal.offset for raw in (raws[0], raws[-1]))
        if signal.is_float:
            farthest = _FLOAT32_MAX if signal.length == 32 else sys.float_info.max
            ends = [-farthest, farthest]
        self._low = float(ends[0] if signal.minimum is None else max(ends[0], signal.minimum))
        self._high = float(ends[1] if signal.maximum is None else min(ends[1], signal.maximum))
        self._margin = 0.0 if signal.is_float else _ROUNDING * max(1.0, abs(self._low), abs(self._high))
        self.read: Callable[[Any], Any]
        self.write: Callable[[Any], float]
        if field.holds in (int, float):
            self.read, self.write = self._number_reader(), self._number_writer()
            if signal.length <= _FEW_BITS and not signal.is_float:
                read = {raw: self.read(raw) for raw in raws}
                written = {value: raw for raw, value in read.items() if self._low <= value <= self._high}
                self.read, self.write = read.__getitem__, _Table(written, self.write).__getitem__
        else:
            members: Any = (False, True) if field.holds is bool else field.holds
            written = {member: int(member) for member in members if self._low <= member <= self._high}
            self.write = _Table({**written, **({None: 0} if field.nullable else {})}, self._no_choice).__getitem__
            self.read = _Table({int(member): member for member in members}, self._unknown).__getitem__

    def read_if_said(self, raw: float | None) -> Any:
        """Read as `read`, in a message that does not always carry the signal: its raw number is None then."""
        if raw is not None:
            return self.read(raw)
        if self.field.absent is None:
            raise Odd(Refuse.FRAME, "")
        return self.field.default

    def _unknown(self, raw: float) -> bool:
        if self.field.holds is bool:  # a flag of several bits
            return True
        known = raw in self.field.unremarkable
        raise Odd(self.field.unknown, "" if known else f"{self._what} {raw} is not in the interface's table")

    def _no_choice(self, value: Any) -> float:
        raise self._refused(value)

    def _number_reader(self) -> Callable[[Any], Any]:
        """Return the function that makes the field's number of a raw number."""
        what, holds, offset = self._what, self.field.holds, self.signal.offset
        # A decimal scale is a quotient of whole numbers: products with it round as decimals do.
        up, down = map(float, Fraction(str(self.signal.scale)).as_integer_ratio())

        def scaled(raw: float) -> float:
            value = raw * up / down
            if offset:  # adding 0 would make 0 of -0
                value += offset
            return round(value) if holds is int else value

        def finite(raw: float) -> float:
            if not math.isfinite(raw):
                raise Odd(Refuse.FRAME, f"{what} is {raw}, not a finite number")
            return scaled(raw)

        if self.signal.is_float:
            return finite
        return scaled if offset or up != down else holds

    def _number_writer(self) -> Callable[[Any], float]:
        """Return the function that makes a raw number of the field's number."""
        low, high, offset, is_float = self._low, self._high, float(self.signal.offset), self.signal.is_float
        up, down = Fraction(str(self.signal.scale)).as_integer_ratio()
        per_unit, clamped = down / up, self._clamped

        def whole(value: Any) -> float:
            try:
                whole_number: int = round(value if low <= value <= high else clamped(value))
            except TypeError:
                raise self._refused(value) from None
            return whole_number

        def scaled(value: Any) -> float:
            try:
                raw: float = ((value if low <= value <= high else clamped(value)) - offset) * per_unit
            except TypeError:
                raise self._refused(value) from None
            return raw if is_float else round(raw)

        return scaled if is_float or offset or per_unit != 1 else whole

    def _clamped(self, value: Any) -> Any:
        """A number beyond the range as it is sent: a logging field's, or a number that is out by a float's rounding."""
        low, high, margin = self._low, self._high, self._margin
        if _is_number(value) and (self.field.saturates or low - margin <= value <= high + margin):
            return min(max(value, low), high)
        raise self._refused(value)

    def _refused(self, value: Any) -> EncodeError:
        holds: Any = self.field.holds
        if holds is bool:
            return EncodeError(f"{self._what} is {value!r}, not a flag")
        if holds not in (int, float):
            if value in set(holds):
                return EncodeError(f"{self._what} {holds(value).name} does not exist in this revision")
            return EncodeError(f"{self._what} {value!r} is not in the interface's table")
        if not _is_number(value):
            return EncodeError(f"{self._what} is {value!r}, not a number")
        limits = f"{self._low:g} … {self._high:g} {unit_of(self.signal)}".strip()
        return EncodeError(f"{self._what} {value:g} is out of range {limits}")
