"""`fsai-vcu drive`: a whole mission against the simulated car, in lockstep, without ROS or hardware."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from fsai_hil.evidence.campaign.cases import CHANCE, Case, case_from_spec
from fsai_hil.evidence.campaign.explain import ScenarioNarrator
from fsai_hil.evidence.campaign.scenario import Scenario, drive_to, power_up
from fsai_hil.evidence.campaign.table import catalogue_lines
from fsai_hil.evidence.campaign.verdict import as_record
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.profiles import PROFILES
from fsai_hil.simulator.setup_arguments import add_setup_arguments, setup_of
from fsai_hil.simulator.world import World, mission_named
from fsai_vcu.cli.main import UserError
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime.limits_file import read_limits
from fsai_vcu.runtime.recording import CandumpWriter

if TYPE_CHECKING:
    from fsai_hil.simulator.animation import Views

# whether it is well, the run to plot, what --json prints, and what is printed for people
Driven = tuple[bool, Any, dict[str, Any], list[str]]

EXAMPLE = (
    "fsai-vcu drive --mission trackdrive --laps 2 --seed 7 --plot run.png\n"
    "  fsai-vcu drive --mission acceleration --fault controller_silent:after=5000,duration=400"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_setup_arguments(parser, "autocross")
    add = parser.add_argument
    add("--profile", default="specification", choices=list(PROFILES), help="how the VCU behaves (specification)")
    add("--noise", type=float, default=1.0, metavar="X", help="noise of the cone sensor (1)")
    add("--max-speed", type=float, metavar="M/S", help="highest speed in every mission")
    add("--limits", type=Path, metavar="FILE.toml", help="operational limits imposed by an official")
    add(
        "--fault",
        metavar="NAME[:PARAMETER=VALUE,…]",
        help="inject a fault and explain the result; since=start|ready|driving|finished and after=MS"
        " say when, chance=N draws what the fault does at random; omitted parameters are drawn from --seed",
    )
    add("--full", action="store_true", help="with --fault: drive to the end of the mission")
    add("--list-faults", nargs="?", const="", metavar="WORD", help="list the kinds of fault, or those with that word")
    add("--realtime", action="store_true", help="drive in real time, not as fast as the computer can")
    add("--plot", type=Path, metavar="FILE.png", help="save a plot of track, driven path and speed")
    add("--animate", type=Path, metavar="FILE.gif|.mp4", help="save a film of the drive, seen from above")
    add("--animate-speed", type=float, default=2.0, metavar="X", help="play the film X times as fast as driven (2)")
    add("--log", type=Path, metavar="FILE", help="save the bus as a candump log")
    add("--json", action="store_true", help="print one JSON object, and nothing else, to standard output")


def run(args: argparse.Namespace) -> int:
    """Drive, then plot, animate and print the verdict; return the exit status."""
    try:
        if args.list_faults is not None:
            print("\n".join(catalogue_lines(args.list_faults)))
            return 0
        views = _views(args)
        passed, driven, record, lines = (_drive_with_fault if args.fault else _drive)(args, views)
        if args.plot:
            from fsai_hil.simulator.plot import plotted

            passed &= plotted("fsai-vcu drive", args.plot, driven)
        if views is not None:
            from fsai_hil.simulator.animation import animate

            animate("fsai-vcu drive", args.animate, driven, views.views, args.animate_speed)
        saved = [f"saved {path}" for path in (args.plot, args.animate, args.log) if path and path.exists()]
        if args.log and args.log.exists():
            saved.append(f"what happened, and why: fsai-vcu explain {shlex.quote(str(args.log))}")
        print(json.dumps(record) if args.json else "\n".join([*lines, *saved]))
        return 0 if passed else 1
    except (ValueError, OSError) as error:
        text = str(error)
        if isinstance(error, OSError):  # a disk that is full does not say which file it was
            text = f"{error.filename or args.log or args.plot}: {error.strerror}"
        raise UserError(text) from error


def _views(args: argparse.Namespace) -> Views | None:
    """Return the recorder of the views for --animate; it complains about missing parts before a long drive."""
    if args.animate is None:
        return None
    from fsai_hil.simulator.animation import Views, why_not

    if problem := why_not(args.animate):
        raise ValueError(problem)
    if not 0.1 <= args.animate_speed <= 100.0:
        raise ValueError(f"--animate-speed is {args.animate_speed:g}, but must be 0.1 to 100")
    return Views()


def _drive(args: argparse.Namespace, views: Views | None) -> Driven:
    """Drive one mission without a fault in lockstep."""
    setup = setup_of(args, [args.mission or "autocross"], profile=args.profile, noise_level=args.noise)
    settings = ControllerSettings()
    if args.max_speed is not None:
        settings = replace(settings, max_speed_mps=args.max_speed)
    limits = read_limits(args.limits) if args.limits else None
    if limits is not None:
        print("operational limits: " + ", ".join(limits.described()), file=sys.stderr)
    with ExitStack() as stack:
        writer = stack.enter_context(CandumpWriter(args.log, "vcan0")) if args.log else None
        lockstep = Lockstep(setup, limits=limits, controller=settings, on_frame=writer.write if writer else None)
        if views is not None:
            views.watch(lockstep)
        for mission in setup.missions:
            if line := lockstep.computer.controller.too_slow(mission):
                print(line, file=sys.stderr)
        result = lockstep.run(None if args.json else DriveProgress(), realtime=args.realtime)
    lines = [result.verdict.summary(), *(f"on the wire: {violation}" for violation in result.wire.violations)]
    if result.report.emergency and not result.passed:
        lines.append(f"emergency: {result.report.emergency}")
    lines += [f"gate: {reason} ({count}x)" for reason, count in result.report.reason_counts.items()]
    speed = result.sim_time_s / max(result.wall_time_s, 1e-9)
    lines.append(f"{result.sim_time_s:.1f} s driven in {result.wall_time_s:.1f} s ({speed:.1f} times real time)")
    return result.passed, lockstep.world.runs[-1], result.as_dict(), lines


def _drive_with_fault(args: argparse.Namespace, views: Views | None) -> Driven:
    """One case of the fault campaign, explained. Not passed: worse than the safety rules allow."""
    others = {"--track": args.track, "--laps": args.laps, "--limits": args.limits, "--max-speed": args.max_speed}
    for name, value in others.items():
        if value is not None:
            raise ValueError(f"{name} does not go with --fault: a fault is driven as in the campaign")
    if args.profile != "specification" or args.noise != 1.0 or args.realtime:
        raise ValueError("--profile, --noise and --realtime do not go with --fault")
    if args.seed < 0:
        raise ValueError(f"seed is {args.seed}, but must be 0 or more")
    mission = mission_named(args.mission) if args.mission else None
    case = case_from_spec(
        args.fault, mission=mission, revision=revision(args.revision).name, seed=args.seed, full=args.full
    )
    with ExitStack() as stack:
        writer = stack.enter_context(CandumpWriter(args.log, "vcan0")) if args.log else None
        rig = power_up(case.world, writer.write if writer else None)
        if views is not None:
            views.watch(rig)
        if case.leg_ms is not None:
            drive_to(rig, case.leg_ms)
        scenario = Scenario(case, rig)
        narrator = ScenarioNarrator(scenario)
        while not scenario.over:
            scenario.step()
            if not args.json:
                narrator.look()
    verdict = scenario.verdict()
    where = f"{case.mission.name.lower()}, revision {case.revision}, seed {case.seed}"
    judged = "as the safety rules demand" if verdict.ok else "WORSE THAN THE SAFETY RULES ALLOW"
    lines = [f"{where}; repeat this run:\n  {_repeated(case, args)}\n", *narrator.lines(verdict), judged]
    return verdict.ok, rig.world.runs[-1], as_record(case, verdict, {}), lines


def _repeated(case: Case, args: argparse.Namespace) -> str:
    """The command that drives this case again, and saves what was asked for."""
    if f"{CHANCE.name}=" not in args.fault:  # then the seed gives it
        case = replace(case, params={name: value for name, value in case.params.items() if name != CHANCE.name})
    asked: dict[str, Any] = {"--plot": args.plot, "--animate": args.animate, "--log": args.log}
    if args.animate:
        asked["--animate-speed"] = f"{args.animate_speed:g}"
    return " ".join((case.replay, *(f"{name} {shlex.quote(str(each))}" for name, each in asked.items() if each)))


class DriveProgress:
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
