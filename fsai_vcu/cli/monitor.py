"""`fsai-vcu monitor`: what a bus says now, and why the car is not driving; only listens."""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import cache
from itertools import chain, islice
from pathlib import Path

from fsai_vcu.arguments import check_numbers
from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.output import write_out
from fsai_vcu.cli.sources import Sources, add_part_arguments, add_sources_argument, part_of
from fsai_vcu.diagnostics.explain.record import NoFrames
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.log.part import Part
from fsai_vcu.diagnostics.monitor.snapshot import plain_line
from fsai_vcu.diagnostics.monitor.sources import Live, PlayedLog, Source, TimedPicture
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.diagnostics.verdict.judging import judged
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.units import S

EXAMPLE = (
    "fsai-vcu monitor can0\n  fsai-vcu monitor run.log --at 62.5\n  fsai-vcu monitor run.log --rate 2\n"
    "  fsai-vcu monitor can0 --signals 'AS_STATE,*_TRQ*'"
)
ABOUT = """\
Shows AS state, mission, why the car is not driving, what is requested and what is
measured, faults, handshake, and the rate and age of every message. Further pages
show the bytes of each message, the signals, and the history of events. It never
sends. Ctrl-C or q ends it, space pauses it, ? shows all keys. A log is shown at
its end (default), at one moment (--at) or played (--rate), with what check finds
up to that moment; keys move in the log. Exit status: of a log as for check; of a
bus or a played pipe 1 if something could not be read; 2 wrong use. With --plain,
or if the output is no terminal, it prints a line a second. The pages need textual
(pip install 'fsai-vcu[monitor]')."""

_DRAW_EVERY_S = 0.25
_PRINT_EVERY_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: sources, the moment or pace of a log, and the form of the output."""
    add_sources_argument(parser)
    add_part_arguments(parser, messages=False)
    add_database_arguments(parser)
    parser.add_argument("--signals", metavar="NAME,…", help="show these signals; NAME or MESSAGE.NAME, with * and ?")
    parser.add_argument(
        "--every", type=float, metavar="S", help="seconds between updates (default: 0.25 drawn, 1 printed)"
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="end after S seconds (live; default: until Ctrl-C)")
    log = parser.add_mutually_exclusive_group()
    log.add_argument("--at", metavar="TIME", help="show a log at that time: seconds or time of day, as --from")
    log.add_argument(
        "--rate", type=float, metavar="X", help="play a log, X times as fast as recorded; 0: without waiting"
    )
    parser.add_argument("--plain", action="store_true", help="a line a second instead of drawing")
    parser.add_argument("--json", action="store_true", help="one JSON object a second instead of drawing")


def run(args: argparse.Namespace) -> int:
    """Check the arguments, then show a bus or a log in the way that they and the terminal allow."""
    check_numbers(args, every=0.02, seconds=0.0, rate=0.0)
    try:
        at = Part(args.at)
    except ValueError as error:
        raise WrongUse(str(error).replace("--from", "--at")) from error
    part = part_of(args)
    sources = Sources("monitor", args.sources)
    if sources.live and (part or args.at is not None or args.rate is not None):
        raise WrongUse("--at, --from, --to and --rate are for logs")
    if not sources.live and args.seconds is not None:
        raise WrongUse("--seconds is for live buses; --at shows a moment of a log")
    decoding = Decoding("monitor", args)
    patterns = decoding.patterns(args.signals)
    names = ", ".join(Path(name).name for name in sources.names)
    view = View(names, args.revision, decoding.databases if args.dbc else None)
    chunks = sources.chunks(args.seconds)
    terminal, still = _is_terminal(), not sources.live and args.rate is None
    textual = not (args.plain or args.json) and (terminal or still) and _has_textual()
    drawn = textual and terminal
    every_s = args.every if args.every is not None else _DRAW_EVERY_S if drawn else _PRINT_EVERY_S
    if sources.live:
        with closing(chunks):  # what was not received is told when it is over, however that came
            first = list(islice(chunks, 1))  # the bus is opened here, not in the thread
            source = Live(chain(first, chunks), view, lambda: sources.lost_here, lambda: sources.heard_ns())
            status = _show(source, every_s, patterns, args, drawn=drawn)
        return status | sources.status
    sources.tell_the_end(at, part)
    first = list(islice(chunks, 1))  # with it the log's first moment is known
    begin_ns = sources.first_ns or 0
    start_ns = (at if args.at is not None or still else part).bounds(begin_ns)[0]
    until_ns = part.bounds(begin_ns)[1]
    ahead = sources.files or still  # what is played while it is piped in may be without end: it is not kept
    read: list[Frames] = []
    frames = _noted(chain(first, chunks), read) if ahead else chain(first, chunks)
    log = PlayedLog(
        (each.only(each.t_ns <= until_ns) for each in frames),
        view,
        (start_ns - begin_ns) / S if math.isfinite(start_ns) else None,
        (args.rate or None) if drawn else args.rate,
        keep=ahead,
    )
    if log.empty:
        return sources.status

    @cache
    def verdict() -> Verdict:
        """Judge the whole log, once."""
        log.read_all()
        try:
            databases = decoding.databases if args.dbc else None
            found = judged(
                joined(read),
                args.revision,
                databases,
                part,
                begin_ns=sources.first_ns,
                recorded=sources.recorded,
            )
        except NoFrames as error:
            raise UserError(f"no frame of {sources.name} is in the chosen part") from error
        return found.verdict.unread(sources.unread)

    def findings(until_ns: int) -> list[str]:
        whole = verdict()
        shown = tuple(one for one in whole.findings if one.t_ns is None or one.t_ns <= until_ns)
        of = "part" if part else "whole log"
        return [f"{of}: {whole.line()}", *replace(whole, findings=shown).lines(remedies=False)]

    if part and ahead:
        verdict()  # where no frame is in the part, that is said at once
    if ahead:
        log.findings = findings
    shown = _show(log, every_s, patterns, args, drawn=drawn, still=still and textual)
    return shown | (verdict().status if ahead else sources.status)


def _noted(chunks: Iterator[Frames], read: list[Frames]) -> Iterator[Frames]:
    """Yield the same chunks, and add each of them to `read`."""
    for frames in chunks:
        read.append(frames)
        yield frames


def _show(
    source: Source, every_s: float, patterns: list[str], args: argparse.Namespace, *, drawn: bool, still: bool = False
) -> int:
    """Show the source drawn, or printed once as it stands still, or in lines, and return the exit status."""
    if drawn:
        return _draw(source, every_s, patterns)
    if still:
        _print_whole(source.look(), 80, 24, None)
    else:
        _print_lines(source, every_s, patterns, as_json=args.json)
    return 0


def _is_terminal() -> bool:
    """Return true where there is a terminal with keys that can be drawn on; textual draws on standard error."""
    able = os.environ.get("TERM", "") not in ("", "dumb")
    return able and all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr))


def _has_textual() -> bool:
    try:
        import textual  # noqa: F401
    except ImportError:
        print("fsai-vcu monitor: for pages and keys: pip install 'fsai-vcu[monitor]'", file=sys.stderr)
        return False
    return True


def _draw(source: Source, every_s: float, patterns: list[str]) -> int:
    from fsai_vcu.diagnostics.monitor.app import MonitorApp

    try:
        app = MonitorApp(source, every_s, patterns)
        app.run(mouse=False)  # so that the terminal's own selection works
    finally:
        source.close()
    width, height = shutil.get_terminal_size()
    _print_whole(app.moment, width, height, height - 1)  # what was shown last stays to be read
    sys.stderr.write("".join(app.printed))
    return app.return_code or 0


def _print_whole(moment: TimedPicture, width: int, height: int, most: int | None) -> None:
    """Print the moment once, as lines that stay, at most so many."""
    from rich.console import Console

    from fsai_vcu.diagnostics.monitor.drawing import head, overview

    console = Console(width=width, highlight=False)
    with console.capture() as captured:
        console.print(head(moment.picture, moment.words, width))
        console.print(overview(moment.picture, width, height))
    lines = [f"{line.rstrip()}\n" for line in captured.get().splitlines()[:most]]
    write_out("".join(lines).encode())


def _print_lines(source: Source, every_s: float, patterns: list[str], *, as_json: bool) -> None:
    """Print a line for each picture until the source ends."""
    try:
        while True:
            source.advance(every_s)
            source.wait(every_s)
            view, picture, time_s, words = source.look()
            signals = view.signals(patterns, picture.t_ns) if patterns else []
            shown = {"signals": {one.name: one.value for one in signals}} if patterns else {}
            entry = {"t": time_s, **picture.as_dict(), **shown}
            text = json.dumps(entry) if as_json else plain_line(picture, words, signals)
            write_out(f"{text}\n".encode())
            if source.ended or not source.playing:
                break
    except KeyboardInterrupt:
        if isinstance(source, PlayedLog):
            raise
    finally:
        source.close()
