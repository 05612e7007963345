"""Causes for which a car in AS_DRIVING does not drive: somebody does not let it, or nobody asks it to.

A stand is a time without motion that is longer than a start and its patience; what held nearly all of that time is its
cause. Whatever the reason, it is one: a car that stands in AS_DRIVING is never passed over.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.conditions import unmet
from fsai_vcu.diagnostics.explain.incident import (
    Candidate,
    ChainLink,
    Incident,
    IncidentKind,
    Sureness,
    candidate,
    shown,
)
from fsai_vcu.diagnostics.explain.record import Record, Span, Values
from fsai_vcu.diagnostics.explain.signals import Signal
from fsai_vcu.diagnostics.log.frames import Ints, Mask
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.specification import STANDING_RPM
from fsai_vcu.interface.units import S, ms

STAND_NS: Final = 7 * S  # an AI computer holds the car for 3 s at first, and has longer for the first torque
NEARLY: Final = 0.9  # of a stand: what comes and goes is not what keeps the car there
NO_TORQUE_NM: Final = 1.0
CREEP_RPM: Final = 2 * STANDING_RPM  # of a wheel: a limit of the motors below that keeps the car where it is
PRESSED_PCT: Final = 10.0
GIVEN_SHARE: Final = 0.5
INSPECTIONS: Final = (Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B)  # in which wheels may rest
SWEPT: Final = (*INSPECTIONS, Ami.AUTONOMOUS_DEMO)  # in which the car steers at rest, and is driving with that
TORQUES: Final = (sig.TORQUE_F, sig.TORQUE_R)
BRAKES: Final = (sig.BRAKE_REQ_F, sig.BRAKE_REQ_R)
PRESSURES: Final = (sig.BRAKE_F, sig.BRAKE_R)


class Stand(NamedTuple):
    """A time without motion in AS_DRIVING, and whether the car had driven before, since AS_DRIVING began."""

    begin_ns: int
    end_ns: int
    driven: bool


def stood(record: Record, begin_ns: int, end_ns: int) -> Stand | None:
    """The longest time without motion in a stay in AS_DRIVING, where that is long enough for a word."""
    wheels = record.middle_wheel.between(begin_ns, end_ns)
    if not len(wheels):
        return None
    still = wheels.values < STANDING_RPM
    if record.at(sig.AMI, end_ns) in SWEPT:
        still &= np.diff(record.series(sig.STEER).sampled(wheels.t_ns), prepend=0.0) == 0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    parts = [(int(wheels.t_ns[a]), int(wheels.t_ns[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    first = begin_ns if still[0] else None
    parts = [(first if first is not None and number == 0 else low, high) for number, (low, high) in enumerate(parts)]
    longest = max(parts, key=lambda part: part[1] - part[0], default=None)
    if longest is None or longest[1] - longest[0] < STAND_NS:
        return None
    return Stand(*longest, bool((~still[wheels.t_ns < longest[0]]).any()))


class _Seen:
    """The signals of the second half of a stand, when a start must be over: a value for each frame with wheel speeds.

    Sentences cite the values of one moment, the middle of that half.
    """

    def __init__(self, record: Record, stand: Stand) -> None:
        self.record, self.stand = record, stand
        self.begin_ns = (stand.begin_ns + stand.end_ns) // 2
        self.times: Ints = record.middle_wheel.between(self.begin_ns, stand.end_ns).t_ns
        self.at_ns = int(self.times[len(self.times) // 2]) if len(self.times) else self.begin_ns

    def has(self, *signals: Signal) -> bool:
        return all(len(self.record.series(signal)) for signal in signals)

    def column(self, *signals: Signal) -> Values:
        """The greatest of these signals in each row."""
        found: Values = np.maximum.reduce([self.record.series(signal).sampled(self.times) for signal in signals])
        return found

    def mostly(self, rows: Mask) -> bool:
        return bool(len(rows)) and float(rows.mean()) >= NEARLY

    def at(self, *signals: Signal) -> float:
        """The greatest of these signals at the moment that sentences cite."""
        return max(self.record.at(signal, self.at_ns) or 0.0 for signal in signals)

    def step(self, signal: Signal, words: str, *cited: Signal) -> ChainLink:
        """The sentence, from when the signal's value was in force; `cited`: whose values the words give, too."""
        span = self.record.span_at(signal, self.at_ns)
        begin_ns = self.stand.begin_ns if span is None else max(self.stand.begin_ns, span.begin_ns)
        return signal.step(begin_ns, words, *(each.was(self.at(each), self.at_ns) for each in (signal, *cited)))


def causes(record: Record, stand: Stand) -> list[Candidate]:
    """The causes that kept the car there, the first to be put right in front; never empty."""
    seen = _Seen(record, stand)
    length = ms(stand.end_ns - stand.begin_ns)
    missing = [one for one in unmet(AsState.AS_DRIVING, record, stand.end_ns) if one.sureness >= Sureness.SHOWN]
    found = [*missing, *_not_let(seen)]
    # An AI computer whose car allows no torque, or is held, asks for none.
    found += [replace(one, sureness=Sureness.FITS) if found else one for one in _not_asked(seen)]
    if found:
        return found
    words = f"no wheel turns for {length}, and no frame says why"
    return [candidate("stands", Sureness.SHOWN, ChainLink(stand.begin_ns, words, 0x525))]


def _not_let(seen: _Seen) -> Iterator[Candidate]:
    """Causes of the car: it gives no torque, or is held."""
    axles = ((seen.record.car.driven_front, 0), (seen.record.car.driven_rear, 1))
    limits = [sig.CAR_TORQUE_MAX[axle] for driven, axle in axles if driven]
    if seen.has(*limits) and seen.mostly(seen.column(*limits) < NO_TORQUE_NM):
        said = " and ".join(f"{limit.name} is {seen.at(limit):g} Nm" for limit in limits)
        yield shown("torque_limit_zero", seen.step(limits[-1], said, *limits))
    braked, pressed = seen.column(*BRAKES), seen.column(*PRESSURES)
    if seen.has(*PRESSURES) and seen.mostly((braked == 0.0) & (pressed > PRESSED_PCT)):
        words = f"{seen.at(*PRESSURES):.0f} % of brake pressure are measured, and 0 % are asked for"
        yield shown("brake_unasked", seen.step(sig.BRAKE_F, words, *PRESSURES))


def _not_asked(seen: _Seen) -> Iterator[Candidate]:
    """Causes of the AI computer: it asks for nothing, or says something beside that keeps the car from driving."""
    if not seen.has(*TORQUES):
        return
    asked, braked = seen.column(*TORQUES), seen.column(*BRAKES)
    if seen.mostly(asked == 0.0):
        yield _nothing_asked(seen, braked)
    if not seen.mostly(asked > 0.0):
        return
    status, direction = sig.MISSION_STATUS, sig.DIRECTION
    torque = f"{seen.at(*TORQUES):g} Nm are asked for"
    for slug, signal, values in (
        ("neutral_in_driving", direction, (Direction.NEUTRAL,)),
        ("never-running", status, (MissionStatus.NOT_SELECTED, MissionStatus.SELECTED)),
    ):
        if seen.has(signal) and seen.mostly(np.isin(seen.column(signal), values)):
            said = sig.label(signal, seen.at(signal))
            yield shown(slug, seen.step(signal, f"{signal.name} is {said}, and {torque}", *TORQUES))
    limits = [limit for asks, limit in zip(TORQUES, (sig.SPEED_MAX_F, sig.SPEED_MAX_R), strict=True) if seen.at(asks)]
    if limits and seen.has(*limits) and seen.mostly(seen.column(*limits) < CREEP_RPM * seen.record.car.gear_ratio):
        words = f"{limits[-1].name} is {seen.at(limits[-1]):g} rpm, and {torque}"
        yield shown("speed_limit_zero", seen.step(limits[-1], words, *TORQUES))
    if seen.mostly(braked > 0.0):
        words = f"{torque}, and {seen.at(*BRAKES):g} % of brake with it"
        yield shown("torque-brake", seen.step(sig.BRAKE_REQ_F, words, *TORQUES))
    if not seen.has(*sig.CAR_TORQUE_MAX, *sig.CAR_TORQUE):
        return
    useful = [seen.column(each) * seen.column(most) for each, most in zip(TORQUES, sig.CAR_TORQUE_MAX, strict=True)]
    if seen.mostly((seen.column(*sig.CAR_TORQUE_MAX) > 0.0) & (np.maximum(*useful) == 0.0)):
        asks = max(TORQUES, key=seen.at)
        words = f"{asks.name} is {seen.at(asks):g} Nm, and the AXLE_TRQ_MAX of that axle is 0"
        yield shown("axle", seen.step(asks, words))
        return
    given = sig.CAR_TORQUE[max((0, 1), key=lambda axle: seen.at(TORQUES[axle]))]
    words = f"{torque}, {given.name} is {seen.at(given):.1f} Nm, and no wheel turns"
    slug = "no_motion" if seen.at(given) > GIVEN_SHARE * seen.at(*TORQUES) else "torque_not_given"
    yield candidate(slug, Sureness.FITS, seen.step(given, words, *TORQUES))


def _nothing_asked(seen: _Seen, braked: Values) -> Candidate:
    record, stand = seen.record, seen.stand
    status = sig.MISSION_STATUS
    if seen.has(status) and seen.mostly(seen.column(status) == MissionStatus.FINISHED):
        return shown("finished_not_taken", seen.step(status, "MISSION_STATUS is FINISHED, and no wheel turns"))
    if seen.mostly(braked > 0.0):
        words = f"{seen.at(*BRAKES):g} % of brake are asked for, and 0 Nm of torque"
        return shown("brake_held", seen.step(sig.BRAKE_REQ_F, words, *TORQUES))
    if seen.has(sig.STEER) and np.ptp(record.series(sig.STEER).sampled(seen.times)) > 0.0:
        words = "0 Nm are asked for, while the steering is asked to move"
        return shown("no_torque_asked", seen.step(sig.TORQUE_R, words, *TORQUES))
    words = f"for {ms(stand.end_ns - stand.begin_ns)} no wheel turns, and neither torque nor steering is asked for"
    return shown("not_driven", seen.step(sig.TORQUE_R, words, *TORQUES))


def last_ns(span: Span) -> int:
    """The last moment of a state: its end is the frame with the next one."""
    return span.end_ns - (span.after is not None)


def stands(record: Record, span: Span) -> Iterator[Incident]:
    """A stay in AS_DRIVING without driving, as an incident of its own."""
    stand = stood(record, span.begin_ns, last_ns(span))
    if stand is None or any(one.begin_ns < stand.end_ns and one.end_ns > stand.begin_ns for one in record.frozen):
        return
    found = tuple(causes(record, stand))
    after = ", after it drove" if stand.driven else ""
    what = f"the car stands in AS_DRIVING for {ms(stand.end_ns - stand.begin_ns)}{after} ({found[0].steps[0].words})"
    yield Incident(IncidentKind.STAND, stand.begin_ns, what, found, lasted=(stand.begin_ns, stand.end_ns))
