"""What a person beside the car sees of the AS state: the ASSI.

Source: the vehicle's interface specification v4.0, indicators.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.units import S


class Assi(StrEnum):
    OFF = "off"
    YELLOW = "yellow"
    YELLOW_AND_BLUE = "yellow+blue"
    YELLOW_FLASHING = "yellow flashing"
    BLUE_FLASHING = "blue flashing"
    BLUE = "blue"


READY_BLUE_NS: Final = 1 * S  # so long blue joins yellow, once Go may be given
ASSI: Final = {
    AsState.AS_INIT: Assi.OFF,
    AsState.AS_OFF: Assi.OFF,
    AsState.AS_READY: Assi.YELLOW,
    AsState.AS_DRIVING: Assi.YELLOW_FLASHING,
    AsState.EMERGENCY_BRAKE: Assi.BLUE_FLASHING,
    AsState.AS_FINISHED: Assi.BLUE,
}
