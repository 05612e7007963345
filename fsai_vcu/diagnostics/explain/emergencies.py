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
)
from fsai_vcu.diagnostics.explain.link import GONE_NS, REBOOT_NS, gap_at, link_losses, ms, timeouts_said
from fsai_vcu.diagnostics.explain.record import Record, Signal, Span
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
PLANNED: Final = (Ami.STATIC_INSPECTION_B, Ami.AUTONOMOUS_DEMO)


def emergencies(record: Record) -> list[Incident]:
    """Every entry into EMERGENCY_BRAKE, and drives that ended in no regular state."""
    found = []
    for span in record.series(sig.AS_STATE).spans:
        if span.value == sig.EMERGENCY:
            found.append(_emergency(record, span))
        elif span.before == sig.DRIVING and span.value not in (sig.FINISHED, sig.EMERGENCY):
            found.append(_cut_off(record, span))
    found += _lost_car(record)
    return found


# ---------------------------------------------------------------- one emergency brake


def _emergency(record: Record, span: Span) -> Incident:
    t_ns = span.begin_ns
    before = None if span.before is None else AsState(int(span.before)) if span.before <= sig.FINISHED else None
    came = f"{before.label} → EMERGENCY_BRAKE" if before is not None else "EMERGENCY_BRAKE"
    end = sig.AS_STATE.step(t_ns, f"AS_STATE {came}{_said_words(record, t_ns)}")
    candidates: list[Candidate] = []
    said = _said(record, span)
    for slug, sureness in said.items():
        candidates += CHAINS.get(slug, _plain)(record, t_ns, slug, sureness)
    for rule in CONDITIONS:
        candidates += rule(record, t_ns, set(said))
    candidates += _impossible(record, span)
    if not candidates or (span.before is None and not said):
        candidates += _nothing_shown(record, span)
    planned = False
    chains = ranked(candidates)
    if chains and chains[0].slug == "planned_end":
        planned = True
    chains = tuple(replace(c, steps=(*_marks(record, c), *c.steps, end)) for c in chains)
    chains = tuple(replace(c, steps=tuple(dict.fromkeys(sorted(c.steps, key=lambda s: s.t_ns)))) for c in chains)
    return Incident(
        IncidentKind.EMERGENCY,
        t_ns,
        f"EMERGENCY_BRAKE{'' if before is None else f' in {before.label}'}",
        chains,
        planned,
    )


def _marks(record: Record, one: Candidate) -> tuple[ChainLink, ...]:
    """What 0x120 says belongs to a chain about the link."""
    if one.slug.startswith(("ai_message", "ai_silent", "handshake", "ai_unheard", "ai_comms")):
        return tuple(timeouts_said(record, one.t_ns, one.t_ns + BEHIND_NS)[:2])
    return ()


def _said(record: Record, span: Span) -> dict[str, Sureness]:
    """The causes that the car names itself, the surest first."""
    t_ns = span.begin_ns
    until_ns = min(t_ns + AROUND_NS, span.end_ns)
    said: dict[str, Sureness] = {}
    value = record.series(sig.SHUTDOWN_CAUSE).at(until_ns) or 0
    if value:
        slug = {int(cause): slug for cause, slug in SHUTDOWN.items()}.get(int(value))
        if slug is not None:  # a value outside the table is told in the timeline, and says nothing here
            said[slug] = Sureness.SAID
    for signal in sig.FAULTS:
        series = record.series(signal)
        if not series.at(until_ns):
            continue
        rose = any(s.value and abs(s.begin_ns - t_ns) <= AROUND_NS for s in series.spans)
        if rose or span.before is None:
            said.setdefault(FAULT_BITS[signal.name], Sureness.SAID)
        else:
            said.setdefault(FAULT_BITS[signal.name], Sureness.FITS)
    return said


def _said_words(record: Record, t_ns: int) -> str:
    names = (
        [f"SHUTDOWN_CAUSE {label(sig.SHUTDOWN_CAUSE, value)}"]
        if (value := record.series(sig.SHUTDOWN_CAUSE).at(t_ns))
        else []
    )
    names += [signal.name for signal in sig.FAULTS if record.series(signal).at(t_ns)]
    return f"; {', '.join(names)}" if names else ""


# ---------------------------------------------------------------- chains behind what the car says


def _plain(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    for signal in sig.FAULTS:
        if FAULT_BITS[signal.name] == slug:
            rose = [s for s in record.series(signal).changes(t_ns - BEHIND_NS, t_ns + AROUND_NS) if s.value]
            at_ns = rose[0].begin_ns if rose else t_ns
            return [candidate(slug, sureness, [signal.step(at_ns, f"{signal.name} is 1")])]
    return [candidate(slug, sureness, [sig.SHUTDOWN_CAUSE.step(t_ns, f"SHUTDOWN_CAUSE names it: {slug}")])]


def _drive_begin(record: Record, t_ns: int) -> int:
    begin = record.begin_ns
    for span in record.series(sig.AS_STATE).spans:
        if span.value == sig.DRIVING and span.begin_ns <= t_ns:
            begin = span.begin_ns
    return begin


def _requested(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """Why the AI computer asked for the emergency brake."""
    asked = [s for s in record.series(sig.ESTOP).spans if s.value and s.begin_ns <= t_ns + 20 * MS]
    if not asked or asked[-1].end_ns < t_ns - BEHIND_NS:
        words = "the car names the AI computer's request, but no 0x510 in this log has ESTOP_REQUEST 1"
        return [candidate(slug, sureness, [sig.SHUTDOWN_CAUSE.step(t_ns, words)])]
    first = asked[-1]
    if first.before is None:
        step = sig.ESTOP.step(first.begin_ns, "ESTOP_REQUEST is 1 from the log's first 0x510 on")
        return [candidate(slug, sureness, [step])]
    request = sig.ESTOP.step(first.begin_ns, "ESTOP_REQUEST 0 → 1: the AI computer asks")
    roots = found_before(record, first.begin_ns, _drive_begin(record, t_ns), emergency=True)
    # Who asked is said by the car; why, by the frames before.
    chains = [replace(root, sureness=sureness, steps=(*root.steps, request)) for root in roots]
    if chains:
        return list(ranked(chains))
    ami = record.series(sig.AMI).at(t_ns)
    if ami in PLANNED and (ami == Ami.STATIC_INSPECTION_B or _has_moved(record, t_ns)):
        mission = sig.AMI.step(_drive_begin(record, t_ns), f"the mission is {label(sig.AMI, ami)}")
        return [candidate("planned_end", sureness, [mission, request])]
    return [
        candidate("not_on_the_bus", sureness, [request]),
        candidate(slug, Sureness.FITS, [request]),
    ]


def _has_moved(record: Record, t_ns: int) -> bool:
    wheels = record.fastest_wheel().between(_drive_begin(record, t_ns), t_ns)
    return bool((wheels.values >= STANDING_RPM).any())


def _link(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """Why the link was lost."""
    silence = next((g for g in record.gaps(sig.STATUS, HUNG_NS) if abs((g.end_ns or 0) - t_ns) <= HUNG_NS), None)
    if silence is not None and not record.silence_in(silence):
        words = f"the last 0x520 before {ms(silence.length_ns)} of silence; the first one after it reports the loss"
        return [candidate("vcu_hung", sureness, [ChainLink(silence.begin_ns, words, sig.STATUS)])]
    found = link_losses(record, t_ns, sureness)
    if found:
        return found
    if record.ai_speaks:
        words = "0x510 to 0x514 and the echo are all in this log, in time"
        return [candidate("ai_unheard", sureness, [ChainLink(t_ns, words, 0x510)])]
    words = "this log has no frame of the AI computer: it was silent, or only one direction was recorded"
    return [candidate(slug, sureness, [ChainLink(t_ns, words, sig.STATUS, "AI_COMMS_LOST")])]


def _torque_with_brake(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """The moment when both were asked for."""
    met = _both_asked(record, t_ns)
    step = met or ChainLink(t_ns, "the frames of this log do not show torque and brake together", sig.STATUS)
    return [candidate(slug, sureness, [step])]


def _both_asked(record: Record, t_ns: int) -> ChainLink | None:
    begin = t_ns - JUST_BEFORE_NS
    torque = [record.series(signal) for signal in (sig.TORQUE_F, sig.TORQUE_R)]
    brake = [record.series(signal) for signal in (sig.BRAKE_REQ_F, sig.BRAKE_REQ_R)]
    for series in (*torque, *brake):
        for at_ns in series.between(begin, t_ns).t_ns.tolist():
            nm = max((s.at(at_ns) or 0.0) for s in torque)
            pct = max((s.at(at_ns) or 0.0) for s in brake)
            if nm > 0 and pct > 0:
                return ChainLink(at_ns, f"torque {nm:g} Nm and brake {pct:g} % are asked for together", 0x514)
    return None


def _turning(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """NEUTRAL or FINISHED while a wheel turned: since when it was said."""
    signal, value = TURNING[slug]
    series = record.series(signal)
    said = [s for s in series.spans if s.value == value and s.begin_ns <= t_ns]
    wheels = record.fastest_wheel().at(t_ns)
    if not said:
        return [
            candidate(
                slug, sureness, [ChainLink(t_ns, f"no 0x510 of this log says {label(signal, value)}", sig.STATUS)]
            )
        ]
    turn = "" if wheels is None else f" while a wheel turns at {wheels:.0f} rpm"
    words = f"{signal.name} {label(signal, said[-1].before)} → {label(signal, value)}{turn}"
    return [candidate(slug, sureness, [signal.step(said[-1].begin_ns, words)])]


TURNING: Final[Mapping[str, tuple[Signal, float]]] = MappingProxyType(
    {
        "neutral_while_moving": (sig.DIRECTION, float(Direction.NEUTRAL)),
        "finished_while_moving": (sig.MISSION_STATUS, float(MissionStatus.FINISHED)),
    }
)


def _ebs(record: Record, t_ns: int, slug: str, sureness: Sureness) -> list[Candidate]:
    """An EBS that goes because TSMS went, or by itself."""
    switched = [s for s in record.series(sig.TS_SWITCH).changes(t_ns - BEHIND_NS, t_ns) if not s.value]
    went: list[ChainLink] = []
    for signal, armed in ((sig.EBS_STATE, EbsState.EBS_ARMED), (sig.STATUS_EBS, EbsStatus.ARMED)):
        for s in record.series(signal).changes(t_ns - BEHIND_NS, t_ns):
            if s.before == armed:
                went.append(
                    signal.step(s.begin_ns, f"{signal.name} {label(signal, s.before)} → {label(signal, s.value)}")
                )
    bit = _plain(record, t_ns, slug, sureness)[0].steps
    if switched:
        root = sig.TS_SWITCH.step(switched[-1].begin_ns, "TS_SWITCH_STATUS 1 → 0: TSMS goes off")
        return [
            candidate("tsms_off", sureness, [root, *went[:1], *bit]),
            candidate(slug, Sureness.FITS, [*went[:1], *bit]),
        ]
    return [candidate(slug, sureness, [*went[:1], *bit])]


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


def _switch_off(record: Record, t_ns: int, said: set[str]) -> list[Candidate]:
    if _state_before(record, t_ns) != sig.DRIVING:
        return []
    return [
        candidate(slug, Sureness.SHOWN, [signal.step(s.begin_ns, words)])
        for signal, slug, words in (
            (sig.AS_SWITCH, "asms_off", "AS_SWITCH_STATUS 1 → 0: ASMS goes off"),
            (sig.GO, "go_off", "GO_SIGNAL 1 → 0"),
        )
        for s in record.series(signal).changes(t_ns - JUST_BEFORE_NS, t_ns)
        if not s.value and not (slug == "go_off" and like_official_simulator(record))
    ]


def _state_before(record: Record, t_ns: int) -> float | None:
    for span in record.series(sig.AS_STATE).spans:
        if span.begin_ns == t_ns:
            return span.before
    return None


def _radio(record: Record, t_ns: int, said: set[str]) -> list[Candidate]:
    """The remote's own words (0x181), and what a Go that vanishes may mean."""
    found = []
    # Which of its two values means pressed is not in the interface: what held before the edge was released.
    for edge in record.series(sig.REMOTE_ESTOP).changes(t_ns - 2 * S, t_ns)[:1]:
        step = sig.REMOTE_ESTOP.step(edge.begin_ns, f"the remote's ESTOP_STATUS {edge.before:g} → {edge.value:g}")
        found.append(candidate("remote_estop", Sureness.SHOWN, [step]))
    silent = gap_at(record, sig.REMOTE_ESTOP.can_id, t_ns, SILENT_NS)
    if silent is not None:
        step = ChainLink(silent.begin_ns, "the last 0x181 (RES_TPDO) before it is missing", sig.REMOTE_ESTOP.can_id)
        found.append(candidate("radio_lost", Sureness.SHOWN, [step]))
    weak = [s for s in record.series(sig.RADIO_STRENGTH).changes(t_ns - 2 * S, t_ns) if s.value == 0]
    if weak:
        step = sig.RADIO_STRENGTH.step(weak[-1].begin_ns, "RADIO_STRENGTH falls to 0 %")
        found.append(candidate("radio_lost", Sureness.SHOWN, [step]))
    elif any(not s.value for s in record.series(sig.GO).changes(t_ns - JUST_BEFORE_NS, t_ns)):
        step = sig.GO.step(t_ns, "Go vanishes with the remote's radio, too")
        found.append(candidate("radio_lost", Sureness.POSSIBLE, [step]))
    return found


def _asked_unsaid(record: Record, t_ns: int, said: set[str]) -> list[Candidate]:
    """Conditions of the AS state machine that the frames show and the car (or this database) does not name."""
    driving = _state_before(record, t_ns) == sig.DRIVING
    if said or not driving:
        return _link_unsaid(record, t_ns) if not said else []
    found: list[Candidate] = []
    if record.series(sig.ESTOP).at(t_ns):
        found += _requested(record, t_ns, "ai_computer_request", Sureness.SHOWN)
    wheels = record.fastest_wheel().at(t_ns)
    for slug, (signal, value) in TURNING.items():
        recent = [s for s in record.series(signal).changes(t_ns - JUST_BEFORE_NS, t_ns) if s.value == value]
        if recent and wheels is not None and wheels > STANDING_RPM:
            found += _turning(record, t_ns, slug, Sureness.SHOWN)
    both = _both_asked(record, t_ns)
    if both is not None:
        found.append(candidate("torque_with_brake", Sureness.SHOWN, [both]))
    return [*found, *_link_unsaid(record, t_ns)]


def _link_unsaid(record: Record, t_ns: int) -> list[Candidate]:
    if not record.ai_speaks:
        return []
    return [c for c in link_losses(record, t_ns, Sureness.SHOWN) if t_ns - c.t_ns <= BEHIND_NS]


def _simulators_brake(record: Record, t_ns: int, said: set[str]) -> list[Candidate]:
    if said or not like_official_simulator(record):
        return []
    rose = [
        s
        for signal in (sig.BRAKE_REQ_F, sig.BRAKE_REQ_R)
        for s in record.series(signal).changes(t_ns - JUST_BEFORE_NS, t_ns)
        if s.value > 0 and s.before == 0
    ]
    if not rose:
        return []
    step = sig.BRAKE_REQ_F.step(rose[0].begin_ns, f"a brake of {rose[0].value:g} % is asked for")
    return [candidate("brake_request_simulator", Sureness.SHOWN, [step])]


Rule = Callable[[Record, int, set[str]], list[Candidate]]
CONDITIONS: Final[tuple[Rule, ...]] = (_switch_off, _radio, _asked_unsaid, _simulators_brake)


def _impossible(record: Record, span: Span) -> list[Candidate]:
    """A state that the car shows for a moment in AS_DRIVING, and from which there is no way back to it."""
    following = next((s for s in record.series(sig.AS_STATE).spans if s.begin_ns == span.end_ns), None)
    if span.before != sig.DRIVING or following is None or following.value != sig.DRIVING:
        return []
    if span.end_ns - span.begin_ns > BACK_NS:
        return []
    words = f"AS_DRIVING again {ms(span.end_ns - span.begin_ns)} later: there is no such way back"
    return [candidate("frames_wrong", Sureness.SHOWN, [sig.AS_STATE.step(span.begin_ns, words)])]


def _nothing_shown(record: Record, span: Span) -> list[Candidate]:
    """What is left when neither the car nor the frames name a cause."""
    t_ns = span.begin_ns
    if span.before is None:
        step = sig.AS_STATE.step(t_ns, "the first 0x520 of the log says EMERGENCY_BRAKE already")
        return [candidate("before_the_log", Sureness.SHOWN, [step])]
    on = [name for name, signal in (("ASMS", sig.AS_SWITCH), ("Go", sig.GO)) if record.series(signal).at(t_ns)]
    switches = f"{' and '.join(on)} {'is' if len(on) == 1 else 'are'} on, " if on else ""
    asked = "the AI computer did not ask and was in time" if record.ai_speaks else "the AI computer is not in this log"
    checked = f"{switches}no fault bit and no SHUTDOWN_CAUSE is set, {asked}"
    found = [candidate("sdc_open", Sureness.FITS, [ChainLink(t_ns, f"{checked}: what is left is the SDC", sig.STATUS)])]
    return [*found, candidate("unknown", Sureness.POSSIBLE, [ChainLink(t_ns, "something that this log does not have")])]


# ---------------------------------------------------------------- drives that were cut off


def _cut_off(record: Record, span: Span) -> Incident:
    """AS_DRIVING fell back to another state than EMERGENCY_BRAKE or AS_FINISHED."""
    t_ns = span.begin_ns
    end = sig.AS_STATE.step(t_ns, f"AS_STATE AS_DRIVING → {label(sig.AS_STATE, span.value)}")
    found: list[Candidate] = []
    silence = next((g for g in record.gaps(sig.STATUS, SILENT_NS) if g.end_ns == t_ns), None)
    if silence is not None and span.value in OFF_LIKE:
        words = f"the last 0x520 before {ms(silence.length_ns)} of silence"
        slug = "vcu_reboot" if silence.length_ns < REBOOT_NS else "power_off"
        found.append(candidate(slug, Sureness.SHOWN, [ChainLink(silence.begin_ns, words, sig.STATUS)]))
    for s in record.series(sig.AS_SWITCH).changes(t_ns - JUST_BEFORE_NS, t_ns):
        if not s.value:
            step = sig.AS_SWITCH.step(s.begin_ns, "AS_SWITCH_STATUS 1 → 0: ASMS goes off")
            found.append(candidate("asms_off", Sureness.SHOWN, [step]))
    for s in record.series(sig.MISSION_STATUS).changes(t_ns - JUST_BEFORE_NS, t_ns):
        if s.value == MissionStatus.NOT_SELECTED:
            step = sig.MISSION_STATUS.step(s.begin_ns, "MISSION_STATUS becomes NOT_SELECTED")
            found.append(candidate("not_selected_simulator", Sureness.SHOWN, [step]))
    if "not in the interface" in label(sig.AS_STATE, span.value):
        found.append(candidate(Reason.AS_STATE_UNKNOWN.slug, Sureness.SHOWN, [end]))
    elif not found:
        found += _impossible(record, span) or [candidate("unknown", Sureness.POSSIBLE, [end])]
    chains = tuple(replace(c, steps=tuple(dict.fromkeys((*c.steps, end)))) for c in ranked(found))
    return Incident(IncidentKind.ABORT, t_ns, f"AS_DRIVING ended in {label(sig.AS_STATE, span.value)}", chains)


def _lost_car(record: Record) -> list[Incident]:
    """The car fell silent in AS_DRIVING and never came back, while others went on."""
    spans = record.series(sig.AS_STATE).spans
    if not spans or spans[-1].value != sig.DRIVING:
        return []
    last_ns = spans[-1].end_ns
    if record.end_ns - last_ns < GONE_NS:
        return []
    words = f"the last 0x520 of the log, {ms(record.end_ns - last_ns)} before its end"
    received = sorted(
        can_id for can_id in BY_ID if can_id > sig.STATUS and can_id < 0x527 and len(record.times(can_id))
    )
    still = any(int(record.times(can_id)[-1]) > last_ns + SILENT_NS for can_id in received)
    slug = "vcu_silent" if still else "power_off"
    return [
        Incident(
            IncidentKind.ABORT,
            last_ns,
            "the car fell silent in AS_DRIVING",
            (candidate(slug, Sureness.SHOWN, [ChainLink(last_ns, words, sig.STATUS)]),),
        )
    ]
