"""`fsai-vcu explain`: the story of a run, and why it braked or did not start."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys

from fsai_vcu.cli.sources import (
    Decoding,
    Sources,
    add_database_arguments,
    add_seconds_argument,
    add_source_argument,
    check_seconds,
)
from fsai_vcu.interface.errors import WrongUse

EXAMPLE = "fsai-vcu explain run.log\n  fsai-vcu explain can0 --seconds 10"
ABOUT = """\
From the frames alone: a timeline, and for every emergency brake and every
refusal to start the cause, the evidence and what to do about it; then the
verdict that check gives. Exit status: as for check (the emergency brake that a
mission ends with is no problem)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{ABOUT}"
    add_source_argument(parser)
    parser.add_argument("--from", dest="from_s", type=float, metavar="S", help="from so many seconds after its start")
    parser.add_argument("--to", dest="to_s", type=float, metavar="S", help="to so many seconds after its start")
    add_seconds_argument(parser)
    add_database_arguments(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object per line")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.diagnostics.explain import record_for, story_of
    from fsai_vcu.diagnostics.explain.render import cut, json_lines, text_lines
    from fsai_vcu.diagnostics.statistics.measure import measure
    from fsai_vcu.diagnostics.verdict import judge_log

    for name, value in (("--from", args.from_s), ("--to", args.to_s)):
        if value is not None and not math.isfinite(value):
            raise WrongUse(f"{name} is {value:g}, not a time")
    check_seconds(args)
    decoding = Decoding("explain", args)  # before anything is read; the story itself says which revision it is, and why
    sources = Sources("explain", [args.source])
    frames = sources.everything(args.seconds)
    if not len(frames):
        return 1
    record = record_for(frames, args.revision, decoding.databases if args.dbc else None)
    story = story_of(record)
    buses = measure(frames, record.decoder, revision=record.revision.name)
    verdict = judge_log(record, story, buses).between(args.from_s, args.to_s)
    shown = cut(story, args.from_s, args.to_s)
    colour = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    for line in json_lines(shown, sources.name) if args.json else text_lines(shown, sources.name, colour=colour):
        print(line)
    for line in map(json.dumps, verdict.as_dicts()) if args.json else (f"verdict: {verdict.line()}",):
        print(line)
    return sources.status or verdict.status
