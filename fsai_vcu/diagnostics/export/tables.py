"""Frames as tables: one for each message of each bus, with typed columns that every format can be made of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import Decoder, MessageTable
from fsai_vcu.diagnostics.decode.layouts import MessageLayout, SignalLayout
from fsai_vcu.diagnostics.log.frames import ERROR, REMOTE, Frames, Ints

SINCE: Final = "time since first frame"
"""Name of the column that counts as explain, report and --from do; in s."""
Kind = Literal["int64", "uint64", "float64", "object"]
Values: TypeAlias = "np.ma.MaskedArray[Any, np.dtype[Any]]"  # numpy 1.21 cannot evaluate it
"""The values of a column, one for each row; masked where a row has none."""

_INT64: Final = 1 << 63
_UNKNOWN, _WRONG_LENGTH = "of unknown ids", "of the wrong length"
_NO_DATA, _UNDECODABLE = "error or remote frames", "whose bits mean nothing"


@dataclass(frozen=True, slots=True)
class Column:
    """A signal as a column. `kind` is of numpy and holds every value it can have: object, integers beyond 64 bits.

    optional: a row may have no value. choices: the database's words, by value.
    """

    name: str
    unit: str
    kind: Kind
    optional: bool = False
    choices: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Table:
    """Description of a table, known before its rows. `about` is for people. `channel` is the bus, "" for all."""

    name: str
    columns: tuple[Column, ...]
    channel: str = ""
    about: str = ""


@dataclass(frozen=True, slots=True)
class TablePart:
    """Some rows of a table. t_ns: times of the log's clock."""

    table: Table
    t_ns: Ints
    values: Sequence[Values]

    def __len__(self) -> int:
        return len(self.t_ns)


def kind_of(signal: SignalLayout) -> Kind:
    """The type of a signal's physical values, as cantools reckons them."""
    if signal.is_float or not (float(signal.scale).is_integer() and float(signal.offset).is_integer()):
        return "float64"
    most = 1 << (signal.length - 1 if signal.signed else signal.length)
    if most * abs(int(signal.scale)) + abs(int(signal.offset)) <= _INT64:
        return "int64"
    plain = signal.scale == 1 and signal.offset == 0
    return "uint64" if plain and signal.length == 64 and not signal.signed else "object"


def table_of(layout: MessageLayout, name: str, channel: str) -> Table:
    columns = []
    for signal in layout.signals:
        choices = signal.choices if signal.scale == 1 and signal.offset == 0 else {}
        # A frame of a message that is not plain (multiplexed, say) need not have every signal.
        columns.append(Column(signal.name, signal.unit, kind_of(signal), not layout.plain, choices))
    senders = f" from {', '.join(layout.senders)}" if layout.senders else ""
    digits = 8 if layout.extended else 3
    return Table(name, tuple(columns), channel, f"{layout.name}, id 0x{layout.can_id:0{digits}X}{senders}")


def values_in(decoded: MessageTable, column: Column) -> Values:
    """One value for each row of `decoded`."""
    series = decoded.series[column.name]
    if len(series.rows) == len(decoded.rows):
        return np.ma.MaskedArray(series.values.astype(column.kind, copy=False))
    values = np.ma.MaskedArray(np.zeros(len(decoded.rows), column.kind), mask=True)
    values[np.searchsorted(decoded.rows, series.rows)] = series.values
    return values


class Tables:
    """The tables of a log as they come up: one for each message, of each bus where there are several."""

    def __init__(self, decoder: Decoder, *, several_buses: bool) -> None:
        self.left_out = Counter(dict.fromkeys((_UNKNOWN, _WRONG_LENGTH, _NO_DATA, _UNDECODABLE), 0))
        """Frames that are in no table, and why."""
        self._decoder = decoder
        self._several = several_buses
        self._tables: dict[tuple[str, int], Table] = {}

    def rows(self, frames: Frames) -> Iterator[TablePart]:
        """The frames by message, each in the order of the log."""
        for layout, rows in self._decoder.by_message(frames):
            if layout is None:
                self.left_out[_UNKNOWN] += len(rows)
                continue
            channels = frames.channel[rows]
            for number in np.unique(channels).tolist():
                decoded = self._decoder.table(layout, frames, rows[channels == number])
                self.left_out[_WRONG_LENGTH] += len(decoded.wrong_length)
                table = self._table(layout, frames.channels[number])
                found = TablePart(table, decoded.t_ns, [values_in(decoded, column) for column in table.columns])
                if not layout.plain and layout.signals:
                    found = self._with_values(found)
                if len(found):
                    yield found
        self.left_out[_NO_DATA] += int(((frames.flags & (ERROR | REMOTE)) != 0).sum())

    def _with_values(self, rows: TablePart) -> TablePart:
        """Return the rows without the frames of which not one signal could be decoded."""
        known = ~np.logical_and.reduce([np.ma.getmaskarray(values) for values in rows.values])
        self.left_out[_UNDECODABLE] += int((~known).sum())
        return TablePart(rows.table, rows.t_ns[known], [values[known] for values in rows.values])

    def _table(self, layout: MessageLayout, channel: str) -> Table:
        key = (channel if self._several else "", layout.key)
        table = self._tables.get(key)
        if table is None:
            name = f"{channel}.{layout.name}" if self._several else layout.name
            if any(name == other.name for other in self._tables.values()):  # two databases may give it to two ids
                name = f"{name}_{layout.can_id:X}"
            table = self._tables[key] = table_of(layout, name, channel)
        return table
