"""A rehearsal's result for people: lines for a terminal, and one page to print and to bring along."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from textwrap import wrap
from typing import Any, Final

from fsai_hil.rehearsal.inspection.judge import Result, Verdict

WORDS: Final = {
    Verdict.PASS: "as asked",
    Verdict.NOTE: "with notes",
    Verdict.FAIL: "not as asked",
    Verdict.NOT_SEEN: "not seen",
}
_WIDTH: Final = 110
_STYLE: Final = """
@page { size: A4; margin: 10mm }
body { font: 7.5pt/1.2 sans-serif; margin: 0 auto; max-width: 190mm; color: #111; background: #fff }
h1 { font-size: 14pt; margin: 0 } p { margin: 2pt 0 6pt }
table { border-collapse: collapse; width: 100% } tr { break-inside: avoid }
td, th { border-top: 0.5pt solid #999; padding: 1pt 4pt; text-align: left; vertical-align: top }
td:first-child { font-weight: bold; white-space: nowrap } td:nth-child(2) { width: 17% } td:nth-child(3) { width: 45% }
small { color: #555; font-size: 6.5pt }
.fail td:first-child { background: #c62828; color: #fff } .pass td:first-child { color: #2e7d32 }
.note td:first-child { color: #b26a00 } .notseen td:first-child { color: #666 }
"""


def line(results: Sequence[Result]) -> str:
    """The whole in one line."""
    counts = Counter(result.verdict for result in results)
    words = [f"{counts[verdict]} {word}" for verdict, word in WORDS.items() if counts[verdict]]
    return f"{'PASS' if passed(results) else 'NOT PASSED'}: {', '.join(words) or 'nothing was looked at'}"


def passed(results: Sequence[Result]) -> bool:
    """Every item was seen, and none is otherwise than asked."""
    return bool(results) and all(result.verdict in (Verdict.PASS, Verdict.NOTE) for result in results)


def text(results: Sequence[Result]) -> str:
    """Return the results as lines for a terminal; what was seen and did not pass comes with what is asked."""
    lines = []
    for result in results:
        item, seen = result.item, list(result.seen)
        lines.append(f"{result.verdict.value.upper():<9} {item.title:<27} {seen[0] if seen else ''}".rstrip())
        if result.verdict is not Verdict.PASS:
            lines += [f"{'':<38}{each}" for each in seen[1:]]
            if result.verdict is not Verdict.NOT_SEEN:
                asked = wrap(f"asked ({item.source}): {item.asks}", _WIDTH - 12)
                lines += [f"{'':<12}{each}" for each in asked]
    return "\n".join((*lines, "", line(results)))


def as_dict(results: Sequence[Result], about: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results as an object for JSON, with the facts of `about`."""
    result = "pass" if passed(results) else "fail"
    return {"result": result, "words": line(results), **about, "items": [each.as_dict() for each in results]}


def page(results: Sequence[Result], about: Mapping[str, Any]) -> str:
    """One HTML page without anything from elsewhere; `about`: facts by name for its head."""
    facts = " · ".join(
        f"{escape(name)}: {escape(str(value))}" for name, value in about.items() if value not in ("", [])
    )
    rows = "".join(
        f'<tr class="{result.verdict.name.lower().replace("_", "")}"><td>{escape(result.verdict.value.upper())}</td>'
        f"<td>{escape(result.item.title)}</td>"
        f"<td>{escape(result.item.asks)} <small>({escape(result.item.source)})</small></td>"
        f"<td>{'<br>'.join(escape(each) for each in result.seen)}</td></tr>\n"
        for result in results
    )
    title = f"Rehearsal: {escape(line(results))}"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        f"<title>{title}</title><style>{_STYLE}</style></head>\n<body><h1>{title}</h1>\n<p>{facts}</p>\n"
        f"<table><tr><th>result</th><th>item</th><th>asked</th><th>seen</th></tr>\n{rows}</table>\n"
        "<p><small>Made by fsai-vcu rehearse from the frames on the bus, against a simulated VCU and car. It rehearses"
        " scrutineering and replaces nothing of it.</small></p></body></html>\n"
    )
