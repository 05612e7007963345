"""What a person beside the car sees and hears: ASSI, TSAL and siren.

Source: the vehicle's interface specification v4.0, indicators.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.immutable import Immutable
from fsai_vcu.interface.units import S


class Assi(StrEnum):
    OFF = "off"
    YELLOW = "yellow"
    YELLOW_AND_BLUE = "yellow+blue"
    YELLOW_FLASHING = "yellow flashing"
    BLUE_FLASHING = "blue flashing"
    BLUE = "blue"


class Tsal(StrEnum):
    OFF = "off"  # no low voltage either
    GREEN = "green"
    RED_FLASHING = "red flashing"


class Siren(StrEnum):
    OFF = "off"
    ON = "on"
    INTERMITTENT = "intermittent"


READY_BLUE_NS: Final = 1 * S
DRIVING_SIREN_NS: Final = 3 * S


@dataclass(frozen=True, slots=True)
class Indicators(Immutable):
    assi: Assi = Assi.OFF
    tsal: Tsal = Tsal.OFF
    siren: Siren = Siren.OFF


DARK: Final = Indicators()

_ASSI: Final = {
    AsState.AS_INIT: Assi.OFF,
    AsState.AS_OFF: Assi.OFF,
    AsState.AS_READY: Assi.YELLOW,
    AsState.AS_DRIVING: Assi.YELLOW_FLASHING,
    AsState.EMERGENCY_BRAKE: Assi.BLUE_FLASHING,
    AsState.AS_FINISHED: Assi.BLUE,
}


def indicators(
    state: AsState, in_state_ns: int, ready_wait_ns: int, emergency_timer_ns: int, has_moved: bool, ts_live: bool
) -> Indicators:
    """The indicators of a car with low voltage on. `has_moved`: a wheel has turned since AS_DRIVING began."""
    assi = _ASSI[state]
    if state is AsState.AS_READY and ready_wait_ns <= in_state_ns < ready_wait_ns + READY_BLUE_NS:
        assi = Assi.YELLOW_AND_BLUE
    siren = Siren.OFF
    if state is AsState.AS_DRIVING:
        if in_state_ns < DRIVING_SIREN_NS:
            siren = Siren.ON
        elif not has_moved:
            siren = Siren.INTERMITTENT
    elif state is AsState.EMERGENCY_BRAKE and in_state_ns < emergency_timer_ns:
        siren = Siren.ON
    return Indicators(assi, Tsal.RED_FLASHING if ts_live else Tsal.GREEN, siren)
