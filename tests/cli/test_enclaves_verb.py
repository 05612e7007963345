"""The verb that makes the keys: with a stand-in for the distribution's `ros2 security`, and without it."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from fsai_vcu.cli import enclaves
from fsai_vcu.cli.main import main
from fsai_vcu.runtime import configuration

CHECKOUT = Path(__file__).resolve().parents[2]
# Notes what it is called with, and leaves what the real one leaves: folders, keys, links; and only where its setup file
# has been read and nobody else's libraries are in its way.
STAND_IN = """#!/bin/sh
[ "$SOURCED" ] && [ "$LD_LIBRARY_PATH" = /distribution/lib ] || exit 9
echo "$*" >> "$CALLS"
[ "$1 $2" = "security --help" ] && exit 0
case $2 in
  create_keystore)
    mkdir -p "$3/enclaves" "$3/public" "$3/private"
    echo key > "$3/private/ca.key.pem"; ln -s ca.key.pem "$3/private/identity_ca.key.pem"
    stat -c %a "$3/private/ca.key.pem" >> "$CALLS"
    echo cert > "$3/public/ca.cert.pem" ;;
  generate_artifacts)
    mkdir -p "$4/enclaves/fsai"; echo key > "$4/enclaves/fsai/key.pem"; chmod 644 "$4/enclaves/fsai/key.pem"
    ln -sf key.pem "$4/enclaves/fsai/link.pem"
    echo "domain $ROS_DOMAIN_ID" >> "$CALLS"
    exit "${FAILS:-0}" ;;
esac
"""
SETUP = 'export SOURCED=yes LD_LIBRARY_PATH="/distribution/lib$LD_LIBRARY_PATH"\n'


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A distribution's stand-in, not on the PATH, as under sudo; what its `ros2` was called with is in this file."""
    tool = tmp_path / "jazzy" / "bin" / "ros2"
    tool.parent.mkdir(parents=True)
    tool.write_text(STAND_IN)
    tool.chmod(0o755)
    (tmp_path / "jazzy" / "setup.bash").write_text(f'export PATH="{tool.parent}:$PATH"\n{SETUP}')
    monkeypatch.setattr(enclaves, "_DISTRIBUTION", tmp_path / "jazzy")
    monkeypatch.setattr(configuration, "USUAL_PATH", tmp_path / "fsai.toml")
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.setenv("LD_LIBRARY_PATH", ":/opt/fsai/lib")
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    return tmp_path / "calls"


def test_one_command_makes_a_keystore_only_services_can_read(
    calls: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keystore = tmp_path / "keystore"
    policy = CHECKOUT / "systemd" / "security" / "policy.xml"
    assert main(["enclaves", "--keystore", str(keystore), "--policy", str(policy)]) == 0
    assert calls.read_text().splitlines() == [
        "security --help",
        f"security create_keystore {keystore}",
        "600",
        f"security generate_artifacts -k {keystore} -p {policy}",
        "domain 0",
    ], "and from its first moment on nobody else can read the key that signs"
    assert mode_of(keystore / "enclaves/fsai/key.pem") == 0o640, "nobody else may read a key"
    assert mode_of(keystore) == mode_of(keystore / "public") == 0o750
    assert f'keystore = "{keystore}"' in capsys.readouterr().out, "what is to be written into the configuration"


def test_a_keystore_is_kept_with_its_signing_key_roots_alone(
    calls: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keystore = tmp_path / "keystore"
    for _ in range(2):
        assert main(["enclaves", "--keystore", str(keystore)]) == 0
        assert mode_of(keystore / "private") == 0o700
        assert mode_of(keystore / "private" / "ca.key.pem") == 0o600
        (keystore / "private").chmod(0o750)  # as an earlier version left it
        (keystore / "private" / "ca.key.pem").chmod(0o640)
    assert calls.read_text().count("create_keystore") == 1
    (line,) = {line for line in capsys.readouterr().out.splitlines() if "chgrp" in line}
    assert line == f"sudo chgrp fsai {keystore} && sudo chgrp -R fsai {keystore}/enclaves {keystore}/public"


def test_keys_are_made_for_the_cars_domain(
    calls: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    named = f'keystore = "{tmp_path}/keystore"'  # and is not there, as when it is to be made anew
    (tmp_path / "fsai.toml").write_text(f"[ros]\ndomain_id = 7\n{named}\n")
    assert main(["enclaves", "--keystore", "keystore"]) == 0
    assert calls.read_text().splitlines()[-1] == "domain 7"
    said = capsys.readouterr().out
    assert "ROS domain 7" in said and named in said, "whatever way it was named by"


def test_a_ros2_on_the_path_is_used_with_its_own_environment(
    calls: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "jazzy").rename(tmp_path / "own")
    (tmp_path / "own" / "setup.bash").unlink()
    monkeypatch.setenv("PATH", f"{tmp_path / 'own' / 'bin'}:{os.environ['PATH']}")
    monkeypatch.setenv("SOURCED", "yes")
    monkeypatch.setenv("LD_LIBRARY_PATH", "/distribution/lib")
    assert main(["enclaves", "--keystore", str(tmp_path / "keystore")]) == 0
    assert any("generate_artifacts" in line for line in calls.read_text().splitlines())


def test_missing_ros2_tools_give_one_line_with_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(enclaves, "_DISTRIBUTION", tmp_path / "jazzy")
    assert main(["enclaves", "--keystore", str(tmp_path / "keystore")]) != 0
    said = capsys.readouterr().err
    assert "ros-jazzy-sros2" in said and len(said.strip().splitlines()) == 1
    assert not (tmp_path / "keystore").exists()


@pytest.mark.usefixtures("calls")
def test_a_keystore_that_cannot_be_made_is_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["enclaves", "--keystore", "/proc/absent"]) == 1
    assert capsys.readouterr().err == "fsai-vcu enclaves: /proc/absent cannot be made: No such file or directory\n"


@pytest.mark.usefixtures("calls")
def test_failing_tools_and_a_missing_policy_are_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["enclaves", "--keystore", str(tmp_path / "k"), "--policy", str(tmp_path / "absent.xml")]) != 0
    assert "absent.xml" in capsys.readouterr().err
    monkeypatch.setenv("FAILS", "3")
    assert main(["enclaves", "--keystore", str(tmp_path / "k")]) != 0
    assert "generate_artifacts failed (exit status 3)" in capsys.readouterr().err
