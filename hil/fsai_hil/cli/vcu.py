"""`fsai-vcu vcu`: the simulated VCU and car as a process on a bus."""

from __future__ import annotations

import argparse

EXAMPLE = "fsai-vcu vcu -i vcan0 --mission trackdrive --laps 2 --auto"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from fsai_hil.simulator import process

    process.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from fsai_hil.simulator import process

    return process.run(args)
