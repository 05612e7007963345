"""From cones to the lane's middle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.planning import lane as finder
from fsai_vcu.core.planning.cone_memory import Cones
from fsai_vcu.core.planning.lane import Known, find_lane
from fsai_vcu.core.planning.lap_strategy import crossings
from fsai_vcu.core.planning.settings import PlannerSettings

SETTINGS = PlannerSettings()
HALF = 1.6


def arc_point(s: float, radius: float, offset: float) -> tuple[float, float]:
    """Point `offset` left of an arc of signed radius that begins at the origin along x."""
    if math.isinf(radius):
        return s, offset
    a = s / radius
    return (radius - offset) * math.sin(a), radius - (radius - offset) * math.cos(a)


def lane_cones(radius: float, colored: bool, spacing: float = 4.0, reach: float = 16.0) -> Cones:
    xy, side = [], []
    for s in np.arange(-4.0, min(reach, 2.2 * abs(radius)), spacing):
        xy += [arc_point(s, radius, HALF), arc_point(s + 0.4 * spacing, radius, -HALF)]
        side += [1.0, -1.0]
    return cones_of(xy, side if colored else [0.0] * len(xy))


def cones_of(xy: list[tuple[float, float]], side: list[float]) -> Cones:
    n = len(xy)
    return Cones(np.array(xy).reshape(-1, 2), np.zeros(n, dtype=np.int64), np.array(side), np.arange(n))


def only(cones: Cones, keep: NDArray[np.bool_]) -> Cones:
    return Cones(cones.xy_m[keep], cones.color[keep], cones.side[keep], np.arange(int(keep.sum())))


def off_middle(path: NDArray[np.float64], radius: float, reach: float = 9.0) -> float:
    """How far the path's first metres are from the arc."""
    arc = np.array([arc_point(s, radius, 0.0) for s in np.arange(-1.0, 30.0, 0.05)])
    first = path[np.arange(len(path)) * SETTINGS.path_step_m <= reach]
    gap = np.hypot(first[:, None, 0] - arc[None, :, 0], first[:, None, 1] - arc[None, :, 1])
    return float(gap.min(axis=1).max())


RADII = [math.inf, 20.0, -20.0, 9.0, -9.0, 5.5, -5.5]


@pytest.mark.parametrize("colored", [True, False])
@pytest.mark.parametrize("radius", RADII)
def test_the_path_is_the_lanes_middle_from_beside_the_car_on(radius: float, colored: bool) -> None:
    lane = find_lane(lane_cones(radius, colored), Known(1.0 / radius, HALF), 0.0, SETTINGS)
    path = lane.path_m
    assert len(path) >= 14 and off_middle(path, radius) < 0.3
    assert math.hypot(*path[0]) < 0.4
    steps = np.hypot(*np.diff(path, axis=0).T)
    assert steps == pytest.approx(np.full(len(steps), SETTINGS.path_step_m), abs=0.03)
    assert path[3, 0] > path[0, 0]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("radius", [math.inf, 9.0, -9.0])
def test_a_lone_border_is_followed_at_half_a_lanes_width(radius: float, side: float) -> None:
    cones = lane_cones(radius, colored=True, spacing=3.0)
    lane = find_lane(only(cones, cones.side == side), Known(1.0 / radius, HALF), 0.0, SETTINGS)
    assert len(lane.path_m) >= 12
    assert off_middle(lane.path_m, radius, reach=7.0) < 0.45


@pytest.mark.parametrize("colored", [True, False])
@pytest.mark.parametrize("missing", range(4, 10))
def test_a_missing_cone_does_not_bend_the_path(missing: int, colored: bool) -> None:
    cones = lane_cones(12.0, colored)
    lane = find_lane(only(cones, np.arange(len(cones.xy_m)) != missing), Known(1 / 12, HALF), 0.0, SETTINGS)
    assert off_middle(lane.path_m, 12.0) < 0.4


@pytest.mark.parametrize("false", [(6.0, 5.0), (4.0, -4.5), (12.0, 3.5), (9.0, -6.0)])
@pytest.mark.parametrize("colored", [True, False])
def test_a_cone_outside_the_lane_does_not_bend_the_path(false: tuple[float, float], colored: bool) -> None:
    cones = lane_cones(math.inf, colored)
    xy = [*map(tuple, cones.xy_m.tolist()), false]
    lane = find_lane(cones_of(xy, [*cones.side.tolist(), 0.0]), Known(0.0, HALF), 0.0, SETTINGS)
    assert off_middle(lane.path_m, math.inf) < 0.3


@pytest.mark.parametrize("out_m", [0.8, 1.1])
def test_a_cone_just_outside_the_first_cones_bends_no_path(out_m: float) -> None:
    """A staged car has no cones behind it that would hold the border where it is."""
    xy = [(x, y) for x in (3.0, 7.0, 11.0, 15.0) for y in (HALF, -HALF)]
    false = (2.7, HALF + out_m)
    lane = find_lane(cones_of([*xy, false], [1.0, -1.0] * 4 + [1.0]), Known(0.0, HALF), 0.0, SETTINGS)
    assert off_middle(lane.path_m, math.inf) < 0.2


def test_a_colour_on_the_wrong_side_keeps_the_path_out() -> None:
    """Two lanes side by side: straight on is another lane's border, of the wrong colour."""
    lane = lane_cones(9.0, colored=True)
    wall = [(14.0, y) for y in (-6.0, -3.0, 0.0)]
    xy = [*map(tuple, lane.xy_m.tolist()), *wall]
    found = find_lane(cones_of(xy, [*lane.side.tolist(), 1.0, 1.0, 1.0]), Known(1 / 9, HALF), 0.0, SETTINGS)
    assert off_middle(found.path_m, 9.0) < 0.3


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_where_the_cones_alone_allow_two_ways_colours_decide(way: float) -> None:
    """A fork, the same to both sides; one branch has its colours the right way round, the other one swapped."""
    xy: list[tuple[float, float]] = []
    side: list[float] = []
    for s in (-3.0, 0.0, 3.0):
        xy += [(s, HALF), (s, -HALF)]
        side += [1.0, -1.0]
    for s in (6.0, 9.0, 12.0, 15.0):
        for offset in (HALF, -HALF):
            x, y = arc_point(s, 11.0, offset)
            xy += [(x, y), (x, -y)]
            side += [way * math.copysign(1.0, offset)] * 2
    path = find_lane(cones_of(xy, side), Known(0.0, HALF), 0.0, SETTINGS).path_m
    assert way * path[-1, 1] > 2.0


@pytest.fixture
def begun_m(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """How far ahead of the car each search began."""
    search, begun = finder._search, []

    def spied(*given: Any) -> Any:
        begun.append(given[1].along_m)
        return search(*given)

    monkeypatch.setattr(finder, "_search", spied)
    return begun


@pytest.mark.parametrize("radius", RADII)
def test_with_the_lane_of_the_last_look_the_same_is_found(radius: float, begun_m: list[float]) -> None:
    cones = lane_cones(radius, colored=True)
    first = find_lane(cones, Known(1.0 / radius, HALF), 0.0, SETTINGS)
    again = find_lane(cones, Known(1.0 / radius, HALF, middle_m=first.middle_m), 0.0, SETTINGS)
    assert off_middle(again.path_m, radius) < 0.15
    assert len(again.path_m) >= len(first.path_m) - 1 and again.supported_m >= first.supported_m - 1.0
    assert (again.side * first.side >= 0.0).all()
    assert begun_m[0] == 0.0 and begun_m[1] > 5.0


@pytest.mark.parametrize("before_radius", [math.inf, 9.0])
def test_where_cones_disagree_the_way_found_before_is_left(before_radius: float, begun_m: list[float]) -> None:
    """It led through the border of the lane."""
    before = np.array([arc_point(s, before_radius, 0.0) for s in np.arange(-4.0, 14.0, 0.5)])
    lane = find_lane(lane_cones(-9.0, colored=True), Known(-1 / 9, HALF, middle_m=before), 0.0, SETTINGS)
    assert off_middle(lane.path_m, -9.0) < 0.3
    assert begun_m == [0.0]


def test_a_way_across_a_border_is_left_when_its_cones_are_seen(begun_m: list[float]) -> None:
    """Without colours, beside another lane: before the border was seen so far, the last look led across it."""
    before = [(x, 0.0) for x in np.arange(-4.0, 8.5, 0.5)]
    before += [(8.0 + 0.55 * s, -0.84 * s) for s in np.arange(0.5, 6.0, 0.5)]
    rows = [(x, y) for x in np.arange(-4.0, 12.5, 4.0) for y in (2.4, -2.4)]
    other = [(x, -5.5) for x in np.arange(-2.0, 13.0, 4.0)]
    voted = [
        0.6 * math.copysign(1.0, y) if x < 8.0 else 0.5 * math.copysign(1.0, y) if x == 8.0 else 0.05 for x, y in rows
    ]
    known = Known(0.0, 2.4, view_m=14.0, middle_m=np.array(before))
    path = find_lane(cones_of(rows + other, voted + [0.0] * 4), known, 0.0, SETTINGS).path_m
    assert 4.0 <= begun_m[0] < 8.0 and np.abs(path[:, 1]).max() < 0.5


def test_a_gap_in_a_hairpins_border_is_no_lane_in_view() -> None:
    """Without colours; beyond the two cones 3.5 m from each other nothing stands as far as cones can be seen."""
    rows = [(x, y) for x in np.arange(-3.5, 4.0, 3.5) for y in (2.0, -2.0, 7.0)]
    cones = cones_of([*rows, (7.5, 0.8), (7.5, 4.3), (5.0, 6.7)], [0.0] * (len(rows) + 3))
    path = find_lane(cones, Known(0.0, HALF, view_m=15.0), 0.0, SETTINGS).path_m
    assert path[:, 0].max() < 6.5 and path[-1, 1] > 4.0


def test_a_wide_lane_is_driven_in_its_middle() -> None:
    xy = [(x, y) for x in np.arange(-4.0, 16.0, 4.0) for y in (2.4, -2.4)]
    lane = find_lane(cones_of(xy, [0.0] * len(xy)), Known(0.0, HALF), 0.0, SETTINGS)
    assert np.abs(lane.path_m[:, 1]).max() < 0.1
    assert lane.half_width_m == pytest.approx(2.4, abs=0.05)


def test_a_car_beside_the_middle_gets_the_middle_all_the_same() -> None:
    xy = [(x, y - 0.5) for x in np.arange(-4.0, 16.0, 4.0) for y in (HALF, -HALF)]
    lane = find_lane(cones_of(xy, [0.0] * len(xy)), Known(0.0, HALF), 0.0, SETTINGS)
    assert lane.path_m[4:, 1] == pytest.approx(np.full(len(lane.path_m) - 4, -0.5), abs=0.2)


def test_the_path_ends_where_the_cones_end() -> None:
    cones = lane_cones(math.inf, colored=True, reach=8.5)
    last = float(cones.xy_m[:, 0].max())
    assert last - 1.0 <= find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS).path_m[-1, 0] <= last + 1.0


def test_beyond_a_long_gap_the_lane_is_not_believed() -> None:
    xy = [(x, y) for x in (-2.0, 2.0, 4.0, 16.0, 18.0) for y in (HALF, -HALF)]
    lane = find_lane(cones_of(xy, [1.0, -1.0] * 5), Known(0.0, HALF), 0.0, SETTINGS)
    assert lane.path_m[-1, 0] < 5.0


@pytest.mark.parametrize(
    ("places", "supported_m"),
    [
        ((10.0, 14.0), 14.0),  # staged before the first cones
        ((11.9, 14.5), 14.5),
        ((13.0, 17.0), 0.0),
        ((-3.0, 11.9, 14.5), 0.0),  # in the lane
        ((-3.0, 0.0, 11.9, 14.5), 0.0),
        ((-3.0, 0.0, 8.5, 14.5), 14.5),
    ],
)
def test_only_a_staged_cars_lane_may_begin_far_ahead(places: tuple[float, ...], supported_m: float) -> None:
    cones = cones_of([(x, y) for x in places for y in (HALF, -HALF)], [1.0, -1.0] * len(places))
    before = np.array([(x, 0.0) for x in np.arange(-4.0, 14.0, 0.5)])
    for middle_m in (None, before):
        lane = find_lane(cones, Known(0.0, HALF, middle_m=middle_m), 0.0, SETTINGS)
        assert lane.supported_m == pytest.approx(supported_m, abs=SETTINGS.path_step_m)


@pytest.mark.parametrize("aside_m", (0.0, 0.3))
def test_a_staged_car_drives_into_its_lane_from_where_it_is(aside_m: float) -> None:
    """However long it has stood there, look after look."""
    places = [(x, side * 1.6 + aside_m) for x in (5.0, 7.8, 8.6, 12.0, 15.0) for side in (1.0, -1.0)]
    cones = cones_of(places, [1.0, -1.0] * 5)
    lane = find_lane(cones, Known(0.0, 1.5), 0.0, SETTINGS)
    for _ in range(60):
        lane = find_lane(cones, Known(0.0, 1.5, middle_m=lane.middle_m), 0.0, SETTINGS)
    near, far = lane.path_m[0], lane.path_m[lane.path_m[:, 0] > 8.0]
    assert abs(near[1]) < 0.05 and np.abs(far[:, 1] - aside_m).max() < 0.1


@pytest.mark.parametrize("count", [0, 1])
def test_without_cones_there_is_no_path(count: int) -> None:
    lane = find_lane(cones_of([(5.0, 1.5)] * count, [0.0] * count), Known(0.0, HALF), 0.0, SETTINGS)
    assert lane.path_m.shape == (0, 2)


def test_cones_behind_the_car_alone_are_no_lane() -> None:
    cones = cones_of([(-3.0, 1.5), (-3.0, -1.5), (-1.0, 1.5)], [1.0, -1.0, 1.0])
    assert len(find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS).path_m) == 0


def test_cones_on_one_spot_or_one_line_do_no_harm() -> None:
    for xy in ([(5.0, 0.0)] * 6, [(float(x), 0.0) for x in range(1, 12)], [(0.0, 0.0)] * 3):
        path = find_lane(cones_of(xy, [0.0] * len(xy)), Known(0.0, HALF), 0.0, SETTINGS).path_m
        assert np.isfinite(path).all()


@pytest.mark.parametrize("radius", [6.0, -6.0])
def test_in_a_bend_the_path_of_the_rear_axle_lies_further_inside(radius: float) -> None:
    """So the nose stays in the lane."""
    cones = lane_cones(radius, colored=True, spacing=2.5)
    middle = find_lane(cones, Known(1.0 / radius, HALF), 0.0, SETTINGS).path_m
    led = find_lane(cones, Known(1.0 / radius, HALF), 2.17, SETTINGS).path_m
    reach_middle = np.hypot(middle[4:12, 0], middle[4:12, 1] - radius).mean()
    reach_led = np.hypot(led[4:12, 0], led[4:12, 1] - radius).mean()
    assert reach_middle - reach_led == pytest.approx(2.17**2 / (4 * abs(radius)), abs=0.08)


def test_cones_near_the_car_are_told_left_from_right() -> None:
    cones = lane_cones(math.inf, colored=False)
    lane = find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS)
    near = (cones.xy_m[:, 0] > -1.5) & (cones.xy_m[:, 0] < 8.0)
    assert (np.sign(lane.side[near]) == np.sign(cones.xy_m[near, 1])).all()


@pytest.mark.parametrize("reach", [6.5, 10.5, 14.5])
def test_a_lane_is_supported_up_to_its_last_cones(reach: float) -> None:
    cones = lane_cones(math.inf, colored=True, reach=reach)
    lane = find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS)
    assert lane.supported_m == pytest.approx(float(cones.xy_m[:, 0].max()), abs=SETTINGS.path_step_m)


def test_confidence_falls_with_a_border_lost() -> None:
    cones = lane_cones(math.inf, colored=True)
    both = find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS)
    left = find_lane(only(cones, cones.side > 0), Known(0.0, HALF), 0.0, SETTINGS)
    assert both.note == "" and both.confidence > 0.8
    assert left.note == "only the left border is seen" and left.confidence < 0.7 * both.confidence


def test_colours_of_the_other_side_lower_confidence() -> None:
    cones = lane_cones(math.inf, colored=True)
    swapped = np.array([index in (4, 7) for index in range(len(cones.xy_m))])
    lane = find_lane(replace(cones, side=np.where(swapped, -cones.side, cones.side)), Known(0.0, HALF), 0.0, SETTINGS)
    assert off_middle(lane.path_m, math.inf) < 0.3
    assert lane.confidence < 0.8 * find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS).confidence
    assert "2 of" in lane.note and "colour of the other side" in lane.note


def test_a_way_that_the_beam_has_dropped_counts_as_well() -> None:
    """Without colours the gap in a border beside another lane is nearly as good a way as the lane ahead."""
    begun = [(s, y) for s in (-3.0, 0.5) for y in (1.5, -1.5)]
    ahead = [(s, y) for s in (4.0, 8.0, 12.0) for y in (1.5, -1.5)]
    seen = [(4.0, 1.5), (8.0, 1.5), (5.5, -1.6)]
    other = [(2.5, -5.5), (6.5, -5.5), (10.5, -5.5), (-1.0, -5.5), (4.5, -8.5), (8.5, -8.5), (12.0, -8.5), (0.5, -8.5)]
    side = [0.6, -0.6, 0.6, -0.6]
    alone = find_lane(cones_of([*begun, *ahead], side + [0.0] * 6), Known(0.0, 1.5), 2.0, SETTINGS)
    beside = find_lane(cones_of([*begun, *seen, *other], side + [0.0] * 11), Known(0.0, 1.5), 2.0, SETTINGS)
    assert beside.confidence < 0.85 < 0.9 < alone.confidence


STEM = [(s, y) for s in (-3.0, 0.0, 3.0) for y in (HALF, -HALF)]
FORK = [*STEM, *(arc_point(s, r, y) for s in (6.0, 9.0, 12.0) for r in (11.0, -11.0) for y in (HALF, -HALF))]


def test_a_fork_is_doubted() -> None:
    """Two ways as good as each other are borne out as far as they are one."""
    lane = find_lane(cones_of(FORK, [0.0] * 18), Known(0.0, HALF), 0.0, SETTINGS)
    assert lane.confidence < 0.3 and "another way" in lane.note
    assert 0.0 < lane.supported_m <= 7.5


def test_a_fork_that_the_car_can_stop_before_is_no_doubt_yet() -> None:
    cones = cones_of(FORK, [0.0] * 18)
    near, far = (find_lane(cones, Known(0.0, HALF, need_m=need_m), 0.0, SETTINGS) for need_m in (2.5, 0.5))
    assert near.confidence < 0.3 and far.confidence > 0.9
    assert far.supported_m == near.supported_m <= 7.5 and far.middle_m[-1, 0] < 8.0
    beyond = np.array(FORK)[:, 0] > 8.0
    assert np.abs(far.side[beyond]).max() < 0.1, "which lane they are of is not known"


def test_a_lane_in_doubt_marks_only_cones_with_a_colour() -> None:
    cones = cones_of(FORK, [0.0, 0.0, 1.0, -1.0] + [0.0] * 14)
    cones.color[2:4] = 1, 2
    lane = find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS)
    assert 0.0 < lane.confidence < 0.5
    assert lane.side.nonzero()[0].tolist() == [2, 3]


def test_the_more_a_way_must_be_better_the_less_confidence() -> None:
    cones = lane_cones(9.0, colored=False)
    margins = [
        find_lane(cones, Known(0.0, HALF, margin=margin), 0.0, SETTINGS).confidence for margin in (0.5, 1.0, 2.0)
    ]
    assert 1.0 > margins[0] > margins[1] > margins[2] > 0.3


def beside_another(island_m: float, apart_m: float = 4.0) -> list[tuple[float, float]]:
    """Cones seen on a straight lane with another one to its right, behind an island."""
    borders = (HALF, -HALF, -HALF - island_m, -3.0 * HALF - island_m)
    xy = [(s + 0.3 * abs(y), y) for y in borders for s in np.arange(1.0, 13.0, apart_m)]
    return [(x, y) for x, y in xy if math.hypot(x, y) < 14.0 and abs(math.atan2(y, x)) < math.radians(55.0)]


@pytest.mark.parametrize("island_m", [4.0, 5.0, 6.0])
def test_no_way_leads_through_a_row_of_cones_without_colour(island_m: float) -> None:
    """One look, from a car that is in its lane: what comes after a cone in its row is of the same border."""
    cones = beside_another(island_m)
    lane = find_lane(cones_of(cones, [0.0] * len(cones)), Known(0.0, HALF, 14.0), 0.0, SETTINGS)
    assert lane.path_m[-1, 0] > 8.5 and off_middle(lane.path_m, math.inf) < 0.3


def test_cones_closer_than_any_border_has_make_no_rows() -> None:
    xy = np.random.default_rng(1).uniform((0.0, -3.0), (6.0, 3.0), (150, 2))
    assert len(finder._rows(xy).first) == 0
    assert len(finder._rows(lane_cones(math.inf, colored=False).xy_m).first) > 8
    assert np.isfinite(find_lane(cones_of(xy.tolist(), [0.0] * 150), Known(0.0, HALF), 0.0, SETTINGS).path_m).all()


def test_a_row_beyond_a_sharp_bend_does_not_close_it() -> None:
    """The outer border's cone that stands straight on from the inner one's end has the colour of its own border."""
    inner = [(1.0, HALF), (4.0, HALF)]
    outer = [(1.0, -HALF), (4.0, -HALF), (7.0, -1.2), (8.6, HALF), (9.0, 4.4), (8.4, 7.2), (8.4, 10.0)]
    inner += [(5.2, 3.6), (5.2, 6.6), (5.2, 9.6)]
    cones = cones_of(inner + outer, [1.0] * len(inner) + [-1.0] * len(outer))
    lane = find_lane(cones, Known(0.0, HALF), 0.0, SETTINGS)
    assert lane.confidence > 0.7 and lane.path_m[:, 1].max() > 5.0


# A sharp bend to the left, and behind its right border the lane that comes back.
BLUE = [(-2.8, 2.5), (1.6, 1.6), (4.9, 5.1), (8.9, 7.0), (11.7, -3.5), (9.3, -6.7), (6.9, -9.8)]
YELLOW = [(-1.5, -1.6), (3.1, -1.0), (6.4, 2.3), (10.4, 3.4), (9.9, -1.0), (7.5, -4.1), (5.0, -7.2), (2.7, -10.4)]


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_bend_sharper_than_most_agrees_with_the_colours(mirror: float) -> None:
    blue, yellow = (np.array(cones) * (1.0, mirror) for cones in (BLUE, YELLOW))
    side = mirror * np.repeat((1.0, -1.0), (len(blue), len(yellow)))
    color = np.where(side > 0.0, ConeColor.BLUE, ConeColor.YELLOW)
    cones = replace(cones_of([*blue, *yellow], side.tolist()), color=color)
    lane = find_lane(cones, Known(0.0, HALF, 14.0), 0.0, SETTINGS)
    borders = np.array((blue[:3], yellow[:3]))
    assert not any(crossings(lane.path_m, border[:-1], border[1:]).any() for border in borders)
    assert lane.supported_m > 8.0


@pytest.mark.parametrize(
    ("count", "note"), [(0, "no cones"), (1, "no lane among 1 cone"), (3, "no lane among 3 cones")]
)
def test_without_a_lane_the_note_says_why(count: int, note: str) -> None:
    lane = find_lane(cones_of([(-5.0 - i, 1.5) for i in range(count)], [0.0] * count), Known(0.0, HALF), 0.0, SETTINGS)
    assert (lane.note, lane.confidence, lane.supported_m, len(lane.path_m)) == (note, 0.0, 0.0, 0)


@pytest.mark.parametrize("open_to", [1.0, -1.0])
def test_no_lane_leads_onto_the_way_driven(open_to: float) -> None:
    """Two lanes that part to left and right, each the other's image: the car has come from one of them."""
    bend = [arc_point(s, 8.0, offset) for offset in (HALF, -HALF) for s in (2.0, 5.0, 8.0, 11.0)]
    left = [(x + 4.0, y + 0.2) for x, y in bend if y > 0.2]
    rows = [(x, y) for x in (-4.0, -1.0, 2.0) for y in (HALF, -HALF)]
    cones = cones_of(rows + left + [(x, -y) for x, y in left], [0.0] * (len(rows) + 2 * len(left)))
    driven = np.array([arc_point(s, 8.0, 0.0) for s in np.arange(6.0, 14.0, 2.0)]) + np.array((4.0, 0.0))
    known = Known(0.0, HALF, driven_m=driven * (1.0, -open_to))
    path = find_lane(cones, known, 0.0, SETTINGS).path_m
    assert open_to * path[path[:, 0] > 8.0][0, 1] > 0.2
