"""`python -m fsai_hil.evidence.fuzz`: strange frames, commands, services and times before the real Bridge and Engine.

Cases run in virtual time, an independent checker (`rules`) judges every frame that goes out. A case is made anew
from its lineage, a failure is cut down to the fewest events and written to out/fuzz/ as a file that can be replayed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import queue
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from fsai_hil.evidence import fuzz_run
from fsai_hil.evidence.fuzz_cases import make
from fsai_hil.evidence.fuzz_drives import Drive
from fsai_hil.evidence.fuzz_events import SETUPS, CaseError, FuzzCase, read_case
from fsai_hil.evidence.fuzz_run import NotOrdinary, forget_stations
from fsai_hil.evidence.fuzz_search import KINDS, Failure, Fuzzer, Tally, described, fuzz, minimised, story, unreached
from fsai_hil.evidence.model import patched
from fsai_hil.evidence.seeded import SEEDS, Seed
from fsai_hil.rules.violation import Violation

EXAMPLE: Final = (
    "example: python -m fsai_hil.evidence.fuzz --minutes 5; python -m fsai_hil.evidence.fuzz --replay out/fuzz/FILE"
)
FOLDER: Final = Path("out/fuzz")
DEFAULT_CASES: Final = 300
BATCH: Final = 20
CASES_FOR_A_DRIVE: Final = 100  # one whole drive in lockstep for so many cases
SEEDED_CASES: Final = 1_500
SEEDED_S: Final = 120.0  # of processor time for one seeded fault at most
_PROGRESS_S: Final = 5.0


# ---------------------------------------------------------------- in many processes


def _worker(job: int, seed: str, cases: int | None, until_s: float | None, out: Any) -> None:
    """One process's share: cases in small batches, so that progress is seen, and a drive now and then."""
    done = 0
    try:
        fuzzer = Fuzzer(f"{seed}-{job}")
        while (cases is None or done < cases) and (until_s is None or time.monotonic() < until_s):
            size = BATCH if cases is None else min(BATCH, cases - done)
            tally = fuzzer.run(cases=size, until_s=until_s)
            tally.failures = [minimised(failure) for failure in tally.failures]
            out.put(tally)
            done += size
            if tally.failures:
                break
            if done % CASES_FOR_A_DRIVE == 0 and (until_s is None or time.monotonic() < until_s):
                drive = Drive(f"{seed}-{job}-{done}")
                problems = drive.run()
                out.put((drive.lockstep.now_ns / 1e9, drive.origin, drive.notes, problems))
    except KeyboardInterrupt:
        pass
    except NotOrdinary as broken:
        out.put(broken.args[0])
    finally:
        out.put(None)


class Campaign:
    """What all processes together have done."""

    def __init__(self) -> None:
        self.tally = Tally()
        self.drives = 0
        self.driven_s = 0.0
        self.bad_drives: list[tuple[str, list[str], list[Violation]]] = []
        self.not_ordinary: list[str] = []

    def take(self, message: Any) -> None:
        if isinstance(message, Tally):
            self.tally.add(message)
        elif isinstance(message, str):
            self.not_ordinary.append(message)
        else:
            driven_s, origin, notes, problems = message
            self.drives += 1
            self.driven_s += driven_s
            if problems:
                self.bad_drives.append((origin, notes, problems))

    @property
    def holds(self) -> bool:
        return not (self.tally.failures or self.bad_drives or self.not_ordinary)


def campaign(seed: str, jobs: int, cases: int | None, minutes: float | None) -> Campaign:
    """Run in `jobs` processes, printing progress. Ctrl-C ends it with what has been done."""
    until_s = None if minutes is None else time.monotonic() + 60.0 * minutes
    context = multiprocessing.get_context("spawn")
    out = context.Queue()
    shares = [None if cases is None else cases // jobs + (job < cases % jobs) for job in range(jobs)]
    processes = [
        context.Process(target=_worker, args=(job, seed, share, until_s, out), daemon=True)
        for job, share in enumerate(shares)
    ]
    began = time.monotonic()
    for process in processes:
        process.start()
    done = Campaign()
    running, said_s = jobs, began
    try:
        while running:
            try:
                message = out.get(timeout=1.0)
            except queue.Empty:
                if not any(process.is_alive() for process in processes):
                    done.not_ordinary.append("a process of the fuzzer died")
                    break
                continue
            if message is None:
                running -= 1
            else:
                done.take(message)
            if time.monotonic() - said_s >= _PROGRESS_S:
                said_s = time.monotonic()
                tally = done.tally
                print(
                    f"  {said_s - began:6.0f} s  {tally.cases:8,} cases  {tally.cycles:11,} cycles"
                    f"  {len(tally.reached):5,} reached  {len(tally.failures)} failures",
                    flush=True,
                )
    except KeyboardInterrupt:
        print("interrupted: this is what was done until then", flush=True)
    for process in processes:
        process.join(2.0)
        if process.is_alive():
            process.terminate()
    done.tally.seconds = time.monotonic() - began
    return done


# ---------------------------------------------------------------- what is printed and kept


def _print_figures(done: Campaign) -> None:
    tally = done.tally
    seconds = max(tally.seconds, 1e-9)
    print(
        f"{tally.cases:,} cases, {tally.cycles:,} cycles, {tally.frames:,} frames judged in {seconds:.1f} s:"
        f" {tally.cases / seconds:.1f} cases/s, {tally.cycles / seconds:,.0f} cycles/s,"
        f" {tally.simulated_s / 3600:.2f} simulated hours beyond the stations"
    )
    print(f"{done.drives} whole drives in lockstep with faults, {done.driven_s / 3600:.3f} simulated hours")
    print("reached: " + ", ".join(f"{tally.count(kind)} x {kind}" for kind in KINDS))
    for kind in ("AS state", "phase", "reason"):
        missing = unreached(tally.reached, kind)
        print(f"  {kind}: " + (f"not reached: {', '.join(sorted(missing))}" if missing else "all reached"))


def keep(failure: Failure, folder: Path = FOLDER) -> Path:
    """Write a failure where it can be read and replayed."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{failure.case.origin or 'case'}.txt"
    notes = [*described(failure), "", f"again: python -m fsai_hil.evidence.fuzz --replay {path}", ""]
    path.write_text(failure.case.text(notes))
    return path


def _print_failures(done: Campaign) -> None:
    for failure in done.tally.failures:
        path = keep(failure)
        print(f"\nBROKEN, kept as {path}:")
        for line in described(failure):
            print(f"  {line}")
    for origin, notes, problems in done.bad_drives:
        print(f"\nBROKEN in the drive {origin} (again: --drive {origin}):")
        for line in [*notes, *(f"rule {one.rule}: {one.words}" for one in problems[:5])]:
            print(f"  {line}")
    for line in done.not_ordinary:
        print(f"\nBROKEN: {line}")


# ---------------------------------------------------------------- faults put in on purpose


def sought(name: str, cases: int = SEEDED_CASES, seconds: float = SEEDED_S) -> tuple[Violation | None, Tally]:
    """Put the seeded fault of that name into the rules and fuzz until it shows on the wire."""
    seed: Seed = next(one for one in SEEDS if one.name == name)
    setups = {
        key: replace(setup, config=replace(setup.config, **seed.config))  # type: ignore[arg-type]
        for key, setup in SETUPS.items()
    }
    forget_stations()
    with ExitStack() as stack:
        stack.enter_context(patched(fuzz_run, "SETUPS", setups))
        for owner, attribute, value in seed.patches():
            stack.enter_context(patched(owner, attribute, value))
        try:
            tally = fuzz("seeded", cases=cases, cpu_s=seconds, stop_at_failures=1)
            problem = tally.failures[0].problem if tally.failures else None
        except NotOrdinary as broken:
            tally, problem = Tally(), broken.problem
    forget_stations()
    return problem, tally


def seek_all(names: Sequence[str], jobs: int) -> int:
    """Seek every seeded fault; how many the wire showed."""
    found = 0
    with multiprocessing.get_context("spawn").Pool(min(len(names), jobs)) as pool:
        for name, (problem, tally) in zip(names, pool.imap(sought, names), strict=True):
            found += problem is not None
            words = "NOT FOUND" if problem is None else f"rule {problem.rule}: {problem.words}"
            print(f"  {name:58} {tally.cases:5} cases  {words[:100]}", flush=True)
    return found


# ---------------------------------------------------------------- the command


def replay(case: FuzzCase) -> int:
    """Tell what happens in a case; 1 if it breaks a rule."""
    lines, problems = story(case)
    for line in lines:
        print(line)
    for problem in problems:
        print(f"BROKEN, rule {problem.rule}: {problem.words}")
    print("no rule broken" if not problems else "")
    return 1 if problems else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence.fuzz",
        description="Put strange frames, commands, services and times before the bridge; judge every frame it sends.",
        epilog=EXAMPLE,
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=float, metavar="M", help="go on for so long")
    length.add_argument("--cases", type=int, metavar="N", help=f"play so many cases (default {DEFAULT_CASES})")
    length.add_argument("--replay", type=Path, metavar="FILE", help="play the case of a file and tell what happens")
    length.add_argument("--case", metavar="LINEAGE", help="make the case of this lineage anew and tell what happens")
    length.add_argument("--drive", metavar="LINEAGE", help="drive the drive of this lineage again")
    length.add_argument("--seeded", action="store_true", help="put faults into the rules on purpose and seek each")
    parser.add_argument("--seed", default="1", metavar="S", help="another seed, other cases")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="J", help="processes")
    return parser


def _drive_again(origin: str) -> int:
    drive = Drive(origin)
    problems = drive.run()
    for line in [*drive.notes, *(f"BROKEN, rule {one.rule}: {one.words}" for one in problems)]:
        print(line)
    return 1 if problems else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 0 every rule held, 1 one was broken (or a seeded fault not found), 2 wrong use."""
    options = _parser().parse_args(arguments)
    try:
        if options.replay is not None:
            return replay(read_case(options.replay.read_text()))
        if options.case is not None:
            return replay(make(options.case))
    except OSError as error:
        print(f"{options.replay}: {error.strerror}", file=sys.stderr)
        return 2
    except (CaseError, ValueError) as error:
        print(f"{options.replay or options.case}: {error}", file=sys.stderr)
        return 2
    if options.drive is not None:
        return _drive_again(options.drive)
    cases = DEFAULT_CASES if options.cases is None and options.minutes is None else options.cases
    if options.jobs < 1 or (cases is not None and cases < 1) or (options.minutes is not None and options.minutes <= 0):
        print("--jobs, --cases and --minutes are more than 0", file=sys.stderr)
        return 2
    if options.seeded:
        seeds = [seed.name for seed in SEEDS if seed.shows_in_fuzz]
        print(f"{len(seeds)} faults put into the rules on purpose, each sought on the wire:", flush=True)
        sound = fuzz("seeded", cases=SEEDED_CASES, cpu_s=SEEDED_S, stop_at_failures=1)
        if sound.failures:
            print(f"without any of them case {sound.failures[0].case.origin} breaks a rule already", file=sys.stderr)
            return 1
        print(
            f"  {'none: the same cases with the rules as they are':58} {sound.cases:5} cases  no rule broken",
            flush=True,
        )
        found = seek_all(seeds, options.jobs)
        hidden = [seed.name for seed in SEEDS if not seed.shows_in_fuzz]
        print(f"{found} of {len(seeds)} found; for the exhaustive search alone: {'; '.join(hidden)}")
        return 0 if found == len(seeds) else 1
    done = campaign(options.seed, options.jobs, cases, options.minutes)
    _print_figures(done)
    _print_failures(done)
    print("\nEvery rule held on the wire." if done.holds else "\nBROKEN: see above.")
    return 0 if done.holds else 1


if __name__ == "__main__":
    sys.exit(main())
