"""Frames as lines of text, many at once: what text.py writes one by one, as columns of characters.

A signal of a plain message has a table with the text of each of its values, filled as they come up. All frames of a
message are put together at a time; whatever is unusual is left to text.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Lock
from typing import Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.decode.decoder import Decoder, raw_of
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout
from fsai_vcu.diagnostics.decode.text import FrameText, SignalText
from fsai_vcu.diagnostics.log.candump import channel_text, hex_text, log_parts, time_text
from fsai_vcu.diagnostics.log.characters import Characters, Part, matrix_of, put
from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, FD, REMOTE, Frames, Ints, LogFrame, Words

_EXTENDED_SHIFT: Final = EXTENDED_KEY.bit_length() - EXTENDED.bit_length()
_SMALL: Final = 256  # so many values are all learned at once
_TABLE_BITS: Final = 16  # a signal of up to so many bits has a table of its values' texts


class LineWriter:
    """Writes frames with their signals, in several threads at once if need be.

    as_json: one object per line. words: names of values instead of numbers, where the database has them.
    """

    def __init__(self, decoder: Decoder, *, as_json: bool = False, words: bool = True) -> None:
        self._decoder = decoder
        self._text = FrameText(decoder.databases, as_json=as_json, words=words)
        self._tables: dict[str, _Texts] = {}

    def block(self, frames: Frames) -> bytearray:
        """All lines of `frames`, each with its line end."""
        return self._written(frames, self._heads(frames), self._text.line) if len(frames) else bytearray()

    def tails(self, frames: Frames) -> list[bytes]:
        """For each frame what it says, to stand behind the frame itself; with the line end."""
        heads = np.zeros((len(frames), 0), np.uint8)
        return [bytes(line) + b"\n" for line in self._written(frames, heads, self._text.tail).split(b"\n")[:-1]]

    def _written(self, frames: Frames, heads: Characters, singly: Callable[[LogFrame], str]) -> bytearray:
        """Each frame's head and what it says; `singly` writes both for a frame that is unusual."""
        parts: list[tuple[Ints, Characters]] = []
        unusual = frames.flags & (ERROR | REMOTE | FD) != 0
        for layout, rows in self._decoder.by_message(frames):
            rows = rows[~unusual[rows]]
            if layout is None:
                parts.append((rows, self._unknown(frames.can_id[rows])))
                continue
            usual = (frames.length[rows] == layout.length) & layout.plain
            unusual[rows[~usual]] = True
            rows = rows[usual]
            parts.append((rows, self._usual(layout, frames.word[rows])))
        widths = np.zeros(len(frames), np.int64)
        for rows, tails in parts:
            widths[rows] = heads.shape[1] + tails.shape[1]
        lines = [(row, singly(frames.frame(row)).encode()) for row in np.flatnonzero(unusual).tolist()]
        for row, line in lines:
            widths[row] = max(heads.shape[1], len(line))
        ends = np.cumsum(widths)
        begins = ends - widths
        out = bytearray(int(ends[-1]) if len(ends) else 0)
        put(out, begins, heads)
        for rows, tails in parts:
            put(out, begins[rows] + heads.shape[1], tails)
        for row, line in lines:
            out[begins[row] : ends[row]] = line.ljust(widths[row], b"\0")
        return out.translate(None, b"\0")

    def _unknown(self, can_ids: npt.NDArray[np.uint32]) -> Characters:
        ids, where = np.unique(can_ids, return_inverse=True)
        return np.take(_characters([self._text.unknown(can_id)[:-1] for can_id in ids.tolist()], "\n"), where, axis=0)

    def _usual(self, layout: MessageLayout, words: Words) -> Characters:
        """What the frames of a plain message say, from their payloads."""
        text = self._text.message(layout)
        parts: list[Part] = []
        for before, signal in zip(text.before, text.signals, strict=True):
            table = self._tables.get(signal.kind) or self._tables.setdefault(signal.kind, _Texts(signal))
            ordered = words.byteswap() if signal.layout.big_endian else words
            values = table.of(ordered >> np.uint64(signal.layout.start))
            parts += before.encode(), values
        return matrix_of([*parts, text.end.encode()], len(words))

    def _heads(self, frames: Frames) -> Characters:
        """Everything up to what a frame says: candump's line, or the object up to the message's name."""
        if not self._text.as_json:
            return matrix_of(log_parts(frames), len(frames))
        keys = frames.can_id | ((frames.flags & np.uint32(EXTENDED)) << np.uint32(_EXTENDED_SHIFT))
        distinct, where = np.unique(keys, return_inverse=True)
        ids = [
            f'","id":{key & ~EXTENDED_KEY},"extended":{json.dumps(bool(key & EXTENDED_KEY))},"data":"'
            for key in distinct.tolist()
        ]
        escaped = replace(frames, channels=[json.dumps(name)[1:-1] for name in frames.channels])
        parts: list[Part] = [b'{"t":', time_text(frames.t_ns), b',"channel":"', channel_text(escaped)]
        return matrix_of([*parts, np.take(_characters(ids), where, axis=0), hex_text(frames), b'"'], len(frames))


class _Texts:
    """The texts of all values of one kind of signal."""

    def __init__(self, signal: SignalText) -> None:
        self._signal = signal
        self._layout = signal.layout._replace(start=0, big_endian=False)
        self._lock = Lock()
        values = 1 << self._layout.length if self._layout.length <= _TABLE_BITS else 0
        self._table: Characters = np.zeros((values, 1), np.uint8)  # by the bits of a value
        self._known = np.zeros(values, np.bool_)
        self._unknown = True  # whether a value is

    def of(self, words: Words) -> Characters:
        """A row of characters for the lowest bits of each word, NUL behind."""
        bits = (words & np.uint64((1 << self._layout.length) - 1)).view(np.int64)
        if not len(self._known):
            distinct, where = np.unique(bits, return_inverse=True)
            return np.take(self._written(distinct), where, axis=0)
        if self._unknown:
            known = np.take(self._known, bits)
            if not known.all():
                with self._lock:
                    self._learn(np.unique(bits[~known]) if len(self._known) > _SMALL else np.arange(len(self._known)))
        return np.take(self._table, bits, axis=0)

    def _learn(self, fresh: Ints) -> None:
        new = self._written(fresh)
        if new.shape[1] > self._table.shape[1]:
            self._table = np.pad(self._table, ((0, 0), (0, new.shape[1] - self._table.shape[1])))
        self._table[fresh, : new.shape[1]] = new
        self._known[fresh] = True  # last: others look there without the lock
        self._unknown = not self._known.all()

    def _written(self, bits: Ints) -> Characters:
        return _characters(self._signal.texts(raw_of(self._layout, bits.view(np.uint64)).tolist()))


def _characters(texts: Sequence[str], end: str = "") -> Characters:
    """One text and `end` a row, NUL behind."""
    array = np.array([text + end.encode() for text in "\n".join(texts).encode().split(b"\n")])
    return array.view(np.uint8).reshape(len(array), -1)
