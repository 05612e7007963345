"""`fsai-vcu explain`: what happened in a run, and why it braked or did not start."""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace

from fsai_vcu.cli.decoding import Decoding
from fsai_vcu.cli.sources import Sources, add_log_arguments, check_seconds, judged
from fsai_vcu.diagnostics.explain.render import json_lines, text_lines

EXAMPLE = "fsai-vcu explain run.log\n  fsai-vcu explain run.log --timeline\n  fsai-vcu explain can0 --seconds 10"
ABOUT = """\
From the frames alone it gives the cause, the evidence and the remedy of every
emergency brake and every refusal to start; then the verdict that check gives.
--timeline adds everything that happened before. Exit status: as for check (an
emergency brake with which the mission ends as planned is no problem). Times in a
log are seconds since its first frame."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log_arguments(parser, messages=False)
    parser.add_argument(
        "--timeline", action="store_true", help="what happened, moment by moment, and what to record next time"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per line")


def run(args: argparse.Namespace) -> int:
    """Judge the log, print the explanation and return the exit status."""
    check_seconds(args)
    decoding = Decoding("explain", args)  # before anything is read; the explanation names the revision, and why
    sources = Sources("explain", args.sources)
    return max(_explain(args, each, decoding) for each in sources.runs())


def _explain(args: argparse.Namespace, sources: Sources, decoding: Decoding) -> int:
    """Print the explanation of one run; the exit status."""
    found = judged(args, sources, decoding)
    if found is None:
        return 1
    verdict, shown = found.verdict, found.verdict.explanation
    told = {(incident.kind.slug, incident.t_ns) for incident in shown.incidents}
    colour = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    story = list(text_lines(shown, sources.name, timeline=args.timeline, colour=colour))
    if not args.timeline:
        story.insert(-1, f"(--timeline adds what happened until then, {len(shown.events)} lines, and the notes)")
    for line in json_lines(shown, sources.name) if args.json else story:
        print(line)
    others = [one for one in verdict.findings if one.severity == "problem" and (one.kind, one.t_ns) not in told]
    notes = [one for one in verdict.findings if one.severity != "problem"]
    if args.timeline:
        others += notes
    text = (*replace(verdict, findings=tuple(others)).lines(), f"verdict: {verdict.line()}")
    for line in map(json.dumps, verdict.as_dicts()) if args.json else text:
        print(line)
    return verdict.status
