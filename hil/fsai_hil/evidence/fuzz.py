"""`python -m fsai_hil.evidence.fuzz`: strange frames, commands, services and times before the real Bridge and loop.

They come in virtual time by the rules of a hypothesis state machine (`fuzz_machine`), and the checker of the rules
judges every frame that goes out. What breaks a rule is cut down to the fewest steps and printed, with what was sent.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import hypothesis
from hypothesis.stateful import run_state_machine_as_test

from fsai_hil.evidence import fuzz_run
from fsai_hil.evidence.fuzz_machine import STEPS, Machine
from fsai_hil.evidence.fuzz_run import forget_stations
from fsai_hil.evidence.seeded import SEEDS, Seed, patched
from fsai_hil.evidence.work import followed, spread
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.supervisor import Phase
from fsai_vcu.interface.enums import AsState

BATCH: Final = 10  # examples of one seed
SEEDED_S: Final = 120.0  # of processor time for one seeded fault at most
_KINDS: Final = {
    "AS state": {state.name for state in AsState},
    "phase": {phase.name for phase in Phase},
    "reason": {reason.slug for reason in Reason},
}


@dataclass(slots=True)
class Done:
    """What examples have shown."""

    examples: int = 0
    cycles: int = 0
    reached: set[tuple[str, str]] = field(default_factory=set)
    failures: list[tuple[int, str]] = field(default_factory=list)  # seeds, and what happened

    def add(self, other: Done) -> None:
        self.examples += other.examples
        self.cycles += other.cycles
        self.reached |= other.reached
        self.failures += other.failures

    def missing(self, kind: str) -> set[str]:
        """What of the AS states, phases or reasons was not reached."""
        return _KINDS[kind] - {name for of, name in self.reached if of == kind}


def batch(seed: int, *, examples: int = BATCH, shrink: bool = True) -> Done:
    """The examples of one seed, as far as the first that breaks a rule."""
    done = Done()

    class Watched(Machine):
        def teardown(self) -> None:
            if hasattr(self, "run"):
                done.add(Done(1, self.run.cycles, self.run.reached))

    chosen = hypothesis.settings(
        max_examples=examples,
        stateful_step_count=STEPS,
        phases=[hypothesis.Phase.generate, hypothesis.Phase.shrink][: 1 + shrink],
        database=None,
        deadline=None,
        suppress_health_check=list(hypothesis.HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
    )
    try:
        run_state_machine_as_test(hypothesis.seed(seed)(Watched), settings=chosen)
    except Exception as error:
        steps = getattr(error, "__notes__", ())
        done.failures.append((seed, "\n".join([*steps, f"{type(error).__name__}: {error}"])))
    return done


def _broken(found: Done) -> str:
    again = "BROKEN (again: python -m fsai_hil.evidence.fuzz --jobs 1 --seed"
    return "\n".join(f"{again} {seed}):\n{words}" for seed, words in found.failures)


def campaign(first_seed: int, jobs: int, minutes: float) -> Done:
    """One seed after the other in `jobs` processes, with progress, until the time is over or a rule is broken."""
    began_s = time.monotonic()
    done = Done()
    seeds = itertools.count(first_seed)
    in_time = itertools.takewhile(
        lambda seed: seed == first_seed or not (done.failures or time.monotonic() - began_s > 60.0 * minutes), seeds
    )
    try:
        for found in followed(spread(batch, in_time, jobs), "seeds", None, _broken, "broke a rule"):
            done.add(found)
    except KeyboardInterrupt:
        print("interrupted: this is what was done until then", flush=True)
    seconds = time.monotonic() - began_s
    print(f"{done.examples:,} examples, {done.cycles:,} cycles of the car in {seconds:.1f} s")
    for kind in _KINDS:
        missing = ", ".join(sorted(done.missing(kind)))
        print(f"  {kind}: {f'not reached: {missing}' if missing else 'all reached'}")
    return done


# ---------------------------------------------------------------- faults put in on purpose


def sought(name: str) -> tuple[str, str, float]:
    """Put the seeded fault of that name into the rules and fuzz until it shows on the wire.

    Returns the name, what was broken ("" for nothing in `SEEDED_S`), and the processor time that took.
    """
    done, number = Done(), 0
    began_s = time.process_time()
    seed = next((one for one in SEEDS if one.name == name), Seed("", "", ""))
    setups = {key: seed.configured(setup) for key, setup in fuzz_run.SETUPS.items()}
    forget_stations()
    with patched(((fuzz_run, "SETUPS", setups), *seed.patches)):
        while not done.failures and time.process_time() - began_s < SEEDED_S:
            number += 1
            done.add(batch(number, shrink=False))
    forget_stations()
    words = done.failures[0][1].splitlines()[-1] if done.failures else ""
    return name, words, time.process_time() - began_s


def seek_all(jobs: int) -> bool:
    """Seek every seeded fault that shows on the wire, and nothing where there is none."""
    names = ["", *(seed.name for seed in SEEDS if seed.shows_in_fuzz)]
    print(f"{len(names) - 1} faults put into the rules on purpose, each sought on the wire:", flush=True)
    right = 0
    for name, words, seconds in spread(sought, names, jobs):
        right += bool(words) == bool(name)
        shown = name or "none: the rules as they are"
        print(f"  {shown:58} {seconds:6.1f} s  {(words or 'NOT FOUND')[:100]}", flush=True)
    print(f"{right} of {len(names)} as they should be")
    return right == len(names)


# ---------------------------------------------------------------- the command


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 0 every rule held, 1 one was broken (or a seeded fault not found), 2 wrong use."""
    parser = argparse.ArgumentParser(
        prog="python -m fsai_hil.evidence.fuzz",
        description="Put strange frames, commands, services and times before the bridge; judge every frame it sends.",
        epilog="example: python -m fsai_hil.evidence.fuzz --minutes 5",
    )
    parser.add_argument("--minutes", type=float, default=1.0, metavar="M", help="for so long (default: %(default)s)")
    parser.add_argument("--seeded", action="store_true", help="put faults into the rules on purpose and seek each")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="the first seed (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="J", help="processes")
    options = parser.parse_args(arguments)
    if options.jobs < 1 or options.minutes <= 0:
        print("--jobs and --minutes are more than 0", file=sys.stderr)
        return 2
    if options.seeded:
        return 0 if seek_all(options.jobs) else 1
    done = campaign(options.seed, options.jobs, options.minutes)
    print("\nBROKEN: see above." if done.failures else "\nEvery rule held on the wire.")
    return 1 if done.failures else 0


if __name__ == "__main__":
    sys.exit(main())
