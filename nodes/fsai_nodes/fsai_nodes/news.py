"""What the bridge has to say that is new: its reports turned into lines for the log. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.reasons import words_of

SAME_REASON_EVERY_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Line:
    text: str
    warning: bool = False


class News:
    """Each change once; a reason that keeps coming up, once a second with its count."""

    def __init__(self) -> None:
        self._seen: dict[str, str] = {}
        self._counts: dict[str, int] = {}
        self._said_ns: dict[str, int] = {}

    def of(self, report: BridgeReport) -> list[Line]:
        lines = [
            Line(text, warning)
            for key, text, quiet, warning in self._facts(report)
            if self._changed(key, text) and not quiet
        ]
        for slug, count in report.reason_counts.items():
            said_ns = self._said_ns.get(slug)
            if count == self._counts.get(slug, 0):
                continue
            if said_ns is not None and report.t_ns - said_ns < SAME_REASON_EVERY_NS:
                continue
            more = count - self._counts.get(slug, 0)
            detail = report.reason_details.get(slug)
            text = words_of(slug) + (f" ({detail})" if detail else "") + (f" [{more} times]" if more > 1 else "")
            lines.append(Line(text, True))
            self._counts[slug] = count
            self._said_ns[slug] = report.t_ns
        return lines

    def _changed(self, key: str, text: str) -> bool:
        changed = self._seen.get(key) != text
        self._seen[key] = text
        return changed

    @staticmethod
    def _facts(report: BridgeReport) -> list[tuple[str, str, bool, bool]]:
        """(key, sentence, nothing worth saying, warning)"""
        as_state = report.run.as_state
        mission = report.run.mission
        return [
            ("mode", f"mode {report.mode}", False, False),
            ("as_state", "AS state " + ("not heard" if as_state is None else as_state.label), as_state is None, False),
            ("run", f"run {report.run.run_id}, mission {mission.label}", False, False),
            ("emergency", f"ESTOP_REQUEST latched: {report.emergency}", report.emergency is None, True),
            ("stopping", f"stopping: {report.stopping}", report.stopping is None, True),
            ("bus", f"bus lost: {report.bus_lost}", report.bus_lost is None, True),
            (
                "shutdown",
                "the car asks for shutdown (SHUTDOWN_REQUEST)" if report.shutdown_requested else "",
                not report.shutdown_requested,
                True,
            ),
        ]
