"""Every EMERGENCY_BRAKE, every drive that was cut off, and those that ended regularly, but early: the cause.

First comes what the car itself reports (SHUTDOWN_CAUSE, fault bits), then what the frames show of the conditions of the
AS state machine; behind an ESTOP_REQUEST and a lost link the search goes one step further back. Where the AI computer
stopped the car by its service brake, how it brakes shows why: commands that fall silent leave torque 0 and the steering
held for 200 ms before the brake comes; everything else brakes at once.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import FAULT_BITS, SHUTDOWN
from fsai_vcu.diagnostics.explain.evidence import (
    CONFIG,
    SLACK_NS,
    accumulators,
    found_before,
    gap_at,
    link_losses,
    sag,
)
from fsai_vcu.diagnostics.explain.incident import (
    Candidate,
    ChainLink,
    Incident,
    IncidentKind,
    Sureness,
    candidate,
    ranked,
    shown,
)
from fsai_vcu.diagnostics.explain.record import DEAD_NS, GONE_NS, REBOOT_NS, Gap, Record, Series, Span
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.diagnostics.explain.standing import INSPECTIONS, Stand, causes, last_ns, stands, stood
from fsai_vcu.diagnostics.log.frames import Ints
from fsai_vcu.diagnostics.statistics.measure import NEVER_NS
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import (
    OFF_LIKE,
    Ami,
    AsState,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    TsState,
)
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, READY_WAIT_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S, ms

AROUND_NS: Final = 300 * MS  # a fault bit that rises so close to the change of state belongs to it
JUST_BEFORE_NS: Final = 150 * MS  # what the VCU acted on is not older than this, but for time-outs
BEHIND_NS: Final = 3 * S  # how far back a chain is followed
SILENT_NS: Final = 200 * MS  # a VCU that starts says nothing for a while
REMOTE_LATE_NS: Final = 20 * MS  # its receiver sends every 10 ms, perhaps after the car's own change of state
HUNG_NS: Final = 50 * MS
LATE_NS: Final = 60 * MS  # of a switch that the car reports behind the state it brought about: nobody reacts so soon
BACK_NS: Final = 2 * S
FAST_RPM: Final = 80  # 2 m/s: a mission that is done brakes by command to less than this before it comes to rest
AT_FIRST_NS: Final = 20 * MS  # a fault bit that rises later than the state did not bring it about
STOOD_NS: Final = COMMS_LOST_NS - 20 * MS  # a HANDSHAKE that stands for so long is no answer that is late
NOT_SHOWN: Final = (Reason.COMMAND_STALE.slug, "stop_asked")  # causes that no frame shows
BRAKING: Final = f"the brake goes to {CONFIG.stop_brake_pct:g} %, torque 0: stopping for the rest of the run"
HELD_NS: Final = 150 * MS  # of the 200 ms between torque 0 and the brake


def emergencies(record: Record) -> Iterator[Incident]:
    """Every entry into EMERGENCY_BRAKE, and drives that ended in no regular state."""
    braked = {drive.end_ns: t_ns for drive, t_ns in service_brakes(record)}
    for span in record.series(sig.AS_STATE).spans:
        if span.value == sig.EMERGENCY:
            yield _emergency(record, span, braked.get(span.begin_ns))
        elif span.before == sig.DRIVING and span.value != sig.FINISHED:
            yield _cut_off(record, span)
    yield from _lost_car(record)


# ---------------------------------------------------------------- one emergency brake


def _emergency(record: Record, span: Span, braked_ns: int | None) -> Incident:
    """Return the incident of an entry into EMERGENCY_BRAKE, with its causes; the service brake came at `braked_ns`."""
    t_ns = span.begin_ns
    before = None if span.before is None or span.before > sig.FINISHED else AsState(int(span.before)).label
    names = [signal.name for signal in sig.FAULTS if record.at(signal, t_ns)]
    if cause := record.at(sig.SHUTDOWN_CAUSE, t_ns):
        names.insert(0, f"SHUTDOWN_CAUSE {label(sig.SHUTDOWN_CAUSE, cause)}")
    came = f"{before} → EMERGENCY_BRAKE" if before else "EMERGENCY_BRAKE"
    end = sig.AS_STATE.step(t_ns, f"AS_STATE {came}{'; ' if names else ''}{', '.join(names)}")
    chains = ranked(_emergency_causes(record, span))
    what = f"EMERGENCY_BRAKE{f' in {before}' if before else ''}"
    ended = tuple(
        candidate(one.slug, one.sureness, *_marks(record, one), *_graded(one, braked_ns), *one.steps, end)
        for one in chains
    )
    return Incident(IncidentKind.EMERGENCY, t_ns, what, ended, planned=chains[0].slug == "planned_end", lasted=span[:2])


def _emergency_causes(record: Record, span: Span) -> list[Candidate]:
    """Return the causes of an entry into EMERGENCY_BRAKE: those that the car reports, then those that frames show."""
    t_ns, driven, reported = span.begin_ns, span.before == sig.DRIVING, _reported(record, span)
    found: list[Candidate] = []
    for slug, sureness in reported.items():
        found += CHAINS.get(slug, _plain)(record, t_ns, slug, sureness)
    radio = list(_radio(record, t_ns))
    if driven:
        found += switched(record, "asms_off", sig.AS_SWITCH, t_ns, "AS_SWITCH_STATUS 1 → 0: ASMS goes off")
        # Go vanishes with the remote's radio, too.
        with_radio = any(one.slug == "radio_lost" and one.sureness is Sureness.SHOWN for one in radio)
        if not with_radio and not record.like_official_simulator:
            found += switched(record, "go_off", sig.GO, t_ns, "GO_SIGNAL 1 → 0")
    found += radio
    if not reported:
        found += _unreported(record, t_ns) if driven else []
        found += _lost_link(record, t_ns, driven)
        found += _simulators_brake(record, t_ns)
    found += _impossible(span)
    if not found and driven:
        found += _just_behind(record, t_ns)
    if not found or (span.before is None and not reported):
        found += _nothing_shown(record, span)
    return found


def _marks(record: Record, one: Candidate) -> list[ChainLink]:
    """Return the links for a chain about the link: what 0x120 (2021) reports as missing."""
    if not one.slug.startswith(("ai_message", "ai_silent", "handshake", "ai_unheard", "ai_comms")):
        return []
    return [
        signal.step(change.begin_ns, f"the VCU misses {what}")
        for signal, what in sig.MISSED.items()
        for change in record.changes(signal, one.t_ns, one.t_ns + BEHIND_NS)
        if change.value
    ][:2]


def _graded(one: Candidate, braked_ns: int | None) -> list[ChainLink]:
    """Return the link for a request for an emergency brake before which the service brake was tried."""
    asked = any(step.signal == sig.ESTOP.name and braked_ns is not None and step.t_ns > braked_ns for step in one.steps)
    return [_braking(braked_ns)] if asked and braked_ns is not None else []


def _braking(t_ns: int) -> ChainLink:
    return sig.BRAKE_REQ_F.step(t_ns, BRAKING)


def _reported(record: Record, span: Span) -> dict[str, Sureness]:
    """The causes that the car names itself, the surest first; of bits that follow one another those of the first."""
    t_ns = span.begin_ns
    until_ns = min(t_ns + AROUND_NS, span.end_ns)
    if any(record.at(signal, t_ns + AT_FIRST_NS) for signal in (sig.SHUTDOWN_CAUSE, *sig.FAULTS)):
        until_ns = min(until_ns, t_ns + AT_FIRST_NS)
    reported: dict[str, Sureness] = {}
    value = int(record.at(sig.SHUTDOWN_CAUSE, until_ns) or 0)
    slugs = {int(cause): slug for cause, slug in SHUTDOWN.items()}
    if value in slugs:  # one outside the table is named in the timeline, and says nothing here
        reported[slugs[value]] = Sureness.SAID
    for signal in sig.FAULTS:
        series = record.series(signal)
        if series.at(until_ns):
            rose = any(s.value for s in series.begun(t_ns - AROUND_NS, until_ns))
            sureness = Sureness.SAID if rose or span.before is None else Sureness.FITS
            reported.setdefault(FAULT_BITS[signal.name], sureness)
    return reported


# ---------------------------------------------------------------- chains behind what the car says


def _plain(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    for signal in sig.FAULTS:
        if FAULT_BITS[signal.name] == slug:
            begun = record.series(signal).begun(t_ns - BEHIND_NS, t_ns + AROUND_NS)
            rose_ns = next((s.begin_ns for s in begun if s.value and s.before is not None), t_ns)
            return [candidate(slug, sureness, signal.step(rose_ns, f"{signal.name} is 1"))]
    return [candidate(slug, sureness, sig.SHUTDOWN_CAUSE.step(t_ns, f"SHUTDOWN_CAUSE names it: {slug}"))]


def _requested(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """Return why the AI computer asked for the emergency brake."""
    first = record.series(sig.ESTOP).last(t_ns + 20 * MS)
    if first is None or first.end_ns < t_ns - BEHIND_NS:
        words = "the car names the AI computer's request, but no 0x510 in this log has ESTOP_REQUEST 1"
        return [candidate(slug, sureness, sig.SHUTDOWN_CAUSE.step(t_ns, words))]
    if first.before is None:
        step = sig.ESTOP.step(first.begin_ns, "ESTOP_REQUEST is 1 from the log's first 0x510 on")
        return [candidate(slug, sureness, step)]
    request = sig.ESTOP.step(first.begin_ns, "ESTOP_REQUEST 0 → 1: the AI computer asks")
    drive = record.series(sig.AS_STATE).last(t_ns, sig.DRIVING)
    drive_ns = record.begin_ns if drive is None else drive.begin_ns
    # Who asked is reported by the car; why, by the frames before.
    if roots := found_before(record, first.begin_ns, drive_ns, emergency=True):
        return list(ranked(candidate(root.slug, sureness, *root.steps, request) for root in roots))
    stand = stood(record, drive_ns, first.begin_ns) if drive is not None else None
    if stand is not None and first.begin_ns - stand.end_ns <= GONE_NS:
        return list(ranked(candidate(one.slug, sureness, *one.steps, request) for one in causes(record, stand)))
    ami = record.at(sig.AMI, t_ns)
    moved = (record.fastest_wheel.between(drive_ns, t_ns).values >= STANDING_RPM).any()
    if ami == Ami.STATIC_INSPECTION_B or (ami == Ami.AUTONOMOUS_DEMO and moved):
        mission = sig.AMI.step(drive_ns, f"the mission is {label(sig.AMI, ami)}")
        return [candidate("planned_end", sureness, mission, request)]
    silent = [gap for gap in record.gaps(sig.ESTOP.can_id, COMMS_LOST_NS) if gap.begin_ns >= first.begin_ns]
    quiet = [
        ChainLink(gap.begin_ns, f"its last 0x510: it falls silent {gap.words()}", 0x510)
        for gap in silent[:1]
        if gap.begin_ns - first.begin_ns <= BEHIND_NS
    ]
    return [
        candidate("not_on_the_bus", sureness, request, *quiet),
        candidate(slug, Sureness.FITS, request),
    ]


def _link(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """Return why the link was lost."""
    gaps = record.gaps(sig.STATUS, HUNG_NS)
    place = bisect_left(gaps, t_ns - HUNG_NS, key=lambda gap: gap.over_ns)
    silence = gaps[place] if place < len(gaps) and (gaps[place].end_ns or NEVER_NS) <= t_ns + HUNG_NS else None
    if silence is not None and not record.silence_in(silence):
        words = f"the last 0x520 before {ms(silence.length_ns)} of silence; the first one after it reports the loss"
        return [candidate("vcu_hung", sureness, ChainLink(silence.begin_ns, words, sig.STATUS))]
    if found := link_losses(record, t_ns, sureness):
        return found
    if found := _still(record, t_ns, sureness):
        return found
    if all(map(record.has, AI_IDS)):
        words = "0x510 to 0x514 and the echo are all in this log, in time"
        return [candidate("ai_unheard", sureness, ChainLink(t_ns, words, 0x510))]
    words = "this log has no frame of the AI computer: it was silent, or only one direction was recorded"
    if record.ai_speaks:
        words = "this log does not have all five messages of the AI computer"
    return [candidate("ai_comms_lost", sureness, ChainLink(t_ns, words, sig.STATUS, "AI_COMMS_LOST"))]


def _still(record: Record, t_ns: int, sureness: Sureness) -> list[Candidate]:
    """A HANDSHAKE that toggled, and then stood for so long that its echo was missed, or nothing was done any more."""
    still = record.span_at(sig.HANDSHAKE, t_ns - 1)
    if still is None or still.before is None or t_ns - still.begin_ns < STOOD_NS or not len(record.series(sig.ECHO)):
        return []  # without its echo nobody knows whether it was sent back
    if any(still.begin_ns <= gap.begin_ns < t_ns for gap in record.gaps(sig.STATUS, HUNG_NS)):
        return []  # nor what it was in frames that did not come
    length = ms(still.end_ns - still.begin_ns)
    words = f"HANDSHAKE of 0x520 stands at {still.value:g} for {length}, and 0x510 sends it back"
    stands_at = sig.HANDSHAKE.step(still.begin_ns, words, sig.HANDSHAKE.was(still.value, still.begin_ns, t_ns - 1))
    # A VCU that hears nobody says so after its patience: if it says nothing for longer, it was not heard itself.
    slug = "status_frozen" if t_ns - still.begin_ns >= COMMS_LOST_NS + DEAD_NS else "handshake_stands"
    return [candidate(slug, sureness, stands_at)]


def _torque_with_brake(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """The moment when both were asked for."""
    unseen = ChainLink(t_ns, "the frames of this log do not show torque and brake together", sig.STATUS)
    return [candidate(slug, sureness, _both_asked(record, t_ns) or unseen)]


def _both_asked(record: Record, t_ns: int) -> ChainLink | None:
    torque, brake = (sig.TORQUE_F, sig.TORQUE_R), (sig.BRAKE_REQ_F, sig.BRAKE_REQ_R)
    for signal in (*torque, *brake):
        for at_ns in record.series(signal).between(t_ns - JUST_BEFORE_NS, t_ns).t_ns.tolist():
            nm, pct = (max(record.at(each, at_ns) or 0.0 for each in pair) for pair in (torque, brake))
            if nm > 0 and pct > 0:
                return ChainLink(at_ns, f"torque {nm:g} Nm and brake {pct:g} % are asked for together", 0x514)
    return None


def _turning(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """NEUTRAL or FINISHED while a wheel turned: since when it was sent."""
    signal, value = TURNING[slug]
    reported = record.series(signal).last(t_ns, value)
    if reported is None:
        step = ChainLink(t_ns, f"no 0x510 of this log says {label(signal, value)}", sig.STATUS)
        return [candidate(slug, sureness, step)]
    wheels = record.fastest_wheel.at(t_ns)
    turn = "" if wheels is None else f" while a wheel turns at {wheels:.0f} rpm"
    words = f"{signal.name} {label(signal, reported.before)} → {label(signal, value)}{turn}"
    return [candidate(slug, sureness, signal.step(reported.begin_ns, words))]


TURNING: Final[Mapping[str, tuple[Signal, float]]] = {
    "neutral_while_moving": (sig.DIRECTION, float(Direction.NEUTRAL)),
    "finished_while_moving": (sig.MISSION_STATUS, float(MissionStatus.FINISHED)),
}


def _ebs(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """An EBS that goes because TSMS went, or by itself."""
    went = [
        signal.step(s.begin_ns, f"{signal.name} {label(signal, s.before)} → {label(signal, s.value)}")
        for signal, armed in ((sig.EBS_STATE, EbsState.EBS_ARMED), (sig.STATUS_EBS, EbsStatus.ARMED))
        for s in record.changes(signal, t_ns - BEHIND_NS, t_ns)
        if s.before == armed
    ]
    steps = [*accumulators(record, t_ns), *went[:1], *_plain(record, t_ns, slug, sureness)[0].steps]
    switched = record.changes(sig.TS_SWITCH, t_ns - BEHIND_NS, t_ns, to=0)
    if not switched:
        return [candidate(slug, sureness, *steps)]
    root = sig.TS_SWITCH.step(switched[-1].begin_ns, "TS_SWITCH_STATUS 1 → 0: TSMS goes off")
    return [candidate("tsms_off", sureness, root, *steps), candidate(slug, Sureness.FITS, *steps)]


Chain = Callable[[Record, int, str, Sureness], list[Candidate]]
CHAINS: Final[Mapping[str, Chain]] = {
    "ai_computer_request": _requested,
    "ai_comms_lost": _link,
    "torque_with_brake": _torque_with_brake,
    "neutral_while_moving": _turning,
    "finished_while_moving": _turning,
    "ebs_fault": _ebs,
}


# ---------------------------------------------------------------- conditions that the frames show


def switched(
    record: Record,
    slug: str,
    signal: Signal,
    t_ns: int,
    words: str = "",
    to: float | None = 0,
    within_ns: int = JUST_BEFORE_NS,
) -> list[Candidate]:
    """Return the cause for each change of the signal (to a value, if one is named) just before, or with it."""
    changes = record.changes(signal, t_ns - within_ns, t_ns, to)
    return [
        shown(
            slug,
            signal.step(
                change.begin_ns,
                words or f"{signal.name} {label(signal, change.before)} → {label(signal, change.value)}",
                signal.was(change.value, change.begin_ns),
            ),
        )
        for change in changes
    ]


def _radio(record: Record, t_ns: int) -> Iterator[Candidate]:
    """The remote's own words (0x181), and what a Go that vanishes may mean."""
    # The interface does not say which of its two values means pressed: before the edge it counts as released.
    for edge in record.changes(sig.REMOTE_ESTOP, t_ns - 2 * S, t_ns + REMOTE_LATE_NS)[:1]:
        step = sig.REMOTE_ESTOP.step(edge.begin_ns, f"the remote's ESTOP_STATUS {edge.before:g} → {edge.value:g}")
        yield shown("remote_estop", step)
    silent = gap_at(record, sig.REMOTE_ESTOP.can_id, t_ns, COMMS_LOST_NS)
    if silent is not None and gap_at(record, sig.STATUS, t_ns, SILENT_NS) is None:  # not the whole car's silence
        step = ChainLink(silent.begin_ns, "the last 0x181 (RES_TPDO) before it is missing", sig.REMOTE_ESTOP.can_id)
        yield shown("radio_lost", step)
    weak = record.changes(sig.RADIO_STRENGTH, t_ns - 2 * S, t_ns + REMOTE_LATE_NS, to=0)
    if weak:
        yield shown("radio_lost", sig.RADIO_STRENGTH.step(weak[-1].begin_ns, "RADIO_STRENGTH falls to 0 %"))
    elif record.changes(sig.GO, t_ns - JUST_BEFORE_NS, t_ns, to=0):
        step = sig.GO.step(t_ns, "Go vanishes with the remote's radio, too")
        yield candidate("radio_lost", Sureness.POSSIBLE, step)


def _unreported(record: Record, t_ns: int) -> list[Candidate]:
    """Conditions to leave AS_DRIVING that the frames show and the car (or this database) does not name."""
    asked = record.at(sig.ESTOP, t_ns)
    found = _requested(record, t_ns, "ai_computer_request", Sureness.SHOWN) if asked else []
    found += switched(record, "tsms_off", sig.TS_SWITCH, t_ns, "TS_SWITCH_STATUS 1 → 0: TSMS goes off")
    found += _failed(record, t_ns)
    wheels = record.fastest_wheel.at(t_ns)
    for slug, (signal, value) in TURNING.items():
        recent = record.changes(signal, t_ns - JUST_BEFORE_NS, t_ns, to=value)
        if recent and wheels is not None and wheels > STANDING_RPM:
            found += _turning(record, t_ns, slug, Sureness.SHOWN)
    both = _both_asked(record, t_ns)
    return found if both is None else [*found, shown("torque_with_brake", both)]


def _lost_link(record: Record, t_ns: int, driven: bool) -> list[Candidate]:
    """The link's loss as the frames show it, where the car does not report it."""
    losses = link_losses(record, t_ns, Sureness.SHOWN) if record.ai_speaks else []
    if driven and not losses:
        losses = _still(record, t_ns, Sureness.FITS)
    return [one for one in losses if t_ns - one.t_ns <= BEHIND_NS]


def _failed(record: Record, t_ns: int) -> Iterator[Candidate]:
    """Causes that a state of the car's systems shows, where no fault bit does: faults, and people at the car."""
    for slug, signal, value in (
        ("ebs_fault", sig.EBS_STATE, EbsState.EBS_FAULT),
        ("ts_fault", sig.TS_STATE, TsState.TS_FAULT),
        ("pushbar_in_driving", sig.OP_STATE, OpState.OP_PUSHBAR),
    ):
        more = accumulators(record, t_ns) if slug == "ebs_fault" else []
        for one in switched(record, slug, signal, t_ns, to=value):
            yield candidate(slug, one.sureness, *more, *one.steps)


def _just_behind(record: Record, t_ns: int) -> Iterator[Candidate]:
    """Changes by hand, or of the tractive system, that 0x520 and 0x181 show a moment after the state."""
    for slug, signal, to in (
        ("asms_off", sig.AS_SWITCH, 0.0),
        ("tsms_off", sig.TS_SWITCH, 0.0),
        ("pushbar_in_driving", sig.OP_STATE, float(OpState.OP_PUSHBAR)),
        ("ts_fault", sig.TS_STATE, float(TsState.TS_FAULT)),
        ("remote_estop", sig.REMOTE_ESTOP, None),
    ):
        for one in switched(record, slug, signal, t_ns + LATE_NS, to=to, within_ns=LATE_NS - 1):
            yield candidate(slug, Sureness.FITS, *one.steps)


def _simulators_brake(record: Record, t_ns: int) -> list[Candidate]:
    for signal in (sig.BRAKE_REQ_F, sig.BRAKE_REQ_R) if record.like_official_simulator else ():
        for s in record.changes(signal, t_ns - JUST_BEFORE_NS, t_ns):
            if s.value > 0 and s.before == 0:
                step = sig.BRAKE_REQ_F.step(s.begin_ns, f"a brake of {s.value:g} % is asked for")
                return [shown("brake_request_simulator", step)]
    return []


def _impossible(span: Span) -> list[Candidate]:
    """A state that the car shows for a moment in AS_DRIVING, and from which there is no way back to it."""
    if not span.before == span.after == sig.DRIVING or span.end_ns - span.begin_ns > BACK_NS:
        return []
    words = f"AS_DRIVING again {ms(span.end_ns - span.begin_ns)} later: the VCU has no such transition"
    return [shown("frames_wrong", sig.AS_STATE.step(span.begin_ns, words))]


def _nothing_shown(record: Record, span: Span) -> list[Candidate]:
    """Return the causes that are left when neither the car nor the frames name one."""
    t_ns = span.begin_ns
    if span.before is None:
        step = sig.AS_STATE.step(t_ns, "the first 0x520 of the log says EMERGENCY_BRAKE already")
        return [shown("before_the_log", step)]
    on = [name for name, signal in (("ASMS", sig.AS_SWITCH), ("Go", sig.GO)) if record.at(signal, t_ns)]
    switches = f"{' and '.join(on)} {'is' if len(on) == 1 else 'are'} on, " if on else ""
    asked = "the AI computer did not ask and was in time" if record.ai_speaks else "the AI computer is not in this log"
    remote = ""
    if record.has(sig.REMOTE_ESTOP.can_id):
        heard = t_ns - record.newest_ns(sig.REMOTE_ESTOP.can_id, t_ns) <= DEAD_NS
        remote = f", the remote's {'E-stop and radio did not change' if heard else '0x181 is missing'}"
    known = [sig.SHUTDOWN_CAUSE, *sig.FAULTS]
    claims = [signal.was(0.0, t_ns) for signal in known if len(record.series(signal))]
    claims += [signal.was(1.0, t_ns) for signal in (sig.AS_SWITCH, sig.GO) if record.at(signal, t_ns)]
    named = "no fault bit and no SHUTDOWN_CAUSE is set" if claims else "no fault bit is known"
    checked = f"{switches}{named}, {asked}{remote}: what is left is the SDC"
    return [
        candidate("sdc_open", Sureness.FITS, ChainLink(t_ns, checked, sig.STATUS, claims=tuple(claims))),
        candidate("unknown", Sureness.POSSIBLE, ChainLink(t_ns, "something that this log does not have")),
    ]


# ---------------------------------------------------------------- drives that were cut off


def restarted(record: Record, gap: Gap, behind: str = "") -> Candidate:
    """The car was silent, and came back in another state."""
    others = [
        other
        for other in record.gaps(sig.STATUS, SILENT_NS)
        if other.begin_ns > gap.begin_ns
        and other.end_ns is not None
        and record.at(sig.AS_STATE, other.end_ns) in OFF_LIKE
    ]
    again = f", the first of {len(others) + 1} such silences" if others else ""
    words = f"the last 0x520 before {ms(gap.length_ns)} of silence{behind}{again}"
    step = ChainLink(gap.begin_ns, words, sig.STATUS)
    return shown("vcu_reboot" if gap.length_ns < REBOOT_NS else "power_off", *sag(record, gap), step)


def _cut_off(record: Record, span: Span) -> Incident:
    """AS_DRIVING fell back to another state than EMERGENCY_BRAKE or AS_FINISHED."""
    t_ns = span.begin_ns
    state = label(sig.AS_STATE, span.value)
    end = sig.AS_STATE.step(t_ns, f"AS_STATE AS_DRIVING → {state}")
    silences = [gap for gap in record.gaps(sig.STATUS, SILENT_NS) if gap.end_ns == t_ns and span.value in OFF_LIKE]
    found = [restarted(record, gap) for gap in silences[:1]]
    found += switched(record, "asms_off", sig.AS_SWITCH, t_ns, "AS_SWITCH_STATUS 1 → 0: ASMS goes off")
    words, unselected = "MISSION_STATUS becomes NOT_SELECTED", MissionStatus.NOT_SELECTED
    found += switched(record, "not_selected_simulator", sig.MISSION_STATUS, t_ns, words, unselected)
    if "not in the interface" in state:
        found.append(shown(Reason.AS_STATE_UNKNOWN.slug, end))
    elif not found:
        found += _impossible(span) or [candidate("unknown", Sureness.POSSIBLE, end)]
    chains = tuple(candidate(one.slug, one.sureness, *one.steps, end) for one in ranked(found))
    return Incident(IncidentKind.ABORT, t_ns, f"AS_DRIVING ended in {state}", chains)


def _lost_car(record: Record) -> Iterator[Incident]:
    """The car fell silent in AS_DRIVING and never came back, while others went on."""
    spans = record.series(sig.AS_STATE).spans
    if not spans or spans[-1].value != sig.DRIVING or record.end_ns - spans[-1].end_ns < GONE_NS:
        return
    last_ns = spans[-1].end_ns
    words = f"the last 0x520 of the log, {ms(record.end_ns - last_ns)} before its end"
    received = [can_id for can_id in BY_ID if sig.STATUS < can_id < 0x527 and record.has(can_id)]
    still = any(int(record.times(can_id)[-1]) > last_ns + SILENT_NS for can_id in received)
    cause = shown("vcu_silent" if still else "power_off", ChainLink(last_ns, words, sig.STATUS))
    yield Incident(IncidentKind.ABORT, last_ns, "the car fell silent in AS_DRIVING", (cause,))


# ---------------------------------------------------------------- service-brake stops


def early_stops(record: Record) -> Iterator[Incident]:
    """Every drive that was ended early by the AI computer's service brake, or in which the car never drove."""
    for span, began_ns in service_brakes(record):
        if span.after == sig.EMERGENCY:
            yield from stands(record, span)
            continue
        if began_ns is None:
            yield from _without_a_stop(record, span)
            continue
        stop = _stop(record, began_ns, span.begin_ns)
        # Slow after a drive, or on stands, a mission that is done stops like this: then only what the bus shows just
        # before counts. One wheel that reads too much does not make it fast.
        wheels = record.middle_wheel.between(span.begin_ns, began_ns).values
        slow = len(wheels) and wheels[-1] < FAST_RPM <= wheels.max()
        on_stands = record.at(sig.AMI, began_ns) == Ami.STATIC_INSPECTION_A
        seen = [one for one in stop.candidates if one.slug not in NOT_SHOWN and began_ns - one.t_ns <= BEHIND_NS]
        if seen or not (slow or on_stands):
            yield stop
        else:
            yield from stands(record, span)


def _without_a_stop(record: Record, span: Span) -> Iterator[Incident]:
    """AS_DRIVING that was over before it drove, or that the AI computer does not take for a drive of its own."""
    wheels = record.fastest_wheel.between(span.begin_ns, span.end_ns).values
    asked = [record.series(signal).between(span.begin_ns, span.end_ns) for signal in (sig.TORQUE_F, sig.TORQUE_R)]
    if span.after != sig.FINISHED or not len(wheels) or not all(map(len, asked)):
        yield from stands(record, span)
        return
    stand: Stand | None = stood(record, span.begin_ns, last_ns(span))
    over = record.span_at(sig.MISSION_STATUS, span.end_ns)
    over_ns = span.end_ns if over is None else over.begin_ns
    found = found_before(record, over_ns, span.begin_ns, emergency=False) if span.before is not None else []
    # What had lasted for long when the mission was over did not end it.
    candidates = [one for one in found if over_ns - one.t_ns <= BEHIND_NS]
    # A start that should not have been comes before all that it brought about.
    wrong = _start_was_wrong(record, span) if wheels.max() < STANDING_RPM and span.before is not None else []
    if stand is not None and not stand.driven:
        candidates += causes(record, stand)
    elif wheels.max() < STANDING_RPM and span.before is not None and record.at(sig.AMI, span.end_ns) not in INSPECTIONS:
        step = ChainLink(span.begin_ns, "the AI computer does not drive in AS_DRIVING", 0x512)
        candidates.append(candidate("stop_asked", Sureness.POSSIBLE, step))
    if told := (*wrong, *ranked(candidates)):
        what = f"AS_DRIVING for {ms(span.end_ns - span.begin_ns)}, and not faster than {wheels.max():.0f} rpm"
        yield Incident(IncidentKind.STOP, over_ns, what, told, lasted=span[:2])


def _start_was_wrong(record: Record, span: Span) -> list[Candidate]:
    """Return the cause that made this start wrong, where one is seen: no mission, or too short a time in AS_READY."""
    if not record.at(sig.AMI, span.begin_ns):
        return [shown(Reason.NO_MISSION.slug, sig.AMI.step(span.begin_ns, "AMI_STATE is 0: no mission is chosen"))]
    ready = record.span_at(sig.AS_STATE, span.begin_ns - 1)
    go = record.span_at(sig.GO, span.begin_ns)
    if ready is None or ready.value != sig.READY:
        return []
    waited_ns = span.begin_ns - ready.begin_ns
    if waited_ns < READY_WAIT_NS - SLACK_NS:
        step = sig.AS_STATE.step(ready.begin_ns, f"AS_READY for {ms(waited_ns)}: 5 s have to pass")
    elif go is not None and go.value and go.begin_ns <= ready.begin_ns:
        step = sig.GO.step(go.begin_ns, "GO_SIGNAL is 1 since before AS_READY began: no Go was given in it")
    else:
        return []
    return [shown(Reason.SEQUENCE_SHORT.slug, step)]


def service_brakes(record: Record) -> Iterator[tuple[Span, int | None]]:
    """Yield every drive with the time at which the AI computer's service brake began to end it, if it did."""
    brake = record.series(sig.BRAKE_REQ_F)
    driven = np.flatnonzero(record.series(sig.SPEED_MAX_R).sampled(brake.t_ns))
    for span in record.series(sig.AS_STATE).spans.of(sig.DRIVING):
        began_ns = _service_brake(brake, driven, span.begin_ns, span.end_ns)
        yield span, None if began_ns is None or record.at(sig.ESTOP, began_ns) else began_ns


def _service_brake(brake: Series, driven: Ints, begin_ns: int, end_ns: int) -> int | None:
    """Return when the brake went to the service-brake stop's pressure, with the motors' speed limit at 0 from then on.

    driven: where in `brake` it was not 0.
    """
    low, high = np.searchsorted(brake.t_ns, (begin_ns, end_ns + 1))
    low, high_driven = np.searchsorted(driven, (low, high))
    if low == high_driven:
        return None
    last = driven[high_driven - 1]
    stopping = np.flatnonzero(np.abs(brake.values[last:high] - CONFIG.stop_brake_pct) < 1.0)
    return int(brake.t_ns[last + stopping[0]]) if len(stopping) else None


def _stop(record: Record, t_ns: int, drive_begin_ns: int) -> Incident:
    """Return the incident of a drive that the AI computer's service brake ended, with its causes."""
    brake = _braking(t_ns)
    before = found_before(record, t_ns, drive_begin_ns, emergency=False)
    candidates = [candidate(one.slug, one.sureness, *one.steps, brake) for one in before]
    held_ns = _held_before(record, t_ns)
    if held_ns is not None:
        stale_ms = CONFIG.command_stale_ns // MS
        words = f"torque 0 and the steering held: no fresh command for {stale_ms} ms by then"
        lost = ChainLink(held_ns - CONFIG.command_stale_ns, "about when the last fresh command came (not on the bus)")
        step = sig.TORQUE_R.step(held_ns, words)
        candidates.append(candidate(Reason.COMMAND_STALE.slug, Sureness.FITS, lost, step, brake))
    candidates.append(candidate("stop_asked", Sureness.POSSIBLE, brake))
    rpm = record.fastest_wheel.at(t_ns)
    what = "service-brake stop" + ("" if rpm is None else f" from {rpm:.0f} rpm")
    return Incident(IncidentKind.STOP, t_ns, what, ranked(candidates))


def _held_before(record: Record, t_ns: int) -> int | None:
    """Return since when torque was 0 and steering and brake stood still, if for about the 200 ms of stale commands."""
    signals, until_ns = (sig.TORQUE_F, sig.TORQUE_R, sig.STEER), t_ns - SLACK_NS
    for signal in signals:
        values = record.series(signal).between(t_ns - HELD_NS, until_ns).values
        if len(values) and (values.max() != values.min() or (signal is not sig.STEER and values.max() > 0)):
            return None
    spans = [record.span_at(signal, until_ns) for signal in signals]
    latest = max((span.begin_ns for span in spans if span is not None), default=t_ns - HELD_NS)
    return max(latest, t_ns - (CONFIG.command_lost_ns - CONFIG.command_stale_ns))
