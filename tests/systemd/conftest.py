"""The car's system files, installed below a folder as a package would, beside this machine's own units."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from install_rig import CHECKOUT, EXECUTABLES, UNITS, install_car


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `make install DESTDIR=` leaves, with stand-ins for the environment's executables."""
    folder = tmp_path_factory.mktemp("root")
    done = install_car("install", destination=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="session")
def machine(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as a whole machine: with the system's own units, so that systemd can judge ours."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    folder = tmp_path_factory.mktemp("machine")
    shutil.copytree("/usr/lib/systemd/system", folder / UNITS, symlinks=True)
    shutil.copytree(root, folder, symlinks=True, dirs_exist_ok=True)
    for bench in (CHECKOUT / "systemd" / "bench").glob("*.service"):
        shutil.copy(bench, folder / UNITS)
    for name in EXECUTABLES:
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy("/bin/true", file)
    return folder


@pytest.fixture(scope="session")
def deb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package without its Python environment, which takes minutes and is what the rehearsal installs."""
    if shutil.which("dpkg-deb") is None:
        pytest.skip("no dpkg-deb here: a Debian package is made on Debian or Ubuntu")
    folder = tmp_path_factory.mktemp("deb")
    done = install_car("deb", str(folder))
    assert done.returncode == 0, done.stderr
    (found,) = folder.glob("*.deb")
    assert not (folder / "root").exists(), "nothing is left behind"
    return found
