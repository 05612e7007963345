"""A loop on a stand-in bus, and what a test of it looks at."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.messages import AiStatus, VcuStatus, WheelSpeeds
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.bus import CanBus, open_bus
from fsai_vcu.runtime.link import LinkEnd, LoopSettings, link_pair
from fsai_vcu.runtime.loop import BridgeLoop
from fsai_vcu.runtime.loop_handle import LoopHandle

REVISION = revision("2026")
CODEC = Codec(REVISION)
WAIT_S = 60.0
WAIT_NS = round(WAIT_S * S)
# Of times that run out where a thread is held up; what they mean is tested in virtual time.
PATIENT = BridgeConfig(
    launch_wait_ns=WAIT_NS,
    vcu_lost_ns=WAIT_NS,
    power_cycle_ns=WAIT_NS,
    stop_timeout_ns=WAIT_NS,
    stop_window_ns=WAIT_NS,
    send_lost_ns=WAIT_NS,
)


class ThreadedLoop(LoopHandle):
    """A loop in a thread of this process, behind the handle that an edge has of one in a process of its own."""

    def __init__(self, spec: str, config: BridgeConfig | None = None, *, real_time: bool = False) -> None:
        ours, theirs = link_pair()
        super().__init__(ours)
        self.far_end = LinkEnd(theirs)
        bridge = Bridge(CODEC, REVISION, CARS["2026"], config, now_ns=time.monotonic_ns())
        self.loop = BridgeLoop(bridge, CODEC, LoopSettings(spec, "2026", "2026", real_time=real_time), self.far_end)
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        self.loop.run(0)
        self.far_end.close()

    def start(self) -> None:
        self.thread.start()
        self._active = True
        assert eventually(lambda: self._newest is not None or not self.running)

    def stop(self) -> None:
        self.deactivate()
        self.thread.join(WAIT_S)
        assert not self.thread.is_alive()


def eventually(condition: Callable[[], bool]) -> bool:
    return eventually_within(WAIT_S, condition)


def eventually_within(wait_s: float, condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + wait_s
    while time.monotonic() < until:
        if condition():
            return True
        threading.Event().wait(0.005)
    return False


def status_received(bus: CanBus) -> AiStatus:
    """The next 0x510 on the bus."""
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        frame = bus.recv(0.5)
        if frame is not None and frame.can_id == 0x510:
            image = CODEC.decode(frame).image
            assert isinstance(image, AiStatus)
            return image
    raise AssertionError("no 0x510 received")


def drop_all(bus: CanBus) -> None:
    while bus.recv(0.0) is not None:
        pass


@contextmanager
def moving_car(spec: str) -> Iterator[list[AiStatus]]:
    """A car in AS_DRIVING whose wheels turn, every 10 ms; the list grows by each 0x510 that it receives."""
    received: list[AiStatus] = []
    over = threading.Event()

    def talk() -> None:
        with open_bus(spec) as vcu:
            while not over.is_set():
                vcu.send(CODEC.encode(VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True)))
                vcu.send(CODEC.encode(WheelSpeeds(200, 200, 200, 200)))
                until = time.monotonic() + 0.01
                while (left_s := until - time.monotonic()) > 0:
                    frame = vcu.recv(left_s)
                    image = None if frame is None else CODEC.decode(frame).image
                    if isinstance(image, AiStatus):
                        received.append(image)

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        yield received
    finally:
        over.set()
        talker.join()


@contextmanager
def systemd(folder: Path, monkeypatch: pytest.MonkeyPatch, watchdog_us: int) -> Iterator[socket.socket]:
    """The service manager's socket, for what is started meanwhile; `told_nothing` asks it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as told:
        told.bind(str(folder / "notify"))
        told.settimeout(WAIT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(folder / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", str(watchdog_us))
        monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))  # systemd names the process that it has started
        yield told


def told_nothing(told: socket.socket) -> bool:
    told.setblocking(False)
    try:
        told.recv(64)
    except BlockingIOError:
        return True
    finally:
        told.settimeout(WAIT_S)
    return False
