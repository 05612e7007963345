"""A simulated cone sensor: what a camera or lidar with its detector would report of the cones around the car.

It reports raw detections: besides the cones that are there, a little displaced, some are missed, some have no colour
or the wrong one, and some were never there. False ones have a low confidence, which is what a threshold is for.
Deterministic for a seed and a sequence of calls.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks import Track
from fsai_vcu.core.arrays import Floats, Ints
from fsai_vcu.core.driving import ConeColor, ConeObservation
from fsai_vcu.interface.values import Value

COLOURED: Final = np.array([ConeColor.BLUE, ConeColor.YELLOW, ConeColor.ORANGE, ConeColor.BIG_ORANGE], dtype=np.int64)


class SensorSettings(Value, frozen=True):
    """The quality of the sensor. All imperfections scale with `noise_level`; 0 is a perfect sensor."""

    range_m: float = 14.0
    blind_m: float = 0.6  # nothing is seen nearer than that
    field_of_view_deg: float = 110.0
    ahead_of_rear_axle_m: float = 0.6  # where it is mounted
    noise_level: float = 1.0
    noise_m: float = 0.03  # standard deviation of a position beside the car …
    noise_per_m: float = 0.008  # … and how it grows with the distance
    miss_near: float = 0.01  # share of cones missed beside the car …
    miss_far: float = 0.10  # … and at the end of the range
    unknown_far: float = 0.25  # share without colour at the end of the range
    confused_far: float = 0.02  # share with a wrong colour at the end of the range
    mistaken: float = 0.0  # share of cones that have the other border's colour in every look
    false_per_scan: float = 0.10  # detections of nothing, on average
    colours: bool = True  # False: every cone is of UNKNOWN colour

    def __post_init__(self) -> None:
        if not self.noise_level >= 0.0 or not math.isfinite(self.noise_level):
            raise ValueError(f"noise_level is {self.noise_level}, but must be 0 or more")
        if not 0.0 <= self.blind_m < self.range_m:
            raise ValueError(f"range_m {self.range_m} must be more than blind_m {self.blind_m}")


class ConeSensor:
    """Sees the cones of a track from a pose."""

    def __init__(self, track: Track, settings: SensorSettings | None = None, seed: int = 0) -> None:
        self.settings = settings if settings is not None else SensorSettings()
        self._xy = track.cones_xy_m
        self._colors = colors = track.cone_colors
        if (share := self.settings.noise_level * self.settings.mistaken) > 0.0:
            mistaken = np.random.default_rng((seed, len(colors))).random(len(colors)) < share
            mistaken &= (colors == ConeColor.BLUE) | (colors == ConeColor.YELLOW)
            self._colors = np.where(mistaken, ConeColor.BLUE + ConeColor.YELLOW - colors, colors)
        self._random = np.random.default_rng(seed)

    def see(self, pose: Pose, t_ns: int) -> ConeObservation:
        """The detections at an instant, in the vehicle frame."""
        s = self.settings
        level = s.noise_level
        x, y = pose.seen(*self._xy.T)
        x = x - s.ahead_of_rear_axle_m
        distance = np.hypot(x, y)
        seen = (distance >= s.blind_m) & (distance <= s.range_m)
        seen &= np.abs(np.arctan2(y, x)) <= math.radians(s.field_of_view_deg / 2.0)
        x, y, distance, colors = x[seen], y[seen], distance[seen], self._colors[seen]
        if level > 0.0:
            # one draw of each kind for every cone in view, so that a change of level does not reshuffle all others
            draw = self._random
            far = distance / s.range_m
            farther = far**2
            count = len(distance)
            chance = draw.random((4, count))
            noise = draw.standard_normal((2, count)) * level * (s.noise_m + s.noise_per_m * distance)
            x, y = x + noise[0], y + noise[1]
            if (confused := chance[1] < level * s.confused_far * farther).any():
                colors[confused] = _other(colors[confused], chance[3][confused])
            colors[chance[2] < level * s.unknown_far * farther] = ConeColor.UNKNOWN
            kept = chance[0] >= level * (s.miss_near + (s.miss_far - s.miss_near) * farther)
            certain = np.minimum(np.maximum(0.97 - 0.25 * far - 0.1 * level * chance[3], 0.5), 1.0)
            x, y, colors, certain = x[kept], y[kept], colors[kept], certain[kept]
            if ghosts := int(draw.poisson(level * s.false_per_scan)):
                ghost_x, ghost_y, ghost_colors, ghost_certain = self._ghosts(ghosts)
                x, y = np.concatenate([x, ghost_x]), np.concatenate([y, ghost_y])
                colors = np.concatenate([colors, ghost_colors])
                certain = np.concatenate([certain, ghost_certain])
        else:
            certain = np.ones(len(distance))
        if not s.colours:
            colors = np.full_like(colors, ConeColor.UNKNOWN)
        xy = np.column_stack([x + s.ahead_of_rear_axle_m, y])
        return ConeObservation(t_ns, xy, colors.astype(np.int64), certain)

    def _ghosts(self, count: int) -> tuple[Floats, Floats, Ints, Floats]:
        """Detections of nothing, anywhere in view."""
        s = self.settings
        distance = s.blind_m + (s.range_m - s.blind_m) * np.sqrt(self._random.random(count))
        angle = math.radians(s.field_of_view_deg) * (self._random.random(count) - 0.5)
        colors = COLOURED[self._random.integers(0, 2, count)]
        return distance * np.cos(angle), distance * np.sin(angle), colors, 0.1 + 0.35 * self._random.random(count)


def _other(colors: Ints, chance: Floats) -> Ints:
    """Return for each cone a colour that is not its own."""
    index = np.searchsorted(COLOURED, np.clip(colors, COLOURED[0], COLOURED[-1]))
    shift = 1 + (chance * (len(COLOURED) - 1)).astype(np.int64)
    return np.asarray(COLOURED[(index + shift) % len(COLOURED)], dtype=np.int64)
