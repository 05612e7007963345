"""How a message is declared: a class whose fields name the signals that fill them.

    @dataclass(frozen=True, slots=True)
    class AiSteer(Message, name="AI2VCU_Steer", required=True):
        steer_deg: float = signal("STEER_REQUEST", 0.0)
        t_rx_ns: int = 0

The annotation says what the field holds: bool a flag, int a whole number, float a number, an IntEnum one of its
members; with None where the signal may say nothing. Positions, widths, scales, ranges and units come from the signal
database that is loaded.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from functools import cache
from types import NoneType
from typing import Any, ClassVar, Final, TypeVar, cast, get_args, get_type_hints

from fsai_vcu.interface.immutable import Immutable
from fsai_vcu.interface.wheels import STRAIGHT, WHEELS, WheelMapping

NOT_READ: Final = "these values are not read"

T = TypeVar("T")


class Refuse(Enum):
    """What an unknown value of a choice does when no substitute may stand for it."""

    FRAME = auto()  # the whole frame is not believed


class Message(Immutable):
    """Base of the declared messages: their name in the databases, and whether a database of this car must have them."""

    __slots__ = ()
    dbc_name: ClassVar[str]
    required: ClassVar[bool]
    __dataclass_fields__: ClassVar[dict[str, Any]]  # each declared message is a dataclass

    @property
    def t_rx_ns(self) -> int:
        """The monotonic time of the frame; a field of each message, the last."""
        raise NotImplementedError

    def __init_subclass__(cls, name: str = "", required: bool = False) -> None:
        super().__init_subclass__()
        if name:  # dataclass makes the class a second time, from what it has by then
            cls.dbc_name, cls.required = name, required


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message class and its signal; `name` is "faults.bms" for a field of a group.

    `holds`: bool, int, float or an IntEnum. `nullable`: None is a value, its bits are 0. `absent`: a database may lack
    the signal, and this follows, after "not known: "; the field is then left out on encoding, and on decoding is None
    where it may be, else its default. `saturates`: a logging field, clamped to the signal's range instead of refused.
    For choices, `unknown` is what a raw value outside the enumeration becomes, and `unremarkable` are such values that
    need no report. `command`: the field of AiCommand with this meaning.
    """

    name: str
    holds: type
    nullable: bool
    default: Any
    signal: str
    absent: str | None
    saturates: bool
    unknown: IntEnum | Refuse | None
    unremarkable: tuple[int, ...]
    command: str | None


def signal(
    name: str,
    default: T,
    *,
    absent: str | None = None,
    saturates: bool = False,
    unknown: IntEnum | Refuse | None = Refuse.FRAME,
    unremarkable: tuple[int, ...] = (),
    command: str | None = None,
) -> T:
    """A field filled by the signal `name`; a wheel in braces in it is where that wheel is wired to. See `Field`."""
    declared = {
        "signal": name,
        "absent": absent,
        "saturates": saturates,
        "unknown": unknown,
        "unremarkable": unremarkable,
        "command": command,
    }
    found: Any = dataclasses.field(default=default, metadata=declared)
    return found  # type: ignore[no-any-return]


@cache
def fields_of(declared: Any, wheels: WheelMapping = STRAIGHT) -> tuple[Field, ...]:
    """The signals of a message class, in the order of its fields and with those of its groups, as this car is wired."""
    wired = {wheel: wheels.source_of(wheel).upper() for wheel in WHEELS}
    hints = get_type_hints(declared)
    found: list[Field] = []
    for one in dataclasses.fields(declared):
        kinds = get_args(hints[one.name]) or (hints[one.name],)
        holds: Any = next(kind for kind in kinds if kind is not NoneType)
        if dataclasses.is_dataclass(holds):
            found += (
                dataclasses.replace(inner, name=f"{one.name}.{inner.name}") for inner in fields_of(cast("Any", holds))
            )
        elif one.metadata:
            name = one.metadata["signal"].format_map(wired)
            found.append(Field(one.name, holds, NoneType in kinds, one.default, **{**one.metadata, "signal": name}))
    return tuple(found)


def by_message(state: type) -> dict[type, str]:
    """For a class with a field for each of several messages: the name of each message class's field."""
    return {
        kind: name for name, hint in get_type_hints(state).items() for kind in get_args(hint) if kind is not NoneType
    }
