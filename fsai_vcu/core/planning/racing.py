"""Laps after the first: the map of the lap driven, the race line in it, and the way from the car along that line."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.laps import LapState
from fsai_vcu.core.planning.cone_map import LOST_M, ConeMap
from fsai_vcu.core.planning.lane import BACKWARD_M
from fsai_vcu.core.planning.pose import NO_PATH, headings_along, to_odometry
from fsai_vcu.core.planning.race_line import CONE_RADIUS_M, LineSearch, RaceLine, clear
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.planning.slip import Slip
from fsai_vcu.core.vehicle.parameters import VehicleParameters

HORIZON_M = 70.0  # of the path handed on
# Beyond the line, the lap's first cones are seen again or are not; where they stand evenly along a straight, what comes
# behind it tells where the car is, but no further on than half a lap.
CLOSING_M, CLOSING_MOST_M = (10.0, 40.0), 120.0
UNCLOSED = "no race: the cones at the lap's end do not show where the lap began"
SEARCH_EVERY_M = 2.0
GATE_DOUBT_M = 1.5  # of the line's place, seen by its gate …
LAP_DOUBT = 0.03  # … and else, by a lap's way
FIT_MIN, FIT_TO_JOIN = 0.5, 0.7
ON_LINE = "a cone stands on the race line"
NOT_ON_LINE = "the car is not on the race line"
STEADY = 10  # observations in a row that allow the line before it is joined
JOINING_M, JOINING_S = 8.0, 1.5  # of way in which the car comes onto the line, with its speed …
JOINING_SHARES = 1.0, 0.75, 0.5  # … or a share of it, so as not to leave the room beside the line in the next corner
# Cut off at the room's end, a way has a kink: by so much it does not matter, and by more than this it cannot be driven.
WITHIN_M, BEYOND_M = 0.02, 0.2
BEHIND_JOINING = 20  # points of the line: so little behind the place where it joined the car is before it
ASIDE_JOINING_M, ASIDE_M, TURNED_RAD = 1.2, 0.8, 0.5  # further off, the car is not on the line
MIDDLE_M = 15.0  # of the lane's middle, ahead of the car
LOOK_M = 20.0  # how far ahead the path is compared with the cones seen
BESIDE_M, BESIDE_PER_M = 0.2, 0.02  # what must be left beside the body to a cone seen, and its doubt by its distance


class Racing:
    """Maps from the start; once a lap is closed, gives the race line. Until then, and in doubt, it gives no path."""

    def __init__(self, car: VehicleParameters, settings: PlannerSettings, motion: Motion) -> None:
        """Begin at the pose of `motion`, with an empty map and without a race line."""
        self._car, self._settings = car, settings
        self._map = ConeMap(settings, motion)
        self._passages: list[LapState] = []  # the states right after the line was passed
        self._search: LineSearch | None = None
        self._line: RaceLine | None = None
        self._next_line: RaceLine | None = None  # laid again: it follows once the car can come onto it
        self._joined_at: int | None = None
        self._offsets: Floats = np.zeros(0)  # of the path from the line, from where it was joined
        self._leaving = False  # the car has left the line, and is not in the middle of the lane yet
        self._into_lane: tuple[Floats, float] | None = None  # offsets of the path from the lane's, and from where on
        self._steady = 0
        self._searched_at_m = motion.distance_m
        self._unclosed = ""
        self.note = ""

    @property
    def located(self) -> bool:
        """The car's place in a closed map is known."""
        return self._map.closed and self._map.fit > FIT_MIN

    @property
    def confidence(self) -> float:
        """Degree to which the cones seen lately confirm the map, 0…1."""
        return self._map.fit

    @property
    def slip(self) -> Slip:
        """The slip of the rear axle, as the map has shown it."""
        return self._map.slip

    def see(self, seen_xy_m: Floats, motion: Motion) -> Motion:
        """Take in the cones seen (vehicle frame). Returns the car's motion in the map frame."""
        here = self._map.add(seen_xy_m, motion)
        if self._map.closed and not self.located and self._may_search(motion):
            here = self._map.find(seen_xy_m)
        return here

    def _may_search(self, motion: Motion) -> bool:
        """A search takes as long as some observations' other work: not at each of them."""
        if motion.distance_m < self._searched_at_m + SEARCH_EVERY_M:
            return False
        self._searched_at_m = motion.distance_m
        return True

    def close(self, state: LapState, motion: Motion) -> LapState:
        """Close the map once a lap is behind the car, and put the line back where it was when the lap began."""
        passages = self._passages
        del passages[state.passages :]  # one may have been taken back
        if state.passages > len(passages):
            passages.append(state)
        if self._map.closed or len(passages) < 2:
            return state
        begun, ended = passages[-2], passages[-1]
        assert begun.passed_at_m is not None and ended.passed_at_m is not None
        beyond_m = motion.distance_m - ended.passed_at_m
        most_m = max(CLOSING_M[1], min(CLOSING_MOST_M, 0.5 * (ended.passed_at_m - begun.passed_at_m)))
        self._unclosed = UNCLOSED if beyond_m >= most_m else ""
        if not CLOSING_M[0] < beyond_m < most_m or not self._may_search(motion):
            return state
        drift, doubt_m = (0.0, 0.0), max(LOST_M, LAP_DOUBT * (ended.passed_at_m - begun.passed_at_m))
        if begun.sighted and ended.sighted:
            drift, doubt_m = (begun.line.x_m - ended.line.x_m, begun.line.y_m - ended.line.y_m), GATE_DOUBT_M
        if not self._map.close(begun.passed_at_m, ended.passed_at_m, drift, doubt_m):
            return state
        return replace(state, line=replace(begun.line, at_distance_m=motion.distance_m))

    def path(self, cones_xy_m: Floats, here: Motion) -> Floats:
        """(M, 2) the way on along the race line, in the vehicle frame; nothing where it cannot be trusted.

        `cones_xy_m`: what was lately seen to stand around the car (vehicle frame): it outranks the map.
        """
        on_line = self._joined_at is not None
        self._look_for_line(here)
        path, self.note = self._along_line(cones_xy_m, here)
        if self.note:
            self._leaving |= on_line
            self._joined_at, self._steady = None, 0
        elif len(path):
            self._leaving, self._into_lane = False, None
        return path

    def into_lane(self, path_m: Floats, half_width_m: float, motion: Motion) -> Floats:
        """The lane's path, (M, 2), vehicle frame; for a car that left the race line, one that begins at the car.

        Over the way in which a car joins the line it comes onto the lane's path. A car out of the lane, or one that
        would come out of it on this way, gets the lane's path as it is.
        """
        if not self._leaving or len(path_m) < 2:
            return path_m
        step_m = self._settings.path_step_m
        cos, sin = headings_along(path_m)
        first = int(np.hypot(path_m[:, 0], path_m[:, 1]).argmin())
        if self._into_lane is None:
            left_m = float(path_m[first, 0] * sin[first] - path_m[first, 1] * cos[first])
            turned_rad = -math.atan2(float(sin[first]), float(cos[first]))
            room_m = half_width_m - 0.5 * self._car.width_m - CONE_RADIUS_M
            way = longest_way((left_m, turned_rad, 0.0), motion, step_m, lambda way: float(np.abs(way).max()) - room_m)
            nose_m = left_m + self._car.nose_ahead_of_rear_axle_m * math.sin(turned_rad)
            in_lane = max(abs(left_m), abs(nose_m)) <= room_m and np.abs(way).max() <= room_m + BEYOND_M
            if not in_lane or abs(turned_rad) > TURNED_RAD:
                self._leaving = False
                return path_m
            self._into_lane = way.clip(-room_m, room_m), motion.distance_m
        way, begun_m = self._into_lane
        left = np.append(way[max(0, round((motion.distance_m - begun_m) / step_m)) :], 0.0)
        if len(left) == 1:
            self._leaving, self._into_lane = False, None
        at = (np.arange(len(path_m)) - first).clip(0, len(left) - 1)
        return np.asarray(path_m + left[at, None] * np.column_stack((-sin, cos)))

    def middle(self, here: Motion) -> Floats | None:
        """(M, 2) the lane's middle by the map, in the vehicle frame, from behind the car on; None without a line."""
        line = self._line
        if line is None or not self.located:
            return None
        first = line.beside(here)[0] - round(BACKWARD_M / line.step_m)
        at = np.arange(first, first + round((BACKWARD_M + MIDDLE_M) / line.step_m)) % len(line.xy_m)
        return line.path(first, BACKWARD_M + MIDDLE_M, 0.5 * (line.left_m - line.right_m)[at], here)

    def _look_for_line(self, here: Motion) -> None:
        """A share of the work on the line, where the map has changed since it was last worked out."""
        if self._search is None and self._map.closed and self._map.changed:
            self._search = LineSearch(self._map.lap_xy_m, self._map.take(), self._car, self._settings.path_step_m)
        line = self._search.advance() if self._search is not None else None
        if line is not None:
            self._next_line, self._search = line, None
        following = self._next_line
        if following is None:
            return
        if self._joined_at is not None:
            index, left_m, turned_rad = following.beside(here)
            if following.beyond_m(index, way_onto(following, index, left_m, turned_rad, here)) > BEYOND_M:
                return  # the car stays on the line that it is on
        self._line, self._next_line, self._joined_at = following, None, None

    def _along_line(self, cones_xy_m: Floats, here: Motion) -> tuple[Floats, str]:
        """The path, and why there is none where it must not be used."""
        line, joined_at = self._line, self._joined_at
        if line is None:
            return NO_PATH, "" if self._map.closed else self._unclosed
        # Steady until now, the car races: a line laid again is not joined from the lane.
        if self._map.fit < (FIT_MIN if self._steady >= STEADY else FIT_TO_JOIN):
            return NO_PATH, "the cones seen do not agree with the map"
        index, left_m, turned_rad = line.beside(here)
        if joined_at is None:
            self._offsets = way_onto(line, index, left_m, turned_rad, here)
            if line.beyond_m(index, self._offsets) > BEYOND_M:
                return NO_PATH, NOT_ON_LINE
            joined_at, most_m = index, ASIDE_JOINING_M
        else:
            most_m = ASIDE_M
        driven = (index - joined_at) % len(line.xy_m)
        if len(self._offsets) <= driven < len(line.xy_m) - BEHIND_JOINING:  # joined: a lap later it is not joined again
            self._offsets = np.zeros(0)
        offsets = self._offsets[driven:]
        aside_m = left_m - float(offsets[0] if len(offsets) and self._joined_at is not None else 0.0)
        if abs(aside_m) > most_m or abs(turned_rad) > TURNED_RAD:
            return NO_PATH, NOT_ON_LINE
        path = line.path(index, HORIZON_M, offsets, here)
        news = cones_xy_m[line.news(to_odometry(here, cones_xy_m))]
        beside = BESIDE_M - BESIDE_PER_M * np.hypot(news[:, 0], news[:, 1])
        if not clear(path[: round(LOOK_M / line.step_m)], news, beside, self._car):
            return NO_PATH, ON_LINE
        self._steady += 1
        if self._steady < STEADY:
            return NO_PATH, ""
        self._joined_at = joined_at
        return path, ""


def way_onto(line: RaceLine, index: int, left_m: float, turned_rad: float, here: Motion) -> Floats:
    """(N,) how far left of the line the path is, on the longest way onto it that keeps to the room beside the line."""
    bend_1pm = here.yaw_rate_radps / max(here.speed_mps, 1.0) - line.curvature_1pm(index)
    return longest_way((left_m, turned_rad, bend_1pm), here, line.step_m, lambda way: line.beyond_m(index, way))


def longest_way(
    begins: tuple[float, float, float], motion: Motion, step_m: float, beyond_m: Callable[[Floats], float]
) -> Floats:
    """(N,) how far left of a line or lane the path is, on the longest way onto it that keeps to the room beside it.

    begins: how far left the car is, how far turned and bent against it; beyond_m: by how much a way leaves the room.
    """
    length_m = JOINING_M + JOINING_S * motion.speed_mps
    ways = [joining(*begins, share * length_m, step_m) for share in JOINING_SHARES]
    return min(ways, key=lambda way: max(WITHIN_M, beyond_m(way)))


def joining(left_m: float, turned_rad: float, bend_1pm: float, length_m: float, step_m: float) -> Floats:
    """(N,) how far left of the line the path is, from where it leaves the car until it has come onto the line.

    It begins beside the line, turned and bent against it as the car is, and ends with none of that: place, direction
    and curvature have no step.
    """
    share = np.arange(0.0, 1.0, step_m / length_m)
    place = left_m * (1.0 + 3.0 * share + 6.0 * share**2)
    slope = length_m * math.tan(turned_rad) * share * (1.0 + 3.0 * share)
    return np.asarray((1.0 - share) ** 3 * (place + slope + 0.5 * bend_1pm * (length_m * share) ** 2))
