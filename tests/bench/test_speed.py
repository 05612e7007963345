"""The benchmark runs, leaves figures that a program can read, and judges the node's start."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from fsai_hil.bench import __main__ as bench
from fsai_hil.bench import decode, loop
from fsai_hil.bench.loop import NODE_START, node_rows
from fsai_hil.bench.rows import Ratio, in_turns, row, timed


def main(arguments: list[str]) -> int:
    return bench.main(["speed", *arguments])


@pytest.mark.long
def test_a_table_is_printed_and_every_figure_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    little: dict[str, Any] = {"ROUNDS": 2, "TURNS": 40, "STARTS": 1, "MISSIONS": ("static_inspection_b",), "DRIVES": 1}
    for name, value in little.items():
        monkeypatch.setattr(loop, name, value)
    monkeypatch.setattr(loop, "NODE_START_S", 60.0)  # one start on any machine
    monkeypatch.setattr(decode, "FRAMES", 2000)
    monkeypatch.setattr(decode, "ROUNDS", 1)
    assert main(["-o", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "bench.json").read_text())
    assert found["machine"]["python"] and found["versions"]["cantools"]
    by_name = {each["name"]: each for each in found["results"]}
    node = [NODE_START] if find_spec("rclpy") and find_spec("fsai_msgs") else []
    random, recorded = (
        [f"{name} {kind}, wall" for name in ("decode", "check", "parquet", "mcap")] for kind in ("random", "recorded")
    )
    frames = ["decode a frame", "encode a frame", "answer a 0x520"]
    assert list(by_name) == [*frames, *node, *random, *recorded, "drive static_inspection_b"]
    for each in by_name.values():
        for figure in (each["ours"], each["peer"], each["ratio"]):
            assert 0 < figure["least"] <= figure["median"] <= figure["most"]
    printed = capsys.readouterr().out
    assert all(name in printed for name in by_name)


def test_a_bridge_slower_than_1_s_to_its_first_frame_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for least_s, status in ((1.0, 0), (1.04, 1)):  # the other start was disturbed
        rows = [row(NODE_START, "s", [least_s, 1.2], "p", [0.1, 0.1])]
        monkeypatch.setattr(bench, "measured", lambda rows=rows: rows)
        assert main(["-o", str(tmp_path)]) == status
    printed = capsys.readouterr()
    assert (
        printed.err == "fsai_hil.bench: start bridge node: 1.04 s of processor time to its first frame, more than 1 s\n"
    )
    assert (tmp_path / "bench.json").exists() and NODE_START in printed.out


def test_a_bridge_that_ends_without_a_frame_has_its_error_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "fsai_nodes"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "vcu_bridge.py").write_text("raise SystemExit('no such bus')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(AssertionError, match=r"^no frame of vcu_bridge: no such bus"):
        node_rows()


def test_a_folder_that_cannot_be_made_is_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["-o", "/proc/absent"]) == 1
    assert capsys.readouterr().err == "fsai_hil.bench: /proc/absent: No such file or directory\n"


@pytest.fixture
def checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """`bench speed ARGS` where the run finds these rows; the baseline is in a folder of its own."""
    monkeypatch.setattr(bench, "BASELINE", tmp_path / "baseline.json")

    def run(rows: list[Ratio], *args: str) -> int:
        monkeypatch.setattr(bench, "measured", lambda: rows)
        return main([*args, "-o", str(tmp_path / "out")])

    return run


def test_a_ratio_that_fell_by_more_than_its_noise_fails(
    checked: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    steady, noisy = [10.0, 10.0, 10.0], [8.0, 10.0, 12.0]
    assert checked([row("a", "s", [1.0] * 3, "p", steady), row("b", "s", [1.0] * 3, "p", noisy)], "--write") == 0
    assert [set(each) for each in json.loads(bench.BASELINE.read_text())["results"]] == [
        {"name", "peer_name", "ratio"}
    ] * 2
    slower_machine = [row("a", "s", [3.0] * 3, "p", [27.3] * 3), row("b", "s", [1.0] * 3, "p", [7.2] * 3)]
    assert checked(slower_machine, "--check") == 0, "within the 10 % between runs, and within the spread of the rounds"
    assert checked([row("a", "s", [1.0] * 3, "p", [8.9] * 3), row("b", "s", [1.0] * 3, "p", noisy)], "--check") == 1
    assert capsys.readouterr().err == "fsai_hil.bench: a fell from 10 to 8.9 (-11%)\n"


def test_both_take_turns_and_the_first_round_does_not_count() -> None:
    calls: list[str] = []

    def measured(name: str, *times: float) -> tuple[str, Callable[[], float]]:
        left = iter(times)
        return name, lambda: (calls.append(name), next(left))[1]

    [found] = in_turns("s", 2, measured("peer", 90.0, 4.0, 8.0), measured("ours", 50.0, 2.0, 1.0), cold=1)
    assert calls == ["ours", "peer", "peer", "ours", "ours", "peer"]
    assert found["ratio"] == {"median": 5.0, "least": 2.0, "most": 8.0}


def test_a_time_is_that_of_one_unit_of_what_was_done() -> None:
    clock = iter([1.0, 7.0, 10.0, 16.0])
    mission_s = timed(lambda: None, 1.0, timer=lambda: next(clock))
    frame_us = timed(lambda: None, 1e6, turns=2, of=6, timer=lambda: next(clock))
    assert (mission_s(), frame_us()) == (6.0, 0.5e6)


def test_a_row_that_is_no_longer_measured_fails(
    checked: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [row("a", "s", [1.0], "p", [2.0]), row("b", "s", [1.0], "p", [2.0])]
    assert checked(rows, "--write") == 0
    assert checked([*rows, row("new", "s", [1.0], "p", [2.0])], "--check") == 0
    assert checked(rows[:1], "--check") == 1
    assert "b is not measured" in capsys.readouterr().err


def test_a_ratio_that_is_too_noisy_shows_no_fall(checked: Callable[..., int]) -> None:
    assert checked([row("a", "s", [1.0] * 3, "p", [10.0] * 3)], "--write") == 0
    assert checked([row("a", "s", [1.0] * 3, "p", [1.0, 3.0, 9.0])], "--check") == 0


def test_wall_times_count_where_processors_are_as_many(
    checked: Callable[..., int], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert checked([row("decode, wall", "s", [1.0], "p", [40.0])], "--write") == 0
    slower = [row("decode, wall", "s", [1.0], "p", [20.0])]
    assert checked(slower, "--check") == 1
    monkeypatch.setattr(bench, "machine", lambda: {"processors": -1, "processor": "", "kernel": "", "python": ""})
    assert checked(slower, "--check") == 0


def test_without_a_baseline_the_check_says_which_is_missing(
    checked: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert checked([], "--check") == 1
    assert "baseline.json: No such file" in capsys.readouterr().err
