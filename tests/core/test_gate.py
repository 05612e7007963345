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
from fsai_vcu.core.supervision.gate import GateConfig, GateState, constant_power_nm, gate, gate_config, motor_rpm, sent
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


DRIVING, COMMAND, MOVING = decision(), command(), car()


def asks(
    state: GateState = FREE,
    what: Decision = DRIVING,
    order: VehicleCommand | None = COMMAND,
    vehicle: VehicleState = MOVING,
    *,
    config: GateConfig = CAR,
) -> tuple[AiCommand, frozenset[Reason]]:
    _, asked, reasons = gate(config, state, what, order, vehicle, NOW)
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
    config: GateConfig, throttle: float, torque_nm: tuple[float, float], rpm: tuple[int, int]
) -> None:
    asked, reasons = asks(order=command(throttle=throttle), config=config)
    assert (asked.front_torque_nm, asked.rear_torque_nm) == torque_nm
    assert (asked.front_motor_speed_max_rpm, asked.rear_motor_speed_max_rpm) == rpm
    assert (asked.brake_requested, asked.steer_deg, reasons) == (False, 0.0, frozenset())


def test_the_handshake_is_the_last_one_received() -> None:
    for bit in (True, False):
        assert asks(vehicle=car(handshake=bit))[0].handshake is bit


@pytest.mark.parametrize(
    ("rpm", "torque_nm", "above_nm"),
    [
        (0, 195.0, 195.0),
        (300, 195.0, 150.0),
        (400, 150.0, 120.0),
        (500, 120.0, 100.0),
        (600, 100.0, 85.0),
        (700, 85.0, 50.0),
        (1249, 50.0, 50.0),
    ],
)
def test_constant_power_allows_less_above_each_wheel_speed(rpm: int, torque_nm: float, above_nm: float) -> None:
    for now_rpm, expected_nm in ((rpm, torque_nm), (rpm + 1, above_nm)):
        assert constant_power_nm(now_rpm) == expected_nm
        assert asks(vehicle=car(rpm=now_rpm))[0].rear_torque_nm == expected_nm


@pytest.mark.parametrize(
    ("changes", "torque_nm", "reasons"),
    [
        ({"speeds": WheelSpeeds(900, 900, 100, 100, NOW)}, (50.0, 195.0), set()),
        ({"speeds": WheelSpeeds(0, 0, 701, 0, NOW)}, (195.0, 50.0), set()),
        ({"speeds": WheelSpeeds(0, 0, 0, 701, NOW)}, (195.0, 50.0), set()),
        ({"drive_front": VcuDriveFront(0, 0, 20.0, NOW)}, (20.0, 195.0), set()),
        ({"drive_rear": VcuDriveRear(0, 0, 33.3, NOW)}, (195.0, 33.3), set()),
        ({"drive_rear": VcuDriveRear(0, 0, 0.0, NOW)}, (195.0, 0.0), set()),
        ({"drive_rear": VcuDriveRear(0, 0, -20.0, NOW)}, (195.0, 0.0), set()),
        ({"drive_rear": VcuDriveRear(0, 0, 195.0, NOW - 100 * MS + 1)}, (195.0, 195.0), set()),
        ({"drive_rear": VcuDriveRear(0, 0, 195.0, NOW - 100 * MS)}, (195.0, 0.0), {Reason.TORQUE_LIMIT_UNKNOWN}),
        ({"drive_rear": None}, (195.0, 0.0), {Reason.TORQUE_LIMIT_UNKNOWN}),
        ({"drive_front": None}, (0.0, 195.0), {Reason.TORQUE_LIMIT_UNKNOWN}),
        ({"speeds": WheelSpeeds(t_rx_ns=NOW - 100 * MS + 1)}, (195.0, 195.0), set()),
        ({"speeds": WheelSpeeds(t_rx_ns=NOW - 100 * MS)}, (0.0, 0.0), set()),  # the supervisor names what is missing
        ({"speeds": None}, (0.0, 0.0), set()),
    ],
)
def test_the_cars_live_torque_limit_is_obeyed_per_axle(
    changes: dict[str, Any], torque_nm: tuple[float, float], reasons: set[Reason]
) -> None:
    vehicle = car(**changes)
    asked, found = asks(vehicle=vehicle, config=CAR_2021)
    assert (asked.front_torque_nm, asked.rear_torque_nm, found) == (*torque_nm, reasons)
    assert asks(vehicle=vehicle)[0].rear_torque_nm == torque_nm[1]
    for what, order in ((decision(Phase.HOLDING), COMMAND), (DRIVING, command(throttle=0.0))):
        asked, found = asks(what=what, order=order, vehicle=vehicle, config=CAR_2021)
        assert (asked.torque_requested, found) == (False, frozenset())  # no reason where no torque is asked for


def test_torque_is_never_rounded_up() -> None:
    vehicle = car(drive_rear=VcuDriveRear(0, 0, 33.3, NOW))
    assert asks(order=command(throttle=0.5), vehicle=vehicle)[0].rear_torque_nm == 16.6


def test_the_smallest_of_all_limits_is_in_force() -> None:
    """The limits are those of the revision, the car, the interface and the official."""
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
    for speed_mps, rpm in ((0.0, 0), (1e30, 4000)):
        assert asks(order=command(speed_limit_mps=speed_mps))[0].rear_motor_speed_max_rpm == rpm
    speeds_mps = (-1.0, 0.0, 0.999, 1.0, 39.99, 40.0, 40.01, math.inf)
    assert [motor_rpm(mps, 100.0, 4000) for mps in speeds_mps] == [0, 0, 99, 100, 3999, 4000, 4000, 4000]


@pytest.mark.parametrize(
    ("fraction", "percent"),
    [(0.0, 0.0), (0.001, 0.0), (0.002, 0.0), (0.0025, 0.5), (0.2, 20.0), (0.5, 50.0), (0.503, 50.5), (1.0, 100.0)],
)
def test_brake_wins_over_throttle(fraction: float, percent: float) -> None:
    asked, _ = asks(order=command(throttle=1.0, brake=fraction))
    assert (asked.front_brake_pct, asked.rear_brake_pct) == (percent, percent)
    assert asked.torque_requested == (fraction == 0.0)  # also over less than the signal can say


def test_logging_fields_saturate() -> None:
    asked, reasons = asks(order=command(laps=99, cones_count_actual=999, cones_count_all=99999, speed_limit_mps=999.0))
    assert (asked.lap_counter, asked.cones_count_actual, asked.cones_count_all) == (15, 255, 65535)
    assert (asked.speed_demand_kmh, reasons) == (255, frozenset())
    asked, _ = asks(order=command(laps=-1, cones_count_actual=-5, cones_count_all=-5))
    assert (asked.lap_counter, asked.cones_count_actual, asked.cones_count_all) == (0, 0, 0)
    for speed_mps, kmh in ((10.0, 36), (999.0, 255), (-1.0, 0), (math.nan, 0), (math.inf, 255)):
        assert gate(CAR, FREE, DRIVING, COMMAND, MOVING, NOW, speed_mps)[1].speed_actual_kmh == kmh
    assert asks()[0].speed_actual_kmh == 0
    for what, order, kmh in ((DRIVING, COMMAND, 36), (decision(Phase.HOLDING), COMMAND, 0), (DRIVING, None, 0)):
        assert asks(what=what, order=order)[0].speed_demand_kmh == kmh


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


@pytest.mark.parametrize(
    ("before_deg", "wanted_deg", "angle_max_deg", "steer_deg", "clamped"),
    [
        (0.0, 20.0, 30.0, 0.4, False),  # held to the actuator's rate, which is no reason
        (0.0, 0.3, 30.0, 0.3, False),
        (20.8, 21.0, 30.0, 21.0, False),
        (20.8, 25.0, 30.0, 21.0, True),  # the limit of the revision
        (20.8, -25.0, 20.9, 20.4, True),
        (20.8, 20.94, 20.9, 20.9, False),  # half a signal step beyond ANGLE_MAX is no reason
        (0.0, 0.049, 0.0, 0.0, False),
        (0.0, 0.05, 0.0, 0.0, False),
        (0.0, 0.051, 0.0, 0.0, True),
        (20.0, 20.0, 5.0, 5.0, True),  # an ANGLE_MAX that shrinks is obeyed at once
        (20.0, 20.0, 0.0, 0.0, True),
        (20.0, 20.0, -5.0, 0.0, True),
        (20.0, 20.0, None, 0.0, True),
    ],
)
def test_steering_beyond_revision_or_angle_max_is_clamped(
    before_deg: float, wanted_deg: float, angle_max_deg: float | None, steer_deg: float, clamped: bool
) -> None:
    steer = None if angle_max_deg is None else VcuSteer(0, angle_max_deg, 0, NOW)
    for sign in (1, -1):
        state, order = replace(FREE, steer_deg=sign * before_deg), command(steering_rad=math.radians(sign * wanted_deg))
        assert math.degrees(order.steering_rad) == sign * wanted_deg
        asked, reasons = asks(state, order=order, vehicle=car(steer=steer), config=CAR_2021)
        assert (asked.steer_deg, reasons) == (sign * steer_deg, {Reason.STEER_CLAMPED} if clamped else set())


def test_steering_keeps_to_the_rate_from_cycle_to_cycle() -> None:
    state = replace(FREE, cycle_ns=None)
    for n in range(70):
        now_ns = NOW + n * 8 * MS
        order = command(t_sensor_ns=now_ns, steering_rad=math.radians(20.0))
        state, asked, _ = gate(CAR, state, decision(), order, car(t_ns=now_ns), now_ns)
        assert state.steer_deg == pytest.approx(min(20.0, 0.32 * n)) == pytest.approx(asked.steer_deg, abs=0.1)
    assert asked.steer_deg == 20.0  # it arrives, in spite of rounding


@pytest.mark.parametrize(
    ("cycle_ns", "turned_deg", "steer_deg"),
    [
        (NOW - 8 * MS, 0.32, 0.3),
        (NOW - 20 * MS + 1, 0.8 - 40e-9, 0.7),
        (NOW - 20 * MS, 0.8, 0.8),
        (NOW - 20 * MS - 1, 0.8, 0.8),  # after a longer pause it does not jump
        (NOW - 5 * S, 0.8, 0.8),
        (None, 0.0, 0.0),  # the first cycle
        (NOW, 0.0, 0.0),  # time that does not pass
        (NOW + 5 * S, 0.0, 0.0),
    ],
)
def test_steering_turns_for_the_time_since_the_last_cycle(
    cycle_ns: int | None, turned_deg: float, steer_deg: float
) -> None:
    order = command(steering_rad=math.radians(20.0))
    state, asked, _ = gate(CAR, replace(FREE, cycle_ns=cycle_ns), DRIVING, order, MOVING, NOW)
    assert (state.steer_deg, asked.steer_deg) == (pytest.approx(turned_deg, abs=1e-9), steer_deg)


@pytest.mark.parametrize("steer", [Steer.HELD, Steer.COMMAND])
@pytest.mark.parametrize("as_state", [state for state in AsState if state is not AsState.AS_DRIVING])
def test_outside_as_driving_the_steering_is_zero_at_once(as_state: AsState, steer: Steer) -> None:
    asked, _ = asks(replace(FREE, steer_deg=12.0), decision(steer=steer), vehicle=car(as_state))
    assert asked.steer_deg == 0.0


IN_PHASE = {
    Phase.IDLE: (0.0, 0.0),
    Phase.READY: (0.0, 30.0),
    Phase.LAUNCH_WAIT: (0.0, 30.0),
    Phase.HOLDING: (-12.3, 40.0),
    Phase.STOPPING: (-12.3, 80.0),
    Phase.STOPPED: (-12.3, 30.0),
    Phase.ESTOP_ASKED: (-12.3, 80.0),
    Phase.FINISHED: (0.0, 30.0),
    Phase.EMERGENCY_MOVING: (0.0, 0.0),
    Phase.EMERGENCY_STANDING: (0.0, 0.0),
}
"""Steering (deg) and brake (%) after -12.34 deg and 40 %."""


@pytest.mark.parametrize("phase", [phase for phase in Phase if phase is not Phase.DRIVING])
def test_each_other_phase_steers_and_brakes_without_torque(phase: Phase) -> None:
    asked, reasons = asks(replace(FREE, steer_deg=-12.34, brake=0.4), decision(phase), vehicle=car(rpm=0))
    assert (asked.steer_deg, asked.rear_brake_pct) == IN_PHASE[phase]
    assert asked.front_brake_pct == asked.rear_brake_pct
    assert (asked.torque_requested, asked.rear_motor_speed_max_rpm, reasons) == (False, 0, frozenset())


# ---------------------------------------------------------------- torque (rule 2)


NOW_DRIVING = VcuStatus(as_state=AsState.AS_DRIVING, go_signal=True, t_rx_ns=NOW)
MOTOR = gate_config(official_simulator(), revision("2026"), ADS_DV_2026)
BRAKING = decision(Phase.STOPPING)


@pytest.mark.parametrize(
    ("state", "what", "vehicle", "brakes"),
    [
        (FREE, {}, {"as_state": AsState.AS_READY}, False),
        (FREE, {}, {"as_state": AsState.EMERGENCY_BRAKE}, False),
        (FREE, {}, {"status": None}, False),
        (FREE, {}, {"status": replace(NOW_DRIVING, t_rx_ns=NOW - 50 * MS)}, False),
        (FREE, {}, {"status_known": False}, False),
        (FREE, {"estop": True}, {}, False),
        (FREE, {"direction": Direction.NEUTRAL}, {"rpm": 0}, False),
        (FREE, {"direction": Direction.REVERSE}, {"rpm": 0}, False),
        (FREE, {}, {"status": replace(NOW_DRIVING, go_signal=False)}, True),
        (FREE, {"may_move": False}, {}, True),
        *((replace(FREE, acknowledged_run_id=run_id), {}, {}, True) for run_id in (None, 0, 2)),
    ],
)
def test_torque_needs_go_a_run_acknowledged_and_the_3_s_over(
    state: GateState, what: dict[str, Any], vehicle: dict[str, Any], brakes: bool
) -> None:
    """And a car known to drive, though the supervisor allows it; the torque by which the motors brake needs less."""
    asked, reasons = asks(state, decision(**what), vehicle=car(**vehicle))
    assert (asked.torque_requested, reasons) == (False, {Reason.TORQUE_BLOCKED})
    for order in (COMMAND, command(throttle=0.0)):
        asked, reasons = asks(state, replace(BRAKING, **what), order, car(**vehicle), config=MOTOR)
        assert (asked.torque_requested, reasons) == (brakes, frozenset())


def test_a_0x520_younger_than_50_ms_allows_torque() -> None:
    assert asks(vehicle=car(status=replace(NOW_DRIVING, t_rx_ns=NOW - 50 * MS + 1)))[0].torque_requested


@pytest.mark.parametrize(
    "order",
    [
        None,
        command(run_id=2),
        command(t_sensor_ns=NOW - 500 * MS),
        command(throttle=math.nan),
        command(throttle=1.1),
        command(brake=-0.1),
        command(steering_rad=math.inf),
        command(speed_limit_mps=math.nan),
    ],
)
def test_a_command_that_is_not_valid_gives_nothing_even_here(order: VehicleCommand | None) -> None:
    asked, _ = asks(replace(FREE, steer_deg=3.0, brake=0.4), order=order)
    assert (asked.torque_requested, asked.steer_deg, asked.rear_brake_pct) == (False, 3.0, 40.0)


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.READY, Phase.LAUNCH_WAIT])
def test_a_run_is_acknowledged_by_selected_sent_whole(phase: Phase, complete: bool) -> None:
    state, asked, _ = gate(CAR, GateState(), decision(phase, run_id=7), None, car(AsState.AS_READY, 0), NOW)
    said = asked.mission_status is MissionStatus.SELECTED
    assert said == (phase is not Phase.LAUNCH_WAIT)
    assert (sent(state, complete, NOW).acknowledged_run_id == 7) == (said and complete)


# ---------------------------------------------------------------- standstill (rule 3)


@pytest.mark.parametrize("phase", [Phase.STOPPED, Phase.FINISHED, Phase.READY, Phase.IDLE])
def test_moving_in_as_driving_never_sends_neutral_or_finished(phase: Phase) -> None:
    for speeds in (None, WheelSpeeds(0, 0, 10, 0, NOW), WheelSpeeds(0, 0, 0, 0, NOW - 100 * MS)):
        asked, reasons = asks(what=decision(phase), vehicle=car(speeds=speeds))
        assert (asked.direction, asked.mission_status) == (Direction.FORWARD, MissionStatus.RUNNING)
        assert Reason.STILLNESS_UNPROVEN in reasons
    what = decision(phase)
    asked, reasons = asks(what=what, vehicle=car(rpm=9))
    assert (asked.direction, asked.mission_status, reasons) == (Direction.NEUTRAL, what.mission_status, frozenset())
    forward = decision(phase, direction=Direction.FORWARD, mission_status=MissionStatus.FINISHED)
    assert asks(what=forward, vehicle=car(rpm=10))[0].mission_status is MissionStatus.RUNNING


def test_outside_as_driving_neutral_needs_no_proof() -> None:
    asked, reasons = asks(what=decision(Phase.READY), vehicle=car(AsState.AS_READY, speeds=None))
    assert (asked.direction, reasons) == (Direction.NEUTRAL, frozenset())


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


# ---------------------------------------------------------------- the interlock (rule 1)


Kind = tuple[Decision, dict[str, float]]  # and what the command says


def cycle(
    state: GateState,
    kind: Kind,
    now_ns: int,
    complete: bool | None = True,
    *,
    config: GateConfig = CAR,
    **changes: Any,
) -> tuple[GateState, AiCommand]:
    """One cycle made and, unless `complete` is None, sent."""
    what, order = kind
    vehicle = car(t_ns=now_ns, **changes)
    state, asked, _ = gate(config, state, what, command(t_sensor_ns=now_ns, **order), vehicle, now_ns)
    return (state if complete is None else sent(state, complete, now_ns)), asked


FRESH = replace(START, run_id=1)
KINDS: dict[str, Kind] = {
    "D": (DRIVING, {}),
    "d": (DRIVING, {"throttle": 0.1 / 195.0}),  # the least torque
    "B": (BRAKING, {}),
    "b": (DRIVING, {"brake": 0.005}),  # the least brake
    "H": (decision(Phase.HOLDING), {}),
    "Z": (decision(Phase.EMERGENCY_MOVING), {}),
}
ECHOES = None, VcuBrake(front_request_pct=0.5), VcuBrake(rear_request_pct=0.5), VcuBrake(t_rx_ns=-10 * MS)
"""Readings of 0x524; the last is from before the zeros could be seen. The time is from now."""


@pytest.mark.parametrize("broken", [False, None])
@pytest.mark.parametrize("echo", ECHOES)
@pytest.mark.parametrize("config", [CAR, FRONT_DRIVEN])
@pytest.mark.parametrize(
    ("state", "cycles", "asked"),
    [
        (FRESH, "D D", "0 T"),  # after a start the first cycle is all zeros
        (FRESH, "B B", "0 B"),
        (FRESH, "H H H", "0 0 0"),  # a brake that nobody ever asked for is not kept
        (FREE, "B D D", "B 0 T"),  # torque after one zero cycle that 0x524 echoes
        (FREE, "B D- D- D-", "B 0 0 T"),  # or after two of them
        (FREE, "B D! D! D! D D", "B 0 0 0 0 T"),  # which must have gone out whole
        (FREE, "B! D", "B 0"),  # a brake that may have gone out keeps the torque back
        (FREE, "D B B", "T 0 B"),  # the brake after one complete cycle without torque
        (FREE, "D B! B! B! B B", "T 0 0 0 0 B"),
        (FREE, "d B B", "T 0 B"),  # the least torque counts as any
        (FREE, "b D D", "B 0 T"),  # the least brake counts, and waits, as any
        (FREE, "D b b", "T 0 B"),
        (FREE, "D! B", "T 0"),  # a torque that may have gone out keeps the brake back
        (FREE, "D D! D", "T T T"),  # torque that runs goes on through a broken cycle
        (FREE, "D H! D", "T 0 0"),  # one that was zero in it does not
        (FREE, "Z! D", "0 T"),  # a broken cycle of zeros takes nothing back
        (FREE, "Z! B", "0 B"),
        (FREE, "D! Z! D- D- D-", "T 0 0 0 T"),  # whole zeros must follow what a broken cycle tried
        (FREE, "B! Z! D- D- D-", "B 0 0 0 T"),
    ],
)
def test_torque_and_brake_wait_for_one_another(
    state: GateState,
    cycles: str,
    asked: str,
    config: GateConfig,
    echo: VcuBrake | None,
    broken: bool | None,
) -> None:
    """Cycles of these kinds; ! not sent whole or nobody says so, - not echoed by 0x524."""
    for n, (kind, expected) in enumerate(zip(cycles.split(), asked.split(), strict=True)):
        now_ns, complete = NOW + n * 10 * MS, broken if "!" in kind else True
        said = echo and replace(echo, t_rx_ns=echo.t_rx_ns + now_ns)
        more = {"brake": said} if "-" in kind else {}
        state, sent_now = cycle(state, KINDS[kind[0]], now_ns, complete, config=config, **more)
        assert (sent_now.torque_requested, sent_now.brake_requested) == (expected == "T", expected == "B"), n


def test_each_cycle_is_told_of_once() -> None:
    for complete in (True, False):
        assert sent(START, complete, NOW) == START
        told, _ = cycle(FREE, KINDS["B"], NOW, complete)
        assert sent(told, True, NOW + 1) == sent(told, False, NOW + 1) == told


def test_a_new_gate_assumes_torque_at_the_vcu_and_nothing_else() -> None:
    begun = GateState()
    assert (begun.torque_there, begun.torque_running, begun.awaiting) == (True, False, False)
    assert (begun.tried_torque, begun.tried_brake, begun.zero_cycles, begun.zero_since_ns) == (False, False, 0, 0)
    assert (begun.steer_deg, begun.brake, begun.cycle_ns, begun.run_id) == (0.0, 0.0, None, 0)


def test_a_brake_that_waits_is_not_forgotten() -> None:
    state, _ = cycle(FREE, KINDS["D"], NOW)
    state, _ = cycle(state, (DRIVING, {"brake": 0.6}), NOW + 10 * MS)
    _, asked = cycle(state, KINDS["H"], NOW + 20 * MS)
    assert asked.rear_brake_pct == 60.0  # kept, though its own cycle had to be zero


def test_a_gate_that_sends_zeros_settles_in_one_state() -> None:
    """An exhaustive search visits every state: there must be an end of them."""
    state, states = FRESH, set()
    for _ in range(10):
        state, _ = cycle(state, (decision(Phase.IDLE), {}), NOW)
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
    state = FRESH
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
        (DRIVING, {"throttle": 0.0, "brake": 0.5}, 97.5, 0),
        (DRIVING, {"throttle": 0.5}, 97.5, 1318),
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


@settings(max_examples=500)
@given(
    what=st.builds(
        decision,
        st.sampled_from(Phase),
        steer=st.sampled_from(Steer),
        brake=st.sampled_from(Brake),
        torque=st.booleans(),
        estop=st.booleans(),
        may_move=st.booleans(),
    ),
    order=st.none() | st.builds(VehicleCommand, st.just(NOW), st.just(1), *[st.floats()] * 4),
    as_state=st.sampled_from(AsState),
    speeds=st.builds(WheelSpeeds, *[st.integers(0, 1250)] * 4, st.just(NOW)),
    limits=st.tuples(st.integers(0, 300), st.integers(0, 1950)),  # in tenths: the resolution of these signals
    config=st.sampled_from([CAR, MOTOR]),
    held_deg=st.floats(-30, 30),
)
def test_the_codec_takes_whatever_the_gate_gives(
    what: Decision,
    order: VehicleCommand | None,
    as_state: AsState,
    speeds: WheelSpeeds,
    limits: tuple[int, int],
    config: GateConfig,
    held_deg: float,
) -> None:
    angle_max_deg, torque_max_nm = limits[0] / 10.0, limits[1] / 10.0
    steer, drive_rear = VcuSteer(0, angle_max_deg, 0, NOW), VcuDriveRear(0, 0, torque_max_nm, NOW)
    vehicle = car(as_state, speeds=speeds, steer=steer, drive_rear=drive_rear)
    _, asked, _ = gate(config, replace(FREE, steer_deg=held_deg), what, order, vehicle, NOW)
    CODEC.encode_command(asked)
    assert not (asked.torque_requested and asked.brake_requested)
    assert asked.rear_torque_nm <= min(torque_max_nm, constant_power_nm(max(speeds.rl_rpm, speeds.rr_rpm)))
    assert asked.front_torque_nm == 0.0
    assert abs(asked.steer_deg) <= angle_max_deg
    if as_state is not AsState.AS_DRIVING:
        assert asked.steer_deg == 0.0 and not asked.torque_requested
