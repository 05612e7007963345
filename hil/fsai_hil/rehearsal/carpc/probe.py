"""Tries what a service that somebody has taken over would try, from inside of its sandbox, and prints how each ended.

Run twice: with nothing around it, where all of it must succeed (else a refusal would prove nothing), and in the place
of the bridge, with every restriction of the bridge's unit.
"""

from __future__ import annotations

import ctypes
import errno
import json
import mmap
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from fsai_hil.rehearsal.carpc import wifi

SECRETS = tuple(Path("/", *home, "secret") for home in (("home", "team"), ("root",)))
PLACES = ("/etc/fsai", "/opt/fsai", "/usr/bin", "/var/log")
PORT = 47001
CAN = "a CAN socket"  # the one thing that is the bridge's to do
_LISTENS_S = 1.0
_PF_PACKET, _CLONE_NEWNS = 17, 0x00020000


def attempts(interface: str) -> dict[str, Callable[[], object]]:
    """Return the attempts by name; each raises OSError when it is refused."""
    return {
        CAN: lambda: open_socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW),
        "a packet socket": lambda: open_socket(_PF_PACKET, socket.SOCK_RAW),
        **{f"writing to {place}": partial(write_to, Path(place)) for place in PLACES},
        **{f"reading {path}": path.read_bytes for path in (*SECRETS, Path("/etc/shadow"))},
        "opening /dev/kmsg": lambda: os.close(os.open("/dev/kmsg", os.O_RDONLY | os.O_NONBLOCK)),
        "looking at process 1": lambda: Path("/proc/1").stat(),
        "changing the CAN interface": lambda: change_link(interface),
        "setting the clock": lambda: time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME)),
        "memory that is written and run": lambda: mmap.mmap(-1, 4096, prot=7).close(),
        "a datagram to the network": lambda: send_to(wifi.THERE, PORT),
        "receiving from the network on an open port": lambda: receive_on(PORT, _LISTENS_S),
        "a namespace of its own": lambda: call("unshare", _CLONE_NEWNS),
        "becoming root": lambda: os.setuid(0),
    }


def ended(attempt: Callable[[], object]) -> str:
    """'' when it was allowed, else how it was refused."""
    try:
        attempt()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error))
    return ""


def open_socket(family: int, kind: int, protocol: int = 0) -> None:
    socket.socket(family, kind, protocol).close()


def write_to(folder: Path) -> None:
    file = folder / "fsai-probe"
    file.write_text("was here\n")
    file.unlink()


def change_link(interface: str) -> None:
    queue = Path(f"/sys/class/net/{interface}/tx_queue_len").read_text().strip()
    words = ["ip", "link", "set", "dev", interface, "txqueuelen", queue]
    if subprocess.run(words, capture_output=True, check=False).returncode != 0:
        raise PermissionError(errno.EPERM, "ip link set is refused")


def send_to(address: str, port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bus:
        bus.sendto(b"x", (address, port))


def receive_on(port: int, seconds: float) -> None:
    """Receive a packet on this port, to which `wifi.talked_to` keeps sending from the network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("0.0.0.0", port))
        listener.settimeout(seconds)
        listener.recv(16)


def call(name: str, *arguments: int) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if getattr(library, name)(*arguments) == -1:
        raise OSError(ctypes.get_errno(), name)


if __name__ == "__main__":
    print(json.dumps({name: ended(attempt) for name, attempt in attempts(sys.argv[1]).items()}))
