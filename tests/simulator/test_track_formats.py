"""Track files of other programs: each format as its program writes it, and what is wrong with one in one line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import astuple

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks import Track, TrackError, as_csv, load_track, parse_track, small_oval
from fsai_hil.simulator.tracks.formats import FORMATS, LAYOUT_MERCHANT_COLORS
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.interface.enums import Ami

START = Pose(-8.0, 0.1, 0.02)
OVAL = small_oval()
NAMES = [ConeColor(color).name.lower() for color in OVAL.cone_colors]


def epfl(folder: Path) -> Path:
    rows = [
        f"{'small_orange' if name == 'orange' else name},{x},{y},0.0,0.0,0.0,0.0,{int(y < 0)},{int(y > 0)}"
        for name, (x, y) in zip(NAMES, OVAL.cones_xy_m, strict=True)
    ]
    path = folder / "loop_cones.csv"
    path.write_text("\n".join(["cone_type,X,Y,Z,std_X,std_Y,std_Z,right,left", *rows]))
    return path


def merchant(**changes: Any) -> dict[str, Any]:
    x, y = OVAL.cones_xy_m.T.tolist()
    colors = [LAYOUT_MERCHANT_COLORS.index(name) for name in NAMES]
    start = {"start_position": [START.x_m, START.y_m], "start_orientation": math.degrees(START.yaw_rad)}
    line = {"timing_line_position": [0.2, 0.0], "timing_line_orientation": 1.0, "timing_line_width": 2}
    return {"x": x, "y": y, "color": colors} | start | line | changes


def layout_merchant(folder: Path) -> Path:
    path = folder / "loop.json"
    path.write_text(json.dumps(merchant()))
    return path


def starkstrom(folder: Path) -> Path:
    pytest.importorskip("yaml", reason="PyYAML comes with ROS; else: pip install pyyaml")
    borders: dict[str, list[int]] = {"left": [], "right": []}
    cones: list[str] = []
    for number, (name, (x, y)) in enumerate(zip(NAMES, OVAL.cones_xy_m, strict=True), 5):
        cones.append(f"{number}:\n- {x}\n- {y}\n")
        side = {"blue": "left", "yellow": "right"}.get(name)
        if side is not None:
            borders[side].append(number)
    (folder / "cone_map_3.yaml").write_text("".join(cones))
    path = folder / "boundaries_3.yaml"
    path.write_text("".join(f"{side}:\n" + "".join(f"- {n}\n" for n in each) for side, each in borders.items()))
    return path


def of_the_lane(track: Track) -> list[ConeColor]:
    return sorted(ConeColor(color) for color in track.cone_colors if color in (ConeColor.BLUE, ConeColor.YELLOW))


@pytest.mark.parametrize("written", [epfl, layout_merchant, starkstrom])
def test_a_track_of_another_program_is_read_as_it_is(written: Callable[[Path], Path], tmp_path: Path) -> None:
    found = load_track(written(tmp_path))
    assert found.closed and found.length_m == pytest.approx(OVAL.length_m, rel=0.03)
    assert of_the_lane(found) == of_the_lane(OVAL)
    again = load_track(found.source)
    assert astuple(again.staging(Ami.AUTOCROSS, 2.17)) == astuple(found.staging(Ami.AUTOCROSS, 2.17))


def test_layout_merchants_start_and_line_are_where_it_has_them(tmp_path: Path) -> None:
    found = load_track(layout_merchant(tmp_path))
    assert astuple(found.staging(Ami.AUTOCROSS, 2.17)) == pytest.approx(astuple(START))
    assert found.start_line is not None and "timing posts" in found.line_by
    assert (found.start_line.x_m, found.start_line.y_m) == pytest.approx((0.2, 0.0), abs=0.13)
    assert load_track(layout_merchant(tmp_path).rename(tmp_path / "no_suffix.txt")).closed


def test_either_file_of_starkstrom_names_the_track(tmp_path: Path) -> None:
    borders = load_track(starkstrom(tmp_path))
    cones = load_track(tmp_path / "cone_map_3.yaml")
    assert borders.length_m == cones.length_m
    assert ConeColor.BIG_ORANGE not in borders.cone_colors, "cones on no border may be none"


def test_a_second_header_is_named_by_its_line(capsys: pytest.CaptureFixture[str]) -> None:
    header, *rows = as_csv(OVAL, START).splitlines()
    for second in (header, header.upper(), "cone_type,X,Y,Z"):
        text = "\n".join([header, *rows[:20], "", second, *rows[20:]])
        assert len(parse_track(text, "loop.csv").cones_xy_m) == len(OVAL.cones_xy_m)
        assert capsys.readouterr().err.startswith("loop.csv: line 23 is a second header: ")


def test_a_table_may_have_comments_and_spaces_in_its_names() -> None:
    text = as_csv(OVAL, START).replace("big_orange", "Big Orange").replace("car_start", "car start")
    header, *rows = text.splitlines()
    for lines in (
        ["# by hand", header, *rows[:5], "# the far side", *rows[5:]],
        [rows[-1].upper().replace(" ", "_"), *rows[:-1]],
    ):
        found = parse_track("\n".join(lines), "loop.csv")
        assert astuple(found.staging(Ami.AUTOCROSS, 2.17)) == pytest.approx(astuple(START))
        assert found.cone_colors.tolist() == OVAL.cone_colors.tolist()


def test_a_direction_is_what_the_header_calls_so(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [f"{name},{x},{y},0.3" for name, (x, y) in zip(NAMES, OVAL.cones_xy_m, strict=True)]
    for columns, start, said in (
        ("z", "-8,0,0.3", "loop.csv: car_start has no direction: it is taken to be 0, along x\n"),
        ("z,direction", "-8,0,0.3,0", ""),
    ):
        found = parse_track("\n".join([f"tag,x,y,{columns}", *rows, f"car_start,{start}"]), "loop.csv")
        assert found.staging(Ami.AUTOCROSS, 2.17) == Pose(-8.0, 0.0, 0.0)
        assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("bad.json", '{"x": [1', "not valid JSON"),
        ("bad.json", "[]", "neither YAML of PacSim (track), "),
        ("bad.json", json.dumps({"cones": []}), "JSON of layout-merchant (x, y, color)"),
        ("bad.json", json.dumps(merchant(x=[1.0])), "x, y and color have 1, "),
        ("bad.json", json.dumps(merchant(color=[7] * len(OVAL.cones_xy_m))), "cone 1: color is 7, not 0 to 4"),
        ("bad.json", json.dumps(merchant(start_orientation="north")), "start: orientation is 'north', not a number"),
        ("bad.json", json.dumps(merchant(start_position=None)), "start: position is nothing, not a list of 2 numbers"),
        ("bad.csv", "cone_type,X,Y,Z\nblue,1\n", "line 2: 2 columns where at least cone_type, x, y"),
        ("bad.csv", "cone_type,X,Y,Z\nblue,1,up,0\n", "line 2: y is 'up'"),
        ("bad.csv", "id,x,y\n", "line 1: the header must begin with tag,x,y"),
        ("bad.csv", "# mine\n\nid,x,y\n", "line 3: the header must begin with tag,x,y"),
        ("bad.csv", "tag,x,y\nblue\n", "line 2: 1 column where at least tag, x, y"),
        ("bad.csv", "car_start,1,2,90\nblue,1,2\n", "line 1: direction is 90, more than a full turn; is it in rad?"),
        ("bad.json", '{"x": 1, "y": [2], "color": [1]}', "bad.json: x is 1, not a list"),
        ("bad.yaml", "track: oval\n", "bad.yaml: track is 'oval', not a mapping"),
        ("bad.yaml", "track: {left: {}}\n", "bad.yaml: track: left is {}, not a list"),
        ("bad.yaml", "track: {left: [{position: [1, 2]}]}\n", "bad.yaml: left 1: has no class"),
        (
            "bad.yaml",
            "track: {left: [{position: [1], class: blue}]}\n",
            "left 1: position is [1], not a list of 2 numbers",
        ),
        (
            "bad.yaml",
            "track: {left: [], start: {position: [1, 2], orientation: [0]}}\n",
            "start: orientation is [0], not",
        ),
        ("bad.yaml", "cones_left: many\n", "bad.yaml: cones_left is 'many', not a list"),
        ("bad.yaml", "cones_left: [[1]]\n", "bad.yaml: cones_left 1 is [1], not a list of 2 numbers"),
        ("bad.yaml", "cones_left: [\n[1, 2\n", "bad.yaml: line 3: not valid YAML: while parsing a flow sequence"),
        ("boundaries_1.yaml", "left: [1]\nright: [2]\n", "cone_map_1.yaml, which belongs to it, cannot be read"),
        ("borders.yaml", "left: [1]\nright: [2]\n", "not named boundaries_N.yaml"),
        ("cone_map_1.yaml", "5: [1, 2]\n", "boundaries_1.yaml, which belongs to it, cannot be read"),
        ("numbers.yaml", "5: [1, 2]\n", "not named cone_map_N.yaml"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_line(name: str, text: str, words: str, tmp_path: Path) -> None:
    if name.endswith("yaml"):
        pytest.importorskip("yaml", reason="PyYAML comes with ROS; else: pip install pyyaml")
    (tmp_path / name).write_text(text)
    with pytest.raises(TrackError) as caught:
        load_track(tmp_path / name)
    assert words in str(caught.value) and "\n" not in str(caught.value) and name in str(caught.value)


def test_a_cone_on_a_border_that_is_not_in_the_map_is_named(tmp_path: Path) -> None:
    path = starkstrom(tmp_path)
    path.write_text(path.read_text() + "- 999\n")
    with pytest.raises(TrackError, match=r"right: cone 999 is not in cone_map_3\.yaml"):
        load_track(path)
    path.write_text("left: [5]\nright: [[6]]\n")
    with pytest.raises(TrackError, match=r"right: cone \[6\] is not in cone_map_3\.yaml"):
        load_track(path)
    (tmp_path / "cone_map_3.yaml").write_text("5: [1]\n")
    with pytest.raises(TrackError, match=r"cone_map_3\.yaml: 5 is \[1\], not a list of 2 numbers"):
        load_track(path)


def test_each_format_has_one_way_to_tell_it() -> None:
    assert all(bool(form.header) != bool(form.keys) for form in FORMATS)
    assert len({form.name for form in FORMATS}) == len(FORMATS)
