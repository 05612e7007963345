"""The line of a file's track and where the car is staged: one definition, and a word where it is not as given."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import astuple, replace

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.judge import check_track
from fsai_hil.simulator.tracks import (
    Track,
    TrackKind,
    acceleration_track,
    as_csv,
    generated_circuit,
    parse_track,
    skidpad_track,
    small_oval,
)
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami

NOSE_M = ADS_DV_2026.nose_ahead_of_rear_axle_m
GATE = ConeColor.BIG_ORANGE
B, Y, U = ConeColor.BLUE, ConeColor.YELLOW, ConeColor.UNKNOWN
TURNED = Pose(20.0, -7.0, 2.0)


def without(track: Track, *colors: ConeColor) -> Track:
    kept = ~np.isin(track.cone_colors, colors)
    return replace(track, cones_xy_m=track.cones_xy_m[kept], cone_colors=track.cone_colors[kept])


def recolored(track: Track, color_of: dict[ConeColor, ConeColor]) -> Track:
    colors = [color_of.get(ConeColor(color), ConeColor(color)) for color in track.cone_colors]
    return replace(track, cone_colors=np.array(colors, dtype=np.int64))


def moved(track: Track, by: Pose) -> Track:
    return replace(track, cones_xy_m=np.column_stack(by.ahead(*track.cones_xy_m.T)))


def moved_pose(pose: Pose, by: Pose) -> Pose:
    return Pose(*by.ahead(pose.x_m, pose.y_m), pose.yaw_rad + by.yaw_rad)


def on_lane(track: Track, ahead_m: float) -> Pose:
    """The car in the middle of the lane, its nose so far ahead of the line by the lane's way."""
    line = track.centreline_m
    assert line is not None
    step_m = track.length_m / len(line)
    at = round((ahead_m - NOSE_M) / step_m)
    rest_m = ahead_m - NOSE_M - at * step_m
    at %= len(line)
    x, y = line[(at + 2) % len(line)] - line[at - 2]
    there = Pose(float(line[at, 0]), float(line[at, 1]), math.atan2(y, x))
    return Pose(*there.ahead(rest_m), there.yaw_rad)


def nose_before_m(track: Track, mission: Ami) -> float:
    assert track.start_line is not None
    return -float(track.start_line.seen(*track.staging(mission, NOSE_M).ahead(NOSE_M))[0])


# ------------------------------------------------------------ the car's start


@pytest.mark.parametrize("past_m", [0.0, 0.4, NOSE_M, 5.0, 15.0, 40.0])
def test_a_car_start_on_the_line_is_staged_before_it_and_said(
    past_m: float, capsys: pytest.CaptureFixture[str]
) -> None:
    found = parse_track(as_csv(small_oval(), on_lane(small_oval(), past_m)), "loop.csv")
    assert found.closed and nose_before_m(found, Ami.AUTOCROSS) == pytest.approx(6.0, abs=0.3)
    said = capsys.readouterr().err
    assert "car_start has the car's nose" in said and "staged 6 m before it" in said


@pytest.mark.parametrize("before_m", [0.3, 3.0, 6.0, 30.0, 45.0])
def test_a_car_start_before_the_line_stays(before_m: float, capsys: pytest.CaptureFixture[str]) -> None:
    start = on_lane(small_oval(), -before_m)
    found = parse_track(as_csv(small_oval(), start), "loop.csv")
    assert astuple(found.staging(Ami.AUTOCROSS, NOSE_M)) == pytest.approx(astuple(start), abs=1e-3)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("track", "mission", "staged_m"),
    [(acceleration_track(), Ami.ACCELERATION, 0.30), (skidpad_track(), Ami.SKIDPAD, 15.0)],
)
@pytest.mark.parametrize("past_m", [0.0, 1.0, 6.0])
def test_so_it_is_on_a_straight_and_in_a_skidpad(track: Track, mission: Ami, staged_m: float, past_m: float) -> None:
    found = parse_track(as_csv(track, Pose(past_m - NOSE_M, 0.0, 0.0)), "given.csv")
    assert nose_before_m(found, mission) == pytest.approx(staged_m, abs=1e-3)


@pytest.mark.parametrize("deg", [-110.0, -90.0, 75.0, 100.0])
def test_a_car_start_across_the_lane_is_turned_into_it(deg: float, capsys: pytest.CaptureFixture[str]) -> None:
    start = on_lane(small_oval(), -6.0)
    across = Pose(start.x_m, start.y_m, start.yaw_rad + math.radians(deg))
    found = parse_track(as_csv(small_oval(), across), "loop.csv")
    assert found.closed and "gate of 4" in found.line_by
    assert astuple(found.staging(Ami.AUTOCROSS, NOSE_M)) == pytest.approx(astuple(start), abs=0.05)
    assert f"car_start points {abs(deg):.0f} deg out of the lane: the car is turned into it" in capsys.readouterr().err


@pytest.mark.parametrize("deg", [-90.0, 80.0])
@pytest.mark.parametrize(
    ("track", "mission", "before_m"),
    [(acceleration_track(), Ami.ACCELERATION, 0.3), (skidpad_track(), Ami.SKIDPAD, 15.0)],
)
def test_so_it_is_before_a_straight_and_a_skidpad(
    track: Track, mission: Ami, before_m: float, deg: float, capsys: pytest.CaptureFixture[str]
) -> None:
    across = Pose(-NOSE_M - before_m, 0.0, math.radians(deg))
    found = parse_track(as_csv(moved(track, TURNED), moved_pose(across, TURNED)), "given.csv")
    assert found.start_line is not None
    assert astuple(found.start_line) == pytest.approx(astuple(TURNED), abs=0.02)
    assert nose_before_m(found, mission) == pytest.approx(before_m, abs=0.02)
    assert f"car_start points {abs(deg):.0f} deg out of the lane" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("track", "start", "words"),
    [
        (small_oval(), Pose(-8.0, 2.5, 0.0), "car_start is not between the borders"),
        (small_oval(), Pose(200.0, 0.0, 0.0), "m from the nearest cone"),
        (skidpad_track(), Pose(-17.0, 3.0, 0.0), "car_start is not between the borders"),
        (skidpad_track(), Pose(-90.0, 0.0, 0.0), "car_start is 71 m from the nearest cone"),
        (acceleration_track(), Pose(-2.5, -4.0, 0.0), "car_start is not between the borders"),
    ],
)
def test_a_car_start_off_the_lane_is_said(
    track: Track, start: Pose, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parse_track(as_csv(track, start), "given.csv")
    assert words in capsys.readouterr().err


def test_blue_cones_on_the_cars_right_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    parse_track(as_csv(recolored(small_oval(), {B: Y, Y: B}), on_lane(small_oval(), -6.0)), "loop.csv")
    assert "its blue cones stand right of the car's way" in capsys.readouterr().err


# ------------------------------------------------------------ the line


@pytest.mark.parametrize("made", [small_oval(), generated_circuit(2), generated_circuit(5, "tight")])
@pytest.mark.parametrize("before_m", [25.0, 40.0, 60.0])
def test_a_gate_round_a_bend_from_the_start_is_the_line(made: Track, before_m: float) -> None:
    found = parse_track(as_csv(made, on_lane(made, -before_m)), "loop.csv")
    assert found.closed and found.length_m == pytest.approx(made.length_m, rel=0.03)
    assert found.start_line is not None and "gate of 4" in found.line_by
    assert astuple(found.start_line) == pytest.approx((0.0, 0.0, 0.0), abs=0.3)


@pytest.mark.parametrize(("at_m", "posts"), [(0.0, 6.0), (3.0, 2.5), (-4.0, 5.9)])
def test_timing_posts_are_the_line_where_there_is_no_gate(at_m: float, posts: float) -> None:
    text = as_csv(without(small_oval(), GATE), on_lane(small_oval(), -8.0))
    text += f"timekeeping,{at_m},{posts}\ntime_keeping,{at_m},{-posts}\n"
    found = parse_track(text, "loop.csv")
    assert found.start_line is not None and found.line_by == "2 timing posts"
    assert (found.start_line.x_m, found.start_line.y_m) == pytest.approx((at_m, 0.0), abs=0.02)
    saved = parse_track(as_csv(found, found.staging(Ami.AUTOCROSS, NOSE_M)), "again.csv")
    assert saved.start_line is not None and astuple(saved.start_line) == pytest.approx(
        astuple(found.start_line), abs=0.02
    )


@pytest.mark.parametrize("staged", [True, False])
@pytest.mark.parametrize(("before_m", "stays"), [(6.0, True), (12.0, False)])
def test_small_orange_cones_across_the_lane_are_its_line(staged: bool, before_m: float, stays: bool) -> None:
    made = recolored(small_oval(), {GATE: ConeColor.ORANGE})
    rows = [*as_csv(made, on_lane(made, -before_m)).splitlines(), "orange,0,11,0", "orange,10,20,0", "orange,12,20,0"]
    found = parse_track("\n".join(row for row in rows if staged or "car_start" not in row), "loop.csv")
    assert found.line_by == "its gate of 4 small orange cones, as no big ones and no timing posts mark it"
    assert found.start_line is not None and astuple(found.start_line) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert nose_before_m(found, Ami.AUTOCROSS) == pytest.approx(before_m if stays else 6.0, abs=0.3)


def test_a_circuit_without_posts_is_saved_without_any() -> None:
    found = parse_track(as_csv(without(small_oval(), GATE), on_lane(small_oval(), -8.0)), "loop.csv")
    text = as_csv(found, found.staging(Ami.AUTOCROSS, NOSE_M))
    assert "timekeeping" not in text and parse_track(text, "again.csv").line_by == found.line_by


@pytest.mark.parametrize(("before_m", "stays"), [(1.0, False), (4.7, True), (6.0, True), (7.3, True), (25.0, False)])
def test_a_line_that_no_gate_shows_is_as_far_as_by_the_rules(
    before_m: float, stays: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A planner that sees no gate takes the line to be where the rules have it from the staged car."""
    start = on_lane(small_oval(), -before_m)
    text = as_csv(without(small_oval(), GATE), start) + "timekeeping,0,3\ntimekeeping,0,-3\n"
    found = parse_track(text, "loop.csv")
    assert nose_before_m(found, Ami.AUTOCROSS) == pytest.approx(before_m if stays else 6.0, abs=0.3)
    assert ("which no gate shows to the car" in capsys.readouterr().err) is not stays


def test_posts_far_from_the_gate_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    text = as_csv(small_oval(), on_lane(small_oval(), -8.0)) + "timekeeping,8,3\ntimekeeping,8,-3\n"
    assert "timing posts" in parse_track(text, "loop.csv").line_by
    assert "its timing posts stand 8.0 m from its gate" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("posts", "words"),
    [
        ([(0.0, 3.0)], "1 of its timing posts stands alone"),
        ([(90.0, 3.0), (90.0, -3.0)], "its timing posts stand more than 6 m from the middle of the lane"),
    ],
)
def test_posts_that_mark_no_line_are_said(
    posts: list[tuple[float, float]], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "".join(f"timekeeping,{x},{y}\n" for x, y in posts)
    found = parse_track(as_csv(small_oval(), on_lane(small_oval(), -6.0)) + rows, "loop.csv")
    assert "gate of 4" in found.line_by and words in capsys.readouterr().err


def test_an_open_lane_that_bends_between_gates_is_no_straight(capsys: pytest.CaptureFixture[str]) -> None:
    made = acceleration_track()
    x, y = made.cones_xy_m.T
    bent = replace(made, cones_xy_m=np.column_stack((x, y + 8.0 * np.sin(np.clip(x, 0.0, 75.0) * math.pi / 75.0))))
    found = parse_track(as_csv(bent, Pose(-NOSE_M - 0.3, 0.0, 0.0)), "open.csv")
    assert found.kind is TrackKind.CIRCUIT and not found.closed
    assert found.start_line is not None and abs(found.start_line.x_m) < 0.1
    assert "no closed lane ahead of car_start" in capsys.readouterr().err


def test_the_nearest_gate_ahead_on_an_open_lane_is_the_line() -> None:
    half = small_oval().cones_xy_m[:, 0] > -14.0
    made = replace(small_oval(), cones_xy_m=small_oval().cones_xy_m[half], cone_colors=small_oval().cone_colors[half])
    far = "".join(f"big_orange,-5,{20.0 + y}\n" for y in (1.75, -1.75))
    found = parse_track(as_csv(made, Pose(-8.2, 0.0, 0.0)) + far, "open.csv")
    assert not found.closed and found.start_line is not None
    assert astuple(found.start_line) == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


def test_four_posts_make_a_straight_of_a_file_without_gates() -> None:
    posts = [f"timekeeping,{x},{y}" for x in (0.0, 75.0) for y in (4.0, -4.0)]
    text = as_csv(without(acceleration_track(), GATE), Pose(-NOSE_M - 0.3, 0.0, 0.0))
    found = parse_track("\n".join([text, *posts]), "run.csv")
    assert found.kind is TrackKind.ACCELERATION
    assert found.start_line is not None and found.finish_line is not None
    assert (found.start_line.x_m, found.finish_line.x_m) == pytest.approx((0.0, 75.0))


def test_a_lane_that_is_not_closed_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    kept = small_oval().cones_xy_m[:, 1] < 9.0
    half = replace(small_oval(), cones_xy_m=small_oval().cones_xy_m[kept], cone_colors=small_oval().cone_colors[kept])
    found = parse_track(as_csv(half, on_lane(small_oval(), -8.0)), "loop.csv")
    assert not found.closed and found.start_line is not None
    assert "no closed lane" in capsys.readouterr().err


# ------------------------------------------------------------ skidpads


@pytest.mark.parametrize("colors", [{}, {B: Y, Y: B}, {Y: B}, {B: U, Y: U}, {B: ConeColor.ORANGE}])
@pytest.mark.parametrize("gate", [True, False])
def test_a_skidpad_is_told_by_its_rings_whatever_their_colours(colors: dict[ConeColor, ConeColor], gate: bool) -> None:
    eight = moved(recolored(skidpad_track() if gate else without(skidpad_track(), GATE), colors), TURNED)
    start = Pose(*TURNED.ahead(-15.0 - NOSE_M, 0.2), TURNED.yaw_rad + 0.03)
    found = parse_track(as_csv(eight, start), "eight.csv")
    assert found.kind is TrackKind.SKIDPAD and check_track(found, Ami.SKIDPAD) is None
    assert found.start_line is not None
    assert astuple(found.start_line) == pytest.approx(astuple(TURNED), abs=0.02)


@pytest.mark.parametrize("colors", [{}, {B: Y, Y: B}])
def test_without_car_start_a_skidpad_is_entered_where_it_is_open(colors: dict[ConeColor, ConeColor]) -> None:
    eight = moved(recolored(skidpad_track(), colors), TURNED)
    found = parse_track("\n".join(as_csv(eight, Pose()).splitlines()[:-1]), "eight.csv")
    assert found.kind is TrackKind.SKIDPAD and found.start_line is not None
    assert astuple(found.start_line) == pytest.approx(astuple(TURNED), abs=0.02)


def halves(track: Track) -> Track:
    kept = (np.abs(track.cones_xy_m[:, 1]) < 9.2) | (track.cone_colors == GATE)
    return replace(track, cones_xy_m=track.cones_xy_m[kept], cone_colors=track.cone_colors[kept])


@pytest.mark.parametrize(
    "wrong",
    [
        replace(skidpad_track(), cones_xy_m=0.7 * skidpad_track().cones_xy_m),
        replace(skidpad_track(), cones_xy_m=skidpad_track().cones_xy_m * (1.0, 1.4)),
        halves(skidpad_track()),
        small_oval(),
    ],
)
def test_what_makes_no_skidpad_is_said_with_what_one_is(wrong: Track) -> None:
    found = parse_track(as_csv(wrong, Pose(-15.0, 0.0, 0.0)), "eight.csv")
    assert found.kind is not TrackKind.SKIDPAD
    problem = check_track(found, Ami.SKIDPAD)
    assert problem is not None and "two whole rings of cones 15.25 m wide" in problem
