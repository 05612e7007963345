"""`fsai-vcu decode`: every frame of a log or a bus, with its signals."""

from __future__ import annotations

import argparse

from fsai_vcu.cli.sources import (
    Decoding,
    Sources,
    add_database_arguments,
    add_part_arguments,
    add_sources_argument,
    part_of,
    write_out,
)

EXAMPLE = "fsai-vcu decode run.log.gz --json | jq 'select(.message==\"VCU2AI_Steer\") | [.t, .signals.ANGLE]'"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_sources_argument(parser, "logs")
    add_part_arguments(parser, signals=True)
    add_database_arguments(parser)
    parser.add_argument("--numbers", action="store_true", help="numbers where the database has words for them")
    parser.add_argument("--json", action="store_true", help="one JSON object per frame")


def run(args: argparse.Namespace) -> int:
    decoding = Decoding("decode", args)
    decoding.show_signals(args.signals)
    sources = Sources("decode", args.logs, decoding, part_of(args, decoding))
    sources.learn()
    try:
        for frames in sources.chunks():
            write_out(decoding.writer.block(frames))
    except KeyboardInterrupt:
        if not sources.live:
            raise
    return sources.status
