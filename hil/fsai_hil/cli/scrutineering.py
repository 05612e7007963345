"""`fsai-vcu scrutineering`: the handshake's response time, measured on a real vcan0, in a report for a scrutineer."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path

from fsai_hil import CHECKOUT
from fsai_hil.cli.hil import add_place_arguments, environment, prepared_place
from fsai_hil.rehearsal.scrutineering.conditions import BY_NAME, SHORT, conditions_named
from fsai_hil.rehearsal.scrutineering.machine import facts, machine
from fsai_hil.rehearsal.scrutineering.report import failures, markdown, not_measured, summary
from fsai_hil.vcan import INTERFACE, VcanError
from fsai_hil.vcan.clock import SLOWEST_PACE
from fsai_vcu.interface.errors import UserError, WrongUse

EXAMPLE = "fsai-vcu scrutineering --seconds 60 -o out/scrutineering"

_SECONDS = 60.0  # six thousand echoes: enough for a p99.9
_SHORT_SECONDS = 3.0
_SLACK_S = 240.0  # starting processes on one slow processor
_PER_CONDITION_S = 120.0  # powering up and driving off


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add = parser.add_argument
    add("--seconds", type=float, metavar="S", help=f"how long each condition is measured ({_SECONDS:g})")
    add("--conditions", metavar="NAME[,NAME…]", help="only these (default: all)")
    add("--short", action="store_true", help=f"only what needs no drive, {_SHORT_SECONDS:g} s each")
    add("--revision", default="2026", choices=("2021", "2026"), help="interface revision (2026)")
    add_place_arguments(parser)
    add(
        "--pace",
        type=float,
        metavar="N",
        help="in User-Mode Linux: how many seconds of this machine a second there takes (1)",
    )
    add(
        "-o",
        "--out",
        type=Path,
        default=Path("out/scrutineering"),
        metavar="DIR",
        help="for report and logs (%(default)s)",
    )
    add("--report", type=Path, metavar="FILE.md", help="write the report to this file as well")
    add("--json", action="store_true", help="print everything measured as one JSON object, the last line")


def run(args: argparse.Namespace) -> int:
    """0: in every condition answered in time, and sooner than the loop in C; 1: not, or not measured."""

    def say(text: str) -> None:
        print(text, file=sys.stderr if args.json else sys.stdout, flush=True)

    seconds = args.seconds if args.seconds is not None else _SHORT_SECONDS if args.short else _SECONDS
    if not 0.0 < seconds < math.inf:
        raise WrongUse(f"--seconds is {seconds:g}, but must be a time in seconds")
    if args.pace is not None and not 1.0 <= args.pace <= SLOWEST_PACE:
        raise WrongUse(f"--pace is {args.pace:g}, but must be from 1 to {SLOWEST_PACE:g}")
    names = args.conditions.split(",") if args.conditions is not None else SHORT if args.short else tuple(BY_NAME)
    conditions = conditions_named(names)
    out: Path = args.out.resolve()
    result = out / "measured.json"
    try:
        out.mkdir(parents=True, exist_ok=True)
        result.unlink(missing_ok=True)
        place = prepared_place(args)
        if args.pace is not None and not place.has_pace:
            raise WrongUse("--pace is for User-Mode Linux (--uml): this kernel's own vcan goes by this machine's clock")
        pace = args.pace or 1.0
        say(f"{place.name} {INTERFACE}: {place.why}")
        say(f"{len(conditions)} conditions, {seconds:g} s each; logs in {out}")
        if pace != 1.0:
            say(f"{pace:g} s of this machine for each second inside")
        plan = {
            "bus": INTERFACE,
            "result": str(result),
            "seconds": seconds,
            "revision": args.revision,
            "conditions": [each.name for each in conditions],
            "slow_place": place.has_pace,
        }
        status = place.run(
            [sys.executable, "-m", "fsai_hil.rehearsal.scrutineering.measurement", json.dumps(plan)],
            cwd=CHECKOUT,
            env=environment(os.environ, INTERFACE, place.name, out),
            timeout_s=pace * (_SLACK_S + len(conditions) * (2 * seconds + _PER_CONDITION_S)),
            results_dir=out,
            **({"pace": pace} if place.has_pace else {}),
        )
        if status or not result.exists():
            raise UserError(f"nothing was measured (status {status}); the logs of the processes are in {out}")
        surroundings = {"place": place.name, "pace": pace, "host": machine(), **facts(CHECKOUT)}
        measured = json.loads(result.read_text()) | surroundings
        measured["failures"] = failures(measured)
        measured["result"] = "fail" if measured["failures"] else "incomplete" if not_measured(measured) else "pass"
        result.unlink()
        saved = [out / "response-time.md", *([args.report] if args.report else []), out / "response-time.json"]
        for path in saved:
            path.parent.mkdir(parents=True, exist_ok=True)
            text = markdown(measured) if path != saved[-1] else json.dumps(measured, indent=1) + "\n"
            path.write_text(text, encoding="utf-8")
    except VcanError as error:
        raise UserError(str(error)) from error
    except OSError as error:
        raise UserError(f"{error.filename or out}: {error.strerror}") from error
    say("\n" + summary(measured))
    say(f"saved {', '.join(str(path) for path in saved)}")
    if args.json:
        print(json.dumps(measured))
    return 0 if measured["result"] == "pass" else 1
