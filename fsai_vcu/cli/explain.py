"""`fsai-vcu explain`: what happened in a run, and why it braked or did not start."""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace

from fsai_vcu.cli.sources import Decoding, Sources, add_log_arguments, check_seconds, judged, part_of
from fsai_vcu.diagnostics.explain.render import json_lines, text_lines
from fsai_vcu.interface.errors import UserError

EXAMPLE = "fsai-vcu explain run.log\n  fsai-vcu explain can0 --seconds 10"
ABOUT = """\
From the frames alone: a timeline, and for every emergency brake and every
refusal to start the cause, the evidence and what to do about it; then the
verdict that check gives. Exit status: as for check (the emergency brake that a
mission ends with is no problem)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log_arguments(parser, messages=False)
    parser.add_argument("--json", action="store_true", help="one JSON object per line")


def run(args: argparse.Namespace) -> int:
    check_seconds(args)
    decoding = Decoding("explain", args)  # before anything is read; the explanation names the revision, and why
    part = part_of(args, decoding)
    sources = Sources("explain", args.sources)
    frames = sources.everything(args.seconds)
    if not len(frames):
        return 1
    record, _, verdict = judged(args, sources, decoding, frames)
    inside = verdict.between(*part.seconds(record.begin_ns))
    shown = inside.explanation
    told = {(incident.kind.slug, incident.t_ns) for incident in shown.incidents}
    if part:
        frames = part.of(frames)
        if not len(frames):
            raise UserError(f"no frame of {sources.name} is in that part")
        alone = judged(args, sources, decoding, frames)[2]
        # What is told of the part with causes from the whole log counts, whether the part alone shows it or not.
        whole = [one for one in inside.findings if (one.kind, one.t_ns) in told]
        rest = [one for one in alone.findings if (one.kind, one.t_ns) not in told]
        verdict = replace(alone, begin_ns=record.begin_ns, findings=(*whole, *rest))
    colour = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    for line in json_lines(shown, sources.name) if args.json else text_lines(shown, sources.name, colour=colour):
        print(line)
    others = tuple(one for one in verdict.findings if one.severity == "problem" and (one.kind, one.t_ns) not in told)
    text = (*replace(verdict, findings=others).lines(), f"verdict: {verdict.line()}")
    for line in map(json.dumps, verdict.as_dicts()) if args.json else text:
        print(line)
    return verdict.status
