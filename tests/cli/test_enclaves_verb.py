"""The verb that makes the keys: with a stand-in for the distribution's `ros2 security`, and without it."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main

CHECKOUT = Path(__file__).resolve().parents[2]
# Notes what it is called with, and leaves what the real one leaves: folders, keys, a link.
STAND_IN = """#!/bin/sh
echo "$*" >> "$CALLS"
[ "$1 $2" = "security --help" ] && exit 0
case $2 in
  create_keystore) mkdir -p "$3/enclaves" ;;
  generate_artifacts)
    mkdir -p "$4/enclaves/fsai"; echo key > "$4/enclaves/fsai/key.pem"; chmod 644 "$4/enclaves/fsai/key.pem"
    ln -sf key.pem "$4/enclaves/fsai/link.pem"
    exit "${FAILS:-0}" ;;
esac
"""


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """`ros2` is a stand-in, and what it was called with is in this file."""
    tool = tmp_path / "bin" / "ros2"
    tool.parent.mkdir()
    tool.write_text(STAND_IN)
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tool.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    return tmp_path / "calls"


def test_one_command_makes_the_keystore_and_the_keys_of_our_policy_for_the_services_alone(
    calls: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keystore = tmp_path / "keystore"
    policy = CHECKOUT / "systemd" / "security" / "policy.xml"
    assert main(["enclaves", "--keystore", str(keystore), "--policy", str(policy)]) == 0
    assert calls.read_text().splitlines() == [
        "security --help",
        f"security create_keystore {keystore}",
        f"security generate_artifacts -k {keystore} -p {policy}",
    ]
    key = keystore / "enclaves/fsai/key.pem"
    assert stat.S_IMODE(key.stat().st_mode) == 0o640, "nobody else may read a key"
    assert stat.S_IMODE(keystore.stat().st_mode) == 0o750
    assert f'keystore = "{keystore}"' in capsys.readouterr().out, "what is to be written into the configuration"


def test_a_keystore_that_is_there_is_kept_and_its_keys_are_made_for_the_policy_of_today(
    calls: Path, tmp_path: Path
) -> None:
    (tmp_path / "keystore").mkdir()
    assert main(["enclaves", "--keystore", str(tmp_path / "keystore")]) == 0
    assert not any("create_keystore" in line for line in calls.read_text().splitlines())


def test_without_the_distributions_tools_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["enclaves", "--keystore", str(tmp_path / "keystore")]) != 0
    said = capsys.readouterr().err
    assert "ros-jazzy-sros2" in said and len(said.strip().splitlines()) == 1
    assert not (tmp_path / "keystore").exists()


@pytest.mark.usefixtures("calls")
def test_tools_that_fail_fail_the_command_and_a_policy_that_is_not_there_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["enclaves", "--keystore", str(tmp_path / "k"), "--policy", str(tmp_path / "absent.xml")]) != 0
    assert "absent.xml" in capsys.readouterr().err
    monkeypatch.setenv("FAILS", "3")
    assert main(["enclaves", "--keystore", str(tmp_path / "k")]) != 0
    assert "generate_artifacts failed (exit status 3)" in capsys.readouterr().err
