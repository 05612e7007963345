"""One bridge per interface, and the words for systemd."""

from __future__ import annotations

import os
import pwd
import re
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fsai_vcu.runtime import lock as lock_module
from fsai_vcu.runtime.bus import BusError, split_spec
from fsai_vcu.runtime.lock import AlreadyRunning, InterfaceLock, holder_pid
from fsai_vcu.runtime.notify import Notifier

STRANGER = 65534  # a user id that is nobody's here


@pytest.mark.parametrize(("first", "second"), [("test-if", "test-if"), ("vcan77", "socketcan:vcan77")])
def test_a_second_bridge_is_refused_with_the_holder_of_the_lock(first: str, second: str) -> None:
    """However the interface is spelt; and the holder can be asked for again and again."""
    user = pwd.getpwuid(os.geteuid()).pw_name
    words = rf"another bridge \(process {os.getpid()} of user {user}\) already drives '{second}'"
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


@contextmanager
def held_by_a_stranger(spec: str, *, answers: bool) -> Iterator[int]:
    """Another user of this machine has the lock's name; its process. answers: it listens, as a bridge does."""
    if os.geteuid() != 0:
        pytest.skip("only root can run a process as another user")
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        os.setuid(STRANGER)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as taken:
            taken.bind(f"\0fsai-vcu-bridge/{':'.join(split_spec(spec))}")
            if answers:
                taken.listen(8)
            os.write(write_end, b"x")
            signal.pause()
    try:
        os.read(read_end, 1)
        yield child
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(read_end)
        os.close(write_end)


@pytest.mark.parametrize("answers", [True, False])
def test_a_stranger_with_the_locks_name_keeps_no_bridge_out(answers: bool, caplog: pytest.LogCaptureFixture) -> None:
    with held_by_a_stranger("test-stranger", answers=answers) as pid:
        lock = InterfaceLock("test-stranger")
        lock.answer_probes()
        lock.release()
        assert holder_pid("test-stranger") is None
        who = rf"process {pid} of user (nobody|{STRANGER})" if answers else "a process that does not answer"
        assert re.search(f"the lock of 'test-stranger' is held by {who}", caplog.text)
        with pytest.raises(AlreadyRunning, match="another bridge"):
            InterfaceLock("test-stranger", polite=True)


def test_the_services_bridge_keeps_out_another_users(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock_module, "_user_id", {"fsai": STRANGER}.get)
    with held_by_a_stranger("test-service", answers=True), pytest.raises(AlreadyRunning, match="another bridge"):
        InterfaceLock("test-service")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_roots_bridge_keeps_out_another_users() -> None:
    lock = InterfaceLock("test-root")
    os.seteuid(STRANGER)
    try:
        with pytest.raises(AlreadyRunning, match="of user root"):
            InterfaceLock("test-root")
    finally:
        os.seteuid(0)
        lock.release()


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


@pytest.mark.parametrize("period", ["abc", "-5", "1e9", "²", "9" * 5000])
def test_a_period_that_is_not_systemds_is_no_watchdog(period: str) -> None:
    assert Notifier({"WATCHDOG_USEC": period}).watchdog_period_ns is None


def test_who_asks_for_the_holder_without_end_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    class Flooded:
        accepted = 0

        def accept(self) -> tuple[socket.socket, str]:
            self.accepted += 1
            assert self.accepted < 1000, "it would go on for ever"
            return socket.socket(socket.AF_UNIX), ""

    lock = InterfaceLock("test-flood")
    try:
        with monkeypatch.context() as patch:
            patch.setattr(lock, "_socket", Flooded())
            lock.answer_probes()
    finally:
        lock.release()
