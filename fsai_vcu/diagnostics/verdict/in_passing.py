"""Findings on what the car did beside what incidents are made of: limits, warnings, restarts, a repeated 0x520."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import Explanation
from fsai_vcu.diagnostics.explain.evidence import AT_ONCE_NS, frozen_words
from fsai_vcu.diagnostics.explain.incident import TimeRange, within
from fsai_vcu.diagnostics.explain.record import REBOOT_NS, Record
from fsai_vcu.diagnostics.explain.signals import (
    AS_STATE,
    CAR_TORQUE_MAX,
    DRIVING,
    GO,
    PULSES,
    STATUS,
    WARNINGS,
    label,
)
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS
from fsai_vcu.interface.units import ms

OFF: Final = float(AsState.AS_OFF)
NEARLY_FULL: Final = 65_000  # a counter of 16 bits goes on at 0
FEW_PULSES: Final = 10
OUT_OF_ORDER_NS: Final = 2 * PERIOD_NS
LOW_SHARE: Final = 0.5  # of the most that TRQ_MAX was in AS_DRIVING


def in_passing(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    """Yield what the car did beside the matter of incidents: the first of each kind, and how often."""
    state = record.series(AS_STATE)
    found: list[tuple[int, str, str, int]] = []
    for kind, signal in (*(("torque-limit", each) for each in CAR_TORQUE_MAX), ("go", GO)):
        series = record.series(signal)
        most = series.values[state.sampled(series.t_ns) == DRIVING].max(initial=0.0)
        below = series.values <= (LOW_SHARE * most if kind == "torque-limit" else 0.0)
        spans = replace(series, values=below.astype(np.float64)).spans
        drives = [state.sampled(spans.begin_ns + later_ns) == DRIVING for later_ns in (0, COMMS_LOST_NS)]
        rows = np.flatnonzero(np.logical_and.reduce([spans.values * most > 0.0, ~spans.apart[:-1], *drives]))
        falls = [*within(part_ns, (spans[row] for row in rows.tolist()))]
        for span in falls[:1]:
            least = series.between(span.begin_ns, max(span.begin_ns, span.end_ns - 1)).values.min()
            length = ms(span.end_ns - span.begin_ns)
            words = f"{signal.name} falls to {least:g} in AS_DRIVING for {length}, and AS_STATE does not change"
            found.append((span.begin_ns, kind, words, len(falls)))
    for warning in WARNINGS:
        spans = record.series(warning).spans
        warned = [*within(part_ns, spans.of(1.0))]
        for span in warned[:1]:
            where = label(AS_STATE, state.at(span.begin_ns))
            words = f"{warning.name} is 1 for {ms(span.end_ns - span.begin_ns)}, from {where} on"
            found.append((span.begin_ns, "warning", words, len(warned)))
    for cycle in list(within(part_ns, record.power_cycles))[:1]:
        found.append((cycle.begin_ns, "power-cycle", cycle.words, len(record.power_cycles)))
    off = np.array([gap.end_ns or 0 for gap in record.gaps(STATUS, REBOOT_NS)])  # switched off: it has to start again
    off = np.append(off, [cycle.end_ns for cycle in record.power_cycles])
    for signal in (AS_STATE, *PULSES):
        t_ns, values = record.series(signal).t_ns, record.series(signal).values
        # Frames out of order are made up for at once, and a wheel that rolls back does not begin near 0.
        if signal == AS_STATE:
            was, low = values == OFF, values - 1
        else:
            was, low = values < NEARLY_FULL, np.minimum(values / 2, values - FEW_PULSES)
        rows = np.flatnonzero(was[:-1] & (values[1:] <= low[:-1])) + 1
        rows = rows[record.series(signal).sampled(t_ns[rows] + OUT_OF_ORDER_NS) <= low[rows - 1]]
        rows = rows[~(np.abs(t_ns[rows, None] - off) < REBOOT_NS).any(axis=1)]
        rows = rows[(t_ns[rows] >= part_ns[0]) & (t_ns[rows] <= part_ns[1])]
        if len(rows):
            before, after = (label(signal, float(value)) for value in values[rows[0] - 1 : rows[0] + 1])
            words = f"the VCU started again: {signal.name} {before} → {after}"
            found.append((int(t_ns[rows[0]]), "restart", words, len(rows)))
    for kind in ("power-cycle", "torque-limit", "warning", "go", "restart"):
        for begin_ns, _, words, count in sorted(each for each in found if each[1] == kind)[:1]:
            remedy = remedy_of("vcu_reboot", record.setting) if kind == "restart" else ""
            more = f", {count} times in all" if count > 1 else ""
            yield Finding("note", kind, f"{words}{more}", remedy, begin_ns, channel=record.channel)


def frozen(record: Record, part_ns: TimeRange, explanation: Explanation) -> Iterator[Finding]:
    """0x520 that comes and repeats itself: the first time, and how many; not what an incident has for its cause."""
    told_ns = [incident.t_ns for incident in explanation.incidents]
    found = [
        span
        for span in within(part_ns, record.frozen)
        if not any(span.begin_ns <= t_ns <= span.end_ns + AT_ONCE_NS for t_ns in told_ns)
    ]
    for span in found[:1]:
        more = f", {len(found)} times in all" if len(found) > 1 else ""
        where = (remedy_of("status_frozen"), span.begin_ns, (STATUS,), record.channel)
        text = f"{frozen_words(record, span)}: the VCU hung, or its 0x520 froze{more}"
        yield Finding("problem", "frozen", text, *where)


def perhaps_frozen(record: Record, part_ns: TimeRange) -> Iterator[str]:
    for span in islice(within(part_ns, record.perhaps_frozen), 1):
        yield (
            f"{frozen_words(record, span)}, with the ASMS off: the VCU froze, or does not toggle HANDSHAKE "
            "while the car is driven by hand; a log with the ASMS on would show which"
        )
