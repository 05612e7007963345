"""`fsai-vcu reset`: clear the latched emergency request, through the bridge's /reset service."""

from __future__ import annotations

import argparse

EXAMPLE = "fsai-vcu reset"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from fsai_vcu.cli.services import add_bridge_arguments

    add_bridge_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.services import call

    return call(args, "reset")
