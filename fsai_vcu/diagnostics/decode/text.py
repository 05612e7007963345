"""What is printed of frames, one at a time: for people as `cantools decode --single-line` writes it, and as JSON.

It needs no numpy, which takes longer to load than a short log to print. lines.py prints many frames at once, with the
very texts of here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from struct import Struct
from typing import Any, Final

from fsai_vcu.diagnostics.decode.databases import Databases, UndecodableError
from fsai_vcu.diagnostics.decode.error_frames import error_words
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout, SignalLayout
from fsai_vcu.diagnostics.log.candump_line import log_line, time_text
from fsai_vcu.diagnostics.log.frame import LogFrame

_FLOATS: Final = {32: (Struct("<I"), Struct("<f")), 64: (Struct("<Q"), Struct("<d"))}


class FrameText:
    """Writes frames with their signals. as_json: an object a line. words: the database's, instead of numbers."""

    def __init__(self, databases: Databases, *, as_json: bool = False, words: bool = True) -> None:
        self.databases = databases
        self.as_json = as_json
        self._words = words
        self._messages: dict[int, MessageText] = {}

    def line(self, frame: LogFrame) -> str:
        """The frame and what it says, with the line end."""
        return (self.json_head(frame) if self.as_json else log_line(frame)) + self.tail(frame)

    def json_head(self, frame: LogFrame) -> str:
        """Everything of the object up to the message's name."""
        flags = (',"fd":true' if frame.fd else "") + (',"remote":true' if frame.remote else "")
        return (
            f'{{"t":{time_text(frame.t_ns)},"channel":{json.dumps(frame.channel)},"id":{frame.can_id},'
            f'"extended":{json.dumps(frame.extended)},"data":"{frame.data.hex().upper()}"{flags}'
        )

    def tail(self, frame: LogFrame) -> str:
        """What stands behind the frame itself, with the line end."""
        layout = self.databases.layouts.get(frame.can_id | (EXTENDED_KEY if frame.extended else 0))
        if frame.error or frame.remote:
            return self._special(frame, layout)
        if layout is None:
            return self.unknown(frame.can_id)
        if layout.plain and len(frame.data) == layout.length:
            return self.message(layout).tail(int.from_bytes(frame.data, "little"))
        return self.careful(layout, frame.data)

    def message(self, layout: MessageLayout) -> MessageText:
        """The texts of a plain message."""
        text = self._messages.get(layout.key)
        if text is None:
            text = self._messages[layout.key] = MessageText(layout, as_json=self.as_json, words=self._words)
        return text

    def unknown(self, can_id: int) -> str:
        """What stands beside a frame that no database describes."""
        return ',"message":null,"signals":{}}\n' if self.as_json else f" :: Unknown frame id {can_id} (0x{can_id:x})\n"

    def careful(self, layout: MessageLayout, data: bytes) -> str:
        """Through cantools: messages that are not plain, and frames of the wrong length as far as they go."""
        wrong = "" if len(data) == layout.length else f"Wrong data size: {len(data)} instead of {layout.length} bytes"
        try:
            values: Mapping[str, Any] = self.databases.decoded(layout, data, choices=self._words)
        except UndecodableError as error:
            values, wrong = {}, wrong or str(error)
        if self.as_json:
            signals = ",".join(f"{json.dumps(name)}:{_json_value(value)}" for name, value in values.items())
            problem = f',"problem":{json.dumps(wrong)}' if wrong else ""
            return f',"message":{json.dumps(layout.name)},"signals":{{{signals}}}{problem}}}\n'
        if wrong and not values:
            return f" :: {wrong}\n"
        units = {signal.name: signal.unit for signal in layout.signals}
        shown = ", ".join(f"{name}: {_with_unit(value, units[name])}" for name, value in values.items())
        return f" :: {wrong + ': ' if wrong else ''}{layout.name}({shown})\n"

    def _special(self, frame: LogFrame, layout: MessageLayout | None) -> str:
        """Error and remote frames."""
        name = layout.name if layout else None
        if frame.error:
            words = error_words(frame.can_id, frame.data)
            if self.as_json:
                return f',"error":{json.dumps(words)},"message":null,"signals":{{}}}}\n'
            return f" :: error frame: {', '.join(words)}\n"
        if self.as_json:
            return f',"message":{json.dumps(name)},"signals":{{}}}}\n'
        return f" :: remote request for {name or 'an unknown frame id'}\n"


class MessageText:
    """The text of one plain message: `before[i]` and the text of `signals[i]` for each of them, then `end`."""

    def __init__(self, layout: MessageLayout, *, as_json: bool, words: bool) -> None:
        self.signals = [SignalText(signal, as_json=as_json, words=words) for signal in layout.signals]
        self.before: list[str] = []
        between = f',"message":{json.dumps(layout.name)},"signals":{{' if as_json else f" :: {layout.name}("
        for signal, text in zip(layout.signals, self.signals, strict=True):
            self.before.append(between + (f"{json.dumps(signal.name)}:" if as_json else f"{signal.name}: "))
            between = text.behind + ("," if as_json else ", ")
        self.end = (self.signals[-1].behind if self.signals else between) + ("}}\n" if as_json else ")\n")

    def tail(self, word: int) -> str:
        """Of the payload as a little-endian number."""
        parts: list[str] = []
        for before, signal in zip(self.before, self.signals, strict=True):
            parts += before, signal.texts([signal.raw(word)])[0]
        return "".join(parts) + self.end


class SignalText:
    """Texts of the values of one signal of a plain message; the arithmetic is Python's, as cantools' is.

    behind: what stands behind all its values. kind: signals of one kind have the same texts.
    """

    def __init__(self, layout: SignalLayout, *, as_json: bool, words: bool) -> None:
        self.layout = layout
        self.kind = str(layout._replace(name="", start=0, big_endian=False))
        self._json = as_json
        self._words: dict[float, str] = {
            raw: json.dumps(word) if as_json else _one_line(word) for raw, word in layout.choices.items() if words
        }
        unit = f" {_one_line(layout.unit)}" if layout.unit and not as_json else ""
        # A word has no unit: where there can be words, the unit belongs to the single text.
        self.behind, self._unit = ("", unit) if self._words else (unit, "")
        self._scale, self._offset = layout.scale, layout.offset
        if not layout.is_float and float(self._scale).is_integer() and float(self._offset).is_integer():
            self._scale, self._offset = int(self._scale), int(self._offset)

    def raw(self, word: int) -> float:
        """What the bits mean of a payload as a little-endian number."""
        length = self.layout.length
        if self.layout.big_endian:
            word = int.from_bytes(word.to_bytes(8, "little"), "big")
        bits = word >> self.layout.start & ((1 << length) - 1)
        if self.layout.is_float:
            integer, real = _FLOATS[length]
            return float(real.unpack(integer.pack(bits))[0])
        return bits - (1 << length) if self.layout.signed and bits >> (length - 1) else bits

    def texts(self, raws: Sequence[float]) -> Sequence[str]:
        """The values of these raw numbers, as they are printed."""
        values = raws
        if self._scale != 1 or self._offset != 0:
            scale, offset = self._scale, self._offset
            values = [raw * scale + offset for raw in raws]
        if self._words:
            pairs = zip(raws, values, strict=True)
            return [self._words.get(raw, f"{value}{self._unit}") for raw, value in pairs]
        return list(map(_json_value if self._json else repr, values))


def _one_line(text: str) -> str:
    """Without what would end or break a line."""
    return text.replace("\0", "").replace("\n", " ")


def _json_value(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "null"  # JSON has no word for it
    if isinstance(value, int | float):
        return repr(value)
    return json.dumps(str(value))


def _with_unit(value: Any, unit: str) -> str:
    return f"{value} {unit}" if unit and isinstance(value, int | float) else str(value)
