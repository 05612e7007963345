"""`fsai-vcu report`: a run as one page that opens anywhere, offline."""

from __future__ import annotations

import argparse
from pathlib import Path

from fsai_vcu.cli.sources import (
    Decoding,
    Sources,
    add_database_arguments,
    add_part_arguments,
    add_seconds_argument,
    add_sources_argument,
    check_seconds,
    part_of,
)
from fsai_vcu.interface.errors import UserError

EXAMPLE = "fsai-vcu report run.log -o report.html"
ABOUT = """\
One HTML file with the plots, the story of explain and the figures of stats; it
opens offline and loads nothing from elsewhere. Exit status: 0 written, 1
something could not be read, or the page not be written, 2 wrong use."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{ABOUT}"
    add_sources_argument(parser)
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="FILE.html", help="the page to write")
    add_seconds_argument(parser)
    add_part_arguments(parser)
    add_database_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.diagnostics.report import page

    check_seconds(args)
    decoding = Decoding("report", args)
    sources = Sources("report", args.sources, part=part_of(args, decoding))
    frames = sources.everything(args.seconds)
    if not len(frames):
        return 1
    databases = decoding.databases if args.dbc else None
    text = page(frames, Path(sources.name).name, args.revision, databases)
    try:
        _write(args.output, text)
    except OSError as error:
        raise UserError(f"cannot write {args.output}: {error.strerror or error}") from error
    print(f"saved {args.output} ({len(text.encode()) / 1000:.0f} kB)")
    return sources.status


def _write(path: Path, text: str) -> None:
    """The whole page, or none."""
    with path.open("w", encoding="utf-8") as file:
        try:
            file.write(text)
            file.flush()
        except OSError:
            if path.is_file():
                path.unlink()
            raise
