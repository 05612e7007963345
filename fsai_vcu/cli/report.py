"""`fsai-vcu report`: a run as one page that opens anywhere, offline."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from fsai_vcu.cli.decoding import Decoding
from fsai_vcu.cli.sources import Sources, add_log_arguments, check_seconds, judged
from fsai_vcu.diagnostics.log.recorded import beside
from fsai_vcu.diagnostics.page.document import of_log
from fsai_vcu.files import is_there, write_whole
from fsai_vcu.interface.errors import UserError, WrongUse

EXAMPLE = "fsai-vcu report run.log -o report.html"
ABOUT = """\
One HTML file: the pit wall's page at any moment of the log, with its plots, what
explain finds and the figures of check --figures. It opens offline and loads
nothing from elsewhere. Exit status: as for check, by the verdict on top of the
page, which is saved whatever the verdict is; 1 also if it cannot be saved."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log_arguments(parser)
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.html", help="the page to write (default: beside a log, run.html)"
    )
    parser.add_argument(
        "--signals", metavar="NAME,…", help="plots of these signals too: NAME or MESSAGE.NAME, with * and ?"
    )
    parser.add_argument(
        "--json", action="store_true", help="print the findings and the verdict, one JSON object per line"
    )


def run(args: argparse.Namespace) -> int:
    """Judge the log and write its page; return the exit status."""
    check_seconds(args)
    decoding = Decoding("report", args)
    decoding.patterns(args.signals)
    sources = Sources("report", args.sources)
    args.output = args.output or _beside(sources)
    sources.check_output(args.output)
    found = judged(args, sources, decoding)
    if found is None:
        return 1
    chosen = found.record.matching((args.signals or "").split(","))
    if args.signals is not None and not chosen:
        raise UserError(f"no signal {args.signals} in {sources.name}")
    text = of_log(found, Path(sources.name).name, chosen)
    try:
        write_whole(args.output, text.encode())
    except OSError as error:
        raise UserError(f"cannot write {args.output}: {error.strerror or error}") from error
    if args.json:
        print("\n".join(map(json.dumps, found.verdict.as_dicts())))
        return found.verdict.status
    print(f"saved {args.output} ({len(text.encode()) / 1000:.0f} kB); verdict: {found.verdict.line()}")
    return found.verdict.status


def _beside(sources: Sources) -> Path:
    """The page's place where none is named: beside the log. Raises WrongUse where there is no one log, or a file."""
    if not sources.files or len(sources.names) > 1:
        raise WrongUse("-o is missing: -o report.html")
    page = beside(Path(sources.name), ".html")
    if is_there(page):
        raise WrongUse(f"{page} exists already: -o {page} overwrites it")
    return page
