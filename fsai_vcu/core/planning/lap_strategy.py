"""Autocross and trackdrive: a lane found in the cones around the car, and laps counted."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.arrays import Bools, Floats, Ints
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.laps import GATE_DEPTH_M, Circling, advance_laps, gate_middle, gate_seen, staged
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.cone_memory import BIG, EXPECTED, SIDES, ConeMemory, Cones
from fsai_vcu.core.planning.course import CONES_MIN, DOUBTFUL, KEPT_POINTS, Course, braking_m
from fsai_vcu.core.planning.lane import ACROSS_M, Known, find_lane
from fsai_vcu.core.planning.pose import NO_PATH, gaps, headings_along, lengths_along, to_odometry, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.units import S

if TYPE_CHECKING:
    from fsai_vcu.core.planning.racing import Racing

GATE_WIDER_M = 1.0  # a gate's cones may stand this much further out than the lane's border
SURE = 0.5  # confidence with which the lane found is believed in the next look
KNOWN_M = 0.5  # distance from a confirmed cone within which a cone seen is that cone
NEWEST_KNOWN = 0.1  # share of the newest look in the average of the share of such cones …
KNOWN_NONE, KNOWN_SPAN = (0.55, 0.4), 0.25  # … that leaves no confidence without and with colours; to full confidence
KNOWN_MOST = 0.9  # with a smaller share only cones that most looks find make the lane: others are mostly false
IN_LANE_M, IN_LANE_SHARE = 0.7, 0.4  # a cone so near to the path stands in the lane: so much confidence each leaves
CROSSED_SHARE = 0.2  # of confidence, left where the path crosses a border: between cones of one …
BORDER_APART_M = 5.0  # … at most so far apart
WIDER_M = 0.7  # a cone further beyond the lane's half width than that stands at no border of the path
FURTHER_ON_M = 1.0  # a cone at a border so far beyond two others shows that the path goes on between borders
# A cone that contradicts the lane by so much has a wrong colour, where so few and so small a share of all do.
CONTRARY, MISTAKEN_MOST, MISTAKEN_SHARE = 0.1, 2, 0.2
BEYOND_COS = 0.7  # of the angle between the way from a path to a cone and that on to one beyond it
NEIGHBOURS_MOST = 60  # cones near the path that are looked at: two borders of 30 m have fewer
MARGIN = (0.7, 1.8)  # as in `Known`, with true colours and cones alone; without, or with false cones in each look
MARGIN_M = 2.0, 12.0  # beyond the way to stop, within which a fork is a doubt; likewise
NEW_LOOK_M = 0.02  # of way between two looks that mark cones: from one place each look says the same
AGREED_M, AGREED_MORE_M = 0.4, 1.0  # paths of two looks so near to each other agree; so much more by each look
LAP_BRAKING_MPS2 = 3.0  # comfortable, from the speed at the finish


class LapStrategy:
    """Follow the lane and count laps."""

    def __init__(self, car: VehicleParameters, settings: PlannerSettings, missions: MissionSettings, laps: int) -> None:
        self._car = car
        self._settings = settings
        self._missions = missions
        self._laps = laps
        self._nose_m = car.nose_ahead_of_rear_axle_m
        self._line_ahead_m = self._nose_m + missions.lap_staging_m
        self.anchor(Motion())

    def anchor(self, motion: Motion) -> None:
        """Begin the run, with the car staged at `motion`."""
        self._state = staged(motion, self._line_ahead_m)
        self._half_width_m = self._settings.lane_half_width_min_m
        self._middle: Floats = NO_PATH  # of the lane as found last, in the odometry frame
        self._kept: Floats = NO_PATH  # the last path, in the vehicle frame …
        self._kept_at = Motion()  # … of then
        self._kept_confidence, self._kept_supported_m = 0.0, 0.0
        self._voted_at_m = motion.distance_m  # where a lane found marked its cones last
        self._racing: Racing | None = None
        if self._laps > 1:  # a single lap leaves nothing to race
            from fsai_vcu.core.planning.racing import Racing  # slow to import, so not in the middle of a run

            self._racing = Racing(self._car, self._settings, motion)
        self._known = 1.0  # of the cones seen lately, those that stand where cones have been seen before
        self._circling, self._circle_m = Circling(), 0.0
        self._finished_at_m: float | None = None
        self._stop_m = self._missions.lap_stop_m

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        """Return the way on: along the race line where the map bears it out, else in the lane that the cones make."""
        cones = memory.around(motion)
        sure = memory.sure(cones.index)
        sure_xy_m = cones.xy_m[sure]
        racing = self._racing
        here, path, doubt = motion, NO_PATH, ""
        if racing is not None:
            here = racing.see(seen_xy_m, motion)
            fresh = memory.lately(cones, motion) & sure
            path, doubt = racing.path(cones.xy_m[fresh], here), racing.note
        if racing is not None and len(path):
            reach_m = self._settings.path_step_m * len(path)
            course = Course(path, supported_m=reach_m, confidence=racing.confidence, mapped=True, note=doubt)
            self._kept_confidence = 0.0  # what the last look at the lane found is far behind
        else:
            middle = racing.middle(here) if racing is not None else None
            stands = np.zeros(len(cones.xy_m))
            if len(seen_xy_m) < CONES_MIN and len(self._kept):
                # The same cones once more say nothing new, and from another place less.
                course = self._kept_course(motion, 1.0, "no cones are seen")
            else:
                borders = np.ones(len(sure), dtype=bool) if self._known > KNOWN_MOST else sure
                course, stands[borders] = self._lane(memory, cones.only(borders), motion, middle)
            if racing is not None:
                course = replace(course, path_m=racing.into_lane(course.path_m, self._half_width_m, motion))
            clear, unknown = self._clear_of_false(cones, sure_xy_m, seen_xy_m)
            free, blocked = free_of_cones(course, sure_xy_m)  # along the race line the map itself is held against cones
            standing, known = cones.only(sure), unmistaken(cones.side, stands)[sure]
            side = np.where(other_lanes(standing, stands[sure], course.path_m), hues(standing), known)
            within, crossing = within_borders(course, sure_xy_m, side)
            until_m = until_border_m(course, standing, self._half_width_m, self._nose_m)
            if until_m <= self._nose_m and not crossing:
                within, crossing = CROSSED_SHARE, "the way crosses the border at the last cones"
            notes = (doubt, unknown if clear < DOUBTFUL else "", blocked, crossing, course.note)
            confidence = clear * free * within * course.confidence
            course = replace(
                course,
                # The nose does not pass it.
                supported_m=min(course.supported_m, max(until_m - self._nose_m, 0.0)),
                confidence=confidence,
                note="; ".join(filter(None, notes)),
            )
        self._count(cones, course.path_m, here)
        if racing is not None:
            self._state = racing.close(self._state, here)
        if self._circle_m == 0.0 and self._finished_at_m is None:
            self._circle_m = self._circling.length_m(self._state, motion) or 0.0
        if self._circle_m > 0.0:
            note = f"the car drives in a circle of {self._circle_m:.0f} m that does not pass the line"
            course = Course(NO_PATH, supported_m=0.0, confidence=0.0, note=note)
        left = None
        if self._finished_at_m is not None:
            left = max(0.0, self._finished_at_m + self._stop_m - motion.distance_m)
        if racing is not None:
            course = replace(course, slip=racing.slip)
        return replace(course, laps=self._state.laps, finished=left is not None, stop_distance_m=left)

    def _clear_of_false(self, cones: Cones, sure_xy_m: Floats, seen_xy_m: Floats) -> tuple[float, str]:
        """The share of confidence that is left by cones seen where none stand, and the note on it.

        Without colours fewer of them are enough to make a lane where there is none.
        """
        if len(seen_xy_m) and len(cones.xy_m):
            known = np.count_nonzero(gaps(seen_xy_m, sure_xy_m).min(axis=1, initial=math.inf) < KNOWN_M)
            self._known += NEWEST_KNOWN * (known / len(seen_xy_m) - self._known)
        none = KNOWN_NONE[0] + _share_with_colours(cones) * (KNOWN_NONE[1] - KNOWN_NONE[0])
        share = min(max((self._known - none) / KNOWN_SPAN, 0.0), 1.0)
        return share, f"{100.0 * (1.0 - self._known):.0f} % of the cones seen stand where none was before"

    def _lane(self, memory: ConeMemory, cones: Cones, motion: Motion, middle: Floats | None) -> tuple[Course, Floats]:
        """The way on in the lane that these cones make, and the (N,) sides on which it has them.

        `middle`: the lane's by the map (vehicle).
        """
        curvature = motion.yaw_rate_radps / max(motion.speed_mps, 1.0)
        if middle is None and self._kept_confidence > SURE:
            middle = to_vehicle(motion, self._middle)
        driven = self._circling.driven(motion, self._settings.horizon_m, self._settings.age_m)
        driven_xy_m = to_vehicle(motion, np.array(driven)) if driven else None
        untrusted = max(1.0 - _share_with_colours(cones), min(1.0, (1.0 - self._known) / KNOWN_SPAN))
        margin = MARGIN[0] + untrusted * (MARGIN[1] - MARGIN[0])
        need_m = braking_m(motion.speed_mps, LAP_BRAKING_MPS2) + MARGIN_M[0] + untrusted * (MARGIN_M[1] - MARGIN_M[0])
        known = Known(curvature, self._half_width_m, memory.view_m, middle, driven_xy_m, margin, need_m)
        lane = find_lane(cones, known, self._nose_m, self._settings)
        path = lane.path_m
        if len(path):
            self._half_width_m += 0.2 * (lane.half_width_m - self._half_width_m)
            if abs(motion.distance_m - self._voted_at_m) > NEW_LOOK_M:
                self._voted_at_m = motion.distance_m
                memory.vote(cones.index, lane.side)
            self._middle = to_odometry(motion, lane.middle_m)
            supported_m = min(lane.supported_m, memory.view_m)
            self._keep(path, supported_m, lane.confidence, motion)
            return Course(path, supported_m=supported_m, confidence=lane.confidence, note=lane.note), lane.side
        age_ns = motion.t_ns - self._kept_at.t_ns
        share = max(0.0, 1.0 - age_ns / (self._settings.keep_path_ns + 1))
        return self._kept_course(motion, share, lane.note), np.zeros(len(cones.xy_m))

    def _keep(self, path: Floats, supported_m: float, confidence: float, motion: Motion) -> None:
        """Keep a path for looks without cones; as far as the looks before agree, for this one may be the last."""
        if len(self._kept):
            before = to_vehicle(motion, to_odometry(self._kept_at, self._kept))
            apart = np.append(gaps(path, before).min(axis=1), math.inf) > AGREED_M
            driven_m = motion.distance_m - self._kept_at.distance_m
            agreed_m = max(0.0, self._settings.path_step_m * (int(apart.argmax()) - 1))
            before_m = max(0.0, self._kept_supported_m - driven_m) + max(AGREED_MORE_M, driven_m)
            supported_m = min(supported_m, agreed_m, before_m)
        self._kept, self._kept_at, self._kept_confidence = path, motion, confidence
        self._kept_supported_m = supported_m

    def _kept_course(self, motion: Motion, share: float, why: str) -> Course:
        """The last lane that was found, as far as cones bore it out then, with this share of its confidence."""
        path = to_vehicle(motion, to_odometry(self._kept_at, self._kept)) if len(self._kept) else NO_PATH
        path = path[int(np.hypot(path[:, 0], path[:, 1]).argmin()) :] if len(path) else path
        left_m = self._kept_supported_m - (motion.distance_m - self._kept_at.distance_m)
        if share <= 0.0 or left_m <= 0.0 or len(path) < KEPT_POINTS:
            return Course(NO_PATH, supported_m=0.0, confidence=0.0, note=why)
        note = f"{why}: path kept from {(motion.t_ns - self._kept_at.t_ns) / S:.1f} s ago"
        return Course(path, supported_m=left_m, confidence=share * self._kept_confidence, note=note)

    def _count(self, cones: Cones, path: Floats, motion: Motion) -> None:
        """Correct the line by the gate, or by the map, and count the passages of it."""
        gate = cones.xy_m[cones.color == BIG]
        if self._racing is not None and self._racing.located:
            # The car's place in the map tells it better than the gate.
            self._state = replace(self._state, line=replace(self._state.line, at_distance_m=motion.distance_m))
        elif len(gate) >= 2 and len(path) >= 3:
            middle = _gate_across(gate, path, self._half_width_m)
            if middle is not None:
                at = to_odometry(motion, middle[0][None, :])[0]
                self._state = gate_seen(
                    self._state,
                    float(at[0]),
                    float(at[1]),
                    motion.yaw_rad + middle[1],
                    motion,
                    self._missions.lap_min_m,
                )
        self._state = advance_laps(self._state, motion, self._missions.lap_min_m)
        if self._state.laps < self._laps:
            self._finished_at_m = None
        elif self._finished_at_m is None:
            self._finished_at_m = motion.distance_m
            # Comfortable from any speed, within what the rules allow; a gate that is due may still come into sight.
            least_m, most_m = self._missions.lap_stop_m, self._missions.lap_stop_max_m
            if self._state.line.seen and not self._state.sighted:
                least_m = 0.5 * (least_m + most_m)
            self._stop_m = min(max(least_m, braking_m(motion.speed_mps, LAP_BRAKING_MPS2)), most_m)


def _share_with_colours(cones: Cones) -> float:
    return np.count_nonzero(cones.color) / max(1, len(cones.color))


def free_of_cones(course: Course, sure_xy_m: Floats) -> tuple[float, str]:
    """The share of confidence that is left by cones (vehicle frame) that stand in the lane, and the note on it."""
    path = course.path_m
    if not (len(path) and len(sure_xy_m)):
        return 1.0, ""
    borne_out = path[lengths_along(path) <= course.supported_m]
    away_m = gaps(sure_xy_m, borne_out).min(axis=1, initial=math.inf)
    inside = int(np.count_nonzero(away_m < IN_LANE_M))
    return IN_LANE_SHARE**inside, f"{inside} cone{'s' * (inside != 1)} in the lane" if inside else ""


def unmistaken(side: Floats, stands: Floats) -> Floats:
    """Sides of cones (N,) as they are known, but 0 for a few that the lane has on its other side.

    A detector may take a cone's colour for the other one in every look, and each such cone would make a border of its
    own. stands: (N,) side on which the lane has them, +1 certainly on its left … -1 certainly on its right.
    """
    contrary = side * stands < -CONTRARY
    if np.count_nonzero(contrary) > min(MISTAKEN_MOST, MISTAKEN_SHARE * np.count_nonzero(stands)):
        return side
    known: Floats = np.where(contrary, 0.0, side)
    return known


def hues(cones: Cones) -> Floats:
    """(N,) the sides on which the cones stand by their colours alone: +1 left, -1 right, 0 without one."""
    sides: Floats = SIDES.take(cones.color)
    return sides


def other_lanes(cones: Cones, stands: Floats, path_m: Floats) -> Bools:
    """Select the cones (N,) whose colour contradicts the lane and that have the other colour beyond them.

    Where no border of this lane stands there, another one runs, or the right one, and the colour is no mistake.
    stands: as in `unmistaken`; path_m: (M, 2) vehicle frame.
    """
    hue = hues(cones)
    contrary = (hue * stands < -CONTRARY).nonzero()[0]
    chosen = np.zeros(len(hue), dtype=bool)
    if len(contrary) and len(path_m):
        places = cones.xy_m[contrary]
        nearest = gaps(places, path_m).argmin(axis=1)
        outward = places - path_m[nearest]
        to_others = cones.xy_m - places[:, None]
        apart_m = np.hypot(to_others[..., 0], to_others[..., 1])
        away_m = (to_others * outward[:, None]).sum(axis=2)
        beyond = away_m > BEYOND_COS * apart_m * np.hypot(outward[:, 0], outward[:, 1])[:, None]
        lane = beyond & (apart_m > ACROSS_M[0]) & (apart_m < ACROSS_M[1]) & (hue * hue[contrary, None] < 0.0)
        # Beside a path's ends, outward is along it.
        beside = (nearest > 0) & (nearest < len(path_m) - 1)
        chosen[contrary] = beside & (lane & (stands == 0.0)).any(axis=1)
    return chosen


def within_borders(course: Course, sure_xy_m: Floats, side: Floats) -> tuple[float, str]:
    """The share of confidence that is left by a path between two neighbouring cones of one border, and the note on it.

    A border has two cones at least on each side of such a path: one cone alone may have a wrong colour.
    side: (N,) of the cones (N, 2, vehicle frame), as in `Cones`.
    """
    path = course.path_m[lengths_along(course.path_m) <= course.supported_m] if len(course.path_m) else course.path_m
    if len(path) < 2 or not len(sure_xy_m):
        return 1.0, ""
    away_m = gaps(sure_xy_m, path).min(axis=1)
    nearest = away_m.argsort(kind="stable")[:NEIGHBOURS_MOST]
    nearest = nearest[np.abs(side[nearest]) > EXPECTED]
    border, sign = sure_xy_m[nearest], np.sign(side[nearest])
    one, other = neighbours(border, sign)
    apart = crossings(path, border[one], border[other]).any(axis=0)
    accompanied = np.bincount(np.concatenate((one[~apart], other[~apart])), minlength=len(border)) > 0
    between = sign[one[apart & accompanied[one] & accompanied[other]]]
    if len(between):
        return CROSSED_SHARE, f"the way crosses the {'left' if between.max() > 0.0 else 'right'} border"
    return 1.0, ""


def until_border_m(course: Course, sure: Cones, half_width_m: float, nose_m: float) -> float:
    """Return the length (m) of path up to where it passes between two cones of one colour that border it; inf if none.

    There it leads out of the lane, or one of the two has a wrong colour. Cones that border it further on, each on the
    side of its colour, show the latter; as long as none are seen, the path is not borne out beyond that place.
    nose_m: the car may stand so far beyond the end of what is borne out.
    """
    path = course.path_m
    if len(path) < 2 or not len(sure.xy_m):
        return math.inf
    along_m = lengths_along(path)
    away_m, colour = gaps(sure.xy_m, path), hues(sure)
    least_m, nearest = away_m.min(axis=1), away_m.argmin(axis=1)
    chosen = least_m.argsort(kind="stable")[:NEIGHBOURS_MOST]
    chosen = chosen[(least_m[chosen] < half_width_m + WIDER_M) & (colour[chosen] != 0.0)]
    border, sign, at = sure.xy_m[chosen], colour[chosen], nearest[chosen]
    one, other = neighbours(border, sign)
    if not len(one):
        return math.inf
    off, (cos, sin) = border - path[at], headings_along(path)
    own_side = (off[:, 1] * cos[at] - off[:, 0] * sin[at]) * sign > 0.0
    last = np.maximum(along_m[at[one]], along_m[at[other]]) > along_m[at[own_side]].max(initial=0.0) - FURTHER_ON_M
    reached = path[along_m <= course.supported_m + nose_m]
    crossed = crossings(reached, border[one[last]], border[other[last]]).any(axis=1)
    return float(along_m[int(crossed.argmax())]) if crossed.any() else math.inf


def neighbours(border_m: Floats, sign: Floats) -> tuple[Ints, Ints]:
    """Pairs of cones, (P,) and (P,), that stand near to each other with one sign; border_m: (N, 2), sign: (N,)."""
    one, other = np.nonzero(np.triu((gaps(border_m, border_m) < BORDER_APART_M) & (sign[:, None] == sign), 1))
    return one, other


def crossings(path_m: Floats, begin_m: Floats, end_m: Floats) -> Bools:
    """Crossings, (M - 1, P): true where a part of a path (M, 2) crosses the line between the places (P, 2) of a row."""
    step, line = np.diff(path_m, axis=0)[:, None], (end_m - begin_m)[None]
    to_begin, to_end = begin_m[None] - path_m[:-1, None], end_m[None] - path_m[:-1, None]
    after = to_begin - step
    ends_apart = _across(step, to_begin) * _across(step, to_end) < 0.0
    meets = ends_apart & (_across(line, to_begin) * _across(line, after) <= 0.0)
    return np.asarray(meets)


def _across(one: Floats, other: Floats) -> Floats:
    cross: Floats = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return cross


def _gate_across(gate_xy_m: Floats, path_m: Floats, half_width_m: float) -> tuple[Floats, float] | None:
    """Middle (vehicle frame) and direction of the nearest gate across the path, or None.

    Cones further off than the lane's border are not of this lane: another one may pass on the border's far side.
    """
    cos, sin = headings_along(path_m)
    along = lengths_along(path_m)
    dx, dy = gate_xy_m[:, None, 0] - path_m[None, :, 0], gate_xy_m[:, None, 1] - path_m[None, :, 1]
    nearest = (dx * dx + dy * dy).argmin(axis=1)
    rows = np.arange(len(nearest))
    dx, dy = dx[rows, nearest], dy[rows, nearest]
    ahead = dx * cos[nearest] + dy * sin[nearest]
    lateral = dy * cos[nearest] - dx * sin[nearest]
    station = along[nearest] + ahead
    of_lane = (np.abs(lateral) < half_width_m + GATE_WIDER_M) & (np.abs(lateral) > 0.6)
    good = of_lane & (np.abs(ahead) < 3.0) & (along[nearest] < 15.0)
    if not good.any():
        return None
    first = float(station[good].min())
    good &= station < first + GATE_DEPTH_M
    if good.sum() < 2:
        return None
    left = lateral[good] > 0.0
    middle = gate_middle(gate_xy_m[good], left)
    index = int(nearest[good][0])
    if left.all() or not left.any():
        index = int(np.abs(along - station[good].mean()).argmin())
        middle = path_m[index]
    return middle, math.atan2(float(sin[index]), float(cos[index]))
