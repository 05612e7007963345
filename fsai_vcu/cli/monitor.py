"""`fsai-vcu monitor`: what a bus says now, and why the car is not driving; only listens."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from fsai_vcu.cli.arguments import check_numbers
from fsai_vcu.cli.sources import Decoding, Output, Sources, add_database_arguments, add_source_argument
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.units import S

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.log.frames import Frames
    from fsai_vcu.diagnostics.monitor.snapshot import Picture
    from fsai_vcu.diagnostics.monitor.view import View

EXAMPLE = "fsai-vcu monitor can0\n  fsai-vcu monitor run.log --at 62.5\n  fsai-vcu monitor run.log --rate 2"
ABOUT = """\
Draws AS state, mission, what stands between now and driving, what is asked for
and what the car gives, faults, handshake, and every message with its rate and
age. It never sends. Ctrl-C or q ends it, p holds the picture. A log is shown as
it stood at its end, or at a moment, or played. Where the output is no terminal,
and with --plain, a line a second is printed."""

Clock = tuple[float, str]  # as a number for programs (s), and as words
Shown = tuple["Picture", Clock]

_DRAW_EVERY_S = 0.25
_PRINT_EVERY_S = 1.0
_FAR_OFF_NS = 60 * S  # a stamp so far from now is of a device's own clock


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{ABOUT}"
    add_source_argument(parser)
    add_database_arguments(parser)
    parser.add_argument("--every", type=float, metavar="S", help="how often (default: 0.25 drawn, 1 printed)")
    parser.add_argument("--seconds", type=float, metavar="S", help="end after so long (live; default: until Ctrl-C)")
    log = parser.add_mutually_exclusive_group()
    log.add_argument("--at", type=float, metavar="S", help="a log as it stood so many seconds after its start")
    log.add_argument("--rate", type=float, metavar="X", help="play a log, X times as fast; 0: without waiting")
    parser.add_argument("--plain", action="store_true", help="a line a second instead of drawing")
    parser.add_argument("--json", action="store_true", help="one JSON object a second instead of drawing")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.diagnostics.monitor.screen import is_terminal
    from fsai_vcu.diagnostics.monitor.view import View
    from fsai_vcu.interface.revisions import revision

    check_numbers(args, every=0.02, seconds=0.0, at=0.0, rate=0.0)
    sources = Sources("monitor", [args.source])
    if sources.live and (args.at is not None or args.rate is not None):
        raise WrongUse("--at and --rate are for logs")
    if not sources.live and args.seconds is not None:
        raise WrongUse("--seconds is for live buses; --at shows a moment of a log")
    decoding = Decoding("monitor", args)
    chosen = revision(args.revision) if args.revision else None
    databases = decoding.databases if args.dbc else None
    name = args.source.partition(",")[0]
    view = View("standard input" if name == "-" else Path(name).name, chosen, databases)
    lines = args.plain or args.json
    drawn = is_terminal() and not lines
    still = not sources.live and args.rate is None
    every_s = args.every if args.every is not None else _DRAW_EVERY_S if drawn else _PRINT_EVERY_S
    if still:
        moments = _still(args, sources, view)
    else:
        moments = _live(sources, view, args.seconds, every_s) if sources.live else _played(sources, view, args, every_s)
    last: Shown | None = None
    with ExitStack() as stack:
        show = None if still and not lines else _shower(args, drawn, stack)
        try:
            for last in moments:
                if show is not None and not show(*last):
                    break
        except KeyboardInterrupt:
            if not sources.live:
                raise
    if last is not None and (drawn or show is None):
        _print_whole(*last, on_terminal=drawn)  # what was shown last stays to be read
    return sources.status


# ---------------------------------------------------------------- moments


def _live(sources: Sources, view: View, seconds: float | None, every_s: float) -> Iterator[Shown]:
    """Pictures of a live bus. Ages are reckoned on the monotonic clock: a step of the wall clock changes none."""
    due_s = time.monotonic()
    for frames in sources.chunks(seconds):
        now_ns = time.monotonic_ns()
        view.update(_on_our_clock(frames, time.time_ns(), now_ns))
        if time.monotonic() >= due_s:
            due_s = max(due_s + every_s, time.monotonic())
            wall_s = time.time()
            yield view.picture(now_ns), (wall_s, datetime.fromtimestamp(wall_s).strftime("%H:%M:%S"))


def _on_our_clock(frames: Frames, wall_ns: int, now_ns: int) -> Frames:
    """Stamps of the wall clock (or of a device's own) as times of the monotonic clock, none of them in the future."""
    import numpy as np

    if not len(frames):
        return frames
    newest_ns = int(frames.t_ns.max())
    reference_ns = wall_ns if abs(wall_ns - newest_ns) < _FAR_OFF_NS else newest_ns
    return frames.at(np.minimum(frames.t_ns - reference_ns + now_ns, now_ns))


def _played(sources: Sources, view: View, args: argparse.Namespace, every_s: float) -> Iterator[Shown]:
    """Pictures of a log, as often as it was asked for on the clock of the one who looks."""
    import numpy as np

    step_ns = max(1, round(every_s * (args.rate or 1.0) * S))
    begin_ns = due_ns = None
    due_s = time.monotonic()
    for frames in sources.chunks():
        while len(frames):
            if due_ns is None or begin_ns is None:
                begin_ns = int(frames.t_ns[0])
                due_ns = begin_ns + step_ns
            later = (frames.t_ns >= due_ns).nonzero()[0]
            cut = int(later[0]) if len(later) else len(frames)
            view.update(frames.head(cut))
            frames = frames.only(np.arange(cut, len(frames), dtype=np.int64))
            if len(later):
                yield _moment(view, begin_ns, due_ns)
                due_ns += step_ns
                due_s += every_s
                if args.rate:
                    time.sleep(max(0.0, due_s - time.monotonic()))
    if begin_ns is not None:
        yield _moment(view, begin_ns, 0)


def _still(args: argparse.Namespace, sources: Sources, view: View) -> Iterator[Shown]:
    """A log as it stood at its end, or at --at. Nothing for an empty log, which Sources has reported."""
    begin_ns: int | None = None
    for frames in sources.chunks():
        if not len(frames):
            continue
        if begin_ns is None:
            begin_ns = int(frames.t_ns[0])
        view.update(frames if args.at is None else frames.only(frames.t_ns <= begin_ns + round(args.at * S)))
    if begin_ns is None:
        return
    if view.memory.newest_ns is None:
        raise UserError(f"{args.source}: no frame up to {args.at:g} s")
    yield _moment(view, begin_ns, 0 if args.at is None else begin_ns + round(args.at * S))


def _print_whole(picture: Picture, clock: Clock, *, on_terminal: bool) -> None:
    """Once, as lines that stay."""
    from fsai_vcu.diagnostics.monitor.drawing import screen_lines
    from fsai_vcu.diagnostics.monitor.screen import USUAL_SIZE, size

    width, height = size() if on_terminal else USUAL_SIZE
    color = on_terminal and not os.environ.get("NO_COLOR")
    lines = screen_lines(picture, width, max(USUAL_SIZE[1], height - 1), clock[1], color=color)
    Output().write(("\n".join(line.rstrip() for line in lines) + "\n").encode(), at_once=True)


def _moment(view: View, begin_ns: int, at_ns: int) -> Shown:
    """The picture at `at_ns` or at the newest frame, whichever is later."""
    now_ns = max(at_ns, view.memory.newest_ns or 0)
    return view.picture(now_ns), (now_ns / S, f"{(now_ns - begin_ns) / S:.1f} s into the log")


# ---------------------------------------------------------------- showing


def _shower(args: argparse.Namespace, drawn: bool, stack: ExitStack) -> Callable[[Picture, Clock], bool]:
    """Shows a picture, and says whether to go on."""
    from fsai_vcu.diagnostics.monitor.drawing import plain_line, screen_lines
    from fsai_vcu.diagnostics.monitor.screen import Screen, size

    if drawn:
        screen = stack.enter_context(Screen())
        color = not os.environ.get("NO_COLOR")
        held: Shown | None = None

        def draw(picture: Picture, clock: Clock) -> bool:
            nonlocal held
            keys = screen.keys()
            if "p" in keys:
                held = None if held else (picture, (clock[0], f"paused at {clock[1]}"))
            shown, at = held or (picture, clock)
            screen.draw(screen_lines(shown, *size(), at[1], color=color))
            return "q" not in keys

        return draw
    output = Output()

    def write(picture: Picture, clock: Clock) -> bool:
        text = json.dumps({"t": clock[0], **picture.as_dict()}) if args.json else plain_line(picture, clock[1])
        output.write(f"{text}\n".encode(), at_once=True)
        return True

    return write
