"""The person beside the simulated car."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from vcu_bench import Bench

from fsai_hil.simulator.operator import Await, Operator, Script
from fsai_hil.simulator.profiles import OFFICIAL_SIMULATOR
from fsai_hil.simulator.switches import Switches
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.units import MS, S


class Driver:
    """An AI computer that does every mission in two seconds, at rest, and finishes it or requests an emergency stop."""

    def __init__(self, bench: Bench, ends_with_estop: bool = False) -> None:
        self.bench = bench
        self.ends_with_estop = ends_with_estop

    def think(self) -> None:
        bench = self.bench
        state, selected = bench.state, bench.switches.ami is not Ami.NOT_SELECTED
        over = state is AsState.AS_DRIVING and bench.vcu.in_state_ns > 2 * S
        if state in (AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY):
            status = MissionStatus.SELECTED if selected else MissionStatus.NOT_SELECTED
            bench.say(mission_status=status, direction=Direction.NEUTRAL, estop_request=False)
        elif over and self.ends_with_estop:
            bench.say(estop_request=True)
        elif over or state is AsState.AS_FINISHED:
            bench.say(mission_status=MissionStatus.FINISHED, direction=Direction.NEUTRAL)
        elif state is AsState.AS_DRIVING:
            bench.say(mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD)


def drive(bench: Bench, driver: Driver, until: Callable[[], bool], limit_ns: int = 120 * S) -> None:
    while not until():
        assert bench.now_ns < limit_ns, f"{bench.operator.doing}; {bench.vcu.transitions}"
        driver.think()
        bench.tick()


def states(bench: Bench) -> list[AsState]:
    return [state for _, state in bench.vcu.history]


ONE_RUN = [AsState.AS_READY, AsState.AS_DRIVING, AsState.AS_FINISHED, AsState.AS_OFF]


@pytest.mark.parametrize(
    ("name", "order", "off"),
    [
        ("2021", ["aims", "asms", "tsms", "lvms"], [AsState.AS_OFF]),
        ("2026", ["lvms", "asms", "tsms"], [AsState.AS_INIT, AsState.AS_OFF]),
    ],
)
def test_the_operator_takes_the_car_from_off_through_a_mission(name: str, order: list[str], off: list[AsState]) -> None:
    """The switches go on in the order of the car's power-up."""
    bench = Bench(name)
    bench.operator = Operator.auto(name, [Ami.TRACKDRIVE])
    seen: list[str] = []
    switches = bench.switches

    def done() -> bool:
        seen.extend(switch for switch in order if getattr(switches, switch) and switch not in seen)
        return bench.operator.done

    drive(bench, Driver(bench), done)
    assert seen == order
    assert states(bench)[: len(off) + 4] == off + ONE_RUN
    assert "AS_READY -> AS_DRIVING: Go" in [str(transition) for transition in bench.vcu.transitions]
    assert not (switches.asms or switches.tsms or switches.lvms or switches.go)
    assert bench.operator.doing == "nothing left to do"


def test_go_comes_after_yellow_and_blue_and_again_if_useless() -> None:
    bench = Bench()
    driver = Driver(bench)
    bench.operator = Operator.auto("2021", [Ami.SKIDPAD])
    drive(bench, driver, lambda: bench.state is AsState.AS_READY)
    ready_ns = bench.now_ns
    bench.say(steer_deg=1.0)  # so the VCU does not start
    drive(bench, driver, lambda: bench.switches.go)
    assert 5 * S <= bench.now_ns - ready_ns <= 6 * S
    drive(bench, driver, lambda: not bench.switches.go)
    bench.say(steer_deg=0.0)
    drive(bench, driver, lambda: bench.state is AsState.AS_DRIVING)


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_after_an_emergency_the_operator_waits_and_cycles_power(name: str) -> None:
    bench = Bench(name)
    driver = Driver(bench, ends_with_estop=True)
    bench.operator = Operator.auto(name, [Ami.STATIC_INSPECTION_B, Ami.SKIDPAD])
    drive(bench, driver, lambda: bench.state is AsState.EMERGENCY_BRAKE)
    begun_ns = bench.now_ns
    drive(bench, driver, lambda: bench.state is AsState.AS_OFF)
    assert bench.now_ns - begun_ns >= 15 * S
    driver.ends_with_estop = False
    drive(bench, driver, lambda: bench.operator.done)
    assert states(bench).count(AsState.AS_FINISHED) == 1
    assert bench.vcu.power_cycles == 2


def test_the_operator_copes_with_the_official_simulator() -> None:
    bench = Bench("2021", OFFICIAL_SIMULATOR)
    bench.operator = Operator.auto("2021", [Ami.ACCELERATION, Ami.SKIDPAD])
    drive(bench, Driver(bench), lambda: bench.operator.done)
    assert states(bench).count(AsState.AS_FINISHED) == 2


def test_the_operator_gives_no_go_after_an_emergency() -> None:
    bench = Bench()
    bench.operator = Operator.auto("2021", [Ami.TRACKDRIVE])
    driver = Driver(bench)
    drive(bench, driver, lambda: bench.state is AsState.AS_READY)
    bench.switches.car_estop = True
    drive(bench, driver, lambda: bench.operator.done or bench.switches.go)
    assert bench.operator.done


def test_a_custom_script_waits_acts_and_times_out() -> None:
    def turn_on(switches: Switches, seen: bool) -> Script:
        switches.lvms = True
        return ()

    def crash_unless(switches: Switches, came: bool) -> Script:
        switches.crash = not came
        return ()

    bench = Bench()
    bench.operator = Operator(
        [
            Await("turning LVMS on", delay_ns=100 * MS),
            turn_on,
            Await("waiting for a mission that cannot come", lambda car: car.mission_selectable, 0, S),
            crash_unless,
        ]
    )
    bench.run(100 * MS)
    assert not bench.switches.lvms
    bench.run(2 * MS)
    assert bench.switches.lvms
    assert bench.operator.doing == "waiting for a mission that cannot come"
    bench.run(S)
    assert bench.switches.crash
    assert bench.operator.done
