"""One meaning of "p99" for the whole project: nearest rank, so that every figure shown was really measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

_PARTS: Final = 100_000  # shares are exact to a thousandth of a per cent


def quantile(ordered: Sequence[int], share: float) -> int | None:
    """The smallest of the values, given in ascending order, that at least `share` (0 to 1) of them do not exceed.

    None of no values. `ordered` may be a numpy array. Raises ValueError for a share outside 0 to 1.
    """
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"a share is 0 to 1, and this is {share}")
    count = len(ordered)
    if not count:
        return None
    rank = -(-count * round(share * _PARTS) // _PARTS)
    return int(ordered[max(rank, 1) - 1])
