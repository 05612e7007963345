"""One wide table at a raster: every signal's last value at each instant, and how old it is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import Decoder, MessageTable
from fsai_vcu.diagnostics.decode.layouts import MessageLayout
from fsai_vcu.diagnostics.export.tables import (
    DTYPES,
    Column,
    LeftOut,
    Numbers,
    Rows,
    Table,
    Values,
    buses_in,
    column_of,
)
from fsai_vcu.diagnostics.log.frames import ERROR, REMOTE, Frames, Ints, Mask

_AT_ONCE: Final = 50_000  # rows
SILENCE_NS: Final = 60_000_000_000  # nothing heard for longer, and there are no rows until something is heard again
_UNITS_NS: Final = {"us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


def raster_ns(text: str) -> int:
    """'10ms', '0.5s', '100us' in nanoseconds. Raises ValueError with one clear line."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(us|ms|s)", text.strip())
    step_ns = round(float(found[1]) * _UNITS_NS[found[2]]) if found else 0
    if step_ns < 1000:
        raise ValueError(f"no raster: '{text}'; a raster is a time like 10ms, 0.5s or 100us")
    return step_ns


@dataclass(frozen=True, slots=True)
class _Source:
    """One message of one bus. rows: its frames in order of time."""

    layout: MessageLayout
    rows: Ints
    t_ns: Ints
    columns: tuple[Column, ...]
    whole: MessageTable | None  # of a message that is not plain: signals may come in turns, so all frames count


class WideTable:
    """Iterated once: its rows, some ten thousand at a time."""

    def __init__(self, decoder: Decoder, frames: Frames, step_ns: int, left_out: LeftOut) -> None:
        self._decoder = decoder
        self._step_ns = step_ns
        self.backwards_ns = -int(min(0, np.diff(frames.t_ns).min(initial=0)))
        """By how much time once went back in the log. The rows are in order of time all the same."""
        if self.backwards_ns:
            frames = frames.only(np.argsort(frames.t_ns, kind="stable"))
        self._frames = frames
        left_out.no_data += int(((frames.flags & (ERROR | REMOTE)) != 0).sum())
        buses = buses_in(frames)
        self._sources: list[_Source] = []
        for layout, rows in decoder.by_message(frames):
            if layout is None:
                left_out.unknown += len(rows)
                continue
            right = frames.length[rows] == layout.length
            left_out.wrong_length += int((~right).sum())
            rows = rows[right]
            for bus in buses:
                ours = rows[frames.channel[rows] == list(frames.channels).index(bus)]
                if len(ours):
                    name = f"{bus}.{layout.name}" if len(buses) > 1 else layout.name
                    self._sources.append(self._source(layout, name, ours))
        self.table = Table(
            "wide",
            tuple(column for source in self._sources for column in source.columns),
            about=f"last values every {step_ns / 1e6:g} ms, and their ages",
        )
        self.silences = 0
        self._spans = list(self._found_spans())
        self.rows = sum(last - first + 1 for first, last in self._spans)

    def _source(self, layout: MessageLayout, name: str, rows: Ints) -> _Source:
        columns = tuple(column_of(signal, optional=True, prefix=f"{name}.") for signal in layout.signals)
        age = Column(f"{name}.age", "s", "float64", optional=True)
        whole = None if layout.plain else self._decoder.table(layout, self._frames, rows)
        return _Source(layout, rows, self._frames.t_ns[rows], (*columns, age), whole)

    def _found_spans(self) -> Iterator[tuple[int, int]]:
        """(first, last) instant of each span without a long silence, as multiples of the raster."""
        t_ns, step = self._frames.t_ns, self._step_ns
        if not len(t_ns):
            return
        breaks = np.flatnonzero(np.diff(t_ns) > SILENCE_NS)
        self.silences = len(breaks)
        before = -1
        for first, last in zip([0, *(breaks + 1).tolist()], [*breaks.tolist(), len(t_ns) - 1], strict=True):
            begin = max(before + 1, -(-int(t_ns[first]) // step))
            end = -(-int(t_ns[last]) // step)  # the last frame is in a row too
            if begin <= end:
                yield begin, end
                before = end

    def __iter__(self) -> Iterator[Rows]:
        for first, last in self._spans:
            for begin in range(first, last + 1, _AT_ONCE):
                instants = np.arange(begin, min(begin + _AT_ONCE, last + 1), dtype=np.int64) * self._step_ns
                values = [each for source in self._sources for each in self._values(source, instants)]
                yield Rows(self.table, instants, values)

    def _values(self, source: _Source, instants: Ints) -> Iterator[Values]:
        newest = np.searchsorted(source.t_ns, instants, side="right") - 1
        known = newest >= 0
        if source.whole is not None:
            yield from self._held_one_by_one(source, source.whole, instants)
        else:
            # Only the frames that are somebody's last are taken apart.
            distinct, where = np.unique(np.maximum(newest, 0), return_inverse=True)
            decoded = self._decoder.table(source.layout, self._frames, source.rows[distinct])
            for signal, column in zip(source.layout.signals, source.columns, strict=False):
                numbers = decoded.series[signal.name].values.astype(DTYPES[column.kind], copy=False)
                yield _held(numbers[where], known)
        yield _held((instants - source.t_ns[np.maximum(newest, 0)]) / 1e9, known)

    def _held_one_by_one(self, source: _Source, whole: MessageTable, instants: Ints) -> Iterator[Values]:
        for signal, column in zip(source.layout.signals, source.columns, strict=False):
            series = whole.series[signal.name]
            newest = np.searchsorted(series.t_ns, instants, side="right") - 1
            numbers = np.zeros(len(instants), DTYPES[column.kind])
            known = newest >= 0
            numbers[known] = series.values[newest[known]]
            yield _held(numbers, known)


def _held(numbers: Numbers, known: Mask) -> Values:
    return Values(numbers, None if known.all() else known)
