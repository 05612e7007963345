"""The Debian package, put by dpkg into an image of a machine: installed, upgraded, removed, purged; this machine is
touched by none of it."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
from pathlib import Path

import pytest

from fsai_hil.rehearsal.carpc import __main__ as rehearsed
from fsai_hil.vcan import VcanError

TOOLS = ("dpkg", "systemctl", "systemd-sysusers", "systemd-tmpfiles")
pytestmark = pytest.mark.skipif(
    os.geteuid() != 0 or not all(shutil.which(tool, path=f"{os.environ['PATH']}:/usr/sbin:/sbin") for tool in TOOLS),
    reason=f"dpkg fills an image as root only, with {', '.join(TOOLS)}",
)
# Ubuntu 22.04's, the oldest; and the interpreter of each distribution.
HAVE = {"systemd": "249.11", "iproute2": "5.15"}
HAVE |= {"python3.10": "3.10.4", "python3.11": "3.11.2", "python3.12": "3.12.3", "python3.13": "3.13.5"}
TARGET = "etc/systemd/system/multi-user.target.wants/fsai.target"
NODES = {f"fsai-{name}.service" for name in ("detector", "planner", "controller")}
BRIDGE = "etc/systemd/system/fsai.target.wants/fsai-bridge@{}.service"


class Image:
    """A folder that dpkg takes for a machine."""

    def __init__(self, root: Path, have: dict[str, str]) -> None:
        self.root = root
        for folder in ("info", "updates"):
            (root / "var/lib/dpkg" / folder).mkdir(parents=True)
        status = "".join(
            f"Package: {name}\nStatus: install ok installed\nVersion: {version}\nArchitecture: all\n"
            "Maintainer: nobody\nDescription: stands in\n\n"
            for name, version in have.items()
        )
        (root / "var/lib/dpkg/status").write_text(status)
        # Units are enabled by name; systemd wants to see that there is a machine.
        (root / "etc").mkdir()

    def dpkg(self, *words: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["dpkg", f"--root={self.root}", "--force-script-chrootless", "--force-unsafe-io", *map(str, words)],
            env={**os.environ, "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )

    def has(self, name: str) -> bool:
        return os.path.lexists(self.root / name)

    def settle(self, *words: str) -> subprocess.CompletedProcess[str]:
        command = [self.root / "usr/lib/fsai/settle", *words]
        environment = {**os.environ, "DPKG_ROOT": str(self.root)}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    @property
    def enabled(self) -> set[str]:
        return {path.name for path in self.root.glob("etc/systemd/system/*.wants/fsai*")}

    @property
    def starts(self) -> set[str]:
        """What is started with the machine, or with an adapter; the nodes are with the target alone."""
        return self.enabled if self.has(TARGET) else {name for name in self.enabled if name not in NODES}


@pytest.fixture
def fresh(deb: Path, tmp_path: Path) -> Image:
    found = Image(tmp_path, HAVE)
    done = found.dpkg("-i", deb)
    assert done.returncode == 0, done.stderr
    return found


@pytest.fixture
def image(fresh: Image) -> Image:
    assert fresh.settle("can0").returncode == 0
    return fresh


def test_nothing_starts_before_a_bus_is_named(fresh: Image, deb: Path) -> None:
    # Somebody turns the car's wheels by hand meanwhile: no adapter that is plugged in may wake the bridge.
    assert fresh.starts == set()
    assert "nothing is sent until you say so" in fresh.settle().stdout
    assert "it starts with the machine" in fresh.settle("can0").stdout
    assert fresh.settle("--off").returncode == 0
    assert fresh.dpkg("-i", deb).returncode == 0
    assert fresh.starts == set(), "nor after an upgrade"


@pytest.mark.parametrize("a_stack_of_their_own", [False, True])
def test_switched_off_nothing_starts_until_a_bus_is_named_again(
    image: Image, deb: Path, a_stack_of_their_own: bool
) -> None:
    wants = image.root / "etc/systemd/system/fsai.target.wants"
    for node in sorted(NODES)[: 3 if a_stack_of_their_own else 1]:
        (wants / node).unlink()
    before = image.starts
    assert "fsai.target" in before
    (wants / "fsai-simulated-sensors.service").symlink_to("/dev/null")
    settings = image.root / "etc/systemd/system/fsai.target.d/override.conf"
    settings.write_text("[Unit]\n")
    assert image.settle("--off").returncode == 0
    assert image.dpkg("-i", deb).returncode == 0
    assert image.starts == set()
    assert settings.exists() and len(list(settings.parent.iterdir())) == 1, "what the team has written is kept"
    assert image.settle("can0").returncode == 0
    assert image.starts == before, "which nodes start is remembered"


@pytest.mark.parametrize(
    "words", [["can 0"], ["../can0"], ["--of"], ["can0;"], ["off"], ["can", "0"], ["can1", "--off"]]
)
def test_what_cannot_be_a_bus_changes_nothing(image: Image, words: list[str]) -> None:
    before = image.starts
    done = image.settle(*words)
    assert done.returncode == 2 and done.stderr.startswith("settle: ")
    assert image.starts == before


def test_with_a_bus_named_it_starts_at_boot_as_its_own_user(image: Image) -> None:
    assert image.has(TARGET) and image.has(BRIDGE.format("can0"))
    users = (image.root / "etc/passwd").read_text()
    (line,) = [line for line in users.splitlines() if line.startswith("fsai:")]
    group = int(line.split(":")[3])
    assert line.endswith("nologin"), "nobody can log in as the services' user"
    for name in ("fsai.toml", "limits.toml"):
        status = (image.root / "etc/fsai" / name).stat()
        assert (status.st_uid, status.st_gid, stat.S_IMODE(status.st_mode)) == (0, group, 0o640)
    logs = (image.root / "var/log/fsai").stat()
    assert (logs.st_gid, stat.S_IMODE(logs.st_mode)) == (group, 0o750)
    # Seen in the rehearsal: a device asked for the recorder while it was still stopping, and nothing asked again.
    held = (image.root / "etc/systemd/system/fsai.target.d/10-interface.conf").read_text()
    assert held == "[Unit]\nUpholds=fsai-bridge@can0.service fsai-recorder@can0.service\n"


def test_without_what_it_depends_on_it_is_not_configured(deb: Path, tmp_path: Path) -> None:
    bare = Image(tmp_path, {name: version for name, version in HAVE.items() if name != "iproute2"})
    done = bare.dpkg("-i", deb)
    assert done.returncode != 0 and "iproute2" in done.stderr
    assert not bare.has(TARGET)


def test_an_upgrade_keeps_configuration_and_what_is_disabled(image: Image, deb: Path) -> None:
    toml = image.root / "etc/fsai/fsai.toml"
    toml.write_text("# ours\n")
    toml.chmod(0o666)
    detector = image.root / "etc/systemd/system/fsai.target.wants/fsai-detector.service"
    detector.unlink()
    assert image.settle("vcan0").returncode == 0
    (image.root / TARGET).unlink()
    before = image.starts
    done = image.dpkg("-i", deb)
    assert done.returncode == 0, done.stderr
    assert toml.read_text() == "# ours\n" and stat.S_IMODE(toml.stat().st_mode) == 0o640
    assert image.starts == before and "fsai-detector.service" not in before and "fsai-bridge@vcan0.service" in before


def test_another_bus_that_is_named_takes_the_place_of_the_first(image: Image) -> None:
    assert image.settle("vcan0").returncode == 0
    assert image.has(BRIDGE.format("vcan0")) and not image.has(BRIDGE.format("can0"))
    assert image.settle().returncode == 0
    assert image.has(BRIDGE.format("vcan0")), "settled again, as an upgrade does, nothing is decided again"


def test_removal_ends_it_and_purging_leaves_only_the_logs(image: Image, deb: Path) -> None:
    log = image.root / "var/log/fsai/run.log"
    log.touch()
    stray = image.root / "opt/fsai/lib/stray.pyc"
    stray.parent.mkdir(parents=True)
    stray.touch()
    assert image.dpkg("-r", "fsai-vcu").returncode == 0
    assert not image.has(TARGET) and not image.has(BRIDGE.format("can0")) and not image.has("opt/fsai")
    assert image.has("etc/fsai/fsai.toml"), "a removed package leaves the configuration"
    assert image.dpkg("-i", deb).returncode == 0
    assert image.starts == set(), "installed again it waits for a bus to be named"
    assert image.settle("can0").returncode == 0 and image.has(TARGET)
    assert image.dpkg("--purge", "fsai-vcu").returncode == 0
    ours = [path for path in image.root.rglob("*fsai*") if "var/lib/dpkg" not in str(path)]
    assert {str(path.relative_to(image.root)) for path in ours} == {"var/log/fsai"}
    assert log.exists()


def test_what_was_compiled_goes_before_other_modules_come(image: Image, deb: Path) -> None:
    compiled = image.root / "opt/fsai/lib/__pycache__/module.pyc"
    for words in (["-i", deb], ["-r", "fsai-vcu"]):
        compiled.parent.mkdir(parents=True)
        compiled.touch()
        assert image.dpkg(*words).returncode == 0
        assert not compiled.exists()


def test_purging_takes_a_log_folder_that_is_empty(image: Image) -> None:
    assert image.dpkg("--purge", "fsai-vcu").returncode == 0
    ours = [path for path in image.root.rglob("*fsai*") if "var/lib/dpkg" not in str(path)]
    assert ours == []


def test_the_rehearsal_unpacks_the_package_afresh(deb: Path, tmp_path: Path) -> None:
    Image(tmp_path / "machine", HAVE)
    # As man-db looks at manual pages; its script is of the machine, and not below the root.
    (tmp_path / "machine/var/lib/dpkg/triggers").mkdir()
    (tmp_path / "machine/var/lib/dpkg/triggers/File").write_text("/usr/share/doc iproute2\n")
    script = tmp_path / "machine/var/lib/dpkg/info/iproute2.postinst"
    script.write_text("#!/bin/sh\n")
    script.chmod(0o755)
    root = tmp_path / "root"
    rehearsed.unpack(deb, root, tmp_path / "machine/var/lib/dpkg")
    status = (root / "var/lib/dpkg/status").read_text()
    assert "Package: iproute2" in status and "install ok unpacked" in status
    assert (root / "usr/lib/fsai/settle").exists()
    (root / "mark").touch()
    rehearsed.unpack(deb, root, tmp_path / "machine/var/lib/dpkg")
    assert not (root / "mark").exists() and (root / "usr/lib/fsai/settle").exists()


def test_a_package_that_dpkg_refuses_is_one_clear_line(deb: Path, tmp_path: Path) -> None:
    Image(tmp_path / "machine", HAVE)
    broken = tmp_path / "fsai-vcu_1_all.deb"
    broken.write_text("no package\n")
    with pytest.raises(VcanError, match=r"dpkg does not unpack fsai-vcu_1_all\.deb"):
        rehearsed.unpack(broken, tmp_path / "root", tmp_path / "machine/var/lib/dpkg")
    assert deb.exists()
