"""Every EMERGENCY_BRAKE, and every drive that was cut off: what brought it about.

First comes what the car itself says (SHUTDOWN_CAUSE, fault bits), then what the frames show of the conditions of the
AS state machine; behind an ESTOP_REQUEST and a lost link the search goes one step further back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import FAULT_BITS, SHUTDOWN
from fsai_vcu.diagnostics.explain.evidence import found_before
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
from fsai_vcu.diagnostics.explain.link import GONE_NS, REBOOT_NS, gap_at, link_losses, timeouts_said
from fsai_vcu.diagnostics.explain.record import Gap, Record, Signal, Span, ms
from fsai_vcu.diagnostics.explain.signals import label, like_official_simulator
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import OFF_LIKE, Ami, AsState, Direction, EbsState, EbsStatus, MissionStatus
from fsai_vcu.interface.specification import STANDING_RPM
from fsai_vcu.interface.units import MS, S

AROUND_NS: Final = 300 * MS  # a fault bit that rises so close to the change of state belongs to it
JUST_BEFORE_NS: Final = 150 * MS  # what the VCU acted on is not older than this, but for time-outs
BEHIND_NS: Final = 3 * S  # how far back a chain is followed
SILENT_NS: Final = 200 * MS  # a VCU that starts says nothing for a while
HUNG_NS: Final = 50 * MS
BACK_NS: Final = 2 * S


def emergencies(record: Record) -> list[Incident]:
    """Every entry into EMERGENCY_BRAKE, and drives that ended in no regular state."""
    found = []
    for span in record.series(sig.AS_STATE).spans:
        if span.value == sig.EMERGENCY:
            found.append(_emergency(record, span))
        elif span.before == sig.DRIVING and span.value != sig.FINISHED:
            found.append(_cut_off(record, span))
    return [*found, *_lost_car(record)]


# ---------------------------------------------------------------- one emergency brake


def _emergency(record: Record, span: Span) -> Incident:
    t_ns = span.begin_ns
    before = None if span.before is None or span.before > sig.FINISHED else AsState(int(span.before)).label
    names = [signal.name for signal in sig.FAULTS if record.at(signal, t_ns)]
    if cause := record.at(sig.SHUTDOWN_CAUSE, t_ns):
        names.insert(0, f"SHUTDOWN_CAUSE {label(sig.SHUTDOWN_CAUSE, cause)}")
    came = f"{before} → EMERGENCY_BRAKE" if before else "EMERGENCY_BRAKE"
    end = sig.AS_STATE.step(t_ns, f"AS_STATE {came}{'; ' if names else ''}{', '.join(names)}")
    candidates: list[Candidate] = []
    said = _said(record, span)
    for slug, sureness in said.items():
        candidates += CHAINS.get(slug, _plain)(record, t_ns, slug, sureness)
    candidates += [*_switch_off(record, t_ns), *_radio(record, t_ns)]
    if not said:
        candidates += [*_asked_unsaid(record, t_ns), *_link_unsaid(record, t_ns), *_simulators_brake(record, t_ns)]
    candidates += _impossible(record, span)
    if not candidates or (span.before is None and not said):
        candidates += _nothing_shown(record, span)
    chains = ranked(candidates)
    what = f"EMERGENCY_BRAKE{f' in {before}' if before else ''}"
    ended = tuple(replace(one, steps=(*_marks(record, one), *one.steps)).with_steps(end) for one in chains)
    return Incident(IncidentKind.EMERGENCY, t_ns, what, ended, planned=chains[0].slug == "planned_end")


def _marks(record: Record, one: Candidate) -> list[ChainLink]:
    """What 0x120 says belongs to a chain about the link."""
    about_link = one.slug.startswith(("ai_message", "ai_silent", "handshake", "ai_unheard", "ai_comms"))
    return timeouts_said(record, one.t_ns, one.t_ns + BEHIND_NS)[:2] if about_link else []


def _said(record: Record, span: Span) -> dict[str, Sureness]:
    """The causes that the car names itself, the surest first."""
    t_ns = span.begin_ns
    until_ns = min(t_ns + AROUND_NS, span.end_ns)
    said: dict[str, Sureness] = {}
    value = int(record.at(sig.SHUTDOWN_CAUSE, until_ns) or 0)
    slugs = {int(cause): slug for cause, slug in SHUTDOWN.items()}
    if value in slugs:  # one outside the table is named in the timeline, and says nothing here
        said[slugs[value]] = Sureness.SAID
    for signal in sig.FAULTS:
        series = record.series(signal)
        if series.at(until_ns):
            rose = any(s.value and abs(s.begin_ns - t_ns) <= AROUND_NS for s in series.spans)
            sureness = Sureness.SAID if rose or span.before is None else Sureness.FITS
            said.setdefault(FAULT_BITS[signal.name], sureness)
    return said


# ---------------------------------------------------------------- chains behind what the car says


def _plain(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    for signal in sig.FAULTS:
        if FAULT_BITS[signal.name] == slug:
            rose = [s.begin_ns for s in record.changes(signal, t_ns - BEHIND_NS, t_ns + AROUND_NS) if s.value]
            return [candidate(slug, sureness, signal.step([*rose, t_ns][0], f"{signal.name} is 1"))]
    return [candidate(slug, sureness, sig.SHUTDOWN_CAUSE.step(t_ns, f"SHUTDOWN_CAUSE names it: {slug}"))]


def _drive_begin(record: Record, t_ns: int) -> int:
    begins = (s.begin_ns for s in record.series(sig.AS_STATE).spans if s.value == sig.DRIVING and s.begin_ns <= t_ns)
    return max(begins, default=record.begin_ns)


def _requested(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """Why the AI computer asked for the emergency brake."""
    asked = [s for s in record.series(sig.ESTOP).spans if s.value and s.begin_ns <= t_ns + 20 * MS]
    if not asked or asked[-1].end_ns < t_ns - BEHIND_NS:
        words = "the car names the AI computer's request, but no 0x510 in this log has ESTOP_REQUEST 1"
        return [candidate(slug, sureness, sig.SHUTDOWN_CAUSE.step(t_ns, words))]
    first = asked[-1]
    if first.before is None:
        step = sig.ESTOP.step(first.begin_ns, "ESTOP_REQUEST is 1 from the log's first 0x510 on")
        return [candidate(slug, sureness, step)]
    request = sig.ESTOP.step(first.begin_ns, "ESTOP_REQUEST 0 → 1: the AI computer asks")
    drive_ns = _drive_begin(record, t_ns)
    # Who asked is said by the car; why, by the frames before.
    if roots := found_before(record, first.begin_ns, drive_ns, emergency=True):
        return list(ranked(replace(root, sureness=sureness, steps=(*root.steps, request)) for root in roots))
    ami = record.at(sig.AMI, t_ns)
    moved = (record.fastest_wheel().between(drive_ns, t_ns).values >= STANDING_RPM).any()
    if ami == Ami.STATIC_INSPECTION_B or (ami == Ami.AUTONOMOUS_DEMO and moved):
        mission = sig.AMI.step(drive_ns, f"the mission is {label(sig.AMI, ami)}")
        return [candidate("planned_end", sureness, mission, request)]
    return [candidate("not_on_the_bus", sureness, request), candidate(slug, Sureness.FITS, request)]


def _link(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """Why the link was lost."""
    silence = next((g for g in record.gaps(sig.STATUS, HUNG_NS) if abs((g.end_ns or 0) - t_ns) <= HUNG_NS), None)
    if silence is not None and not record.silence_in(silence):
        words = f"the last 0x520 before {ms(silence.length_ns)} of silence; the first one after it reports the loss"
        return [candidate("vcu_hung", sureness, ChainLink(silence.begin_ns, words, sig.STATUS))]
    if found := link_losses(record, t_ns, sureness):
        return found
    if record.ai_speaks:
        words = "0x510 to 0x514 and the echo are all in this log, in time"
        return [candidate("ai_unheard", sureness, ChainLink(t_ns, words, 0x510))]
    words = "this log has no frame of the AI computer: it was silent, or only one direction was recorded"
    return [candidate(slug, sureness, ChainLink(t_ns, words, sig.STATUS, "AI_COMMS_LOST"))]


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
    """NEUTRAL or FINISHED while a wheel turned: since when it was said."""
    signal, value = TURNING[slug]
    said = [s for s in record.series(signal).spans if s.value == value and s.begin_ns <= t_ns]
    if not said:
        step = ChainLink(t_ns, f"no 0x510 of this log says {label(signal, value)}", sig.STATUS)
        return [candidate(slug, sureness, step)]
    wheels = record.fastest_wheel().at(t_ns)
    turn = "" if wheels is None else f" while a wheel turns at {wheels:.0f} rpm"
    words = f"{signal.name} {label(signal, said[-1].before)} → {label(signal, value)}{turn}"
    return [candidate(slug, sureness, signal.step(said[-1].begin_ns, words))]


TURNING: Final[Mapping[str, tuple[Signal, float]]] = MappingProxyType(
    {
        "neutral_while_moving": (sig.DIRECTION, float(Direction.NEUTRAL)),
        "finished_while_moving": (sig.MISSION_STATUS, float(MissionStatus.FINISHED)),
    }
)


def _ebs(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """An EBS that goes because TSMS went, or by itself."""
    went = [
        signal.step(s.begin_ns, f"{signal.name} {label(signal, s.before)} → {label(signal, s.value)}")
        for signal, armed in ((sig.EBS_STATE, EbsState.EBS_ARMED), (sig.STATUS_EBS, EbsStatus.ARMED))
        for s in record.changes(signal, t_ns - BEHIND_NS, t_ns)
        if s.before == armed
    ]
    steps = [*went[:1], *_plain(record, t_ns, slug, sureness)[0].steps]
    switched = record.changes(sig.TS_SWITCH, t_ns - BEHIND_NS, t_ns, to=0)
    if not switched:
        return [candidate(slug, sureness, *steps)]
    root = sig.TS_SWITCH.step(switched[-1].begin_ns, "TS_SWITCH_STATUS 1 → 0: TSMS goes off")
    return [candidate("tsms_off", sureness, root, *steps), candidate(slug, Sureness.FITS, *steps)]


Chain = Callable[[Record, int, str, Sureness], list[Candidate]]
CHAINS: Final[Mapping[str, Chain]] = MappingProxyType(
    {
        "ai_computer_request": _requested,
        "ai_comms_lost": _link,
        "torque_with_brake": _torque_with_brake,
        "neutral_while_moving": _turning,
        "finished_while_moving": _turning,
        "ebs_fault": _ebs,
    }
)


# ---------------------------------------------------------------- conditions that the frames show


def _was_driving(record: Record, t_ns: int) -> bool:
    return any(s.begin_ns == t_ns and s.before == sig.DRIVING for s in record.series(sig.AS_STATE).spans)


def _asms_off(record: Record, t_ns: int) -> list[Candidate]:
    return [
        shown("asms_off", sig.AS_SWITCH.step(s.begin_ns, "AS_SWITCH_STATUS 1 → 0: ASMS goes off"))
        for s in record.changes(sig.AS_SWITCH, t_ns - JUST_BEFORE_NS, t_ns, to=0)
    ]


def _switch_off(record: Record, t_ns: int) -> list[Candidate]:
    if not _was_driving(record, t_ns):
        return []
    go_off = [] if like_official_simulator(record) else record.changes(sig.GO, t_ns - JUST_BEFORE_NS, t_ns, to=0)
    return [*_asms_off(record, t_ns), *(shown("go_off", sig.GO.step(s.begin_ns, "GO_SIGNAL 1 → 0")) for s in go_off)]


def _radio(record: Record, t_ns: int) -> list[Candidate]:
    """The remote's own words (0x181), and what a Go that vanishes may mean."""
    found = []
    # Which of its two values means pressed is not in the interface: what held before the edge was released.
    for edge in record.changes(sig.REMOTE_ESTOP, t_ns - 2 * S, t_ns)[:1]:
        step = sig.REMOTE_ESTOP.step(edge.begin_ns, f"the remote's ESTOP_STATUS {edge.before:g} → {edge.value:g}")
        found.append(shown("remote_estop", step))
    silent = gap_at(record, sig.REMOTE_ESTOP.can_id, t_ns, SILENT_NS)
    if silent is not None:
        step = ChainLink(silent.begin_ns, "the last 0x181 (RES_TPDO) before it is missing", sig.REMOTE_ESTOP.can_id)
        found.append(shown("radio_lost", step))
    weak = record.changes(sig.RADIO_STRENGTH, t_ns - 2 * S, t_ns, to=0)
    if weak:
        step = sig.RADIO_STRENGTH.step(weak[-1].begin_ns, "RADIO_STRENGTH falls to 0 %")
        found.append(shown("radio_lost", step))
    elif record.changes(sig.GO, t_ns - JUST_BEFORE_NS, t_ns, to=0):
        step = sig.GO.step(t_ns, "Go vanishes with the remote's radio, too")
        found.append(candidate("radio_lost", Sureness.POSSIBLE, step))
    return found


def _asked_unsaid(record: Record, t_ns: int) -> list[Candidate]:
    """Conditions of the AS state machine that the frames show and the car (or this database) does not name."""
    found: list[Candidate] = []
    if not _was_driving(record, t_ns):
        return found
    if record.at(sig.ESTOP, t_ns):
        found += _requested(record, t_ns, "ai_computer_request", Sureness.SHOWN)
    wheels = record.fastest_wheel().at(t_ns)
    for slug, (signal, value) in TURNING.items():
        recent = record.changes(signal, t_ns - JUST_BEFORE_NS, t_ns, to=value)
        if recent and wheels is not None and wheels > STANDING_RPM:
            found += _turning(record, t_ns, slug, Sureness.SHOWN)
    both = _both_asked(record, t_ns)
    return found if both is None else [*found, shown("torque_with_brake", both)]


def _link_unsaid(record: Record, t_ns: int) -> list[Candidate]:
    losses = link_losses(record, t_ns, Sureness.SHOWN) if record.ai_speaks else []
    return [one for one in losses if t_ns - one.t_ns <= BEHIND_NS]


def _simulators_brake(record: Record, t_ns: int) -> list[Candidate]:
    for signal in (sig.BRAKE_REQ_F, sig.BRAKE_REQ_R) if like_official_simulator(record) else ():
        for s in record.changes(signal, t_ns - JUST_BEFORE_NS, t_ns):
            if s.value > 0 and s.before == 0:
                step = sig.BRAKE_REQ_F.step(s.begin_ns, f"a brake of {s.value:g} % is asked for")
                return [shown("brake_request_simulator", step)]
    return []


def _impossible(record: Record, span: Span) -> list[Candidate]:
    """A state that the car shows for a moment in AS_DRIVING, and from which there is no way back to it."""
    following = next((s for s in record.series(sig.AS_STATE).spans if s.begin_ns == span.end_ns), None)
    back = following is not None and following.value == sig.DRIVING and span.end_ns - span.begin_ns <= BACK_NS
    if span.before != sig.DRIVING or not back:
        return []
    words = f"AS_DRIVING again {ms(span.end_ns - span.begin_ns)} later: there is no such way back"
    return [shown("frames_wrong", sig.AS_STATE.step(span.begin_ns, words))]


def _nothing_shown(record: Record, span: Span) -> list[Candidate]:
    """What is left when neither the car nor the frames name a cause."""
    t_ns = span.begin_ns
    if span.before is None:
        step = sig.AS_STATE.step(t_ns, "the first 0x520 of the log says EMERGENCY_BRAKE already")
        return [shown("before_the_log", step)]
    on = [name for name, signal in (("ASMS", sig.AS_SWITCH), ("Go", sig.GO)) if record.at(signal, t_ns)]
    switches = f"{' and '.join(on)} {'is' if len(on) == 1 else 'are'} on, " if on else ""
    asked = "the AI computer did not ask and was in time" if record.ai_speaks else "the AI computer is not in this log"
    checked = f"{switches}no fault bit and no SHUTDOWN_CAUSE is set, {asked}: what is left is the SDC"
    return [
        candidate("sdc_open", Sureness.FITS, ChainLink(t_ns, checked, sig.STATUS)),
        candidate("unknown", Sureness.POSSIBLE, ChainLink(t_ns, "something that this log does not have")),
    ]


# ---------------------------------------------------------------- drives that were cut off


def restarted(gap: Gap, behind: str = "") -> Candidate:
    """The car was silent, and came back in another state."""
    step = ChainLink(gap.begin_ns, f"the last 0x520 before {ms(gap.length_ns)} of silence{behind}", sig.STATUS)
    return shown("vcu_reboot" if gap.length_ns < REBOOT_NS else "power_off", step)


def _cut_off(record: Record, span: Span) -> Incident:
    """AS_DRIVING fell back to another state than EMERGENCY_BRAKE or AS_FINISHED."""
    t_ns = span.begin_ns
    state = label(sig.AS_STATE, span.value)
    end = sig.AS_STATE.step(t_ns, f"AS_STATE AS_DRIVING → {state}")
    silences = [gap for gap in record.gaps(sig.STATUS, SILENT_NS) if gap.end_ns == t_ns and span.value in OFF_LIKE]
    found = [restarted(gap) for gap in silences[:1]]
    found += _asms_off(record, t_ns)
    for s in record.changes(sig.MISSION_STATUS, t_ns - JUST_BEFORE_NS, t_ns, to=MissionStatus.NOT_SELECTED):
        step = sig.MISSION_STATUS.step(s.begin_ns, "MISSION_STATUS becomes NOT_SELECTED")
        found.append(shown("not_selected_simulator", step))
    if "not in the interface" in state:
        found.append(shown(Reason.AS_STATE_UNKNOWN.slug, end))
    elif not found:
        found += _impossible(record, span) or [candidate("unknown", Sureness.POSSIBLE, end)]
    chains = tuple(replace(c, steps=tuple(dict.fromkeys((*c.steps, end)))) for c in ranked(found))
    return Incident(IncidentKind.ABORT, t_ns, f"AS_DRIVING ended in {state}", chains)


def _lost_car(record: Record) -> list[Incident]:
    """The car fell silent in AS_DRIVING and never came back, while others went on."""
    spans = record.series(sig.AS_STATE).spans
    if not spans or spans[-1].value != sig.DRIVING or record.end_ns - spans[-1].end_ns < GONE_NS:
        return []
    last_ns = spans[-1].end_ns
    words = f"the last 0x520 of the log, {ms(record.end_ns - last_ns)} before its end"
    received = [can_id for can_id in BY_ID if sig.STATUS < can_id < 0x527 and record.has(can_id)]
    still = any(int(record.times(can_id)[-1]) > last_ns + SILENT_NS for can_id in received)
    cause = shown("vcu_silent" if still else "power_off", ChainLink(last_ns, words, sig.STATUS))
    return [Incident(IncidentKind.ABORT, last_ns, "the car fell silent in AS_DRIVING", (cause,))]
