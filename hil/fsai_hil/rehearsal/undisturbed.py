"""Tests in real time count only if the machine let them run: a pytest plugin asks the stall monitor at each failure.

A test that fails while the machine stood still or ran far below its speed has shown nothing, neither for nor against
what it tests: that is said, and it is run again from the start, with every fixture made anew. Or it is put off, where
somebody will run it again on a machine with more time for the same deadlines; it is so too if the machine merely had no
time to spare. A failure on an undisturbed machine is a failure, at once. A test that is disturbed in each of its runs
has failed, and says why. No deadline is loosened by any of this.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

from fsai_hil.rehearsal.stall_monitor import RUNS, StallMonitor, describe

PUT_OFF = "put off"  # an outcome beside pytest's own: neither passed nor failed, it goes on the list


class Undisturbed:
    """Runs each test of the session, again if need be.

    clock: the stall monitor's.
    put_off: where the names of disturbed tests are written, one a line, instead of running those again here; beside it,
    with `.txt`, how they failed.
    """

    def __init__(
        self, stall_monitor: StallMonitor, clock: Callable[[], int] = time.monotonic_ns, put_off: Path | None = None
    ) -> None:
        self._stall_monitor = stall_monitor
        self._clock = clock
        self._put_off = put_off

    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str] | None:
        return (PUT_OFF, "P", "PUT OFF") if report.outcome == PUT_OFF else None

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in self._reports(item, nextitem):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _reports(self, item: pytest.Item, nextitem: pytest.Item | None) -> list[pytest.TestReport]:
        """Those of the run that counts, or of the last."""
        for run in range(1, RUNS + 1):
            since_ns = self._clock()
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
            failed = [report for report in reports if report.failed]
            if not failed:
                return reports
            # Whatever it left behind, in fixtures that others share too, is ended: the next run begins anew.
            item.session._setupstate.teardown_exact(None)
            disturbances = list(self._stall_monitor.disturbances(since_ns))
            if self._put_off is not None:
                disturbances += self._stall_monitor.busy_spells(since_ns)
            if not disturbances:
                return reports
            what = f"the machine {describe(disturbances)}"
            if self._put_off is not None:
                self._say(item, f"{item.name}: {what}: put off")
                _put_off(self._put_off, item.nodeid, failed)
                return reports
            if run < RUNS:
                self._say(item, f"{item.name}: {what}: run {run} shows nothing")
        why = f"never ran undisturbed: in run {RUNS} of {RUNS} too {what}"
        self._say(item, f"{item.name}: {why}")
        failed[0].sections.append(("the machine", why))
        return reports

    def _say(self, item: pytest.Item, line: str) -> None:
        terminal = item.config.pluginmanager.get_plugin("terminalreporter")
        if terminal is not None:
            terminal.ensure_newline()
            terminal.write_line(line, yellow=True)


def _put_off(names: Path, nodeid: str, failed: list[pytest.TestReport]) -> None:
    """Put it on the list, and beside the list how it failed; its reports then say neither passed nor failed."""
    with names.open("a") as listed, names.with_suffix(".txt").open("a") as reasons:
        print(nodeid, file=listed)
        for report in failed:
            print(nodeid, report.when, report.longreprtext, sep="\n", file=reasons)
            report.outcome = PUT_OFF  # type: ignore[assignment]
