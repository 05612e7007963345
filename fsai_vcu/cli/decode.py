"""`fsai-vcu decode`: every frame of a log or a bus, with its signals."""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from fsai_vcu.cli.sources import Decoding, Output, Sources, add_database_arguments, add_source_argument, report_problems

if TYPE_CHECKING:
    from concurrent.futures import Future

    from fsai_vcu.diagnostics.log.frames import Frames

EXAMPLE = "fsai-vcu decode run.log.gz --json | jq 'select(.message==\"VCU2AI_Steer\") | [.t, .signals.ANGLE]'"
_AT_ONCE = 60_000  # frames: many of one message are decoded together, and their text still fits a processor's cache
_SHORT_BYTES = 1 << 16  # printed frame by frame sooner than numpy is loaded


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_source_argument(parser, "log")
    add_database_arguments(parser)
    parser.add_argument("--numbers", action="store_true", help="numbers where the database has words for them")
    parser.add_argument("--json", action="store_true", help="one JSON object per frame")


def run(args: argparse.Namespace) -> int:
    decoding = Decoding("decode", args)
    if _is_candump(args.log):
        if Path(args.log).stat().st_size <= _SHORT_BYTES:
            return _short(args, decoding)
        decoding.hear_log(args.log)
    sources = Sources("decode", [args.log], decoding)
    output = Output()
    if sources.live or args.log == "-":
        for frames in sources.chunks():
            output.write(decoding.writer.block(frames), at_once=True)
    else:
        _long(sources, decoding, output)
    output.flush()
    return sources.status


def _short(args: argparse.Namespace, decoding: Decoding) -> int:
    """A small log, without numpy."""
    from fsai_vcu.diagnostics.decode.text import FrameText
    from fsai_vcu.diagnostics.log.reader import open_log

    with open_log(args.log) as log:
        frames = list(log.frames())
    decoding.hear_frames(frames)
    text = FrameText(decoding.databases, as_json=args.json, words=not args.numbers)
    output = Output()
    output.write("".join(map(text.line, frames)).encode(), at_once=True)
    return report_problems("decode", log.name, len(frames), log.problems)


def _long(sources: Sources, decoding: Decoding, output: Output) -> None:
    """The next frames are read while the last ones become text."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        texts: deque[Future[bytearray]] = deque()
        for frames in _windows(sources):
            texts.append(pool.submit(decoding.writer.block, frames))
            if len(texts) > 1:
                output.write(texts.popleft().result())
        for text in texts:
            output.write(text.result())


def _windows(sources: Sources) -> Iterator[Frames]:
    from fsai_vcu.diagnostics.log.frames import joined

    waiting: list[Frames] = []
    count = 0
    for chunk in sources.chunks():
        waiting.append(chunk)
        count += len(chunk)
        if count >= _AT_ONCE:
            yield joined(waiting)
            waiting, count = [], 0
    yield joined(waiting)


def _is_candump(name: str) -> bool:
    """Whether this is a file in one of candump's formats."""
    from fsai_vcu.diagnostics.log.files import kind_of

    try:
        with Path(name).open("rb") as file:
            return Path(name).is_file() and kind_of(file.read(16)) == "candump"
    except OSError:
        return False
