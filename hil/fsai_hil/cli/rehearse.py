"""`fsai-vcu rehearse`: test any AI-side program, in any language, against scrutineering and the interface."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from fsai_hil.simulator.profiles import PROFILES
from fsai_vcu.arguments import add_bus_argument
from fsai_vcu.interface.errors import UserError, WrongUse

PROGRAM: Final = "fsai-vcu rehearse"
EXAMPLE = (
    "fsai-vcu rehearse vcan0 -- ./own_can_node vcan0\n"
    "  fsai-vcu rehearse vcan0 --only handshake,static-a -- ros2 launch my_stack car.launch.py\n"
    "  fsai-vcu rehearse can0 -o out/can0"
)
ABOUT = """\
Starts the program, and a simulated VCU and car on the same bus, and plays what
happens to a car: power-up, missions chosen and taken back, Go, static inspections,
autonomous demo, E-stop, messages that fall silent, power cycles. It takes five
minutes. Exit status: 0 where every item was seen as asked, 1 where not.
Without COMMAND somebody else starts the program, here or on another machine.
In DIR: result.html (one page to print), result.json, bus.log, program.log."""


def parse(parser: argparse.ArgumentParser, argv: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments; those that follow `--` are the program's."""
    words = list(argv)
    split = words.index("--") if "--" in words else len(words)
    args = parser.parse_args(words[:split])
    args.command = words[split + 1 :]
    return args


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.usage = "%(prog)s [BUS] [options] [-- COMMAND …]"
    add = parser.add_argument
    add_bus_argument(parser, "the bus: vcan0, loopback:NAME or KIND:CHANNEL (vcan0)", "vcan0")
    add("--only", metavar="ITEM[,ITEM…]", help="only these items, and the scenes that show them")
    add("--list", action="store_true", help="list the items: what each requires, and its source")
    add("--revision", default="2026", choices=("2021", "2026"), help="interface revision of the car (2026)")
    add("--profile", default="specification", choices=list(PROFILES), help="how the VCU behaves (specification)")
    add("--pedals-once-a-cycle", action="store_true", help="the VCU checks torque with brake once a cycle")
    add("--truth", type=int, metavar="PORT", help="send the true pose to this UDP port of 127.0.0.1, for sensors")
    add("--no-gps", action="store_true", help="a car without the PCAN-GPS")
    add(
        "-o",
        "--out",
        type=Path,
        default=Path("out/rehearse"),
        metavar="DIR",
        help="folder for page and logs (%(default)s)",
    )
    add("--json", action="store_true", help="print the result as one JSON object, the last line of stdout")
    add("--quiet", action="store_true", help="no progress lines")


def run(args: argparse.Namespace) -> int:
    """0: every item seen as asked; 1: not; 130: interrupted."""
    from fsai_hil.rehearsal.inspection.items import ITEMS
    from fsai_hil.rehearsal.inspection.judge import items_named
    from fsai_hil.rehearsal.inspection.program import RehearsalProcess, run_rehearsal
    from fsai_hil.rehearsal.inspection.rehearsal import RehearsalWorld
    from fsai_hil.rehearsal.inspection.report import as_dict, page, passed, text
    from fsai_vcu.runtime.bus import open_bus

    if args.list:
        if args.json:
            print(json.dumps([item._asdict() for item in ITEMS]))
        else:
            print("\n".join(f"{item.slug:<12} {item.title}: {item.asks} ({item.source})" for item in ITEMS))
        return 0
    if args.truth is not None and not 0 < args.truth < 65536:
        raise WrongUse(f"--truth is {args.truth}, but a port is 1 to 65535")
    try:
        items = items_named([name.strip() for name in args.only.split(",")] if args.only else [])
    except ValueError as error:
        raise WrongUse(str(error)) from None
    out: Path = args.out.resolve()
    args.auto, args.timeout, args.log = True, None, str(out / "bus.log")
    rehearsal = RehearsalWorld(
        items,
        revision=args.revision,
        profile=args.profile,
        pedals_by_frame=not args.pedals_once_a_cycle,
        start_ns=time.monotonic_ns(),
        gps=not args.no_gps,
    )
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "program.log").unlink(missing_ok=True)
        with open_bus(args.interface) as bus:
            process = RehearsalProcess(rehearsal, bus, args, args.command, out)
            run_rehearsal(process)
        results = rehearsal.results()
        about = {
            "program": shlex.join(args.command) or "started by somebody else",
            "date": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
            "bus": args.interface,
            "revision": args.revision,
            "profile": args.profile,
            "seconds": round((rehearsal.now_ns - rehearsal.setup.start_ns) / 1e9, 1),
            "held up": f"{process.held_up_ns / 1e6:.0f} ms" if process.held_up_ns else "",
            "ended": process.interrupted or "",
        }
        result = as_dict(results, about)
        (out / "result.html").write_text(page(results, about), encoding="utf-8")
        (out / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UserError(f"{error.filename or out}: {error.strerror}") from error
    print(text(results), file=sys.stderr if args.json else sys.stdout, flush=True)
    print(f"saved {out / 'result.html'}, result.json, bus.log, program.log", file=sys.stderr)
    if args.json:
        print(json.dumps(result), flush=True)
    if process.interrupted == "ended by SIGINT":
        return 130
    return 0 if passed(results) else 1
