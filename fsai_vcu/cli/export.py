"""`fsai-vcu export`: a log as tables for other tools."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.ending import interruptible
from fsai_vcu.cli.output import Progress
from fsai_vcu.cli.sources import LOG_HELP, Sources, add_part_arguments, part_of
from fsai_vcu.diagnostics.export.wide import raster_ns
from fsai_vcu.diagnostics.export.writing import check_format, export
from fsai_vcu.interface.errors import UserError, WrongUse

EXAMPLE = (
    "fsai-vcu export run.log -o run.csv --raster 20ms\n"
    "  fsai-vcu export run.log.gz --format parquet -o run-tables\n"
    "  fsai-vcu export run.log -o run.mcap"
)
ABOUT = """\
Times: the first column of CSV and Parquet is the time in the log, the second one
the seconds since the log's first frame, as check, explain, report and plot count.
MF4 has only these seconds, MCAP only the time in the log."""
_DEFAULT_RASTER = "10ms"
_FORMATS = ("csv", "parquet", "mcap", "mf4")
_FILES = ("mcap", "mf4")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: logs, format, output, and the options of single formats."""
    add = parser.add_argument
    add(
        "logs",
        nargs="+",
        metavar="LOG[,FILTER…]",
        help=f"{LOG_HELP}, with candump's filters to leave frames out; several logs are read one after "
        "the other, as the segments of a recording",
    )
    add("--format", choices=_FORMATS, help="what to make (default: as PATH ends)")
    add(
        "-o",
        "--output",
        required=True,
        type=Path,
        metavar="PATH",
        help="a file: FILE.mcap, FILE.mf4, or FILE.csv and FILE.parquet with one --wide table; with --format csv or "
        "parquet a new folder, with a file for each message",
    )
    add("--wide", action="store_true", help="one table at a raster: every signal's last value, and its age per message")
    add(
        "--raster",
        metavar="TIME",
        help=f"of one table (--wide, FILE.csv, FILE.parquet): 10ms, 0.5s, 100us (default: {_DEFAULT_RASTER})",
    )
    add("--words", action="store_true", help="csv, parquet: the database's words instead of numbers")
    add_part_arguments(parser, signals=True)
    add("--until", help=argparse.SUPPRESS)
    add_database_arguments(parser)


def _take_old_names(args: argparse.Namespace) -> None:
    """--to named the format and --until the end in an earlier release; both work for one release more."""
    for old, new, meant in (("to", "format", args.end in _FORMATS), ("until", "to", args.until is not None)):
        if meant:
            print(f"fsai-vcu export: --{old} is now called --{new}", file=sys.stderr)
    if args.format is None and args.end in _FORMATS:
        args.format, args.end = args.end, None
    args.end = args.end if args.until is None else args.until


def run(args: argparse.Namespace) -> int:
    """Check the arguments, then write the log's tables."""
    _take_old_names(args)
    ending = args.output.suffix.lstrip(".").lower()
    if args.format is None and ending in _FORMATS:  # a file of that name: one table, where it holds no more
        args.format, args.wide = ending, args.wide or ending not in _FILES
    if args.format is None:
        raise WrongUse(f"--format is missing: {', '.join(_FORMATS)}")
    if args.raster is not None and not args.wide:
        raise WrongUse("--raster goes with --wide")
    if args.words and args.format not in ("csv", "parquet"):
        raise WrongUse(f"--words does not go with {args.format}, which has both numbers and words")
    try:
        step_ns = raster_ns(args.raster or _DEFAULT_RASTER) if args.wide else None
    except ValueError as error:
        raise WrongUse(str(error)) from error
    check_format(args.format)
    decoding = Decoding("export", args)
    decoding.show_signals(args.signals)
    sources = Sources("export", args.logs, decoding, part_of(args, decoding))
    if sources.live:
        raise WrongUse(f"{args.logs[0]} is an interface; export reads logs, and `fsai-vcu record` makes them")
    sources.check_output(args.output)
    progress = Progress()
    frames = sources.everything(received=progress.reading)
    if not len(frames):
        return sources.status or 1
    if (decoding.decoder.which(frames) < 0).all():
        raise UserError(f"nothing to export: the databases name none of the {len(frames)} frames")
    try:
        with interruptible():
            written = export(
                frames,
                decoding.decoder,
                args.format,
                args.output,
                first_ns=sources.first_ns,
                step_ns=step_ns,
                words=args.words,
                progress=progress.writing,
            )
    except OSError as error:
        raise UserError(f"cannot write {args.output}: {error.strerror or error}") from error
    finally:
        progress.end()
    tables = "1 table" if written.tables == 1 else f"{written.tables} tables"
    every = f" (one every {args.raster or _DEFAULT_RASTER})" if args.wide else ""
    left_out = f"; left out: {written.left_out}" if written.left_out else ""
    print(f"{tables}, {written.rows} rows{every} of {len(frames)} frames in {args.output}{left_out}", file=sys.stderr)
    for note in written.notes:
        print(f"fsai-vcu export: {note}", file=sys.stderr)
    return sources.status
