"""The stand-in bus of this computer: what a rehearsal without CAN relies on."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from math import inf, nan

import can
import pytest

from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime import loopback
from fsai_vcu.runtime.bus import CanBus, open_bus


@pytest.fixture
def pair(spec: str) -> Iterator[tuple[CanBus, CanBus]]:
    with open_bus(spec) as one, open_bus(spec) as other:
        yield one, other


def test_a_frame_reaches_every_other_participant_unchanged(pair: tuple[CanBus, CanBus]) -> None:
    one, other = pair
    one.send(Frame(0x510, b"\x01"))  # which its sender does not receive
    assert other.send(Frame(0x520, bytes.fromhex("0102030405060708")))
    received = one.recv(1.0)
    assert received is not None and received.t_ns > 0
    assert received == Frame(0x520, bytes.fromhex("0102030405060708"), received.t_ns)


def test_only_frames_of_its_name_that_pass_the_filters_come(spec: str) -> None:
    with open_bus(spec, receive=[0x520]) as bus, open_bus(spec + "-elsewhere") as elsewhere, open_bus(spec) as sender:
        elsewhere.send(Frame(0x520, b"\x01"))
        sender.send(Frame(0x600, b"\x02"))
        sender.send(Frame(0x520, b"\x03"))
        assert [frame.data for frame in bus.drain()] == [b"\x03"]


def test_frames_come_in_the_order_in_which_they_were_sent(pair: tuple[CanBus, CanBus]) -> None:
    one, other = pair
    for number in range(200):
        one.send(Frame(0x100 + number, bytes([number])))
    received = [other.recv(1.0) for _ in range(200)]
    assert [frame.can_id for frame in received if frame] == list(range(0x100, 0x100 + 200))


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


@pytest.mark.parametrize(("stamp_s", "length"), [(nan, 8), (inf, 8), (-1.0, 8), (1e300, 8), (1.0, 7), (1.0, 0)])
def test_a_datagram_that_is_no_frame_is_passed_over(
    stamp_s: float, length: int, spec: str, pair: tuple[CanBus, CanBus]
) -> None:
    one, other = pair
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        header = loopback._HEADER.pack(loopback._MAGIC, bytes(8), stamp_s, 0x520, length)
        stranger.sendto(header + bytes(8), loopback.group_of(spec.partition(":")[2]))
    one.send(Frame(0x521, b"\x01"))
    received = other.recv(5.0)
    assert received is not None and received.can_id == 0x521
