"""`fsai-vcu decode`: every frame of a log or a bus, with its signals."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fsai_vcu.cli.sources import SOURCE_HELP, Output, Sources, add_database_arguments, decoder_of

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.frames import Frames

EXAMPLE = "fsai-vcu decode run.log.gz --json | jq 'select(.message==\"VCU2AI_Steer\") | [.t, .signals.ANGLE]'"
_AT_ONCE = 60_000  # frames: many of one message are decoded together, and their text still fits a processor's cache


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", metavar="LOG|INTERFACE", help=SOURCE_HELP)
    add_database_arguments(parser)
    parser.add_argument("--numbers", action="store_true", help="numbers where the database has words for them")
    parser.add_argument("--json", action="store_true", help="one JSON object per frame")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.main import UserError
    from fsai_vcu.diagnostics.frames import joined
    from fsai_vcu.diagnostics.lines import LineWriter
    from fsai_vcu.diagnostics.sharing import processes_for, write_lines

    sources = Sources("decode", [args.log])
    writer = LineWriter(decoder_of(args), as_json=args.json, words=not args.numbers)
    output = Output()
    processes = processes_for(args.log)
    if processes > 1:
        try:
            frames, problems = write_lines(Path(args.log), writer.block, sys.stdout.fileno(), processes)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise UserError(f"cannot write the output: {error.strerror or error}") from error
        sources.report(args.log, frames, problems)
        return sources.status
    waiting: list[Frames] = []
    count = 0
    at_once = sources.live or args.log == "-"
    for chunk in sources.chunks():
        waiting.append(chunk)
        count += len(chunk)
        if count >= _AT_ONCE or (at_once and count):
            output.write(writer.block(joined(waiting)), at_once=at_once)
            waiting, count = [], 0
    output.write(writer.block(joined(waiting)))
    output.flush()
    return sources.status
