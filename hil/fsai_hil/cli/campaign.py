"""`fsai-vcu campaign`: every kind of fault at random moments of every mission, judged by the safety rules."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import deque
from collections.abc import Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from fsai_hil.evidence.campaign.cases import WINDOW_MS, WORLD_SEEDS, CampaignPlan
from fsai_hil.evidence.campaign.runner import KIND, batches, drive_batch, header_of, on_cluster
from fsai_hil.evidence.campaign.table import catalogue_lines, failures, markdown
from fsai_hil.evidence.work import RecordFile, followed, read, spread
from fsai_hil.simulator.world import mission_named
from fsai_vcu.cli.main import UserError
from fsai_vcu.files import write_whole
from fsai_vcu.interface.revisions import revision

EXAMPLE = "fsai-vcu campaign --runs 10000 --full 300 --seed 1 --out out/campaign"

RUNS = 10_000
FULL = 300


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add = parser.add_argument
    add("--runs", type=int, default=RUNS, metavar="N", help=f"runs from snapshots (default: {RUNS})")
    add("--full", type=int, default=FULL, metavar="N", help=f"full-length runs (default: {FULL})")
    add("--seed", type=int, default=1, metavar="N", help="seed from which every case is drawn (default: 1)")
    add("--jobs", type=int, metavar="N", help="processes (default: one per processor)")
    add("--faults", metavar="A,B,…", help="only these kinds (default: all; see --list)")
    add("--missions", metavar="A,B,…", help="only these missions (default: all)")
    add("--revisions", metavar="A,B", help="only these interface revisions (default: all)")
    add("--world-seeds", type=int, metavar="N", help="different worlds that are driven in (default: 3)")
    add("--window", type=float, metavar="S", help="length of a run from a snapshot (default: 10 s)")
    add("--out", type=Path, default=Path("out/campaign"), metavar="DIR", help="default: out/campaign")
    add("--resume", action="store_true", help="continue the record in DIR; one of other sources or options is renamed")
    add("--dask", metavar="ADDRESS", help="drive on the Dask cluster whose scheduler is there")
    add("--list", action="store_true", help="list the kinds of fault")
    add("--table", type=Path, metavar="RECORD", help="drive nothing: make the table of a record")
    add("-o", "--output", type=Path, metavar="FILE.md", help="write the table there")


def run(args: argparse.Namespace) -> int:
    try:
        if args.list:
            print("\n".join(catalogue_lines()))
            return 0
        if args.table:
            _table(args.table, args.output)
            return 0
        return _campaign(args)
    except ValueError as error:
        raise UserError(str(error)) from error
    except OSError as error:
        text = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        raise UserError(text) from error


def _table(record: Path, output: Path | None) -> None:
    header, runs = read(record, KIND)
    text = markdown(header, runs)
    if output is None:
        print(text)
    else:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_whole(output, text.encode())
        print(f"saved {output}: {len(runs)} runs, {len(failures(runs))} worse than the rules allow")


def _campaign(args: argparse.Namespace) -> int:
    """Do the runs that the record lacks, then write its table; return the exit status."""
    plan = _plan(args)
    jobs = args.jobs if args.jobs is not None else os.cpu_count() or 1
    if jobs < 1:
        raise ValueError(f"--jobs is {jobs}, but must be at least 1")
    with RecordFile(args.out / "record.jsonl", header_of(plan), resume=args.resume) as record:
        if record.kept_as:
            why = "it is of other sources or options" if args.resume else "without --resume a campaign begins again"
            print(f"{record.path} is now {record.kept_as.name}: {why}", file=sys.stderr)
        kept = len(record.results)
        if kept:
            print(f"{kept} runs are in {record.path} already", file=sys.stderr)
        done = {(run["full"], run["index"]) for run in record.results}
        tasks = [task for task in plan.tasks() if task not in done]
        began_s = time.monotonic()
        drive = partial(drive_batch, plan)
        driven = on_cluster(plan, tasks, args.dask) if args.dask else spread(drive, batches(plan, tasks), jobs)
        lines = chain.from_iterable(driven)
        try:
            deque(followed(lines, "runs", len(tasks), _worse, "worse than the rules allow", record=record), 0)
        except KeyboardInterrupt:
            print(f"{len(record.results)} runs are kept in {record.path}; --resume goes on", file=sys.stderr)
            raise
        new = len(record.results) - kept
        if new:
            rate = new / max(1e-9, time.monotonic() - began_s)
            print(
                f"{new} runs at {rate:.2f} runs/s; 10,000 runs take {10_000 / rate / 3600:.1f} hours at this rate",
                file=sys.stderr,
            )
        print(f"{len(record.results)} runs of {len(plan.kinds())} kinds, record in {record.path}")
        if args.output:
            _table(record.path, args.output)
        else:
            print(f"table: fsai-vcu campaign --table {record.path}")
        if failures(record.results):
            print(f"{len(failures(record.results))} worse than the rules allow")
            return 1
        print("every run ended as the rules demand")
        return 0


def _worse(line: Mapping[str, Any]) -> str:
    return f"worse: {line['replay']}\n       {'; '.join(line['reasons'][:3])}" if failures([line]) else ""


def _plan(args: argparse.Namespace) -> CampaignPlan:
    """Return the plan that the arguments ask for. Raises ValueError in words for the user."""
    if args.runs < 0 or args.full < 0 or args.runs + args.full < 1:
        raise ValueError("--runs and --full must be 0 or more, and one of them at least 1")
    if args.world_seeds is not None and args.world_seeds < 1:
        raise ValueError(f"--world-seeds is {args.world_seeds}, but must be at least 1")
    if args.window is not None and not 1.0 <= args.window <= 100.0:
        raise ValueError(f"--window is {args.window:g} s, but must be 1 to 100 s")
    return CampaignPlan(
        args.seed,
        args.runs,
        args.full,
        tuple(_names(args.faults)),
        tuple(mission_named(name) for name in _names(args.missions)),
        tuple(revision(name).name for name in _names(args.revisions)),
        WORLD_SEEDS if args.world_seeds is None else args.world_seeds,
        WINDOW_MS if args.window is None else round(args.window * 1000),
    )


def _names(text: str | None) -> list[str]:
    return [name.strip() for name in (text or "").split(",") if name.strip()]
