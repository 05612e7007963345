"""`python -m fsai_hil.bench` measures how fast the product is beside its peers, and how well it plans and drives.

    python -m fsai_hil.bench speed -o out/bench
    python -m fsai_hil.bench planning | control

Speed is measured as ratios to a peer in the same run, by processor time, the kernel's part too, so that other programs
on the machine cost nothing. That both give the same values is shown in `tests/interface`. One figure is judged: the
bridge node, real rclpy and all, must come to its first frame within a second of processor time. `--check` compares the
ratios, and nothing else, with those of `docs/evidence/bench.json`, which `--write` renews.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from fsai_hil import CHECKOUT
from fsai_hil.bench import control, decode, laps, loop, planning
from fsai_hil.bench.rows import Ratio, fallen, table
from fsai_hil.rehearsal.scrutineering.machine import facts, machine
from fsai_hil.simulator.tracks import TrackError

BASELINE = CHECKOUT / "docs" / "evidence" / "bench.json"
PROGRAM = "fsai_hil.bench"


def measured() -> list[Ratio]:
    """Measure the speed of everything, with progress. Without ROS 2 the bridge node is left out."""
    ros = all(find_spec(name) for name in ("rclpy", "fsai_msgs", "fsai_nodes"))
    found: list[Ratio] = []
    for step in (loop.codec_rows, *[loop.node_rows] * ros, decode.rows, loop.mission_rows):
        print((step.__doc__ or "").splitlines()[0], flush=True)
        found += step()
    return found


def speed(args: argparse.Namespace) -> str:
    """Measure, print and save the speed; return what is wrong with it."""
    here = machine()
    args.out.mkdir(parents=True, exist_ok=True)
    baseline = json.loads(BASELINE.read_text("utf-8")) if args.check and not args.write else {"results": []}
    rows = measured()
    whole = {**facts(CHECKOUT), "time": "processor time, user and kernel", "machine": here, "results": rows}
    _save(args.out / "bench.json", whole)
    if args.write:
        ratios = [{key: each[key] for key in ("name", "peer_name", "ratio")} for each in rows]
        _save(BASELINE, {**whole, "results": ratios})
    words = "{median:.3g} ({least:.3g} to {most:.3g})".format_map
    lines = [
        (each["name"], each["unit"], words(each["ours"]), words(each["peer"]), words(each["ratio"]), each["peer_name"])
        for each in rows
    ]
    print("", table(("what", "unit", "ours", "peer", "peer / ours", "peer is"), lines), sep="\n")
    print("median (quickest to slowest round), of processor time where not wall time")
    problems = fallen(rows, baseline, here["processors"])
    for each in rows:
        least_s, most_s = each["ours"]["least"], loop.NODE_START_S  # the slower rounds were held up
        if each["name"] == loop.NODE_START and least_s > most_s:
            start = f"{least_s:.3g} s of processor time to its first frame, more than {most_s:g} s"
            problems.append(f"{loop.NODE_START}: {start}")
    return "; ".join(problems)


def _save(path: Path, whole: Ratio) -> None:
    path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    print(f"saved {path}")


def main(argv: Sequence[str] | None = None) -> int:
    """0: measured, and nothing is wrong; 1: something is; 2: wrong use."""
    words = "measure the speed beside what others take, and how well planning and control drive"
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=words)
    verbs = parser.add_subparsers(dest="bench", required=True)
    for name, module in (("planning", planning), ("control", control), ("laps", laps)):
        words = (module.__doc__ or "").splitlines()[0]
        module.add_arguments(verbs.add_parser(name, help=words, description=words))
    fast = verbs.add_parser("speed", help="codec, answer, logs, start and whole missions, as ratios to a peer's time")
    fast.add_argument("--check", action="store_true", help="fail where a ratio fell by more than its noise")
    fast.add_argument("--write", action="store_true", help="let this run be what --check compares with")
    fast.add_argument("-o", "--out", type=Path, default=Path("out/bench"), metavar="DIR", help="folder for bench.json")
    fast.set_defaults(run=speed)
    args = parser.parse_args(argv)
    try:
        problem, status = args.run(args), 1
    except TrackError as error:
        problem, status = str(error), 2
    except (AssertionError, json.JSONDecodeError) as error:
        problem, status = f"nothing to compare: {error}", 1
    except OSError as error:
        problem, status = f"{error.filename or args.out}: {error.strerror}", 1
    except KeyboardInterrupt:
        problem, status = "interrupted", 130
    if problem:
        print(f"{PROGRAM}: {problem}", file=sys.stderr)
    return status if problem else 0


if __name__ == "__main__":
    sys.exit(main())
