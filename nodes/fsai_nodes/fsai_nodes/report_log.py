"""News of the bridge: its reports turned into lines for the log. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from msgspec.structs import replace

from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.config import Reason, words_of
from fsai_vcu.diagnostics.explain.causes import CAUSES, SHUTDOWN
from fsai_vcu.interface.enums import AsState

SAME_REASON_EVERY_NS = 1_000_000_000
_STALE = Reason.COMMAND_STALE.slug
_REFUSED = Reason.COMMAND_REFUSED.slug
_LATE_LOOP = Reason.LOOP_FAULT.slug

Level = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True)
class ReportLine:
    """Line for the log, with its level."""

    text: str
    level: Level = "info"


class Culprit:
    """Finder of the node that a stale vehicle command is missing; the core knows only for how long."""

    def __init__(self) -> None:
        self._seen: tuple[int, str | None] = 0, None
        self._silence = ""

    def named(self, report: BridgeReport, whose_silence: Callable[[], str]) -> BridgeReport:
        """The report with it; `whose_silence` is asked when the command becomes stale, and when that stops the car."""
        words = words_of(_STALE)
        stopping = report.stopping if report.stopping and report.stopping.startswith(words) else None
        seen = report.reason_counts.get(_STALE, 0), stopping
        if not seen[0]:
            return report
        if seen != self._seen:
            self._seen = seen
            if _STALE in report.reasons or not self._silence:
                self._silence = whose_silence()
        details = MappingProxyType({**report.reason_details, _STALE: self._silence})
        if stopping is None:
            return replace(report, reason_details=details)
        named = f"{words}: {self._silence}"
        why = tuple(line.replace(stopping, named) for line in report.why_not_driving)
        return replace(report, reason_details=details, stopping=named, why_not_driving=why)


def with_refused(report: BridgeReport, count: int, words: str) -> BridgeReport:
    """The report, with `count` commands that the door refused before they came to the loop; `words`: the last one."""
    if not count:
        return report
    counts = {**report.reason_counts, _REFUSED: report.reason_counts.get(_REFUSED, 0) + count}
    details = {**report.reason_details, _REFUSED: words}
    return replace(report, reason_counts=MappingProxyType(counts), reason_details=MappingProxyType(details))


class News:
    """Each change once; a reason that keeps coming up, once a second with its count."""

    def __init__(self) -> None:
        self._seen: dict[str, str] = {}
        self._counts: dict[str, int] = {}
        self._said_ns: dict[str, int] = {}

    def of(self, report: BridgeReport) -> list[ReportLine]:
        """Return the lines on what is new in this report."""
        lines = [
            ReportLine(text, level)
            for key, text, quiet, level in self._facts(report)
            if self._changed(key, text) and not quiet
        ]
        # The reason is counted in AS_DRIVING only; the report counts every missed deadline.
        counts = {**report.reason_counts, _LATE_LOOP: report.loop_faults}
        for slug, count in counts.items():
            said_ns = self._said_ns.get(slug)
            more = count - self._counts.get(slug, 0)
            if not more or (said_ns is not None and report.t_ns - said_ns < SAME_REASON_EVERY_NS):
                continue
            detail = report.reason_details.get(slug)
            text = words_of(slug) + (f" ({detail})" if detail else "") + (f" [{more} times]" if more > 1 else "")
            lines.append(ReportLine(text, "error" if slug in (_STALE, _LATE_LOOP) else "warning"))
            self._counts[slug] = count
            self._said_ns[slug] = report.t_ns
        return lines

    def _changed(self, key: str, text: str) -> bool:
        changed = self._seen.get(key) != text
        self._seen[key] = text
        return changed

    @staticmethod
    def _facts(report: BridgeReport) -> list[tuple[str, str, bool, Level]]:
        """(key, sentence, nothing worth saying, level)"""
        as_state = report.run.as_state
        mission = report.run.mission
        braking = as_state is AsState.EMERGENCY_BRAKE
        state = "not received" if as_state is None else as_state.label + (f": {_cause_of(report)}" if braking else "")
        return [
            ("mode", f"mode {report.mode}", False, "info"),
            ("as_state", f"AS state {state}", as_state is None, "error" if braking else "info"),
            ("run", f"run {report.run.run_id}, mission {mission.label}", False, "info"),
            ("emergency", f"ESTOP_REQUEST latched: {report.emergency}", report.emergency is None, "warning"),
            ("stopping", f"stopping: {report.stopping}", report.stopping is None, "warning"),
            ("bus", f"bus lost: {report.bus_lost}", report.bus_lost is None, "warning"),
            (
                "shutdown",
                "the car asks for shutdown (SHUTDOWN_REQUEST)" if report.shutdown_requested else "",
                not report.shutdown_requested,
                "warning",
            ),
        ]


def _cause_of(report: BridgeReport) -> str:
    """SHUTDOWN_CAUSE in words."""
    status = report.vehicle.status
    cause = None if status is None else status.shutdown_cause
    if cause is None:
        return "SHUTDOWN_CAUSE is unknown"
    slug = SHUTDOWN.get(cause)
    return f"SHUTDOWN_CAUSE {cause.label}" + ("" if slug is None else f", {CAUSES[slug].words}")
