"""A stand-in bus on which somebody talks."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from fsai_vcu.diagnostics.log import live
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus


@contextmanager
def talking(name: str, *frames: Frame) -> Iterator[list[Frame]]:
    """Each frame a hundred times a second; what anybody else sends there is in the list.

    Who listens in this process, however briefly, hears each at least once: they are sent when it has opened the bus.
    """
    received: list[Frame] = []
    ended = threading.Event()
    opened = live._open

    def opened_and_heard(spec: str) -> CanBus:
        bus = opened(spec)
        if spec == name:
            with open_bus(name) as other:
                for frame in frames:
                    other.send(frame)
        return bus

    def talk() -> None:
        with open_bus(name) as bus:
            while not ended.wait(0.01):
                for frame in frames:
                    bus.send(frame)
                received.extend(bus.drain())  # not by `recv`, which a test may hold up for whoever listens

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        with patch.object(live, "_open", opened_and_heard):
            yield received
    finally:
        ended.set()
        thread.join()
