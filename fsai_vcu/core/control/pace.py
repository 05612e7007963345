"""Pace of racing laps: how much more than in the first of them the car is asked for, by how it followed its path.

It rises at the line, one step a lap, where the car has followed the map's path closely since it joined it or passed the
line last. It is taken back whole, at once, where the car is far beside its path, an axle slips, the cones seen hardly
confirm the map, or the path does not follow one. A step at which the car lost its path is not taken again in the run.
"""

from __future__ import annotations

from fsai_vcu.interface.values import Value

STEP = 0.5  # of the pace, a lap: the quickest lap is the third by the map
FOLLOWED_M, LOST_M = 0.3, 0.45  # beside the path: up to the first the lap counts, beyond the second the pace is lost
SLIPPING = 0.2  # axle_slip of tyres that hold is some hundredths, and 0.13 with the steering at its end
LEAST_M = 60.0  # of way followed, that counts as a lap


class Shown(Value, frozen=True):
    """Car at one instant of its racing, as the controller sees it."""

    laps: int
    distance_m: float
    aside_m: float  # from the path, to either side
    slip: float  # see `axle_slip`
    sure: bool  # the path follows the map, and the cones seen confirm it


class Pace(Value, frozen=True):
    """share: 0 for the grip that the settings give … 1 for the most that they allow."""

    share: float = 0.0
    most: float = 1.0
    laps: int = 0
    since_m: float | None = None  # distance from which on the path has been followed closely; None: it is not

    def after(self, shown: Shown) -> Pace:
        """The pace once the car has shown this."""
        aside_m = abs(shown.aside_m)
        if not shown.sure:
            return Pace(0.0, self.most, shown.laps)
        if not (aside_m <= LOST_M and shown.slip <= SLIPPING):
            most = max(0.0, self.share - STEP) if self.share > 0.0 else self.most
            return Pace(0.0, most, shown.laps)
        if shown.laps != self.laps:
            followed = self.since_m is not None and shown.distance_m - self.since_m >= LEAST_M
            share = min(self.most, self.share + STEP) if followed else self.share
            return Pace(share, self.most, shown.laps, shown.distance_m)
        if self.since_m is None or aside_m > FOLLOWED_M:
            return Pace(self.share, self.most, self.laps, shown.distance_m)
        return self


def axle_slip(wheel_speeds_rpm: tuple[float, float, float, float]) -> float:
    """Return by how much of the faster axle's speed the other one turns slower. Speeds are FL, FR, RL, RR."""
    front_left, front_right, rear_left, rear_right = wheel_speeds_rpm
    front, rear = front_left + front_right, rear_left + rear_right
    return abs(front - rear) / max(front, rear, 1.0)
