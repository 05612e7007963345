"""Messages on the car's bus: sender, period, and when silence counts as loss, in one table.

`timeout_ns=None` spells that nobody supervises the message. Periods are those of the interface's databases.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS


class Flow(Enum):
    """Direction of a message, seen from the AI computer."""

    TO_VCU = "AI to VCU"
    FROM_VCU = "VCU to AI"
    FROM_SENSOR = "PCAN-GPS to AI"
    OTHER = "between others"


class BusMessage(NamedTuple):
    """One message of the bus. `period_ns` has an entry for each revision in which the message exists."""

    name: str
    can_id: int
    dlc: int
    period_ns: Mapping[str, int]
    timeout_ns: int | None
    flow: Flow
    owner: str

    def __str__(self) -> str:
        return f"{self.name} (0x{self.can_id:03X})"


def _both(period_ms: int) -> Mapping[str, int]:
    return MappingProxyType({"2021": period_ms * MS, "2026": period_ms * MS})


def _each(**period_ms: int) -> Mapping[str, int]:
    return MappingProxyType({name.removeprefix("r"): period * MS for name, period in period_ms.items()})


# The AI side's own supervision of 0x520, wheel speeds and steering takes the VCU's time (safety: graded reactions).
_LOSS = COMMS_LOST_NS
_GPS_LOSS = 1_000 * MS  # a GPS receiver settles new values about once a second

BUS_TABLE: tuple[BusMessage, ...] = (
    BusMessage("AI2VCU_Status", 0x510, 8, _both(10), _LOSS, Flow.TO_VCU, "AI"),
    BusMessage("AI2VCU_Drive_F", 0x511, 4, _both(10), _LOSS, Flow.TO_VCU, "AI"),
    BusMessage("AI2VCU_Drive_R", 0x512, 4, _both(10), _LOSS, Flow.TO_VCU, "AI"),
    BusMessage("AI2VCU_Steer", 0x513, 2, _both(10), _LOSS, Flow.TO_VCU, "AI"),
    BusMessage("AI2VCU_Brake", 0x514, 2, _both(10), _LOSS, Flow.TO_VCU, "AI"),
    BusMessage("VCU2AI_Status", 0x520, 8, _both(10), _LOSS, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2AI_Drive_F", 0x521, 6, _both(10), _LOSS, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2AI_Drive_R", 0x522, 6, _both(10), _LOSS, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2AI_Steer", 0x523, 6, _both(10), _LOSS, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2AI_Brake", 0x524, 5, _both(10), _LOSS, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2AI_Speeds", 0x525, 8, _both(10), _LOSS, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2AI_Wheel_counts", 0x526, 8, _both(10), _LOSS, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2LOG_Dynamics1", 0x500, 8, _each(r2021=10, r2026=100), None, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU2LOG_Status", 0x502, 5, _both(100), None, Flow.FROM_VCU, "VCU"),
    BusMessage("VCU_STATUS", 0x120, 8, _each(r2021=10), None, Flow.FROM_VCU, "VCU"),
    BusMessage("AI2LOG_Dynamics2", 0x501, 6, _each(r2021=10, r2026=5), _LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("BMC_Acceleration", 0x600, 8, _both(5), _LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("L3GD20_Rotation_A", 0x610, 8, _both(5), _LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("L3GD20_Rotation_B", 0x611, 4, _both(5), _LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_Status", 0x620, 3, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_CourseSpeed", 0x621, 8, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_PositionLongitude", 0x622, 7, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_PositionLatitude", 0x623, 7, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_PositionAltitude", 0x624, 4, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_Delusions_A", 0x625, 8, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_Delusions_B", 0x626, 4, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("GPS_DateTime", 0x627, 6, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("BMC_MagneticField", 0x628, 6, _both(5), _GPS_LOSS, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("IO", 0x630, 1, _both(5), None, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("RTC_DateTime", 0x640, 8, _both(5), None, Flow.FROM_SENSOR, "PCAN_GPS"),
    BusMessage("NMT", 0x000, 2, _each(r2026=100), None, Flow.OTHER, "VCU"),
    BusMessage("SYNC", 0x080, 0, _each(r2026=5), None, Flow.OTHER, "VCU"),
    BusMessage("RES_EMCY", 0x081, 8, _each(r2026=10), None, Flow.OTHER, "RES"),
    BusMessage("UMB_EMCY", 0x084, 8, _each(r2026=100), None, Flow.OTHER, "JOYSTICK"),
    BusMessage("OPUS2VCU_FB", 0x123, 1, _each(r2026=100), None, Flow.OTHER, "OPUS"),
    BusMessage("RES_TPDO", 0x181, 8, _each(r2026=10), None, Flow.OTHER, "RES"),
    BusMessage("UMB_PDO1", 0x184, 2, _each(r2026=5), None, Flow.OTHER, "JOYSTICK"),
    BusMessage("UMB_PDO2", 0x284, 4, _each(r2026=100), None, Flow.OTHER, "JOYSTICK"),
    BusMessage("VCU2OPUS_1", 0x300, 8, _each(r2026=10), None, Flow.OTHER, "VCU"),
    BusMessage("VCU2OPUS_2", 0x301, 8, _each(r2026=10), None, Flow.OTHER, "VCU"),
    BusMessage("VCU2OPUS_3", 0x302, 8, _each(r2026=10), None, Flow.OTHER, "VCU"),
)

BY_ID: Mapping[int, BusMessage] = MappingProxyType({message.can_id: message for message in BUS_TABLE})
BY_NAME: Mapping[str, BusMessage] = MappingProxyType({message.name: message for message in BUS_TABLE})
