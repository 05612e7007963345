"""Programs with Fast DDS's usual transports, shared memory among them: they find the nodes, and hold up nobody."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from ros_rig import RosRig

from fsai_vcu.diagnostics.doctor.collect import dds_leftovers
from fsai_vcu.runtime.transport import VARIABLES, loopback_environment

LONG_S = 60.0
# What a team's own program or a `ros2` tool is: it knows nothing of this project.
PROGRAM = """
import sys, time, rclpy
rclpy.init()
node = rclpy.create_node("visitor")
until = time.monotonic() + 600
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


def mapped(pid: int) -> set[str]:
    """The process's files of shared memory, ports that others may have open as well among them."""
    words = (line.split() for line in Path(f"/proc/{pid}/maps").read_text().splitlines())
    return {line[5] for line in words if len(line) > 5 and re.match("/dev/shm/.*fast(rtps|dds)_", line[5])}


def test_leftovers_in_dev_shm_keep_no_node_from_starting(
    request: pytest.FixtureRequest,
) -> None:
    victim = started("visitor", "stays")
    assert victim.stdout is not None and victim.stdout.readline() == "found\n"
    files = mapped(victim.pid)
    segments = {path for path in files if "port" not in path}
    try:
        assert segments and not segments & set(dds_leftovers()), "its owner lives"
        victim.kill()
        victim.wait(LONG_S)
        assert segments <= set(dds_leftovers()), "its owner is gone"
        request.getfixturevalue("detector")
        program = started("cone_detector", "leaves")
        output, _ = program.communicate()
        assert output == "found\n"
    finally:
        victim.kill()
        victim.wait(LONG_S)
        for path in {*files, *(f"{path}_el" for path in files)} & set(dds_leftovers()):
            Path(path).unlink(missing_ok=True)


def test_the_nodes_sockets_have_room_for_a_flood(rig: RosRig) -> None:
    """Else a request beside it is lost, and comes again after 3 s."""
    allowed = int(Path("/proc/sys/net/core/rmem_max").read_text())
    rig.turns()
    rooms = []
    for path in Path("/proc/self/fd").iterdir():
        if not (path.is_symlink() and str(path.readlink()).startswith("socket:")):
            continue
        with socket.socket(fileno=os.dup(int(path.name))) as each:
            if each.type is socket.SOCK_DGRAM and each.family is socket.AF_INET:
                rooms.append(each.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF))
    assert sum(room == 2 * min(allowed, 1 << 20) for room in rooms) >= 2, rooms  # the kernel doubles it
