"""The checkout's installer, run as a package is made: below a folder, without the Python environment."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
INSTALL = CHECKOUT / "scripts" / "install-car"
UNITS = Path("usr/lib/systemd/system")
EXECUTABLES = ("opt/fsai/bin/python", "opt/fsai/bin/fsai-vcu")


def install_car(
    *words: str, destination: Path | None = None, script: Path = INSTALL, **variables: str
) -> subprocess.CompletedProcess[str]:
    """variables: the script's own; without any of them no Python environment is made."""
    environment = {"PATH": os.environ["PATH"], **(variables or {"WITHOUT_ENVIRONMENT": "yes"})}
    if destination is not None:
        environment["DESTDIR"] = str(destination)
    return subprocess.run([script, *words], env=environment, capture_output=True, text=True, check=False)
