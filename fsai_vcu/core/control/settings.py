"""What can be set about control. SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fsai_vcu.core.ranges import check_ranges, ranges_of, within
from fsai_vcu.interface.immutable import Immutable

NO_SPEED_LIMIT_MPS = 30.0  # what the car reaches at its motors' highest speed: as a limit it is none


@dataclass(frozen=True, slots=True)
class ControllerSettings(Immutable):
    """Defaults drive robustly rather than fast. The speed of a mission is the lower of its own and `max_speed_mps`."""

    max_speed_mps: float = within(0.5, NO_SPEED_LIMIT_MPS, NO_SPEED_LIMIT_MPS)  # in every mission
    lap_max_speed_mps: float = within(0.5, 30.0, 7.0)  # autocross, trackdrive
    skidpad_max_speed_mps: float = within(0.5, 30.0, 6.0)
    acceleration_max_speed_mps: float = within(0.5, 30.0, 25.0)
    max_steer_rad: float = within(0.05, math.radians(30.0), math.radians(30.0))  # nor more than the car's own

    lateral_mps2: float = within(0.5, 15.0, 4.5)  # in corners
    braking_mps2: float = within(0.5, 8.0, 3.0)  # planned before corners
    stopping_mps2: float = within(0.5, 8.0, 4.0)  # planned before the stopping place
    braking_max_mps2: float = within(1.2, 9.0, 6.0)
    end_of_path_mps: float = within(0.0, 20.0, 4.0)  # with what lies behind the path's end unknown

    lookahead_m: float = within(0.0, 5.0, 1.0)  # of pure pursuit at rest …
    lookahead_s: float = within(0.0, 2.0, 0.25)  # … and with speed
    lookahead_min_m: float = within(1.0, 5.0, 1.7)
    lookahead_max_m: float = within(2.0, 20.0, 6.0)
    delay_s: float = within(0.0, 0.5, 0.11)  # command to wheels: dead time, bus, half of the actuator's lag
    reaction_s: float = within(0.0, 1.0, 0.2)  # of the brakes

    speed_gain_1ps: float = 2.0  # acceleration per speed error
    brake_on_mps2: float = within(0.2, 5.0, 1.8)  # needed deceleration from which on the brake is used …
    brake_off_mps2: float = within(0.0, 5.0, 0.8)  # … and below which it is released
    plan_old_s: float = 0.4  # no throttle on an older plan
    plan_lost_s: float = 0.8  # brake on an older one
    gentle_brake: float = within(0.0, 1.0, 0.2)  # without a path
    final_brake: float = within(0.05, 1.0, 0.3)  # after the end
    path_min_m: float = 1.5  # a shorter path is none
    give_up_s: float = within(5.0, 600.0, 30.0)  # of standing where the car should drive: then ESTOP_REQUEST

    def __post_init__(self) -> None:
        check_ranges(self, "controller")


CONTROLLER_RANGES = ranges_of(ControllerSettings)
