"""The real-time loop on a bus, in a thread here: its turns, its edge's link, and a bus that goes away."""

from __future__ import annotations

import contextlib
import gc
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from loop_rig import (
    CODEC,
    PATIENT,
    WAIT_NS,
    WAIT_S,
    ThreadedLoop,
    drop_all,
    eventually,
    eventually_within,
    moving_car,
    status_received,
    systemd,
    told_nothing,
)

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.enums import AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiStatus, VcuStatus
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.runtime import loop as loop_module
from fsai_vcu.runtime import loop_handle as handle_module
from fsai_vcu.runtime import turns as turns_module
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.link import Ended
from fsai_vcu.runtime.pacing import MIN_GAP_NS


@contextlib.contextmanager
def running(spec: str, config: BridgeConfig | None = None, *, real_time: bool = False) -> Iterator[ThreadedLoop]:
    made = ThreadedLoop(spec, config, real_time=real_time)
    made.start()
    try:
        yield made
    finally:
        made.stop()


@pytest.fixture
def loop(spec: str) -> Iterator[ThreadedLoop]:
    with running(spec) as made:
        yield made


def failing(error: type[Exception], words: str) -> Callable[..., Any]:
    """A function that raises that error, whatever it is given."""

    def fail(*_: object, **__: object) -> Any:
        raise error(words)

    return fail


def test_without_a_car_it_sends_the_five_idle_frames_alone(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as car:
        received = [frame for frame in (car.recv(1.0) for _ in range(25)) if frame is not None]
    assert {frame.can_id for frame in received} == set(AI_IDS)
    decoded = [CODEC.decode(frame).image for frame in received if frame.can_id == 0x510]
    assert all(isinstance(i, AiStatus) and i.mission_status is MissionStatus.NOT_SELECTED for i in decoded)
    assert loop.loop._bus is not None
    for can_id in (0x501, 0x520):
        with pytest.raises(ValueError, match="must never be transmitted"):
            loop.loop._bus.send(Frame(can_id, bytes(8)))


def test_it_comes_back_by_itself_when_the_bus_does(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The interface is missing for a while; not even the first try comes before the minimum gap."""
    attempts_ns: list[int] = []
    lost_ns: list[int] = []

    def absent_twice(*args: object, **kwargs: object) -> CanBus:
        attempts_ns.append(time.monotonic_ns())
        if len(attempts_ns) < 3:
            raise BusError("no such device")
        return open_bus(spec)

    def gone(self: CanBus) -> None:
        monkeypatch.setattr(CanBus, "drain", original)
        lost_ns.append(time.monotonic_ns())
        raise BusLost("Network is down")

    original = CanBus.drain
    monkeypatch.setattr(loop_module, "open_bus", absent_twice)
    monkeypatch.setattr(CanBus, "drain", gone)
    assert eventually(lambda: loop.loop_report().reopened == 1)
    assert len(attempts_ns) == 3 and attempts_ns[0] - lost_ns[0] >= MIN_GAP_NS
    with open_bus(spec) as car:
        status_received(car)


def test_an_exception_in_the_loop_sends_an_emergency_request(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_bus(spec) as car:
        driving = CODEC.encode(VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True))
        car.send(driving)
        assert eventually(lambda: loop.report().run.as_state is AsState.AS_DRIVING)
        status_received(car)  # it has listened for its first 200 ms and speaks

        def speak(why: str) -> None:
            order.append("request")
            last_words(why)

        order: list[str] = []
        last_words = loop.loop._last_words
        monkeypatch.setattr(loop.loop, "_last_words", speak)
        monkeypatch.setattr(loop_module.logger, "exception", lambda *_: order.append("log"))
        monkeypatch.setattr(loop.loop._bridge, "on_frame", failing(RuntimeError, "a bug"))
        drop_all(car)  # a full bus would drop the last words
        car.send(driving)
        assert eventually(lambda: not loop.running)
        last: AiStatus | None = None
        while (frame := car.recv(0.0)) is not None:
            image = CODEC.decode(frame).image
            last = image if isinstance(image, AiStatus) else last
    assert loop.failure == "RuntimeError: a bug"
    assert loop.report().why_not_driving == ("the CAN loop ended by itself: RuntimeError: a bug",)
    assert loop.set_mode("autonomous") == (False, "the CAN loop does not run: nothing is sent")
    assert last is not None and last.estop_request
    assert order == ["request", "log"]


def test_whatever_keeps_it_from_starting_the_lock_is_free_again(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(loop_module, "open_bus", failing(OSError, "Too many open files"))
        with pytest.raises(OSError, match="Too many") as kept:  # and with it all that the constructor held
            ThreadedLoop(spec)
    with running(spec):
        assert kept.value


def test_a_failure_at_the_start_is_reported_and_closes_the_bus(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "go_real_time", failing(RuntimeError, "no such call"))
    with running(spec, real_time=True) as loop:
        assert eventually(lambda: not loop.running)
        assert loop.failure == "RuntimeError: no such call"
    assert loop.loop._bus is None  # closed after the failure is said


def test_refused_real_time_scheduling_is_only_reported(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "go_real_time", lambda: ("not allowed",))
    with running(spec, real_time=True) as loop:
        assert eventually(lambda: loop.loop_report().scheduling_refused == ("not allowed",))
    assert loop.failure == ""


@pytest.mark.parametrize("listen_only", [False, True])
def test_full_garbage_collections_are_rare_in_any_mode(
    spec: str, monkeypatch: pytest.MonkeyPatch, listen_only: bool
) -> None:
    collected: list[int] = []
    monkeypatch.setattr(loop_module.gc, "collect", lambda generation=2: collected.append(generation))
    with running(spec, BridgeConfig(listen_only=listen_only)):
        assert not gc.isenabled(), "none comes by surprise"
        assert eventually(lambda: len(collected) > 30)
    assert collected.count(2) == 1, "only the one before the first turn"
    assert gc.isenabled()


def test_a_cycle_made_in_time_but_sent_late_is_a_loop_fault(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    encode = CODEC.encode_command

    def named() -> bool:
        return any(int(why.split()[4]) >= 300 for why in said)

    def slow_until_named(*args: Any) -> Any:
        if not named():  # a cycle that was late before it was made has been named for that
            threading.Event().wait(0.3)
        return encode(*args)

    monkeypatch.setattr(loop.loop._bridge, "loop_fault", lambda why, _now_ns: said.append(why))
    monkeypatch.setattr(CODEC, "encode_command", slow_until_named)
    assert eventually(named)


@contextlib.contextmanager
def hanging(
    loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch, then: Callable[[], object] = lambda: None
) -> Iterator[None]:
    """The loop's thread hangs between its reading of the bus and its sending until the block ends; it does `then`."""
    go_on, hangs = threading.Event(), threading.Event()

    def hang(*_: object) -> None:
        hangs.set()
        go_on.wait(WAIT_S)
        then()

    monkeypatch.setattr(loop.loop._bridge, "on_reset_confirmed", hang)
    loop.confirm_reset("planner", 1)
    assert hangs.wait(WAIT_S)
    try:
        yield
    finally:
        go_on.set()


def test_a_late_request_is_refused_but_an_emergency_is_done(
    loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A call that nobody waits for any more is not done behind his back, unless it is better late than never."""
    done: list[object] = []

    def do(*what: object) -> tuple[bool, str]:
        done.append(what[0])
        return True, "done"

    for name in ("set_mode", "reset", "emergency_brake"):
        monkeypatch.setattr(loop.loop._bridge, name, do)
    monkeypatch.setattr(handle_module, "REQUEST_TIMEOUT_S", 0.05)
    with hanging(loop, monkeypatch):
        refused = (False, "the CAN loop does not answer")
        assert loop.set_mode("autonomous") == loop.reset() == loop.emergency_brake("now") == refused
    assert eventually(lambda: done == ["now"])
    assert not eventually_within(0.1, lambda: done != ["now"])


def test_the_watchdog_is_fed_and_a_stop_works_without_the_bus(
    spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turns_module, "EDGE_HUNG_NS", WAIT_NS)
    with systemd(tmp_path, monkeypatch, 20_000) as told, running(spec) as loop:
        monkeypatch.setattr(loop_module, "open_bus", failing(BusError, "no such device"))
        monkeypatch.setattr(CanBus, "drain", failing(BusLost, "Network is down"))
        # In the longest pause between two tries to open it, too.
        assert eventually(lambda: loop.loop._turns._pause_ns == turns_module.REOPEN_MOST_NS)
        while not told_nothing(told):
            pass
        assert told.recv(64) == b"WATCHDOG=1"

        def reports_it() -> bool:
            threading.Event().wait(0.02)
            return any("the bus is lost: Network is down" in line for line in loop.report().why_not_driving)

        assert eventually(lambda: all(reports_it() for _ in range(20))), "longer than a loop may be silent"
        loop.stop()
        assert not loop.running and loop.failure == ""


def test_a_queue_that_stays_full_reopens_the_bus(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    closed: list[CanBus] = []

    def close(self: CanBus) -> None:
        closed.append(self)
        original(self)

    original = CanBus.close
    with open_bus(spec) as car:
        status_received(car)
        with monkeypatch.context() as full:
            full.setattr(CanBus, "close", close)
            full.setattr(CanBus, "send", lambda *_: False)
            assert eventually(lambda: loop.loop_report().reopened >= 4)
            assert len(set(closed)) >= 4
        drop_all(car)
        status_received(car)
    told = [record.getMessage() for record in caplog.records if record.levelname in ("ERROR", "WARNING")]
    assert len([line for line in told if "no complete cycle sent for" in line]) == 1, told
    assert eventually(lambda: loop.report().bus_lost is None)


def test_a_single_full_queue_is_counted_and_the_bus_stays_open(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    dropped: list[int] = []

    def drop_three(self: CanBus, frame: Frame) -> bool:
        if len(dropped) < 3:
            dropped.append(frame.can_id)
            return False
        return original(self, frame)

    original = CanBus.send
    with running(spec, PATIENT) as loop, open_bus(spec) as car:
        status_received(car)
        monkeypatch.setattr(CanBus, "send", drop_three)
        assert eventually(lambda: len(dropped) == 3)
        drop_all(car)
        status_received(car)
        # The first may be any frame of a cycle that was just being sent; the rest of that cycle is not.
        assert dropped[1:] == [0x510] * 2
        assert eventually(lambda: loop.report().incomplete_cycles == 3)
        assert loop.loop_report().reopened == 0


def test_others_on_our_ids_are_received_and_own_frames_not(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as other:
        status_received(other)
        assert "intruder" not in loop.report().reason_counts
        other.send(Frame(0x513, b"\x00\x00"))
        assert eventually(lambda: loop.report().reason_details.get("intruder") == "0x513 [00 00]")


def test_a_stop_while_moving_requests_emergency_then_is_silent(spec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = ThreadedLoop(spec, PATIENT)
    monkeypatch.setattr(loop.loop._bridge, "loop_fault", lambda *_: None)  # nor does a held-up machine count
    loop.start()
    with moving_car(spec) as received:
        assert eventually(lambda: bool(received))
        loop.stop()
        assert not loop.running and loop.report().emergency is not None
        assert "this software was stopped" in loop.report().emergency
        assert eventually(lambda: sum(status.estop_request for status in received) == 5)
        sent = len(received)
        assert not eventually_within(0.1, lambda: len(received) > sent), "it still sends after its stop"
    assert all(status.estop_request and status.direction is Direction.FORWARD for status in received[-5:])


def test_a_turn_judges_its_deadline_reads_and_then_acts(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []

    def note(owner: object, name: str) -> None:
        def noted(*given: Any) -> Any:
            order.append(name)
            return original(*given)

        original = getattr(owner, name)
        monkeypatch.setattr(owner, name, noted)

    turns = loop.loop._turns
    turn = {"awake": turns, "drain": loop.loop._bus, "receive": loop.far_end, "on_frames": turns, "on_edge": turns}
    for name, owner in (turn | {"act": turns}).items():
        note(owner, name)
    assert eventually(lambda: len(order) > 80)
    begun = order.index("awake", -40)
    assert order[begun : begun + 12] == [*turn, "act"] * 2


def test_a_hang_is_told_before_the_first_cycle_after_it(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    cycle = loop.loop._bridge.cycle

    def cycle_noted(now_ns: int) -> object:
        order.append("cycle")
        return cycle(now_ns)

    monkeypatch.setattr(loop.loop._bridge, "loop_fault", lambda *_: order.append("fault"))
    monkeypatch.setattr(loop.loop._bridge, "cycle", cycle_noted)
    with hanging(loop, monkeypatch, then=lambda: order.append("hung")):
        threading.Event().wait(0.3)
    assert eventually(lambda: "hung" in order and "cycle" in order[order.index("hung") :])
    # In the turn that hung: before it where that was late already.
    hung = order.index("hung")
    begun = max((at for at in range(hung) if order[at] == "cycle"), default=-1) + 1
    assert "fault" in order[begun : order.index("cycle", hung)]


def test_cycles_past_their_deadline_do_not_feed_the_watchdog(
    spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turns_module, "EDGE_HUNG_NS", WAIT_NS)
    monkeypatch.setattr(turns_module, "DEADLINE_MISS_NS", -WAIT_NS)
    with systemd(tmp_path, monkeypatch, 2_000) as told, running(spec) as loop:
        first_ns = loop.report().t_ns
        assert eventually(lambda: loop.report().t_ns - first_ns > 100_000_000)
        assert told.recv(64) == b"READY=1"
        assert told_nothing(told)
        monkeypatch.setattr(turns_module, "DEADLINE_MISS_NS", WAIT_NS)
        assert told.recv(64) == b"WATCHDOG=1"


def test_all_that_waited_is_received_before_the_next_answer(
    loop: ThreadedLoop, spec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The echo is the newest bit received, what waited is as old as it is, and the backlog is named with its age."""
    events: list[str] = []
    ages_ms: list[float] = []
    named: list[float] = []
    cycle, on_frame = loop.loop._bridge.cycle, loop.loop._bridge.on_frame

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
        with hanging(loop, monkeypatch, then=events.clear):
            for bit in [False] * 20 + [True]:
                car.send(CODEC.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)))
            threading.Event().wait(0.1)
            drop_all(car)
        assert eventually(lambda: "cycle" in events)
        while not status_received(car).handshake:
            pass
    # The cycle of the turn that hung comes first; then everything is read at once.
    turn = events[events.index("frame") :]
    assert turn[: turn.index("cycle")].count("frame") == 21
    assert max(ages_ms) >= 100.0 and max(named) >= 100.0


# ---------------------------------------------------------------- the edge


def test_a_gone_edge_ends_a_loop_whose_car_is_not_driving(loop: ThreadedLoop, spec: str) -> None:
    with open_bus(spec) as car:
        status_received(car)
        loop._link.close()
        loop.thread.join(WAIT_S)
        assert not loop.thread.is_alive()
        drop_all(car)
        assert car.recv(0.1) is None


def test_an_edge_that_does_not_read_keeps_the_loop_from_nothing(loop: ThreadedLoop, spec: str) -> None:
    """Nor is lost why the loop ended meanwhile: an edge that hung reads everything in the end."""
    loop.far_end._lanes.ordinary.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 8192)  # some reports
    with open_bus(spec) as car:
        for bit in (True, False) * 20:
            car.send(CODEC.encode(VcuStatus(handshake=bit, as_state=AsState.AS_OFF)))
            while status_received(car).handshake is not bit:
                pass
        assert eventually(lambda: loop.far_end.trouble.dropped > 0)
    assert loop.far_end.send(Ended("RuntimeError: a bug"))
    assert eventually(lambda: loop.report().run.as_state is AsState.AS_OFF)
    assert eventually(lambda: not loop.running)
    assert loop.failure == "RuntimeError: a bug"
    loop._link.close()


def test_a_loop_that_is_silent_looks_like_a_silent_car(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handle_module, "LOOP_SILENT_NS", handle_module._NOT_READ_NS)  # a busy machine's pause is none
    with hanging(loop, monkeypatch):
        assert eventually(lambda: loop.report().why_not_driving[0].startswith("the CAN loop has reported nothing for"))
        assert loop.report().vcu_lost and not loop.report().standing
        loop._read_ns -= handle_module._NOT_READ_NS  # as if the edge had been held up itself
        assert not loop.silent, "its link was full, and the newest report did not get into it"
        assert eventually(lambda: loop.silent)
    assert eventually(lambda: not loop.report().why_not_driving[0].startswith("the CAN loop"))


def test_of_several_commands_that_wait_the_newest_counts(loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    monkeypatch.setattr(loop.loop._bridge, "on_command", lambda command, _now_ns: taken.append(command.laps))
    with hanging(loop, monkeypatch):
        for laps in range(5):
            loop.submit_command(VehicleCommand(time.monotonic_ns(), 1, laps=laps))
    assert eventually(lambda: bool(taken)) and taken[-1] == 4 and len(taken) <= 2
