"""Tests in real time count only if the machine let them run: a pytest plugin asks the stall monitor at each failure.

A test that fails while the machine stood still has shown nothing, neither for nor against what it tests: that is
reported, and it is run again from the start, with every fixture made again. A failure on an undisturbed machine is a
failure, at once. A test that is disturbed in each of its runs has failed, and reports why. No deadline is loosened by
any of this.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from _pytest.runner import runtestprotocol

from fsai_hil.rehearsal.stall_monitor import RUNS, StallMonitor


class Undisturbed:
    """Runs each test of the session, again if need be.

    clock: the stall monitor's.
    """

    def __init__(self, stall_monitor: StallMonitor, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._stall_monitor = stall_monitor
        self._clock = clock

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for run in range(1, RUNS + 1):
            since_ns = self._clock()
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
            failed = [report for report in reports if report.failed]
            if failed:
                # Whatever it left behind, in fixtures that others share too, is ended: the next run begins again.
                item.session._setupstate.teardown_exact(None)
            if not failed or not (what := self._stall_monitor.disturbed(since_ns)):
                break
            then = "shows nothing" if run < RUNS else f"of {RUNS} too: never undisturbed"
            why = f"the machine {what}: run {run} {then}"
            failed[0].sections.append(("the machine", why))
            if terminal := item.config.pluginmanager.get_plugin("terminalreporter"):
                terminal.ensure_newline()
                terminal.write_line(f"{item.name}: {why}", yellow=True)
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True
