"""Frames of an MF4 bus log as columns, as asammdf reads them: no work in Python for each frame.

asammdf trusts a file, and so runs in a process with bounds.
"""

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.candump_line import MAX_SECONDS, MAX_STANDARD_ID
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
    Mask,
    frames_of,
    joined,
)
from fsai_vcu.diagnostics.log.rows import BUS_ERROR, FD_BYTES, OVERLOAD, PROTOCOL
from fsai_vcu.files import MIB, TOO_MUCH_PACKED, UNPACKED_BYTES, UNPACKED_TIMES, bytes_on_disk
from fsai_vcu.runtime.bounded import BoundedError, Bounds, results_of, send_results

_OVERLOADED: Final = "CAN_OverloadFrame"
_KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE, _OVERLOADED: ERROR}
_MARKS: Final = {"EDL": FD, "BRS": BRS, "ESI": ESI}
_ID_BYTES: Final = 64  # of the block that begins a file
_FLAGS_AT: Final = 60  # in it: what was not finalized
_LAST_LENGTH: Final = 1 << 2
_VIRTUAL: Final = (3, 6)  # types of channels that are no bits of a record
_EXTENDED_BIT: Final = 1 << 31  # of an identifier, where no IDE stands beside it
_AT_ONCE: Final = 1 << 22  # bytes of records: each has 64 of data, of which few are used
_BYTES_OF: Final = np.array(FD_BYTES, np.uint8)  # by DLC
_MOST_BUS: Final = 0xFFFF
_CLASSES: Final = 0x400  # beyond all classes of errors (linux/can/error.h)
_BATCH: Final = 100_000
_RECORD_BYTES: Final = 16  # at least, of a frame
_MEMORY_BYTES: Final = 256 * MIB
_MEMORY_TIMES: Final = 32  # a packed log of two kinds of frames, which are sorted, takes 20 times its size
SECONDS: Final = 10
_SECONDS_PER_MIB: Final = 2.0  # a packed log takes 0.2

_USED: Final = np.array([(1 << 8 * length) - 1 for length in range(CLASSIC_BYTES + 1)], np.uint64)  # bits, by length

Columns = dict[str, npt.NDArray[Any]]


def read_mf4(path: Path, problem: Callable[[str], None], seconds: int = SECONDS) -> Iterator[Frames]:
    """All frames of a file in the order of time, in parts. `problem` gets what could not be read.

    Raises BoundedError where that is all of it, or all that comes behind. seconds: for a file of any size.
    """
    channels: list[str] = []
    for sent in results_of(__name__, str(path.resolve()), str(seconds)):
        if isinstance(sent, Frames):
            channels.extend(sent.channels[len(channels) :])
            yield replace(sent, channels=channels)
        else:
            problem(sent)


def main(path: Path, seconds: int) -> None:
    """The process that reads it."""
    import asammdf

    def read(send: Callable[[Frames | str], None]) -> None:
        # A frame whose bytes are marked as invalid came nevertheless.
        options: dict[str, Any] = {"process_bus_logging": False, "ignore_invalidation_bits": True}
        try:
            opened = asammdf.MDF(_finalizable(path) or path, **options)
        except asammdf.blocks.utils.MdfException:  # whose words are of Python's objects
            raise ValueError("cut off, or broken: no head of an MF4") from None
        except (ValueError, struct.error) as error:  # so it ends where a block should be that is behind the end
            raise ValueError(f"cut off, or broken: {error}") from error
        with opened as mdf:
            _send_frames(mdf, max(UNPACKED_BYTES, UNPACKED_TIMES * bytes_on_disk(path.stat())), send)

    send_results(path, Bounds(_MEMORY_BYTES, _MEMORY_TIMES, seconds, _SECONDS_PER_MIB), read)


def _finalizable(path: Path) -> io.BytesIO | None:
    """A copy of a file that its logger did not finalize, as loggers leave them, which asammdf does; None of another.

    asammdf gives up where the length of the last data block is to be set, and the blocks are packed, which have their
    lengths: then nothing is to be set.
    """
    with path.open("rb") as file:
        head = file.read(_ID_BYTES)
        flags = int.from_bytes(head[_FLAGS_AT : _FLAGS_AT + 2], "little")
        if len(head) < _ID_BYTES or not (head.startswith(b"UnFinMF ") or flags):
            return None
        content = bytearray(head + file.read())
    if b"##DZ" in content:
        content[_FLAGS_AT : _FLAGS_AT + 2] = (flags & ~_LAST_LENGTH).to_bytes(2, "little")
    return io.BytesIO(content)


def _send_frames(mdf: Any, most_bytes: int, send: Callable[[Frames | str], None]) -> None:
    """All frames of an open `asammdf.MDF`. most_bytes: how much may be unpacked."""
    groups = [
        (number, channel.name)
        for number, group in enumerate(mdf.groups)
        for channel in group.channels
        if channel.name in _KINDS
    ]
    if not groups:
        send("an MF4 of signals, not of a bus's frames")
    mdf.configure(read_fragment_size=_AT_ONCE)
    filled = sum(mdf.groups[number].channel_group.cycles_nr > 0 for number, _ in groups)
    parts: list[Frames] = []
    channels: list[str] = []
    count = unpacked = 0
    for number, kind in groups:
        record_bytes = max(_RECORD_BYTES, mdf.groups[number].channel_group.samples_byte_nr)
        try:
            for frames in _group_frames(mdf, number, kind, channels, send):
                count += len(frames)
                unpacked += len(frames) * record_bytes
                if unpacked > most_bytes:
                    raise BoundedError(TOO_MUCH_PACKED)
                if filled > 1:
                    parts.append(frames)
                else:
                    send(frames)
        except (MemoryError, BoundedError):
            raise
        except Exception as error:  # asammdf has no common base class for what a broken file makes it raise
            text = " ".join(str(error).split())[:300] or type(error).__name__
            send(f"not readable as MF4 after frame {count}: {text}")
    if parts:
        whole = joined(parts)
        order = np.argsort(whole.t_ns, kind="stable")
        for begin in range(0, len(order), _BATCH):
            send(whole.only(order[begin : begin + _BATCH]))


def _group_frames(
    mdf: Any, number: int, kind: str, channels: list[str], problem: Callable[[str], None]
) -> Iterator[Frames]:
    """Yield the frames of one channel group, which are of one kind. `channels` grows."""
    start_s = mdf.header.start_time.timestamp()
    announced, read = mdf.groups[number].channel_group.cycles_nr, 0
    computed = [
        channel.name
        for channel in mdf.groups[number].channels
        if channel.name.startswith(f"{kind}.") and (channel.channel_type in _VIRTUAL or channel.conversion is not None)
    ]
    for signal in mdf.iter_get(kind, number, raw=True):
        columns = {name.removeprefix(f"{kind}."): signal.samples[name] for name in signal.samples.dtype.names}
        for name in computed:
            values = mdf.get(name, number, record_offset=read, record_count=len(signal)).samples
            if values.dtype.kind in "iufb":  # words stand for the numbers that are in the records
                columns[name.removeprefix(f"{kind}.")] = values
        times = signal.timestamps + start_s
        timely = (times >= 0) & (times <= MAX_SECONDS)
        for time in times[~timely].tolist():
            problem(f"an invalid time: {time}")
        t_ns = np.rint(np.where(timely, times, 0) * 1e6).astype(np.int64) * 1000
        frames = _frames(columns, t_ns, kind, channels)
        sound = _sound(frames, columns)
        for row in np.flatnonzero(~sound).tolist():
            problem(f"frame {read + row + 1}, 0x{frames.can_id[row]:X} of {frames.length[row]} bytes, cannot be one")
        yield frames.only(timely & sound)
        read += len(times)
    if read < announced:
        problem(f"cut off: {read} of {announced} frames are there")


def _sound(frames: Frames, columns: Columns) -> Mask:
    """Select the frames whose identifier has at most 11 bits, or 29, and whose data bytes are all there."""
    sound: Mask = (frames.can_id <= MAX_STANDARD_ID) | (frames.flags & np.uint8(EXTENDED | ERROR) != 0)
    if len(frames) and "DataBytes" in columns:
        sound &= (frames.length <= columns["DataBytes"].shape[1]) | (frames.flags & np.uint8(REMOTE) != 0)
    return sound


def _frames(columns: Columns, t_ns: npt.NDArray[np.int64], kind: str, channels: list[str]) -> Frames:
    """Return the columns of one kind of frames as Frames."""
    count = len(t_ns)
    if not count:
        return frames_of((), channels)
    columns = {name: _whole(column) for name, column in columns.items()}
    needed = {"CAN_DataFrame": ("ID", "DataBytes"), "CAN_RemoteFrame": ("ID",)}.get(kind, ())
    if missing := [name for name in needed if name not in columns]:
        raise ValueError(f"its frames have no {' and no '.join(missing)}")
    ids = columns.get("ID", np.zeros(count, np.uint32)).astype(np.uint32)
    if _KINDS[kind] == ERROR:
        ids = _error_classes(ids, columns, kind)
    flags = np.full(count, _KINDS[kind], np.uint8)
    if not flags.any() or kind == "CAN_RemoteFrame":  # of an error frame the identifier is its class
        flags[columns.get("IDE", ids & _EXTENDED_BIT) != 0] |= EXTENDED
    for name, mark in _MARKS.items():
        if name in columns:
            flags[columns[name] != 0] |= mark
    if "Dir" in columns:
        flags |= np.where(columns["Dir"] != 0, SENT, RECEIVED).astype(np.uint8)
    dlc = columns.get("DLC", np.zeros(count, np.uint8)).astype(np.uint8)
    length = dlc if kind == "CAN_RemoteFrame" else columns.get("DataLength", _BYTES_OF[dlc & 15]).astype(np.uint8)
    payload = columns.get("DataBytes", np.zeros((count, CLASSIC_BYTES), np.uint8))
    first = np.zeros((count, CLASSIC_BYTES), np.uint8)
    first[:, : payload.shape[1]] = payload[:, :CLASSIC_BYTES]
    word = first.view("<u8").ravel() & _USED[np.minimum(length, CLASSIC_BYTES)]
    if kind == _OVERLOADED:
        length, word = np.full(count, CLASSIC_BYTES, np.uint8), np.full(count, OVERLOAD << 16, np.uint64)
    bus = columns.get("BusChannel", np.zeros(count, np.uint8))
    if not 0 <= int(bus.min()) <= int(bus.max()) <= _MOST_BUS:
        raise ValueError(f"an invalid number of a bus: {int(bus.min())} to {int(bus.max())}")
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


def _error_classes(ids: npt.NDArray[np.uint32], columns: Columns, kind: str) -> npt.NDArray[np.uint32]:
    """SocketCAN's classes of error frames, where their identifiers are such; loggers write those of the frame there."""
    if kind == _OVERLOADED:
        return np.full(len(ids), PROTOCOL, np.uint32)
    is_class = (ids > 0) & (ids < _CLASSES) & ("ErrorType" not in columns)
    return np.where(is_class, ids, np.uint32(BUS_ERROR))


def _whole(column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Make the numbers whole, as a conversion does not leave them."""
    if column.dtype.kind != "f":
        return column
    if not (np.isfinite(column).all() and (column == np.rint(column)).all() and (np.abs(column) < 1 << 32).all()):
        raise ValueError("a field of the frames is no whole number")
    return column.astype(np.int64)


if __name__ == "__main__":
    from fsai_vcu.diagnostics.log import mf4  # what is sent is of that module, and not of this one, __main__

    mf4.main(Path(sys.argv[1]), int(sys.argv[2]))
