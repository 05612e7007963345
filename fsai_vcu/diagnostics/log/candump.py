"""candump's text formats as columns: a whole block of lines read and written at once.

Lines of one shape (the constant text around time, identifier and payload) are read together, as columns of characters.
Whatever does not pass every check there is read by candump_line.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.candump_line import (
    ERROR_FLAG,
    MAX_EXTENDED_ID,
    MAX_SECONDS,
    MAX_STANDARD_ID,
    Unreadable,
    log_line,
    parse_line,
    read_lines,
)
from fsai_vcu.diagnostics.log.characters import Part, Texts, items_of, lines_of, texts_of, widened
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
    frames_of,
    joined,
)
from fsai_vcu.printable import printable

_FRONT, _BACK = 16, 128  # bytes around a block: the columns of a line may end behind it
Characters = npt.NDArray[np.uint8]
_EIGHT = np.arange(CLASSIC_BYTES)[:, np.newaxis]
_SHAPES = 40  # more kinds of lines than that in one block, and the rest is read one by one

_SHAPE = re.compile(
    rb"(?P<before> {0,8})(?:(?P<open>\()(?P<time>\d{1,10})\.\d{6}(?P<close>\) {1,8}))?"
    rb"(?P<between>(?P<channel>[^\s()]{1,15}) {1,8}(?:(?P<way>[RT])X - -  )?)"
    rb"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})(?P<behind>#| {1,8}\[)"
)


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
            printable(found["channel"].decode("ascii", "replace")),
            len(found["id"]),
            found["behind"],
            {None: 0, b"R": RECEIVED, b"T": SENT}[found["way"]],
        )


def parse_block(
    block: npt.NDArray[np.uint8], channels: list[str], parse: Callable[[str], LogFrame | None] = parse_line
) -> tuple[Frames, list[Unreadable], int]:
    """Frames of whole lines, each with its line end; new channels are added to `channels`.

    parse: for lines of no common shape.

    Returns (frames, what could not be read, number of lines).
    """
    text = np.concatenate([np.zeros(_FRONT, np.uint8), block, np.zeros(_BACK, np.uint8)])
    ends = np.flatnonzero(text == ord("\n"))
    starts = np.concatenate([[_FRONT], ends[:-1] + 1])[: len(ends)]
    if len(ends) and text[ends[0] - 1] == ord("\r"):
        ends = ends - (text[ends - 1] == ord("\r"))
    parts: list[Frames] = []
    rows: list[Ints] = []
    rest = np.arange(len(ends))
    for _ in range(_SHAPES):
        shape = _next_shape(text, starts, ends, rest)
        if shape is None:
            break
        frames, read = _of_shape(text, starts[rest], ends[rest], shape, channels)
        parts.append(frames)
        rows.append(rest[read])
        rest = rest[~read]
    remaining = ((row, text[starts[row] : ends[row]].tobytes()) for row in rest.tolist())
    singly, unreadable = read_lines(remaining, parse)
    whole = joined([*parts, frames_of(singly.values(), channels)])
    if len(parts) + len(singly) > 1:
        whole = whole.only(np.argsort(np.concatenate([*rows, np.array([*singly], np.int64)])))
    return whole, unreadable, len(ends)


def _next_shape(text: npt.NDArray[np.uint8], starts: Ints, ends: Ints, rest: Ints) -> _Shape | None:
    """The shape of the first of the remaining lines that has one."""
    for row in rest[:200]:
        found = _SHAPE.match(text[starts[row] : ends[row]].tobytes())
        if found and (found["behind"] != b"#" or (found["time"] and not found["way"])):
            return _Shape.of(found)
    return None


def _of_shape(
    text: npt.NDArray[np.uint8], starts: Ints, ends: Ints, shape: _Shape, channels: list[str]
) -> tuple[Frames, Mask]:
    """The frames on those of the lines that have this shape, and which these are."""
    time_at = len(shape.before)
    between_at = time_at + (shape.digits + len(".uuuuuu") if shape.digits else 0)
    id_at = between_at + len(shape.between)
    behind_at = id_at + shape.id_width
    data_at = behind_at + len(shape.behind)

    eights = -(-(data_at + (2 if shape.behind == b"#" else 3) * CLASSIC_BYTES + 3) // 8)
    lines = np.ndarray((len(text) - 8 * eights + 1,), f"V{8 * eights}", text, strides=(1,))[starts]
    # A row for each place: what is done to a row is done to all lines at once. Eight at a time they are turned quicker.
    turned = np.ascontiguousarray(lines.view(np.uint64).reshape(-1, eights).T).view(np.uint8)
    columns = np.ascontiguousarray(turned.reshape(eights, -1, 8).transpose(0, 2, 1)).reshape(8 * eights, -1)

    ok: Mask = ends - starts >= data_at
    for at, constant in ((0, shape.before), (between_at, shape.between), (behind_at, shape.behind)):
        expected = np.frombuffer(constant, np.uint8)[:, np.newaxis]
        ok &= (columns[at : at + len(constant)] == expected).all(axis=0)

    t_ns = np.zeros(len(starts), np.int64)
    if shape.digits:
        dot = time_at + shape.digits
        ok &= text[starts + dot] == ord(".")
        digits = np.concatenate([columns[time_at:dot], columns[dot + 1 : between_at]]) - np.uint8(ord("0"))
        ok &= (digits <= 9).all(axis=0)
        t_ns = _number(digits, 10) * 1000
        ok &= (t_ns >= 0) & (t_ns < (MAX_SECONDS + 1) * 1_000_000_000)  # too great a number has become negative

    nibbles, id_ok = _nibbles(columns[id_at:behind_at])
    ok &= id_ok.all(axis=0)
    can_id = _number(nibbles, 16)
    flags = np.full(len(starts), shape.flags, np.uint8)
    if shape.id_width == 3:
        ok &= can_id <= MAX_STANDARD_ID
    else:
        ok &= can_id <= ERROR_FLAG | MAX_EXTENDED_ID
        flags |= np.where(can_id & ERROR_FLAG, np.uint8(ERROR), np.uint8(EXTENDED))
        can_id &= MAX_EXTENDED_ID

    length = ends - starts - data_at
    if shape.behind == b"#":
        way = text[ends - 1]
        marked = (text[ends - 2] == ord(" ")) & ((way == ord("R")) | (way == ord("T"))) & (length >= 2)
        flags |= np.where(marked, np.where(way == ord("T"), np.uint8(SENT), np.uint8(RECEIVED)), np.uint8(0))
        length -= 2 * marked
        ok &= (length >= 0) & (length & 1 == 0)
        length >>= 1
        high, low = columns[data_at : data_at + 16 : 2], columns[data_at + 1 : data_at + 17 : 2]
    else:  # "2]  01 23": a space before each byte, and one more before the first
        characters, length = length, text[starts + data_at].astype(np.int64) - ord("0")
        ok &= (length > 0) & (characters == 3 + 3 * length)
        ok &= (columns[data_at + 1 : data_at + 3] == [[ord("]")], [ord(" ")]]).all(axis=0)
        spaces, high, low = (columns[data_at + 3 + at : data_at + 27 + at : 3] for at in range(3))
        ok &= ((spaces == ord(" ")) | (length <= _EIGHT)).all(axis=0)
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


def _nibbles(characters: Characters) -> tuple[Characters, Mask]:
    """What hexadecimal digits are worth, and whether they are such digits."""
    digit, letter = characters - np.uint8(ord("0")), (characters | np.uint8(0x20)) - np.uint8(ord("a"))
    worth = (characters & np.uint8(15)) + np.uint8(9) * (characters >> np.uint8(6))
    return worth, (digit <= 9) | (letter <= 5)


def _number(digits: Characters, base: int) -> Ints:
    """Of each column of digits, the highest first."""
    number = np.zeros(digits.shape[1], np.int64)
    for row in digits:
        number *= base
        number += row
    return number


# ---------------------------------------------------------------- writing


_THREE: Final = np.array([f"{n:03d}" for n in range(1000)], "S3")
_ID3: Final = np.array([f"{n:03X}" for n in range(MAX_STANDARD_ID + 1)], "S3")
_BYTE: Final = np.array([f"{n:02X}" for n in range(256)], "S2")


def time_text(t_ns: Ints, width: int = 1) -> Texts:
    """Seconds with six decimals as candump writes them, at least `width` digits before the point."""
    seconds = t_ns // 1_000_000_000  # dividing is quick, the remainder is not
    micros = (t_ns - seconds * 1_000_000_000).astype(np.uint32) // np.uint32(1000)
    millis = micros // np.uint32(1000)
    begins = np.flatnonzero(np.diff(seconds, prepend=-1))  # in a log a second lasts for many frames
    texts = [f"{second:0{width}d}." for second in seconds[begins].tolist()]
    whole, lengths = texts_of(texts)
    lasts = np.diff(begins, append=len(t_ns))
    out = np.empty(len(t_ns), [("seconds", whole.dtype), ("millis", "S3"), ("micros", "S3")])
    out["seconds"] = np.repeat(whole, lasts)
    out["millis"] = _THREE.take(millis)
    out["micros"] = _THREE.take(micros - millis * np.uint32(1000))
    alike = len(set(map(len, texts))) < 2
    return Texts(out.view(f"V{out.itemsize}"), out.itemsize if alike else np.repeat(lengths, lasts) + 6)


def id_text(frames: Frames) -> Texts:
    """Identifiers as candump writes them: three or eight digits."""
    wide = (frames.flags & (EXTENDED | ERROR)) != 0
    three = _ID3.take(frames.can_id & np.uint32(MAX_STANDARD_ID)).view("V3")
    if not wide.any():
        return Texts(three, 3)
    number = frames.can_id | np.where((frames.flags & ERROR) != 0, np.uint32(ERROR_FLAG), np.uint32(0))
    eight = items_of(_BYTE.take(number.astype(">u4").view(np.uint8).reshape(-1, 4)))
    return Texts(np.where(wide, eight, widened(three, 8)), np.where(wide, 8, 3))


def hex_text(frames: Frames) -> Texts:
    """The first eight data bytes in hexadecimal digits."""
    length = np.where((frames.flags & REMOTE) != 0, 0, np.minimum(frames.length, CLASSIC_BYTES))
    word = frames.word << (8 * (CLASSIC_BYTES - length)).astype(np.uint64)  # the last of its bytes is the last
    return Texts(items_of(_BYTE.take(word.view(np.uint8).reshape(-1, CLASSIC_BYTES))), 2 * length)


def channel_text(frames: Frames) -> Part:
    if len(frames.channels) == 1:
        return frames.channels[0].encode("utf-8", "replace")
    return texts_of(frames.channels or ["-"]).at(frames.channel)


def log_parts(frames: Frames, time_digits: int = 1) -> list[Part]:
    """The columns of lines of `candump -L`; at least `time_digits` digits of seconds. Not of remote and FD frames."""
    time, can_id = time_text(frames.t_ns, time_digits), id_text(frames)
    return [b"(", time, b") ", channel_text(frames), b" ", can_id, b"#", hex_text(frames)]


def log_lines(frames: Frames, time_digits: int = 1, *, marks: bool = False) -> list[bytes]:
    """Each frame as a line of `candump -L`, without its line end; with `marks` of `candump -L -x`, R or T."""
    lines = bytes(lines_of(log_parts(frames, time_digits), len(frames))).split(b"\n")[:-1]
    for row in np.flatnonzero(frames.flags & (REMOTE | FD)).tolist():
        lines[row] = log_line(frames.frame(row), time_digits).encode()
    if marks:
        sent = (frames.flags & SENT).tolist()
        lines = [line + (b" T" if ours else b" R") for line, ours in zip(lines, sent, strict=True)]
    return lines
