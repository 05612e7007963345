"""`python -m fsai_hil.bench` measures how fast the product is beside its peers, and how well it plans and drives.

    python -m fsai_hil.bench speed --quick -o out/bench
    python -m fsai_hil.bench planning | control

Speed is measured as ratios to a peer in the same run, by processor time, the kernel's part too, so that other programs
on the machine cost nothing. That both give the same values is shown in `tests/interface`. One figure is judged, but for
`--quick`: the bridge node, real rclpy and all, must come to its first frame within a second of processor time.
`--check` compares the ratios, and nothing else, with those of `docs/evidence/bench.json`, which `--write` renews.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from fsai_hil import CHECKOUT
from fsai_hil.bench import control, decode, loop, planning
from fsai_hil.bench.rows import Row, compared, table
from fsai_hil.rehearsal.scrutineering.machine import facts, machine
from fsai_hil.simulator.tracks import TrackError

BASELINE = CHECKOUT / "docs" / "evidence" / "bench.json"
PROGRAM = "fsai_hil.bench"
TIME = "processor time, user and kernel"


class Effort(NamedTuple):
    """The number of rounds, turns, starts, drives and frames that a run takes."""

    rounds: int
    turns: int  # of a comparison in each round
    starts: int  # of a process
    missions: tuple[str, ...]
    drives: int  # of each mission
    log_frames: int
    log_rounds: int


FULL = Effort(15, 2000, 7, ("acceleration", "skidpad", "autocross", "trackdrive"), 2, 2_000_000, 3)
QUICK = Effort(5, 300, 2, ("acceleration",), 1, 50_000, 1)


def measured(effort: Effort) -> list[Row]:
    """Measure the speed of everything, with progress."""
    ros = all(find_spec(name) for name in ("rclpy", "fsai_msgs", "fsai_nodes"))
    steps: tuple[tuple[str, Callable[[], list[Row]]], ...] = (
        ("decoding, encoding, answering on the loopback bus", lambda: loop.codec_rows(effort.turns, effort.rounds)),
        ("starting processes", lambda: loop.start_rows(effort.starts)),
        ("starting the bridge node", lambda: loop.node_rows(effort.starts))
        if ros
        else ("not measured: the bridge node; ROS 2 is not in this environment", list),
        (f"reading logs of {effort.log_frames} frames", lambda: decode.rows(effort.log_frames, effort.log_rounds)),
        ("driving in lockstep", lambda: loop.mission_rows(effort.missions, effort.drives)),
    )
    rows: list[Row] = []
    for number, (words, step) in enumerate(steps, start=1):
        print(f"[{number}/{len(steps)}] {words}", flush=True)
        rows += step()
    return rows


def too_slow(rows: Sequence[Row]) -> list[str]:
    """Say what is wrong with the quickest start of the node: the others are held up by other programs."""
    starts_s = [each["ours"]["least"] for each in rows if each["name"] == loop.NODE_START]
    words = f"{loop.NODE_START}: {{:.3g}} s of processor time to its first frame, more than {loop.NODE_START_S:g} s"
    return [words.format(least_s) for least_s in starts_s if least_s > loop.NODE_START_S]


def speed(args: argparse.Namespace) -> str:
    """Measure, print and save the speed; return what is wrong with it."""
    here, baseline = machine(), None
    print(f"{here['processor']} x {here['processors']}, {here['kernel']}, Python {here['python']}", flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    if args.check and not args.write:
        try:
            baseline = json.loads(BASELINE.read_text("utf-8"))
        except (OSError, json.JSONDecodeError) as error:
            return f"{BASELINE}: {error}; this makes it again: make bench-check ARGS=--write"
    rows = measured(QUICK if args.quick else FULL)
    whole = {**facts(CHECKOUT), "quick": args.quick, "time": TIME, "machine": here, "results": rows}
    _save(args.out / "bench.json", whole)
    if args.write:
        ratios = [{key: each[key] for key in ("name", "peer_name", "ratio")} for each in rows]
        _save(BASELINE, {**whole, "results": ratios})
    figures = [[_words(each[figure]) for figure in ("ours", "peer", "ratio")] for each in rows]
    named = [(each["name"], each["unit"], *words, each["peer_name"]) for each, words in zip(rows, figures, strict=True)]
    print("", table(("what", "unit", "ours", "peer", "peer / ours", "peer is"), named), sep="\n")
    print("median (quickest to slowest round), of processor time where not wall time")
    problems = [] if args.quick else too_slow(rows)
    if baseline:
        words, fell = compared(rows, baseline, here)
        print("", words, sep="\n")
        if absent := {each["name"] for each in baseline["results"]} - {each["name"] for each in rows}:
            problems.append(f"in {BASELINE}, and not measured: {', '.join(sorted(absent))}")
        if fell:
            problems.append(f"slower than in {BASELINE}, by more than the noise: {', '.join(fell)}")
    return "; ".join(problems)


def _save(path: Path, whole: Row) -> None:
    path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    print(f"saved {path}")


def _words(figure: dict[str, float] | None) -> str:
    if figure is None:
        return "-"
    least, most = figure["least"], figure["most"]
    return f"{figure['median']:.3g}" + (f" ({least:.3g} to {most:.3g})" if least != most else "")


def main(argv: Sequence[str] | None = None) -> int:
    """0: measured, and nothing is wrong; 1: something is; 2: wrong use."""
    words = "measure the speed beside what others take, and how well planning and control drive"
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=words)
    verbs = parser.add_subparsers(dest="bench", required=True)
    for name, module in (("planning", planning), ("control", control)):
        words = (module.__doc__ or "").splitlines()[0]
        module.add_arguments(verbs.add_parser(name, help=words, description=words))
    fast = verbs.add_parser("speed", help="codec, answer, logs, start and whole missions, as ratios to a peer's time")
    fast.add_argument("--quick", action="store_true", help="half a minute, more spread, the start is not judged")
    fast.add_argument("--check", action="store_true", help="fail where a ratio fell by more than its noise")
    fast.add_argument("--write", action="store_true", help="let this run be what --check compares with")
    fast.add_argument("-o", "--out", type=Path, default=Path("out/bench"), metavar="DIR", help="folder for bench.json")
    fast.set_defaults(run=speed)
    args = parser.parse_args(argv)
    try:
        if args.bench == "speed" and args.quick and (args.check or args.write):
            raise TrackError("--quick is too short to be compared: without --check and --write")
        problem, status = args.run(args), 1
    except TrackError as error:
        problem, status = str(error), 2
    except AssertionError as error:
        problem, status = f"nothing to compare: {error}", 1
    except OSError as error:
        problem, status = f"{error.filename or args.out}: {error.strerror}", 1
    except KeyboardInterrupt:
        problem, status = "interrupted", 130
    if not problem:
        return 0
    print(f"{PROGRAM}: {problem}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
