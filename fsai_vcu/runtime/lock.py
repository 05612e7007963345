"""One bridge per interface: an exclusive lock that the kernel drops with the process, however it dies."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct

from fsai_vcu.interface.errors import UserError
from fsai_vcu.runtime.bus import BusError, split_spec

_PROBES = 64  # who may ask for the holder between two calls of `answer_probes`


class AlreadyRunning(UserError):
    """Another process holds the interface; the message is one clear line."""


class InterfaceLock:
    """Holds the interface that `spec` names for this process, however it is spelt (vcan0 or socketcan:vcan0).

    An abstract Unix socket: no file is left behind, and its scope is the network namespace, as the interface's is.
    Raises AlreadyRunning, or BusError where no lock can be had at all.
    """

    def __init__(self, spec: str) -> None:
        address = _address(spec)
        try:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        except OSError as error:
            raise BusError(f"cannot lock CAN interface '{spec}': {error.strerror}") from error
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            if error.errno != errno.EADDRINUSE:
                raise BusError(f"cannot lock CAN interface '{spec}': {error.strerror or error}") from error
            pid = holder_pid(spec)
            holder = "" if pid is None else f" (process {pid})"
            raise AlreadyRunning(
                f"another bridge{holder} already drives '{spec}'; stop it first (one bridge per interface)"
            ) from error
        self._socket.setblocking(False)
        self._socket.listen(_PROBES)

    def answer_probes(self) -> None:
        """Let go of those who have asked who holds the interface; to be called now and then."""
        with contextlib.suppress(OSError):
            while True:
                self._socket.accept()[0].close()

    def release(self) -> None:
        self._socket.close()


def holder_pid(spec: str) -> int | None:
    """The process that drives the interface, where there is one and the kernel tells."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(_address(spec))
            pid: int = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]
        except OSError:
            return None
    return pid


def _address(spec: str) -> str:
    return f"\0fsai-vcu-bridge/{':'.join(split_spec(spec))}"
