"""`fsai-vcu explain`: the story of a run, and why it braked or did not start."""

from __future__ import annotations

import argparse
import math
import os
import sys

EXAMPLE = "fsai-vcu explain run.log"
BAD_INPUT = 2
ABOUT = """\
From the frames alone: a timeline, and for every emergency brake and every
refusal to start the cause, the evidence and what to do about it. Exit status:
0 no emergency brake and no refusal (the emergency brake that a mission ends
with counts as none), 1 otherwise, 2 bad input."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{ABOUT}"
    parser.add_argument("log", metavar="LOG", help="candump (also .gz), BLF, ASC or MF4; - is standard input")
    parser.add_argument("--from", dest="from_s", type=float, metavar="S", help="from so many seconds after its start")
    parser.add_argument("--to", dest="to_s", type=float, metavar="S", help="to so many seconds after its start")
    parser.add_argument("--revision", help="interface revision: 2021 or 2026 (default: told from the log)")
    parser.add_argument("--dbc", action="append", metavar="FILE", help="these databases instead of our own")
    parser.add_argument("--json", action="store_true", help="one JSON object per line")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.diagnostics.databases import DatabasesError, load_databases
    from fsai_vcu.diagnostics.logs import LogError, read_log
    from fsai_vcu.diagnostics.story import tell
    from fsai_vcu.diagnostics.story.telling import cut, json_lines, text_lines

    for name, value in (("--from", args.from_s), ("--to", args.to_s)):
        if value is not None and not math.isfinite(value):
            print(f"fsai-vcu explain: {name} is {value:g}, not a time", file=sys.stderr)
            return BAD_INPUT
    try:
        frames, problems = read_log(args.log)
        for text in problems.texts[:3]:
            print(f"fsai-vcu explain: {text}", file=sys.stderr)
        if problems.count > 3:
            print(f"fsai-vcu explain: {problems.count - 3} more places could not be read", file=sys.stderr)
        databases = load_databases(args.dbc) if args.dbc else None
        story = cut(tell(frames, args.revision, databases), args.from_s, args.to_s)
    except (LogError, DatabasesError, ValueError) as error:
        print(f"fsai-vcu explain: {args.log}: {error}".replace(f"{args.log}: {args.log}", args.log), file=sys.stderr)
        return BAD_INPUT
    colour = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    name = "standard input" if args.log == "-" else args.log
    for line in json_lines(story, name) if args.json else text_lines(story, name, colour=colour):
        print(line)
    if not story.clean:
        return 1
    return BAD_INPUT if problems else 0
