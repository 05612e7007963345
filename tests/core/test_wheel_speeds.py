"""Which wheel speeds are believed, with the pulse counts beside them."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.wheel_speeds import (
    NO_PULSES,
    Pulses,
    WheelBelief,
    on_counts,
    on_speeds,
    pulses_of,
    pulses_per_s,
    turning,
)
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026, OFFICIAL_SIMULATOR, VehicleParameters
from fsai_vcu.interface.messages import WheelCounts, WheelSpeeds
from fsai_vcu.interface.units import MS, S

CONFIG = BridgeConfig()
CAR = ADS_DV_2026
PER_S = pulses_per_s(CONFIG, CAR)
T0 = 1000 * S
PERIOD = 10 * MS
Four = tuple[float, float, float, float]


def speeds(rpm: int | tuple[int, int, int, int], t_ns: int) -> WheelSpeeds:
    return WheelSpeeds(*((rpm,) * 4 if isinstance(rpm, int) else rpm), t_rx_ns=t_ns)


class Wheels:
    """Frames of 0x525 and 0x526 every 10 ms, of what a wheel does and of what its two signals say of it."""

    def __init__(self, car: VehicleParameters = CAR, first_count: int = 0) -> None:
        self.car = car
        self.t_ns = T0
        self.first_count = first_count
        self.turns = [0.0, 0.0, 0.0, 0.0]
        self.belief = WheelBelief()
        self.doubts: list[str] = []
        self.lost: set[type] = set()

    def step(self, reads: int | Four, counts: int | Four | None = None) -> str:
        """Another 10 ms; `counts` is the rpm at which the pulse counts run, None: as the readings say."""
        self.t_ns += PERIOD
        reading = (reads,) * 4 if isinstance(reads, int) else reads
        running = reading if counts is None else (counts,) * 4 if isinstance(counts, int) else counts
        doubt = ""
        if WheelSpeeds not in self.lost:
            said = (int(reading[0]), int(reading[1]), int(reading[2]), int(reading[3]))
            self.belief, doubt = on_speeds(CONFIG, self.belief, speeds(said, self.t_ns))
            self.doubts.append(doubt)
        for wheel, rpm in enumerate(running):
            self.turns[wheel] += rpm / 60.0 * PERIOD / S
        if WheelCounts not in self.lost:
            ppr = self.car.wheel_pulses_per_rev
            counted = [(self.first_count + int(turns * ppr)) % 65536 for turns in self.turns]
            self.belief = on_counts(CONFIG, self.car, self.belief, WheelCounts(*counted, t_rx_ns=self.t_ns))
        return doubt

    def until_doubted(self, reads: int | Four, counts: int | Four, most_ms: int = 5000) -> int | None:
        """Milliseconds until a frame is not believed because of the counts."""
        began_ns = self.t_ns
        while self.t_ns - began_ns < most_ms * MS:
            if "count" in self.step(reads, counts):
                return (self.t_ns - began_ns) // MS
        return None

    def roll(self, rpm: int, milliseconds: int = 1000) -> Wheels:
        for n in range(milliseconds // 10):
            assert self.step(min(rpm, 250 * (n + 1))) == ""
        return self


# ---------------------------------------------------------------- the database's range


@pytest.mark.parametrize(("rpm", "believed"), [(0, True), (1250, True), (1251, False), (65535, False)])
@pytest.mark.parametrize("wheel", range(4))
def test_a_reading_above_the_databases_range_is_not_believed(rpm: int, believed: bool, wheel: int) -> None:
    said = [0, 0, 0, 0]
    said[wheel] = rpm
    frame = WheelSpeeds(*said, t_rx_ns=T0)
    belief, doubt = on_speeds(CONFIG, WheelBelief(), frame)
    assert (belief.speeds is frame) == believed == (doubt == "")
    names = ("front left", "front right", "rear left", "rear right")
    assert believed or doubt == f"the {names[wheel]} wheel reads more than 1250 rpm"


# ---------------------------------------------------------------- changes that no tyre can follow


@pytest.mark.parametrize("gap_ns", [1, 5 * MS, 10 * MS])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_reading_may_change_by_300_rpm_in_a_period(gap_ns: int, sign: int) -> None:
    belief, _ = on_speeds(CONFIG, WheelBelief(), speeds(600, T0))
    for change, believed in ((300, True), (301, False)):
        frame = speeds((600, 600 + sign * change, 600, 600), T0 + gap_ns)
        after, doubt = on_speeds(CONFIG, belief, frame)
        assert (after.speeds is frame) == believed
        assert believed or doubt == "the front right wheel changed faster than a tyre can follow"


def test_a_jump_that_stays_is_not_believed_for_350_ms() -> None:
    """So it is reacted to as a missing frame, at 100 and 300 ms, before it counts."""
    belief, _ = on_speeds(CONFIG, WheelBelief(), speeds(0, T0))
    for after_ns in (*range(10 * MS, 350 * MS, 10 * MS), 350 * MS - 1):
        belief, doubt = on_speeds(CONFIG, belief, speeds(301, T0 + after_ns))
        assert doubt and belief.speeds == speeds(0, T0)
    assert on_speeds(CONFIG, belief, speeds(301, T0 + 350 * MS))[1] == ""


# ---------------------------------------------------------------- readings against counts


def counting(car: VehicleParameters, counts: tuple[int, ...], gap_ns: int, rpm: int) -> WheelBelief:
    """The front left wheel counts so, `gap_ns` apart, the last at T0; all wheels read `rpm` just before each."""
    belief = WheelBelief()
    for n, fl in enumerate(counts):
        t_ns = T0 - (len(counts) - 1 - n) * gap_ns
        belief, _ = on_speeds(CONFIG, belief, speeds(rpm, t_ns - 1))
        belief = on_counts(CONFIG, car, belief, WheelCounts(fl=fl, t_rx_ns=t_ns))
    return belief


@pytest.mark.parametrize(("rpm", "most_ms"), [(60, 1000), (200, 250), (500, 110), (1000, 80)])
@pytest.mark.parametrize("reads", [0, 9])
def test_a_reading_that_stands_while_its_count_runs(rpm: int, most_ms: int, reads: int) -> None:
    wheels = Wheels().roll(rpm)
    after_ms = wheels.until_doubted((reads, rpm, rpm, rpm), rpm)
    assert after_ms is not None and after_ms <= most_ms
    assert wheels.doubts[-1] == "the front left wheel reads under 10 rpm while its pulse count runs"
    for _ in range(100):  # for as long as it lasts
        assert wheels.step((reads, rpm, rpm, rpm), rpm)


@pytest.mark.parametrize(("rpm", "most_ms"), [(20, 1800), (60, 600), (200, 200), (500, 110), (1000, 80)])
def test_a_reading_that_runs_while_its_count_stands(rpm: int, most_ms: int) -> None:
    wheels = Wheels().roll(rpm)
    after_ms = wheels.until_doubted(rpm, (rpm, rpm, 0, rpm))
    assert after_ms is not None and after_ms <= most_ms
    assert wheels.doubts[-1] == "the rear left wheel reads a speed while its pulse count stands still"
    for _ in range(100):
        assert wheels.step(rpm, (rpm, rpm, 0, rpm))


def but(wheel: int, rpm: int, others_rpm: int) -> Four:
    """`rpm` for one wheel and `others_rpm` for the others."""
    fl, fr, rl, rr = (rpm if n == wheel else others_rpm for n in range(4))
    return fl, fr, rl, rr


@pytest.mark.parametrize("wheel", range(4))
def test_each_wheels_reading_is_held_against_its_own_count(wheel: int) -> None:
    names = ("front left", "front right", "rear left", "rear right")
    for reads, counts in ((but(wheel, 200, 0), 0), (200, but(wheel, 0, 200)), (but(wheel, 0, 200), 200)):
        wheels = Wheels().roll(200)
        assert wheels.until_doubted(reads, counts) is not None
        assert wheels.doubts[-1].startswith(f"the {names[wheel]} wheel")


def test_a_doubted_wheel_is_believed_when_it_reads_near_standing() -> None:
    for reads, counts, believed_rpm in ((200, 0, 19), (0, 200, 10)):
        wheels = Wheels().roll(200)
        assert wheels.until_doubted(reads, counts) is not None
        assert wheels.step(believed_rpm, counts) == ""


@pytest.mark.parametrize("wheel", range(4))
def test_each_wheel_must_have_been_seen_to_count_itself(wheel: int) -> None:
    wheels = Wheels()
    for _ in range(14):  # too short for a doubt
        wheels.step(200, but(wheel, 0, 200))
    assert wheels.belief.has_counted == tuple(n != wheel for n in range(4))
    assert wheels.until_doubted(but(wheel, 200, 0), 0) is None


def test_a_wheel_may_run_for_half_a_turn_without_its_count() -> None:
    """At 600 rpm that is 50 ms, to the nanosecond."""
    for gap_ns, doubted in ((50 * MS - 1, False), (50 * MS, True)):
        belief = counting(CAR, (0, 2), PERIOD, 600)
        assert belief.doubted == (0, 0, 0, 0)
        belief = on_counts(CONFIG, CAR, belief, WheelCounts(fl=2, t_rx_ns=T0 + gap_ns))
        assert belief.doubted == ((-1, 0, 0, 0) if doubted else (0, 0, 0, 0))


@pytest.mark.parametrize(("pulses", "doubted"), [(5299, False), (5301, True)])
def test_a_count_may_run_half_a_turn_ahead_of_20_rpm(pulses: int, doubted: bool) -> None:
    car = replace(CAR, wheel_pulses_per_rev=10_000)  # 300 of them are 20 rpm for 90 ms
    assert counting(car, (0, pulses), 90 * MS, 0).doubted == ((1, 0, 0, 0) if doubted else (0, 0, 0, 0))


def test_two_pulses_at_once_show_that_a_wheel_counts() -> None:
    assert counting(CAR, (0, 2), PERIOD, 0).has_counted == (True, False, False, False)
    assert counting(CAR, (0, 1), PERIOD, 0).has_counted == (False, False, False, False)
    assert counting(CAR, (0, 1, 2), PERIOD, 0).has_counted == (True, False, False, False)


@pytest.mark.parametrize("counts", [0, 200])
@pytest.mark.parametrize("reads", [10, 19])
def test_what_is_read_near_standing_is_held_against_no_wheel(reads: int, counts: int) -> None:
    wheels = Wheels().roll(100)
    assert wheels.until_doubted(reads, counts) is None
    assert wheels.step(30 if counts == 0 else 0, counts) == ""


@pytest.mark.parametrize(("between", "reads", "counts"), [(5, 100, 0), (100, 0, 100)])
def test_every_reading_between_two_counts_counts(between: int, reads: int, counts: int) -> None:
    wheels = Wheels().roll(100)
    for _ in range(200):
        wheels.belief, doubt = on_speeds(CONFIG, wheels.belief, speeds(between, wheels.t_ns + 5 * MS))
        assert doubt == "" == wheels.step(reads, counts)


def test_the_reading_before_the_last_count_counts_too() -> None:
    """What a wheel reads between two counts it may have left, or come to, at once after the first."""
    wheels = Wheels().roll(200)
    for _ in range(50):
        wheels.step(200, 200)
        wheels.step(0, 200)
        assert wheels.belief.ahead == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("rpm", [5, 10, 19, 20])
def test_a_count_that_crawls_contradicts_no_standing_wheel(rpm: int) -> None:
    assert Wheels().until_doubted(0, rpm) is None


@pytest.mark.parametrize("ran_ms", [0, 40])
def test_a_wheel_that_never_counted_says_nothing(ran_ms: int) -> None:
    """One pulse may be an edge at rest."""
    wheels = Wheels()
    for _ in range(ran_ms // 10):
        wheels.step(100)
    assert wheels.until_doubted(200, 0) is None


@pytest.mark.parametrize(("reads", "counts", "after_ms"), [(200, 0, 50), (0, 200, 10)])
def test_a_wheel_of_which_both_signals_run_is_believed_again(reads: int, counts: int, after_ms: int) -> None:
    wheels = Wheels().roll(200)
    assert wheels.until_doubted(reads, counts) is not None
    assert next(n * 10 for n in range(1, 100) if wheels.step(200) == "") <= after_ms


@pytest.mark.parametrize("doubted_cycles", [0, 500])
def test_a_wheel_whose_count_stops_is_believed_to_stand_later(doubted_cycles: int) -> None:
    """However long the doubt has lasted."""
    wheels = Wheels().roll(200)
    assert wheels.until_doubted(0, 200) is not None
    for _ in range(doubted_cycles):
        wheels.step(0, 200)
    after_ms = next(n * 10 for n in range(1, 1000) if wheels.step(0, 0) == "")
    assert 500 <= after_ms <= 2000  # no pulse in all that time


@pytest.mark.parametrize("car", [ADS_DV_2026, OFFICIAL_SIMULATOR])
@pytest.mark.parametrize("rpm", [1, 9, 10, 11, 30, 250, 299])
def test_signals_that_agree_are_believed_at_every_speed(car: VehicleParameters, rpm: int) -> None:
    wheels = Wheels(car)
    for milliseconds, now_rpm in ((2000, rpm), (3000, 0), (1000, 9), (2000, rpm)):
        wheels.roll(now_rpm, milliseconds)


@pytest.mark.parametrize("delay", [1, 5, 10])
@pytest.mark.parametrize("late", ["reading", "count"])
def test_dead_time_between_the_two_is_no_contradiction(delay: int, late: str) -> None:
    """From 500 rpm to rest at 9 m/s2 and back, with one of the two signals up to 100 ms behind the other."""
    course = [0] * 50 + [min(500, 3 * n) for n in range(200)] + [max(0, 500 - 3 * n) for n in range(300)] + [0] * 100
    wheels = Wheels()
    for n in range(len(course)):
        behind = course[max(0, n - delay)]
        reads, counts = (behind, course[n]) if late == "reading" else (course[n], behind)
        assert wheels.step(reads, counts) == "", n


@pytest.mark.parametrize("delay", [0, 3])
def test_a_wheel_that_locks_or_spins_is_no_contradiction(delay: int) -> None:
    course = [300] * 50 + [0] * 20 + [250] * 20 + [0] * 20 + [200] * 50
    wheels = Wheels().roll(290)
    for n in range(len(course)):
        assert wheels.step(course[n], course[max(0, n - delay)]) == "", n


@pytest.mark.parametrize("lost", [WheelCounts, WheelSpeeds])
def test_signals_that_are_missing_contradict_nothing(lost: type) -> None:
    wheels = Wheels().roll(200)
    wheels.lost = {lost}
    for _ in range(30):
        assert wheels.step(0) == ""
    wheels.lost = set()
    for _ in range(5):
        assert wheels.step(200, 200) == ""


def test_a_doubt_ends_with_the_counts_it_came_from() -> None:
    wheels = Wheels().roll(200)
    assert wheels.until_doubted(0, 200) is not None
    wheels.lost = {WheelCounts}
    doubted = [wheels.step(0) != "" for _ in range(12)]
    assert doubted == [True] * 9 + [False] * 3  # counts of 100 ms say nothing any more


@pytest.mark.parametrize(("gap_ns", "compared"), [(100 * MS - 1, True), (100 * MS, False)])
def test_counts_100_ms_apart_contradict_nothing(gap_ns: int, compared: bool) -> None:
    belief = counting(CAR, (0, 40), gap_ns, 0)
    assert belief.doubted == ((1, 0, 0, 0) if compared else (0, 0, 0, 0))


@pytest.mark.parametrize(("age_ns", "compared"), [(100 * MS - 1, True), (100 * MS, False)])
def test_a_reading_of_100_ms_contradicts_nothing(age_ns: int, compared: bool) -> None:
    belief, _ = on_speeds(CONFIG, WheelBelief(), speeds(0, T0 - age_ns))
    for count, t_ns in ((0, T0 - 50 * MS), (20, T0)):
        belief = on_counts(CONFIG, CAR, belief, WheelCounts(fl=count, t_rx_ns=t_ns))
    assert belief.doubted == ((1, 0, 0, 0) if compared else (0, 0, 0, 0))


@pytest.mark.parametrize("lost", [WheelCounts, WheelSpeeds])
def test_before_both_signals_came_nothing_contradicts(lost: type) -> None:
    wheels = Wheels()
    wheels.lost = {lost}
    for _ in range(100):
        assert wheels.step(200, 100) == ""
    wheels.lost = set()
    assert wheels.step(0 if lost is WheelSpeeds else 200, 100) == ""


def test_frames_lost_now_and_then_change_nothing() -> None:
    wheels = Wheels().roll(250)
    for n in range(400):
        wheels.lost = {WheelSpeeds} if n % 7 == 0 else {WheelCounts} if n % 5 == 0 else set()
        assert wheels.step(0 if 100 <= n < 300 else 250) == ""


def test_counts_that_start_anew_contradict_nothing() -> None:
    wheels = Wheels().roll(250)
    for _ in range(20):
        wheels.first_count += 1000
        for _ in range(3):
            assert wheels.step(0, 0) == ""


# ---------------------------------------------------------------- pulses


def frames(*counts: int, step_ns: int = PERIOD, per_s: float = PER_S) -> Pulses:
    """Frames in which the front left wheel counts so, the last at T0."""
    pulses = NO_PULSES
    for n, fl in enumerate(counts):
        pulses = pulses_of(per_s, pulses, WheelCounts(fl=fl, t_rx_ns=T0 - (len(counts) - 1 - n) * step_ns))
    return pulses


@pytest.mark.parametrize(
    ("counts", "step_ns", "turned_ms_ago"),
    [
        ((7,), PERIOD, None),
        ((7, 7, 7), PERIOD, None),
        ((7, 8), PERIOD, None),  # one pulse may be an edge
        ((7, 8, 8), PERIOD, None),
        ((7, 9), PERIOD, 0),
        ((65535, 1), PERIOD, 0),
        ((65534, 0), PERIOD, 0),
        ((65535, 0, 0, 0, 1), PERIOD, 30),  # two count from the older one
        ((7, 8, 9, 10, 10), PERIOD, 20),
        ((0, 6), MS, 0),  # frames read close together were measured apart
        ((0, 40), 100 * MS, 0),  # a longer gap explains more pulses
        ((0, 44), 100 * MS, None),
    ],
)
def test_two_pulses_are_turning_from_the_older_one_on(
    counts: tuple[int, ...], step_ns: int, turned_ms_ago: int | None
) -> None:
    assert frames(*counts, step_ns=step_ns).turning_ns == (None if turned_ms_ago is None else T0 - turned_ms_ago * MS)


def test_the_latest_turning_of_all_wheels_counts() -> None:
    pulses = NO_PULSES
    turned = []
    for n, counts in enumerate(((0, 0, 0, 0), (0, 0, 1, 0), (2, 0, 1, 0), (2, 1, 1, 0), (2, 1, 2, 0), (2, 2, 2, 0))):
        pulses = pulses_of(PER_S, pulses, WheelCounts(*counts, t_rx_ns=T0 + n * PERIOD))
        turned.append(pulses.turning_ns)
    # The first pulse of a wheel is an edge; the one before the rear left wheel's second is older than the front's two.
    assert turned == [None, None, T0 + 2 * PERIOD, T0 + 2 * PERIOD, T0 + 2 * PERIOD, T0 + 3 * PERIOD]


@pytest.mark.parametrize("wheel", range(4))
def test_each_wheel_alone_is_turning(wheel: int) -> None:
    counts = [0, 0, 0, 0]
    pulses = pulses_of(PER_S, NO_PULSES, WheelCounts(*counts, t_rx_ns=T0 - PERIOD))
    counts[wheel] = 2
    assert pulses_of(PER_S, pulses, WheelCounts(*counts, t_rx_ns=T0)).turning_ns == T0


@pytest.mark.parametrize(
    ("per_s", "step", "restart"),
    [
        (PER_S, 6, False),
        (PER_S, 7, True),
        (PER_S, 32769, True),
        (PER_S, 65535, True),
        (400.0, 6, False),  # 4 in a period, and 2 more
        (460.0, 7, True),
    ],
)
def test_a_count_that_no_speed_explains_has_started_anew(per_s: float, step: int, restart: bool) -> None:
    pulses = frames(30000, (30000 + step) % 65536, per_s=per_s)
    assert (pulses.steps is None) == restart == (pulses.turning_ns is None)
    assert pulses.counts is not None and pulses.counts.fl == (30000 + step) % 65536


@pytest.mark.parametrize(("age_ns", "turns"), [(0, True), (500 * MS - 1, True), (500 * MS, False)])
def test_turning_ends_half_a_second_after_the_older_pulse(age_ns: int, turns: bool) -> None:
    assert turning(500 * MS, T0 - age_ns, T0) == turns
    assert not turning(500 * MS, None, T0)


def test_the_highest_speed_explains_the_pulses_of_its_car() -> None:
    assert pulses_per_s(CONFIG, CAR) == pytest.approx(1250 / 60 * 20)
    assert pulses_per_s(replace(CONFIG, wheel_max_rpm=600), OFFICIAL_SIMULATOR) == pytest.approx(360)
