"""Declarations by which the exhaustive search knows each field of the bridge's state; they stand in its `Annotated`.

A field without one is searched as it is, and a value within it field by field. A time, whose name ends in `_ns`, must
have one: a search that told every age apart would never end.
"""

from __future__ import annotations

from typing import Any, Final


class Ages:
    """Ages at which a time matters, by their names in `BridgeConfig`: T - 1 ns and T are told apart, no age between."""

    def __init__(self, *at: str | int, gap: tuple[str, ...] = ()) -> None:
        """`at`: names, sums of them with " + ", or ns; `gap`: names of those that are noticed when a frame comes."""
        self.at: Final = at
        self.gap: Final = gap


class NoAge:
    """A number of ns that is not compared with the clock: it is searched as it is, so `why` says what bounds it."""

    def __init__(self, why: str) -> None:
        self.why: Final = why


class NotSearched:
    """A field that the search leaves as it begins, or makes from the rest; `why` says how that can be sound."""

    def __init__(self, why: str) -> None:
        self.why: Final = why


CHOSEN: Final = NotSearched("the searched environment chooses what the plausibility checks find")


class Within:
    """Declarations for fields of the value that a field holds, by their names: they come before that value's own."""

    def __init__(self, **fields: Ages | NoAge | NotSearched | Within) -> None:
        self.fields: Final[dict[str, Any]] = fields
