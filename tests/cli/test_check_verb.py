"""`fsai-vcu check`: figures, findings, a verdict, an exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main


@pytest.fixture
def well(tmp_path: Path) -> Path:
    """One message of a small database, as it should be: every 10 ms."""
    (tmp_path / "team.dbc").write_text(
        'VERSION ""\n\nBU_: AI\n\nBO_ 291 Ours: 2 AI\n SG_ A : 0|8@1+ (1,0) [0|0] "" AI\n\n'
        'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'
        'BA_ "GenMsgCycleTime" BO_ 291 10;\n'
    )
    path = tmp_path / "well.log"
    path.write_text("".join(f"(1.{step * 10_000:06d}) can0 123#{step:04X}\n" for step in range(100)))
    return path


def run(log: Path, *options: str) -> int:
    return main(["check", str(log), "--dbc", str(log.with_name("team.dbc")), *options])


def test_a_bus_without_the_car_is_measured_and_not_called_ok(well: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(well, "--figures") == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].startswith("verdict: UNKNOWN: no 0x520 was received")
    assert "the 1 periodic message comes in its period, without gaps" in lines
    assert [line.split() for line in lines if line.startswith("123 ")] == [
        ["123", "Ours", "100", "10", "10.00", "0.00", "0.00", "0.00", "0", "10.00", "0", "1.34%"]
    ]


def test_the_first_line_names_the_log_and_its_bus(well: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(well, "--figures")
    first, titles, units, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{well}: 100 frames on can0 in 0.990 s, load ")
    for title, unit in (("median", "ms"), ("jitter max", "ms"), ("longest gap", "ms"), ("unchanged", "ms")):
        end = titles.index(title) + len(title)
        assert units[:end].endswith(f" {unit}"), title


def test_what_is_wrong_is_named_with_status_1(well: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = well.read_text().splitlines(keepends=True)
    well.write_text("".join(lines[:30] + lines[50:]).replace("#001D", "#00"))
    assert run(well) == 1
    said = capsys.readouterr().out.splitlines()
    assert "problem: at 0.290 s: Ours (0x123) must have 2 bytes: 1 of 1 bytes" in said
    assert "problem: at 0.290 s: Ours (0x123) was silent for 210.0 ms: 100 ms count as lost" in said
    assert said[-1] == "verdict: NOT OK: 2 problems"
    assert not any(line.startswith("123 ") or "without gaps" in line for line in said)


def test_json_is_one_object_a_line_with_the_verdict_last(well: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(well, "--figures", "--json") == 1
    entries = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [entry["type"] for entry in entries] == ["message", "bus", "verdict"]
    assert entries[0]["interval_ms"] == {"p50_ms": 10.0, "p99_ms": 10.0, "max_ms": 10.0}
    assert (entries[-1]["verdict"], entries[-1]["problems"], entries[-1]["notes"]) == ("unknown", 0, 0)


def test_a_partly_readable_log_fails_even_if_the_rest_is_well(well: Path, capsys: pytest.CaptureFixture[str]) -> None:
    well.write_text(well.read_text() + "garbage\n")
    assert run(well) == 1
    said = capsys.readouterr()
    assert "line 101: not a line of candump: 'garbage'" in said.err
    assert not [line for line in said.out.splitlines() if line.startswith("problem")]


def test_an_empty_log_is_not_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty.log").touch()
    assert main(["check", str(tmp_path / "empty.log")]) == 1
    said = capsys.readouterr()
    assert said.out == "verdict: NOT OK: no frames\n"
    assert "no frames in it" in said.err


def test_verbs_of_an_earlier_release_say_their_new_name(well: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(well, "--figures") == 1
    figures = capsys.readouterr().out
    assert main(["stats", str(well), "--dbc", str(well.with_name("team.dbc"))]) == 1
    said = capsys.readouterr()
    assert said.out == figures
    assert said.err == "fsai-vcu: stats is now called check --figures\n"
    assert main(["recorder", "--config", str(well.with_name("absent.toml"))]) == 1
    assert capsys.readouterr().err.splitlines()[0] == "fsai-vcu: recorder is now called record --service"


def test_logs_of_different_clocks_are_several_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, begin_s in (("a", 1_790_000_000), ("b", 0), ("c", 0)):
        lines = (f"({begin_s + number / 100:.6f}) can0 520#0000000000000000\n" for number in range(150))
        (tmp_path / f"{name}.log").write_text("".join(lines))
    assert main(["check", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert [line for line in out.splitlines() if line.startswith("run ")] == [f"run {tmp_path}/{n}.log" for n in "bca"]
    assert out.count("verdict: ") == 1 and out.endswith("verdict: NOT OK: 3 of 3 runs\n")
    assert "1790000" not in out
    assert main(["check", str(tmp_path), "--json"]) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["runs"] == 3
    assert main(["explain", str(tmp_path)]) == 1
    assert capsys.readouterr().out.count("\nverdict: ") == 3
    assert main(["report", str(tmp_path), "-o", str(tmp_path / "page.html")]) == 1
    assert "they are 3 runs; name the logs of one: " in capsys.readouterr().err


def test_a_log_that_cannot_be_read_is_no_run_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.log").touch()
    lines = (f"({1_790_000_000 + number / 100:.6f}) can0 520#0000000000000000\n" for number in range(150))
    (tmp_path / "b.log").write_text("".join(lines))
    for names in ("ab", "ba"):
        main(["check", *(f"{tmp_path}/{name}.log" for name in names)])
        out = capsys.readouterr().out
        assert "run " not in out and out.count("verdict: ") == 1
