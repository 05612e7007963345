"""What the simulated VCU and its PCAN-GPS say, and how often."""

from __future__ import annotations

from collections import Counter

import pytest
from msgspec.structs import replace
from vcu_bench import Bench

from fsai_vcu.interface.bus_table import BY_ID, Flow
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import (
    Acceleration,
    GpsLatitude,
    GpsLongitude,
    GpsStatus,
    LogDynamics1,
    LogDynamics2,
    LogStatus,
    RotationB,
    VcuBrake,
    VcuDriveRear,
    VcuSteer,
    VcuSystemStatus,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.units import MS, S


def sent_last(bench: Bench, can_id: int) -> str:
    return next(str(frame) for frame in reversed(bench.sent) if frame.can_id == can_id)


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_every_car_message_has_the_period_of_the_bus_table(name: str) -> None:
    bench = Bench(name, gps=True).power_up()
    bench.run(13 * MS)
    counted: Counter[int] = Counter()
    last_ns = 0
    for _ in range(10_000):
        for frame in bench.tick():
            assert last_ns <= frame.t_ns <= bench.now_ns, "frames are in order of time and never after the step"
            last_ns = frame.t_ns
            counted[frame.can_id] += 1
    expected = {
        message.can_id: 10 * S // message.period_ns[name]
        for message in BY_ID.values()
        if (message.flow in (Flow.FROM_VCU, Flow.FROM_SENSOR) or message.name == "RES_TPDO")
        and name in message.period_ns
    }
    assert counted == expected


@pytest.mark.parametrize(
    ("switches", "data"),
    [
        ({}, "0000000000006400"),
        ({"go": True}, "0200000000006400"),
        ({"go": True, "remote_estop": True}, "0300000000006400"),
        ({"go": True, "remote_radio_ok": False}, "0000000000000000"),
    ],
)
def test_the_remotes_receiver_sends_its_switches_and_signal(switches: dict[str, bool], data: str) -> None:
    bench = Bench("2026").power_up()
    for switch, on in switches.items():
        setattr(bench.switches, switch, on)
    sent = [frame.data for frame in bench.run(20 * MS) if frame.can_id == 0x181]
    assert sent[-1] == bytes.fromhex(data)
    assert not [frame for frame in Bench("2021").power_up().run(20 * MS) if frame.can_id == 0x181]


def test_the_vcu_sends_its_own_frames_together_0x520_first() -> None:
    bench = Bench().power_up()
    frames = [frame for frame in bench.run(10 * MS) if 0x520 <= frame.can_id <= 0x526]
    assert [frame.can_id for frame in frames] == list(range(0x520, 0x527))
    assert len({frame.t_ns for frame in frames}) == 1
    assert all(BY_ID[frame.can_id].flow is Flow.FROM_VCU for frame in bench.run(S)), "there is no PCAN-GPS"


def test_a_slow_machine_may_have_fewer_gps_and_logging_frames() -> None:
    bench = Bench("2021", gps=True, gps_decimation=4, log_decimation=10).power_up()
    counted = Counter(frame.can_id for frame in bench.run(S))
    assert counted[0x520] == 100
    assert counted[0x500] == 10
    assert counted[0x600] == 50


def test_sensor_readings_are_sent_and_saturate_at_their_ranges() -> None:
    bench = Bench("2021").to_driving()
    bench.car = replace(
        bench.car,
        wheel_rpm=(10.4, 20.6, 2000.0, 40.0),
        pulses=(1, 65535, 65536 + 7, 4),
        steer_deg=-25.0,
        rear_torque_nm=-300.0,
        front_brake_pct=12.5,
        rear_brake_pct=130.0,
    )
    bench.deliver(rear_torque_nm=12.3, steer_deg=4.5, rear_motor_speed_max_rpm=100)
    bench.run(20 * MS)
    assert (speeds := bench.images(WheelSpeeds)[-1]) == WheelSpeeds(10, 21, 1250, 40, speeds.t_rx_ns)
    assert (counts := bench.images(WheelCounts)[-1]) == WheelCounts(1, 65535, 7, 4, counts.t_rx_ns)
    assert (steer := bench.images(VcuSteer)[-1]) == VcuSteer(-21.0, 21.0, 4.5, steer.t_rx_ns)
    assert (drive := bench.images(VcuDriveRear)[-1]) == VcuDriveRear(-195.0, 12.3, 195.0, drive.t_rx_ns)
    brake = bench.images(VcuBrake)[-1]
    assert (brake.front_pct, brake.rear_pct) == (12.5, 100.0)


def test_0x524_has_the_requested_brake_and_not_that_of_the_ebs() -> None:
    bench = Bench().to_emergency()
    bench.deliver(front_brake_pct=10.0, rear_brake_pct=20.0)
    bench.run(20 * MS)
    brake = bench.images(VcuBrake)[-1]
    assert (brake.front_request_pct, brake.rear_request_pct) == (10.0, 20.0)


@pytest.mark.parametrize(
    ("name", "derated", "limit"), [("2021", None, 21.0), ("2026", None, 30.0), ("2026", 24.0, 24.0)]
)
def test_the_steering_limit_is_reported_and_a_derated_one_too(name: str, derated: float | None, limit: float) -> None:
    bench = Bench(name).power_up()
    bench.switches.steer_limit_deg = derated
    bench.run(20 * MS)
    assert bench.images(VcuSteer)[-1].angle_max_deg == limit


def test_switches_mission_and_go_are_reported() -> None:
    bench = Bench().to_ready(Ami.AUTONOMOUS_DEMO)
    bench.switches.go = True
    bench.switches.batt_temp_high = True
    status = bench.status()
    assert (status.as_switch, status.ts_switch, status.go_signal) == (True, True, True)
    assert status.ami is Ami.AUTONOMOUS_DEMO
    assert status.warning and status.warn_batt_temp_high and not status.warn_batt_soc_low
    assert not status.fault
    bench.switches.remote_radio_ok = False
    assert not bench.status().go_signal, "without its radio the remote's Go is not received"


def test_outside_as_driving_ai_faults_are_warnings_of_0x120() -> None:
    bench = Bench("2021").power_up()
    bench.wheels(50.0)
    bench.say(estop_request=True, mission_status=MissionStatus.FINISHED, rear_torque_nm=10.0, rear_brake_pct=10.0)
    bench.run(30 * MS)
    system = bench.images(VcuSystemStatus)[-1]
    assert system.warn_ai_estop_req and system.warn_mission_status and system.warn_auto_braking
    assert system.warn_brake_plausibility and not system.warn_ai_comms_lost
    assert bench.state is AsState.AS_OFF


def test_the_logging_frames_report_the_run() -> None:
    bench = Bench("2021").to_driving(Ami.SKIDPAD)
    bench.car = replace(bench.car, speed_mps=10.0, steer_deg=3.3, front_brake_pct=0.0, rear_torque_nm=97.5)
    bench.deliver(
        rear_torque_nm=195.0,
        steer_deg=5.0,
        lap_counter=3,
        cones_count_actual=12,
        cones_count_all=345,
        speed_demand_kmh=40,
    )
    bench.run(200 * MS)
    dynamics = bench.images(LogDynamics1)[-1]
    assert (dynamics.speed_actual_kmh, dynamics.speed_target_kmh) == (36, 40)
    assert (dynamics.steer_actual_deg, dynamics.steer_target_deg) == (3.5, 5.0)
    assert (dynamics.torque_actual_pct, dynamics.torque_target_pct) == (50, 100)
    status = bench.images(LogStatus)[-1]
    assert status == LogStatus(3, 2, 2, 1, 3, 3, 12, 345, status.t_rx_ns)


def test_the_gps_has_no_position_for_its_first_two_seconds() -> None:
    bench = Bench("2026", gps=True)
    bench.car = replace(bench.car, latitude_deg=52.0706, longitude_deg=-1.0174, course_deg=271.0, speed_mps=10.0)
    bench.switches.lvms = True
    bench.run(1900 * MS)
    assert (early := bench.images(GpsLatitude)[-1]) == GpsLatitude(0.0, 0, 0, early.t_rx_ns)
    bench.run(S)
    latitude, longitude = bench.images(GpsLatitude)[-1], bench.images(GpsLongitude)[-1]
    assert (latitude.degrees, chr(latitude.indicator)) == (52, "N")
    assert latitude.minutes == pytest.approx(0.0706 * 60, abs=1e-5)
    assert (longitude.degrees, chr(longitude.indicator)) == (1, "W")
    assert longitude.minutes == pytest.approx(0.0174 * 60, abs=1e-5)
    assert sent_last(bench, 0x621) == "621#0080874300001042", "271 degrees and 36 km/h as floats"
    status = bench.images(GpsStatus)[-1]
    assert status.navigation_method == 3


def test_the_inertial_messages_follow_the_car() -> None:
    bench = Bench("2026", gps=True).power_up()
    bench.car = replace(bench.car, accel_xyz_mps2=(1.9, -4.0, 9.81), yaw_rate_radps=0.5)
    bench.run(20 * MS)
    acceleration, rotation = bench.images(Acceleration)[-1], bench.images(RotationB)[-1]
    assert acceleration.x_mg == pytest.approx(193.7, abs=2.0)
    assert acceleration.z_mg == pytest.approx(1000.0, abs=2.0)
    assert rotation.z_degps == pytest.approx(28.65, abs=0.01)
    dynamics = bench.images(LogDynamics2)[-1]
    assert dynamics.accel_lateral_mps2 == pytest.approx(-4.0, abs=0.002)
    assert dynamics.yaw_rate_degps == pytest.approx(28.65, abs=0.01)


def test_what_the_ai_does_not_read_of_the_gps_has_these_bytes() -> None:
    bench = Bench("2026", gps=True).power_up()
    bench.run(60 * S - bench.now_ns + 300 * MS)
    assert sent_last(bench, 0x627) == "627#1A070F090100", "2026-07-15, 09:01:00, a minute after the virtual clock's 0"
    assert sent_last(bench, 0x640) == "640#000109020F07EA07", "a Wednesday"
    assert sent_last(bench, 0x628) == "628#400000006BFF", "19.2 and -44.8 uT in steps of 0.3"
    assert sent_last(bench, 0x630) == "630#10", "the receiver has power"


def test_readings_far_beyond_any_car_do_not_silence_a_message() -> None:
    bench = Bench("2021", gps=True).to_driving()
    bench.car = replace(
        bench.car, accel_xyz_mps2=(900.0, -900.0, 900.0), yaw_rate_radps=99.0, speed_mps=400.0, steer_deg=500.0
    )
    bench.deliver(direction=Direction.FORWARD)
    counted = Counter(frame.can_id for frame in bench.run(S))
    assert counted[0x501] == counted[0x500] == counted[0x523] == 100
