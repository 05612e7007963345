"""The cones around the car, remembered in the odometry frame: a detector forgets, misses and invents; this does less.

Repeated sightings of a cone are averaged. A cone is believed after some sightings, and dropped when looks at its place
no longer find it, when it is far behind, and when it has not been seen for a long way.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fsai_vcu.core.arrays import Bools, Floats, Ints
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion
from fsai_vcu.core.planning.pose import gaps, to_odometry, to_vehicle, within
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.interface.values import Value

N_COLORS = len(ConeColor)
BIG = int(ConeColor.BIG_ORANGE)  # compared with an array it takes a ninth of the time of an enum's member
SIDES = np.array([{ConeColor.BLUE: 1.0, ConeColor.YELLOW: -1.0}.get(color, 0.0) for color in ConeColor])
DUPLICATE_M = 0.35  # two cones cannot stand nearer: their feet are 0.23 to 0.29 m wide


class Cones(Value, frozen=True):
    """Cones believed. xy_m: (N, 2) vehicle frame; color: (N,) ConeColor; side: (N,) +1 left … -1 right, 0 unknown;
    index: (N,) their place in the memory."""

    xy_m: Floats
    color: Ints
    side: Floats
    index: Ints

    def only(self, chosen: Bools) -> Cones:
        """Return the cones that are chosen, (N,)."""
        return Cones(self.xy_m[chosen], self.color[chosen], self.side[chosen], self.index[chosen])


def believable(observation: ConeObservation, settings: PlannerSettings) -> tuple[Floats, Ints]:
    """Positions (vehicle frame) and colours of the cones of an observation that can be used at all."""
    xy = np.asarray(observation.xy_m, dtype=np.float64).reshape(-1, 2)
    color = np.asarray(observation.color, dtype=np.int64).reshape(-1)
    confidence = np.asarray(observation.confidence, dtype=np.float64).reshape(-1)
    count = min(len(xy), len(color), len(confidence))
    xy, color, confidence = xy[:count], color[:count], confidence[:count]
    with np.errstate(invalid="ignore", over="ignore"):
        # What is not finite is not within range either.
        good = (confidence >= settings.confidence_min) & (np.hypot(xy[:, 0], xy[:, 1]) <= settings.range_max_m)
    xy, color = xy[good], color[good]
    color = np.where((color < 0) | (color >= N_COLORS), int(ConeColor.UNKNOWN), color)
    return xy, color


_CONE = np.dtype(
    [
        ("xy", np.float64, 2),
        ("hits", np.float64),
        ("misses", np.float64),
        ("votes", np.float64, N_COLORS),
        ("side", np.float64),  # by the lane: votes for left minus votes for right
        ("seen_at_m", np.float64),
    ]
)
SURE_SIDE = 0.3  # of a cone's side, from -1 to 1: beyond it the cone is not expected on the other one
BESIDE_M = 2.5  # a cone so near may be out of view beside the car
VIEW_KEPT = 0.999  # from look to look, of how far cones were seen
# There most looks may miss a cone that stands; false ones must not gather there all the same while the car stands.
MISSED_AT_THE_EDGE = 1.0 / 3.0
GATE_VOTES_MIN = 2.5  # sightings as a big orange cone before one is believed; old votes fade
# The cones of a border stand in a row: so near each other, and turning so little (cosine of the angle) that it is sure.
CHAIN_GAP_M, CHAIN_COS = 5.0, 0.9
# A track has no more cones in range than that, nor a cone so many neighbours; a message may.
AROUND_MOST, IN_ROWS_MOST = 200, 16
CHAIN_PASSES = 2  # so many wrong colours one after the other are found
EXPECTED = 0.5  # the side of a cone in line with a border's end
NEWEST = 0.1  # share of the newest look in the average of how many cones turn out to be none
DISPLACED_M = 0.6  # by so much, all cones together, the doubt is that of a cone in each look that turns out to be none
# Of way: in 10 m of a hairpin odometry drifts by some 0.4 m; the same times how far off a cone stands: it turns, too.
LATELY_M, LATELY_M2 = 5.0, 15.0
DRIFTED_M = 1.3  # a cone come into view again may stand so far from its place in memory: from there on it counts
# A cone that comes into view again, and is missed, mostly stands elsewhere by now: share of its hits that a miss takes.
STALE_MISSED = 0.5
OUTVOTED_MOST = 2  # cones around the car whose colour the lane may outvote
OUTVOTES = 3.0  # so many sure looks at a cone on the other side of the lane weigh as much as its colour


class ConeMemory:
    """Cones in the odometry frame, one row of `_CONE` each."""

    def __init__(self, settings: PlannerSettings) -> None:
        self._settings = settings
        self.clear()

    def clear(self) -> None:
        self._cones = np.zeros(0, _CONE)
        self.total = 0  # cones ever believed
        self.view_m, self._view_rad = 0.0, 0.0  # how far, and how far to a side, cones are seen
        # Cones that lately turned out to be none; how far all known ones stand from their places in the newest look.
        self._none_per_look, self._displaced_m = 0.0, 0.0

    def __len__(self) -> int:
        return len(self._cones)

    @property
    def doubt(self) -> float:
        """The doubt in the cones, 0 to 1: how many lately turned out to be none, and how far known ones moved together.

        The detector errs, or the odometry.
        """
        return min(1.0, max(self._none_per_look, self._displaced_m / DISPLACED_M))

    def add(self, xy_m: Floats, color: Ints, motion: Motion) -> None:
        """Take in one observation: vehicle-frame positions and colours, seen from `motion`."""
        settings = self._settings
        cones = self._cones
        seen = np.zeros(len(cones), dtype=bool)
        before = cones["hits"] >= settings.hits_to_believe
        self.view_m, self._view_rad = VIEW_KEPT * self.view_m, VIEW_KEPT * self._view_rad
        self._displaced_m = 0.0
        if len(xy_m):
            self.view_m = max(self.view_m, float(np.maximum.reduce(np.hypot(xy_m[:, 0], xy_m[:, 1]))))
            self._view_rad = max(self._view_rad, float(np.maximum.reduce(aside(xy_m))))
            at = to_odometry(motion, xy_m)
            new = np.ones(len(at), dtype=bool)
            if len(cones):
                xy = cones["xy"]
                nearest, gap, mutual = matched(at, xy)
                unseen = motion.distance_m - cones["seen_at_m"] > LATELY_M
                same = mutual & (gap <= np.where(unseen.take(nearest), DRIFTED_M, settings.same_cone_m))
                # So far off a cone of the other colour is another cone.
                hue = np.sign(cones["votes"].dot(SIDES))
                same &= (gap <= settings.same_cone_m) | (SIDES.take(color) * hue.take(nearest) >= 0.0)
                new = ~same & (gap > DUPLICATE_M)
                known = nearest[same]
                seen[known] = True
                cones["hits"][known] += 1
                off, fresh = at[same] - xy[known], ~unseen[known]
                self._displaced_m = math.hypot(*off[fresh].sum(axis=0)) / max(1, int(np.count_nonzero(fresh)))
                share = np.where(fresh, 1.0 / np.minimum(cones["hits"][known], settings.average_over), 1.0)
                xy[known] += share[:, None] * off
                cones["votes"][known] *= 1.0 - 1.0 / 30.0  # a wrong colour of long ago fades
                cones["votes"][known, color[same]] += 1.0
                cones["seen_at_m"][known] = motion.distance_m
                again = known[~fresh]  # one look alone does not make sure that it stands there now
                cones["hits"][again] = np.minimum(cones["hits"][again], settings.hits_to_believe)
                cones["misses"][again] = 0.0
            if count := np.count_nonzero(new):
                added = np.zeros(count, _CONE)
                added["xy"], added["hits"], added["seen_at_m"] = at[new], 1.0, motion.distance_m
                added["votes"][np.arange(count), color[new]] = 1.0
                cones = joined(cones, added)
                seen = np.concatenate((seen, np.ones(count, dtype=bool)))
                before = np.concatenate((before, np.zeros(count, dtype=bool)))
        if len(cones):
            here = to_vehicle(motion, cones["xy"])
            reach = np.hypot(here[:, 0], here[:, 1])
            hits, misses = cones["hits"], cones["misses"]
            angle = aside(here)
            perhaps = (reach < self.view_m) & (angle < self._view_rad)
            missed = np.where(in_view(reach, angle, settings), 1.0, MISSED_AT_THE_EDGE * perhaps)
            unseen = motion.distance_m - cones["seen_at_m"] > LATELY_M
            if len(xy_m):
                missed *= np.where(unseen, np.maximum(1.0, STALE_MISSED * hits), 1.0)
            misses += ~seen * missed
            self.total += int(np.count_nonzero((hits >= settings.hits_to_believe) & ~before))
            # Seen once or twice and then missed as often: not a cone.
            none = (hits < settings.hit_ratio_min * (hits + misses)) | ((hits <= 2.0) & (misses > hits))
            self._none_per_look += NEWEST * (np.count_nonzero(none & ~unseen) - self._none_per_look)
            keep = (
                (here[:, 0] > -settings.behind_m)
                & (reach < 3.0 * settings.range_max_m)
                & (motion.distance_m - cones["seen_at_m"] < settings.age_m)
                & ~none
            )
            self._cones = cones if np.count_nonzero(keep) == len(keep) else cones[keep]

    def around(self, motion: Motion) -> Cones:
        """The cones believed, as seen from `motion`; the nearest of ever so many."""
        known = self._cones
        here = to_vehicle(motion, known["xy"])
        believed = known["hits"] >= self._settings.hits_to_believe
        reach = np.hypot(here[:, 0], here[:, 1])
        index = (believed & (reach <= self._settings.range_max_m)).nonzero()[0]
        if len(index) > AROUND_MOST:
            index = np.sort(index[reach[index].argsort(kind="stable")[:AROUND_MOST]])
        here = here[index]
        seen = known["votes"][index]
        votes = seen.copy()
        # A gate stops the car and counts its laps: it takes more than a slip of the detector to make one.
        big = votes[:, BIG]
        big[(big < GATE_VOTES_MIN) | (big <= 0.5 * votes[:, 1:].sum(axis=1))] = 0.0
        hues = votes[:, 1:]
        # A colour counts where it was seen in at least every third look: colourless sightings do not outvote it.
        has_color = hues.max(axis=1, initial=0.0) * 3.0 >= seen.sum(axis=1) - 1e-9
        color = np.where(has_color & (hues.sum(axis=1) > 0), hues.argmax(axis=1) + 1, 0)
        colored, rows = SIDES.take(color), rows_of(here)
        by_color = by_chain(colored, rows)
        lane = known["side"][index]
        # The side on which lanes have had a cone, look after look, outvotes its colour, but not between two such.
        contrary = np.where(_between_own(by_color, rows), by_color, within(by_color + lane / OUTVOTES, 1.0))
        if np.count_nonzero(by_color * contrary < 0.0) > OUTVOTED_MOST:
            contrary = by_color  # so many wrong colours are rarer than a wrong lane
        by_lane = within(lane / 4.0, 0.6)
        side = np.where(by_color == 0.0, by_lane, np.where(by_color * lane < 0.0, contrary, by_color))
        side = carried_on(side, colored == 0.0, rows)
        return Cones(here, color.astype(np.int64), side, index)

    def sure(self, index: Ints) -> Bools:
        """Select those of these cones that most looks at their place find: two false ones may have been there."""
        hits, misses = self._cones["hits"][index], self._cones["misses"][index]
        return np.asarray((hits > self._settings.hits_to_believe) & (hits > 2.0 * misses))

    def lately(self, cones: Cones, motion: Motion) -> Bools:
        """Select those of these cones whose places odometry's drift since they were last seen has hardly moved."""
        since_m = motion.distance_m - self._cones["seen_at_m"][cones.index]
        return np.asarray((since_m < LATELY_M) & (since_m * np.hypot(*cones.xy_m.T) < LATELY_M2))

    def vote(self, index: Ints, side: Floats) -> None:
        """The lane has these cones on its left (+1) or right (-1), certainly or less so."""
        known = self._cones["side"]
        known[index] = within(known[index] + side, 6.0)


def matched(at: Floats, known: Floats) -> tuple[Ints, Floats, Bools]:
    """Return for each place (N, 2) the nearest of the known ones (M, 2), its distance, and whether it is nobody else's.

    Each is (N,); the last is true where no other place is nearer to the known one.
    """
    gap = gaps(at, known)
    nearest = gap.argmin(axis=1)
    return nearest, np.minimum.reduce(gap, axis=1), gap.argmin(axis=0).take(nearest) == np.arange(len(at))


def joined(cones: Any, more: Any) -> Any:
    """The rows of both, which are of one type and hold nothing but floats. (A tenth of the time of joining records.)"""
    return np.concatenate((cones.view(np.float64), more.view(np.float64))).view(cones.dtype)


def aside(here: Floats) -> Floats:
    """(N,) the angle to a side at which each place (N, 2, vehicle frame) is seen."""
    return np.abs(np.arctan2(here[:, 1], here[:, 0]))


def in_view(reach: Floats, angle: Floats, settings: PlannerSettings) -> Bools:
    """(N,) whether a cone so far off, at such an angle to a side, would be seen if it stood."""
    return (reach > BESIDE_M) & (reach < settings.view_range_m) & (angle < settings.view_half_angle_rad)


class ConeRows(Value, frozen=True):
    """Rows among N cones: neighbours near enough to each other to be one border's, in line. The last is no cone.

    whom: (N + 1, K) each cone's neighbours, N where there is none; beyond: (N + 1, K, K) whether a neighbour's own
    neighbour stands in line behind it; between: (N + 1, K, K) whether the cone itself stands in line between two.
    """

    whom: Ints
    beyond: Bools
    between: Bools


def rows_of(xy_m: Floats) -> ConeRows:
    """The rows in cones (N, 2)."""
    count = len(xy_m)
    dx, dy = xy_m[:, 0] - xy_m[:, :1], xy_m[:, 1] - xy_m[:, 1:]
    length = np.hypot(dx, dy)
    near = (length > 0.0) & (length < CHAIN_GAP_M)
    if count and np.maximum.reduce(near.sum(axis=1)) > IN_ROWS_MOST:
        nearest_m = np.partition(np.where(near, length, np.inf), IN_ROWS_MOST - 1, axis=1)
        near &= length <= nearest_m[:, IN_ROWS_MOST - 1, None]
    pair = near.ravel().nonzero()[0]
    cone, neighbour = np.divmod(pair, count)
    place = np.arange(len(cone)) - cone.searchsorted(cone)  # the neighbour's among those of its cone
    shape = count + 1, int(np.maximum.reduce(place, initial=0)) + 1
    whom, (x, y) = np.full(shape, count), np.zeros((2, *shape))  # each neighbour, and the unit vector to it
    slot, size = cone * shape[1] + place, length.take(pair)
    whom.put(slot, neighbour)
    x.put(slot, dx.take(pair) / size)
    y.put(slot, dy.take(pair) / size)
    ahead, across = x[:, :, None], y[:, :, None]
    return ConeRows(
        whom,
        ahead * x.take(whom, axis=0) + across * y.take(whom, axis=0) > CHAIN_COS,
        ahead * x[:, None] + across * y[:, None] < -CHAIN_COS,
    )


def by_chain(side: Floats, rows: ConeRows) -> Floats:
    """Return the sides (+1, -1, 0 unknown) of cones by their colours, but 0 for those in a border of the other colour.

    A border also counts at its end as far as it is seen: there the lane says it. A cone is in a border of the other
    colour that is in line with two of the other colour, one after the other, and neither with two of its own nor
    between two of its own.
    """
    if not np.count_nonzero(side):
        return side
    known = np.append(side, 0.0)
    for _ in range(CHAIN_PASSES):
        contrary = _in_other_border(known, rows)
        if not np.count_nonzero(contrary):
            break
        known[contrary] *= -1.0
    return np.where(known[:-1] == side, side, 0.0)


def _in_other_border(known: Floats, rows: ConeRows) -> Bools:
    """Select the cones in a border of the other colour. known: (N + 1,) sides by colour, the last one 0."""
    of_neighbour = known.take(rows.whom)
    own, other = of_neighbour * known[:, None] > 0.0, of_neighbour * known[:, None] < 0.0
    of_next = of_neighbour.take(rows.whom, axis=0)  # of each neighbour's own neighbours
    in_line = ((of_neighbour[:, :, None] * of_next > 0.0) & rows.beyond).any(axis=2)  # two of one colour, one behind …
    contrary = np.asarray((other & in_line).any(axis=1))  # … the other
    if np.count_nonzero(contrary):
        contrary &= ~((own & in_line).any(axis=1) | _between(own, rows))
    return contrary


def _between_own(side: Floats, rows: ConeRows) -> Bools:
    """Select the cones (N,) that stand in line between two of their own side."""
    known = np.append(side, 0.0)
    return _between(known.take(rows.whom) * known[:, None] > 0.0, rows)[:-1]


def _between(chosen: Bools, rows: ConeRows) -> Bools:
    """Select the cones (N + 1,) in line between two chosen neighbours. chosen: (N + 1, K), as in `ConeRows.whom`."""
    return np.asarray((chosen[:, :, None] & chosen[:, None] & rows.between).any(axis=(1, 2)))


def carried_on(side: Floats, colourless: Bools, rows: ConeRows) -> Floats:
    """Return the sides of cones; those without a colour carry on the border whose last two cones they are in line with.

    Those beside the lane already do not. Nor do they where the other border ends nearby as well and nothing is in line
    with it: in a sharp bend the outer border stands straight on from the inner one's end.
    """
    sure = np.abs(side) > SURE_SIDE
    if not np.count_nonzero(colourless & ~sure):
        return side
    whom, known = rows.whom, np.append(np.where(sure, side, 0.0), 0.0)
    its = known.take(whom)
    same = its * known[:, None]
    onward = (rows.between & (same > 0.0)[:, None]).any(axis=2) & (same >= 0.0) & (whom < len(side))
    cone, place = (onward & (its == 0.0)).nonzero()
    carried = np.sign(np.bincount(whom[cone, place], np.sign(known[cone]), len(known)))
    ends = (known != 0.0) & ~onward.any(axis=1)
    contested = (ends.take(whom) & (its * carried[:, None] < 0.0)).any(axis=1)
    new = ((carried != 0.0) & ~contested)[:-1] & colourless
    return np.where(new, EXPECTED * carried[:-1], side)
