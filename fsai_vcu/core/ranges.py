"""Settings that are numbers: each is declared with its range, and refused by its name outside of it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import get_type_hints

from msgspec import Meta

from fsai_vcu.interface.values import Value


def within(low: float, high: float) -> Meta:
    """The range of a field of a settings class, ends included; it stands in the field's `Annotated`."""
    return Meta(ge=low, le=high)


@cache
def ranges_of(settings: type[Value]) -> Mapping[str, tuple[float, float]]:
    """The ranges of the fields that were declared with one."""
    return {
        name: (note.ge, note.le)
        for name, hint in get_type_hints(settings, include_extras=True).items()
        for note in getattr(hint, "__metadata__", ())
        if isinstance(note, Meta) and note.ge is not None and note.le is not None
    }


def check_ranges(settings: Value, what: str, others: tuple[float, float] = (0.01, 100.0)) -> None:
    """Check each setting against its range; `others`: the range of fields that were declared without one. Raises
    ValueError, which names the setting.
    """
    ranges = ranges_of(type(settings))
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        low, high = ranges.get(name, others)
        if not low <= value <= high:
            raise ValueError(f"{what} setting {name} is {value}, outside {low}…{high}")
