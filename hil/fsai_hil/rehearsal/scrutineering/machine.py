"""On what something was measured: facts for a report."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from fsai_vcu.diagnostics.doctor import collect

PACKAGES = ("fsai-vcu", "python-can", "cantools", "numpy", "ros-rclpy")


def machine() -> dict[str, Any]:
    """Kernel, processors, memory, Python."""
    return {
        "kernel": f"{platform.system()} {platform.release()}",
        "processor": _first_match(Path("/proc/cpuinfo"), r"model name\s*: (.+)") or platform.machine(),
        "processors": os.cpu_count() or 1,
        "memory_gib": round(int(_first_match(Path("/proc/meminfo"), r"MemTotal:\s*(\d+)") or 0) / (1 << 20), 1),
        "python": platform.python_version(),
        "system": collect.system(),
    }


def facts(checkout: Path) -> dict[str, Any]:
    """When, on what and of which sources something was measured."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "versions": versions(),
        "source": source_revision(checkout),
    }


def versions() -> dict[str, str]:
    """Of the packages that are installed."""
    found: dict[str, str] = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def source_revision(checkout: Path) -> str:
    """The commit that is checked out, and whether files differ from it; empty where there is no git checkout."""

    def git(*arguments: str) -> str | None:
        try:
            done = subprocess.run(["git", "-C", str(checkout), *arguments], capture_output=True, text=True, check=False)
        except OSError:
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    commit = git("rev-parse", "--short=12", "HEAD")
    if commit is None:
        return ""
    return f"{commit} with changes" if git("status", "--porcelain", "--untracked-files=no") else commit


def scheduling_of(pid: int) -> dict[str, Any]:
    """How the most urgent thread of a process is scheduled, and whether its memory is locked, as the kernel has it."""
    found = collect.scheduling_of(Path("/proc", str(pid)))
    assert found is not None, f"process {pid} has ended"
    return asdict(found)


def scheduling_in_words(scheduling: Mapping[str, Any]) -> str:
    memory = "memory locked" if scheduling["memory_locked"] else "memory not locked"
    if not scheduling["priority"]:
        return f"ordinary (real-time scheduling was refused), {memory}"
    return f"{scheduling['policy']} with priority {scheduling['priority']}, {memory}"


def _first_match(path: Path, pattern: str) -> str | None:
    try:
        found = re.search(pattern, path.read_text(errors="replace"))
    except OSError:
        return None
    return found.group(1).strip() if found else None
