"""Units in one another, and a length of time in words."""

from __future__ import annotations

from typing import Final

MS: Final = 1_000_000
"""Nanoseconds in a millisecond."""

S: Final = 1_000_000_000
"""Nanoseconds in a second."""

KMH_PER_MPS: Final = 3.6
STANDARD_GRAVITY_MPS2: Final = 9.80665  # what accelerometers count in


def ms(length_ns: int) -> str:
    """A length of time as people read it."""
    if length_ns < S:
        return f"{length_ns / MS:.0f} ms" if length_ns >= 10 * MS else f"{length_ns / MS:.1f} ms"
    return f"{length_ns / S:.2f} s"
