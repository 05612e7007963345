"""The network of every place, as lines of shell: vcan0 up, and a loopback on which ROS 2 nodes find each other."""

from __future__ import annotations

INTERFACE = "vcan0"
TX_QUEUE_FRAMES = 10  # two cycles of commands; the usual 1000 would hold back two seconds of stale ones


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
