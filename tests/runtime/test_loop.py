"""The real-time loop on a bus: its thread, its slots, and what it does when the bus goes away."""

from __future__ import annotations

import contextlib
import gc
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.images import AiStatus, VcuStatus, WheelSpeeds
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime import loop as loop_module
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.lock import AlreadyRunning
from fsai_vcu.runtime.loop import BridgeLoop
from fsai_vcu.runtime.pacing import MIN_GAP_NS

REVISION = revision("2026")
CODEC = Codec(REVISION)
WAIT_S = 10.0


def make_loop(spec: str, config: BridgeConfig | None = None) -> BridgeLoop:
    bridge = Bridge(CODEC, REVISION, CARS["2026"], config, now_ns=time.monotonic_ns())
    return BridgeLoop(bridge, CODEC, spec, real_time=False)


def eventually(condition: Callable[[], bool]) -> bool:
    return eventually_within(WAIT_S, condition)


def eventually_within(wait_s: float, condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + wait_s
    while time.monotonic() < until:
        if condition():
            return True
        threading.Event().wait(0.005)
    return False


@pytest.fixture
def spec() -> str:
    return f"loopback:{uuid.uuid4()}"


@pytest.fixture
def loop(spec: str) -> Iterator[BridgeLoop]:
    made = make_loop(spec)
    made.start()
    yield made
    made.stop()


def status_heard(bus: CanBus) -> AiStatus:
    """The next 0x510 on the bus."""
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        frame = bus.recv(0.5)
        if frame is not None and frame.can_id == 0x510:
            image = CODEC.decode(frame).image
            assert isinstance(image, AiStatus)
            return image
    raise AssertionError("no 0x510 heard")


def test_without_a_car_it_sends_idle_frames_by_its_own_clock(loop: BridgeLoop, spec: str) -> None:
    with open_bus(spec) as car:
        heard = [frame for frame in (car.recv(1.0) for _ in range(25)) if frame is not None]
    assert {frame.can_id for frame in heard} == set(AI_IDS)
    decoded = [CODEC.decode(frame).image for frame in heard if frame.can_id == 0x510]
    assert all(isinstance(i, AiStatus) and i.mission_status is MissionStatus.NOT_SELECTED for i in decoded)


def test_the_handshake_bit_is_echoed_in_the_answer(loop: BridgeLoop, spec: str) -> None:
    with open_bus(spec) as car:
        for bit in (True, False, True, True, False):
            car.send(CODEC.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)))
            assert eventually(lambda bit=bit: status_heard(car).handshake is bit)


def test_a_question_is_answered_between_two_cycles_and_shows_in_the_next_report(loop: BridgeLoop, spec: str) -> None:
    with open_bus(spec) as car:
        car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF, ami=Ami.AUTOCROSS)))
        assert eventually(lambda: loop.report().run.as_state is AsState.AS_OFF)
        accepted, message = loop.set_mode("autonomous")
        assert accepted, message
        assert eventually(lambda: loop.report().mode == "autonomous")


def test_an_unknown_mode_is_refused_with_the_valid_ones(loop: BridgeLoop) -> None:
    accepted, message = loop.set_mode("sport")
    assert not accepted
    assert "autonomous" in message and "manual" in message and "sport" in message


def test_a_command_that_is_not_finite_is_refused_whole_and_reported(loop: BridgeLoop) -> None:
    loop.submit_command(VehicleCommand(time.monotonic_ns(), loop.report().run.run_id, throttle=float("nan")))
    assert eventually(lambda: any("refused" in name for name in loop.report().reason_counts))


def test_selected_is_sent_once_planner_and_controller_have_confirmed(loop: BridgeLoop, spec: str) -> None:
    with open_bus(spec) as car:
        silent = threading.Event()

        def talk() -> None:
            with open_bus(spec) as vcu:
                while not silent.wait(0.01):
                    vcu.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF, ami=Ami.AUTOCROSS)))

        talker = threading.Thread(target=talk)
        talker.start()
        try:
            assert eventually(lambda: loop.report().run.mission is Ami.AUTOCROSS)
            assert loop.set_mode("autonomous")[0]
            assert status_heard(car).mission_status is MissionStatus.NOT_SELECTED
            for role in ("planner", "controller"):
                loop.confirm_reset(role, loop.report().run.run_id)
            assert eventually(lambda: status_heard(car).mission_status is MissionStatus.SELECTED)
        finally:
            silent.set()
            talker.join()


def test_a_listener_never_sends(spec: str) -> None:
    with open_bus(spec) as car:
        loop = make_loop(spec, BridgeConfig(listen_only=True))
        loop.start()
        car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF)))
        assert eventually(lambda: loop.report().run.as_state is AsState.AS_OFF)
        loop.stop()
        assert car.recv(0.0) is None


def test_a_second_bridge_on_the_interface_refuses_to_start(loop: BridgeLoop, spec: str) -> None:
    with pytest.raises(AlreadyRunning, match="already drives"):
        make_loop(spec)


def test_an_absent_interface_leaves_no_lock_behind() -> None:
    for _ in range(2):
        with pytest.raises(BusError, match="no CAN interface 'can98'"):
            make_loop("can98")


def test_after_a_stop_the_bus_is_silent_and_free_for_the_next(spec: str) -> None:
    first = make_loop(spec)
    first.start()
    with open_bus(spec) as car:
        status_heard(car)
        first.stop()
        while car.recv(0.0) is not None:
            pass  # what was sent before the stop
        assert car.recv(0.1) is None, "it still sends after its stop"
    second = make_loop(spec)
    second.start()
    second.stop()
    assert second.failure is None


def test_it_comes_back_by_itself_when_the_bus_does(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The interface goes down under the loop and is missing for a while."""
    attempts: list[int] = []

    def absent_twice(*args: object, **kwargs: object) -> CanBus:
        attempts.append(1)
        if len(attempts) < 3:
            raise BusError("no such device")
        return open_bus(spec)

    def gone(self: CanBus, timeout_s: float) -> None:
        monkeypatch.setattr(CanBus, "recv", original)
        raise BusLost("Network is down")

    original = CanBus.recv
    monkeypatch.setattr(loop_module, "open_bus", absent_twice)
    monkeypatch.setattr(CanBus, "recv", gone)
    assert eventually(lambda: loop.reopened == 1)
    assert len(attempts) == 3
    with open_bus(spec) as car:
        status_heard(car)


def test_an_exception_in_the_loop_ends_it_with_an_emergency_request_on_the_wire(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_bus(spec) as car:
        driving = CODEC.encode(VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True))
        car.send(driving)
        assert eventually(lambda: loop.report().run.as_state is AsState.AS_DRIVING)
        status_heard(car)  # it has listened for its first 200 ms and speaks

        def broken(frame: object) -> None:
            raise RuntimeError("a bug")

        monkeypatch.setattr(loop._bridge, "on_frame", broken)
        car.send(driving)
        assert eventually(lambda: not loop.running)
        last: AiStatus | None = None
        while (frame := car.recv(0.0)) is not None:
            image = CODEC.decode(frame).image
            last = image if isinstance(image, AiStatus) else last
    assert isinstance(loop.failure, RuntimeError)
    assert last is not None and last.estop_request


def test_whatever_keeps_it_from_starting_the_lock_is_free_again(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> CanBus:
        raise OSError("Too many open files")

    with monkeypatch.context() as patched:
        patched.setattr(loop_module, "open_bus", refuse)
        with pytest.raises(OSError, match="Too many") as kept:  # and with it all that the constructor held
            make_loop(spec)
    make_loop(spec).stop()
    assert kept.value


def test_a_failure_before_the_first_turn_is_told_and_leaves_the_bus_closed(
    spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> tuple[str, ...]:
        raise RuntimeError("no such call")

    monkeypatch.setattr(loop_module, "go_real_time", refuse)
    bridge = Bridge(CODEC, REVISION, CARS["2026"], now_ns=time.monotonic_ns())
    loop = BridgeLoop(bridge, CODEC, spec, real_time=True)
    loop.start()
    assert eventually(lambda: not loop.running)
    assert isinstance(loop.failure, RuntimeError) and loop._bus is None
    loop.stop()


def test_what_real_time_scheduling_refuses_is_told_and_the_loop_goes_on(
    spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop_module, "go_real_time", lambda: ("not allowed",))
    bridge = Bridge(CODEC, REVISION, CARS["2026"], now_ns=time.monotonic_ns())
    loop = BridgeLoop(bridge, CODEC, spec, real_time=True)
    loop.start()
    with open_bus(spec) as car:
        status_heard(car)
    loop.stop()
    assert loop.scheduling_refused == ("not allowed",) and loop.failure is None


@pytest.mark.parametrize("listen_only", [False, True])
def test_a_full_garbage_collection_is_rare_whether_it_sends_or_only_listens(
    spec: str, monkeypatch: pytest.MonkeyPatch, listen_only: bool
) -> None:
    collected: list[int] = []
    monkeypatch.setattr(loop_module.gc, "collect", lambda generation=2: collected.append(generation))
    loop = make_loop(spec, BridgeConfig(listen_only=listen_only))
    loop.start()
    try:
        assert eventually(lambda: len(collected) > 30)
    finally:
        loop.stop()
    assert collected.count(2) == 1, "only the one before the first turn"


def test_a_cycle_that_was_made_in_time_and_leaves_late_is_a_fault_of_the_loop(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    held = threading.Event()
    encode = loop._codec.encode_command

    def slow_once(*args: Any) -> Any:
        if not held.is_set():
            held.set()
            threading.Event().wait(0.3)
        return encode(*args)

    monkeypatch.setattr(loop._bridge, "loop_fault", lambda why, _now_ns: said.append(why))
    monkeypatch.setattr(loop._codec, "encode_command", slow_once)
    assert eventually(lambda: any(int(why.split()[4]) >= 300 for why in said))


def test_a_question_that_was_not_answered_in_time_is_not_done_later_but_an_emergency_is(
    loop: BridgeLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[object] = []

    def do(*what: object) -> tuple[bool, str]:
        done.append(what[0])
        return True, "done"

    for name in ("set_mode", "reset", "emergency_brake"):
        monkeypatch.setattr(loop._bridge, name, do)
    monkeypatch.setattr(loop_module, "_REQUEST_TIMEOUT_S", 0.05)
    go_on, hangs = threading.Event(), threading.Event()

    def hang(_now_ns: int) -> None:
        hangs.set()
        go_on.wait(WAIT_S)

    loop._requests.put((hang, Future()))
    assert hangs.wait(WAIT_S)
    try:
        refused = (False, "the CAN loop does not answer")
        assert loop.set_mode("autonomous") == loop.reset() == loop.emergency_brake("now") == refused
    finally:
        go_on.set()
    assert eventually(lambda: done == ["now"])
    assert not eventually_within(0.1, lambda: done != ["now"])


def test_after_its_end_a_question_is_answered_at_once(loop: BridgeLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "_REQUEST_TIMEOUT_S", 1e9)
    loop.stop()
    assert loop.emergency_brake("late") == (False, "the CAN loop does not run: nothing is sent")


def test_the_emergency_request_goes_out_before_anything_is_logged(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    last_words = loop._last_words

    def broken(frame: object) -> None:
        raise RuntimeError("a bug")

    def speak(why: str) -> None:
        order.append("request")
        last_words(why)

    monkeypatch.setattr(loop, "_last_words", speak)
    monkeypatch.setattr(loop_module.logger, "exception", lambda *_: order.append("log"))
    monkeypatch.setattr(loop._bridge, "on_frame", broken)
    with open_bus(spec) as car:
        car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF)))
        assert eventually(lambda: not loop.running)
    assert order == ["request", "log"]


def test_while_the_bus_is_gone_the_watchdog_is_fed_and_a_stop_does_not_hang(
    spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(WAIT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "20000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        loop = make_loop(spec)
        loop.start()
        attempts: list[int] = []

        def absent(*args: object, **kwargs: object) -> CanBus:
            attempts.append(1)
            raise BusError("no such device")

        def gone(self: CanBus, timeout_s: float) -> None:
            raise BusLost("Network is down")

        monkeypatch.setattr(loop_module, "open_bus", absent)
        monkeypatch.setattr(CanBus, "recv", gone)
        assert eventually(lambda: len(attempts) >= 2)
        systemd.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                systemd.recv(64)
        systemd.setblocking(True)
        systemd.settimeout(WAIT_S)
        assert systemd.recv(64) == b"WATCHDOG=1"
        assert loop.report().bus_lost == "Network is down"
        loop.stop()
        assert not loop.running and loop.failure is None


def test_it_does_not_open_a_lost_bus_again_before_two_sends_may_follow_each_other(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    times: list[int] = []

    def open_again(*args: object, **kwargs: object) -> CanBus:
        times.append(time.monotonic_ns())
        return open_bus(spec)

    def gone(self: CanBus, timeout_s: float) -> None:
        monkeypatch.setattr(CanBus, "recv", original)
        times.append(time.monotonic_ns())
        raise BusLost("bus-off")

    original = CanBus.recv
    monkeypatch.setattr(loop_module, "open_bus", open_again)
    monkeypatch.setattr(CanBus, "recv", gone)
    assert eventually(lambda: loop.reopened == 1)
    lost_ns, opened_ns = times
    assert opened_ns - lost_ns >= MIN_GAP_NS


def test_a_queue_that_stays_full_is_a_lost_bus_opened_again_ever_more_seldom_until_a_cycle_goes_out(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    opened: list[int] = []
    lost: list[int] = []

    def open_again(*args: object, **kwargs: object) -> CanBus:
        opened.append(time.monotonic_ns())
        return open_bus(spec)

    def close(self: CanBus) -> None:
        lost.append(time.monotonic_ns())
        original_close(self)

    original_send, original_close = CanBus.send, CanBus.close
    monkeypatch.setattr(loop_module, "open_bus", open_again)
    with open_bus(spec) as car:
        status_heard(car)
        monkeypatch.setattr(CanBus, "close", close)
        monkeypatch.setattr(CanBus, "send", lambda self, frame: False)
        assert eventually(lambda: len(opened) >= 4)
        monkeypatch.setattr(CanBus, "send", original_send)
        monkeypatch.setattr(CanBus, "close", original_close)
        status_heard(car)
    pauses_ms = [(there - gone) / 1e6 for gone, there in zip(lost, opened, strict=False)]
    assert all(pause >= least for pause, least in zip(pauses_ms, (10, 20, 40, 80), strict=False)), pauses_ms
    told = [record.getMessage() for record in caplog.records if record.levelname in ("ERROR", "WARNING")]
    assert len([line for line in told if "no complete cycle sent for" in line]) == 1, told
    assert eventually(lambda: loop.report().bus_lost is None and loop._pause_s == loop_module._REOPEN_FIRST_S)


def test_a_single_full_queue_is_dropped_and_counted_and_the_bus_stays_open(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    dropped: list[int] = []

    def drop_three(self: CanBus, frame: Frame) -> bool:
        if len(dropped) < 3:
            dropped.append(frame.can_id)
            return False
        return original(self, frame)

    original = CanBus.send
    with open_bus(spec) as car:
        status_heard(car)
        monkeypatch.setattr(CanBus, "send", drop_three)
        assert eventually(lambda: len(dropped) == 3)
        status_heard(car)
    # The first may be any frame of a cycle that was just being sent; the rest of that cycle is not.
    assert dropped[1:] == [0x510] * 2
    assert eventually(lambda: loop.report().incomplete_cycles == 3)
    assert loop.reopened == 0


def test_the_loops_own_bus_takes_no_other_id_than_the_five(loop: BridgeLoop) -> None:
    assert loop._bus is not None
    for can_id in (0x501, 0x50F, 0x515, 0x520, 0x600):
        with pytest.raises(ValueError, match="must never be transmitted"):
            loop._bus.send(Frame(can_id, b"\x00"))


def test_somebody_else_on_our_ids_is_heard_and_its_own_frames_are_not(loop: BridgeLoop, spec: str) -> None:
    with open_bus(spec) as other:
        status_heard(other)
        assert "intruder" not in loop.report().reason_counts
        other.send(Frame(0x513, b"\x00\x00"))
        assert eventually(lambda: loop.report().reason_details.get("intruder") == "0x513 [00 00]")


def test_a_stop_while_moving_leaves_the_car_to_its_emergency_brake_and_then_is_silent(spec: str) -> None:
    loop = make_loop(spec)
    loop.start()
    over = threading.Event()
    heard: list[AiStatus] = []

    def talk() -> None:
        with open_bus(spec) as car:
            while not over.is_set():
                car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True)))
                car.send(CODEC.encode(WheelSpeeds(200, 200, 200, 200)))
                until = time.monotonic() + 0.01
                while (left_s := until - time.monotonic()) > 0:
                    frame = car.recv(left_s)
                    image = None if frame is None else CODEC.decode(frame).image
                    if isinstance(image, AiStatus):
                        heard.append(image)

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        assert eventually(lambda: bool(heard))
        before = len(heard)
        loop.stop()
        assert not loop.running and loop.report().emergency is not None
        assert "this software was stopped" in loop.report().emergency
        assert eventually(lambda: len(heard) >= before + 5)
        sent = len(heard)
        assert not eventually_within(0.1, lambda: len(heard) > sent), "it still sends after its stop"
    finally:
        over.set()
        talker.join()
    assert all(status.estop_request and status.direction is Direction.FORWARD for status in heard[-5:])
    assert not heard[-6].estop_request


def test_a_hang_is_told_before_the_first_cycle_after_it(loop: BridgeLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    cycle = loop._bridge.cycle

    def cycle_noted(now_ns: int) -> object:
        order.append("cycle")
        return cycle(now_ns)

    def hang(_now_ns: int) -> None:
        threading.Event().wait(0.3)
        order.append("hung")

    monkeypatch.setattr(loop._bridge, "loop_fault", lambda *_: order.append("fault"))
    monkeypatch.setattr(loop._bridge, "cycle", cycle_noted)
    loop._requests.put((hang, Future()))
    assert eventually(lambda: "hung" in order and "cycle" in order[order.index("hung") :])
    assert order[order.index("hung") + 1] == "fault"


def test_the_watchdog_is_not_fed_by_cycles_that_missed_their_deadline(
    spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(WAIT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "2000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        loop = make_loop(spec)
        late = threading.Event()
        monkeypatch.setattr(loop, "_missed", lambda *_: late.is_set())
        late.set()
        loop.start()
        first_ns = loop.report().t_ns
        assert eventually(lambda: loop.report().t_ns - first_ns > 100_000_000)
        assert systemd.recv(64) == b"READY=1"
        systemd.setblocking(False)
        with pytest.raises(BlockingIOError):
            systemd.recv(64)
        systemd.settimeout(WAIT_S)
        late.clear()
        assert systemd.recv(64) == b"WATCHDOG=1"
        loop.stop()


def test_no_garbage_is_collected_by_surprise_while_it_runs(loop: BridgeLoop) -> None:
    assert not gc.isenabled()
    loop.stop()
    assert gc.isenabled()


def test_after_a_pause_all_that_waited_is_heard_before_the_next_cycle(
    loop: BridgeLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames that waited in the socket look new and are not: the oldest of them says nothing about now."""
    heard: list[str] = []
    cycle, on_frame = loop._bridge.cycle, loop._bridge.on_frame
    hangs, go_on = threading.Event(), threading.Event()

    def hang(_now_ns: int) -> None:
        hangs.set()
        go_on.wait(WAIT_S)
        heard.clear()

    def cycle_noted(now_ns: int) -> object:
        heard.append("cycle")
        return cycle(now_ns)

    def frame_noted(frame: Frame) -> None:
        heard.append("frame")
        on_frame(frame)

    monkeypatch.setattr(loop._bridge, "cycle", cycle_noted)
    monkeypatch.setattr(loop._bridge, "on_frame", frame_noted)
    with open_bus(spec) as car:
        loop._requests.put((hang, Future()))
        assert hangs.wait(WAIT_S)
        for _ in range(20):
            car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF)))
        threading.Event().wait(0.1)  # long enough for a deadline to be missed
        go_on.set()
        assert eventually(lambda: "cycle" in heard)
    assert heard[: heard.index("cycle")].count("frame") >= 19, "the frame in hand when it hung may be one of them"
