"""Builds the libraries that are preloaded into User-Mode Linux and the programs inside; each says in its source why."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

COMPILER = "apt-get install -y gcc libc6-dev"
_HERE = Path(__file__).parent


def built(name: str, folder: Path) -> Path | None:
    """The library of that name, built into `folder`; None where there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    library = folder / f"{name}.so"
    command = [compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(_HERE / f"{name}.c")]
    return library if subprocess.run(command, capture_output=True, check=False).returncode == 0 else None
