"""`fsai-vcu send`: a frame by message and signal names, for the bench; never beside a live bridge."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from contextlib import ExitStack

from fsai_vcu.arguments import BUS_HELP, check_numbers
from fsai_vcu.cli.decoding import add_database_arguments
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.transmit.sending import Outgoing, outgoing
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.reserved import AI_IDS, OPTIONAL_AI_ID
from fsai_vcu.runtime.bus import BusLost, CanBus, open_bus
from fsai_vcu.runtime.lock import InterfaceLock

EXAMPLE = (
    "fsai-vcu send AI2VCU_Steer STEER_REQUEST=5 --as-ai --dry-run\n"
    "  fsai-vcu send can0 BenchLamp COLOUR=RED --dbc bench.dbc --count 10 --period 100\n"
    "  fsai-vcu send vcan0 AI2VCU_Steer STEER_REQUEST=5 --as-ai"
)
ABOUT = """\
A signal that is not named gets the database's initial value, or 0; it must be
named if 0 is out of its range. Values are numbers or words of the signal's table.
Identifiers reserved for the car, and those of the VCU and of the car's other
devices, are always refused. The AI computer's identifiers (0x510 to 0x514) are
refused without --as-ai: a car that receives them switches its tractive system on
and arms its EBS. 0x501 of the PCAN-GPS is refused without --as-ai, too: an AI
computer sends it only on a car without a PCAN-GPS. If another program sends them
on this bus already, nothing is sent; if one begins to, sending ends at once."""

_LISTEN_S = 0.5  # fifty cycles of a bridge
_LEAST_LISTEN_S = 0.2  # as long as a bridge itself listens before it sends
_PERIOD_MS = 100.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: bus, message, signals, and how often and how carefully it is sent."""
    add = parser.add_argument
    add("bus", nargs="?", metavar="BUS", help=f"{BUS_HELP}; --dry-run needs none")
    add("message", metavar="MESSAGE", help="name of the message, or its identifier as in 0x514")
    add("signals", nargs="*", metavar="SIGNAL=VALUE", help="its signals")
    add("-i", "--interface", metavar="BUS", help="the bus, as an option")
    add_database_arguments(parser, "2026")
    add("--count", type=int, default=1, metavar="N", help="send N times (default: 1; 0: until Ctrl-C)")
    add("--period", type=float, metavar="MS", help="MS milliseconds apart (default: the database's period, or 100)")
    add(
        "--listen",
        type=float,
        default=_LISTEN_S,
        metavar="S",
        help="listen for a live bridge before sending (default: 0.5 s)",
    )
    add("--as-ai", action="store_true", help="send the AI computer's own identifiers too: see above")
    add("--dry-run", action="store_true", help="send nothing; print the frame as cansend takes it")
    add("--json", action="store_true", help="print the frame and its signals as one JSON object")


def run(args: argparse.Namespace) -> int:
    """Make the frame of the arguments, and show it or send it."""
    check_numbers(args, count=0, period=1.0, listen=_LEAST_LISTEN_S)
    databases = load_databases(args.dbc, args.revision)
    if args.bus is not None:
        known = any(layout.is_called(args.bus) for layout in databases.layouts.values())
        if args.interface is not None or known or "=" in args.message:  # the first word is the message
            args.message, args.signals = args.bus, [args.message, *args.signals]
        else:
            args.interface = args.bus
    frame = outgoing(databases, args.message, args.signals, as_ai=args.as_ai)
    if args.dry_run:
        _show(args, frame)
        return 0
    if args.interface is None:
        raise WrongUse(f"the bus is missing: fsai-vcu send can0 {args.message} …; --dry-run sends nothing")
    return _send(args, frame)


def _show(args: argparse.Namespace, frame: Outgoing) -> None:
    """Print the frame: its signals, or an object with --json."""
    if args.json:
        shown = {
            "message": frame.message,
            "id": frame.frame.can_id,
            "extended": frame.frame.extended,
            "frame": frame.cansend,
            "signals": dict(frame.values),
            "filled": list(frame.filled),
        }
        print(json.dumps(shown))
        return
    print(frame.cansend)
    values = ", ".join(f"{name} {value}" for name, value in frame.values.items())
    print(f"{frame.message}: {values or 'no signals'}", file=sys.stderr)
    if frame.filled:
        print(f"not named, so at the database's initial value: {', '.join(frame.filled)}", file=sys.stderr)


def _send(args: argparse.Namespace, outgoing: Outgoing) -> int:
    """Listen first, then send the frame as often as asked; return the exit status."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended by a script as by Ctrl-C
    with ExitStack() as stack:
        if outgoing.is_of_the_ai:  # no bridge begins while another program speaks for the AI computer
            stack.callback(InterfaceLock(args.interface, polite=True).release)
        bus = stack.enter_context(open_bus(args.interface, may_send={outgoing.frame.can_id}))
        sender = _Sender(bus, args, outgoing)
        try:
            sender.watch(time.monotonic() + args.listen)
            _show(args, outgoing)
            sender.run()
        except BusLost as error:
            raise UserError(f"{error}; {sender.sent} frames were sent") from error
        except KeyboardInterrupt:
            if args.count:
                raise
    dropped = f", {sender.dropped} dropped because the transmit queue was full" if sender.dropped else ""
    print(f"{sender.sent} frame{'s' * (sender.sent != 1)} sent on {args.interface}{dropped}", file=sys.stderr)
    return 1 if sender.dropped else 0


class _Sender:
    """Sends, and stops at the first sign of a live bridge."""

    def __init__(self, bus: CanBus, args: argparse.Namespace, outgoing: Outgoing) -> None:
        self.sent = 0
        self.dropped = 0
        self._bus = bus
        self._count: int = args.count
        self._period_s = (args.period or outgoing.period_ms or _PERIOD_MS) / 1000.0
        self._frame = outgoing.frame

    def run(self) -> None:
        due_s = time.monotonic()
        while True:
            if self._bus.send(self._frame):
                self.sent += 1
            else:
                self.dropped += 1
            if self._count and self.sent + self.dropped >= self._count:
                return
            due_s = max(due_s + self._period_s, time.monotonic())  # late ones are not caught up with in a burst
            self.watch(due_s)

    def watch(self, until_s: float) -> None:
        """Receive until then, and in any case all that has come so far. Raises UserError for a live bridge."""
        ours = {*AI_IDS, *({OPTIONAL_AI_ID} & {self._frame.can_id})}
        while True:
            left_s = until_s - time.monotonic()
            frame = self._bus.recv(max(0.0, left_s))
            if frame is None:
                if left_s <= 0.0:
                    return
                continue
            if frame.extended or frame.error or frame.can_id not in ours:
                continue
            sender = "a PCAN-GPS" if frame.can_id == OPTIONAL_AI_ID else "a live bridge"
            before = f"; {self.sent} frames were sent before" if self.sent else ""
            raise UserError(f"{sender} is on {self._bus.spec} (0x{frame.can_id:03X}): stop it first{before}")
