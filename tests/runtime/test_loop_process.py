"""The loop's own process: what it shares with its edge (a link), what it survives, and how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from loop_rig import CODEC, PATIENT, WAIT_S, drop_all, eventually, status_received, systemd

from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.messages import VcuStatus
from fsai_vcu.runtime.bus import open_bus
from fsai_vcu.runtime.link import LoopSettings
from fsai_vcu.runtime.loop_handle import LoopError, LoopHandle, start_loop_process


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("REQUEST_TIMEOUT_S", "_START_TIMEOUT_S", "_STOP_TIMEOUT_S"):
        monkeypatch.setattr(f"fsai_vcu.runtime.loop_handle.{name}", WAIT_S)


@pytest.fixture(scope="module")
def lasting() -> Iterator[LoopHandle]:
    """One that goes on from test to test, each on a bus of its own."""
    handle = start_loop_process("loopback:lasting")
    yield handle
    handle.close()


@pytest.fixture
def loop(lasting: LoopHandle) -> Iterator[LoopHandle]:
    yield lasting
    assert lasting.deactivate()


@pytest.fixture
def process(spec: str) -> Iterator[LoopHandle]:
    """One that may be ended."""
    handle = start_loop_process(spec)
    yield handle
    handle.close()


def settings(spec: str, **changes: object) -> LoopSettings:
    return LoopSettings(bus=spec, revision="2026", car="2026", real_time=False, **changes)  # type: ignore[arg-type]


def process_of(handle: LoopHandle) -> subprocess.Popen[bytes]:
    assert handle._process is not None
    return handle._process


def test_it_answers_the_car_and_reports_it(loop: LoopHandle, spec: str) -> None:
    loop.configure(settings(spec, config=PATIENT))
    loop.activate(7)
    with open_bus(spec) as car:
        for bit in (True, False, True):
            car.send(CODEC.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)))
            while status_received(car).handshake is not bit:
                pass
    assert eventually(lambda: loop.report().run.as_state is AsState.AS_OFF)
    assert loop.report().run.run_id == 7
    assert loop.set_mode("autonomous") == (True, "mode is autonomous")


def test_neither_ros_nor_its_middleware_is_in_it(loop: LoopHandle, spec: str) -> None:
    loop.configure(settings(spec))
    loop.activate(1)
    mapped = Path(f"/proc/{loop.pid}/maps").read_text()
    assert not [name for name in ("rclpy", "librcl", "librmw", "fastrtps", "fastdds") if name in mapped]


def test_it_is_activated_again_after_its_end(loop: LoopHandle, spec: str) -> None:
    loop.configure(settings(spec))
    with open_bus(spec) as car:
        for _ in range(2):
            loop.activate(1)
            status_received(car)
            assert loop.deactivate()
            drop_all(car)
            assert car.recv(0.1) is None
    assert loop.failure == ""


@pytest.mark.parametrize("database", ["absent.dbc", __file__], ids=["no file", "no database"])
def test_what_cannot_be_read_is_refused_in_one_line(loop: LoopHandle, spec: str, database: str, tmp_path: Path) -> None:
    path = tmp_path / database
    with pytest.raises(LoopError, match=path.name) as refused:
        loop.configure(settings(spec, dbc_files=(str(path),)))
    assert "\n" not in str(refused.value)


def test_an_absent_bus_is_refused_and_may_come_later(loop: LoopHandle) -> None:
    loop.configure(settings("can98"))
    for _ in range(2):
        with pytest.raises(LoopError, match="no CAN interface 'can98'"):
            loop.activate(1)
    assert process_of(loop).poll() is None


def test_the_second_on_an_interface_is_refused_by_name(loop: LoopHandle, spec: str) -> None:
    loop.configure(settings(spec))
    loop.activate(1)
    second = start_loop_process(spec)
    try:
        second.configure(settings(spec))
        with pytest.raises(LoopError, match=rf"another bridge \(process {loop.pid} of user [^)]+\) already drives"):
            second.activate(1)
    finally:
        second.close()


def test_signals_to_the_whole_group_do_not_end_it(loop: LoopHandle, spec: str) -> None:
    """Ctrl-C and a service manager's SIGTERM reach every process; what they mean is the edge's to say."""
    loop.configure(settings(spec))
    loop.activate(1)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(process_of(loop).pid, number)
    with open_bus(spec) as car:
        for _ in range(5):
            status_received(car)
    assert loop.running


def test_a_killed_loop_is_noticed_with_its_signal(process: LoopHandle, spec: str) -> None:
    process.configure(settings(spec))
    process.activate(1)
    os.kill(process_of(process).pid, signal.SIGKILL)
    process_of(process).wait(WAIT_S)
    assert eventually(lambda: not process.running)
    assert process.failure == "its process was killed by signal 9"
    assert process.report().vcu_lost
    assert process.emergency_brake("now") == (False, "the CAN loop does not run: nothing is sent")


def test_a_hanging_loop_is_killed_in_the_end(process: LoopHandle, spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsai_vcu.runtime.loop_handle._STOP_TIMEOUT_S", 0.2)
    process.configure(settings(spec))
    process.activate(1)
    os.kill(process_of(process).pid, signal.SIGSTOP)
    assert not process.deactivate()
    monkeypatch.setattr("fsai_vcu.runtime.loop_handle._STOP_TIMEOUT_S", WAIT_S)
    began = time.monotonic()
    process.close()
    assert time.monotonic() - began < WAIT_S, "it has been waited for already"
    assert process_of(process).returncode == -signal.SIGKILL


def test_it_ends_with_its_edge(process: LoopHandle, spec: str) -> None:
    process.configure(settings(spec))
    process.activate(1)
    process._link.close()
    assert process_of(process).wait(60.0) == 0
    with open_bus(spec) as car:
        assert car.recv(0.1) is None


def test_it_ends_when_the_edge_was_killed(spec: str, tmp_path: Path) -> None:
    """The lock is free again for the next edge, without anybody's help."""
    edge = (
        "import sys, time\n"
        "from fsai_vcu.runtime.link import LoopSettings\n"
        "from fsai_vcu.runtime.loop_handle import start_loop_process\n"
        f"handle = start_loop_process({spec!r})\n"
        f"handle.configure(LoopSettings(bus={spec!r}, revision='2026', car='2026', real_time=False))\n"
        "handle.activate(1)\n"
        "print(handle.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", edge], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        loop_pid = int(child.stdout.readline())
        child.kill()
    assert eventually(lambda: not Path(f"/proc/{loop_pid}/maps").exists() or not Path(f"/proc/{loop_pid}").exists())
    again = start_loop_process(spec)
    try:
        again.configure(settings(spec))
        again.activate(1)
    finally:
        again.close()


def test_the_watchdog_is_fed_by_the_loop_itself(spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with systemd(tmp_path, monkeypatch, 1_000_000) as told:  # some ten words fit the socket
        handle = start_loop_process(spec)
        try:
            handle.configure(settings(spec))
            handle.activate(1)
            assert told.recv(64) == b"READY=1"
            assert told.recv(64) == b"WATCHDOG=1"
        finally:
            handle.close()
        while (said := told.recv(64)) == b"WATCHDOG=1":
            pass
        assert said == b"STOPPING=1"
