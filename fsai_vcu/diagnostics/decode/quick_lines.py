"""Lines of a candump log with their signals, without numpy: to load it takes longer than to print 100,000 such lines.

In a log the same payloads come again and again: what is printed beside one is worked out once. Whatever is unusual
(lines of another form than candump's, messages that are not plain, frames of a wrong length) is left to lines.py.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from collections.abc import Callable
from struct import Struct
from typing import Final

from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout, SignalLayout

_MASK: Final = bytes.maketrans(b"123456789", b"000000000")
_HEAD: Final = re.compile(rb"\n\((0{1,10})\.0{6}\) [A-Za-z0-9_.:-]{1,15} ")  # of a line whose digits are all '0'
_FRAME: Final = re.compile(rb"(?:[0-7][0-9A-F]{2}|[0-3][0-9A-F]{7})#(?:[0-9A-F]{2}){0,8}")
_ASKED: Final = re.compile(rb" ([0-7][0-9A-Fa-f]{2})#((?:[0-9A-Fa-f]{2}){0,8})\s")
_DIGITS: Final = b"0123456789ABCDEF"
_LATE: Final = b"(9"  # a time of ten digits that may be too great to be one
_MAX_ID: Final = 0x1FFF_FFFF  # beyond it: error frames
_HEADS: Final = 8  # more lengths of what stands before the identifier in one block, and it is left to lines.py
_KEPT: Final = 200_000
_TABLE_BITS: Final = 16  # values of signals up to this long are remembered
_FLOATS: Final = {32: (Struct("<I"), Struct("<f")), 64: (Struct("<Q"), Struct("<d"))}
# By (whether it is a float, bits); the lower-case letters are those of signed integers.
_STRUCT_CODES: Final = {
    (False, 8): "B",
    (False, 16): "H",
    (False, 32): "I",
    (False, 64): "Q",
    (True, 32): "f",
    (True, 64): "d",
}


class _Unusual(Exception):
    """Not for here."""


def payloads(block: bytes) -> set[tuple[int, int, int]]:
    """(identifier, bytes, payload as a little-endian number) of the usual frames with 11-bit identifiers."""
    return {
        (int(can_id, 16), len(data) // 2, int.from_bytes(unhexlify(data), "little"))
        for can_id, data in set(_ASKED.findall(block))
    }


class QuickWriter:
    """Writes blocks of whole lines as `LineWriter` does. words: names of values, where the database has them."""

    def __init__(self, databases: Databases, careful: Callable[[bytes], bytes], *, words: bool = True) -> None:
        """`careful` says what stands beside an unusual frame, given as `523#0102`; with the line end."""
        self._tails = _Tails(databases, careful, words)

    def block(self, block: bytes) -> tuple[bytes, int] | None:
        """(all lines with their signals, number of frames); None where a line is unusual."""
        lines = block.split(b"\n")
        if lines.pop() or not lines:
            return None
        both: list[bytes] = [b""] * (2 * len(lines))
        both[0::2] = lines
        try:
            both[1::2] = self._beside(lines, b"\n" + block.translate(_MASK))
        except _Unusual:
            return None
        return b"".join(both), len(lines)

    def _beside(self, lines: list[bytes], masked: bytes) -> list[bytes]:
        """For each line its tail. masked: the same lines, all digits '0', each with a line end before it."""
        beside: list[bytes] = []
        for _ in range(_HEADS):
            head = _HEAD.match(masked)
            if head is None or (len(head[1]) > 1 and lines[0][1:2] == b"0"):
                raise _Unusual
            at = len(head[0]) - 1
            whole = masked.count(head[0]) == len(lines)
            part = lines
            if not whole:  # from some line on the time, or the name of the bus, is longer
                masked_lines = masked[1:].split(b"\n")
                end = next(row for row, line in enumerate(masked_lines) if not line.startswith(head[0][1:]))
                part, lines = lines[:end], lines[end:]
                masked = b"\n" + b"\n".join(masked_lines[end:])
            if len(head[1]) == 10 and max(part) >= _LATE:
                raise _Unusual
            beside += map(self._tails.__getitem__, [line[at:] for line in part])
            if whole:
                return beside
        raise _Unusual


class _Tails(dict[bytes, bytes]):
    """What stands beside a frame, by its text in the log."""

    def __init__(self, databases: Databases, careful: Callable[[bytes], bytes], words: bool) -> None:
        super().__init__()
        self._careful = careful
        self._messages = {
            f"{layout.can_id:0{8 if layout.key & EXTENDED_KEY else 3}X}".encode(): _Message(layout, words)
            for layout in databases.layouts.values()
            if layout.plain
        }
        self._keys = databases.layouts.keys()

    def __missing__(self, text: bytes) -> bytes:
        if len(self) >= _KEPT:
            self.clear()
        can_id, _, data = text.partition(b"#")
        message = self._messages.get(can_id)
        if message is not None and len(data) == message.digits and not data.strip(_DIGITS):
            tail = message.tail(unhexlify(data))
        elif not _FRAME.fullmatch(text):
            raise _Unusual
        elif self._describes(can_id):
            tail = self._careful(text)
        else:
            tail = unknown(int(can_id, 16))
        self[text] = tail
        return tail

    def _describes(self, can_id: bytes) -> bool:
        """Whether somebody else has more to say about this identifier than that nobody knows it."""
        number = int(can_id, 16)
        return number > _MAX_ID or (number | (EXTENDED_KEY if len(can_id) == 8 else 0)) in self._keys


class _Message:
    """One plain message."""

    def __init__(self, layout: MessageLayout, words: bool) -> None:
        self.digits = 2 * layout.length
        self._signals: list[tuple[_Texts | range, int, int]] = []  # texts by bits, and where the bits are
        shown, every = [], []
        for signal in layout.signals:
            texts = _Texts(signal, words)
            every.append(texts)
            everything = range(1 << signal.length)
            self._signals.append((everything if texts.are_bits else texts, signal.start, everything[-1]))
            shown.append(f"{_literally(signal.name)}: %s{_literally(texts.behind)}")
        code = _struct_code(layout)
        self._unpack = None if code is None or not all(texts.are_values for texts in every) else Struct(code).unpack
        self._template = f" :: {_literally(layout.name)}({', '.join(shown)})\n"

    def tail(self, data: bytes) -> bytes:
        if self._unpack is not None:
            return (self._template % self._unpack(data)).encode()
        word = int.from_bytes(data, "little")
        return (
            self._template % tuple([texts[(word >> start) & mask] for texts, start, mask in self._signals])
        ).encode()


def _struct_code(layout: MessageLayout) -> str | None:
    """For struct, where the signals follow one another, fill the message, and are numbers that struct knows."""
    code, end = "<", 0
    for signal in layout.signals:
        letter = _STRUCT_CODES.get((signal.is_float, signal.length))
        if letter is None or signal.start != end:
            return None
        code += letter.lower() if signal.signed else letter
        end += signal.length
    return code if end == 8 * layout.length else None


def _literally(text: str) -> str:
    """For a template: what is a % there stays one."""
    return text.replace("%", "%%")


class _Texts(dict[int, str]):
    """The value of a signal as it is printed, by its bits; cantools' arithmetic, which is Python's.

    behind: what stands behind all its values. are_values: what is printed is the very number that its bits are;
    are_bits: a number without a sign.
    """

    def __init__(self, signal: SignalLayout, words: bool) -> None:
        super().__init__()
        self._choices = signal.choices if words else {}
        unit = f" {one_line(signal.unit)}" if signal.unit else ""
        # A word has no unit: where there can be words, the unit belongs to the single text.
        self.behind, self._unit = ("", unit) if self._choices else (unit, "")
        self._remembered = signal.length <= _TABLE_BITS
        self._scale, self._offset = signal.scale, signal.offset
        if not signal.is_float and float(self._scale).is_integer() and float(self._offset).is_integer():
            self._scale, self._offset = int(self._scale), int(self._offset)
        self._raw_is_value = signal.scale == 1 and signal.offset == 0
        self._float = _FLOATS[signal.length] if signal.is_float else None
        self._negative_from = 1 << (signal.length - 1) if signal.signed and not signal.is_float else 1 << signal.length
        self._all = 1 << signal.length
        self.are_values = self._raw_is_value and not self._choices
        self.are_bits = self.are_values and not (signal.signed or signal.is_float)

    def __missing__(self, bits: int) -> str:
        raw: float = bits
        if self._float is not None:
            raw = self._float[1].unpack(self._float[0].pack(bits))[0]
        elif bits >= self._negative_from:
            raw = bits - self._all
        value = raw if self._raw_is_value else raw * self._scale + self._offset
        word = self._choices.get(int(raw)) if self._choices else None
        text = f"{value}{self._unit}" if word is None else one_line(word)
        if self._remembered:
            self[bits] = text
        return text


def unknown(can_id: int) -> bytes:
    """What stands beside a frame that no database describes."""
    return f" :: Unknown frame id {can_id} (0x{can_id:x})\n".encode()


def one_line(text: str) -> str:
    """Without what would end or break a line."""
    return text.replace("\0", "").replace("\n", " ")
