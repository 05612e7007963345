"""The arguments that all programs have which drive a car: what is driven and on which car, as it is typed."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from fsai_hil.simulator.tracks import NAMES, load_track
from fsai_hil.simulator.world import WorldSetup, mission_named
from fsai_vcu.interface.enums import Ami


def add_setup_arguments(parser: argparse.ArgumentParser, default: str, missions: str = "NAME") -> None:
    """`default`: the mission that is driven where none is named. `missions`: the form in which they are named."""
    known = ", ".join(ami.name.lower() for ami in Ami if ami is not Ami.NOT_SELECTED)
    add = parser.add_argument
    add("--mission", metavar=missions, help=f"{known} ({default})")
    tracks = f"a file, or {', '.join(NAMES)} (the mission's own)"
    add("--track", metavar="FILE|NAME", help=tracks)
    add("--laps", type=int, metavar="N", help="laps of a trackdrive (10)")
    add("--revision", default="2026", help="interface revision of the car (2026)")
    add("--seed", type=int, default=0, metavar="N", help="seed of everything random (0)")


def setup_of(args: argparse.Namespace, missions: Sequence[str], **others: Any) -> WorldSetup:
    """The setup of a world. Raises ValueError (TrackError is one) for what cannot be driven."""
    return WorldSetup(
        missions=[mission_named(name) for name in missions],
        track=load_track(args.track) if args.track else None,
        revision=args.revision,
        seed=args.seed,
        laps=args.laps,
        **others,
    )
