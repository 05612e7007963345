"""Memory of a view: the last seconds of a bus whole, of all before them what shows states, and what changed in it.

The whole of a day on a bus does not fit, and is not needed: states change seldom. So of 0x520, 0x510, 0x524 and 0x525
the memory keeps those frames at which a state in them changed, those on both sides of a pause, and two a second
besides, which show that there was no pause. Of every other message it keeps the newest frame.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import Decoder, Numbers, SignalSeries
from fsai_vcu.diagnostics.explain.signals import STATUS
from fsai_vcu.diagnostics.log.frames import (
    ERROR,
    EXTENDED,
    REMOTE,
    Frames,
    Ints,
    LogFrame,
    Words,
    frames_of,
    joined,
    straightened,
)
from fsai_vcu.diagnostics.monitor.snapshot import History
from fsai_vcu.diagnostics.statistics.measure import keys_of
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.messages import AiStatus, VcuBrake, VcuStatus
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.interface.specification import COMMS_LOST_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S

WINDOW_NS: Final = 3 * S  # enough for a rate
LONG_NS: Final = 30 * S  # as far as the rules look back that find the cause of an emergency brake
HEARTBEAT_NS: Final = 500 * MS  # under the second without 0x520 that means a car switched off
MOST_STATES: Final = 200_000  # rows: a day of heartbeats of four messages


def _turning(words: Words) -> Words:
    """0x525: which of the four wheels turn."""
    wheels = words.astype("<u8").view("<u2").reshape(-1, 4)
    return np.packbits(wheels >= STANDING_RPM, axis=1, bitorder="little")[:, 0].astype(np.uint64)


@cache
def _states_of() -> dict[int, Callable[[Words], Words]]:
    """Return by identifier what of its payloads is a state, in any revision."""
    codec = Codec(list(REVISIONS.values())[-1])

    def only(mask: int) -> Callable[[Words], Words]:
        return lambda words: words & np.uint64(mask)

    handshake = codec.mask(VcuStatus, "handshake")  # toggles all the time
    return {
        STATUS: only(~handshake & 0xFFFF_FFFF_FFFF_FFFF),
        0x510: only(codec.mask(AiStatus, "estop_request", "mission_status", "direction", "lap_counter")),
        0x524: only(codec.mask(VcuBrake, "brake_status", "ebs_status")),
        0x525: _turning,
    }


class Memory:
    """Frames of one bus, the newest last. Times never go back: where the frames' clock does, what follows is moved on.

    `frames` counts what was received, `begin_ns` and `newest_ns` are the times of the first and the newest frame;
    `newest`: by key (see layouts.py) the newest frame of each message, however old.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.begin_ns: int | None = None
        self.newest_ns: int | None = None
        self.first_ns: dict[int, int] = {}
        self._moved_ns = 0
        self._window: list[Frames] = []
        self._states: list[Frames] = []
        self.newest: dict[int, LogFrame] = {}
        self._channels: list[str] = []

    def copy(self) -> Memory:
        """Return a copy of what is remembered now, for frames with times as `update` returned them."""
        found = copy.copy(self)
        found._moved_ns = 0
        found.first_ns, found.newest = dict(self.first_ns), dict(self.newest)
        found._window, found._states = list(self._window), list(self._states)
        return found

    def update(self, frames: Frames) -> Frames:
        """Take in more frames, in the order in which they came, and return them with times that never go back."""
        if not len(frames):
            return frames
        t_ns, back_ns = straightened(frames.t_ns + self._moved_ns, self.newest_ns)
        self._moved_ns += int(back_ns.sum())
        frames = frames.at(t_ns)
        self.frames += len(frames)
        if self.begin_ns is None:
            self.begin_ns = int(t_ns[0])
        self.newest_ns = int(t_ns[-1])
        self._channels = list(frames.channels)
        self._window.append(frames)
        oldest_ns = self.newest_ns - LONG_NS
        while int(self._window[0].t_ns[-1]) < oldest_ns:
            del self._window[0]
        self._keep_states(frames)
        keys = keys_of(frames)
        found, first = np.unique(keys, return_index=True)
        _, last = np.unique(keys[::-1], return_index=True)
        for key, row, back in zip(found.tolist(), first.tolist(), last.tolist(), strict=True):
            if key >= 0:
                self.first_ns.setdefault(key, int(t_ns[row]))
                self.newest[key] = frames.frame(len(frames) - 1 - back)
        return frames

    def _keep_states(self, frames: Frames) -> None:
        """Keep those of the frames at which a state changed, and those that show that there was no pause."""
        plain = (frames.flags & (ERROR | EXTENDED | REMOTE)) == 0
        for can_id, states_of in _states_of().items():
            rows: Ints = np.flatnonzero(plain & (frames.can_id == can_id))
            if not len(rows):
                continue
            before = self.newest.get(can_id)
            of_message = frames.only(rows)
            if before is not None:
                of_message = joined([frames_of([before], list(frames.channels)), of_message])
            beats = of_message.t_ns // HEARTBEAT_NS
            pauses = np.diff(of_message.t_ns) > COMMS_LOST_NS
            kept = np.full(len(of_message), before is None)
            kept[1:] = (np.diff(states_of(of_message.word)) != 0) | (np.diff(beats) != 0) | pauses
            kept[:-1] |= pauses
            if kept.any():
                self._states.append(of_message.only(kept))

    def window(self, now_ns: int, length_ns: int = WINDOW_NS) -> Frames:
        """All frames of the last seconds before `now_ns`, at most LONG_NS of them."""
        whole = joined(part for part in self._window if int(part.t_ns[-1]) > now_ns - length_ns)
        return whole.only(whole.t_ns > now_ns - length_ns)

    def condensed(self, window: Frames) -> Frames:
        """All that is remembered, in the order of time: `window` whole, and before it what shows states."""
        states = joined(self._states)
        if len(states) > MOST_STATES:
            states = states.only(np.arange(len(states) // 4, len(states), dtype=np.int64))
        self._states = [states]
        begin_ns = int(window.t_ns[0]) if len(window) else np.iinfo(np.int64).max
        newest = frames_of((frame for frame in self.newest.values() if frame.t_ns < begin_ns), list(self._channels))
        before = joined([states.only(states.t_ns < begin_ns), newest])
        order = np.lexsort((keys_of(before), before.t_ns))
        before = before.only(order)
        again = (np.diff(before.t_ns, prepend=-1) == 0) & (np.diff(keys_of(before), prepend=-2) == 0)
        return joined([before.only(~again), window])


# ---------------------------------------------------------------- what changed


def changed_bytes(frames: Frames, since_ns: int) -> dict[int, tuple[int, ...]]:
    """Return by key of the message which of its first eight bytes changed after `since_ns`."""
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
    table = np.array([list(data.ljust(width, b"\0")) for data in payloads], np.int64).reshape(len(rows), width)
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
