"""`fsai-vcu decode`: every frame of a log or a bus, with its signals."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fsai_vcu.cli.sources import Decoding, Output, Sources, add_database_arguments, add_source_argument, report_problems

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.log.frames import Frames

EXAMPLE = "fsai-vcu decode run.log.gz --json | jq 'select(.message==\"VCU2AI_Steer\") | [.t, .signals.ANGLE]'"
_AT_ONCE = 60_000  # frames: many of one message are decoded together, and their text still fits a processor's cache


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_argument(parser, "log")
    add_database_arguments(parser)
    parser.add_argument("--numbers", action="store_true", help="numbers where the database has words for them")
    parser.add_argument("--json", action="store_true", help="one JSON object per frame")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.diagnostics.decode.sharing import processes_for

    decoding = Decoding("decode", args)
    processes = processes_for(args.log)
    return _pieces(args, decoding, processes) if processes else _chunks(args, decoding)


def _pieces(args: argparse.Namespace, decoding: Decoding, processes: int) -> int:
    """A candump log, on all processors."""
    from fsai_vcu.cli.main import UserError
    from fsai_vcu.diagnostics.decode.printing import Printer
    from fsai_vcu.diagnostics.decode.sharing import LARGE_PIECE_BYTES, PIECE_BYTES, write_all, write_lines

    path = Path(args.log)
    try:
        decoding.hear_log(path)
        printer = Printer(decoding.databases, as_json=args.json, words=not args.numbers)
        piece_bytes = LARGE_PIECE_BYTES if args.json else PIECE_BYTES
        output = Output()
        write = partial(write_all, sys.stdout.fileno()) if processes > 1 else output.write
        count, problems = write_lines(path, printer, write, processes, piece_bytes)
        output.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise UserError(f"cannot write the output: {error.strerror or error}") from error
    return report_problems("decode", args.log, count, problems)


def _chunks(args: argparse.Namespace, decoding: Decoding) -> int:
    from fsai_vcu.diagnostics.log.frames import joined

    sources = Sources("decode", [args.log], decoding)
    output = Output()
    waiting: list[Frames] = []
    count = 0
    at_once = sources.live or args.log == "-"
    for chunk in sources.chunks():
        waiting.append(chunk)
        count += len(chunk)
        if count >= _AT_ONCE or (at_once and count):
            output.write(decoding.writer.block(joined(waiting)), at_once=at_once)
            waiting, count = [], 0
    output.write(decoding.writer.block(joined(waiting)))
    output.flush()
    return sources.status
