"""What changed in frames: bytes of messages, and signals of any database. `now_ns` is on the frames' clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import Decoder, Numbers, SignalSeries
from fsai_vcu.diagnostics.log.frames import Frames, Ints
from fsai_vcu.diagnostics.monitor.snapshot import History
from fsai_vcu.diagnostics.monitor.state_history import LONG_NS, keys_of
from fsai_vcu.interface.units import S


def changed_bytes(frames: Frames, since_ns: int) -> dict[int, tuple[int, ...]]:
    """By key of the message: which of its first eight bytes changed after `since_ns`."""
    keys = keys_of(frames)
    order = np.argsort(keys, kind="stable")
    keys, words, t_ns = keys[order], frames.word[order], frames.t_ns[order]
    rows = np.flatnonzero((np.diff(keys) == 0) & (np.diff(words) != 0) & (t_ns[1:] > since_ns))
    flipped = (words[rows + 1] ^ words[rows]).astype("<u8").view(np.uint8).reshape(-1, 8)
    return {
        key: tuple(np.flatnonzero(flipped[keys[rows] == key].any(axis=0)).tolist())
        for key in np.unique(keys[rows]).tolist()
    }


def bytes_of(frames: Frames, key: int, now_ns: int) -> list[History]:
    """Each byte of a message."""
    rows = np.flatnonzero(keys_of(frames) == key)
    payloads = [frames.payload(row) for row in rows.tolist()]
    width = max(map(len, payloads), default=0)
    table = np.array([list(data.ljust(width, b"\0")) for data in payloads], np.int64).reshape(-1, width)
    t_ns = frames.t_ns[rows]

    def text(place: int) -> Callable[[int], str]:
        return lambda row: f"{table[row, place]:02X}"

    return [_history(f"byte {place}", t_ns, table[:, place], text(place), now_ns) for place in range(width)]


def signals_of(frames: Frames, decoder: Decoder, patterns: Sequence[str], now_ns: int) -> list[History]:
    """The signals that fit one of the patterns and were received, in the order of the databases."""
    wanted = {
        f"{layout.name}.{signal.name}": layout.name
        for layout in decoder.databases.layouts.values()
        for signal in layout.signals_like(patterns)
    }
    tables = decoder.tables(frames, set(wanted.values()))
    return [
        _signal(f"{table.layout.name}.{series.name}", series, now_ns)
        for table in tables.values()
        for series in table.series.values()
        if f"{table.layout.name}.{series.name}" in wanted and len(series.t_ns)
    ]


def _signal(name: str, series: SignalSeries, now_ns: int) -> History:
    def text(row: int) -> str:
        word = series.choices.get(int(series.raw[row])) if series.choices else None
        shown = f"{series.values[row]:.6g}" if series.values.dtype != object else str(series.values[row])
        return word or f"{shown} {series.unit}".rstrip()

    found = _history(name, series.t_ns, series.values, text, now_ns)
    recent = series.values[series.t_ns > now_ns - LONG_NS]
    if series.choices or recent.dtype == object or not found.changes:
        return found
    return replace(found, extent=f"{recent.min():.6g} … {recent.max():.6g}")


def _history(name: str, t_ns: Ints, values: Numbers, text: Callable[[int], str], now_ns: int) -> History:
    rows = np.flatnonzero(values[1:] != values[:-1]) + 1
    rows = rows[t_ns[rows] > now_ns - LONG_NS]
    last = int(rows[-1]) if len(rows) else None
    return History(
        name,
        text(len(values) - 1),
        (now_ns - int(t_ns[-1])) / S,
        len(rows),
        None if last is None else (now_ns - int(t_ns[last])) / S,
        "" if last is None else text(last - 1),
    )
