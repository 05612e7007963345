"""`fsai-vcu doctor`: what is right and what is wrong on this machine, on one screen; and how the wheels are wired."""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from fsai_vcu.arguments import add_bus_argument
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.diagnostics.doctor.checks import FOR_THE_CAR, examine
from fsai_vcu.diagnostics.doctor.collect import collect, laptop
from fsai_vcu.diagnostics.doctor.machine import Wanted
from fsai_vcu.diagnostics.doctor.wheels import NAMES, WheelWiringCheck
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.files import is_there
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.interface.messages import WheelCounts, WheelSpeeds
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.interface.wheels import STRAIGHT, WheelMapping
from fsai_vcu.runtime.bus import open_bus
from fsai_vcu.runtime.configuration import (
    BITRATE,
    QUEUE_FRAMES,
    USUAL_PATH,
    Configuration,
    ConfigurationError,
    read_configuration,
)

EXAMPLE = "fsai-vcu doctor; fsai-vcu doctor --wheels"

INSTALLED = Path("/usr/lib/fsai/manifest")  # of the car's software
_MARKS = {"right": "ok  ", "problem": "WRONG", "note": "-   "}
_PATIENCE_S = 60.0  # for a wheel to be turned


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--config", type=Path, metavar="FILE", help="the car PC's configuration (default: /etc/fsai/fsai.toml)")
    add_bus_argument(parser, "the bus to listen to (default: the configuration's)")
    add("--seconds", type=float, default=2.0, metavar="S", help="how long to listen to the bus (2 s)")
    add("--wheels", action="store_true", help="commissioning: asks for one wheel after the other to be turned by hand")
    add("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Exit status: 0 when nothing is wrong."""
    if not 0.0 < args.seconds < math.inf:
        raise WrongUse(f"--seconds is {args.seconds:g}, not a time to listen for")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if args.config is None and not args.wheels and not (is_there(USUAL_PATH) or INSTALLED.exists()):
        return _show(examine(laptop(args.interface, args.seconds)), as_json=args.json)
    configuration: Configuration | None = None
    problems: tuple[str, ...] = ()
    try:
        configuration = read_configuration(args.config or USUAL_PATH)
    except ConfigurationError as error:
        problems = error.problems
    if args.wheels:
        if configuration is None:
            raise UserError(problems[0])
        return _turn_wheels(configuration, args.interface or configuration.interface, as_json=args.json)

    wanted = codec = None
    if configuration is not None:
        wanted = _wanted(configuration, args.interface)
        codec = _codec(configuration, configuration.wheel_mapping)
    return _show(examine(collect(wanted, problems, codec, args.seconds)), as_json=args.json)


def _as_dict(finding: Finding) -> dict[str, str]:
    level = "wrong" if finding.severity == "problem" else finding.severity
    return {"topic": finding.kind, "level": level, "words": finding.words, "todo": finding.remedy}


def _show(findings: Sequence[Finding], *, as_json: bool) -> int:
    """Print the findings as lines, or as JSON; return the exit status, 1 where something is wrong."""
    wrong = sum(finding.severity == "problem" for finding in findings)
    if as_json:
        print(json.dumps({"wrong": wrong, "findings": [_as_dict(finding) for finding in findings]}))
        return 1 if wrong else 0
    width = max(len(finding.kind) for finding in findings)
    for finding in findings:
        print(f"{_MARKS[finding.severity]:<5} {finding.kind:<{width}}  {finding.words}")
        if finding.remedy:
            print(f"{'':5} {'':<{width}}  -> {finding.remedy}")
    lacks = sum(finding.kind == FOR_THE_CAR for finding in findings)
    to_do = sum(bool(finding.remedy) for finding in findings if finding.severity != "problem") - lacks
    well = "this computer can simulate" if lacks else "nothing is wrong" if to_do else "all is well"
    well += f"; {to_do} to correct (->)" * bool(to_do)
    last = f"{wrong} wrong" if wrong else well
    print(last + f"; it cannot drive the car: the lines '{FOR_THE_CAR}' say what it lacks" * bool(lacks))
    return 1 if wrong else 0


def _wanted(configuration: Configuration, interface: str | None) -> Wanted:
    """Return the settings that the doctor holds the machine against."""
    return Wanted(
        path=str(configuration.path),
        interface=interface or configuration.interface,
        configured_interface=configuration.interface,
        revision=configuration.revision,
        bitrate=BITRATE,
        queue_frames=QUEUE_FRAMES,
        wheel_mapping=str(configuration.wheel_mapping),
        limits=configuration.limits_described(),
        limits_path=str(configuration.limits_path or ""),
        environment=configuration.environment(),
        discovery=configuration.text("ros", "discovery"),
        keystore=configuration.text("ros", "keystore"),
        recording_folder=configuration.text("recording", "folder"),
        leave_free_mib=int(configuration.number("recording", "leave_free_mib")),
    )


def _codec(configuration: Configuration, mapping: WheelMapping) -> Codec:
    files = [Path(name) for name in configuration.dbc_files]
    return Codec(REVISIONS[configuration.revision], files or None, mapping)


def _turn_wheels(configuration: Configuration, interface: str, *, as_json: bool) -> int:
    """The commissioning check: each wheel is turned once, forwards, with the car on stands and nothing energised."""
    codec = _codec(configuration, STRAIGHT)  # the wheels as their signals are called
    pulses_per_rev = CARS[configuration.car].wheel_pulses_per_rev
    check = WheelWiringCheck()
    asked: str | None = None
    problems: list[str] = []

    def show(words: str) -> None:
        print(words, file=sys.stderr if as_json else sys.stdout, flush=True)

    with open_bus(interface, receive=(0x525, 0x526), may_send=()) as bus:
        until_ns = 0
        while check.asked is not None:
            if check.asked != asked:
                asked = check.asked
                until_ns = time.monotonic_ns() + int(_PATIENCE_S * 1e9)
                show(f"turn the {NAMES[asked]} wheel slowly forwards by one turn, then stop it")
            if time.monotonic_ns() >= until_ns:
                raise UserError(f"no wheel has turned for {_PATIENCE_S:g} s (0x526)")
            frame = bus.recv(0.2)
            image = None if frame is None else codec.decode(frame).image
            if isinstance(image, WheelSpeeds):
                check.on_speeds(image.all_rpm)
            elif isinstance(image, WheelCounts):
                turn = check.on_counts((image.fl, image.fr, image.rl, image.rr), time.monotonic_ns())
                if turn is not None:
                    problem = turn.problem(pulses_per_rev)
                    if turn.source is None:
                        show(f"  {problem}")
                        continue
                    show(f"  {NAMES[turn.wheel]}: found in {turn.source}, {turn.counted} pulses")
                    if problem:
                        show(f"  WRONG: {problem}")
                        problems.append(f"{NAMES[turn.wheel]}: {problem}")
    mapping = check.mapping()
    configured = configuration.wheel_mapping
    todo = ""
    if mapping is None:
        problems.append("two wheels were found in one signal: turn one wheel alone, and begin again")
    elif mapping != configured:
        table = ", ".join(f'{turn.wheel} = "{turn.source}"' for turn in check.turns if turn.wheel != turn.source)
        todo = f"[car] wheel_mapping = {{ {table} }}" if table else "[car] without wheel_mapping"
        problems.append(f"the wiring is {mapping}, the configuration says {configured}")
    if as_json:
        turns = [{**asdict(turn), "source": turn.source} for turn in check.turns]
        print(json.dumps({"wrong": len(problems), "problems": problems, "todo": todo, "turns": turns}))
    else:
        for problem in problems:
            print(f"WRONG {problem}")
        if todo:
            print(f"-> {configuration.path}: {todo}")
        if not problems:
            print("all is well: every wheel is where the configuration says")
    return 1 if problems else 0
