"""Values that never change once they are made: messages, states, reports and settings."""

from __future__ import annotations

from typing import Any

import msgspec


class Value(msgspec.Struct, frozen=True):
    """Base of all values: quickly made, and shared by the copies of what holds them.

    A deep copy of what holds such values shares them: a simulation in the middle of a run is copied in milliseconds,
    because only what can still change is copied. Arrays in them must not be written to. A copy with other values in
    some fields is made by `msgspec.structs.replace`. Types of fields are checked where a value is decoded, and only
    there.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> Value:
        return self
