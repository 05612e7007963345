"""Signal databases as the diagnostics use them: several at once, the project's own or any that cantools can read.

Of each message there is a `MessageLayout`: plain data, enough to take a plain message apart. Messages that are not
plain (multiplexed, longer than eight bytes, …) are decoded by cantools.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout, SignalLayout
from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.database_text import loaded_without_orphans, read_database_text
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.revisions import dbc_dir
from fsai_vcu.interface.revisions import revision as revision_named
from fsai_vcu.interface.slots import unit_of
from fsai_vcu.printable import printable
from fsai_vcu.runtime.bounded import results_of

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

_KINDS = ("arxml", "cdd", "dbc", "kcd", "sym")
_PACKED = ("\x1f\x8b", "\x1f\u2039", "PK\x03\x04", "\xfd7zXZ", "BZh")  # as text of Latin-1, or of Windows
_MAX_PLAIN_BYTES = 8
_INT64 = 1 << 63
_NAMED = 5
_LONGEST_PERIOD_MS = 86_400_000  # a day


class UndecodableError(ValueError):
    """The bits of a frame mean nothing in its message; the message says why."""


class Databases:
    """Messages by key (identifier, plus EXTENDED_KEY), from one or more files; of two for one key the first counts."""

    def __init__(
        self, layouts: Mapping[int, MessageLayout], messages: Mapping[int, Message], baudrate: int | None = None
    ) -> None:
        """`messages` are cantools' own."""
        self.layouts = layouts
        self.baudrate = baudrate
        self.signed_flags: tuple[str, ...] = ()  # official files with one-bit flags that are signed, and read unsigned
        self.left_out: tuple[str, ...] = ()  # by file, entries that belong to nothing
        self._messages = messages

    def message(self, key: int) -> Message:
        """cantools' own message."""
        return self._messages[key]

    def decoded(
        self, layout: MessageLayout, data: bytes, *, scaling: bool = True, choices: bool = False
    ) -> dict[str, Any]:
        """Decode one frame through cantools: all signals that lie in its data. `choices`: words, not numbers.

        Raises UndecodableError.
        """
        message = self.message(layout.key)
        try:
            return dict(message.decode_simple(data, choices, scaling, allow_truncated=True, allow_excess=True))
        except Exception as error:  # cantools lets several unrelated kinds of errors through
            raise UndecodableError(" ".join(str(error).split()) or type(error).__name__) from error

    def with_signals(self, names: Sequence[str]) -> Databases:
        """The messages that have signals of these names (with * and ?), with no others in them."""
        chosen = {}
        for key, layout in self.layouts.items():
            if signals := layout.signals_like(names):  # of a message that cantools decodes all signals are shown
                chosen[key] = layout._replace(signals=signals) if layout.plain else layout
        return Databases(chosen, self._messages, self.baudrate)

    def by_name(self, name: str) -> MessageLayout | None:
        return next((layout for layout in self.layouts.values() if layout.name == name), None)


def load_databases(files: Sequence[Path | str] = (), revision: str = "2026") -> Databases:
    """The given files, or where there are none the project's own of an interface revision. Raises UserError."""
    if files:
        return _loaded([Path(file) for file in files])
    try:
        names = revision_named(revision).dbc_files
    except ValueError as error:
        raise UserError(str(error)) from error
    return _own(dbc_dir(), names)


@cache  # a verb that learns the revision from the frames asks for the same ones two or three times
def _own(folder: Path, names: tuple[str, ...]) -> Databases:
    return _loaded([folder / name for name in names])


def _loaded(paths: Sequence[Path]) -> Databases:
    loaded = [_load(path) for path in paths]
    databases = databases_of(database for database, _, _ in loaded)
    databases.signed_flags = tuple(str(path) for path, (_, signed, _) in zip(paths, loaded, strict=True) if signed)
    databases.left_out = tuple(f"{path}: {words}" for path, (_, _, words) in zip(paths, loaded, strict=True) if words)
    return databases


def _not_shown(database: Database) -> str:
    """Sentence on messages and signals of one file that others hide, and on signals that no frame can have, or ''."""
    found: dict[str, list[str]] = {}
    seen: set[tuple[int, bool]] = set()
    for message in database.messages:
        key = (message.frame_id, message.is_extended_frame)
        if key in seen:
            found.setdefault("left out, as the identifier has a message already", []).append(message.name)
        seen.add(key)
        names = Counter(signal.name for signal in message.signals)
        twice = [f"{message.name}.{name}" for name, count in names.items() if count > 1]
        if twice and not message.is_multiplexed():
            found.setdefault("only one signal is shown of several with the same name", []).extend(twice)
        beyond = [signal.name for signal in message.signals if _is_beyond(signal, message.length)]
        if beyond and message.length:
            words = "messages that cannot be decoded, as signals lie beyond their bytes"
            found.setdefault(words, []).append(f"{message.name} ({', '.join(beyond[:_NAMED])})")
    lists = ((words, [printable(name[:80]) for name in names]) for words, names in found.items())
    return "; ".join(
        f"{words}: {', '.join(names[:_NAMED])}{f' and {len(names) - _NAMED} more' if names[_NAMED:] else ''}"
        for words, names in lists
    )


def _is_beyond(signal: Signal, length: int) -> bool:
    if signal.byte_order != "big_endian":
        return bool(signal.start + signal.length > 8 * length)
    return bool(8 * (signal.start // 8) + 7 - signal.start % 8 + signal.length > 8 * length)


def databases_of(databases: Iterable[Database]) -> Databases:
    """Layouts of databases that cantools has loaded."""
    messages: dict[int, Message] = {}
    baudrate: int | None = None
    for database in databases:
        _make_printable(database)
        for message in database.messages:
            messages.setdefault(message.frame_id | (EXTENDED_KEY if message.is_extended_frame else 0), message)
        attribute = database.dbc.attributes.get("Baudrate") if database.dbc is not None else None
        if baudrate is None and attribute is not None and isinstance(attribute.value, int) and attribute.value > 0:
            baudrate = attribute.value
    return Databases({key: _layout(message) for key, message in messages.items()}, messages, baudrate)


def _make_printable(database: Database) -> None:
    """Names, units and words that are shown somewhere become texts of characters that can be seen."""
    from cantools.database.namedsignalvalue import NamedSignalValue

    changed = False
    for message in database.messages:
        texts = [message.name, *message.senders]
        for signal in message.signals:
            words = {raw: str(word) for raw, word in (signal.choices or {}).items()}
            texts += [signal.name, signal.unit or "", *words.values()]
        if all(text.isprintable() for text in texts):
            continue
        changed = True
        message.name = printable(message.name)
        message._senders = [printable(sender) for sender in message.senders]
        for signal in message.signals:
            signal.name = printable(signal.name)
            signal.unit = None if signal.unit is None else printable(signal.unit)
            if signal.choices:
                named = (
                    (raw, NamedSignalValue(int(raw), printable(str(word)))) for raw, word in signal.choices.items()
                )
                signal.choices = OrderedDict(named)
    if changed:
        database.refresh()


def _load(path: Path) -> tuple[Database, bool, str]:
    """A file's database; of this car's interface with signed one-bit flags made unsigned, and whether there were any.

    Also a sentence on entries that were left out or are not shown, or ''.

    Raises DatabaseError.
    """
    from fsai_vcu.interface.database import (
        DatabaseError,
        check_bounds,
        check_lengths,
        check_whole,
        is_modest,
        make_flags_unsigned,
    )

    import cantools.database  # isort: skip  after lean_cantools, which sees to it that cantools loads no more than it needs
    from cantools.database.can import Database  # isort: skip

    try:
        endings = [ending.lower().removeprefix(".") for ending in reversed(path.suffixes)]
        kind = next((ending for ending in endings if ending in _KINDS), path.suffix.lower().removeprefix("."))
        text, left_out = read_database_text(path, kind), ""
        if text.startswith(_PACKED):
            raise DatabaseError(f"{path}: packed: unpack it first")
        if kind not in _KINDS or kind == "dbc":
            check_lengths(path, text)
        if kind == "dbc" and is_modest(text):
            # Without the cache that an environment variable can name: what it holds is unpickled.
            loaded, left_out = loaded_without_orphans(
                lambda text: cantools.database.load_string(text, "dbc", strict=False), text
            )
        else:
            ((loaded, left_out),) = results_of(
                "fsai_vcu.diagnostics.decode.foreign", str(path), kind if kind in _KINDS else ""
            )
    except OSError as error:
        raise DatabaseError(f"{path}: cannot be read: {error.strerror or error}") from error
    except DatabaseError:
        raise
    except Exception as error:  # the parsers have no common base class for what a broken file makes them raise
        words = " ".join(str(error)[:2000].split()) or type(error).__name__
        raise DatabaseError(f"{path}: not a database that cantools can read: {words[:200]}") from error
    if not isinstance(loaded, Database):
        raise DatabaseError(f"{path}: describes diagnostics, not messages")
    if not loaded.messages:
        raise DatabaseError(f"{path}: describes no message")
    check_bounds(path, loaded)
    if kind != "dbc":
        return loaded, False, "; ".join(filter(None, (left_out, _not_shown(loaded))))
    check_whole(path, text, by_nodes=True)
    signed = ("AI2VCU_" in text or "VCU2AI_" in text) and any(
        signal.length == 1 and signal.is_signed for message in loaded.messages for signal in message.signals
    )
    if signed:
        make_flags_unsigned(loaded)
    return loaded, signed, "; ".join(filter(None, (left_out, _not_shown(loaded))))


def _layout(message: Message) -> MessageLayout:
    """Return the layout of cantools' message, and whether it is plain."""
    signals = tuple(_signal_layout(signal) for signal in message.signals)
    plain = (
        message.length <= _MAX_PLAIN_BYTES
        and not message.is_fd
        and not message.is_container
        and not message.is_multiplexed()
        and len({signal.name for signal in signals}) == len(signals)
        and all(_is_plain(signal, message.length) for signal in message.signals)
    )
    own = BY_NAME.get(message.name)
    period_ms = message.cycle_time or None
    if not isinstance(period_ms, int | float) or not 0 < period_ms <= _LONGEST_PERIOD_MS:
        period_ms = None  # the attribute may be anything
    if period_ms is None and own is not None and own.can_id == message.frame_id and len(own.period_ns) == 1:
        period_ms = next(iter(own.period_ns.values())) // 1_000_000
    return MessageLayout(
        message.name,
        message.frame_id,
        message.is_extended_frame,
        message.length,
        period_ms,
        tuple(message.senders),
        signals,
        plain,
        _one_line(message.comment),
    )


def _signal_layout(signal: Signal) -> SignalLayout:
    """Return what the decoder needs of a signal: its bits, scale, unit, choices, limits and comment."""
    return SignalLayout(
        signal.name,
        _lowest_bit(signal),
        signal.length,
        signal.byte_order == "big_endian",
        signal.is_signed,
        signal.is_float,
        signal.scale,
        signal.offset,
        unit_of(signal),
        {int(raw): str(name) for raw, name in (signal.choices or {}).items()},
        None if signal.minimum is None else float(signal.minimum),
        None if signal.maximum is None else float(signal.maximum),
        _one_line(signal.comment),
    )


def _one_line(comment: str | None) -> str:
    return " ".join((comment or "").split())


def _lowest_bit(signal: Signal) -> int:
    """Return the lowest bit as in SignalLayout; of a big-endian signal cantools names the highest, by its place."""
    if signal.byte_order != "big_endian":
        return signal.start
    return 8 * (_MAX_PLAIN_BYTES - 1 - signal.start // 8) + signal.start % 8 - signal.length + 1


def _is_plain(signal: Signal, length: int) -> bool:
    """Return true where the signal can be taken out of a message of `length` bytes by shifting and masking."""
    lowest = _lowest_bit(signal)
    first = 8 * (_MAX_PLAIN_BYTES - length) if signal.byte_order == "big_endian" else 0
    if not 0 < signal.length <= 64 or lowest < first or lowest + signal.length > first + 8 * length:
        return False
    if signal.unit is not None and "\0" in signal.unit:
        return False
    if signal.is_float:
        return signal.length in (32, 64) and not signal.choices
    scale, offset = signal.scale, signal.offset
    if scale == 1 and offset == 0:
        return True
    # True where 64-bit integers can reckon what Python's unbounded ones do for cantools.
    if signal.length == 64 and not signal.is_signed:
        return False
    most = 1 << (signal.length - 1 if signal.is_signed else signal.length)
    return most * abs(scale) + abs(offset) < _INT64
