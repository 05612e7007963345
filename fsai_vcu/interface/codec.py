"""Between frames and images, both ways.

The layout of every message comes from the loaded signal database and from nowhere else; `Codec.mask` gives a position.
At load each message gets a function that shifts and masks (a bridge decodes 1500 frames a second and a simulation a
hundred times as many). That function answers only for what is plainly in order; anything doubtful goes to the careful
path, which finds out what is wrong and reports it. Messages that shifting cannot do (big-endian,
multiplexed) take the careful path always, with cantools doing the bits.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from functools import cache, lru_cache
from numbers import Real
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

from msgspec import NODEFAULT, structs

try:
    import bitstruct.c as bitstruct
except ImportError:  # a machine for which it is not compiled
    import bitstruct

from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.database import DatabaseError, dbc_dir, load_database
from fsai_vcu.interface.fields import Field, Refuse, fields_of
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import COMMAND_FIELDS, MESSAGES, AiCommand, AiImage, Image, VcuStatus
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.wheels import STRAIGHT, WheelMapping

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

_UNIT_SUFFIXES = ("_Nm", "_rpm", "_deg", "_kmh", "_pct")
_DBC_NAME_LENGTH = 32  # longer names are cut by the tools that official files come from
_FLOAT32_MAX = 3.4028234663852886e38
# Physical values are products of a raw integer and a decimal scale: equal up to the last bits of a float.
_ROUNDING = 1e-9


class EncodeError(ValueError):
    """A value that the wire cannot carry faithfully: out of range, not a number, unknown."""


class Decoded(NamedTuple):
    """What a frame reports. `image` is None where it reports nothing that may be believed.

    `problems` are sentences for people. `handshake` is the bit of a 0x520, set even where its image was not believed.
    """

    image: Image | None
    problems: tuple[str, ...] = ()
    handshake: bool | None = None


_NOTHING = Decoded(None)
_new: Final = tuple.__new__  # a named tuple's own way takes thrice as long


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
        self._decoders: dict[int, Callable[[Frame], Decoded]] = {}
        self._encoders: dict[type, Callable[[Any, int], Frame]] = {}
        self._layouts: dict[type, _Layout] = {}
        lacking: list[_Lack] = []
        for kind in MESSAGES:
            message = _find_message(self.database, kind.dbc_name)
            if message is None:
                if kind.required:
                    raise DatabaseError(
                        f"{_files(paths)}: no message {kind.dbc_name}, so this is not the car's database"
                    )
                lacking.append((kind.dbc_name, _NO_MESSAGE))
                continue
            _check_identity(kind.dbc_name, message, paths)
            layout = _Layout(kind, message, mapping, paths)
            lacking += layout.lacking
            self._layouts[kind] = layout
            self._decoders[message.frame_id] = layout.decoder()
            self._encoders[kind] = layout.encoder(None)
        self._command_encoders = tuple(self._layouts[kind].encoder(names) for kind, names in COMMAND_FIELDS.items())
        self._lacking = tuple(lacking)
        self.unknown = "" if dbc_paths is None else _lacking_line(paths, self._lacking, codec_of(revision)._lacking)

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

    def mask(self, message: type[Image], *names: str) -> int:
        """Where the signals of these fields are in a payload as a little-endian number; 0 where there are none."""
        layout = self._layouts.get(message)
        slots = [] if layout is None else [layout.slots[name] for name in names if name in layout.slots]
        return sum(slot.mask << slot.start for slot in slots)

    def decode(self, frame: Frame) -> Decoded:
        """What `frame` says. Never raises: what cannot be believed is in `problems`."""
        if frame.error:
            return _NOTHING
        if frame.remote or frame.extended:
            kind = "remote" if frame.remote else "extended"
            return Decoded(None, (f"{kind} frame 0x{frame.can_id:03X}: the car's bus has none",))
        decode = self._decoders.get(frame.can_id)
        return _NOTHING if decode is None else decode(frame)


def command_of(images: Mapping[type, AiImage]) -> AiCommand:
    """One command out of the newest image of each of the five messages; those not received count as safe defaults."""
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


def _find_message(database: Database, dbc_name: str) -> Message | None:
    by_name = {message.name: message for message in database.messages}
    return next((by_name[name] for name in _spellings(dbc_name) if name in by_name), None)


def _find_signal(message: Message, name: str) -> Signal | None:
    by_name = {signal.name: signal for signal in message.signals}
    return next((by_name[spelling] for spelling in _spellings(name) if spelling in by_name), None)


def _check_identity(dbc_name: str, message: Message, paths: Sequence[Path | str]) -> None:
    """Safety rule 8: a database cannot make the AI side send on an identifier that is not its own."""
    expected = BY_NAME[dbc_name].can_id
    if message.frame_id != expected or message.is_extended_frame:
        raise DatabaseError(
            f"{_files(paths)}: {message.name} has identifier 0x{message.frame_id:03X}, not 0x{expected:03X}"
        )


@cache
def codec_of(revision: Revision) -> Codec:
    """The codec of a revision's own files, made once: it never changes."""
    return Codec(revision)


def _files(paths: Sequence[Path | str]) -> str:
    return ", ".join(str(path) for path in paths)


# ---------------------------------------------------------------- what a database lacks

_Lack = tuple[str, str]  # the name of a signal or message, and what follows
_NO_MESSAGE: Final = "these messages are not read"


def _lacking_line(paths: Sequence[Path | str], lacking: Sequence[_Lack], by_nature: Sequence[_Lack]) -> str:
    names: dict[str, list[str]] = {}
    for name, consequence in lacking:
        if (name, consequence) not in by_nature:
            names.setdefault(consequence, []).append(name)
    if not names:
        return ""
    listed = "; ".join(f"{consequence} ({', '.join(these)})" for consequence, these in names.items())
    return f"{_files(paths)}: lacks signals of the car's interface: {listed}"


# ---------------------------------------------------------------- one message


class _Slot:
    """A field together with its signal, found in the database."""

    def __init__(self, field: Field, signal: Signal) -> None:
        self.field = field
        self.signal = signal
        length, self.start, self.scale, self.offset = signal.length, signal.start, signal.scale, signal.offset
        self.is_float = bool(signal.is_float)
        self.mask = (1 << length) - 1  # as wide as the signal; where it is in the frame is `mask << start`
        self.sign = 1 << length - 1 if signal.is_signed else 0
        # Raw steps in one physical unit where that is a whole number: dividing by it rounds as decimals do.
        steps = 1 / signal.scale
        whole = steps >= 1 and math.isclose(steps, round(steps), rel_tol=1e-12)
        self.per_unit = round(steps) if whole else None
        # Physical limits on encoding, and how far beyond them a value may be by a float's rounding alone.
        if self.is_float:
            self.high = _FLOAT32_MAX if length == 32 else math.inf
            self.low = -self.high
        else:
            ends = [raw * signal.scale + signal.offset for raw in (-self.sign, self.mask - self.sign)]
            self.low, self.high = float(min(ends)), float(max(ends))
        if signal.minimum is not None:
            self.low = max(self.low, float(signal.minimum))
        if signal.maximum is not None:
            self.high = min(self.high, float(signal.maximum))
        self.margin = 0.0 if self.is_float else _ROUNDING * max(1.0, abs(self.low), abs(self.high))

    def number(self, raw: float) -> float:
        """The field's value of a finite raw one."""
        scaled = raw if self.scale == 1 else raw / self.per_unit if self.per_unit else raw * self.scale
        value = scaled + self.offset if self.offset else scaled
        return round(value) if self.field.holds is int else value

    def steps(self, value: float) -> float:
        """Where a physical value is on the raw scale."""
        shifted = value - self.offset
        return shifted * self.per_unit if self.per_unit else shifted / self.scale


# Flags, choices and fields up to this wide take few values together: each combination that occurs is read once.
_FEW_BITS: Final = 4
_COMBINATIONS: Final = 1024
_FLOAT: Final = struct.Struct("<f")
_RAW_FLOAT: Final = struct.Struct("<I")


class _Layout:
    """One message of the loaded database with the class that it fills."""

    def __init__(self, kind: type[Image], message: Message, wheels: WheelMapping, paths: Sequence[Path | str]) -> None:
        self.kind: Any = kind
        self.message = message
        self.slots: dict[str, _Slot] = {}
        self.defaults: dict[str, Any] = {}
        self.lacking: list[_Lack] = []
        for field in fields_of(cast("Any", kind), wheels):
            signal = _find_signal(message, field.signal)
            self.defaults[field.name] = None if signal is None and field.nullable else field.default
            if signal is not None:
                self.slots[field.name] = _Slot(field, signal)
            elif field.absent is not None:
                self.lacking.append((field.signal, field.absent))
            else:
                raise DatabaseError(f"{_files(paths)}: {message.name} has no signal {field.signal}")
        declared = [field for field in structs.fields(kind) if field.name != "t_rx_ns"]
        self.names = [field.name for field in declared]
        self.groups: dict[str, Any] = {
            field.name: field.default_factory for field in declared if field.default_factory is not NODEFAULT
        }
        self.simple = not message.is_multiplexed() and all(
            slot.signal.byte_order == "little_endian"
            and (not slot.is_float or (slot.signal.length == 32 and slot.field.holds is float))
            for slot in self.slots.values()
        )

    def in_groups(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values by the names of `fields_of` become values of the class's own fields."""
        grouped = {name: values[name] for name in self.names if name not in self.groups}
        for name, group in self.groups.items():
            begin = f"{name}."
            grouped[name] = group(**{k.removeprefix(begin): v for k, v in values.items() if k.startswith(begin)})
        return grouped

    # -------------------------------------------------------- the careful way

    def careful_decode(self, frame: Frame) -> Decoded:
        """Decode field by field and say what is wrong."""
        data, length = frame.data, self.message.length
        if len(data) != length:
            return Decoded(None, (f"0x{frame.can_id:03X}: {len(data)} bytes where {length} belong",))
        try:
            raws = cast(
                "dict[str, Any]",
                self.message.decode(data, decode_choices=False, scaling=False, allow_truncated=False),
            )
        except Exception as error:  # decode never raises, whatever a strange database makes cantools do
            return Decoded(None, (f"{self.message.name}: cannot be decoded: {error}",))
        problems: list[str] = []
        values = dict(self.defaults)
        believed = True
        for name, slot in self.slots.items():
            raw = raws.get(slot.signal.name)
            if raw is None:  # a multiplexed signal that this frame does not carry
                believed = believed and slot.field.absent is not None
                continue
            value, problem = _read(slot, raw)
            if problem:
                problems.append(f"{self.message.name}: {problem}")
            if isinstance(value, Refuse):
                believed = False
            else:
                values[name] = value
        handshake = values["handshake"] if self.kind is VcuStatus else None
        image = self.kind(**self.in_groups(values), t_rx_ns=frame.t_ns) if believed else None
        return Decoded(image, tuple(problems), handshake)

    def careful_encode(self, source: Any, names: Mapping[str, str] | None, t_ns: int) -> Frame:
        """Encode field by field and say what is refused."""
        raws: dict[str, Any] = {signal.name: 0 for signal in self.message.signals}
        for name, slot in self.slots.items():
            value = attrgetter(name if names is None else names[name])(source)
            raws[slot.signal.name] = _write(slot, value, self.message.name)
        try:
            data = self.message.encode(raws, scaling=False, padding=False, strict=False)
        except Exception as error:
            raise EncodeError(f"{self.message.name}: cannot be encoded: {error}") from error
        return Frame(self.message.frame_id, bytes(data), t_ns)

    # -------------------------------------------------------- the quick way

    def decoder(self) -> Callable[[Frame], Decoded]:
        """A function of a data frame on the message's identifier."""
        if not self.simple:
            return self.careful_decode
        narrow = {name: slot for name, slot in self.slots.items() if _is_narrow(slot)}
        wide = sorted(self.slots.keys() - narrow.keys(), key=lambda name: -self.slots[name].start)
        others = [name for name in self.names if name not in wide]
        known: dict[str, Any] = {}
        read = {name: _number(self.slots[name], name, known) for name in wide}
        row = ", ".join(read.get(name, name) for name in self.names)
        arrange: Callable[..., list[Any]] = eval(f"lambda {', '.join([*others, *wide])}: [{row}]", known)
        mask = sum(slot.mask << slot.start for slot in narrow.values())
        unpack = bitstruct.compile(_from_the_end([self.slots[name] for name in wide], self.message.length)).unpack
        any_float = any(slot.is_float for slot in self.slots.values())
        of, careful, is_status, length = self.kind, self.careful_decode, self.kind is VcuStatus, self.message.length

        @lru_cache(maxsize=_COMBINATIONS)
        def read_narrow(word: int) -> tuple[Any, ...]:
            values = dict(self.defaults)
            for name, slot in narrow.items():
                values[name], problem = _read(slot, ((word >> slot.start & slot.mask) ^ slot.sign) - slot.sign)
                if problem:
                    raise ValueError(problem)
            grouped = self.in_groups(values)
            return tuple(grouped[name] for name in others)

        latest: tuple[bytes | None, list[Any]] = (None, [])  # most payloads of a bus repeat the one before
        answered: tuple[Frame | None, Decoded] = (None, _NOTHING)  # a frame has several receivers: bridge and checker

        def decode(frame: Frame) -> Decoded:
            nonlocal latest, answered
            asked, decoded = answered
            if frame is asked:
                return decoded
            known, values = latest
            data = frame.data
            if data != known:
                found = read_all(data) if len(data) == length else None
                if found is None:
                    return careful(frame)
                latest, values = (data, found), found
            image: Any = of(*values, frame.t_ns)
            decoded = _new(Decoded, (image, (), image.handshake if is_status else None))
            answered = frame, decoded
            return decoded

        def read_all(data: bytes) -> list[Any] | None:
            """The values of the class's fields; None where something is wrong."""
            values = unpack(data[::-1]) if wide else ()
            if any_float and not math.isfinite(sum(values)):
                return None
            if not others:
                return arrange(*values)
            try:
                return arrange(*read_narrow(int.from_bytes(data, "little") & mask), *values)
            except ValueError:
                return None

        return decode

    def encoder(self, names: Mapping[str, str] | None) -> Callable[[Any, int], Frame]:
        """A function of an image (or, with `names`, of an object with those attributes) and a time."""

        def careful(source: Any, t_ns: int) -> Frame:
            return self.careful_encode(source, names, t_ns)

        if not self.simple or not self.slots:
            return careful
        known: dict[str, Any] = {"careful": careful, "make": Frame, "can_id": self.message.frame_id}
        written = [_written(slot, number, known) for number, slot in enumerate(self.slots.values())]
        ranged = [number for number in range(len(written)) if f"low{number}" in known]
        ranges = " and ".join(f"low{number} <= v{number} <= high{number}" for number in ranged)
        attributes = [name if names is None else names[name] for name in self.slots]
        lines = [
            "def encode(source, t_ns):",
            " try:",
            *(f"  v{number} = source.{attribute}" for number, attribute in enumerate(attributes)),
            f"  if {ranges or True}:",
            f"   data = ({' + '.join(written)}).to_bytes({self.message.length}, 'little')",
            "   return make(can_id, data, t_ns)",
            " except (KeyError, ValueError, TypeError, AttributeError, OverflowError):",
            "  pass",
            " return careful(source, t_ns)",
        ]
        exec(compile("\n".join(lines), f"<encoder of {self.message.name}>", "exec"), known)
        return cast("Callable[[Any, int], Frame]", known["encode"])


def _is_narrow(slot: _Slot) -> bool:
    return slot.field.holds not in (int, float) or (not slot.is_float and slot.signal.length <= _FEW_BITS)


def _from_the_end(slots: Sequence[_Slot], length: int) -> str:
    """The format of a payload read backwards, so that little-endian signals are whole; `slots` with the last first."""
    formats, end = [], 8 * length
    for slot in slots:
        letter = "f" if slot.is_float else "s" if slot.sign else "u"
        formats.append(f"p{end - slot.start - slot.signal.length}{letter}{slot.signal.length}")
        end = slot.start
    return "".join([*formats, f"p{end}"]).replace("p0", "")


def _number(slot: _Slot, raw: str, known: dict[str, Any]) -> str:
    """An expression of the field's number of a finite raw one, as `_Slot.number` has it; `known`: of a name in it."""
    holds, scale = slot.field.holds, slot.signal.scale
    if slot.signal.offset or (holds is int and scale != 1):
        known[f"number_of_{raw}"] = slot.number
        return f"number_of_{raw}({raw})"
    if scale == 1:
        return raw if holds is int or slot.is_float else f"float({raw})"
    return f"{raw} * {scale!r}" if slot.per_unit is None else f"{raw} / {slot.per_unit!r}"


def _written(slot: _Slot, number: int, known: dict[str, Any]) -> str:
    """An expression of the field's bits, in their place, of its value `v<number>`; any of several exceptions where it
    is not plainly in order. `known` is given the names in it, and `low…` and `high…` where a range is to be checked.
    """
    start, mask, value, holds = slot.start, slot.mask, f"v{number}", slot.field.holds
    unscaled = slot.scale == 1 and not slot.offset
    bits: dict[int | None, int] | None = None
    if holds not in (int, float):
        members: Any = (0, 1) if holds is bool else holds
        bits = {m: int(m) << start for m in members if slot.low <= m <= slot.high}
        if slot.field.nullable:
            bits[None] = 0
    elif holds is int and unscaled and slot.signal.length <= 8:
        # A number between two whole ones is left to the careful way.
        bits = {raw: (raw & mask) << start for raw in range(math.ceil(slot.low), math.floor(slot.high) + 1)}
    if bits is not None:
        known[f"bits{number}"] = bits
        return f"bits{number}[{value}]"
    known[f"low{number}"], known[f"high{number}"] = slot.low - slot.margin, slot.high + slot.margin
    if slot.offset:
        known[f"steps{number}"] = slot.steps
        value = f"steps{number}({value})"
    elif not unscaled:
        value = f"{value} / {slot.scale!r}" if slot.per_unit is None else f"{value} * {slot.per_unit}"
    if slot.is_float:
        known["pack"], known["unpack"] = _FLOAT.pack, _RAW_FLOAT.unpack
        return f"(unpack(pack({value}))[0] << {start})"
    if holds is float or not unscaled:
        value = f"round({value})"
    return f"(({value} & {mask}) << {start})"


# ---------------------------------------------------------------- one field, the careful way


def _read(slot: _Slot, raw: Any) -> tuple[Any, str | None]:
    """The field's value, or Refuse, and what is wrong with it."""
    field = slot.field
    if field.holds is bool:
        return bool(raw), None
    if issubclass(field.holds, IntEnum):
        try:
            return field.holds(raw), None
        except ValueError:
            reported = (
                None if raw in field.unremarkable else f"{slot.signal.name} {raw} is not in the interface's table"
            )
            return field.unknown, reported
    if not math.isfinite(raw):
        return Refuse.FRAME, f"{slot.signal.name} is {raw}, not a finite number"
    return slot.number(raw), None


def _write(slot: _Slot, value: Any, message: str) -> int | float:
    """The raw value of a field. None is 0: the signal says nothing."""
    field = slot.field
    what = f"{message}: {slot.signal.name}"
    if value is None and field.nullable:
        return 0
    if field.holds is bool:
        if value not in (False, True):
            raise EncodeError(f"{what} is {value!r}, not a flag")
        return int(value)
    if issubclass(field.holds, IntEnum):
        try:
            member = field.holds(value)
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
    return slot.steps(number) if slot.is_float else round(slot.steps(number))
