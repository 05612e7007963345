"""The memory of cones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion
from fsai_vcu.core.planning.cone_memory import (
    AROUND_MOST,
    IN_ROWS_MOST,
    OUTVOTED_MOST,
    SURE_SIDE,
    ConeMemory,
    believable,
    by_chain,
    carried_on,
    rows_of,
)
from fsai_vcu.core.planning.settings import PlannerSettings

SETTINGS = PlannerSettings()
HERE = Motion()


def colors(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)


def test_a_cone_is_believed_after_its_second_sighting() -> None:
    memory = ConeMemory(SETTINGS)
    memory.add(np.array([[5.0, 1.5]]), colors(1), HERE)
    assert len(memory.around(HERE).xy_m) == 0
    memory.add(np.array([[5.1, 1.4]]), colors(1), HERE)
    assert len(memory.around(HERE).xy_m) == 1
    assert memory.total == 1


def test_sightings_are_averaged() -> None:
    memory = ConeMemory(SETTINGS)
    for offset in (-0.2, 0.2, -0.1, 0.1):
        memory.add(np.array([[5.0 + offset, 1.5]]), colors(1), HERE)
    assert memory.around(HERE).xy_m[0] == pytest.approx([5.0, 1.5], abs=0.06)


def test_a_cone_keeps_its_place_while_the_car_moves() -> None:
    memory = ConeMemory(SETTINGS)
    for x in (0.0, 1.0, 2.0):
        memory.add(np.array([[6.0 - x, 1.5]]), colors(1), Motion(x_m=x, distance_m=x))
    turned = Motion(x_m=6.0, y_m=0.0, yaw_rad=np.pi / 2, distance_m=6.0)
    assert memory.around(turned).xy_m[0] == pytest.approx([1.5, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("cone_xy_m", "since_m", "fresh"),
    [((12.0, 1.5), 0.0, True), ((12.0, 1.5), 2.0, False), ((5.0, 1.5), 2.5, True), ((5.0, 1.5), 5.5, False)],
)
def test_a_place_is_fresh_until_odometry_has_drifted(
    cone_xy_m: tuple[float, float], since_m: float, fresh: bool
) -> None:
    memory = ConeMemory(SETTINGS)
    for _ in range(3):
        memory.add(np.array([cone_xy_m]), colors(1), HERE)
    there = Motion(x_m=since_m, distance_m=since_m)
    assert memory.lately(memory.around(there), there).tolist() == [fresh]


def test_a_false_cone_that_is_not_seen_again_is_dropped() -> None:
    memory = ConeMemory(SETTINGS)
    real = np.array([[6.0, 1.5]])
    memory.add(np.vstack((real, [[5.0, -0.5]])), colors(1, 1), HERE)
    for _ in range(2):
        memory.add(real, colors(1), HERE)
    assert len(memory) == 1


def test_a_real_cone_survives_misses() -> None:
    memory = ConeMemory(SETTINGS)
    for index in range(20):
        seen = index % 2 == 0 or index < 3
        memory.add(np.array([[6.0, 1.5]]) if seen else np.zeros((0, 2)), colors(1) if seen else colors(), HERE)
    assert len(memory.around(HERE).xy_m) == 1


@pytest.mark.parametrize(("cones", "left"), [(1, 1), (0, 2)])
def test_a_cone_come_into_view_again_is_soon_none_if_missed(cones: int, left: int) -> None:
    """Odometry has drifted since. Looks without any cone say nothing of it."""
    memory = ConeMemory(SETTINGS)
    other, there = np.array([[6.0, -1.5]]), Motion(x_m=1.0, distance_m=41.0)
    for _ in range(40):
        memory.add(np.array([[6.0, 1.5], [6.0, -1.5]]), colors(1, 2), HERE)
    for _ in range(6):
        memory.add((other - (1.0, 0.0))[:cones], colors(2)[:cones], there)
    assert len(memory) == left


def test_a_cone_come_into_view_again_counts_where_it_stands_now() -> None:
    """Odometry has drifted by more than two cones may be apart: it is no other cone, and keeps its colour."""
    memory = ConeMemory(SETTINGS)
    for _ in range(10):
        memory.add(np.array([[6.0, 1.5]]), colors(1), HERE)
    there = Motion(distance_m=40.0)
    memory.add(np.array([[6.9, 2.2]]), colors(0), there)
    cones = memory.around(there)
    assert cones.xy_m == pytest.approx(np.array([[6.9, 2.2]])) and cones.color.tolist() == [1]
    assert memory.doubt == 0.0
    assert not memory.sure(cones.index).any(), "one look has found it there"
    memory.add(np.array([[6.9, 3.3]]), colors(0), there)
    assert len(memory) == 2, "from one place a cone stands where it stands"


def test_a_cone_of_the_other_colour_is_another_one() -> None:
    """Beyond a border the next lane's begins, back to back."""
    memory, there = ConeMemory(SETTINGS), Motion(distance_m=20.0)
    for _ in range(10):
        memory.add(np.array([[6.0, 1.5]]), colors(1), HERE)
    for _ in range(2):
        memory.add(np.array([[6.0, 2.6]]), colors(2), there)
    cones = memory.around(there)
    assert dict(zip(cones.xy_m[:, 1].round(1).tolist(), cones.side.tolist(), strict=True))[2.6] == -1.0


def test_cones_that_odometry_has_moved_are_no_doubt() -> None:
    memory, there = ConeMemory(SETTINGS), Motion(distance_m=20.0)
    for _ in range(10):
        memory.add(np.array([[6.0, 1.5], [5.0, -1.5], [7.0, -1.5]]), colors(1, 2, 2), HERE)
    for _ in range(8):
        memory.add(np.array([[6.0, 1.5]]), colors(1), there)
    assert len(memory) == 1 and memory.doubt == 0.0


def test_cones_far_behind_are_forgotten() -> None:
    memory = ConeMemory(SETTINGS)
    for _ in range(3):
        memory.add(np.array([[3.0, 1.5]]), colors(1), HERE)
    for x, left in ((3.0 + SETTINGS.behind_m - 0.1, 1), (3.0 + SETTINGS.behind_m + 0.1, 0)):
        memory.add(np.zeros((0, 2)), colors(), Motion(x_m=x, distance_m=x))
        assert len(memory) == left


def test_of_ever_so_many_cones_the_nearest_count() -> None:
    """A message may have 2,000; tables over all of them and their neighbours would take gigabytes."""
    memory, draw = ConeMemory(SETTINGS), np.random.default_rng(2)
    xy = draw.uniform((0.0, -8.0), (16.0, 8.0), (2000, 2))
    for _ in range(3):
        memory.add(xy, colors(*[0] * len(xy)), HERE)
    cones = memory.around(HERE)
    assert len(cones.xy_m) == AROUND_MOST
    away = np.hypot(*xy.T)
    assert np.hypot(*cones.xy_m.T).max() < np.sort(away)[AROUND_MOST + 100]
    rows = rows_of(xy[:300])
    assert rows.whom.shape[1] == IN_ROWS_MOST
    for cone in range(0, 300, 50):
        gap = np.sort(np.hypot(*(xy[:300] - xy[cone]).T))
        assert np.hypot(*(xy[rows.whom[cone]] - xy[cone]).T).max() == pytest.approx(gap[IN_ROWS_MOST])


def test_false_cones_do_not_gather_before_a_standing_car() -> None:
    """A look has a false cone anywhere in view, and finds a cone at its edge every third time."""
    memory, draw = ConeMemory(SETTINGS), np.random.default_rng(3)
    known = []
    for look in range(1200):
        far, angle = 14.0 * math.sqrt(draw.random()), math.radians(55.0) * (2.0 * draw.random() - 1.0)
        seen = [[far * math.cos(angle), far * math.sin(angle)], *([[13.0, 3.0]] if look % 3 == 0 else [])]
        memory.add(np.array(seen), colors(*[1] * len(seen)), HERE)
        xy = memory.around(HERE).xy_m
        known.append((len(xy), np.hypot(*(xy - (13.0, 3.0)).T).min(initial=9.0)))
    assert np.mean([count for count, _ in known]) < 3.0 and max(count for count, _ in known) < 8
    assert max(off for _, off in known[20:]) < SETTINGS.same_cone_m


def looked_at(false_per_look: float, jump_m: float = 0.0) -> float:
    """The doubt after 40 looks of a car at 8 m/s between two rows; with the last one its pose jumps aside."""
    memory, draw = ConeMemory(SETTINGS), np.random.default_rng(4)
    lane = np.array([[x, y] for x in np.arange(0.0, 40.0, 3.0) for y in (1.5, -1.5)])
    for look in range(40):
        way, aside = 0.4 * look, jump_m * (look == 39)
        here = lane - (way, 0.0) + draw.normal(0.0, 0.08, lane.shape)
        here = here[(here[:, 0] > 0.6) & (here[:, 0] < 14.0)]
        far = 14.0 * np.sqrt(draw.random((draw.poisson(false_per_look), 1)))
        angle = math.radians(55.0) * (2.0 * draw.random(far.shape) - 1.0)
        seen = np.vstack((here, np.hstack((far * np.cos(angle), far * np.sin(angle)))))
        memory.add(seen, colors(*[0] * len(seen)), Motion(x_m=way, y_m=aside, distance_m=way))
    return memory.doubt


def test_false_cones_and_a_pose_that_jumps_raise_the_doubt() -> None:
    assert looked_at(0.0) < 0.25
    assert looked_at(1.0) > 0.5
    assert looked_at(0.0, jump_m=0.5) > 0.5


def test_two_cones_side_by_side_stay_two() -> None:
    memory = ConeMemory(SETTINGS)
    for _ in range(4):
        memory.add(np.array([[6.0, 1.5], [6.9, 1.5]]), colors(4, 4), HERE)
    assert len(memory.around(HERE).xy_m) == 2


def test_the_most_seen_colour_outvotes_colourless_sightings() -> None:
    memory = ConeMemory(SETTINGS)
    for color in (1, 0, 1, 2, 0, 1, 0):
        memory.add(np.array([[6.0, 1.5]]), colors(color), HERE)
    cones = memory.around(HERE)
    assert cones.color[0] == ConeColor.BLUE
    assert cones.side[0] == 1.0


def test_a_cone_never_seen_with_a_colour_has_none() -> None:
    memory = ConeMemory(SETTINGS)
    for _ in range(3):
        memory.add(np.array([[6.0, 1.5]]), colors(0), HERE)
    cones = memory.around(HERE)
    assert cones.color[0] == ConeColor.UNKNOWN
    assert cones.side[0] == 0.0


def test_a_side_from_the_lane_is_kept_but_weaker_than_a_colour() -> None:
    memory = ConeMemory(SETTINGS)
    for _ in range(12):
        memory.add(np.array([[6.0, 1.5]]), colors(0), HERE)
        memory.vote(memory.around(HERE).index, np.array([-1.0]))
    assert memory.around(HERE).side[0] == pytest.approx(-0.6)


def test_a_lane_outvotes_a_colour_that_contradicts_it() -> None:
    memory = ConeMemory(SETTINGS)
    sides = []
    for _ in range(8):
        memory.add(np.array([[6.0, 1.5]]), colors(ConeColor.YELLOW), HERE)
        cones = memory.around(HERE)
        sides += cones.side.tolist()
        memory.vote(cones.index, np.ones(len(cones.index)))
    assert sides[0] == -1.0 and sides[-1] > 0.0
    assert memory.around(HERE).color[0] == ConeColor.YELLOW


@pytest.mark.parametrize(("wrong", "outvoted"), [(OUTVOTED_MOST, True), (OUTVOTED_MOST + 1, False)])
def test_many_colours_that_contradict_a_lane_are_believed(wrong: int, outvoted: bool) -> None:
    memory, places = ConeMemory(SETTINGS), np.array([[6.0 * count, 1.5] for count in range(1, wrong + 1)])
    for _ in range(8):
        memory.add(places, colors(*wrong * [ConeColor.YELLOW]), HERE)
        cones = memory.around(HERE)
        memory.vote(cones.index, np.ones(len(cones.index)))
    assert (memory.around(HERE).side > 0.0).tolist() == wrong * [outvoted]


@pytest.mark.parametrize(("neighbours", "side"), [(ConeColor.YELLOW, -1.0), (ConeColor.UNKNOWN, 1.0)])
def test_between_two_cones_of_its_colour_none_is_outvoted(neighbours: ConeColor, side: float) -> None:
    memory, places = ConeMemory(SETTINGS), np.array([[3.0, 2.0], [6.0, 1.5], [9.0, 2.0]])
    for _ in range(12):
        memory.add(places, colors(neighbours, ConeColor.YELLOW, neighbours), HERE)
        memory.vote(memory.around(HERE).index[1:2], np.array([1.0]))
    assert memory.around(HERE).side[1] == side


def test_what_cannot_be_a_cone_is_not_taken_in() -> None:
    observation = ConeObservation(
        0,
        np.array([[5.0, 1.0], [np.nan, 1.0], [5.0, np.inf], [5.0, -1.0], [500.0, 0.0], [6.0, 1.0]]),
        colors(1, 1, 1, 2, 1, 77),
        np.array([0.9, 0.9, 0.9, 0.05, 0.9, 0.9]),
    )
    xy, color = believable(observation, SETTINGS)
    assert xy.tolist() == [[5.0, 1.0], [6.0, 1.0]]
    assert color.tolist() == [ConeColor.BLUE, ConeColor.UNKNOWN]


def rows(*at_m: float, step_m: float = 4.0) -> np.ndarray:
    """Rows of seven cones along x, at these places across."""
    return np.array([(step_m * place, y) for y in at_m for place in range(7)])


def sides(*of_rows: float) -> np.ndarray:
    return np.repeat(np.array(of_rows), 7)


def kept(side: np.ndarray, of: np.ndarray) -> bool:
    """Each cone of the rows has its side, but those at a row's ends may have none."""
    return all(side[1:-1] == of[1:-1]) and all(side * of >= 0.0)


@pytest.mark.parametrize("wrong", range(7))
@pytest.mark.parametrize("step_m", (2.0, 4.9))
def test_a_border_of_the_other_colour_outvotes_a_colour(wrong: int, step_m: float) -> None:
    seen = sides(1.0, -1.0)
    seen[wrong] *= -1.0
    expected = sides(1.0, -1.0)
    expected[wrong] = 0.0
    assert list(by_chain(seen, rows_of(rows(1.6, -1.6, step_m=step_m)))) == list(expected)


@pytest.mark.parametrize("wrong", range(6))
@pytest.mark.parametrize("across_m", (3.0, 4.5))
@pytest.mark.parametrize("step_m", (2.0, 2.5, 3.5, 4.9))
def test_two_wrong_colours_in_a_row_are_outvoted(wrong: int, across_m: float, step_m: float) -> None:
    seen = sides(1.0, -1.0)
    seen[wrong : wrong + 2] *= -1.0
    side = by_chain(seen, rows_of(rows(0.5 * across_m, -0.5 * across_m, step_m=step_m)))
    assert all(side * sides(1.0, -1.0) >= 0.0) and sum(side == 0.0) <= 3  # a cone at a row's end may have none


@pytest.mark.parametrize("apart_m", (0.5, 1.5, 3.0))
@pytest.mark.parametrize("next_lane", ((1.0, -1.0), (-1.0, 1.0)))
def test_lanes_beside_each_other_keep_their_colours(apart_m: float, next_lane: tuple[float, float]) -> None:
    xy, seen = rows(1.5, -1.5, -1.5 - apart_m, -4.5 - apart_m), sides(1.0, -1.0, *next_lane)
    side = by_chain(seen, rows_of(xy))
    assert all(kept(*row) for row in zip(side.reshape(-1, 7), seen.reshape(-1, 7), strict=True))


@pytest.mark.parametrize("inside_m", (1.5, 3.0, 6.0))
def test_a_hairpins_borders_keep_their_colours(inside_m: float) -> None:
    arcs = [(radius, np.arange(0.0, np.pi, 2.0 / radius)) for radius in (inside_m, inside_m + 3.0)]
    xy = np.concatenate([radius * np.stack((np.sin(turn), -np.cos(turn)), axis=-1) for radius, turn in arcs])
    seen = np.repeat((1.0, -1.0), [len(turn) for _, turn in arcs])
    side, inside = by_chain(seen, rows_of(xy)), len(arcs[0][1])
    assert kept(side[:inside], seen[:inside]) and kept(side[inside:], seen[inside:])


@pytest.mark.parametrize("apart_m", (1.5, 3.0))
def test_cones_without_colour_carry_on_their_border(apart_m: float) -> None:
    """Another lane beside one's own leads nobody through the gap in a border that goes straight on."""
    seen = 0.6 * sides(1.0, -1.0, 0.0)
    seen[[4, 5, 6, 11, 12, 13]] = 0.0
    side = carried_on(seen, np.ones(len(seen), dtype=bool), rows_of(rows(1.5, -1.5, -1.5 - apart_m, step_m=4.0)))
    assert side[4] > SURE_SIDE and side[11] < -SURE_SIDE
    assert all(side[14:] <= 0.0)


def test_an_outer_border_does_not_carry_on_the_inner_one() -> None:
    """A sharp bend to the left: its outer border stands across the way, straight on from the inner border's end."""
    xy = np.array([[-4.0, 1.5], [0.0, 1.5], [3.2, 0.4], [3.8, 1.6], [-4.0, -1.5], [0.0, -1.5]])
    seen = np.array([0.6, 0.6, 0.0, 0.0, -0.6, -0.6])
    colourless = np.ones(6, dtype=bool)
    assert list(carried_on(seen, colourless, rows_of(xy))) == list(seen)
    assert all(carried_on(seen[:4], colourless[:4], rows_of(xy[:4]))[2:] > SURE_SIDE)  # but for the outer border's end


def test_a_colour_is_not_carried_over() -> None:
    seen = 0.6 * sides(1.0, -1.0)
    seen[4] = 0.0
    colourless = np.arange(len(seen)) == 11  # on the other side
    seen[11] = 0.0
    side = carried_on(seen, colourless, rows_of(rows(1.5, -1.5, step_m=4.0)))
    assert side[11] < -SURE_SIDE and list(np.delete(side, 11)) == list(np.delete(seen, 11))
