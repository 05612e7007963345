"""View of the car that a mission without a path has, and its request."""

from __future__ import annotations

from fsai_vcu.core.driving import Motion
from fsai_vcu.interface.values import Value


class CarView(Value, frozen=True):
    """View of the car for a mission without a path. wheel_rpm: FL, FR, RL, RR; steer_rad: measured; standing: all
    wheels at rest.
    """

    now_ns: int
    motion: Motion
    wheel_rpm: tuple[float, float, float, float]
    steer_rad: float
    standing: bool


class MissionRequest(Value, frozen=True):
    """Request of a mission without a path, in the terms of `VehicleCommand`. The default is at rest."""

    steering_rad: float = 0.0
    throttle: float = 0.0
    brake: float = 0.0
    speed_limit_mps: float = 0.0
    finished: bool = False
    estop: bool = False
