"""Between frames and images, both ways.

The layout of every message comes from the loaded signal database and from nowhere else. At load each message is
compiled into one function that shifts and masks (a bridge decodes 1500 frames a second and a simulation a hundred times
as many). That function answers only for what is plainly in order; anything doubtful goes to the careful path, which
finds out what is wrong and says it. Messages that shifting cannot do (big-endian, multiplexed) take the careful path
always, with cantools doing the bits.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any, cast

from cantools.database.can import Database, Message, Signal

from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.database import DatabaseError, dbc_dir, load_database
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.images import (
    AiCommand,
    AiImage,
    Faults,
    Image,
    VcuStatus,
)
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.signals import COMMAND_FIELDS, Field, Kind, Refuse, Row, rows
from fsai_vcu.interface.wheels import STRAIGHT, WheelMapping

_UNIT_SUFFIXES = ("_Nm", "_rpm", "_deg", "_kmh", "_pct")
_DBC_NAME_LENGTH = 32  # longer names are cut by the tools that official files come from
_FLOAT32_MAX = 3.4028234663852886e38
# Physical values are products of a raw integer and a decimal scale: equal up to the last bits of a float.
_ROUNDING = 1e-9


class EncodeError(ValueError):
    """A value that the wire cannot carry faithfully: out of range, not a number, unknown."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """What a frame said. `image` is None where it said nothing that may be believed.

    `problems` are sentences for people. `handshake` is the bit of a 0x520, set even where its image was not believed.
    """

    image: Image | None
    problems: tuple[str, ...] = ()
    handshake: bool | None = None


_NOTHING = Decoded(None)


class Codec:
    """Encodes and decodes the messages of one revision, for the AI side and for a simulated car alike.

    `dbc_paths` replaces the revision's own DBC files, for instance by an official one; `mapping` says which signal
    carries which wheel, in both directions. Raises DatabaseError when the files do not describe this car.

    `unknown`: one line on what such files lack of the revision's own, and what follows; empty where they lack nothing.
    """

    def __init__(
        self,
        revision: Revision,
        dbc_paths: Sequence[Path | str] | None = None,
        mapping: WheelMapping = STRAIGHT,
    ) -> None:
        paths = [dbc_dir() / name for name in revision.dbc_files] if dbc_paths is None else list(dbc_paths)
        self.revision = revision
        self.mapping = mapping
        self.database: Database = load_database(paths)
        self._decoders: dict[int, tuple[int, Callable[[bytes, int], Decoded]]] = {}
        self._encoders: dict[type, Callable[[Any, int], Frame]] = {}
        command_encoders: dict[type, Callable[[Any, int], Frame]] = {}
        lacking: list[_Lack] = []
        for row in rows(mapping):
            message = _find_message(self.database, row)
            if message is None:
                if row.required:
                    raise DatabaseError(f"{_files(paths)}: no message {row.message}, so this is not the car's database")
                lacking.append((row.message, _NOT_READ))
                continue
            _check_identity(row, message, paths)
            layout = _Layout(row, message, paths)
            lacking += layout.lacking
            self._decoders[message.frame_id] = (message.length, layout.decoder())
            self._encoders[row.image] = layout.encoder(None)
            if row.image in COMMAND_FIELDS:
                command_encoders[row.image] = layout.encoder(COMMAND_FIELDS[row.image])
        self._latest: tuple[Frame, Decoded] = (Frame(0, error=True), _NOTHING)
        self._command_encoders = tuple(command_encoders[image] for image in COMMAND_FIELDS)
        self._lacking = tuple(lacking)
        self.unknown = "" if dbc_paths is None else _lacking_line(paths, self._lacking, _lacking_by_nature(revision))

    def __deepcopy__(self, memo: dict[int, Any]) -> Codec:
        """What a codec says of a frame never changes: copies of a simulation share it."""
        return self

    def knows(self, can_id: int) -> bool:
        """Whether `decode` makes an image of this identifier."""
        return can_id in self._decoders

    def encode(self, image: Image) -> Frame:
        """The frame that carries `image`, stamped with the image's own time.

        Values are rounded to the nearest raw step. Raises EncodeError for a value out of range, not finite or unknown,
        and for a message that this revision lacks; logging fields saturate. Fields that the loaded database lacks, and
        those that are None, leave their bits at 0.
        """
        encoder = self._encoders.get(type(image))
        if encoder is None:
            raise EncodeError(f"{type(image).__name__} is not a message of the loaded database")
        return encoder(image, image.t_rx_ns)

    def encode_command(self, command: AiCommand, t_ns: int = 0) -> tuple[Frame, Frame, Frame, Frame, Frame]:
        """0x510 to 0x514 in that order, stamped `t_ns`. Raises EncodeError as `encode` does: all five or none."""
        status, front, rear, steer, brake = self._command_encoders
        return (
            status(command, t_ns),
            front(command, t_ns),
            rear(command, t_ns),
            steer(command, t_ns),
            brake(command, t_ns),
        )

    def decode(self, frame: Frame) -> Decoded:
        """What `frame` says. Never raises: what cannot be believed is in `problems`."""
        latest = self._latest
        if frame is latest[0]:
            return latest[1]  # whoever else hears the same frame asks next: a checker beside a bridge
        decoded = self._decode(frame)
        self._latest = (frame, decoded)
        return decoded

    def _decode(self, frame: Frame) -> Decoded:
        if frame.error:
            return _NOTHING
        if frame.remote or frame.extended:
            kind = "remote" if frame.remote else "extended"
            return Decoded(None, (f"{kind} frame 0x{frame.can_id:03X}: the car's bus has none",))
        known = self._decoders.get(frame.can_id)
        if known is None:
            return _NOTHING
        length, decode = known
        if len(frame.data) != length:
            said = f"0x{frame.can_id:03X}: {len(frame.data)} bytes where {length} belong"
            return Decoded(None, (said,))
        return decode(frame.data, frame.t_ns)


def command_of(images: Mapping[type, AiImage]) -> AiCommand:
    """One command out of the newest image of each of the five messages; those not yet heard count as safe defaults."""
    values: dict[str, Any] = {}
    for image_type, names in COMMAND_FIELDS.items():
        image = images.get(image_type)
        if image is not None:
            values.update({theirs: getattr(image, ours) for ours, theirs in names.items()})
    return AiCommand(**values)


# ---------------------------------------------------------------- finding names in a database


def _spellings(name: str) -> tuple[str, ...]:
    """The name as the interface has it, then as official files have been seen to spell it."""
    bare = name
    for suffix in _UNIT_SUFFIXES:
        bare = bare.removesuffix(suffix)
    return (name, name[:_DBC_NAME_LENGTH], bare, *(bare + suffix for suffix in _UNIT_SUFFIXES))


def _find_message(database: Database, row: Row) -> Message | None:
    by_name = {message.name: message for message in database.messages}
    for name in _spellings(row.message):
        if name in by_name:
            return by_name[name]
    return None


def _find_signal(message: Message, name: str) -> Signal | None:
    by_name = {signal.name: signal for signal in message.signals}
    for spelling in _spellings(name):
        if spelling in by_name:
            return by_name[spelling]
    return None


def _check_identity(row: Row, message: Message, paths: Sequence[Path | str]) -> None:
    """Safety rule 8: a database cannot make the AI side send on an identifier that is not its own."""
    expected = BY_NAME[row.message].can_id
    if message.frame_id != expected or message.is_extended_frame:
        raise DatabaseError(
            f"{_files(paths)}: {message.name} has identifier 0x{message.frame_id:03X}, not 0x{expected:03X}"
        )


def _files(paths: Sequence[Path | str]) -> str:
    return ", ".join(str(path) for path in paths)


# ---------------------------------------------------------------- what a database lacks

_Lack = tuple[str, str]  # the name of a signal or message, and what follows
_NOT_READ = "these messages are not read"
_NO_VALUE = "these values are not read"


@cache
def _lacking_by_nature(revision: Revision) -> tuple[_Lack, ...]:
    """What the revision's own files lack: it does not exist in this revision."""
    return Codec(revision)._lacking


def _lacking_line(paths: Sequence[Path | str], lacking: Sequence[_Lack], by_nature: Sequence[_Lack]) -> str:
    names: dict[str, list[str]] = {}
    for name, consequence in lacking:
        if (name, consequence) not in by_nature:
            names.setdefault(consequence, []).append(name)
    if not names:
        return ""
    told = "; ".join(f"{consequence} ({', '.join(these)})" for consequence, these in names.items())
    return f"{_files(paths)}: lacks signals of the car's interface: {told}"


# ---------------------------------------------------------------- one message, compiled


@dataclass(frozen=True, slots=True)
class _Slot:
    """A field together with its signal, found in the database."""

    field: Field
    signal: Signal
    raw_min: int
    raw_max: int
    low: float  # physical limits on encoding
    high: float

    @property
    def is_float(self) -> bool:
        return bool(self.signal.is_float)

    @property
    def margin(self) -> float:
        """How far beyond its limits a value may be by a float's rounding alone."""
        return 0.0 if self.is_float else _ROUNDING * max(1.0, abs(self.low), abs(self.high))

    @property
    def says_nothing_as_none(self) -> bool:
        """Whether None is a value of the field; its bits are then 0."""
        return self.field.optional or self.field.unknown is None

    @property
    def mask(self) -> int:
        return (1 << self.signal.length) - 1

    @property
    def per_unit(self) -> int | None:
        """Raw steps in one physical unit where that is a whole number: dividing by it rounds as decimals do."""
        steps = 1 / self.signal.scale
        return round(steps) if steps >= 1 and math.isclose(steps, round(steps), rel_tol=1e-12) else None

    def physical(self, raw: float) -> float:
        per_unit = self.per_unit
        scaled = raw if self.signal.scale == 1 else raw / per_unit if per_unit else raw * self.signal.scale
        return scaled + self.signal.offset if self.signal.offset else scaled

    def raw(self, value: float) -> int:
        """The nearest raw step to a physical value within the limits."""
        shifted = value - self.signal.offset
        steps = shifted * self.per_unit if self.per_unit else shifted / self.signal.scale
        return min(max(round(steps), self.raw_min), self.raw_max)


def _slot(field: Field, signal: Signal) -> _Slot:
    length = signal.length
    raw_min, raw_max = (-(1 << length - 1), (1 << length - 1) - 1) if signal.is_signed else (0, (1 << length) - 1)
    if signal.is_float:
        low, high = -_FLOAT32_MAX if length == 32 else -math.inf, _FLOAT32_MAX if length == 32 else math.inf
    else:
        ends = sorted((raw_min * signal.scale + signal.offset, raw_max * signal.scale + signal.offset))
        low, high = float(ends[0]), float(ends[1])
    if signal.minimum is not None:
        low = max(low, float(signal.minimum))
    if signal.maximum is not None:
        high = min(high, float(signal.maximum))
    return _Slot(field, signal, raw_min, raw_max, low, high)


class _Layout:
    """One message of the loaded database with the image that it fills."""

    def __init__(self, row: Row, message: Message, paths: Sequence[Path | str]) -> None:
        self.row = row
        self.message = message
        self.slots = self._find(row.fields, paths)
        self.fault_slots = self._find(row.faults, paths)
        self.defaults = {
            field.name: field.default
            for field in dataclasses.fields(row.image)
            if field.default is not dataclasses.MISSING
        }
        found = {*self.slots, *self.fault_slots}
        absent = [field for field in (*row.fields, *row.faults) if field.name not in found]
        self.defaults.update({field.name: None for field in absent if field.none_if_absent})
        self.lacking = [(field.signal, field.absent or _NO_VALUE) for field in absent]
        self.simple = not message.is_multiplexed() and all(
            slot.signal.byte_order == "little_endian"
            and (not slot.is_float or (slot.signal.length == 32 and slot.signal.start % 8 == 0))
            for slot in (*self.slots.values(), *self.fault_slots.values())
        )

    def _find(self, fields: Sequence[Field], paths: Sequence[Path | str]) -> dict[str, _Slot]:
        found = {}
        for field in fields:
            signal = _find_signal(self.message, field.signal)
            if signal is not None:
                found[field.name] = _slot(field, signal)
            elif not field.optional:
                raise DatabaseError(f"{_files(paths)}: {self.message.name} has no signal {field.signal}")
        return found

    # -------------------------------------------------------- raw values, the careful way

    def raws(self, data: bytes) -> dict[str, Any]:
        """Raw signal values by name. A multiplexed message yields only the signals that it carries."""
        decoded = self.message.decode(data, decode_choices=False, scaling=False, allow_truncated=False)
        return cast("dict[str, Any]", decoded)

    def careful_decode(self, data: bytes, t_ns: int) -> Decoded:
        """Decode field by field and say what is wrong."""
        try:
            raws = self.raws(data)
        except Exception as error:  # decode never raises, whatever a strange database makes cantools do
            return Decoded(None, (f"{self.message.name}: cannot be decoded: {error}",))
        problems: list[str] = []
        values: dict[str, Any] = {**self.defaults, "t_rx_ns": t_ns}
        believed = True
        for slot in self.slots.values():
            raw = raws.get(slot.signal.name)
            if raw is None:  # a multiplexed signal that this frame does not carry
                believed = believed and slot.field.optional
                continue
            value, problem = _read(slot, raw)
            if problem:
                problems.append(f"{self.message.name}: {problem}")
            if isinstance(value, Refuse):
                believed = False
            else:
                values[slot.field.name] = value
        if self.fault_slots:
            bits = {name: raws.get(slot.signal.name) for name, slot in self.fault_slots.items()}
            values["faults"] = Faults(**{name: None if bit is None else bool(bit) for name, bit in bits.items()})
        handshake = values.get("handshake") if self.row.image is VcuStatus else None
        image = self.row.image(**values) if believed else None
        return Decoded(image, tuple(problems), handshake)

    def careful_encode(self, source: Any, names: Mapping[str, str] | None, t_ns: int) -> Frame:
        """Encode field by field and say what is refused."""
        raws: dict[str, Any] = {signal.name: 0 for signal in self.message.signals}
        for name, slot in self.slots.items():
            value = getattr(source, name if names is None else names[name])
            raws[slot.signal.name] = _write(slot, value, self.message.name)
        for name, slot in self.fault_slots.items():
            raws[slot.signal.name] = _write(slot, getattr(source.faults, name), self.message.name)
        if self.simple:
            return Frame(self.message.frame_id, self._pack(raws), t_ns)
        try:
            data = self.message.encode(raws, scaling=False, padding=False, strict=False)
        except Exception as error:
            raise EncodeError(f"{self.message.name}: cannot be encoded: {error}") from error
        return Frame(self.message.frame_id, bytes(data), t_ns)

    def _pack(self, raws: Mapping[str, Any]) -> bytes:
        word = 0
        for slot in (*self.slots.values(), *self.fault_slots.values()):
            raw = raws[slot.signal.name]
            bits = int.from_bytes(struct.pack("<f", raw), "little") if slot.is_float else raw & slot.mask
            word |= bits << slot.signal.start
        return word.to_bytes(self.message.length, "little")

    # -------------------------------------------------------- compiled

    def decoder(self) -> Callable[[bytes, int], Decoded]:
        """A function of a frame's data (of the right length) and time."""
        if not self.simple:
            return self.careful_decode
        source = _Source(
            {"Image": self.row.image, "Faults": Faults, "Decoded": Decoded, "careful": self.careful_decode}
        )
        source.line("def decode(data, t_ns):")
        source.line("    word = from_bytes(data, 'little')")
        doubts: list[str] = []
        values = [self._decode_expression(source, field.name, doubts) for field in dataclasses.fields(self.row.image)]
        if doubts:
            source.line(f"    if {' or '.join(doubts)}:")
            source.line("        return careful(data, t_ns)")
        handshake = self._flag_expression("handshake") if self.row.image is VcuStatus else "None"
        source.line(f"    return Decoded(Image({', '.join(values)}), (), {handshake})")
        return cast("Callable[[bytes, int], Decoded]", source.function("decode"))

    def _flag_expression(self, name: str) -> str:
        return f"word & {1 << self.slots[name].signal.start} != 0"

    def _decode_expression(self, source: _Source, name: str, doubts: list[str]) -> str:
        if name == "t_rx_ns":
            return "t_ns"
        if name == "faults":
            mask = sum(1 << slot.signal.start for slot in self.fault_slots.values())
            source.names["faults_of"] = self._fault_table()
            return f"faults_of(word & {mask})"
        slot = self.slots.get(name)
        if slot is None:
            source.names[f"default_{name}"] = self.defaults[name]
            return f"default_{name}"
        start, length = slot.signal.start, slot.signal.length
        if slot.is_float:
            source.line(f"    {name}, = unpack_float(data, {start // 8})")
            doubts.append(f"not isfinite({name})")
            return _physical_source(slot, name)
        bits = f"word & {slot.mask}" if start == 0 else f"word >> {start} & {slot.mask}"
        if slot.field.kind is Kind.FLAG:
            return f"word & {slot.mask << start} != 0"
        if slot.field.kind is Kind.CHOICE:
            assert slot.field.choices is not None
            table: dict[int, Any] = dict.fromkeys(slot.field.unremarkable, slot.field.unknown)
            table.update({int(member): member for member in slot.field.choices})
            source.names[f"table_{name}"] = table
            source.line(f"    {name} = table_{name}.get({bits}, unknown)")
            doubts.append(f"{name} is unknown")
            return name
        if slot.signal.is_signed:
            sign = 1 << length - 1
            bits = f"(({bits}) ^ {sign}) - {sign}"
        return _physical_source(slot, f"({bits})")

    def _fault_table(self) -> Callable[[int], Faults]:
        """Faults by their bits. All combinations that occur are kept: they are few, and building one is slow."""
        seen: dict[int, Faults] = {}
        places = {name: 1 << slot.signal.start for name, slot in self.fault_slots.items()}

        def faults_of(bits: int) -> Faults:
            faults = seen.get(bits)
            if faults is None:
                faults = seen[bits] = Faults(**{name: bool(bits & place) for name, place in places.items()})
            return faults

        return faults_of

    def encoder(self, names: Mapping[str, str] | None) -> Callable[[Any, int], Frame]:
        """A function of an image (or, with `names`, of an object with those attributes) and a time."""

        def careful(source: Any, t_ns: int) -> Frame:
            return self.careful_encode(source, names, t_ns)

        if not self.simple:
            return careful
        source = _Source({"Frame": Frame, "careful": careful})
        source.line("def encode(source, t_ns):")
        source.line("    try:")
        terms: list[str] = []
        doubts: list[str] = []
        for name, slot in self.slots.items():
            attribute = name if names is None else names[name]
            source.line(f"        {name} = source.{attribute}")
            terms.append(self._encode_expression(source, name, slot, doubts))
        if self.fault_slots:
            source.line("        faults = source.faults")
            for name, slot in self.fault_slots.items():
                source.line(f"        fault_{name} = faults.{name}")
                terms.append(self._encode_expression(source, f"fault_{name}", slot, doubts))
        if doubts:
            source.line(f"        if {' or '.join(doubts)}:")
            source.line("            return careful(source, t_ns)")
        source.line(f"        word = {' | '.join(terms)}")
        source.line(f"        data = word.to_bytes({self.message.length}, 'little')")
        source.line("    except (TypeError, AttributeError, OverflowError):")
        source.line("        return careful(source, t_ns)")
        source.line(f"    return Frame({self.message.frame_id}, data, t_ns)")
        return cast("Callable[[Any, int], Frame]", source.function("encode"))

    def _encode_expression(self, source: _Source, name: str, slot: _Slot, doubts: list[str]) -> str:
        start = slot.signal.start
        if slot.field.kind in (Kind.FLAG, Kind.CHOICE):
            members = slot.field.choices or (0, 1)
            bits: dict[int | None, int] = {m: int(m) << start for m in members if slot.low <= m <= slot.high}
            if slot.says_nothing_as_none:
                bits[None] = 0
            source.names[f"bits_{name}"] = bits
            source.line(f"        {name} = bits_{name}.get({name})")
            doubts.append(f"{name} is None")
            return name
        source.names[f"low_{name}"] = slot.low - slot.margin
        source.names[f"high_{name}"] = slot.high + slot.margin
        doubts.append(f"not low_{name} <= {name} <= high_{name}")
        if slot.is_float:
            value = name
            if (slot.signal.scale, slot.signal.offset) != (1, 0):
                value = f"({name} - {slot.signal.offset!r}) / {slot.signal.scale!r}"
            return f"from_bytes(pack_float({value}), 'little') << {start}"
        shifted = f"({name} - {slot.signal.offset!r})" if slot.signal.offset else name
        per_unit = slot.per_unit
        if per_unit is None:
            steps = f"{shifted} / {slot.signal.scale!r}"
        else:
            steps = shifted if per_unit == 1 else f"{shifted} * {per_unit}"
        return f"(round({steps}) & {slot.mask}) << {start}"


def _physical_source(slot: _Slot, raw: str) -> str:
    """Source text: the physical value of a raw expression, as `_Slot.physical` computes it."""
    per_unit = slot.per_unit
    scaled = raw
    if slot.signal.scale != 1:
        scaled = f"{raw} / {per_unit}" if per_unit else f"{raw} * {slot.signal.scale!r}"
    if slot.signal.offset:
        scaled = f"{scaled} + {slot.signal.offset!r}"
    return f"round({scaled})" if slot.field.kind is Kind.WHOLE and scaled != raw else scaled


class _Source:
    """Source text of a function and the names that it uses."""

    def __init__(self, names: dict[str, Any]) -> None:
        self.names: dict[str, Any] = {
            "from_bytes": int.from_bytes,
            "unpack_float": struct.Struct("<f").unpack_from,
            "pack_float": struct.Struct("<f").pack,
            "isfinite": math.isfinite,
            "unknown": object(),
            **names,
        }
        self._lines: list[str] = []

    def line(self, text: str) -> None:
        self._lines.append(text)

    def function(self, name: str) -> Any:
        exec(compile("\n".join(self._lines), f"<{name} compiled from the signal database>", "exec"), self.names)
        return self.names[name]


# ---------------------------------------------------------------- one field, the careful way


def _read(slot: _Slot, raw: Any) -> tuple[Any, str | None]:
    """The field's value, or Refuse, and what is wrong with it."""
    field = slot.field
    if field.kind is Kind.FLAG:
        return bool(raw), None
    if field.kind is Kind.CHOICE:
        assert field.choices is not None
        try:
            return field.choices(raw), None
        except ValueError:
            reported = (
                None if raw in field.unremarkable else f"{slot.signal.name} {raw} is not in the interface's table"
            )
            return field.unknown, reported
    if not math.isfinite(raw):
        return Refuse.FRAME, f"{slot.signal.name} is {raw}, not a finite number"
    value = slot.physical(raw)
    return (round(value) if field.kind is Kind.WHOLE else value), None


def _write(slot: _Slot, value: Any, message: str) -> int | float:
    """The raw value of a field. None is 0: the signal says nothing."""
    field = slot.field
    what = f"{message}: {slot.signal.name}"
    if value is None and slot.says_nothing_as_none:
        return 0
    if field.kind is Kind.FLAG:
        if value not in (False, True):
            raise EncodeError(f"{what} is {value!r}, not a flag")
        return int(value)
    if field.kind is Kind.CHOICE:
        assert field.choices is not None
        try:
            member = field.choices(value)
        except ValueError:
            raise EncodeError(f"{what} {value!r} is not in the interface's table") from None
        if not (slot.low <= member <= slot.high):
            raise EncodeError(f"{what} {member.name} does not exist in this revision")
        return int(member)
    if not isinstance(value, Real) or math.isnan(value):
        raise EncodeError(f"{what} is {value!r}, not a number")
    number = float(value)
    if field.saturates:
        number = min(max(number, slot.low), slot.high)
    if not slot.low - slot.margin <= number <= slot.high + slot.margin:
        raise EncodeError(
            f"{what} {number:g} is out of range {slot.low:g} … {slot.high:g} {slot.signal.unit or ''}".strip()
        )
    if slot.is_float:
        return (number - slot.signal.offset) / slot.signal.scale
    return slot.raw(number)
