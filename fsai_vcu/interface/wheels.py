"""Mapping of signals to wheels: cars have been met whose wheel sensors are wired to the wrong inputs."""

from __future__ import annotations

from collections.abc import Mapping

from fsai_vcu.interface.values import Value, Word

WHEELS = ("fl", "fr", "rl", "rr")


class WheelMapping(Value, frozen=True):
    """Mapping of each wheel to the position whose signals in 0x525 and 0x526 carry it; the default: as documented.

    `WheelMapping(fl="fr", fr="fl")` says: the front left wheel is found in FR_WHEEL_SPEED and FR_PULSE_COUNT.
    """

    fl: Word = "fl"
    fr: Word = "fr"
    rl: Word = "rl"
    rr: Word = "rr"

    def __post_init__(self) -> None:
        if sorted((self.fl, self.fr, self.rl, self.rr)) != sorted(WHEELS):
            raise ValueError(f"wheel mapping {self} must name each of {', '.join(WHEELS)} once")

    def __str__(self) -> str:
        return f"fl={self.fl},fr={self.fr},rl={self.rl},rr={self.rr}"

    def source_of(self, wheel: str) -> str:
        """The position whose signals carry `wheel`."""
        return {"fl": self.fl, "fr": self.fr, "rl": self.rl, "rr": self.rr}[wheel]

    @classmethod
    def of(cls, mapping: Mapping[str, str]) -> WheelMapping:
        """Make the mapping from one with any of the keys fl, fr, rl, rr; wheels left out stay where they are."""
        strange = sorted(set(mapping) - set(WHEELS))
        if strange:
            raise ValueError(f"wheel mapping names {', '.join(strange)}: the wheels are {', '.join(WHEELS)}")
        return cls(**{wheel: str(source).lower() for wheel, source in mapping.items()})


STRAIGHT = WheelMapping()
