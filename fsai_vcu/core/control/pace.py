"""Pace of racing laps: how much more or less than the settings' grip the tyres are asked for, by how they slip.

Tyres near their grip slip more for the same force, and so do tyres with less grip. The planner measures the rear axle's
slip angle by lateral acceleration in the map; the pace is what makes that angle, in corners, the one aimed at. It grows
slowly, sinks fast, and is taken back whole, at once, where the car is far beside its path, an axle slips, the cones
seen hardly confirm the map, or the path does not follow one. A pace at which the car lost its path is not taken again.
Until the slip is measured, the pace is what the settings ask. Near its grip a car that brakes turns up to a third more
than it is steered: where no sensor says how fast it turns, the pace stays further from there.
"""

from __future__ import annotations

from msgspec.structs import replace

from fsai_vcu.interface.values import Value

ANGLE_RAD = 0.102  # of the rear axle's slip in a corner: beyond about the double no tyre holds more
LEAST, MOST = 0.9, 1.36  # of the settings' grip
BLIND_ANGLE_RAD, BLIND_MOST = 0.08, 1.23  # the same where no sensor says how fast the car turns
GROWS_1PM, SINKS_1PM = 0.0005, 0.003  # a tenth in 200 m
STEP = 0.1  # of the settings' grip: so much less than when the path was lost
LOST_M = 0.45  # beside the path
SLIPPING = 0.2  # axle_slip of tyres that hold is some hundredths, and 0.13 with the steering at its end


class Signs(Value, frozen=True):
    """Signs of how a car races at one instant, as the controller sees them."""

    distance_m: float
    aside_m: float  # from the path, to either side
    axle_slip: float  # see `axle_slip`
    angle_rad: float  # of the rear axle's slip, at the lateral acceleration that the settings ask for; 0: not measured
    sure: bool  # the path follows the map, and the cones seen confirm it
    turn_sensed: bool  # a sensor says how fast the car turns


class Pace(Value, frozen=True):
    """gain: what is asked of the tyres, by what the settings ask."""

    gain: float = 1.0
    most: float = MOST
    distance_m: float = 0.0

    def after(self, shown: Signs) -> Pace:
        """The pace once the car has shown this."""
        if not shown.sure:
            return self.taken_back(shown.distance_m)
        if not (abs(shown.aside_m) <= LOST_M and shown.axle_slip <= SLIPPING):
            most = max(1.0, self.gain - STEP) if self.gain > 1.0 else self.most
            return replace(self.taken_back(shown.distance_m), most=most)
        way_m = max(shown.distance_m - self.distance_m, 0.0)
        angle_rad, most = (ANGLE_RAD, MOST) if shown.turn_sensed else (BLIND_ANGLE_RAD, BLIND_MOST)
        wanted = min(max(angle_rad / shown.angle_rad, LEAST), most, self.most) if shown.angle_rad > 0.0 else 1.0
        gain = min(max(wanted, self.gain - SINKS_1PM * way_m), self.gain + GROWS_1PM * way_m)
        return Pace(gain, self.most, shown.distance_m)

    def taken_back(self, distance_m: float) -> Pace:
        """The pace of a car that has lost its way by the map there."""
        return Pace(min(self.gain, 1.0), self.most, distance_m)


def axle_slip(wheel_speeds_rpm: tuple[float, float, float, float]) -> float:
    """Return by how much of the faster axle's speed the other one turns slower. Speeds are FL, FR, RL, RR."""
    front_left, front_right, rear_left, rear_right = wheel_speeds_rpm
    front, rear = front_left + front_right, rear_left + rear_right
    return abs(front - rear) / max(front, rear, 1.0)
