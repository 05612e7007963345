"""The car's lights (ASSI) in each AS state, and the one table of colours in which an AS state is drawn anywhere."""

from __future__ import annotations

from typing import Final, NamedTuple

from fsai_vcu.interface.enums import AsState


class Light(NamedTuple):
    """The lights that the car shows, and the colours of every picture of that state (CSS and matplotlib).

    `colour` is off, yellow or blue. `fill` is paler where the car's light is steady: a picture does not flash. `ink` is
    readable on it.
    """

    colour: str
    flashes: bool
    fill: str
    ink: str


LIGHTS: Final = {
    AsState.AS_INIT: Light("off", False, "#dde2e8", "#14181d"),
    AsState.AS_OFF: Light("off", False, "#c3cad2", "#14181d"),
    AsState.AS_READY: Light("yellow", False, "#ffec99", "#14181d"),
    AsState.AS_DRIVING: Light("yellow", True, "#ffc800", "#14181d"),
    AsState.EMERGENCY_BRAKE: Light("blue", True, "#0a4fa3", "#ffffff"),
    AsState.AS_FINISHED: Light("blue", False, "#9ccbff", "#14181d"),
}
"""Lights: interface specification v4.0, ASSI."""

BAND_ALPHA: Final = 0.2
"""The opacity of a state's band behind curves, of `fill`."""

UNKNOWN: Final = Light("unknown", False, "#dde2e8", "#14181d")
"""No AS state is received, or none that the interface names."""


def light_of(label: str | None) -> Light:
    """The light of an AS state by its label."""
    return UNKNOWN if label is None or label not in AsState.__members__ else LIGHTS[AsState[label]]
