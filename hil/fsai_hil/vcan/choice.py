"""Which vcan0: the kernel's own where it has one, else a kernel that brings one along."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from fsai_hil.vcan.errors import VcanError
from fsai_hil.vcan.native import native_vcan_available, run_natively
from fsai_hil.vcan.uml import find_user_mode_linux, run_in_uml


@dataclass(frozen=True)
class VcanHost:
    """Where a command meets its vcan0: `run` has the signature of `run_natively` and `run_in_uml`."""

    name: Literal["native", "uml"]
    why: str
    run: Callable[..., int]

    @property
    def has_pace(self) -> bool:
        """Whether `run` takes `pace`: a clock inside that goes slower than the machine's."""
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
