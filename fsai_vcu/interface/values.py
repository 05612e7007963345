"""Values that never change once they are made: messages, states, reports and settings; and how long their texts are."""

from __future__ import annotations

from typing import Annotated, Any, Final

import msgspec


class Value(msgspec.Struct, frozen=True):
    """Base of all values: quickly made, and shared by the copies of what holds them.

    A deep copy of what holds such values shares them: a simulation in the middle of a run is copied in milliseconds,
    because only what can still change is copied. Arrays in them must not be written to. A copy with other values in
    some fields is made by `msgspec.structs.replace`. Types and bounds of fields are checked where a value is decoded,
    and only there.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> Value:
        return self


# ---------------------------------------------------------------- bounds of what one process tells another

WORD_LENGTH: Final = 48
DETAIL_LENGTH: Final = 160
SENTENCE_LENGTH: Final = 500

Word = Annotated[str, msgspec.Meta(max_length=WORD_LENGTH)]
"""A name: of a mode, a role, a car, a reason."""
Detail = Annotated[str, msgspec.Meta(max_length=DETAIL_LENGTH)]
"""Text that is said besides: the detail of a reason, a problem of a frame."""
Sentence = Annotated[str, msgspec.Meta(max_length=SENTENCE_LENGTH)]
Whole = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]
Count = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]


def shortened(text: str, length: int = SENTENCE_LENGTH) -> str:
    """The text as it is kept and told on: at most `length` characters, and none that UTF-8 cannot encode."""
    if len(text) > length:
        text = text[: length - 1] + "…"
    return text if text.isascii() else text.encode("utf-8", "replace").decode()
