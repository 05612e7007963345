"""vcan0 of this very kernel, in a network namespace of its own: the machine's own interfaces are never touched."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

TIMED_OUT = 124  # the exit status of a command that was ended by its time limit, as timeout(1) has it
INTERFACE = "vcan0"
TX_QUEUE_FRAMES = 10  # two cycles of commands; the usual 1000 would hold back two seconds of stale ones
_PROBE_S = 60.0
_GRACE_S = 5.0
_ARPHRD_CAN = "280"  # linux/if_arp.h
BIN = "/usr/sbin:/usr/bin:/sbin:/bin"


class VcanError(Exception):
    """No vcan0 to be had; the message is one clear line with what to do about it."""


# As root of a fresh network namespace or kernel; `set -e` is in force. ROS 2 nodes find each other on the loopback.
BRING_UP = f"""ip link set lo up multicast on
ip route add 224.0.0.0/4 dev lo
ip link add dev {INTERFACE} type vcan
ip link set {INTERFACE} txqueuelen {TX_QUEUE_FRAMES} up"""
# A root user needs no user namespace; everybody else becomes root of one of his own, where the system allows it.
_NAMESPACES = (
    ("unshare", "--net", "--mount"),
    ("unshare", "--user", "--map-root-user", "--net", "--mount"),
)
# The list of interfaces in /sys is of the namespace in which it was mounted. Shared memory of its own keeps the ROS 2
# middleware of parallel runs apart, as the namespace does for sockets.
_SCRIPT = f"""set -e
export PATH="$PATH:{BIN}"
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /dev/shm
{BRING_UP}
exec "$@"
"""


def namespace_prefix() -> tuple[str, ...] | None:
    """The command that puts another into a network namespace where a vcan interface can be made; None if none can."""
    if os.geteuid() == 0 and (modprobe := shutil.which("modprobe", path=BIN)):
        subprocess.run([modprobe, "-qa", "can-raw", "vcan"], capture_output=True, check=False)
    can_socket = "import socket; socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)"
    for prefix in _NAMESPACES:
        probe = [*prefix, "sh", "-c", _SCRIPT, "sh", sys.executable, "-S", "-c", can_socket]
        try:
            done = subprocess.run(probe, capture_output=True, stdin=subprocess.DEVNULL, timeout=_PROBE_S, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if done.returncode == 0:
            return prefix
    return None


def existing_vcan(interface: str = INTERFACE) -> bool:
    """True if the machine has a CAN interface of that name already, and it is up."""
    device = Path("/sys/class/net") / interface
    try:
        is_can = (device / "type").read_text().strip() == _ARPHRD_CAN
        return is_can and bool(int((device / "flags").read_text(), 16) & 1)
    except (OSError, ValueError):
        return False


def native_vcan_available() -> bool:
    """True if this kernel can give a command a vcan0: one made for it, or the machine's own that is up."""
    return namespace_prefix() is not None or existing_vcan()


def run_natively(
    argv: Sequence[str],
    *,
    cwd: Path,
    env: Mapping[str, str],
    timeout_s: float,
    results_dir: Path,
) -> int:
    """Run a command where `vcan0` is this kernel's. Returns its exit status, 124 if it took longer than `timeout_s`.

    The command and whatever it started are ended on a timeout and on Ctrl-C. Raises VcanError where it cannot run.
    """
    prefix = namespace_prefix()
    if prefix is not None:
        argv = [*prefix, "sh", "-c", _SCRIPT, "sh", *argv]
    elif not existing_vcan():
        raise VcanError("this kernel has no vcan")
    results_dir.mkdir(parents=True, exist_ok=True)
    process = subprocess.Popen(argv, cwd=cwd, env=dict(env), stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        return process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        return TIMED_OUT
    finally:
        end_group(process)


def end_group(process: subprocess.Popen[bytes]) -> None:
    """End a process that leads its own session, and all that is left in its process group: asked first, then killed."""
    if process.poll() is None:
        _signal_group(process.pid, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_GRACE_S)
    _signal_group(process.pid, signal.SIGKILL)
    process.wait()


def _signal_group(group: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, number)
