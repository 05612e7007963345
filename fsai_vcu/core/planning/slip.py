"""Slip of the rear axle in corners, as the map shows it: what is left between the car's place by odometry and by cones.

Odometry moves the car outward by the slip assumed. Where tyres slip more, the cones find the car further outward still:
look by look a little, and always to the same side of a corner.
"""

from __future__ import annotations

from fsai_vcu.core.vehicle.parameters import GRAVITY_MPS2, SLIP_LEAST_RADPMPS2, SLIP_MOST_RADPMPS2, SLIP_RADPMPS2
from fsai_vcu.interface.values import Value

CORNER_MPS2 = 4.0  # less says little of it
LEFT_MOST_M, WAY_MOST_M = 0.2, 2.0  # a larger correction, or step, is of another cause
MEMORY_M2PS2 = 28.0  # way times lateral acceleration, summed in squares: some 100 m of corners tell it
LEARNT_M = 50.0  # of way in corners, after which it is the car's own


class Slip(Value, frozen=True):
    """radpmps2: slip angle by lateral acceleration; cornered_m: way in corners that has told it."""

    radpmps2: float = SLIP_RADPMPS2
    cornered_m: float = 0.0

    @property
    def measured_radpmps2(self) -> float:
        """The slip once enough corners have told it; 0 before."""
        return self.radpmps2 if self.cornered_m >= LEARNT_M else 0.0

    def after(self, way_m: float, lateral_mps2: float, left_m: float) -> Slip:
        """The slip once cones have moved the car so far to the left of where odometry had it."""
        size = abs(lateral_mps2)
        if not (CORNER_MPS2 < size < GRAVITY_MPS2 and abs(left_m) < LEFT_MOST_M and way_m < WAY_MOST_M):
            return self
        change = -left_m * lateral_mps2 * way_m / MEMORY_M2PS2**2
        within = min(max(self.radpmps2 + change, SLIP_LEAST_RADPMPS2), SLIP_MOST_RADPMPS2)
        return Slip(within, self.cornered_m + way_m)
