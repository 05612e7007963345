"""Arguments that several verbs take alike: the bus, and what numbers may be."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any, Final

from fsai_vcu.interface.errors import WrongUse

BUS_HELP: Final = "the bus: vcan0, can0, loopback:NAME …"


class _Bus(argparse.Action):
    """The first argument is the bus, unless it is left out; another one in -i is refused."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        if not isinstance(values, str):
            return
        given = getattr(namespace, self.dest, None)
        if given not in (None, parser.get_default(self.dest), values):
            parser.error(f"two buses: {values}, and -i {given}")
        setattr(namespace, self.dest, values)


def add_bus_argument(parser: argparse.ArgumentParser, words: str = BUS_HELP, default: str | None = None) -> None:
    """The bus as the first argument; scripts that name it by -i go on working."""
    parser.add_argument("-i", "--interface", metavar="BUS", default=default, help="the same, as an option")
    parser.add_argument("interface", nargs="?", metavar="BUS", action=_Bus, help=words)


def check_numbers(args: argparse.Namespace, **least: float) -> None:
    """Raise WrongUse for an option that was given and is not finite, or less than its `least`."""
    for name, bound in least.items():
        value = getattr(args, name)
        if value is not None and not bound <= value < math.inf:
            raise WrongUse(f"--{name} is {value:g}, but must be {bound:g} or more")
