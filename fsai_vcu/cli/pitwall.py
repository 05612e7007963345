"""`fsai-vcu pitwall`: a bus live, or a log, on one web page for everybody around the car; only listens."""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fsai_vcu.arguments import check_numbers
from fsai_vcu.cli.decoding import Decoding
from fsai_vcu.cli.services import nodes_module, ros_errors
from fsai_vcu.cli.sources import (
    Sources,
    add_part_arguments,
    add_server_arguments,
    add_sources_argument,
    check_server,
    judged,
    part_of,
)
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.units import S

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.monitor.sources import Source
    from fsai_vcu.diagnostics.page.server import Server

EXAMPLE = (
    "fsai-vcu pitwall can0 --ros\n  fsai-vcu pitwall run.log --rate 1 --loop\n  fsai-vcu pitwall can0 --host 0.0.0.0"
)
ABOUT = """\
One page for a wall, a tablet or a phone, which loads nothing from the internet:
AS state with its lights, mission, why the car is not driving, requests and
measurements of the last ten seconds, laps (of the number that the rules ask for)
and their times, faults and what to do, the bus, and the driven path. --ros adds
what the running nodes say: cones, the planned path, the place to stop at, and the
words of bridge, planner and controller. It never sends, and the page of a bus has
no buttons. Only this machine can open the page, unless --host opens it to a
network. A log plays on the same page with a time slider, plots and what explain
finds, as in the file that report saves. Needs the extra pitwall (pip install
'fsai-vcu[pitwall]')."""
Said = tuple[dict[str, Any], dict[str, Any]]  # for the page's state, and for its story
PORT: Final = 8650
SHOWN_S: Final = 0.2
UNSEEN_S: Final = 1.0  # while nobody looks
STORY_S: Final = 1.0
PLAYED_S: Final = 25.0  # of a pipe at a time: of so much the view has every frame


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_sources_argument(parser)
    add_part_arguments(parser, messages=False)
    parser.add_argument("--rate", type=float, metavar="X", help="play a log X times as fast as recorded (default: 1)")
    parser.add_argument("--loop", action="store_true", help="play a log again and again")
    parser.add_argument(
        "--ros", action="store_true", help="also show what the running nodes say: cones, path and status"
    )
    parser.add_argument("--namespace", metavar="NS", help="with --ros: the nodes' ROS namespace, such as /car1")
    add_server_arguments(parser, PORT)


def run(args: argparse.Namespace) -> int:
    """Check the arguments, then serve a bus or a log as a web page."""
    os.nice(5)  # what drives the car goes first, and it takes a while to load what follows
    from fsai_vcu.diagnostics.monitor.sources import Live, PlayedLog
    from fsai_vcu.diagnostics.monitor.view import View

    try:
        from fsai_vcu.diagnostics.page.server import Server
    except ModuleNotFoundError:
        raise UserError("aiohttp is not installed; install it with: pip install 'fsai-vcu[pitwall]'") from None
    check_numbers(args, rate=0.01)
    check_server(args)
    part = part_of(args)
    sources = Sources("pitwall", args.sources)
    if sources.live and (part or args.rate is not None or args.loop):
        raise WrongUse("--from, --to, --rate and --loop are for logs")
    if not sources.live and (args.seconds is not None or args.ros):
        raise WrongUse(f"--{'ros' if args.ros else 'seconds'} is for a live bus, and {sources.name} is a log")
    if args.namespace and not args.ros:
        raise WrongUse("--namespace goes with --ros")
    if args.loop and not sources.files:
        raise WrongUse("--loop is for logs that are files")
    decoding = Decoding("pitwall", args)
    try:
        server = Server(args.host, args.port)
    except OSError as error:
        raise UserError(f"cannot listen on {args.host}:{args.port}: {error.strerror or error}") from error
    with ExitStack() as opened, closing(server.socket), suppress(KeyboardInterrupt):
        if sources.files:
            return _serve_log(server, sources, decoding, args)
        databases = decoding.databases if args.dbc else None
        view = View(", ".join(Path(name).name for name in sources.names), args.revision, databases)
        chunks = opened.enter_context(closing(sources.chunks(args.seconds, waits=True)))
        source: Source
        first = list(islice(chunks, 1))  # a bus is opened here, not in the thread; of a log the first moment is known
        if sources.live:
            source = Live(chain(first, chunks), view, lambda: sources.lost_here, lambda: sources.heard_ns())
        else:
            begin_ns = sources.first_ns or 0
            low_ns, high_ns = part.bounds(begin_ns)
            frames = (each.only(each.t_ns <= high_ns) for each in chain(first, chunks))
            from_s = (low_ns - begin_ns) / S if math.isfinite(low_ns) else None
            source = PlayedLog(frames, view, from_s, args.rate or 1.0, keep=False)
            if source.empty:
                return sources.status
        with closing(source), server, _nodes(args) as nodes:
            _announce(server, sources)
            _show(source, server, nodes, args)
    return sources.status


def _announce(server: Server, sources: Sources) -> None:
    print(f"http://{server.url} shows {sources.name} until Ctrl-C", flush=True)
    if server.beyond:
        print(server.beyond, flush=True)


def _serve_log(server: Server, sources: Sources, decoding: Decoding, args: argparse.Namespace) -> int:
    """The page has the whole log in it, and plays it itself."""
    from fsai_vcu.diagnostics.page.document import of_log

    found = judged(args, sources, decoding)
    if found is None:
        return sources.status
    name = ", ".join(Path(name).name for name in sources.names)
    server.html = of_log(found, name, whole=False, rate=args.rate or 1.0, loop=args.loop)
    with server:
        _announce(server, sources)
        while True:
            time.sleep(UNSEEN_S)
            server.check()


@contextmanager
def _nodes(args: argparse.Namespace) -> Iterator[Callable[[], Said]]:
    """Give a function that returns what the nodes say now; it returns nothing where the nodes are not asked for."""
    if not args.ros:
        yield lambda: ({}, {})
        return
    with ros_errors():
        listener = nodes_module("pitwall").PitWall(args.namespace or "/")
    listener.start()
    try:
        yield listener.look
    finally:
        listener.stop()


def _show(source: Source, server: Server, nodes: Callable[[], Said], args: argparse.Namespace) -> None:
    """Show the source until its bus is over. The picture is made as often as somebody looks, the story of the run once
    a second.
    """
    from fsai_vcu.diagnostics.monitor.sources import PlayedLog
    from fsai_vcu.diagnostics.page.board import events_of, state_of
    from fsai_vcu.diagnostics.page.trace import Trace

    trace = Trace()
    run = ""
    most_s = PLAYED_S / (args.rate or 1.0)
    shown_s = story_s = time.monotonic()
    while True:
        view, picture, _, words = source.look()
        trace.update(view.memory, picture.revision)
        drawn, driven = nodes()
        before, run = run, f"{trace.run}/{drawn.get('run')}"  # what is drawn together is of one run, in one frame
        if server.viewers and (shown_s >= story_s or run != before):  # it takes the longer the longer the run is
            story_s = shown_s + STORY_S
            events = events_of(view.events(), picture.t_ns, source.clock)
            server.publish("story", {"way_cm": trace.line.way_cm, "events": events, **driven, "run": run})
        clock = words if source.playing else f"{words}: its end"
        pose = [round(each, 3) for each in trace.pose]
        server.publish("state", {**state_of(picture), "clock": clock, "pose": pose, **drawn, "run": run})
        if source.ended and not isinstance(source, PlayedLog):
            return
        source.wait(min(SHOWN_S if server.viewers else UNSEEN_S, most_s))
        now_s = time.monotonic()
        source.advance(min(now_s - shown_s, most_s))
        shown_s = now_s
