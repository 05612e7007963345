"""A stand-in bus on which somebody talks."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import open_bus


@contextmanager
def talking(name: str, *frames: Frame) -> Iterator[list[Frame]]:
    """Each frame a hundred times a second; what anybody else sends there is in the list."""
    received: list[Frame] = []
    ended = threading.Event()

    def talk() -> None:
        with open_bus(name) as bus:
            while not ended.wait(0.01):
                for frame in frames:
                    bus.send(frame)
                if (other := bus.recv(0.0)) is not None:
                    received.append(other)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield received
    finally:
        ended.set()
        thread.join()
