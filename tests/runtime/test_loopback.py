"""The stand-in bus of this computer: what a rehearsal without CAN relies on."""

from __future__ import annotations

import uuid
from collections.abc import Iterator

import can
import pytest

from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus


@pytest.fixture
def spec() -> str:
    return f"loopback:{uuid.uuid4()}"


@pytest.fixture
def pair(spec: str) -> Iterator[tuple[CanBus, CanBus]]:
    with open_bus(spec) as one, open_bus(spec) as other:
        yield one, other


def test_a_frame_reaches_every_other_participant_unchanged(pair: tuple[CanBus, CanBus]) -> None:
    one, other = pair
    assert one.send(Frame(0x520, bytes.fromhex("0102030405060708")))
    heard = other.recv(1.0)
    assert heard is not None
    assert (heard.can_id, heard.data.hex(), heard.extended, heard.error) == (0x520, "0102030405060708", False, False)
    assert heard.t_ns > 0


def test_a_participant_does_not_hear_itself(pair: tuple[CanBus, CanBus]) -> None:
    one, other = pair
    one.send(Frame(0x510, b"\x01"))
    other.send(Frame(0x520, b"\x02"))
    heard = one.recv(1.0)
    assert heard is not None
    assert heard.can_id == 0x520


def test_buses_of_other_names_are_not_heard(spec: str) -> None:
    with open_bus(spec) as here, open_bus(spec + "-elsewhere") as elsewhere, open_bus(spec) as witness:
        elsewhere.send(Frame(0x520, b"\x01"))
        witness.send(Frame(0x521, b"\x02"))
        heard = here.recv(1.0)
    assert heard is not None
    assert heard.can_id == 0x521


def test_frames_come_in_the_order_in_which_they_were_sent(pair: tuple[CanBus, CanBus]) -> None:
    one, other = pair
    for number in range(200):
        one.send(Frame(0x100 + number, bytes([number])))
    heard = [other.recv(1.0) for _ in range(200)]
    assert [frame.can_id for frame in heard if frame] == list(range(0x100, 0x100 + 200))


def test_receive_filters_hold_on_the_stand_in_too(spec: str) -> None:
    with open_bus(spec, receive=[0x520]) as filtered, open_bus(spec) as sender:
        sender.send(Frame(0x600, b"\x00"))
        sender.send(Frame(0x520, b"\x00"))
        heard = filtered.recv(1.0)
    assert heard is not None
    assert heard.can_id == 0x520


def test_extended_and_error_frames_keep_their_kind(pair: tuple[CanBus, CanBus]) -> None:
    one, other = pair
    one.send(Frame(0x18FF0001, b"\x01", extended=True))
    one.send(Frame(0x004, bytes(8), error=True))
    extended, error = other.recv(1.0), other.recv(1.0)
    assert extended is not None and extended.extended and extended.can_id == 0x18FF0001
    assert error is not None and error.error


def test_python_can_finds_the_interface_by_its_registered_name(spec: str) -> None:
    with can.Bus(interface="fsai_loopback", channel=spec.partition(":")[2]) as bus:
        assert "loopback bus" in bus.channel_info
