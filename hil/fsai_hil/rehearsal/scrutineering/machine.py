"""On what something was measured: facts for a report."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("fsai-vcu", "python-can", "cantools", "numpy", "ros-rclpy")
_POLICIES = {os.SCHED_OTHER: "ordinary", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}


def machine() -> dict[str, Any]:
    """Kernel, processors, memory, Python."""
    return {
        "kernel": f"{platform.system()} {platform.release()}",
        "processor": _first_match(Path("/proc/cpuinfo"), r"model name\s*: (.+)") or platform.machine(),
        "processors": os.cpu_count() or 1,
        "memory_gib": round(int(_first_match(Path("/proc/meminfo"), r"MemTotal:\s*(\d+)") or 0) / (1 << 20), 1),
        "python": platform.python_version(),
        "system": _first_match(Path("/etc/os-release"), r'PRETTY_NAME="(.+)"') or platform.system(),
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
    policy, priority = os.SCHED_OTHER, 0
    for thread in Path(f"/proc/{pid}/task").iterdir():
        number = int(thread.name)
        if (found := os.sched_getparam(number).sched_priority) > priority:
            policy, priority = os.sched_getscheduler(number), found
    locked = _first_match(Path(f"/proc/{pid}/status"), r"VmLck:\s*(\d+)")
    return {
        "policy": _POLICIES.get(policy, str(policy)),
        "priority": priority,
        "memory_locked": locked not in (None, "0"),
    }


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
