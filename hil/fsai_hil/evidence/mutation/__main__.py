"""`python -m fsai_hil.evidence.mutation`: every mistake of one place, and whether a test notices it."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from fsai_hil import CHECKOUT
from fsai_hil.evidence.mutation import explained, trial
from fsai_hil.evidence.mutation.mutants import Key, Mutant

EXAMPLE = "example: python -m fsai_hil.evidence.mutation --only gate._steering --jobs 1"
HEADS = ("mutants", "killed", "equivalent", "survived", "score")

RECORD = CHECKOUT / "out" / "mutation" / "record.jsonl"
_EVERY_S = 10.0  # progress


def _digest() -> str:
    """Changes with the text of any source or test that a verdict depends on."""
    vcu, tests = CHECKOUT / "fsai_vcu", CHECKOUT / "tests" / "core"
    sources = [*(vcu / "core").rglob("*.py"), *(vcu / "interface").rglob("*.py"), *Path(__file__).parent.glob("*.py")]
    sources += [tests / name for name in (*trial.KILLERS, "supervision_rig.py")]
    total = hashlib.sha256()
    for path in sorted(sources):
        total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.hexdigest()[:12]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence.mutation", description=__doc__, epilog=EXAMPLE, allow_abbrev=False
    )
    parser.add_argument("--only", action="append", default=[], metavar="PLACE", help="a module or function, as printed")
    parser.add_argument("--sample", type=int, metavar="N", help="only N that act in functions, without coverage")
    parser.add_argument("--seed", help="what the sample is drawn by (default: the digest of sources and tests)")
    parser.add_argument(
        "--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes (default: %(default)s)"
    )
    parser.add_argument("--document", action="store_true", help=f"write {explained.DOCUMENT} if everything holds")
    return parser


def _chosen(mutants: Sequence[Mutant], listed: set[Key], options: argparse.Namespace, seed: str) -> list[Mutant]:
    chosen = [m for m in mutants if not options.only or any(f"{m.place}.".startswith(f"{n}.") for n in options.only)]
    if not chosen:
        places = ", ".join(sorted({mutant.place for mutant in mutants}))
        raise SystemExit(f"no mutant in {', '.join(options.only)}: the places are {places}")
    if options.sample is not None:
        # Those that are known to survive cost all tests and tell nothing new; tables cost the tests' collection each.
        chosen = [mutant for mutant in chosen if mutant.key not in listed and not mutant.at_import]
        chosen = random.Random(seed).sample(chosen, min(options.sample, len(chosen)))
        print(f"a sample of {len(chosen)}, drawn by --seed {seed}", flush=True)
    return chosen


def _try(
    baseline: trial.Baseline, sources: dict[str, str], chosen: list[Mutant], options: argparse.Namespace, digest: str
) -> list[tuple[Mutant, str]]:
    """Every mutant with its killer, on disk line by line: a run of the same sources goes on where one was stopped."""
    RECORD.parent.mkdir(parents=True, exist_ok=True)
    lines = RECORD.read_text().splitlines(keepends=True) if RECORD.exists() else []
    head = json.dumps({"digest": digest}) + "\n"
    known = [line for line in lines[1:] if line.endswith("\n")] if lines[:1] == [head] else []
    done = {tuple(key): killer for key, killer in map(json.loads, known)}
    results = [(mutant, done[mutant.key]) for mutant in chosen if mutant.key in done]
    if results:
        print(f"{len(results)} were tried before and are not tried again", flush=True)
    waiting = [mutant for mutant in chosen if mutant.key not in done]
    began = said = time.monotonic()
    with RECORD.open("w") as record:
        record.writelines([head, *known])

        def report(mutant: Mutant, killer: str) -> None:
            nonlocal said
            print(json.dumps([mutant.key, killer]), file=record, flush=True)
            results.append((mutant, killer))
            if (now := time.monotonic()) - said >= _EVERY_S:
                said, left = now, len(chosen) - len(results)
                left_min = (now - began) / (len(waiting) - left) * left / 60.0
                survive = sum(not killer for _, killer in results)
                print(f"{len(results)} of {len(chosen)}, {survive} survive, {left_min:.0f} min left", flush=True)

        trial.try_all(baseline, sources, waiting, options.jobs, report)
    return results


def _shown(mutant: Mutant) -> str:
    lines = [f"{mutant.place}, line {mutant.lines[0]}: {mutant.operator}"]
    lines += [f"    - {line}" for line in mutant.minus.splitlines()]
    return "\n".join([*lines, *(f"    + {line}" for line in mutant.plus.splitlines() or ["(nothing)"])])


def _run(options: argparse.Namespace) -> int:
    trial.warm_up()
    digest = _digest()
    listed = explained.load()
    sources = trial.sources()
    mutants = trial.mutants(sources)
    gone = listed - {mutant.key for mutant in mutants}
    for place, minus, plus, nth in gone:
        print(f"{explained.LIST} explains what is no mutant any more: {place} ({nth})\n    - {minus}\n    + {plus}")
    chosen = _chosen(mutants, listed, options, options.seed or digest)

    baseline = trial.Baseline()
    if options.sample is None:
        print(f"{len(chosen)} mutants; the tests on the code as it is …", flush=True)
        baseline = trial.measure()
        if baseline.failed:
            print(f"a test fails on the code as it is: {baseline.failed}", file=sys.stderr)
            return 1
        print(f"{len(baseline.seconds)} tests, {sum(baseline.seconds.values()):.0f} s of CPU time", flush=True)
        for place in baseline.missing or [f"nothing: every line and branch of {', '.join(trial.COVERED)} is reached"]:
            print(f"not covered: {place}")
    results = _try(baseline, sources, chosen, options, digest)
    rows = {name: explained.row([one for one in results if one[0].module == name], listed) for name in sources}
    for name, cells in (("module", HEADS), *rows.items(), ("in all", explained.row(results, listed))):
        print(f"{name.rpartition('.')[2]:14} " + " ".join(f"{cell:>10}" for cell in cells))
    unexplained = [mutant for mutant, killer in results if not killer and mutant.key not in listed]
    wrongly_explained = [mutant for mutant, killer in results if killer and mutant.key in listed]
    for mutant in unexplained:
        print(f"\nSURVIVED: {_shown(mutant)}")
    for mutant in wrongly_explained:
        print(f"\n{explained.LIST} calls it equivalent, but a test kills it: {_shown(mutant)}")
    holds = not (unexplained or wrongly_explained or gone or baseline.missing)
    if options.document and holds and len(chosen) == len(mutants):
        (CHECKOUT / explained.DOCUMENT).write_text(explained.page(rows, mutants, digest))
        print(f"written: {explained.DOCUMENT}")
    return 0 if holds else 1


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    if options.jobs < 1 or (options.sample is not None and options.sample < 1):
        print("--jobs and --sample take 1 or more", file=sys.stderr)
        return 2
    try:
        return _run(options)
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
