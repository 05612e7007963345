"""Tests of the ROS 2 nodes, on real rclpy. Each run has a ROS domain of its own and stays on this machine."""

from __future__ import annotations

import os
import sys
import uuid
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from fsai_vcu.runtime.transport import LOOPBACK, set_transport

CHECKOUT = Path(__file__).parents[2]

# Read when rclpy and the messages are imported. Field checks find what the middleware would send as nonsense.
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ.update(LOOPBACK)
set_transport(os.environ)
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
# The checkout's nodes are tested, not a copy that was installed some time ago.
sys.path.insert(0, str(CHECKOUT / "nodes" / "fsai_nodes"))
REDUCED = str(Path(__file__).parent / "humble")  # on PYTHONPATH it makes rclpy what Humble's is, in all processes
_paths = [REDUCED] if REDUCED in os.environ.get("PYTHONPATH", "").split(":") else []
os.environ["PYTHONPATH"] = ":".join([*_paths, str(CHECKOUT / "nodes" / "fsai_nodes")])


_ABSENT = [name for name in ("rclpy", "fsai_msgs") if find_spec(name) is None]
collect_ignore_glob = ["test_*.py"] if _ABSENT else []


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for name in _ABSENT:
        how = "pip install 'fsai-vcu[ros]', then nodes/build-messages"
        terminalreporter.write_line(f"tests/nodes: left out, for {name} is not in this environment ({how})")


@pytest.fixture
def rig() -> Iterator[object]:
    """A started ROS with an executor; nodes added to it are stopped and destroyed at the end."""
    from ros_rig import RosRig

    with RosRig() as started:
        yield started


@pytest.fixture
def bus() -> str:
    """A stand-in bus that nobody else is on."""
    return f"loopback:{uuid.uuid4()}"
