"""An explanation as people read it, and as programs do."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from datetime import datetime, timezone
from typing import Any, Final

from fsai_vcu.diagnostics.explain.incident import (
    Candidate,
    ChainLink,
    Explanation,
    Incident,
    IncidentKind,
    Sureness,
    Weight,
)
from fsai_vcu.diagnostics.log.frames import EPOCH_NS

WIDTH: Final = 110
_ALSO: Final = 3  # further candidates in full sentences
_ASKED: Final = "ai_computer_request"
_COLOURS: Final = {Weight.FAULT: "31;1", Weight.WARNING: "33", Weight.STATE: "1", Weight.NOTE: "2"}


def seconds(story: Explanation, t_ns: int) -> float:
    """Seconds since the log's first frame."""
    return (t_ns - int(story.heading["begin_ns"])) / 1e9


def extent(story: Explanation) -> str:
    """Say how long the log is, of which bus, and when it began."""
    heading, began = story.heading, int(story.heading["begin_ns"])
    when = f", {datetime.fromtimestamp(began / 1e9, timezone.utc):%Y-%m-%d %H:%M:%S} UTC" if began > EPOCH_NS else ""
    return f"{heading['seconds']:.1f} s, {heading['frames']} frames on {heading['channel']}{when}"


# ---------------------------------------------------------------- for people


def text_lines(story: Explanation, name: str, *, timeline: bool = False, colour: bool = False) -> Iterator[str]:
    """The explanation as lines: each cause with what to do. `timeline`: all that happened before it, and what to record
    next time; the answer stands at the end, where the eye is.
    """

    def paint(text: str, code: str) -> str:
        return f"\033[{code}m{text}\033[0m" if colour and code else text

    heading = story.heading
    yield paint(f"{name}: {extent(story)}", "1")
    if timeline:
        yield f"interface revision {heading['revision']} ({heading['revision_reason']})"
    for problem in story.problems:
        yield paint(f"note: {problem}", "33")
    if timeline:
        yield ""
    for event in story.events if timeline else ():
        where = f"  [0x{event.can_id:03X}]" if event.can_id is not None else ""
        text = paint(event.text, _COLOURS[event.weight])
        yield f"{seconds(story, event.t_ns):9.3f} s  {event.topic:<9} {text}{paint(where, '2')}"
    if timeline:
        yield f"{seconds(story, story.end_ns):9.3f} s  {'':<9} {story.closing}"
    else:
        yield story.closing
    for incident in story.incidents:
        yield ""
        yield from _incident_lines(story, incident, paint, more=timeline)
    yield ""
    yield paint(verdict(story), "32;1" if story.clean else "31;1")


def _incident_lines(story: Explanation, incident: Incident, paint: Any, *, more: bool) -> Iterator[str]:
    """Yield the lines of an incident; `more`: also what to record next time."""
    colour = "33;1" if incident.planned else "31;1"
    planned = " (as planned)" if incident.planned else ""
    what = incident.what.removeprefix("EMERGENCY_BRAKE ") if incident.kind is IncidentKind.EMERGENCY else incident.what
    heading = f"{incident.kind.words.upper()} at {seconds(story, incident.t_ns):.3f} s{planned}: {what}"
    yield paint(heading, colour)
    first = incident.candidates[0]
    yield from _wrapped(f"because {first.cause.words}", "  ", paint, "1")
    yield from _chain(incident, first, paint)
    yield from _wrapped(f"what to do: {first.cause.remedy}.", "  ", paint)
    if first.sureness < Sureness.SHOWN:
        yield from _wrapped(f"how sure: this {first.sureness.words}; the log does not prove it.", "  ", paint)
    record = story.to_record(first.cause) if more else ""
    if record:
        yield from _wrapped(f"to know more, record next time: {record}.", "  ", paint)
    told = {step.words for step in first.steps}
    for other in incident.candidates[1 : 1 + _ALSO]:
        seen = other.steps[0].words
        if other.slug == _ASKED and seen in told:
            continue  # the same, without what made it ask
        words = ". ".join((other.cause.words, *([] if seen in told else [seen])))
        yield from _wrapped(f"also ({other.sureness.words}): {words}.", "  ", paint)
        if other.sureness >= Sureness.SHOWN:
            yield from _wrapped(f"what to do: {other.cause.remedy}.", "      ", paint)


def _chain(incident: Incident, one: Candidate, paint: Any) -> Iterator[str]:
    for step in one.steps:
        frame = f"{step.frame:<22}" if step.frame else " " * 22
        signal = f" [{step.signal}]" if step.signal and step.signal not in step.words else ""
        yield f"    {before(incident.t_ns, step):>12}  {paint(frame, '36')}  {step.words}{paint(signal, '2')}"


def before(t_ns: int, step: ChainLink) -> str:
    """Say how long before (or after) the incident the step was."""
    apart_ms = (step.t_ns - t_ns) / 1e6
    if abs(apart_ms) < 0.05:
        return "0 ms"
    if abs(apart_ms) >= 1000:
        return f"{apart_ms / 1000:+.2f} s"
    return f"{apart_ms:+.1f} ms" if abs(apart_ms) < 10 else f"{apart_ms:+.0f} ms"


def _wrapped(text: str, indent: str, paint: Any, code: str = "") -> Iterator[str]:
    for line in textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent + "  "):
        yield paint(line, code)


def verdict(story: Explanation) -> str:
    """One line that ends the explanation."""
    counts = [(kind, sum(i.kind is kind and not i.planned for i in story.incidents)) for kind in IncidentKind]
    bad = [f"{count} {kind.one if count == 1 else kind.many}" for kind, count in counts if count]
    planned = any(incident.planned for incident in story.incidents)
    rest = ["the emergency brake that the mission ends with"] if planned else []
    if not bad and story.unknown:
        return f"{story.unknown} it is unknown whether the car braked or did not start"
    return ", ".join([*bad, *rest]) if bad else "; ".join(["no emergency brake, no refusal to start", *rest])


# ---------------------------------------------------------------- for programs


def json_lines(story: Explanation, name: str) -> Iterator[str]:
    """One object per line: the log, each event, each incident, the summary."""
    yield json.dumps({"type": "log", "log": name, **story.heading, "notes": list(story.problems)})
    for event in story.events:
        yield json.dumps(
            {
                "type": "event",
                "t_s": round(seconds(story, event.t_ns), 6),
                "t_ns": event.t_ns,
                "topic": event.topic,
                "weight": event.weight.name.lower(),
                "text": event.text,
                "frame": None if event.can_id is None else f"0x{event.can_id:03X}",
                "signal": event.signal or None,
            }
        )
    for incident in story.incidents:
        yield json.dumps(incident_dict(story, incident))
    counted = {"emergency_brakes": IncidentKind.EMERGENCY, "refusals": IncidentKind.REFUSAL}
    counted |= {"aborts": IncidentKind.ABORT, "early_stops": IncidentKind.STOP}
    counts = {name: sum(one.kind is kind for one in story.incidents) for name, kind in counted.items()}
    last = {"words": verdict(story), "ends": story.closing}
    yield json.dumps({"type": "summary", "clean": story.clean, **counts, **last})


def incident_dict(story: Explanation, incident: Incident) -> dict[str, Any]:
    """One incident for JSON."""
    return {
        "type": "incident",
        "kind": incident.kind.slug,
        "t_s": round(seconds(story, incident.t_ns), 6),
        "t_ns": incident.t_ns,
        "what": incident.what,
        "planned": incident.planned,
        "bad": not incident.planned,
        "causes": [
            {
                "cause": one.slug,
                "words": one.cause.words,
                "sureness": one.sureness.name.lower(),
                "remedy": one.cause.remedy,
                "record": story.to_record(one.cause) or None,
                "chain": [
                    {
                        "t_s": round(seconds(story, step.t_ns), 6),
                        "before_ms": round((incident.t_ns - step.t_ns) / 1e6, 3),
                        "frame": step.frame or None,
                        "signal": step.signal or None,
                        "words": step.words,
                    }
                    for step in one.steps
                ],
            }
            for one in incident.candidates
        ],
    }
