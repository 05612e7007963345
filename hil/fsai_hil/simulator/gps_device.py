"""The PCAN-GPS on the car's bus: accelerometer, gyroscope, magnetometer, satellite receiver and clock.

Pure: what it sends follows from the car's motion and the time. The device's axes are the car's (ISO 8855).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import datetime, timedelta, timezone
from functools import lru_cache
from typing import Final

from fsai_hil.simulator.car_signals import CarFeedback, limited
from fsai_vcu.interface.bus_table import BUS_TABLE, BY_NAME, Flow
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    Acceleration,
    GpsAltitude,
    GpsDilutionA,
    GpsDilutionB,
    GpsLatitude,
    GpsLongitude,
    GpsStatus,
    LogDynamics2,
    Message,
    RotationA,
    RotationB,
)
from fsai_vcu.interface.units import KMH_PER_MPS, MS, STANDARD_GRAVITY_MPS2, S

MILLI_G_PER_MPS2: Final = 1000.0 / STANDARD_GRAVITY_MPS2
MILLI_G_MOST: Final = 20000.0  # PCAN-GPS database: range of BMC_Acceleration
DYNAMICS_MOST_MPS2: Final = 63.99  # signal database: ranges of 0x501
DYNAMICS_MOST_DEGPS: Final = 255.99
RECEIVER_PERIOD_NS: Final = 100 * MS  # the receiver solves for a position ten times a second and repeats it meanwhile
FIRST_FIX_NS: Final = 2 * S
ANTENNA_OK: Final = 2
NAVIGATION_NONE: Final = 1
NAVIGATION_3D: Final = 3
VERTICAL_AXIS_Z: Final = 3
TEMPERATURE_DEGC: Final = 24.0
ALTITUDE_M: Final = 143.0
# Earth's field in the middle of England, north and down
FIELD_NORTH_UT: Final = 19.2
FIELD_DOWN_UT: Final = 44.8
UTC_AT_0: Final = datetime(2026, 7, 15, 9, 0, 0, tzinfo=timezone.utc)


def degrees_and_minutes(angle_deg: float, positive: str, negative: str) -> tuple[int, float, int]:
    """Whole degrees, minutes and the letter of the hemisphere, as the device sends a longitude or latitude."""
    size = abs(angle_deg)
    degrees = int(size)
    return degrees, (size - degrees) * 60.0, ord(positive if angle_deg >= 0.0 else negative)


class PcanGps:
    """The device from its power-up on.

    `frames(names, now_ns, car)` are its messages of those names now. What repeats is encoded once: it is most of the
    bus.
    """

    def __init__(self, codec: Codec, now_ns: int) -> None:
        self._codec = codec
        self._powered_ns = now_ns
        self._solved_ns: int | None = None
        self._felt: object = None
        self._payloads: dict[str, tuple[int, bytes]] = {}  # with their identifiers

    def frames(self, names: Iterable[str], now_ns: int, car: CarFeedback) -> list[Frame]:
        payloads = self._payloads
        if self._solved_ns is None or now_ns - self._solved_ns >= RECEIVER_PERIOD_NS:
            self._solved_ns = now_ns
            payloads |= self._solve(now_ns, car)
        if (felt := (car.accel_xyz_mps2, car.yaw_rate_radps)) != self._felt:
            self._felt = felt
            payloads |= self._feel(car)
        return [Frame(*payloads[name], now_ns) for name in names]

    def _feel(self, car: CarFeedback) -> dict[str, tuple[int, bytes]]:
        """The inertial messages."""
        xyz_mg = [limited(mps2 * MILLI_G_PER_MPS2, MILLI_G_MOST) for mps2 in car.accel_xyz_mps2]
        along, across, _ = [limited(mps2, DYNAMICS_MOST_MPS2) for mps2 in car.accel_xyz_mps2]
        turning_degps = math.degrees(car.yaw_rate_radps)
        images: tuple[Message, ...] = (
            Acceleration(*xyz_mg, TEMPERATURE_DEGC, VERTICAL_AXIS_Z, 0),
            RotationB(turning_degps),
            LogDynamics2(along, across, limited(turning_degps, DYNAMICS_MOST_DEGPS)),
        )
        encoded = [(image.dbc_name, self._codec.encode(image)) for image in images]
        return {name: (frame.can_id, frame.data) for name, frame in encoded}

    def _solve(self, now_ns: int, car: CarFeedback) -> dict[str, tuple[int, bytes]]:
        """Everything that changes ten times a second at most."""
        heading = math.radians(car.course_deg)
        utc = UTC_AT_0 + timedelta(microseconds=now_ns // 1000)
        east_deg, east_min, east = degrees_and_minutes(car.longitude_deg, "E", "W")
        north_deg, north_min, north = degrees_and_minutes(car.latitude_deg, "N", "S")
        images: list[Message] = [
            RotationA(),  # a flat track and a stiff car neither roll nor pitch
            GpsStatus(ANTENNA_OK, 11, NAVIGATION_3D),
            GpsLongitude(east_min, east_deg, east),
            GpsLatitude(north_min, north_deg, north),
            GpsAltitude(ALTITUDE_M),
            GpsDilutionA(1.4, 0.8),
            GpsDilutionB(1.1),
        ]
        # What the AI computer does not read has no class: the values of its signals, in the order of their places.
        others: dict[str, tuple[float, ...]] = {
            "GPS_CourseSpeed": (car.course_deg % 360.0, car.speed_mps * KMH_PER_MPS),
            "GPS_DateTime": (utc.year - 2000, utc.month, utc.day, utc.hour, utc.minute, utc.second),
            "BMC_MagneticField": (
                FIELD_NORTH_UT * math.cos(heading),
                FIELD_NORTH_UT * math.sin(heading),
                -FIELD_DOWN_UT,
            ),
            "IO": (0, 0, 0, 0, 1, 0),  # the receiver has power
            "RTC_DateTime": (utc.second, utc.minute, utc.hour, utc.weekday(), utc.day, utc.month, utc.year),
        }
        if now_ns - self._powered_ns < FIRST_FIX_NS:
            images[1:] = [GpsStatus(ANTENNA_OK, 0, NAVIGATION_NONE), GpsLongitude(), GpsLatitude(), GpsAltitude()]
            images += [GpsDilutionA(99.9, 99.9), GpsDilutionB(99.9)]
            others["GPS_CourseSpeed"] = (0.0, 0.0)
        solved = {image.dbc_name: self._codec.encode(image).data for image in images}
        solved |= {name: _payload(self._codec, name, values) for name, values in others.items()}
        return {name: (BY_NAME[name].can_id, data) for name, data in solved.items()}


@lru_cache
def _payload(codec: Codec, name: str, values: tuple[float, ...]) -> bytes:
    message = codec.database.get_message_by_name(name)
    return message.encode(dict(zip([signal.name for signal in message.signals], values, strict=True)))


GPS_NAMES: Final = tuple(
    message.name for message in sorted(BUS_TABLE, key=lambda each: each.can_id) if message.flow is Flow.FROM_SENSOR
)
