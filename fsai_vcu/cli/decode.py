"""`fsai-vcu decode`: every frame of a log or a bus, with its signals."""

from __future__ import annotations

import argparse
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from fsai_vcu.cli.sources import (
    Decoding,
    Output,
    Sources,
    add_database_arguments,
    add_part_arguments,
    add_sources_argument,
    part_of,
    report_problems,
)

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

Given = TypeVar("Given")
Done = TypeVar("Done")

EXAMPLE = "fsai-vcu decode run.log.gz --json | jq 'select(.message==\"VCU2AI_Steer\") | [.t, .signals.ANGLE]'"
_AT_ONCE = 3  # blocks of a log
_SHORT_BYTES = 1 << 16  # printed frame by frame sooner than numpy is loaded


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_sources_argument(parser, "logs")
    add_part_arguments(parser)
    add_database_arguments(parser)
    parser.add_argument("--numbers", action="store_true", help="numbers where the database has words for them")
    parser.add_argument("--json", action="store_true", help="one JSON object per frame")


def run(args: argparse.Namespace) -> int:
    decoding = Decoding("decode", args)
    whole = args.begin is args.end is args.messages is None
    if whole and len(args.logs) == 1 and _is_short(Path(args.logs[0])):
        return _short(args, decoding)
    sources = Sources("decode", args.logs, decoding, part_of(args, decoding))
    output = Output()
    if not whole or not sources.files:  # a part begins where the log does
        try:
            for frames in sources.chunks():
                output.write(decoding.writer.block(frames), at_once=True)
        except KeyboardInterrupt:
            if not sources.live:
                raise
        return sources.status
    from concurrent.futures import ThreadPoolExecutor

    sources.learn()
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for text in sources.mapped(decoding.writer.block, partial(_in_order, pool)):
            output.write(text)
    output.flush()
    return sources.status


def _short(args: argparse.Namespace, decoding: Decoding) -> int:
    """A small log, without numpy."""
    from fsai_vcu.diagnostics.decode.text import FrameText
    from fsai_vcu.diagnostics.log.reader import open_log

    with open_log(args.logs[0]) as log:
        frames = list(log.frames())
    decoding.hear_frames(frames)
    text = FrameText(decoding.databases, as_json=args.json, words=not args.numbers)
    output = Output()
    output.write("".join(map(text.line, frames)).encode(), at_once=True)
    return report_problems("decode", log.name, len(frames), log.problems)


def _in_order(pool: Executor, work: Callable[[Given], Done], several: Iterable[Given]) -> Iterator[Done]:
    """As `map`: a few at once, and no more of them in memory."""
    waiting: deque[Future[Done]] = deque()
    for each in several:
        waiting.append(pool.submit(work, each))
        if len(waiting) > _AT_ONCE:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def _is_short(path: Path) -> bool:
    """Whether this is a file in one of candump's formats, and a small one."""
    from fsai_vcu.diagnostics.log.files import kind_of

    if not path.is_file():  # a pipe can be read but once
        return False
    try:
        with path.open("rb") as file:
            return os.fstat(file.fileno()).st_size <= _SHORT_BYTES and kind_of(file.read(16)) == "candump"
    except OSError:
        return False
