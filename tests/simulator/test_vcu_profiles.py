"""Each quirk of the official simulator, beside what the specification has in its place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import fields, replace
from vcu_bench import Bench

from fsai_hil.simulator.profiles import OFFICIAL_SIMULATOR, PROFILES, SPECIFICATION, Profile
from fsai_vcu.interface.enums import AsState, BrakeStatus, Direction, MissionStatus
from fsai_vcu.interface.messages import VcuBrake, VcuStatus
from fsai_vcu.interface.units import MS, S


def test_the_specification_is_the_default_of_every_difference() -> None:
    assert Profile(name="specification") == SPECIFICATION
    assert set(PROFILES) == {"specification", "official-simulator"}
    same = {f.name for f in fields(Profile) if getattr(OFFICIAL_SIMULATOR, f.name) == getattr(SPECIFICATION, f.name)}
    # A VCU that needs no acknowledgement is one of the campaign's faults, and no profile.
    # Nor is known by what it judges torque and brake that change in one call.
    same -= {"pedals_judged_by_frame"}
    assert same == {"ready_wait_ns", "emergency_timer_ns", "ready_without_acknowledgement"}


def test_the_simulator_toggles_every_10_ms_whatever_is_received() -> None:
    alternating = ([True, False] * 3, [False, True] * 3)
    for kind, sent in ((OFFICIAL_SIMULATOR, alternating), (SPECIFICATION, ([True] * 6,))):
        bench = Bench("2021", kind)
        bench.talks = False
        bench.switches.lvms = True
        bench.run(S)
        del bench.sent[:]
        bench.run(60 * MS)
        assert [image.handshake for image in bench.images(VcuStatus)] in sent


def test_the_simulator_takes_an_inverse_for_which_the_car_stops() -> None:
    for kind, survives in ((SPECIFICATION, False), (OFFICIAL_SIMULATOR, True)):
        bench = Bench("2021", kind).to_driving()
        bench.run(100 * MS)
        bench.echoes = False  # it sends the inverse
        bench.run(2 * S)
        assert (bench.state is AsState.AS_DRIVING) is survives


def test_torque_and_brake_may_change_in_one_call_by_the_cycle() -> None:
    for by_frame in (True, False):
        bench = Bench("2026", replace(SPECIFICATION, pedals_judged_by_frame=by_frame)).to_driving()
        bench.say(rear_torque_nm=0.0, front_brake_pct=20.0, rear_brake_pct=20.0)
        bench.run(100 * MS)
        bench.say(rear_torque_nm=50.0, front_brake_pct=0.0, rear_brake_pct=0.0)  # 0x512 goes before 0x514
        bench.run(100 * MS)
        stopped = bench.state is AsState.EMERGENCY_BRAKE
        assert stopped is by_frame
        bench.say(front_brake_pct=20.0, rear_brake_pct=20.0)  # and stays
        bench.run(100 * MS)
        assert bench.state is AsState.EMERGENCY_BRAKE


def _in(*states: AsState) -> Callable[[Bench], object]:
    return lambda bench: bench.state in states


def _orders(name: str) -> Callable[[Bench], object]:
    return lambda bench: getattr(bench.vcu.actuation, name)


def _late_go(bench: Bench) -> None:
    bench.run(5 * S)
    bench.say(mission_status=MissionStatus.RUNNING)
    bench.run(30 * MS)
    bench.switches.go = True
    bench.run(30 * MS)


def _go_off(bench: Bench) -> None:
    bench.switches.go = False
    bench.run(S)


def _neutral_with_three_wheels_turning(bench: Bench) -> None:
    bench.wheels(50.0, 50.0, 10.0, 50.0)
    bench.tick()
    bench.deliver(direction=Direction.NEUTRAL)


def _sends(**changes: Any) -> Callable[[Bench], None]:
    return lambda bench: bench.deliver(**changes)


DRIVING, EMERGENCY, OFF = AsState.AS_DRIVING, AsState.EMERGENCY_BRAKE, AsState.AS_OFF
# What happens in which state, what is looked at, and what it is by the specification and in the simulator.
QUIRKS: list[tuple[str, Callable[[Bench], None], Callable[[Bench], object], object, object]] = [
    ("to_ready", _late_go, _in(DRIVING), True, False),  # it starts only while SELECTED is sent
    *(
        (way, _sends(rear_brake_pct=0.5), _in(EMERGENCY), False, True)
        for way in ("to_ready", "to_driving", "to_finished")
    ),
    ("power_up", _sends(estop_request=True), _in(EMERGENCY), False, True),
    ("to_driving", _neutral_with_three_wheels_turning, _in(DRIVING), False, True),
    ("to_driving", _go_off, _in(DRIVING), False, True),
    *(
        (way, _sends(mission_status=MissionStatus.NOT_SELECTED), _in(OFF), False, True)
        for way in ("to_ready", "to_driving", "to_finished")
    ),
    ("to_driving", _sends(direction=Direction.NEUTRAL), _orders("rear_brake_pct"), 0.0, 100.0),
    ("to_driving", _sends(steer_deg=7.6), _orders("steer_deg"), 7.6, 8.0),
    ("to_driving", _sends(front_torque_nm=30.0), _orders("front_torque_nm"), 30.0, 0.0),
]


@pytest.mark.parametrize(("way", "happens", "look", "by_specification", "by_simulator"), QUIRKS)
def test_each_quirk_of_the_simulator_is_not_the_specifications(
    way: str,
    happens: Callable[[Bench], None],
    look: Callable[[Bench], object],
    by_specification: object,
    by_simulator: object,
) -> None:
    for kind, expected in ((SPECIFICATION, by_specification), (OFFICIAL_SIMULATOR, by_simulator)):
        bench: Bench = getattr(Bench("2021", kind), way)()
        happens(bench)
        assert look(bench) == expected, kind.name


def test_the_simulator_sends_as_state_zero_while_asms_is_off() -> None:
    for kind, sent in ((SPECIFICATION, AsState.AS_OFF), (OFFICIAL_SIMULATOR, AsState.AS_INIT)):
        bench = Bench("2021", kind)
        bench.switches.lvms = True
        assert bench.status().as_state is sent
        bench.switches.asms = True
        assert bench.status().as_state is AsState.AS_OFF


@pytest.mark.parametrize("way", ["to_ready", "to_driving", "to_finished", "to_emergency"])
def test_the_simulator_resets_to_as_off_when_asms_goes_off(way: str) -> None:
    bench: Bench = getattr(Bench("2021", OFFICIAL_SIMULATOR), way)()
    bench.switches.asms = False
    bench.tick()
    assert bench.state is AsState.AS_OFF
    assert not bench.vcu.power_cycle_needed


def test_the_simulator_recovers_from_an_emergency_while_powered() -> None:
    bench = Bench("2021", OFFICIAL_SIMULATOR).to_emergency()
    bench.switches.asms = bench.switches.go = False
    bench.say(estop_request=False, mission_status=MissionStatus.SELECTED, direction=Direction.NEUTRAL)
    bench.run(S)
    assert not bench.status().fault
    bench.switches.asms = True
    bench.run_until(lambda: bench.state is AsState.AS_READY, 10 * S)


def test_the_simulator_sends_brake_and_ebs_status_as_zero() -> None:
    bench = Bench("2021", OFFICIAL_SIMULATOR).power_up()
    bench.run(20 * MS)
    assert next(frame for frame in reversed(bench.sent) if frame.can_id == 0x524).data[4] == 0
    image = bench.images(VcuBrake)[-1]
    assert (image.brake_status, image.ebs_status) == (BrakeStatus.INITIALISING, None)
