"""Opening a bus, and what may be sent on it."""

from __future__ import annotations

import errno
import itertools
import os
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from importlib.util import find_spec

import can
import pytest
from can.interfaces.socketcan.constants import SO_TIMESTAMPNS
from msgspec.structs import replace

from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, RESERVED_IDS
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.clocks import StampConverter


def test_an_absent_interface_is_one_clear_line_that_names_it() -> None:
    with pytest.raises(BusError) as error:
        open_bus("can99")
    assert "no CAN interface 'can99'" in str(error.value)
    assert "\n" not in str(error.value)


def test_an_interface_that_is_not_can_is_refused_by_name() -> None:
    with pytest.raises(BusError, match="'lo' is a network interface but not a CAN interface"):
        open_bus("lo")


def test_an_unknown_kind_of_bus_is_one_clear_line() -> None:
    with pytest.raises(BusError, match="cannot open CAN interface 'nonsense:1'"):
        open_bus("nonsense:1")


def test_a_bus_of_the_ai_computer_refuses_every_other_id() -> None:
    with open_bus("loopback:refusals", may_send=AI_IDS) as bus:
        for can_id in sorted(RESERVED_IDS | {0x501, 0x520, 0x515}):
            with pytest.raises(ValueError, match="must never be transmitted"):
                bus.send(Frame(can_id, b"\x00"))


@pytest.mark.parametrize("can_ids", [(), AI_IDS])
def test_no_bus_is_opened_that_would_let_a_reserved_id_out(
    monkeypatch: pytest.MonkeyPatch, can_ids: tuple[int, ...]
) -> None:
    monkeypatch.setattr(can, "Bus", lambda **_: pytest.fail("opened, and nobody would close it"))
    for can_id in RESERVED_IDS:
        with pytest.raises(ValueError, match="reserved for the car"):
            open_bus("loopback:reserved", may_send=[*can_ids, can_id])


def test_opening_a_bus_does_not_take_pandas_along() -> None:
    assert find_spec("asammdf"), "without it python-can takes nothing along"
    code = "import sys, fsai_vcu.runtime.bus; sys.exit('asammdf' in sys.modules or 'pandas' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


class SilentBus(can.BusABC):
    """Nothing is ever received on it; it notes how long it was asked to wait."""

    def __init__(self) -> None:
        super().__init__("silent")
        self.waits: list[float | None] = []

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.waits.append(timeout)
        assert len(self.waits) < 10, self.waits
        threading.Event().wait(min(timeout or 0.0, 0.02))
        return None, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError("nothing is sent here")


def test_a_wall_clock_set_back_does_not_lengthen_a_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_s = itertools.count(2e9, -3600.0)
    monkeypatch.setattr("can.bus.time", lambda: next(wall_s))
    silent = SilentBus()
    with CanBus(silent, "silent") as bus:
        assert bus.recv(0.02) is None
    assert all(wait is not None and wait <= 0.02 for wait in silent.waits), silent.waits


def test_out_of_file_descriptors_is_reported_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_options: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("fsai_vcu.runtime.bus.check_interface", lambda _channel: None)
    monkeypatch.setattr("can.Bus", refuse)
    with pytest.raises(BusError, match="cannot open CAN interface 'can0': Too many open files"):
        open_bus("can0")


def test_bus_off_is_a_bus_loss_and_other_error_frames_are_not() -> None:
    with open_bus("loopback:errors") as controller, open_bus("loopback:errors") as bus:
        controller.send(Frame(0x004, bytes(8), error=True))  # a problem of the controller, which goes on
        received = bus.recv(1.0)
        assert received is not None and received.error
        controller.send(Frame(0x040, bytes(8), error=True))
        with pytest.raises(BusLost, match="bus-off"):
            bus.recv(1.0)


@pytest.mark.parametrize(
    ("error", "lost"),
    [
        (can.CanOperationError("Transmit buffer full"), False),
        (can.CanOperationError("No buffer space available", errno.ENOBUFS), False),
        (can.CanOperationError("Network is down", errno.ENETDOWN), True),
        (can.CanOperationError("No such device", errno.ENODEV), True),
    ],
)
def test_a_missing_interface_is_a_bus_loss_a_full_queue_is_not(
    error: can.CanError, lost: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    silent = SilentBus()
    monkeypatch.setattr(silent, "send", refuse)
    with CanBus(silent, "can0", may_send=AI_IDS) as bus:
        if lost:
            with pytest.raises(BusLost, match="can0: "):
                bus.send(Frame(0x510, bytes(8)))
        else:
            assert bus.send(Frame(0x510, bytes(8))) is False


def test_frames_for_which_the_kernel_had_no_room_are_counted() -> None:
    with open_bus("loopback:room") as sender, open_bus("loopback:room") as bus:
        with socket.socket(fileno=os.dup(bus.fileno())) as same:
            same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        assert bus.dropped() == 0
        for _ in range(100):
            sender.send(Frame(0x520, bytes(8)))
        received = bus.drain()
        assert received and bus.dropped() == 100 - len(received) > 0
    assert bus.dropped() == 0, "a closed socket is no error"


@pytest.fixture
def kernel_pair(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[CanBus, socket.socket]]:
    """`can0` as SocketCAN opens it, on a socket of another family that the kernel stamps as well, and its far end."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    near.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

    class Opened(SilentBus):
        socket = near

        def fileno(self) -> int:
            return near.fileno()

    monkeypatch.setattr("fsai_vcu.runtime.bus.check_interface", lambda _channel: None)
    monkeypatch.setattr("can.Bus", lambda **_options: Opened())
    with near, far, open_bus("can0") as bus:
        yield bus, far


def test_at_most_some_ten_frames_wait_in_the_kernel(kernel_pair: tuple[CanBus, socket.socket]) -> None:
    bus, _ = kernel_pair
    frame_bytes = 768  # what the kernel charges a socket for one frame on a 64-bit machine
    with socket.socket(fileno=os.dup(bus.fileno())) as same:
        frames = same.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) / frame_bytes
    assert 5 <= frames <= 12


FRAMES = (
    (Frame(0x520, b"\x01\x02\x03"), "20 05 00 00 03 00 00 00 01 02 03 00 00 00 00 00"),
    (Frame(0x1ABCDEF0, b"\xff" * 8, extended=True), "F0 DE BC 9A 08 00 00 00 FF FF FF FF FF FF FF FF"),
    (Frame(0x510, b"", remote=True), "10 05 00 40 00 00 00 00 00 00 00 00 00 00 00 00"),
    (Frame(0x004, bytes(8), error=True), "04 00 00 20 08 00 00 00 00 00 00 00 00 00 00 00"),
)


@pytest.mark.parametrize(("frame", "wire"), FRAMES)
def test_socketcan_frames_have_the_layout_of_the_kernel(
    kernel_pair: tuple[CanBus, socket.socket], frame: Frame, wire: str
) -> None:
    bus, far = kernel_pair
    assert bus.send(frame)
    assert far.recv(64) == bytes.fromhex(wire)
    far.send(bytes.fromhex(wire))
    (received,) = bus.drain()
    assert replace(received, t_ns=0) == frame


def test_a_frame_that_waited_is_as_old_as_it_is(kernel_pair: tuple[CanBus, socket.socket]) -> None:
    bus, far = kernel_pair
    before_ns = time.monotonic_ns()
    far.send(bytes.fromhex(FRAMES[0][1]))
    after_ns = time.monotonic_ns()
    threading.Event().wait(0.05)
    far.send(bytes.fromhex(FRAMES[0][1]))
    first, second = bus.drain()
    noise_ns = 1_000_000  # what the two clocks may differ by between two readings
    assert before_ns - noise_ns <= first.t_ns <= after_ns + noise_ns
    assert second.t_ns - first.t_ns >= 50_000_000 - noise_ns
    assert bus.drain() == []


def test_a_step_of_the_wall_clock_makes_no_frame_old(
    kernel_pair: tuple[CanBus, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    bus, far = kernel_pair
    wall_ns = time.time_ns
    for step_s in (3600, -3600):
        before_ns = time.monotonic_ns()
        far.send(bytes.fromhex(FRAMES[0][1]))
        monkeypatch.setattr("time.time_ns", lambda step_s=step_s: wall_ns() + step_s * 1_000_000_000)
        (frame,) = bus.drain()
        assert before_ns - 1_000_000 <= frame.t_ns <= time.monotonic_ns()
        monkeypatch.setattr("time.time_ns", wall_ns)
        bus.drain()


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_a_step_that_only_the_kernel_knows_makes_no_frame_old(
    kernel_pair: tuple[CanBus, socket.socket], monkeypatch: pytest.MonkeyPatch, step_s: int
) -> None:
    """Set between the reading of the clock and the stamp: by this clock the frame is an hour old, or of the future."""
    bus, far = kernel_pair
    emptied_ns = time.monotonic_ns()
    assert bus.drain() == []
    wall_ns = time.time_ns
    bus._clocks = StampConverter()
    monkeypatch.setattr("time.time_ns", lambda: wall_ns() + step_s * 1_000_000_000)
    far.send(bytes.fromhex(FRAMES[0][1]))
    (frame,) = bus.drain()
    assert emptied_ns <= frame.t_ns <= time.monotonic_ns()


def test_a_full_socketcan_queue_drops_the_frame(kernel_pair: tuple[CanBus, socket.socket]) -> None:
    bus, far = kernel_pair
    assert not all(bus.send(Frame(0x510, bytes(8))) for _ in range(1000))
    far.close()
    with pytest.raises(BusLost, match="can0: "):
        bus.send(Frame(0x510, bytes(8)))


def test_nobody_drives_on_a_bus_that_returns_a_senders_frames() -> None:
    with pytest.raises(BusError, match=r"a sender's own frames.*loopback:NAME") as refused:
        open_bus("udp_multicast:239.74.163.2", may_send=AI_IDS)
    assert "\n" not in str(refused.value)


def test_a_service_that_may_not_open_ip_sockets_opens_its_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    """systemd refuses families that a unit does not name (RestrictAddressFamilies=)."""
    original = socket.socket

    def refused(family: int = socket.AF_INET, *rest: int, **options: int) -> socket.socket:
        if family in (socket.AF_INET, socket.AF_INET6):
            raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")
        return original(family, *rest, **options)

    monkeypatch.setattr("fsai_vcu.runtime.bus.socket.socket", refused)
    with pytest.raises(BusError, match="'lo' is a network interface but not a CAN interface"):
        open_bus("lo")


@pytest.mark.parametrize("name", ["can\udcff", "c" * 16, "a\0b"])
def test_a_name_that_no_interface_can_have_is_an_absent_one(name: str) -> None:
    with pytest.raises(BusError, match="no CAN interface"):
        open_bus(name)


@pytest.mark.parametrize(
    "settings", ["{", "[1]", '{"can_filters": "x"}', '{"receive_own_messages": true, "nothing": 1}']
)
def test_settings_of_python_can_change_no_bus_of_ours(settings: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are the environment's, and of files in HOME; nor do they make a number of a name."""
    monkeypatch.setenv("CAN_CONFIG", settings)
    spec = f"loopback:{uuid.uuid4().int}"
    with open_bus(spec) as one, open_bus(spec) as other:
        assert one.send(Frame(0x520, b"\x01"))
        received = other.recv(5.0)
        assert received is not None and received.data == b"\x01"


@pytest.mark.parametrize("spec", ["socketcand:x", "udp_multicast:0"])
def test_what_a_kind_of_bus_cannot_be_opened_with_is_one_line(spec: str) -> None:
    with pytest.raises(BusError, match=f"^cannot open CAN interface '{spec}': [^\n]+$"):
        open_bus(spec)
