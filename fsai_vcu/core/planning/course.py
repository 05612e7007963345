"""What a strategy hands to the planner: the way on, as one family of missions finds it."""

from __future__ import annotations

import math
from typing import Protocol

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.planning.cone_memory import ConeMemory
from fsai_vcu.core.planning.pose import NO_PATH
from fsai_vcu.interface.values import Value

BRAKING_DELAY_S = 0.3
BLIND_MAX_M = 12.0  # driven by odometry alone where the way is known from the cones seen before
CONES_MIN = 2  # in one look, that keep a way believed


class Course(Value, frozen=True):
    """The way on from the car. Fields as in `Plan`, which carries them to the controller."""

    path_m: Floats  # (M, 2) vehicle frame
    laps: int = 0
    finished: bool = False
    stop_distance_m: float | None = None
    supported_m: float = math.inf
    confidence: float = 1.0
    mapped: bool = False
    note: str = ""


class Strategy(Protocol):
    """How a family of missions finds its way."""

    def anchor(self, motion: Motion) -> None:
        """The car stands at its staging place, at `motion`."""

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        """The way on, after `memory` has taken in the cones seen (vehicle frame) from `motion`."""


class Sight:
    """How far the car has driven since cones were seen."""

    def __init__(self, motion: Motion) -> None:
        self._seen_at_m = motion.distance_m

    def lost(self, seen_xy_m: Floats, motion: Motion) -> Course | None:
        """No way on, where none were seen for too long; None as long as they are."""
        if len(seen_xy_m) >= CONES_MIN:
            self._seen_at_m = motion.distance_m
        blind_m = motion.distance_m - self._seen_at_m
        if blind_m <= BLIND_MAX_M:
            return None
        return Course(NO_PATH, supported_m=0.0, confidence=0.0, note=f"no cones are seen for {blind_m:.0f} m")


def braking_m(speed_mps: float, deceleration_mps2: float) -> float:
    """Way in which the car comes to rest."""
    return speed_mps * BRAKING_DELAY_S + speed_mps**2 / (2.0 * deceleration_mps2)
