"""Conditions of a start as a log shows them at one moment: those that are not met, and those that are seen met.

The conditions themselves are those of `start_conditions.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum
from typing import Any, Final

from fsai_vcu.core.supervision.start_conditions import Moment, Obstacle, seen_met
from fsai_vcu.core.supervision.start_conditions import unmet as conditions_unmet
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import FAULT_BITS
from fsai_vcu.diagnostics.explain.evidence import accumulators, frozen_words
from fsai_vcu.diagnostics.explain.incident import Candidate, ChainLink, Sureness, candidate
from fsai_vcu.diagnostics.explain.record import GONE_NS, Record
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.interface.enums import AsState, MissionStatus
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
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS, ms

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
    words = [f"0x{i:03X} does not come" for i in missing if i not in record.wrong_length]
    words += [f"0x{i:03X} has {record.wrong_length[i].words}" for i in missing if i in record.wrong_length]
    return ChainLink(max(int(record.newest_ns(missing[0], t_ns)), record.begin_ns), ", ".join(words), missing[0])


def _power_cycle(record: Record, t_ns: int) -> ChainLink | None:
    if record.like_official_simulator:
        return None  # ASMS alone resets it
    run = record.series(sig.AS_STATE).last(t_ns, *record.revision.power_cycle_after)
    if run is None or any(run.end_ns <= g.begin_ns <= t_ns for g in record.gaps(sig.STATUS, GONE_NS)):
        return None
    ended = f"the last run ended in {label(sig.AS_STATE, run.value)}"
    words = f"{ended}, and 0x520 has not stopped since: the car was not switched off"
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
    """The vehicle state up to `t_ns`, as a bridge would have it, and its history."""
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
    """The conditions of a state that do not hold at `t_ns`: those to be put right first, then those that follow."""
    found = []
    for condition, source, evidence, follows in conditions_unmet(moment(record, t_ns), state):
        signal = _SIGNALS.get(source)
        span = None if signal is None else record.span_at(signal, t_ns)
        if signal is None:
            step = _HISTORY[condition.slug](record, t_ns)
        elif span is None:
            continue  # of a message that never came, whose values nobody has said
        else:
            step = signal.step(span.begin_ns, evidence, signal.was(span.value, span.begin_ns, t_ns))
        assert step is not None
        sureness = Sureness.FITS if follows else Sureness.SHOWN
        more = accumulators(record, t_ns) if condition.slug == "ebs_not_armed" else []
        found.append(candidate(named(condition.slug, record, t_ns), sureness, step, *more))
    return found


def named(slug: str, record: Record, t_ns: int) -> str:
    """The car's own name for a fault, and what is wrong with messages that count as missing: they say what to do."""
    if slug == "ai_data_incomplete":
        missing = [i for i in AI_IDS if t_ns - record.newest_ns(i, t_ns) >= RECENT_NS]
        return "ai_message_length" if set(missing) <= record.wrong_length.keys() else slug
    names = (FAULT_BITS[signal.name] for signal in sig.FAULTS if signal != sig.COMMS_LOST and record.at(signal, t_ns))
    return next(names, slug) if slug == "fault" else slug


def all_met(state: AsState, record: Record, t_ns: int) -> Candidate:
    """The candidate that is left where no condition is seen to be missing: each was seen met, or some were not seen."""
    shown, unseen = seen_met(moment(record, t_ns), state)
    fresh = {
        _SIGNALS[source]: words
        for source, words in shown.items()
        if len(record.series(_SIGNALS[source])) and t_ns - record.newest_ns(_SIGNALS[source].can_id, t_ns) < RECENT_NS
    }
    stale = [_SIGNALS[source].name for source in shown if _SIGNALS[source] not in fresh]
    steps = [
        signal.step(t_ns, words, signal.was(record.at(signal, t_ns) or 0.0, t_ns)) for signal, words in fresh.items()
    ]
    if lacking := (*stale, *unseen):
        steps.append(ChainLink(t_ns, f"not seen: {', '.join(dict.fromkeys(lacking))}"))
    return candidate("start_unclear" if lacking else "start_unknown", Sureness.POSSIBLE, *steps)


def sentence(one: Candidate) -> str:
    """The cause of a refusal with what shows it, in the words of everybody who says why a car does not drive."""
    shows = one.steps[-1 if one.slug == "start_unclear" else 0].words
    return one.cause.words if one.slug == "start_unknown" else Obstacle(one.slug, one.cause.words, shows).sentence
