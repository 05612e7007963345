"""`rehearse` on a real bus: it starts a C program that speaks SocketCAN, looks at it, and ends it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from fsai_hil import CHECKOUT
from fsai_vcu.interface.reserved import AI_IDS

SOURCE = CHECKOUT / "examples" / "own_can_node" / "own_can_node.c"
Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.mark.parametrize("only", ["end", pytest.param("handshake,end", marks=pytest.mark.long)])
def test_a_c_program_is_started_looked_at_and_ended(
    interface: str, verb: Run, tmp_path: Path, results: Path, only: str
) -> None:
    program = tmp_path / "own_can_node"
    subprocess.run(["cc", "-o", str(program), str(SOURCE)], check=True)
    done = verb(
        *("rehearse", "-i", interface, "--no-gps", "--only", only, "--json", "-o", str(results)),
        *("--", str(program), interface),
        timeout_s=120.0,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert {item["item"]: item["result"] for item in found["items"]} == dict.fromkeys(only.split(","), "pass")
    assert (results / "result.html").read_text().startswith("<!doctype html>")
    log = (results / "bus.log").read_text()
    assert all(f" {can_id:03X}#" in log for can_id in (*AI_IDS, 0x520))
