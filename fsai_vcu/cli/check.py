"""`fsai-vcu check`: what is wrong on a bus or in a log."""

import argparse

from fsai_vcu.cli.stats import ABOUT, add_arguments, measured  # noqa: F401  what every verb's file has

EXAMPLE = "fsai-vcu check run.log && echo the bus was well"


def run(args: argparse.Namespace) -> int:
    return measured("check", args, table=False)
