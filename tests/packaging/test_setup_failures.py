"""A step of scripts/setup that fails says what failed, in which command, the lines that matter and what to do."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
# Each as seen where it was provoked; of others' notes only as many as there were.
DEPRECATION = (
    "  DEPRECATION: fsai-nodes is being installed using the legacy 'setup.py install' method, because it failed"
)
NO_INDEX = """\
WARNING: Retrying (Retry(total=0, connect=None)) after connection broken by 'NewConnectionError('<pip._vendor>: \
Failed to establish a new connection: [Errno -3] Temporary failure in name resolution')': /simple/pip/
ERROR: Could not find a version that satisfies the requirement pip<27,>=24.1 (from versions: none)
ERROR: No matching distribution found for pip<27,>=24.1
"""
FULL = """\
WARNING: Location 'file:///opt/wheels/' is ignored: it is neither a file nor a directory.
ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device
"""
COMPILER = """\
CMake Deprecation Warning at share/ament_cmake_core/cmake/core/all.cmake:18:
  Compatibility with CMake < 3.10 will be removed from a future version of

CMake Error at .venv/share/cmake-4.1/Modules/CMakeTestCCompiler.cmake:67 (message):
  The C compiler
    "/usr/bin/cc"
  is not able to compile a simple test program.
  cc: cannot execute cc1: no such file
build-messages: building fsai_msgs failed
"""
ANOTHERS = "ERROR: Could not install packages due to an OSError: [Errno 13] Permission denied: '.venv/bin/pip'\n"
NO_APT = """\
E: Failed to fetch http://mirror/g/gcc.deb  Temporary failure resolving 'mirror'
E: Unable to fetch some archives, maybe run apt-get update or try with --fix-missing?
"""
KILLED = "scripts/setup: line 100: 4242 Killed\n"
STRANGE = "one thing\nand another\n"


def said(log: str, tmp_path: Path) -> str:
    """What a step prints whose command prints `log` and fails; the checkout is not touched."""
    (tmp_path / "pyproject.toml").write_text((CHECKOUT / "pyproject.toml").read_text())
    (tmp_path / "log").write_text(log)
    script = f"""
        set -euo pipefail
        source {CHECKOUT}/scripts/environment.bash
        scratch=$(mktemp -d)
        do_it() {{ run sh -c 'cat log; exit 3'; echo "it went on behind the command that failed"; }}
        attempt do_it
        ((status == 0)) || failed setup "the ROS 2 nodes"
        echo "it went on behind the step that failed"
    """
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stdout == ""
    assert (tmp_path / "out" / "setup.log").read_text() == log, "all of it is kept"
    return done.stderr


@pytest.mark.parametrize(
    ("log", "line", "to_do"),
    [
        (NO_INDEX, "No matching distribution found for pip", "no connection to the Python package index"),
        (FULL, "No space left on device", "the disk is full"),
        (COMPILER, "is not able to compile a simple test program", "the compiler does not work"),
        (ANOTHERS, "Permission denied", "sudo chown -R"),
        (NO_APT, "Temporary failure resolving", "no connection to the distribution's packages"),
        (KILLED, "Killed", "memory was short"),
        (STRANGE, "and another", "the lines above say what is wrong"),
    ],
)
def test_a_step_that_fails_says_where_why_and_what_to_do(log: str, line: str, to_do: str, tmp_path: Path) -> None:
    words = said(f"{DEPRECATION}\n{log}", tmp_path)
    first, second, *_, last = words.splitlines()
    assert first == "setup: failed: the ROS 2 nodes"
    assert second.startswith("setup: the command:  sh -c")
    assert line in words
    assert to_do in last and last.endswith("run the same again: it goes on where it was.")
    assert not re.search(r"deprecat|Retrying|is ignored", words, re.IGNORECASE), "these notes are others' affairs"


def test_of_a_long_log_only_the_lines_around_the_error_are_shown(tmp_path: Path) -> None:
    noise = "".join(f"-- Checking for something {number}\n" for number in range(300))
    words = said(f"{noise}{COMPILER}{noise}", tmp_path)
    assert "is not able to compile" in words
    assert len(words.splitlines()) < 22


def test_the_interpreters_taken_are_those_of_the_project(tmp_path: Path) -> None:
    for version in ("3.9", "3.12", "3.14"):
        program = tmp_path / f"python{version}"
        minor = version.split(".")[1]
        program.write_text(f'#!/bin/sh\nexec python3 -c "import sys; sys.version_info = (3, {minor}, 0); $2"\n')
        program.chmod(0o755)
    (tmp_path / "pyproject.toml").write_text('[project]\nrequires-python = ">=3.11,<3.14"\n')
    script = f"source {CHECKOUT}/scripts/environment.bash; echo $PYTHONS; for version in 3.9 3.12 3.14; do"
    script += " find_python ./python$version >/dev/null && echo $version; done"
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.split("\n")[:2] == ["3.11 to 3.13", "3.12"], done.stdout + done.stderr
