"""`fsai-vcu track`: what is saved is what is named, and what is said of a track is so."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks import as_csv, load_track
from fsai_vcu.cli.main import main
from fsai_vcu.interface.enums import Ami


def test_a_seed_is_saved_as_a_track_that_can_be_driven(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, picture = tmp_path / "tight.csv", tmp_path / "tight.png"
    argv = ["track", "--seed", "3", "--style", "tight", "-o", str(file), "--plot", str(picture)]
    assert main(argv) == 0
    said = capsys.readouterr().out
    assert f"saved {file}\nsaved {picture}\n" in said and picture.stat().st_size > 1000
    made, read = load_track("generated-3-tight"), load_track(file)
    assert read.closed and len(read.cones_xy_m) == len(made.cones_xy_m)
    assert read.start_line is not None
    assert read.start_line.seen(*read.staging(Ami.AUTOCROSS, 2.17).ahead(2.17))[0] == pytest.approx(-6.0, abs=0.3)


def test_a_track_is_described_in_figures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["track", "small_oval"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "small_oval: circuit, 103 m",
        "cones: 29 yellow, 22 blue, 4 big_orange",
        "start line: 0.00, 0.00 m, crossed towards 0 deg: its gate of big orange cones",
        "car: -8.17, 0.00 m, its nose 6.0 m before the line",
        "tightest radius of the middle of the lane: 10.0 m",
        "lane: 3.5 to 3.5 m wide",
    ]
    assert main(["track", "small_oval", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["car"] == {"x_m": -8.17, "y_m": 0.0, "yaw_deg": 0.0, "before_line_m": 6.0}
    assert (facts["kind"], facts["cones"]["blue"], round(facts["tightest_radius_m"], 1)) == ("circuit", 22, 10.0)


def test_what_is_not_as_the_file_has_it_is_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = load_track("small_oval")
    on_line, picture = tmp_path / "on_line.csv", tmp_path / "on_line.png"
    on_line.write_text(as_csv(made, Pose(0.0, 0.0, 0.0)))
    assert main(["track", str(on_line), "--plot", str(picture)]) == 0
    said = capsys.readouterr()
    assert "m past the line: the car is staged 6 m before it" in said.err
    assert "its gate of 4 big orange cones" in said.out
    assert re.search(r"its nose (5\.[89]|6\.[0-2]) m before the line", said.out)
    assert picture.stat().st_size > 1000
