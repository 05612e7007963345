"""Somebody on the team's Wi-Fi: a network at the other end of a virtual cable, and what is seen from there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

HERE, THERE = "192.0.2.1", "192.0.2.2"  # RFC 5737: addresses for documentation, nobody's
INTERFACE = "wifi0"
_ELSEWHERE = "wifi"  # the network namespace
BRIDGE = "vcu_bridge"
COMMANDS, SET_MODE = "/vehicle_cmd", "/set_mode"
_LOOK_AGAIN_S = 0.25


def plug_in() -> None:
    """The car PC is on that network as HERE."""
    for words in (
        f"netns add {_ELSEWHERE}",
        f"link add {INTERFACE} type veth peer name sta0 netns {_ELSEWHERE}",
        f"addr add {HERE}/24 dev {INTERFACE}",
        f"link set {INTERFACE} up",
        f"-n {_ELSEWHERE} addr add {THERE}/24 dev sta0",
        f"-n {_ELSEWHERE} link set lo up",
        f"-n {_ELSEWHERE} link set sta0 up",
        # Datagrams to a group, as discovery sends them, go there.
        f"-n {_ELSEWHERE} route add 224.0.0.0/4 dev sta0",
    ):
        subprocess.run(["ip", *words.split()], check=True)


def from_there(*argv: str) -> list[str]:
    """A command as somebody there runs it."""
    return ["ip", "netns", "exec", _ELSEWHERE, *argv]


@contextmanager
def talked_to(port: int) -> Iterator[None]:
    """Somebody there keeps saying something to this port of the car PC."""
    line = f"while :; do echo x >/dev/udp/{HERE}/{port}; sleep 0.05; done"
    talker = subprocess.Popen(from_there("bash", "-c", line), stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        talker.kill()
        talker.wait()


def nodes_seen(seconds: float) -> dict[str, object]:
    """A ROS node that joins the car's domain, looks around for so long, or until it sees the bridge."""
    import rclpy

    rclpy.init()
    node = rclpy.create_node("stranger")
    until = time.monotonic() + seconds
    while True:
        nodes = sorted(set(node.get_node_names()) - {node.get_name()})
        subscribers = node.count_subscribers(COMMANDS)
        set_mode = any(name == SET_MODE for name, _ in node.get_service_names_and_types())
        sees = BRIDGE in nodes and subscribers > 0 and set_mode
        if sees or time.monotonic() >= until:
            break
        time.sleep(_LOOK_AGAIN_S)
    rclpy.shutdown()
    return {"nodes": nodes, "subscribers": subscribers, "set_mode": set_mode, "sees_the_car": sees}


STRANGERS = {
    "ROS_DOMAIN_ID": "0",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    "ROS_STATIC_PEERS": HERE,  # he knows the car PC's address
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
}


def looked(argv: list[str], seconds: float, environment: Mapping[str, str]) -> dict[str, object]:
    """Return what such a node reports, started with `argv` before it."""
    command = [*argv, sys.executable, "-m", "fsai_hil.rehearsal.carpc.wifi", str(seconds)]
    environment = {**os.environ, **environment, "HOME": "/tmp"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the stranger failed: {done.stderr.strip()[-300:]}")
    found: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    print(json.dumps(nodes_seen(float(sys.argv[1]))))
