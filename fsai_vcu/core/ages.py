"""Declarations by which the exhaustive search knows each field of a state; they stand in its `Annotated`.

The state of the bridge has them, and the memory of the checker of the rules. A field without one is searched as it is,
and a value within it field by field. A time, whose name ends in `_ns`, must have one: a search that told every age
apart would never end.
"""

from __future__ import annotations

from typing import Any, Final


class Ages:
    """Ages at which a time matters, in ns or by names of `BridgeConfig`: T - 1 ns and T are told apart."""

    def __init__(self, *at: str | int, gap: tuple[str | int, ...] = ()) -> None:
        """`at`: names, sums of them with " + ", or ns; `gap`: those that are noticed when a frame comes."""
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
