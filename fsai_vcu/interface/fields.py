"""Declaration of a message: a class whose fields name the signals that fill them.

    class AiSteer(Message, frozen=True):
        dbc_name, required = "AI2VCU_Steer", True

        steer_deg: Annotated[float, Signal("STEER_REQUEST")] = 0.0
        t_rx_ns: int = 0

The annotation says what the field holds: bool a flag, int a whole number, float a number, an IntEnum one of its
members; with None where the signal may say nothing. Positions, widths, scales, ranges and units come from the signal
database that is loaded.
"""

from __future__ import annotations

from enum import Enum, IntEnum, auto
from functools import cache
from types import NoneType
from typing import Any, ClassVar, Final, cast, get_args, get_type_hints

from msgspec import structs

from fsai_vcu.interface.values import Value
from fsai_vcu.interface.wheels import STRAIGHT, WHEELS, WheelMapping

NOT_READ: Final = "these values are not read"


class Refuse(Enum):
    """Effect of an unknown value of a choice when no substitute may stand for it."""

    FRAME = auto()  # the whole frame is not believed


class Message(Value, frozen=True):
    """Base of the declared messages: their name in the databases, and whether a database of this car must have them."""

    dbc_name: ClassVar[str]
    required: ClassVar[bool] = False

    @property
    def t_rx_ns(self) -> int:
        """The monotonic time of the frame; a field of each message, the last."""
        raise NotImplementedError


class Signal(Value, frozen=True):
    """The signal that fills a field, and what its values mean; it stands in the field's `Annotated`.

    `signal`: its name; a wheel in braces in it is where that wheel is wired to. `absent`: a database may lack
    the signal, and this follows, after "not known: "; the field is then left out on encoding, and on decoding is None
    where it may be, else its default. `saturates`: a logging field, clamped to the signal's range instead of refused.
    For choices, `unknown` is what a raw value outside the enumeration becomes, and `unremarkable` are such values that
    need no report. `command`: the field of AiCommand with this meaning.
    """

    signal: str
    absent: str | None = None
    saturates: bool = False
    unknown: IntEnum | Refuse | None = Refuse.FRAME
    unremarkable: tuple[int, ...] = ()
    command: str | None = None


class Field(Signal, frozen=True, kw_only=True):
    """One field of a message class with its signal; `name` is "faults.bms" for a field of a group.

    `holds`: bool, int, float or an IntEnum. `nullable`: None is a value, its bits are 0.
    """

    name: str
    holds: type
    nullable: bool
    default: Any


@cache
def fields_of(declared: Any, wheels: WheelMapping = STRAIGHT) -> tuple[Field, ...]:
    """The signals of a message class, in the order of its fields and with those of its groups, as this car is wired."""
    wired = {wheel: wheels.source_of(wheel).upper() for wheel in WHEELS}
    hints = get_type_hints(declared, include_extras=True)
    found: list[Field] = []
    for one in structs.fields(declared):
        bare, *notes = get_args(hints[one.name]) if hasattr(hints[one.name], "__metadata__") else (hints[one.name],)
        kinds = get_args(bare) or (bare,)
        holds: Any = next(kind for kind in kinds if kind is not NoneType)
        if isinstance(holds, type) and issubclass(holds, Value):
            found += (
                structs.replace(inner, name=f"{one.name}.{inner.name}") for inner in fields_of(cast("Any", holds))
            )
        elif notes:
            declared_signal = {**structs.asdict(notes[0]), "signal": notes[0].signal.format_map(wired)}
            found.append(
                Field(**declared_signal, name=one.name, holds=holds, nullable=NoneType in kinds, default=one.default)
            )
    return tuple(found)


def by_message(state: type) -> dict[type, str]:
    """Name the field for each message class, in a class with a field for each of several messages."""
    return {
        kind: name for name, hint in get_type_hints(state).items() for kind in get_args(hint) if kind is not NoneType
    }
