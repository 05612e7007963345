"""Tables and ROS 2 messages as MCAP, the file that Foxglove and `ros2 bag` open.

Every channel is CDR with a ROS 2 definition, the tables' too: `ros2 bag` opens no file that mixes encodings. A table is
a message type of the package `fsai_can`; its fields are the signals, in ROS's lower case, with the database's words as
constants. A field of an integer that a row may lack is a float64, NaN where it has none.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, cast

import numpy as np
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import CompressionType, Writer

from fsai_vcu.diagnostics.export.tables import Column, Rows, Table, Values
from fsai_vcu.diagnostics.log.characters import put
from fsai_vcu.diagnostics.log.frames import Ints

PROFILE: Final = "ros2"
ENCODING, SCHEMA_ENCODING = "cdr", "ros2msg"
_PACKAGE: Final = "fsai_can"
_CDR_HEAD: Final = b"\0\1\0\0"  # CDR of the XCDR1 kind, little-endian
_CHUNK_BYTES: Final = 1 << 20
# A message in the file (mcap.dev/spec, Message), up to the fields of its table.
_MESSAGE: Final = (
    ("opcode", "u1"),
    ("size", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
    ("head", "V4"),
    ("sec", "<i4"),
    ("nanosec", "<u4"),
)
_RECORD_HEAD_BYTES: Final = 9  # opcode and size
Records = np.ndarray[tuple[int], np.dtype[np.void]]
_RULE: Final = "=" * 80
_TIME: Final = f"{_RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"


class Stream(Protocol):
    """What a file is written to."""

    def write(self, data: bytes, /) -> int: ...
    def tell(self) -> int: ...
    def flush(self) -> None: ...


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


class _Index(MessageIndex):
    """Written at once, not number by number."""

    def write(self, stream: Any) -> None:
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(self.records) * 16)
        stream.write(np.array(self.records, "<u8").tobytes())
        stream.finish_record()


@dataclass(frozen=True, slots=True)
class _Channel:
    number: int
    dtype: np.dtype[np.void]


class McapTables:
    """Writes one MCAP file to an open stream. `flush` puts all of it there; `finish` adds the index."""

    def __init__(self, stream: Stream, metadata: Mapping[str, str] | None = None) -> None:
        """`metadata` is kept in the file under the name 'fsai-vcu'."""
        self._writer: Any = Writer(cast(Any, stream), chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, library="fsai-vcu")
        if metadata:
            self._writer.add_metadata("fsai-vcu", dict(metadata))
        self._tables: dict[str, _Channel] = {}
        self._topics: dict[tuple[str, str], int] = {}
        self._types: dict[tuple[str, str], int] = {}
        self._sequences: dict[int, int] = {}

    def write(self, rows: Rows) -> None:
        self.write_together([rows])

    def write_together(self, several: Sequence[Rows]) -> None:
        """Rows of several tables, in order of time."""
        records = [self._records(rows) for rows in several]
        if not any(map(len, records)):
            return
        times, numbers = (np.concatenate([each[name] for each in records]) for name in ("log_time", "channel"))
        sizes = np.repeat([each.dtype.itemsize for each in records], list(map(len, records)))
        order = np.argsort(times, kind="stable")
        ends = np.cumsum(sizes[order])
        begins = np.empty_like(ends)
        begins[order] = ends - sizes[order]
        out = bytearray(int(ends[-1]))
        for each, places in zip(records, np.split(begins, np.cumsum(list(map(len, records)))[:-1]), strict=True):
            put(out, places, each.view(np.uint8).reshape(len(each), -1))
        for rows in np.split(order, np.flatnonzero(np.diff(ends // _CHUNK_BYTES)) + 1):
            begin, end = int(begins[rows[0]]), int(begins[rows[-1]] + sizes[rows[-1]])
            self._add_many(memoryview(out)[begin:end], numbers[rows], times[rows], begins[rows] - begin)

    def write_message(self, message: RosMessage) -> None:
        topic = message.topic
        number = self._topics.get((topic.name, topic.type_name))
        if number is None:
            number = self._register(topic)
            self._topics[topic.name, topic.type_name] = number
        self._add(number, message.data, message.log_ns, message.published_ns)

    def flush(self) -> None:
        """Ends the chunk in hand: everything written so far is in the stream, whole."""
        self._writer.flush()

    def finish(self) -> None:
        self._writer.finish()

    def close(self) -> None:
        """The stream is its owner's to close."""

    def _add(self, number: int, data: bytes, log_ns: int, published_ns: int) -> None:
        sequence = self._sequences[number] = self._sequences.get(number, 0) + 1
        self._writer.add_message(number, max(0, log_ns), data, max(0, published_ns), sequence)

    def _add_many(self, records: memoryview, numbers: Ints, times: Ints, places: Ints) -> None:
        """Records of messages in order of time, as they are in a file: what `Writer.add_message` does for each.

        The writer takes only single messages from outside, and three times as long for them.
        """
        chunk, statistics = self._writer._Writer__chunk_builder, self._writer._Writer__statistics
        places = places + chunk.record_writer.count
        chunk.record_writer.write(records)
        for number in np.unique(numbers).tolist():
            ours = numbers == number
            index = chunk.message_indices.setdefault(number, _Index(number, []))
            index.records += zip(times[ours].tolist(), places[ours].tolist(), strict=True)
            statistics.channel_message_counts[number] += int(ours.sum())
        first, last = int(times[0]), int(times[-1])
        for total, count in ((chunk, "num_messages"), (statistics, "message_count")):
            before = getattr(total, count)
            total.message_start_time = min(first, total.message_start_time) if before else first
            total.message_end_time = max(last, total.message_end_time)
            setattr(total, count, before + len(times))
        self._writer._Writer__maybe_finalize_chunk()

    def _records(self, rows: Rows) -> Records:
        """A table's rows as records of messages."""
        channel = self._tables.get(rows.table.name)
        if channel is None:
            channel = self._tables[rows.table.name] = self._table_channel(rows.table)
        out = np.zeros(len(rows), channel.dtype)
        before = self._sequences.get(channel.number, 0)
        self._sequences[channel.number] = before + len(rows)
        out["opcode"], out["size"] = Opcode.MESSAGE, channel.dtype.itemsize - _RECORD_HEAD_BYTES
        out["channel"], out["sequence"] = channel.number, np.arange(before + 1, before + 1 + len(rows))
        out["log_time"] = out["publish_time"] = np.maximum(rows.t_ns, 0)
        _pack(rows, out)
        return out

    def _table_channel(self, table: Table) -> _Channel:
        topic = RosTopic(topic_of(table), f"{_PACKAGE}/msg/{_type_name(table.name)}", definition_of(table))
        fields = [(f"f{at}", _CDR_TYPES[_field_kind(column)][1]) for at, column in enumerate(table.columns)]
        return _Channel(self._register(topic), np.dtype([*_MESSAGE, *fields]))

    def _register(self, topic: RosTopic) -> int:
        key = (topic.type_name, topic.definition)
        schema = self._types.get(key)
        if schema is None:
            data = topic.definition.encode()
            schema = self._types[key] = self._writer.register_schema(topic.type_name, SCHEMA_ENCODING, data)
        number: int = self._writer.register_channel(topic.name, ENCODING, schema, {"offered_qos_profiles": topic.qos})
        return number


# All fields behind the stamp take eight bytes, so that nothing is padded.
_CDR_TYPES: Final = {"int64": ("int64", "<i8"), "uint64": ("uint64", "<u8"), "float64": ("float64", "<f8")}


def _field_kind(column: Column) -> str:
    return "float64" if column.optional or column.kind == "text" else column.kind


def _pack(rows: Rows, out: Records) -> None:
    """The messages themselves."""
    seconds, nanoseconds = np.divmod(rows.t_ns, 1_000_000_000)
    out["head"] = np.void(_CDR_HEAD)
    out["sec"], out["nanosec"] = np.minimum(seconds, 0x7FFF_FFFF), nanoseconds
    for at, (column, values) in enumerate(zip(rows.table.columns, rows.values, strict=True)):
        out[f"f{at}"] = _numbers(column, values)


def _numbers(column: Column, values: Values) -> np.ndarray[tuple[int], np.dtype[np.generic]]:
    if _field_kind(column) != "float64":
        return values.numbers
    numbers = values.numbers.astype(np.float64, copy=False)
    return numbers if values.present is None else np.where(values.present, numbers, np.nan)


def topic_of(table: Table) -> str:
    """/BUS/MESSAGE, in characters that ROS allows."""
    name = table.name.removeprefix(f"{table.channel}.")
    return "/" + "/".join(_identifier(part) for part in (table.channel, name) if part)


def definition_of(table: Table) -> str:
    """The ROS 2 message definition of a table's rows."""
    lines = [f"# {_comment(table.about)}", "builtin_interfaces/Time stamp"]
    used: set[str] = {"stamp"}
    for column in table.columns:
        kind = _field_kind(column)
        lines.append(f"# {_comment(column.name)}{', ' + _comment(column.unit) if column.unit else ''}")
        name = _distinct(_field_name(column.name), used)
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


def _field_name(text: str) -> str:
    """ROS 2: lower case, no two underscores in a row and none at the end."""
    return re.sub(r"_+", "_", _identifier(text).lower()).strip("_") or "x"


def _type_name(text: str) -> str:
    """ROS 2: letters and digits, a capital first."""
    name = "".join(part[0].upper() + part[1:] for part in re.split(r"[^A-Za-z0-9]+", text) if part)
    return name if name[:1].isalpha() else f"X{name}"


def _comment(text: str) -> str:
    return " ".join(text.split())
