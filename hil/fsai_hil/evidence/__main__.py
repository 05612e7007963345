"""`python -m fsai_hil.evidence`: the exhaustive search, its figures, and the seeded faults that show it can fail."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from fsai_hil.evidence.model import Composition
from fsai_hil.evidence.scopes import all_scopes, scope
from fsai_hil.evidence.search import explore
from fsai_hil.evidence.seeded import SEEDS, Seed, search_seed
from fsai_hil.rules.checker import RULES

EXAMPLE = "example: python -m fsai_hil.evidence --scope messages --seeded"


def searched(name: str) -> dict[str, Any]:
    """Search the scope of that name; its figures."""
    one = scope(name)
    began = time.process_time()
    model = Composition(one)
    found = explore(model, bounds_ns=one.bounds_ns)
    trace = model.told(found.trace)
    figures: dict[str, Any] = {
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
        "problems": [{"rule": p.rule, "words": p.words} for p in found.problems],
        "trace": trace,
    }
    return figures


def _print_scope(figures: dict[str, Any]) -> None:
    print(
        f"{figures['scope']:20} {figures['states']:8,} {figures['transitions']:12,} {figures['depth']:6} "
        f"{figures['seconds']:8.1f} s",
        flush=True,
    )
    for problem in figures["problems"]:
        print(f"  BROKEN, rule {problem['rule']}: {problem['words']}")
    for line in figures["trace"]:
        print(f"  {line}")


def search_all(names: Sequence[str], *, quiet: bool) -> list[dict[str, Any]]:
    """Search the scopes of those names (none: all), printing as it goes."""
    chosen = [scope(name).name for name in names] or [one.name for one in all_scopes()]
    if not quiet:
        print(f"{'scope':20} {'states':>8} {'transitions':>12} {'depth':>6} {'CPU time':>10}")
    results = []
    with ProcessPoolExecutor() as pool:
        for figures in pool.map(searched, chosen):
            results.append(figures)
            if not quiet:
                _print_scope(figures)
    return results


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
    rules = sorted({problem.rule for problem in found.problems})
    return {
        "seed": seed.name,
        "rule": seed.rule,
        "scope": seed.scope,
        "found": seed.rule in rules,
        "rules": rules,
        "steps": len(found.trace),
        "words": list(dict.fromkeys(problem.words for problem in found.problems)),
        "trace": trace,
        "seconds": round(time.process_time() - began, 2),
    }


def searched_seeds() -> list[Seed]:
    """Those that are not for the fuzz alone."""
    return [seed for seed in SEEDS if seed.scope]


def search_seeds(*, quiet: bool) -> list[dict[str, Any]]:
    """Put every seeded fault in, one after another; each must be found."""
    results = []
    with ProcessPoolExecutor() as pool:
        for result in pool.map(sought, [seed.name for seed in searched_seeds()]):
            results.append(result)
            if not quiet:
                verdict = f"rule {result['rule']}" if result["found"] else f"NOT FOUND (expected rule {result['rule']})"
                print(
                    f"  {result['seed']:58} {verdict:18} {result['steps']:3} steps {result['seconds']:6.1f} s",
                    flush=True,
                )
    return results


def _print_traces(seeds: Sequence[dict[str, Any]], *, every: bool) -> None:
    """The shortest way to the harm in words: of every seed, or of the first one of each rule."""
    told: set[str] = set()
    for seed in seeds:
        if every or seed["rule"] not in told:
            told.add(seed["rule"])
            print(f"\nRule {seed['rule']}, {seed['seed']}: {'; '.join(seed['words'])}")
            for line in seed["trace"]:
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
    parser.add_argument("--traces", action="store_true", help="tell the trace of every seed, not of one for each rule")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    options = parser.parse_args(arguments)
    try:
        results = [] if options.only_seeded else search_all(options.scope, quiet=options.json)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if results and not options.json:
        _print_totals(results)
    seeds: list[dict[str, Any]] = []
    if options.seeded or options.only_seeded:
        if not options.json:
            print(
                f"\nSeeded faults: {len(searched_seeds())} mistakes in rules, times and functions; each must be found"
            )
        seeds = search_seeds(quiet=options.json)
        if not options.json:
            _print_traces(seeds, every=options.traces)
    holds = all(result["holds"] for result in results) and all(seed["found"] for seed in seeds)
    if options.json:
        print(json.dumps({"holds": holds, "scopes": results, "seeded": seeds}, indent=1))
    else:
        print("\n" + ("Every rule holds in every state." if holds else "BROKEN: see above."))
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
