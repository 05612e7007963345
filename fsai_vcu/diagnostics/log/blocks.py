"""Rows of a text read many at a time: lines of one shape together, as columns of characters.

A shape is the constant text around a line's digits. Whatever does not pass every check of its shape is read by its
format's reader, one line after the other; the shapes are asked for again wherever that reader has learned something
that changes how the following lines are read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.candump_line import (
    ERROR_FLAG,
    MAX_EXTENDED_ID,
    MAX_NS,
    MAX_STANDARD_ID,
    Unreadable,
    read_lines,
)
from fsai_vcu.diagnostics.log.frames import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    MOST_CHANNELS,
    RECEIVED,
    SENT,
    Frames,
    Ints,
    LogFrame,
    Mask,
    frames_of,
    joined,
)
from fsai_vcu.diagnostics.log.rows import Pattern, Rows

Characters = npt.NDArray[np.uint8]
_FRONT, _BACK = 16, 192  # bytes around a block: the columns of a line may end behind it
_EIGHT: Final = np.arange(CLASSIC_BYTES)[:, np.newaxis]
_WIDEST: Final = 120  # characters before the data bytes
_SHAPES: Final = 40  # more kinds of lines than that at once, and the rest is read one by one
_LOOKED_AT: Final = 200  # lines, for one that has a shape
_FEW: Final = 32  # lines that are read one by one where the reader has just learned something
_BLANK: Final = 3  # spaces at a line's end
_TAIL: Final = 60  # characters behind the data; a second row in the line has more
_SPACE, _NEWLINE, _RETURN = b" \n\r"


class _Shape(NamedTuple):
    """The common part of lines of one kind: their head, in which the digits are zeros, and where these are.

    seconds: of the time in the unit of the format, with its decimals behind a point; empty: no time.
    length: the place of the number of data bytes, and each byte follows a space; 0: they follow each other.
    """

    head: bytes
    number: slice
    seconds: slice
    decimals: slice
    id: slice
    length: int
    channel: str
    flags: int
    wide: bool

    @classmethod
    def of(cls, found: re.Match[bytes], pattern: Pattern) -> _Shape:
        groups = pattern.expression.groupindex

        def place(name: str) -> slice:
            return slice(*(found.span(name) if name in groups and found[name] is not None else (0, 0)))

        number, seconds, decimals, can_id, length = map(place, ("number", "time", "decimals", "id", "length"))
        head = bytearray(found[0])
        for each in (number, seconds, decimals, can_id, length):
            head[each] = bytes(each.stop - each.start)
        way = found["way"] if "way" in groups else None
        flags = 0 if way is None else SENT if way[:1] in b"Tt" else RECEIVED
        bus, wide = pattern.channel(found), pattern.wide(found)
        return cls(bytes(head), number, seconds, decimals, can_id, length.start, bus, flags, wide)

    @property
    def key(self) -> object:
        """The key that tells it from others."""
        return self.head, self.channel, self.flags, self.wide

    def constants(self) -> Iterator[tuple[int, bytes]]:
        """Each text that all lines share, and where it begins."""
        return ((each.start(), each[0]) for each in re.finditer(rb"[^\0]+", self.head))


def parse_block(block: npt.NDArray[np.uint8], channels: list[str], rows: Rows) -> tuple[Frames, list[Unreadable], int]:
    """Frames of whole lines, each with its line end; new channels are added to `channels`.

    Returns (frames, what could not be read, number of lines).
    """
    text = np.concatenate([np.zeros(_FRONT, np.uint8), block, np.zeros(_BACK, np.uint8)])
    ends = np.flatnonzero(text == _NEWLINE)
    starts = np.concatenate([[_FRONT], ends[:-1] + 1])[: len(ends)]
    count = len(ends)
    if count and text[ends[0] - 1] == _RETURN:
        ends = ends - (text[ends - 1] == _RETURN)
    parts: list[Frames] = []
    unreadable: list[Unreadable] = []
    pattern = rows.pattern()
    begun = pattern is None or (count and pattern.expression.match(text[starts[0] : ends[0]].tobytes()))
    at, alone, together = 0, not begun, count if begun else _FEW
    while at < count:
        times = rows.times()
        stop = min(at + together, count)
        found: list[tuple[Frames, Ints]] = []
        rest = np.arange(at, stop)
        if not alone:
            found, rest = _together(text, starts, ends, rest, rows, channels)
        singly: dict[int, LogFrame] = {}
        learned = _singly(text, starts, ends, rest, rows, singly, unreadable, go_on=alone)
        stop = stop if learned is None else learned + 1
        whole = _in_order(found, singly, stop, channels)
        parts.append(whole if times is None else whole.at(times(whole.t_ns)))
        at, alone = stop, learned is not None
        together = _FEW if alone else 4 * together
    return joined(parts), unreadable, count


def _in_order(found: list[tuple[Frames, Ints]], singly: dict[int, LogFrame], stop: int, channels: list[str]) -> Frames:
    """The frames on the lines before that one, in the order of the lines."""
    parts, places = [frames_of(singly.values(), channels)], [np.array([*singly], np.int64)]
    for frames, read in found:
        kept = int(np.searchsorted(read, stop))
        parts.append(frames if kept == len(frames) else frames.head(kept))
        places.append(read[:kept])
    whole, order = joined(parts), np.concatenate(places)
    return whole if (order[1:] > order[:-1]).all() else whole.only(np.argsort(order))


def _singly(
    text: Characters,
    starts: Ints,
    ends: Ints,
    rest: Ints,
    rows: Rows,
    frames: dict[int, LogFrame],
    unreadable: list[Unreadable],
    *,
    go_on: bool,
) -> int | None:
    """Read lines one by one, up to the first that changes how the following ones are read: that line, or None.

    go_on: that does not end it, unless the times of what follows are others; the last line stands for it.
    """
    before, learned = rows.state(), None
    go_on = go_on and rows.times() is None

    rest = rest[ends[rest] > starts[rest]]  # a file may be millions of empty lines

    def lines() -> Iterator[tuple[int, bytes]]:
        nonlocal learned
        for row in rest.tolist():
            yield row, text[starts[row] : ends[row]].tobytes()
            if learned is None and rows.state() == before:
                continue
            learned = row
            if not go_on or rows.times() is not None:
                return

    read_lines(lines(), rows, rows.encoding, frames, unreadable)
    return learned


def _together(
    text: Characters, starts: Ints, ends: Ints, rest: Ints, rows: Rows, channels: list[str]
) -> tuple[list[tuple[Frames, Ints]], Ints]:
    """The frames on those of the lines that have a shape, with the lines' numbers; and the other lines."""
    found: list[tuple[Frames, Ints]] = []
    pattern, tried = rows.pattern(), set[object]()
    while pattern is not None and len(tried) < _SHAPES:
        shape = _next_shape(text, starts, ends, rest, pattern, tried)
        if shape is None:
            break
        tried.add(shape.key)
        if shape.channel not in channels and len(channels) >= MOST_CHANNELS:
            continue
        likely = _likely(text, starts[rest], shape)
        alike = rest[likely]
        frames, read = _of_shape(text, starts[alike], ends[alike], shape, pattern, channels)
        found.append((frames, alike[read]))
        likely[likely] = read
        rest = rest[~likely]
    return found, rest


def _next_shape(
    text: Characters, starts: Ints, ends: Ints, rest: Ints, pattern: Pattern, tried: set[object]
) -> _Shape | None:
    """The shape of the first of the lines that has one which was not tried yet."""
    for row in rest[:_LOOKED_AT].tolist():
        found = pattern.expression.match(text[starts[row] : ends[row]].tobytes())
        if found and found.end() <= _WIDEST and (shape := _Shape.of(found, pattern)).key not in tried:
            return shape
    return None


def _likely(text: Characters, starts: Ints, shape: _Shape) -> Mask:
    """Select the lines that may have the shape: the characters around identifier and decimals are in place."""
    likely = np.ones(len(starts), np.bool_)
    for place in {shape.decimals.start - 1, shape.id.start - 1, shape.id.stop}:
        if place >= 0:
            likely &= text[starts + place] == shape.head[place]
    return likely


def _of_shape(
    text: Characters, starts: Ints, ends: Ints, shape: _Shape, pattern: Pattern, channels: list[str]
) -> tuple[Frames, Mask]:
    """The frames on those of the lines that have this shape, and which these are."""
    data_at = len(shape.head)
    step = 3 if shape.length else 2
    eights = -(-(data_at + step * CLASSIC_BYTES) // 8)
    lines = np.ndarray((len(text) - 8 * eights + 1,), f"V{8 * eights}", text, strides=(1,))[starts]
    # A row for each place: what is done to a row is done to all lines at once. Eight at a time they are turned quicker.
    turned = np.ascontiguousarray(lines.view(np.uint64).reshape(-1, eights).T).view(np.uint8)
    columns = np.ascontiguousarray(turned.reshape(eights, -1, 8).transpose(0, 2, 1)).reshape(8 * eights, -1)

    ok: Mask = ends - starts >= data_at
    for at, constant in shape.constants():
        expected = np.frombuffer(constant, np.uint8)[:, np.newaxis]
        ok &= (columns[at : at + len(constant)] == expected).all(axis=0)
    digits = np.concatenate([columns[each] for each in (shape.seconds, shape.decimals)]) - np.uint8(ord("0"))
    ok &= (digits <= 9).all(axis=0)
    ok &= (columns[shape.number] - np.uint8(ord("0")) <= 9).all(axis=0)
    t_ns = _number(digits, 10) * (pattern.unit_ns // 10 ** (shape.decimals.stop - shape.decimals.start))
    ok &= (t_ns >= 0) & (t_ns <= MAX_NS - pattern.begin_ns)  # too great a number has become negative
    t_ns += pattern.begin_ns

    nibbles, id_ok = _nibbles(columns[shape.id])
    ok &= id_ok.all(axis=0)
    can_id = _number(nibbles, 16)
    flags = np.full(len(starts), shape.flags, np.uint8)
    if shape.wide and pattern.marked:
        ok &= can_id <= ERROR_FLAG | MAX_EXTENDED_ID
        flags |= np.where(can_id & ERROR_FLAG, np.uint8(ERROR), np.uint8(EXTENDED))
        can_id &= MAX_EXTENDED_ID
    else:
        ok &= can_id <= (MAX_EXTENDED_ID if shape.wide else MAX_STANDARD_ID)
        flags |= np.uint8(EXTENDED if shape.wide else 0)

    length = ends - starts - data_at
    if not shape.length:
        way = text[ends - 1]
        marked = (text[ends - 2] == _SPACE) & ((way == ord("R")) | (way == ord("T"))) & (length >= 2)
        flags |= np.where(marked, np.where(way == ord("T"), np.uint8(SENT), np.uint8(RECEIVED)), np.uint8(0))
        length -= 2 * marked
        ok &= (length >= 0) & (length & 1 == 0)
        length >>= 1
        high, low = columns[data_at : data_at + 16 : 2], columns[data_at + 1 : data_at + 17 : 2]
    else:
        rest, length = length, columns[shape.length].astype(np.int64) - ord("0")
        ok &= length >= 0
        rest -= 3 * length
        ok &= rest == 0 if pattern.tail is None else _ended(text, ends, rest, pattern.tail)
        spaces, high, low = (columns[data_at + at : data_at + 24 + at : 3] for at in range(3))
        ok &= ((spaces == _SPACE) | (length <= _EIGHT)).all(axis=0)
    ok &= length <= CLASSIC_BYTES
    (high, high_ok), (low, low_ok) = _nibbles(high), _nibbles(low)
    ok &= ((high_ok & low_ok) | (length <= _EIGHT)).all(axis=0)
    payload = (high << np.uint8(4) | low) * (length > _EIGHT)

    if shape.channel not in channels:
        channels.append(shape.channel)
    frames = Frames(
        t_ns,
        can_id.astype(np.uint32),
        flags,
        length.astype(np.uint8),
        np.ascontiguousarray(payload.T).view("<u8").ravel(),
        np.full(len(starts), channels.index(shape.channel), np.int32),
        channels,
    )
    return frames.only(ok), ok


def _ended(text: Characters, ends: Ints, rest: Ints, tail: bytes) -> Mask:
    """True for lines whose last so many characters are spaces, or what the format writes behind the data."""
    ended: Mask = rest == 0
    if ended.all():
        return ended
    blank = (rest > 0) & (rest <= _BLANK)
    for back in range(1, _BLANK + 1):
        blank &= (rest < back) | (text[ends - back] == _SPACE)
    ended |= blank
    if tail:
        named = (rest >= len(tail)) & (rest <= _TAIL)
        at = ends - np.clip(rest, 0, _TAIL)
        for place, character in enumerate(tail):
            named &= text[at + place] == character
        ended |= named
    return ended


def _nibbles(characters: Characters) -> tuple[Characters, Mask]:
    """The values of hexadecimal digits, and whether they are such digits."""
    digit, letter = characters - np.uint8(ord("0")), (characters | np.uint8(0x20)) - np.uint8(ord("a"))
    worth = (characters & np.uint8(15)) + np.uint8(9) * (characters >> np.uint8(6))
    return worth, (digit <= 9) | (letter <= 5)


def _number(digits: Characters, base: int) -> Ints:
    """The number in each column of digits, the highest first."""
    number = np.zeros(digits.shape[1], np.int64)
    for row in digits:
        number *= base
        number += row
    return number
