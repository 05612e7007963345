"""The page itself: one HTML file, its own style and script inside, and a policy that forbids everything else."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterator
from html import escape
from importlib.resources import files
from typing import Any, Final

from fsai_vcu.diagnostics.explain import Explanation, Incident, IncidentKind
from fsai_vcu.diagnostics.explain.incident import Candidate, Sureness, Weight
from fsai_vcu.diagnostics.explain.record import Record, Series
from fsai_vcu.diagnostics.explain.render import before, extent, seconds
from fsai_vcu.diagnostics.report.curves import Plot, lanes, packed, plots, plots_of
from fsai_vcu.diagnostics.report.summary import drawing, figures, way_of
from fsai_vcu.diagnostics.statistics.measure import BusStatistics, measure
from fsai_vcu.diagnostics.verdict import Verdict, judge_log

EVENTS: Final = 2000  # more lines than that nobody reads on a page; explain has them all
_ALSO: Final = 3

Chosen = dict[str, list[tuple[str, Series]]]


def page_of(record: Record, story: Explanation, name: str, chosen: Chosen | None = None) -> str:
    """The page of a log that is sorted already; `chosen`: signals to be plotted too, by unit."""
    style, script = _part("page.css"), _part("page.js")
    policy = (
        f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; img-src data:;"
        " base-uri 'none'; form-action 'none'"
    )
    drawn = [*plots_of(chosen or {}), *plots(record)]
    buses = measure(record.frames, record.decoder, revision=record.revision.name)
    verdict = judge_log(record, story, buses)
    return "".join(
        (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">\n',
            f"<title>{escape(name)}: {escape(verdict.line())}</title>\n<style>{style}</style>\n</head>\n<body>\n",
            *_head(story, verdict, name),
            "<main>\n",
            *_findings(verdict),
            *_incidents(story),
            *_summary(record),
            *_plots(drawn),
            *_events(story),
            *_figures(buses[0]),
            "</main>\n<footer>Made by <code>fsai-vcu report</code> from the frames alone.</footer>\n",
            f'<script type="application/json" id="data">{_data(record, story, drawn)}</script>\n',
            f"<script>{script}</script>\n</body>\n</html>\n",
        )
    )


def _part(name: str) -> str:
    return files("fsai_vcu.diagnostics.report").joinpath(name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _data(record: Record, story: Explanation, drawn: list[Plot]) -> str:
    data = {
        "seconds": round((record.end_ns - record.begin_ns) / 1e9, 4),
        "plots": [
            {
                "slug": plot.slug,
                "unit": plot.unit,
                "digits": plot.digits,
                "curves": [packed(curve, plot.digits, record.begin_ns, record.end_ns) for curve in plot.curves],
            }
            for plot in drawn
        ],
        "lanes": lanes(record),
        "marks": [[round(seconds(story, i.t_ns), 4), i.kind.words, i.bad] for i in story.incidents],
    }
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")


# ---------------------------------------------------------------- what is read


def _head(story: Explanation, verdict: Verdict, name: str) -> Iterator[str]:
    heading = story.heading
    yield f"<header>\n<h1>{escape(name)}</h1>\n"
    yield f'<p class="verdict {"good" if verdict.ok else "bad"}">{escape(verdict.line())}</p>\n'
    yield (
        f"<p>{escape(extent(story))};"
        f" interface revision {escape(heading['revision'])} ({escape(heading['revision_reason'])});"
        f" {escape(story.closing)}.</p>\n"
    )
    if story.problems:
        yield "<ul class=notes>" + "".join(f"<li>{escape(problem)}</li>" for problem in story.problems) + "</ul>\n"
    yield "</header>\n"


def _findings(verdict: Verdict) -> Iterator[str]:
    """What check says of the log; incidents have articles of their own."""
    kinds = {kind.slug for kind in IncidentKind}
    shown = [finding for finding in verdict.findings if finding.kind not in kinds]
    if not shown:
        return
    yield '<section aria-labelledby="bus"><h2 id="bus">On the bus</h2>\n<ul class="notes">\n'
    for finding in shown:
        remedy = f" <b>What to do:</b> {escape(finding.remedy)}." if finding.remedy else ""
        yield f"<li><b>{finding.severity.value}</b>: {escape(verdict.moment(finding) + finding.text)}.{remedy}</li>\n"
    yield "</ul></section>\n"


def _incidents(story: Explanation) -> Iterator[str]:
    if not story.incidents:
        return
    yield '<section aria-labelledby="why"><h2 id="why">What happened, and why</h2>\n'
    for incident in story.incidents:
        yield from _incident(story, incident)
    yield "</section>\n"


def _summary(record: Record) -> Iterator[str]:
    way = way_of(record)
    yield '<section aria-labelledby="run"><h2 id="run">The run</h2>\n<dl>'
    yield "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in figures(record, way)) + "</dl>\n"
    picture = drawing(way)
    if picture:
        yield f"<figure><figcaption>The way driven, by wheels and steering</figcaption>{picture}</figure>\n"
    yield "</section>\n"


def _incident(story: Explanation, incident: Incident) -> Iterator[str]:
    first = incident.candidates[0]
    at_s = seconds(story, incident.t_ns)
    planned = " (as planned)" if incident.planned else ""
    yield f'<article class="{"bad" if incident.bad else "calm"}">\n<h3>{escape(incident.kind.words)}{planned} at '
    yield f'<button type="button" class="time" data-t="{at_s:.4f}">{at_s:.3f} s</button></h3>\n'
    yield f"<p>{escape(incident.what)}</p>\n<p><b>Because {escape(first.cause.words)}.</b></p>\n"
    yield from _chain(incident, first)
    yield f"<p><b>What to do:</b> {escape(first.cause.remedy)}.</p>\n"
    if first.sureness < Sureness.SHOWN:
        yield f"<p>How sure: this {escape(first.sureness.words)}; the log does not prove it.</p>\n"
    if record := story.to_record(first.cause):
        yield f"<p>To know more, record next time: {escape(record)}.</p>\n"
    others = incident.candidates[1 : 1 + _ALSO]
    if others:
        yield "<p>Also:</p><ul>"
        for other in others:
            why = f"{other.cause.words} ({other.sureness.words}): {other.steps[0].words}"
            yield f"<li>{escape(why)}</li>"
        yield "</ul>\n"
    yield "</article>\n"


def _chain(incident: Incident, one: Candidate) -> Iterator[str]:
    yield '<ol class="chain">'
    for step in one.steps:
        signal = f" <code>{escape(step.signal)}</code>" if step.signal and step.signal not in step.words else ""
        frame = f"<code>{escape(step.frame)}</code> " if step.frame else ""
        apart = escape(before(incident.t_ns, step))
        yield f'<li><span class="apart">{apart}</span> {frame}{escape(step.words)}{signal}</li>'
    yield "</ol>\n"


def _plots(drawn: list[Plot]) -> Iterator[str]:
    yield '<section aria-labelledby="plots"><h2 id="plots">Over time</h2>\n'
    yield (
        '<div class="tools" role="toolbar" aria-label="time shown"><button type="button" data-do="out">−</button>'
        '<button type="button" data-do="in">+</button><button type="button" data-do="back">◀</button>'
        '<button type="button" data-do="on">▶</button><button type="button" data-do="all">all</button>'
        '<output id="range"></output></div>\n'
        '<p class="hint">Drag to zoom, double-click for all; on a phone two fingers. Keys in a plot: arrows, + − 0.'
        "</p>\n"
    )
    yield (
        '<figure><figcaption>States <span class="legend" id="legend-lanes"></span></figcaption>'
        '<canvas id="lanes" tabindex="0" role="img" aria-label="AS state, mission, switches and faults over time; the'
        ' timeline below has the same in words"></canvas></figure>\n'
    )
    for plot in drawn:
        legend = "".join(
            f'<span class="key c{number}{" quiet" if curve.quiet else ""}">{escape(curve.name)} <b></b></span>'
            for number, curve in enumerate(plot.curves)
        )
        yield (
            f"<figure><figcaption>{escape(plot.title)}, {escape(plot.unit)}"
            f' <span class="legend" id="legend-{plot.slug}">{legend}</span></figcaption>'
            f'<canvas id="plot-{plot.slug}" tabindex="0" role="img" aria-label="{escape(plot.summary())}"></canvas>'
            "</figure>\n"
        )
    yield "</section>\n"


def _events(story: Explanation) -> Iterator[str]:
    weights = {Weight.FAULT: "fault", Weight.WARNING: "warning", Weight.STATE: "state", Weight.NOTE: "note"}
    count = len(story.events)
    yield f'<section><details open><summary><h2>Timeline</h2> {count} events</summary>\n<ol class="events">'
    for event in story.events[:EVENTS]:
        at_s = seconds(story, event.t_ns)
        frame = f" <code>0x{event.can_id:03X}</code>" if event.can_id is not None else ""
        yield (
            f'<li class="{weights[event.weight]}"><button type="button" class="time" data-t="{at_s:.4f}">{at_s:.3f} s'
            f'</button> <span class="topic">{escape(event.topic)}</span> <span>{escape(event.text)}{frame}</span></li>'
        )
    yield "</ol>\n"
    if count > EVENTS:
        yield f"<p>… and {count - EVENTS} more: <code>fsai-vcu explain</code> has them all.</p>\n"
    yield "</details></section>\n"


# ---------------------------------------------------------------- figures


def _figures(bus: BusStatistics) -> Iterator[str]:
    yield '<section aria-labelledby="figures"><h2 id="figures">Figures</h2>\n'
    yield from _bus(bus)
    titles = ("id", "message", "frames", "expected ms", "mean ms", "p99 ms", "max ms", "gaps", "load %")
    yield '<div class="scroll" tabindex="0" role="region" aria-label="figures of each message"><table><thead><tr>'
    yield "".join(f'<th scope="col">{title}</th>' for title in titles) + "</tr></thead>\n<tbody>"
    for message in sorted(bus.messages, key=lambda m: (m.extended, m.can_id)):
        cells: tuple[Any, ...] = (
            f"0x{message.can_id:03X}",
            message.name or "unknown",
            message.count,
            _number(message.expected_ms, 0),
            _number(message.mean_ms),
            _number(message.interval.p99_ms),
            _number(message.interval.max_ms),
            message.gaps,
            _number(100.0 * message.load),
        )
        row = "".join(f"<td>{escape(str(cell))}</td>" for cell in cells[1:])
        yield f'<tr class="{"late" if message.gaps else ""}"><th scope="row">{cells[0]}</th>{row}</tr>\n'
    yield "</tbody></table></div></section>\n"


def _bus(bus: BusStatistics) -> Iterator[str]:
    facts = [("bus load", f"{100 * bus.load:.1f} %, {100 * bus.peak_load:.1f} % at most over 100 ms")]
    if bus.handshake is not None and bus.handshake.answered:
        spread = bus.handshake.response
        times = f"p50 {_number(spread.p50_ms)}, p99 {_number(spread.p99_ms)}, max {_number(spread.max_ms)} ms"
        unanswered = f", {bus.handshake.unanswered} unanswered" if bus.handshake.unanswered else ""
        facts.append(("handshake response", f"{bus.handshake.answered} echoes{unanswered}: {times}"))
    errors = sum(bus.error_frames.values())
    facts.append(("error frames", str(errors) if errors else "none"))
    yield "<dl>" + "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts) + "</dl>\n"


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
