"""`python -m fsai_hil.evidence`: the exhaustive search, its figures, and the seeded faults that show it can fail."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from typing import Any

from fsai_hil.evidence.model import Composition
from fsai_hil.evidence.scopes import all_scopes, scope
from fsai_hil.evidence.search import explore
from fsai_hil.evidence.seeded import SEEDS, search_seed
from fsai_hil.evidence.work import spread
from fsai_hil.rules.checker import RULES

EXAMPLE = "example: python -m fsai_hil.evidence --scope messages --seeded"
JOBS = os.cpu_count() or 1


def searched(name: str) -> dict[str, Any]:
    """Search the scope of that name; its figures."""
    one = scope(name)
    began = time.process_time()
    model = Composition(one)
    found = explore(model, bounds_ns=one.bounds_ns)
    return {
        "scope": one.name,
        "covers": one.covers,
        "choices": len(one.choices),
        "states": found.states,
        "transitions": found.transitions,
        "depth": found.depth,
        "endless": one.endless,
        "checks": dict(model.checks) | {"safe end": found.states * len(found.bounds_ns)},
        "safe_end_s": {name: bound / 1e9 for name, bound in found.bounds_ns.items()},
        "seconds": round(time.process_time() - began, 2),
        "holds": found.holds,
        "problems": found.problems,
        "trace": model.described(found.trace),
    }


def search_all(names: Sequence[str]) -> list[dict[str, Any]]:
    """Search the scopes of those names (none: all), printing as it goes."""
    chosen = [scope(name).name for name in names] or [one.name for one in all_scopes()]
    print(f"{'scope':20} {'states':>8} {'transitions':>12} {'depth':>6} {'CPU time':>10}")
    results = []
    for figures in spread(searched, chosen, JOBS):
        results.append(figures)
        print(
            f"{figures['scope']:20} {figures['states']:8,} {figures['transitions']:12,} {figures['depth']:6} "
            f"{figures['seconds']:8.1f} s",
            flush=True,
        )
        for problem in figures["problems"]:
            print(f"  BROKEN, rule {problem.rule}: {problem.words}")
        for line in figures["trace"]:
            print(f"  {line}")
    return sorted(results, key=lambda figures: chosen.index(figures["scope"]))


def _print_totals(results: Sequence[dict[str, Any]]) -> None:
    print(
        f"{'in all':20} {sum(r['states'] for r in results):8,} {sum(r['transitions'] for r in results):12,} "
        f"{max(r['depth'] for r in results):6} {sum(r['seconds'] for r in results):8.1f} s"
    )
    print("\nWhat each scope leaves free; everything else in it behaves:")
    for figures in results:
        print(f"  {figures['scope']}: {figures['covers']}")
    print("\nCycles held against each rule:")
    for rule, words in RULES.items():
        count = sum(r["checks"].get(rule, 0) for r in results)
        print(f"  {rule:>12}  {count:10,}  {words}")
    print(
        "\nThe safe end (out of AS_DRIVING: finished, off or braking by itself), from every state at the latest after:"
    )
    latest: dict[str, float] = {}
    for figures in results:
        for name, seconds in figures["safe_end_s"].items():
            latest[name] = max(latest.get(name, 0.0), seconds)
    for name, seconds in latest.items():
        print(f"  {seconds:6.2f} s  with {name}")
    print(
        "  A VCU that says AS_DRIVING for ever is at the end once it has received ESTOP_REQUEST, or FINISHED at rest."
    )
    for figures in results:
        if figures["endless"]:
            print(f"  none in '{figures['scope']}': {figures['endless']}")


def sought(name: str) -> dict[str, Any]:
    """Put the seeded fault of that name in and search; what was found."""
    seed = next(each for each in SEEDS if each.name == name)
    began = time.process_time()
    found, trace = search_seed(seed)
    return {
        "seed": seed.name,
        "rule": seed.rule,
        "found": seed.rule in {problem.rule for problem in found.problems},
        "steps": len(found.trace),
        "words": list(dict.fromkeys(problem.words for problem in found.problems)),
        "trace": trace,
        "seconds": round(time.process_time() - began, 2),
    }


def search_seeds() -> list[dict[str, Any]]:
    """Put every seeded fault in, one after another; each must be found."""
    names = [seed.name for seed in SEEDS if seed.scope]  # the others are for the fuzz alone
    print(f"\nSeeded faults: {len(names)} mistakes in rules, times and functions; each must be found")
    results = []
    for result in spread(sought, names, JOBS):
        results.append(result)
        verdict = f"rule {result['rule']}" if result["found"] else f"NOT FOUND (expected rule {result['rule']})"
        print(f"  {result['seed']:58} {verdict:18} {result['steps']:3} steps {result['seconds']:6.1f} s", flush=True)
    return sorted(results, key=lambda result: names.index(result["seed"]))


def _print_traces(seeds: Sequence[dict[str, Any]]) -> None:
    """The shortest way to the harm in words, of the first seed of each rule."""
    for rule in dict.fromkeys(seed["rule"] for seed in seeds):
        first = next(seed for seed in seeds if seed["rule"] == rule)
        print(f"\nRule {rule}, {first['seed']}: {'; '.join(first['words'])}")
        for line in first["trace"]:
            print(f"  {line}")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence",
        description="Visit every reachable state of supervisor and gate and the VCU; check every rule.",
        epilog=EXAMPLE,
    )
    parser.add_argument("--scope", action="append", default=[], metavar="NAME", help="search only this scope")
    parser.add_argument("--seeded", action="store_true", help="then put faults into the rules: all must be found")
    parser.add_argument("--only-seeded", action="store_true", help="only the seeded faults")
    options = parser.parse_args(arguments)
    try:
        results = [] if options.only_seeded else search_all(options.scope)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if results:
        _print_totals(results)
    seeds = search_seeds() if options.seeded or options.only_seeded else []
    _print_traces(seeds)
    holds = all(result["holds"] for result in results) and all(seed["found"] for seed in seeds)
    print("\n" + ("Every rule holds in every state." if holds else "BROKEN: see above."))
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
