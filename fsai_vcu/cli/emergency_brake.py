"""`fsai-vcu emergency-brake`: ask the car for an emergency stop, through the bridge."""

from __future__ import annotations

import argparse

EXAMPLE = "fsai-vcu emergency-brake"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from fsai_vcu.cli.services import add_bridge_arguments

    add_bridge_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.services import call

    return call(args, "emergency_brake")
