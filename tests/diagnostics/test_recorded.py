"""A log of a computer that was too busy: the verdict names that computer, and blames neither the car nor its plugs."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from story_runs import branch, cut, driving, of_ids, twice

from fsai_hil.simulator.faults import Drop
from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.log.recorded import Recorded, note_stalls, recorded
from fsai_vcu.diagnostics.verdict.own_faults import of_the_recording
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS, S

SINCE_1970_NS = 1_790_000_000 * S


@pytest.fixture(scope="module")
def silent() -> tuple[Frames, int]:
    """A drive in which the AI computer falls silent, and when; the car brakes 100 ms later."""
    run = branch(driving(), lambda run: run.spoil(Drop(frozenset(AI_IDS))), 1.0)
    return run.frames.at(run.frames.t_ns + SINCE_1970_NS), run.injected_ns + SINCE_1970_NS


@pytest.fixture(scope="module")
def held_up(silent: tuple[Frames, int]) -> tuple[Frames, int]:
    """The same, but the AI computer is received again 10 ms after the car has braked."""
    frames, silent_ns = silent
    before = cut(of_ids(frames, AI_IDS, silent_ns - 310 * MS), silent_ns)
    return twice(frames, before, 420 * MS), silent_ns


def written(folder: Path, frames: Frames, **about: object) -> Path:
    log = folder / "run.log"
    log.write_bytes(b"\n".join(log_lines(frames)) + b"\n")
    log.with_suffix(".json").write_text(json.dumps({"lost_in_receive_buffer": 0, "interface": "can0", **about}))
    return log


def told(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main([*argv]) == 1
    return capsys.readouterr().out


def test_a_computer_that_stood_still_is_the_cause_of_the_silence(
    held_up: tuple[Frames, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, silent_ns = held_up
    log = written(tmp_path, frames)
    assert "the AI computer fell silent" in told(capsys, "explain", str(log)).split("EMERGENCY BRAKE")[1]
    note_stalls(tmp_path, [(silent_ns + 2 * MS, silent_ns + 97 * MS)])
    for verb in ("explain", "check"):
        out = told(capsys, verb, str(log))
        assert "because a processor of this computer stood still: it was too busy for real time" in out
        assert "plug" not in out and "fell silent" not in out
    words = "a processor of this computer stood still for 95 ms: it was too busy, so this run is not judged"
    assert f"verdict: UNKNOWN: {words}" in out


@pytest.mark.parametrize(("begin_ms", "end_ms"), [(-50, 1), (2, 97)])
def test_a_program_that_stays_away_is_not_excused_by_a_stall(
    begin_ms: int, end_ms: int, silent: tuple[Frames, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, silent_ns = silent
    stall = [silent_ns + begin_ms * MS, silent_ns + end_ms * MS]
    out = told(capsys, "check", str(written(tmp_path, frames, stood_still_ns=[stall])))
    assert "because the AI computer fell silent" in out and "verdict: NOT OK" in out and "not judged" not in out


def test_a_stall_at_another_time_is_no_cause(
    silent: tuple[Frames, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, silent_ns = silent
    log = written(tmp_path, frames, stood_still_ns=[[silent_ns - 900 * MS, silent_ns - 800 * MS]])
    out = told(capsys, "check", str(log))
    assert "because the AI computer fell silent" in out and "verdict: NOT OK" in out
    assert "note: a processor of this computer stood still for 100 ms" in out and "not judged" not in out


def test_a_pause_is_the_loss_of_the_computer_that_lost_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = branch(driving(), lambda run: None, 2.0).frames
    frames = frames.only(abs(frames.t_ns - (frames.t_ns[-1] - 900 * MS)) > 100 * MS)
    gap = told(capsys, "check", str(written(tmp_path, frames)))
    assert "problem:" in gap and "plug" in gap
    lossy = told(capsys, "check", str(written(tmp_path, frames, lost_in_receive_buffer=28_928)))
    assert "problem:" not in lossy and "plug" not in lossy and "termination" not in lossy
    assert "verdict: UNKNOWN: 28928 frames lost in this machine's receive buffer: not a fault of the bus" in lossy


@pytest.mark.parametrize(
    ("stalls_ms", "verdict"),
    [([(-1, 401)], "UNKNOWN"), ([(-1, 200), (-1, 200), (220, 390)], "UNKNOWN"), ([(-1, 200), (-1, 200)], "NOT OK")],
)
def test_a_stall_explains_a_pause_that_is_as_long(
    stalls_ms: list[tuple[int, int]], verdict: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = branch(driving(), lambda run: None, 2.0).frames
    begin_ns = int(frames.t_ns[-1]) - S
    frames = frames.only((frames.t_ns < begin_ns) | (frames.t_ns > begin_ns + 400 * MS))
    stalls = [[begin_ns + each * MS for each in stall] for stall in stalls_ms]
    out = told(capsys, "check", str(written(tmp_path, frames, stood_still_ns=stalls)))
    assert f"verdict: {verdict}" in out and ("problem: " in out) == (verdict == "NOT OK")
    assert ("this run is not judged" in out) == (verdict == "UNKNOWN")


def test_stalls_a_minute_apart_explain_what_was_missed_in_each() -> None:
    """No stall lasts from the first of them to the last."""
    missed_ns = tuple((t_ns, t_ns + 100 * MS) for t_ns in (20 * MS, 60 * S + 20 * MS))
    finding = Finding("problem", "handshake", "2 handshakes without an answer", silent_ns=missed_ns)
    stalls_ns = (0, 200 * MS), (60 * S, 60 * S + 200 * MS)
    assert of_the_recording(finding, Recorded(stalls_ns=stalls_ns))
    assert not of_the_recording(finding, Recorded(stalls_ns=stalls_ns[:1]))


@pytest.mark.parametrize("bus", ["loopback:fsai", "vcan0"])
def test_on_a_virtual_bus_nobody_is_sent_to_a_plug(
    bus: str, silent: tuple[Frames, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = written(tmp_path, silent[0], interface=bus)
    out = told(capsys, "explain", str(log))
    assert "the bus is virtual" in out and "plug" not in out


@pytest.mark.parametrize(
    "beside",
    [
        "[" * 50_000,
        '{"lost_in_receive_buffer": ' + "9" * 5000 + "}",
        '{"lost_in_receive_buffer": true}',
        '{"lost_in_receive_buffer": 1e999, "stood_still_ns": 7, "interface": []}',
        '{"stood_still_ns": [[1], [2, 1], ["a", "b"], [1.5, 2.5], {}, null, [-3, 4]]}',
        "\0",
        "7",
        "[]",
    ],
)
def test_a_wrong_sidecar_is_as_if_it_were_not_there(beside: str, tmp_path: Path) -> None:
    (tmp_path / "run.log").touch()
    (tmp_path / "run.json").write_text(beside)
    assert recorded(tmp_path / "run.log") == Recorded()
    note_stalls(tmp_path, [(1, 2)])
    assert recorded(tmp_path / "run.log") in (Recorded(), Recorded(0, ((1, 2),)))
    (tmp_path / "run.json").unlink()
    os.mkfifo(tmp_path / "run.json")
    note_stalls(tmp_path, [(1, 2)])
    assert recorded(tmp_path / "run.log") == Recorded()


def test_stalls_are_noted_beside_each_log_of_a_folder(tmp_path: Path) -> None:
    for name in ("fsai-000001", "fsai-000002"):
        (tmp_path / f"{name}.log").touch()
        (tmp_path / f"{name}.json").write_text('{"lost_in_receive_buffer": 3, "host": "' + "h" * 200 + '"}')
    note_stalls(tmp_path, [(5, 9)])
    note_stalls(tmp_path, [(2, 4)])
    assert recorded(tmp_path / "fsai-000002.log") == Recorded(3, ((2, 4), (5, 9)))
    assert json.loads((tmp_path / "fsai-000001.json").read_text())["host"] == "h" * 200


def test_a_stall_that_did_no_harm_is_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = branch(driving(), lambda run: None, 2.0).frames
    at_ns = int(frames.t_ns[-1]) - S
    assert main(["check", str(written(tmp_path, frames, stood_still_ns=[[at_ns, at_ns + 97 * MS]]))]) == 0
    out = capsys.readouterr().out
    assert "note: a processor of this computer stood still for 97 ms\n" in out and "verdict: OK" in out
