"""A bus received in a thread of its own: while the disk takes its time, nothing that passes is missed.

The bus may go and come back: the listener reports it, and opens it again.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections import deque
from typing import Final

from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus

Received = tuple[Frame, int]  # and the bus's own wall-clock stamp

_WAIT_S: Final = 0.2
_AGAIN_S: Final = 0.2
_RECEIVE_BUFFER_BYTES: Final = 8 << 20  # some ten thousand frames: seconds of a full bus
_SO_RCVBUFFORCE: Final = 33  # asm-generic/socket.h; beyond the system's bound, for those who may
_MOST_WAITING: Final = 1_000_000  # frames that were not fetched


class Listener:
    """`fetch` what was received, and `news` for the operator, in order."""

    def __init__(self, spec: str) -> None:
        """Opens the bus. Raises BusError."""
        self._thread = threading.Thread(target=self._run, name="listener", daemon=True)
        self._spec = spec
        self._bus: CanBus | None = _open(spec)
        self._received: deque[Received] = deque()
        self._news: deque[str] = deque()
        self._ending = threading.Event()
        self.overrun = 0
        """Frames thrown away because they were not fetched for too long."""

    def fetch(self) -> list[Received]:
        """What was received since the last call."""
        return [self._received.popleft() for _ in range(len(self._received))]

    def news(self) -> list[str]:
        return [self._news.popleft() for _ in range(len(self._news))]

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        lost_s = 0.0
        while not self._ending.is_set():
            bus = self._bus
            if bus is None:
                bus = self._again(lost_s)
                continue
            try:
                received = bus.recv_stamped(_WAIT_S, bus_off_is_lost=False)
            except BusLost as error:
                lost_s = time.monotonic()
                self._bus = None
                bus.close()
                self._news.append(f"{error}; waiting for it to come back")
                continue
            if received is None:
                continue
            if len(self._received) >= _MOST_WAITING:
                self.overrun += 1
                continue
            self._received.append(received)

    def _again(self, lost_s: float) -> CanBus | None:
        try:
            self._bus = _open(self._spec)
        except BusError:
            self._ending.wait(_AGAIN_S)
        else:
            self._news.append(f"{self._spec} is back after {time.monotonic() - lost_s:.1f} s")
        return self._bus

    def close(self) -> None:
        """What has been received can still be fetched."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._bus is not None:
            self._bus.close()


def _open(spec: str) -> CanBus:
    bus = open_bus(spec, may_send=())
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(bus.fileno())) as ours:
        try:
            ours.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)
        except PermissionError:
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    return bus
