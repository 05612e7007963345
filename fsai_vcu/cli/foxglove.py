"""`fsai-vcu foxglove`: a bus live in Foxglove, decoded, over a websocket of this machine."""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from importlib.resources import files
from itertools import chain, islice
from typing import Any, Final

from fsai_vcu.cli.decoding import Decoding
from fsai_vcu.cli.sources import (
    SOURCE_HELP,
    Sources,
    add_bus_mark,
    add_part_arguments,
    add_server_arguments,
    check_server,
    part_of,
)
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.interface.errors import UserError, WrongUse

EXAMPLE = "fsai-vcu foxglove can0\n  fsai-vcu foxglove --layout > fsai.json"
ABOUT = """\
Each message is a topic /can/NAME with its signals. /can/state has AS state,
mission and shutdown cause in words; /can/bridge has the mission status, direction
and ESTOP_REQUEST that the bridge sends to the VCU. In Foxglove: open connection,
Foxglove WebSocket, ws://localhost:8765, then import the layout that --layout
prints. A log is played once, as fast as it was recorded. This verb never sends to
the bus. Only Foxglove's own pages and programs of this machine can connect, not
other web pages; --host opens it to a network. Needs the extra foxglove (pip
install 'fsai-vcu[foxglove]')."""
PORT: Final = 8765
PIECE_NS: Final = 50_000_000  # of a log, handed over at once
WORDS: Final = {
    "VCU2AI_Status": ("/can/state", ("AS_STATE", "AMI_STATE", "SHUTDOWN_CAUSE", "GO_SIGNAL")),
    "AI2VCU_Status": ("/can/bridge", ("MISSION_STATUS", "DIRECTION_REQUEST", "ESTOP_REQUEST")),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sources", nargs="*", metavar="LOG|INTERFACE[,FILTER…]", help=SOURCE_HELP)
    add_bus_mark(parser)
    parser.add_argument("--layout", action="store_true", help="print a layout to import, and nothing else")
    add_part_arguments(parser)
    add_server_arguments(parser, PORT)


def run(args: argparse.Namespace) -> int:
    """Print the layout, or serve a source to Foxglove until it ends."""
    if args.layout:
        print(files("fsai_vcu.cli").joinpath("foxglove_layout.json").read_text(encoding="utf-8"), end="")
        return 0
    os.nice(5)  # what drives the car goes first
    try:
        from fsai_vcu.diagnostics.foxglove import Server
    except ModuleNotFoundError:
        raise UserError("aiohttp is not installed; install it with: pip install 'fsai-vcu[foxglove]'") from None
    if not args.sources:
        raise WrongUse("a log or an interface is missing: fsai-vcu foxglove can0")
    check_server(args)
    decoding = Decoding("foxglove", args)
    sources = Sources("foxglove", args.sources, decoding, part_of(args, decoding))
    source = sources.chunks(args.seconds)
    first = list(islice(source, 1))  # opened before anybody is told of a server
    if not first:
        return sources.status
    chunks = chain(first, source)
    try:
        server = Server(args.host, args.port, f"fsai-vcu {sources.name}", topics_of(decoding))
    except OSError as error:
        source.close()
        raise UserError(f"cannot listen on {args.host}:{args.port}: {error.strerror or error}") from error
    how_long = "until Ctrl-C" if sources.live else "once, as fast as it was recorded"
    try:
        with closing(source), server:
            print(f"ws://{server.url} shows {sources.name}, {how_long}", flush=True)
            if server.beyond:
                print(server.beyond, flush=True)
            for frames in chunks if sources.live else _as_recorded(chunks):
                server.publish(messages_of(frames, decoding))
    except KeyboardInterrupt:
        pass
    return sources.status


def _as_recorded(chunks: Iterable[Frames]) -> Iterator[Frames]:
    """A log's frames in pieces, each at its time."""
    import numpy as np

    began: tuple[int, float] | None = None
    for frames in chunks:
        if not len(frames):
            continue
        began = began or (int(frames.t_ns[0]), time.monotonic())
        pieces = (frames.t_ns - began[0]) // PIECE_NS
        for piece in np.unique(pieces).tolist():
            while (left_s := piece * PIECE_NS / 1e9 - (time.monotonic() - began[1])) > 0.0:
                time.sleep(min(left_s, PIECE_NS / 1e9))
            yield frames.only(pieces == piece)


def _finite(values: list[Any]) -> list[Any]:
    """JSON has no NaN and no infinity."""
    return [None if isinstance(value, float) and not math.isfinite(value) else value for value in values]


def topics_of(decoding: Decoding) -> list[str]:
    """The topic of every message that may come."""
    names = {layout.name for databases in decoding.possible() for layout in databases.layouts.values()}
    return sorted({f"/can/{name}" for name in names} | {WORDS[name][0] for name in names & WORDS.keys()})


def messages_of(frames: Frames, decoding: Decoding) -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Topic, time and values of what the frames say."""
    for table in decoding.decoder.tables(frames).values() if len(frames) else ():
        name = table.layout.name
        columns = {series.name: _finite(series.values.tolist()) for series in table.series.values()}
        for row, t_ns in enumerate(table.t_ns.tolist()):
            yield f"/can/{name}", t_ns, {each: values[row] for each, values in columns.items()}
        if name in WORDS and len(table.t_ns):
            topic, signals = WORDS[name]
            last = len(table.t_ns) - 1
            words = {signal: table.series[signal].label(last) for signal in signals if signal in table.series}
            yield topic, int(table.t_ns[-1]), words
