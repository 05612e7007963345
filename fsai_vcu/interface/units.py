"""Units in one another."""

from __future__ import annotations

from typing import Final

MS: Final = 1_000_000
"""Nanoseconds in a millisecond."""

S: Final = 1_000_000_000
"""Nanoseconds in a second."""

KMH_PER_MPS: Final = 3.6
STANDARD_GRAVITY_MPS2: Final = 9.80665  # what accelerometers count in
