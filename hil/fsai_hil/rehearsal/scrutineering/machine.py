"""Facts for a report: the machine on which something was measured."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime, timezone
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from fsai_vcu.diagnostics.doctor import collect

PACKAGES = ("fsai-vcu", "python-can", "cantools", "numpy", "ros-rclpy")


def machine() -> dict[str, Any]:
    """Kernel, processors, memory, Python."""
    processor = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text(errors="replace"))
    return {
        "kernel": f"{platform.system()} {platform.release()}",
        "processor": processor.group(1).strip() if processor else platform.machine(),
        "processors": os.cpu_count() or 1,
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / (1 << 30), 1),
        "python": platform.python_version(),
        "system": collect.system(),
    }


def facts(checkout: Path) -> dict[str, Any]:
    """Return when, on what and of which sources something was measured."""
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "versions": versions(),
        "source": source_revision(checkout),
    }


@cache  # the metadata of some hundred packages are read
def versions() -> dict[str, str]:
    """Return the versions of the packages that are installed."""
    found = {each.name: each.version for each in reversed([*distributions()])}  # the first of a name counts
    return {package: found.get(package, "not installed") for package in PACKAGES}


def source_revision(checkout: Path) -> str:
    """The commit that is checked out, and whether files differ from it; empty where there is no git checkout."""

    describe = ["describe", "--always", "--exclude=*", "--abbrev=12", "--dirty= with changes"]
    try:
        done = subprocess.run(["git", "-C", str(checkout), *describe], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()


def scheduling_of(pid: int) -> dict[str, Any]:
    """Return how the kernel schedules the most urgent thread of a process, and whether its memory is locked."""
    found = collect.scheduling_of(Path("/proc", str(pid)))
    assert found is not None, f"process {pid} has ended"
    return asdict(found)


def scheduling_in_words(scheduling: Mapping[str, Any]) -> str:
    memory = "memory locked" if scheduling["memory_locked"] else "memory not locked"
    if not scheduling["priority"]:
        return f"ordinary (real-time scheduling was refused), {memory}"
    return f"{scheduling['policy']} with priority {scheduling['priority']}, {memory}"
