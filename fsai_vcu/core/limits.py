"""Operational limits: what an official allows at a venue. Loaded at start, confirmed on the screen, never exceeded.

The caller reads the file; here a mapping becomes limits, or one clear line says why it cannot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.values import Value


class LimitsError(UserError, ValueError):
    """The limits given cannot be used."""


class OperationalLimits(Value, frozen=True):
    """The most that may be asked of the car. Infinity means that the official limits nothing there."""

    max_speed_mps: float = math.inf
    max_axle_torque_nm: float = math.inf
    max_steer_deg: float = math.inf

    def __post_init__(self) -> None:
        for name in NAMES:
            value = getattr(self, name)
            if math.isnan(value) or value < 0.0:
                raise LimitsError(f"{name} is {value}: a limit is a number of 0 or more")

    def described(self) -> tuple[str, ...]:
        """One line per limit, for the screen and the log."""
        return tuple(
            f"{name} = " + ("not limited" if math.isinf(value) else f"{value:g}")
            for name, value in ((name, getattr(self, name)) for name in NAMES)
        )


NAMES = ("max_speed_mps", "max_axle_torque_nm", "max_steer_deg")

UNLIMITED = OperationalLimits()
SPEED_NOT_LIMITED = UNLIMITED.described()[0]
"""The line of `described` that says so."""


def parse_limits(mapping: Mapping[str, object]) -> OperationalLimits:
    """Limits from a mapping such as a parsed TOML table. A name left out is not limited.

    A misspelt name would leave the car unlimited without anybody noticing, so it is refused.
    """
    unknown = sorted(str(name) for name in mapping if name not in NAMES)
    if unknown:
        raise LimitsError(f"unknown limit {', '.join(unknown)}: the limits are {', '.join(NAMES)}")
    values: dict[str, float] = {}
    for name, value in mapping.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise LimitsError(f"{name} is {value!r}: a limit is a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number) or number < 0.0:
            raise LimitsError(f"{name} is {number}: a limit is a finite number of 0 or more")
        values[name] = number
    return OperationalLimits(**values)
