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
import os
import pickle
import resource
import selectors
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

import coverage
import hypothesis
import pytest

from fsai_hil import CHECKOUT
from fsai_hil.evidence.mutation.operators import Mutant, mutants_of, mutated

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

COVERED: Final = ("supervision/*", "bridge.py", "bridge_state.py", "tally.py", "limits.py")
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
TOO_SLOW: Final = "test_whatever_happens_in_whatever_order_no_cycle_breaks_a_rule"
"""Two thirds of the killers' time in one property: what only it would kill lacks a test that says what is wrong."""

_MEMORY: Final = 6 << 30  # a mutant may fill it in a loop
_LEAST_CPU_S: Final = 20.0

KILLED, SURVIVED, TIMED_OUT, UNREACHED = "killed", "survived", "timed out", "unreached"


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a mutant, and the test that says so."""

    outcome: str
    killer: str = ""
    cpu_s: float = 0.0


@dataclass(slots=True)
class Baseline:
    """The killers on the code as it is."""

    seconds: dict[str, float] = field(default_factory=dict)  # test -> CPU time
    reached: dict[str, dict[int, list[str]]] = field(default_factory=dict)  # module -> line -> tests
    missing: list[str] = field(default_factory=list)  # lines and branches that no test takes
    failed: str = ""


def root() -> Path:
    """The project's directory: the tests and the sources to be mutated are in it."""
    return CHECKOUT


def path_of(module: str) -> Path:
    return root() / (module.replace(".", "/") + ".py")


# ---------------------------------------------------------------- processes


def warm_up() -> None:
    """Load what every child needs and none mutates."""
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    os.environ.pop("PYTEST_ADDOPTS", None)
    os.chdir(root())
    sys.path.insert(0, str(root()))
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
    gc.collect()
    gc.freeze()


def fork(work: Callable[[], object], cpu_s: float | None = None) -> tuple[int, int]:
    """Run `work` in a child; its pid, and where its pickled result can be read."""
    out, into = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        os.close(into)
        return pid, out
    try:
        os.close(out)
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silence, stream)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its children
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        if cpu_s is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (round(cpu_s), round(cpu_s)))
        try:
            result: object = work()
        except BaseException as problem:  # what a mutant raises on import, too, is a result
            result = problem
        with os.fdopen(into, "wb") as pipe:
            pickle.dump(result, pipe)
    finally:
        os._exit(0)


def gathered(pid: int, out: int) -> Any:
    """The result of a child's work; what it raised is raised here."""
    with os.fdopen(out, "rb") as pipe:
        data = pipe.read()
    os.waitpid(pid, 0)
    if not data:
        raise RuntimeError("a child died without a word")
    result = pickle.loads(data)
    if isinstance(result, BaseException):
        raise result
    return result


def in_child(work: Callable[[], Any]) -> Any:
    """The result of `work`, of which nothing remains in this process."""
    return gathered(*fork(work))


# ---------------------------------------------------------------- the code as it is


class _Timed:
    """Notes each test's CPU time, and tells the coverage measurement whose lines follow."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self._measured = measured
        self.seconds: dict[str, float] = {}
        self.failed = ""

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._measured.switch_context(item.nodeid)
        began = time.process_time()
        yield
        self.seconds[item.nodeid] = time.process_time() - began
        self._measured.switch_context("")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = f"{report.nodeid}: {report.longreprtext}"

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.failed:
            self.failed = f"{report.nodeid}: {report.longreprtext}"


def _arguments(files: Iterable[str]) -> list[str]:
    folder = root() / "tests" / "core"
    # Nobody reads why a test failed, so its asserts need not be rewritten to say it.
    fixed = ["-x", "--assert=plain", "-p", "no:cacheprovider", "--rootdir", str(root())]
    fixed += ["-c", str(root() / "pyproject.toml"), "-o", "addopts=--strict-markers"]
    return [*fixed, "--deselect", f"tests/core/test_bridge.py::{TOO_SLOW}", *(str(folder / name) for name in files)]


def measure() -> Baseline:
    """Run all killers once: which test reaches which line, and what none reaches."""
    halves = [fork(partial(_measure, files)) for files in (KILLERS[:-1], KILLERS[-1:])]
    first, second = [gathered(*half) for half in halves]
    return Baseline(
        first.seconds | second.seconds,
        {
            module: {
                line: [*first.reached[module].get(line, ()), *second.reached[module].get(line, ())]
                for line in first.reached[module].keys() | second.reached[module].keys()
            }
            for module in first.reached
        },
        [place for place in first.missing if place in set(second.missing)],
        first.failed or second.failed,
    )


def _measure(files: Sequence[str]) -> Baseline:
    core = root() / "fsai_vcu" / "core"
    files_covered = sorted(
        path for part in COVERED for path in core.glob(part) if path.suffix == ".py" and path.stem != "__init__"
    )
    measured = coverage.Coverage(
        data_file=None, branch=True, include=[str(path) for path in files_covered], config_file=False
    )
    measured.set_option("run:core", "ctrace")  # the only one that knows whose lines they are
    measured.set_option("report:exclude_lines", [])  # no comment switches a line off
    measured.set_option("report:partial_branches", [])
    timed = _Timed(measured)
    measured.start()
    for file in files_covered:  # so that one that no test imports is seen to be missing
        importlib.import_module(".".join(file.relative_to(root()).with_suffix("").parts))
    status = pytest.main(_arguments(files), plugins=[timed])
    measured.stop()
    found = Baseline(seconds=timed.seconds, failed=timed.failed)
    if status and not found.failed:
        found.failed = f"pytest ends with {status}"
    data = measured.get_data()
    for name in MODULES:
        lines = data.contexts_by_lineno(str(path_of(PACKAGE + name)))
        found.reached[PACKAGE + name] = {line: [test for test in tests if test] for line, tests in lines.items()}
    with tempfile.NamedTemporaryFile("r") as report:
        measured.json_report(outfile=report.name)
        told = json.load(report)["files"]
    for file in files_covered:
        where = str(file.relative_to(root()))
        one = told[where]
        found.missing += [f"{where}, line {line}: no test reaches it" for line in one["missing_lines"]]
        found.missing += [
            f"{where}, line {line}: no test goes from here to {_end(end)}" for line, end in one["missing_branches"]
        ]
    return found


def _end(line: int) -> str:
    return f"line {line}" if line > 0 else "the function's end"


def sources() -> dict[str, str]:
    """Module -> its text now: what is edited while trials run does not reach them."""
    return {PACKAGE + name: path_of(PACKAGE + name).read_text() for name in MODULES}


def mutants(texts: Mapping[str, str]) -> list[Mutant]:
    """In a child (the modules are imported): all mutants."""
    return [
        mutant
        for module, text in texts.items()
        for mutant in mutants_of(module, text, vars(importlib.import_module(module)))
    ]


# ---------------------------------------------------------------- one mutant


class _Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the mutated source in place of the module."""

    def __init__(self, mutant: Mutant, text: str) -> None:
        self._mutant = mutant
        self._path = str(path_of(mutant.module))
        self._code: CodeType = compile(mutated(text, mutant), self._path, "exec")

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._mutant.module:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=self._path)

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self._path
        exec(self._code, module.__dict__)


class _Failures:
    """Remembers the first test that fails."""

    def __init__(self) -> None:
        self.killer = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.killer:
            self.killer = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.killer:
            self.killer = f"{report.nodeid} (on import)"


class _Chosen(_Failures):
    """Runs the chosen tests in their order."""

    def __init__(self, tests: Sequence[str]) -> None:
        super().__init__()
        self._order = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self._order), key=lambda item: self._order[item.nodeid]
        )


def imported(mutant: Mutant, text: str, tests: Sequence[str]) -> Verdict:
    """In a child that has not imported the module: everything that leans on it is imported with the mistake in it."""
    began = time.process_time()
    sys.meta_path.insert(0, _Mutated(mutant, text))
    chosen = _Chosen(tests)
    # File by file: most mutants fall to the first, and the others need not be imported.
    for file in dict.fromkeys(test.partition("::")[0] for test in tests):
        status = pytest.main(_arguments([Path(file).name]), plugins=[chosen])
        if status:
            killer = chosen.killer or f"pytest ends with {status} on {file}"
            return Verdict(KILLED, killer, time.process_time() - began)
    return Verdict(SURVIVED, cpu_s=time.process_time() - began)


def called(mutant: Mutant, text: str, tests: Sequence[pytest.Item], failures: _Failures) -> Verdict:
    """In a child that has collected the tests: the function gets the code with the mistake in it."""
    began = time.process_time()
    function = _function(sys.modules[mutant.module], mutant.where)
    function.__code__ = _code_of(compile(mutated(text, mutant), function.__code__.co_filename, "exec"), mutant.where)
    for item in tests:
        item.ihook.pytest_runtest_protocol(item=item, nextitem=None)
        if failures.killer:
            return Verdict(KILLED, failures.killer, time.process_time() - began)
    return Verdict(SURVIVED, cpu_s=time.process_time() - began)


def _function(module: ModuleType, where: str) -> FunctionType:
    found: Any = module
    for name in where.split("."):
        found = vars(found)[name]
    if isinstance(found, property):
        found = found.fget
    assert isinstance(found, FunctionType), where
    return found


def _code_of(module: CodeType, where: str) -> CodeType:
    code = module
    for name in where.split("."):
        code = next(part for part in code.co_consts if isinstance(part, CodeType) and part.co_name == name)
    return code


def candidates(baseline: Baseline, mutant: Mutant, hint: str = "") -> list[str]:
    """The tests that reach the mutant: the one that killed it last time, its own module's, then the quickest first."""
    own = f"{mutant.module.rpartition('.')[2]}.py"
    if mutant.at_import:
        tests = set(baseline.seconds)
    else:
        lines = baseline.reached[mutant.module]
        first, last = mutant.lines
        tests = {test for line in range(first, last + 1) for test in lines.get(line, ())}

    def place(test: str) -> tuple[bool, bool, float, str]:
        return test != hint, not test.partition("::")[0].endswith(own), baseline.seconds[test], test

    return sorted(tests, key=place)


Report = Callable[[Mutant, Verdict], None]
_Trial = tuple[Mutant, float, Callable[[], Verdict]]  # the mutant, the CPU time it may take, and the trial of it


def try_all(
    baseline: Baseline,
    texts: Mapping[str, str],
    tried: Sequence[Mutant],
    hints: Mapping[tuple[str, str, str, int], str],
    jobs: int,
    report: Report,
) -> None:
    """Every mutant's verdict is reported as it comes in, of `jobs` mutants at a time.

    What acts on import comes first: after that this process has imported the code itself.
    """
    tests = {mutant: candidates(baseline, mutant, hints.get(mutant.key, "")) for mutant in tried}
    for mutant in tried:
        if not tests[mutant]:
            report(mutant, Verdict(UNREACHED))

    def allowed_s(mutant: Mutant) -> float:
        return _LEAST_CPU_S + 5.0 * sum(baseline.seconds[test] for test in tests[mutant])

    _pool(
        [
            (mutant, allowed_s(mutant), partial(imported, mutant, texts[mutant.module], tests[mutant]))
            for mutant in tried
            if mutant.at_import and tests[mutant]
        ],
        jobs,
        report,
    )

    def session(items: Mapping[str, pytest.Item], failures: _Failures) -> None:
        _pool(
            [
                (
                    mutant,
                    allowed_s(mutant),
                    partial(called, mutant, texts[mutant.module], [items[test] for test in tests[mutant]], failures),
                )
                for mutant in tried
                if not mutant.at_import and tests[mutant]
            ],
            jobs,
            report,
        )

    _in_session(session)


class _Session(_Failures):
    """A pytest session that does something else with the tests it has collected than to run them."""

    def __init__(self, work: Callable[[Mapping[str, pytest.Item], _Failures], None]) -> None:
        super().__init__()
        self._work = work
        self.problem: BaseException | None = None

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        gc.collect()
        gc.freeze()
        try:
            self._work({item.nodeid: item for item in session.items}, self)
        except BaseException as problem:  # pytest would only tell it to its terminal, which is off
            self.problem = problem
        return True


def _in_session(work: Callable[[Mapping[str, pytest.Item], _Failures], None]) -> None:
    session = _Session(work)
    status = pytest.main([*_arguments(KILLERS), "-s", "-p", "no:terminal"], plugins=[session])
    if session.problem is not None:
        raise session.problem
    if status:
        raise RuntimeError(f"pytest ends with {status}: {session.killer}")


def _pool(trials: Sequence[_Trial], jobs: int, report: Report) -> None:
    waiting = list(reversed(trials))
    running: dict[int, tuple[int, Mutant]] = {}
    with selectors.DefaultSelector() as arrivals:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    mutant, cpu_s, trial = waiting.pop()
                    pid, out = fork(trial, cpu_s)
                    running[out] = pid, mutant
                    arrivals.register(out, selectors.EVENT_READ)
                for key, _ in arrivals.select():
                    out = key.fd
                    arrivals.unregister(out)
                    pid, mutant = running.pop(out)
                    with os.fdopen(out, "rb") as pipe:
                        data = pipe.read()
                    os.waitpid(pid, 0)
                    report(mutant, _verdict(data))
        finally:
            for out, (pid, _) in running.items():
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                os.close(out)


def _verdict(data: bytes) -> Verdict:
    if not data:  # the CPU time is up, or the memory
        return Verdict(TIMED_OUT)
    result = pickle.loads(data)
    if isinstance(result, Verdict):
        return result
    raise RuntimeError(f"a trial failed by itself: {result!r}")
