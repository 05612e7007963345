"""`fsai-vcu record`: what is on a bus, as a candump log."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path

EXAMPLE = "fsai-vcu record -i vcan0 -o run.log"
_WAIT_S = 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-i", "--interface", required=True, help="CAN interface: vcan0, can0, loopback:NAME …")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="FILE", help="the log to write")
    parser.add_argument("--seconds", type=float, metavar="S", help="stop after so long (default: until Ctrl-C)")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.main import UserError
    from fsai_vcu.runtime.bus import BusError, BusLost, open_bus
    from fsai_vcu.runtime.recording import CandumpWriter

    if args.seconds is not None and not 0.0 <= args.seconds < float("inf"):
        raise UserError(f"--seconds is {args.seconds:g}, not a time")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a stopped service closes its log as Ctrl-C does
    name = args.interface.partition(":")[2] or args.interface
    try:
        bus = open_bus(args.interface)
    except BusError as error:
        raise UserError(str(error)) from error
    try:
        writer = CandumpWriter(args.output, name)
    except OSError as error:
        bus.close()
        raise UserError(f"cannot write {args.output}: {error.strerror}") from error
    until_ns = None if args.seconds is None else time.monotonic_ns() + int(args.seconds * 1e9)
    with bus, writer:
        try:
            while until_ns is None or time.monotonic_ns() < until_ns:
                heard = bus.recv_stamped(_WAIT_S)
                if heard is not None:
                    writer.write(*heard)
        except KeyboardInterrupt:
            pass
        except BusLost as error:
            print(f"fsai-vcu record: {error}; {writer.frames} frames kept in {args.output}", file=sys.stderr)
            return 1
        except OSError as error:
            raise UserError(f"cannot write {args.output}: {error.strerror}") from error
        print(f"{writer.frames} frames in {args.output}", file=sys.stderr)
    return 0
