"""Static inspections, through the controller, with wheels that answer, and whatever wheels do in the demo."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.driving import Motion, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.static_inspection import driven_rpm
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026, CARS, VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState

STEP_NS = 20_000_000
SETTINGS = MissionSettings()
BOTH = pytest.mark.parametrize("car", [ADS_DV_2021, ADS_DV_2026], ids=lambda car: car.name)


@dataclass
class InTheAir:
    """A car on stands: wheels with inertia and friction, a steering actuator with its rate."""

    car: VehicleParameters
    mission: Ami
    inertia_kgm2: float = 2.0
    friction_nm: float = 3.0
    steer_stuck: bool = False
    settings: ControllerSettings = field(default_factory=ControllerSettings)
    t_ns: int = 0
    rpm: float = 0.0
    steer: float = 0.0
    commands: list[VehicleCommand] = field(default_factory=list)
    rpms: list[float] = field(default_factory=list)
    steers: list[float] = field(default_factory=list)

    def run(self, seconds: float) -> None:
        controller = Controller(self.car, self.settings)
        run = Run(5, self.mission, AsState.AS_DRIVING, may_move=True)
        controller.reset(run)
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.t_ns += STEP_NS
            driven = round(self.rpm)
            front = driven if self.car.driven_front else 0
            wheels = (float(front), float(front), float(driven), float(driven))
            motion = Motion(t_ns=self.t_ns, speed_mps=self.car.speed_of_wheel_rpm(self.rpm))
            command = controller.command(None, motion, self.rpm < 10, wheels, math.degrees(self.steer), run, self.t_ns)
            self.commands.append(command)
            self.rpms.append(self.rpm)
            self.steers.append(self.steer)
            if command.estop_request:
                return
            dt = STEP_NS / 1e9
            torque = command.throttle * self.car.axle_torque_max_nm
            if self.rpm > self.car.wheel_rpm_of_speed(command.speed_limit_mps):
                torque = 0.0
            slowing = (self.friction_nm if self.rpm > 0 else 0.0) + 150.0 * command.brake
            self.rpm = max(0.0, self.rpm + (torque - slowing) / self.inertia_kgm2 * dt * 60.0 / (2.0 * math.pi))
            most = 0.0 if self.steer_stuck else self.car.steer_rate_radps * dt
            self.steer += min(max(command.steering_rad - self.steer, -most), most)

    def time_s(self, index: int) -> float:
        return (index + 1) * STEP_NS / 1e9


@BOTH
@pytest.mark.parametrize(("inertia", "friction"), [(1.0, 1.0), (2.0, 3.0), (4.0, 12.0)])
def test_inspection_a_spins_up_in_10_s_and_rests_in_5_s(
    car: VehicleParameters, inertia: float, friction: float
) -> None:
    stand = InTheAir(car, Ami.STATIC_INSPECTION_A, inertia, friction)
    stand.run(30.0)
    limit = car.steer_max_rad
    assert max(stand.steers) == pytest.approx(limit, abs=0.04)
    assert min(stand.steers) == pytest.approx(-limit, abs=0.04)
    first_throttle = next(i for i, command in enumerate(stand.commands) if command.throttle > 0)
    assert abs(stand.steers[first_throttle]) < 0.04
    reached = next(i for i, rpm in enumerate(stand.rpms) if rpm >= 200)
    assert stand.time_s(reached) - stand.time_s(first_throttle) < 10.0
    assert max(stand.rpms) < 300
    finished = next(i for i, command in enumerate(stand.commands) if command.mission_finished)
    rest = next(i for i, rpm in enumerate(stand.rpms) if i > finished and rpm < 10)
    assert stand.time_s(rest) - stand.time_s(finished) < 5.0
    assert all(command.mission_finished for command in stand.commands[finished:])
    assert not any(command.estop_request for command in stand.commands)


@BOTH
@pytest.mark.parametrize(
    ("mission", "inertia"),
    [(Ami.STATIC_INSPECTION_A, 2.0), (Ami.AUTONOMOUS_DEMO, 20.0)],  # of wheels in the air, of the whole car
)
def test_max_speed_is_kept_without_a_path(car: VehicleParameters, mission: Ami, inertia: float) -> None:
    stand = InTheAir(car, mission, inertia, settings=ControllerSettings(max_speed_mps=3.0))
    stand.run(30.0)
    assert 2.5 < car.speed_of_wheel_rpm(max(stand.rpms)) < 3.0 * 1.03


@BOTH
def test_inspection_b_reaches_50_rpm_then_requests_the_emergency(car: VehicleParameters) -> None:
    stand = InTheAir(car, Ami.STATIC_INSPECTION_B)
    stand.run(20.0)
    assert stand.commands[-1].estop_request
    assert 50 <= stand.rpms[-1] < 100
    assert not any(command.mission_finished for command in stand.commands)
    assert all(command.steering_rad == 0.0 for command in stand.commands)


@BOTH
def test_the_sweep_is_slower_than_the_actuator(car: VehicleParameters) -> None:
    stand = InTheAir(car, Ami.STATIC_INSPECTION_A)
    stand.run(10.0)
    angles = [command.steering_rad for command in stand.commands]
    rates = [abs(b - a) / (STEP_NS / 1e9) for a, b in itertools.pairwise(angles)]
    assert max(rates) < 0.6 * car.steer_rate_radps


def test_a_stuck_steering_does_not_block_an_inspection() -> None:
    stand = InTheAir(ADS_DV_2026, Ami.STATIC_INSPECTION_A, steer_stuck=True)
    stand.run(40.0)
    assert stand.commands[-1].mission_finished


def test_blocked_wheels_end_it_within_a_quarter_of_the_torque() -> None:
    stand = InTheAir(ADS_DV_2026, Ami.STATIC_INSPECTION_A, friction_nm=100.0)
    stand.run(40.0)
    assert max(command.throttle for command in stand.commands) <= 0.25
    assert stand.commands[-1].mission_finished


def test_inspections_do_not_mind_what_odometry_says() -> None:
    """Wheels in the air make distance: nothing may come of it."""
    results = []
    for distance in (0.0, 500.0):
        controller = Controller(ADS_DV_2026)
        run = Run(5, Ami.STATIC_INSPECTION_A, AsState.AS_DRIVING, may_move=True)
        controller.reset(run)
        commands = [
            controller.command(
                None, Motion(t_ns=i * STEP_NS, distance_m=distance + i), True, (0.0,) * 4, 0.0, run, i * STEP_NS
            )
            for i in range(200)
        ]
        results.append([(c.steering_rad, c.throttle, c.brake) for c in commands])
    assert results[0] == results[1]


def test_the_slowest_driven_wheel_counts_but_for_a_differential() -> None:
    assert driven_rpm(ADS_DV_2026, (0.0, 0.0, 190.0, 210.0)) == 190.0
    assert driven_rpm(ADS_DV_2026, (0.0, 0.0, 0.0, 400.0)) == 300.0
    assert driven_rpm(ADS_DV_2021, (100.0, 210.0, 190.0, 200.0)) == pytest.approx(157.5)


@settings(max_examples=40)
@given(
    mission=st.sampled_from([Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B, Ami.AUTONOMOUS_DEMO]),
    car=st.sampled_from(sorted(CARS)),
    story=st.lists(
        st.tuples(st.integers(-50, 3000), st.integers(0, 1250), st.floats(-30, 30) | st.just(math.nan), st.booleans()),
        max_size=60,
    ),
)
def test_whatever_the_wheels_do_the_command_is_in_order(
    mission: Ami, car: str, story: list[tuple[int, int, float, bool]]
) -> None:
    parameters = CARS[car]
    controller = Controller(parameters)
    run = Run(5, mission, AsState.AS_DRIVING, may_move=True)
    controller.reset(run)
    now = 0
    ended = False
    for step_ms, rpm, steer_deg, standing in story:
        now += step_ms * 1_000_000
        motion = Motion(t_ns=now, speed_mps=parameters.speed_of_wheel_rpm(rpm), distance_m=now / 1e9)
        command = controller.command(None, motion, standing, (float(rpm),) * 4, steer_deg, run, now)
        assert command.problems(parameters.steer_max_rad) == ()
        assert not (command.throttle > 0.0 and command.brake > 0.0)
        assert ended <= (command.mission_finished or command.estop_request)
        ended = command.mission_finished or command.estop_request
        if ended:
            assert command.throttle == 0.0
