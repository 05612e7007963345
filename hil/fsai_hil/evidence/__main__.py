"""`python -m fsai_hil.evidence`: the exhaustive search, its figures, and the seeded faults that show it can fail."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

from fsai_hil.evidence.model import LEFT_OUT
from fsai_hil.evidence.scopes import SCOPES, scope
from fsai_hil.evidence.search import Search
from fsai_hil.evidence.seeded import SEEDS, Seed, search_for
from fsai_hil.evidence.work import spread
from fsai_hil.rules.checker import RULES

JOBS = os.cpu_count() or 1


@dataclass(slots=True)
class Searched:
    """The result of the search of one scope, or for one seeded fault."""

    name: str
    found: Search
    trace: list[str]
    seconds: float


def searched(name: str) -> Searched:
    """Search the scope of that name, or for the harm of the seeded fault of that name."""
    began = time.process_time()
    seed = next((seed for seed in SEEDS if seed.name == name), Seed("", "", name))
    found, model = search_for(seed)
    return Searched(name, found, model.described(found.trace), time.process_time() - began)


def search_all(names: Sequence[str]) -> list[Searched]:
    """Search the scopes of those names (none: all), printing as it goes."""
    chosen = [scope(name).name for name in names] or [one.name for one in SCOPES]
    print(f"{'scope':20} {'states':>8} {'transitions':>12} {'depth':>6} {'CPU time':>10}")
    results = []
    for one in spread(searched, chosen, JOBS):
        results.append(one)
        found = one.found
        figures = f"{found.states:8,} {found.transitions:12,} {found.depth:6} {one.seconds:8.1f} s"
        print(f"{one.name:20} {figures}", flush=True)
        for problem in found.problems:
            print(f"  BROKEN, rule {problem.rule}: {problem.words}")
        for line in one.trace:
            print(f"  {line}")
    return sorted(results, key=lambda one: chosen.index(one.name))


def _print_totals(results: Sequence[Searched]) -> None:
    """Print the sums of all scopes, their limits, and the rules with what broke them."""
    found = [one.found for one in results]
    print(
        f"{'in all':20} {sum(f.states for f in found):8,} {sum(f.transitions for f in found):12,} "
        f"{max(f.depth for f in found):6} {sum(one.seconds for one in results):8.1f} s"
    )
    print("\nWhat each scope leaves free; everything else in it behaves:")
    for one in results:
        print(f"  {one.name}: {scope(one.name).covers}")
    print("\nNot searched, in any scope:")
    for words in LEFT_OUT:
        print(f"  {words}")
    print("\nThe rules, each held against every cycle:")
    for rule, words in RULES.items():
        print(f"  {rule:>12}  {words}")
    print(
        "\nThe safe end (out of AS_DRIVING: finished, off or braking by itself), from every state at the latest after:"
    )
    for name in dict.fromkeys(name for each in found for name in each.bounds_ns):
        print(f"  {max(each.bounds_ns.get(name, 0) for each in found) / 1e9:6.2f} s  with {name}")
    print(
        "  A VCU that says AS_DRIVING for ever is at the end once it has received ESTOP_REQUEST, or FINISHED at rest."
    )
    for one in results:
        if not scope(one.name).endings:
            print(f"  none in '{one.name}': a process that never sends brings no car to any end")


def search_seeds() -> bool:
    """Put every seeded fault in, one after another; each must be found. Of each rule's first, the shortest trace."""
    rules = {seed.name: seed.rule for seed in SEEDS if seed.scope}  # the others are for the fuzz alone
    print(f"\nSeeded faults: {len(rules)} mistakes in rules, times and functions; each must be found")
    results: dict[str, Searched] = {}
    missed = 0
    for one in spread(searched, rules, JOBS):
        results[one.name] = one
        rule, steps = rules[one.name], len(one.found.trace)
        is_found = rule in {problem.rule for problem in one.found.problems}
        missed += not is_found
        verdict = f"rule {rule}" if is_found else f"NOT FOUND (expected rule {rule})"
        print(f"  {one.name:58} {verdict:18} {steps:3} steps {one.seconds:6.1f} s", flush=True)
    for rule in dict.fromkeys(rules.values()):
        first = next(results[name] for name in rules if rules[name] == rule)
        words = dict.fromkeys(problem.words for problem in first.found.problems)
        print(f"\nRule {rule}, {first.name}: {'; '.join(words)}")
        for line in first.trace:
            print(f"  {line}")
    return not missed


def main(arguments: Sequence[str] | None = None) -> int:
    """Search the scopes and the seeded faults that the arguments name; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence",
        description="Visit every reachable state of supervisor and gate and the VCU; check every rule.",
        epilog="example: python -m fsai_hil.evidence --scope messages --seeded",
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
    holds = all(one.found.holds for one in results)
    if options.seeded or options.only_seeded:
        holds &= search_seeds()
    print("\n" + ("Every rule holds in every state." if holds else "BROKEN: see above."))
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
