"""`send` on a live bus sends as cansend does."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from fsai_hil.rehearsal.bus_watch import BusWatch
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


@pytest.mark.parametrize(
    ("argv", "frame"),
    [
        (("BenchLamp", "COLOUR=RED", "LEVEL=12.5"), "1A3#0119"),
        (("BenchWide", "ANY=255"), "18FF00FF#FF"),
    ],
)
def test_send_and_cansend_of_its_dry_run_send_the_same_frame(
    argv: tuple[str, ...], frame: str, interface: str, bench: str, bus_log: BusWatch, verb: Run
) -> None:
    dry = verb("send", *argv, "--dbc", bench, "--dry-run")
    assert (dry.returncode, dry.stdout) == (0, f"{frame}\n"), dry.stderr
    subprocess.run(["cansend", interface, dry.stdout.strip()], check=True)
    done = verb("send", *argv, "--dbc", bench, "-i", interface, "--count", "3", "--period", "20")
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == f"3 frames sent on {interface}"
    await_condition(lambda: len(bus_log.frames) == 4, WITHIN_S, "candump wrote every frame")
    assert len({str(each) for each in bus_log.frames}) == 1
    assert bus_log.path.read_text().split()[2] == frame
