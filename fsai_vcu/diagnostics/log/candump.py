"""candump's text formats as columns: a whole block of lines read and written at once.

Lines of one shape (the constant text around time, identifier and payload) are read together: eight characters at a time
as one 64-bit number, each step for all lines. Whatever does not pass every check there is read by candump_line.py.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.candump_line import (
    ERROR_FLAG,
    MAX_EXTENDED_ID,
    MAX_FD_BYTES,
    MAX_SECONDS,
    MAX_STANDARD_ID,
    UnreadableError,
    log_line,
    parse_line,
    read_line,
)
from fsai_vcu.diagnostics.log.characters import Characters, Part, assembled
from fsai_vcu.diagnostics.log.frames import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    RECEIVED,
    REMOTE,
    SENT,
    Frames,
    Ints,
    LogFrame,
    Mask,
    Words,
)

_FRONT, _BACK = 16, 64  # bytes around a block, so that a window of eight may begin before it and end behind it
_SHAPES = 40  # more kinds of lines than that in one block, and the rest is read one by one

_SHAPE = re.compile(
    rb"(?P<before> *)(?:(?P<open>\()(?P<time>\d{1,10})\.\d{6}(?P<close>\) +))?(?P<between>(?P<channel>[^\s()]{1,15}) +"
    rb"(?:(?P<way>[RT])X - -  )?)(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})(?P<behind>#| {1,8}\[)"
)
_U = np.uint64


def _each(byte: int) -> np.uint64:
    return _U(byte * 0x0101_0101_0101_0101)


class Unreadable(NamedTuple):
    """A line that is no frame: its number in the block, from 0, and what is wrong with it."""

    line: int
    reason: str


class _Shape(NamedTuple):
    """What lines of one kind have in common. digits: of the seconds; 0: no time. flags: of the direction."""

    before: bytes
    digits: int
    between: bytes
    channel: str
    id_width: int
    behind: bytes
    flags: int

    @classmethod
    def of(cls, found: re.Match[bytes]) -> _Shape:
        return cls(
            found["before"] + (found["open"] or b""),
            len(found["time"] or b""),
            (found["close"] or b"") + found["between"],
            found["channel"].decode("ascii", "replace"),
            len(found["id"]),
            found["behind"],
            {None: 0, b"R": RECEIVED, b"T": SENT}[found["way"]],
        )


def parse_block(block: npt.NDArray[np.uint8], channels: list[str]) -> tuple[Frames, list[Unreadable], int]:
    """Frames of whole lines, each with its line end; new channels are added to `channels`.

    Returns (frames, what could not be read, number of lines).
    """
    text = np.concatenate([np.zeros(_FRONT, np.uint8), block, np.zeros(_BACK, np.uint8)])
    ends = np.flatnonzero(text == ord("\n"))
    count = len(ends)
    starts = np.empty(count, np.int64)
    if count:
        starts[0] = _FRONT
        starts[1:] = ends[:-1] + 1
    if count and text[ends[0] - 1] == ord("\r"):
        ends = ends - (text[ends - 1] == ord("\r"))
    columns = _Columns(count, channels)
    rest = np.arange(count)
    for _ in range(_SHAPES):
        if not len(rest):
            break
        shape = _next_shape(text, starts, ends, rest)
        if shape is None:
            break
        rest = rest[~_read_shape(columns, text, starts, ends, rest, shape)]
    unreadable = _read_singly(columns, text, starts, ends, rest)
    return columns.frames(), unreadable, count


class _Columns:
    """The columns as they fill up, one row for each line."""

    def __init__(self, count: int, channels: list[str]) -> None:
        self.t_ns = np.zeros(count, np.int64)
        self.can_id = np.zeros(count, np.uint32)
        self.flags = np.zeros(count, np.uint8)
        self.length = np.zeros(count, np.uint8)
        self.word = np.zeros(count, np.uint64)
        self.channel = np.zeros(count, np.int32)
        self.filled = np.zeros(count, np.bool_)
        self.long: dict[int, bytes] = {}
        self.channels = channels

    def channel_index(self, name: str) -> int:
        if name not in self.channels:
            self.channels.append(name)
        return self.channels.index(name)

    def put(self, row: int, frame: LogFrame) -> None:
        self.t_ns[row] = frame.t_ns
        self.can_id[row] = frame.can_id
        self.flags[row] = frame.flags
        self.length[row] = frame.length
        self.word[row] = int.from_bytes(frame.data[:CLASSIC_BYTES], "little")
        self.channel[row] = self.channel_index(frame.channel)
        self.filled[row] = True
        if len(frame.data) > CLASSIC_BYTES:
            self.long[row] = frame.data

    def frames(self) -> Frames:
        whole = Frames(
            self.t_ns, self.can_id, self.flags, self.length, self.word, self.channel, self.channels, self.long
        )
        return whole if self.filled.all() else whole.only(self.filled)


# ---------------------------------------------------------------- many lines at once


def _next_shape(text: npt.NDArray[np.uint8], starts: Ints, ends: Ints, rest: Ints) -> _Shape | None:
    """The shape of the first of the remaining lines that has one."""
    for row in rest[:200]:
        found = _SHAPE.match(text[starts[row] : ends[row]].tobytes())
        if found and (found["behind"] != b"#" or (found["time"] and not found["way"])):
            return _Shape.of(found)
    return None


def _read_shape(
    columns: _Columns, text: npt.NDArray[np.uint8], starts: Ints, ends: Ints, rest: Ints, shape: _Shape
) -> Mask:
    """Read those of the lines `rest` that have this shape; returns which of them were read."""
    # A number at every byte: window[i] is the eight characters from i on.
    window: Words = np.ndarray((len(text) - 7,), "<u8", buffer=text.data, strides=(1,))
    everything = len(rest) == len(starts)
    base = starts if everything else starts[rest]
    end = ends if everything else ends[rest]
    dot = len(shape.before) + shape.digits
    between_at = dot + (len(".uuuuuu") if shape.digits else 0)
    behind_at = between_at + len(shape.between) + shape.id_width
    payload_at = base + (behind_at + len(shape.behind))
    ok: Mask = end >= payload_at
    for at, constant in ((0, shape.before), (between_at, shape.between), (behind_at, shape.behind)):
        ok &= _are(window, base + at, constant)

    t_ns = np.zeros(len(base), np.int64)
    if shape.digits:
        micros = window[base + dot]  # ".uuuuuu)"
        ok &= (micros & _U(0xFF)) == _U(ord("."))
        micros = ((micros >> _U(8)) << _U(16)) | _U(0x3030)
        seconds = _zeros_in_front(window[base + (dot - 8)], 8 - min(shape.digits, 8))
        ok &= _are_digits(micros) & _are_digits(seconds)
        t_s = _number(seconds)
        if shape.digits > 8:
            high = _zeros_in_front(window[base + (dot - 16)], 16 - shape.digits)
            ok &= _are_digits(high)
            t_s += _number(high) * _U(100_000_000)
            ok &= t_s <= _U(MAX_SECONDS)
        t_ns = ((t_s * _U(1_000_000) + _number(micros)) * _U(1000)).astype(np.int64)

    id_bytes, id_ok = _hex_bytes(_zeros_in_front(window[base + (behind_at - 8)], 8 - shape.id_width))
    ok &= id_ok
    can_id = id_bytes.astype(np.uint32).byteswap()  # the first byte is the highest
    flags = np.full(len(base), shape.flags, np.uint8)
    if shape.id_width == 3:
        ok &= can_id <= MAX_STANDARD_ID
    else:
        ok &= (can_id & np.uint32(0xC000_0000)) == 0
        flags |= np.where((can_id & np.uint32(ERROR_FLAG)) != 0, np.uint8(ERROR), np.uint8(EXTENDED))
        can_id = can_id & np.uint32(MAX_EXTENDED_ID)

    if shape.behind == b"#":
        way = text[end - 1]
        told = (text[end - 2] == ord(" ")) & ((way == ord("R")) | (way == ord("T"))) & (end - payload_at >= 2)
        characters = end - payload_at
        if told.any():
            characters = characters - 2 * told
            flags |= np.where(told, np.where(way == ord("T"), np.uint8(SENT), np.uint8(RECEIVED)), np.uint8(0))
        first, second = window[payload_at], window[payload_at + 8]
    else:  # "n]  01 23 45": a space before each byte, and one more before the first
        characters = (text[payload_at].astype(np.int64) - ord("0")) * 2
        ok &= (characters >= 2) & (end - payload_at == 3 + characters // 2 * 3)
        ok &= _are(window, payload_at + 1, b"]  ")
        places = payload_at[:, np.newaxis] + np.arange(4, 28, 3)
        pairs = np.where(places < end[:, np.newaxis], places, 0)
        ok &= ((text[pairs - 1] == ord(" ")) | (pairs == 0)).all(axis=1)
        digits = text[np.stack([pairs, pairs + 1], axis=2)].reshape(-1, 16).view("<u8")
        first, second = digits[:, 0], digits[:, 1]
    ok &= (characters >= 0) & (characters <= 16) & (characters & 1 == 0)
    characters = np.clip(characters, 0, 16)
    first, first_ok = _hex_bytes(_zeros_behind(first, characters))
    second, second_ok = _hex_bytes(_zeros_behind(second, characters - 8))
    ok &= first_ok & second_ok

    rows: Ints | slice = slice(None) if everything and ok.all() else rest[ok]
    keep: Mask | slice = slice(None) if isinstance(rows, slice) else ok
    columns.t_ns[rows] = t_ns[keep]
    columns.can_id[rows] = can_id[keep]
    columns.flags[rows] = flags[keep]
    columns.length[rows] = (characters[keep] >> 1).astype(np.uint8)
    columns.word[rows] = (first | (second << _U(32)))[keep]
    columns.channel[rows] = columns.channel_index(shape.channel)
    columns.filled[rows] = True
    return ok


def _are(window: Words, places: Ints, constant: bytes) -> Mask:
    """Where this text stands."""
    ok: Mask = np.ones(len(places), np.bool_)
    for at in range(0, len(constant), 8):
        piece = constant[at : at + 8]
        mask = _U((1 << (8 * len(piece))) - 1)
        ok &= (window[places + at] & mask) == _U(int.from_bytes(piece, "little"))
    return ok


def _are_digits(word: Words) -> Mask:
    high = _each(0xF0)
    ok: Mask = ((word & high) == _each(0x30)) & (((word + _each(0x06)) & high) == _each(0x30))
    return ok


def _number(digits: Words) -> Words:
    """The number that eight decimal digits say, the first in the lowest byte."""
    pairs = (digits & _each(0x0F)) * _U(10) + ((digits & _each(0x0F)) >> _U(8))
    even = _U(0x0000_00FF_0000_00FF)
    return ((pairs & even) * _U(0x000F_4240_0000_0064) + ((pairs >> _U(16)) & even) * _U(0x0000_2710_0000_0001)) >> _U(
        32
    )


def _zeros_in_front(word: Words, count: int) -> Words:
    """The first `count` characters become '0'."""
    if not count:
        return word
    mask = (1 << (8 * count)) - 1
    return (word & _U(~mask & 0xFFFF_FFFF_FFFF_FFFF)) | _U(0x3030_3030_3030_3030 & mask)


_KEEP: Final = np.array([(1 << (8 * count)) - 1 for count in range(9)], np.uint64)


def _zeros_behind(word: Words, count: Ints) -> Words:
    """All but the first `count` characters become '0'."""
    keep = _KEEP[np.clip(count, 0, 8)]
    return (word & keep) | (_each(0x30) & ~keep)


def _hex_bytes(word: Words) -> tuple[Words, Mask]:
    """Four bytes from eight hexadecimal digits, the first in the lowest byte; and whether they are such digits."""
    letter = (word >> _U(6)) & _each(0x01)
    value = (word & _each(0x0F)) + letter * _U(9)
    right_column = (word & _each(0xF0) & ~(letter << _U(5))) == _each(0x30) + (letter << _U(4))
    right_row = (((value + _each(0x06)) >> _U(4)) & _each(0x01)) == letter
    ok = right_column & right_row & ((value & _each(0x10)) == 0)
    out = ((value & _U(0x000F_000F_000F_000F)) << _U(4)) | ((value >> _U(8)) & _U(0x000F_000F_000F_000F))
    out = (out | (out >> _U(8))) & _U(0x0000_FFFF_0000_FFFF)
    return (out | (out >> _U(16))) & _U(0xFFFF_FFFF), ok


def _read_singly(
    columns: _Columns, text: npt.NDArray[np.uint8], starts: Ints, ends: Ints, rest: Ints
) -> list[Unreadable]:
    unreadable = []
    for row in rest.tolist():
        try:
            frame = read_line(text[starts[row] : ends[row]].tobytes(), parse_line)
        except UnreadableError as error:
            unreadable.append(Unreadable(row, str(error)))
        else:
            if frame is not None:
                columns.put(row, frame)
    return unreadable


# ---------------------------------------------------------------- writing


def _packed(texts: Sequence[str], dtype: str) -> npt.NDArray[np.unsignedinteger]:
    """Short texts as numbers whose bytes, the lowest first, are the characters."""
    return np.array([int.from_bytes(text.encode(), "little") for text in texts], dtype)


_THREE: Final = _packed([f"{n:03d}" for n in range(1000)], "<u8")
_ID3: Final = _packed([f"{n:03X}" for n in range(0x800)], "<u4")
_BYTE: Final = _packed([f"{n:02X}" for n in range(256)], "<u4")
_TWO_BYTES: Final = (_BYTE[np.newaxis, :] << np.uint32(16) | _BYTE[:, np.newaxis]).T.ravel()  # first byte: the lower
_KEEP_HEX: Final = np.array([[_KEEP[min(2 * n, 8)], _KEEP[max(2 * n - 8, 0)]] for n in range(9)], "<u8")


def time_text(t_ns: Ints, width: int = 1) -> npt.NDArray[np.uint8]:
    """Seconds with six decimals as candump writes them, at least `width` digits before the point; NUL in front."""
    count = len(t_ns)
    seconds, below = np.divmod(t_ns, 1_000_000_000)
    micros = below.astype(np.uint32) // np.uint32(1000)
    distinct = np.flatnonzero(np.diff(seconds, prepend=-1))  # in a log a second lasts for many frames
    texts = np.array([f"{second:0{width}d}.".rjust(12, "\0").encode() for second in seconds[distinct].tolist()], "S12")
    wide = max((len(text.lstrip(b"\0")) for text in texts.tolist()), default=width + 1)
    out = np.empty((count, wide + 6), np.uint8)
    table = np.ascontiguousarray(texts.view(np.uint8).reshape(-1, 12)[:, 12 - wide :])
    out[:, :wide] = np.repeat(table, np.diff(distinct, append=count), axis=0)
    packed = _THREE[micros // np.uint32(1000)] | (_THREE[micros % np.uint32(1000)] << _U(24))
    out[:, wide:] = packed.view(np.uint8).reshape(count, 8)[:, :6]
    return out


def id_text(frames: Frames) -> npt.NDArray[np.uint8]:
    """Identifiers as candump writes them: three or eight digits, NUL behind."""
    wide = (frames.flags & (EXTENDED | ERROR)) != 0
    narrow = _ID3[frames.can_id & np.uint32(MAX_STANDARD_ID)]
    if not wide.any():
        three: Characters = narrow.view(np.uint8).reshape(-1, 4)[:, :3]
        return three
    number = frames.can_id | np.where((frames.flags & ERROR) != 0, np.uint32(ERROR_FLAG), np.uint32(0))
    out = np.zeros((len(frames), 2), np.uint32)
    swapped = number.byteswap()
    out[:, 0] = np.where(wide, _TWO_BYTES[swapped & np.uint32(0xFFFF)], narrow)
    out[:, 1] = np.where(wide, _TWO_BYTES[swapped >> np.uint32(16)], np.uint32(0))
    return out.view(np.uint8)


def hex_text(frames: Frames) -> npt.NDArray[np.uint8]:
    """The first eight data bytes as sixteen digits, NUL behind."""
    lengths = np.minimum(frames.length, CLASSIC_BYTES)
    if (frames.flags & REMOTE).any():
        lengths = np.where((frames.flags & REMOTE) != 0, np.uint8(0), lengths)
    digits = _TWO_BYTES[np.ascontiguousarray(frames.word).astype("<u8", copy=False).view("<u2")].view("<u8")
    kept: Characters = (digits.reshape(-1, 2) & _KEEP_HEX[lengths]).view(np.uint8)
    return kept


def channel_text(frames: Frames) -> Part:
    if len(frames.channels) == 1:
        return frames.channels[0].encode("utf-8", "replace")
    names = np.array([name.encode("utf-8", "replace") for name in frames.channels] or [b"-"])
    return np.take(names.view(np.uint8).reshape(len(names), -1), frames.channel, axis=0)


def log_parts(frames: Frames, time_digits: int = 1) -> list[Part]:
    """The columns of lines of `candump -L`; at least `time_digits` digits of seconds. Not of remote and FD frames."""
    time, can_id = time_text(frames.t_ns, time_digits), id_text(frames)
    return [b"(", time, b") ", channel_text(frames), b" ", can_id, b"#", hex_text(frames)]


def log_lines(frames: Frames, time_digits: int = 1) -> list[bytes]:
    """Each frame as a line of `candump -L`, without its line end."""
    lines = assembled(log_parts(frames, time_digits), len(frames))
    for row in np.flatnonzero(frames.flags & (REMOTE | FD)).tolist():
        lines[row] = log_line(frames.frame(row), time_digits).encode()
    return lines


def screen_lines(
    frames: Frames, *, time_digits: int | None, padded: bool = False, indented: bool = False
) -> list[bytes]:
    """Each frame as candump shows it on a screen.

    time_digits: how many digits of seconds at least; None: no times. padded: to one width, so that something may stand
    beside. indented: a frame with a 29-bit identifier was shown before; from the first one on candump indents others.
    """
    if not len(frames):
        return []
    extended = (frames.flags & EXTENDED) != 0
    indent = np.zeros((len(frames), 5), np.uint8)
    if indented or extended.any():
        indent[np.logical_or.accumulate(extended | indented) & ((frames.flags & (EXTENDED | ERROR)) == 0)] = ord(" ")
    wide_name = max(len(name) for name in frames.channels)
    names = np.array([name.rjust(wide_name).encode("utf-8", "replace") for name in frames.channels])
    name_text = names.view(np.uint8).reshape(len(names), -1)[frames.channel]
    lengths = np.array([f"   [{n}]" for n in range(9)] + [f"  [{n:02d}]" for n in range(9, MAX_FD_BYTES + 1)], "S6")
    digits = hex_text(frames).reshape(-1, CLASSIC_BYTES, 2)
    spaced = np.zeros((len(frames), CLASSIC_BYTES, 3), np.uint8)
    spaced[:, :, 1:] = digits
    spaced[:, :, 0] = np.where(digits[:, :, 0] != 0, np.uint8(ord(" ")), np.uint8(0))
    parts: list[Part] = [b" "] if time_digits is None else [b" (", time_text(frames.t_ns, time_digits), b") "]
    parts += [b" ", name_text, b"  ", indent, id_text(frames)]
    parts += [lengths[np.minimum(frames.length, MAX_FD_BYTES)].view(np.uint8).reshape(len(frames), -1)]
    parts += [b" ", spaced.reshape(len(frames), -1)]
    lines = assembled(parts, len(frames))
    for row in np.flatnonzero(frames.flags & (ERROR | REMOTE | FD)).tolist():
        frame = frames.frame(row)
        head = lines[row].partition(b"]")[0].rpartition(b"[")[0].rstrip()
        if frame.fd:
            lines[row] = head + f"  [{frame.length:02d}]  {frame.data.hex(' ').upper()}".encode()
        elif frame.remote:
            lines[row] = head + f"   [{frame.length}]  remote request".encode()
        else:
            lines[row] += b"   ERRORFRAME"
    if padded:
        width = max(map(len, lines))
        lines = [line.ljust(width) for line in lines]
    return lines
