"""`fsai-vcu drive`: a whole mission against the simulated car, in lockstep, without ROS or hardware."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fsai_hil.world import World
    from fsai_vcu.core.report import BridgeReport

EXAMPLE = "fsai-vcu drive --mission trackdrive --laps 2 --seed 7 --plot run.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--mission", default="autocross", help="what the AMI is set to (default: autocross)")
    parser.add_argument("--track", metavar="FILE.csv|NAME", help="default: the mission's own built-in track")
    parser.add_argument("--laps", type=int, metavar="N", help="laps of a trackdrive (default: 10)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of every chance in the run (default: 0)")
    parser.add_argument("--revision", default="2026", help="interface revision: 2021 or 2026 (default: 2026)")
    parser.add_argument(
        "--profile", default="specification", help="the VCU's manners: specification or official-simulator"
    )
    parser.add_argument("--noise", type=float, default=1.0, metavar="X", help="noise of the cone sensor (default: 1)")
    parser.add_argument("--max-speed", type=float, metavar="M/S", help="highest speed on a circuit")
    parser.add_argument("--limits", type=Path, metavar="FILE.toml", help="operational limits imposed by an official")
    parser.add_argument("--realtime", action="store_true", help="as fast as the clock, not as the computer")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="save a plot of track, path driven and speed")
    parser.add_argument("--log", type=Path, metavar="FILE", help="save the bus as a candump log")
    parser.add_argument("--json", action="store_true", help="print one JSON object as the last line")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.main import UserError

    try:
        return _drive(args)
    except (ValueError, OSError) as error:
        text = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else str(error)
        raise UserError(text) from error


def _drive(args: argparse.Namespace) -> int:
    from dataclasses import replace

    from fsai_hil.lockstep import Lockstep
    from fsai_hil.plot import PlotError, save_plot
    from fsai_hil.tracks import load_track
    from fsai_hil.world import WorldSetup, mission_named
    from fsai_vcu.core.control.settings import ControllerSettings
    from fsai_vcu.runtime.limits_file import read_limits
    from fsai_vcu.runtime.recording import CandumpWriter

    if args.laps is not None and args.laps < 1:
        raise ValueError(f"--laps is {args.laps}, but at least 1 lap can be driven")
    setup = WorldSetup(
        missions=[mission_named(args.mission)],
        track=load_track(args.track) if args.track else None,
        revision=args.revision,
        profile=args.profile,
        seed=args.seed,
        laps=args.laps,
        noise_level=args.noise,
    )
    settings = ControllerSettings()
    if args.max_speed is not None:
        settings = replace(settings, max_speed_mps=args.max_speed)
    limits = read_limits(args.limits) if args.limits else None
    if limits is not None:
        print("operational limits: " + ", ".join(limits.described()), file=sys.stderr)
    with ExitStack() as stack:
        writer = stack.enter_context(CandumpWriter(args.log, "vcan0")) if args.log else None
        lockstep = Lockstep(setup, limits=limits, controller=settings, on_frame=writer.write if writer else None)
        result = lockstep.run(None if args.json else Progress(), realtime=args.realtime)
    status = 0 if result.passed else 1
    if args.plot:
        try:
            save_plot(args.plot, lockstep.world.track, lockstep.world.samples, result.verdict)
        except PlotError as error:
            print(f"fsai-vcu drive: {error}", file=sys.stderr)
            status = 1
    if args.json:
        print(json.dumps(result.as_dict()))
        return status
    print(result.verdict.summary())
    for violation in result.wire.violations:
        print(f"on the wire: {violation}")
    if result.report.emergency and not result.passed:
        print(f"emergency: {result.report.emergency}")
    for reason, count in result.report.reason_counts.items():
        print(f"gate: {reason} ({count}x)")
    speed = result.sim_time_s / max(result.wall_time_s, 1e-9)
    print(f"{result.sim_time_s:.1f} s driven in {result.wall_time_s:.1f} s ({speed:.0f} times real time)")
    for path in (args.plot, args.log):
        if path and path.exists():
            print(f"saved {path}")
    return status


class Progress:
    """A line when the AS state changes, and one every five seconds of driving."""

    EVERY_S = 5.0

    def __init__(self) -> None:
        self._state = ""
        self._next_s = 0.0

    def __call__(self, world: World, report: BridgeReport) -> None:
        truth, now_s = world.truth, world.now_ns / 1e9
        if truth.as_state == self._state and now_s < self._next_s:
            return
        self._state, self._next_s = truth.as_state, now_s + self.EVERY_S
        why = f"  {report.why_not_driving[0]}" if report.why_not_driving else ""
        print(
            f"{now_s:6.1f} s  {truth.as_state:<15} {report.mode:<10} {truth.speed_mps:5.1f} m/s  lap {truth.laps}{why}",
            file=sys.stderr,
        )
