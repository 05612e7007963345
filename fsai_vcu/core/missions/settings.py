"""The lengths, times and speeds of the seven missions. The rules of a year may change them; the defaults are those of
the rules the missions were written for. Lengths in m, speeds in m/s, times in s, angles in rad."""

from __future__ import annotations

from fsai_vcu.interface.units import KMH_PER_MPS
from fsai_vcu.interface.values import Value


class MissionSettings(Value, frozen=True):
    """Staging distances are from the car's nose to the line."""

    # Autocross / sprint and trackdrive
    lap_staging_m: float = 6.0
    autocross_laps: int = 1
    trackdrive_laps: int = 10
    lap_stop_m: float = 12.0  # stand this far behind the line, further when faster …
    lap_stop_max_m: float = 25.0  # … but no further; the rules allow 30 m
    lap_min_m: float = 20.0  # no two passages of the line nearer to each other than this way

    # Acceleration
    acceleration_staging_m: float = 0.30
    acceleration_length_m: float = 75.0
    acceleration_stop_m: float = 15.0  # stand this far behind the finish, further when faster …
    acceleration_stop_max_m: float = 90.0  # … but no further; the rules allow 100 m

    # Skidpad
    skidpad_centres_m: float = 18.25
    skidpad_inner_diameter_m: float = 15.25
    skidpad_lane_m: float = 3.0
    skidpad_laps_per_side: int = 2
    skidpad_stop_m: float = 15.0  # the rules allow 25 m

    # Static inspections A and B, wheels in the air
    sweep_rate_radps: float = 0.35  # the actuator makes 0.70
    sweep_hold_s: float = 0.4  # at each end, for the actuator to arrive
    sweep_tolerance_rad: float = 0.035
    inspection_a_rpm: float = 200.0
    inspection_a_spin_up_s: float = 10.0
    inspection_a_hold_s: float = 1.0
    inspection_b_rpm: float = 50.0
    inspection_b_hold_s: float = 0.5

    # Autonomous demo
    demo_speed_mps: float = 15.0 / KMH_PER_MPS
    demo_margin_mps: float = 0.6  # faster than asked by this, for the difference between our speed and the judge's
    demo_length_m: float = 10.0  # to accelerate in, and to stop in
    demo_pause_s: float = 1.0  # at rest before accelerating again

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if not 0 < value < 10_000:
                raise ValueError(f"mission setting {name} is {value}, not a positive number")
