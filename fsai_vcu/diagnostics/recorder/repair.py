"""What a power cut leaves: a last line that is half there, an MCAP without its end. Both are made whole again."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, ChunkIndex, MessageIndex, MetadataIndex, Schema

_TAIL: Final = 1 << 16


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

    Chunks are not written anew; messages are read only of the last one and of those that bring a new channel.
    """
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, DataEnd, Footer, Header, MessageIndex, Metadata, MetadataIndex, Statistics
    from mcap.stream_reader import StreamReader
    from mcap.writer import MCAP0_MAGIC

    with path.open("r+b") as file:
        length = file.seek(0, os.SEEK_END)
        file.seek(max(0, length - len(MCAP0_MAGIC)))
        if length > len(MCAP0_MAGIC) and file.read() == MCAP0_MAGIC:
            return None
        file.seek(0)
        summary = _Summary()
        end = 0
        with suppress(Exception):  # what is torn makes its readers raise many things
            for record in StreamReader(file, emit_chunks=True).records:
                at, behind = end or len(MCAP0_MAGIC), file.tell()
                if isinstance(record, DataEnd):
                    break
                if isinstance(record, Chunk):
                    summary.add_chunk(record, at, behind)
                elif isinstance(record, MessageIndex):
                    summary.add_messages(record, at, behind)
                elif isinstance(record, Metadata):
                    summary.metadata.append(MetadataIndex(at, behind - at, record.name))
                end = behind
        kept = end or len(MCAP0_MAGIC)
        out: Any = RecordBuilder()
        if not end:  # not even a beginning was on the disk
            out.write(MCAP0_MAGIC)
            Header("", "").write(out)
        if summary.last is not None:  # its indexes may be missing: they are written anew, which takes nothing away
            index = summary.chunks[-1]
            end = index.chunk_start_offset + index.chunk_length
            index.message_index_length = 0
            for messages in _contents(summary.last)[2].values():
                at = out.count
                messages.write(out)
                summary.add_messages(messages, end + at, end + out.count)
            summary.learn_channels()
        DataEnd(0).write(out)  # a checksum of 0: none
        summary_start = end + out.count
        for records in (summary.schemas.values(), summary.channels.values(), summary.chunks, summary.metadata):
            for each in records:
                each.write(out)
        counts = summary.counts()
        Statistics(
            attachment_count=0,
            channel_count=len(summary.channels),
            channel_message_counts=counts,
            chunk_count=len(summary.chunks),
            message_count=sum(counts.values()),
            metadata_count=len(summary.metadata),
            message_start_time=min((index.message_start_time for index in summary.chunks), default=0),
            message_end_time=max((index.message_end_time for index in summary.chunks), default=0),
            schema_count=len(summary.schemas),
        ).write(out)
        Footer(summary_start, 0, 0).write(out)
        file.seek(end)
        file.write(out.end() + MCAP0_MAGIC)
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
    return max(0, length - kept)


class _Summary:
    """What is known of the whole chunks so far; `last` is the newest of them."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkIndex] = []
        self.metadata: list[MetadataIndex] = []
        self.last: Chunk | None = None
        self._counts: list[dict[int, int]] = []  # of each chunk's messages, by channel

    def add_chunk(self, chunk: Chunk, at: int, behind: int) -> None:
        """Raises whatever a torn one makes its reader raise."""
        from mcap.records import ChunkIndex
        from mcap.stream_reader import get_chunk_data_stream

        get_chunk_data_stream(chunk, validate_crc=True)
        self.learn_channels()
        self.last = chunk
        self._counts.append({})
        self.chunks.append(
            ChunkIndex(
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
        )

    def add_messages(self, messages: MessageIndex, at: int, behind: int) -> None:
        """Of the last chunk."""
        self.chunks[-1].message_index_offsets[messages.channel_id] = at
        self.chunks[-1].message_index_length += behind - at
        self._counts[-1][messages.channel_id] = len(messages.records)

    def learn_channels(self) -> None:
        """Those that the last chunk brings, once its messages are known."""
        if self.last is not None and not self._counts[-1].keys() <= self.channels.keys():
            schemas, channels, _ = _contents(self.last)
            self.schemas |= schemas
            self.channels |= channels

    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return {channel: sum(count.get(channel, 0) for count in self._counts) for channel in self.channels}


def _contents(chunk: Chunk) -> tuple[dict[int, Schema], dict[int, Channel], dict[int, MessageIndex]]:
    """What a chunk defines, and where its messages are."""
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
