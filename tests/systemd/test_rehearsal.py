"""The rehearsal's own judgement: what it calls well again is well again, and in time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsai_hil.carpc import __main__ as rehearsal
from fsai_hil.carpc import inside
from fsai_hil.carpc.watching import Said, longest_gap_s, standing, torque_ends_s
from fsai_vcu.interface.images import AiDriveFront, AiDriveRear, AiStatus, WheelSpeeds

MS = 1_000_000


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> inside.Rehearsal:
    monkeypatch.setattr(inside, "RESULTS", tmp_path)
    return inside.Rehearsal("vcan0", 1, short=True)


@pytest.mark.parametrize(("seconds", "passed"), [(10.0, True), (10.1, False), (None, False)])
def test_a_step_that_takes_longer_than_is_stated_or_never_ends_is_wrong(
    machine: inside.Rehearsal, tmp_path: Path, seconds: float | None, passed: bool
) -> None:
    machine.note("back", seconds, 10.0)
    (step,) = json.loads((tmp_path / "report.json").read_text())
    assert step["passed"] is passed


def test_after_the_reboot_the_report_goes_on_where_it_was(machine: inside.Rehearsal) -> None:
    machine.note("before", 1.0)
    again = inside.Rehearsal("vcan0", 1, short=False)
    again.note("after", 1.0)
    assert [step["what"] for step in again.steps] == ["before", "after"]


def test_torque_of_either_axle_counts_and_its_last_frame_is_what_is_measured() -> None:
    said = [
        Said(100 * MS, AiDriveFront(torque_nm=5.0)),
        Said(120 * MS, AiDriveRear(torque_nm=5.0)),
        Said(130 * MS, AiDriveRear()),
    ]
    assert torque_ends_s(said, 100 * MS) == pytest.approx(0.02)
    assert torque_ends_s(said[2:], 100 * MS) == 0.0


def test_a_car_of_which_one_wheel_turns_does_not_stand() -> None:
    assert standing(WheelSpeeds(rr_rpm=9))
    assert not standing(WheelSpeeds(rr_rpm=10))
    assert not inside.standing_at_the_end([])


def test_the_longest_pause_is_between_frames_of_the_ai_computer_whatever_the_car_says_meanwhile() -> None:
    said = [Said(0, AiStatus()), Said(10 * MS, WheelSpeeds()), Said(30 * MS, AiStatus()), Said(40 * MS, AiStatus())]
    assert longest_gap_s(said) == pytest.approx(0.03)


def test_a_bus_log_that_breaks_a_rule_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "bus-x.log"
    log.write_text("(1000.000000) vcan0 7FF#00\n")
    assert not rehearsal.rules_kept(log)
    assert capsys.readouterr().out.startswith("WRONG")
