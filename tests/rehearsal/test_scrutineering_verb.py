"""`fsai-vcu scrutineering`: measures where there is a vcan0, writes a report, and its exit status is the verdict."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from measured_rows import measured, row

from fsai_hil.vcan import VcanHost
from fsai_vcu.cli.main import main


class FakePlace:
    """Measures nothing and hands over what it was given."""

    def __init__(self) -> None:
        self.status = 0
        self.result: dict[str, Any] | None = measured()
        self.plan: dict[str, Any] = {}
        self.options: dict[str, Any] = {}

    def run(self, argv: list[str], **options: Any) -> int:
        self.plan, self.options = json.loads(argv[-1]), options
        if self.result is not None:
            Path(self.plan["result"]).write_text(json.dumps(self.result))
        return self.status


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> FakePlace:
    fake = FakePlace()
    monkeypatch.setattr("fsai_hil.vcan.choose_place", lambda wanted: VcanHost("uml", f"wanted {wanted}", fake.run))
    monkeypatch.setattr("compileall.compile_dir", lambda *_, **__: True)
    return fake


def test_it_leaves_a_report_for_people_and_one_for_programs(
    place: FakePlace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    extra = tmp_path / "docs" / "figures.md"
    assert main(["scrutineering", "-o", str(tmp_path), "--report", str(extra)]) == 0
    out = capsys.readouterr().out
    assert "uml vcan0: wanted auto" in out and "PASS" in out and "response-time.md" in out
    text = (tmp_path / "response-time.md").read_text()
    assert text == extra.read_text() and "**PASS" in text
    saved = json.loads((tmp_path / "response-time.json").read_text())
    assert saved["result"] == "pass" and saved["place"] == "uml" and saved["conditions"][0]["name"] == "idle"
    assert not (tmp_path / "measured.json").exists()


def test_a_vcu_timeout_fails_the_verb_and_the_report_is_written(
    place: FakePlace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place.result = measured(row(comms_losses=1))
    assert main(["scrutineering", "-o", str(tmp_path), "--json"]) == 1
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["result"] == "fail" and "AI_COMMS_LOST once" in last["failures"][0]
    assert "**FAIL" in (tmp_path / "response-time.md").read_text()


def test_what_could_not_be_measured_fails_the_command(
    place: FakePlace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place.result = measured(not_measured={"driving": "the car does not come as far as AS_DRIVING"})
    assert main(["scrutineering", "-o", str(tmp_path), "--json"]) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["result"] == "incomplete"


def test_only_what_was_asked_for_is_measured(place: FakePlace, tmp_path: Path) -> None:
    assert main(["scrutineering", "-o", str(tmp_path), "--conditions", "driving,idle", "--seconds", "7"]) == 0
    assert (place.plan["conditions"], place.plan["seconds"]) == (["idle", "driving"], 7.0)
    assert place.plan["slow_place"] is True
    assert main(["scrutineering", "-o", str(tmp_path), "--short"]) == 0
    assert (place.plan["conditions"], place.plan["seconds"]) == (["idle", "idle-loaded"], 3.0)


def test_a_slower_clock_is_only_for_those_who_ask_and_is_said(place: FakePlace, tmp_path: Path) -> None:
    for words, pace in (([], 1.0), (["--pace", "3"], 3.0)):
        assert main(["scrutineering", "-o", str(tmp_path), "--short", *words]) == 0
        assert place.options["pace"] == pace
        text = " ".join((tmp_path / "response-time.md").read_text().split())
        assert (f"A second there took {pace:g} s of this machine" in text) == (pace != 1.0)
        assert json.loads((tmp_path / "response-time.json").read_text())["pace"] == pace


def test_on_this_kernels_own_vcan_there_is_no_other_clock(
    place: FakePlace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("fsai_hil.vcan.choose_place", lambda wanted: VcanHost("native", "", place.run))
    assert main(["scrutineering", "-o", str(tmp_path), "--pace", "2"]) == 2
    assert "--pace is for User-Mode Linux" in capsys.readouterr().err
    assert place.plan == {}
    assert main(["scrutineering", "-o", str(tmp_path)]) == 0
    assert "pace" not in place.options


@pytest.mark.parametrize(
    ("status", "argv", "words"),
    [
        (2, ["--seconds", "0"], "--seconds is 0, but must be a time in seconds"),
        (2, ["--seconds", "nan"], "--seconds is nan"),
        (2, ["--pace", "0.5"], "--pace is 0.5, but must be from 1 to 100"),
        (2, ["--conditions", "asleep"], "no condition 'asleep': choose from idle"),
        (1, ["-o", "/proc/absent"], "/proc/absent: No such file or directory"),
    ],
)
def test_bad_input_gets_one_clear_line(
    place: FakePlace, status: int, argv: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scrutineering", *argv]) == status
    error = capsys.readouterr().err
    assert error.startswith("fsai-vcu scrutineering: ") and words in error and error.count("\n") == 1
    assert place.plan == {}


def test_a_measurement_that_broke_off_is_no_report(
    place: FakePlace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "measured.json").write_text("what an earlier run left")
    place.status, place.result = 1, None
    assert main(["scrutineering", "-o", str(tmp_path)]) == 1
    assert "nothing was measured (status 1); the logs of the processes are in" in capsys.readouterr().err
    assert not (tmp_path / "response-time.md").exists()
