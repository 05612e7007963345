"""A CAN bus as the loop sees it: frames with monotonic times, and three outcomes of a send.

A frame either went out, or was dropped because the transmit queue is full (`send` returns False: a normal event), or
the bus is gone (`BusLost`). Any python-can interface serves: `vcan0` and `can0` are SocketCAN channels, `loopback:NAME`
is the stand-in of this computer, and `KIND:CHANNEL` names any other python-can interface. On one where a sender hears
itself nobody may drive: his frames would look like an intruder's.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import time
from collections.abc import Iterable
from pathlib import Path

import can

from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import RESERVED_IDS

_QUEUE_FULL = {errno.ENOBUFS, errno.EAGAIN, None}
_SEND_BUFFER_BYTES = 8192  # doubled by the kernel, and full for a poll at half of that: about ten frames of 768 bytes
_ECHOES_OWN = frozenset({"udp_multicast"})  # python-can interfaces on which a sender hears itself
_ERROR_BUS_OFF = 0x040  # linux/can/error.h: CAN_ERR_BUSOFF, a bit of an error frame's id


class BusError(Exception):
    """The bus cannot be opened; the message is one clear line."""


class BusLost(Exception):
    """The bus was open and is gone: interface down, unplugged, or bus-off."""


def split_spec(spec: str) -> tuple[str, str]:
    """`spec` as (python-can interface, channel): 'vcan0' -> ('socketcan', 'vcan0')."""
    kind, colon, channel = spec.partition(":")
    if not colon:
        return "socketcan", spec
    return ("fsai_loopback" if kind == "loopback" else kind), channel


class CanBus:
    """An open bus. Not thread-safe: one thread owns it.

    may_send: ids that may be transmitted at all (None: any). Anything else is refused with ValueError before the wire.
    """

    def __init__(self, bus: can.BusABC, spec: str, may_send: Iterable[int] | None = None) -> None:
        self._bus = bus
        self._may_send = _allowed(may_send)
        self.spec = spec

    def send(self, frame: Frame) -> bool:
        """True if the frame was handed to the bus, False if the transmit queue was full. Raises BusLost."""
        if self._may_send is not None and frame.can_id not in self._may_send:
            raise ValueError(f"id 0x{frame.can_id:03X} must never be transmitted from here")
        message = can.Message(
            arbitration_id=frame.can_id,
            data=frame.data,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            is_error_frame=frame.error,
            check=False,
        )
        try:
            self._bus.send(message, timeout=0)
        except can.CanError as error:
            if error.error_code in _QUEUE_FULL:
                return False
            raise BusLost(f"{self.spec}: {error}") from error
        return True

    def recv(self, timeout_s: float) -> Frame | None:
        """The next frame, or None after `timeout_s`. Raises BusLost, on a bus-off error frame too."""
        heard = self.recv_stamped(timeout_s)
        return None if heard is None else heard[0]

    def recv_stamped(self, timeout_s: float, *, bus_off_is_lost: bool = True) -> tuple[Frame, int] | None:
        """As `recv`, with the bus's own time stamp of the frame in ns of the wall clock, for logs.

        Whoever only listens may take a bus-off for the error frame that it is: `bus_off_is_lost=False`.
        """
        try:
            message = self._next_message(timeout_s)
        except (can.CanError, OSError) as error:
            raise BusLost(f"{self.spec}: {error}") from error
        if message is None:
            return None
        if bus_off_is_lost and message.is_error_frame and message.arbitration_id & _ERROR_BUS_OFF:
            raise BusLost(f"{self.spec}: bus-off")
        frame = Frame(
            message.arbitration_id,
            bytes(message.data),
            time.monotonic_ns(),
            message.is_extended_id,
            message.is_remote_frame,
            message.is_error_frame,
        )
        return frame, int(message.timestamp * 1e6) * 1000

    def _next_message(self, timeout_s: float) -> can.Message | None:
        """python-can's own `recv` times its waiting by the wall clock: set back, that clock would make it wait for as
        long as it was set back. What it does is done here by the monotonic clock.
        """
        until = time.monotonic() + timeout_s
        left_s = timeout_s
        while True:
            message, filtered = self._bus._recv_internal(left_s)
            if message is not None and (filtered or self._bus._matches_filters(message)):
                return message
            left_s = until - time.monotonic()
            if left_s <= 0.0:
                return None

    def fileno(self) -> int:
        return self._bus.fileno()

    def close(self) -> None:
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()

    def __enter__(self) -> CanBus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_bus(spec: str, *, receive: Iterable[int] | None = None, may_send: Iterable[int] | None = None) -> CanBus:
    """Open the bus `spec`.

    receive: 11-bit ids to hear (a kernel filter on SocketCAN); None hears everything.
    may_send: see CanBus.
    Raises BusError with one clear line.
    """
    may_send = _allowed(may_send)
    kind, channel = split_spec(spec)
    if kind in _ECHOES_OWN and may_send is not None:
        raise BusError(
            f"'{kind}' brings a sender its own frames back, which nobody can tell from an intruder's; "
            "a stand-in for a rehearsal on one machine is loopback:NAME"
        )
    filters: list[can.typechecking.CanFilter] | None = None
    if receive is not None:
        filters = [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in sorted(receive)]
    if kind == "socketcan":
        _check_interface(channel)
    try:
        bus = can.Bus(interface=kind, channel=channel, can_filters=filters)
    except (can.CanError, OSError, ValueError, NotImplementedError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise BusError(f"cannot open CAN interface '{spec}': {reason}") from error
    if kind == "socketcan":
        try:
            _bound_queue(bus)
        except OSError as error:
            bus.shutdown()
            raise BusError(f"cannot open CAN interface '{spec}': {error.strerror}") from error
    return CanBus(bus, spec, may_send)


def _allowed(may_send: Iterable[int] | None) -> frozenset[int] | None:
    """The ids that may be transmitted. Raises ValueError for one that is reserved for the car."""
    allowed = None if may_send is None else frozenset(may_send)
    reserved = sorted((allowed or frozenset()) & RESERVED_IDS)
    if reserved:
        raise ValueError(f"ids reserved for the car can never be allowed: {', '.join(map(hex, reserved))}")
    return allowed


def _bound_queue(bus: can.BusABC) -> None:
    """Let at most some ten of our frames wait in the kernel: 20 ms of commands, never seconds of stale ones."""
    with socket.socket(fileno=os.dup(bus.fileno())) as ours:
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)


def _check_interface(channel: str) -> None:
    """Say in words what a bare OSError would not: absent, not a CAN device, or down."""
    device = Path("/sys/class/net") / channel
    if not channel or not device.exists():
        can_devices = sorted(
            path.name for path in Path("/sys/class/net").glob("*") if _read(path / "type") == _ARPHRD_CAN
        )
        known = f"CAN interfaces here: {', '.join(can_devices)}" if can_devices else "this machine has no CAN interface"
        raise BusError(
            f"no CAN interface '{channel}' ({known}; 'loopback:NAME' is a stand-in bus for a rehearsal on one machine)"
        )
    if _read(device / "type") != _ARPHRD_CAN:
        raise BusError(f"'{channel}' is a network interface but not a CAN interface")
    flags = _read(device / "flags")
    if flags and not int(flags, 16) & 1:
        raise BusError(f"CAN interface '{channel}' is down; bring it up with: ip link set {channel} up")


_ARPHRD_CAN = "280"  # linux/if_arp.h


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
