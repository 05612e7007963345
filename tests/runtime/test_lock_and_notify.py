"""One bridge per interface, and the words for systemd."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from fsai_vcu.runtime.bus import BusError
from fsai_vcu.runtime.lock import AlreadyRunning, InterfaceLock, holder_pid
from fsai_vcu.runtime.notify import Notifier


@pytest.mark.parametrize(("first", "second"), [("test-if", "test-if"), ("vcan77", "socketcan:vcan77")])
def test_a_second_bridge_is_refused_with_the_holder_of_the_lock(first: str, second: str) -> None:
    """However the interface is spelt; and the holder can be asked for again and again."""
    words = rf"another bridge \(process {os.getpid()}\) already drives '{second}'"
    lock = InterfaceLock(first)
    try:
        with pytest.raises(AlreadyRunning, match=words):
            InterfaceLock(second)
        assert [holder_pid(second) for _ in range(20)] == [os.getpid()] * 20
        lock.answer_probes()
        assert holder_pid(first) == os.getpid()
    finally:
        lock.release()
    assert holder_pid(first) is None


def test_a_lock_that_cannot_be_made_is_not_blamed_on_a_bridge() -> None:
    with pytest.raises(BusError, match=r"cannot lock CAN interface 'loopback:x+': .*too long"):
        InterfaceLock("loopback:" + "x" * 120)


def test_a_lock_is_free_after_release_and_per_interface() -> None:
    first = InterfaceLock("test-if")
    other = InterfaceLock("test-if2")
    first.release()
    InterfaceLock("test-if").release()
    other.release()


def test_the_lock_dies_with_its_process() -> None:
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        _kept = InterfaceLock("test-child")
        os.write(write_end, b"x")
        os.kill(os.getpid(), 9)
    os.read(read_end, 1)
    os.waitpid(child, 0)
    InterfaceLock("test-child").release()


def test_systemd_gets_ready_and_half_the_watchdog_period_is_used(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "2000000"})
        notifier.send("READY=1")
        assert systemd.recv(64) == b"READY=1"
    assert notifier.watchdog_period_ns == 1_000_000_000


def test_without_systemd_a_notification_does_nothing() -> None:
    notifier = Notifier({})
    notifier.send("READY=1")
    assert notifier.watchdog_period_ns is None


def test_a_watchdog_meant_for_another_process_is_not_fed() -> None:
    assert Notifier({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}).watchdog_period_ns is None
