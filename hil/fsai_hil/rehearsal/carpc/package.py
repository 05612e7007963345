"""What the rehearsed machine has on top of this one's files: the Debian package, made, and unpacked by dpkg.

Or, sooner there, what `make install` installs, with a copy of the environment in which this runs.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from fsai_hil import CHECKOUT
from fsai_hil.vcan import VcanError

NAME = "fsai-vcu"
_DPKG = Path("var/lib/dpkg")
_MARK = ".unpacked-from"


def lay_out(root: Path) -> None:
    """What `make install` installs, below `root`; what is up to date there is left alone. Raises VcanError."""
    # A configuration of an earlier rehearsal is not kept.
    shutil.rmtree(root / "etc", ignore_errors=True)
    _install_car("install", DESTDIR=root, ENVIRONMENT=Path(sys.prefix))


def _install_car(*words: str | Path, **variables: Path) -> None:
    environment = {**os.environ, **{name: str(path) for name, path in variables.items()}}
    done = subprocess.run([CHECKOUT / "scripts" / "install-car", *words], env=environment, check=False)
    if done.returncode != 0:
        raise VcanError(f"scripts/install-car {words[0]} failed")


def make(folder: Path) -> Path:
    """`folder`/fsai-vcu_….deb, made anew where the sources have changed. Raises VcanError."""
    _install_car("deb", folder, PAYLOAD=folder / "payload")
    packages = sorted(folder.glob(f"{NAME}_*.deb"), key=lambda path: path.stat().st_mtime_ns)
    return packages[-1]


def unpack(package: Path, root: Path, dpkg: Path = Path("/") / _DPKG) -> None:
    """Unpack it below `root` by dpkg, beside what this machine says is installed; what is configured is left to do.

    Its dependencies are judged when it is configured, which is done in the rehearsed machine.
    """
    status = package.stat()
    mark = f"{package.name} {status.st_size} {status.st_mtime_ns}\n"
    if (root / _MARK).is_file() and (root / _MARK).read_text() == mark:
        return
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    shutil.copytree(dpkg, root / _DPKG, symlinks=True)
    words = ["dpkg", f"--root={root}", "--force-unsafe-io", "--unpack", str(package)]
    if os.geteuid() != 0:
        if shutil.which("fakeroot") is None:
            raise VcanError("dpkg unpacks as root only; as another: sudo apt-get install -y fakeroot")
        words = ["fakeroot", *words]
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    done = subprocess.run(words, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise VcanError(f"dpkg does not unpack {package.name}: {done.stderr.strip()[-300:]}")
    (root / _MARK).write_text(mark)
