"""`explain` and `report` on a live bus: what was received is explained, after a while or at Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import open_bus

NAME = f"loopback:stories-{os.getpid()}"


@pytest.fixture
def car() -> Iterator[None]:
    """A car whose AS state is EMERGENCY_BRAKE, on the stand-in bus."""
    status, steer = Frame(0x520, bytes.fromhex("0000040000000000")), Frame(0x523, bytes.fromhex("00002C010000"))
    with talking(NAME, status, steer):
        yield


def test_a_live_bus_is_explained_after_so_long(car: None, capsys: pytest.CaptureFixture[str]) -> None:
    main(["explain", NAME, "--seconds", "0.5", "--json"])
    said = capsys.readouterr()
    heading = json.loads(said.out.splitlines()[0])
    assert heading["type"] == "log" and heading["frames"] > 0 and heading["revision"] == "2026"
    assert "EMERGENCY_BRAKE" in said.out and said.err == ""


def test_ctrl_c_ends_the_listening_and_begins_the_story(car: None) -> None:
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", "explain", NAME]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        said = process.stderr.readline()
        with open_bus(NAME) as bus:
            assert all(bus.recv(60.0) is not None for _ in range(20))
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60.0)
    assert said == f"fsai-vcu explain: listening to {NAME} until Ctrl-C\n" and err == ""
    assert out.startswith(f"{NAME}: ") and "the log ends with the car in EMERGENCY_BRAKE" in out


@pytest.mark.parametrize("verb", ["explain", "report", "check"])
def test_a_silent_bus_is_one_clear_line(verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = ["-o", str(tmp_path / "x.html")] if verb == "report" else []
    assert main([verb, f"{NAME}-silent", "--seconds", "0.1", *page]) == 1
    assert capsys.readouterr().err == f"fsai-vcu {verb}: nothing was received on {NAME}-silent\n"
    assert not (tmp_path / "x.html").exists()


def test_a_live_bus_becomes_a_page(car: None, tmp_path: Path) -> None:
    assert main(["report", NAME, "--seconds", "0.5", "-o", str(tmp_path / "live.html")]) == 1  # it is not well
    assert "EMERGENCY_BRAKE" in (tmp_path / "live.html").read_text()
