"""The judgement of one run: what happened, how fast, and whether it is worse than the safety rules allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.campaign.cases import Case, Since
from fsai_hil.evidence.campaign.demands import ANY, IMPLAUSIBLE_LOST_MS, NOTHING, Demand, End, Onset
from fsai_hil.evidence.campaign.observation import (
    Observation,
    Streak,
    count_streaks,
    steering_streaks,
    wheel_streaks,
)
from fsai_hil.rules.bus_view import IDLE
from fsai_hil.rules.numbers import LAUNCH_NS, MS
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.values import Value

SUPERVISED_MS: Final = LAUNCH_NS // MS  # safety rules: supervision starts 3 s into AS_DRIVING
REACTION: Final[Mapping[End, str]] = {
    End.ESTOP: "estop_ns",
    End.SELF: "emergency_ns",
    End.STOP: "braking_ns",
    End.HELD: "torque_off_ns",
    End.OFF: "torque_off_ns",
}
"""The instant at which what ended the run so was first on the bus."""
STREAKS: Final = {Onset.STEERING: steering_streaks, Onset.COUNTS: count_streaks, Onset.WHEEL: wheel_streaks}


class CaseVerdict(Value, frozen=True):
    """`faults` is empty when the run is as the rules demand. Times in ms from the onset of its demand: the fault, or a
    value that is certainly implausible; `onset_ms` from the fault; None: there was none.
    """

    end: End
    reaction: str  # what was seen, in words
    reaction_ms: float | None
    safe_ms: float | None
    applies: bool  # False: the mission was over, or the car not driving, before anything could be demanded
    faults: tuple[str, ...]
    onset_ms: float | None = None
    brake_ms: float | None = None  # since when the brake that ended the run was on

    @property
    def ok(self) -> bool:
        return not self.faults


def _supervised(case: Case) -> bool:
    """Reactions are of AS_DRIVING, once its first 3 s are over. What is there from power-up on is judged by it all."""
    if case.kind.from_start:
        return case.since is Since.START
    return case.since is Since.DRIVING and case.after_ms >= SUPERVISED_MS


class _Seen(Value, frozen=True):
    """The instants that matter, from the fault on; None: never."""

    estop_ns: int | None
    emergency_ns: int | None
    finished_ns: int | None
    rest_ns: int | None
    braking_ns: int | None  # since when the brake that ended the run was on
    torque_off_ns: int | None  # since when there has been no torque, to the end


def judge(
    case: Case, seen: Observation, fault_ns: int | None, violations: Sequence[str], crashes: Sequence[str] = ()
) -> CaseVerdict:
    """Judge a run in which the fault began at `fault_ns` (None: its moment never came).

    `crashes` are processes of this software that ended by an exception: no fault may do that to them, whatever the car
    makes of the silence. What a fault kills on purpose raises nothing.
    """
    demand = case.kind.must.demand(case.params) if _supervised(case) else ANY
    wrong = [f"on the wire: {violation}" for violation in violations]
    wrong += crashes
    wrong += _moved_too_early(seen)
    if fault_ns is None:
        end = _end(seen, _since(seen, 0), 0, seen.mission_over_ns)
        wrong += [end.value] if end is End.UNSAFE else []
        return CaseVerdict(end, "the moment never came", None, None, False, tuple(wrong))
    found = _since(seen, fault_ns)
    over_ns = seen.mission_over_ns
    if not demand.own_word and over_ns is not None and over_ns > fault_ns:
        over_ns = None  # that is what the fault makes it report
    end = _end(seen, found, fault_ns, over_ns)
    if end is End.ON and found.finished_ns is not None and End.ON not in demand.ends and End.STOP in demand.ends:
        end = End.STOP  # the mission ended while it was stopping anyway
    parked_ns = seen.entered(AsState.AS_FINISHED, fault_ns - 1)
    allowed = demand.ends
    if parked_ns is not None and demand.estop_ms is not None and parked_ns <= fault_ns + demand.estop_ms * MS:
        allowed = allowed | {End.STOP}  # it stood: the stop was over before the emergency brake was due
    safe_ns = _safe_ns(end, found)
    # A frame of an intruder may end the drive at the very instant of the fault.
    driving = _supervised(case) and (case.kind.from_start or seen.state_at(fault_ns - 1) is AsState.AS_DRIVING)
    applies = driving and not _over(over_ns, demand, fault_ns)
    onset_ns: int | None = fault_ns
    reaction_ns: int | None = getattr(found, REACTION[end]) if end in REACTION else None
    reaction = end.value
    if demand.no_torque_ms is not None and end is End.ON:
        reaction = "torque 0, then drives on"
        reaction_ns = next((cycle.t_ns for cycle in seen.cycles_after(fault_ns) if cycle.torque_nm <= 0.0), None)
        safe_ns = reaction_ns
    if applies:
        if end not in allowed:
            wrong.append(f"{end.value}, where the rules demand: {demand.words}")
        elif demand.onset is Onset.FAULT:
            wrong += _too_late(case, seen, found, demand, end, fault_ns, safe_ns)
        else:
            streaks = STREAKS[demand.onset](seen, CARS[case.revision], fault_ns)
            onset_ns = _onset_ns(streaks, reaction_ns)
            wrong += _implausible_too_long(seen, found, demand, streaks)
    elif end is End.UNSAFE:
        wrong.append(end.value)
    if applies and replace(demand, note="") == NOTHING and seen.left_course:
        wrong.append("the car left the course, where the rules demand that nothing changes")
    return CaseVerdict(
        end,
        reaction,
        _ms(reaction_ns, onset_ns),
        _ms(safe_ns, onset_ns),
        applies,
        tuple(wrong),
        _ms(onset_ns, fault_ns),
        _ms(found.braking_ns, onset_ns),
    )


def _onset_ns(streaks: Sequence[Streak], reaction_ns: int | None) -> int | None:
    """Return where the streak began that the reaction answers; None: it came before anything was sure."""
    if reaction_ns is None:
        return None
    before = [start for start, end in streaks if start <= reaction_ns <= end + IMPLAUSIBLE_LOST_MS * MS]
    return before[-1] if before else None


def _ms(t_ns: int | None, onset_ns: int | None) -> float | None:
    return None if t_ns is None or onset_ns is None else max(0.0, round((t_ns - onset_ns) / MS, 1))


def _since(seen: Observation, fault_ns: int) -> _Seen:
    """Gather what was seen from the fault on."""
    after = seen.cycles_after(fault_ns)
    estop_ns = next((cycle.t_ns for cycle in after if cycle.estop), None)
    emergency_ns = seen.entered(AsState.EMERGENCY_BRAKE, fault_ns - 1)
    finished_ns = next((cycle.t_ns for cycle in after if cycle.finished), None)
    until_ns = min((t_ns for t_ns in (emergency_ns, finished_ns) if t_ns is not None), default=seen.ended_ns)
    until = [cycle for cycle in after if cycle.t_ns <= until_ns]
    braking = takewhile(lambda cycle: cycle.brake_pct > 0.0 or cycle.t_ns >= until_ns, reversed(until))
    idle = takewhile(lambda cycle: cycle.torque_nm <= 0.0, reversed(after))
    rest_ns = seen.resting_since()
    return _Seen(
        estop_ns,
        emergency_ns,
        finished_ns,
        None if rest_ns is None else max(rest_ns, fault_ns),
        min((cycle.t_ns for cycle in braking), default=None),
        min((cycle.t_ns for cycle in idle), default=None),
    )


def _end(seen: Observation, found: _Seen, fault_ns: int, over_ns: int | None) -> End:
    """Return how the run ended; `over_ns`: when the controller reported by itself that the mission is over."""
    last = seen.states[-1][1]
    over = over_ns is not None
    idle = found.torque_off_ns is not None and seen.ended_ns - found.torque_off_ns > 3_000 * MS
    emergency, finished = found.emergency_ns is not None, found.finished_ns is not None
    by_us = emergency and _by(found.estop_ns, found.emergency_ns)
    driving = last is AsState.AS_DRIVING
    had_torque = any(cycle.torque_nm > 0.0 for cycle in seen.cycles if cycle.t_ns <= fault_ns)
    had_driven = any(state is AsState.AS_DRIVING for _, state in seen.states)
    ends = (
        (_unsafe(seen, last, idle, over_ns), End.UNSAFE),
        (by_us and _by(over_ns, found.estop_ns), End.ON),  # the mission ends so
        (by_us, End.ESTOP),
        (emergency, End.SELF),
        (finished and _by(over_ns, found.finished_ns), End.ON),
        (finished, End.STOP),
        (driving and over and found.estop_ns is None, End.ON),  # it stands, the mission done, and has yet to report it
        (driving and had_torque and idle and found.rest_ns is not None, End.HELD),
        (driving, End.ON),
        (last in IDLE and had_driven, End.OFF),
        (last in IDLE, End.NOT_STARTED),
        (over, End.ON),
        (last is AsState.AS_FINISHED, End.STOP),
    )
    # Else it has been in EMERGENCY_BRAKE since before the fault.
    return next((end for holds, end in ends if holds), End.SELF)


def _by(t_ns: int | None, other_ns: int | None) -> bool:
    """Return whether both happened, the first no later than the other."""
    return t_ns is not None and other_ns is not None and t_ns <= other_ns


def _unsafe(seen: Observation, last: AsState, idle: bool, over_ns: int | None) -> bool:
    """A car that moves where it must stand; or a run that has not ended after the longest time, and is not driven.

    A car in AS_DRIVING that still drives by command then is slow, or lost its way: no rule of the bridge forbids that.
    """
    moves = bool(seen.moving) and seen.moving[-1][1]
    if last is not AsState.AS_DRIVING:
        return moves and (seen.ran_out or last is not AsState.EMERGENCY_BRAKE)
    return seen.ran_out and ((moves and idle) or over_ns is not None)


def _safe_ns(end: End, found: _Seen) -> int | None:
    if end in (End.ESTOP, End.SELF):
        return min((t_ns for t_ns in (found.emergency_ns, found.rest_ns) if t_ns is not None), default=None)
    return found.rest_ns if end in (End.STOP, End.OFF, End.HELD) else None


def _over(over_ns: int | None, demand: Demand, fault_ns: int) -> bool:
    """The mission ended by itself before a reaction could be demanded."""
    if over_ns is None:
        return False
    limits = (demand.no_torque_ms, demand.brake_ms, demand.estop_ms)
    allowed_ms = max((limit for limit in limits if limit is not None), default=0.0)
    return over_ns <= fault_ns + round(allowed_ms * MS) and (
        End.ON not in demand.ends or demand.no_torque_ms is not None or over_ns <= fault_ns
    )


def _too_late(
    case: Case, seen: Observation, found: _Seen, demand: Demand, end: End, fault_ns: int, safe_ns: int | None
) -> list[str]:
    """Say what the demand asks for by a time and did not come by then."""
    wrong = []
    if demand.no_torque_ms is not None:
        from_ns = fault_ns + round(demand.no_torque_ms * MS)
        # Where the run must end, torque stays away for good; else for as long as the fault lasts.
        until_ns = seen.ended_ns
        if End.ON in demand.ends:
            until_ns = fault_ns + case.params.get("duration", 0) * MS
        torque = [c for c in seen.cycles_after(from_ns) if c.torque_nm > 0.0 and c.t_ns <= until_ns]
        if torque:
            wrong.append(
                f"torque {torque[0].torque_nm:.0f} Nm {_ms(torque[0].t_ns, fault_ns):.0f} ms after the fault,"
                f" allowed are {demand.no_torque_ms:.0f} ms"
            )
    for holds, what, most_ms, at_ns in (
        (end is End.STOP, "the service brake", demand.brake_ms, found.braking_ns),
        (end in (End.ESTOP, End.SELF), "ESTOP_REQUEST", demand.estop_ms, found.estop_ns),
        (end not in (End.ON, End.HELD), "a safe state", demand.safe_ms, safe_ns),
    ):
        if not holds or most_ms is None:
            continue
        if at_ns is None:
            wrong.append(f"{what} never came, allowed are {most_ms:.0f} ms")
        elif at_ns > fault_ns + most_ms * MS:
            wrong.append(f"{what} came {_ms(at_ns, fault_ns):.0f} ms after the fault, allowed are {most_ms:.0f} ms")
    return wrong


def _implausible_too_long(seen: Observation, found: _Seen, demand: Demand, streaks: Sequence[Streak]) -> list[str]:
    """Demands of values that are certainly implausible: for so long the car stops, for longer ESTOP_REQUEST follows."""
    wrong = []
    assert demand.brake_ms is not None and demand.estop_ms is not None  # rows of this kind have both
    emergencies = (found.estop_ns, found.emergency_ns)
    for start_ns, end_ns in streaks:
        for what, within_ms, reacted in (
            ("stop", demand.brake_ms, (found.braking_ns, *emergencies)),
            ("ESTOP_REQUEST", demand.estop_ms, emergencies),
        ):
            due_ns = start_ns + round(within_ms * MS)
            if end_ns >= due_ns and not any(t_ns is not None and t_ns <= due_ns for t_ns in reacted):
                lasted_ms = (end_ns - start_ns) / MS
                wrong.append(f"implausible for {lasted_ms:.0f} ms, and no {what} after {within_ms:.0f} ms")
    return wrong[:2]


def _moved_too_early(seen: Observation) -> list[str]:
    """Safety rules: the car stands until it has been in AS_DRIVING for 3 s."""
    began = next((t_ns for t_ns, state in seen.states if state is AsState.AS_DRIVING), None)
    allowed_ns = seen.ended_ns if began is None else began + SUPERVISED_MS * MS
    early = next((t_ns for t_ns, moves in seen.moving if moves and t_ns < allowed_ns), None)
    return [] if early is None else [f"the car moved at {early / 1e9:.2f} s, before it may"]


def as_record(case: Case, verdict: CaseVerdict, extra: Mapping[str, Any]) -> dict[str, Any]:
    """One line of the record."""
    return {
        "index": case.index,
        "full": case.full,
        "fault": case.fault,
        "mission": case.mission.name.lower(),
        "revision": case.revision,
        "world_seed": case.seed,
        "since": case.since.value,
        "after_ms": case.after_ms,
        "params": dict(case.params),
        "verdict": "ok" if verdict.ok else "worse",
        "applies": verdict.applies,
        "end": verdict.end.name,
        "reaction": verdict.reaction,
        "reaction_ms": verdict.reaction_ms,
        "safe_ms": verdict.safe_ms,
        "reasons": list(verdict.faults),
        **extra,
        "replay": case.replay,
    }
