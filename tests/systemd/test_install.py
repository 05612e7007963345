"""Installing below a folder, as packages do: again without harm, away without a trace but the configuration."""

from __future__ import annotations

import gzip
import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

from install_rig import CHECKOUT, UNITS, install_car


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_installing_again_keeps_the_configuration(tmp_path: Path) -> None:
    assert install_car("install", destination=tmp_path).returncode == 0
    toml = tmp_path / "etc/fsai/fsai.toml"
    toml.write_text("# ours\n")
    before = contents(tmp_path)
    assert install_car("install", destination=tmp_path).returncode == 0
    assert contents(tmp_path) == before


def modes(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): path.stat().st_mode for path in folder.rglob("*")}


def test_a_version_over_another_is_as_if_installed_alone(tmp_path: Path) -> None:
    car, fresh, version = tmp_path / "car", tmp_path / "fresh", tmp_path / "version"
    for name in ("systemd", "scripts", "docs"):
        shutil.copytree(CHECKOUT / name, version / name)
    for name in ("LICENSE", "CHANGELOG.md", "pyproject.toml"):
        shutil.copy(CHECKOUT / name, version)
    script = version / "scripts" / "install-car"
    assert install_car("install", destination=car, script=script).returncode == 0
    units, ours = version / "systemd/units", car / "etc/fsai/fsai.toml"
    ours.write_text("# ours\n")
    (car / UNITS / "fsai.target").chmod(0o666)
    (car / "usr/lib/fsai/settle").chmod(0o644)
    (units / "fsai-planner.service").rename(units / "fsai-path.service")
    (units / "fsai-bridge@.service").write_text("# changed\n")
    shutil.rmtree(units / "fsai-link@.service.d")
    (version / "systemd/etc/fsai.toml").write_text("# theirs\n")
    (version / "systemd/tmpfiles/fsai.conf").unlink()  # it breaks off in the middle
    (units / "fsai-given-up.service").touch()
    assert install_car("install", destination=car, script=script).returncode != 0
    (units / "fsai-given-up.service").unlink()
    shutil.copy(CHECKOUT / "systemd/tmpfiles/fsai.conf", version / "systemd/tmpfiles")
    for destination in (car, fresh):
        assert install_car("install", destination=destination, script=script).returncode == 0
    assert modes(car) == modes(fresh)
    assert ours.read_text() == "# ours\n"
    ours.write_text("# theirs\n")
    assert contents(car) == contents(fresh)


def test_uninstalling_leaves_the_configuration_and_nothing_else(tmp_path: Path) -> None:
    install_car("install", destination=tmp_path)
    (tmp_path / "opt/fsai/bin").mkdir(parents=True)
    other = tmp_path / "usr/lib/systemd/system/other.service"
    other.touch()
    assert install_car("uninstall", destination=tmp_path).returncode == 0
    assert set(contents(tmp_path)) == {
        "etc/fsai/fsai.toml",
        "etc/fsai/limits.toml",
        "usr/lib/systemd/system/other.service",
    }
    again = install_car("uninstall", destination=tmp_path)
    assert again.returncode == 1 and "nothing is installed" in again.stderr


def test_wrong_use_is_reported_in_one_line() -> None:
    done = install_car("instal")
    assert done.returncode == 1
    assert done.stderr == "install-car: say install, build, uninstall or deb\n"


def test_an_environment_that_cannot_be_copied_is_refused_first(tmp_path: Path) -> None:
    root, other = tmp_path / "root", tmp_path / "other"
    done = install_car("install", destination=root, PYTHON=sys.executable, ENVIRONMENT=str(other))
    assert done.returncode == 1 and f"{other} is no virtual environment" in done.stderr
    (other / "bin").mkdir(parents=True)
    (other / "bin" / "python").write_text("#!/bin/sh\necho 3.9\n")
    (other / "bin" / "python").chmod(0o755)
    done = install_car("install", destination=root, PYTHON=sys.executable, ENVIRONMENT=str(other))
    assert done.returncode == 1 and f"{other} is for Python 3.9, and {sys.executable} is " in done.stderr
    assert contents(root) == {}


def test_no_installed_file_names_the_place_it_was_installed_from(root: Path) -> None:
    for path in root.rglob("*"):
        if path.is_file():
            text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
            assert str(root).encode() not in text, path


def dpkg_deb(*words: object) -> str:
    return subprocess.run(["dpkg-deb", *map(str, words)], capture_output=True, text=True, check=True).stdout


def test_the_package_carries_the_system_files_owned_by_root(deb: Path) -> None:
    listing = dpkg_deb("-c", deb).splitlines()
    names = {line.split()[5].removeprefix(".") for line in listing}
    assert {
        "/usr/lib/systemd/system/fsai.target",
        "/usr/lib/systemd/system/fsai-bridge@.service",
        "/usr/lib/systemd/system/fsai-.service.d/50-sandbox.conf",
        "/usr/lib/systemd/network/70-fsai-can.network",
        "/usr/lib/fsai/link",
        "/usr/lib/fsai/settle",
        "/usr/bin/fsai-vcu",
        "/etc/fsai/fsai.toml",
        "/usr/share/doc/fsai-vcu/changelog.gz",
        "/usr/share/doc/fsai-vcu/changelog.Debian.gz",
    } <= names
    assert {line.split()[1] for line in listing} == {"root/root"}
    assert not any(name.startswith("/DEBIAN") for name in names)


def test_the_package_keeps_the_configuration_on_upgrade(deb: Path, tmp_path: Path) -> None:
    fields = dpkg_deb("-f", deb)
    assert "Package: fsai-vcu" in fields and "systemd (>= 249)" in fields
    dpkg_deb("-e", deb, tmp_path)
    assert (tmp_path / "conffiles").read_text().splitlines() == ["/etc/fsai/fsai.toml", "/etc/fsai/limits.toml"]
    assert "/usr/lib/fsai/settle" in (tmp_path / "postinst").read_text()
    for script in ("postinst", "prerm", "postrm"):
        subprocess.run(["sh", "-n", tmp_path / script], check=True)


def test_the_package_says_what_each_of_its_files_is(deb: Path, tmp_path: Path) -> None:
    dpkg_deb("-e", deb, tmp_path / "DEBIAN")
    dpkg_deb("-x", deb, tmp_path)
    sums = (tmp_path / "DEBIAN" / "md5sums").read_text()
    subprocess.run(["md5sum", "--check", "--quiet", "--strict"], input=sums, cwd=tmp_path, text=True, check=True)
    named = {line.partition("  ")[2] for line in sums.splitlines()}
    packed = {name for name in contents(tmp_path) if not name.startswith("DEBIAN/")}
    assert named == {name for name in packed if not name.startswith("etc/")}, "configuration is for the team to change"
