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
from fsai_vcu.diagnostics.log.characters import Part, length_of, put_parts, texts_of
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
        """Make a writer of `decoder`'s messages; the class says what the options do."""
        self._decoder = decoder
        self._json = as_json
        self._words = words
        self._short = short
        self._rounded = rounded
        self._messages: dict[int, MessageText] = {}
        self._texts: dict[str, SignalText] = {}

    def block(self, frames: Frames) -> bytearray:
        """All lines of `frames`, each with its line end."""
        return self._written(frames, self._heads, self._line)

    def tails(self, frames: Frames) -> list[bytes]:
        """Return what each frame says, to stand behind the frame itself; with the line end."""
        return [line + b"\n" for line in bytes(self._written(frames, lambda _: [], self._tail)).split(b"\n")[:-1]]

    def _written(
        self, frames: Frames, heads: Callable[[Frames], list[Part]], singly: Callable[[LogFrame], str]
    ) -> bytearray:
        """Each frame's head and what it says; `singly` writes both for a frame that is unusual."""
        tails: list[tuple[Ints, list[Part]]] = []
        unusual = frames.flags & (ERROR | REMOTE | FD) != 0
        for layout, rows in self._decoder.by_message(frames):
            rows = rows[~unusual[rows]]
            if layout is not None:
                usual = (frames.length[rows] == layout.length) & layout.plain
                unusual[rows[~usual]] = True
                rows = rows[usual]
            if len(rows):
                say = self._unknown(frames.can_id[rows]) if layout is None else self._usual(layout, frames.word[rows])
                tails.append((rows, say))
        usual = np.flatnonzero(~unusual)
        head = heads(frames.only(usual))
        lengths = np.zeros(len(frames), np.int64)
        lengths[usual] = head_lengths = np.broadcast_to(length_of(head), len(usual))
        for rows, tail in tails:
            lengths[rows] += length_of(tail)
        lines = [(row, singly(frames.frame(row)).encode()) for row in np.flatnonzero(unusual).tolist()]
        for row, line in lines:
            lengths[row] = len(line)
        ends = np.cumsum(lengths)
        begins = ends - lengths
        out = bytearray(int(lengths.sum()))
        for rows, tail in tails:
            put_parts(out, ends[rows], tail, int(head_lengths.min()))
        if len(usual):
            put_parts(out, begins[usual] + head_lengths, head)
        for row, line in lines:
            out[begins[row] : ends[row]] = line
        return out

    def _unknown(self, can_ids: npt.NDArray[np.uint32]) -> list[Part]:
        ids, where = np.unique(can_ids, return_inverse=True)
        return [texts_of([self._unknown_text(can_id) for can_id in ids.tolist()]).at(where)]

    def _unknown_text(self, can_id: int) -> str:
        return ',"message":null,"signals":{}}\n' if self._json else f" :: Unknown frame id {can_id} (0x{can_id:x})\n"

    def _usual(self, layout: MessageLayout, words: Words) -> list[Part]:
        """Return what the frames of a plain message say, from their payloads."""
        text = self._messages.get(layout.key)
        if text is None:
            texts = [self._text_of(signal) for signal in layout.signals]
            text = self._messages[layout.key] = MessageText(layout, texts, as_json=self._json, short=self._short)
        parts: list[Part] = []
        for before, signal, values in zip(text.before, layout.signals, text.signals, strict=True):
            ordered = words.byteswap() if signal.big_endian else words
            parts += before.encode(), values.of(ordered >> np.uint64(signal.start))
        return [*parts, text.end.encode()]

    def _text_of(self, signal: SignalLayout) -> SignalText:
        """Return the texts of a signal's values; signals whose values have the same texts share them."""
        alone = signal._replace(start=0, big_endian=False, name=signal.name if self._short else "")
        key = str(alone)
        if key not in self._texts:
            self._texts[key] = (
                ShortText(alone, words=self._words, rounded=self._rounded)
                if self._short
                else SignalText(alone, as_json=self._json, words=self._words, rounded=self._rounded)
            )
        return self._texts[key]

    def _heads(self, frames: Frames) -> list[Part]:
        """Everything up to what a frame says: candump's line, or the object up to the message's name."""
        if not self._json:
            return log_parts(frames)
        keys = frames.can_id | ((frames.flags & np.uint32(EXTENDED)) << np.uint32(_EXTENDED_SHIFT))
        distinct, where = np.unique(keys, return_inverse=True)
        ids = [
            f'","id":{key & ~EXTENDED_KEY},"extended":{json.dumps(bool(key & EXTENDED_KEY))},"data":"'
            for key in distinct.tolist()
        ]
        escaped = replace(frames, channels=[json.dumps(name)[1:-1] for name in frames.channels])
        time, channel = time_text(frames.t_ns), channel_text(escaped)
        return [b'{"t":', time, b',"channel":"', channel, texts_of(ids).at(where), hex_text(frames), b'"']

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
        """Return the text behind an unusual frame: an error or remote frame, or a frame that goes through cantools."""
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
            return self._unknown_text(frame.can_id)
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
