"""The tests against one mutant, in a process of its own.

A mistake in a function: a parent that has collected all tests forks, the child gives the function its mistaken code.
A mistake in a table or a default: a parent that has loaded everything but the code under test forks, the child imports
the mistaken source. Either runs the tests that reach the mutated lines, quickest first, until one fails. Time is the
child's own CPU time, so that a busy machine changes no verdict.
"""

from __future__ import annotations

import gc
import importlib
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, Final

import coverage
import hypothesis
import pytest

from fsai_hil import CHECKOUT
from fsai_hil.evidence.mutation.mutants import Mutant, mutants_of, mutated

PACKAGE: Final = "fsai_vcu.core."
MODULES: Final = (
    "supervision.supervisor",
    "supervision.gate",
    "supervision.plausibility",
    "supervision.readiness",
    "supervision.wheel_speeds",
    "supervision.changes",
)
"""What is mutated."""

COVERED: Final = ("supervision/*.py", "bridge.py", "bridge_state.py", "tally.py", "limits.py")
"""What the killers must reach in every branch."""

KILLERS: Final = (
    "test_supervisor.py",
    "test_gate.py",
    "test_supervision_plausibility.py",
    "test_supervision_readiness.py",
    "test_wheel_speeds.py",
    "test_supervision_changes.py",
    "test_limits.py",
    "test_bridge.py",
)
_MEMORY: Final = 6 << 30  # a mutant may fill it in a loop
_LEAST_CPU_S: Final = 20.0
_STUCK_S: Final = 900.0  # without any verdict: a child has died

Report = Callable[[Mutant, str], None]
"""Takes a mutant and the test that killed it, "" where it survived."""


@dataclass(slots=True)
class Baseline:
    """The killers on the code as it is."""

    seconds: dict[str, float] = field(default_factory=dict)  # test -> CPU time
    reached: dict[str, dict[int, list[str]]] = field(default_factory=dict)  # module -> line -> tests
    missing: list[str] = field(default_factory=list)  # lines and branches that no test takes
    failed: str = ""

    def candidates(self, mutant: Mutant) -> list[str]:
        """The tests that reach the mutant (all, if nothing was measured): its own module's first, then the quickest."""
        tests = set(self.seconds)
        if self.reached and not mutant.at_import:
            lines = self.reached[mutant.module]
            tests = {test for line in range(mutant.lines[0], mutant.lines[1] + 1) for test in lines.get(line, ())}
        own = f"{mutant.module.rpartition('.')[2]}.py"
        order = sorted(self.seconds, key=lambda test: (not test.partition("::")[0].endswith(own), self.seconds[test]))
        return [test for test in order if test in tests]


def path_of(module: str) -> Path:
    return CHECKOUT / f"{module.replace('.', '/')}.py"


def sources() -> dict[str, str]:
    """Module -> its text now: what is edited while trials run does not reach them."""
    return {PACKAGE + name: path_of(PACKAGE + name).read_text() for name in MODULES}


def warm_up() -> None:
    """Load what every child needs and none mutates."""
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    os.environ.pop("PYTEST_ADDOPTS", None)
    os.chdir(CHECKOUT)
    sys.path.insert(0, str(CHECKOUT))
    for name in ("fsai_vcu.interface.codec", "fsai_vcu.core.command", "fsai_vcu.core.driving", "hypothesis.strategies"):
        importlib.import_module(name)
    # The same examples in every run, and no time spent on making a failure beautiful.
    hypothesis.settings.register_profile(
        "mutation", derandomize=True, database=None, deadline=None, phases=(hypothesis.Phase.generate,)
    )
    hypothesis.settings.load_profile("mutation")


# ---------------------------------------------------------------- processes

_work: Callable[[Any], Any]  # what the children do, inherited: it need not be picklable


def _begin() -> None:
    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silence, stream)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its children
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))


def _do(task: Any) -> Any:
    return _work(task)


def in_children(work: Callable[[Any], Any], tasks: Sequence[Any], jobs: int) -> Iterator[Any]:
    """The result of each task as it comes in, each from a process of its own that is forked from this one."""
    global _work
    _work = work
    sys.stdout.flush()
    gc.collect()
    gc.freeze()
    with multiprocessing.get_context("fork").Pool(jobs, _begin, maxtasksperchild=1) as pool:
        results = pool.imap_unordered(_do, tasks)
        for _ in tasks:
            yield results.next(_STUCK_S)


class OutOfTime(BaseException):
    """The mutant takes many times as long as the code does."""


def _expire(*_: object) -> None:
    raise OutOfTime


# ---------------------------------------------------------------- the code as it is


class _Watch:
    """Notes the first failure and each test's CPU time, and tells the coverage measurement whose lines follow.

    With `tests` it runs only these, in their order.
    """

    def __init__(self, measured: coverage.Coverage | None = None, tests: Sequence[str] | None = None) -> None:
        self._measured = measured
        self._order = None if tests is None else {test: place for place, test in enumerate(tests)}
        self.seconds: dict[str, float] = {}
        self.failed = ""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if (order := self._order) is not None:
            items[:] = sorted((one for one in items if one.nodeid in order), key=lambda one: order[one.nodeid])

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        if self._measured is not None:
            self._measured.switch_context(item.nodeid)
        began = time.process_time()
        yield
        self.seconds[item.nodeid] = time.process_time() - began

    def pytest_runtest_logreport(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        if report.failed and not self.failed:
            self.failed = f"{report.nodeid}: {report.longreprtext}" if self._measured else report.nodeid

    pytest_collectreport = pytest_runtest_logreport


def _run(files: Iterable[str], watch: object, *more: str) -> int:
    # Nobody reads why a test failed, so its asserts need not be rewritten to say it.
    fixed = ["-x", "--assert=plain", "-p", "no:cacheprovider", "--rootdir", str(CHECKOUT), *more]
    fixed += ["-c", str(CHECKOUT / "pyproject.toml"), "-o", "addopts=--strict-markers"]
    return pytest.main([*fixed, *(str(CHECKOUT / "tests" / "core" / name) for name in files)], plugins=[watch])


def measure() -> Baseline:
    """Run all killers once: which test reaches which line, and what none reaches."""
    baselines: list[Baseline] = list(in_children(_measure, [KILLERS], 1))
    return baselines[0]


def _measure(files: Sequence[str]) -> Baseline:
    core = CHECKOUT / "fsai_vcu" / "core"
    covered = sorted(path for part in COVERED for path in core.glob(part) if path.stem != "__init__")
    measured = coverage.Coverage(data_file=None, branch=True, include=list(map(str, covered)), config_file=False)
    measured.set_option("run:core", "ctrace")  # the only one that knows whose lines they are
    measured.set_option("report:exclude_lines", [])  # no comment switches a line off
    measured.set_option("report:partial_branches", [])
    watch = _Watch(measured)
    measured.start()
    for file in covered:  # so that one that no test imports is seen to be missing
        importlib.import_module(".".join(file.relative_to(CHECKOUT).with_suffix("").parts))
    status = _run(files, watch)
    measured.stop()
    found = Baseline(watch.seconds, failed=watch.failed or (f"pytest ends with {status}" if status else ""))
    for module in sources():
        lines = measured.get_data().contexts_by_lineno(str(path_of(module)))
        found.reached[module] = {line: [test for test in tests if test] for line, tests in lines.items()}
    with tempfile.NamedTemporaryFile("r") as report:
        measured.json_report(outfile=report.name)
        reported = json.load(report)["files"]
    for where in (str(file.relative_to(CHECKOUT)) for file in covered):
        found.missing += [f"{where}, line {line}: no test reaches it" for line in reported[where]["missing_lines"]]
        for line, end in reported[where]["missing_branches"]:
            to = f"line {end}" if end > 0 else "the function's end"
            found.missing.append(f"{where}, line {line}: no test goes from here to {to}")
    return found


def mutants(texts: Mapping[str, str]) -> list[Mutant]:
    """All mutants, in the order of the sources."""
    found = [
        mutant
        for module, text in texts.items()
        for mutant in mutants_of(module, text, vars(importlib.import_module(module)))
    ]
    return sorted(found, key=lambda mutant: ([*texts].index(mutant.module), mutant.start, mutant.end, mutant.text))


# ---------------------------------------------------------------- one mutant


def _imported(text: str, mutant: Mutant, tests: Sequence[str]) -> str:
    """Everything that leans on the module imports it with the mistake in it."""
    path = str(path_of(mutant.module))
    module = sys.modules[mutant.module] = ModuleType(mutant.module)
    module.__file__ = path
    try:
        exec(compile(text, path, "exec"), vars(module))
    except Exception as error:
        return f"the import: {error}"
    package, _, name = mutant.module.rpartition(".")
    setattr(importlib.import_module(package), name, module)
    watch = _Watch(tests=tests)
    # File by file: most mutants fall to the first, and the others need not be imported.
    for file in dict.fromkeys(test.partition("::")[0] for test in tests):
        if status := _run([Path(file).name], watch):
            return watch.failed or f"pytest ends with {status} on {file}"
    return ""


def _called(items: Mapping[str, pytest.Item], watch: _Watch, text: str, mutant: Mutant, tests: Sequence[str]) -> str:
    """The tests are collected: the function gets the code with the mistake in it."""
    found: Any = sys.modules[mutant.module]
    code = compile(text, str(path_of(mutant.module)), "exec")
    for name in mutant.where.split("."):
        found = vars(found)[name]
        code = next(part for part in code.co_consts if isinstance(part, CodeType) and part.co_name == name)
    function: Any = found.fget if isinstance(found, property) else found
    function.__code__ = code
    for test in tests:
        items[test].ihook.pytest_runtest_protocol(item=items[test], nextitem=None)
        if watch.failed:
            return watch.failed
    return ""


def try_all(baseline: Baseline, texts: Mapping[str, str], tried: Sequence[Mutant], jobs: int, report: Report) -> None:
    """Every mutant's verdict is reported as it comes in, of `jobs` mutants at a time.

    What acts on import comes first: after that this process has imported the code itself. With an empty baseline, which
    has not been measured, nothing may act on import.
    """

    def verdict(trial: Callable[[str, Mutant, Sequence[str]], str], mutant: Mutant) -> tuple[Mutant, str]:
        tests = baseline.candidates(mutant)
        allowed_s = _LEAST_CPU_S + 5.0 * sum(baseline.seconds[test] for test in tests)
        signal.signal(signal.SIGPROF, _expire)
        signal.setitimer(signal.ITIMER_PROF, allowed_s, 1.0)
        try:
            return mutant, trial(mutated(texts[mutant.module], mutant), mutant, tests)
        except OutOfTime:
            return mutant, f"takes more than {allowed_s:.0f} s"

    for mutant, killer in in_children(partial(verdict, _imported), [m for m in tried if m.at_import], jobs):
        report(mutant, killer)

    class Session(_Watch):
        @pytest.hookimpl(tryfirst=True)
        def pytest_runtestloop(self, session: pytest.Session) -> bool:
            items = {item.nodeid: item for item in session.items}
            baseline.seconds = baseline.seconds or dict.fromkeys(items, 0.0)
            called = [mutant for mutant in tried if not mutant.at_import]
            for mutant, killer in in_children(partial(verdict, partial(_called, items, self)), called, jobs):
                report(mutant, killer)
            return True

    watch = Session()
    if status := _run(KILLERS, watch, "-s", "-p", "no:terminal"):
        raise RuntimeError(f"pytest ends with {status}: {watch.failed}")
