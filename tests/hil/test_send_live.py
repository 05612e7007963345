"""`send` on a live bus sends as cansend does."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

from fsai_hil.rehearsal.bus_watch import BusWatch
from fsai_hil.rehearsal.stack import await_condition

WITHIN_S = 60.0
Run = Callable[..., "subprocess.CompletedProcess[str]"]

BENCH = """\
VERSION ""

BU_: AI LAMP

BO_ 2566848767 BenchWide: 1 AI
 SG_ ANY : 0|8@1+ (1,0) [0|255] "" LAMP
"""


def test_send_and_cansend_of_its_dry_run_send_the_same_frame(
    interface: str, bus_log: BusWatch, verb: Run, tmp_path: Path
) -> None:
    bench = tmp_path / "bench.dbc"
    bench.write_text(BENCH)
    wide = ("BenchWide", "ANY=255", "--dbc", str(bench))
    dry = verb("send", *wide, "--dry-run")
    assert (dry.returncode, dry.stdout) == (0, "18FF00FF#FF\n"), dry.stderr
    subprocess.run(["cansend", interface, dry.stdout.strip()], check=True)
    done = verb("send", *wide, "-i", interface, "--count", "3", "--period", "20")
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == f"3 frames sent on {interface}"
    await_condition(lambda: len(bus_log.frames) == 4, WITHIN_S, "candump wrote every frame")
    assert len({str(each) for each in bus_log.frames}) == 1
    assert bus_log.path.read_text().split()[2] == "18FF00FF#FF"
