"""Values that never change once they are made."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from typing_extensions import Self


class Immutable:
    """Base of frozen dataclasses with slots: quickly made, and shared by the copies of what holds them.

    A deep copy of what holds such values shares them: a simulation in the middle of a run is copied in milliseconds,
    because only what can still change is copied. Arrays in them must not be written to.

    A frozen dataclass assigns each field through `object.__setattr__`, 90 ns a field; the messages, states and reports
    of a run in lockstep made that an eighth of all its time. The constructor here assigns them to an object that is not
    frozen yet, which takes a fifth of that, and so does the copy that `replace` makes.
    """

    __slots__ = ()
    if TYPE_CHECKING:
        of: ClassVar[Callable[[tuple[Any, ...]], Any]]  # of the values of all fields, in two thirds of the time

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # dataclass makes the class a second time, with slots: that is the one that will be used.
        if is_dataclass(cls) and "__slots__" in cls.__dict__ and _is_simple(cls):
            setattr(cls, "__init__", _constructor(cls))  # noqa: B010 - mypy forbids the plain assignment
            setattr(cls, "_with", _copier(cls))  # noqa: B010
            cls.of = staticmethod(_maker(cls))

    def _with(self, changes: dict[str, Any]) -> Self:
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        # Made again by its constructor: half the time of a dataclass's own way.
        frozen: type = type(self)
        return frozen, tuple([getattr(self, name) for name in _field_names(frozen)])


if TYPE_CHECKING:
    from dataclasses import replace as replace
else:

    def replace(value: Immutable, **changes: Any) -> Immutable:
        """As `dataclasses.replace`, in a quarter of its time: the bridge copies its states several times a cycle."""
        return value._with(changes)


@cache
def _field_names(frozen: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(frozen))


_become = object.__dict__["__class__"].__set__


def _is_simple(frozen: type) -> bool:
    """Whether its constructor does nothing but take its own fields by place or by name."""
    return (
        not hasattr(frozen, "__post_init__")
        and not any(is_dataclass(base) for base in frozen.__mro__[1:])
        and all(field.init and not field.kw_only for field in fields(frozen))
    )


def _liquid(frozen: type) -> type:
    """A class of the same layout that is not frozen: an object is of this one while its fields are set."""
    return type(f"_{frozen.__name__}InTheMaking", frozen.__bases__, {"__slots__": frozen.__dict__["__slots__"]})


def _copier(frozen: type) -> Any:
    """A method that copies an object and sets some of its fields; AttributeError for what is no field."""
    lines = ["def _with(self, changes):", "copy = new(liquid)"]
    lines += [f"copy.{name} = self.{name}" for name in _field_names(frozen)]
    lines += ["for name in changes: setattr(copy, name, changes[name])", "copy.__class__ = frozen", "return copy"]
    names = {"new": object.__new__, "liquid": _liquid(frozen), "frozen": frozen}
    exec(compile("\n    ".join(lines), f"<copier of {frozen.__name__}>", "exec"), names)
    return names["_with"]


def _maker(frozen: type) -> Any:
    """A function of a tuple with the values of all fields."""
    targets = "".join(f"made.{name}, " for name in _field_names(frozen))
    lines = ["def of(values):", "made = new(liquid)", f"{targets} = values", "made.__class__ = frozen", "return made"]
    names = {"new": object.__new__, "liquid": _liquid(frozen), "frozen": frozen}
    exec(compile("\n    ".join(lines), f"<maker of {frozen.__name__}>", "exec"), names)
    return names["of"]


def _constructor(frozen: type) -> Any:
    """An __init__ with the dataclass's own signature."""
    names: dict[str, Any] = {"become": _become, "liquid": _liquid(frozen), "frozen": frozen, "missing": MISSING}
    parameters, lines = ["self"], ["become(self, liquid)"]
    for field in fields(frozen):
        name = value = field.name
        if field.default is not MISSING:
            names[f"default_{name}"] = field.default
            parameters.append(f"{name}=default_{name}")
        elif field.default_factory is not MISSING:
            names[f"make_{name}"] = field.default_factory
            parameters.append(f"{name}=missing")
            value = f"make_{name}() if {name} is missing else {name}"
        else:
            parameters.append(name)
        lines.append(f"self.{name} = {value}")
    lines.append("self.__class__ = frozen")
    source = f"def __init__({', '.join(parameters)}):\n    " + "\n    ".join(lines)
    exec(compile(source, f"<constructor of {frozen.__name__}>", "exec"), names)
    constructor = names["__init__"]
    constructor.__qualname__ = f"{frozen.__qualname__}.__init__"
    constructor.__annotations__ = dict(frozen.__init__.__annotations__)  # type: ignore[misc]
    return constructor
