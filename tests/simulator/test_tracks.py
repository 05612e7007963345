"""Tracks: the rules' geometry, generated circuits, files good and bad."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks import (
    BUILT_IN,
    Track,
    TrackError,
    TrackKind,
    acceleration_track,
    load_track,
    parse_track,
    random_circuit,
    skidpad_track,
    small_oval,
)
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami

CIRCUITS = ("autocross", "trackdrive", "small_oval", "random-1", "random-2", "random-77")


def cones(track: Track, color: ConeColor) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in track.cones_xy_m[track.cone_colors == int(color)]]


def middle(track: Track) -> np.ndarray:
    assert track.centreline_m is not None
    return track.centreline_m


def gaps(line: np.ndarray) -> np.ndarray:
    return np.asarray(np.hypot(*(np.roll(line, -1, axis=0) - line).T))


def as_csv(track: Track, pose: Pose) -> str:
    """The track as a file has it: cones in no useful order, and where the car starts."""
    names = {1: "blue", 2: "yellow", 3: "orange", 4: "big_orange"}
    rows = [f"{names[int(c)]},{x:.4f},{y:.4f}" for (x, y), c in zip(track.cones_xy_m, track.cone_colors, strict=True)]
    order = np.random.default_rng(3).permutation(len(rows))
    start = f"car_start,{pose.x_m},{pose.y_m},{pose.yaw_rad}"
    return "\n".join(["tag,x,y,direction", start, *(rows[i] for i in order)]) + "\n"


# ------------------------------------------------------------ the rules' geometry


def test_acceleration_is_75_m_long_with_100_m_to_stop_in() -> None:
    track = acceleration_track()
    assert track.start_line is not None and track.finish_line is not None
    assert track.start_line.seen(track.finish_line.x_m, track.finish_line.y_m) == (75.0, 0.0)
    assert max(x for x, _ in cones(track, ConeColor.ORANGE)) >= 175.0
    assert min(abs(y) for _, y in cones(track, ConeColor.BLUE)) >= 1.5
    assert len(cones(track, ConeColor.BIG_ORANGE)) == 8


def test_skidpad_has_the_official_circles() -> None:
    track = skidpad_track()
    for side, inner, outer in ((1, ConeColor.BLUE, ConeColor.YELLOW), (-1, ConeColor.YELLOW, ConeColor.BLUE)):
        centre = (0.0, side * 18.25 / 2)
        near = [math.dist(c, centre) for c in cones(track, inner) if c[1] * side > 0]
        far = [math.dist(c, centre) for c in cones(track, outer) if c[1] * side > 0]
        assert near == pytest.approx([15.25 / 2] * 16)
        assert far == pytest.approx([15.25 / 2 + 3.0] * 13)
    # the route is two laps right and two left
    step = np.diff(middle(track), axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    assert heading.min() == pytest.approx(-4.0 * math.pi, abs=0.1)
    assert heading[-1] == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize(
    ("mission", "track", "before_m"),
    [
        (Ami.ACCELERATION, "acceleration", 0.30),
        (Ami.SKIDPAD, "skidpad", 15.0),
        (Ami.AUTOCROSS, "autocross", 6.0),
        (Ami.TRACKDRIVE, "trackdrive", 6.0),
    ],
)
def test_the_car_is_staged_with_its_nose_so_far_before_the_line(mission: Ami, track: str, before_m: float) -> None:
    loaded = load_track(track)
    nose_m = ADS_DV_2026.nose_ahead_of_rear_axle_m
    pose = loaded.staging(mission, nose_m)
    assert loaded.start_line is not None
    assert loaded.start_line.seen(*pose.ahead(nose_m))[0] == pytest.approx(-before_m)
    assert loaded.on_lane(*pose.ahead(0.0))


@pytest.mark.parametrize("name", CIRCUITS)
def test_a_circuit_is_drivable_by_rule(name: str) -> None:
    track = load_track(name)
    assert track.closed
    line = middle(track)
    assert 90.0 < track.length_m < 310.0
    start = [(x, y) for x, y in line if -8.0 < x < 6.0 and abs(y) < 3.0]
    assert len(start) > 40
    assert max(abs(y) for _, y in start) < 0.3, "it begins with a straight"
    ahead, behind = np.roll(line, -4, axis=0) - line, line - np.roll(line, 4, axis=0)
    bend = np.arctan2(ahead[:, 1], ahead[:, 0]) - np.arctan2(behind[:, 1], behind[:, 0])
    turn = np.abs(np.remainder(bend + math.pi, 2.0 * math.pi) - math.pi)
    assert 1.0 / turn.max() > 7.5  # the chords' middles are 1 m apart; the inner border is then still 5.75 m
    assert track.left_border_m is not None and track.right_border_m is not None
    width = np.hypot(*(track.left_border_m - track.right_border_m).T)
    assert width.min() >= 3.0
    assert len(cones(track, ConeColor.BIG_ORANGE)) == 4
    for color in (ConeColor.BLUE, ConeColor.YELLOW):
        row = np.array(cones(track, color))
        *along, over_the_gate = gaps(row)
        assert min(along) > 0.5
        assert max(along) <= 5.0  # rule: cones of a border at most 5 m apart
        assert over_the_gate <= 2 * 5.0


def test_blue_cones_are_on_the_left_and_yellow_ones_on_the_right() -> None:
    track = load_track("autocross")
    line = middle(track)
    for color, side in ((ConeColor.BLUE, 1.0), (ConeColor.YELLOW, -1.0)):
        for x, y in cones(track, color):
            i = int(np.argmin(np.hypot(line[:, 0] - x, line[:, 1] - y)))
            tx, ty = line[(i + 1) % len(line)] - line[i - 1]
            assert (tx * (y - line[i, 1]) - ty * (x - line[i, 0])) * side > 0.0


def test_a_seed_gives_one_circuit_and_another_seed_another() -> None:
    assert np.array_equal(random_circuit(5).cones_xy_m, random_circuit(5).cones_xy_m)
    assert not np.array_equal(random_circuit(5).centreline_m, random_circuit(6).centreline_m)


@pytest.mark.parametrize("name", ["acceleration", "skidpad", "autocross", "small_oval"])
def test_the_centreline_is_on_the_lane_and_points_beside_are_not(name: str) -> None:
    track = load_track(name)
    line = middle(track)
    assert all(track.on_lane(float(x), float(y)) for x, y in line[::7])
    far = float(line[:, 1].max()) + 30.0
    assert not track.on_lane(float(line[0, 0]), far)
    if track.closed:
        assert not track.on_lane(*(float(v) for v in line.mean(axis=0))), "the infield"


# ------------------------------------------------------------ files


@pytest.mark.parametrize("name", ["autocross", "small_oval", "random-3"])
def test_the_borders_of_a_circuit_from_a_file_are_found(name: str) -> None:
    made = load_track(name)
    pose = made.staging(Ami.AUTOCROSS, 2.17)
    found = parse_track(as_csv(made, pose), "some/where/loop.csv")
    assert found.kind is TrackKind.CIRCUIT
    assert found.closed
    assert found.name == "loop"
    assert found.staging(Ami.AUTOCROSS, 2.17) == pose
    assert found.length_m == pytest.approx(made.length_m, rel=0.02)
    line, truth = middle(found), middle(made)
    apart = np.hypot(line[:, None, 0] - truth[None, :, 0], line[:, None, 1] - truth[None, :, 1]).min(axis=1)
    assert apart.max() < 0.4
    assert found.start_line is not None
    assert (found.start_line.x_m, found.start_line.y_m) == pytest.approx((0.0, 0.0), abs=0.3)


def test_acceleration_and_skidpad_from_a_file_are_recognised() -> None:
    run = parse_track(as_csv(acceleration_track(), Pose(-2.5, 0.0, 0.0)), "run.csv")
    assert run.kind is TrackKind.ACCELERATION
    assert run.start_line is not None and run.finish_line is not None
    assert run.finish_line.x_m - run.start_line.x_m == pytest.approx(75.0)
    eight = parse_track(as_csv(skidpad_track(), Pose(-17.0, 0.0, 0.02)), "eight.csv")
    assert eight.kind is TrackKind.SKIDPAD
    assert eight.start_line is not None
    assert eight.start_line.yaw_rad == pytest.approx(0.0, abs=1e-6)


def test_extra_columns_blank_lines_and_a_bom_are_ignored(tmp_path: Path) -> None:
    header, *rows = as_csv(small_oval(), Pose(-8.0, 0.0, 0.0)).splitlines()
    text = "\n".join([header + ",x_variance,y_variance,xy_covariance", "", *rows, ""])
    path = tmp_path / "oval.csv"
    path.write_text(text, encoding="utf-8-sig")
    track = load_track(path)
    assert len(track.cones_xy_m) == len(small_oval().cones_xy_m)
    assert load_track(track.source).name == "oval"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["line 1", "header"]),
        ("x,y,tag\n1,2,blue\n", ["line 1", "tag,x,y"]),
        ("tag,x,y\nblue,1\n", ["line 2", "2 columns"]),
        ("tag,x,y\nblue,1,2\nblue,one,2\n", ["line 3", "x is 'one'"]),
        ("tag,x,y\nblue,1,nan\n", ["line 2", "y is nan", "finite"]),
        ("tag,x,y\nblue,1,2\npurple,1,2\n", ["line 3", "'purple'", "big_orange"]),
        ("tag,x,y,direction\ncar_start,0,0,north\n", ["line 2", "direction", "'north'"]),
        ("tag,x,y,direction\ncar_start,0,0,0\ncar_start,1,0,0\n", ["line 3", "second car_start"]),
        ("tag,x,y\nblue,1,2\n", ["no car_start"]),
        ("tag,x,y,direction\ncar_start,0,0,0\n", ["no cones"]),
    ],
)
def test_a_malformed_file_is_one_line_with_file_line_and_fault(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(TrackError) as caught:
        load_track(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    assert all(word in message for word in words), message


def test_missing_and_binary_files_and_unknown_names_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(TrackError, match=r"gone\.csv: cannot be read: No such file"):
        load_track(tmp_path / "gone.csv")
    (tmp_path / "picture.csv").write_bytes(b"\xff\xfe\x00\x89")
    with pytest.raises(TrackError, match="not a text file"):
        load_track(tmp_path / "picture.csv")
    with pytest.raises(TrackError, match=r"silverstone: no such track; built in are .*skidpad"):
        load_track("silverstone")


def test_cones_that_form_no_lane_have_no_borders() -> None:
    track = parse_track("tag,x,y,direction\ncar_start,0,0,0\norange,5,1,0\norange,5,-1,0\n", "few.csv")
    assert track.centreline_m is None
    assert track.on_lane(1000.0, 1000.0)


def test_every_built_in_track_can_be_loaded_again_by_its_source() -> None:
    for name in BUILT_IN:
        assert load_track(load_track(name).source).name == name
