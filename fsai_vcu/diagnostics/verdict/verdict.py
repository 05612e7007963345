"""The verdict on a log as people and programs read it: findings, what is not known, the exit status."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from itertools import groupby
from typing import Any, Final

from fsai_vcu.diagnostics.explain import Explanation
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.frames import EPOCH_NS
from fsai_vcu.interface.units import S

UNREAD: Final = "not everything could be read"


@dataclass(frozen=True, slots=True)
class Verdict:
    """`unknown`: what could not be judged, and why; where there is such a thing nothing is called OK. chosen: a filter
    left messages out, and of those nothing is said.
    """

    begin_ns: int
    explanation: Explanation
    findings: tuple[Finding, ...]
    unknown: tuple[str, ...] = ()
    chosen: bool = False

    @property
    def problems(self) -> int:
        return sum(finding.severity == "problem" for finding in self.findings)

    @property
    def ok(self) -> bool:
        return not self.problems and not self.unknown

    @property
    def status(self) -> int:
        """The exit status of every verb that judges a log."""
        return 0 if self.ok else 1

    def unread(self, unread: bool) -> Verdict:
        """The same of a log that could not be read whole, where that is so."""
        return replace(self, unknown=(UNREAD, *self.unknown)) if unread else self

    def line(self) -> str:
        """Return the verdict in one line, without findings."""
        notes = len(self.findings) - self.problems
        end = ", of the chosen messages alone" if self.chosen else ""
        end += f" ({notes} note{'s' * (notes > 1)})" if notes else ""
        if self.problems:
            return f"NOT OK: {self.problems} problem{'s' * (self.problems > 1)}{end}"
        if self.unknown:
            return f"UNKNOWN: {self.unknown[0]}{end}"
        return f"OK{end}"

    def lines(self, *, remedies: bool = True) -> Iterator[str]:
        """The findings as people read them, and what to do: once for those beside each other with one remedy."""
        yield from (f"unknown: {why}" for why in self.unknown)
        for remedy, findings in groupby(self.findings, lambda finding: finding.remedy):
            yield from (f"{finding.severity}: {self.moment(finding)}{finding.words}" for finding in findings)
            if remedy and remedies:
                yield f"    what to do: {remedy}."

    def moment(self, finding: Finding) -> str:
        """Return the moment: seconds since the log's first frame, and the time of day where the log has one."""
        if finding.t_ns is None:
            return ""
        clock = (
            f" ({datetime.fromtimestamp(finding.t_ns / S, timezone.utc):%H:%M:%S} UTC)"
            if self.begin_ns > EPOCH_NS
            else ""
        )
        return f"at {(finding.t_ns - self.begin_ns) / S:.3f} s{clock}: "

    def as_dicts(self) -> Iterator[dict[str, Any]]:
        """The findings, then the verdict, for JSON."""
        for finding in self.findings:
            yield {
                "type": "finding",
                "severity": finding.severity,
                "kind": finding.kind,
                "text": finding.words,
                "t_s": None if finding.t_ns is None else round((finding.t_ns - self.begin_ns) / S, 6),
                "t_ns": finding.t_ns,
                "remedy": finding.remedy or None,
                "ids": list(finding.can_ids),
                "channel": finding.channel,
            }
        word = "ok" if self.ok else "not ok" if self.problems else "unknown"
        notes = len(self.findings) - self.problems
        yield {
            "type": "verdict",
            "verdict": word,
            "problems": self.problems,
            "notes": notes,
            "unknown": list(self.unknown),
            "words": self.line(),
        }
