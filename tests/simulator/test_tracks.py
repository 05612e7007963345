"""Tracks: the rules' geometry, generated circuits, files good and bad."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import astuple

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks import (
    BUILT_IN,
    STYLES,
    Track,
    TrackError,
    TrackKind,
    acceleration_track,
    as_csv,
    generated_circuit,
    load_track,
    parse_track,
    random_circuit,
    skidpad_track,
    small_oval,
)
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.planning.pose import gaps, ring_curvature
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami

NOSE_M = ADS_DV_2026.nose_ahead_of_rear_axle_m
CIRCUITS = ("autocross", "trackdrive", "small_oval", "random-1", "random-2", "random-77")


def cones(track: Track, color: ConeColor) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in track.cones_xy_m[track.cone_colors == int(color)]]


def middle(track: Track) -> np.ndarray:
    assert track.centreline_m is not None
    return track.centreline_m


def steps(line: np.ndarray) -> np.ndarray:
    return np.asarray(np.hypot(*(np.roll(line, -1, axis=0) - line).T))


def turns(line: np.ndarray) -> np.ndarray:
    """Angle by which the line turns from the metre before each point to the metre after it, rad."""
    ring = line @ (1.0, 1j)
    return np.abs(np.angle((np.roll(ring, -4) - ring) / (ring - np.roll(ring, 4))))


def lane_widths(track: Track) -> np.ndarray:
    assert track.left_border_m is not None and track.right_border_m is not None
    return np.asarray(np.hypot(*(track.left_border_m - track.right_border_m).T))


def line_of(track: Track) -> Pose:
    assert track.start_line is not None
    return track.start_line


def shuffled(track: Track, pose: Pose) -> list[str]:
    """The lines of the track's file, its cones in no useful order."""
    header, *rows = as_csv(track, pose).splitlines()
    return [header, *np.random.default_rng(3).permutation(rows).tolist()]


def without_gate(track: Track, pose: Pose) -> str:
    return "\n".join(line for line in shuffled(track, pose) if "orange" not in line)


# ------------------------------------------------------------ the rules' geometry


def test_acceleration_is_75_m_long_with_100_m_to_stop_in() -> None:
    track = acceleration_track()
    assert track.finish_line is not None
    assert line_of(track).seen(track.finish_line.x_m, track.finish_line.y_m) == (75.0, 0.0)
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
    pose = loaded.staging(mission, NOSE_M)
    assert line_of(loaded).seen(*pose.ahead(NOSE_M))[0] == pytest.approx(-before_m)
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
    assert 1.0 / turns(line).max() > 7.5  # the chords' middles are 1 m apart; the inner border is then still 5.75 m
    assert lane_widths(track).min() >= 3.0
    assert len(cones(track, ConeColor.BIG_ORANGE)) == 4
    for color in (ConeColor.BLUE, ConeColor.YELLOW):
        *along, over_the_gate = steps(np.array(cones(track, color)))
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


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("style", STYLES)
def test_a_generated_circuit_keeps_the_rules(style: str, seed: int) -> None:
    track = generated_circuit(seed, style)
    assert track.closed and 200.0 <= track.length_m <= 500.0
    line, lane_m = middle(track), lane_widths(track)
    assert lane_m.min() >= 3.0 - 1e-6 and lane_m.max() <= 5.0 + 1e-6
    turn = turns(line)
    least_m = 8.8 if style == "sharp" else 9.0  # of the rules, and a little harder
    assert 2.0 / turn.max() + lane_m.max() >= least_m - 0.1, "the outside diameter of the tightest hairpin"
    bent = np.flatnonzero(turn > 0.01)
    assert np.diff([*bent, bent[0] + len(line)]).max() * 0.25 <= 80.0 + 1.5, "the longest straight"
    gate = np.array(cones(track, ConeColor.BIG_ORANGE))
    assert len(gate) == 4
    for color, side in ((ConeColor.BLUE, 1.0), (ConeColor.YELLOW, -1.0)):
        posts = gate[gate[:, 1] * side > 0.0]
        row = np.vstack([posts[posts[:, 0] > 0.0], cones(track, color), posts[posts[:, 0] < 0.0]])
        assert steps(row)[:-1].max() <= 5.0
        assert gaps(row, line).min() > lane_m.min() / 2.0 - 0.1, "no cone of another part of the lane in this one"


def test_sharp_corners_are_as_sharp_as_the_rules_allow() -> None:
    tracks = [generated_circuit(seed, "sharp") for seed in range(12)]
    inside, apart = [], []
    for track in tracks:
        bend = np.abs(ring_curvature(middle(track), 4))
        inside.append(1.0 / bend.max() - lane_widths(track).mean() / 2.0)
        apart.append(min(steps(np.array(cones(track, color))).min() for color in (ConeColor.BLUE, ConeColor.YELLOW)))
    assert 1.3 < min(inside) < 1.6 and max(inside) < 4.0
    assert min(apart) < 2.0 and max(apart) > 3.0, "cones are close in the bends of one circuit, far apart in another's"


def test_circuits_known_by_their_seeds_stay_as_they_are() -> None:
    known = {"generated-1": "57fb535bef285c11", "generated-3-islands": "e58408cdcf950b5e"}
    for name, digest in known.items():
        track = load_track(name)
        found = np.round(np.vstack([track.cones_xy_m, middle(track)]), 6) + 0.0
        assert sha256(found.tobytes()).hexdigest()[:16] == digest, name


def test_a_seed_and_a_style_always_give_the_same_circuit() -> None:
    again = load_track(load_track("generated-5-tight").source)
    assert np.array_equal(generated_circuit(5, "tight").cones_xy_m, again.cones_xy_m)
    assert not np.array_equal(generated_circuit(5).cones_xy_m[:9], again.cones_xy_m[:9])


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


@pytest.mark.parametrize("name", ["autocross", "small_oval", "random-3", "generated-2-tight"])
def test_the_borders_of_a_circuit_from_a_file_are_found(name: str) -> None:
    made = load_track(name)
    pose = made.staging(Ami.AUTOCROSS, 2.17)
    found = parse_track("\n".join(shuffled(made, pose)), "some/where/loop.csv")
    assert found.kind is TrackKind.CIRCUIT
    assert found.closed
    assert found.name == "loop"
    assert astuple(found.staging(Ami.AUTOCROSS, 2.17)) == pytest.approx(astuple(pose), abs=1e-4)
    assert found.length_m == pytest.approx(made.length_m, rel=0.02)
    assert gaps(middle(found), middle(made)).min(axis=1).max() < 0.4
    assert (line_of(found).x_m, line_of(found).y_m) == pytest.approx((0.0, 0.0), abs=0.3)


def test_acceleration_and_skidpad_from_a_file_are_recognised() -> None:
    run = parse_track(as_csv(acceleration_track(), Pose(-2.5, 0.0, 0.0)), "run.csv")
    assert run.kind is TrackKind.ACCELERATION
    assert run.finish_line is not None and run.finish_line.x_m - line_of(run).x_m == pytest.approx(75.0)
    eight = parse_track(as_csv(skidpad_track(), Pose(-17.0, 0.0, 0.02)), "eight.csv")
    assert eight.kind is TrackKind.SKIDPAD
    assert line_of(eight).yaw_rad == pytest.approx(0.0, abs=1e-6)
    blind = parse_track("\n".join(as_csv(skidpad_track(), Pose()).splitlines()[:-1]), "eight.csv")
    assert blind.kind is TrackKind.SKIDPAD
    assert blind.staging(Ami.SKIDPAD, NOSE_M).x_m == pytest.approx(-15.0 - NOSE_M)


def test_extra_columns_blank_lines_and_a_bom_are_ignored(tmp_path: Path) -> None:
    header, *rows = shuffled(small_oval(), Pose(-8.0, 0.0, 0.0))
    text = "\n".join([header + ",more", "", *rows, ""])
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


def test_a_cone_that_is_in_the_file_twice_stands_once(capsys: pytest.CaptureFixture[str]) -> None:
    rows = as_csv(small_oval(), Pose(-8.0, 0.0, 0.0))
    again = "".join(f"{row}\n" for row in rows.splitlines()[1:] if "car_start" not in row)
    assert len(parse_track(rows + again, "loop.csv").cones_xy_m) == len(small_oval().cones_xy_m)
    count = len(small_oval().cones_xy_m)
    assert capsys.readouterr().err == f"loop.csv: skipped {count} cones that stood in the file before\n"


def test_a_tag_that_means_nothing_is_skipped_with_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    rows = as_csv(small_oval(), Pose(-8.0, 0.0, 0.0))
    track = parse_track(rows + "purple,1,2\npurple,3,2\nunknown,50,50\ntimekeeping,0,4\ntimekeeping,0,-4\n", "loop.csv")
    assert capsys.readouterr().err == "loop.csv: skipped 2 rows with tag 'purple'\n"
    assert cones(track, ConeColor.UNKNOWN) == [(50.0, 50.0)]
    assert len(track.cones_xy_m) == len(small_oval().cones_xy_m) + 1


def test_a_file_without_a_header_is_read() -> None:
    rows = as_csv(small_oval(), Pose(-8.0, 0.0, 0.0)).splitlines()[1:]
    assert len(parse_track("\n".join(rows), "loop.csv").cones_xy_m) == len(small_oval().cones_xy_m)


def pacsim(track: Track) -> dict[str, object]:
    """The small oval as PacSim has it: the gate's cones are of the rows, and a pose of what is driven."""
    classes = {ConeColor.BLUE: "blue", ConeColor.YELLOW: "yellow", ConeColor.BIG_ORANGE: "big-orange"}
    rows = [
        {"position": [*xy.tolist(), 0.0], "class": classes[ConeColor(color)]}
        for xy, color in zip(track.cones_xy_m, track.cone_colors, strict=True)
    ]
    # Whatever class they have: FSG24.yaml has unknown.
    posts = [{"position": [0.5, y, 0.0], "class": "unknown"} for y in (5.0, -6.0)]
    centre = Pose(-8.0, 0.1, 0.02).ahead(ADS_DV_2026.cog_ahead_of_rear_axle_m)
    start = {"position": [*centre, 0.0], "orientation": [0.0, 0.0, 0.02]}
    return {"track": {"start": start, "left": rows[::2], "right": rows[1::2], "time_keeping": posts, "unknown": []}}


def fssim(track: Track) -> dict[str, object]:
    colors = {"cones_left": ConeColor.BLUE, "cones_right": ConeColor.YELLOW, "cones_orange_big": ConeColor.BIG_ORANGE}
    lists: dict[str, object] = {name: cones(track, color) for name, color in colors.items()}
    nose = Pose(-8.0, 0.1, 0.02).ahead(ADS_DV_2026.nose_ahead_of_rear_axle_m)
    return lists | {
        "cones_orange": [],
        "starting_pose_front_wing": [*nose, 0.02],
        "tk_device": [[0.5, 3.0], [0.5, -3.0]],
    }


@pytest.mark.parametrize("layout", [pacsim, fssim])
def test_a_track_of_pacsim_and_of_fssim_is_read(layout: Callable[[Track], object], tmp_path: Path) -> None:
    pytest.importorskip("yaml", reason="PyYAML comes with ROS; else: pip install pyyaml")
    path = tmp_path / "loop.yaml"
    path.write_text(json.dumps(layout(small_oval())))  # JSON is YAML
    found = load_track(path)
    assert sorted(found.cone_colors.tolist()) == sorted(small_oval().cone_colors.tolist())
    assert found.closed and found.length_m == pytest.approx(small_oval().length_m, rel=0.02)
    assert astuple(found.staging(Ami.AUTOCROSS, 2.17)) == pytest.approx((-8.0, 0.1, 0.02))
    assert found.line_by == "2 timing posts"
    assert (line_of(found).x_m, line_of(found).y_m) == pytest.approx((0.5, 0.0), abs=0.02)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [", "not valid YAML"),
        ("- 1", "neither YAML of PacSim"),
        ("", "neither YAML of PacSim"),
        ("track: {left: [{class: blue}]}", "bad.yaml: left 1: has no position"),
        ("cones_left: [[1]]", "bad.yaml: cones_left 1 is [1], not a list of 2 numbers"),
        ("cones_left: [[1, up]]", "cones_left 1: y is 'up', not a number"),
    ],
)
def test_malformed_yaml_is_one_line(text: str, words: str) -> None:
    pytest.importorskip("yaml", reason="PyYAML comes with ROS; else: pip install pyyaml")
    with pytest.raises(TrackError) as caught:
        parse_track(text, "bad.yaml")
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_yaml_without_pyyaml_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(TrackError, match="pip install pyyaml"):
        parse_track("track: {}", "loop.yaml")


@pytest.mark.parametrize("kept", ["", "orange"])
def test_without_car_start_the_car_is_staged_before_the_line(kept: str, capsys: pytest.CaptureFixture[str]) -> None:
    made = load_track("autocross")
    rows = [row for row in as_csv(made, Pose()).splitlines() if "car_start" not in row and not (kept and kept in row)]
    found = parse_track("\n".join(rows), "loop.csv")
    assert capsys.readouterr().err == "loop.csv: no car_start: the car is staged before the line\n"
    pose = found.staging(Ami.AUTOCROSS, NOSE_M)
    assert line_of(found).seen(*pose.ahead(NOSE_M))[0] == pytest.approx(-6.0, abs=0.3)
    near = int(np.argmin(np.hypot(*(middle(made) - (pose.x_m, pose.y_m)).T)))
    along = middle(made)[near + 1] - middle(made)[near]
    assert np.hypot(*(middle(made)[near] - (pose.x_m, pose.y_m))) < 0.3
    assert math.cos(math.atan2(along[1], along[0]) - pose.yaw_rad) > 0.99


def test_without_car_start_a_gate_across_a_wide_lane_is_one() -> None:
    gates = [f"big_orange,{x},{y}" for x in (0.0, 75.0) for y in (2.7, 2.9, -2.7, -2.9)]
    lane = [f"{tag},{x},{y}" for x in range(5, 100, 5) for tag, y in (("blue", 2.7), ("yellow", -2.7))]
    line = line_of(parse_track("\n".join(("tag,x,y", *gates, *lane)), "wide.csv"))
    assert (line.x_m, line.y_m) == pytest.approx((0.0, 0.0), abs=0.01)


# ------------------------------------------------------------ the line


@pytest.mark.parametrize("name", ["small_oval", "generated-4"])
def test_without_a_gate_the_line_is_where_the_planner_has_it(name: str) -> None:
    made = load_track(name)
    pose = made.staging(Ami.AUTOCROSS, NOSE_M)
    back = Pose(*pose.ahead(-2.0), pose.yaw_rad)
    line = line_of(parse_track(without_gate(made, back), "loop.csv"))
    assert (line.x_m, line.y_m, line.yaw_rad) == pytest.approx((-2.0, 0.0, 0.0), abs=0.2)


def test_the_line_of_an_askew_gate_is_across_the_lane() -> None:
    gate = ["big_orange,1,1.75", "big_orange,1.8,1.75", "big_orange,2.6,1.75", "big_orange,-2,-1.75"]
    text = "\n".join([without_gate(small_oval(), Pose(-8.0, 0.2, -0.1)), *gate])
    line = line_of(parse_track(text, "loop.csv"))
    assert (line.x_m, line.y_m, line.yaw_rad) == pytest.approx((-0.1, 0.0, 0.0), abs=0.2)


def test_every_built_in_track_can_be_loaded_again_by_its_source() -> None:
    for name in BUILT_IN:
        assert load_track(load_track(name).source).name == name
