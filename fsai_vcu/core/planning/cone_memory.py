"""The cones around the car, remembered in the odometry frame: a detector forgets, misses and invents; this does less.

Repeated sightings of a cone are averaged. A cone is believed after some sightings, and dropped when looks at its place
no longer find it, when it is far behind, and when it has not been seen for a long way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsai_vcu.core.arrays import Floats, Ints
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion
from fsai_vcu.core.planning.pose import to_odometry, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings

N_COLORS = len(ConeColor)
DUPLICATE_M = 0.35  # two cones cannot stand nearer: their feet are 0.23 to 0.29 m wide


@dataclass(frozen=True, slots=True)
class Cones:
    """Cones believed. xy_m: (N, 2) vehicle frame; color: (N,) ConeColor; side: (N,) +1 left … -1 right, 0 unknown;
    index: (N,) their place in the memory."""

    xy_m: Floats
    color: Ints
    side: Floats
    index: Ints


def believable(observation: ConeObservation, settings: PlannerSettings) -> tuple[Floats, Ints]:
    """Positions (vehicle frame) and colours of the cones of an observation that can be used at all."""
    xy = np.asarray(observation.xy_m, dtype=np.float64).reshape(-1, 2)
    color = np.asarray(observation.color, dtype=np.int64).reshape(-1)
    confidence = np.asarray(observation.confidence, dtype=np.float64).reshape(-1)
    count = min(len(xy), len(color), len(confidence))
    xy, color, confidence = xy[:count], color[:count], confidence[:count]
    with np.errstate(invalid="ignore", over="ignore"):
        good = (
            np.isfinite(xy).all(axis=1)
            & (confidence >= settings.confidence_min)
            & (np.hypot(xy[:, 0], xy[:, 1]) <= settings.range_max_m)
        )
    xy, color = xy[good], color[good]
    color = np.where((color < 0) | (color >= N_COLORS), int(ConeColor.UNKNOWN), color)
    return xy, color


GATE_VOTES_MIN = 2.5  # sightings as a big orange cone before one is believed; old votes fade


class ConeMemory:
    """Cones in the odometry frame, as arrays with one row per cone."""

    def __init__(self, settings: PlannerSettings) -> None:
        self._settings = settings
        self.clear()

    def clear(self) -> None:
        self._xy: Floats = np.zeros((0, 2))
        self._hits: Floats = np.zeros(0)
        self._misses: Floats = np.zeros(0)
        self._votes: Floats = np.zeros((0, N_COLORS))
        self._side: Floats = np.zeros(0)  # by the lane: votes for left minus votes for right
        self._seen_at_m: Floats = np.zeros(0)
        self.total = 0  # cones ever believed

    def __len__(self) -> int:
        return len(self._xy)

    def add(self, xy_m: Floats, color: Ints, motion: Motion) -> None:
        """Take in one observation: vehicle-frame positions and colours, seen from `motion`."""
        settings = self._settings
        seen = np.zeros(len(self._xy), dtype=bool)
        before = self._hits >= settings.hits_to_believe
        if len(xy_m):
            at = to_odometry(motion, xy_m)
            new = np.ones(len(at), dtype=bool)
            if len(self._xy):
                gap = np.hypot(at[:, None, 0] - self._xy[None, :, 0], at[:, None, 1] - self._xy[None, :, 1])
                nearest = gap.argmin(axis=1)
                rows = np.arange(len(at))
                mutual = gap[:, nearest].argmin(axis=0) == rows
                same = mutual & (gap[rows, nearest] <= settings.same_cone_m)
                new = ~same & (gap[rows, nearest] > DUPLICATE_M)
                known = nearest[same]
                seen[known] = True
                self._hits[known] += 1
                share = 1.0 / np.minimum(self._hits[known], settings.average_over)
                self._xy[known] += share[:, None] * (at[same] - self._xy[known])
                self._votes[known] *= 1.0 - 1.0 / 30.0  # a wrong colour of long ago fades
                self._votes[known, color[same]] += 1.0
                self._seen_at_m[known] = motion.distance_m
            self._append(at[new], color[new], motion.distance_m)
            seen = np.concatenate((seen, np.ones(int(new.sum()), dtype=bool)))
            before = np.concatenate((before, np.zeros(int(new.sum()), dtype=bool)))
        if len(self._xy):
            here = to_vehicle(motion, self._xy)
            reach = np.hypot(here[:, 0], here[:, 1])
            in_view = (
                (reach < settings.view_range_m)
                & (reach > 2.5)
                & (np.abs(np.arctan2(here[:, 1], here[:, 0])) < settings.view_half_angle_rad)
            )
            self._misses[in_view & ~seen] += 1.0
            self.total += int(((self._hits >= settings.hits_to_believe) & ~before).sum())
            keep = (
                (here[:, 0] > -settings.behind_m)
                & (reach < 3.0 * settings.range_max_m)
                & (motion.distance_m - self._seen_at_m < settings.age_m)
                & (self._hits >= settings.hit_ratio_min * (self._hits + self._misses))
                # Seen once or twice and then missed as often: not a cone.
                & ~((self._hits <= 2.0) & (self._misses > self._hits))
            )
            self._drop(keep)

    def _append(self, at: Floats, color: Ints, distance_m: float) -> None:
        count = len(at)
        if not count:
            return
        votes = np.zeros((count, N_COLORS))
        votes[np.arange(count), color] = 1.0
        self._xy = np.concatenate((self._xy, at))
        self._hits = np.concatenate((self._hits, np.ones(count)))
        self._misses = np.concatenate((self._misses, np.zeros(count)))
        self._votes = np.concatenate((self._votes, votes))
        self._side = np.concatenate((self._side, np.zeros(count)))
        self._seen_at_m = np.concatenate((self._seen_at_m, np.full(count, distance_m)))

    def _drop(self, keep: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> None:
        if keep.all():
            return
        self._xy, self._hits, self._misses = self._xy[keep], self._hits[keep], self._misses[keep]
        self._votes, self._side, self._seen_at_m = self._votes[keep], self._side[keep], self._seen_at_m[keep]

    def around(self, motion: Motion) -> Cones:
        """The cones believed, as seen from `motion`."""
        here = to_vehicle(motion, self._xy)
        index = np.flatnonzero(
            (self._hits >= self._settings.hits_to_believe)
            & (np.hypot(here[:, 0], here[:, 1]) <= self._settings.range_max_m)
        )
        votes = self._votes[index].copy()
        # A gate stops the car and counts its laps: it takes more than a slip of the detector to make one.
        big = votes[:, ConeColor.BIG_ORANGE]
        votes[(big < GATE_VOTES_MIN) | (big <= 0.5 * votes[:, 1:].sum(axis=1)), ConeColor.BIG_ORANGE] = 0.0
        colored = votes[:, 1:]
        # A colour counts where it was seen in at least every third look: colourless sightings do not outvote it.
        has_color = colored.max(axis=1, initial=0.0) * 3.0 >= self._votes[index].sum(axis=1) - 1e-9
        color = np.where(has_color & (colored.sum(axis=1) > 0), colored.argmax(axis=1) + 1, 0)
        by_color = np.where(color == ConeColor.BLUE, 1.0, np.where(color == ConeColor.YELLOW, -1.0, 0.0))
        by_lane = np.clip(self._side[index] / 4.0, -0.6, 0.6)
        side = np.where(by_color != 0.0, by_color, by_lane)
        return Cones(here[index], color.astype(np.int64), side, index)

    def vote(self, index: Ints, side: Floats) -> None:
        """The lane has these cones on its left (+1) or right (-1), surely or less so."""
        self._side[index] = np.clip(self._side[index] + side, -6.0, 6.0)
