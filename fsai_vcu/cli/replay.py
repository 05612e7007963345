"""`fsai-vcu replay`: a log sent onto a bus again."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from typing import Final

import numpy as np

from fsai_vcu.arguments import check_numbers
from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.output import Progress
from fsai_vcu.cli.sources import LOG_HELP, Sources, add_part_arguments, part_of
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.transmit.replaying import Player, choose, is_physical
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.bus import BusLost, check_interface, open_bus, split_spec

EXAMPLE = "fsai-vcu replay run.log vcan0 --from 12.5 --to 20 --rate 0.5 --loop"
_LATE_NS: Final = 10_000_000  # a cycle of the bus
_PAUSE_NS: Final = 60 * S


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: logs, the bus to send on, and how fast and how often."""
    add = parser.add_argument
    add(
        "logs",
        nargs="+",
        metavar="LOG[,FILTER…]",
        help=f"{LOG_HELP}, with candump's filters: ID:MASK, ID~MASK, j; the last argument is the bus to send on",
    )
    add(
        "-i",
        "--interface",
        metavar="BUS",
        help="the bus to send on, instead of the last argument: vcan0, loopback:NAME …",
    )
    add("--rate", type=float, default=1.0, metavar="X", help="send X times as fast as recorded (default: 1)")
    add("--loop", nargs="?", type=int, const=0, metavar="N", help="repeat until Ctrl-C, or N times (default: once)")
    add_part_arguments(parser)  # no signals: a frame is sent whole
    add_database_arguments(parser)
    add(
        "--skip-pauses",
        action="store_true",
        help="shorten each pause of over a minute in the log to a second",
    )
    add("--physical", action="store_true", help="the interface may be a real bus; reserved identifiers are left out")
    add(
        "--with-ai-ids",
        action="store_true",
        help="send 0x510 to 0x514 too: to a bridge on the bus they come from a second sender",
    )


def run(args: argparse.Namespace) -> int:
    """Check the arguments and the bus, then send the log's frames in their rhythm."""
    check_numbers(args, loop=0, rate=0.01)
    if args.interface is None:
        args.interface = args.logs.pop()
        if not args.logs or not Sources("replay", [args.interface]).live:
            raise WrongUse("the last argument is the bus to send on: fsai-vcu replay run.log vcan0")
    sources = Sources("replay", args.logs, part=part_of(args, Decoding("replay", args)))
    if sources.live:
        raise WrongUse(f"{sources.name} is an interface; replay reads logs")
    kind, channel = split_spec(args.interface)
    if kind == "socketcan":
        check_interface(channel)  # before anybody is told to say --physical
    physical = is_physical(args.interface)
    if physical and not args.physical:
        raise UserError(
            f"{args.interface} may be a real bus, with a car on it: frames of a log can move it; "
            "to send all the same, add --physical"
        )
    chosen, left_out = choose(sources.everything(), with_ai_ids=args.with_ai_ids, physical=physical)
    if left_out:
        print(f"fsai-vcu replay: left out: {left_out}", file=sys.stderr)
    if not len(chosen):
        raise UserError("nothing is left to send")
    chosen = _paced(chosen, skip=args.skip_pauses)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended by a script as by Ctrl-C
    bus = open_bus(args.interface, receive=(), may_send=set(chosen.can_id.tolist()) if physical else None)
    laps = 1 if args.loop is None else args.loop or None
    player = Player(chosen, bus.send, time.monotonic_ns, time.sleep, rate=args.rate, laps=laps)
    status = sources.status
    progress = Progress()
    sent = "{} frames sent"
    with bus:
        try:
            for _ in player.play():
                progress.show(lambda: f"{player.sent} frames sent, {player.laps} times through {len(chosen)}")
        except KeyboardInterrupt:
            if laps is not None:
                sent = f"interrupted: {{}} of {laps * len(chosen)} frames sent"
        except BusLost as error:
            print(f"fsai-vcu replay: {error}", file=sys.stderr)
            status = 1
        finally:
            progress.end()
    return max(status, _result(player, sent.format(player.sent)))


def _paced(frames: Frames, *, skip: bool) -> Frames:
    """Says how long the log's pauses are; skip: with each of them a second long."""
    steps_ns = np.diff(frames.t_ns, prepend=frames.t_ns[:1])
    pauses = steps_ns > _PAUSE_NS
    if not pauses.any():
        return frames
    whole_s = int(steps_ns[pauses].sum()) // S
    which = f"{np.count_nonzero(pauses)} of over a minute, {whole_s} s in all"
    print(f"fsai-vcu replay: pauses {'skipped' if skip else 'waited for (--skip-pauses)'}: {which}", file=sys.stderr)
    return frames.at(frames.t_ns - np.cumsum(np.where(pauses, steps_ns - S, 0))) if skip else frames


def _result(player: Player, sent: str) -> int:
    print(sent, file=sys.stderr)
    if player.refused:
        print(f"fsai-vcu replay: {player.refused} frames not sent: the transmit queue stayed full", file=sys.stderr)
    if player.late_max_ns > _LATE_NS:
        late = f"frames were sent up to {player.late_max_ns / 1e6:.0f} ms late"
        gaps = "more than a cycle (10 ms): a receiver that supervises periods sees gaps"
        print(f"fsai-vcu replay: {late}, {gaps}", file=sys.stderr)
    return 1 if player.refused else 0
