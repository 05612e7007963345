"""A real vcan0 for the tests, whatever the kernel: native where it has one, else in User-Mode Linux.

    place = choose_place()                  # says which, and why; raises VcanError with what to install
    status = place.run([...], cwd=..., env=..., timeout_s=..., results_dir=...)

Both places give the command a SocketCAN interface `vcan0`, a loopback interface with multicast and a `/dev/shm` of its
own, so that neither of two runs side by side receives the other. Standard library only: `make setup` asks
`native_vcan_available` before anything is installed.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from fsai_hil.vcan.native import INTERFACE, VcanError, native_vcan_available, run_natively
from fsai_hil.vcan.uml import find_user_mode_linux, run_in_uml

__all__ = ["INTERFACE", "VcanError", "VcanHost", "choose_place", "native_vcan_available", "run_in_uml", "run_natively"]


@dataclass(frozen=True)
class VcanHost:
    """The place where a command meets its vcan0: `run` has the signature of `run_natively` and `run_in_uml`."""

    name: Literal["native", "uml"]
    why: str
    run: Callable[..., int]

    @property
    def has_pace(self) -> bool:
        """Return whether `run` takes `pace`: a clock inside that goes slower than the machine's."""
        return self.name == "uml"


def choose_place(wanted: Literal["auto", "native", "uml"] = "auto") -> VcanHost:
    """The place asked for, or the best there is. Raises VcanError, whose message says what to install."""
    if wanted != "uml" and native_vcan_available():
        return VcanHost("native", "this kernel has vcan", run_natively)
    if wanted == "native":
        raise VcanError(
            f"the kernel here ({platform.release()}) gives no vcan interface: load the module as root "
            "(modprobe vcan; on Ubuntu it is in linux-modules-extra), or use --uml"
        )
    uml = find_user_mode_linux()
    why = "asked for" if wanted == "uml" else f"the kernel here ({platform.release()}) has no vcan"
    return VcanHost("uml", f"{why}; User-Mode Linux {uml.version} brings one along", run_in_uml)
