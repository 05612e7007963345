"""The command gate, held to the safety rules by itself: whatever a decision or a command says."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.supervision.config import BridgeConfig, Reason, official_simulator
from fsai_vcu.core.supervision.gate import GateState, constant_power_nm, gate, gate_config, motor_rpm, sent
from fsai_vcu.core.supervision.supervisor import OUTPUT, Brake, Decision, Phase, Steer
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import (
    AiCommand,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    VehicleState,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS, S

NOW = 1000 * S
CODEC = Codec(revision("2026"))
CAR = gate_config(BridgeConfig(), revision("2026"), ADS_DV_2026)
CAR_2021 = gate_config(BridgeConfig(), revision("2021"), ADS_DV_2021)


def decision(phase: Phase = Phase.DRIVING, **changes: Any) -> Decision:
    row = OUTPUT[phase]
    values: dict[str, Any] = {
        "phase": phase,
        "mission_status": row.mission_status or MissionStatus.SELECTED,
        "direction": row.direction,
        "steer": Steer.HELD if row.steer is Steer.HELD_OR_COMMAND else row.steer,
        "brake": row.brake,
        "torque": row.torque,
        "run_id": 1,
        "may_move": phase not in (Phase.IDLE, Phase.READY, Phase.LAUNCH_WAIT),
        **changes,
    }
    return Decision(**values)


def car(as_state: AsState = AsState.AS_DRIVING, rpm: int = 100, t_ns: int = NOW, **changes: Any) -> VehicleState:
    """A car that has said everything just now."""
    values: dict[str, Any] = {
        "handshake": True,
        "status": VcuStatus(as_state=as_state, go_signal=True, t_rx_ns=t_ns),
        "drive_front": VcuDriveFront(0, 0, 195.0, t_rx_ns=t_ns),
        "drive_rear": VcuDriveRear(0, 0, 195.0, t_rx_ns=t_ns),
        "steer": VcuSteer(0, 30.0, 0, t_rx_ns=t_ns),
        "brake": VcuBrake(t_rx_ns=t_ns),
        "speeds": WheelSpeeds(rpm, rpm, rpm, rpm, t_rx_ns=t_ns),
        **changes,
    }
    return VehicleState(**values)


def command(**changes: Any) -> VehicleCommand:
    values: dict[str, Any] = {"t_sensor_ns": NOW, "run_id": 1, "throttle": 1.0, "speed_limit_mps": 10.0, **changes}
    return VehicleCommand(**values)


START = GateState(acknowledged_run_id=1)
"""Nothing is known of what the VCU may hold, but the mission was acknowledged."""

FREE = replace(START, torque_there=False, zero_cycles=2, zero_since_ns=NOW - 20 * MS, cycle_ns=NOW - 10 * MS, run_id=1)
"""Two complete cycles of zeros went out: torque may rise, and so may the brake."""


def asks(
    state: GateState = FREE,
    what: Decision | None = None,
    order: VehicleCommand | None = None,
    vehicle: VehicleState | None = None,
    *,
    config: Any = CAR,
    now_ns: int = NOW,
) -> tuple[AiCommand, frozenset[Reason]]:
    _, asked, reasons = gate(
        config, state, what or decision(), command() if order is None else order, vehicle or car(), now_ns
    )
    return asked, reasons


# ---------------------------------------------------------------- values


FRONT_DRIVEN = replace(CAR_2021, driven_rear=False)


@pytest.mark.parametrize(
    ("config", "throttle", "torque_nm", "rpm"),
    [
        (CAR, 1.0, (0.0, 195.0), (0, 1318)),
        (CAR_2021, 0.5, (97.5, 97.5), (1318, 1318)),
        (FRONT_DRIVEN, 1.0, (195.0, 0.0), (1318, 0)),
    ],
)
def test_a_valid_command_becomes_torque_on_the_driven_axles(
    config: Any, throttle: float, torque_nm: tuple[float, float], rpm: tuple[int, int]
) -> None:
    asked, reasons = asks(order=command(throttle=throttle), config=config)
    assert (asked.front_torque_nm, asked.rear_torque_nm) == torque_nm
    assert (asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm) == rpm
    assert (asked.brake_requested, asked.steer_deg, reasons) == (False, 0.0, frozenset())


def test_the_handshake_is_the_last_one_received() -> None:
    for bit in (True, False):
        assert asks(vehicle=car(handshake=bit))[0].handshake is bit


@pytest.mark.parametrize(
    ("rpm", "torque_nm"),
    [
        (0, 195.0),
        (300, 195.0),
        (301, 150.0),
        (400, 150.0),
        (401, 120.0),
        (500, 120.0),
        (501, 100.0),
        (600, 100.0),
        (601, 85.0),
        (700, 85.0),
        (701, 50.0),
        (1250, 50.0),
    ],
)
def test_constant_power_allows_less_above_each_wheel_speed(rpm: int, torque_nm: float) -> None:
    assert constant_power_nm(rpm) == torque_nm
    assert asks(vehicle=car(rpm=rpm))[0].rear_torque_nm == torque_nm


def test_the_fastest_wheel_of_the_same_axle_limits_the_torque() -> None:
    front_fast = car(speeds=WheelSpeeds(900, 900, 100, 100, t_rx_ns=NOW))
    assert asks(vehicle=front_fast)[0].rear_torque_nm == 195.0
    for speeds in (WheelSpeeds(0, 0, 701, 0, t_rx_ns=NOW), WheelSpeeds(0, 0, 0, 701, t_rx_ns=NOW)):
        assert asks(vehicle=car(speeds=speeds))[0].rear_torque_nm == 50.0
    asked, _ = asks(vehicle=front_fast, config=CAR_2021)
    assert (asked.front_torque_nm, asked.rear_torque_nm) == (50.0, 195.0)


def test_the_cars_live_torque_limit_is_obeyed_per_axle() -> None:
    vehicle = car(drive_front=VcuDriveFront(0, 0, 20.0, NOW), drive_rear=VcuDriveRear(0, 0, 33.3, NOW))
    asked, _ = asks(vehicle=vehicle, config=CAR_2021)
    assert (asked.front_torque_nm, asked.rear_torque_nm) == (20.0, 33.3)
    assert asks(order=command(throttle=0.5), vehicle=vehicle)[0].rear_torque_nm == 16.6  # never rounded up
    for limit_nm in (0.0, -20.0):
        assert asks(vehicle=car(drive_rear=VcuDriveRear(0, 0, limit_nm, NOW)))[0].rear_torque_nm == 0.0


@pytest.mark.parametrize("age_ns", [None, 100 * MS])
def test_without_the_cars_live_torque_limit_there_is_no_torque(age_ns: int | None) -> None:
    vehicle = car(drive_rear=None if age_ns is None else VcuDriveRear(0, 0, 195.0, NOW - age_ns))
    asked, reasons = asks(vehicle=vehicle)
    assert (asked.rear_torque_nm, reasons) == (0.0, {Reason.TORQUE_LIMIT_UNKNOWN})
    vehicle = car(drive_rear=VcuDriveRear(0, 0, 195.0, NOW - 100 * MS + 1))
    assert asks(vehicle=vehicle)[0].rear_torque_nm == 195.0
    one = car(drive_front=None)
    asked, reasons = asks(vehicle=one, config=CAR_2021)
    assert (asked.front_torque_nm, asked.rear_torque_nm, reasons) == (0.0, 195.0, {Reason.TORQUE_LIMIT_UNKNOWN})


@pytest.mark.parametrize("speeds", [None, WheelSpeeds(0, 0, 0, 0, NOW - 100 * MS)])
def test_without_fresh_wheel_speeds_there_is_no_torque(speeds: WheelSpeeds | None) -> None:
    for config in (CAR, CAR_2021):
        asked, reasons = asks(vehicle=car(speeds=speeds), config=config)
        assert (asked.front_torque_nm, asked.rear_torque_nm) == (0.0, 0.0)
        assert reasons == frozenset()  # the supervisor names what is missing
    asked, _ = asks(vehicle=car(speeds=WheelSpeeds(0, 0, 0, 0, NOW - 100 * MS + 1)))
    assert asked.rear_torque_nm == 195.0


def test_an_unknown_torque_limit_is_no_reason_without_torque() -> None:
    for what, order in ((decision(Phase.HOLDING), command()), (decision(), command(throttle=0.0))):
        asked, reasons = asks(what=what, order=order, vehicle=car(drive_rear=None))
        assert (asked.rear_torque_nm, reasons) == (0.0, frozenset())


def test_the_smallest_of_all_limits_is_in_force() -> None:
    """Of the revision, the car, the interface and the official."""
    for steer_deg, expected_deg in ((math.inf, 21.0), (21.5, 21.0), (20.5, 20.5)):
        limits = OperationalLimits(max_steer_deg=steer_deg)
        assert gate_config(BridgeConfig(), revision("2021"), ADS_DV_2021, limits).steer_limit_deg == expected_deg
    for car_nm, official_nm, expected_nm in (
        (195.0, math.inf, 195.0),
        (300.0, math.inf, 195.0),
        (150.0, math.inf, 150.0),
        (150.0, 140.0, 140.0),
        (150.0, 160.0, 150.0),
    ):
        weak = replace(ADS_DV_2026, axle_torque_max_nm=car_nm)
        limits = OperationalLimits(max_axle_torque_nm=official_nm)
        assert gate_config(BridgeConfig(), revision("2026"), weak, limits).torque_limit_nm == expected_nm


def test_what_an_official_limits_is_never_exceeded() -> None:
    limits = OperationalLimits(max_speed_mps=5.0, max_axle_torque_nm=40.0, max_steer_deg=1.0)
    config = gate_config(BridgeConfig(steer_rate_degps=1000.0), revision("2026"), ADS_DV_2026, limits)
    asked, _ = asks(order=command(speed_limit_mps=99.0, steering_rad=math.radians(9.0)), config=config)
    assert (asked.rear_torque_nm, asked.rear_motor_speed_max_rpm, asked.steer_deg) == (40.0, 659, 1.0)
    slower, _ = asks(order=command(speed_limit_mps=2.0), config=config)
    assert slower.rear_motor_speed_max_rpm == 263


def test_the_motor_speed_limit_ends_at_4000_rpm_and_at_zero() -> None:
    assert asks(order=command(speed_limit_mps=1e30))[0].rear_motor_speed_max_rpm == 4000
    assert asks(order=command(speed_limit_mps=0.0))[0].rear_motor_speed_max_rpm == 0
    assert motor_rpm(1.0, 100.0, 4000) == 100
    assert motor_rpm(0.999, 100.0, 4000) == 99
    assert motor_rpm(math.inf, 100.0, 4000) == 4000
    assert (motor_rpm(39.99, 100.0, 4000), motor_rpm(40.0, 100.0, 4000), motor_rpm(40.01, 100.0, 4000)) == (
        3999,
        4000,
        4000,
    )
    assert (motor_rpm(0.0, 100.0, 4000), motor_rpm(-1.0, 100.0, 4000)) == (0, 0)


@pytest.mark.parametrize(
    ("fraction", "percent"), [(0.0, 0.0), (0.002, 0.0), (0.0025, 0.5), (0.5, 50.0), (0.503, 50.5), (1.0, 100.0)]
)
def test_the_brake_goes_out_in_half_percents_on_both_axles(fraction: float, percent: float) -> None:
    asked, _ = asks(order=command(throttle=0.0, brake=fraction))
    assert (asked.front_brake_pct, asked.rear_brake_pct) == (percent, percent)


def test_logging_fields_saturate() -> None:
    asked, reasons = asks(order=command(laps=99, cones_count_actual=999, cones_count_all=99999, speed_limit_mps=999.0))
    assert (asked.lap_counter, asked.cones_count_actual, asked.cones_count_all) == (15, 255, 65535)
    assert (asked.speed_demand_kmh, reasons) == (255, frozenset())
    asked, _ = asks(order=command(laps=-1, cones_count_actual=-5, cones_count_all=-5))
    assert (asked.lap_counter, asked.cones_count_actual, asked.cones_count_all) == (0, 0, 0)
    for speed_mps, kmh in ((10.0, 36), (999.0, 255), (-1.0, 0), (math.nan, 0), (math.inf, 255)):
        assert gate(CAR, FREE, decision(), command(), car(), NOW, speed_mps)[1].speed_actual_kmh == kmh
    assert asks()[0].speed_actual_kmh == 0
    for what, order, kmh in (
        (decision(), command(), 36),
        (decision(Phase.HOLDING), command(), 0),
        (decision(), None, 0),
    ):
        assert gate(CAR, FREE, what, order, car(), NOW)[1].speed_demand_kmh == kmh


def test_laps_stay_on_the_bus_until_the_run_ends() -> None:
    order = command(run_id=7, laps=3, cones_count_actual=5, cones_count_all=44)
    state, _, _ = gate(CAR, FREE, decision(run_id=7), order, car(), NOW)
    for as_state, silent in ((AsState.AS_DRIVING, None), (AsState.AS_FINISHED, None), (AsState.AS_FINISHED, order)):
        late = None if silent is None else replace(silent, laps=9, cones_count_actual=9, cones_count_all=9)
        state, asked, _ = gate(CAR, state, decision(Phase.FINISHED, run_id=7), late, car(as_state, rpm=0), NOW)
        assert (asked.lap_counter, asked.cones_count_actual, asked.cones_count_all) == (3, 5, 44)
    for before, run_id in ((state, 8), (START, 0), (START, 1), (START, 7)):
        _, asked, _ = gate(CAR, before, decision(Phase.IDLE, run_id=run_id), None, car(AsState.AS_OFF), NOW)
        assert (asked.lap_counter, asked.cones_count_actual, asked.cones_count_all) == (0, 0, 0)


# ---------------------------------------------------------------- steering (rule 4)


def steered(degrees: float, state: GateState = FREE, now_ns: int = NOW, **changes: Any) -> AiCommand:
    return asks(state, order=command(steering_rad=math.radians(degrees)), vehicle=car(**changes), now_ns=now_ns)[0]


def test_steering_held_to_the_actuator_rate_gives_no_reason() -> None:
    asked, reasons = asks(order=command(steering_rad=math.radians(20.0)))
    assert (asked.steer_deg, reasons) == (0.4, frozenset())
    assert steered(-20.0).steer_deg == -0.4
    assert steered(0.3).steer_deg == 0.3
    assert steered(20.0, replace(FREE, cycle_ns=NOW - 8 * MS)).steer_deg == 0.3


def test_steering_keeps_to_the_rate_from_cycle_to_cycle() -> None:
    state = replace(FREE, cycle_ns=None)
    for n in range(70):
        now_ns = NOW + n * 8 * MS
        order = command(t_sensor_ns=now_ns, steering_rad=math.radians(20.0))
        state, asked, _ = gate(CAR, state, decision(), order, car(t_ns=now_ns), now_ns)
        assert state.steer_deg == pytest.approx(min(20.0, 0.32 * n)) == pytest.approx(asked.steer_deg, abs=0.1)
    assert asked.steer_deg == 20.0  # it arrives, in spite of rounding


@pytest.mark.parametrize(
    ("steer", "limit_deg"),
    [(VcuSteer(0, 5.0, 0, NOW), 5.0), (VcuSteer(0, 0.0, 0, NOW), 0.0), (VcuSteer(0, -5.0, 0, NOW), 0.0), (None, 0.0)],
)
def test_an_angle_max_that_shrinks_is_obeyed_at_once(steer: VcuSteer | None, limit_deg: float) -> None:
    for sign in (1, -1):
        state = replace(FREE, steer_deg=sign * 20.0)
        assert steered(sign * 20.0, state, steer=steer).steer_deg == sign * limit_deg


def test_after_a_pause_the_steering_does_not_jump() -> None:
    for pause_ns, turned_deg in ((20 * MS, 0.8), (20 * MS - 1, 0.8 - 40e-9), (20 * MS + 1, 0.8), (5 * S, 0.8)):
        order = command(steering_rad=math.radians(20.0))
        state, _, _ = gate(CAR, replace(FREE, cycle_ns=NOW - pause_ns), decision(), order, car(), NOW)
        assert state.steer_deg == pytest.approx(turned_deg, abs=1e-9)
    assert steered(20.0, replace(FREE, cycle_ns=NOW - 5 * S)).steer_deg == 0.8
    for cycle_ns in (None, NOW, NOW + 5 * S):  # the first cycle, and time that does not pass
        order = command(steering_rad=math.radians(20.0))
        state, _, _ = gate(CAR, replace(FREE, cycle_ns=cycle_ns), decision(), order, car(), NOW)
        assert state.steer_deg == 0.0


def test_steering_beyond_revision_or_angle_max_is_clamped() -> None:
    turned = replace(FREE, steer_deg=20.8)
    assert steered(21.0, turned).steer_deg == 21.0
    asked, reasons = asks(turned, order=command(steering_rad=math.radians(25.0)), config=CAR_2021)
    assert (asked.steer_deg, reasons) == (21.0, {Reason.STEER_CLAMPED})
    vehicle = car(steer=VcuSteer(0, 20.9, 0, NOW))
    asked, reasons = asks(turned, order=command(steering_rad=math.radians(-25.0)), vehicle=vehicle)
    assert (asked.steer_deg, reasons) == (20.4, {Reason.STEER_CLAMPED})
    asked, reasons = asks(turned, order=command(steering_rad=math.radians(20.94)), vehicle=vehicle)
    assert (asked.steer_deg, reasons) == (20.9, frozenset())


def test_half_a_signal_step_beyond_angle_max_is_no_reason() -> None:
    for degrees, reasons in ((0.049, frozenset()), (0.05, frozenset()), (0.051, {Reason.STEER_CLAMPED})):
        order = command(steering_rad=math.radians(degrees))
        assert math.degrees(order.steering_rad) == degrees
        asked, found = asks(order=order, vehicle=car(steer=VcuSteer(0, 0.0, 0, NOW)))
        assert (asked.steer_deg, found) == (0.0, reasons)


@pytest.mark.parametrize("as_state", [state for state in AsState if state is not AsState.AS_DRIVING])
def test_outside_as_driving_the_steering_is_zero_at_once(as_state: AsState) -> None:
    asked, _ = asks(replace(FREE, steer_deg=12.0), decision(steer=Steer.HELD), vehicle=car(as_state))
    assert asked.steer_deg == 0.0
    asked, _ = asks(replace(FREE, steer_deg=12.0), decision(steer=Steer.COMMAND), vehicle=car(as_state))
    assert asked.steer_deg == 0.0
    for phase in (Phase.LAUNCH_WAIT, Phase.READY, Phase.FINISHED):  # and where the table says so
        assert asks(replace(FREE, steer_deg=12.0), decision(phase), vehicle=car(rpm=0))[0].steer_deg == 0.0


def test_steering_held_stays_where_it_was() -> None:
    what = decision(Phase.HOLDING)
    assert asks(replace(FREE, steer_deg=12.0), what)[0].steer_deg == 12.0
    assert asks(replace(FREE, steer_deg=-12.34), decision(Phase.STOPPING))[0].steer_deg == -12.3
    state = replace(FREE, steer_deg=12.0)
    assert gate(CAR, state, decision(), None, car(), NOW)[1].steer_deg == 12.0  # by command, and there is none


# ---------------------------------------------------------------- torque (rule 2)


def status(age_ns: int = 0, **changes: Any) -> VcuStatus:
    values: dict[str, Any] = {"as_state": AsState.AS_DRIVING, "go_signal": True, **changes}
    return VcuStatus(t_rx_ns=NOW - age_ns, **values)


MOTOR = gate_config(official_simulator(), revision("2026"), ADS_DV_2026)
BRAKING = decision(Phase.STOPPING)


@pytest.mark.parametrize(
    ("what", "vehicle"),
    [
        ({}, {"as_state": AsState.AS_READY}),
        ({}, {"as_state": AsState.EMERGENCY_BRAKE}),
        ({}, {"status": None}),
        ({}, {"status": status(age_ns=50 * MS)}),
        ({}, {"status_known": False}),
        ({"estop": True}, {}),
        ({"direction": Direction.NEUTRAL}, {"rpm": 0}),
        ({"direction": Direction.REVERSE}, {"rpm": 0}),
    ],
)
def test_torque_is_blocked_where_the_car_is_not_known_to_drive(what: dict[str, Any], vehicle: dict[str, Any]) -> None:
    """Though the supervisor allows it; and where the motors are the brake, they do not brake either."""
    asked, reasons = asks(what=decision(**what), vehicle=car(**vehicle))
    assert not asked.torque_requested and Reason.TORQUE_BLOCKED in reasons
    asked, _ = asks(what=replace(BRAKING, **what), order=command(throttle=0.0), vehicle=car(**vehicle), config=MOTOR)
    assert not asked.torque_requested


def test_torque_needs_go_a_run_acknowledged_and_the_3_s_over() -> None:
    """Not so the torque by which the motors brake."""
    assert asks(vehicle=car(status=status(age_ns=50 * MS - 1)))[0].torque_requested
    for state, what, vehicle in (
        (FREE, {}, car(status=status(go_signal=False))),
        (FREE, {"may_move": False}, car()),
        *((replace(FREE, acknowledged_run_id=run_id), {}, car()) for run_id in (None, 0, 2)),
    ):
        asked, reasons = asks(state, decision(**what), vehicle=vehicle)
        assert not asked.torque_requested and reasons == {Reason.TORQUE_BLOCKED}
        asked, reasons = asks(state, replace(BRAKING, **what), vehicle=vehicle, config=MOTOR)
        assert asked.torque_requested and reasons == frozenset()


@pytest.mark.parametrize("phase", [phase for phase in Phase if phase is not Phase.DRIVING])
def test_no_other_phase_gives_torque_to_a_command(phase: Phase) -> None:
    asked, reasons = asks(what=decision(phase), vehicle=car(rpm=0))
    assert not asked.torque_requested and asked.rear_motor_speed_max_rpm == 0
    assert reasons == frozenset()


@pytest.mark.parametrize(
    "order",
    [
        command(run_id=2),
        command(t_sensor_ns=NOW - 500 * MS),
        command(throttle=math.nan),
        command(throttle=1.1),
        command(brake=-0.1),
        command(steering_rad=math.inf),
        command(speed_limit_mps=math.nan),
    ],
)
def test_a_command_that_is_not_valid_gives_nothing_even_here(order: VehicleCommand) -> None:
    _, asked, _ = gate(CAR, replace(FREE, steer_deg=3.0, brake=0.4), decision(), order, car(), NOW)
    assert (asked.torque_requested, asked.steer_deg, asked.rear_brake_pct) == (False, 3.0, 40.0)


def test_brake_wins_over_throttle() -> None:
    asked, _ = asks(order=command(throttle=1.0, brake=0.2))
    assert (asked.rear_torque_nm, asked.rear_brake_pct) == (0.0, 20.0)
    asked, _ = asks(order=command(throttle=1.0, brake=0.001))  # less than the signal can say
    assert (asked.rear_torque_nm, asked.rear_brake_pct) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("phase", "percent"),
    [
        (Phase.READY, 30.0),
        (Phase.LAUNCH_WAIT, 30.0),
        (Phase.STOPPED, 30.0),
        (Phase.STOPPING, 80.0),
        (Phase.ESTOP_ASKED, 80.0),
        (Phase.EMERGENCY_MOVING, 0.0),
        (Phase.IDLE, 0.0),
        (Phase.HOLDING, 40.0),
    ],
)
def test_each_phase_has_its_own_brake_share_and_holding_the_last(phase: Phase, percent: float) -> None:
    asked, _ = asks(replace(FREE, brake=0.4), decision(phase), vehicle=car(rpm=0))
    assert (asked.front_brake_pct, asked.rear_brake_pct) == (percent, percent)


# ---------------------------------------------------------------- standstill (rule 3)


@pytest.mark.parametrize("phase", [Phase.STOPPED, Phase.FINISHED, Phase.READY, Phase.IDLE])
def test_moving_in_as_driving_never_sends_neutral_or_finished(phase: Phase) -> None:
    for speeds in (None, WheelSpeeds(0, 0, 10, 0, NOW), WheelSpeeds(0, 0, 0, 0, NOW - 100 * MS)):
        asked, reasons = asks(what=decision(phase), vehicle=car(speeds=speeds))
        assert (asked.direction, asked.mission_status) == (Direction.FORWARD, MissionStatus.RUNNING)
        assert Reason.STILLNESS_UNPROVEN in reasons
    asked, reasons = asks(what=decision(phase), vehicle=car(rpm=9))
    assert (asked.direction, asked.mission_status) == (
        Direction.NEUTRAL,
        OUTPUT[phase].mission_status or MissionStatus.SELECTED,
    )
    assert reasons == frozenset()
    forward = decision(phase, direction=Direction.FORWARD, mission_status=MissionStatus.FINISHED)
    assert asks(what=forward, vehicle=car(rpm=10))[0].mission_status is MissionStatus.RUNNING


def test_outside_as_driving_neutral_needs_no_proof() -> None:
    asked, reasons = asks(what=decision(Phase.READY), vehicle=car(AsState.AS_READY, speeds=None))
    assert (asked.direction, reasons) == (Direction.NEUTRAL, frozenset())


# ---------------------------------------------------------------- the interlock (rule 1)


def cycle(
    state: GateState, what: Decision, now_ns: int, complete: bool | None = True, **changes: Any
) -> tuple[GateState, AiCommand]:
    """One cycle made and, unless `complete` is None, sent."""
    vehicle = car(t_ns=now_ns, **changes)
    state, asked, _ = gate(CAR, state, what, command(t_sensor_ns=now_ns), vehicle, now_ns)
    return (state if complete is None else sent(state, complete, now_ns)), asked


FRESH = replace(START, run_id=1)
KINDS = {"D": decision(), "B": BRAKING, "H": decision(Phase.HOLDING), "Z": decision(Phase.EMERGENCY_MOVING)}


@pytest.mark.parametrize("broken", [False, None])
@pytest.mark.parametrize(
    ("state", "cycles", "asked"),
    [
        (FRESH, "D D", "0 T"),  # after a start the first cycle is all zeros
        (FRESH, "B B", "0 B"),
        (FREE, "B D D", "B 0 T"),  # torque after one zero cycle that 0x524 echoes
        (FREE, "B D- D- D-", "B 0 0 T"),  # or after two of them
        (FREE, "B D! D! D! D D", "B 0 0 0 0 T"),  # which must have gone out whole
        (FREE, "B! D", "B 0"),  # a brake that may have gone out keeps the torque back
        (FREE, "D B B", "T 0 B"),  # the brake after one complete cycle without torque
        (FREE, "D B! B! B! B B", "T 0 0 0 0 B"),
        (FREE, "D! B", "T 0"),  # a torque that may have gone out keeps the brake back
        (FREE, "D D! D", "T T T"),  # torque that runs goes on through a broken cycle
        (FREE, "D H! D", "T 0 0"),  # one that was zero in it does not
        (FREE, "Z! D", "0 T"),  # a broken cycle of zeros takes nothing back
        (FREE, "Z! B", "0 B"),
        (FREE, "D! Z! D- D- D-", "T 0 0 0 T"),  # whole zeros must follow what a broken cycle tried
        (FREE, "B! Z! D- D- D-", "B 0 0 0 T"),
    ],
)
def test_torque_and_brake_wait_for_one_another(state: GateState, cycles: str, asked: str, broken: bool | None) -> None:
    """Cycles that drive, brake, hold or ask for zeros; ! not sent whole or nobody says so, - not echoed by 0x524."""
    for n, (what, expected) in enumerate(zip(cycles.split(), asked.split(), strict=True)):
        more = {"brake": None} if "-" in what else {}
        state, sent_now = cycle(state, KINDS[what[0]], NOW + n * 10 * MS, broken if "!" in what else True, **more)
        assert (sent_now.torque_requested, sent_now.brake_requested) == (expected == "T", expected == "B"), n


def test_each_cycle_is_told_of_once() -> None:
    for complete in (True, False):
        assert sent(START, complete, NOW) == START
        told, _ = cycle(FREE, BRAKING, NOW, complete)
        assert sent(told, True, NOW + 1) == sent(told, False, NOW + 1) == told


def test_a_brake_that_nobody_ever_asked_for_is_not_kept() -> None:
    state = replace(START, run_id=1)
    for n in range(5):
        state, asked = cycle(state, decision(Phase.HOLDING), NOW + n * 10 * MS)
        assert (asked.front_brake_pct, asked.rear_brake_pct) == (0.0, 0.0)


def test_a_new_gate_assumes_torque_at_the_vcu_and_nothing_else() -> None:
    begun = START
    assert (begun.torque_there, begun.torque_running, begun.awaiting) == (True, False, False)
    assert (begun.tried_torque, begun.tried_brake, begun.zero_cycles, begun.zero_since_ns) == (False, False, 0, 0)
    assert (begun.steer_deg, begun.brake, begun.cycle_ns, begun.run_id) == (0.0, 0.0, None, 0)


@pytest.mark.parametrize(
    "brake",
    [
        None,
        VcuBrake(front_request_pct=0.5, t_rx_ns=NOW + 20 * MS),
        VcuBrake(rear_request_pct=0.5, t_rx_ns=NOW + 20 * MS),
        VcuBrake(t_rx_ns=NOW + 10 * MS),  # from before the zeros could be seen
    ],
)
def test_without_the_echo_torque_rises_after_two_zero_cycles(brake: VcuBrake | None) -> None:
    state, _ = cycle(FREE, BRAKING, NOW)
    state, _ = cycle(state, decision(), NOW + 10 * MS, brake=brake)
    state, asked = cycle(state, decision(), NOW + 20 * MS, brake=brake)
    assert not asked.torque_requested
    _, asked = cycle(state, decision(), NOW + 30 * MS, brake=brake)
    assert asked.torque_requested


@pytest.mark.parametrize("axle", ["front", "rear"])
def test_the_smallest_torque_step_counts_on_either_axle(axle: str) -> None:
    config = replace(CAR_2021, driven_front=axle == "front", driven_rear=axle == "rear")
    state, asked, _ = gate(config, FREE, decision(), command(throttle=0.1 / 195.0), car(), NOW)
    assert asked.front_torque_nm + asked.rear_torque_nm == 0.1
    state, asked, _ = gate(config, sent(state, True, NOW), BRAKING, command(), car(), NOW)
    assert not asked.brake_requested
    _, asked, _ = gate(config, sent(state, True, NOW), BRAKING, command(), car(), NOW)
    assert asked.brake_requested


def test_the_least_brake_counts_and_waits_as_any() -> None:
    state, asked, _ = gate(CAR, FREE, decision(), command(brake=0.005), car(), NOW)
    assert asked.rear_brake_pct == 0.5
    assert not cycle(sent(state, True, NOW), decision(), NOW + 10 * MS)[1].torque_requested
    state, _ = cycle(FREE, decision(), NOW)
    state, asked, _ = gate(CAR, state, decision(), command(brake=0.005), car(), NOW)
    assert not asked.brake_requested and not asked.torque_requested
    assert gate(CAR, sent(state, True, NOW), decision(), command(brake=0.005), car(), NOW)[1].rear_brake_pct == 0.5


def test_a_brake_that_waits_is_not_forgotten() -> None:
    state, _ = cycle(FREE, decision(), NOW)
    state, _, _ = gate(CAR, state, decision(), command(brake=0.6), car(), NOW + 10 * MS)
    state = sent(state, True, NOW + 10 * MS)
    _, asked = cycle(state, decision(Phase.HOLDING), NOW + 20 * MS)
    assert asked.rear_brake_pct == 60.0  # kept, though its own cycle had to be zero


def test_a_gate_that_sends_zeros_settles_in_one_state() -> None:
    """An exhaustive search visits every state: there must be an end of them."""
    state, states = replace(START, run_id=1), set()
    for _ in range(10):
        state, _ = cycle(state, decision(Phase.IDLE), NOW)
        states.add(state)
    assert len(states) == 2


@settings(max_examples=300)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([Phase.DRIVING, Phase.DRIVING, Phase.HOLDING, Phase.STOPPING, Phase.EMERGENCY_MOVING]),
            st.booleans(),  # throttle
            st.booleans(),  # brake
            st.sampled_from([True, True, False, None]),  # sent whole
            st.booleans(),  # 0x524 echoes
        ),
        max_size=40,
    )
)
def test_torque_and_brake_never_meet_whichever_frames_arrive(steps: list[Any]) -> None:
    """The VCU keeps what it saw last; of a broken cycle any of the frames may have arrived."""
    state = replace(START, run_id=1)
    torque_at_vcu, brake_at_vcu = {True, False}, {True, False}  # what may be there
    for n, (phase, throttle, brake, complete, echoes) in enumerate(steps):
        now_ns = NOW + n * 10 * MS
        order = command(t_sensor_ns=now_ns, throttle=float(throttle), brake=0.3 * brake)
        echo = VcuBrake(front_request_pct=50.0 if True in brake_at_vcu and not echoes else 0.0, t_rx_ns=now_ns)
        state, asked, _ = gate(CAR, state, decision(phase), order, car(t_ns=now_ns, brake=echo), now_ns)
        torque, braking = asked.torque_requested, asked.brake_requested
        # In the order of the frames: torque (0x511, 0x512) arrives while the old brake is still there, and the other
        # way round if the torque's frame of this cycle is lost.
        assert not (torque and (True in brake_at_vcu or braking))
        assert not (braking and True in torque_at_vcu)
        if complete:
            torque_at_vcu, brake_at_vcu = {torque}, {braking}
        else:
            torque_at_vcu |= {torque}
            brake_at_vcu |= {braking}
        if complete is not None:
            state = sent(state, complete, now_ns)


# ---------------------------------------------------------------- the motors as service brake


@pytest.mark.parametrize(
    ("what", "order", "torque_nm", "rpm"),
    [
        (BRAKING, {}, 195.0, 0),  # the share of a stop, 100 % by the motors
        (decision(), {"throttle": 0.0, "brake": 0.5}, 97.5, 0),
        (decision(), {"throttle": 0.5}, 97.5, 1318),
        (decision(Phase.STOPPED), {}, 0.0, 0),
    ],
)
def test_the_official_simulator_brakes_by_torque_at_speed_zero(
    what: Decision, order: dict[str, float], torque_nm: float, rpm: int
) -> None:
    asked, reasons = asks(what=what, order=command(**order), vehicle=car(rpm=0), config=MOTOR)
    assert (asked.rear_torque_nm, asked.rear_motor_speed_max_rpm, asked.brake_requested) == (torque_nm, rpm, False)
    assert reasons == frozenset()


def test_the_official_simulator_gets_no_hydraulic_brake() -> None:
    for phase in Phase:
        for as_state in AsState:
            asked, _ = asks(what=decision(phase), vehicle=car(as_state, rpm=0), config=MOTOR)
            assert not asked.brake_requested
            if as_state is not AsState.AS_DRIVING:
                assert not asked.torque_requested


# ---------------------------------------------------------------- anything at all


@settings(max_examples=500)
@given(
    phase=st.sampled_from(list(Phase)),
    steer=st.sampled_from(list(Steer)),
    brake=st.sampled_from(list(Brake)),
    flags=st.tuples(*[st.booleans()] * 6),
    numbers=st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 4),
    as_state=st.sampled_from(list(AsState)),
    rpm=st.tuples(*[st.integers(0, 1250)] * 4),
    limits=st.tuples(st.floats(0, 30), st.floats(0, 195)),
    held=st.floats(-30, 30),
)
def test_the_codec_takes_whatever_the_gate_gives(
    phase: Phase,
    steer: Steer,
    brake: Brake,
    flags: tuple[bool, ...],
    numbers: tuple[float, ...],
    as_state: AsState,
    rpm: tuple[int, int, int, int],
    limits: tuple[float, float],
    held: float,
) -> None:
    what = decision(phase, steer=steer, brake=brake, torque=flags[0], estop=flags[1], may_move=flags[2])
    order = VehicleCommand(NOW, 1, *numbers) if flags[3] else None
    vehicle = car(
        as_state,
        speeds=WheelSpeeds(*rpm, t_rx_ns=NOW),
        steer=VcuSteer(0, limits[0], 0, NOW),
        drive_rear=VcuDriveRear(0, 0, limits[1], NOW),
    )
    config = MOTOR if flags[4] else CAR
    _, asked, _ = gate(config, replace(FREE, steer_deg=held), what, order, vehicle, NOW)
    CODEC.encode_command(asked)
    assert not (asked.torque_requested and asked.brake_requested)
    assert asked.rear_torque_nm <= min(limits[1], constant_power_nm(max(rpm[2:])))
    assert asked.front_torque_nm == 0.0
    assert abs(asked.steer_deg) <= min(30.0, limits[0])
    if as_state is not AsState.AS_DRIVING:
        assert asked.steer_deg == 0.0 and not asked.torque_requested


# ---------------------------------------------------------------- what it sees for itself


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.READY, Phase.LAUNCH_WAIT])
def test_a_run_is_acknowledged_by_selected_sent_whole(phase: Phase, complete: bool) -> None:
    state, asked, _ = gate(CAR, GateState(), decision(phase, run_id=7), None, car(AsState.AS_READY, 0), NOW)
    said = asked.mission_status is MissionStatus.SELECTED
    assert said == (phase is not Phase.LAUNCH_WAIT)
    assert (sent(state, complete, NOW).acknowledged_run_id == 7) == (said and complete)


def counted(fl: int, t_ns: int) -> WheelCounts:
    return WheelCounts(fl=fl, t_rx_ns=t_ns)


def test_a_single_pulse_or_none_leaves_it_to_the_wheel_speeds() -> None:
    """It may be an edge at rest; counts that do not come any more are not forgotten: they have been the same since."""
    state, _, _ = gate(CAR, FREE, decision(), None, car(rpm=0, counts=counted(4, NOW - 10 * MS)), NOW - 10 * MS)
    for counts in (counted(5, NOW), None):
        asked, _ = asks(state, decision(Phase.STOPPED), vehicle=car(rpm=0, counts=counts))
        assert asked.mission_status is MissionStatus.FINISHED


@pytest.mark.parametrize(("age_ns", "held"), [(500 * MS - 1, True), (500 * MS, False)])
@pytest.mark.parametrize("phase", [Phase.STOPPED, Phase.FINISHED])
def test_finished_is_not_said_while_counts_advance(phase: Phase, age_ns: int, held: bool) -> None:
    state = FREE
    for fl, t_ns in ((65535, NOW - age_ns - 10 * MS), (1, NOW - age_ns)):
        vehicle = car(rpm=0, t_ns=t_ns, counts=counted(fl, t_ns))
        state, _, _ = gate(CAR, state, decision(), None, vehicle, t_ns)
    asked, reasons = asks(state, decision(phase), vehicle=car(rpm=0, counts=counted(1, NOW)))
    expected = (MissionStatus.RUNNING, Direction.FORWARD) if held else (MissionStatus.FINISHED, Direction.NEUTRAL)
    assert (asked.mission_status, asked.direction) == expected
    assert reasons == ({Reason.STILLNESS_UNPROVEN} if held else frozenset())
