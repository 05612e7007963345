"""Codec between frames and images, both ways.

The layout of every message comes from the loaded signal database and from nowhere else. A payload becomes raw numbers
(`_by_position`), and each of them the value of a field (`Slot`); encoding goes the same way back. Most frames of a bus
repeat one before: each message remembers what it has read and written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from msgspec import NODEFAULT, structs

try:
    import bitstruct.c as bitstruct
except ImportError:  # a machine for which it is not compiled
    import bitstruct

from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.database import DatabaseError, dbc_dir, find_named, load_database
from fsai_vcu.interface.fields import Refuse, fields_of
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import COMMAND_FIELDS, MESSAGES, AiCommand, Image, VcuStatus
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.slots import EncodeError as EncodeError
from fsai_vcu.interface.slots import Odd, Slot
from fsai_vcu.interface.values import Value
from fsai_vcu.interface.wheels import STRAIGHT, WheelMapping

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

_REMEMBERED: Final = 64  # payloads, and rows of values, of each message


class Decoded(Value, frozen=True):
    """Content that a frame reports. `image` is None where it reports nothing that may be believed.

    `problems` are sentences for people. `handshake` is the bit of a 0x520, set even where its image was not believed.
    """

    image: Image | None
    problems: tuple[str, ...] = ()
    handshake: bool | None = None


_NOTHING: Final = Decoded(None)


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
        """Load the databases and lay out every message. Raises DatabaseError."""
        paths = [dbc_dir() / name for name in revision.dbc_files] if dbc_paths is None else list(dbc_paths)
        files = ", ".join(map(str, paths))
        self.revision = revision
        self.mapping = mapping
        self.database: Database = load_database(paths)
        self._layouts: dict[type, _Layout] = {}
        self._lacking: list[_Lack] = []
        for kind in MESSAGES:
            message = find_named(self.database.messages, kind.dbc_name)
            if message is None:
                if kind.required:
                    raise DatabaseError(f"{files}: no message {kind.dbc_name}, so this is not the car's database")
                self._lacking.append((kind.dbc_name, "these messages are not read"))
                continue
            expected = BY_NAME[kind.dbc_name].can_id
            if message.frame_id != expected or message.is_extended_frame:  # safety rule 8
                raise DatabaseError(
                    f"{files}: {message.name} has identifier 0x{message.frame_id:03X}, not 0x{expected:03X}"
                )
            try:
                self._layouts[kind] = layout = _Layout(kind, message, mapping, files)
            except (ArithmeticError, NotImplementedError) as error:  # a scale of 0, a signal of more than 64 bits
                raise DatabaseError(f"{files}: {message.name} cannot be read: {error}") from error
            self._lacking += layout.lacking
        self._by_id = {layout.can_id: layout for layout in self._layouts.values()}
        commanding = {self._layouts[kind]: names for kind, names in COMMAND_FIELDS.items()}
        self._command = [(one, _getter([names[ours] for ours in one.names])) for one, names in commanding.items()]
        self.unknown = "" if dbc_paths is None else _lacking_line(files, self._lacking, codec_of(revision)._lacking)

    def __deepcopy__(self, memo: dict[int, Any]) -> Codec:
        """Return the codec itself: what it says of a frame never changes, and copies of a simulation share it."""
        return self

    def knows(self, can_id: int) -> bool:
        """Return true where `decode` makes an image of this identifier."""
        return can_id in self._by_id

    def encode(self, image: Image) -> Frame:
        """The frame that carries `image`, stamped with the image's own time.

        Values are rounded to the nearest raw step. Raises EncodeError for a value out of range, not finite or unknown,
        and for a message that this revision lacks; logging fields saturate. Fields that the loaded database lacks, and
        fields whose value is None, leave their bits at 0.
        """
        layout = self._layouts.get(type(image))
        if layout is None:
            raise EncodeError(f"{type(image).__name__} is not a message of the loaded database")
        return layout.frame(layout.values_of(image), image.t_rx_ns)

    def encode_command(self, command: AiCommand, t_ns: int = 0) -> tuple[Frame, Frame, Frame, Frame, Frame]:
        """0x510 to 0x514 in that order, stamped `t_ns`. Raises EncodeError as `encode` does: all five or none."""
        frames = [layout.frame(values_of(command), t_ns) for layout, values_of in self._command]
        return cast("tuple[Frame, Frame, Frame, Frame, Frame]", tuple(frames))

    def mask(self, message: type[Image], *names: str) -> int:
        """Return where these fields' signals are in a payload, as a little-endian number; 0 where there are none."""
        slots = self._layouts[message].slots if message in self._layouts else []
        return sum(slot.ones << slot.signal.start for slot in slots if slot.field.name in names)

    def decode(self, frame: Frame) -> Decoded:
        """Return what `frame` says. Never raises: what cannot be believed is in `problems`."""
        if frame.error:
            return _NOTHING
        if frame.remote or frame.extended:
            kind = "remote" if frame.remote else "extended"
            return Decoded(None, (f"{kind} frame 0x{frame.can_id:03X}: the car's bus has no such frame",))
        layout = self._by_id.get(frame.can_id)
        if layout is None:
            return _NOTHING
        values, problems, handshake = layout.values(frame.data)
        return Decoded(None if values is None else layout.kind(*values, frame.t_ns), problems, handshake)


@cache
def codec_of(revision: Revision) -> Codec:
    """The codec of a revision's own files, made once: it never changes."""
    return Codec(revision)


# ---------------------------------------------------------------- one message

_Lack = tuple[str, str]  # the name of a signal or message that a database has not, and what follows
_Said = tuple[list[Any] | None, tuple[str, ...], bool | None]  # values of the class's fields; as in Decoded


def _lacking_line(files: str, lacking: Sequence[_Lack], by_nature: Sequence[_Lack]) -> str:
    names: dict[str, list[str]] = {}
    for name, consequence in lacking:
        if (name, consequence) not in by_nature:
            names.setdefault(consequence, []).append(name)
    listed = "; ".join(f"{consequence} ({', '.join(these)})" for consequence, these in names.items())
    return listed and f"{files}: lacks signals of the car's interface: {listed}"


def _getter(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    if len(names) == 1:  # of one name attrgetter makes no tuple
        return lambda source: (getattr(source, names[0]),)
    return attrgetter(*names)


class _Layout:
    """One message of the loaded database with the class that it fills."""

    def __init__(self, kind: type[Image], message: Message, wheels: WheelMapping, files: str) -> None:
        """Lay out one message of the database for its class; `lacking` has the signals that are not there."""
        self.kind: Any = kind
        self.message = message.name
        self.can_id = message.frame_id
        self.length = message.length
        self.lacking: list[_Lack] = []
        self._defaults: list[Any] = []
        slots: list[Slot] = []
        for field in fields_of(cast("Any", kind), wheels):
            signal = find_named(message.signals, field.signal)
            if signal is not None:
                slots.append(Slot(field, signal, message.name, len(self._defaults)))
            elif field.absent is not None:
                self.lacking.append((field.signal, field.absent))
            else:
                raise DatabaseError(f"{files}: {message.name} has no signal {field.signal}")
            self._defaults.append(None if signal is None and field.nullable else field.default)
        self.slots = sorted(slots, key=lambda slot: -slot.signal.start)
        self.names = [slot.field.name for slot in self.slots]
        self.values_of = _getter(self.names)
        declared = enumerate(structs.fields(kind))
        self._groups: list[Any] = [
            (at, one.default_factory) for at, one in declared if one.default_factory is not NODEFAULT
        ]
        self._unpack, self._pack = _by_position(message, [slot.signal for slot in self.slots])
        readers = (slot.read_if_said if message.is_multiplexed() else slot.read for slot in self.slots)
        self._readers = list(readers)
        self._places = [slot.place for slot in self.slots]
        self._writers = [slot.write for slot in self.slots]
        self._has_float = any(slot.signal.is_float for slot in self.slots)
        self._read: dict[bytes, _Said] = {}
        self._written: dict[tuple[Any, ...], bytes] = {}

    def values(self, data: bytes) -> _Said:
        """Return what a payload says."""
        said = self._read.get(data)
        if said is not None:
            return said
        if len(data) != self.length:
            return None, (f"0x{self.can_id:03X}: {len(data)} bytes where {self.length} belong",), None
        try:
            raws = self._unpack(data[::-1])
        except Exception as error:  # decode never raises, whatever a strange database makes cantools do
            return None, (f"{self.message}: cannot be decoded: {error}",), None
        values, problems, refused = self._defaults.copy(), list[str](), False
        for place, read, raw in zip(self._places, self._readers, raws, strict=True):
            try:
                values[place] = read(raw)
            except Odd as odd:
                values[place] = odd.value
                refused = refused or odd.value is Refuse.FRAME
                problems += [odd.problem] if odd.problem else []
        handshake = values[0] if self.kind is VcuStatus else None
        for place, group in self._groups:
            end = place + len(group.__struct_fields__)
            values[place:end] = [group(*values[place:end])]
        said = None if refused else values, tuple(problems), handshake
        _remember(self._read, data, said)
        return said

    def frame(self, values: tuple[Any, ...], t_ns: int) -> Frame:
        """The frame with these values, in the order of `names`. Raises EncodeError."""
        try:
            data = self._written.get(values)
            if data is None:
                data = self._pack(*[write(value) for write, value in zip(self._writers, values, strict=True)])[::-1]
                if not self._has_float:  # equal values have equal bits, but for the two zeros of a float
                    _remember(self._written, values, data)
        except EncodeError:
            raise
        except Exception as error:
            raise EncodeError(f"{self.message}: cannot be encoded: {error}") from error
        return Frame(self.can_id, data, t_ns)


def _remember(known: dict[Any, Any], key: Any, found: Any) -> None:
    if len(known) >= _REMEMBERED:
        known.clear()
    known[key] = found


def _by_position(message: Message, signals: Sequence[Signal]) -> tuple[Callable[..., Any], Callable[..., bytes]]:
    """Return functions from a payload to the raw numbers of these signals, the last in the frame first, and back.

    Other bits are 0. Payloads are read and made from their end, so that little-endian signals are whole. Messages that
    this cannot do are left to cantools: big-endian ones, and multiplexed ones, where a signal that a frame does not
    carry is None.
    """
    if message.is_multiplexed() or any(signal.byte_order != "little_endian" for signal in signals):
        names, others = [signal.name for signal in signals], {signal.name: 0 for signal in message.signals}

        def unpack(data: bytes) -> list[Any]:
            raws: Any = message.decode(data[::-1], decode_choices=False, scaling=False, allow_truncated=False)
            return [raws.get(name) for name in names]

        def pack(*raws: float) -> bytes:
            named: Any = {**others, **dict(zip(names, raws, strict=True))}
            return message.encode(named, scaling=False, padding=False, strict=False)[::-1]

        return unpack, pack
    layout, end = "", 8 * message.length
    for signal in signals:
        letter = "f" if signal.is_float else "s" if signal.is_signed else "u"
        layout += f"p{end - signal.start - signal.length}{letter}{signal.length}"
        end = signal.start
    compiled = bitstruct.compile(f"{layout}p{end}".replace("p0", ""))
    return compiled.unpack, compiled.pack
