"""Mistakes of an AI side that the car bore, whatever stack it is: mistakes that cost teams their event.

Each check looks at AS_DRIVING alone, and reports once, with the first moment. What stopped the car is an incident's
cause.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import TimeRange
from fsai_vcu.diagnostics.explain.record import Record, Series
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.frames import Ints, Mask
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.interface.enums import MissionStatus
from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import MS, S

ENOUGH: Final = 50  # frames: half a second of one thing
WANTED_DEG: Final = 3.0
WENT_DEG: Final = 1.0  # more than its backlash
FOLLOWS_NS: Final = 150 * MS  # in which the steering has begun to follow
MOSTLY: Final = 0.5  # on the way back to straight, both signs agree
SAYS_NS: Final = 1 * S
TOGETHER_NS: Final = 5 * PERIOD_NS  # a frame that the recording lost makes them meet for one or two
_TORQUES: Final = (sig.TORQUE_F, sig.TORQUE_R)
_BRAKES: Final = (sig.BRAKE_REQ_F, sig.BRAKE_REQ_R)
_AXLES: Final = (
    (0x511, sig.TORQUE_F, sig.CAR_TORQUE_MAX[0]),
    (0x512, sig.TORQUE_R, sig.CAR_TORQUE_MAX[1]),
)


def mistakes(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    """Yield the mistakes of the AI side in that part of the log."""
    yield from _steering_swapped(record, part_ns)
    yield from _wrong_axle(record, part_ns)
    yield from _never_running(record, part_ns)
    yield from _torque_with_brake(record, part_ns)


def _problem(record: Record, kind: str, words: str, t_ns: int, *can_ids: int) -> Finding:
    return Finding("problem", kind, words, remedy_of(kind), t_ns, can_ids, record.channel)


def _driving(record: Record, times: Ints, part_ns: TimeRange) -> Mask:
    within: Mask = (times >= part_ns[0]) & (times <= part_ns[1])
    driving: Mask = within & (record.series(sig.AS_STATE).sampled(times) == sig.DRIVING)
    return driving


def _steering_swapped(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    """Yield that steering went the other way than it was asked to."""
    measured, asked = record.series(sig.ANGLE), record.series(sig.STEER)
    if not len(measured) or not len(asked):
        return
    times, angle = measured.t_ns, measured.values
    then_ns = times - FOLLOWS_NS
    wanted = asked.sampled(then_ns) - measured.sampled(then_ns)  # which way it had to go, and how far
    went = angle - measured.sampled(then_ns)
    rows = _driving(record, times, part_ns) & (np.abs(wanted) >= WANTED_DEG) & (np.abs(went) >= WENT_DEG)
    against = rows & (wanted * went < 0.0)
    if against.sum() < ENOUGH or against.sum() < MOSTLY * rows.sum():
        return
    first = int(np.flatnonzero(against)[0])
    text = (
        f"the steering turns the other way than asked: STEER_REQUEST {asked.sampled(then_ns)[first]:.1f} deg, and ANGLE"
        f" goes from {angle[first] - went[first]:.1f} to {angle[first]:.1f} deg; so {against.sum() / rows.sum():.0%} of"
        " the time"
    )
    yield _problem(record, "steering-sign", text, int(times[first]), 0x513, 0x523)


def _wrong_axle(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    """Yield that torque was asked of an axle that has none to give."""
    for (can_id, asked_of, most_of), (_, others_asked, others_most) in (_AXLES, _AXLES[::-1]):
        asked, most = record.series(asked_of), record.series(most_of)
        if not len(asked) or not len(most) or not len(record.series(others_most)):
            continue
        times = asked.t_ns
        rows = _driving(record, times, part_ns) & (asked.values > 0.0) & (most.sampled(times) == 0.0)
        rows &= record.series(others_most).sampled(times) > 0.0
        if rows.sum() < ENOUGH:
            continue
        first, lost = int(np.flatnonzero(rows)[0]), float(asked.values[rows].sum())
        share = lost / (lost + float(record.series(others_asked).sampled(times)[rows].sum()))
        half = ", as if the stack halved it between two axles" if 0.4 < share < 0.6 else ""
        text = (
            f"{share:.0%} of the torque is requested from an axle that cannot give any ({asked_of.name}"
            f" {asked.values[first]:.1f} Nm, {most_of.name} 0){half}"
        )
        yield _problem(record, "axle", text, int(times[first]), can_id)


def _never_running(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    said = record.series(sig.MISSION_STATUS)
    for span in record.series(sig.AS_STATE).spans.of(sig.DRIVING):
        begin_ns, end_ns = int(max(span.begin_ns, part_ns[0])), int(min(span.end_ns, part_ns[1]))
        heard = said.between(begin_ns, end_ns)
        if end_ns - begin_ns < SAYS_NS or len(heard) < ENOUGH:
            continue
        if np.isin(heard.values, (MissionStatus.RUNNING, MissionStatus.FINISHED)).any():
            continue
        words = sig.label(sig.MISSION_STATUS, float(heard.values[-1]))
        text = f"MISSION_STATUS never becomes RUNNING in AS_DRIVING: it stays {words}"
        yield _problem(record, "never-running", text, begin_ns, 0x510)
        return


def _torque_with_brake(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    """Yield torque asked for beside the brake, as the VCU receives the two one after another, frame by frame."""
    torques, brakes = ([*map(record.series, pair)] for pair in (_TORQUES, _BRAKES))
    times = np.unique(np.concatenate([series.t_ns for series in (*torques, *brakes)]))
    if not len(times):
        return
    both = _most(torques, times) * _most(brakes, times) > 0.0
    both &= _driving(record, times, part_ns)
    begins = np.flatnonzero(both & ~np.append(False, both[:-1]))
    ends = np.flatnonzero(~both & np.append(False, both[:-1]))
    ends = np.append(ends, len(times) - 1)[: len(begins)]
    lasted_ns = times[ends] - times[begins]
    for kind, which in (("one-call", lasted_ns < PERIOD_NS - MS), ("torque-brake", lasted_ns >= TOGETHER_NS)):
        rows = np.flatnonzero(which)
        if not len(rows):
            continue
        first = int(times[begins[rows[0]]])
        often = "once" if len(rows) == 1 else f"{len(rows)} times"
        if kind == "one-call":
            text = (
                f"torque and brake change in one call, {often}: the VCU receives 0x511 and 0x512 before 0x514, and has"
                f" both for up to {lasted_ns[rows].max() / MS:.1f} ms; whether it judges each frame is"
                " published nowhere"
            )
        else:
            text = f"torque and brake are asked for together, {often}, for up to {lasted_ns[rows].max() / MS:.0f} ms"
        yield _problem(record, kind, text, first, 0x511, 0x512, 0x514)


def _most(of: list[Series], times: Ints) -> np.ndarray:
    """The greater of two signals at each of these times, 0 before the first frame."""
    found = [np.where(times >= (each.t_ns[0] if len(each) else times[-1] + 1), each.sampled(times), 0.0) for each in of]
    return np.maximum(*found)
