"""The C program of the examples in virtual time: as a shared library, without a bus and without a clock."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from fsai_hil import CHECKOUT
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import VCU_IDS

SOURCE = CHECKOUT / "examples" / "own_can_node" / "own_can_node.c"
WARNINGS = ("-O2", "-Wall", "-Wextra", "-Werror")
MOST_SENT = 6


class CanFrame(ctypes.Structure):
    """linux/can.h: struct can_frame."""

    _fields_ = (
        ("can_id", ctypes.c_uint32),
        ("length", ctypes.c_uint8),
        ("pad", ctypes.c_uint8 * 3),
        ("data", ctypes.c_uint8 * 8),
    )


def compiled(folder: Path, *options: str) -> Path:
    """The program, or with -shared -fPIC the library. Without a compiler here: FileNotFoundError."""
    target = folder / ("own_can_node.so" if options else "own_can_node")
    compiler = shutil.which("cc")
    if compiler is None:
        raise FileNotFoundError("cc")
    subprocess.run([compiler, *WARNINGS, *options, "-o", str(target), str(SOURCE)], check=True)
    return target


class CNode:
    """One process of it; `fault` is the mistake that it makes."""

    def __init__(self, library: Path, fault: str = "none") -> None:
        self._node = ctypes.CDLL(str(library))
        self._node.begin.restype = ctypes.c_bool
        assert self._node.begin(fault.encode()), fault
        self._sent = (CanFrame * MOST_SENT)()

    def cycle(self, received: Sequence[Frame], now_ns: int) -> list[Frame]:
        """What it sends, having received that since the last cycle."""
        heard = [frame for frame in received if frame.can_id in VCU_IDS]
        given = (CanFrame * max(1, len(heard)))()
        for one, frame in zip(given, heard, strict=False):
            one.can_id, one.length = frame.can_id, len(frame.data)
            one.data[: len(frame.data)] = frame.data
        count = self._node.run_cycle(given, len(heard), ctypes.c_int64(now_ns), self._sent)
        return [Frame(one.can_id, bytes(one.data[: one.length]), now_ns) for one in self._sent[:count]]
