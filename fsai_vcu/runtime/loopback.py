"""A stand-in bus for machines without CAN: frames as datagrams that never leave this computer.

Every frame is one UDP multicast datagram on the loopback interface (time to live 0), so several processes share a bus
as they would share `vcan0`. A multicast sender receives its own: each datagram is tagged with its sender, and a process
drops its own. It has no bitrate, no acknowledge and no arbitration: it is for rehearsal, never for the car.

Registered with python-can as interface `fsai_loopback`, so that python-can's own tools can look at such a bus too.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import time
import zlib
from typing import Any

from fsai_vcu.lean_can import can

_HEADER = struct.Struct("!4s8sdIB")  # magic, sender, wall-clock time, id with SocketCAN's flags, length
_MAGIC = b"fsv1"
_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_RECEIVE_BUFFER_BYTES = 1 << 20
_LATEST_S = float(1 << 33)  # wall-clock time that no clock says before the year 2242


def group_of(channel: str) -> tuple[str, int]:
    """The multicast group (administratively scoped) and port that stand for the bus `channel`."""
    digest = zlib.crc32(channel.encode())
    # Below the ports of ROS 2's discovery (7400 and up) and of the kernel's own choice (32768 and up).
    return f"239.83.{digest >> 8 & 0xFF}.{(digest & 0xFF) or 1}", 5100 + (digest >> 16) % 2200


class LoopbackBus(can.BusABC):
    """A bus shared by the processes of this computer that open the same `channel`."""

    def __init__(
        self, channel: str = "fsai", can_filters: can.typechecking.CanFilters | None = None, **kwargs: Any
    ) -> None:
        """Open the socket of the group that stands for `channel`."""
        self._closed = True
        self._group, self._port = group_of(channel)
        self._sender = os.urandom(8)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
            loopback = socket.inet_aton("127.0.0.1")
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            self._socket.setsockopt(
                socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(self._group) + loopback
            )
            # Bound to the group's own address: datagrams of any other group or host are not even seen.
            self._socket.bind((self._group, self._port))
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise can.CanInitializationError(f"no loopback bus '{channel}': {error.strerror}", error.errno) from error
        self._closed = False
        self.channel_info = f"loopback bus '{channel}' ({self._group}:{self._port})"
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        word = msg.arbitration_id
        word |= (
            (_EXTENDED if msg.is_extended_id else 0)
            | (_REMOTE if msg.is_remote_frame else 0)
            | (_ERROR if msg.is_error_frame else 0)
        )
        datagram = _HEADER.pack(_MAGIC, self._sender, time.time(), word, msg.dlc) + bytes(msg.data)
        try:
            self._socket.sendto(datagram, (self._group, self._port))
        except OSError as error:
            raise can.CanOperationError(f"Failed to transmit: {error.strerror}", error.errno) from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Return the next message of another process, or None after `timeout` (s), as python-can asks for it."""
        until = None if timeout is None else time.monotonic() + timeout
        while True:
            try:
                datagram = self._socket.recv(_HEADER.size + 64)
            except BlockingIOError:
                left = None if until is None else until - time.monotonic()
                if left is not None and left <= 0:
                    return None, False
                select.select([self._socket], [], [], left)
                continue
            except OSError as error:
                raise can.CanOperationError(f"Failed to receive: {error.strerror}", error.errno) from error
            message = self._message_of(datagram)
            if message is not None:
                return message, False

    def _message_of(self, datagram: bytes) -> can.Message | None:
        """Return the message in a datagram; None for this bus's own frames and for anything that is not a frame."""
        if len(datagram) < _HEADER.size:
            return None
        magic, sender, timestamp, word, length = _HEADER.unpack_from(datagram)
        if magic != _MAGIC or sender == self._sender or length > 8 or not 0.0 <= timestamp < _LATEST_S:
            return None
        extended = bool(word & _EXTENDED)
        remote = bool(word & _REMOTE)
        if len(datagram) != _HEADER.size + (0 if remote else length):
            return None
        return can.Message(
            timestamp=timestamp,
            arbitration_id=word & (0x1FFF_FFFF if extended else 0x7FF),
            is_extended_id=extended,
            is_remote_frame=remote,
            is_error_frame=bool(word & _ERROR),
            dlc=length,
            data=None if remote else datagram[_HEADER.size :],
            channel=self._group,
        )

    def fileno(self) -> int:
        return self._socket.fileno()

    def shutdown(self) -> None:
        if not self._closed:
            self._closed = True
            self._socket.close()
        super().shutdown()
