"""Tables and ROS 2 messages as MCAP, the file that Foxglove and `ros2 bag` open.

Every channel is CDR with a ROS 2 definition, the tables' too: `ros2 bag` opens no file that mixes encodings. A table is
a message type of the package `fsai_can`; its fields are the signals, in ROS's lower case, with the database's words as
constants. A field of an integer that a row may lack is a float64, NaN where it has none.
"""

from __future__ import annotations

import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, MetadataIndex, Schema
from mcap.writer import MCAP0_MAGIC

from fsai_vcu.diagnostics.export.mcap_summary import Summary
from fsai_vcu.diagnostics.export.tables import Column, Table, TablePart
from fsai_vcu.diagnostics.log.characters import window
from fsai_vcu.diagnostics.log.frames import Ints

PROFILE: Final = "ros2"
ENCODING, SCHEMA_ENCODING = "cdr", "ros2msg"
_PACKAGE: Final = "fsai_can"
_CDR_HEAD: Final = b"\0\1\0\0"  # CDR of the XCDR1 kind, little-endian
_CHUNK_BYTES: Final = 1 << 20
# A table's row in CDR: head and stamp, then a field of eight bytes for each column, so that nothing is padded.
_STAMP: Final = (("head", "V4"), ("sec", "<i4"), ("nanosec", "<u4"))
# A message's record up to its data.
_MESSAGE: Final = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<i8"), ("published", "<i8")]
)
_RECORD_HEAD_BYTES: Final = 1 + 8  # opcode and length
_RULE: Final = "=" * 80
_TIME: Final = f"{_RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"


@dataclass(frozen=True, slots=True)
class RosTopic:
    """A topic as a bag describes it. definition: the type's and, behind rules, those of all types in it."""

    name: str
    type_name: str  # package/msg/Type
    definition: str
    qos: str = ""  # rosbag2's YAML list of offered profiles


@dataclass(frozen=True, slots=True)
class RosMessage:
    """A message as it came over the wire, in CDR."""

    topic: RosTopic
    data: bytes
    log_ns: int
    published_ns: int


@contextmanager
def mcap_file(path: Path) -> Iterator[Callable[[TablePart], None]]:
    """Writes all tables to one file."""
    with path.open("wb") as stream:
        tables = McapTables(stream)
        yield lambda rows: tables.write_together([rows])
        tables.finish()


class McapTables:
    """Writes one MCAP file to an open stream. `flush` puts all of it there; `finish` adds the index."""

    def __init__(self, stream: Any, metadata: Mapping[str, str] | None = None) -> None:
        """`stream` has write, tell and flush; `metadata` is kept in the file under the name 'fsai-vcu'."""
        self._stream = stream
        self._summary = Summary()
        self._tables: dict[str, int] = {}
        self._topics: dict[tuple[str, str], int] = {}
        self._types: dict[tuple[str, str], int] = {}  # numbers of schemas, by name and definition
        self._sequences: Counter[int] = Counter()
        builder: Any = RecordBuilder
        self._records = builder()  # of the chunk in hand
        self._messages: list[tuple[Ints, Ints, Ints]] = []  # in it: channels, times, places
        stream.write(MCAP0_MAGIC)
        out = self._records
        Header(PROFILE, "fsai-vcu").write(out)
        stream.write(out.end())
        if metadata:
            Metadata("fsai-vcu", dict(metadata)).write(out)
            self._summary.metadata.append(MetadataIndex(stream.tell(), out.count, "fsai-vcu"))
            stream.write(out.end())

    def write_together(self, several: Sequence[TablePart]) -> None:
        """Rows of several tables, in order of time."""
        tables = [self._packed(rows) for rows in several]
        numbers, times, widths = (
            np.concatenate([np.zeros(0, np.int64), *columns])
            for columns in (
                [records["channel"] for records in tables],
                [records["log"] for records in tables],
                [np.full(len(records), records.itemsize) for records in tables],
            )
        )
        order = np.argsort(times, kind="stable")
        ends = np.cumsum(widths[order])
        begins = np.empty_like(ends)
        begins[order] = ends - widths[order]
        out = bytearray(int(widths.sum()))
        first = 0
        for records in tables:
            window(out, records.itemsize)[begins[first : first + len(records)]] = records.view(f"V{records.itemsize}")
            first += len(records)
        self._add(memoryview(out), ends, numbers[order], times[order])

    def write_message(self, message: RosMessage) -> None:
        number = self._number_of(message.topic)
        self._sequences[number] += 1
        times = max(0, message.log_ns), max(0, message.published_ns)
        head = np.array([(*_head_of(len(message.data)), number, self._sequences[number], *times)], _MESSAGE)
        record = head.tobytes() + message.data
        self._add(memoryview(record), np.array([len(record)]), head["channel"], head["log"])

    def flush(self) -> None:
        """Ends the chunk in hand: everything written so far is in the stream, whole."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        self._end_chunk()
        self._stream.write(self._summary.end(self._stream.tell()))

    def _packed(self, rows: TablePart) -> npt.NDArray[Any]:
        """Each row as the record of a message, in order of time."""
        if rows.table.name not in self._tables:
            self._tables[rows.table.name] = self._number_of(topic_of(rows.table))
        number = self._tables[rows.table.name]
        kinds = [np.dtype(_field_kind(column)).newbyteorder("<") for column in rows.table.columns]
        fields = [(f"f{at}", kind) for at, kind in enumerate(kinds)]
        out = np.zeros(len(rows), [*_MESSAGE.descr, *_STAMP, *fields])
        out["opcode"], out["length"] = _head_of(out.itemsize - _MESSAGE.itemsize)
        out["channel"] = number
        out["log"] = out["published"] = np.maximum(rows.t_ns, 0)
        seconds, nanoseconds = np.divmod(rows.t_ns, 1_000_000_000)
        out["head"] = np.void(_CDR_HEAD)
        out["sec"], out["nanosec"] = np.minimum(seconds, 0x7FFF_FFFF), nanoseconds
        for (name, kind), values in zip(fields, rows.values, strict=True):
            out[name] = np.where(values.mask, np.nan, values.data) if kind.kind == "f" else values.data
        if (np.diff(rows.t_ns) < 0).any():
            out = out[np.argsort(out["log"], kind="stable")]
        out["sequence"] = self._sequences[number] + 1 + np.arange(len(rows))
        self._sequences[number] += len(rows)
        return out

    def _add(self, records: memoryview, ends: Ints, numbers: Ints, times: Ints) -> None:
        """Records of messages, one behind the other; a chunk ends with the first that is beyond its size."""
        begins = np.concatenate(([0], ends))
        row = 0
        while row < len(ends):
            at, room = int(begins[row]), _CHUNK_BYTES - self._records.count
            upto = min(max(int(np.searchsorted(ends, at + room, side="right")), row) + 1, len(ends))
            places = begins[row:upto] + (self._records.count - at)
            self._messages.append((numbers[row:upto], times[row:upto], places))
            self._records.write(records[at : int(ends[upto - 1])])
            if self._records.count > _CHUNK_BYTES:
                self._end_chunk()
            row = upto

    def _end_chunk(self) -> None:
        """End the chunk in hand, if there is one, and write it with its index to the stream."""
        if not self._messages:
            return
        numbers, times, places = (np.concatenate(columns) for columns in zip(*self._messages, strict=True))
        self._messages.clear()
        out, at, data = self._records, self._stream.tell(), self._records.end()
        chunk = Chunk(
            compression="zstd",
            data=zstandard.compress(data),
            message_end_time=int(times.max()),
            message_start_time=int(times.min()),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        chunk.write(out)
        self._summary.add_chunk(chunk, at, at + out.count)
        for number in np.unique(numbers).tolist():
            mine, begin = numbers == number, out.count
            entries = np.stack((times[mine], places[mine]), axis=1).astype("<u8").tobytes()
            out.start_record(Opcode.MESSAGE_INDEX)
            out.write2(number)
            out.write4(len(entries))
            out.write(entries)
            out.finish_record()
            self._summary.add_messages(number, int(mine.sum()), at + begin, at + out.count)
        self._stream.write(out.end())

    def _number_of(self, topic: RosTopic) -> int:
        """Return the number of the topic's channel, which is registered when it is first met."""
        key, kind = (topic.name, topic.type_name), (topic.type_name, topic.definition)
        if kind not in self._types:
            number = self._types[kind] = len(self._types) + 1
            schema = Schema(number, topic.definition.encode(), SCHEMA_ENCODING, topic.type_name)
            self._summary.schemas[number] = schema
            schema.write(self._records)
        if key not in self._topics:
            number = self._topics[key] = len(self._topics) + 1
            qos = {"offered_qos_profiles": topic.qos}
            channel = Channel(number, topic.name, ENCODING, qos, self._types[kind])
            self._summary.channels[number] = channel
            channel.write(self._records)
        return self._topics[key]


def _field_kind(column: Column) -> str:
    return "float64" if column.optional or column.kind == "object" else column.kind


def _head_of(length: int) -> tuple[int, int]:
    """Opcode and length of the record of a message with so many bytes of data."""
    return Opcode.MESSAGE, _MESSAGE.itemsize - _RECORD_HEAD_BYTES + length


def topic_of(table: Table) -> RosTopic:
    """/BUS/MESSAGE, in characters that ROS allows, with the type of a table's rows."""
    parts = (table.channel, table.name.removeprefix(f"{table.channel}."))
    name = "/" + "/".join(_identifier(part) for part in parts if part)
    return RosTopic(name, f"{_PACKAGE}/msg/{_type_name(table.name)}", definition_of(table))


def definition_of(table: Table) -> str:
    """The ROS 2 message definition of a table's rows."""
    lines = [f"# {_comment(table.about)}", "builtin_interfaces/Time stamp"]
    used: set[str] = {"stamp"}
    for column in table.columns:
        kind = _field_kind(column)
        lines.append(f"# {_comment(column.name)}{', ' + _comment(column.unit) if column.unit else ''}")
        # ROS 2: lower case, no two underscores in a row and none at the end.
        name = _distinct(re.sub(r"_+", "_", _identifier(column.name).lower()).strip("_") or "x", used)
        if kind != "float64":
            for value, word in column.choices.items():
                constant = _distinct(f"{name}_{_identifier(word)}".upper().replace("__", "_").strip("_"), used)
                lines.append(f"{kind} {constant}={value}")
        lines.append(f"{kind} {name}")
    return "\n".join(lines) + f"\n{_TIME}"


def _distinct(name: str, used: set[str]) -> str:
    candidate, number = name, 2
    while candidate in used:
        candidate, number = f"{name}{number}", number + 1
    used.add(candidate)
    return candidate


def _identifier(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text) or "_"
    return name if name[0].isalpha() else f"x{name}"


def _type_name(text: str) -> str:
    """ROS 2: letters and digits, a capital first."""
    name = "".join(part[0].upper() + part[1:] for part in re.split(r"[^A-Za-z0-9]+", text) if part)
    return name if name[:1].isalpha() else f"X{name}"


def _comment(text: str) -> str:
    return " ".join(text.split())
