"""Frames to values, many at once, and to the last bit the values that cantools gives.

A plain message (layouts.py) is taken apart with numpy: shift, mask, raw * scale + offset in the types of the database.
Everything else goes through cantools frame by frame. A frame of the wrong length is never taken for a whole one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.decode.databases import Databases, UndecodableError
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout, SignalLayout
from fsai_vcu.diagnostics.log.candump_line import MAX_STANDARD_ID
from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, REMOTE, Frames, Ints, Words

Numbers = npt.NDArray[Any]
_UNKNOWN: Final = -1
_NO_DATA_FRAME: Final = -2


@dataclass(frozen=True, slots=True)
class SignalSeries:
    """A signal over time. values: physical numbers (int64, uint64 or float64; object where cantools gave them).

    raw: the integers (or floats) on the wire. rows: where in the frames each value comes from.
    """

    name: str
    unit: str
    choices: Mapping[int, str]
    rows: Ints
    t_ns: Ints
    values: Numbers
    raw: Numbers

    def label(self, index: int) -> str:
        """The value in the database's words where it has one, else the number."""
        raw, value = self.raw[index : index + 1].tolist()[0], self.values[index : index + 1].tolist()[0]
        word = self.choices.get(int(raw)) if self.choices else None
        return str(value) if word is None else word


@dataclass(frozen=True, slots=True)
class MessageTable:
    """All frames of one message. rows: where in the frames; wrong_length: rows of frames that are not decoded."""

    layout: MessageLayout
    rows: Ints
    t_ns: Ints
    series: Mapping[str, SignalSeries]
    wrong_length: Ints


class Decoder:
    """Decodes with the messages of `databases`."""

    def __init__(self, databases: Databases) -> None:
        self.databases = databases
        self._layouts = list(databases.layouts.values())
        keys = np.array([*databases.layouts, 0xFFFF_FFFF], np.uint32)
        self._order = np.argsort(keys).astype(np.int32)
        self._keys = keys[self._order]
        self._standard = np.full(MAX_STANDARD_ID + 1, _UNKNOWN, np.int32)  # a table is quicker than a search
        short = keys <= MAX_STANDARD_ID
        self._standard[keys[short]] = np.flatnonzero(short)

    def which(self, frames: Frames) -> npt.NDArray[np.int32]:
        """Return for each frame the index of its message; -1: in no database, -2: an error or remote frame."""
        keys = np.where(frames.flags & EXTENDED, frames.can_id | np.uint32(EXTENDED_KEY), frames.can_id)
        index = np.take(self._standard, keys, mode="clip")
        wide = np.flatnonzero(keys > MAX_STANDARD_ID)
        places = np.searchsorted(self._keys, keys[wide])
        index[wide] = np.where(self._keys[places] == keys[wide], self._order[places], _UNKNOWN)
        index[(frames.flags & (ERROR | REMOTE)) != 0] = _NO_DATA_FRAME
        return index

    def by_message(self, frames: Frames) -> Iterator[tuple[MessageLayout | None, Ints]]:
        """(message, rows of its frames in order); None for frames that no database describes."""
        index = (self.which(frames) + 2).astype(np.uint16)
        order = np.argsort(index, kind="stable")
        counts = np.bincount(index, minlength=2)
        at = int(counts[0])
        for number in np.flatnonzero(counts[1:]).tolist():
            count = int(counts[number + 1])
            yield (self._layouts[number - 1] if number else None), order[at : at + count]
            at += count

    def tables(self, frames: Frames, names: set[str] | None = None) -> dict[str, MessageTable]:
        """Every message received (or those called `names`) as a table."""
        return {
            layout.name: self.table(layout, frames, rows)
            for layout, rows in self.by_message(frames)
            if layout is not None and (names is None or layout.name in names)
        }

    def table(self, layout: MessageLayout, frames: Frames, rows: Ints) -> MessageTable:
        """The frames `rows`, all of one message, decoded."""
        right = frames.length[rows] == layout.length
        wrong = rows[~right]
        rows = rows[right]
        t_ns = frames.t_ns[rows]
        if layout.plain:
            words = frames.word[rows]
            series = {
                signal.name: SignalSeries(
                    signal.name, signal.unit, signal.choices, rows, t_ns, *values_of(signal, words)
                )
                for signal in layout.signals
            }
        else:
            series = self._careful_series(layout, frames, rows)
        return MessageTable(layout, rows, t_ns, series, wrong)

    def _careful_series(self, layout: MessageLayout, frames: Frames, rows: Ints) -> dict[str, SignalSeries]:
        """Decode the frames `rows` through cantools, one by one, into a series for each signal."""
        message = self.databases.message(layout.key)
        found: dict[str, tuple[list[int], list[Any], list[Any]]] = {
            signal.name: ([], [], []) for signal in layout.signals
        }
        convert = {signal.name: signal.conversion for signal in message.signals}
        for row in rows.tolist():
            try:
                decoded = self.databases.decoded(layout, frames.payload(row), scaling=False)
            except UndecodableError:
                continue  # it has no values to put into columns; the printed line says why
            for name, raw in decoded.items():
                places, values, raws = found[name]
                places.append(row)
                raws.append(raw)
                values.append(convert[name].raw_to_scaled(raw, False))
        series = {}
        for signal in layout.signals:
            places, values, raws = found[signal.name]
            at = np.array(places, np.int64)
            columns = at, frames.t_ns[at], _column(values), _column(raws)
            series[signal.name] = SignalSeries(signal.name, signal.unit, signal.choices, *columns)
        return series


def values_of(signal: SignalLayout, words: Words) -> tuple[Numbers, Numbers]:
    """(physical values, raw values) of a signal of a plain message, from its payloads as numbers."""
    raw = raw_of(signal, words)
    scale, offset = signal.scale, signal.offset
    if scale == 1 and offset == 0:
        return raw, raw
    if not signal.is_float and float(scale).is_integer() and float(offset).is_integer():
        scale, offset = int(scale), int(offset)  # as cantools does: the value stays an integer
    with np.errstate(all="ignore"):  # floats on a bus may be anything: infinities and NaN are values like others
        return raw * scale + offset, raw


def raw_of(signal: SignalLayout, words: Words) -> Numbers:
    if signal.big_endian:
        words = words.byteswap()
    above = np.uint64(64 - signal.start - signal.length)
    if signal.is_float:
        kind = "<u4" if signal.length == 32 else "<u8"
        bits = (words >> np.uint64(signal.start)).astype(kind)
        with np.errstate(invalid="ignore"):  # a NaN of any kind stays one
            return bits.view("<f4" if signal.length == 32 else "<f8").astype(np.float64)
    if signal.signed:
        return (words << above).view(np.int64) >> np.int64(64 - signal.length)
    raw = (words << above) >> np.uint64(64 - signal.length)
    return raw if signal.length == 64 else raw.view(np.int64)


def _column(values: list[Any]) -> Numbers:
    if all(type(value) is float for value in values):
        return np.array(values, np.float64)
    if all(type(value) is int and -(1 << 63) <= value < 1 << 63 for value in values):
        return np.array(values, np.int64)
    column = np.empty(len(values), object)
    column[:] = values
    return column
