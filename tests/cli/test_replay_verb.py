"""`fsai-vcu replay`: what a person gets, on a stand-in bus."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.bus import CanBus, open_bus

LOG = """\
(10.000000) can0 520#0000030000000000
(10.001000) can0 510#0000000000000000
(10.002000) can0 523#640064006400
(10.003000) can0 621#01
(10.004000) can0 520#0000030000000000
"""
BUS = f"loopback:replay-{os.getpid()}"


@pytest.fixture
def log(tmp_path: Path) -> str:
    path = tmp_path / "run.log"
    path.write_text(LOG)
    return str(path)


@pytest.fixture
def bus() -> Iterator[CanBus]:
    with open_bus(BUS) as opened:
        yield opened


def received(bus: CanBus, count: int) -> list[str]:
    """The next frames on the bus, and that none follows."""
    frames = [bus.recv(60.0) for _ in range(count)]
    assert bus.recv(0.05) is None
    return [str(frame) for frame in frames]


def test_the_cars_frames_are_sent_and_the_rest_is_reported(
    log: str, bus: CanBus, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsai_vcu.cli.replay._LATE_NS", 60 * S)  # how late the machine was is not of interest
    assert main(["replay", log, "-i", BUS]) == 0
    gps = "621#01"
    assert received(bus, 4) == ["520#0000030000000000", "523#640064006400", gps, "520#0000030000000000"]
    own = "0x510 to 0x514, the AI computer's own (--with-ai-ids: send them too)"
    left_out = f"fsai-vcu replay: left out: 1 frames of {own}\n"
    assert capsys.readouterr().err == f"{left_out}4 frames sent\n"


def test_the_ais_own_frames_are_sent_where_that_is_asked_for(log: str, bus: CanBus) -> None:
    assert main(["replay", log, "-i", BUS, "--with-ai-ids"]) == 0
    assert received(bus, 5)[1] == "510#0000000000000000"


def test_a_part_filtered_and_looped(log: str, bus: CanBus) -> None:
    argv = ["replay", f"{log},520:7FF", BUS, "--from", "0", "--to", "0.002", "--loop", "3", "--rate", "10"]
    assert main(argv) == 0
    assert received(bus, 3) == ["520#0000030000000000"] * 3


def test_ctrl_c_ends_a_loop_cleanly(log: str, bus: CanBus) -> None:
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", "replay", log, "-i", BUS, "--loop"]
    process = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True)
    assert all(bus.recv(60.0) is not None for _ in range(10))
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60.0)[1]
    assert process.returncode == 0
    lines = [line for line in said.splitlines() if " ms late" not in line]
    assert lines[-1].endswith(" frames sent")


def test_ctrl_c_says_how_much_of_the_log_was_sent(log: str, bus: CanBus) -> None:
    argv = [sys.executable, "-m", "fsai_vcu.cli.main", "replay", log, "-i", BUS, "--loop", "100000"]
    process = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True)
    assert bus.recv(60.0) is not None
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60.0)[1]
    assert process.returncode == 0
    assert re.search(r"^interrupted: \d+ of 400000 frames sent$", said, re.MULTILINE)


def test_a_broken_log_is_sent_up_to_the_break_and_fails(
    log: str, bus: CanBus, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(log)
    path.write_text("nonsense\n" + LOG)
    assert main(["replay", log, "-i", BUS]) == 1
    assert len(received(bus, 4)) == 4
    assert "line 1: not a line of candump" in capsys.readouterr().err


def test_messages_by_name_or_identifier_are_sent(log: str, bus: CanBus, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", log, "-i", BUS, "--messages", "*_Steer,0x621"]) == 0
    assert received(bus, 2) == ["523#640064006400", "621#01"]
    assert main(["replay", log, "-i", BUS, "--messages", "NoSuch"]) == 1
    assert "no message NoSuch" in capsys.readouterr().err


def test_pauses_of_a_log_are_said_and_can_be_skipped(
    tmp_path: Path, bus: CanBus, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsai_vcu.cli.replay._LATE_NS", 60 * S)
    path = tmp_path / "run.log"
    path.write_text("".join(f"({second}.000000) can0 520#0000030000000000\n" for second in (1, 2_000_000_000)))
    assert main(["replay", str(path), "-i", BUS, "--skip-pauses", "--rate", "100"]) == 0
    assert len(received(bus, 2)) == 2
    said = "fsai-vcu replay: pauses skipped: 1 of over a minute, 1999999999 s in all\n"
    assert capsys.readouterr().err == f"{said}2 frames sent\n"
