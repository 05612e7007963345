"""Course that a strategy hands to the planner: the way on, as one family of missions finds it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import LOST, Motion
from fsai_vcu.core.planning.cone_memory import ConeMemory, Cones
from fsai_vcu.core.planning.pose import NO_PATH, gaps, headings_along, lengths_along, to_odometry, to_vehicle
from fsai_vcu.core.planning.slip import Slip
from fsai_vcu.interface.units import S
from fsai_vcu.interface.values import Value

BRAKING_DELAY_S = 0.3
BLIND_MAX_M = 12.0  # driven by odometry alone where the way is known from the cones seen before
CONES_MIN = 2  # in one look, that keep a way believed

DOUBTFUL = 0.5  # with no more confidence a note says why
# A car that goes on under the floor of confidence, averaged over some looks, is lost.
FLOOR = 0.3
# Share of the newest look in that average: a look against the way weighs more than one for it, as false cones bear out
# a wrong way in many looks.
NEWEST_AGAINST, NEWEST_FOR = 0.2, 0.07
DOUBTED_M, DOUBTED_S = 1.0, 0.15  # of way, and of time, that may be driven under the floor
FLOOR_AGAIN = 0.5  # with more a look bears its way out
# A lost car that stands drives on with so much, if it lasts: from one place each look shows the same, right or wrong.
SURE_AGAIN, AT_REST_MPS, AGAIN_NS = 0.8, 0.1, 2 * S
SLOWLY_M = 4.0  # of way borne out at most, below that confidence
KEPT_M, KEPT_POINTS = 3.0, 5  # of way, that a path is driven on while looks are in doubt; of a path, at least
STUCK_M = 0.5  # beside its path in a bend tighter than it can turn, a car only gets further off: it is lost at once
ASIDE_M = (0.3, 0.8)  # beside its path: from the first on confidence falls, at the second none is left
BEND_OVER_M = 2.0  # of path, over which the radius of a bend is measured
BENT_TOLERANCE_M = 0.1  # in which two radii are the same
BENT_M = 6.0  # of way, after a bend too tight for the car, on which it may be beside its path because of that
LOST_BRAKING_MPS2 = 4.0
STOP_HERE_M = 0.1  # of way borne out: less than to the car's nose
TURNED_M = 0.7  # a path that leaves the last one by so much, before the car could stop, leads elsewhere
# How far each look moves the path, before the car could stop, in the mean: from the first on confidence falls, at the
# second none is left. One look counts for so much of the mean, and for so much way at most.
MOVED_M, NEWEST_MOVED, MOVED_MOST_M = (0.12, 0.22), 0.1, 0.5
FIT_M = 0.5  # from where it should stand, beyond which a cone does not bear out a course of known shape
FIT_AHEAD_M = 10.0  # so far ahead of the car cones are compared
CONES_TO_FIT = 3  # fewer do not bear out all of it
FIT_NONE, FIT_ALL = 0.3, 0.7  # share of cones that fit anywhere by chance, and that leaves no doubt


class Course(Value, frozen=True):
    """The way on from the car. Fields as in `Plan`, which carries them to the controller, and `slip` as measured."""

    path_m: Floats  # (M, 2) vehicle frame
    laps: int = 0
    finished: bool = False
    stop_distance_m: float | None = None
    supported_m: float = math.inf
    confidence: float = 1.0
    mapped: bool = False
    note: str = ""
    slip: Slip = Slip()


class Strategy(Protocol):
    """Strategy by which a family of missions finds its way."""

    def anchor(self, motion: Motion) -> None:
        """The car stands at its staging place, at `motion`."""

    def plan(self, memory: ConeMemory, seen_xy_m: Floats, motion: Motion) -> Course:
        """The way on, after `memory` has taken in the cones seen (vehicle frame) from `motion`."""


class Blind:
    """Distance that the car has driven since cones were seen."""

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


class Evidence:
    """Judges how far the cones seen bear out the courses of a run, and whether the car is lost.

    A car that is lost brakes to rest on the last way that was not in doubt, and stays there until the cones around it
    show the way again.
    """

    def __init__(self, least_radius_m: float = 0.0) -> None:
        """`least_radius_m`: of the tightest bend that the car can drive."""
        self._least_radius_m = least_radius_m
        self._too_tight: tuple[float, float] | None = None  # the radius of such a bend on the path, and where driven
        self._stuck = False  # too far beside its path in such a bend
        self._sure = 1.0
        self._moved_m = 0.0  # by how much looks move the path, in the mean
        self._doubted_m = 0.0
        self._why = ""
        self._lost = False
        self._clear_ns: int | None = None  # since when a lost car stands and the way is clear again
        self._at_m: float | None = None  # how far driven at the last look
        self._last: tuple[Course, Motion] | None = None  # the last course with a path
        self._trusted: tuple[Course, Motion] | None = None  # the last course that was not in doubt

    def judged(self, course: Course, motion: Motion) -> Course:
        """The course with the confidence that it deserves; the way to a stop where the car is lost."""
        self._stuck = False
        share, why, parting_m = self._against_last(course, motion)
        course = replace(
            course,
            supported_m=course.supported_m if course.mapped else min(course.supported_m, parting_m),
            confidence=share * course.confidence,
            note="; ".join(filter(None, (why, course.note))),
        )
        driven_m = 0.0 if self._at_m is None else max(0.0, motion.distance_m - self._at_m)
        self._at_m = motion.distance_m
        if len(course.path_m) > 1:
            self._last = course, motion
        if course.finished:
            return course
        news = course.confidence - self._sure
        self._sure += (NEWEST_FOR if news > 0.0 else NEWEST_AGAINST) * news
        if self._sure >= FLOOR:
            self._doubted_m = max(0.0, self._doubted_m - 2.0 * driven_m)
        else:
            self._doubted_m += driven_m
        if course.confidence < FLOOR or self._stuck:
            self._why = course.note or self._why
        if min(self._sure, course.confidence) >= FLOOR_AGAIN and not self._lost and len(course.path_m):
            self._trusted = course, motion
        if self._lost:
            self._lost = not self._clear(course, motion)
        elif self._stuck or self._doubted_m > max(DOUBTED_M, DOUBTED_S * motion.speed_mps):
            self._lost, self._clear_ns = True, None
        return self._kept(course, motion)

    def _against_last(self, course: Course, motion: Motion) -> tuple[float, str, float]:
        """The share of a course's confidence that is left by how it follows from the last one, why, and a length (m).

        The length is that of the path up to where it leaves the last one by `TURNED_M`; inf where it does not. Beyond
        that place neither of the two is borne out.
        """
        path = course.path_m
        if len(path) < 2:
            return 1.0, "", math.inf
        aside_m = float(np.hypot(path[:, 0], path[:, 1]).min())
        parting_m = math.inf
        if self._last is not None and self._last[0].mapped == course.mapped:
            before = to_vehicle(motion, to_odometry(self._last[1], self._last[0].path_m))
            reach_m = DOUBTED_M + braking_m(motion.speed_mps, LOST_BRAKING_MPS2)
            along_m, along_before_m = lengths_along(path), lengths_along(before)
            # Looks without a way may lie between the two: only what is left of the last one is the way of both.
            left_m = float(along_before_m[-1] - along_before_m[int(np.hypot(before[:, 0], before[:, 1]).argmin())])
            both_m = along_m[along_m < left_m - DOUBTED_M]
            asides_m = aside_m_of(path[: len(both_m)], before)
            moved_m = float(asides_m[both_m < reach_m].max(initial=0.0))
            self._moved_m += NEWEST_MOVED * (min(moved_m, MOVED_MOST_M) - self._moved_m)
            if (asides_m > TURNED_M).any():
                parting_m = float(along_m[int((asides_m > TURNED_M).argmax())])
            if moved_m > TURNED_M:
                return 0.0, "the path ahead differs from the one a moment ago", parting_m
        radius_m = least_radius_of(path)
        if radius_m < self._least_radius_m - BENT_TOLERANCE_M:
            self._too_tight = radius_m, motion.distance_m
        steady = min(1.0, max(0.0, MOVED_M[1] - self._moved_m) / (MOVED_M[1] - MOVED_M[0]))
        share = (ASIDE_M[1] - aside_m) / (ASIDE_M[1] - ASIDE_M[0])
        moving = f"each look moves the way ahead, by {self._moved_m:.1f} m" if steady < DOUBTFUL else ""
        if share >= 1.0:
            return steady, moving, parting_m
        note = f"the car is {aside_m:.1f} m beside its path"
        if self._too_tight is not None and motion.distance_m - self._too_tight[1] < BENT_M:
            self._stuck = aside_m >= STUCK_M
            note += (
                f" in a bend of {self._too_tight[0]:.1f} m, tighter than the {self._least_radius_m:.1f} m it can turn"
            )
        return steady * max(0.0, share), "; ".join(filter(None, (note, moving))), parting_m

    def _clear(self, course: Course, motion: Motion) -> bool:
        """True once a lost car stands and each look of two seconds has shown the way."""
        if motion.speed_mps > AT_REST_MPS or self._sure < FLOOR_AGAIN or course.confidence < SURE_AGAIN:
            self._clear_ns = None
        elif self._clear_ns is None:
            self._clear_ns = motion.t_ns
        clear = self._clear_ns is not None and motion.t_ns - self._clear_ns >= AGAIN_NS
        if clear:
            self._sure, self._doubted_m = FLOOR_AGAIN, 0.0  # many looks from one place vouch for no more
        return clear

    def _kept(self, course: Course, motion: Motion) -> Course:
        """The way to a stop at once where the car is lost; where one look is in doubt, the last way that was not."""
        way, supported_m = NO_PATH, course.supported_m
        if self._trusted is not None and (self._lost or course.confidence < FLOOR):
            trusted, there = self._trusted
            if self._lost or motion.distance_m < there.distance_m + KEPT_M:
                way = to_vehicle(motion, to_odometry(there, trusted.path_m))
                way = way[int(np.hypot(way[:, 0], way[:, 1]).argmin()) :]
                # Looks in doubt bear out no more of it than the last one that was not.
                supported_m = max(0.0, trusted.supported_m - (motion.distance_m - there.distance_m))
        path = way if len(way) >= KEPT_POINTS else course.path_m
        if not self._lost:
            slowly_m = SLOWLY_M if self._sure < FLOOR_AGAIN else math.inf
            supported_m = min(supported_m, course.supported_m, slowly_m)
            return replace(course, path_m=path, supported_m=supported_m) if len(course.path_m) else course
        note = f"{LOST}{self._why}"
        return replace(course, path_m=path, supported_m=STOP_HERE_M, confidence=0.0, mapped=False, note=note)


class Fit:
    """Compares the cones around the car with a course of known shape: confidence, 0…1."""

    def __init__(self) -> None:
        self._confidence = 1.0

    def of(self, memory: ConeMemory, cones: Cones, seen_xy_m: Floats, off_course: Callable[[Floats], Floats]) -> float:
        """The confidence after a look; a look that saw nothing says nothing.

        `off_course`: (N,) how far (m) places (N, 2, vehicle frame) are from where the course has its cones.
        """
        ahead = (cones.xy_m[:, 0] > 0.0) & (np.hypot(cones.xy_m[:, 0], cones.xy_m[:, 1]) < FIT_AHEAD_M)
        places = cones.xy_m[ahead & memory.sure(cones.index)]
        if len(seen_xy_m) >= CONES_MIN:
            share = np.maximum(0.0, 1.0 - (off_course(places) / FIT_M) ** 2).sum() / max(CONES_TO_FIT, len(places))
            self._confidence = min(max((float(share) - FIT_NONE) / (FIT_ALL - FIT_NONE), 0.0), 1.0)
        return self._confidence


def aside_m_of(places_m: Floats, path_m: Floats) -> Floats:
    """(N,) distance (m) of places (N, 2) from a path that they are beside."""
    nearest = gaps(places_m, path_m).argmin(axis=1)
    off, (cos, sin) = places_m - path_m[nearest], headings_along(path_m)
    return np.asarray(np.abs(off[:, 1] * cos[nearest] - off[:, 0] * sin[nearest]))


def least_radius_of(path_m: Floats) -> float:
    """Radius (m) of a path's tightest bend; inf for one shorter than a bend is measured over."""
    along = lengths_along(path_m)
    until = int(np.searchsorted(along, along[-1] - BEND_OVER_M, side="right"))
    cos, sin = headings_along(path_m)
    before = slice(until)
    later = np.minimum(np.searchsorted(along, along[before] + BEND_OVER_M), len(path_m) - 1)
    across = cos[before] * sin[later] - sin[before] * cos[later]
    turned = np.abs(np.arctan2(across, cos[before] * cos[later] + sin[before] * sin[later]))
    return float(((along[later] - along[before]) / np.maximum(turned, 1e-9)).min(initial=math.inf))


def braking_m(speed_mps: float, deceleration_mps2: float) -> float:
    """Way in which the car comes to rest."""
    return speed_mps * BRAKING_DELAY_S + speed_mps**2 / (2.0 * deceleration_mps2)
