"""The page as HTML: of a bus, or of a log with its data inside, in parts or as one file with a policy of its own."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Iterator
from html import escape
from importlib.resources import files
from typing import Any, Final

from fsai_vcu.diagnostics.explain import Explanation, Incident, IncidentKind
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import Candidate, Sureness, Weight
from fsai_vcu.diagnostics.explain.record import Series
from fsai_vcu.diagnostics.explain.render import before, extent, seconds
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.diagnostics.page.board import states_of
from fsai_vcu.diagnostics.page.curves import Plot, figures, lanes, packed, packed_way, plots, plots_of, way_of
from fsai_vcu.diagnostics.statistics.measure import BusStatistics
from fsai_vcu.diagnostics.verdict.judging import Judged
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.lights import BAND_ALPHA, LIGHTS

EVENTS: Final = 2000  # more lines than that nobody reads on a page; explain has them all
_ALSO: Final = 3

Chosen = dict[str, list[tuple[str, Series]]]


def part(name: str) -> str:
    """page.html, which is the page of a bus; page.css; page.js."""
    return files("fsai_vcu.diagnostics.page").joinpath(name).read_text(encoding="utf-8")


def of_log(
    judged: Judged,
    name: str,
    chosen: Chosen | None = None,
    *,
    whole: bool = True,
    rate: float | None = None,
    loop: bool = False,
) -> str:
    """The page of a log, or of a part of it.

    chosen: signals to be plotted too, by unit; they come first. whole: one file that opens anywhere; else style and
    script are page.css and page.js beside it. rate: it plays so many times as fast when it is opened; loop: and again.
    """
    record, verdict, bus = judged.record, judged.verdict, judged.bus
    drawn, story = plots(record), verdict.explanation
    first = plots_of(chosen or {})
    curves = _section("plots", "Over time", *_plots(first, drawn))
    below = (
        *(() if first else (curves,)),
        _section("why", "What happened, and why", *_incidents(story)) if story.incidents else "",
        _findings(verdict),
        _section("run", "The run", _facts([*figures(record, way_of(record)), *_bus(bus)])),
        *_events(story),
        _section("figures", "Figures", *_figures(bus)),
        "<footer>Made by <code>fsai-vcu</code> from the frames alone.</footer>\n",
        f'<script type="application/json" id="data">{_data(judged, [*first, *drawn], rate, loop=loop)}</script>\n',
    )
    title = f"<title>{escape(name)}: {escape(verdict.line())}</title>"
    changes = {
        "<title>pit wall</title>": title,
        '<body class="stale">': '<body class="log">',
        '<h1 id="channel">pit wall</h1>': f'<h1 id="channel">{escape(name)}</h1>',
        "<!--above-->": "".join((*_head(story, verdict), _TIME, curves if first else "")),
        "<!--below-->": "".join(below),
    }
    if whole:
        style, script = part("page.css"), part("page.js")
        policy = (
            f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; img-src data:;"
            " base-uri 'none'; form-action 'none'"
        )
        changes |= {
            '<link rel="stylesheet" href="page.css">': f"<style>{style}</style>",
            '<script src="page.js"></script>': f"<script>{script}</script>",
            "<title>": f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n<title>',
        }
    html = part("page.html")
    for place, text in changes.items():
        html = html.replace(place, text, 1)
    return html


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _data(judged: Judged, drawn: list[Plot], rate: float | None, *, loop: bool) -> str:
    """Return the log's data for the page, as JSON."""
    record, story = judged.record, judged.verdict.explanation
    zero_ns = int(story.heading["begin_ns"])
    times_ns = zero_ns, record.begin_ns, record.end_ns
    changes_ns = [event.t_ns for event in story.events if event.weight > Weight.NOTE]
    changes_ns += record.series(sig.LAP).spans.begin_ns.tolist()
    status_ns = record.series(sig.AS_STATE).t_ns
    view = View(record.channel, record.revision.name, record.decoder.databases)
    data = {
        "extent": [round(seconds(story, t_ns), 4) for t_ns in (record.begin_ns, record.end_ns)],
        # A car that is switched off before the recording ends has nothing to show at the end.
        "heard": round(seconds(story, int(status_ns[-1]) if len(status_ns) else record.end_ns), 4),
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
        "lights": {state.label: [light.fill, light.ink] for state, light in LIGHTS.items()},
        "band": BAND_ALPHA,
        "marks": [[round(seconds(story, i.t_ns), 4), i.kind.words, not i.planned] for i in story.incidents],
        "states": [[round(t_s, 4), state] for t_s, state in states_of(record.frames, view, changes_ns, zero_ns)],
        "way": packed_way(way_of(record), zero_ns),
        "rate": rate,
        "loop": loop,
    }
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")


_TIME: Final = """<div class="tools" role="toolbar" aria-label="time">
<button type="button" data-do="play" id="play" aria-label="play">▶</button>
<select id="rate" aria-label="speed"><option value="0.25">¼×</option><option value="1" selected>1×</option>
<option value="4">4×</option><option value="16">16×</option></select>
<input type="range" id="time" step="0.01" aria-label="time in the log, s"><output id="now" for="time"></output>
<span class="zoom"><button type="button" data-do="back" aria-label="plots: earlier">◀</button><button type="button"
 data-do="out" aria-label="plots: longer">−</button><button type="button" data-do="in"
 aria-label="plots: shorter">+</button><button type="button" data-do="on" aria-label="plots: later">▶</button><button
 type="button" data-do="all" aria-label="plots: the whole log">all</button><output id="range"></output></span></div>
"""

# ---------------------------------------------------------------- what is read


def _head(story: Explanation, verdict: Verdict) -> Iterator[str]:
    """The verdict, and the cause of each thing that went wrong."""
    heading = story.heading
    yield f'<div class="verdict {"good" if verdict.ok else "bad"}"><p>{escape(verdict.line())}</p>\n'
    for incident in [one for one in story.incidents if not one.planned][:_ALSO]:
        when, cause = _moment(seconds(story, incident.t_ns)), incident.candidates[0].cause
        yield f"<p>{escape(incident.kind.words)} at {when} because {escape(cause.words)}. "
        yield f"<b>What to do:</b> {escape(cause.remedy)}.</p>\n"
    yield (
        f"</div>\n<p class=hint>{escape(extent(story))};"
        f" interface revision {escape(heading['revision'])} ({escape(heading['revision_reason'])});"
        f" {escape(story.closing)}.</p>\n"
    )
    if story.problems:
        yield "<ul class=notes>" + "".join(f"<li>{escape(problem)}</li>" for problem in story.problems) + "</ul>\n"


def _section(slug: str, title: str, *content: str) -> str:
    inside = "".join(content)
    return f'<section aria-labelledby="{slug}"><h2 id="{slug}">{title}</h2>\n{inside}</section>\n'


def _facts(facts: Iterable[tuple[str, str]]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts) + "</dl>\n"


def _moment(at_s: float) -> str:
    return f'<button type="button" class="time" data-t="{at_s:.4f}">{at_s:.3f} s</button>'


def _findings(verdict: Verdict) -> str:
    """Return what check says of the log; incidents have articles of their own."""
    kinds = {kind.slug for kind in IncidentKind}
    shown = "".join(f'<li class="problem"><b>unknown</b>: {escape(why)}.</li>\n' for why in verdict.unknown)
    for finding in verdict.findings:
        if finding.kind not in kinds:
            remedy = f" <b>What to do:</b> {escape(finding.remedy)}." if finding.remedy else ""
            text = escape(verdict.moment(finding) + finding.words)
            shown += f'<li class="{finding.severity}"><b>{finding.severity}</b>: {text}.{remedy}</li>\n'
    return _section("bus", "On the bus", f'<ul class="notes">\n{shown}</ul>') if shown else ""


def _incidents(story: Explanation) -> Iterator[str]:
    """Yield an article for each incident: what happened, why, and what to do."""
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


def _plots(first: list[Plot], drawn: list[Plot]) -> Iterator[str]:
    """The plots: those asked for before the lanes of states, the rest behind them."""
    yield (
        '<p class="hint">A click goes to that moment. Drag to zoom, double-click for all; on a phone two fingers. Keys'
        " in a plot: arrows, + − 0.</p>\n"
    )
    yield from map(_plot, first)
    yield (
        '<figure><figcaption>States <span class="legend" id="legend-lanes"></span></figcaption>'
        '<canvas id="lanes" tabindex="0" role="img" aria-label="AS state, mission, switches and faults over time; the'
        ' timeline below has the same in words"></canvas></figure>\n'
    )
    yield from map(_plot, drawn)


def _plot(plot: Plot) -> str:
    legend = "".join(
        f'<span class="key c{number}{" quiet" if curve.quiet else ""}">{escape(curve.name)} <b></b></span>'
        for number, curve in enumerate(curve for curve in plot.curves if curve.drawn)
    )
    return (
        f"<figure><figcaption>{escape(plot.title)}, {escape(plot.unit)}"
        f' <span class="legend" id="legend-{plot.slug}">{legend}</span></figcaption>'
        f'<canvas id="plot-{plot.slug}" tabindex="0" role="img" aria-label="{escape(plot.summary())}"></canvas>'
        "</figure>\n"
    )


def _events(story: Explanation) -> Iterator[str]:
    count = len(story.events)
    yield f"<section><details open><summary><h2>Timeline</h2> {count} events</summary>\n"
    yield '<ol class="events" id="timeline">'
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
    """Yield the table of figures of a bus's messages."""
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
        times = f"p50 {_number(spread.p50_ms)} ms, p99 {_number(spread.p99_ms)} ms, max {_number(spread.max_ms)} ms"
        unanswered = f", {bus.handshake.unanswered} unanswered" if bus.handshake.unanswered else ""
        yield "handshake response", f"{bus.handshake.answered} echoes{unanswered}: {times}"
    yield "error frames", str(sum(bus.error_frames.values()) or "none")


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
