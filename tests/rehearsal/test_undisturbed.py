"""A failure while the machine stood still is run again, and reported; one on a machine that ran is never repeated."""

from __future__ import annotations

import os
import signal
import textwrap
import time
from pathlib import Path

import pytest

from fsai_hil.rehearsal.demo import rehearse
from fsai_hil.rehearsal.stack import StackError
from fsai_hil.rehearsal.stall_monitor import BUSY_NS, NOTED_NS, RUNS, StallMonitor
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS

pytest_plugins = ["pytester"]

PLUGIN = """
import pathlib, pytest
from undisturbed import Undisturbed

SCRIPT = {script!r}  # of each failed run: whether the machine stood still in it

class Scripted:
    def __init__(self):
        self.left = list(SCRIPT)
        self.time_ns = 0
    def clock(self):
        self.time_ns += 1000
        return self.time_ns
    def disturbed(self, since_ns):
        assert since_ns == self.time_ns, "it asks about this run"
        return "stood still for 52 ms" if self.left.pop(0) else ""

def pytest_configure(config):
    monitor = Scripted()
    config.pluginmanager.register(Undisturbed(monitor, monitor.clock))

def note(word):
    with pathlib.Path("notes").open("a") as notes:
        print(word, file=notes)

@pytest.fixture(scope="module")
def shared():
    note("up")
    yield []
    note("down")
"""


def run(pytester: pytest.Pytester, script: list[bool], tests: str) -> tuple[pytest.RunResult, list[str]]:
    """The result of the tests under a stall monitor that answers by the script, and what the tests noted."""
    pytester.syspathinsert()
    pytester.syspathinsert(Path(__file__).parents[1] / "hil")
    pytester._monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # others' plugins cost a second each time
    pytester.makepyfile(scripted=PLUGIN.format(script=script))
    pytester.makepyfile("from scripted import note\n" + textwrap.dedent(tests))
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-p", "scripted")
    return result, Path(pytester.path / "notes").read_text().split()


FAILS_TWICE = """
    def test_it(shared):
        note("run")
        assert open("notes").read().split().count("run") > 2
"""


def test_a_failure_on_a_machine_that_ran_is_never_repeated(pytester: pytest.Pytester) -> None:
    result, notes = run(pytester, [False], FAILS_TWICE)
    result.assert_outcomes(failed=1)
    assert notes == ["up", "run", "down"]
    assert "stood still" not in result.stdout.str()


def test_a_failure_in_a_stall_is_reported_and_run_again_afresh(pytester: pytest.Pytester) -> None:
    result, notes = run(pytester, [True, True], FAILS_TWICE)
    result.assert_outcomes(passed=1)
    assert notes == ["up", "run", "down"] * 3
    printed = [line for line in result.stdout.lines if "stood still" in line]
    assert printed == [f"test_it: the machine stood still for 52 ms: run {number} shows nothing" for number in (1, 2)]


def test_a_test_that_never_ran_undisturbed_fails_and_says_so(pytester: pytest.Pytester) -> None:
    result, notes = run(pytester, [True] * RUNS, "def test_it(): note('run'); assert False")
    result.assert_outcomes(failed=1)
    assert notes == ["run"] * RUNS
    result.stdout.fnmatch_lines(["*the machine stood still for 52 ms: run 3 of 3 too: never undisturbed"])


def test_disturbed_setups_and_teardowns_are_run_again_too(pytester: pytest.Pytester) -> None:
    tests = """
        import pathlib, pytest

        @pytest.fixture(params=["setup", "teardown"])
        def fragile(request):
            mark = pathlib.Path(request.param)
            first = not mark.exists()
            mark.touch()
            assert not first or request.param != "setup"
            yield
            assert not first or request.param != "teardown"

        def test_it(shared, fragile):
            note("run")
    """
    result, notes = run(pytester, [True, True], tests)
    result.assert_outcomes(passed=2)
    assert notes == ["up", "down", "up", "run", "run", "down", "up", "run", "down"]


def noted(path: Path, *notes: str) -> StallMonitor:
    """A stall monitor whose notes are there, and begin with these, and whose process is not started."""
    monitor = object.__new__(StallMonitor)
    monitor._path = path
    if notes:
        path.write_text("\n".join(["it watches", *notes, "12345 9999"]))  # the last is just being written
    return monitor


def test_only_long_stalls_within_the_asked_time_are_reported(tmp_path: Path) -> None:
    long = NOTED_NS
    times = ((0, long), (long, 2 * long), (3 * long, 4 * long - 1), (5 * long, 7 * long))
    monitor = noted(tmp_path / "notes", *(f"{began} {ended}" for began, ended in times))
    assert monitor.stalls_ns(2 * long) == [long, 2 * long]
    assert monitor.stalls_ns(2 * long, 0) == [long, long - 1, 2 * long]
    assert monitor.disturbed(7 * long + 1) == ""


def test_stalls_are_described_by_the_longest(tmp_path: Path) -> None:
    monitor = noted(tmp_path / "notes", f"{1000 * MS} {1052 * MS}", f"0 {90 * MS}")
    assert monitor.disturbed(0) == "stood still for 90 ms (the longest of 2 times)"
    assert monitor.disturbed(1000 * MS) == "stood still for 52 ms"


def test_the_monitor_notes_that_it_was_itself_held_up(tmp_path: Path) -> None:
    with StallMonitor(tmp_path / "notes") as monitor:
        since_ns = time.monotonic_ns()
        os.kill(monitor._process.pid, signal.SIGSTOP)
        held_s = 0.2
        time.sleep(held_s)  # the very thing that is measured
        os.kill(monitor._process.pid, signal.SIGCONT)
        until = time.monotonic() + 10.0
        # A busy machine may have had another, shorter stall before.
        while max(seen := monitor.stalls_ns(since_ns), default=0) < held_s * 1e9 * 0.9 and time.monotonic() < until:
            time.sleep(0.01)
    assert max(seen) >= held_s * 1e9 * 0.9
    assert monitor._process.returncode is not None, "it has been ended"


@pytest.mark.parametrize(
    ("runs", "status", "printed"),
    [
        ([(0, True)], 0, []),
        ([(1, False)], 1, []),
        ([(None, False)], 1, []),
        ([(1, True), (0, False)], 0, ["stood still for 52 ms"]),
        ([(None, True), (0, True)], 0, ["stood still for 52 ms"]),
        ([(1, True), (1, False)], 1, ["stood still for 52 ms"]),
        ([(1, True), (1, True)], 1, ["stood still for 52 ms", "this time too"]),
    ],
)
def test_the_demo_drives_again_only_after_a_failure_in_a_stall(
    runs: list[tuple[int | None, bool]],
    status: int,
    printed: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    left = list(runs)
    disturbed = False

    def drive() -> int:
        nonlocal disturbed
        result, disturbed = left.pop(0)
        if result is None:
            raise StackError("a process ended")
        return result

    monkeypatch.setattr(StallMonitor, "disturbed", lambda *_: "stood still for 52 ms" if disturbed else "")
    assert rehearse(drive, tmp_path) == status
    assert left == []
    lines = [line for line in capsys.readouterr().out.splitlines() if "stood still" in line]
    assert len(lines) == len(printed) and all(words in line for words, line in zip(printed, lines, strict=True))


def test_a_busy_computer_leaves_half_of_the_cars_time_at_most() -> None:
    """The monitor's processes load the standard library alone, so that the number stands there once more."""
    assert BUSY_NS == COMMS_LOST_NS // 2
