"""Repair of what a power cut leaves: a last line that is half there, an MCAP without its end. Both are made whole
again.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

from fsai_vcu.files import MIB, open_found

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, McapRecord, MessageIndex, Schema
    from mcap.stream_reader import StreamReader

    from fsai_vcu.diagnostics.export.mcap_summary import Summary

_TAIL: Final = 1 << 16
_AT_ONCE: Final = 16 * MIB  # most of a record, and of what a chunk unpacks to: the recorder's chunks end behind 1 MiB


def repair_text(path: Path) -> int:
    """Cut off a last line that is not whole, and what a file system may have put behind it. Returns bytes cut off.

    Raises OSError, also where it is no file of one name.
    """
    with open_found(path, write=True) as file:
        length = file.seek(0, os.SEEK_END)
        begin = max(0, length - _TAIL)
        file.seek(begin)
        tail = file.read()
        end = tail.find(b"\0")  # blocks that were promised and never written
        whole = tail[: end if end >= 0 else len(tail)]
        kept = begin + whole.rfind(b"\n") + 1
        if kept == length or (begin and kept == begin):
            return 0
        file.truncate(kept)
        os.fsync(file.fileno())
    return length - kept


def repair_mcap(path: Path) -> int | None:
    """Give an MCAP that ends anywhere its index and its end. Returns bytes cut off, None if it had them.

    Raises OSError, also where it is no file of one name.

    Chunks are not written again; messages are read only of the last one and of those that bring a new channel. What is
    larger than the recorder writes it counts as torn, and all behind it.
    """
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, DataEnd, Header, MessageIndex, Metadata, MetadataIndex
    from mcap.stream_reader import get_chunk_data_stream
    from mcap.writer import MCAP0_MAGIC

    from fsai_vcu.diagnostics.export.mcap_summary import Summary

    with open_found(path, write=True) as file:
        length = file.seek(0, os.SEEK_END)
        file.seek(max(0, length - len(MCAP0_MAGIC)))
        if length > len(MCAP0_MAGIC) and file.read() == MCAP0_MAGIC:
            return None
        file.seek(0)
        summary = Summary()
        last: Chunk | None = None
        end = 0
        with suppress(Exception):  # what is torn makes its readers raise many things
            for record in _bounded_reader(file).records:
                at, behind = end or len(MCAP0_MAGIC), file.tell()
                if isinstance(record, DataEnd):
                    break
                if isinstance(record, Chunk):
                    _check_unpacked(record)
                    get_chunk_data_stream(record, validate_crc=True)
                    _learn_channels(summary, last)
                    summary.add_chunk(record, at, behind)
                    last = record
                elif isinstance(record, MessageIndex):
                    summary.add_messages(record.channel_id, len(record.records), at, behind)
                elif isinstance(record, Metadata):
                    summary.metadata.append(MetadataIndex(at, behind - at, record.name))
                end = behind
        kept = end or len(MCAP0_MAGIC)
        out: Any = RecordBuilder()
        if not end:  # not even a beginning was on the disk
            out.write(MCAP0_MAGIC)
            Header("", "").write(out)
        if last is not None:  # its indexes may be missing: they are written again, which takes nothing away
            index = summary.chunks[-1]
            end = index.chunk_start_offset + index.chunk_length
            index.message_index_length = 0
            for messages in _contents(last)[2].values():
                at = out.count
                messages.write(out)
                summary.add_messages(messages.channel_id, len(messages.records), end + at, end + out.count)
            _learn_channels(summary, last)
        out.write(summary.end(end + out.count))
        file.seek(end)
        file.write(out.end())
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
    return max(0, length - kept)


class _Reads:
    """A file of which not too much is read at once, whatever length a record in it claims to have."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        if size > _AT_ONCE:
            raise ValueError(f"{size} bytes at once")
        return self._file.read(size)


def _bounded_reader(file: IO[bytes]) -> StreamReader:
    """A reader that ends where zeros begin: a disk may have promised gigabytes of them."""
    from mcap.stream_reader import StreamReader

    class Reader(StreamReader):
        """Reader of records that refuses zeros."""

        def _read_record(self, opcode: int, length: int) -> McapRecord | None:
            if opcode == 0:
                raise ValueError("zeros")
            return super()._read_record(opcode, length)

    return Reader(_Reads(file), emit_chunks=True)  # type: ignore[arg-type]


def _check_unpacked(chunk: Chunk) -> None:
    """Raise where a chunk may unpack to more than a chunk has: it says so itself, or does not say."""
    import zstandard

    sizes = [chunk.uncompressed_size]
    if chunk.compression:
        sizes.append(zstandard.frame_content_size(chunk.data))
    if not all(0 <= size <= _AT_ONCE for size in sizes):
        raise ValueError(f"a chunk of {max(sizes)} bytes")


def _learn_channels(summary: Summary, last: Chunk | None) -> None:
    """Learn the channels that the last chunk brings, once its messages are known."""
    if last is not None and not summary.counts[-1].keys() <= summary.channels.keys():
        schemas, channels, _ = _contents(last)
        summary.schemas |= schemas
        summary.channels |= channels


def _contents(chunk: Chunk) -> tuple[dict[int, Schema], dict[int, Channel], dict[int, MessageIndex]]:
    """Return what a chunk defines, and where its messages are."""
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message, MessageIndex, Schema
    from mcap.stream_reader import get_chunk_data_stream

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    indexes: dict[int, MessageIndex] = {}
    stream, length = get_chunk_data_stream(chunk)
    while stream.count < length:
        at = stream.count
        opcode, size = stream.read1(), stream.read8()
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            channels[channel.id] = channel
        elif opcode == Opcode.MESSAGE:
            message = Message.read(stream, size)
            index = indexes.setdefault(message.channel_id, MessageIndex(message.channel_id, []))
            index.records.append((message.log_time, at))
        else:
            stream.read(size)
    return schemas, channels, indexes
