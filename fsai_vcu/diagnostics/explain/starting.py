"""Why the car does not start, in a log or at one moment: the conditions from power-up to AS_DRIVING as two tables.

`TO_READY` are the conditions of AS_OFF -> AS_READY (and of leaving AS_INIT), `TO_DRIVING` those of AS_READY ->
AS_DRIVING. A condition that cannot be met before another one is, is named as what follows from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import not_
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import CAUSES, FAULT_BITS
from fsai_vcu.diagnostics.explain.endings import idle, restarted, switched
from fsai_vcu.diagnostics.explain.evidence import GONE_NS, frozen_words
from fsai_vcu.diagnostics.explain.incident import (
    Candidate,
    ChainLink,
    Incident,
    IncidentKind,
    Sureness,
    candidate,
    shown,
)
from fsai_vcu.diagnostics.explain.record import Record, Span, ms
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import OFF_LIKE, BrakeStatus, Direction, EbsState, EbsStatus, MissionStatus, TsState
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, READY_STEER_DEG, READY_WAIT_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S

PATIENCE_NS: Final = 5 * S  # shorter waits in AS_INIT and AS_OFF are a car that comes up
NO_GO_NS: Final = READY_WAIT_NS + 1 * S
ANSWER_NS: Final = 200 * MS  # from Go to AS_DRIVING
RECENT_NS: Final = 500 * MS

Unmet = Callable[[Record, int], "ChainLink | None"]


@dataclass(frozen=True, slots=True)
class StartCondition:
    """One condition. `unmet` gives the evidence while it does not hold. `after`: what has to be met before it."""

    slug: str
    unmet: Unmet
    after: tuple[str, ...] = ()
    hint: bool = False  # no condition of the interface's table, but it goes with a car that does not start


def _is(signal: Signal, wanted: Callable[[float], bool]) -> Unmet:
    """The condition that a signal (where the log has it) has a wanted value."""

    def unmet(record: Record, t_ns: int) -> ChainLink | None:
        span = record.span_at(signal, t_ns)
        if span is None or wanted(span.value):
            return None
        return signal.step(span.begin_ns, f"{signal.name} is {label(signal, span.value)}")

    return unmet


def _no_ai_data(record: Record, t_ns: int) -> ChainLink | None:
    last_ns = max(int(record.newest_ns(can_id, t_ns)) for can_id in AI_IDS)
    if last_ns < 0:
        return ChainLink(record.begin_ns, "no 0x510 to 0x514 up to then")
    if t_ns - last_ns < RECENT_NS:
        return None
    return ChainLink(last_ns, f"the last frame of the AI computer, {ms(t_ns - last_ns)} before")


def _frozen(record: Record, t_ns: int) -> ChainLink | None:
    for span in record.frozen:
        if span.begin_ns <= t_ns <= span.end_ns:
            return sig.HANDSHAKE.step(span.begin_ns, frozen_words(record, span))
    return None


def _incomplete(record: Record, t_ns: int) -> ChainLink | None:
    missing = [i for i in AI_IDS if t_ns - record.newest_ns(i, t_ns) >= RECENT_NS]
    if not missing or len(missing) == len(AI_IDS):
        return None
    words = f"{', '.join(f'0x{i:03X}' for i in missing)} {'does' if len(missing) == 1 else 'do'} not come"
    if any(i in record.wrong_length for i in missing):
        words += ", or with the wrong length"
    return ChainLink(max(int(record.newest_ns(missing[0], t_ns)), record.begin_ns), words, missing[0])


def _ebs(record: Record, t_ns: int) -> ChainLink | None:
    if len(record.series(sig.EBS_STATE)):
        return _is(sig.EBS_STATE, lambda value: value == EbsState.EBS_ARMED)(record, t_ns)
    # 0 is what the official simulator always sends: it says nothing
    return _is(sig.STATUS_EBS, lambda value: value in (0, EbsStatus.ARMED))(record, t_ns)


def _status(wrong: MissionStatus) -> Unmet:
    return _is(sig.MISSION_STATUS, lambda value: value != wrong)


def _power_cycle(record: Record, t_ns: int) -> ChainLink | None:
    ends = (sig.EMERGENCY,) if record.revision.name == "2021" else (sig.EMERGENCY, sig.FINISHED)
    if record.like_official_simulator:
        return None  # ASMS alone resets it
    run = record.series(sig.AS_STATE).last(t_ns, *ends)
    if run is None or any(run.end_ns <= g.begin_ns <= t_ns for g in record.gaps(sig.STATUS, GONE_NS)):
        return None
    words = f"the last run ended in {label(sig.AS_STATE, run.value)}, and 0x520 has not been away since"
    return sig.AS_STATE.step(run.end_ns, words)


def _fault(record: Record, t_ns: int) -> ChainLink | None:
    span = record.span_at(sig.FAULT_STATUS, t_ns)
    if span is None or not span.value:
        return None
    names = ", ".join(signal.name for signal in sig.FAULTS if record.at(signal, t_ns))
    return sig.FAULT_STATUS.step(span.begin_ns, f"FAULT_STATUS is 1{': ' + names if names else ''}")


_LINK = ("no_ai_data", "ai_data_incomplete")

TO_READY: Final[tuple[StartCondition, ...]] = (
    StartCondition("status_frozen", _frozen),
    StartCondition("no_ai_data", _no_ai_data),
    StartCondition("ai_data_incomplete", _incomplete),
    StartCondition("power_cycle", _power_cycle),
    StartCondition("asms", _is(sig.AS_SWITCH, bool)),
    StartCondition("tsms", _is(sig.TS_SWITCH, bool)),
    StartCondition("shutting_down", _is(sig.SHUTDOWN_REQUEST, not_), after=("tsms",)),
    StartCondition("fault", _fault, after=_LINK),
    StartCondition("link_lost", _is(sig.COMMS_LOST, not_), after=_LINK),
    StartCondition("estop_latched", _is(sig.ESTOP, not_), after=("no_ai_data",)),
    StartCondition("no_mission", _is(sig.AMI, bool)),
    StartCondition(
        "status_not_selected", _status(MissionStatus.NOT_SELECTED), after=("no_ai_data", "no_mission", "estop_latched")
    ),
    StartCondition("status_running", _status(MissionStatus.RUNNING), after=("no_ai_data",)),
    StartCondition("status_finished", _status(MissionStatus.FINISHED), after=("no_ai_data",)),
    StartCondition(
        "ts_not_running",
        _is(sig.TS_STATE, lambda value: value == TsState.TS_RUNNING),
        after=(*_LINK, "tsms", "power_cycle", "fault", "shutting_down", "link_lost"),
    ),
    StartCondition(
        "ebs_not_armed",
        _ebs,
        after=(*_LINK, "asms", "tsms", "power_cycle", "fault", "shutting_down", "link_lost", "ts_not_running"),
    ),
)


def _too_early(record: Record, t_ns: int) -> ChainLink | None:
    span = record.span_at(sig.AS_STATE, t_ns)
    if span is None or span.before is None or t_ns - span.begin_ns >= READY_WAIT_NS:
        return None
    words = f"Go {ms(t_ns - span.begin_ns)} after AS_READY began: 5 s have to pass"
    return sig.AS_STATE.step(span.begin_ns, words)


def _ready_not_selected(record: Record, t_ns: int) -> ChainLink | None:
    if not record.like_official_simulator:
        return None
    return _is(sig.MISSION_STATUS, lambda value: value == MissionStatus.SELECTED)(record, t_ns)


TO_DRIVING: Final[tuple[StartCondition, ...]] = (
    StartCondition("status_frozen", _frozen),
    StartCondition("go_too_early", _too_early),
    StartCondition("torque_requested", lambda *at: _is(sig.TORQUE_F, not_)(*at) or _is(sig.TORQUE_R, not_)(*at)),
    StartCondition("steering_requested", _is(sig.STEER, not_)),
    StartCondition("steering_turned", _is(sig.ANGLE, lambda value: abs(value) < READY_STEER_DEG)),
    StartCondition("direction_not_neutral", _is(sig.DIRECTION, lambda value: value == Direction.NEUTRAL)),
    StartCondition("ready_not_selected", _ready_not_selected),
    StartCondition("tsms", _is(sig.TS_SWITCH, bool)),
    StartCondition("link_lost", _is(sig.COMMS_LOST, not_)),
    StartCondition("no_ai_data", _no_ai_data),
    StartCondition("steering_inactive", _is(sig.STEERING_STATUS, bool), hint=True),
    StartCondition("brakes_not_ready", _is(sig.STATUS_BRK, lambda value: value in (0, BrakeStatus.READY)), hint=True),
)


def unmet(conditions: tuple[StartCondition, ...], record: Record, t_ns: int) -> list[Candidate]:
    """What does not hold at `t_ns`: what must be put right first, then what follows from it."""
    steps = {c.slug: (c, step) for c in conditions if (step := c.unmet(record, t_ns)) is not None}
    named = (FAULT_BITS[signal.name] for signal in sig.FAULTS if signal != sig.COMMS_LOST and record.at(signal, t_ns))
    fault = next(named, "fault")  # the car's own name for it says what to do
    found = [
        candidate(
            fault if slug == "fault" else slug,
            Sureness.FITS if c.hint or not steps.keys().isdisjoint(c.after) else Sureness.SHOWN,
            step,
        )
        for slug, (c, step) in steps.items()
    ]
    return sorted(found, key=lambda one: -one.sureness)


# ---------------------------------------------------------------- refusals


def refusals(record: Record) -> Iterator[Incident]:
    """Every time that the car was to start and did not."""
    yield from _never_ready(record)
    for span in record.series(sig.AS_STATE).spans.of(sig.READY):
        incident = _refused_go(record, span)
        if incident is None and span.after not in (sig.DRIVING, sig.EMERGENCY):
            incident = _waited_in_vain(record, span)
        if incident is not None:
            yield incident


def _never_ready(record: Record) -> Iterator[Incident]:
    for begin_ns, end_ns, after_run in _off_stays(record):
        if end_ns - begin_ns < PATIENCE_NS:
            continue
        if after_run and not any(s.value for s in record.changes(sig.AS_SWITCH, begin_ns, end_ns)):
            continue  # the run is over, and the switches go off
        asms, wheel = (each.between(begin_ns, end_ns) for each in (record.series(sig.AS_SWITCH), record.fastest_wheel))
        if not asms.values.any() and (wheel.values >= STANDING_RPM).any():
            continue  # driven by hand
        at_ns = _last_both_on(record, begin_ns, end_ns)
        met = ChainLink(at_ns, "ASMS, TSMS, EBS, mission and MISSION_STATUS SELECTED are all there", sig.STATUS)
        candidates = unmet(TO_READY, record, at_ns) or [candidate("start_unknown", Sureness.POSSIBLE, met)]
        state = label(sig.AS_STATE, record.at(sig.AS_STATE, at_ns))
        what = f"the car stays in {state} for {ms(end_ns - begin_ns)} and never gets to AS_READY"
        yield Incident(IncidentKind.REFUSAL, at_ns, what, tuple(candidates), lasted=(begin_ns, end_ns))


def _off_stays(record: Record) -> Iterator[tuple[int, int, bool]]:
    """(begin, end, whether a run was before) of each stay in AS_INIT and AS_OFF that lasted as long as 0x520 came."""
    spans = record.series(sig.AS_STATE).spans_within(GONE_NS)
    off = np.isin(spans.values, tuple(OFF_LIKE))
    begins = np.flatnonzero(off & (spans.apart[:-1] | ~np.append(False, off[:-1])))
    ends = np.flatnonzero(off & spans.apart[1:])
    firsts = begins[np.searchsorted(begins, ends, side="right") - 1]
    columns = spans.begin_ns[firsts], spans.end_ns[ends], ~spans.apart[firsts]
    return zip(*(column.tolist() for column in columns), strict=True)


def _last_both_on(record: Record, begin_ns: int, end_ns: int) -> int:
    """The last moment with ASMS and TSMS on: what was missing then was missing to start. Else the end."""
    asms, tsms = (record.series(s).between(begin_ns, end_ns) for s in (sig.AS_SWITCH, sig.TS_SWITCH))
    both = asms.t_ns[(asms.values != 0) & (tsms.values != 0)]
    return int(both[-1]) if len(both) else end_ns


def _refused_go(record: Record, span: Span) -> Incident | None:
    """Go was given, and the car stayed in AS_READY."""
    given_up = span.after not in (sig.DRIVING, None)
    refused = [
        s.begin_ns
        for s in record.changes(sig.GO, span.begin_ns, span.end_ns)
        if s.value and span.end_ns - s.begin_ns > (0 if given_up else ANSWER_NS)
    ]
    if not refused:
        return None
    found: dict[str, Candidate] = {}
    pressed = [sig.GO.step(edge_ns, "GO_SIGNAL 0 → 1, and AS_STATE stays AS_READY") for edge_ns in refused]
    for press in pressed:
        for one in unmet(TO_DRIVING, record, press.t_ns):
            found.setdefault(one.slug, candidate(one.slug, one.sureness, *one.steps, press))
    if not any(one.sureness >= Sureness.SHOWN for one in found.values()):
        found["start_unknown"] = candidate("start_unknown", Sureness.POSSIBLE, pressed[0])
    times = f" ({len(refused)} times)" if len(refused) > 1 else ""
    later = ", later it did" if span.after == sig.DRIVING else ""
    order = sorted(found.values(), key=lambda one: -one.sureness)
    what = f"Go was given{times} and the car did not start{later}"
    return Incident(IncidentKind.REFUSAL, refused[0], what, tuple(order), lasted=(refused[0], refused[-1]))


def _waited_in_vain(record: Record, span: Span) -> Incident | None:
    """AS_READY ended, or the log did, without a Go that counts."""
    waited_ns = span.end_ns - span.begin_ns
    state = label(sig.AS_STATE, span.after)
    found: list[Candidate] = []
    if span.after in OFF_LIKE:
        found += switched(record, "given_up", sig.AS_SWITCH, span.end_ns, "AS_SWITCH_STATUS 1 → 0", within_ns=waited_ns)
        silences = [gap for gap in record.gaps(sig.STATUS, ANSWER_NS) if gap.end_ns == span.end_ns]
        found += [restarted(gap, f", then {state}") for gap in silences]
    if waited_ns >= NO_GO_NS and not found:
        end_ns = span.end_ns - 1 if span.after is not None else span.end_ns
        go = record.span_at(sig.GO, end_ns)
        found += [one for one in unmet(TO_DRIVING, record, end_ns) if one.slug != "go_too_early"]
        if go is not None and go.value and go.begin_ns <= span.begin_ns:
            found.append(shown("go_held", sig.GO.step(go.begin_ns, "GO_SIGNAL is 1 since before AS_READY began")))
        elif go is not None and not go.value:
            words = f"GO_SIGNAL stays 0 for the {ms(waited_ns)} of AS_READY"
            found.append(shown("no_go", sig.GO.step(span.begin_ns, words)))
    elif span.after is None and not found:
        return None  # the log ends while the 5 s run
    if not found:
        step = sig.AS_STATE.step(span.end_ns, f"AS_STATE AS_READY → {state}")
        found.append(candidate("start_unknown", Sureness.POSSIBLE, step))
    ended = "the log ends" if span.after is None else f"{state} follows"
    order = sorted(found, key=lambda one: -one.sureness)
    what = f"AS_READY for {ms(waited_ns)} without a start, then {ended}"
    return Incident(IncidentKind.REFUSAL, span.end_ns, what, tuple(order), lasted=span[:2])


# ---------------------------------------------------------------- at one moment


@dataclass(frozen=True, slots=True)
class Obstacle:
    """One thing that stands between now and driving. `follows`: it goes by itself once the ones above it are gone."""

    words: str
    evidence: str = ""
    remedy: str = ""
    follows: bool = False

    @property
    def sentence(self) -> str:
        """The words, and the evidence where they do not name it already."""
        named = self.evidence in self.words or self.evidence.replace(" is ", " ") in self.words
        return self.words if named else f"{self.words} ({self.evidence})"


def why_not_driving(record: Record, now_ns: int, emergency: Incident | None) -> Iterator[Obstacle]:
    """What stands between now and driving, what must be put right first in front. In AS_DRIVING only that it stands.

    emergency: the newest entry into EMERGENCY_BRAKE with its causes, where that was seen.
    """
    span = record.span_at(sig.AS_STATE, now_ns)
    if span is None and record.wrong_length.get(sig.STATUS):
        yield Obstacle(f"{BY_ID[sig.STATUS]} has the wrong length: it counts as missing")
        return
    if span is None and not record.lacks(sig.STATUS):
        yield Obstacle("the database has no AS_STATE in 0x520", remedy="use the car's own (no --dbc), or --revision")
        return
    if span is None:
        remedy = "LVMS on; then check the CAN plug, the bit rate and the interface (ip -details link show)"
        yield Obstacle("no 0x520 from the car yet", remedy=remedy)
        return
    silent_ns = now_ns - int(record.times(sig.STATUS)[-1])
    state = label(sig.AS_STATE, span.value)
    if silent_ns >= COMMS_LOST_NS:
        remedy = "switched off, or unplugged: LVMS, CAN plug" if silent_ns >= S else CAUSES["vcu_silent"].remedy
        yield Obstacle(
            f"0x520 is missing for {ms(silent_ns)}: the car is silent", f"its last AS state was {state}", remedy
        )
    elif span.value == sig.EMERGENCY:
        yield from _braked(emergency)
    elif span.value == sig.FINISHED:
        yield Obstacle("the mission is finished (AS_FINISHED)", remedy="ASMS off ends the run")
    elif span.value == sig.READY:
        yield from _in_ready(record, span, now_ns)
    elif span.value == sig.DRIVING:
        if stood := idle(record, span.begin_ns, now_ns):
            yield _obstacle(shown("not_driven", stood))
    else:
        found = [_obstacle(one) for one in unmet(TO_READY, record, now_ns)]
        if span.value not in OFF_LIKE:
            yield Obstacle(f"AS_STATE is {state}")
        elif not found:
            yield Obstacle(f"{state}: all that the bus shows is met; the VCU goes to AS_READY by itself")
        yield from found


def _braked(emergency: Incident | None) -> Iterator[Obstacle]:
    if emergency is None:
        words = "the car is in EMERGENCY_BRAKE, and was before this began to listen"
        yield Obstacle(words, remedy=CAUSES["before_the_log"].remedy)
        return
    for one in emergency.candidates[:2]:
        evidence = "" if one.sureness >= Sureness.SHOWN else one.sureness.words
        yield Obstacle(one.cause.words, evidence, one.cause.remedy, follows=one.sureness < Sureness.FITS)


def _in_ready(record: Record, span: Span, now_ns: int) -> Iterator[Obstacle]:
    yield from (_obstacle(one) for one in unmet(TO_DRIVING, record, now_ns) if one.slug != "go_too_early")
    left_ns = READY_WAIT_NS - (now_ns - span.begin_ns)
    if left_ns > 0 and span.before is not None:
        yield Obstacle(f"waiting in AS_READY: {left_ns / S:.1f} s of {READY_WAIT_NS // S} s left")
    if record.at(sig.GO, now_ns):
        yield Obstacle(CAUSES["go_held"].words, "GO_SIGNAL is 1", CAUSES["go_held"].remedy)
    else:
        yield Obstacle("waiting for Go", "GO_SIGNAL is 0", CAUSES["no_go"].remedy, follows=left_ns > 0)


def _obstacle(one: Candidate) -> Obstacle:
    evidence = "; ".join(step.words for step in one.steps[-2:])
    return Obstacle(one.cause.words, evidence, one.cause.remedy, follows=one.sureness < Sureness.SHOWN)
