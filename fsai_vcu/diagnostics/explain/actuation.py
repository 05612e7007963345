"""Check that the car does what it is asked: torque, steering, brakes and wheels of a drive, for any AI stack.

Each check is a mask over the drive's cycles; a check that holds for long enough is an incident with the cause's words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import ALWAYS, Incident, IncidentKind, TimeRange, shown
from fsai_vcu.diagnostics.explain.record import Record, Values
from fsai_vcu.diagnostics.explain.signals import Signal
from fsai_vcu.diagnostics.log.frames import Ints, Mask
from fsai_vcu.interface.enums import Direction, MissionStatus
from fsai_vcu.interface.specification import PERIOD_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S, ms

TORQUE_NM: Final = 20.0  # less is within what a motor's own estimate is off
TORQUE_SHARE: Final = 0.7  # of what is asked for, allowed by TRQ_MAX, and within the motors' power
LIMIT_SHARE: Final = 0.7  # of what is asked for: a car that allows less is derated
BRAKE_PCT: Final = 20.0
BRAKE_SHARE: Final = 0.6
STEER_DEG: Final = 4.0
WHEEL_RPM: Final = 40.0
WHEEL_SHARE: Final = 0.4  # above what the tightest turn makes of the inner wheel
TORQUE_TIME_NS: Final = 300 * MS  # so long after a request at the latest the actuator has answered …
BRAKE_TIME_NS: Final = 500 * MS
STEER_TIME_NS: Final = 1500 * MS  # … lock to lock at 40 deg/s, and its dead time
START_TIME_NS: Final = 2 * S
WARNED_SHARE: Final = 0.5
FRESH_NS: Final = 50 * MS
AGAINST_TIME_NS: Final = 100 * MS  # … and turned round
TURN_DEG: Final = 4.0  # less is no turn that wheel speeds tell from a straight
TURN_RPM: Final = 60.0
TURN_SHARE: Final = 0.4  # of the difference that the turn makes between left and right
LASTING_NS: Final = 500 * MS
LESS_LASTING_NS: Final = 1 * S
UNASKED_LASTING_NS: Final = 300 * MS
TURN_LASTING_NS: Final = 2 * S
BRAKE_LASTING_NS: Final = 200 * MS


_NO_DRIVE: Final = (
    (float(Direction.NEUTRAL),),
    (float(MissionStatus.NOT_SELECTED), float(MissionStatus.SELECTED)),
)


@dataclass(frozen=True)
class Mismatch:
    """One thing that was not as asked, cycle by cycle."""

    slug: str
    signal: Signal
    asked: Signal
    holds: Mask
    words: str  # with places for the values of a cycle
    values: Sequence[Values]
    least_ns: int = LASTING_NS


def mismatches(record: Record, part_ns: TimeRange = ALWAYS) -> Iterator[Incident]:
    """Times at which the car did not do what was asked, in each stay in AS_DRIVING: of those at one time the longest.

    Motors that nobody asked are told in every state.
    """
    for span in record.series(sig.AS_STATE).spans:
        times = record.times(0x513)
        low, high = np.searchsorted(times, (span.begin_ns, span.end_ns + 1))
        times = times[low:high]
        if len(times) <= STEER_TIME_NS // PERIOD_NS:
            continue
        driving = span.value == sig.DRIVING
        awake = np.ones(len(times), np.bool_)
        for frozen in record.frozen:  # whether the car still drives is not known
            awake &= (times < frozen.begin_ns) | (times > frozen.end_ns)
        seen: dict[str, Incident] = {}  # an axle that does not do it is enough
        for one in _all(record, times):
            if not driving and one.slug != "torque_unasked":
                continue
            known = [awake, *(_fresh(record, each, times) for each in (one.signal, one.asked, sig.WHEELS[0]))]
            stretch = _longest(replace(one, holds=np.logical_and.reduce([one.holds, *known])), times, part_ns)
            if stretch is not None:
                begin_ns, end_ns = (int(times[row]) for row in stretch)
                middle = one.words.format(*(values[sum(stretch) // 2] for values in one.values))
                words = f"{middle}, for {ms(end_ns - begin_ns)}"
                cause = shown(one.slug, one.signal.step(begin_ns, words))
                incident = Incident(IncidentKind.MISMATCH, begin_ns, words, (cause,), lasted=(begin_ns, end_ns))
                seen.setdefault(one.slug, incident)
        yield from seen.values()


def _fresh(record: Record, signal: Signal, times: Ints) -> Mask:
    """Select the times at which the car has reported it all along lately: what is missing is not a wrong answer."""
    received = record.times(signal.can_id)
    if not len(received) or not len(record.series(signal)):
        return np.zeros(len(times), np.bool_)
    newest = received[np.maximum(np.searchsorted(received, times, side="right") - 1, 0)]
    late = (times - newest >= FRESH_NS).astype(np.float64)
    return np.asarray(_range(late, START_TIME_NS)[1] == 0.0)


def _longest(one: Mismatch, times: Ints, part_ns: TimeRange) -> tuple[int, int] | None:
    """Select its longest stretch of rows, if that is long enough: one finding a drive, not a hundred."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], one.holds, [False])).astype(np.int8)))
    stretches = [(int(begin), int(end) - 1) for begin, end in zip(edges[::2], edges[1::2], strict=True)]
    stretches = [rows for rows in stretches if times[rows[0]] <= part_ns[1] and times[rows[1]] >= part_ns[0]]
    longest = max(stretches, key=lambda rows: int(times[rows[1]] - times[rows[0]]), default=None)
    return longest if longest is not None and times[longest[1]] - times[longest[0]] >= one.least_ns else None


def _all(record: Record, times: Ints) -> Iterator[Mismatch]:
    """Every check; what the log does not have counts as 0 here, and is never fresh."""
    car = record.car

    def column(signal: Signal) -> Values:
        return record.series(signal).sampled(times)

    wheels = np.stack([column(signal) for signal in sig.WHEELS])
    fastest = wheels.max(axis=0)
    braked = np.maximum(column(sig.BRAKE_REQ_F), column(sig.BRAKE_REQ_R)) > 0
    pressed = np.maximum(column(sig.BRAKE_F), column(sig.BRAKE_R)) > 2.0
    # No torque is to be expected with NEUTRAL, or without RUNNING: standing.py names that.
    meant = ~np.isin(column(sig.DIRECTION), _NO_DRIVE[0]) if len(record.series(sig.DIRECTION)) else ~braked
    if len(record.series(sig.MISSION_STATUS)):
        meant &= ~np.isin(column(sig.MISSION_STATUS), _NO_DRIVE[1])
    given_sum = np.zeros(len(times))
    curve_rpm, curve_nm = np.array(car.torque_curve_rpm_nm).T
    for axle, driven, asked_signal, limit_signal, given_signal, max_signal in (
        ("front", car.driven_front, sig.TORQUE_F, sig.SPEED_MAX_F, sig.CAR_TORQUE[0], sig.CAR_TORQUE_MAX[0]),
        ("rear", car.driven_rear, sig.TORQUE_R, sig.SPEED_MAX_R, sig.CAR_TORQUE[1], sig.CAR_TORQUE_MAX[1]),
    ):
        if not driven:
            continue
        asked, given, most = column(asked_signal), column(given_signal), column(max_signal)
        given_sum += given
        motor_rpm = fastest * car.gear_ratio
        free = (motor_rpm < 0.9 * column(limit_signal)) & ~braked & meant
        possible = np.minimum(np.minimum(asked, most), np.interp(motor_rpm, curve_rpm, curve_nm))
        low, _ = _range(np.where(free, possible, 0.0), TORQUE_TIME_NS)
        wanted, high = _range(asked, TORQUE_TIME_NS)
        words = f"{axle} torque: {{:.1f}} Nm asked for, {{:.1f}} Nm measured"
        less = (low > TORQUE_NM) & (given < TORQUE_SHARE * low)
        more = given > high + TORQUE_NM
        against = given < -(_range(asked, AGAINST_TIME_NS)[1] + TORQUE_NM)  # above MOTOR_SPEED_MAX it brakes by as much
        yield Mismatch("torque_not_given", given_signal, asked_signal, less, words, (asked, given), LESS_LASTING_NS)
        yield Mismatch(
            "torque_unasked", given_signal, asked_signal, more | against, words, (asked, given), UNASKED_LASTING_NS
        )
        allows = f"{max_signal.name} is {{:.1f}} Nm, and {{:.1f}} Nm are asked for"
        held = free & (wanted - most > TORQUE_NM) & (most < LIMIT_SHARE * wanted)
        yield from _derated(column, held, Mismatch("derated", max_signal, asked_signal, held, allows, (most, asked), S))
    pushed, _ = _range(np.where(braked | pressed, 0.0, given_sum), START_TIME_NS)
    yield Mismatch(
        "no_motion",
        sig.CAR_TORQUE[1],
        sig.TORQUE_R,
        (pushed > TORQUE_NM) & (_range(fastest, START_TIME_NS)[1] < STANDING_RPM),
        "{:.0f} Nm are given, and no wheel turns",
        (given_sum,),
    )
    brakes = (("front", sig.BRAKE_REQ_F, sig.BRAKE_F), ("rear", sig.BRAKE_REQ_R, sig.BRAKE_R))
    for axle, asked_signal, given_signal in brakes:
        asked, given = column(asked_signal), column(given_signal)
        low, high = _range(asked, BRAKE_TIME_NS)[0], _range(asked, 2 * BRAKE_TIME_NS)[1]
        words = f"{axle} brake: {{:.1f}} % asked for, {{:.1f}} % measured"
        less, more = (low > BRAKE_PCT) & (given < BRAKE_SHARE * low), given > 1.3 * high + BRAKE_PCT
        yield Mismatch("brake_not_following", given_signal, asked_signal, less, words, (asked, given), BRAKE_LASTING_NS)
        yield Mismatch("brake_unasked", given_signal, asked_signal, more, words, (asked, given))
    asked, angle = column(sig.STEER), column(sig.ANGLE)
    limit = column(sig.ANGLE_MAX) if len(record.series(sig.ANGLE_MAX)) else np.full(len(times), np.inf)
    within = np.clip(asked, -limit, limit)
    low, high = _range(within, STEER_TIME_NS)
    off = (angle < low - STEER_DEG) | (angle > high + STEER_DEG)
    off[: STEER_TIME_NS // PERIOD_NS] = False
    words = "steering: {:.1f} deg asked for, {:.1f} deg measured"
    yield Mismatch("steering_not_following", sig.ANGLE, sig.STEER, off, words, (asked, angle))
    # In a turn the outer wheels are the faster ones; positive angles turn left.
    turn = np.tan(np.radians(angle)) * car.track_m / car.wheelbase_m
    for axle, left, right in (("front", 0, 1), ("rear", 2, 3)):
        mean = (wheels[left] + wheels[right]) / 2
        outer = (wheels[right] - wheels[left]) * np.sign(angle)
        turning = (np.abs(angle) >= TURN_DEG) & (mean >= TURN_RPM) & (angle * asked > 0)
        swapped = turning & (outer < -TURN_SHARE * np.abs(turn) * mean)
        names = " and ".join(f"{sig.WHEEL_NAMES[wheel]} {{:.0f}}" for wheel in (left, right))
        words = f"{axle} wheels in a turn of {{:.1f}} deg (positive: left): {names} rpm"
        values = (angle, wheels[left], wheels[right])
        yield Mismatch("wheels_swapped", sig.WHEELS[left], sig.ANGLE, swapped, words, values, TURN_LASTING_NS)
    for number, name in enumerate(sig.WHEEL_NAMES):
        others = np.sort(np.delete(wheels, number, axis=0), axis=0)
        middle = others[1]
        allowed = WHEEL_RPM + WHEEL_SHARE * middle
        unlike = (np.abs(wheels[number] - middle) > allowed) & (others[2] - others[0] <= allowed)
        words = f"{name} at {{:.0f}} rpm, the others at {{:.0f}} rpm"
        yield Mismatch("wheel_unlike", sig.WHEELS[number], sig.WHEELS[0], unlike, words, (wheels[number], middle))


def _derated(column: Callable[[Signal], Values], held: Mask, one: Mismatch) -> Iterator[Mismatch]:
    """The car allows less torque than is asked for; why, where it warns."""
    for slug, warning in (("derated_hot", sig.WARNINGS[0]), ("derated_empty", sig.WARNINGS[1])):
        warned = held & (column(warning) != 0)
        if held.any() and warned.sum() >= WARNED_SHARE * held.sum():
            yield replace(one, slug=slug, holds=held, words=f"{one.words}; {warning.name} is 1")
            return
    yield one


def _range(values: Values, over_ns: int) -> tuple[Values, Values]:
    """The lowest and highest value of the last `over_ns`, of one value a cycle; before the first it counts as 0."""
    width, reach = over_ns // PERIOD_NS, 1
    low = high = np.concatenate((np.zeros(width - 1), values))
    while reach < width:
        step = min(reach, width - reach)
        low, high = np.minimum(low[step:], low[:-step]), np.maximum(high[step:], high[:-step])
        reach += step
    return low, high
