"""Live buses as a source of frames, in the same shape as a log.

Each bus is received in a thread of its own: while the disk or the screen takes its time, nothing that passes is missed.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, can_interfaces, open_bus

Received = tuple[Frame, int]  # and the bus's own wall-clock stamp

_GATHER_S: Final = 0.05  # frames of so long are handled together: quick enough for an eye, cheap enough for a car
_ALL_INTERFACES: Final = "any"  # as candump calls it
_WAIT_S: Final = 0.05
_AGAIN_S: Final = 0.2
_RECEIVE_BUFFER_BYTES: Final = 8 << 20  # some ten thousand frames: seconds of a full bus
_SO_RCVBUFFORCE: Final = 33  # asm-generic/socket.h; beyond the system's bound, for a process that may
_MOST_WAITING: Final = 1_000_000  # frames that were not fetched


class Listener:
    """One bus: `fetch` what was received, and `news` for the operator, in order. It never sends.

    `lost`: why the bus is gone; with `waits` it is reported, and opened again when it comes back. `overrun`: frames
    thrown away because they were not fetched for too long. `dropped`: those that the kernel had no room for.
    `heard_ns`: what passed until then (monotonic clock) can be fetched; on a busy machine that is behind the present.
    """

    def __init__(self, spec: str, *, waits: bool) -> None:
        """Opens the bus. Raises BusError."""
        self.lost: str | None = None
        self._waits = waits
        self.overrun = 0
        self.name = spec.partition(":")[2] or spec
        self._thread = threading.Thread(target=self._run, name="listener", daemon=True)
        self._spec = spec
        self._bus: CanBus | None = _open(spec)
        self.heard_ns = time.monotonic_ns()
        self._dropped = 0  # of buses that are closed
        self._received: deque[Received] = deque()
        self._news: deque[str] = deque()
        self._ending = threading.Event()
        self._end_ns = float("inf")  # what passes later need not be received
        self._error: Exception | None = None

    def fetch(self) -> list[Received]:
        """Return what was received since the last call. Raises BusLost where nothing is received any more."""
        if self._error is not None and not self._received:
            raise BusLost(f"{self.name} is not received any more: {self._error!r}") from self._error
        return [self._received.popleft() for _ in range(len(self._received))]

    def news(self) -> list[str]:
        return [self._news.popleft() for _ in range(len(self._news))]

    @property
    def dropped(self) -> int:
        bus = self._bus  # the thread may leave it meanwhile
        return self._dropped + (bus.dropped() if bus is not None else 0)

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        try:
            self._receive()
        except Exception as error:
            self._error = error
            raise

    def _receive(self) -> None:
        """Receive until the end, in a thread of its own, and open the bus again when it comes back."""
        lost_s = 0.0
        while self.heard_ns < self._end_ns:
            if self._bus is None:
                self._try_again(lost_s)
                continue
            until_ns = time.monotonic_ns() + round(_WAIT_S * S)
            try:
                received = self._bus.recv_stamped(_WAIT_S, bus_off_is_lost=False)
            except BusLost as error:
                lost_s = time.monotonic()
                self._leave()
                self.lost = str(error)
                if not self._waits:
                    return
                self._news.append(f"{error}; waiting for it to come back")
                continue
            if received is not None and len(self._received) >= _MOST_WAITING:
                self.overrun += 1
            elif received is not None:
                self._received.append(received)
            self.heard_ns = until_ns if received is None else received[0].t_ns

    def _try_again(self, lost_s: float) -> None:
        self.heard_ns = time.monotonic_ns()
        try:
            self._bus = _open(self._spec)
        except BusError:
            self._ending.wait(_AGAIN_S)
        else:
            self._news.append(f"{self._spec} is back after {time.monotonic() - lost_s:.1f} s")

    def close(self) -> None:
        """End the reception; what has passed until now is received first, and can still be fetched."""
        self._end_ns = min(self._end_ns, time.monotonic_ns())
        self._ending.set()
        if self._thread.is_alive() and not sys.is_finalizing():  # then it never goes on, nor ends
            self._thread.join()
        self._leave()

    def _leave(self) -> None:
        bus = self._bus
        if bus is not None:
            dropped = bus.dropped()
            self._bus = None
            self._dropped += dropped
            bus.close()


class LiveSource:
    """Receives from buses. Times are their own stamps of the wall clock.

    `lost` is the one clear line of what ended it, None while all is well; `missing` says what was not received. With
    `waits` a bus that is lost ends nothing: it is opened again when it comes back. `heard_ns`: everything until then
    (monotonic clock) is in the last of `chunks`.
    """

    def __init__(self, interfaces: Sequence[str], *, waits: bool = False) -> None:
        """Opens them all; raises runtime.bus.BusError."""
        self._waits = waits
        self.lost: str | None = None
        self.heard_ns = time.monotonic_ns()
        self._channels: list[str] = []
        self._listeners: list[Listener] = []
        names = [name for each in interfaces for name in (can_interfaces() if each == _ALL_INTERFACES else [each])]
        try:
            for name in names or [_ALL_INTERFACES]:
                self._listeners.append(Listener(name, waits=waits))
        except BaseException:
            self.close()
            raise
        for listener in self._listeners:
            listener.start()

    def chunks(self, seconds: float | None = None, asked: Sequence[int] = ()) -> Iterator[Frames]:
        """Yield what is received, every 50 ms or so, possibly nothing.

        Ends after `seconds`, when a bus is lost, or when the end is `asked` for: once there is something in that.
        The last chunk has everything that has passed until then.
        """
        until = float("inf") if seconds is None else time.monotonic() + seconds
        interrupted = False
        while not interrupted and not asked and self.lost is None and (left_s := until - time.monotonic()) > 0.0:
            try:
                time.sleep(min(_GATHER_S, left_s))
            except KeyboardInterrupt:
                interrupted = True
            if not self._waits:
                self.lost = next((listener.lost for listener in self._listeners if listener.lost), None)
            yield self._fetched()
        self.close()
        yield self._fetched()
        if interrupted:
            raise KeyboardInterrupt

    def news(self) -> list[str]:
        """Return the news of buses that went and came back."""
        return [text for listener in self._listeners for text in listener.news()]

    def missing(self) -> Iterator[str]:
        """Yield what was not received, and why, in one line each."""
        if self.lost is not None:
            yield self.lost
        if overrun := sum(listener.overrun for listener in self._listeners):
            yield f"{overrun} frames were lost: the program that reads the output is too slow for the bus"

    @property
    def dropped(self) -> int:
        """Frames that the kernel had no room for, on all buses."""
        return sum(listener.dropped for listener in self._listeners)

    def _fetched(self) -> Frames:
        received: list[LogFrame] = []
        heard_ns: list[int] = []
        for listener in self._listeners:
            before_ns = listener.heard_ns  # read first: what comes meanwhile is no gap
            fetched = listener.fetch()
            heard_ns.append(max(before_ns, fetched[-1][0].t_ns if fetched else 0))
            received += (log_frame(each, listener.name) for each in fetched)
        self.heard_ns = min(heard_ns)
        return frames_of(sorted(received, key=lambda frame: frame.t_ns), self._channels)

    def close(self) -> None:
        for listener in self._listeners:
            listener.close()


def log_frame(received: Received, channel: str) -> LogFrame:
    frame, stamp_ns = received
    kind = (frame.extended and not frame.error, frame.remote, frame.error)
    return LogFrame(stamp_ns, channel, frame.can_id, frame.data, *kind)


def _open(spec: str) -> CanBus:
    bus = open_bus(spec, may_send=())
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(bus.fileno())) as ours:
        try:
            ours.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)
        except PermissionError:
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    return bus
