"""The table of missions: a row each, the figures of a record, and a status that says whether a run failed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fsai_hil.evidence.missions import cases, main
from fsai_hil.evidence.work import digest


def run(seed: int, condition: str, result: str = "pass", **more: Any) -> dict[str, Any]:
    about = {"mission": "acceleration", "track": "acceleration", "condition": condition, "seed": seed, "result": result}
    nothing: dict[str, Any] = {"reasons": [], "faults": [], "cones_hit": 0, "off_course": 0, "sim_time_s": 30.0}
    return {**about, **nothing, "times_s": [9.0], **more}


def recorded(folder: Path, *runs: dict[str, Any]) -> list[str]:
    """A record of these runs, and the arguments that make the table of it: none of them is missing."""
    record = folder / "record.jsonl"
    record.write_text("\n".join(json.dumps(line) for line in ({"missions": digest()}, *runs)) + "\n")
    return ["--missions", "acceleration", "--conditions", "nominal,noise", "--seeds", "2", "--record", str(record)]


def test_each_mission_track_and_condition_is_a_row(tmp_path: Path) -> None:
    done = [run(1, "nominal"), run(2, "nominal", times_s=[10.0]), run(1, "noise", cones_hit=2), run(2, "noise")]
    document = tmp_path / "missions.md"
    assert main([*recorded(tmp_path, *done), "-o", str(document)]) == 0
    rows = [line for line in document.read_text().splitlines() if line.startswith("| acceleration")]
    assert rows == [
        "| acceleration | acceleration | nominal | 2 | 2 | 0 | 0 | 0 | 0 | 9.5 | 10.0 | – |",
        "| acceleration | acceleration | noise | 2 | 2 | 0 | 2 | 0 | 0 | 9.0 | 9.0 | – |",
    ]
    assert f"Sources: `{digest()}`" in document.read_text()
    assert "**Failed: 0 of 4 runs.**" in document.read_text()


def test_a_failed_run_is_named_and_is_the_status(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    failed = run(2, "noise", "fail", reasons=["off course once"], off_course=1, times_s=[99.0])
    arguments = recorded(tmp_path, run(1, "nominal"), run(2, "nominal"), run(1, "noise"), failed)
    assert main(arguments) == 1
    document = capsys.readouterr().out
    assert "| acceleration | acceleration | noise | 2 | 1 | 0 | 0 | 1 | 0 | 9.0 | 9.0 | – |" in document
    assert "acceleration, acceleration, noise, seed 2: off course once" in document


def test_a_stop_in_the_lane_with_a_hard_sensor_is_no_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = recorded(tmp_path, run(1, "hard", "stopped"), run(2, "hard"))
    assert main([*arguments, "--conditions", "hard"]) == 0
    document = capsys.readouterr().out
    assert "| acceleration | acceleration | hard | 2 | 1 | 1 | 0 | 0 | 0 | 9.0 | 9.0 | – |" in document
    assert "**Failed: 0 of 2 runs.**" in document


def test_cases_are_what_can_be_driven_and_nothing_twice() -> None:
    missions = ["acceleration", "skidpad", "autocross", "trackdrive", "static_inspection_a"]
    found = list(cases(missions, ["nominal", "clutter"], [1, 2], None))
    assert len(found) == len(set(found)) == (1 + 1 + 3 + 1) * 2 * 2 + 1
    tracks = ["skidpad", "random-SEED", "trackdrive"]
    chosen = {(case.mission, case.track) for case in cases(missions, ["nominal"], [1], tracks)}
    assert chosen == {
        ("skidpad", "skidpad"),
        ("autocross", "random-SEED"),
        ("autocross", "trackdrive"),
        ("trackdrive", "trackdrive"),
        ("static_inspection_a", "static"),
    }


def test_sharp_corners_are_driven_on_their_own_circuits() -> None:
    found = [(case.mission, case.track) for case in cases(["trackdrive", "autocross"], ["sharp"], [1], ["small_oval"])]
    assert found == [("autocross", "generated-SEED-sharp")]


def test_a_circuit_is_raced_on_where_that_is_asked() -> None:
    found = [(case.mission, case.track) for case in cases(["trackdrive"], ["nominal"], [1], ["small_oval"])]
    assert found == [("trackdrive", "small_oval")]


def test_laps_are_compared_with_the_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    laps = [run(seed, "nominal", times_s=[40.0, 30.0 - seed, 26.0]) for seed in (1, 2)]
    main([*recorded(tmp_path, *laps, run(1, "noise"), run(2, "noise"))])
    assert "| 31.5 | 40.0 | 0.792 |" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [["--conditions", "fog"], ["--seeds", "many"]])
def test_what_is_typed_wrong_is_said(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(wrong)
    assert wrong[1] in capsys.readouterr().err
