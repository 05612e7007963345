"""The bus itself: what a socket receives, and what becomes of it when its interface goes."""

from __future__ import annotations

import ctypes
import subprocess
import time
from collections.abc import Callable

import pytest

from conftest import ip
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus

WITHIN_S = 60.0
CLOCK_GETTIME = 228  # the system call, on x86-64


def cansend(interface: str, frame: str) -> None:
    subprocess.run(["cansend", interface, frame], check=True)


def test_ones_own_frames_do_not_come_back(listen: Callable[..., CanBus]) -> None:
    bus, other = listen(), listen()
    bus.send(Frame(0x510, b"\x01"))
    other.send(Frame(0x520, b"\x02"))
    received = bus.recv(WITHIN_S)
    assert received is not None and received.can_id == 0x520


def test_the_kernel_keeps_other_ids_from_a_bus_opened_for_some(interface: str, listen: Callable[..., CanBus]) -> None:
    bus = listen(receive={0x520, 0x521})
    for text in ("300#00", "510#00", "00000520#00", "521#07"):
        cansend(interface, text)
    received = bus.recv(WITHIN_S)
    assert received is not None and (received.can_id, received.extended) == (0x521, False)


def test_an_absent_interface_gets_one_line_with_those_there_are(interface: str) -> None:
    with pytest.raises(BusError, match=rf"no CAN interface 'vcan9'.*{interface}") as refused:
        open_bus("vcan9")
    assert "\n" not in str(refused.value)


def test_a_bus_lost_with_its_interface_is_opened_again(other: str) -> None:
    ip("link", "set", other, "down")
    with pytest.raises(BusError, match=f"'{other}' is down"):
        open_bus(other)
    ip("link", "set", other, "up")
    with open_bus(other) as bus:
        assert bus.send(Frame(0x510, b"\x01"))
        ip("link", "set", other, "down")
        with pytest.raises(BusLost):
            bus.recv(WITHIN_S)
    ip("link", "set", other, "up")
    with open_bus(other) as bus:
        assert bus.send(Frame(0x510, b"\x01"))


def test_programs_and_the_kernel_go_by_one_clock() -> None:
    """Programs in User-Mode Linux read a clock without a system call, and idle time is skipped there."""

    def by_kernel_ns() -> int:
        time_of_kernel = (ctypes.c_long * 2)()
        assert not ctypes.CDLL(None).syscall(CLOCK_GETTIME, time.CLOCK_MONOTONIC, time_of_kernel)
        return time_of_kernel[0] * 1_000_000_000 + time_of_kernel[1]

    for _ in range(3):
        ahead_ns = []
        for _ in range(5):
            before_ns, kernel_ns, after_ns = time.monotonic_ns(), by_kernel_ns(), time.monotonic_ns()
            ahead_ns.append(max(before_ns - kernel_ns, kernel_ns - after_ns))
        assert min(ahead_ns) < 100_000, "between two readings of the one clock comes one of the other"
        time.sleep(1.0)  # idle, and longer than the clocks are compared
