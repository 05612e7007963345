"""Why the car does not start, in a log or at one moment.

The conditions are those of `start_conditions.py`; here is what a log shows of each, and what was missing where the car
was to start and did not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum
from typing import Any, Final

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.supervision.start_conditions import Moment, Obstacle
from fsai_vcu.core.supervision.start_conditions import unmet as conditions_unmet
from fsai_vcu.core.supervision.start_conditions import why_not_driving as bus_not_driving
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
from fsai_vcu.diagnostics.explain.record import Record, Span
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import OFF_LIKE, AsState, MissionStatus
from fsai_vcu.interface.fields import Refuse, fields_of
from fsai_vcu.interface.messages import (
    COMMAND_FIELDS,
    VEHICLE_FIELD_OF,
    AiCommand,
    Faults,
    VcuBrake,
    VcuStatus,
    VcuSteer,
    VehicleState,
)
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, READY_WAIT_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S, ms

PATIENCE_NS: Final = 5 * S  # shorter waits in AS_INIT and AS_OFF are a car that comes up
NO_GO_NS: Final = READY_WAIT_NS + 1 * S
ANSWER_NS: Final = 200 * MS  # from Go to AS_DRIVING
RECENT_NS: Final = 500 * MS


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


def _power_cycle(record: Record, t_ns: int) -> ChainLink | None:
    if record.like_official_simulator:
        return None  # ASMS alone resets it
    run = record.series(sig.AS_STATE).last(t_ns, *record.revision.power_cycle_after)
    if run is None or any(run.end_ns <= g.begin_ns <= t_ns for g in record.gaps(sig.STATUS, GONE_NS)):
        return None
    words = f"the last run ended in {label(sig.AS_STATE, run.value)}, and 0x520 has not been away since"
    return sig.AS_STATE.step(run.end_ns, words)


def _ready_not_selected(record: Record, t_ns: int) -> ChainLink | None:
    span = record.span_at(sig.MISSION_STATUS, t_ns)
    if not record.like_official_simulator or span is None or span.value == MissionStatus.SELECTED:
        return None
    return sig.MISSION_STATUS.step(span.begin_ns, f"MISSION_STATUS is {label(sig.MISSION_STATUS, span.value)}")


_HISTORY: Final[Mapping[str, Callable[[Record, int], ChainLink | None]]] = {
    "status_frozen": _frozen,
    "no_ai_data": _no_ai_data,
    "ai_data_incomplete": _incomplete,
    "power_cycle": _power_cycle,
    "ready_not_selected": _ready_not_selected,
}
"""The conditions that only frames before a moment show."""


def _signals() -> Iterator[tuple[str, Signal]]:
    """The signal of each field of a Moment."""
    declared: dict[Any, str] = {**VEHICLE_FIELD_OF, **dict.fromkeys(COMMAND_FIELDS, "command")}
    for kind, root in declared.items():
        for one in fields_of(kind):
            name = COMMAND_FIELDS[kind][one.name] if root == "command" else one.name
            yield f"{root}.{name}", Signal(kind.dbc_name, one.signal)


_SIGNALS: Final = dict(_signals())


def _heard(record: Record, t_ns: int, kind: Any) -> dict[str, Any] | None:
    """The fields of a message as the newest frames up to `t_ns` have them; None where nothing may be believed."""
    found: dict[str, Any] = {}
    for one in fields_of(kind):
        holds: Any = one.holds
        value = record.at(Signal(kind.dbc_name, one.signal), t_ns)
        if value is None:
            continue
        known = not issubclass(holds, IntEnum) or value in set(holds)
        found[one.name] = holds(value) if known else one.unknown
    return None if not found or Refuse.FRAME in found.values() else found


def moment(record: Record, t_ns: int) -> Moment:
    """What the log shows up to `t_ns`, as a bridge would have it, and the history of it."""
    seen: dict[str, Any] = {}
    kinds: tuple[Any, ...] = (VcuStatus, VcuSteer, VcuBrake)
    for kind in kinds:
        heard = _heard(record, t_ns, kind)
        if heard is None or (kind is VcuBrake and record.like_official_simulator):
            continue
        own = {name: value for name, value in heard.items() if "." not in name}
        if kind is VcuStatus:
            own["faults"] = Faults(**{name.partition(".")[2]: v for name, v in heard.items() if "." in name})
        seen[VEHICLE_FIELD_OF[kind]] = kind(**own)
    said = {
        names[name]: value
        for kind, names in COMMAND_FIELDS.items()
        for name, value in (_heard(record, t_ns, kind) or {}).items()
    }
    unknown = record.at(sig.AS_STATE, t_ns) is not None and "status" not in seen
    status_ns = int(record.newest_ns(sig.STATUS, t_ns))
    silent_ns = t_ns - status_ns if status_ns >= 0 and t_ns - status_ns >= COMMS_LOST_NS else None
    span = record.span_at(sig.AS_STATE, t_ns)
    return Moment(
        VehicleState(**seen, status_known=not unknown),
        AiCommand(**said) if said else None,
        silent_ns,
        t_ns - span.begin_ns if span is not None and span.before is not None else None,
        {slug: link.words for slug, show in _HISTORY.items() if (link := show(record, t_ns)) is not None},
    )


def unmet(state: AsState, record: Record, t_ns: int) -> list[Candidate]:
    """What does not hold at `t_ns` of what is asked in a state: what must be put right first, then what follows."""
    found = []
    for condition, source, evidence, follows in conditions_unmet(moment(record, t_ns), state):
        signal = _SIGNALS.get(source)
        span = None if signal is None else record.span_at(signal, t_ns)
        if signal is not None and span is not None:
            step: ChainLink | None = signal.step(span.begin_ns, evidence)
        else:
            step = _HISTORY[condition.slug](record, t_ns)
        assert step is not None
        sureness = Sureness.FITS if follows else Sureness.SHOWN
        found.append(candidate(_named(condition.slug, record, t_ns), sureness, step))
    return found


def _named(slug: str, record: Record, t_ns: int) -> str:
    """The car's own name for a fault says what to do."""
    names = (FAULT_BITS[signal.name] for signal in sig.FAULTS if signal != sig.COMMS_LOST and record.at(signal, t_ns))
    return next(names, slug) if slug == "fault" else slug


def _too_early(record: Record, t_ns: int) -> list[Candidate]:
    span = record.span_at(sig.AS_STATE, t_ns)
    if span is None or span.before is None or t_ns - span.begin_ns >= READY_WAIT_NS:
        return []
    words = f"Go {ms(t_ns - span.begin_ns)} after AS_READY began: 5 s have to pass"
    return [shown("go_too_early", sig.AS_STATE.step(span.begin_ns, words))]


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
        candidates = unmet(AsState.AS_OFF, record, at_ns) or [candidate("start_unknown", Sureness.POSSIBLE, met)]
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
        for one in (*_too_early(record, press.t_ns), *unmet(AsState.AS_READY, record, press.t_ns)):
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
        found += unmet(AsState.AS_READY, record, end_ns)
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


def why_not_driving(record: Record, now_ns: int, emergency: Incident | None) -> Iterator[Obstacle]:
    """What stands between now and driving, and what to do, what must be put right first in front.

    In AS_DRIVING only that the car stands. emergency: the newest entry into EMERGENCY_BRAKE with its causes, where that
    was seen.
    """
    span = record.span_at(sig.AS_STATE, now_ns)
    if span is None and record.wrong_length.get(sig.STATUS):
        yield _told(
            record, Obstacle("status_length", f"{BY_ID[sig.STATUS]} has the wrong length: it counts as missing")
        )
        return
    if span is None and not record.lacks(sig.STATUS):
        yield _told(record, Obstacle("no_as_state", "the database has no AS_STATE in 0x520"))
        return
    now = moment(record, now_ns)
    if span is not None and now.silent_ns is None and span.value == sig.EMERGENCY and emergency is not None:
        yield _of_cause(record, emergency.candidates[0])
        yield from (replace(obstacle, follows=True) for obstacle in bus_not_driving(now))
        return
    if span is not None and now.silent_ns is None and span.value == sig.DRIVING:
        stood = idle(record, span.begin_ns, now_ns)
        if stood is None:
            return
        yield _told(record, Obstacle("not_driven", CAUSES["not_driven"].words, stood.words))
    for obstacle in bus_not_driving(now):
        yield _told(record, obstacle, _named(obstacle.slug, record, now_ns))


def _of_cause(record: Record, one: Candidate) -> Obstacle:
    evidence = "" if one.sureness >= Sureness.SHOWN else one.sureness.words
    return _told(record, Obstacle(one.slug, one.cause.words, evidence, one.sureness < Sureness.FITS))


def _told(record: Record, obstacle: Obstacle, slug: str = "") -> Obstacle:
    return replace(obstacle, remedy=remedy_of(slug or obstacle.slug, theirs=record.ai_is_theirs))
