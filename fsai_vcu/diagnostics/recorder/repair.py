"""What a power cut leaves: a last line that is half there, an MCAP without its end. Both are made whole again."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, ChunkIndex, MessageIndex, Schema

_TAIL: Final = 1 << 16
_MAGIC_BYTES: Final = 8
_RECORD_HEAD: Final = 9  # MCAP: an opcode and the length of what follows


def repair_text(path: Path) -> int:
    """Cut off a last line that is not whole, and what a file system may have put behind it. Returns bytes cut off."""
    with path.open("r+b") as file:
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

    Chunks are neither written anew nor, but for the last and those that bring a new channel, unpacked.
    """
    from mcap.data_stream import RecordBuilder
    from mcap.opcode import Opcode
    from mcap.records import Chunk, DataEnd, Footer, Header, MessageIndex, Metadata, MetadataIndex, Statistics
    from mcap.writer import MCAP0_MAGIC

    with path.open("r+b") as file:
        length = file.seek(0, os.SEEK_END)
        file.seek(max(0, length - len(MCAP0_MAGIC)))
        if length > len(MCAP0_MAGIC) and file.read() == MCAP0_MAGIC:
            return None
        groups: list[_Group] = []
        metadata: list[MetadataIndex] = []
        end = len(MCAP0_MAGIC)
        begun = False
        for opcode, at, behind in _records(file, length):
            begun = begun or opcode == Opcode.HEADER
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            if opcode == Opcode.CHUNK:
                groups.append(_Group(at, behind))
            elif opcode == Opcode.MESSAGE_INDEX and groups:
                groups[-1].indexes.append((at, behind))
            elif opcode == Opcode.METADATA:
                metadata.append(MetadataIndex(at, behind - at, _read(file, at, Metadata).name))
            end = behind
        kept = end  # the last indexes are written anew, which takes nothing away
        out: Any = RecordBuilder()
        if not begun:  # not even a beginning was on the disk
            end = 0
            out.write(MCAP0_MAGIC)
            Header("", "").write(out)
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        counts: dict[int, int] = {}
        indexes: list[ChunkIndex] = []
        whole = False
        while groups and not whole:  # the last chunk may be torn, and its indexes may be missing: they are made anew
            last = groups[-1]
            end, last.indexes = last.behind, []
            try:
                contents = _contents(_read(file, last.at, Chunk))
                whole = True
            except Exception:  # what is no chunk makes its readers raise many things
                end = kept = last.at
                groups.pop()
        for group in groups:
            chunk = _read(file, group.at, Chunk)
            index = _index_of(chunk, group.at, group.behind)
            found: dict[int, int] = {}
            for at, behind in group.indexes:
                entry = _read(file, at, MessageIndex)
                index.message_index_offsets[entry.channel_id] = at
                index.message_index_length += behind - at
                found[entry.channel_id] = len(entry.records)
            if group is groups[-1]:
                begin = out.count
                for entry in contents[2].values():
                    index.message_index_offsets[entry.channel_id] = end + out.count
                    entry.write(out)
                    found[entry.channel_id] = len(entry.records)
                index.message_index_length = out.count - begin
            if not found.keys() <= channels.keys():
                new_schemas, new_channels, _ = contents if group is groups[-1] else _contents(chunk)
                schemas.update(new_schemas)
                channels.update(new_channels)
            for channel_id, count in found.items():
                counts[channel_id] = counts.get(channel_id, 0) + count
            indexes.append(index)
        DataEnd(0).write(out)  # a checksum of 0: none
        summary_start = end + out.count
        for records in (schemas.values(), channels.values(), indexes, metadata):
            for record in records:
                record.write(out)
        Statistics(
            attachment_count=0,
            channel_count=len(channels),
            channel_message_counts=counts,
            chunk_count=len(indexes),
            message_count=sum(counts.values()),
            metadata_count=len(metadata),
            message_start_time=min((index.message_start_time for index in indexes), default=0),
            message_end_time=max((index.message_end_time for index in indexes), default=0),
            schema_count=len(schemas),
        ).write(out)
        Footer(summary_start, 0, 0).write(out)
        file.seek(end)
        file.write(out.end() + MCAP0_MAGIC)
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
    return max(0, length - kept)


@dataclass
class _Group:
    """A chunk and the indexes of its messages, as places in the file."""

    at: int
    behind: int
    indexes: list[tuple[int, int]] = field(default_factory=list)


def _records(file: IO[bytes], length: int) -> Iterator[tuple[int, int, int]]:
    """(opcode, begin, end) of each record that is there to its end."""
    at = _MAGIC_BYTES
    while at + _RECORD_HEAD <= length:
        file.seek(at)
        opcode, size = struct.unpack("<BQ", file.read(_RECORD_HEAD))
        behind = at + _RECORD_HEAD + size
        if behind > length or opcode == 0:
            return
        yield opcode, at, behind
        at = behind


def _read(file: IO[bytes], at: int, kind: Any) -> Any:
    from mcap.data_stream import ReadDataStream

    file.seek(at + _RECORD_HEAD)
    return kind.read(ReadDataStream(file))


def _index_of(chunk: Chunk, at: int, behind: int) -> ChunkIndex:
    from mcap.records import ChunkIndex

    return ChunkIndex(
        chunk_length=behind - at,
        chunk_start_offset=at,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )


def _contents(chunk: Chunk) -> tuple[dict[int, Schema], dict[int, Channel], dict[int, MessageIndex]]:
    """What a chunk defines, and where its messages are. Raises whatever a torn one makes its readers raise."""
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message, MessageIndex, Schema
    from mcap.stream_reader import get_chunk_data_stream

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    indexes: dict[int, MessageIndex] = {}
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
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
