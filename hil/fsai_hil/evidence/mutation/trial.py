"""The tests against one mutant, in a process of its own that is forked for it.

The parent has loaded everything but the code under test; the child imports it with the mistake in it, and runs the
tests that reach the mutated lines, quickest first, until one fails. Its time is its own CPU time, so that a busy
machine changes no verdict.
"""

from __future__ import annotations

import importlib
import io
import os
import resource
import signal
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Final

import coverage
import hypothesis
import pytest

from fsai_hil import CHECKOUT
from fsai_hil.evidence.mutation.mutants import Mutant, Walk

CORE: Final = CHECKOUT / "fsai_vcu" / "core"
MODULES: Final = {
    f"fsai_vcu.core.supervision.{name}": CORE / "supervision" / f"{name}.py"
    for name in ("supervisor", "gate", "plausibility", "readiness", "start_conditions", "wheel_speeds", "changes")
}
"""The modules that are mutated."""

COVERED: Final = ("supervision/*.py", "bridge.py", "bridge_state.py", "tally.py", "limits.py")
"""The modules whose every branch the killers must reach."""

_TESTED: Final = "supervisor gate supervision_plausibility supervision_readiness wheel_speeds supervision_changes"
KILLERS: Final = tuple(f"tests/core/test_{name}.py" for name in (*_TESTED.split(), "limits", "bridge"))
_MEMORY: Final = 6 << 30  # a mutant may fill it in a loop
_LEAST_CPU_S: Final = 20


def prepare() -> None:
    """The same examples in every run, no time spent on a beautiful failure; each child imports the code again."""
    for name in [name for name in sys.modules if name.startswith("fsai_vcu.core")]:
        del sys.modules[name]
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    os.environ.pop("PYTEST_ADDOPTS", None)
    os.chdir(CHECKOUT)
    sys.path.insert(0, str(CHECKOUT))
    phases = (hypothesis.Phase.generate,)
    hypothesis.settings.register_profile("mutation", derandomize=True, database=None, deadline=None, phases=phases)
    hypothesis.settings.load_profile("mutation")


def mutants() -> list[Mutant]:
    """All mutants. What is edited while they are tried does not reach them."""
    walks = [Walk(name, path.read_text(), vars(importlib.import_module(name))) for name, path in MODULES.items()]
    return [mutant for walk in walks for mutant in walk.mutants()]


def _run(tests: Sequence[str], *plugins: object) -> int:
    # Nobody reads why a test failed, so its asserts need not be rewritten to say it.
    options = ["-x", "--assert=plain", "-p", "no:cacheprovider", "-o", "addopts=--strict-markers"]
    return pytest.main([*options, *tests], plugins=plugins)


# ---------------------------------------------------------------- the code as it is


@dataclass(slots=True)
class Baseline:
    """The killers on the code as it is. An empty one has not been measured."""

    seconds: Counter[str] = field(default_factory=Counter)  # by test
    reached: dict[str, dict[int, list[str]]] = field(default_factory=dict)  # module -> line -> tests
    missing: str = ""  # lines and branches that no test takes
    failed: str = ""

    def candidates(self, mutant: Mutant) -> list[list[str]]:
        """The tests that reach the mutant, by file: its own module's first, and the quickest of each file."""
        lines = self.reached.get(mutant.module, {})
        tests = {test for line in mutant.lines for test in lines.get(line, ())}
        if not tests or "" in tests:  # it acts on import
            tests = set(self.seconds or KILLERS)
        files = sorted(KILLERS, key=lambda file: not file.endswith(f"{mutant.module.rpartition('.')[2]}.py"))
        return [sorted((one for one in tests if one.startswith(file)), key=self.seconds.__getitem__) for file in files]


def measure() -> Baseline:
    """Run all killers once, in a process that has not imported the code: what does each reach, and what does none?"""
    covered = sorted(path for part in COVERED for path in CORE.glob(part) if path.stem != "__init__")
    measured = coverage.Coverage(data_file=None, branch=True, include=list(map(str, covered)), config_file=False)
    measured.set_option("run:core", "ctrace")  # the only one that knows whose lines they are
    measured.set_option("report:exclude_lines", [])  # no comment switches a line off
    measured.set_option("report:partial_branches", [])
    seconds, printed, table = Counter[str](), io.StringIO(), io.StringIO()

    class Watch:
        """Observer of the tests: which one runs, and how long each takes."""

        def pytest_runtest_logstart(self, nodeid: str) -> None:
            measured.switch_context(nodeid)

        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            seconds[report.nodeid] += report.duration  # type: ignore[assignment]

    measured.start()
    for file in covered:  # so that one that no test imports is seen to be missing
        importlib.import_module(".".join(file.relative_to(CHECKOUT).with_suffix("").parts))
    with redirect_stdout(printed):
        status = _run(KILLERS, Watch())
    measured.stop()
    share = measured.report(show_missing=True, skip_covered=True, file=table)
    reached = {module: measured.get_data().contexts_by_lineno(str(path)) for module, path in MODULES.items()}
    missing, failed = table.getvalue() if share < 100.0 else "", printed.getvalue() if status else ""
    return Baseline(seconds, reached, missing, failed)


# ---------------------------------------------------------------- one mutant


def _child(mutant: Mutant, tests: Sequence[Sequence[str]], cpu_s: int) -> None:
    """Ends with status 0 if the mutant survives; with 1, or by a signal, if it does not."""
    status = 1
    try:
        signal.alarm(900)  # a mutant may wait for ever
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        mistaken, as_it_is = mutant.code(str(MODULES[mutant.module])), SourceFileLoader.get_code
        SourceFileLoader.get_code = (  # type: ignore[method-assign]
            lambda loader, name: mistaken if name == mutant.module else as_it_is(loader, name)
        )
        with Path(os.devnull).open("w") as nothing, redirect_stdout(nothing), redirect_stderr(nothing):
            # File by file: most mutants fall to the first, and the others need not be imported.
            status = int(any(_run(some) for some in tests if some))
    finally:
        os._exit(status)


def outcomes(baseline: Baseline, tried: Sequence[Mutant], jobs: int) -> Iterator[tuple[Mutant, bool]]:
    """Each mutant and whether it survives, as it comes in; `jobs` mutants at a time."""
    waiting, running = list(reversed(tried)), dict[int, Mutant]()
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            tests = baseline.candidates(mutant)
            cpu_s = _LEAST_CPU_S + round(5.0 * sum(baseline.seconds[test] for some in tests for test in some))
            if (child := os.fork()) == 0:
                _child(mutant, tests, cpu_s)
            running[child] = mutant
        child, status = os.wait()
        yield running.pop(child), status == 0
