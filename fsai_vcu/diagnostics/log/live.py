"""Live buses as a source of frames, in the same shape as a log."""

from __future__ import annotations

import selectors
import time
from collections.abc import Iterator, Sequence
from typing import Final

from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of
from fsai_vcu.runtime.bus import BusLost, CanBus, can_interfaces, open_bus

_GATHER_S: Final = 0.05  # frames of so long are handled together: quick enough for an eye, cheap enough for a car
_MOST_AT_ONCE: Final = 500
_ALL_INTERFACES: Final = "any"  # as candump calls it


class LiveSource:
    """Receives from buses, and never sends.

    `lost` is the one clear line of what ended it, None while all is well. Times are the bus's own stamps of the wall
    clock.
    """

    def __init__(self, interfaces: Sequence[str]) -> None:
        """Opens them all; raises runtime.bus.BusError."""
        self.lost: str | None = None
        self._channels: list[str] = []
        self._buses: list[tuple[str, CanBus]] = []
        try:
            for interface in _expanded(interfaces):
                bus = open_bus(interface, may_send=())
                self._buses.append((interface.partition(":")[2] or interface, bus))
        except BaseException:
            self.close()
            raise

    def chunks(self, seconds: float | None = None) -> Iterator[Frames]:
        """What is received, every 50 ms or so, possibly nothing; ends after `seconds` or when a bus is lost."""
        until = None if seconds is None else time.monotonic() + seconds
        while self.lost is None and (until is None or time.monotonic() < until):
            wait_s = _GATHER_S if until is None else max(0.0, min(_GATHER_S, until - time.monotonic()))
            received: list[LogFrame] = []
            try:
                self._gather(received, wait_s)
            except KeyboardInterrupt:
                yield frames_of(received, self._channels)  # what was received before Ctrl-C is not lost
                raise
            received.sort(key=lambda frame: frame.t_ns)
            yield frames_of(received, self._channels)

    def _gather(self, received: list[LogFrame], wait_s: float) -> None:
        until = time.monotonic() + wait_s
        while len(received) < _MOST_AT_ONCE and self.lost is None:
            left_s = until - time.monotonic()
            if left_s <= 0.0:
                break
            for name, bus in self._ready(left_s):
                try:
                    found = bus.recv_stamped(left_s if len(self._buses) == 1 else 0.0, bus_off_is_lost=False)
                except BusLost as error:
                    self.lost = str(error)
                    break
                if found is not None:
                    frame, stamp_ns = found
                    kind = (frame.extended and not frame.error, frame.remote, frame.error)
                    received.append(LogFrame(stamp_ns, name, frame.can_id, frame.data, *kind))

    def _ready(self, wait_s: float) -> list[tuple[str, CanBus]]:
        """The buses on which something may be waiting."""
        if len(self._buses) == 1:
            return self._buses
        with selectors.DefaultSelector() as selector:
            for name, bus in self._buses:
                selector.register(bus.fileno(), selectors.EVENT_READ, (name, bus))
            return [key.data for key, _ in selector.select(wait_s)]

    def close(self) -> None:
        for _, bus in self._buses:
            bus.close()

    def __enter__(self) -> LiveSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _expanded(interfaces: Sequence[str]) -> list[str]:
    names = [name for each in interfaces for name in (can_interfaces() if each == _ALL_INTERFACES else [each])]
    return names or [_ALL_INTERFACES]
