"""One wide table at a raster: every signal's last value at each instant, and how old it is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.export.tables import Column, Table, TablePart, Tables, Values
from fsai_vcu.diagnostics.log.frames import Frames, Ints

_AT_ONCE: Final = 50_000  # rows
SILENCE_NS: Final = 60_000_000_000  # nothing received for longer, and there are no rows until something is
_UNITS_NS: Final = {"us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


def raster_ns(text: str) -> int:
    """'10ms', '0.5s', '100us' in nanoseconds. Raises ValueError with one clear line."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(us|ms|s)", text.strip())
    step_ns = round(float(found[1]) * _UNITS_NS[found[2]]) if found else 0
    if step_ns < 1000:
        raise ValueError(f"'{text}' is not a raster: a raster is a time like 10ms, 0.5s or 100us")
    return step_ns


class WideTable:
    """Iterated once: its rows, some ten thousand at a time. notes: lines for people."""

    def __init__(self, tables: Tables, frames: Frames, step_ns: int) -> None:
        """Prepare the rows of `frames`, in order of time, at multiples of `step_ns`."""
        self._step_ns = step_ns
        self.notes: list[str] = []
        backwards_ns = -int(min(0, np.diff(frames.t_ns).min(initial=0)))
        if backwards_ns:
            self.notes.append(
                f"time goes back in the log, by up to {backwards_ns / 1e9:.3f} s: the rows are sorted by time"
            )
            frames = frames.only(np.argsort(frames.t_ns, kind="stable"))
        self._t_ns = frames.t_ns
        self._sources = list(tables.rows(frames))
        columns: list[Column] = []
        for table in (source.table for source in self._sources):
            columns += [replace(each, name=f"{table.name}.{each.name}", optional=True) for each in table.columns]
            columns.append(Column(f"{table.name}.age", "s", "float64", optional=True))
        about = f"last values every {step_ns / 1e6:g} ms, and their ages"
        self.table = Table("wide", tuple(columns), about=about)
        self._spans = list(self._found_spans())
        self.rows = sum(last - first + 1 for first, last in self._spans)

    def _found_spans(self) -> Iterator[tuple[int, int]]:
        """(first, last) instant of each span without a long silence, as multiples of the raster."""
        t_ns, step = self._t_ns, self._step_ns
        if not len(t_ns):
            return
        breaks = np.flatnonzero(np.diff(t_ns) > SILENCE_NS)
        if len(breaks):
            self.notes.append(f"no rows for {len(breaks)} silences of more than a minute")
        before = -1
        for first, last in zip([0, *(breaks + 1).tolist()], [*breaks.tolist(), len(t_ns) - 1], strict=True):
            begin = max(before + 1, -(-int(t_ns[first]) // step))
            end = -(-int(t_ns[last]) // step)  # the last frame is in a row too
            if begin <= end:
                yield begin, end
                before = end

    def __iter__(self) -> Iterator[TablePart]:
        for first, last in self._spans:
            for begin in range(first, last + 1, _AT_ONCE):
                instants = np.arange(begin, min(begin + _AT_ONCE, last + 1), dtype=np.int64) * self._step_ns
                values = [each for source in self._sources for each in _values(source, instants)]
                yield TablePart(self.table, instants, values)


def _values(source: TablePart, instants: Ints) -> Iterator[Values]:
    """Yield the last value that each signal had, for not every frame need have all; and the age of the last frame."""
    last = np.searchsorted(source.t_ns, instants, side="right") - 1
    rows = np.arange(len(source))
    for values in source.values:
        at = last
        if values.mask is not np.ma.nomask:
            newest = np.maximum.accumulate(np.where(values.mask, -1, rows))  # the last row with a value, at each row
            at = np.where(last < 0, -1, newest[last])
        yield _held(values.data[at], at)
    yield _held((instants - source.t_ns[last]) / 1e9, last)


def _held(numbers: npt.NDArray[Any], at: Ints) -> Values:
    return np.ma.MaskedArray(numbers, mask=at < 0 if at.min(initial=0) < 0 else np.ma.nomask)
