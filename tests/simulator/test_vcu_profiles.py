"""Each quirk of the official simulator, beside what the specification has in its place."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
from vcu_bench import Bench

from fsai_hil.simulator.profiles import OFFICIAL_SIMULATOR, PROFILES, SPECIFICATION, Profile, profile
from fsai_vcu.interface.enums import AsState, BrakeStatus, Direction, MissionStatus
from fsai_vcu.interface.messages import VcuBrake, VcuStatus
from fsai_vcu.interface.units import MS, S


def bench_of(kind: Profile, name: str = "2021") -> Bench:
    return Bench(name, kind)


def handshakes(bench: Bench, count: int) -> list[bool]:
    del bench.sent[:]
    bench.run(count * 10 * MS)
    return [image.handshake for image in bench.images(VcuStatus) if isinstance(image, VcuStatus)]


def test_profiles_are_found_by_name_an_unknown_name_lists_them() -> None:
    assert profile("specification") is SPECIFICATION
    assert profile("official-simulator") is OFFICIAL_SIMULATOR
    with pytest.raises(ValueError, match="specification, official-simulator"):
        profile("nobody's")


def test_the_specification_is_the_default_of_every_difference() -> None:
    assert Profile(name="specification") == SPECIFICATION
    assert set(PROFILES) == {"specification", "official-simulator"}
    same = {f.name for f in fields(Profile) if getattr(OFFICIAL_SIMULATOR, f.name) == getattr(SPECIFICATION, f.name)}
    # A VCU that needs no acknowledgement is one of the campaign's faults, and no profile.
    assert same == {"message_timeout_ns", "ready_wait_ns", "emergency_timer_ns", "ready_without_acknowledgement"}


def test_the_official_simulator_runs_like_the_specification() -> None:
    for kind in PROFILES.values():
        bench = bench_of(kind).to_finished()
        assert bench.state is AsState.AS_FINISHED


def test_the_simulator_toggles_every_10_ms_whatever_is_received() -> None:
    silent = bench_of(OFFICIAL_SIMULATOR)
    silent.talks = False
    silent.switches.lvms = True
    silent.run(S)
    assert handshakes(silent, 6) in ([True, False] * 3, [False, True] * 3)
    silent = bench_of(SPECIFICATION)
    silent.talks = False
    silent.switches.lvms = True
    silent.run(S)
    assert handshakes(silent, 6) == [True] * 6


def test_the_simulator_gives_the_echo_500_ms() -> None:
    for kind, survives in ((SPECIFICATION, False), (OFFICIAL_SIMULATOR, True)):
        bench = bench_of(kind).to_driving()
        bench.run(100 * MS)
        bench.echoes = False
        bench.run(480 * MS)
        assert (bench.state is AsState.AS_DRIVING) is survives
    bench.run(30 * MS)
    assert bench.state is AsState.EMERGENCY_BRAKE


def test_the_simulator_starts_only_while_selected_is_sent() -> None:
    for kind, starts in ((SPECIFICATION, True), (OFFICIAL_SIMULATOR, False)):
        bench = bench_of(kind).to_ready()
        bench.run(5 * S)
        bench.say(mission_status=MissionStatus.RUNNING)
        bench.run(30 * MS)
        bench.switches.go = True
        bench.run(30 * MS)
        assert (bench.state is AsState.AS_DRIVING) is starts


@pytest.mark.parametrize("way", ["to_ready", "to_driving", "to_finished"])
def test_the_simulator_takes_any_brake_request_for_an_emergency(way: str) -> None:
    for kind, survives in ((SPECIFICATION, True), (OFFICIAL_SIMULATOR, False)):
        bench: Bench = getattr(bench_of(kind), way)()
        bench.deliver(rear_brake_pct=0.5)
        assert (bench.state is not AsState.EMERGENCY_BRAKE) is survives


def test_the_simulator_takes_an_estop_request_even_in_as_off() -> None:
    for kind, state in ((SPECIFICATION, AsState.AS_OFF), (OFFICIAL_SIMULATOR, AsState.EMERGENCY_BRAKE)):
        bench = bench_of(kind).power_up()
        bench.deliver(estop_request=True)
        assert bench.state is state


def test_the_simulator_sends_as_state_zero_while_asms_is_off() -> None:
    for kind, sent in ((SPECIFICATION, AsState.AS_OFF), (OFFICIAL_SIMULATOR, AsState.AS_INIT)):
        bench = bench_of(kind)
        bench.switches.lvms = True
        assert bench.status().as_state is sent
        bench.switches.asms = True
        assert bench.status().as_state is AsState.AS_OFF


def test_the_simulator_raises_the_neutral_fault_with_all_wheels() -> None:
    for kind, survives in ((SPECIFICATION, False), (OFFICIAL_SIMULATOR, True)):
        bench = bench_of(kind).to_driving()
        bench.wheels(50.0, 50.0, 10.0, 50.0)
        bench.tick()
        bench.deliver(direction=Direction.NEUTRAL)
        assert (bench.state is AsState.AS_DRIVING) is survives
    bench.wheels(50.0)
    bench.tick()
    assert bench.state is AsState.EMERGENCY_BRAKE


@pytest.mark.parametrize("way", ["to_ready", "to_driving", "to_finished", "to_emergency"])
def test_the_simulator_resets_to_as_off_when_asms_goes_off(way: str) -> None:
    bench: Bench = getattr(bench_of(OFFICIAL_SIMULATOR), way)()
    bench.switches.asms = False
    bench.tick()
    assert bench.state is AsState.AS_OFF
    assert not bench.vcu.power_cycle_needed


def test_the_simulator_recovers_from_an_emergency_while_powered() -> None:
    bench = bench_of(OFFICIAL_SIMULATOR).to_emergency()
    bench.switches.asms = bench.switches.go = False
    bench.say(estop_request=False, mission_status=MissionStatus.SELECTED, direction=Direction.NEUTRAL)
    bench.run(S)
    assert not bench.status().fault
    bench.switches.asms = True
    bench.run_until(lambda: bench.state is AsState.AS_READY, 10 * S)


def test_the_simulator_ignores_go_going_off_while_driving() -> None:
    for kind, survives in ((SPECIFICATION, False), (OFFICIAL_SIMULATOR, True)):
        bench = bench_of(kind).to_driving()
        bench.switches.go = False
        bench.run(S)
        assert (bench.state is AsState.AS_DRIVING) is survives


@pytest.mark.parametrize("way", ["to_ready", "to_driving", "to_finished"])
def test_the_simulator_takes_not_selected_as_as_off_at_once(way: str) -> None:
    for kind, leaves in ((SPECIFICATION, False), (OFFICIAL_SIMULATOR, True)):
        bench: Bench = getattr(bench_of(kind), way)()
        bench.deliver(mission_status=MissionStatus.NOT_SELECTED)
        assert (bench.state is AsState.AS_OFF) is leaves


def test_the_simulator_brakes_fully_when_neutral() -> None:
    for kind, brake in ((SPECIFICATION, 0.0), (OFFICIAL_SIMULATOR, 100.0)):
        bench = bench_of(kind).to_driving()
        assert bench.vcu.actuation.rear_brake_pct == 0.0
        bench.deliver(direction=Direction.NEUTRAL)
        assert bench.state is AsState.AS_DRIVING
        assert bench.vcu.actuation.rear_brake_pct == brake


def test_the_simulator_rounds_steering_to_whole_degrees() -> None:
    for kind, steer in ((SPECIFICATION, 7.6), (OFFICIAL_SIMULATOR, 8.0)):
        bench = bench_of(kind).to_driving()
        bench.deliver(steer_deg=7.6)
        assert bench.vcu.actuation.steer_deg == steer


def test_the_simulator_drives_by_the_rear_torque_only() -> None:
    for kind, front in ((SPECIFICATION, 30.0), (OFFICIAL_SIMULATOR, 0.0)):
        bench = bench_of(kind).to_driving()
        bench.deliver(front_torque_nm=30.0, rear_torque_nm=40.0)
        order = bench.vcu.actuation
        assert (order.front_torque_nm, order.rear_torque_nm) == (front, 40.0)


def test_the_simulator_sends_brake_and_ebs_status_as_zero() -> None:
    bench = bench_of(OFFICIAL_SIMULATOR).power_up()
    bench.run(20 * MS)
    assert next(frame for frame in reversed(bench.sent) if frame.can_id == 0x524).data[4] == 0
    image = bench.images(VcuBrake)[-1]
    assert isinstance(image, VcuBrake)
    assert (image.brake_status, image.ebs_status) == (BrakeStatus.INITIALISING, None)


def test_a_profile_of_ones_own_is_one_change() -> None:
    patient = replace(SPECIFICATION, name="patient", message_timeout_ns=S)
    bench = bench_of(patient).to_driving()
    bench.silent_ids = {0x513}
    bench.run(900 * MS)
    assert bench.state is AsState.AS_DRIVING
    bench.run(150 * MS)
    assert bench.state is AsState.EMERGENCY_BRAKE
