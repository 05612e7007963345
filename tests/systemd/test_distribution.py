"""Where the car PC has the distribution's ROS 2: what its setup file says reaches services and command line.

The distribution is a stand-in here: folders as ros-jazzy-ros-base has them, with a package that is called rclpy.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from install_rig import CHECKOUT, INSTALL

SETUP = """export AMENT_PREFIX_PATH={ros}
export PYTHONPATH={ros}/lib/python3/site-packages
export LD_LIBRARY_PATH={ros}/opt/vendor/lib:{ros}/lib
export ROS_DISTRO=jazzy
export ROS_VERSION=2
export ROS_PYTHON_VERSION=3
export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET
export CMAKE_PREFIX_PATH={ros}
"""


@pytest.fixture
def ros(tmp_path: Path) -> Path:
    folder = tmp_path / "ros" / "jazzy"
    package = folder / "lib/python3/site-packages/rclpy"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (folder / "setup.bash").write_text(SETUP.format(ros=folder))
    return folder


@pytest.fixture
def installed(tmp_path: Path, ros: Path) -> Path:
    """/opt/fsai as an installation on such a machine leaves it: the environment file, and the command."""
    folder = tmp_path / "opt"
    (folder / "bin").mkdir(parents=True)
    (folder / "bin/fsai-vcu").symlink_to(Path(sys.executable).with_name("fsai-vcu"))
    function = re.search(r"^describe_distribution\(\) \{\n.*?^\}\n", INSTALL.read_text(), re.M | re.S)
    assert function is not None
    variables = {"PREFIX": str(folder), "ROS_PREFIX": str(ros), "env": str(folder)}
    subprocess.run(
        ["bash", "-euo", "pipefail", "-c", f"{function[0]}describe_distribution"],
        env={"PATH": os.environ["PATH"], **variables},
        check=True,
    )
    return folder


def test_a_ros_setup_file_is_noted_with_our_messages_first(installed: Path, ros: Path) -> None:
    lines = dict(line.split("=", 1) for line in (installed / "environment").read_text().splitlines())
    assert lines["AMENT_PREFIX_PATH"] == f"{installed}:{ros}"
    assert lines["LD_LIBRARY_PATH"] == f"{installed}/lib:{ros}/opt/vendor/lib:{ros}/lib"
    assert lines["PYTHONPATH"] == f"{ros}/lib/python3/site-packages"
    assert lines["ROS_DISTRO"] == "jazzy"
    assert "CMAKE_PREFIX_PATH" not in lines, "what only building needs"


def test_our_configuration_decides_whom_the_nodes_talk_to(installed: Path) -> None:
    text = (installed / "environment").read_text()
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" not in text and "ROS_DOMAIN_ID" not in text


def test_the_doctor_names_the_distributions_rclpy(installed: Path, ros: Path, tmp_path: Path) -> None:
    launcher = tmp_path / "fsai-vcu"
    text = (CHECKOUT / "systemd" / "fsai-vcu").read_text()
    assert "/opt/fsai/environment" in text and "/opt/fsai/bin/fsai-vcu" in text
    launcher.write_text(text.replace("/opt/fsai", str(installed)))
    launcher.chmod(0o755)
    done = subprocess.run(
        [launcher, "doctor", "--json", "--config", tmp_path / "absent.toml"],
        env={"PATH": os.environ["PATH"], "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    findings = json.loads(done.stdout)["findings"]
    found = [finding["words"] for finding in findings if finding["topic"] == "ROS 2"]
    assert found[0] == f"jazzy, {ros}/lib/python3/site-packages/rclpy"


def test_services_take_their_ros_from_the_same_file() -> None:
    sandbox = (CHECKOUT / "systemd/units/fsai-.service.d/50-sandbox.conf").read_text()
    assert "EnvironmentFile=-/opt/fsai/environment\n" in sandbox
