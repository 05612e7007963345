"""Evidence: when a planner doubts its course, when it is lost, and when it knows the way again."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from msgspec.structs import replace

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.cone_memory import ConeMemory, Cones
from fsai_vcu.core.planning.course import (
    DOUBTED_M,
    FLOOR,
    KEPT_M,
    SLOWLY_M,
    SURE_AGAIN,
    Course,
    Evidence,
    Fit,
    aside_m_of,
    least_radius_of,
)
from fsai_vcu.core.planning.lap_strategy import (
    MISTAKEN_MOST,
    LapStrategy,
    free_of_cones,
    other_lanes,
    unmistaken,
    until_border_m,
    within_borders,
)
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.planning.pose import NO_PATH, to_vehicle
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState

LOOK_NS, SPEED_MPS = 50_000_000, 4.0
STRAIGHT = np.column_stack((np.arange(0.0, 20.0, 0.5), np.zeros(40)))
SURE = Course(STRAIGHT, supported_m=15.0)
UNSURE = replace(SURE, confidence=0.1, note="a fork")


def looks(speed_mps: float = SPEED_MPS, begin: Motion | None = None) -> Iterator[Motion]:
    """The car's motion straight on, look after look."""
    motion = begin or Motion(speed_mps=speed_mps)
    while True:
        step_m = speed_mps * LOOK_NS / 1e9
        way = motion.x_m + step_m
        motion = replace(
            motion, t_ns=motion.t_ns + LOOK_NS, x_m=way, distance_m=motion.distance_m + step_m, speed_mps=speed_mps
        )
        yield motion


def lost() -> tuple[Evidence, Motion]:
    """A planner that has become so, and where."""
    evidence, motion = Evidence(), Motion()
    for count, motion in enumerate(looks()):
        if evidence.judged(SURE if count < 20 else UNSURE, motion).note.startswith("lost"):
            break
    return evidence, motion


def test_a_course_borne_out_is_handed_on_as_it_is() -> None:
    evidence = Evidence()
    assert all(evidence.judged(SURE, motion) == SURE for motion, _ in zip(looks(), range(50), strict=False))


def test_lasting_doubt_is_lost_before_the_car_is_far() -> None:
    evidence, begun_m = Evidence(), None
    for count, motion in enumerate(looks()):
        course = evidence.judged(SURE if count < 20 else UNSURE, motion)
        if count == 20:
            begun_m = motion.distance_m
        if course.note.startswith("lost"):
            break
    assert begun_m is not None and DOUBTED_M < motion.distance_m - begun_m < 4.0
    assert course.note == "lost: a fork"
    assert (course.confidence, course.mapped) == (0.0, False) and course.supported_m < 0.5
    assert len(course.path_m) > 20, "it needs a way to stop on"


def test_a_car_that_stands_in_doubt_is_not_lost_yet() -> None:
    evidence = Evidence()
    for motion, _ in zip(looks(0.0), range(200), strict=False):
        assert evidence.judged(UNSURE, motion).note == "a fork"


def test_one_look_elsewhere_does_not_turn_the_car() -> None:
    evidence, aside = Evidence(), replace(SURE, path_m=np.array((0.0, 1.0)) + STRAIGHT)
    for count, motion in enumerate(looks()):
        course = evidence.judged(aside if count == 20 else SURE, motion)
        assert abs(float(course.path_m[0, 1])) < 1e-9
        if count == 20:
            assert course.confidence < FLOOR and "differs" in course.note
        if count == 30:
            break
    assert course == SURE


def test_a_way_found_in_every_other_look_alone_is_lost() -> None:
    evidence, nowhere = Evidence(), replace(SURE, confidence=0.0)
    for count, motion in enumerate(looks()):
        course = evidence.judged(nowhere if count % 2 else SURE, motion)
        if course.note.startswith("lost"):
            break
        assert motion.distance_m < 10.0


def swaying(evidence: Evidence, by_m: float, least: int = 60) -> list[Course]:
    """The courses judged, of a path that each look moves so far, to one side and back."""
    ways = [replace(SURE, path_m=STRAIGHT + np.array((0.0, side * by_m / 2.0))) for side in (1.0, -1.0)]
    return [evidence.judged(ways[count % 2], motion) for motion, count in zip(looks(), range(least), strict=False)]


def test_a_way_that_each_look_moves_is_doubted_then_lost() -> None:
    courses = swaying(Evidence(), 0.35)
    assert courses[2].confidence > 0.9, "one look alone may move it"
    assert any(course.note == "each look moves the way ahead, by 0.2 m" for course in courses)
    assert courses[-1].note.startswith("lost: each look moves the way ahead")


def test_a_way_that_noise_moves_a_little_is_believed() -> None:
    assert all(course.confidence == 1.0 for course in swaying(Evidence(), 0.1))


def test_the_points_of_a_way_may_begin_anywhere_along_it() -> None:
    assert not aside_m_of(STRAIGHT + np.array((0.25, 0.0)), STRAIGHT).any()
    assert aside_m_of(np.array(((3.2, 0.4), (5.0, -0.1))), STRAIGHT) == pytest.approx([0.4, 0.1])
    assert len(aside_m_of(STRAIGHT[:0], STRAIGHT)) == 0


@pytest.mark.parametrize("mapped", [False, True])
def test_where_the_way_is_another_one_it_is_borne_out_so_far(mapped: bool) -> None:
    """One that leads aside from 1 m on; the last one is not driven on beyond that place either. A map bears out more.

    It is 0.7 m aside after 1 m of the way straight on and 1 m of the way aside.
    """
    evidence, aside, before = Evidence(), STRAIGHT.copy(), replace(SURE, mapped=mapped)
    aside[:, 1] += np.maximum(aside[:, 0] - 1.0, 0.0)
    for count, motion in enumerate(looks()):
        course = evidence.judged(before if count < 20 else replace(before, path_m=aside), motion)
        if count == 20:
            break
    assert course.note == "the path ahead differs from the one a moment ago"
    driven_m = SPEED_MPS * LOOK_NS / 1e9
    assert course.supported_m == pytest.approx(SURE.supported_m - driven_m if mapped else 2.2, abs=0.3)


def test_far_ahead_another_way_only_ends_what_is_borne_out() -> None:
    """Aside from 8 m on, where the car could stop before. A look without a way between the two changes nothing."""
    aside, nothing = STRAIGHT.copy(), replace(SURE, path_m=NO_PATH, supported_m=0.0, confidence=0.0)
    aside[:, 1] += np.maximum(aside[:, 0] - 8.0, 0.0)
    for between in ([], [nothing]):
        evidence, motions = Evidence(), looks(2.0)
        for course in (*[SURE] * 20, *between, replace(SURE, path_m=aside)):
            found = evidence.judged(course, next(motions))
        assert found.supported_m == pytest.approx(9.4, abs=0.3) and found.confidence == 1.0


def test_in_a_bend_the_way_is_the_same_after_looks_without_one() -> None:
    """The last way ends before the one that is found again does."""
    turns = np.arange(0.0, 8.0, 0.5) / 9.0
    bend, evidence = 9.0 * np.column_stack((np.sin(turns), 1.0 - np.cos(turns))), Evidence()
    for look in range(37):
        yaw = 0.7 * look / 9.0
        here = Motion(look * LOOK_NS, 9.0 * math.sin(yaw), 9.0 - 9.0 * math.cos(yaw), yaw, 7.0, 7.0 / 9.0, 0.7 * look)
        found = Course(bend, supported_m=7.5) if not 30 <= look < 36 else Course(NO_PATH, supported_m=0.0)
        course = evidence.judged(found, here)
    assert course.confidence == 1.0 and course.supported_m == 7.5 and not course.note


def test_a_way_kept_in_doubt_is_borne_out_no_further_than_before() -> None:
    evidence, far = Evidence(), replace(UNSURE, supported_m=19.0)
    for count, motion in enumerate(looks()):
        course = evidence.judged(SURE if count < 20 else far, motion)
        if count == 22:
            break
    assert course.note == "a fork"
    assert course.supported_m == pytest.approx(SURE.supported_m - 3 * SPEED_MPS * LOOK_NS / 1e9)


def test_a_way_kept_ends_after_some_metres() -> None:
    evidence, bend = Evidence(), replace(UNSURE, path_m=np.array((0.0, 0.1)) + STRAIGHT)
    for count, motion in enumerate(looks(1.0)):
        course = evidence.judged(SURE if count < 20 else bend, motion)
        if course.note.startswith("lost"):
            break
    assert motion.distance_m < 1.0 + KEPT_M + DOUBTED_M


def test_the_farther_beside_its_path_the_less_sure() -> None:
    sure = [
        Evidence().judged(replace(SURE, path_m=np.array((0.0, y)) + STRAIGHT), Motion()) for y in (0.2, 0.5, 0.7, 1.0)
    ]
    confidences = [course.confidence for course in sure]
    assert confidences == sorted(confidences, reverse=True) and (confidences[0], confidences[-1]) == (1.0, 0.0)
    assert sure[0].note == "" and sure[-1].note == "the car is 1.0 m beside its path"


@pytest.mark.parametrize(("radius_m", "least_m", "said"), [(2.9, 4.0, True), (4.2, 4.0, False), (2.9, 2.7, False)])
def test_a_bend_tighter_than_the_car_can_turn_is_named(radius_m: float, least_m: float, said: bool) -> None:
    turned = np.arange(0.0, 3.0, 0.5 / radius_m)
    bend = radius_m * np.column_stack((np.sin(turned), 1.0 - np.cos(turned)))
    course = Evidence(least_m).judged(replace(SURE, path_m=bend + np.array((0.0, 0.6))), Motion())
    tight = " in a bend of 2.9 m, tighter than the 4.0 m it can turn"
    lost = "lost: " * said  # it would only get further off
    assert course.note == f"{lost}the car is 0.6 m beside its path{tight * said}"
    assert least_radius_of(STRAIGHT) > 1e6 and least_radius_of(STRAIGHT[:3]) == np.inf


@pytest.mark.parametrize(
    ("speed", "course", "again"),
    [
        (0.0, SURE, True),
        (0.0, replace(SURE, confidence=SURE_AGAIN), True),
        (0.0, replace(SURE, confidence=SURE_AGAIN - 0.01), False),
        (1.0, SURE, False),
        (0.0, UNSURE, False),
    ],
)
def test_a_lost_car_drives_on_from_rest_when_it_sees_its_way(speed: float, course: Course, again: bool) -> None:
    evidence, there = lost()
    notes = [evidence.judged(course, motion).note for motion, _ in zip(looks(speed, there), range(60), strict=False)]
    assert notes[35].startswith("lost"), "not before two seconds have passed"
    assert (not notes[-1].startswith("lost")) is again


def test_looks_at_rest_vouch_little_for_the_way_after_them() -> None:
    """They are all of one place: a doubt on the way on counts sooner than after looks from everywhere."""

    def driven_m(evidence: Evidence, there: Motion) -> float:
        """The way driven in doubt."""
        for motion in looks(2.0, there):
            if evidence.judged(UNSURE, motion).note.startswith("lost"):
                break
        return motion.distance_m - there.distance_m

    again, at_rest = lost()
    for there in looks(0.0, at_rest):
        if not again.judged(SURE, there).note.startswith("lost"):
            break
    never = Evidence()
    for begin, _ in zip(looks(2.0), range(400), strict=False):
        never.judged(SURE, begin)
    assert driven_m(again, there) < driven_m(never, begin) - 0.2


def test_a_lost_car_waits_for_two_seconds_without_a_doubt() -> None:
    evidence, there = lost()
    for motion, count in zip(looks(0.0, there), range(200), strict=False):
        course = evidence.judged(UNSURE if count % 30 == 0 else SURE, motion)
        assert course.note.startswith("lost")


def test_a_car_in_doubt_drives_slowly_on_the_way_it_has() -> None:
    evidence, doubtful = Evidence(), replace(SURE, confidence=0.4, note="a fork")
    courses = [evidence.judged(doubtful, motion) for motion, _ in zip(looks(), range(60), strict=False)]
    assert courses[0].supported_m == SURE.supported_m, "one look alone slows no car"
    assert courses[-1].supported_m == SLOWLY_M and courses[-1].note == "a fork"


def test_a_finished_mission_stops_where_it_has_to() -> None:
    evidence = Evidence()
    for motion, _ in zip(looks(), range(100), strict=False):
        course = evidence.judged(replace(UNSURE, finished=True, stop_distance_m=5.0), motion)
        assert not course.note.startswith("lost")


ROWS = np.array([(x, y) for x in (1.0, 4.0, 7.0) for y in (1.5, -1.5)])


def beside_rows(xy_m: Floats) -> Floats:
    return np.abs(np.abs(xy_m[:, 1]) - 1.5)


@pytest.mark.parametrize(
    ("moved", "fits"),
    [
        (lambda xy: xy, lambda sure: sure == 1.0),
        (lambda xy: xy + np.array((0.0, 1.0)), lambda sure: sure == 0.0),
        (lambda xy: xy[:2], lambda sure: 0.3 < sure < 1.0),  # too few to bear out all of it
        (lambda xy: xy[:0], lambda sure: sure == 1.0),  # nothing seen says nothing
    ],
)
def test_a_known_course_is_as_sure_as_the_cones_fit(
    moved: Callable[[Floats], Floats], fits: Callable[[float], bool]
) -> None:
    memory, xy = ConeMemory(PlannerSettings()), moved(ROWS)
    for _ in range(5):
        memory.add(xy, np.full(len(xy), int(ConeColor.UNKNOWN)), Motion())
    assert fits(Fit().of(memory, memory.around(Motion()), xy, beside_rows))


@pytest.mark.parametrize(
    ("cone", "share", "note"), [((6.0, 0.3), 0.4, "1 cone in the lane"), ((18.0, 0.0), 1.0, ""), ((6.0, 1.0), 1.0, "")]
)
def test_a_cone_on_the_path_borne_out_leaves_little_confidence(
    cone: tuple[float, float], share: float, note: str
) -> None:
    assert free_of_cones(SURE, np.vstack((ROWS, cone))) == (share, note)


BORDERS = np.array([(x, y) for y in (1.5, -1.5) for x in (0.0, 4.0, 8.0, 12.0)])
LEFT_OR_RIGHT = np.repeat([1.0, -1.0], 4)
AHEAD_M = np.arange(0.0, 14.0, 0.5)
ASTRAY = replace(SURE, path_m=np.column_stack((AHEAD_M, 0.5 * np.maximum(AHEAD_M - 3.0, 0.0))))
CROSSES = (0.2, "the way crosses the left border")


@pytest.mark.parametrize(
    ("course", "side", "said"),
    [
        (SURE, LEFT_OR_RIGHT, (1.0, "")),
        (ASTRAY, LEFT_OR_RIGHT, CROSSES),
        (replace(ASTRAY, supported_m=3.0), LEFT_OR_RIGHT, (1.0, "")),  # so far as it is borne out
        (ASTRAY, np.where(BORDERS[:, 0] == 8.0, -LEFT_OR_RIGHT, LEFT_OR_RIGHT), (1.0, "")),  # of the other colour
        (ASTRAY, 0.5 * LEFT_OR_RIGHT, (1.0, "")),  # of cones only in line with a border
        (SURE, np.where(np.arange(8) == 6, -LEFT_OR_RIGHT, LEFT_OR_RIGHT), (1.0, "")),  # one cone makes no border
        (SURE, np.where(np.arange(8) >= 6, -LEFT_OR_RIGHT, LEFT_OR_RIGHT), CROSSES),
        (replace(SURE, path_m=STRAIGHT[:0]), LEFT_OR_RIGHT, (1.0, "")),
    ],
)
def test_a_way_between_the_cones_of_one_border_is_doubted(
    course: Course, side: Floats, said: tuple[float, str]
) -> None:
    assert within_borders(course, BORDERS, side) == said


@pytest.mark.parametrize(("wrong", "left"), [((6,), (6,)), ((6, 7), ())])
def test_a_few_colours_that_the_lane_contradicts_are_mistaken(wrong: tuple[int, ...], left: tuple[int, ...]) -> None:
    side = LEFT_OR_RIGHT.copy()
    side[list(wrong)] *= -1.0
    assert np.flatnonzero(unmistaken(side, 0.3 * LEFT_OR_RIGHT) == 0.0).tolist() == list(left)


@pytest.mark.parametrize(
    ("beyond_m", "color", "stands", "chosen"),
    [
        ((0.0, 3.2), ConeColor.BLUE, 0.0, [2, 3]),
        ((0.0, 2.5), ConeColor.BLUE, 0.0, [2, 3]),
        ((0.0, 4.4), ConeColor.BLUE, 0.0, [2, 3]),
        ((0.0, 2.3), ConeColor.BLUE, 0.0, []),  # no lane is so narrow,
        ((0.0, 4.6), ConeColor.BLUE, 0.0, []),  # nor so wide
        ((1.8, 2.6), ConeColor.BLUE, 0.0, [2, 3]),
        ((2.6, 1.8), ConeColor.BLUE, 0.0, []),  # rather along the border
        ((0.0, 3.2), ConeColor.YELLOW, 0.0, []),  # another lane's border of the same colour
        ((0.0, 3.2), ConeColor.UNKNOWN, 0.0, []),
        ((0.0, 3.2), ConeColor.BLUE, 0.5, []),  # this lane's border, further on
        ((0.0, -3.2), ConeColor.BLUE, 0.0, []),  # on the path's other side
    ],
)
def test_a_colour_is_no_mistake_where_its_own_lane_has_a_border(
    beyond_m: tuple[float, float], color: ConeColor, stands: float, chosen: list[int]
) -> None:
    """Two cones of the left border are yellow, as those of the right one; beyond them stand two more."""
    xy = np.vstack((BORDERS, BORDERS[2:4] + np.array(beyond_m)))
    hue = np.where(LEFT_OR_RIGHT > 0.0, int(ConeColor.BLUE), int(ConeColor.YELLOW))
    hue[2:4] = int(ConeColor.YELLOW)
    cones = Cones(xy, np.append(hue, 2 * [int(color)]), np.zeros(10), np.arange(10))
    having = np.append(LEFT_OR_RIGHT, 2 * [stands])
    assert np.flatnonzero(other_lanes(cones, having, SURE.path_m)).tolist() == chosen
    assert not other_lanes(cones, -having, SURE.path_m)[2:4].any()  # where the lane has them as their colour says
    assert not other_lanes(cones, having, SURE.path_m[:10])[2:4].any()  # beyond the path's end


@pytest.mark.parametrize(("beyond_m", "note"), [(3.2, "the way crosses the right border"), (6.0, "")])
def test_a_way_into_another_lane_is_doubted_by_two_colours(beyond_m: float, note: str) -> None:
    """Straight on, the left border goes on with two yellow cones, in line; if that lane turns left there, blue ones
    stand beyond them."""
    blue, yellow = int(ConeColor.BLUE), int(ConeColor.YELLOW)
    along = np.arange(0.0, 20.0, 3.0)
    left, right = (np.column_stack((along, np.full(7, y))) for y in (1.5, -1.5))
    xy = np.vstack((left, right, left[3:5] + np.array((0.0, beyond_m))))
    color = np.array([blue, blue, blue, yellow, yellow, blue, blue, *7 * [yellow], blue, blue])
    planner = Planner(CARS["2026"])
    planner.reset(Run(1, Ami.AUTOCROSS, AsState.AS_DRIVING, may_move=True))
    for look in range(10):
        here = Motion(look * LOOK_NS, 0.1 * look, 0.0, 0.0, 2.0, 0.0, 0.1 * look)
        plan = planner.on_cones(ConeObservation(here.t_ns, to_vehicle(here, xy), color, np.ones(len(xy))), here)
    assert plan is not None and plan.note == note


LAST = (12.0, 1.2)  # beside the path, with the last one of the right border 9 m along it


@pytest.mark.parametrize(
    ("last", "color", "further", "until_m"),
    [
        (LAST, ConeColor.YELLOW, (), 10.5),  # the lane turns left there
        (LAST, ConeColor.BLUE, (), math.inf),
        (LAST, ConeColor.UNKNOWN, (), math.inf),
        ((12.0, -1.2), ConeColor.YELLOW, (), math.inf),
        ((12.0, 2.4), ConeColor.YELLOW, (), math.inf),  # another lane's
        ((13.3, 1.2), ConeColor.YELLOW, (), math.inf),  # too far from the one before
        (LAST, ConeColor.YELLOW, ((14.0, 1.5, ConeColor.BLUE),), math.inf),  # it has a wrong colour: the lane goes on
        (LAST, ConeColor.YELLOW, ((14.0, 3.0, ConeColor.BLUE),), 10.5),
        (LAST, ConeColor.YELLOW, ((14.0, 1.5, ConeColor.YELLOW),), 10.5),  # left of the path it vouches for no lane
    ],
)
def test_between_the_last_cones_of_a_border_no_way_is_borne_out(
    last: tuple[float, float], color: ConeColor, further: tuple[tuple[float, float, ConeColor], ...], until_m: float
) -> None:
    along = np.arange(0.0, 10.0, 3.0)
    rows = [np.column_stack((along, np.full(4, y))) for y in (1.5, -1.5)]
    xy = np.vstack((*rows, [last], *[cone[:2] for cone in further]))
    blue, yellow = int(ConeColor.BLUE), int(ConeColor.YELLOW)
    hue = np.array([*4 * [blue], *4 * [yellow], color, *[cone[2] for cone in further]])
    cones = Cones(xy, hue, np.zeros(len(xy)), np.arange(len(xy)))
    assert until_border_m(SURE, cones, 1.5, 0.0) == until_m
    # The car may stand so far beyond what is borne out.
    assert until_border_m(replace(SURE, supported_m=9.5), cones, 1.5, 2.0) == until_m
    assert until_border_m(replace(SURE, supported_m=9.5), cones, 1.5, 0.0) == math.inf
    assert until_border_m(replace(SURE, path_m=NO_PATH), cones, 1.5, 0.0) == math.inf
    assert until_border_m(SURE, cones.only(np.zeros(len(xy), dtype=bool)), 1.5, 0.0) == math.inf


@pytest.mark.parametrize(("at_m", "note"), [(0.0, ""), (9.0, "the way crosses the border at the last cones")])
def test_the_nose_stops_before_the_last_two_cones_of_a_border(at_m: float, note: str) -> None:
    """The path goes straight on between them; the car is told so only when its nose is there."""
    strategy = LapStrategy(CARS["2026"], PlannerSettings(), MissionSettings(), 1)
    along = np.arange(0.0, 10.0, 3.0)
    xy = np.vstack((*(np.column_stack((along, np.full(4, y))) for y in (1.5, -1.5)), [LAST]))
    color = np.repeat((int(ConeColor.BLUE), int(ConeColor.YELLOW)), (4, 5))
    here = Motion(0, at_m, 0.0, 0.0, 1.0, 0.0, at_m)
    memory = ConeMemory(PlannerSettings())
    for look in range(4):
        here = replace(here, t_ns=look * LOOK_NS)
        memory.add(to_vehicle(here, xy), color, here)
    strategy._lane = lambda *_: (SURE, np.zeros(len(xy)))  # type: ignore[method-assign]
    course = strategy.plan(memory, to_vehicle(here, xy), here)
    assert course.supported_m == pytest.approx(max(0.0, 10.5 - at_m - CARS["2026"].nose_ahead_of_rear_axle_m), abs=0.3)
    assert (course.confidence < FLOOR) == bool(note) and course.note == note


def test_a_lane_that_many_colours_contradict_crosses_a_border() -> None:
    along = np.arange(-10.0, 20.0, 3.0)
    xy = np.vstack((np.column_stack((along, np.full(10, 1.5))), np.column_stack((along, np.full(10, -1.5)))))
    side = np.repeat([1.0, -1.0], 10)
    stands = np.sign(xy[:, 1] - np.interp(xy[:, 0], ASTRAY.path_m[:, 0], ASTRAY.path_m[:, 1]))
    assert np.count_nonzero(stands != side) > MISTAKEN_MOST
    assert within_borders(ASTRAY, xy, unmistaken(side, stands)) == CROSSES


@pytest.mark.parametrize(("spacing_m", "wrong"), [(5.0, (6,)), (5.0, (6, 7)), (4.0, (8, 9)), (3.0, (12, 13))])
def test_a_cone_or_two_of_the_wrong_colour_stop_no_car(spacing_m: float, wrong: tuple[int, ...]) -> None:
    """Round a circle of 10 m to the left; the outer border has cones of the inner one's colour."""

    def ring(radius_m: float) -> Floats:
        angles = np.linspace(0.0, 2.0 * math.pi, round(2.0 * math.pi * radius_m / spacing_m), endpoint=False)
        return np.column_stack((radius_m * np.sin(angles), 10.0 - radius_m * np.cos(angles)))

    inner, outer = ring(8.4), ring(11.6)
    xy = np.vstack((inner, outer))
    color = np.repeat((int(ConeColor.BLUE), int(ConeColor.YELLOW)), (len(inner), len(outer)))
    color[len(inner) + np.array(wrong)] = int(ConeColor.BLUE)
    planner = Planner(CARS["2026"])
    planner.reset(Run(1, Ami.AUTOCROSS, AsState.AS_DRIVING, may_move=True))
    for look in range(160):
        yaw = 0.025 * look
        here = Motion(look * LOOK_NS, 10.0 * math.sin(yaw), 10.0 - 10.0 * math.cos(yaw), yaw, 5.0, 0.5, 0.25 * look)
        places = to_vehicle(here, xy)
        ahead, aside = places.T
        seen = (ahead > 0.6) & (np.hypot(ahead, aside) < 14.0) & (np.abs(np.arctan2(aside, ahead)) < 1.0)
        plan = planner.on_cones(ConeObservation(here.t_ns, places[seen], color[seen], np.ones(seen.sum())), here)
        assert plan is not None and not plan.lost, (here.distance_m, plan.note if plan else "")


def test_a_way_that_goes_on_to_cross_a_border_is_lost() -> None:
    share, note = CROSSES
    evidence, crossing = Evidence(), replace(SURE, confidence=share, note=note)
    notes = [evidence.judged(crossing, motion).note for motion, _ in zip(looks(), range(40), strict=False)]
    assert notes[0] == note and notes[-1] == f"lost: {note}"


def test_of_ever_so_many_cones_the_nearest_are_looked_at() -> None:
    many = np.vstack((BORDERS, np.random.default_rng(0).uniform((-20.0, 20.0), (20.0, 60.0), (2000, 2))))
    side = np.concatenate((LEFT_OR_RIGHT, np.ones(2000)))
    tracemalloc.start()
    try:
        assert within_borders(ASTRAY, many, side) == CROSSES
        until_border_m(ASTRAY, Cones(many, np.where(side > 0.0, 1, 2), side, np.arange(len(side))), 1.5, 0.0)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_without_cones_no_border_is_crossed() -> None:
    assert within_borders(ASTRAY, BORDERS[:0], LEFT_OR_RIGHT[:0]) == (1.0, "")
