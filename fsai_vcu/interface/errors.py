"""Errors that a person can put right: raised wherever they are found, printed by the command line as one line."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

_LONGEST: Final = 60  # characters of a mistyped name that are compared
_FEW: Final = 12  # so many names are listed where none is near


class UserError(Exception):
    """Something the user can put right; the message is one clear line."""


class WrongUse(UserError):
    """Request that makes no sense, whatever is on the bus or in the log."""


def did_you_mean(word: str, names: Iterable[str], few: int = _FEW) -> str:
    """The end of an error about an unknown name: the names that were perhaps meant, else all of `few`; else nothing."""
    by_folded = {name.casefold(): name for name in names}
    folded = word[:_LONGEST].casefold()
    close = get_close_matches(folded, by_folded, n=3)
    close += [each for each in by_folded if folded and folded in each and each not in close][: 3 - len(close)]
    if close:
        return f"; did you mean {' or '.join(by_folded[each] for each in close)}?"
    return f"; there are: {', '.join(by_folded.values())}" if 0 < len(by_folded) <= few else ""
