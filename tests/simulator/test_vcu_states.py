"""The autonomous-system state machine of the simulated VCU: each row of the specification's table."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace
from vcu_bench import Bench

from fsai_hil.simulator.as_machine import AI_FAULTS, CAR_FAULTS, Situation, taken, transition_table
from fsai_hil.simulator.profiles import SPECIFICATION
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus, ShutdownCause
from fsai_vcu.interface.messages import Faults
from fsai_vcu.interface.units import MS, S

TABLE = transition_table(SPECIFICATION)
INIT, OFF, READY, DRIVING = AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
FINISHED, EMERGENCY = AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE

# A situation in which each state stays as it is: a sound car whose AI computer does what it should.
QUIET: dict[AsState, Situation] = {
    INIT: Situation(),
    OFF: Situation(),
    READY: Situation(
        asms=True,
        tsms=True,
        ami=Ami.TRACKDRIVE,
        ebs_armed=True,
        mission_status=MissionStatus.SELECTED,
    ),
    DRIVING: Situation(
        asms=True,
        tsms=True,
        go=True,
        ami=Ami.TRACKDRIVE,
        ebs_armed=True,
        mission_status=MissionStatus.RUNNING,
        direction=Direction.FORWARD,
        fastest_wheel_rpm=200.0,
        slowest_wheel_rpm=180.0,
        torque_requested=True,
        steer_requested=True,
    ),
    FINISHED: Situation(asms=True, tsms=True, go=True, ebs_armed=True, mission_status=MissionStatus.FINISHED),
    EMERGENCY: Situation(asms=True, tsms=True, sdc_open=True),
}

ROWS_OF_THE_SPECIFICATION: list[tuple[AsState, AsState, dict[str, Any]]] = [
    (INIT, OFF, {"tractive_system_running": True, "ebs_armed": True}),
    (
        OFF,
        READY,
        {"asms": True, "tsms": True, "ebs_armed": True, "ami": Ami.SKIDPAD, "mission_status": MissionStatus.SELECTED},
    ),
    (READY, DRIVING, {"ready_wait_over": True, "go": True, "go_rising": True}),
    (READY, EMERGENCY, {"sdc_open": True}),
    (READY, EMERGENCY, {"comms_lost": True}),
    (READY, OFF, {"asms": False}),
    (DRIVING, EMERGENCY, {"sdc_open": True}),
    (DRIVING, EMERGENCY, {"asms": False}),
    (DRIVING, EMERGENCY, {"go": False}),
    (DRIVING, FINISHED, {"mission_status": MissionStatus.FINISHED, "fastest_wheel_rpm": 9.9, "slowest_wheel_rpm": 0.0}),
    (FINISHED, OFF, {"asms": False}),
    (FINISHED, EMERGENCY, {"sdc_open": True}),
    (FINISHED, EMERGENCY, {"comms_lost": True}),
    (EMERGENCY, OFF, {"emergency_timer_over": True, "asms": False}),
]


def named(case: Any) -> str | None:
    if isinstance(case, AsState):
        return case.label
    return "+".join(case) if isinstance(case, dict) else None


def test_every_fault_is_a_fault_bit_of_the_status_message() -> None:
    assert {fault.name for fault in (*AI_FAULTS, *CAR_FAULTS)} == set(Faults.__struct_fields__)


@pytest.mark.parametrize("state", AsState, ids=named)
def test_a_state_stays_while_nothing_happens(state: AsState) -> None:
    assert taken(TABLE, state, QUIET[state]) is None


@pytest.mark.parametrize(("source", "target", "conditions"), ROWS_OF_THE_SPECIFICATION, ids=named)
def test_a_row_of_the_specification_is_taken(source: AsState, target: AsState, conditions: dict[str, Any]) -> None:
    row = taken(TABLE, source, replace(QUIET[source], **conditions))
    assert row is not None
    assert row.target is target


@pytest.mark.parametrize(("source", "target", "conditions"), ROWS_OF_THE_SPECIFICATION, ids=named)
def test_a_row_needs_each_of_its_conditions(source: AsState, target: AsState, conditions: dict[str, Any]) -> None:
    quiet = QUIET[source]
    for left_out in conditions:
        if left_out in ("slowest_wheel_rpm", "go"):  # not a condition of these rows, only part of the picture
            continue
        situation = replace(quiet, **{**conditions, left_out: getattr(quiet, left_out)})
        row = taken(TABLE, source, situation)
        assert row is None or row.target is not target, f"{left_out} does not matter"


@pytest.mark.parametrize(
    "hindrance",
    [
        {"torque_requested": True},
        {"steer_requested": True},
        {"steer_deg": 5.0},
        {"steer_deg": -5.0},
        {"direction": Direction.FORWARD},
        {"go_rising": False},
        {"ready_wait_over": False},
    ],
    ids=named,
)
def test_the_car_does_not_start_with_an_unmet_as_ready_condition(hindrance: dict[str, Any]) -> None:
    willing = replace(QUIET[READY], ready_wait_over=True, go=True, go_rising=True, steer_deg=4.99)
    assert taken(TABLE, READY, willing) is not None
    assert taken(TABLE, READY, replace(willing, **hindrance)) is None


@pytest.mark.parametrize("status", [s for s in MissionStatus if s is not MissionStatus.SELECTED])
def test_as_ready_needs_the_ai_computers_acknowledgement(status: MissionStatus) -> None:
    situation = replace(QUIET[READY], mission_status=status)
    assert taken(TABLE, OFF, situation) is None


@pytest.mark.parametrize(("rpm", "finished"), [(10.0, None), (9.99, FINISHED), (0.0, FINISHED)])
def test_finished_needs_wheels_under_10_rpm_at_10_is_no_fault(rpm: float, finished: AsState | None) -> None:
    """Nor is NEUTRAL."""
    standing = replace(QUIET[DRIVING], fastest_wheel_rpm=rpm, slowest_wheel_rpm=0.0)
    row = taken(TABLE, DRIVING, replace(standing, mission_status=MissionStatus.FINISHED))
    assert (row.target if row else None) is finished
    assert taken(TABLE, DRIVING, replace(standing, direction=Direction.NEUTRAL)) is None


@pytest.mark.parametrize(
    ("lie", "fault", "cause"),
    [
        ({"estop_request": True}, "ai_estop_request", ShutdownCause.AI_COMPUTER_REQUEST),
        ({"mission_status": MissionStatus.FINISHED}, "mission_status", ShutdownCause.MISSION_STATUS_FAULT),
        ({"direction": Direction.NEUTRAL}, "autonomous_braking", ShutdownCause.AUTONOMOUS_BRAKING_FAULT),
        ({"comms_lost": True}, "ai_comms_lost", ShutdownCause.AI_COMMS_FAULT),
        ({"brake_requested": True}, "brake_plausibility", ShutdownCause.BRAKE_PLAUSIBILITY_FAULT),
        ({"hvil_open": True, "sdc_open": True}, "hvil_open", ShutdownCause.HVIL_OPEN_FAULT),
        ({"hvil_short": True, "sdc_open": True}, "hvil_short", ShutdownCause.HVIL_SHORT_FAULT),
        ({"ebs_fault": True, "sdc_open": True}, "ebs", ShutdownCause.EBS_FAULT),
        ({"ebs_armed": False}, "ebs", ShutdownCause.EBS_FAULT),
        ({"offboard_charger_fault": True, "sdc_open": True}, "offboard_charger", ShutdownCause.OFFBOARD_CHARGER_FAULT),
        ({"charge_procedure_fault": True, "sdc_open": True}, "charge_procedure", ShutdownCause.CHARGE_PROCEDURE_FAULT),
        ({"bms_fault": True, "sdc_open": True}, "bms", ShutdownCause.BMS_FAULT),
        ({"bms_fault": True}, "bms", ShutdownCause.BMS_FAULT),
    ],
    ids=named,
)
def test_a_fault_in_as_driving_brings_its_fault_bit_and_cause(
    lie: dict[str, Any], fault: str, cause: ShutdownCause
) -> None:
    row = taken(TABLE, DRIVING, replace(QUIET[DRIVING], **lie))
    assert row is not None and row.target is EMERGENCY
    assert row.fault is not None
    assert (row.fault.name, row.fault.cause) == (fault, cause)


# ---------------------------------------------------------------- the same, on the VCU


def test_go_at_5_s_in_as_ready_starts_and_1_ns_before_is_lost() -> None:
    bench = Bench().to_ready()
    bench.run(bench.vcu.history[-1][0] + 5 * S - bench.now_ns)
    bench.switches.go = True
    bench.tick(0)
    assert bench.vcu.history[-1] == (bench.now_ns, DRIVING)
    bench = Bench().to_ready()
    ready_ns = bench.vcu.history[-1][0]
    bench.run(ready_ns + 5 * S - 1 - bench.now_ns)
    bench.switches.go = True
    bench.tick(0)
    assert bench.vcu.in_state_ns == 5 * S - 1
    bench.run(2 * S)
    assert bench.state is READY, "a Go that was on too early must not start the car later"
    bench.switches.go = False
    bench.run(10 * MS)
    bench.switches.go = True
    bench.run(10 * MS)
    assert bench.state is DRIVING


def test_a_go_left_on_since_power_up_does_not_start_the_car() -> None:
    bench = Bench()
    bench.switches.go = True
    bench.to_ready()
    bench.run(8 * S)
    assert bench.state is READY


@pytest.mark.parametrize(
    ("switch", "value"),
    [
        (name, True)
        for name in ("remote_estop", "car_estop", "crash", "hvil_open", "hvil_short", "ebs_fault", "bms_fault")
    ]
    + [("remote_radio_ok", False), ("dongle", False)],
)
def test_whatever_opens_the_shutdown_circuit_is_an_emergency(switch: str, value: bool) -> None:
    bench = Bench().to_driving()
    setattr(bench.switches, switch, value)
    bench.tick()
    assert bench.state is EMERGENCY
    assert bench.vcu.actuation.ebs_engaged


def test_tsms_off_while_driving_is_an_emergency() -> None:
    """The EBS has lost its supply."""
    bench = Bench().to_driving()
    bench.switches.tsms = False
    bench.tick()
    assert bench.state is EMERGENCY
    assert bench.vcu.shutdown_cause is ShutdownCause.EBS_FAULT


def test_a_fault_stays_in_the_status_until_power_is_cycled() -> None:
    bench = Bench().to_emergency()
    bench.say(estop_request=False)
    bench.run(16 * S)
    bench.switches.asms = False
    status = bench.status()
    assert status.as_state is OFF
    assert status.fault and status.faults.ai_estop_request
    assert status.shutdown_cause is ShutdownCause.AI_COMPUTER_REQUEST
    bench.switches.lvms = False
    bench.run(S)
    bench.switches.lvms = True
    status = bench.status()
    assert not status.fault
    assert status.shutdown_cause is ShutdownCause.NO_SHUTDOWN


def test_an_emergency_ends_after_15_s_and_not_1_ns_before() -> None:
    bench = Bench().to_emergency()
    bench.switches.asms = False
    bench.run(bench.vcu.history[-1][0] + 15 * S - 1 - bench.now_ns)
    assert bench.state is EMERGENCY
    bench.tick(1)
    assert bench.state is OFF


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_after_an_emergency_only_a_power_cycle_makes_ready_again(name: str) -> None:
    bench = Bench(name).to_emergency()
    bench.say(estop_request=False, mission_status=MissionStatus.SELECTED, direction=Direction.NEUTRAL)
    bench.run(16 * S)
    bench.switches.asms = bench.switches.go = False
    bench.run(S)
    bench.switches.asms = True
    bench.run(10 * S)
    assert bench.state is OFF
    assert bench.vcu.power_cycle_needed
    bench.switches.lvms = False
    bench.run(S)
    bench.switches.lvms = True
    bench.run_until(lambda: bench.state is READY, 10 * S)
    assert bench.vcu.power_cycles == 1


def test_torque_and_brake_meeting_between_two_frames_are_a_fault() -> None:
    bench = Bench().to_driving()
    bench.deliver(rear_torque_nm=50.0, rear_motor_speed_max_rpm=500)
    bench.deliver(rear_torque_nm=0.0, rear_brake_pct=20.0)
    bench.run(S)
    assert bench.state is DRIVING, "torque ends before the brake in the order of the frames"
    bench.deliver(rear_brake_pct=0.0)
    bench.deliver(rear_torque_nm=50.0)
    # the next cycle brakes without torque, but its brake frame comes before the torque frames
    braking = replace(bench.command, handshake=bench.echo, rear_torque_nm=0.0, rear_brake_pct=20.0)
    status, front, rear, steer, brake = bench.codec.encode_command(braking, bench.now_ns)
    for frame in (status, brake, front, rear, steer):
        bench.vcu.on_frame(frame)
    assert bench.state is EMERGENCY
    assert bench.vcu.shutdown_cause is ShutdownCause.BRAKE_PLAUSIBILITY_FAULT


# ---------------------------------------------------------------- what it orders


def test_torque_and_steering_requests_count_only_in_as_driving() -> None:
    bench = Bench().to_ready()
    bench.deliver(rear_torque_nm=50.0, steer_deg=10.0, rear_motor_speed_max_rpm=500)
    bench.run(100 * MS)
    order = bench.vcu.actuation
    assert (order.front_torque_nm, order.rear_torque_nm, order.steer_deg) == (0.0, 0.0, 0.0)
    bench = Bench().to_driving()
    bench.deliver(rear_motor_speed_max_rpm=500)
    assert bench.vcu.actuation.rear_motor_speed_max_rpm == 500


@pytest.mark.parametrize("way", ["power_up", "to_ready", "to_driving", "to_finished"])
def test_a_brake_request_counts_in_every_state(way: str) -> None:
    bench: Bench = getattr(Bench(), way)()
    bench.deliver(front_brake_pct=30.0, rear_brake_pct=20.0)
    order = bench.vcu.actuation
    assert (order.front_brake_pct, order.rear_brake_pct) == (30.0, 20.0)


ASKED = {"front_torque_nm": 195.0, "rear_torque_nm": 195.0, "steer_deg": -21.0}


@pytest.mark.parametrize(
    ("name", "changes", "switches", "expected"),
    [
        ("2021", {}, {}, (195.0, 195.0, -21.0)),
        ("2021", {}, {"torque_limit_nm": 60.0, "steer_limit_deg": 12.0}, (60.0, 60.0, -12.0)),
        ("2021", {"direction": Direction.NEUTRAL}, {}, (0.0, 0.0, -21.0)),
        ("2021", {"direction": Direction.REVERSE}, {}, (0.0, 0.0, -21.0)),
        ("2026", {}, {}, (0.0, 195.0, -21.0)),  # no motor in front
    ],
)
def test_orders_keep_to_direction_live_limits_and_motors(
    name: str, changes: dict[str, Any], switches: dict[str, float], expected: tuple[float, ...]
) -> None:
    bench = Bench(name).to_driving()
    for switch, value in switches.items():
        setattr(bench.switches, switch, value)
    bench.deliver(**ASKED, **changes)
    order = bench.vcu.actuation
    assert (order.front_torque_nm, order.rear_torque_nm, order.steer_deg) == expected


def test_an_emergency_brakes_cuts_torque_and_holds_the_steering() -> None:
    bench = Bench().to_driving()
    bench.deliver(rear_torque_nm=100.0, steer_deg=7.0)
    bench.switches.remote_estop = True
    bench.tick()
    bench.deliver(steer_deg=-7.0)
    order = bench.vcu.actuation
    assert order.ebs_engaged
    assert not order.tractive_system_live
    assert (order.rear_torque_nm, order.steer_deg, order.front_brake_pct) == (0.0, 7.0, 100.0)
