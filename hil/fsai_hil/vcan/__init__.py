"""A real vcan0 for the tests, whatever the kernel: native where it has one, else in User-Mode Linux.

    place = choose_place()                  # says which, and why; raises VcanError with what to install
    status = place.run([...], cwd=..., env=..., timeout_s=..., results_dir=...)

Both places give the command a SocketCAN interface `vcan0`, a loopback interface with multicast and a `/dev/shm` of its
own, so that two runs side by side never hear each other. Standard library only: `make setup` asks
`native_vcan_available` before anything is installed.
"""

from __future__ import annotations

from fsai_hil.vcan.choice import VcanHost, choose_place
from fsai_hil.vcan.errors import VcanError
from fsai_hil.vcan.native import native_vcan_available, run_natively
from fsai_hil.vcan.network import INTERFACE
from fsai_hil.vcan.uml import run_in_uml

__all__ = [
    "INTERFACE",
    "VcanError",
    "VcanHost",
    "choose_place",
    "native_vcan_available",
    "run_in_uml",
    "run_natively",
]
