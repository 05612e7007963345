"""The page itself: one HTML file, its own style and script inside, and a policy that forbids everything else."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Iterator
from html import escape
from importlib.resources import files
from typing import Any, Final

from fsai_vcu.diagnostics.explain import Explanation, Incident, IncidentKind
from fsai_vcu.diagnostics.explain.incident import Candidate, Sureness
from fsai_vcu.diagnostics.explain.record import Record, Series
from fsai_vcu.diagnostics.explain.render import before, extent, seconds
from fsai_vcu.diagnostics.report.curves import Plot, drawing, figures, lanes, packed, plots, plots_of, way_of
from fsai_vcu.diagnostics.statistics.measure import BusStatistics
from fsai_vcu.diagnostics.verdict import Judged, Verdict

EVENTS: Final = 2000  # more lines than that nobody reads on a page; explain has them all
_ALSO: Final = 3

Chosen = dict[str, list[tuple[str, Series]]]


def page_of(judged: Judged, name: str, chosen: Chosen | None = None) -> str:
    """The page of a log, or of a part of it; `chosen`: signals to be plotted too, by unit."""
    record, verdict, bus = judged.record, judged.verdict, judged.bus
    style, script = _part("page.css"), _part("page.js")
    policy = (
        f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; img-src data:;"
        " base-uri 'none'; form-action 'none'"
    )
    drawn = [*plots_of(chosen or {}), *plots(record)]
    story = verdict.explanation
    return "".join(
        (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">\n',
            f"<title>{escape(name)}: {escape(verdict.line())}</title>\n<style>{style}</style>\n</head>\n<body>\n",
            *_head(story, verdict, name),
            "<main>\n",
            _findings(verdict),
            _section("why", "What happened, and why", *_incidents(story)) if story.incidents else "",
            _summary(record, bus),
            _section("plots", "Over time", *_plots(drawn)),
            *_events(story),
            _section("figures", "Figures", *_figures(bus)),
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
    zero_ns = int(story.heading["begin_ns"])
    times_ns = zero_ns, record.begin_ns, record.end_ns
    data = {
        "extent": [round(seconds(story, t_ns), 4) for t_ns in (record.begin_ns, record.end_ns)],
        "plots": [
            {
                "slug": plot.slug,
                "unit": plot.unit,
                "digits": plot.digits,
                "curves": [packed(curve, plot.digits, *times_ns) for curve in plot.curves],
            }
            for plot in drawn
        ],
        "lanes": lanes(record, zero_ns),
        "marks": [[round(seconds(story, i.t_ns), 4), i.kind.words, not i.planned] for i in story.incidents],
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


def _section(slug: str, title: str, *content: str) -> str:
    inside = "".join(content)
    return f'<section aria-labelledby="{slug}"><h2 id="{slug}">{title}</h2>\n{inside}</section>\n'


def _facts(facts: Iterable[tuple[str, str]]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts) + "</dl>\n"


def _moment(at_s: float) -> str:
    return f'<button type="button" class="time" data-t="{at_s:.4f}">{at_s:.3f} s</button>'


def _findings(verdict: Verdict) -> str:
    """What check says of the log; incidents have articles of their own."""
    kinds = {kind.slug for kind in IncidentKind}
    shown = "".join(f'<li class="problem"><b>unknown</b>: {escape(why)}.</li>\n' for why in verdict.unknown)
    for finding in verdict.findings:
        if finding.kind not in kinds:
            remedy = f" <b>What to do:</b> {escape(finding.remedy)}." if finding.remedy else ""
            text = escape(verdict.moment(finding) + finding.words)
            shown += f'<li class="{finding.severity}"><b>{finding.severity}</b>: {text}.{remedy}</li>\n'
    return _section("bus", "On the bus", f'<ul class="notes">\n{shown}</ul>') if shown else ""


def _summary(record: Record, bus: BusStatistics) -> str:
    way = way_of(record)
    caption = "<figcaption>The way driven, by wheels and steering</figcaption>"
    picture = drawing(way)
    figure = f"<figure>{caption}{picture}</figure>\n" if picture else ""
    return _section("run", "The run", _facts([*figures(record, way), *_bus(bus)]), figure)


def _incidents(story: Explanation) -> Iterator[str]:
    for incident in story.incidents:
        planned = " (as planned)" if incident.planned else ""
        when = _moment(seconds(story, incident.t_ns))
        yield f'<article class="{"calm" if incident.planned else "bad"}">\n'
        yield f"<h3>{escape(incident.kind.words)}{planned} at {when}</h3>\n"
        first = incident.candidates[0]
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


def _events(story: Explanation) -> Iterator[str]:
    count = len(story.events)
    yield f'<section><details open><summary><h2>Timeline</h2> {count} events</summary>\n<ol class="events">'
    for event in story.events[:EVENTS]:
        when = _moment(seconds(story, event.t_ns))
        frame = f" <code>0x{event.can_id:03X}</code>" if event.can_id is not None else ""
        text = f'<span class="topic">{escape(event.topic)}</span> <span>{escape(event.text)}{frame}</span>'
        yield f'<li class="{event.weight.name.lower()}">{when} {text}</li>'
    yield "</ol>\n"
    if count > EVENTS:
        yield f"<p>… and {count - EVENTS} more: <code>fsai-vcu explain</code> has them all.</p>\n"
    yield "</details></section>\n"


# ---------------------------------------------------------------- figures


def _figures(bus: BusStatistics) -> Iterator[str]:
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
            _number(message.interval_ms.p99_ms),
            _number(message.interval_ms.max_ms),
            message.gaps,
            _number(100.0 * message.load),
        )
        row = "".join(f"<td>{escape(str(cell))}</td>" for cell in cells[1:])
        yield f'<tr class="{"late" if message.gaps else ""}"><th scope="row">{cells[0]}</th>{row}</tr>\n'
    yield "</tbody></table></div>"


def _bus(bus: BusStatistics) -> Iterator[tuple[str, str]]:
    yield "bus load", f"{100 * bus.load:.1f} %, {100 * bus.peak_load:.1f} % at most over 100 ms"
    if bus.handshake is not None and bus.handshake.answered:
        spread = bus.handshake.response_ms
        times = f"p50 {_number(spread.p50_ms)}, p99 {_number(spread.p99_ms)}, max {_number(spread.max_ms)} ms"
        unanswered = f", {bus.handshake.unanswered} unanswered" if bus.handshake.unanswered else ""
        yield "handshake response", f"{bus.handshake.answered} echoes{unanswered}: {times}"
    yield "error frames", str(sum(bus.error_frames.values()) or "none")


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
