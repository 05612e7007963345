"""Programs with Fast DDS's usual transports, shared memory among them: they find the nodes, and hold up nobody."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed (pip install 'fsai-vcu[ros]')")

from fsai_vcu.diagnostics.doctor.collect import dds_leftovers
from fsai_vcu.runtime.transport import VARIABLES, loopback_environment

SHARED_MEMORY = Path("/dev/shm")
LONG_S = 60.0
# What a team's own program or a `ros2` tool is: it knows nothing of this project.
PROGRAM = """
import sys, time, rclpy
rclpy.init()
node = rclpy.create_node("visitor")
until = time.monotonic() + 30
while sys.argv[1] not in node.get_node_names() and time.monotonic() < until:
    rclpy.spin_once(node, timeout_sec=0.1)
print("found" if sys.argv[1] in node.get_node_names() else "not found", flush=True)
if sys.argv[2] == "stays":
    rclpy.spin(node)
"""


def started(name: str, then: str) -> subprocess.Popen[str]:
    usual = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, name, then],
        stdout=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env=usual,
    )


@pytest.fixture
def detector() -> Iterator[subprocess.Popen[str]]:
    """A node of ours as a process."""
    node = subprocess.Popen(
        [sys.executable, "-m", "fsai_nodes.cone_detector"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=loopback_environment(os.environ),
    )
    yield node
    node.send_signal(signal.SIGTERM)
    output, _ = node.communicate(timeout=LONG_S)
    assert node.returncode == 0, output


def test_a_program_with_the_usual_transports_finds_a_node(detector: subprocess.Popen[str]) -> None:
    program = started("cone_detector", "leaves")
    output, _ = program.communicate(timeout=LONG_S)
    assert output == "found\n"


def test_what_killed_programs_leave_in_dev_shm_is_named_and_keeps_no_node_from_starting(
    request: pytest.FixtureRequest,
) -> None:
    before = set(dds_leftovers())
    victim = started("visitor", "stays")
    assert victim.stdout is not None and victim.stdout.readline() == "found\n"
    own = set(SHARED_MEMORY.glob("*fastrtps_*")) - {Path(path) for path in before}
    try:
        assert own and not own & {Path(path) for path in dds_leftovers()}, "its owner lives"
        victim.kill()
        victim.wait(LONG_S)
        assert own <= {Path(path) for path in dds_leftovers()}, "its owner is gone"
        request.getfixturevalue("detector")
        program = started("cone_detector", "leaves")
        output, _ = program.communicate(timeout=LONG_S)
        assert output == "found\n"
    finally:
        victim.kill()
        victim.wait(LONG_S)
        for path in own:
            path.unlink(missing_ok=True)
