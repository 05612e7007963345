"""One frame for the bench, from the words of a person: which message, which signals, and whether it may be sent.

Refused are, whatever the database calls them: identifiers that are reserved for the car, those of the VCU and of the
car's other devices, and the AI computer's own (safety rule 8: those are the bridge's) unless that is asked for.
Signals that are not named get the database's initial value, or 0 where it has none; where 0 is out of their range they
have to be named.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.decode.layouts import MessageLayout
from fsai_vcu.diagnostics.log.frames import CLASSIC_BYTES
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.errors import UserError, WrongUse, did_you_mean
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, OPTIONAL_AI_ID, RESERVED_IDS
from fsai_vcu.interface.slots import unit_of

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

_VCU: Final = "VCU"  # the node's name in the interface's databases
_FLOAT32_MAX: Final = 3.4028234663852886e38
_ROUNDING: Final = 1e-9  # physical values are products of a raw integer and a decimal scale
_NUMBER = re.compile(r"[+-]?0[xX][0-9A-Fa-f]+")
_FORM: Final = "send takes BUS MESSAGE SIGNAL=VALUE, and fsai-vcu dbc show lists messages with their signals"


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A frame and what it says. `values`: every signal, rounded to what the wire carries; `filled`: not named."""

    message: str
    frame: Frame
    values: Mapping[str, float | str]
    filled: tuple[str, ...]
    period_ms: int | None

    @property
    def cansend(self) -> str:
        """The frame as can-utils' cansend takes it."""
        number = f"{self.frame.can_id:08X}" if self.frame.extended else f"{self.frame.can_id:03X}"
        return f"{number}#{self.frame.data.hex().upper()}"

    @property
    def is_of_the_ai(self) -> bool:
        return not self.frame.extended and self.frame.can_id in (*AI_IDS, OPTIONAL_AI_ID)


def outgoing(databases: Databases, message: str, assignments: Sequence[str], *, as_ai: bool = False) -> Outgoing:
    """The frame of `message` (its name, or its identifier as in 0x514) with `SIGNAL=VALUE` each.

    as_ai: the AI computer's own identifiers may be sent too. Raises UserError.
    """
    layout = find_message(databases, message)
    check_permission(layout, as_ai=as_ai)
    if layout.length > CLASSIC_BYTES:
        raise UserError(f"{layout.name} has {layout.length} bytes, and a classic CAN frame at most {CLASSIC_BYTES}")
    described = databases.message(layout.key)
    given = _assigned(described, assignments)
    raws, filled = _raw_values(described, given)
    try:
        data = bytes(described.encode(raws, scaling=False, padding=False, strict=False))
    except Exception as error:  # cantools lets several unrelated kinds of errors through
        words = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{layout.name} cannot be encoded: {words}") from error
    by_name = {signal.name: signal for signal in described.signals}
    values = {name: _shown(by_name[name], raw) for name, raw in raws.items()}
    frame = Frame(layout.can_id, data, extended=layout.extended)
    return Outgoing(layout.name, frame, values, tuple(filled), layout.period_ms)


def find_message(databases: Databases, words: str) -> MessageLayout:
    """The message by its name (in any case) or its identifier. Raises UserError."""
    exact = databases.by_name(words)
    if exact is not None:
        return exact
    layouts = list(databases.layouts.values())
    name, raw, _ = words.partition("#")
    name = f"0x{name}" if raw else name  # as cansend writes it
    number = int(name, 16) if _NUMBER.fullmatch(name) else None
    matching = [each for each in layouts if each.can_id == number or each.name.casefold() == name.casefold()]
    if raw:
        named = (f"{each.name} {' '.join(f'{signal.name}=…' for signal in each.signals)}".strip() for each in matching)
        raise WrongUse(f"'{words}' is a raw frame, for cansend; send takes: {next(named, _FORM)}")
    if not matching and number is not None:
        raise UserError(f"no message has the identifier {words}; {_FORM}")
    if not matching:
        raise UserError(f"no message '{words}'{did_you_mean(words, (one.name for one in layouts)) or f'; {_FORM}'}")
    if len(matching) > 1:
        raise UserError(f"'{words}' may be {' or '.join(layout.name for layout in matching)}")
    return matching[0]


def check_permission(layout: MessageLayout, *, as_ai: bool) -> None:
    """Raise UserError for a message that this software must not send."""
    name = f"{layout.name} (0x{layout.can_id:03X})"
    # A filter for a number may not look at the width of the identifier: reserved is reserved in both.
    if layout.can_id in RESERVED_IDS:
        raise UserError(f"{name} is reserved for the car: it must never be sent from here")
    own = None if layout.extended else BY_ID.get(layout.can_id)
    if layout.can_id in (*AI_IDS, OPTIONAL_AI_ID):
        if not as_ai:
            raise UserError(f"only the AI computer's bridge may send {name}; --as-ai sends it all the same")
        return
    if own is not None:
        remedy = "; fsai-vcu vcu simulates a whole VCU" if own.owner == _VCU else ""
        raise UserError(f"{name} is the {own.owner}'s: it must never be sent from here{remedy}")
    if any(sender.upper() == _VCU for sender in layout.senders):
        raise UserError(f"{name} is the VCU's, as its database says: it must never be sent from here")


# ---------------------------------------------------------------- values


def _assigned(message: Message, assignments: Sequence[str]) -> dict[str, str]:
    """Signal name -> the words for its value."""
    names = [signal.name for signal in message.signals]
    found: dict[str, str] = {}
    for assignment in assignments:
        name, equals, words = assignment.partition("=")
        if not equals or not words.strip():
            raise UserError(f"'{assignment}' is not SIGNAL=VALUE")
        if name not in names:
            alike = [each for each in names if each.casefold() == name.casefold()]
            if len(alike) != 1:
                raise UserError(f"{message.name} has no signal '{name}'{did_you_mean(name, names)}")
            name = alike[0]
        if name in found:
            raise UserError(f"{name} is given twice")
        found[name] = words.strip()
    return found


def _raw_values(message: Message, given: Mapping[str, str]) -> tuple[dict[str, Any], list[str]]:
    """(raw value of every signal in the frame, names of those that were not given)."""
    raws: dict[str, Any] = {}
    filled: list[str] = []
    waiting = list(message.signals)
    while ready := [signal for signal in waiting if _is_in_frame(signal, raws)]:
        for signal in ready:
            if signal.name in given:
                raws[signal.name] = _raw_of(signal, given[signal.name])
            else:
                raws[signal.name] = _initial(signal)
                filled.append(signal.name)
            waiting.remove(signal)
    for selector in (signal.name for signal in message.signals if signal.is_multiplexer and signal.name in raws):
        branches = [signal for signal in message.signals if signal.multiplexer_signal == selector]
        values = sorted({number for signal in branches for number in signal.multiplexer_ids or ()})
        if raws[selector] not in values:
            raise UserError(f"{selector} {raws[selector]} selects nothing: it may be {', '.join(map(str, values))}")
    absent = [name for name in given if name not in raws]
    if absent:
        raise UserError(f"{absent[0]} is not in the part of {message.name} that its multiplexer selects")
    return raws, filled


def _is_in_frame(signal: Signal, raws: Mapping[str, Any]) -> bool:
    """Return true where the selectors chosen so far put the signal into the frame."""
    selector = signal.multiplexer_signal
    return selector is None or (selector in raws and raws[selector] in (signal.multiplexer_ids or ()))


def _initial(signal: Signal) -> int | float:
    if signal.raw_initial is not None:
        return float(signal.raw_initial) if signal.is_float else int(signal.raw_initial)
    low, high = _limits(signal)
    if low <= _physical(signal, 0) <= high:
        return 0.0 if signal.is_float else 0
    raise UserError(f"{signal.name} must be given: it has no initial value, and 0 is not in {low:g} … {high:g}")


def _raw_of(signal: Signal, words: str) -> int | float:
    """The wire's value for a number or for a word of the signal's table."""
    choices = {int(raw): str(name) for raw, name in (signal.choices or {}).items()}
    value = _number(words)
    if value is None:
        named = [raw for raw, name in choices.items() if _folded(name) == _folded(words)]
        if len(named) == 1:
            return _in_field(signal, named[0], f"{signal.name} {words}")
        if choices:
            raise UserError(f"{signal.name} has no value '{words}': it may be {', '.join(choices.values())}")
        raise UserError(f"{signal.name}: '{words}' is not a number")
    if not math.isfinite(value):
        raise UserError(f"{signal.name} is {words}, not a finite number")
    low, high = _limits(signal)
    margin = _ROUNDING * max(1.0, abs(low), abs(high)) if math.isfinite(low + high) else 0.0
    if not low - margin <= value <= high + margin:
        raise UserError(f"{signal.name} {value:g} is out of range {low:g} … {high:g} {unit_of(signal)}".rstrip())
    if signal.is_float:
        return float((value - signal.offset) / signal.scale)
    raw = round((value - signal.offset) / signal.scale)
    if choices and signal.length == 1 and raw not in choices:
        raise UserError(f"{signal.name} has no value {raw}")
    return _in_field(signal, raw, f"{signal.name} {value:g}")


def _in_field(signal: Signal, raw: int, what: str) -> int:
    least, most = _raw_limits(signal)
    if not least <= raw <= most:
        raise UserError(f"{what} does not fit into the {signal.length} bits of its field")
    return raw


def _raw_limits(signal: Signal) -> tuple[int, int]:
    if signal.is_signed:
        return -(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1
    return 0, (1 << signal.length) - 1


def _limits(signal: Signal) -> tuple[float, float]:
    """Return the least and the most that the database allows, and no more than the field can carry."""
    if signal.is_float:
        most = _FLOAT32_MAX if signal.length == 32 else math.inf
        carried = (-most, most)
    else:
        ends = [_physical(signal, raw) for raw in _raw_limits(signal)]
        carried = (min(ends), max(ends))
    low = carried[0] if signal.minimum is None else max(carried[0], float(signal.minimum))
    high = carried[1] if signal.maximum is None else min(carried[1], float(signal.maximum))
    return low, high


def _physical(signal: Signal, raw: int) -> float:
    return float(raw * signal.scale + signal.offset)


def _number(words: str) -> float | None:
    if _NUMBER.fullmatch(words):
        return float(int(words, 16))
    try:
        return float(words)
    except ValueError:
        return None


def _shown(signal: Signal, raw: float) -> float | str:
    """Return what the wire carries, in the database's words where it has one."""
    scaled = signal.conversion.raw_to_scaled(raw, True)
    if isinstance(scaled, int | float):
        return round(scaled, 9) if isinstance(scaled, float) else scaled
    return str(scaled)


def _folded(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).casefold()
