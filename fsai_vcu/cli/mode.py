"""`fsai-vcu mode`: autonomous or manual, through the bridge's /set_mode service."""

from __future__ import annotations

import argparse

from fsai_vcu.cli.services import add_bridge_arguments, call

EXAMPLE = "fsai-vcu mode autonomous"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("mode", help="autonomous or manual")
    add_bridge_arguments(parser)


def run(args: argparse.Namespace) -> int:
    return call(args, "set_mode", mode=args.mode)
