"""Vector's binary format BLF: a head, then containers, most of them packed, of one stream of objects.

Every length is checked: a length that does not lead forward, or further than what is ever written, ends the reading.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from datetime import datetime, timezone
from typing import IO, Final

import numpy as np

from fsai_vcu.diagnostics.log.candump_line import MAX_EXTENDED_ID, MAX_NS, MAX_SECONDS, MAX_STANDARD_ID
from fsai_vcu.diagnostics.log.frames import EXTENDED, RECEIVED, SENT, Frames, LogFrame, frames_of
from fsai_vcu.diagnostics.log.problems import Problems, ReadingEnds
from fsai_vcu.diagnostics.log.rows import (
    BUS_ERROR,
    FD_BYTES,
    FORM,
    OVERLOAD,
    PROTOCOL,
    REQUESTS,
    SINGLE_BIT,
    STUFFING,
    counted_errors,
    error_frame,
    frame_of,
    state_frame,
    told_error,
)

MAGIC: Final = b"LOGG"
_CONTAINER_BYTES: Final = 16 << 20  # python-can and Vector's tools pack 128 KiB
_OBJECT_BYTES: Final = 256 << 10  # a frame takes less than 200 bytes, a comment some KiB
_PADDING: Final = 8  # zeros before an object, at most

# Vector's binlog_objects.h, as python-can and vector_blf read them.
_HEAD: Final = struct.Struct("<4sL8xQQLL8H8H")  # magic, size, file size, unpacked size, objects, …, begin, end
_OBJECT: Final = struct.Struct("<4sHHLL")  # magic, size of the head, its version, size, type
_STAMP: Final = struct.Struct("<L4xQ")  # units, time
_CONTAINER: Final = struct.Struct("<H6xL4x")  # packing, unpacked size
_CAN: Final = struct.Struct("<HBBL8s")  # channel, flags, DLC, identifier, data
_ERROR_EXT: Final = struct.Struct("<HHLBBBxLLH2x8s")  # channel, …, what is valid, ECC, …, identifier, …, data
_DRIVER_ERROR: Final = struct.Struct("<HBBL")  # channel, transmit errors, receive errors, code
_COUNTED: Final = struct.Struct("<HH4L2L")  # channel, load, frames of four kinds, error frames, overload frames
_LOST: Final = struct.Struct("<LQL")  # queue, time of the first event that was lost, how many
_FD: Final = struct.Struct("<HBBLLBBB5x64s")  # channel, flags, DLC, identifier, …, FD flags, data bytes, data
_FD_64: Final = struct.Struct("<BBBBLLLLLLLHBBL")  # channel, DLC, data bytes, …, identifier, …, flags, …, way, end, CRC
_MESSAGE, _ERROR, _OVERLOADED, _CONTAINS, _DRIVER, _ERROR_2, _DRIVER_2, _MESSAGE_2 = 1, 2, 3, 10, 31, 73, 74, 86
_FD_MESSAGE, _FD_MESSAGE_64, _FD_ERROR_64 = 100, 101, 104
_STATISTICS, _OVERRUN, _LOSS_BEGINS, _LOSS_ENDS = 4, 91, 125, 126
_NAMES: Final = {4: "statistics", 5: "trigger", 65: "text", 72: "variable", 92: "comment", 96: "marker"}
_MINUTE_S: Final = 60
_SINGLY: Final = 16  # fewer objects alike are not worth while, and then as many are read one by one
_TOGETHER: Final = 4096
_PLAIN_FIELDS: Final = (  # of an object of a frame of at most eight bytes, with the head before
    ("head", f"V{_OBJECT.size}", 0), ("units", "<u4", 16), ("time", "<u8", 24), ("channel", "<u2", 32),
    ("flags", "u1", 34), ("dlc", "u1", 35), ("id", "<u4", 36), ("data", "<u8", 40),
)  # fmt: skip
_PLAIN_BYTES: Final = 48
_USED: Final = np.array([(1 << 8 * length) - 1 for length in range(9)], np.uint64)  # bits, by length
_NO_FRAMES: Final = frames_of(())
_Object = tuple[int, int, bytes]
"""Type, version of the head, and all behind the common part of the head."""
_VIOLATIONS: Final = (SINGLE_BIT, FORM, STUFFING, 0)  # by the upper bits of an error code capture


class BlfFile:
    """Reads one file, once."""

    def __init__(self, stream: IO[bytes], told: Problems, name: str) -> None:
        """Read the head. Raises ReadingEnds."""
        self._stream = stream
        self._told = told
        self._name = name
        head = self._take(_HEAD.size)
        if len(head) < _HEAD.size:
            raise ReadingEnds("cut off in its head")
        _, head_bytes, self._file_bytes, _, self._objects, _, *times = _HEAD.unpack(head)
        self._begin_ns = _systemtime_ns(times[:8])
        if not _HEAD.size <= head_bytes <= _OBJECT_BYTES:
            raise ReadingEnds(f"a head of length {head_bytes}")
        self._take(head_bytes - _HEAD.size)
        self._read_bytes = head_bytes
        self._rest = b""

    def _take(self, count: int) -> bytes:
        return self._stream.read(count)

    def frames(self) -> Iterator[LogFrame | Frames]:
        """All frames, and what it says of errors of the bus. Raises ReadingEnds where it ends before its end."""
        seen = 0
        for each in self._all_objects():
            if isinstance(each, Frames):
                seen += len(each)
                yield each
                continue
            seen += 1
            kind, version, content = each
            try:
                frame = self._frame(kind, version, content)
            except (ValueError, struct.error) as error:
                words = "it is too short" if isinstance(error, struct.error) else str(error)
                self._told.add(f"{self._name}: object {seen}, of type {kind}, is left out: {words}")
                continue
            if frame is not None:
                yield frame
        if self._read_bytes < self._file_bytes or seen < self._objects:
            announced = f"{seen} of {self._objects} objects" if seen < self._objects else "less than its head announces"
            raise ReadingEnds(f"cut off: {announced} are there" if seen < self._objects else f"cut off: {announced}")
        if self._read_bytes > self._file_bytes + 3:
            raise ReadingEnds("the logger did not close the file: unwritten frames are missing")

    def _all_objects(self) -> Iterator[_Object | Frames]:
        """Each object that is no container; frames behind each other together."""
        while head := self._take(_OBJECT.size):
            if len(head) < _OBJECT.size:
                if head.strip(b"\0"):
                    raise ReadingEnds("cut off")
                self._read_bytes += len(head)
                break
            magic, _, version, size, kind = _OBJECT.unpack(head)
            if magic != b"LOBJ":
                raise ReadingEnds("an invalid object follows")
            most = _CONTAINER_BYTES if kind == _CONTAINS else _OBJECT_BYTES
            if not _OBJECT.size <= size <= most:
                raise ReadingEnds(f"an object of length {size}")
            content = self._take(size - _OBJECT.size)
            padding = self._take(size % 4)
            self._read_bytes += _OBJECT.size + len(content) + len(padding)
            if len(content) < size - _OBJECT.size:
                raise ReadingEnds("cut off")
            if kind == _CONTAINS:
                yield from self._objects_in(self._rest + _unpacked(content))
            else:
                yield kind, version, content
        if self._rest.strip(b"\0"):
            raise ReadingEnds("cut off in an object")

    def _objects_in(self, data: bytes) -> Iterator[_Object | Frames]:
        """Objects of one container; an object that goes on in the next is kept for it."""
        at = singly = 0
        while True:
            found = data.find(b"LOBJ", at, at + _PADDING + 4)
            if found < 0 or found + _OBJECT.size > len(data):
                if len(data) - at > _PADDING + _OBJECT.size:
                    raise ReadingEnds("an invalid object follows")
                break
            _, _, version, size, kind = _OBJECT.unpack_from(data, found)
            if not _OBJECT.size <= size <= _OBJECT_BYTES or kind == _CONTAINS:
                raise ReadingEnds(f"an object of length {size}")
            if found + size > len(data):
                break
            if not singly and kind in (_MESSAGE, _MESSAGE_2) and version == 1 and size >= _PLAIN_BYTES:
                frames = self._together(data, found, size + size % 4)
                if len(frames):
                    yield frames
                    at = found + len(frames) * (size + size % 4) - size % 4
                    continue
                singly = _SINGLY
            singly = max(singly - 1, 0)
            yield kind, version, data[found + _OBJECT.size : found + size]
            at = found + size
        self._rest = data[at:]

    def _together(self, data: bytes, at: int, stride: int) -> Frames:
        """The plain frames from there on whose objects are alike; none where they are few."""
        many = min((len(data) - at) // stride, _TOGETHER)
        if many < _SINGLY or data[at + (_SINGLY - 1) * stride :][: _OBJECT.size] != data[at : at + _OBJECT.size]:
            return _NO_FRAMES
        heads = np.frombuffer(data, f"V{_OBJECT.size}", 1, at)
        fields = {name: (kind, place) for name, kind, place in _PLAIN_FIELDS}
        kinds = np.dtype(
            {
                "names": list(fields),
                "formats": [kind for kind, _ in fields.values()],
                "offsets": [place for _, place in fields.values()],
                "itemsize": stride,
            }
        )
        rows = np.frombuffer(data, kinds, many, at)
        extended = rows["id"] >> np.uint32(31) != 0
        number = rows["id"] & np.uint32(0x7FFF_FFFF)
        way = rows["flags"] & np.uint8(15)
        most = np.uint64(MAX_NS - self._begin_ns)
        tens = rows["units"] == 1
        ok = (rows["head"] == heads[0]) & (rows["dlc"] <= 8) & (way <= 1) & (rows["flags"] & np.uint8(0x80) == 0)
        ok &= number <= np.where(extended, np.uint32(MAX_EXTENDED_ID), np.uint32(MAX_STANDARD_ID))
        ok &= rows["time"] <= np.where(tens, most // np.uint64(10_000), most)
        count = many if ok.all() else int(np.argmin(ok))
        if count < _SINGLY:
            return _NO_FRAMES
        rows = rows[:count]
        t_ns = rows["time"].astype(np.int64) * np.where(tens[:count], 10_000, 1) + self._begin_ns
        numbers, channel = np.unique(rows["channel"], return_inverse=True)
        flags = np.where(way[:count] == 1, np.uint8(SENT), np.uint8(RECEIVED))
        flags |= np.where(extended[:count], np.uint8(EXTENDED), np.uint8(0))
        return Frames(
            (t_ns + 500) // 1000 * 1000,
            number[:count].astype(np.uint32),
            flags.astype(np.uint8),
            rows["dlc"].copy(),
            rows["data"] & _USED[rows["dlc"]],
            channel.astype(np.int32),
            [_channel(each) for each in numbers.tolist()],
        )

    def _frame(self, kind: int, version: int, content: bytes) -> LogFrame | None:
        """Return the frame of an object; None for an object that is no frame, which is noted."""
        if kind in (_OVERRUN, _LOSS_BEGINS, _LOSS_ENDS):
            self._told.lost += _lost(kind, version, content)
            return None
        if kind not in _READ:
            name = _NAMES.get(kind)
            self._told.note(f"an object of type {kind}{f' ({name})' if name else ''}, which is not a frame")
            return None
        if version not in (1, 2):
            raise ValueError(f"a head of version {version}")
        units, stamp = _STAMP.unpack_from(content)
        t_ns = self._begin_ns + stamp * (10_000 if units == 1 else 1)
        t_ns = (t_ns + 500) // 1000 * 1000  # its writers' floats are exact to less than a microsecond, not better
        at = _STAMP.size if version == 1 else _STAMP.size + 8
        if kind in (_MESSAGE, _MESSAGE_2):
            channel, flags, dlc, can_id, data = _CAN.unpack_from(content, at)
            length = min(dlc, 8) if dlc < 16 else dlc
            return self._message(t_ns, channel, can_id, data[:length], length, flags & 15, remote=bool(flags & 0x80))
        if kind == _FD_MESSAGE:
            channel, flags, dlc, can_id, _, _, marks, length, data = _FD.unpack_from(content, at)
            remote, fd = bool(flags & 0x80), bool(marks & 1)
            length = min(dlc, 8) if remote else length
            more = (remote, fd, bool(marks & 2), bool(marks & 4))
            return self._message(t_ns, channel, can_id, data[:length], length, flags & 15, *more)
        if kind == _FD_MESSAGE_64:
            channel, dlc, length, _, can_id, _, marks, *_, way, end, _ = _FD_64.unpack_from(content, at)
            remote, fd = bool(marks & 0x10), bool(marks & 0x1000)
            begin = at + _FD_64.size
            stop = min(begin + length, (end - _OBJECT.size) if end else len(content), len(content))
            data = content[begin:stop].ljust(length, b"\0")  # zeros at the end may be left out
            length = FD_BYTES[min(dlc, 8)] if remote else length
            return self._message(
                t_ns, channel, can_id, data, length, way, remote, fd, bool(marks & 0x2000), bool(marks & 0x4000)
            )
        if kind == _STATISTICS:
            number, _, *_, errors, overloads = _COUNTED.unpack_from(content, at)
            if not errors and not overloads:
                self._told.note(f"an object of type {kind} ({_NAMES[kind]}), which is not a frame")
                return None
            return counted_errors(t_ns, _channel(number), errors)
        return _bad(kind, t_ns, content, at)

    def _message(
        self, t_ns: int, channel: int, can_id: int, data: bytes, length: int, way: int, remote: bool = False,
        fd: bool = False, brs: bool = False, esi: bool = False,
    ) -> LogFrame | None:  # fmt: skip
        if way == 2:
            self._told.note(REQUESTS)
            return None
        return frame_of(
            t_ns, _channel(channel), f"{can_id & 0x7FFF_FFFF:X}", data, length,
            extended=bool(can_id >> 31), remote=remote, fd=fd, brs=brs, esi=esi, sent=way == 1,
        )  # fmt: skip


_READ: Final = {
    _MESSAGE, _MESSAGE_2, _FD_MESSAGE, _FD_MESSAGE_64,
    _ERROR, _ERROR_2, _FD_ERROR_64, _OVERLOADED, _DRIVER, _DRIVER_2, _STATISTICS,
}  # fmt: skip


def _lost(kind: int, version: int, content: bytes) -> int:
    """Number of frames that an object says are missing here; the begin of a loss is one, its end tells the others."""
    if kind != _LOSS_ENDS:
        return 1
    (_, _, count) = _LOST.unpack_from(content, _STAMP.size if version == 1 else _STAMP.size + 8)
    return max(int(count) - 1, 0)


def _bad(kind: int, t_ns: int, content: bytes, at: int) -> LogFrame:
    """Error frame of an object that reports a bus error."""
    if kind in (_DRIVER, _DRIVER_2):
        number, sent, received, _ = _DRIVER_ERROR.unpack_from(content, at)
        return state_frame(t_ns, _channel(number), sent, received)
    if kind == _FD_ERROR_64:
        return error_frame(t_ns, _channel(content[at]), BUS_ERROR)
    (number,) = struct.unpack_from("<H", content, at)
    if kind == _OVERLOADED:
        return error_frame(t_ns, _channel(number), PROTOCOL, protocol=OVERLOAD)
    if kind == _ERROR_2:
        _, _, valid, code, _, dlc, _, can_id, _, data = _ERROR_EXT.unpack_from(content, at)
        if not valid and can_id & 0x1FFF_FFFF:  # as python-can writes what SocketCAN says
            return told_error(t_ns, _channel(number), can_id, data[: min(dlc, 8)])
        if valid & 1:
            return error_frame(t_ns, _channel(number), PROTOCOL | BUS_ERROR, protocol=_VIOLATIONS[code >> 6])
    return error_frame(t_ns, _channel(number), BUS_ERROR)


def _channel(number: int) -> str:
    return f"can{max(number, 1) - 1}"


def _unpacked(content: bytes) -> bytes:
    """The unpacked content of a container. Raises ReadingEnds."""
    if len(content) < _CONTAINER.size:
        raise ReadingEnds("a container without a head")
    packing, size = _CONTAINER.unpack_from(content)
    if packing == 0:
        return content[_CONTAINER.size :]
    if packing != 2:
        raise ReadingEnds(f"a container compressed with unknown method {packing}")
    unpacking = zlib.decompressobj()
    try:
        data = unpacking.decompress(content[_CONTAINER.size :], _CONTAINER_BYTES)
    except zlib.error as error:
        raise ReadingEnds(f"a container cannot be unpacked: {error}") from None
    if unpacking.unconsumed_tail:
        raise ReadingEnds(f"a container unpacks to more than {_CONTAINER_BYTES >> 20} MiB")
    if not unpacking.eof or len(data) != size:
        raise ReadingEnds("a container is not whole")
    return data


def _systemtime_ns(fields: list[int]) -> int:
    """Windows' SYSTEMTIME, in UTC; 0 where it is none."""
    year, month, _, day, hour, minute, second, millis = fields
    try:
        begin_s = int(datetime(year, month, day, hour, minute, second, tzinfo=timezone.utc).timestamp())
    except ValueError:
        return 0
    return begin_s * 1_000_000_000 + millis * 1_000_000 if 0 <= begin_s < MAX_SECONDS - _MINUTE_S else 0
