"""`fsai-vcu check`: what is wrong on a bus or in a log."""

from __future__ import annotations

import argparse

from fsai_vcu.cli import stats

EXAMPLE = "fsai-vcu check run.log && echo the bus was well"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    stats.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    return stats.measured("check", args, table=False)
