"""One wide table at a raster: every signal's last value at each instant, and how old it is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import Decoder, MessageTable
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
SILENCE_NS: Final = 60_000_000_000  # nothing received for longer, and there are no rows until something is
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
    """One message of one bus, in order of time. columns: its signals' and its age's."""

    decoded: MessageTable
    columns: tuple[Column, ...]


class WideTable:
    """Iterated once: its rows, some ten thousand at a time."""

    def __init__(self, decoder: Decoder, frames: Frames, step_ns: int, left_out: LeftOut) -> None:
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
            for bus in buses:
                ours = rows[frames.channel[rows] == list(frames.channels).index(bus)]
                decoded = decoder.table(layout, frames, ours)
                left_out.wrong_length += len(decoded.wrong_length)
                if len(decoded.rows):
                    name = f"{bus}.{layout.name}" if len(buses) > 1 else layout.name
                    columns = [column_of(signal, optional=True, prefix=f"{name}.") for signal in layout.signals]
                    age = Column(f"{name}.age", "s", "float64", optional=True)
                    self._sources.append(_Source(decoded, (*columns, age)))
        self.table = Table(
            "wide",
            tuple(column for source in self._sources for column in source.columns),
            about=f"last values every {step_ns / 1e6:g} ms, and their ages",
        )
        self.silences = 0
        self._spans = list(self._found_spans())
        self.rows = sum(last - first + 1 for first, last in self._spans)

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
                values = [each for source in self._sources for each in _values(source, instants)]
                yield Rows(self.table, instants, values)


def _values(source: _Source, instants: Ints) -> Iterator[Values]:
    """Of each signal the last value it had, for not every frame need have all; and the age of the last frame."""
    decoded = source.decoded
    newest: Ints = np.zeros(0, np.int64)
    times: Ints | None = None
    for signal, column in zip(decoded.layout.signals, source.columns, strict=False):
        series = decoded.series[signal.name]
        if times is not series.t_ns:  # signals that are in every frame share their times
            times = series.t_ns
            newest = np.searchsorted(times, instants, side="right") - 1
        known = newest >= 0
        numbers = np.zeros(len(instants), DTYPES[column.kind])
        numbers[known] = series.values[newest[known]]
        yield _held(numbers, known)
    newest = np.searchsorted(decoded.t_ns, instants, side="right") - 1
    yield _held((instants - decoded.t_ns[np.maximum(newest, 0)]) / 1e9, newest >= 0)


def _held(numbers: Numbers, known: Mask) -> Values:
    return Values(numbers, None if known.all() else known)
