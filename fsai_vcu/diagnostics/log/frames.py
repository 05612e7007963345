"""Frames of a log or a live bus as columns; one of them is a LogFrame (frame.py)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.frame import (
    BRS as BRS,
)
from fsai_vcu.diagnostics.log.frame import (
    CLASSIC_BYTES as CLASSIC_BYTES,
)
from fsai_vcu.diagnostics.log.frame import (
    ERROR as ERROR,
)
from fsai_vcu.diagnostics.log.frame import (
    ESI as ESI,
)
from fsai_vcu.diagnostics.log.frame import (
    EXTENDED as EXTENDED,
)
from fsai_vcu.diagnostics.log.frame import (
    FD as FD,
)
from fsai_vcu.diagnostics.log.frame import (
    RECEIVED as RECEIVED,
)
from fsai_vcu.diagnostics.log.frame import (
    REMOTE as REMOTE,
)
from fsai_vcu.diagnostics.log.frame import (
    SENT as SENT,
)
from fsai_vcu.diagnostics.log.frame import (
    LogFrame as LogFrame,
)

Ints = npt.NDArray[np.int64]
Words = npt.NDArray[np.uint64]
Mask = npt.NDArray[np.bool_]


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
        return LogFrame(
            t_ns=int(self.t_ns[row]),
            channel=self.channels[int(self.channel[row])],
            can_id=int(self.can_id[row]),
            data=self.payload(row),
            extended=bool(flags & EXTENDED),
            remote=bool(flags & REMOTE),
            error=bool(flags & ERROR),
            fd=bool(flags & FD),
            brs=bool(flags & BRS),
            esi=bool(flags & ESI),
            sent=True if flags & SENT else False if flags & RECEIVED else None,
            length=int(self.length[row]),
        )

    def __iter__(self) -> Iterator[LogFrame]:
        return (self.frame(row) for row in range(len(self)))

    def only(self, rows: Mask | Ints) -> Frames:
        """The frames chosen by a mask or by rows in ascending order."""
        long: dict[int, bytes] = {}
        if self.long:
            chosen = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
            places = {int(old): new for new, old in enumerate(chosen)}
            long = {places[old]: whole for old, whole in self.long.items() if old in places}
        return Frames(
            self.t_ns[rows],
            self.can_id[rows],
            self.flags[rows],
            self.length[rows],
            self.word[rows],
            self.channel[rows],
            self.channels,
            long,
        )

    def at(self, t_ns: Ints) -> Frames:
        """The same frames at other times."""
        return replace(self, t_ns=t_ns)

    def head(self, count: int) -> Frames:
        """The first `count` frames."""
        return self.only(np.arange(min(count, len(self)), dtype=np.int64))


def frames_of(records: Iterable[LogFrame], channels: list[str] | None = None) -> Frames:
    """Columns from single frames. `channels` is the log's own growing list of names, to number them alike."""
    names = [] if channels is None else channels
    index = {name: number for number, name in enumerate(names)}
    rows = list(records)
    long = {row: frame.data for row, frame in enumerate(rows) if len(frame.data) > CLASSIC_BYTES}
    for frame in rows:
        if frame.channel not in index:
            index[frame.channel] = len(names)
            names.append(frame.channel)
    count = len(rows)
    return Frames(
        np.fromiter((frame.t_ns for frame in rows), np.int64, count),
        np.fromiter((frame.can_id for frame in rows), np.uint32, count),
        np.fromiter((frame.flags for frame in rows), np.uint8, count),
        np.fromiter((frame.length for frame in rows), np.uint8, count),
        np.fromiter((int.from_bytes(frame.data[:CLASSIC_BYTES], "little") for frame in rows), np.uint64, count),
        np.fromiter((index[frame.channel] for frame in rows), np.int32, count),
        names,
        long,
    )


def renumbered(frames: Frames, channels: list[str]) -> Frames:
    """The same frames with their buses numbered by `channels`, which grows: several logs number each their own."""
    for name in frames.channels:
        if name not in channels:
            channels.append(name)
    number = np.array([channels.index(name) for name in frames.channels] or [0], np.int32)
    return replace(frames, channel=number[frames.channel], channels=channels)


def joined(parts: Iterable[Frames]) -> Frames:
    """One run of frames from several of the same log."""
    kept = [part for part in parts if len(part)]
    if not kept:
        return frames_of(())
    if len(kept) == 1:
        return kept[0]
    long: dict[int, bytes] = {}
    before = 0
    for part in kept:
        long.update({row + before: whole for row, whole in part.long.items()})
        before += len(part)
    return Frames(
        np.concatenate([part.t_ns for part in kept]),
        np.concatenate([part.can_id for part in kept]),
        np.concatenate([part.flags for part in kept]),
        np.concatenate([part.length for part in kept]),
        np.concatenate([part.word for part in kept]),
        np.concatenate([part.channel for part in kept]),
        kept[-1].channels,
        long,
    )
