"""Columns of frames as text of candump: the lines of a whole block written at once."""

from __future__ import annotations

from typing import Final

import numpy as np

from fsai_vcu.diagnostics.log.candump_line import ERROR_FLAG, MAX_STANDARD_ID, log_line
from fsai_vcu.diagnostics.log.characters import Part, Texts, items_of, lines_of, texts_of, widened
from fsai_vcu.diagnostics.log.frames import CLASSIC_BYTES, ERROR, EXTENDED, FD, REMOTE, SENT, Frames, Ints

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
