"""The bus itself: what a socket receives, and what becomes of it when its interface goes."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest

from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus

WITHIN_S = 5.0


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


def cansend(interface: str, frame: str) -> None:
    subprocess.run(["cansend", interface, frame], check=True)


def test_ones_own_frames_do_not_come_back(listen: Callable[..., CanBus]) -> None:
    bus, other = listen(), listen()
    bus.send(Frame(0x510, b"\x01"))
    other.send(Frame(0x520, b"\x02"))
    heard = bus.recv(WITHIN_S)
    assert heard is not None and heard.can_id == 0x520


def test_the_kernel_keeps_other_ids_from_a_bus_opened_for_some(interface: str, listen: Callable[..., CanBus]) -> None:
    bus = listen(receive={0x520, 0x521})
    for text in ("300#00", "510#00", "00000520#00", "521#07"):
        cansend(interface, text)
    heard = bus.recv(WITHIN_S)
    assert heard is not None and (heard.can_id, heard.extended) == (0x521, False)


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
