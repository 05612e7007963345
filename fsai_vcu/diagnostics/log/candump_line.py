"""candump's text formats, line by line: every manner of them is read, what is no frame is reported."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from datetime import datetime
from typing import Final, NamedTuple

from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.printable import printable

MAX_SECONDS: Final = 9_223_372_035  # beyond it a time in ns would not fit in 64 bits
MAX_NS: Final = MAX_SECONDS * 1_000_000_000
MAX_STANDARD_ID: Final = 0x7FF
MAX_EXTENDED_ID: Final = 0x1FFF_FFFF
ERROR_FLAG: Final = 0x2000_0000  # linux/can.h, CAN_ERR_FLAG
MAX_CLASSIC_DLC: Final = 8
MAX_FD_BYTES: Final = 64
LONGEST_LINE: Final = 4096
"""Characters of a line; a frame with all that any tool writes beside it takes a tenth of it."""
_SAID: Final = 1000  # of the lines read together that are no frames; the others are only counted

_LOG_LINE = re.compile(
    r"\s*\((?P<s>\d{1,11})\.(?P<f>\d{1,9})\)\s+(?P<ch>\S+)\s+(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})"
    r"#(?:(?P<fd>#[0-9A-Fa-f])?(?P<data>(?:[0-9A-Fa-f]{2}|\.)*)(?P<raw_dlc>_[9A-Fa-f])?|(?P<remote>[Rr](?P<asked>[0-8]?)(?:_[9A-Fa-f])?))"
    r"(?:\s+(?P<way>[RTrt])(?:\s.*)?)?\s*"
)
_SCREEN_LINE = re.compile(
    r"\s*(?:\((?P<time>[^()]*)\)\s+)?(?P<ch>\S+)\s+(?:(?P<way>[RT]X)\s+(?P<brs>[B-])\s+(?P<esi>[E-])\s+)?"
    r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})\s+(?P<open>[\[{])(?P<length>\d+)[\]}]"
    r"(?:\s+(?P<data>remote request|[0-9A-Fa-f]{2}(?: [0-9A-Fa-f]{2})*))?(?:\s+.*)?"
)
_SECONDS = re.compile(r"(\d{1,11})\.(\d{1,9})")


class Unreadable(NamedTuple):
    """A line that is no frame: its number, and what is wrong with it and its beginning, for a person."""

    line: int
    reason: str


def read_lines(
    lines: Iterable[tuple[int, bytes]],
    parse: Callable[[str], LogFrame | None],
    encoding: str,
    frames: dict[int, LogFrame],
    unreadable: list[Unreadable],
) -> None:
    """Add the frames that `parse` finds (or its ValueErrors), by the numbers of their lines. Empty lines are none.

    encoding: 'ascii' takes nothing else for text; in any other what is no text of it is replaced.
    """
    errors = "strict" if encoding == "ascii" else "replace"
    for number, line in lines:
        if len(line) > LONGEST_LINE:
            unreadable.append(Unreadable(number, too_long(line)))
            continue
        if not line.strip():
            continue
        try:
            frame = parse(line.decode(encoding, errors))
        except ValueError as error:
            if len(unreadable) >= _SAID:
                unreadable.append(Unreadable(number, "no frame either"))
                continue
            what = "not text" if isinstance(error, UnicodeDecodeError) else str(error)
            unreadable.append(Unreadable(number, f"{what}: {_beginning(line)}"))
        else:
            if frame is not None:
                frames[number] = frame


def too_long(line: bytes) -> str:
    """Describe a line that is longer than `LONGEST_LINE`, given it or its beginning."""
    return f"longer than {LONGEST_LINE} characters: {_beginning(line)}"


def _beginning(line: bytes) -> str:
    shown = line[:60].decode("ascii", "backslashreplace")
    return f"'{printable(shown)}{'…' if len(line) > 60 else ''}'"


def whole_line(line: str) -> bool:
    """Return true where a line without its end has a whole frame, which cannot be longer than it is."""
    digits = line.partition("#")[2].strip()
    return len(digits) == 2 * MAX_CLASSIC_DLC or digits.endswith((" R", " T"))


def parse_line(line: str) -> LogFrame:
    """The frame on one line of `candump -L` or of candump's screen output. Raises ValueError."""
    found = _LOG_LINE.fullmatch(line)
    if found:
        return _from_log_line(found)
    found = _SCREEN_LINE.fullmatch(line)
    if found:
        return _from_screen_line(found)
    raise ValueError("not a line of candump")


def _from_log_line(found: re.Match[str]) -> LogFrame:
    t_ns = _time_ns(found["s"], found["f"])
    can_id, extended, error = _identifier(found["id"])
    sent = {"T": True, "R": False}.get((found["way"] or "").upper())
    channel = found["ch"]
    if found["remote"]:
        return LogFrame(t_ns, channel, can_id, b"", extended, True, error, sent=sent, length=int(found["asked"] or 0))
    data = bytes.fromhex(found["data"].replace(".", ""))
    fd = found["fd"] is not None
    bits = int(found["fd"][1], 16) if fd else 0
    _check_length(len(data), fd)
    marks = (extended, False, error, fd, bool(bits & 1), bool(bits & 2))  # linux/can.h, CANFD_BRS and CANFD_ESI
    return LogFrame(t_ns, channel, can_id, data, *marks, sent=sent)


def _from_screen_line(found: re.Match[str]) -> LogFrame:
    """Return the frame of a matched line of candump's screen output."""
    can_id, extended, error = _identifier(found["id"])
    length = int(found["length"])
    text = found["data"] or ""
    sent = {"TX": True, "RX": False}.get(found["way"] or "")
    t_ns = _screen_time_ns(found["time"])
    if text == "remote request":
        return LogFrame(t_ns, found["ch"], can_id, b"", extended, True, error, sent=sent, length=length)
    data = bytes.fromhex(text)
    if len(data) != length:
        raise ValueError(f"{len(data)} data bytes where {length} are announced")
    brs, esi = found["brs"] == "B", found["esi"] == "E"
    fd = length > MAX_CLASSIC_DLC or brs or esi
    _check_length(length, fd)
    return LogFrame(t_ns, found["ch"], can_id, data, extended, False, error, fd, brs, esi, sent)


def _identifier(text: str) -> tuple[int, bool, bool]:
    number = int(text, 16)
    if len(text) == 3:
        if number > MAX_STANDARD_ID:
            raise ValueError(f"no 11-bit identifier: {text}")
        return number, False, False
    if number & ERROR_FLAG and number <= ERROR_FLAG | MAX_EXTENDED_ID:
        return number & MAX_EXTENDED_ID, False, True
    if number > MAX_EXTENDED_ID:
        raise ValueError(f"no 29-bit identifier: {text}")
    return number, True, False


def _check_length(length: int, fd: bool) -> None:
    if length > (MAX_FD_BYTES if fd else MAX_CLASSIC_DLC):
        raise ValueError(f"{length} data bytes")


def _time_ns(seconds: str, fraction: str) -> int:
    if int(seconds) > MAX_SECONDS:
        raise ValueError(f"invalid time: {seconds}.{fraction}")
    return int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))


def _screen_time_ns(text: str | None) -> int:
    """Read the time of a line of the screen (ns); 0 where candump wrote no times."""
    if text is None:
        return 0
    found = _SECONDS.fullmatch(text.strip())
    if found:
        return _time_ns(found[1], found[2])
    try:
        date, _, fraction = text.strip().partition(".")
        return int(datetime.strptime(date, "%Y-%m-%d %H:%M:%S").timestamp()) * 1_000_000_000 + int(
            (fraction or "0").ljust(9, "0")[:9]
        )
    except (ValueError, OverflowError):
        raise ValueError(f"invalid time: {text}") from None


def log_line(frame: LogFrame, time_digits: int = 1) -> str:
    """The frame as a line of `candump -L`, without its line end; at least `time_digits` digits of seconds."""
    return f"({time_text(frame.t_ns, time_digits)}) {frame.channel} {_identifier_text(frame)}#{_payload_text(frame)}"


def screen_line(
    frame: LogFrame,
    time: str = "",
    *,
    width: int = 0,
    indented: bool = False,
    extra: bool = False,
    ascii_: bool = False,
) -> str:
    """The frame as candump shows it on a screen (can-utils, lib.c).

    time: what stands in brackets. width: of the longest channel's name. indented: as candump does with an 11-bit
    identifier once it has seen one of 29 bits. extra: direction and FD flags (-x); received, where nothing else is
    known. ascii_: -a.
    """
    way = f"  {'TX' if frame.sent else 'RX'} {'B' if frame.brs else '-'} {'E' if frame.esi else '-'}" if extra else ""
    indent = " " * 5 if indented and not (frame.extended or frame.error) else ""
    head = f" {f'({time}) ' if time else ''} {frame.channel:>{width}}{way}  {indent}{_identifier_text(frame)}"
    length = f"  [{frame.length:02d}]" if frame.fd else f"   [{frame.length}]"
    if frame.remote:
        return f"{head}{length}  remote request"
    line = f"{head}{length} {''.join(f' {byte:02X}' for byte in frame.data)}"
    behind = " " * (3 * (MAX_CLASSIC_DLC - len(frame.data)) + 3)
    if frame.error:
        return f"{line}{behind}ERRORFRAME"
    if ascii_ and len(frame.data) <= MAX_CLASSIC_DLC:
        line += f"{behind}'{''.join(chr(byte) if 0x1F < byte < 0x7F else '.' for byte in frame.data)}'"
    return line


def time_text(t_ns: int, digits: int = 1) -> str:
    """Seconds with six decimals, as candump writes them."""
    return f"{t_ns // 1_000_000_000:0{digits}d}.{t_ns // 1000 % 1_000_000:06d}"


def date_text(t_ns: int) -> str:
    """Date and time of day, local, as `candump -t A` writes them."""
    return f"{datetime.fromtimestamp(t_ns // 1_000_000_000):%Y-%m-%d %H:%M:%S}.{t_ns // 1000 % 1_000_000:06d}"


def _identifier_text(frame: LogFrame) -> str:
    if frame.error:
        return f"{frame.can_id | ERROR_FLAG:08X}"
    return f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"


def _payload_text(frame: LogFrame) -> str:
    """Return the text behind the '#' in a log of candump."""
    if frame.remote:
        return f"R{frame.length or ''}"
    if frame.fd:
        return f"#{int(frame.brs) | int(frame.esi) << 1:X}{frame.data.hex().upper()}"
    return frame.data.hex().upper()
