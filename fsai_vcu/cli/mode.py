"""`fsai-vcu mode`: autonomous or manual, through the bridge's /set_mode service."""

from __future__ import annotations

import argparse

from fsai_vcu.cli.services import add_bridge_arguments, call
from fsai_vcu.core.supervision.supervisor import MODES
from fsai_vcu.interface.errors import WrongUse, did_you_mean

EXAMPLE = "fsai-vcu mode autonomous"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("mode", metavar="autonomous|manual", help="the mode to set")
    add_bridge_arguments(parser)


def run(args: argparse.Namespace) -> int:
    if args.mode not in MODES:  # before ROS is loaded, which takes a while
        raise WrongUse(f"there is no mode '{args.mode}'{did_you_mean(args.mode, MODES)}")
    return call(args, "set_mode", mode=args.mode)
