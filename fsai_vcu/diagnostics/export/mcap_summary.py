"""Summary at the end of an MCAP file: its schemas, channels and counts, and where its chunks are."""

from __future__ import annotations

import zlib
from dataclasses import replace
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

_CHECKSUM_BYTES = 4


class Summary:
    """Summary of the chunks so far."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkIndex] = []
        self.metadata: list[MetadataIndex] = []
        self.counts: list[dict[int, int]] = []  # of each chunk's messages, by channel

    def add_chunk(self, chunk: Chunk, at: int, behind: int) -> None:
        """A chunk whose record is from `at` to `behind` in the file."""
        self.counts.append({})
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

    def add_messages(self, channel_id: int, count: int, at: int, behind: int) -> None:
        """The last chunk's messages of a channel, by their index in the file."""
        self.chunks[-1].message_index_offsets[channel_id] = at
        self.chunks[-1].message_index_length += behind - at
        self.counts[-1][channel_id] = count

    def end(self, at: int) -> bytes:
        """The file's end, from place `at` on."""
        out: Any = RecordBuilder()
        DataEnd(0).write(out)  # a checksum of 0: none
        begin = out.count
        counts = {number: sum(count.get(number, 0) for count in self.counts) for number in self.channels}
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=counts,
            chunk_count=len(self.chunks),
            message_count=sum(counts.values()),
            metadata_count=len(self.metadata),
            message_start_time=min((index.message_start_time for index in self.chunks), default=0),
            message_end_time=max((index.message_end_time for index in self.chunks), default=0),
            schema_count=len(self.schemas),
        )
        groups: tuple[tuple[Opcode, list[Any]], ...] = (
            (Opcode.SCHEMA, [*self.schemas.values()]),
            (Opcode.CHANNEL, [*self.channels.values()]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.METADATA_INDEX, self.metadata),
        )
        offsets = []
        for opcode, records in groups:
            offset = SummaryOffset(opcode, at + out.count, 0)
            for each in records:
                each.write(out)
            offsets.append(replace(offset, group_length=at + out.count - offset.group_start))
        footer = Footer(at + begin, at + out.count, 0)
        for offset in offsets:
            offset.write(out)
        footer.write(out)
        whole = out.end()[:-_CHECKSUM_BYTES]
        return bytes(whole + zlib.crc32(whole[begin:]).to_bytes(_CHECKSUM_BYTES, "little") + MCAP0_MAGIC)
