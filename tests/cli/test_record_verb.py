"""`fsai-vcu record` in one line: what it made, and what it could not make."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.interface.frames import Frame

BUS = f"loopback:record-{os.getpid()}"


@pytest.fixture
def blocked(tmp_path: Path) -> Path:
    """A folder that cannot be made: a file is in its place."""
    path = tmp_path / "logs"
    path.touch()
    return path


def test_a_folder_that_cannot_be_written_is_one_line(blocked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["record", "-i", BUS, "-o", str(blocked / "can0"), "--seconds", "1"]) == 1
    assert capsys.readouterr().err == f"fsai-vcu record: cannot write {blocked / 'can0'}: Not a directory\n"


def test_a_service_waits_for_its_folder_and_says_so(blocked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = blocked / "can0"
    repaired = threading.Timer(0.3, blocked.unlink)
    repaired.start()
    with talking(BUS, Frame(0x520, bytes(8))):
        assert main(["record", "-i", BUS, "-o", str(folder), "--seconds", "0.7", "--patient"]) == 0
    repaired.join()
    said = capsys.readouterr().err.splitlines()
    assert said[0] == f"fsai-vcu record: cannot write {folder}: Not a directory; trying again every second"
    assert said[1] == f"fsai-vcu record: writing in {folder}"
    assert len(list(folder.glob("*.log"))) == 1


def test_a_file_of_which_nothing_is_made_is_not_named_as_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "int.log"
    assert main(["record", "loopback:record-silent", "-o", str(log), "--seconds", "0"]) == 1
    why = f"nothing was received on loopback:record-silent: {log} was not made"
    assert capsys.readouterr().err == f"fsai-vcu record: {why}\n" and not list(tmp_path.iterdir())


def test_the_file_beside_a_recorded_log_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, about = tmp_path / "lab.log", tmp_path / "lab.json"
    with talking(BUS, Frame(0x520, bytes(8))):
        assert main(["record", BUS, "-o", str(log), "--seconds", "0.5"]) == 0
    assert capsys.readouterr().err.endswith(f" frames in {log}, about it in {about}\n") and about.exists()


def test_names_that_are_no_text_are_written_beside_a_log(tmp_path: Path) -> None:
    run, limits = tmp_path / "run.log", tmp_path / "l\udcff.toml"
    limits.write_text("max_speed_mps = 5.0\n")
    dbc = tmp_path / "d\udcff.dbc"
    dbc.write_text('VERSION ""\n\nBU_: A\n\nBO_ 291 Engine: 8 A\n SG_ Rpm : 0|16@1+ (1,0) [0|0] "rpm" A\n')
    with talking(BUS, Frame(0x520, bytes(8))):
        asked = ["record", BUS, "-o", str(run), "--seconds", "0.3", "--limits", str(limits), "--dbc", str(dbc)]
        assert main(asked) == 0
    about = json.loads(run.with_suffix(".json").read_text())
    assert about["databases"] == [f"{tmp_path}/d\\udcff.dbc"]
    assert about["operational_limits"]["file"] == f"{tmp_path}/l\\udcff.toml"
