"""Tables and ROS 2 messages as MCAP, the file that Foxglove and `ros2 bag` open.

Every channel is CDR with a ROS 2 definition, the tables' too: `ros2 bag` opens no file that mixes encodings. A table is
a message type of the package `fsai_can`; its fields are the signals, in ROS's lower case, with the database's words as
constants. A field of an integer that a row may lack is a float64, NaN where it has none.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.writer import CompressionType, Writer

from fsai_vcu.diagnostics.export.tables import Column, Rows, Table

PROFILE: Final = "ros2"
ENCODING, SCHEMA_ENCODING = "cdr", "ros2msg"
_PACKAGE: Final = "fsai_can"
_CDR_HEAD: Final = b"\0\1\0\0"  # CDR of the XCDR1 kind, little-endian
_CHUNK_BYTES: Final = 1 << 20
# A table's row in CDR: head and stamp, then a field of eight bytes for each column, so that nothing is padded.
_STAMP: Final = (("head", "V4"), ("sec", "<i4"), ("nanosec", "<u4"))
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
def mcap_file(path: Path) -> Iterator[Callable[[Rows], None]]:
    """Writes all tables to one file."""
    with path.open("wb") as stream:
        tables = McapTables(stream)
        yield lambda rows: tables.write_together([rows])
        tables.finish()


class McapTables:
    """Writes one MCAP file to an open stream. `flush` puts all of it there; `finish` adds the index."""

    def __init__(self, stream: Any, metadata: Mapping[str, str] | None = None) -> None:
        """`stream` has write, tell and flush; `metadata` is kept in the file under the name 'fsai-vcu'."""
        self._writer: Any = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, library="fsai-vcu")
        if metadata:
            self._writer.add_metadata("fsai-vcu", dict(metadata))
        self._tables: dict[str, int] = {}
        self._topics: dict[tuple[str, str], int] = {}
        self._types: dict[tuple[str, str], int] = {}  # numbers of schemas, by name and definition
        self._sequences: dict[int, int] = {}

    def write_together(self, several: Sequence[Rows]) -> None:
        """Rows of several tables, in order of time."""
        messages: list[tuple[int, int, bytes]] = []
        for rows in several:
            if rows.table.name not in self._tables:
                self._tables[rows.table.name] = self._number_of(topic_of(rows.table))
            number = self._tables[rows.table.name]
            times = np.maximum(rows.t_ns, 0).tolist()
            messages += [(t_ns, number, data) for t_ns, data in zip(times, _packed(rows), strict=True)]
        for t_ns, number, data in sorted(messages, key=lambda message: message[0]):
            self._add(number, data, t_ns, t_ns)

    def write_message(self, message: RosMessage) -> None:
        self._add(self._number_of(message.topic), message.data, max(0, message.log_ns), max(0, message.published_ns))

    def flush(self) -> None:
        """Ends the chunk in hand: everything written so far is in the stream, whole."""
        self._writer.flush()

    def finish(self) -> None:
        self._writer.finish()

    def _add(self, number: int, data: bytes, log_ns: int, published_ns: int) -> None:
        sequence = self._sequences[number] = self._sequences.get(number, 0) + 1
        self._writer.add_message(number, log_ns, data, published_ns, sequence)

    def _number_of(self, topic: RosTopic) -> int:
        """Of the topic's channel, registered when it is first met."""
        key, kind = (topic.name, topic.type_name), (topic.type_name, topic.definition)
        if kind not in self._types:
            data = topic.definition.encode()
            self._types[kind] = self._writer.register_schema(topic.type_name, SCHEMA_ENCODING, data)
        if key not in self._topics:
            qos = {"offered_qos_profiles": topic.qos}
            self._topics[key] = self._writer.register_channel(topic.name, ENCODING, self._types[kind], qos)
        return self._topics[key]


def _field_kind(column: Column) -> str:
    return "float64" if column.optional or column.kind == "object" else column.kind


def _packed(rows: Rows) -> list[bytes]:
    """Each row as a message."""
    kinds = [np.dtype(_field_kind(column)).newbyteorder("<") for column in rows.table.columns]
    fields = [(f"f{at}", kind) for at, kind in enumerate(kinds)]
    out = np.zeros(len(rows), [*_STAMP, *fields])
    seconds, nanoseconds = np.divmod(rows.t_ns, 1_000_000_000)
    out["head"] = np.void(_CDR_HEAD)
    out["sec"], out["nanosec"] = np.minimum(seconds, 0x7FFF_FFFF), nanoseconds
    for (name, kind), values in zip(fields, rows.values, strict=True):
        out[name] = np.where(values.mask, np.nan, values.data) if kind.kind == "f" else values.data
    whole, size = out.tobytes(), out.dtype.itemsize
    return [whole[at : at + size] for at in range(0, len(whole), size)]


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
