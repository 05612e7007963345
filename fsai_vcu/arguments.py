"""What numbers on a command line may be."""

from __future__ import annotations

import argparse
import math

from fsai_vcu.interface.errors import WrongUse


def check_numbers(args: argparse.Namespace, **least: float) -> None:
    """Raises WrongUse for an option that was given and is not finite, or less than its `least`."""
    for name, bound in least.items():
        value = getattr(args, name)
        if value is not None and not bound <= value < math.inf:
            raise WrongUse(f"--{name} is {value:g}, but must be {bound:g} or more")
