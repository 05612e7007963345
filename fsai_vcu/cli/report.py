"""`fsai-vcu report`: a run as one page that opens anywhere, offline."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

EXAMPLE = "fsai-vcu report run.log -o report.html"
BAD_INPUT = 2
ABOUT = """\
One HTML file with the plots, the story of explain and the figures of stats; it
opens offline and loads nothing from elsewhere. Exit status: 0 written, 2 bad
input or nowhere to write."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{ABOUT}"
    parser.add_argument("log", metavar="LOG", help="candump (also .gz), BLF, ASC or MF4; - is standard input")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="FILE.html", help="the page to write")
    parser.add_argument("--revision", help="interface revision: 2021 or 2026 (default: told from the log)")
    parser.add_argument("--dbc", action="append", metavar="FILE", help="these databases instead of our own")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.diagnostics.databases import DatabasesError, load_databases
    from fsai_vcu.diagnostics.logs import LogError, read_log
    from fsai_vcu.diagnostics.report import page

    try:
        frames, problems = read_log(args.log)
        for text in problems.texts[:3]:
            print(f"fsai-vcu report: {text}", file=sys.stderr)
        databases = load_databases(args.dbc) if args.dbc else None
        name = "standard input" if args.log == "-" else Path(args.log).name
        text = page(frames, name, args.revision, databases)
        args.output.write_text(text, encoding="utf-8")
    except (LogError, DatabasesError, ValueError) as error:
        print(f"fsai-vcu report: {args.log}: {error}".replace(f"{args.log}: {args.log}", args.log), file=sys.stderr)
        return BAD_INPUT
    except OSError as error:
        print(f"fsai-vcu report: cannot write {args.output}: {error.strerror or error}", file=sys.stderr)
        return BAD_INPUT
    print(f"saved {args.output} ({len(text.encode()) / 1000:.0f} kB)")
    return BAD_INPUT if problems else 0
