"""Frames as lines of text, many at once, as columns of characters.

All frames of a message are put together at a time; whatever is unusual goes through cantools, frame by frame.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.decode.databases import UndecodableError
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.decode.error_frames import error_words
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout, SignalLayout
from fsai_vcu.diagnostics.decode.text import MessageText, ShortText, SignalText, json_value, with_unit
from fsai_vcu.diagnostics.log.candump import channel_text, hex_text, log_parts, time_text
from fsai_vcu.diagnostics.log.candump_line import log_line
from fsai_vcu.diagnostics.log.candump_line import time_text as one_time_text
from fsai_vcu.diagnostics.log.characters import Characters, Part, characters_of, matrix_of, put
from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, FD, REMOTE, Frames, Ints, LogFrame, Words

_EXTENDED_SHIFT: Final = EXTENDED_KEY.bit_length() - EXTENDED.bit_length()


class LineWriter:
    """Writes frames with their signals.

    as_json: one object per line. words: names of values instead of numbers, where the database has them. short: what
    is not 0 alone. rounded: numbers as people read them, not to the last bit as cantools has them.
    """

    def __init__(
        self,
        decoder: Decoder,
        *,
        as_json: bool = False,
        words: bool = True,
        short: bool = False,
        rounded: bool = False,
    ) -> None:
        self._decoder = decoder
        self._json = as_json
        self._words = words
        self._short = short
        self._rounded = rounded
        self._messages: dict[int, MessageText] = {}
        self._texts: dict[str, SignalText] = {}

    def block(self, frames: Frames) -> bytearray:
        """All lines of `frames`, each with its line end."""
        return self._written(frames, self._heads(frames), self._line) if len(frames) else bytearray()

    def tails(self, frames: Frames) -> list[bytes]:
        """For each frame what it says, to stand behind the frame itself; with the line end."""
        heads = np.zeros((len(frames), 0), np.uint8)
        return [bytes(line) + b"\n" for line in self._written(frames, heads, self._tail).split(b"\n")[:-1]]

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
        texts = [
            ',"message":null,"signals":{}}' if self._json else f" :: Unknown frame id {can_id} (0x{can_id:x})"
            for can_id in ids.tolist()
        ]
        return matrix_of([np.take(characters_of(texts), where, axis=0), b"\n"], len(can_ids))

    def _usual(self, layout: MessageLayout, words: Words) -> Characters:
        """What the frames of a plain message say, from their payloads."""
        text = self._messages.get(layout.key)
        if text is None:
            texts = [self._text_of(signal) for signal in layout.signals]
            text = self._messages[layout.key] = MessageText(layout, texts, as_json=self._json, short=self._short)
        parts: list[Part] = []
        for before, signal, values in zip(text.before, layout.signals, text.signals, strict=True):
            ordered = words.byteswap() if signal.big_endian else words
            parts += before.encode(), values.of(ordered >> np.uint64(signal.start))
        return matrix_of([*parts, text.end.encode()], len(words))

    def _text_of(self, signal: SignalLayout) -> SignalText:
        """Signals whose values have the same texts share them."""
        alone = signal._replace(start=0, big_endian=False, name=signal.name if self._short else "")
        key = str(alone)
        if key not in self._texts:
            self._texts[key] = (
                ShortText(alone, words=self._words, rounded=self._rounded)
                if self._short
                else SignalText(alone, as_json=self._json, words=self._words, rounded=self._rounded)
            )
        return self._texts[key]

    def _heads(self, frames: Frames) -> Characters:
        """Everything up to what a frame says: candump's line, or the object up to the message's name."""
        if not self._json:
            return matrix_of(log_parts(frames), len(frames))
        keys = frames.can_id | ((frames.flags & np.uint32(EXTENDED)) << np.uint32(_EXTENDED_SHIFT))
        distinct, where = np.unique(keys, return_inverse=True)
        ids = [
            f'","id":{key & ~EXTENDED_KEY},"extended":{json.dumps(bool(key & EXTENDED_KEY))},"data":"'
            for key in distinct.tolist()
        ]
        escaped = replace(frames, channels=[json.dumps(name)[1:-1] for name in frames.channels])
        parts: list[Part] = [b'{"t":', time_text(frames.t_ns), b',"channel":"', channel_text(escaped)]
        return matrix_of([*parts, np.take(characters_of(ids), where, axis=0), hex_text(frames), b'"'], len(frames))

    # ------------------------------------------------------------ one by one

    def _line(self, frame: LogFrame) -> str:
        if not self._json:
            return log_line(frame) + self._tail(frame)
        flags = (',"fd":true' if frame.fd else "") + (',"remote":true' if frame.remote else "")
        return (
            f'{{"t":{one_time_text(frame.t_ns)},"channel":{json.dumps(frame.channel)},"id":{frame.can_id},'
            f'"extended":{json.dumps(frame.extended)},"data":"{frame.data.hex().upper()}"{flags}{self._tail(frame)}'
        )

    def _tail(self, frame: LogFrame) -> str:
        """What stands behind an unusual frame: an error or remote frame, or one that goes through cantools."""
        layout = self._decoder.databases.layouts.get(frame.can_id | (EXTENDED_KEY if frame.extended else 0))
        if frame.error:
            words = error_words(frame.can_id, frame.data)
            if self._json:
                return f',"error":{json.dumps(words)},"message":null,"signals":{{}}}}\n'
            return f" :: error frame: {', '.join(words)}\n"
        if frame.remote:
            name = layout.name if layout else None
            if self._json:
                return f',"message":{json.dumps(name)},"signals":{{}}}}\n'
            return f" :: remote request for {name or 'an unknown frame id'}\n"
        if layout is None:
            return self._unknown(np.array([frame.can_id], np.uint32)).tobytes().decode()
        return self._careful(layout, frame.data)

    def _careful(self, layout: MessageLayout, data: bytes) -> str:
        """Messages that are not plain, and frames of the wrong length as far as they go."""
        wrong = "" if len(data) == layout.length else f"Wrong data size: {len(data)} instead of {layout.length} bytes"
        try:
            values: Mapping[str, Any] = self._decoder.databases.decoded(layout, data, choices=self._words)
        except UndecodableError as error:
            values, wrong = {}, wrong or str(error)
        units = {signal.name: signal.unit for signal in layout.signals}  # of those that are shown at all
        values = {name: value for name, value in values.items() if name in units}
        if self._json:
            signals = ",".join(f"{json.dumps(name)}:{json_value(value)}" for name, value in values.items())
            problem = f',"problem":{json.dumps(wrong)}' if wrong else ""
            return f',"message":{json.dumps(layout.name)},"signals":{{{signals}}}{problem}}}\n'
        if wrong and not values:
            return f" :: {wrong}\n"
        shown = ", ".join(f"{name}: {with_unit(value, units[name])}" for name, value in values.items())
        return f" :: {wrong + ': ' if wrong else ''}{layout.name}({shown})\n"
