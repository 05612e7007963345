"""Causes for which the car does not start, in a log or at one moment.

The conditions are those of `start_conditions.py`; here is what a log shows of each, and what was missing where the car
was to start and did not.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Final

import numpy as np
from msgspec.structs import replace

from fsai_vcu.core.supervision.start_conditions import CONDITIONS, Obstacle
from fsai_vcu.core.supervision.start_conditions import why_not_driving as bus_not_driving
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import FAULT_BITS
from fsai_vcu.diagnostics.explain.conditions import all_met, moment, named, unmet
from fsai_vcu.diagnostics.explain.endings import JUST_BEFORE_NS, LATE_NS, restarted, switched
from fsai_vcu.diagnostics.explain.evidence import link_losses
from fsai_vcu.diagnostics.explain.incident import (
    Candidate,
    Incident,
    IncidentKind,
    Sureness,
    candidate,
    shown,
)
from fsai_vcu.diagnostics.explain.record import GONE_NS, Record, Span
from fsai_vcu.diagnostics.explain.signals import label
from fsai_vcu.diagnostics.explain.standing import causes, last_ns, stood
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import OFF_LIKE, AsState
from fsai_vcu.interface.specification import READY_WAIT_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S, ms

PATIENCE_NS: Final = 5 * S  # shorter waits in AS_INIT and AS_OFF are a car that comes up
NO_GO_NS: Final = READY_WAIT_NS + 1 * S
ANSWER_NS: Final = 200 * MS  # from Go to AS_DRIVING
SPELT: Final = 3  # states of a stay that are named one after another
SILENT: Final = ("no_ai_data", "ai_data_incomplete")  # what a lost link says more of
_OF_A_CONDITION: Final = frozenset(condition.slug for condition in CONDITIONS)


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
    """Yield an incident for each stay in AS_INIT and AS_OFF in which the car was to start and did not."""
    for begin_ns, end_ns, after_run in _off_stays(record):
        if end_ns - begin_ns < PATIENCE_NS:
            continue
        if after_run and not any(s.value for s in record.changes(sig.AS_SWITCH, begin_ns, end_ns)):
            continue  # the run is over, and the switches go off
        asms, wheel = (each.between(begin_ns, end_ns) for each in (record.series(sig.AS_SWITCH), record.fastest_wheel))
        if not asms.values.any() and (wheel.values >= STANDING_RPM).any():
            continue  # driven by hand
        at_ns = _judged_at(record, begin_ns, end_ns)
        candidates = (
            unmet(AsState.AS_OFF, record, at_ns)
            or unmet(AsState.AS_OFF, record, end_ns)
            or [*_reported(record, begin_ns, at_ns)]
            or [all_met(AsState.AS_OFF, record, at_ns)]
        )
        what = f"the car stays {_where(record, begin_ns, end_ns)}, and never gets to AS_READY"
        yield Incident(IncidentKind.REFUSAL, at_ns, what, tuple(candidates), lasted=(begin_ns, end_ns))


def _reported(record: Record, begin_ns: int, at_ns: int) -> Iterator[Candidate]:
    """Causes that the car and the remote report at that moment of a stay, beside the conditions of a start."""
    for signal in sig.FAULTS:
        if record.at(signal, at_ns):
            rose = record.span_at(signal, at_ns)
            since_ns = at_ns if rose is None else max(rose.begin_ns, begin_ns)
            yield candidate(FAULT_BITS[signal.name], Sureness.SAID, signal.step(since_ns, f"{signal.name} is 1"))
    pressed = record.changes(sig.REMOTE_ESTOP, begin_ns, at_ns)
    if pressed and record.at(sig.REMOTE_ESTOP, at_ns) == pressed[-1].value:
        words = f"the remote's ESTOP_STATUS {pressed[-1].before:g} → {pressed[-1].value:g}"
        yield candidate("remote_estop", Sureness.FITS, sig.REMOTE_ESTOP.step(pressed[-1].begin_ns, words))


def _where(record: Record, begin_ns: int, end_ns: int) -> str:
    """The states of a stay, and how long each of them lasted."""
    states = record.series(sig.AS_STATE).between(begin_ns, end_ns)
    parts = [
        (label(sig.AS_STATE, state), [t_ns for _, t_ns in rows])
        for state, rows in groupby(
            zip(states.values.tolist(), states.t_ns.tolist(), strict=True), key=lambda row: row[0]
        )
    ]
    if len(parts) > SPELT:
        names = " and ".join(dict.fromkeys(name for name, _ in parts))
        return f"in {names} for {ms(end_ns - begin_ns)}"
    ends = [times[0] for _, times in parts[1:]] + [end_ns]
    return ", then ".join(
        f"in {name} for {ms(until_ns - times[0])}" for (name, times), until_ns in zip(parts, ends, strict=True)
    )


def _off_stays(record: Record) -> Iterator[tuple[int, int, bool]]:
    """(begin, end, whether a run was before) of each stay in AS_INIT and AS_OFF that lasted as long as 0x520 came."""
    spans = record.series(sig.AS_STATE).spans_within(GONE_NS)
    off = np.isin(spans.values, tuple(OFF_LIKE))
    begins = np.flatnonzero(off & (spans.apart[:-1] | ~np.append(False, off[:-1])))
    ends = np.flatnonzero(off & spans.apart[1:])
    firsts = begins[np.searchsorted(begins, ends, side="right") - 1]
    columns = spans.begin_ns[firsts], spans.end_ns[ends], ~spans.apart[firsts]
    return zip(*(column.tolist() for column in columns), strict=True)


def _judged_at(record: Record, begin_ns: int, end_ns: int) -> int:
    """Return the last moment with ASMS and TSMS on, where they were on for as long as a start may take.

    What was missing then was missing to start. Else return the end: the switches themselves kept the car from it.
    """
    asms, tsms = (record.series(s).between(begin_ns, end_ns) for s in (sig.AS_SWITCH, sig.TS_SWITCH))
    if len(asms) != len(tsms) or not len(asms):
        return end_ns
    rows = (asms.values != 0) & (tsms.values != 0)
    lasted_ns = np.diff(asms.t_ns, append=end_ns)[rows].sum()
    return int(asms.t_ns[rows][-1]) if lasted_ns >= PATIENCE_NS else end_ns


def _losses(record: Record, t_ns: int) -> list[Candidate]:
    """Losses of the link to the AI computer, at a moment in which the car was to start."""
    return link_losses(record, t_ns, Sureness.SHOWN) if record.ai_speaks else []


def _missing(record: Record, t_ns: int) -> list[Candidate]:
    """Conditions of AS_READY that do not hold; in the place of a link that is lost, how it was."""
    losses = _losses(record, t_ns)
    found = [one for one in unmet(AsState.AS_READY, record, t_ns) if not losses or one.slug not in SILENT]
    return [*losses, *found]


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
        for one in (*_too_early(record, press.t_ns), *_missing(record, press.t_ns)):
            found.setdefault(one.slug, candidate(one.slug, one.sureness, *one.steps, press))
    if not any(one.sureness >= Sureness.SHOWN for one in found.values()):
        met = all_met(AsState.AS_READY, record, pressed[0].t_ns)
        found[met.slug] = candidate(met.slug, met.sureness, *met.steps, pressed[0])
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
    end_ns = last_ns(span)
    if span.after in OFF_LIKE:
        found += switched(record, "given_up", sig.AS_SWITCH, span.end_ns, "AS_SWITCH_STATUS 1 → 0", within_ns=waited_ns)
        silences = [gap for gap in record.gaps(sig.STATUS, ANSWER_NS) if gap.end_ns == span.end_ns]
        found += [restarted(record, gap, f", then {state}") for gap in silences]
        if not found:
            # What follows from a switch is shown by the same frame.
            missing = (one for one in _missing(record, span.end_ns) if one.sureness >= Sureness.SHOWN)
            found += [*_turned_away(record, span)] or missing
    elif losses := _losses(record, end_ns):
        found += losses
    if waited_ns >= NO_GO_NS and not found:
        found += [*_missing(record, end_ns), *_no_go(record, span, end_ns)]
    elif span.after is None and not found:
        return None  # the log ends while the 5 s run
    if not found:
        step = sig.AS_STATE.step(span.end_ns, f"AS_STATE AS_READY → {state}")
        met = all_met(AsState.AS_READY, record, end_ns)
        found.append(candidate(met.slug, met.sureness, *met.steps, step))
    ended = "the log ends" if span.after is None else f"{state} follows"
    order = sorted(found, key=lambda one: -one.sureness)
    what = f"AS_READY for {ms(waited_ns)} without a start, then {ended}"
    return Incident(IncidentKind.REFUSAL, span.end_ns, what, tuple(order), lasted=span[:2])


def _turned_away(record: Record, span: Span) -> Iterator[Candidate]:
    """Changes that somebody made just before AS_READY was left for AS_OFF."""
    for slug, signal, to in (
        ("tsms", sig.TS_SWITCH, 0),
        ("mission_changed", sig.AMI, None),
        ("deselected", sig.MISSION_STATUS, None),
    ):
        late_ns = LATE_NS if signal is sig.TS_SWITCH else 0  # the others may change because of AS_OFF
        yield from switched(record, slug, signal, span.end_ns + late_ns, to=to, within_ns=JUST_BEFORE_NS + late_ns)


def _no_go(record: Record, span: Span, end_ns: int) -> Iterator[Candidate]:
    """Causes of a Go that did not come, by GO_SIGNAL and by the remote's own words where they are in the log."""
    go = record.span_at(sig.GO, end_ns)
    if go is None:
        return
    if go.value:
        if go.begin_ns <= span.begin_ns:
            yield shown("go_held", sig.GO.step(go.begin_ns, "GO_SIGNAL is 1 since before AS_READY began"))
        return
    stays = f"GO_SIGNAL stays 0 for the {ms(span.end_ns - span.begin_ns)} of AS_READY"
    stayed = sig.GO.step(span.begin_ns, stays, sig.GO.was(0.0, span.begin_ns, end_ns))
    pressed = record.changes(sig.REMOTE_GO, span.begin_ns, end_ns, to=1)
    late = [press for press in pressed if press.begin_ns - span.begin_ns >= READY_WAIT_NS]
    if late:
        often = "" if len(late) == 1 else f", {len(late)} times"
        words = f"K2_SWITCH_GO_STATUS of the remote is 1 for {ms(late[0].end_ns - late[0].begin_ns)}{often}"
        press = sig.REMOTE_GO.step(late[0].begin_ns, words, sig.REMOTE_GO.was(1.0, late[0].begin_ns))
        yield shown("go_not_taken", stayed, press)
    elif pressed:
        words = f"K2_SWITCH_GO_STATUS of the remote 0 → 1, {ms(pressed[0].begin_ns - span.begin_ns)} after it began"
        yield shown("go_too_early", stayed, sig.REMOTE_GO.step(pressed[0].begin_ns, words))
    elif record.at(sig.REMOTE_GO, span.begin_ns):
        words = "K2_SWITCH_GO_STATUS of the remote is 1 since before AS_READY began"
        yield shown("go_held", stayed, sig.REMOTE_GO.step(span.begin_ns, words, sig.REMOTE_GO.was(1.0, span.begin_ns)))
    else:
        words = "K2_SWITCH_GO_STATUS of the remote stays 0, too"
        remote = sig.REMOTE_GO.step(span.begin_ns, words, sig.REMOTE_GO.was(0.0, span.begin_ns, end_ns))
        yield shown("no_go", stayed, *([remote] if record.at(sig.REMOTE_GO, span.begin_ns) is not None else []))


# ---------------------------------------------------------------- at one moment


def why_not_driving(record: Record, now_ns: int, emergency: Incident | None) -> Iterator[Obstacle]:
    """Yield the obstacles between now and driving, and what to do; the one to put right first comes first.

    In AS_DRIVING it yields only that the car stands. emergency: the newest entry into EMERGENCY_BRAKE with its causes,
    where that was seen.
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
        stand = stood(record, span.begin_ns, now_ns)
        if stand is None or now_ns - stand.end_ns > GONE_NS:
            return
        for one in causes(record, stand):
            if one.slug not in _OF_A_CONDITION:
                yield _told(record, Obstacle(one.slug, one.cause.words, one.steps[0].words))
    for obstacle in bus_not_driving(now):
        yield _told(record, obstacle, named(obstacle.slug, record, now_ns))


def _of_cause(record: Record, one: Candidate) -> Obstacle:
    evidence = "" if one.sureness >= Sureness.SHOWN else one.sureness.words
    return _told(record, Obstacle(one.slug, one.cause.words, evidence, one.sureness < Sureness.FITS))


def _told(record: Record, obstacle: Obstacle, slug: str = "") -> Obstacle:
    return replace(obstacle, remedy=remedy_of(slug or obstacle.slug, record.setting))
