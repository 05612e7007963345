"""Frames of an MF4 bus log as columns, as asammdf reads them: no work in Python for each frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.candump_line import MAX_SECONDS
from fsai_vcu.diagnostics.log.frames import (
    BRS,
    CLASSIC_BYTES,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    RECEIVED,
    REMOTE,
    SENT,
    Frames,
    joined,
)

_KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
_MARKS: Final = {"EDL": FD, "BRS": BRS, "ESI": ESI}
_EXTENDED_BIT: Final = 1 << 31  # of an identifier, where no IDE stands beside it
_AT_ONCE: Final = 1 << 22  # bytes of records: each has 64 of data, of which few are used

_USED: Final = np.array([(1 << 8 * length) - 1 for length in range(CLASSIC_BYTES + 1)], np.uint64)  # bits, by length

Columns = dict[str, npt.NDArray[Any]]


def bus_frames(mdf: Any, problem: Callable[[str], None]) -> list[Frames] | None:
    """All frames of an open `asammdf.MDF`, in the order of time and in parts; None where it is no bus log.

    `problem` gets what could not be read.
    """
    groups = [
        (number, channel.name)
        for number, group in enumerate(mdf.groups)
        for channel in group.channels
        if channel.name in _KINDS
    ]
    mdf.configure(read_fragment_size=_AT_ONCE)
    parts: list[Frames] = []
    channels: list[str] = []
    for number, kind in groups:
        try:
            parts.extend(_group_frames(mdf, number, kind, channels, problem))
        except Exception as error:  # asammdf has no common base class for what a broken file makes it raise
            problem(f"not readable as MF4 after frame {sum(map(len, parts))}: {error or type(error).__name__}")
    if sum(mdf.groups[number].channel_group.cycles_nr > 0 for number, _ in groups) > 1:
        frames = joined(parts)
        parts = [frames.only(np.argsort(frames.t_ns, kind="stable"))]
    return parts if groups else None


def _group_frames(
    mdf: Any, number: int, kind: str, channels: list[str], problem: Callable[[str], None]
) -> Iterator[Frames]:
    """Of one channel group, which has frames of one kind. `channels` grows."""
    start_s = mdf.header.start_time.timestamp()
    for signal in mdf.iter_get(kind, number, raw=True):
        columns = {name.removeprefix(f"{kind}."): signal.samples[name] for name in signal.samples.dtype.names}
        times = signal.timestamps + start_s
        timely = (times >= 0) & (times <= MAX_SECONDS)
        for time in times[~timely].tolist():
            problem(f"a time that is none: {time}")
        t_ns = np.rint(np.where(timely, times, 0) * 1e6).astype(np.int64) * 1000
        yield _frames(columns, t_ns, kind, channels).only(timely)


def _frames(columns: Columns, t_ns: npt.NDArray[np.int64], kind: str, channels: list[str]) -> Frames:
    count = len(t_ns)
    ids = columns.get("ID", np.zeros(count, np.uint32)).astype(np.uint32)
    flags = np.full(count, _KINDS[kind], np.uint8)
    if not flags.any() or kind == "CAN_RemoteFrame":  # of an error frame the identifier is its class
        flags[columns.get("IDE", ids & _EXTENDED_BIT) != 0] |= EXTENDED
    for name, mark in _MARKS.items():
        if name in columns:
            flags[columns[name] != 0] |= mark
    if "Dir" in columns:
        flags |= np.where(columns["Dir"] != 0, SENT, RECEIVED).astype(np.uint8)
    length = columns.get("DLC" if kind == "CAN_RemoteFrame" else "DataLength", np.zeros(count)).astype(np.uint8)
    payload = columns.get("DataBytes", np.zeros((count, CLASSIC_BYTES), np.uint8))
    first = np.zeros((count, CLASSIC_BYTES), np.uint8)
    first[:, : payload.shape[1]] = payload[:, :CLASSIC_BYTES]
    word = first.view("<u8").ravel() & _USED[np.minimum(length, CLASSIC_BYTES)]
    bus = columns.get("BusChannel", np.zeros(count, np.uint8))
    counts = np.bincount(bus)
    numbers = np.zeros(len(counts), np.int32)
    for each in np.flatnonzero(counts).tolist():
        if f"can{each}" not in channels:
            channels.append(f"can{each}")
        numbers[each] = channels.index(f"can{each}")
    return Frames(
        t_ns,
        (ids & 0x1FFF_FFFF).astype(np.uint32),
        flags,
        length,
        word,
        numbers[bus],
        channels,
        {row: payload[row, : length[row]].tobytes() for row in np.flatnonzero(length > CLASSIC_BYTES).tolist()},
    )
