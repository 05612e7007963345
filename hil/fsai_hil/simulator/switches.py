"""What people and faults do to the car's electrics: switches, buttons, and parts that fail."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

from fsai_vcu.interface.enums import Ami


@dataclass(slots=True)
class Switches:
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


SWITCH_NAMES: Final = tuple(field.name for field in fields(Switches))
