"""Lock of an interface for one bridge: exclusive, and dropped by the kernel with the process, however it dies."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import pwd
import socket
import struct
import time
from typing import Final, NamedTuple

from fsai_vcu.interface.errors import UserError
from fsai_vcu.runtime.bus import BusError, split_spec

logger = logging.getLogger(__name__)

_PROBES: Final = 64  # who may ask for the holder between two calls of `answer_probes`
_SERVICE_USER: Final = "fsai"
_ASK_S: Final = 0.2  # time that a holder has between taking the name and answering


class AlreadyRunning(UserError):
    """Another process holds the interface; the message is one clear line."""


class Holder(NamedTuple):
    """The process that has the lock's name, as the kernel tells."""

    pid: int
    user_id: int

    @property
    def trusted(self) -> bool:
        """It runs as this user, as root or as the services do: what it says of driving the interface is believed."""
        return self.user_id in {0, os.geteuid(), _user_id(_SERVICE_USER)}

    def __str__(self) -> str:
        try:
            user = pwd.getpwuid(self.user_id).pw_name
        except KeyError:
            user = str(self.user_id)
        return f"process {self.pid} of user {user}"


class InterfaceLock:
    """Holds the interface that `spec` names for this process, however it is spelt (vcan0 or socketcan:vcan0).

    An abstract Unix socket: no file is left behind, and its scope is the network namespace, as the interface's is. Any
    user may take such a name, so it keeps out only when its holder is this user, root or the services' user. Where
    another user holds it, this process goes on without the lock, and the log names the holder: another sender on the
    interface is seen there. Raises AlreadyRunning, or BusError where no lock can be had at all.
    """

    def __init__(self, spec: str, *, polite: bool = False) -> None:
        """Take the lock.

        polite: it respects anybody's hold; for a process that can wait, and does not keep the car from being driven.
        """
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
            holder = _holder(spec)
            who = "" if holder is None else f" ({holder})"
            if polite or (holder is not None and holder.trusted):
                raise AlreadyRunning(
                    f"another bridge{who} already drives '{spec}'; stop it first (one bridge per interface)"
                ) from error
            logger.warning(
                "the lock of '%s' is held by %s, which may not be a bridge: going on without the lock",
                spec,
                holder or "a process that does not answer",
            )
            return
        self._socket.setblocking(False)
        self._socket.listen(_PROBES)

    def answer_probes(self) -> None:
        """Let go of the processes that have asked who holds the interface; to be called now and then."""
        with contextlib.suppress(OSError):
            for _ in range(_PROBES):  # not until none waits: who asks again and again would hold up the CAN loop
                self._socket.accept()[0].close()

    def release(self) -> None:
        self._socket.close()


def holder_pid(spec: str) -> int | None:
    """The process that drives the interface, where there is one and the kernel tells."""
    holder = _holder(spec, wait_s=0.0)
    return holder.pid if holder is not None and holder.trusted else None


def _holder(spec: str, wait_s: float = _ASK_S) -> Holder | None:
    """Return the holder of the lock's name. None: nobody, or a process that has not begun to answer within `wait_s`."""
    until_s = time.monotonic() + wait_s
    while True:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(_ASK_S)
            try:
                probe.connect(_address(spec))
                pid, user_id, _ = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
                return Holder(pid, user_id & 0xFFFF_FFFF)
            except OSError as error:
                if error.errno != errno.ECONNREFUSED or time.monotonic() >= until_s:
                    return None
        time.sleep(0.01)


def _user_id(name: str) -> int | None:
    try:
        return pwd.getpwnam(name).pw_uid
    except KeyError:
        return None


def _address(spec: str) -> str:
    return f"\0fsai-vcu-bridge/{':'.join(split_spec(spec))}"
