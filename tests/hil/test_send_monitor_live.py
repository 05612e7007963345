"""`monitor` and `send` on a live bus: one sees the bus go, the other sends as cansend does."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import VERB, BusLog
from fsai_hil.rehearsal.stack import await_condition

WITHIN_S = 20.0
Run = Callable[..., "subprocess.CompletedProcess[str]"]

BENCH = """\
VERSION ""

BU_: AI LAMP

BO_ 419 BenchLamp: 2 AI
 SG_ COLOUR : 0|4@1+ (1,0) [0|15] "" LAMP
 SG_ LEVEL : 8|8@1+ (0.5,0) [0|100] "%" LAMP

BO_ 2566848767 BenchWide: 1 AI
 SG_ ANY : 0|8@1+ (1,0) [0|255] "" LAMP

VAL_ 419 COLOUR 0 "OFF" 1 "RED";
"""


@pytest.fixture
def bench(tmp_path: Path) -> str:
    path = tmp_path / "bench.dbc"
    path.write_text(BENCH)
    return str(path)


def test_an_interface_that_goes_down_ends_monitor_with_one_line(tmp_path: Path) -> None:
    subprocess.run(["ip", "link", "add", "dev", "vcan2", "type", "vcan"], check=True)
    try:
        subprocess.run(["ip", "link", "set", "vcan2", "up"], check=True)
        out = tmp_path / "monitor.txt"
        with out.open("wb") as file:
            argv = [*VERB, "monitor", "vcan2", "--plain", "--every", "0.1"]
            process = subprocess.Popen(argv, stdout=file, stderr=subprocess.PIPE, text=True)
            await_condition(lambda: out.stat().st_size > 0, WITHIN_S, "monitor listens")
            subprocess.run(["ip", "link", "set", "vcan2", "down"], check=True)
            _, said = process.communicate(timeout=WITHIN_S)
        assert process.returncode == 1
        assert said.startswith("fsai-vcu monitor: vcan2: ") and said.count("\n") == 1
    finally:
        subprocess.run(["ip", "link", "del", "vcan2"], check=True)


@pytest.mark.parametrize(
    ("argv", "frame"),
    [
        (("BenchLamp", "COLOUR=RED", "LEVEL=12.5"), "1A3#0119"),
        (("BenchWide", "ANY=255"), "18FF00FF#FF"),
    ],
)
def test_send_and_cansend_of_its_dry_run_send_the_same_frame(
    argv: tuple[str, ...], frame: str, interface: str, bench: str, bus_log: BusLog, verb: Run
) -> None:
    dry = verb("send", *argv, "--dbc", bench, "--dry-run")
    assert (dry.returncode, dry.stdout) == (0, f"{frame}\n"), dry.stderr
    subprocess.run(["cansend", interface, dry.stdout.strip()], check=True)
    done = verb("send", *argv, "--dbc", bench, "-i", interface, "--count", "3", "--period", "20")
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == f"3 frames sent on {interface}"
    await_condition(lambda: len(bus_log.frames()) == 4, WITHIN_S, "candump wrote every frame")
    assert len({str(each) for each in bus_log.frames()}) == 1
    assert bus_log.path.read_text().split()[2] == frame
