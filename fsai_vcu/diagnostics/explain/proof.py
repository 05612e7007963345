"""Each sentence of a cause is held against the frames that it cites; a sentence that they deny is not said.

A rule finds a cause, and its words say more than the rule looked at: that a switch stayed off, that a limit was 0 all
the time, that something never came. These claims are written beside the words, and checked here, in one place.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from fsai_vcu.diagnostics.explain.incident import Candidate, ChainLink, Claim, Incident, Sureness, candidate
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.explain.signals import Signal


def holds(record: Record, claim: Claim) -> bool:
    """True where the frames say the same. Where no frame had the signal by then, they do not."""
    series = record.series(Signal(*claim.signal))
    first = series.at(claim.begin_ns)
    values = series.between(claim.begin_ns, claim.end_ns).values
    if first is None:
        return False
    return bool(claim.low <= first <= claim.high and ((values >= claim.low) & (values <= claim.high)).all())


def denied(record: Record, steps: Iterable[ChainLink]) -> Iterable[Claim]:
    """The claims of these sentences that the frames do not bear out."""
    return (claim for step in steps for claim in step.claims if not holds(record, claim))


def _stands(record: Record, one: Candidate) -> bool:
    return not any(True for _ in denied(record, one.steps))


def proved(record: Record, incident: Incident) -> Incident:
    """The incident with the causes that the frames bear out."""
    kept = tuple(one for one in incident.candidates if _stands(record, one))
    if len(kept) == len(incident.candidates):
        return incident
    bare = [replace(step, claims=()) for step in incident.candidates[0].steps if not step.claims]
    bare = bare or [ChainLink(incident.t_ns, incident.what)]
    return replace(incident, candidates=kept or (candidate("unknown", Sureness.POSSIBLE, *bare),))
