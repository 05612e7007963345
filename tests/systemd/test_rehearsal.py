"""The rehearsal's own judgement: what it calls well again is well again, and in time."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import pytest
from msgspec.structs import replace

from fsai_hil.rehearsal.bus_watch import CODEC, Wire, standing
from fsai_hil.rehearsal.carpc import __main__ as rehearsal
from fsai_hil.rehearsal.carpc import probe, scenes
from fsai_hil.rehearsal.stall_monitor import RUNS
from fsai_vcu.interface.messages import AiDriveFront, AiDriveRear, AiImage, AiStatus, WheelSpeeds
from fsai_vcu.interface.units import MS


class Remembers:
    """A stall monitor to a machine of which each run of a scene was disturbed or not, as given."""

    def __init__(self, *disturbed: bool) -> None:
        self._disturbed = list(disturbed)

    def disturbed(self, since_ns: int) -> str:
        return "stood still for 80 ms" if self._disturbed.pop(0) else ""


def rehearsed(*disturbed: bool) -> scenes.Rehearsal:
    return scenes.Rehearsal("vcan0", 1, Remembers(*disturbed))  # type: ignore[arg-type]


@pytest.fixture
def report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> scenes.Rehearsal:
    monkeypatch.setattr(scenes, "RESULTS", tmp_path)
    return rehearsed()


@pytest.mark.parametrize(
    ("words", "pace"), [([], 1.0), (["--short"], rehearsal.SHORT_PACE), (["--short", "--pace", "4"], 4.0)]
)
def test_the_rehearsals_pace_is_1_unless_asked_for(
    monkeypatch: pytest.MonkeyPatch, words: list[str], pace: float
) -> None:
    asked: list[float] = []
    monkeypatch.setattr(rehearsal, "NEEDED", {})
    monkeypatch.setattr("sys.argv", ["carpc", *words])
    monkeypatch.setattr(rehearsal, "rehearse", lambda *arguments: asked.append(arguments[-1]) or 0)
    assert rehearsal.main() == 0
    assert asked == [pace]


@pytest.mark.parametrize("pace", ["0", "0.5", "nan", "101"])
def test_a_pace_that_no_machine_keeps_is_refused_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], pace: str
) -> None:
    monkeypatch.setattr("sys.argv", ["carpc", "--pace", pace])
    with pytest.raises(SystemExit) as refused:
        rehearsal.main()
    assert refused.value.code == 2
    assert f"--pace is {pace}, but must be from 1 to 100" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(("seconds", "passed"), [(10.0, True), (10.1, False), (None, False)])
def test_a_step_that_takes_longer_than_stated_is_wrong(
    report: scenes.Rehearsal, tmp_path: Path, seconds: float | None, passed: bool
) -> None:
    report.note("back", seconds, 10.0)
    (step,) = json.loads((tmp_path / "report.json").read_text())
    assert step["passed"] is passed


def test_after_the_reboot_the_report_goes_on_where_it_was(report: scenes.Rehearsal) -> None:
    report.note("before", 1.0)
    again = rehearsed()
    again.note("after", 1.0)
    assert [step["what"] for step in again.steps] == ["before", "after"]


def wire(*images: tuple[int, AiImage | WheelSpeeds]) -> Wire:
    """Of these messages, and when each was on the bus in ms."""
    return Wire(replace(CODEC.encode(image), t_ns=t_ms * MS) for t_ms, image in images)


def test_the_last_frame_with_torque_on_either_axle_is_measured() -> None:
    seen = wire((100, AiDriveFront(torque_nm=5.0)), (120, AiDriveRear(torque_nm=5.0)), (130, AiDriveRear()))
    assert seen.torque_ends(100 * MS) == 20 * MS
    assert seen.torque_ends(121 * MS) == 0


def test_a_car_of_which_one_wheel_turns_does_not_stand() -> None:
    assert standing(WheelSpeeds(rr_rpm=9))
    assert not standing(WheelSpeeds(rr_rpm=10))
    assert wire().rests_after(0) == wire((5, WheelSpeeds(rr_rpm=10))).rests_after(0) == math.inf
    assert wire((5, WheelSpeeds(rr_rpm=10)), (9, WheelSpeeds())).rests_after(0) == 5 * MS


def test_the_longest_pause_is_of_the_ai_computers_frames() -> None:
    seen = wire((0, AiStatus()), (10, WheelSpeeds()), (30, AiStatus()), (40, AiStatus()))
    assert seen.longest_gap(0) == 30 * MS


def test_a_bus_log_that_breaks_a_rule_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "bus-x.log"
    log.write_text("(1000.000000) vcan0 7FF#00\n")
    assert not rehearsal.rules_kept(log)
    assert capsys.readouterr().out.startswith("WRONG")


class Scene:
    """One that notes a failure, or breaks off, in its first runs."""

    def __init__(self, machine: scenes.Rehearsal, failures: int, *, breaks_off: bool = False) -> None:
        self.runs = 0
        self._machine, self._failures, self._breaks_off = machine, failures, breaks_off

    def __call__(self) -> None:
        self.runs += 1
        fails = self.runs <= self._failures
        self._machine.note(f"run {self.runs}", None, passed=not fails or self._breaks_off)
        if fails and self._breaks_off:
            raise scenes.CannotGoOn


@pytest.mark.usefixtures("report")
@pytest.mark.parametrize(
    ("disturbed", "failures", "breaks_off", "runs", "well"),
    [
        ([], 0, False, 1, True),  # would fail, being asked
        ([True, True], 2, False, 3, True),
        ([True, True], 2, True, 3, True),
        ([False], 1, False, 1, False),
        ([True] * RUNS, RUNS, False, RUNS, False),
    ],
)
def test_only_a_scene_failed_while_disturbed_is_played_again(
    disturbed: list[bool], failures: int, breaks_off: bool, runs: int, well: bool
) -> None:
    rehearsal_of_it = rehearsed(*disturbed)
    scene = Scene(rehearsal_of_it, failures, breaks_off=breaks_off)
    rehearsal_of_it.scene("a scene", scene)
    assert scene.runs == runs and rehearsal.all_well(rehearsal_of_it.steps) is well
    counting = [step["what"] for step in rehearsal_of_it.steps if step["counts"]]
    assert f"run {runs}" in counting and (runs == 1 or "run 1" not in counting)
    reasons = [step for step in rehearsal_of_it.steps if "the machine stood still for 80 ms" in str(step)]
    assert len(reasons) == sum(disturbed)
    assert ("a scene: never undisturbed" in counting) is (runs == RUNS and not well)


def test_a_rehearsal_of_which_nothing_counts_is_not_well() -> None:
    assert not rehearsal.all_well([])
    assert not rehearsal.all_well([{"passed": True, "counts": False}])


def test_the_probe_has_the_bridges_restrictions_but_no_restart(machine: Path) -> None:
    units = machine / "usr/lib/systemd/system"
    shutil.copy(units / "fsai-bridge@.service", units / "fsai-probe@.service")
    settings = shutil.copytree(units / "fsai-bridge@.service.d", units / "fsai-probe@.service.d")
    (settings / "90-probe.conf").write_text(scenes.PROBE.format(command="/opt/fsai/bin/python", printed="/run/printed"))
    done = subprocess.run(
        ["systemd-analyze", "--no-pager", f"--root={machine}", "verify", "--man=no", "fsai-probe@can0.service"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0 and "probe" not in done.stderr, done.stderr


def test_the_probe_distinguishes_refused_from_allowed(tmp_path: Path) -> None:
    assert probe.ended(lambda: probe.write_to(tmp_path)) == ""
    assert not list(tmp_path.iterdir()), "it leaves nothing behind"
    assert probe.ended(lambda: probe.write_to(tmp_path / "absent")) == "ENOENT"
    assert probe.ended((tmp_path / "absent").read_bytes) == "ENOENT"
    assert probe.ended(lambda: probe.receive_on(0, 0.01)) == "timed out"
