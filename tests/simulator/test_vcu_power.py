"""Power-up and switching off in both revisions, and what people see of it."""

from __future__ import annotations

from typing import Any

import pytest
from vcu_bench import Bench, codec

from fsai_hil.simulator.power import SystemState
from fsai_hil.simulator.switches import Assi
from fsai_hil.simulator.vcu import SimulatedVcu
from fsai_vcu.interface.enums import (
    AsState,
    BrakeStatus,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.messages import VcuBrake, VcuStatus, VcuSystemStatus
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.units import MS, S


def distinct(values: list[Any]) -> list[Any]:
    """The values in the order in which they first appear."""
    return list(dict.fromkeys(values))


def test_a_car_without_low_voltage_sends_and_shows_nothing() -> None:
    bench = Bench()
    bench.switches.aims = bench.switches.asms = bench.switches.tsms = True
    assert bench.run(S) == []
    assert not bench.vcu.powered
    assert not bench.vcu.actuation.ebs_engaged


@pytest.mark.parametrize("missing", ["aims", "talks"])
def test_2021_the_vcu_stays_in_aux_until_ai_data_arrives(missing: str) -> None:
    """From an AI computer that AIMS feeds."""
    bench = Bench("2021")
    bench.switches.aims = bench.switches.asms = bench.switches.tsms = bench.switches.lvms = True
    owner = bench.switches if missing == "aims" else bench
    setattr(owner, missing, False)
    bench.run(20 * S)
    assert bench.vcu.system_state is SystemState.AUX
    setattr(owner, missing, True)
    bench.run(5 * S)
    sent = bench.images(VcuSystemStatus)
    assert distinct([image.sm_sys for image in sent]) == [
        SystemState.POWER_ON_SELF_TEST,
        SystemState.AUX,
        SystemState.POWERTRAIN_ENABLE,
        SystemState.DRIVE_AUTONOMOUS,
    ]
    assert bench.vcu.mission_selectable
    assert {image.sm_as for image in sent} == {AsState.AS_OFF}


def test_2026_ts_and_ebs_come_up_when_valid_can_data_arrives() -> None:
    bench = Bench("2026")
    bench.silent_ids = {0x514}
    for name in ("lvms", "asms", "tsms"):
        setattr(bench.switches, name, True)
        bench.run(300 * MS)
    bench.run(10 * S)
    assert not bench.vcu.actuation.tractive_system_live
    status = bench.status()
    assert (status.as_state, status.ts_state, status.ebs_state) == (AsState.AS_INIT, TsState.TS_INIT, EbsState.EBS_INIT)
    assert status.op_state is OpState.OP_AUTO
    bench.silent_ids = set()
    bench.run(5 * S)
    sent = bench.images(VcuStatus)
    assert distinct([image.ts_state for image in sent]) == [
        TsState.TS_INIT,
        TsState.TS_PRECHARGE,
        TsState.TS_ACTIVATE,
        TsState.TS_RUNNING,
    ]
    assert distinct([image.ebs_state for image in sent]) == [
        EbsState.EBS_INIT,
        EbsState.EBS_CHARGING,
        EbsState.EBS_ARMED,
    ]
    for image in sent:
        up = image.ts_state is TsState.TS_RUNNING and image.ebs_state is EbsState.EBS_ARMED
        assert image.as_state is (AsState.AS_OFF if up else AsState.AS_INIT)


@pytest.mark.parametrize("missing", ["asms", "tsms"])
@pytest.mark.parametrize("name", ["2021", "2026"])
def test_the_ebs_is_not_armed_without_both_switches(name: str, missing: str) -> None:
    bench = Bench(name)
    for switch in {"aims", "lvms", "asms", "tsms"} - {missing}:
        setattr(bench.switches, switch, True)
    bench.run(10 * S)
    brake = bench.images(VcuBrake)[-1]
    assert brake.ebs_status is EbsStatus.UNAVAILABLE
    assert brake.brake_status is BrakeStatus.READY


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_the_car_does_not_come_up_with_an_open_shutdown_circuit(name: str) -> None:
    bench = Bench(name)
    bench.switches.remote_estop = True
    bench.switches.aims = bench.switches.lvms = bench.switches.asms = bench.switches.tsms = True
    bench.run(10 * S)
    assert not bench.vcu.mission_selectable
    bench.switches.remote_estop = False
    bench.run(5 * S)
    assert bench.vcu.mission_selectable


def test_2026_a_second_mission_needs_all_switches_off_and_on() -> None:
    bench = Bench("2026").to_finished()
    bench.switches.asms = bench.switches.go = False
    bench.say(mission_status=MissionStatus.SELECTED, direction=Direction.NEUTRAL)
    bench.run(2 * S)
    bench.switches.asms = True
    bench.run(10 * S)
    assert bench.state is AsState.AS_OFF
    bench.switches.asms = bench.switches.tsms = bench.switches.lvms = False
    bench.run(S)
    bench.switches.lvms = bench.switches.asms = bench.switches.tsms = True
    bench.run_until(lambda: bench.state is AsState.AS_READY, 10 * S)


def test_tsms_off_shuts_down_and_lvms_may_follow_2_s_later() -> None:
    bench = Bench("2021").power_up()
    assert not bench.status().shutdown_request
    bench.switches.asms = bench.switches.tsms = False
    status = bench.status()
    assert status.shutdown_request
    assert not bench.vcu.shut_down
    assert bench.vcu.system_state is SystemState.SHUTDOWN
    bench.run(2 * S)
    assert bench.vcu.shut_down
    assert bench.vcu.system_state is SystemState.SHUTDOWN_OFF
    assert not bench.vcu.actuation.tractive_system_live
    bench.switches.tsms = True
    bench.run(5 * S)
    assert bench.status().shutdown_request, "a shutdown that has begun ends with LVMS off"


def test_after_low_voltage_has_been_off_the_vcu_begins_anew() -> None:
    bench = Bench("2026").to_ready()
    bench.switches.lvms = bench.switches.tsms = False
    assert bench.run(2 * S) == []
    bench.switches.lvms = True
    status = bench.status()
    assert status.as_state is AsState.AS_INIT
    assert status.handshake is True
    bench.run(5 * S)
    assert not bench.status().shutdown_request, "a TSMS that was never on requests no shutdown"


def test_an_ebs_left_under_pressure_brakes_until_armed_anew() -> None:
    bench = Bench("2026").to_ready()
    assert not bench.vcu.actuation.ebs_engaged
    bench.switches.lvms = False
    bench.run(S // 10)
    assert bench.vcu.actuation.ebs_engaged
    bench.switches.lvms = True
    bench.run_until(lambda: bench.status().as_state is AsState.AS_INIT, S)
    assert bench.vcu.actuation.ebs_engaged, "a VCU that starts does not let a car roll"
    bench.switches.lvms = False
    bench.run(S // 10)
    bench.switches.lvms = True
    bench.run(S)
    assert bench.vcu.actuation.ebs_engaged, "nor does one that starts twice"
    bench.run_until(lambda: bench.state is AsState.AS_READY, 20 * S)
    assert not bench.vcu.actuation.ebs_engaged


def test_steering_is_ready_with_the_ts_and_off_in_an_emergency() -> None:
    bench = Bench().power_up()
    assert bench.status().steering_status is SteeringStatus.ACTIVE
    bench.switches.steering_fault = True
    assert bench.status().steering_status is SteeringStatus.OFF
    assert Bench().to_emergency().status().steering_status is SteeringStatus.OFF


def test_an_unknown_revision_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"'2031'.*2021, 2026"):
        SimulatedVcu(codec("2021"), Revision("2031", (), 21.0))


# ---------------------------------------------------------------- what people see


@pytest.mark.parametrize(
    ("way", "assi"),
    [
        ("power_up", Assi.OFF),
        ("to_ready", Assi.YELLOW),
        ("to_driving", Assi.YELLOW_FLASHING),
        ("to_finished", Assi.BLUE),
        ("to_emergency", Assi.BLUE_FLASHING),
    ],
)
def test_the_assi_shows_the_as_state(way: str, assi: Assi) -> None:
    assert getattr(Bench(), way)().vcu.assi is assi


YELLOW, YELLOW_AND_BLUE = Assi.YELLOW, Assi.YELLOW_AND_BLUE


@pytest.mark.parametrize(
    ("way", "shows", "expected"),
    [
        ("to_ready", "assi", {5 * S - 1: YELLOW, 5 * S: YELLOW_AND_BLUE, 6 * S - 1: YELLOW_AND_BLUE, 6 * S: YELLOW}),
        ("to_emergency", "siren", {15 * S - 1: True, 15 * S: False}),
    ],
)
def test_blue_joins_yellow_for_1_s_after_5_s_sirens_sound_15_s(
    way: str, shows: str, expected: dict[int, object]
) -> None:
    bench = getattr(Bench(), way)()
    begun_ns = bench.vcu.history[-1][0]
    for offset_ns, shown in expected.items():
        bench.run(begun_ns + offset_ns - bench.now_ns)
        assert getattr(bench.vcu, shows) == shown
