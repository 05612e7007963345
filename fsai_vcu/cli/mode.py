"""`fsai-vcu mode`: autonomous or manual, through the bridge's /set_mode service."""

from __future__ import annotations

import argparse
from difflib import get_close_matches

from fsai_vcu.cli.services import add_bridge_arguments, call
from fsai_vcu.core.supervision.supervisor import MODES
from fsai_vcu.interface.errors import WrongUse

EXAMPLE = "fsai-vcu mode autonomous"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("mode", help="autonomous or manual")
    add_bridge_arguments(parser)


def run(args: argparse.Namespace) -> int:
    if args.mode not in MODES:  # before ROS is loaded, which takes a while
        near = get_close_matches(args.mode, MODES, 1, cutoff=0.4)
        raise WrongUse(f"there is no mode '{args.mode}'; {f'did you mean {near[0]}?' if near else ' or '.join(MODES)}")
    return call(args, "set_mode", mode=args.mode)
