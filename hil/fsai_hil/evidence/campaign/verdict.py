"""The judgement of one run: how it ended, how fast, and whether that is worse than the safety rules allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.evidence.campaign.cases import Case, Since
from fsai_hil.evidence.campaign.endings import ANY, NOTHING, End, Must
from fsai_hil.evidence.campaign.observation import Observation
from fsai_hil.rules.bus_view import IDLE
from fsai_hil.rules.numbers import LAUNCH_NS, MS, ODD_LOST_NS
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.values import Value

SUPERVISED_MS: Final = LAUNCH_NS // MS  # safety rules: supervision starts 3 s into AS_DRIVING
OVER_MS: Final = 1000  # a mission that is over so soon after the fault may be over before any reaction is due


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


def judge(
    case: Case, seen: Observation, fault_ns: int | None, violations: Sequence[str], crashes: Sequence[str] = ()
) -> CaseVerdict:
    """Judge a run in which the fault began at `fault_ns` (None: its moment never came).

    `violations` are the checker's; `crashes` are processes of this software that ended by an exception: no fault may do
    that to them, whatever the car makes of the silence. What a fault kills on purpose raises nothing.
    """
    wrong = [*(f"on the wire: {violation}" for violation in violations), *crashes]
    if seen.early_ns is not None:
        wrong.append(f"the car moved at {seen.early_ns / 1e9:.2f} s, before it may")
    if fault_ns is None:
        end = _end(seen, 0, seen.mission_over_ns)
        wrong += [end.value] if end is End.UNSAFE else []
        return CaseVerdict(end, "the moment never came", None, None, False, tuple(wrong))
    must = case.kind.must.of_drawn(case.params) if _supervised(case) else ANY
    over_ns = seen.mission_over_ns
    if not must.own_word and over_ns is not None and over_ns > fault_ns:
        over_ns = None  # that is what the fault makes it report
    end, allowed = _end(seen, fault_ns, over_ns), must.ends
    if end is End.ON and seen.finished_ns is not None and End.ON not in allowed and End.STOP in allowed:
        end = End.STOP  # the mission ended while it was stopping anyway
    reaction, reaction_ns, safe_ns = _times(seen, end, must, fault_ns)
    # A frame of an intruder may end the drive at the very instant of the fault.
    applies = _supervised(case) and (case.kind.from_start or seen.state_at(fault_ns - 1) is AsState.AS_DRIVING)
    if over_ns is not None:
        patience_ms = 0 if End.ON in allowed else OVER_MS if must.safe_ms is None else must.safe_ms
        applies = applies and over_ns > fault_ns + patience_ms * MS
    if not applies:
        wrong += [end.value] if end is End.UNSAFE else []
    else:
        wrong += _wrong(seen, end, must, fault_ns, safe_ns)
    onset_ns: int | None = fault_ns
    if must.shows_late:
        onset_ns = None
        for from_ns, to_ns in seen.certain_ns.items() if reaction_ns is not None else ():
            if fault_ns <= from_ns <= reaction_ns <= to_ns + ODD_LOST_NS:
                onset_ns = from_ns
    return CaseVerdict(
        end,
        reaction,
        _ms(reaction_ns, onset_ns),
        _ms(safe_ns, onset_ns),
        applies,
        tuple(wrong),
        _ms(onset_ns, fault_ns),
        _ms(seen.braking_ns, onset_ns),
    )


def _wrong(seen: Observation, end: End, must: Must, fault_ns: int, safe_ns: int | None) -> list[str]:
    """Say what the row of the catalogue demands and the run's end is not."""
    due_ns = seen.ended_ns if must.safe_ms is None else fault_ns + must.safe_ms * MS
    parked_ns = seen.entered(AsState.AS_FINISHED, fault_ns)
    parked = must.safe_ms is not None and parked_ns is not None and parked_ns <= due_ns  # no emergency was due any more
    if end not in must.ends and not (parked and end is End.STOP):
        return [f"{end.value}, where the rules demand: {must.words}"]
    braked = must.brake_ms is not None and end is End.STOP
    for what, at_ns, due, most_ms in (
        ("the service brake", seen.braking_ns, braked, must.brake_ms),
        ("a safe state", safe_ns, end not in (End.ON, End.HELD, End.NOT_STARTED), must.safe_ms),
        ("ESTOP_REQUEST", seen.estop_ns, must.asks, must.safe_ms),
    ):
        latest_ns = seen.ended_ns if most_ms is None else fault_ns + most_ms * MS
        if due and (at_ns is None or at_ns > latest_ns):
            came = "never came" if at_ns is None else f"came {_ms(at_ns, fault_ns):.0f} ms after the fault"
            return [f"{what} {came}" + (f", allowed are {most_ms:.0f} ms" if most_ms is not None else "")]
    if replace(must, note="") == NOTHING and seen.left_course:
        return ["the car left the course, where the rules demand that nothing changes"]
    return []


def _times(seen: Observation, end: End, must: Must, fault_ns: int) -> tuple[str, int | None, int | None]:
    """Return what was seen in words, when it was first on the bus, and when the car was safe (None: it drives on)."""
    emergency_ns = seen.entered(AsState.EMERGENCY_BRAKE, fault_ns)
    rest_ns = None if seen.rest_ns is None else max(seen.rest_ns, fault_ns)
    match end:
        case End.ESTOP | End.SELF:
            first_ns = min((t_ns for t_ns in (emergency_ns, rest_ns) if t_ns is not None), default=None)
            return end.value, seen.estop_ns if end is End.ESTOP else emergency_ns, first_ns
        case End.STOP:
            return end.value, seen.braking_ns, rest_ns
        case End.HELD | End.OFF:
            return end.value, seen.idle_ns, rest_ns
        case End.ON if must.pauses:
            return "torque 0, then drives on", seen.pause_ns, seen.pause_ns
    return end.value, None, None


def _end(seen: Observation, fault_ns: int, over_ns: int | None) -> End:
    """Return how the run ended; `over_ns`: when the controller reported by itself that the mission is over."""
    last = seen.states[-1][1]
    over, finished = over_ns is not None, seen.finished_ns is not None
    idle = seen.idle_ns is not None and seen.ended_ns - seen.idle_ns > 3_000 * MS
    emergency_ns = seen.entered(AsState.EMERGENCY_BRAKE, fault_ns)
    by_us = _by(seen.estop_ns, emergency_ns)
    driving = last is AsState.AS_DRIVING
    ends = (
        (_unsafe(seen, last, idle, over), End.UNSAFE),
        (by_us and _by(over_ns, seen.estop_ns), End.ON),  # the mission ends so
        (by_us, End.ESTOP),
        (emergency_ns is not None, End.SELF),
        (finished and _by(over_ns, seen.finished_ns), End.ON),
        (finished, End.STOP),
        (driving and over and seen.estop_ns is None, End.ON),  # it stands, the mission done, and has yet to report it
        (driving and seen.had_torque and idle and seen.rest_ns is not None, End.HELD),
        (driving, End.ON),
        (last in IDLE and any(state is AsState.AS_DRIVING for _, state in seen.states), End.OFF),
        (last in IDLE, End.NOT_STARTED),
        (over, End.ON),
        (last is AsState.AS_FINISHED, End.STOP),
    )
    # Else it has been in EMERGENCY_BRAKE since before the fault.
    return next((end for holds, end in ends if holds), End.SELF)


def _by(t_ns: int | None, other_ns: int | None) -> bool:
    """Return whether both happened, the first no later than the other."""
    return t_ns is not None and other_ns is not None and t_ns <= other_ns


def _unsafe(seen: Observation, last: AsState, idle: bool, over: bool) -> bool:
    """A car that moves where it must stand; or a run that has not ended after the longest time, and is not driven.

    A car in AS_DRIVING that still drives by command then is slow, or lost its way: no rule of the bridge forbids that.
    """
    moves = seen.rest_ns is None
    if last is not AsState.AS_DRIVING:
        return moves and (seen.ran_out or last is not AsState.EMERGENCY_BRAKE)
    return seen.ran_out and ((moves and idle) or over)


def _ms(t_ns: int | None, onset_ns: int | None) -> float | None:
    return None if t_ns is None or onset_ns is None else max(0.0, round((t_ns - onset_ns) / MS, 1))


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
