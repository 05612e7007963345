"""The stack of a rehearsal: which program drives in a node's place, and Go for its car."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fsai_hil.cli import hil
from fsai_hil.rehearsal import stack
from fsai_hil.rehearsal.stack import NODES, RunningProcess, Stack
from fsai_vcu.cli.main import WrongUse


@pytest.mark.parametrize(("name", "first"), [("own.py", ""), ("own", "#!/usr/bin/env python3\n")])
def test_an_own_program_is_started_under_the_nodes_name(tmp_path: Path, name: str, first: str) -> None:
    own = tmp_path / name
    own.write_text(f"{first}import sys\nprint('own', *sys.argv[1:])\n")
    own.chmod(0o755)
    with Stack("loopback:own", tmp_path / "logs", own={"path_planner": str(own)}) as stack:
        planner = stack.start_node("path_planner", laps=100)
        assert planner.wait(60.0) == 0
        assert planner.log() == "own --ros-args -r __node:=path_planner\n"


def test_a_program_of_others_gets_its_arguments(tmp_path: Path) -> None:
    own = tmp_path / "own stack.py"
    own.write_text("import sys\nprint(*sys.argv[1:])\n")
    for other, printed in ((str(own), "\n"), (f"'{own}' -p preset:=eufs", "-p preset:=eufs\n")):
        with Stack("loopback:others", tmp_path / printed.strip()) as stack:
            assert stack.start_nodes({}, NODES, [other]) == ("own stack",)
            program = stack.processes["own stack"]
            assert program.wait(60.0) == 0
            assert program.log() == printed


def test_at_the_end_each_process_is_asked_once(tmp_path: Path) -> None:
    told = "import signal, time; signal.signal(15, lambda *_: print('asked')); print('ready'); signal.pause()"
    with Stack("loopback:asked", tmp_path) as stack:
        for name, takes_s in (("slow", 1.0), ("quick", 0.3)):  # the quick one's end is awaited first
            stack.start(name, [sys.executable, "-c", f"{told}; time.sleep({takes_s})"]).await_log("ready", 60.0)
    assert [process.log() for process in stack.processes.values()] == ["ready\nasked\n"] * 2


def test_an_own_program_is_found_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").touch()
    assert hil.own_program("path_planner=own.py") == f"path_planner={tmp_path}/own.py"
    assert hil.own_program("path_planner=our_stack.planner") == "path_planner=our_stack.planner"


@pytest.mark.parametrize(
    "given", ["own.py", "path_planner", "path_planner=", "vcu_bridge=own.py", "path_planner=no.py"]
)
def test_an_own_program_that_is_none_is_refused(given: str) -> None:
    parser = argparse.ArgumentParser()
    hil.add_arguments(parser)
    with pytest.raises(WrongUse, match="--with"):
        hil.run(hil.parse(parser, ["--with", given]))


def test_go_is_given_again_until_the_car_takes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stack, "GO_AGAIN_S", 0.01)
    car = RunningProcess("car", ["cat"], tmp_path / "car.log", os.environ, stdin=subprocess.PIPE)
    try:
        car.give_go(lambda: car.log().count("go") > 1, 60.0, lambda: time.sleep(0.02))
        assert car.log().count("go") > 1
    finally:
        car.stop()
