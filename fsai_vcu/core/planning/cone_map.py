"""The cones of a whole lap, and where among them the car is.

The map frame is the odometry frame of the run's beginning, but the car's pose in it is corrected by every cone that is
seen again: what is left of odometry's drift is that of a lap, not of each metre. When the lap is closed that rest is
known, and is spread over the lap's way. From then on the cones stand, and the car is found among them.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.arrays import Bools, Floats, Ints
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.planning.cone_memory import aside, in_view, joined, matched
from fsai_vcu.core.planning.pose import NO_PATH, gaps, resampled_ring, to_odometry, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.planning.slip import Slip

NEAR_M = 25.0  # cones further from the car cannot be seen
RECENT_M = 30.0  # of way: before the lap is closed, a cone not seen for longer is not in sight now
LATELY_M = 54.0  # of way: cones seen for the first time in it tell where in the map the car is
VIEW_M = 14.0  # cones come into view about this far ahead
BELIEVED_HITS = 3.0
AVERAGE_OVER = 20.0  # sightings in a cone's mean
TRUST_GAIN, TRUST_NEW, TRUST_MIN = 0.15, 0.5, 0.2  # of the share of looks at a cone's place that find it
MOVED_M = 0.1  # a cone so far from where it was when the map was taken has moved, …
BORDER_M = 4.0  # … which matters within this distance of the driven path

GATE_M = 0.8  # a cone seen further than this from every known one is not matched
SIGMA_M, SIGMA_PER_M = 0.05, 0.01  # of a cone seen, with its distance
DRIFT_M, DRIFT_PER_M = 0.004, 0.01  # of odometry between two observations
DRIFT_RAD, DRIFT_RAD_PER_M = 0.0007, 0.0015
CLOSED_LOOSER = 3.0  # a whole map is believed more, and raced in: wheels slip more
SETTLED = 0.02  # m and rad: a pose moved by less is moved once
FIT_GAIN = 0.2
TAKING_FIT = 0.6  # a car that is lost does not change the map
TRACK_STEP_M, RING_STEP_M = 0.5, 2.0
SHARED_M = 1.0  # a border between two parts of the lap belongs to both

LOST_M = 8.0  # how far from where it is thought to be the car may be found
# Looking for the car around a guess: coarsely first, then at the best places apart from each other
SEARCH_STEP_M = 1.5
SEARCH_M = np.arange(-6.0, 6.1, SEARCH_STEP_M)
SEARCH_SEEN = 20
SEARCH_RAD = np.arange(-0.16, 0.17, 0.08)
SEARCH_GATE_M, SEARCH_APART_M, SEARCH_PLACES = 2.0, 2.0, 4
SEARCH_CONES, SEARCH_FIT, SEARCH_LEAD = 6, 0.8, 0.15  # so many cones, all but some fit, and elsewhere fit worse

_CONE = np.dtype(
    [
        ("xy", np.float64, 2),
        ("hits", np.float64),
        ("trust", np.float64),
        ("first_m", np.float64),  # distance driven when it was first …
        ("last_m", np.float64),  # … and last seen
        ("way_m", np.float64),  # mean of the distances driven when it was seen
        ("known", np.float64, 2),  # where it was when the map was last taken
    ]
)


class ConeMap:
    """Cones in the map frame. `here` is the car in it; `fit` (0…1) says how well the cones seen agree with the map."""

    def __init__(self, settings: PlannerSettings, motion: Motion) -> None:
        self._settings = settings
        self._cones = np.zeros(0, _CONE)
        self._track: list[tuple[float, float, float]] = []  # distance driven and place, of the car
        self._odometry = self.here = motion
        self.fit = 0.0
        self.slip = Slip()
        self.closed = False
        self.lap_xy_m: Floats = NO_PATH  # the driven path in the lap that was closed …
        self._ring_xy_m: Floats = NO_PATH  # … and coarsely
        self.changed = False  # since it was last taken

    @property
    def _believed(self) -> Bools:
        return np.asarray(self._cones["hits"] >= BELIEVED_HITS)

    @property
    def _established(self) -> Bools:
        """Select the cones that tell where the car is.

        A car that begins to be lost puts new cones where it thinks to see them.
        """
        return self._believed & (self._cones["first_m"] < self.here.distance_m - RECENT_M)

    def take(self) -> Floats:
        """(N, 2) the cones believed. From now on `changed` tells whether they are still the same."""
        self.changed = False
        believed = self._believed
        self._cones["known"] = np.where(believed[:, None], self._cones["xy"], np.inf)
        return np.array(self._cones["xy"][believed])

    def add(self, seen_xy_m: Floats, motion: Motion) -> Motion:
        """Find the car in the map by the cones seen (vehicle frame), and take these in. The car in the map frame."""
        step_m = abs(motion.distance_m - self._odometry.distance_m)
        here = self._carried(motion)
        cones = self._cones
        near = np.hypot(cones["xy"][:, 0] - here.x_m, cones["xy"][:, 1] - here.y_m) < NEAR_M
        if self.closed:
            seen_xy_m = seen_xy_m[self._of_this_part(to_odometry(here, seen_xy_m), here)]
            near[near] = self._of_this_part(cones["xy"][near], here)
            firm = near & self._established
        else:
            near &= cones["last_m"] > motion.distance_m - RECENT_M
            firm = near & self._believed
        if len(seen_xy_m) and firm.any():
            loose = CLOSED_LOOSER if self.closed else 1.0
            drift_m, drift_rad = DRIFT_M + DRIFT_PER_M * step_m, DRIFT_RAD + DRIFT_RAD_PER_M * step_m
            carried, here = here, registered(here, seen_xy_m, cones["xy"][firm], loose * drift_m, loose * drift_rad)
            if self.closed and self.fit > TAKING_FIT:
                dx, dy = here.x_m - carried.x_m, here.y_m - carried.y_m
                left_m = dy * math.cos(carried.yaw_rad) - dx * math.sin(carried.yaw_rad)
                self.slip = self.slip.after(step_m, motion.speed_mps * motion.yaw_rate_radps, left_m)
        fit = fit_of(here, seen_xy_m, cones["xy"][firm])
        self.fit += FIT_GAIN * (fit - self.fit)
        self.here = here
        if not self.closed and (not self._track or motion.distance_m > self._track[-1][0] + TRACK_STEP_M):
            self._track.append((motion.distance_m, here.x_m, here.y_m))
        if not self.closed or self.fit > TAKING_FIT:
            self._take_in(seen_xy_m, np.flatnonzero(near))
        return here

    def find(self, seen_xy_m: Floats) -> Motion:
        """Look for the car some metres around where it was thought to be."""
        cones = self._cones["xy"][self._established]
        around = np.hypot(cones[:, 0] - self.here.x_m, cones[:, 1] - self.here.y_m) < NEAR_M
        self.here = located(self.here, LOST_M, seen_xy_m, cones[around]) or self.here
        return self.here

    def close(self, begun_m: float, ended_m: float, drift_m: tuple[float, float], doubt_m: float = LOST_M) -> bool:
        """Close the lap that was driven between two passages of its line, when the distances driven were these.

        `drift_m`: from where things are found at the lap's end to where they were at its beginning, within `doubt_m`.
        False where the cones do not match yet.
        """
        self._cones = self._cones[self._cones["last_m"] > begun_m - RECENT_M]
        cones, here = self._cones, self.here
        old = self._believed & (cones["first_m"] < begun_m + max(RECENT_M, here.distance_m - ended_m))
        again = self._believed & (cones["first_m"] > ended_m - VIEW_M) & ~old
        lately = again & (cones["first_m"] > here.distance_m - LATELY_M)
        guess = replace(here, x_m=here.x_m + drift_m[0], y_m=here.y_m + drift_m[1])
        found = located(guess, doubt_m, to_vehicle(here, cones["xy"][lately]), cones["xy"][old])
        if found is None:
            return False
        driven = self._spread(found, begun_m)
        way = np.array([way for way, _, _ in self._track])
        lately = way > begun_m - RECENT_M  # laps before this one were driven along the same way
        self._merge(old, again, ended_m - begun_m, way[lately], driven[lately])
        self.here, self.closed, self.changed, self.fit = found, True, True, 1.0
        lap = driven[way >= begun_m]
        # Where drift has moved the line, the lap ends where it began, not where the line was passed.
        end = _lengths(lap - lap[0]) + np.where(way[way >= begun_m] > ended_m - VIEW_M, 0.0, np.inf)
        self.lap_xy_m = lap[: int(end.argmin())]
        self._ring_xy_m = resampled_ring(self.lap_xy_m, RING_STEP_M)
        return True

    def _of_this_part(self, xy_m: Floats, here: Motion) -> Bools:
        """Select the places (map frame) beside the part of the lap that the car is in.

        Another part may pass nearby; how the two lie to each other is known only within what odometry drifts between.
        """
        ring = self._ring_xy_m
        apart = np.abs(np.arange(len(ring)) - gaps(np.array([[here.x_m, here.y_m]]), ring).argmin())
        part = np.minimum(apart, len(ring) - apart) * RING_STEP_M < RECENT_M
        away = gaps(xy_m, ring)
        return np.asarray(away[:, part].min(axis=1) < away.min(axis=1) + SHARED_M)

    def _carried(self, motion: Motion) -> Motion:
        """The car in the map frame by its last place there and odometry since."""
        last, here = self._odometry, self.here
        self._odometry = motion
        # The same as to_vehicle and to_odometry; for one point these take ten times as long.
        cos, sin = math.cos(last.yaw_rad), math.sin(last.yaw_rad)
        dx, dy = motion.x_m - last.x_m, motion.y_m - last.y_m
        ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
        cos, sin = math.cos(here.yaw_rad), math.sin(here.yaw_rad)
        x, y = here.x_m + cos * ahead - sin * left, here.y_m + sin * ahead + cos * left
        yaw = here.yaw_rad + math.remainder(motion.yaw_rad - last.yaw_rad, 2.0 * math.pi)
        return replace(motion, x_m=x, y_m=y, yaw_rad=yaw)

    def _take_in(self, seen_xy_m: Floats, near: Ints) -> None:
        """Take the cones seen into the map: average those that are known, add those that are new."""
        settings, here, cones = self._settings, self.here, self._cones
        at = to_odometry(here, seen_xy_m)
        found = np.zeros(len(cones), dtype=bool)
        new = np.ones(len(at), dtype=bool)
        if len(at) and len(near):
            nearest, gap, mutual = matched(at, cones["xy"][near])
            same = mutual & (gap <= settings.same_cone_m)
            # In a closed map a cone of another part of the lap may be the same one, just across the parts' border.
            new = (gaps(at, cones["xy"]).min(axis=1) if self.closed else gap) > settings.same_cone_m
            known = near[nearest[same]]
            found[known] = True
            cones["hits"][known] += 1.0
            share = 1.0 / np.minimum(cones["hits"][known], AVERAGE_OVER)
            cones["xy"][known] += share[:, None] * (at[same] - cones["xy"][known])
            cones["way_m"][known] += share * (here.distance_m - cones["way_m"][known])
            cones["last_m"][known] = here.distance_m
            cones["trust"][known] += TRUST_GAIN * (1.0 - cones["trust"][known])
        local = to_vehicle(here, cones["xy"][near])
        missed = near[in_view(_lengths(local), aside(local), settings) & ~found[near]]
        cones["trust"][missed] *= 1.0 - TRUST_GAIN
        gone = missed[cones["trust"][missed] < TRUST_MIN]
        moved = near[_lengths(cones["xy"][near] - cones["known"][near]) > MOVED_M]
        news = np.concatenate((gone, moved))
        news = news[cones["hits"][news] >= BELIEVED_HITS]
        if len(news) and len(self.lap_xy_m):
            self.changed |= bool(gaps(cones["xy"][news], self.lap_xy_m).min() < BORDER_M)
        if len(gone):
            cones = np.delete(cones, gone)
        if new.any():
            added = np.zeros(int(new.sum()), _CONE)
            added["xy"], added["hits"], added["trust"], added["known"] = at[new], 1.0, TRUST_NEW, np.inf
            added["first_m"] = added["last_m"] = added["way_m"] = here.distance_m
            cones = joined(cones, added)
        self._cones = cones

    def _spread(self, found: Motion, begun_m: float) -> Floats:
        """Bend the driven path, and the cones seen from it, so that it ends where the car was found. Returns the way.

        The heading's error is spread over the way first, and what is left of the place's error then.
        """
        cones, here = self._cones, self.here
        track = np.array([*self._track, (here.distance_m, here.x_m, here.y_m)])
        way, place = track[:, 0], track[:, 1] + 1j * track[:, 2]
        share = np.clip((way - begun_m) / (way[-1] - begun_m), 0.0, 1.0)
        turn = np.exp(1j * share * math.remainder(found.yaw_rad - here.yaw_rad, 2.0 * math.pi))
        bent = place[0] + np.concatenate(([0.0], (np.diff(place) * turn[1:]).cumsum()))
        bent += share * (complex(found.x_m, found.y_m) - bent[-1])
        at = np.minimum(way.searchsorted(cones["way_m"]), len(way) - 1)
        moved = bent[at] + (cones["xy"] @ (1.0, 1j) - place[at]) * turn[at]
        cones["xy"] = np.column_stack((moved.real, moved.imag))
        return np.column_stack((bent.real, bent.imag))[:-1]

    def _merge(self, old: Bools, again: Bools, lap_m: float, way_m: Floats, driven_xy_m: Floats) -> None:
        """Leave one of the several sightings of a cone in different parts of the lap.

        What was seen at the beginning of the lap and again at its end is one cone. Any other is known best from where
        the car passed nearest to it; seen from elsewhere, across the track, it may be off by some of the drift.
        """
        cones = self._cones
        first, second = np.flatnonzero(old), np.flatnonzero(again)
        gap = gaps(cones["xy"][second], cones["xy"][first])
        same = gap.min(axis=1) < GATE_M
        cones["last_m"][first[gap.argmin(axis=1)[same]]] = self.here.distance_m
        passed_m = way_m[::4][gaps(cones["xy"], driven_xy_m[::4]).argmin(axis=1)]
        apart_m = np.abs(passed_m - cones["way_m"])
        across = apart_m > RECENT_M
        across[first] &= np.abs(lap_m - apart_m)[first] > RECENT_M
        across[second] = False
        self._cones = np.delete(cones, np.concatenate((second[same], np.flatnonzero(across))))


def registered(here: Motion, seen_xy_m: Floats, fixed_xy_m: Floats, drift_m: float, drift_rad: float) -> Motion:
    """The pose near `here` from which the cones seen stand where they are known to, weighed against drift."""
    prior = np.array(((drift_m**-2, 0.0, 0.0), (0.0, drift_m**-2, 0.0), (0.0, 0.0, drift_rad**-2)))
    total = np.zeros(3)  # moved so far: x, y, yaw
    spread = SIGMA_M + SIGMA_PER_M * _lengths(seen_xy_m)
    for _ in range(2):
        at = to_odometry(here, seen_xy_m)
        error = fixed_xy_m[gaps(at, fixed_xy_m).argmin(axis=1)] - at
        size = np.maximum(_lengths(error), 1e-9)
        weight = np.where(size < GATE_M, np.minimum(1.0, 2.0 * spread / size) / spread**2, 0.0)  # Huber's
        arm_x, arm_y = at[:, 0] - here.x_m, at[:, 1] - here.y_m
        sum_w, sum_x, sum_y = weight.sum(), weight @ arm_x, weight @ arm_y
        moment = weight @ (arm_x * error[:, 1] - arm_y * error[:, 0])
        inertia = weight @ (arm_x**2 + arm_y**2)
        normal = np.array([[sum_w, 0.0, -sum_y], [0.0, sum_w, sum_x], [-sum_y, sum_x, inertia]])
        pull = np.array([weight @ error[:, 0], weight @ error[:, 1], moment])
        step = np.linalg.solve(normal + prior, pull - prior @ total)
        total += step
        x, y, yaw = here.x_m + float(step[0]), here.y_m + float(step[1]), here.yaw_rad + float(step[2])
        here = replace(here, x_m=x, y_m=y, yaw_rad=yaw)
        if abs(step).max() < SETTLED:
            break
    return here


def located(guess: Motion, doubt_m: float, seen_xy_m: Floats, fixed_xy_m: Floats) -> Motion | None:
    """The pose from which the cones seen stand where they are known to, searched for around the guess.

    `doubt_m`: a place so far from the guess must fit better by a tenth of all cones.

    None where they fit nowhere, or about as well at two places: cones stand at even distances.
    """
    if len(seen_xy_m) < SEARCH_CONES or not len(fixed_xy_m):
        return None
    fixed = fixed_xy_m @ (1.0, 1j)
    # For a pose that may be further off, the cones next to the car must do at the first look.
    wide = doubt_m > LOST_M
    steps = np.arange(-doubt_m, doubt_m + 0.1, SEARCH_STEP_M) if wide else SEARCH_M
    first = seen_xy_m[_lengths(seen_xy_m).argsort()[:SEARCH_SEEN]] if wide else seen_xy_m
    shifts = (steps[:, None] + 1j * steps).ravel()
    turned = [replace(guess, yaw_rad=guess.yaw_rad + float(turn)) for turn in SEARCH_RAD]
    costs = np.empty((len(turned), len(shifts)))
    for row, pose in enumerate(turned):
        at = to_odometry(pose, first) @ (1.0, 1j)
        gap = np.abs(shifts[:, None, None] + at[:, None] - fixed).min(axis=2)
        costs[row] = np.minimum(gap, SEARCH_GATE_M).sum(axis=1)
    found: list[tuple[float, Motion]] = []
    for _ in range(SEARCH_PLACES):
        row, place = divmod(int(costs.argmin()), len(shifts))
        shift = shifts[place]
        costs[:, np.abs(shifts - shift) < SEARCH_APART_M] = np.inf
        pose = replace(turned[row], x_m=guess.x_m + float(shift.real), y_m=guess.y_m + float(shift.imag))
        for _ in range(5):
            pose = registered(pose, seen_xy_m, fixed_xy_m, 1.0, 0.3)
        if all(math.hypot(pose.x_m - other.x_m, pose.y_m - other.y_m) > GATE_M for _, other in found):
            away_m = math.hypot(pose.x_m - guess.x_m, pose.y_m - guess.y_m)
            found.append((fit_of(pose, seen_xy_m, fixed_xy_m) - 0.1 * (away_m / doubt_m) ** 2, pose))
    found.sort(key=lambda each: each[0], reverse=True)
    unique = len(found) == 1 or found[1][0] < found[0][0] - SEARCH_LEAD
    return found[0][1] if found[0][0] > SEARCH_FIT and unique else None


def fit_of(here: Motion, seen_xy_m: Floats, fixed_xy_m: Floats) -> float:
    """Return how well the cones seen from `here` fit the known ones: 1 all and exactly, 0 none (or none seen)."""
    if not len(seen_xy_m) or not len(fixed_xy_m):
        return 0.0
    gap = gaps(to_odometry(here, seen_xy_m), fixed_xy_m).min(axis=1)
    return float(np.maximum(0.0, 1.0 - (gap / GATE_M) ** 2).sum() / max(len(gap), 3))


def _lengths(vectors: Floats) -> Floats:
    return np.hypot(vectors[:, 0], vectors[:, 1])
