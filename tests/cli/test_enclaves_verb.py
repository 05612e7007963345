"""The verb that makes the keys: with a stand-in for the distribution's `ros2 security`, and without it."""

from __future__ import annotations

import os
import re
import stat
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

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
    for each in $(sed -n 's/.*enclave path="\\([^"]*\\)".*/\\1/p' "$6"); do
      mkdir -p "$4/enclaves$each"; echo key > "$4/enclaves$each/key.pem"; chmod 644 "$4/enclaves$each/key.pem"
      ln -sf key.pem "$4/enclaves$each/link.pem"
    done
    echo g > "$4/enclaves/governance.p7s"
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
    monkeypatch.setattr(enclaves, "_DISTRIBUTIONS", tmp_path)
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
    keys = list((keystore / "enclaves").rglob("key.pem"))
    assert keys and {mode_of(key) for key in keys} == {0o600}, "without user and group of the services nobody else's"
    said = capsys.readouterr()
    assert f'keystore = "{keystore}"' in said.out, "what is to be written into the configuration"
    assert "only this user can read them" in said.err


ROWS = {  # of the table in security.md: user and groups of the account
    "any account of the PC": (61_009, ()),
    "in the group `fsai`": (61_009, (61_001,)),
    "in the group `fsai-operators` too": (61_009, (61_001, 61_002)),
    "the services' user `fsai`": (61_001, (61_001,)),
    "root": (0, (0,)),
}


def readable_by(account: tuple[int, tuple[int, ...]], keys: list[Path]) -> set[str]:
    """The enclaves whose key a process of the account can open; 'private' for the key that signs."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        try:  # whatever happens, it must not go on as a second pytest
            user, groups = account
            os.setgroups(groups)
            os.setgid(groups[0] if groups else user)
            os.setuid(user)
            for key in keys:
                with suppress(PermissionError):
                    key.read_bytes()
                    os.write(write_end, f"{key.parent.name}\n".encode())
        finally:
            os._exit(0)
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        found = set(pipe.read().split())
    os.waitpid(child, 0)
    return found


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to users and become them")
def test_each_account_reads_the_keys_that_security_md_says(calls: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enclaves.pwd, "getpwnam", lambda name: SimpleNamespace(pw_uid=61_001))
    monkeypatch.setattr(enclaves.grp, "getgrnam", lambda name: SimpleNamespace(gr_gid=61_002))
    with TemporaryDirectory() as folder:  # pytest's own is root's alone
        Path(folder).chmod(0o755)
        keystore = Path(folder) / "keystore"
        assert main(["enclaves", "--keystore", str(keystore)]) == 0
        keys = [*(keystore / "enclaves").rglob("key.pem"), keystore / "private" / "ca.key.pem"]
        found = {account: readable_by(ids, keys) for account, ids in ROWS.items()}
        folders = {path for path in keystore.rglob("*") if path.is_dir()}
        assert folders and {path.stat().st_uid for path in folders} == {0}, "a service can put no link into any"
        everybody = {ids: (keystore / "enclaves" / "governance.p7s").stat().st_mode & 0o777 for ids in ROWS}
    table = {}
    for line in (CHECKOUT / "docs" / "security.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] in ROWS:
            table[cells[0]] = cells[1]
    assert set(table) == set(ROWS)
    every = {key.parent.name for key in keys}
    for account, words in table.items():
        said = every if words == "all of them" else set() if words == "none" else set(re.findall(r"`(\w+)`", words))
        assert said == found[account], account
    assert found["in the group `fsai`"] == set() and set(everybody.values()) == {0o644}


def test_each_service_is_kept_from_the_keys_of_others() -> None:
    every = set(re.findall(r'enclave path="(/fsai/\w+)"', (CHECKOUT / "systemd/security/policy.xml").read_text()))
    assert {path.rpartition("/")[2] for path in every} >= enclaves.OF_SERVICES | enclaves.OF_OPERATORS
    for unit in (CHECKOUT / "systemd" / "units").glob("fsai-*.service"):
        text = unit.read_text()
        own = {f"/fsai/{name}" for name in re.findall(r"fsai_nodes\.(\w+)", text)}
        hidden = set(re.findall(r"-/etc/fsai/keystore/enclaves(/fsai/\w+)", text))
        assert hidden == every - own, unit.name
        assert ("-/etc/fsai/keystore/private" in text) is True, unit.name


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


def test_keys_are_made_for_the_cars_domain(
    calls: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    named = f'keystore = "{tmp_path}/keystore"'  # and is not there, as when it is to be made again
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
    monkeypatch.setattr(enclaves, "_DISTRIBUTIONS", tmp_path)
    assert main(["enclaves", "--keystore", str(tmp_path / "keystore")]) != 0
    said = capsys.readouterr().err
    assert "ros-$ROS_DISTRO-sros2" in said and len(said.strip().splitlines()) == 1
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
