"""Frames of a log or a live bus: one as a LogFrame, many as columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.interface.units import MS, S
from fsai_vcu.printable import printable

# Bits of `flags`.
EXTENDED: Final = 0x01
REMOTE: Final = 0x02
ERROR: Final = 0x04
FD: Final = 0x08
BRS: Final = 0x10
ESI: Final = 0x20
RECEIVED: Final = 0x40  # the log says that its computer received the frame …
SENT: Final = 0x80  # … or sent it; where neither is set the log does not say

CLASSIC_BYTES: Final = 8
OUT_OF_ORDER_NS: Final = 20 * MS
EPOCH_NS: Final = 946_684_800 * S  # 2000: earlier stamps count from something else than a calendar
_NEAR: Final = 5  # frames to each side of a step back that tell whether the clock was set

_COLUMNS: Final = ("t_ns", "can_id", "flags", "length", "word", "channel")

Ints = npt.NDArray[np.int64]
Words = npt.NDArray[np.uint64]
Mask = npt.NDArray[np.bool_]

MOST_CHANNELS: Final = 256  # that a log names; no car has a tenth of it
_OTHERS: Final = "others"  # what is said of more
_LONGEST_NAME: Final = 64  # characters of a channel; of a network interface it has 15


@dataclass(frozen=True, slots=True)
class LogFrame:
    """One frame. `t_ns`: nanoseconds of the log's clock. `sent`: by the computer that logged; None: not recorded.

    `length` is the number of data bytes; for a remote frame the number asked for. `can_id` is without flags: for an
    error frame, SocketCAN's error class bits (linux/can/error.h).
    """

    t_ns: int
    channel: str
    can_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    error: bool = False
    fd: bool = False
    brs: bool = False
    esi: bool = False
    sent: bool | None = None
    length: int = -1

    def __post_init__(self) -> None:
        if self.length < 0:
            object.__setattr__(self, "length", len(self.data))

    @property
    def flags(self) -> int:
        direction = 0 if self.sent is None else SENT if self.sent else RECEIVED
        marks = (self.extended, self.remote, self.error, self.fd, self.brs, self.esi)
        return direction | sum(mark << place for place, mark in enumerate(marks))


@dataclass(frozen=True, slots=True)
class Frames:
    """Frames as columns, all of one length, in the order of the log.

    word: the first eight data bytes as a little-endian number; bytes that a frame does not have are zero.
    length: data bytes, as in LogFrame. channel: index into `channels`.
    long: the whole payload of each frame with more than eight bytes, by row.
    """

    t_ns: Ints
    can_id: npt.NDArray[np.uint32]
    flags: npt.NDArray[np.uint8]
    length: npt.NDArray[np.uint8]
    word: Words
    channel: npt.NDArray[np.int32]
    channels: Sequence[str] = ()
    long: Mapping[int, bytes] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def data(self) -> npt.NDArray[np.uint8]:
        """The first eight data bytes, shape [n, 8]."""
        return np.ascontiguousarray(self.word).astype("<u8", copy=False).view(np.uint8).reshape(-1, CLASSIC_BYTES)

    def payload(self, row: int) -> bytes:
        """All data bytes of one frame: as many as it has, none for a remote frame."""
        if self.flags[row] & REMOTE:
            return b""
        whole = self.long.get(row)
        if whole is not None:
            return whole
        return int(self.word[row]).to_bytes(CLASSIC_BYTES, "little")[: int(self.length[row])]

    def frame(self, row: int) -> LogFrame:
        flags = int(self.flags[row])
        head = (int(self.t_ns[row]), self.channels[int(self.channel[row])], int(self.can_id[row]), self.payload(row))
        kind = (bool(flags & EXTENDED), bool(flags & REMOTE), bool(flags & ERROR))
        fd = (bool(flags & FD), bool(flags & BRS), bool(flags & ESI))
        sent = True if flags & SENT else False if flags & RECEIVED else None
        return LogFrame(*head, *kind, *fd, sent, int(self.length[row]))

    def __iter__(self) -> Iterator[LogFrame]:
        return (self.frame(row) for row in range(len(self)))

    def only(self, rows: Mask | Ints) -> Frames:
        """The frames chosen by a mask or by rows in ascending order."""
        if rows.dtype == np.bool_ and rows.all():
            return self
        long: dict[int, bytes] = {}
        if self.long:
            chosen = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
            places = {int(old): new for new, old in enumerate(chosen)}
            long = {places[old]: whole for old, whole in self.long.items() if old in places}
        return replace(self, long=long, **{name: getattr(self, name)[rows] for name in _COLUMNS})

    def at(self, t_ns: Ints) -> Frames:
        """The same frames at other times."""
        return replace(self, t_ns=t_ns)

    def head(self, count: int) -> Frames:
        """The first `count` frames."""
        return self.only(np.arange(min(count, len(self)), dtype=np.int64))


def frames_of(records: Iterable[LogFrame], channels: list[str] | None = None) -> Frames:
    """Columns from single frames. `channels` is the log's own growing list of names, to number them alike."""
    names = [] if channels is None else channels
    rows = list(records)
    spelt = {channel: _name_of(channel) for channel in dict.fromkeys(frame.channel for frame in rows)}
    for channel, name in spelt.items():
        if name not in names and len(names) >= MOST_CHANNELS:
            name = spelt[channel] = _OTHERS
        if name not in names:
            names.append(name)
    index = {name: number for number, name in enumerate(names)}
    count = len(rows)
    return Frames(
        np.fromiter((frame.t_ns for frame in rows), np.int64, count),
        np.fromiter((frame.can_id for frame in rows), np.uint32, count),
        np.fromiter((frame.flags for frame in rows), np.uint8, count),
        np.fromiter((frame.length for frame in rows), np.uint8, count),
        np.fromiter((int.from_bytes(frame.data[:CLASSIC_BYTES], "little") for frame in rows), np.uint64, count),
        np.fromiter((index[spelt[frame.channel]] for frame in rows), np.int32, count),
        names,
        {row: frame.data for row, frame in enumerate(rows) if len(frame.data) > CLASSIC_BYTES},
    )


def _name_of(channel: str) -> str:
    """A channel's name as it is shown, and as a word in a line of candump: a capture may have any text there."""
    return printable("_".join(channel[:_LONGEST_NAME].split(" ")))[:_LONGEST_NAME]


def joined(parts: Iterable[Frames]) -> Frames:
    """One run of frames from several. Logs number their buses each for itself: those of one name become one.

    Parts are copied as they come: of those that nobody else keeps there is never more than one beside the whole.
    """
    kept = filter(len, parts)
    begin = list(islice(kept, 2))
    if len(begin) < 2:
        return begin[0] if begin else frames_of(())
    channels = begin[0].channels
    numbers: dict[str, int] = {}
    columns: dict[str, Any] = {name: np.empty(0, getattr(begin[0], name).dtype) for name in _COLUMNS}
    long: dict[int, bytes] = {}
    count = 0
    for part in chain(begin, kept):
        numbers = numbers or ({} if part.channels is channels else {name: n for n, name in enumerate(channels)})
        if numbers:
            own = np.array([numbers.setdefault(name, len(numbers)) for name in part.channels], np.int32)
            part = replace(part, channel=own[part.channel])
        long |= {row + count: whole for row, whole in part.long.items()}
        end = count + len(part)
        for name, column in columns.items():
            if end > len(column):
                column.resize(end + end // 8, refcheck=False)
            column[count:end] = getattr(part, name)
        count = end
    columns = {name: column[:count] for name, column in columns.items()}
    return Frames(**columns, channels=[*numbers] or channels, long=long)


def set_right(t_ns: Ints, before_ns: int | None = None) -> tuple[Ints, Ints]:
    """The times without the steps back of a clock that was set, and by how much each is one.

    before_ns: of the frame before. Small steps are no clock that was set, but frames of two receivers out of order, and
    stay. Nor is one where the next frames are no earlier than the ones before: then a few frames were stamped wrongly,
    too late or too early. They get the time of the next one or of the one before.
    """
    if (before_ns is None or t_ns[0] >= before_ns) and (t_ns[1:] >= t_ns[:-1]).all():
        return t_ns, np.zeros_like(t_ns)
    known_ns = np.concatenate(([t_ns[0] if before_ns is None else before_ns], t_ns))
    back_ns = -np.diff(known_ns)
    at = np.flatnonzero(back_ns > OUT_OF_ORDER_NS)[:, None]
    near = np.arange(_NEAR)
    rows_before, rows_after = (np.clip(rows, 0, len(t_ns)) for rows in (at - near, at + 1 + near))
    before, after = (np.sort(known_ns[rows])[:, _NEAR // 2] for rows in (rows_before, rows_after))
    steps_ns = np.zeros_like(back_ns)
    set_back = at[after < before]
    steps_ns[set_back] = back_ns[set_back]
    too_late = (after >= before) & (known_ns[at[:, 0] + 1] >= before)
    too_early = (after >= before) & ~too_late
    for wrong, rows, right, cut in (
        (too_late, rows_before, at + 1, np.minimum),
        (too_early, rows_after, at, np.maximum),
    ):
        right_ns = np.broadcast_to(known_ns[right], rows.shape)
        far = wrong[:, None] & (np.abs(known_ns[rows] - right_ns) > OUT_OF_ORDER_NS)
        cut.at(known_ns, rows[far], right_ns[far])
    return known_ns[1:] + np.cumsum(steps_ns), steps_ns


def straightened(t_ns: Ints, before_ns: int | None = None) -> tuple[Ints, Ints]:
    """The times set right, each from that of the frame before it on; and by how much each is a step back."""
    moved_ns, steps_ns = set_right(t_ns, before_ns)
    return np.maximum.accumulate(moved_ns if before_ns is None else np.maximum(moved_ns, before_ns)), steps_ns
