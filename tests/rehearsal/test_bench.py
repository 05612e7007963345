"""The benchmark runs, leaves figures that a program can read, and judges the node's start."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import pytest

from fsai_hil.rehearsal import bench
from fsai_hil.rehearsal.bench import NODE_START, NODE_START_WALL, QUICK, bench_node, main, row, too_slow


def test_quick_prints_a_table_and_writes_every_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "QUICK", QUICK._replace(rounds=2, turns=40, starts=1, log_frames=2000))
    assert main(["--quick", "-o", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "bench.json").read_text())
    assert found["quick"] is True and found["machine"]["python"] and found["versions"]["cantools"]
    by_name = {each["name"]: each for each in found["results"]}
    compared = ["decode a frame", "encode a frame", "answer a 0x520", "start to a first frame"]
    node = [NODE_START, NODE_START_WALL] if find_spec("rclpy") and find_spec("fsai_msgs") else []
    logs = [f"{name} random, wall" for name in ("decode", "values", "parquet", "mcap", "check")]
    assert list(by_name) == [*compared, *node, *logs, "drive acceleration"]
    compared.append(logs[0])
    for name in node:
        assert by_name[name]["ours"]["least"] > 0 and by_name[name]["peer"] is None
    for name in compared:
        each = by_name[name]
        for figure in (each["ours"], each["peer"], each["ratio"]):
            assert 0 < figure["least"] <= figure["median"] <= figure["most"]
    assert by_name["drive acceleration"]["ours"]["median"] > 0 and by_name["drive acceleration"]["peer"] is None
    printed = capsys.readouterr().out
    assert all(name in printed for name in by_name)
    assert node or "not measured: the bridge node" in printed


def test_a_bridge_slower_than_1_s_to_its_first_frame_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = [row(NODE_START, "s", [1.04, 1.2]), row(NODE_START_WALL, "s", [1.4, 1.6])]
    assert too_slow([row(NODE_START, "s", [1.0, 1.2]), slow[1]]) is None, "one start was disturbed"
    assert too_slow([]) is None
    monkeypatch.setattr(bench, "run", lambda *_: slow)
    assert main(["--quick", "-o", str(tmp_path)]) == 0, "in a hurry nothing is judged"
    capsys.readouterr()
    assert main(["-o", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    assert (
        printed.err
        == "fsai_hil.rehearsal.bench: start bridge node: 1.04 s of processor time to its first frame, more than 1 s\n"
    )
    assert (tmp_path / "bench.json").exists() and NODE_START_WALL in printed.out


def test_a_bridge_that_ends_without_a_frame_has_its_error_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "fsai_nodes"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "vcu_bridge.py").write_text("raise SystemExit('no such bus')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(AssertionError, match=r"^no frame of vcu_bridge: no such bus"):
        bench_node(QUICK)


def test_a_folder_that_cannot_be_made_is_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick", "-o", "/proc/absent"]) == 1
    assert capsys.readouterr().err == "fsai_hil.rehearsal.bench: /proc/absent: No such file or directory\n"
