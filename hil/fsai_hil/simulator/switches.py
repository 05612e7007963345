"""The car's electrics as people and faults change them: switches, buttons, parts that fail; and the ASSI.

Source: the vehicle's interface specification v4.0.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from msgspec import Struct

from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import S


class Switches(Struct):
    """The switch panel, the remote and the wiring, as they are now. The VCU looks at them in each step.

    The defaults are the car as it is wheeled in: everything off, nothing broken.
    """

    # the switch panel
    lvms: bool = False  # low-voltage master switch: power to the VCU
    aims: bool = False  # AI master switch (2021): power to the AI computer
    asms: bool = False  # autonomous-system master switch
    tsms: bool = False  # tractive-system master switch
    ami: Ami = Ami.NOT_SELECTED  # the mission on the display

    # the remote
    go: bool = False
    remote_estop: bool = False
    remote_radio_ok: bool = True

    # on the car
    car_estop: bool = False
    dongle: bool = True  # the dongle that permits autonomous driving is in
    crash: bool = False  # the crash sensor has tripped

    # what breaks
    hvil_open: bool = False
    hvil_short: bool = False
    ebs_fault: bool = False
    offboard_charger_fault: bool = False
    charge_procedure_fault: bool = False
    bms_fault: bool = False
    steering_fault: bool = False
    brake_fault: bool = False
    batt_temp_high: bool = False
    batt_soc_low: bool = False

    # derating: None leaves the limit of the interface revision
    torque_limit_nm: float | None = None
    steer_limit_deg: float | None = None


SWITCH_NAMES: Final = Switches.__struct_fields__


class Assi(str, Enum):
    """Lights of the autonomous system's status indicator (ASSI)."""

    OFF = "off"
    YELLOW = "yellow"
    YELLOW_AND_BLUE = "yellow+blue"
    YELLOW_FLASHING = "yellow flashing"
    BLUE_FLASHING = "blue flashing"
    BLUE = "blue"

    def __str__(self) -> str:
        return self.value


READY_BLUE_NS: Final = 1 * S  # so long blue joins yellow, once Go may be given
ASSI: Final = {
    AsState.AS_INIT: Assi.OFF,
    AsState.AS_OFF: Assi.OFF,
    AsState.AS_READY: Assi.YELLOW,
    AsState.AS_DRIVING: Assi.YELLOW_FLASHING,
    AsState.EMERGENCY_BRAKE: Assi.BLUE_FLASHING,
    AsState.AS_FINISHED: Assi.BLUE,
}
