"""One bridge per interface: an exclusive lock that the kernel drops with the process, however it dies."""

from __future__ import annotations

import socket
import struct


class AlreadyRunning(Exception):
    """Another process holds the interface; the message is one clear line."""


class InterfaceLock:
    """Holds the name of `spec` for this process.

    An abstract Unix socket: no file is left behind, and its scope is the network namespace, as the interface's is.
    """

    def __init__(self, spec: str) -> None:
        address = f"\0fsai-vcu-bridge/{spec}"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise AlreadyRunning(
                f"another bridge{_holder(address)} already drives '{spec}'; stop it first (one bridge per interface)"
            ) from error
        self._socket.listen(1)

    def release(self) -> None:
        self._socket.close()


def _holder(address: str) -> str:
    """' (process N)' where the kernel tells who holds the lock."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(address)
            pid = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]
        except OSError:
            return ""
    return f" (process {pid})"
