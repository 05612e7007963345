"""The real-time loop on a bus: its thread, its slots, and what it does when the bus goes away."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Iterator

import pytest

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, MissionStatus
from fsai_vcu.interface.images import AiStatus, VcuStatus
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime import loop as loop_module
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.lock import AlreadyRunning
from fsai_vcu.runtime.loop import BridgeLoop

REVISION = revision("2026")
CODEC = Codec(REVISION)
WAIT_S = 10.0


def make_loop(spec: str, config: BridgeConfig | None = None) -> BridgeLoop:
    bridge = Bridge(CODEC, REVISION, CARS["2026"], config, now_ns=time.monotonic_ns())
    return BridgeLoop(bridge, CODEC, spec, real_time=False)


def eventually(condition: Callable[[], bool]) -> bool:
    until = time.monotonic() + WAIT_S
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
