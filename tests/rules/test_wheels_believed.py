"""The evidence's own judgement of wheel speeds and pulse counts."""

from __future__ import annotations

import pytest

from fsai_hil.rules.wheels import Belief, Rpm, Wheels

MS = 1_000_000
PULSES = 20


class Car:
    """Four wheels that turn alike; what they read and count can be set apart from each other."""

    def __init__(self) -> None:
        self.wheels = Wheels(PULSES)
        self.now_ns = 0
        self.pulses = 0.0

    def cycle(self, reads: int, turns: float | None = None, cycles: int = 1) -> Belief:
        for _ in range(cycles):
            self.now_ns += 10 * MS
            self.pulses += (reads if turns is None else turns) / 60.0 * PULSES * 0.01
            count = int(self.pulses) % 65536
            self.wheels.on_counts((count,) * 4, self.now_ns)
            belief = self.wheels.on_speeds((reads,) * 4, self.now_ns)
        return belief

    def rolling(self, rpm: int = 200) -> Car:
        self.cycle(rpm, cycles=60)
        return self


def test_a_car_that_rolls_and_stops_is_believed_all_along() -> None:
    car = Car()
    assert all(car.cycle(rpm) is Belief.YES for rpm in [*range(200), *range(200, -1, -1)])
    assert all(car.cycle(9, 0) is Belief.YES for _ in range(100)), "a reading may rest at 9 rpm"
    assert car.wheels.may_stand(car.now_ns) and car.wheels.surely_stand(car.now_ns)


@pytest.mark.parametrize("rpm", [1251, 1300, 65535])
def test_more_than_the_database_allows_is_not_believed(rpm: int) -> None:
    car = Car().rolling()
    read: Rpm = (200, 200, 200, rpm)
    assert car.wheels.on_speeds(read, car.now_ns + 10 * MS) is Belief.NO


@pytest.mark.parametrize(("rpm", "belief"), [(500, Belief.YES), (501, Belief.NO)])
def test_a_jump_that_no_tyre_follows_in_10_ms_is_not_believed(rpm: int, belief: Belief) -> None:
    car = Car().rolling()
    assert car.wheels.on_speeds((200, rpm, 200, 200), car.now_ns + 10 * MS) is belief


def test_speeds_of_0_while_counts_run_are_no_standing_car() -> None:
    car = Car().rolling()
    assert car.cycle(0, 200, cycles=60) is Belief.NO
    assert not car.wheels.may_stand(car.now_ns)


def test_speeds_while_running_counts_stand_are_not_believed() -> None:
    assert Car().rolling().cycle(200, 0, cycles=60) is Belief.NO
    assert Car().cycle(200, 0, cycles=60) is not Belief.NO, "this VCU never counts"


def test_counts_that_wrap_or_start_anew_contradict_nothing() -> None:
    car = Car()
    car.pulses = 65_530.0
    assert car.rolling().cycle(200) is Belief.YES
    car.pulses = 0.0
    assert all(car.cycle(200) is Belief.YES for _ in range(60))


@pytest.mark.parametrize(("pulses", "stands"), [(1, True), (2, False)])
def test_one_pulse_is_an_edge_at_rest_two_are_a_turning_wheel(pulses: int, stands: bool) -> None:
    car = Car()
    car.cycle(0, cycles=100)
    car.pulses += pulses
    car.cycle(0)
    assert car.wheels.may_stand(car.now_ns) is stands
    car.cycle(0, cycles=50)
    assert car.wheels.may_stand(car.now_ns)
