"""`fsai-vcu record` where nothing can be written yet: it fails at once, or as a service goes on asking."""

from __future__ import annotations

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
