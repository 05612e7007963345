"""Frames as lines of text, fast: for people as `cantools decode --single-line` writes them, and as JSON.

A payload that comes again is written once and copied; a value that comes again is turned into digits once. Signals of
plain messages are put together as columns of characters, all frames of a message at a time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.decode.decoder import Decoder, UndecodableError, values_of
from fsai_vcu.diagnostics.decode.error_frames import error_words
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout, SignalLayout
from fsai_vcu.diagnostics.decode.quick_lines import one_line, unknown
from fsai_vcu.diagnostics.log.candump import (
    Part,
    assembled,
    channel_text,
    hex_text,
    log_lines,
    time_text,
    unusual_rows,
)
from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, REMOTE, Frames, Ints, Words

_EXTENDED_SHIFT: Final = EXTENDED_KEY.bit_length() - EXTENDED.bit_length()
_TABLE_BITS: Final = 10  # a signal of up to so many bits has a table of its values' texts

Text = npt.NDArray[np.bytes_]


class LineWriter:
    """Writes frames with their signals.

    as_json: one object per line. words: names of values instead of numbers, where the database has them.
    """

    def __init__(self, decoder: Decoder, *, as_json: bool = False, words: bool = True) -> None:
        self._decoder = decoder
        self._json = as_json
        self._words = words
        self._writers: dict[int, _MessageWriter] = {}

    def block(self, frames: Frames) -> bytes:
        """All lines of `frames`, each with its line end."""
        if not len(frames):
            return b""
        both: list[bytes] = [b""] * (2 * len(frames))
        both[0::2] = self._json_heads(frames) if self._json else log_lines(frames)
        both[1::2] = self.tails(frames)
        return b"".join(both)

    def tails(self, frames: Frames) -> list[bytes]:
        """For each frame what it says, to stand behind the frame itself; with the line end."""
        tails = np.empty(len(frames), object)
        for layout, rows in self._decoder.by_message(frames):
            if layout is None:
                self._unknown(frames, rows, tails)
                continue
            right = frames.length[rows] == layout.length
            if layout.plain:
                if not right.all():
                    self._carefully(layout, frames, rows[~right], tails)
                    rows = rows[right]
                if not len(rows):
                    continue
                words, where = np.unique(frames.word[rows], return_inverse=True)
                texts = np.empty(len(words), object)
                texts[:] = self._writer(layout).texts(words)
                tails[rows] = texts[where]
            else:
                self._carefully(layout, frames, rows, tails)
        for row in np.flatnonzero(frames.flags & (ERROR | REMOTE)).tolist():
            tails[row] = self._special(frames, row)
        return tails.tolist()

    def _writer(self, layout: MessageLayout) -> _MessageWriter:
        writer = self._writers.get(layout.key)
        if writer is None:
            writer = self._writers[layout.key] = _MessageWriter(layout, as_json=self._json, words=self._words)
        return writer

    def _json_heads(self, frames: Frames) -> list[bytes]:
        """Everything of the object up to the message's name."""
        keys = frames.can_id | ((frames.flags & np.uint32(EXTENDED)) << np.uint32(_EXTENDED_SHIFT))
        distinct, where = np.unique(keys, return_inverse=True)
        ids = [
            f'","id":{key & ~EXTENDED_KEY},"extended":{json.dumps(bool(key & EXTENDED_KEY))},"data":"'.encode()
            for key in distinct.tolist()
        ]
        parts: list[Part] = [b'{"t":', time_text(frames.t_ns), b',"channel":"', channel_text(_escaped(frames))]
        parts += [_matrix(np.array(ids))[where], hex_text(frames)]
        heads = assembled([*parts, b'"'], len(frames))
        for row in unusual_rows(frames):
            frame = frames.frame(row)
            head = heads[row].rpartition(b',"data":')[0]
            heads[row] = head + b',"data":"' + frame.data.hex().upper().encode() + b'"'
            if frame.fd:
                heads[row] += b',"fd":true'
            if frame.remote:
                heads[row] += b',"remote":true'
        return heads

    def _unknown(self, frames: Frames, rows: Ints, tails: npt.NDArray[np.object_]) -> None:
        """No database describes these."""
        if self._json:
            tails[rows] = b',"message":null,"signals":{}}\n'
            return
        ids, where = np.unique(frames.can_id[rows], return_inverse=True)
        texts = np.empty(len(ids), object)
        texts[:] = [unknown(can_id) for can_id in ids.tolist()]
        tails[rows] = texts[where]

    def _carefully(self, layout: MessageLayout, frames: Frames, rows: Ints, tails: npt.NDArray[np.object_]) -> None:
        """One by one through cantools: unusual messages, and frames of the wrong length as far as they go."""
        known: dict[bytes, bytes] = {}
        for row in rows.tolist():
            data = frames.payload(row)
            text = known.get(data)
            if text is None:
                text = known[data] = self._careful_text(layout, data).encode()
            tails[row] = text

    def _careful_text(self, layout: MessageLayout, data: bytes) -> str:
        wrong = "" if len(data) == layout.length else f"Wrong data size: {len(data)} instead of {layout.length} bytes"
        try:
            values: Mapping[str, Any] = self._decoder.careful(layout, data, choices=self._words)
        except UndecodableError as error:
            values, wrong = {}, wrong or str(error)
        if self._json:
            signals = ",".join(f"{json.dumps(name)}:{_json_value(value)}" for name, value in values.items())
            problem = f',"problem":{json.dumps(wrong)}' if wrong else ""
            return f',"message":{json.dumps(layout.name)},"signals":{{{signals}}}{problem}}}\n'
        units = {signal.name: signal.unit for signal in layout.signals}
        shown = ", ".join(f"{name}: {_with_unit(value, units[name])}" for name, value in values.items())
        if wrong and not values:
            return f" :: {wrong}\n"
        return f" :: {wrong + ': ' if wrong else ''}{layout.name}({shown})\n"

    def _special(self, frames: Frames, row: int) -> bytes:
        """Error and remote frames."""
        frame = frames.frame(row)
        if frame.error:
            words = error_words(frame.can_id, frame.data)
            if self._json:
                return f',"error":{json.dumps(words)},"message":null,"signals":{{}}}}\n'.encode()
            return f" :: error frame: {', '.join(words)}\n".encode()
        layout = self._decoder.layout_of(frame.can_id, frame.extended)
        if self._json:
            return f',"message":{json.dumps(layout.name if layout else None)},"signals":{{}}}}\n'.encode()
        return f" :: remote request for {layout.name if layout else 'an unknown frame id'}\n".encode()


class _MessageWriter:
    """Texts of the payloads of one plain message."""

    def __init__(self, layout: MessageLayout, *, as_json: bool, words: bool) -> None:
        self._layout = layout
        self._signals = [_SignalWriter(signal, as_json=as_json, words=words) for signal in layout.signals]
        if as_json:
            self._begin = f',"message":{json.dumps(layout.name)},"signals":{{'
            self._end = "}}\n"
            self._names = [f"{json.dumps(signal.name)}:" for signal in layout.signals]
            self._comma = ","
        else:
            self._begin = f" :: {layout.name}("
            self._end = ")\n"
            self._names = [f"{signal.name}: " for signal in layout.signals]
            self._comma = ", "

    def texts(self, words: Words) -> list[bytes]:
        parts: list[Part] = []
        before = self._begin
        for name, signal in zip(self._names, self._signals, strict=True):
            parts.append((before + name).encode())
            parts.append(_matrix(signal.texts(words)))
            before = signal.behind + self._comma
        behind = self._signals[-1].behind if self._signals else ""
        if not self._signals:
            return [(self._begin + self._end).encode()] * len(words)
        return [line + b"\n" for line in assembled([*parts, (behind + self._end[:-1]).encode()], len(words))]


class _SignalWriter:
    """Texts of the values of one signal; those of few bits are remembered."""

    def __init__(self, layout: SignalLayout, *, as_json: bool, words: bool) -> None:
        self._layout = layout
        self._json = as_json
        self._choices = layout.choices if words else {}
        unit = "" if as_json or not layout.unit else f" {one_line(layout.unit)}"
        # A word has no unit: where there can be words, the unit belongs to the single text.
        self.behind = "" if self._choices else unit
        self._unit = unit if self._choices else ""
        self._table: Text | None = None
        if layout.length <= _TABLE_BITS and not layout.is_float:
            self._table = np.zeros(1 << layout.length, "S1")
            self._known = np.zeros(1 << layout.length, np.bool_)

    def texts(self, words: Words) -> Text:
        """One text for each payload, all of one width, NUL behind."""
        if self._table is None:
            if self._layout.is_float:
                return self._written(words)
            distinct, where = np.unique(_bits(self._layout, words), return_inverse=True)
            return self._written(distinct << np.uint64(self._layout.start))[where]
        bits = _bits(self._layout, words).view(np.int64)
        known = self._known[bits]
        if not known.all():
            fresh = np.unique(bits[~known])
            new = self._written(fresh.view(np.uint64) << np.uint64(self._layout.start))
            if new.dtype.itemsize > self._table.dtype.itemsize:
                self._table = self._table.astype(new.dtype)
            self._table[fresh] = new
            self._known[fresh] = True
        return self._table[bits]

    def _written(self, words: Words) -> Text:
        values, raw = values_of(self._layout, words)
        if self._choices or (self._json and values.dtype.kind == "f" and not np.isfinite(values).all()):
            pairs = zip(values.tolist(), raw.tolist(), strict=True)
            return np.array([self._one(value, number).encode() for value, number in pairs])
        return np.array("\n".join(map(repr, values.tolist())).encode().split(b"\n"))

    def _one(self, value: float, raw: float) -> str:
        word = self._choices.get(int(raw)) if self._choices else None
        if self._json:
            return _json_value(value if word is None else word)
        return f"{value}{self._unit}" if word is None else one_line(word)


def _bits(signal: SignalLayout, words: Words) -> Words:
    """The bits of a signal as they are, unsigned."""
    return (words << np.uint64(64 - signal.start - signal.length)) >> np.uint64(64 - signal.length)


def _matrix(texts: Text) -> npt.NDArray[np.uint8]:
    return texts.view(np.uint8).reshape(len(texts), texts.dtype.itemsize)


def _escaped(frames: Frames) -> Frames:
    """The same frames with names of channels that can stand in JSON."""
    names = [json.dumps(name)[1:-1] for name in frames.channels]
    return replace(frames, channels=names)


def _json_value(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "null"  # JSON has no word for it
    if isinstance(value, int | float):
        return repr(value)
    return json.dumps(str(value))


def _with_unit(value: Any, unit: str) -> str:
    return f"{value} {unit}" if unit and isinstance(value, int | float) else str(value)
