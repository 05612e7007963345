"""`python -m fsai_hil.evidence.mutation`: every mistake of one place, and whether a test notices it."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from fsai_hil.evidence.mutation import document, explained, trial
from fsai_hil.evidence.mutation.explained import Judgement, Key, judge
from fsai_hil.evidence.mutation.operators import Mutant
from fsai_hil.evidence.mutation.trial import Baseline, Verdict

EXAMPLE = "example: python -m fsai_hil.evidence.mutation --only gate._steering --jobs 1"

_EVERY_S = 10.0  # progress


def digest_of(sources: Iterable[Path]) -> str:
    """Changes with the text of any of these files."""
    total = hashlib.sha256()
    for path in sorted(sources):
        total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.hexdigest()[:12]


def _digest() -> str:
    root = trial.root()
    tests = root / "tests" / "core"
    return digest_of(
        [
            *(root / "fsai_vcu" / "core").rglob("*.py"),
            *(root / "fsai_vcu" / "interface").rglob("*.py"),
            *(tests / name for name in trial.KILLERS),
            tests / "supervision_rig.py",
            *Path(__file__).parent.glob("*.py"),
        ]
    )


class _Record:
    """Verdicts on disk, line by line. One of the same sources is taken up again; of others it only remembers which
    test killed a mutant, so that this test is asked first.
    """

    def __init__(self, path: Path, digest: str, *, fresh: bool) -> None:
        self.done: dict[Key, Verdict] = {}
        self.hints: dict[Key, str] = {}
        lines = path.read_text().splitlines() if path.exists() else []
        same = bool(lines) and json.loads(lines[0]) == {"digest": digest} and not fresh
        for line in lines[1:]:
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue  # cut short by the end of a process
            place, minus, plus, nth = entry["mutant"]
            verdict = Verdict(**entry["verdict"])
            self.hints[place, minus, plus, nth] = verdict.killer
            if same:
                self.done[place, minus, plus, nth] = verdict
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a" if same else "w")
        if not same:
            print(json.dumps({"digest": digest}), file=self._file, flush=True)

    def add(self, mutant: Mutant, verdict: Verdict) -> None:
        entry = {
            "mutant": mutant.key,
            "verdict": {"outcome": verdict.outcome, "killer": verdict.killer, "cpu_s": round(verdict.cpu_s, 2)},
        }
        print(json.dumps(entry), file=self._file, flush=True)

    def close(self) -> None:
        self._file.close()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence.mutation", description=__doc__, epilog=EXAMPLE, allow_abbrev=False
    )
    parser.add_argument("--only", action="append", default=[], metavar="PLACE", help="a module or function, as printed")
    parser.add_argument("--sample", type=int, metavar="N", help="only N mutants, drawn by --seed")
    parser.add_argument("--seed", help="what the sample is drawn by (default: the digest of sources and tests)")
    parser.add_argument(
        "--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes (default: %(default)s)"
    )
    parser.add_argument("--fresh", action="store_true", help="begin anew, though the same sources were tried before")
    parser.add_argument("--record", type=Path, help="where verdicts are kept (default: out/mutation/record.jsonl)")
    parser.add_argument("--document", action="store_true", help=f"write {document.DOCUMENT} if everything holds")
    return parser


def _chosen(mutants: Sequence[Mutant], known: Iterable[Key], options: argparse.Namespace, digest: str) -> list[Mutant]:
    chosen = list(mutants)
    if options.only:
        chosen = [m for m in chosen if any(m.place == name or m.place.startswith(f"{name}.") for name in options.only)]
        if not chosen:
            places = ", ".join(sorted({mutant.place for mutant in mutants}))
            raise SystemExit(f"no mutant in {', '.join(options.only)}: the places are {places}")
    if options.sample is not None:
        # Those that are known to survive cost all tests and tell nothing new.
        equivalent = set(known)
        chosen = [mutant for mutant in chosen if mutant.key not in equivalent]
        seed = options.seed or digest
        chosen = random.Random(seed).sample(chosen, min(options.sample, len(chosen)))
        print(f"a sample of {len(chosen)}, drawn by --seed {seed}", flush=True)
    return chosen


def _try_all(
    baseline: Baseline, sources: dict[str, str], mutants: Sequence[Mutant], record: _Record, jobs: int
) -> list[tuple[Mutant, Verdict]]:
    results = [(mutant, record.done[mutant.key]) for mutant in mutants if mutant.key in record.done]
    if results:
        print(f"{len(results)} were tried before and are not tried again", flush=True)
    waiting = [mutant for mutant in mutants if mutant.key not in record.done]
    began = said = time.monotonic()
    survived = count = 0

    def report(mutant: Mutant, verdict: Verdict) -> None:
        nonlocal said, survived, count
        record.add(mutant, verdict)
        results.append((mutant, verdict))
        survived += verdict.outcome in (trial.SURVIVED, trial.UNREACHED)
        count += 1
        now = time.monotonic()
        if now - said >= _EVERY_S:
            said = now
            left_s = (now - began) / count * (len(waiting) - count)
            print(f"{count} of {len(waiting)}, {survived} survive, {left_s / 60.0:.0f} min left", flush=True)

    trial.try_all(baseline, sources, waiting, record.hints, jobs, report)
    return results


def _print_figures(judgements: dict[str, Judgement], every: Judgement) -> None:
    heads = f"{'mutants':>8} {'killed':>8} {'timed out':>10} {'equivalent':>11} {'survived':>9} {'score':>9}"
    print(f"\n{'module':14} {heads}")
    for name, one in (*judgements.items(), ("in all", every)):
        print(
            f"{name.rpartition('.')[2]:14} {one.tried:8} {one.killed:8} {one.timed_out:10} {len(one.explained):11} "
            f"{len(one.unexplained):9} {document.score(one):>9}"
        )
    if every.tried:
        print(
            f"\n{every.caught} of {every.tried} mutants killed, {100.0 * every.caught / every.tried:.2f} %; "
            f"of those that are not equivalent, {document.score(every)}"
        )


def _run(options: argparse.Namespace) -> int:
    path = (options.record or trial.root() / "out" / "mutation" / "record.jsonl").resolve()
    trial.warm_up()
    digest = _digest()
    listed = explained.load()
    sources = trial.sources()
    mutants = trial.in_child(lambda: trial.mutants(sources))
    gone = explained.stale(listed, mutants)
    for place, minus, plus, nth in gone:
        print(f"{explained.LIST} explains what is no mutant any more: {place} ({nth})\n    - {minus}\n    + {plus}")
    chosen = _chosen(mutants, listed, options, digest)

    print(f"{len(chosen)} mutants; the tests on the code as it is …", flush=True)
    baseline = trial.measure()
    if baseline.failed:
        print(f"a test fails on the code as it is: {baseline.failed}", file=sys.stderr)
        return 1
    cpu_s = sum(baseline.seconds.values())
    print(f"{len(baseline.seconds)} tests, {cpu_s:.0f} s of CPU time", flush=True)
    for place in baseline.missing:
        print(f"not covered: {place}")
    if not baseline.missing:
        print(f"every line and branch of {', '.join(trial.COVERED)} is reached", flush=True)

    record = _Record(path, digest, fresh=options.fresh)
    try:
        results = _try_all(baseline, sources, chosen, record, options.jobs)
    finally:
        record.close()
    every = judge(results, listed)
    judgements = {name: judge([r for r in results if r[0].module == name], listed) for name in sources}
    _print_figures(judgements, every)
    for mutant in every.unexplained:
        print(f"\nSURVIVED: {mutant.shown()}")
    for mutant in every.wrongly_explained:
        print(f"\n{explained.LIST} calls it equivalent, but a test kills it: {mutant.shown()}")
    holds = every.holds and not gone and not baseline.missing
    if options.document and holds and len(chosen) == len(mutants):
        page = trial.root() / document.DOCUMENT
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(document.written(judgements, mutants, listed, digest))
        print(f"written: {document.DOCUMENT}")
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
    except explained.ListError as problem:
        print(f"{explained.LIST}: {problem}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
