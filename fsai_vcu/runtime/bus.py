"""A CAN bus as the loop sees it: frames with monotonic times, and three outcomes of a send.

A frame either went out, or was dropped because the transmit queue is full (`send` returns False: a normal event), or
the bus is gone (`BusLost`). Any python-can interface serves: `vcan0` and `can0` are SocketCAN channels, `loopback:NAME`
is the stand-in of this computer, and `KIND:CHANNEL` names any other python-can interface. On an interface whose sender
receives its own frames nobody may drive: they would look like an intruder's.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import socket
import struct
import time
from collections.abc import Iterable

from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import RESERVED_IDS
from fsai_vcu.lean_can import can
from fsai_vcu.runtime.clocks import StampConverter

_QUEUE_FULL = {errno.ENOBUFS, errno.EAGAIN, None}
_SEND_BUFFER_BYTES = 4096  # doubled by the kernel: about ten frames of 768 bytes
_MOST_WAITING = 1000  # frames: more than a socket keeps
_CAN_FRAME = struct.Struct("=IB3x8s")  # linux/can.h: struct can_frame
_TIMESPEC = struct.Struct("@ll")
_STAMP_SPACE_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)
_SO_MEMINFO = 55  # asm-generic/socket.h
_MEMINFO = struct.Struct("9I")  # linux/sock_diag.h: the last one is SK_MEMINFO_DROPS
_ECHOES_OWN = frozenset({"udp_multicast"})  # python-can interfaces on which a sender receives its own frames
_STAMPED_BY_WALL_CLOCK = frozenset({"fsai_loopback", "virtual"})  # besides SocketCAN, whose kernel does it
# Of these the name says all. python-can's own settings (CAN_CONFIG, ~/.canrc …) are for adapters, which need a bitrate:
# with them a bus here could bring a sender its own frames back, filter, or not open at all.
_WITHOUT_SETTINGS = frozenset({"socketcan", "fsai_loopback", "virtual"})
_ERROR_BUS_OFF = 0x040  # linux/can/error.h: CAN_ERR_BUSOFF, a bit of an error frame's id

_Taken = tuple[int, bytes, int, bool, bool, bool]  # id, data, wall-clock stamp in ns, extended, remote, error


class BusError(UserError):
    """The bus cannot be opened; the message is one clear line."""


class BusLost(UserError):
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
    wall_clock_stamps: whether the interface stamps frames by this machine's wall clock; their age is known then, and a
    frame that waited is as old as it is. Otherwise a frame is taken for received when it is read.
    """

    def __init__(
        self,
        bus: can.BusABC,
        spec: str,
        may_send: Iterable[int] | None = None,
        *,
        wall_clock_stamps: bool = False,
    ) -> None:
        """Take over python-can's `bus`; the class says what the arguments mean."""
        self._bus = bus
        self._may_send = _allowed(may_send)
        self._stamped = wall_clock_stamps
        self._clocks = StampConverter()
        # When nothing waited last. What is read later came later, whatever a wall clock that is just being set makes
        # of its stamp.
        self._emptied_ns = self._observe()
        self.spec = spec

    def send(self, frame: Frame) -> bool:
        """True if the frame was handed to the bus, False if the transmit queue was full. Raises BusLost."""
        if self._may_send is not None and frame.can_id not in self._may_send:
            raise ValueError(f"id 0x{frame.can_id:03X} must never be transmitted from here")
        try:
            self._put(frame)
        except (can.CanError, OSError) as error:
            if (error.error_code if isinstance(error, can.CanError) else error.errno) in _QUEUE_FULL:
                return False
            raise BusLost(f"{self.spec}: {_words_of(error)}") from error
        return True

    def recv(self, timeout_s: float) -> Frame | None:
        """The next frame, or None after `timeout_s`. Raises BusLost, on a bus-off error frame too."""
        received = self.recv_stamped(timeout_s)
        return None if received is None else received[0]

    def drain(self) -> list[Frame]:
        """Every frame that waits now, oldest first, without waiting. Raises BusLost."""
        now_ns = self._observe()  # once: reading a clock is a system call on some machines
        frames: list[Frame] = []
        while len(frames) < _MOST_WAITING:
            taken = self._taken(0.0)
            if taken is None:
                self._emptied_ns = now_ns
                break
            frames.append(self._frame_of(taken, now_ns, bus_off_is_lost=True))
        return frames

    def recv_stamped(self, timeout_s: float, *, bus_off_is_lost: bool = True) -> tuple[Frame, int] | None:
        """Receive as `recv`, with the bus's own time stamp of the frame in ns of the wall clock, for logs.

        A caller that only listens may take a bus-off for the error frame that it is: `bus_off_is_lost=False`.
        """
        taken = self._taken(timeout_s)
        now_ns = self._observe()
        if taken is None:
            self._emptied_ns = now_ns
            return None
        return self._frame_of(taken, now_ns, bus_off_is_lost=bus_off_is_lost), taken[2]

    def _taken(self, timeout_s: float) -> _Taken | None:
        try:
            return self._take(timeout_s)
        except (can.CanError, OSError) as error:
            raise BusLost(f"{self.spec}: {_words_of(error)}") from error

    def _frame_of(self, taken: _Taken, now_ns: int, *, bus_off_is_lost: bool) -> Frame:
        can_id, data, stamp_ns, extended, remote, is_error = taken
        if bus_off_is_lost and is_error and can_id & _ERROR_BUS_OFF:
            raise BusLost(f"{self.spec}: bus-off")
        t_ns = now_ns
        if self._stamped:
            t_ns = max(self._emptied_ns, min(now_ns, self._clocks.to_steady(stamp_ns, now_ns)))
        return Frame(can_id, data, t_ns, extended, remote, is_error)

    def _observe(self) -> int:
        """The monotonic clock; notes its offset to the wall clock, so that a step of that one makes no frame old."""
        now_ns = time.monotonic_ns()
        self._clocks.observe(time.time_ns(), now_ns)
        return now_ns

    def _put(self, frame: Frame) -> None:
        message = can.Message(
            arbitration_id=frame.can_id,
            data=frame.data,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            is_error_frame=frame.error,
            check=False,
        )
        self._bus.send(message, timeout=0)

    def _take(self, timeout_s: float) -> _Taken | None:
        """The next frame that passes the filters, or None after `timeout_s`.

        python-can's own `recv` times its waiting by the wall clock: set back, that clock would make it wait for as
        long as it was set back. What it does is done here by the monotonic clock.
        """
        until = time.monotonic() + timeout_s
        left_s = timeout_s
        while True:
            message, filtered = self._bus._recv_internal(left_s)
            if message is not None and (filtered or self._bus._matches_filters(message)):
                return (
                    message.arbitration_id,
                    bytes(message.data),
                    int(message.timestamp * 1e6) * 1000,
                    message.is_extended_id,
                    message.is_remote_frame,
                    message.is_error_frame,
                )
            left_s = max(0.0, until - time.monotonic())
            if message is None and left_s == 0.0:
                return None

    def fileno(self) -> int:
        """Return what to wait on for frames; -1 where the interface has nothing of the kind."""
        try:
            return self._bus.fileno()
        except NotImplementedError:
            return -1

    def dropped(self) -> int:
        """Frames so far that found this socket's receive buffer full and are lost; 0 where no kernel counts them.

        The kernel is asked only here: receiving costs nothing more.
        """
        with contextlib.suppress(OSError, ValueError):
            ours = socket.socket(fileno=self.fileno())
            try:
                return int(_MEMINFO.unpack(ours.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[-1])
            finally:
                ours.detach()
        return 0

    def close(self) -> None:
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()

    def __enter__(self) -> CanBus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class SocketCanBus(CanBus):
    """A SocketCAN interface: opened and filtered by python-can, then read and written without its detours.

    python-can asks `select` before every frame it reads or writes, and makes an object of 15 fields of it; between a
    0x520 and its answer that is half of the time.
    """

    def __init__(self, bus: can.BusABC, spec: str, may_send: Iterable[int] | None = None) -> None:
        super().__init__(bus, spec, may_send, wall_clock_stamps=True)
        self._socket: socket.socket = bus.socket  # type: ignore[attr-defined]
        # At most some ten frames wait in the kernel: 20 ms of commands, never seconds of stale ones.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)

    def _put(self, frame: Frame) -> None:
        word = frame.can_id
        word |= (
            (socket.CAN_EFF_FLAG if frame.extended else 0)
            | (socket.CAN_RTR_FLAG if frame.remote else 0)
            | (socket.CAN_ERR_FLAG if frame.error else 0)
        )
        self._socket.send(_CAN_FRAME.pack(word, len(frame.data), frame.data), socket.MSG_DONTWAIT)

    def _take(self, timeout_s: float) -> _Taken | None:
        """Return the next frame that the socket has, or None after `timeout_s`. Raises BusLost."""
        until = time.monotonic() + timeout_s if timeout_s > 0.0 else 0.0
        while True:
            try:
                received, ancillary, _, _ = self._socket.recvmsg(
                    _CAN_FRAME.size, _STAMP_SPACE_BYTES, socket.MSG_DONTWAIT
                )
                break
            except BlockingIOError:
                left_s = until - time.monotonic() if timeout_s > 0.0 else 0.0
                if left_s <= 0.0:
                    return None
                select.select([self._socket], [], [], left_s)
        word, length, data = _CAN_FRAME.unpack(received)
        seconds, nanoseconds = _TIMESPEC.unpack_from(ancillary[0][2])
        extended = bool(word & socket.CAN_EFF_FLAG)
        return (
            word & (socket.CAN_EFF_MASK if extended else socket.CAN_SFF_MASK),
            data[:length],
            seconds * 1_000_000_000 + nanoseconds,
            extended,
            bool(word & socket.CAN_RTR_FLAG),
            bool(word & socket.CAN_ERR_FLAG),
        )


def open_bus(spec: str, *, receive: Iterable[int] | None = None, may_send: Iterable[int] | None = None) -> CanBus:
    """Open the bus `spec`.

    receive: 11-bit ids to receive (a kernel filter on SocketCAN); None: all.
    may_send: see CanBus.
    Raises BusError with one clear line.
    """
    may_send = _allowed(may_send)
    kind, channel = split_spec(spec)
    if not channel:
        raise BusError(f"'{spec}' names no bus: {spec or 'vcan'}NAME is meant")
    if kind in _ECHOES_OWN and may_send is not None:
        raise BusError(
            f"'{kind}' returns a sender's own frames, which cannot be told from a second sender's; "
            "a stand-in for a rehearsal on one machine is loopback:NAME"
        )
    filters: list[can.typechecking.CanFilter] | None = None
    if receive is not None:
        filters = [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in sorted(receive)]
    if kind == "socketcan":
        check_interface(channel)
    try:
        bus = can.Bus(interface=kind, channel=channel, can_filters=filters, ignore_config=kind in _WITHOUT_SETTINGS)
        if kind == "socketcan":
            return SocketCanBus(bus, spec, may_send)
    except Exception as error:  # of python-can's many interfaces, and of its settings: they have no common base class
        reason = " ".join((getattr(error, "strerror", None) or str(error) or type(error).__name__).split())
        raise BusError(f"cannot open CAN interface '{spec}': {reason}") from error
    return CanBus(bus, spec, may_send, wall_clock_stamps=kind in _STAMPED_BY_WALL_CLOCK)


def _words_of(error: can.CanError | OSError) -> str:
    return str(error) if isinstance(error, can.CanError) else error.strerror or str(error)


def _allowed(may_send: Iterable[int] | None) -> frozenset[int] | None:
    """The ids that may be transmitted. Raises ValueError for an id that is reserved for the car."""
    allowed = None if may_send is None else frozenset(may_send)
    reserved = sorted((allowed or frozenset()) & RESERVED_IDS)
    if reserved:
        raise ValueError(f"ids reserved for the car can never be allowed: {', '.join(map(hex, reserved))}")
    return allowed


def can_interfaces() -> list[str]:
    """The names of this machine's CAN interfaces, up or down."""
    return sorted(name for _, name in socket.if_nameindex() if _asked(name, _SIOCGIFHWADDR) == _ARPHRD_CAN)


def check_interface(channel: str) -> None:
    """Say in words what a bare OSError would not: absent, not a CAN device, or down."""
    kind = _asked(channel, _SIOCGIFHWADDR)
    if kind is None:
        can_devices = can_interfaces()
        known = f"CAN interfaces here: {', '.join(can_devices)}" if can_devices else "this machine has no CAN interface"
        raise BusError(
            f"no CAN interface '{channel}' ({known}; 'loopback:NAME' is a stand-in bus for a rehearsal on one machine)"
        )
    if kind != _ARPHRD_CAN:
        raise BusError(f"'{channel}' is a network interface but not a CAN interface")
    flags = _asked(channel, _SIOCGIFFLAGS)
    if flags is not None and not flags & _IFF_UP:
        raise BusError(f"CAN interface '{channel}' is down; bring it up with: ip link set {channel} up")


_SIOCGIFFLAGS, _SIOCGIFHWADDR = 0x8913, 0x8927  # linux/sockios.h
_ARPHRD_CAN, _IFF_UP = 280, 1  # linux/if_arp.h, linux/if.h
_IFREQ = struct.Struct("16sH22x")  # an interface's name; then the flags, or the family of the hardware address


def _asked(interface: str, request: int) -> int | None:
    """A number that the kernel has of an interface; None where there is no such interface (netdevice(7)).

    /sys/class/net need not be mounted, and may be another network namespace's.
    """
    name = os.fsencode(interface)
    if not 0 < len(name) < 16 or b"\0" in name:
        return None
    try:
        # Any socket is asked: one of this kind is allowed to every service.
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
            answer = fcntl.ioctl(asking, request, _IFREQ.pack(name, 0))
    except OSError:
        return None
    number: int = _IFREQ.unpack(answer)[1]
    return number
