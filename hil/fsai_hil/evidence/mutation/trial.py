"""The tests against one mutant, in a process of its own.

A mistake in a function: a parent that has collected all tests forks, the child gives the function its mistaken code.
A mistake in a table or a default: a parent that has loaded everything but the code under test forks, the child imports
the mistaken source. Either runs the tests that reach the mutated lines, quickest first, until one fails. Time is the
child's own CPU time, so that a busy machine changes no verdict.
"""

from __future__ import annotations

import gc
import importlib.abc
import importlib.machinery
import importlib.util
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
    loaded = sorted(name for name in sys.modules if name.startswith((f"{PACKAGE}supervision.", f"{PACKAGE}bridge")))
    if loaded:
        raise RuntimeError(f"already imported, so that a mutant would not be: {', '.join(loaded)}")


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


def _within(cpu_s: float) -> None:
    """From now on this process has so much CPU time, and is then told so again and again."""
    signal.signal(signal.SIGPROF, _expire)
    signal.setitimer(signal.ITIMER_PROF, cpu_s, 1.0)


# ---------------------------------------------------------------- the code as it is


class _Watch:
    """Notes the first failure and each test's CPU time, and tells the coverage measurement whose lines follow."""

    def __init__(self, measured: coverage.Coverage | None = None) -> None:
        self._measured = measured
        self.seconds: dict[str, float] = {}
        self.failed = ""
        self.words = ""

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        if self._measured is not None:
            self._measured.switch_context(item.nodeid)
        began = time.process_time()
        yield
        self.seconds[item.nodeid] = time.process_time() - began

    def pytest_runtest_logreport(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        if report.failed and not self.failed:
            self.failed, self.words = report.nodeid, report.longreprtext

    pytest_collectreport = pytest_runtest_logreport


def _arguments(files: Iterable[str]) -> list[str]:
    folder = CHECKOUT / "tests" / "core"
    # Nobody reads why a test failed, so its asserts need not be rewritten to say it.
    fixed = ["-x", "--assert=plain", "-p", "no:cacheprovider", "--rootdir", str(CHECKOUT)]
    fixed += ["-c", str(CHECKOUT / "pyproject.toml"), "-o", "addopts=--strict-markers"]
    return [*fixed, *(str(folder / name) for name in files)]


def measure() -> Baseline:
    """Run all killers once: which test reaches which line, and what none reaches."""
    first, second = in_children(_measure, [KILLERS[:-1], KILLERS[-1:]], 2)
    reached: dict[str, dict[int, list[str]]] = {module: {} for module in first.reached}
    for module, lines in (*first.reached.items(), *second.reached.items()):
        for line, tests in lines.items():
            reached[module].setdefault(line, []).extend(tests)
    missing = [place for place in first.missing if place in set(second.missing)]
    return Baseline(first.seconds | second.seconds, reached, missing, first.failed or second.failed)


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
    status = pytest.main(_arguments(files), plugins=[watch])
    measured.stop()
    found = Baseline(watch.seconds, failed=f"{watch.failed}: {watch.words}" if watch.failed else "")
    if status and not found.failed:
        found.failed = f"pytest ends with {status}"
    for module in sources():
        lines = measured.get_data().contexts_by_lineno(str(path_of(module)))
        found.reached[module] = {line: [test for test in tests if test] for line, tests in lines.items()}
    with tempfile.NamedTemporaryFile("r") as report:
        measured.json_report(outfile=report.name)
        told = json.load(report)["files"]
    for where in (str(file.relative_to(CHECKOUT)) for file in covered):
        found.missing += [f"{where}, line {line}: no test reaches it" for line in told[where]["missing_lines"]]
        for line, end in told[where]["missing_branches"]:
            to = f"line {end}" if end > 0 else "the function's end"
            found.missing.append(f"{where}, line {line}: no test goes from here to {to}")
    return found


def mutants(texts: Mapping[str, str]) -> list[Mutant]:
    """All mutants, found in a child: the modules are imported there."""

    def find(module: str) -> list[Mutant]:
        return mutants_of(module, texts[module], vars(importlib.import_module(module)))

    found = [mutant for part in in_children(find, list(texts), 2) for mutant in part]
    return sorted(found, key=lambda mutant: ([*texts].index(mutant.module), mutant.start, mutant.end, mutant.text))


# ---------------------------------------------------------------- one mutant


class _Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the mutated source in place of the module."""

    def __init__(self, module: str, text: str) -> None:
        self._module, self._path = module, str(path_of(module))
        self._code = compile(text, self._path, "exec")

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._module:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=self._path)

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self._path
        exec(self._code, module.__dict__)


class _Chosen(_Watch):
    """Runs the chosen tests in their order."""

    def __init__(self, tests: Sequence[str]) -> None:
        super().__init__()
        self._order = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((i for i in items if i.nodeid in self._order), key=lambda i: self._order[i.nodeid])


def _imported(text: str, mutant: Mutant, tests: Sequence[str]) -> str:
    """Everything that leans on the module is imported with the mistake in it."""
    sys.meta_path.insert(0, _Mutated(mutant.module, text))
    chosen = _Chosen(tests)
    # File by file: most mutants fall to the first, and the others need not be imported.
    for file in dict.fromkeys(test.partition("::")[0] for test in tests):
        if status := pytest.main(_arguments([Path(file).name]), plugins=[chosen]):
            return chosen.failed or f"pytest ends with {status} on {file}"
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


def candidates(baseline: Baseline, mutant: Mutant) -> list[str]:
    """The tests that reach the mutant: its own module's first, then the quickest."""
    tests = set(baseline.seconds)
    if not mutant.at_import:
        lines = baseline.reached[mutant.module]
        tests = {test for line in range(mutant.lines[0], mutant.lines[1] + 1) for test in lines.get(line, ())}
    own = f"{mutant.module.rpartition('.')[2]}.py"
    return sorted(tests, key=lambda t: (not t.partition("::")[0].endswith(own), baseline.seconds[t], t))


def try_all(baseline: Baseline, texts: Mapping[str, str], tried: Sequence[Mutant], jobs: int, report: Report) -> None:
    """Every mutant's verdict is reported as it comes in, of `jobs` mutants at a time.

    What acts on import comes first: after that this process has imported the code itself.
    """

    def verdict(trial: Callable[[str, Mutant, Sequence[str]], str], mutant: Mutant) -> tuple[Mutant, str]:
        tests = candidates(baseline, mutant)
        allowed_s = _LEAST_CPU_S + 5.0 * sum(baseline.seconds[test] for test in tests)
        _within(allowed_s)
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
            called = [mutant for mutant in tried if not mutant.at_import]
            for mutant, killer in in_children(partial(verdict, partial(_called, items, self)), called, jobs):
                report(mutant, killer)
            return True

    watch = Session()
    if status := pytest.main([*_arguments(KILLERS), "-s", "-p", "no:terminal"], plugins=[watch]):
        raise RuntimeError(f"pytest ends with {status}: {watch.failed}")
