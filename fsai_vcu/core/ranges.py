"""Settings that are numbers: each is declared with its range, and refused by its name outside of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields
from typing import Any, TypeVar

N = TypeVar("N", int, float)


def within(low: float, high: float, default: N) -> N:
    """A field of a settings class with its range, ends included."""
    found: Any = field(default=default, metadata={"range": (low, high)})
    return found  # type: ignore[no-any-return]


def ranges_of(settings: Any) -> Mapping[str, tuple[float, float]]:
    """The ranges of the fields that were declared with one."""
    return {each.name: each.metadata["range"] for each in fields(settings) if each.metadata}


def check_ranges(settings: Any, what: str, others: tuple[float, float] = (0.01, 100.0)) -> None:
    """`others`: the range of fields that were declared without one. Raises ValueError, which names the setting."""
    for each in fields(settings):
        value = getattr(settings, each.name)
        low, high = each.metadata.get("range", others)
        if not low <= value <= high:
            raise ValueError(f"{what} setting {each.name} is {value}, outside {low}…{high}")
