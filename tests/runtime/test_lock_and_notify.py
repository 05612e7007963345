"""One bridge per interface, and the words for systemd."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from fsai_vcu.runtime.bus import BusError
from fsai_vcu.runtime.lock import AlreadyRunning, InterfaceLock, holder_pid
from fsai_vcu.runtime.notify import Notifier


def test_a_second_bridge_is_refused_with_the_holder_of_the_lock() -> None:
    lock = InterfaceLock("test-if")
    try:
        with pytest.raises(AlreadyRunning, match=rf"another bridge \(process {os.getpid()}\) already drives 'test-if'"):
            InterfaceLock("test-if")
    finally:
        lock.release()


def test_who_holds_an_interface_can_be_asked_again_and_again() -> None:
    lock = InterfaceLock("test-if")
    try:
        assert [holder_pid("test-if") for _ in range(20)] == [os.getpid()] * 20
        lock.answer_probes()
        assert holder_pid("test-if") == os.getpid()
    finally:
        lock.release()
    assert holder_pid("test-if") is None


def test_one_interface_has_one_lock_however_it_is_spelt() -> None:
    lock = InterfaceLock("vcan77")
    try:
        with pytest.raises(AlreadyRunning, match="already drives 'socketcan:vcan77'"):
            InterfaceLock("socketcan:vcan77")
    finally:
        lock.release()


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
        InterfaceLock("test-child")
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
