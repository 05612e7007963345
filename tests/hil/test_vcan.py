"""The bus itself: the project's frames and those of the field's own tools are the same frames."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import pytest

from conftest import BusLog
from fsai_hil.rehearsal.stack import await_condition
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus

WITHIN_S = 5.0


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


def cansend(interface: str, frame: str) -> None:
    subprocess.run(["cansend", interface, frame], check=True)


def test_a_frame_sent_by_cansend_is_received_bit_for_bit(interface: str, listen: Callable[..., CanBus]) -> None:
    bus = listen()
    cansend(interface, "520#01A50C1300FF8001")
    frame = bus.recv(WITHIN_S)
    assert frame is not None
    assert (frame.can_id, frame.data) == (0x520, bytes.fromhex("01A50C1300FF8001"))
    assert not (frame.extended or frame.remote or frame.error)


def test_a_short_an_extended_and_a_remote_frame_are_told_apart(interface: str, listen: Callable[..., CanBus]) -> None:
    bus = listen()
    for text in ("514#0102", "00000514#01", "511#R"):
        cansend(interface, text)
    short, extended, remote = (bus.recv(WITHIN_S) for _ in range(3))
    assert short is not None and short.data == b"\x01\x02" and not short.extended
    assert extended is not None and extended.extended
    assert remote is not None and remote.remote


def test_candump_sees_the_frames_that_we_send_in_their_order(listen: Callable[..., CanBus], bus_log: BusLog) -> None:
    sent = [Frame(0x510 + step % 5, bytes([step, 255 - step])) for step in range(50)]
    bus = listen()
    assert all(bus.send(frame) for frame in sent)
    await_condition(lambda: len(bus_log.frames()) == len(sent), WITHIN_S, "candump wrote every frame")
    assert [(frame.can_id, frame.data) for frame in bus_log.frames()] == [(frame.can_id, frame.data) for frame in sent]


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


def test_a_bus_lost_with_its_interface_is_opened_again() -> None:
    ip("link", "add", "dev", "vcan1", "type", "vcan")
    try:
        with pytest.raises(BusError, match="'vcan1' is down"):
            open_bus("vcan1")
        ip("link", "set", "vcan1", "up")
        with open_bus("vcan1") as bus:
            assert bus.send(Frame(0x510, b"\x01"))
            ip("link", "set", "vcan1", "down")
            with pytest.raises(BusLost):
                bus.recv(WITHIN_S)
        ip("link", "set", "vcan1", "up")
        with open_bus("vcan1") as bus:
            assert bus.send(Frame(0x510, b"\x01"))
    finally:
        ip("link", "del", "vcan1")
