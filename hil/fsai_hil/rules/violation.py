"""A rule that does not hold."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Violation:
    """Which rule does not hold, and what is wrong."""

    rule: str
    words: str
