"""Rows of text formats: what the readers of all of them have in common.

A reader is made for each file and called with each line. It returns the frame on it, None where the line is none, and
raises ValueError where it cannot be read.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, NamedTuple

from fsai_vcu.diagnostics.log.candump_line import (
    MAX_CLASSIC_DLC,
    MAX_EXTENDED_ID,
    MAX_FD_BYTES,
    MAX_NS,
    MAX_STANDARD_ID,
)
from fsai_vcu.diagnostics.log.frames import Ints, LogFrame
from fsai_vcu.diagnostics.log.problems import Problems

FD_BYTES: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Data bytes of each DLC."""
REQUESTS: Final = "a request to send, which is not a frame on the bus"

# SocketCAN's error classes and details (linux/can/error.h).
CONTROLLER: Final = 0x04
PROTOCOL: Final = 0x08
BUS_OFF: Final = 0x40
BUS_ERROR: Final = 0x80
WARNING: Final = 0x0C  # of `controller`: both counters
PASSIVE: Final = 0x30
SINGLE_BIT: Final = 0x01  # of `protocol`
FORM: Final = 0x02
STUFFING: Final = 0x04
OVERLOAD: Final = 0x20

WAYS: Final = {"rx": False, "tx": True}
"""Direction of a row: `sent` of its frame."""

_TIME = re.compile(r"(-?)(\d{1,18})(?:[.,](\d{1,12}))?")
_TWO_DIGITS = re.compile(r"(?:[0-9A-Fa-f]{2}(?: |$))*")
_NUMBERS = re.compile(r"(?:[0-9A-Fa-f]{1,3}(?: |$))*")


class Pattern(NamedTuple):
    """The head of most rows of a file, up to the data bytes: rows alike are read together (blocks.py).

    expression: its groups are `id`; `time` and `decimals`, in units of `unit_ns` since `begin_ns`; `number`, of the
    row; `length`, of the data, of which each byte then follows a space (without it the bytes follow each other);
    `way`. channel, wide: its bus, and whether its identifier has 29 bits. marked: such a one may say of itself that it
    is an error frame. tail: what may stand behind the data beside spaces; None: nothing may.
    """

    expression: re.Pattern[bytes]
    channel: Callable[[re.Match[bytes]], str]
    wide: Callable[[re.Match[bytes]], bool]
    unit_ns: int = 1_000_000_000
    begin_ns: int = 0
    marked: bool = False
    tail: bytes | None = b""


class Rows:
    """Reads the rows of one file; `told` gets what is said beside the frames."""

    encoding = "utf-8"

    def __init__(self, told: Problems) -> None:
        self.told = told

    def pattern(self) -> Pattern | None:
        """The pattern of most rows, by what is known so far; None: one by one. What it takes, a call takes alike.

        It is asked for again where `state` has changed.
        """
        return None

    def state(self) -> object:
        """Everything that the rows so far have told of how the following ones are read."""
        return None

    def times(self) -> Callable[[Ints], Ints] | None:
        """Makes the times of the following frames, up to where `state` changes, from what their rows say; None: as is.

        It is asked for before those rows are read, and called after them.
        """
        return None

    def __call__(self, line: str) -> LogFrame | None:
        """The frame on a line, None where there is none to be. Raises ValueError."""
        raise NotImplementedError

    def is_whole(self, line: str) -> bool:
        """True if a line without its end is whole: as many data bytes as it announces, the last one of two digits.

        That they are as many is checked when it is read.
        """
        return re.search(r"\s[0-9A-Fa-f]{2}\s*$", line) is not None

    def missing(self) -> str:
        """Return what the file announced and does not have at its end, as the end of a sentence; '' where nothing."""
        return ""


def ns_of(text: str, unit_ns: int = 1_000_000_000) -> int:
    """A decimal number of units in ns, with a point or a comma. Raises ValueError."""
    found = _TIME.fullmatch(text)
    if found is None:
        raise ValueError(f"invalid time: {text[:40]}")
    fraction = found[3] or ""
    ns = int(found[2] + fraction) * unit_ns // int(10 ** len(fraction))
    return -ns if found[1] else ns


def frame_of(
    t_ns: int,
    channel: str,
    id_text: str,
    data: bytes,
    length: int | None = None,
    *,
    base: int = 16,
    extended: bool = False,
    remote: bool = False,
    fd: bool = False,
    brs: bool = False,
    esi: bool = False,
    sent: bool | None = None,
) -> LogFrame:
    """A frame of a row, checked. length: data bytes that are announced. Raises ValueError."""
    if not 0 <= t_ns <= MAX_NS:
        raise ValueError(f"invalid time: {t_ns / 1e9:.6f} s")
    try:
        can_id = int(id_text, base)
    except ValueError:
        raise ValueError(f"invalid identifier: {id_text[:40]}") from None
    if not 0 <= can_id <= (MAX_EXTENDED_ID if extended else MAX_STANDARD_ID):
        raise ValueError(f"no {29 if extended else 11}-bit identifier: {id_text[:40]}")
    announced = len(data) if length is None else length
    if not 0 <= announced <= (MAX_FD_BYTES if fd else MAX_CLASSIC_DLC):
        raise ValueError(f"{announced} data bytes")
    if not remote and len(data) != announced:
        raise ValueError(f"{len(data)} data bytes where {announced} are announced")
    data = b"" if remote else data
    return LogFrame(t_ns, channel, can_id, data, extended, remote, False, fd, brs, esi, sent, announced)


def bytes_of(words: list[str], base: int = 16) -> bytes:
    """Data bytes of a row, one a word. Raises ValueError."""
    text = " ".join(words)
    if base == 16 and _TWO_DIGITS.fullmatch(text):
        return bytes.fromhex(text)
    try:
        if not _NUMBERS.fullmatch(text):
            raise ValueError
        return bytes(int(word, base) for word in words)
    except ValueError:
        raise ValueError(f"no data bytes: {text[:40]}") from None


def error_frame(
    t_ns: int, channel: str, kinds: int, *, controller: int = 0, protocol: int = 0, sent: int = 0, received: int = 0
) -> LogFrame:
    """Error frame of SocketCAN for a bus error that a log reports. sent, received: the error counters."""
    if not 0 <= t_ns <= MAX_NS:
        raise ValueError(f"invalid time: {t_ns / 1e9:.6f} s")
    data = bytes((0, controller, protocol, 0, 0, 0, min(sent, 255), min(received, 255)))
    return LogFrame(t_ns, channel, kinds, data, error=True)


def counted_errors(t_ns: int, channel: str, errors: int) -> LogFrame:
    """Error frame for errors of the bus that a log only counts, in a row of statistics; none of them: overloads."""
    return error_frame(t_ns, channel, BUS_ERROR) if errors else error_frame(t_ns, channel, PROTOCOL, protocol=OVERLOAD)


def told_error(t_ns: int, channel: str, number: int, data: bytes, sent: bool | None = None) -> LogFrame:
    """Error frame that a log has as SocketCAN gave it: its identifier and its data. Raises ValueError."""
    if not 0 <= t_ns <= MAX_NS:
        raise ValueError(f"invalid time: {t_ns / 1e9:.6f} s")
    return LogFrame(t_ns, channel, number & MAX_EXTENDED_ID, data[:MAX_CLASSIC_DLC], error=True, sent=sent)


def state_frame(t_ns: int, channel: str, sent: int, received: int) -> LogFrame:
    """An error frame by a controller's error counters; 256 of the first is bus-off."""
    most = max(sent, received)
    if sent > 255:
        return error_frame(t_ns, channel, BUS_OFF, sent=sent, received=received)
    if most < 96:
        return error_frame(t_ns, channel, BUS_ERROR, sent=sent, received=received)
    # The lower of each pair of bits is of receiving.
    bits = (PASSIVE if most > 127 else WARNING) & (0x28 if sent == most else 0x14)
    return error_frame(t_ns, channel, CONTROLLER, controller=bits, sent=sent, received=received)
