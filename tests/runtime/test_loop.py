"""The real-time loop on a bus, in a thread here: its turns, its edge's link, and a bus that goes away."""

from __future__ import annotations

import contextlib
import gc
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from loop_rig import CODEC, WAIT_S, ThreadedLoop, drop_all, eventually, eventually_within, make_loop, status_heard

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiStatus, VcuStatus, WheelSpeeds
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.runtime import loop as loop_module
from fsai_vcu.runtime import loop_handle as handle_module
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.link import Ended
from fsai_vcu.runtime.lock import AlreadyRunning
from fsai_vcu.runtime.pacing import MIN_GAP_NS


@pytest.fixture
def spec() -> str:
    return f"loopback:{uuid.uuid4()}"


@pytest.fixture
def loop(spec: str) -> Iterator[ThreadedLoop]:
    made = make_loop(spec)
    made.start()
    yield made
    made.stop()


def test_without_a_car_it_sends_idle_frames_by_its_own_clock(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as car:
        heard = [frame for frame in (car.recv(1.0) for _ in range(25)) if frame is not None]
    assert {frame.can_id for frame in heard} == set(AI_IDS)
    decoded = [CODEC.decode(frame).image for frame in heard if frame.can_id == 0x510]
    assert all(isinstance(i, AiStatus) and i.mission_status is MissionStatus.NOT_SELECTED for i in decoded)


def test_the_handshake_bit_is_echoed_in_the_answer(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as car:
        for bit in (True, False, True, True, False):
            car.send(CODEC.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)))
            assert eventually(lambda bit=bit: status_heard(car).handshake is bit)


def test_a_request_is_answered_and_shows_in_the_next_report(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as car:
        car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF, ami=Ami.AUTOCROSS)))
        assert eventually(lambda: loop.report().run.as_state is AsState.AS_OFF)
        accepted, message = loop.set_mode("autonomous")
        assert accepted, message
        assert eventually(lambda: loop.report().mode == "autonomous")


def test_an_unknown_mode_is_refused_with_the_valid_ones(loop: ThreadedLoop) -> None:
    accepted, message = loop.set_mode("sport")
    assert not accepted
    assert "autonomous" in message and "manual" in message and "sport" in message


def test_a_command_that_is_not_finite_is_refused_whole(loop: ThreadedLoop) -> None:
    loop.submit_command(VehicleCommand(time.monotonic_ns(), loop.report().run.run_id, throttle=float("nan")))
    assert eventually(lambda: any("refused" in name for name in loop.report().reason_counts))


def test_selected_is_sent_once_both_roles_have_confirmed(loop: ThreadedLoop, spec: str) -> None:
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


def test_a_second_bridge_on_the_interface_refuses_to_start(loop: ThreadedLoop, spec: str) -> None:
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
    assert second.failure == ""


def test_it_comes_back_by_itself_when_the_bus_does(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The interface goes down under the loop and is missing for a while."""
    attempts: list[int] = []

    def absent_twice(*args: object, **kwargs: object) -> CanBus:
        attempts.append(1)
        if len(attempts) < 3:
            raise BusError("no such device")
        return open_bus(spec)

    def gone(self: CanBus) -> None:
        monkeypatch.setattr(CanBus, "drain", original)
        raise BusLost("Network is down")

    original = CanBus.drain
    monkeypatch.setattr(loop_module, "open_bus", absent_twice)
    monkeypatch.setattr(CanBus, "drain", gone)
    assert eventually(lambda: loop.loop_report().reopened == 1)
    assert len(attempts) == 3
    with open_bus(spec) as car:
        status_heard(car)


def test_an_exception_in_the_loop_sends_an_emergency_request(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_bus(spec) as car:
        driving = CODEC.encode(VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True))
        car.send(driving)
        assert eventually(lambda: loop.report().run.as_state is AsState.AS_DRIVING)
        status_heard(car)  # it has listened for its first 200 ms and speaks

        def broken(frame: object) -> None:
            raise RuntimeError("a bug")

        monkeypatch.setattr(loop.loop._bridge, "on_frame", broken)
        car.send(driving)
        assert eventually(lambda: not loop.running)
        last: AiStatus | None = None
        while (frame := car.recv(0.0)) is not None:
            image = CODEC.decode(frame).image
            last = image if isinstance(image, AiStatus) else last
    assert loop.failure == "RuntimeError: a bug"
    assert last is not None and last.estop_request


def test_whatever_keeps_it_from_starting_the_lock_is_free_again(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> CanBus:
        raise OSError("Too many open files")

    with monkeypatch.context() as patched:
        patched.setattr(loop_module, "open_bus", refuse)
        with pytest.raises(OSError, match="Too many") as kept:  # and with it all that the constructor held
            make_loop(spec)
    again = make_loop(spec)
    again.start()
    again.stop()
    assert kept.value


def test_a_failure_at_the_start_is_reported_and_closes_the_bus(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> tuple[str, ...]:
        raise RuntimeError("no such call")

    monkeypatch.setattr(loop_module, "go_real_time", refuse)
    loop = ThreadedLoop(spec, real_time=True)
    loop.start()
    assert eventually(lambda: not loop.running)
    assert loop.failure == "RuntimeError: no such call" and loop.loop._bus is None
    loop.stop()


def test_refused_real_time_scheduling_is_only_reported(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "go_real_time", lambda: ("not allowed",))
    loop = ThreadedLoop(spec, real_time=True)
    loop.start()
    with open_bus(spec) as car:
        status_heard(car)
    loop.stop()
    assert loop.loop_report().scheduling_refused == ("not allowed",) and loop.failure == ""


@pytest.mark.parametrize("listen_only", [False, True])
def test_full_garbage_collections_are_rare_in_any_mode(
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


def test_a_cycle_made_in_time_but_sent_late_is_a_loop_fault(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    held = threading.Event()
    encode = loop.loop._codec.encode_command

    def slow_once(*args: Any) -> Any:
        if not held.is_set():
            held.set()
            threading.Event().wait(0.3)
        return encode(*args)

    monkeypatch.setattr(loop.loop._bridge, "loop_fault", lambda why, _now_ns: said.append(why))
    monkeypatch.setattr(loop.loop._codec, "encode_command", slow_once)
    assert eventually(lambda: any(int(why.split()[4]) >= 300 for why in said))


def hang_in(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch, hang: Callable[[], object]) -> None:
    """`hang` is called once in the loop's thread, between its reading of the bus and its sending."""
    monkeypatch.setattr(loop.loop._bridge, "on_reset_confirmed", lambda *_: hang())
    loop.confirm_reset("planner", 1)


def test_a_late_request_is_refused_but_an_emergency_is_done(
    loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What nobody waits for any more is not done behind his back, unless it is better late than never."""
    done: list[object] = []

    def do(*what: object) -> tuple[bool, str]:
        done.append(what[0])
        return True, "done"

    for name in ("set_mode", "reset", "emergency_brake"):
        monkeypatch.setattr(loop.loop._bridge, name, do)
    monkeypatch.setattr(handle_module, "REQUEST_TIMEOUT_S", 0.05)
    go_on, hangs = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        go_on.wait(WAIT_S)

    hang_in(loop, monkeypatch, hang)
    assert hangs.wait(WAIT_S)
    try:
        refused = (False, "the CAN loop does not answer")
        assert loop.set_mode("autonomous") == loop.reset() == loop.emergency_brake("now") == refused
    finally:
        go_on.set()
    assert eventually(lambda: done == ["now"])
    assert not eventually_within(0.1, lambda: done != ["now"])


def test_after_its_end_a_request_is_answered_at_once(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handle_module, "REQUEST_TIMEOUT_S", 1e9)
    loop.stop()
    assert loop.emergency_brake("late") == (False, "the CAN loop does not run: nothing is sent")


def test_the_emergency_request_goes_out_before_any_logging(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    last_words = loop.loop._last_words

    def broken(frame: object) -> None:
        raise RuntimeError("a bug")

    def speak(why: str) -> None:
        order.append("request")
        last_words(why)

    monkeypatch.setattr(loop.loop, "_last_words", speak)
    monkeypatch.setattr(loop_module.logger, "exception", lambda *_: order.append("log"))
    monkeypatch.setattr(loop.loop._bridge, "on_frame", broken)
    with open_bus(spec) as car:
        car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF)))
        assert eventually(lambda: not loop.running)
    assert order == ["request", "log"]


def test_the_watchdog_is_fed_and_a_stop_works_without_the_bus(
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

        def gone(self: CanBus) -> None:
            raise BusLost("Network is down")

        monkeypatch.setattr(loop_module, "open_bus", absent)
        monkeypatch.setattr(CanBus, "drain", gone)
        assert eventually(lambda: len(attempts) >= 2)
        systemd.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                systemd.recv(64)
        systemd.setblocking(True)
        systemd.settimeout(WAIT_S)
        assert systemd.recv(64) == b"WATCHDOG=1"
        # In the longest pause between two tries to open it, too.
        assert eventually(lambda: loop.loop._pause_s == loop_module._REOPEN_MOST_S)
        for _ in range(20):
            assert any("the bus is lost: Network is down" in line for line in loop.report().why_not_driving)
            threading.Event().wait(0.02)
        loop.stop()
        assert not loop.running and loop.failure == ""


def test_a_lost_bus_is_opened_again_only_after_the_minimum_gap(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    times: list[int] = []

    def open_again(*args: object, **kwargs: object) -> CanBus:
        times.append(time.monotonic_ns())
        return open_bus(spec)

    def gone(self: CanBus) -> None:
        monkeypatch.setattr(CanBus, "drain", original)
        times.append(time.monotonic_ns())
        raise BusLost("bus-off")

    original = CanBus.drain
    monkeypatch.setattr(loop_module, "open_bus", open_again)
    monkeypatch.setattr(CanBus, "drain", gone)
    assert eventually(lambda: loop.loop_report().reopened == 1)
    lost_ns, opened_ns = times
    assert opened_ns - lost_ns >= MIN_GAP_NS


def test_a_queue_that_stays_full_reopens_the_bus_ever_less_often(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
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
    assert eventually(lambda: loop.report().bus_lost is None and loop.loop._pause_s == loop_module._REOPEN_FIRST_S)


def test_a_single_full_queue_is_counted_and_the_bus_stays_open(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
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
    assert loop.loop_report().reopened == 0


def test_the_loops_own_bus_takes_no_other_id_than_the_five(loop: ThreadedLoop) -> None:
    assert loop.loop._bus is not None
    for can_id in (0x501, 0x50F, 0x515, 0x520, 0x600):
        with pytest.raises(ValueError, match="must never be transmitted"):
            loop.loop._bus.send(Frame(can_id, b"\x00"))


def test_others_on_our_ids_are_received_and_own_frames_not(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as other:
        status_heard(other)
        assert "intruder" not in loop.report().reason_counts
        other.send(Frame(0x513, b"\x00\x00"))
        assert eventually(lambda: loop.report().reason_details.get("intruder") == "0x513 [00 00]")


def test_a_stop_while_moving_requests_emergency_then_is_silent(spec: str) -> None:
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


def test_a_hang_is_told_before_the_first_cycle_after_it(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    cycle = loop.loop._bridge.cycle

    def cycle_noted(now_ns: int) -> object:
        order.append("cycle")
        return cycle(now_ns)

    def hang() -> None:
        threading.Event().wait(0.3)
        order.append("hung")

    monkeypatch.setattr(loop.loop._bridge, "loop_fault", lambda *_: order.append("fault"))
    monkeypatch.setattr(loop.loop._bridge, "cycle", cycle_noted)
    hang_in(loop, monkeypatch, hang)
    assert eventually(lambda: "hung" in order and "cycle" in order[order.index("hung") :])
    assert order[order.index("hung") + 1] == "fault"


def test_cycles_past_their_deadline_do_not_feed_the_watchdog(
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
        monkeypatch.setattr(loop.loop, "_missed", lambda *_: late.is_set())
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


def test_a_silent_edge_starves_the_watchdog_but_in_a_drive(
    spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(WAIT_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "2000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        monkeypatch.setattr(loop_module, "EDGE_HUNG_NS", 0)
        loop = make_loop(spec)
        loop.start()
        first_ns = loop.report().t_ns
        assert eventually(lambda: loop.report().t_ns - first_ns > 100_000_000)
        assert systemd.recv(64) == b"READY=1"
        systemd.setblocking(False)
        with pytest.raises(BlockingIOError):
            systemd.recv(64)
        systemd.settimeout(WAIT_S)
        with open_bus(spec) as car:
            car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True)))
            assert systemd.recv(64) == b"WATCHDOG=1"
        loop.stop()


def test_no_garbage_is_collected_by_surprise_while_it_runs(loop: ThreadedLoop) -> None:
    assert not gc.isenabled()
    loop.stop()
    assert gc.isenabled()


def test_all_that_waited_is_received_before_the_next_answer(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The echo is the newest bit received, what waited is as old as it is, and the backlog is named with its age."""
    events: list[str] = []
    ages_ms: list[float] = []
    named: list[float] = []
    cycle, on_frame = loop.loop._bridge.cycle, loop.loop._bridge.on_frame
    hangs, go_on = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        go_on.wait(WAIT_S)
        events.clear()

    def cycle_noted(now_ns: int) -> object:
        events.append("cycle")
        return cycle(now_ns)

    def frame_noted(frame: Frame) -> None:
        events.append("frame")
        ages_ms.append((time.monotonic_ns() - frame.t_ns) / 1e6)
        on_frame(frame)

    monkeypatch.setattr(loop.loop._bridge, "cycle", cycle_noted)
    monkeypatch.setattr(loop.loop._bridge, "on_frame", frame_noted)
    monkeypatch.setattr(loop.loop._bridge, "backlog", lambda age_ns, _now_ns: named.append(age_ns / 1e6))
    with open_bus(spec) as car:
        hang_in(loop, monkeypatch, hang)
        assert hangs.wait(WAIT_S)
        for bit in [False] * 20 + [True]:
            car.send(CODEC.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)))
        threading.Event().wait(0.1)
        drop_all(car)
        go_on.set()
        assert eventually(lambda: "cycle" in events)
        while not (answer := status_heard(car)).handshake:
            pass
    # The cycle of the turn that hung comes first; then everything is read at once.
    turn = events[events.index("frame") :]
    assert turn[: turn.index("cycle")].count("frame") == 21
    assert answer.handshake
    assert max(ages_ms) >= 100.0 and max(named) >= 100.0


# ---------------------------------------------------------------- the edge


def test_a_gone_edge_ends_a_loop_whose_car_is_not_driving(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as car:
        status_heard(car)
        loop._link.close()
        loop.thread.join(WAIT_S)
        assert not loop.thread.is_alive()
        drop_all(car)
        assert car.recv(0.1) is None


def test_a_gone_edge_leaves_a_driving_car_to_the_reactions(loop: ThreadedLoop, spec: str) -> None:
    """It is braked by the table of reactions, not by the end of the software: no ESTOP_REQUEST, no silence."""
    statuses: list[AiStatus] = []
    over = threading.Event()

    def talk() -> None:
        with open_bus(spec) as vcu:
            while not over.is_set():
                state = VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True, ami=Ami.AUTOCROSS)
                vcu.send(CODEC.encode(state))
                vcu.send(CODEC.encode(WheelSpeeds(200, 200, 200, 200)))
                until = time.monotonic() + 0.01
                while (left_s := until - time.monotonic()) > 0:
                    frame = vcu.recv(left_s)
                    image = None if frame is None else CODEC.decode(frame).image
                    if isinstance(image, AiStatus):
                        statuses.append(image)

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        assert eventually(lambda: len(statuses) > 5 and statuses[-1].mission_status is MissionStatus.RUNNING)
        loop._link.close()
        before = len(statuses)
        assert eventually(lambda: len(statuses) > before + 20)
        assert not any(status.estop_request for status in statuses)
        assert loop.thread.is_alive()
    finally:
        over.set()
        talker.join()
    loop.thread.join(WAIT_S)
    assert not loop.thread.is_alive(), "with the car silent there is nothing left to do"


def test_an_edge_that_does_not_read_keeps_the_loop_from_nothing(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as car:
        for bit in (True, False) * 200:
            car.send(CODEC.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)))
            while status_heard(car).handshake is not bit:
                pass
        assert eventually(lambda: loop.far_end.dropped > 0)
    assert eventually(lambda: loop.report().run.as_state is AsState.AS_OFF)


def test_why_it_ended_is_not_lost_on_a_full_link(loop: ThreadedLoop, spec: str) -> None:
    """An edge that hung while the loop failed reads everything in the end, the reason included."""
    with open_bus(spec) as car:
        for _ in range(500):
            car.send(CODEC.encode(VcuStatus(as_state=AsState.AS_OFF)))
            status_heard(car)
    assert eventually(lambda: loop.far_end.dropped > 0)
    assert not loop.far_end.send(Ended("RuntimeError: a bug"))
    loop._take()
    assert loop.failure == ""
    assert eventually(lambda: not loop.running)
    assert loop.failure == "RuntimeError: a bug"
    loop._link.close()


def test_a_loop_that_is_silent_looks_like_a_silent_car(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on, hangs = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        go_on.wait(WAIT_S)

    hang_in(loop, monkeypatch, hang)
    assert hangs.wait(WAIT_S)
    try:
        assert eventually(lambda: loop.report().why_not_driving[0].startswith("the CAN loop has reported nothing for"))
        assert loop.report().vcu_lost and not loop.report().standing
    finally:
        go_on.set()
    assert eventually(lambda: not loop.report().why_not_driving[0].startswith("the CAN loop"))


def test_a_loop_that_failed_is_reported_as_such(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise RuntimeError("a bug")

    hang_in(loop, monkeypatch, fail)
    assert eventually(lambda: not loop.running)
    assert loop.report().why_not_driving == ("the CAN loop ended by itself: RuntimeError: a bug",)
    assert loop.set_mode("autonomous") == (False, "the CAN loop does not run: nothing is sent")


def test_of_several_commands_that_wait_the_newest_counts(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    go_on = threading.Event()
    monkeypatch.setattr(loop.loop._bridge, "on_command", lambda command, _now_ns: taken.append(command.laps))
    hang_in(loop, monkeypatch, lambda: go_on.wait(WAIT_S))
    for laps in range(5):
        loop.submit_command(VehicleCommand(time.monotonic_ns(), 1, laps=laps))
    go_on.set()
    assert eventually(lambda: bool(taken)) and taken[-1] == 4 and len(taken) <= 2
