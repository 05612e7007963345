"""A node started with --config takes everything from that file, and is received by this machine alone."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from fsai_nodes.config_arguments import Configured, ros_arguments
from fsai_nodes.parameters import NodeError
from fsai_vcu.diagnostics.doctor.collect import listening_addresses
from fsai_vcu.runtime.transport import VARIABLES

LONG_S = 60.0
_RANGE, _BUILTIN = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTDDS_BUILTIN_TRANSPORTS"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    limits = tmp_path / "limits.toml"
    limits.write_text("max_speed_mps = 3.5\n")
    path = tmp_path / "fsai.toml"
    path.write_text(
        f'[can]\ninterface = "loopback:configured-{os.getpid()}"\nrevision = "2021"\n[limits]\nfile = "{limits}"\n'
        f"[ros]\ndomain_id = {os.environ['ROS_DOMAIN_ID']}\n"
    )
    return path


class Watched:
    """A node as a process under a stand-in for systemd: what it is told, and the sockets and memory it opens.

    transport: of the operator's environment; what else would choose one is taken out of it.
    """

    def __init__(self, module: str, *arguments: str, folder: Path, transport: Mapping[str, str] | None = None) -> None:
        self.told: list[str] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / "notify"))
        self._socket.settimeout(LONG_S)
        self.process = subprocess.Popen(
            [sys.executable, "-m", f"fsai_nodes.{module}", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={
                **{name: value for name, value in os.environ.items() if name not in VARIABLES},
                **(transport or {}),
                "NOTIFY_SOCKET": str(folder / "notify"),
                "WATCHDOG_USEC": "400000",
                "HOME": str(folder),
            },
        )

    def await_told(self, word: str) -> None:
        until = time.monotonic() + LONG_S
        while word not in self.told:
            assert time.monotonic() < until, f"systemd was never told {word}"
            self.told.append(self._socket.recv(4096).decode())

    def end(self) -> str:
        self.process.send_signal(signal.SIGTERM)
        output, _ = self.process.communicate(timeout=LONG_S)
        assert self.process.returncode == 0, output
        self._socket.close()
        return output

    def addresses(self) -> set[str]:
        found = listening_addresses(Path("/proc", str(self.process.pid)))
        return {str(address) for address in found if not address.is_loopback}

    def shares_memory(self) -> bool:
        """Whether DDS has a thread for shared memory."""
        tasks = Path(f"/proc/{self.process.pid}/task").iterdir()
        return any((task / "comm").read_text().startswith("dds.shm") for task in tasks)


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("cone_detector", ["configuration {file}: revision 2021, car 2021"]),
        (
            "vcu_bridge",
            [
                f"active on loopback:configured-{os.getpid()}, interface revision 2021, car 2021",
                "operational limits: max_speed_mps = 3.5",
            ],
        ),
    ],
)
def test_a_node_takes_the_file_notifies_systemd_and_is_local(
    file: Path, tmp_path: Path, module: str, said: list[str]
) -> None:
    node = Watched(module, "--config", str(file), folder=tmp_path)
    node.await_told("READY=1")
    node.await_told("WATCHDOG=1")
    assert node.addresses() == set()
    output = node.end()
    assert all(words.format(file=file) in output for words in said)
    assert not (tmp_path / ".ros").exists(), "no log files of ROS's own beside the journal"


@pytest.mark.parametrize(
    ("module", "transport", "open_to_networks", "shared_memory", "words"),
    [
        ("composed", {}, False, False, ""),
        ("cone_detector", {_RANGE: "LOCALHOST"}, False, False, ""),
        ("cone_detector", {_RANGE: "SUBNET"}, True, False, "transport: UDP, on every network"),
        (
            "cone_detector",
            {_BUILTIN: "SHM"},
            False,
            True,
            "FASTDDS_BUILTIN_TRANSPORTS=SHM of the environment",
        ),
        ("cone_detector", {_BUILTIN: "UDPv4", _RANGE: "LOCALHOST"}, True, True, "shared memory is used all the same"),
    ],
)
def test_it_is_the_loopback_alone_unless_the_operator_has_chosen(
    tmp_path: Path, module: str, transport: dict[str, str], open_to_networks: bool, shared_memory: bool, words: str
) -> None:
    """And then one line says so."""
    node = Watched(module, folder=tmp_path, transport=transport)
    node.await_told("READY=1")
    assert (node.addresses() != set(), node.shares_memory()) == (open_to_networks, shared_memory)
    output = node.end()
    assert words in output and output.count("transport:") == bool(words)


def test_the_interface_of_the_service_goes_before_the_files(file: Path) -> None:
    found = Configured(["bridge", "--config", str(file), "--interface", "can7"], "vcu_bridge").arguments
    assert 'can_interface:="can7"' in found


def test_the_command_line_goes_before_the_file(file: Path) -> None:
    given = ["--ros-args", "-p", "revision:=2026"]
    found = Configured(["bridge", "--config", str(file), *given], "vcu_bridge").arguments
    assert found[-3:] == given
    assert 'revision:="2021"' in found[:-3]


def test_a_command_line_without_a_configuration_is_left_as_it_is() -> None:
    words = ["bridge", "other", "--ros-args", "-p", "config:=x"]
    assert Configured(words, "vcu_bridge").arguments == words


def test_composed_nodes_get_their_parameters_by_name() -> None:
    found = ros_arguments({"path_planner": {"laps": 3, "car": "2026"}, "vehicle_controller": {"max_speed": 4.0}})
    assert found[1:-1:2] == ["-p"] * 3
    assert found[2:-1:2] == ["path_planner:laps:=3", 'path_planner:car:="2026"', "vehicle_controller:max_speed:=4.0"]


def test_a_text_of_any_letters_comes_to_the_node_as_it_is() -> None:
    path = '/etc/fsai/\U0001f3ce é "x"\\n/limits.toml'
    given = ["x", *ros_arguments({"": {"limits": path}})]
    context = Context()
    rclpy.init(args=given, context=context)
    node = Node("reader", context=context)
    assert node.declare_parameter("limits", "").value == path
    node.destroy_node()
    context.try_shutdown()


def test_a_wrong_configuration_is_refused_with_its_file_and_line(tmp_path: Path) -> None:
    (tmp_path / "fsai.toml").write_text("[can]\nrevison = '2026'\n")
    with pytest.raises(NodeError, match=r"fsai\.toml, line 2: \[can\] has no setting 'revison'"):
        Configured(["bridge", "--config", str(tmp_path / "fsai.toml")], "vcu_bridge")
    with pytest.raises(NodeError, match="--interface needs --config"):
        Configured(["bridge", "--interface", "can0"], "vcu_bridge")
