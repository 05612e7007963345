"""What every place has: its network, as lines of shell, and what goes wrong with it.

vcan0 is up, and there is a loopback on which ROS 2 nodes find each other.
"""

from __future__ import annotations

TIMED_OUT = 124  # the exit status of a command that was ended by its time limit, as timeout(1) has it
INTERFACE = "vcan0"
TX_QUEUE_FRAMES = 10  # two cycles of commands; the usual 1000 would hold back two seconds of stale ones


class VcanError(Exception):
    """No vcan0 to be had; the message is one clear line with what to do about it."""


def bring_up(interface: str = INTERFACE) -> str:
    """Shell commands (run as root of a fresh network namespace or kernel; `set -e` in force)."""
    return "\n".join(
        (
            "ip link set lo up multicast on",
            "ip route add 224.0.0.0/4 dev lo",
            f"ip link add dev {interface} type vcan",
            f"ip link set {interface} txqueuelen {TX_QUEUE_FRAMES} up",
        )
    )
