"""Settings of control. SI units."""

from __future__ import annotations

import math
from typing import Annotated

from fsai_vcu.core.ranges import check_ranges, ranges_of, within
from fsai_vcu.interface.values import Value

NO_SPEED_LIMIT_MPS = 30.0  # what the car reaches at its motors' highest speed: as a limit it is none


class ControllerSettings(Value, frozen=True):
    """Defaults drive robustly rather than fast. The speed of a mission is the lower of its own and `max_speed_mps`."""

    max_speed_mps: Annotated[float, within(0.5, NO_SPEED_LIMIT_MPS)] = NO_SPEED_LIMIT_MPS  # in every mission
    lap_max_speed_mps: Annotated[float, within(0.5, 30.0)] = 12.0  # autocross, trackdrive
    race_max_speed_mps: Annotated[float, within(0.5, 30.0)] = 15.5  # of them, where the path follows a map
    skidpad_max_speed_mps: Annotated[float, within(0.5, 30.0)] = 6.0
    acceleration_max_speed_mps: Annotated[float, within(0.5, 30.0)] = 25.0
    # Nor more than the car's own.
    max_steer_rad: Annotated[float, within(0.05, math.radians(30.0))] = math.radians(30.0)

    # Without a map a car is careful until looks have borne out its path well for a while; sight alone limits it then.
    careful_mps: Annotated[float, within(0.5, 30.0)] = 7.0
    lateral_mps2: Annotated[float, within(0.5, 15.0)] = 4.5  # in corners, careful …
    sight_lateral_mps2: Annotated[float, within(0.5, 15.0)] = 7.0  # … and by sight
    braking_mps2: Annotated[float, within(0.5, 8.0)] = 3.0  # planned before corners, careful …
    sight_braking_mps2: Annotated[float, within(0.5, 8.0)] = 7.5  # … and by sight: it stops on what cones bear out
    sight_braking_max_mps2: Annotated[float, within(1.2, 9.0)] = 8.5
    race_lateral_mps2: Annotated[float, within(0.5, 15.0)] = 7.0  # the same where the path follows a map …
    race_braking_mps2: Annotated[float, within(0.5, 8.0)] = 6.0  # … or is known beforehand
    stopping_mps2: Annotated[float, within(0.5, 8.0)] = 4.0  # planned before the stopping place
    braking_max_mps2: Annotated[float, within(1.2, 9.0)] = 8.0
    end_of_path_mps: Annotated[float, within(0.0, 20.0)] = 4.0  # with what lies behind the path's end unknown
    confidence_sure: Annotated[float, within(0.01, 1.0)] = 0.5  # with a lower one speeds shrink, gently …
    confidence_min: Annotated[float, within(0.0, 1.0)] = 0.2  # … and below this the nose stops at the path's end

    delay_s: Annotated[float, within(0.0, 0.5)] = 0.09  # command to wheels: dead time, bus, half a cycle of each
    # Smaller changes to and fro are not asked for.
    steer_play_rad: Annotated[float, within(0.0, 0.05)] = math.radians(0.2)
    # Share of the car's backlash that is steered through on a turn-back.
    backlash_share: Annotated[float, within(0.0, 1.0)] = 0.8

    reaction_s: Annotated[float, within(0.0, 0.5)] = 0.11  # command to brakes: dead time, bus, half a cycle of each
    preview_s: Annotated[float, within(0.2, 2.0)] = 0.45  # the profile's speed so far ahead is the one aimed at
    jerk_mps3: Annotated[float, within(1.0, 100.0)] = 12.0
    brake_on_mps2: Annotated[float, within(0.2, 5.0)] = 1.0  # wanted deceleration from which on the brake is used …
    brake_off_mps2: Annotated[float, within(0.0, 5.0)] = 0.3  # … and below which it is released
    plan_old_s: float = 0.4  # no throttle on an older plan
    plan_lost_s: float = 0.8  # brake on an older one
    gentle_brake: Annotated[float, within(0.0, 1.0)] = 0.2  # without a path
    final_brake: Annotated[float, within(0.05, 1.0)] = 0.3  # after the end; at least so much where the planner is lost
    path_min_m: float = 1.5  # a shorter path is none
    give_up_s: Annotated[float, within(5.0, 600.0)] = 30.0  # of standing where the car should drive: then ESTOP_REQUEST

    def __post_init__(self) -> None:
        check_ranges(self, "controller")


CONTROLLER_RANGES = ranges_of(ControllerSettings)
