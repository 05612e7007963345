"""Work spread over processes of this machine, and one line that says how it goes on."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from itertools import islice
from typing import Final, TypeVar

AHEAD: Final = 3  # tasks waiting per worker
NICENESS: Final = 5  # evidence gives way to what else there is to do on the machine
PROGRESS_EVERY_S: Final = 5.0

PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h

T = TypeVar("T")
R = TypeVar("R")


def _begin_worker(parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who spreads the work
    # A worker waits for work on a pipe of which it holds both ends: it would outlive a parent that is killed.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        os._exit(1)
    os.nice(NICENESS)


def handed_over(pool: Executor, work: Callable[[T], R], tasks: Iterable[T], at_once: int) -> Iterator[R]:
    """The result of each task as it comes; tasks are taken when a worker has room for them."""
    waiting = iter(tasks)
    under_way: set[Future[R]] = set()
    while True:
        under_way |= {pool.submit(work, task) for task in islice(waiting, at_once - len(under_way))}
        if not under_way:
            return
        done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


def spread(work: Callable[[T], R], tasks: Iterable[T], jobs: int) -> Iterator[R]:
    """`work` done to each task in `jobs` processes of this machine; results as they come."""
    if jobs == 1:
        yield from map(work, tasks)
        return
    # Forked workers share what is imported already, and a test's seeded defects.
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker, initargs=(os.getpid(),))
    try:
        yield from handed_over(pool, work, tasks, jobs * AHEAD)
    except BaseException:
        workers = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in workers:
            process.terminate()
        raise
    pool.shutdown()


class Progress:
    """One line on stderr that is written over on a terminal, one every few seconds elsewhere."""

    def __init__(self, what: str, total: int | None = None) -> None:
        """`what` is counted; `total`: None where the end is not known."""
        self._what, self._total = what, total
        self._began_s = self._next_s = time.monotonic()
        self._terminal = sys.stderr.isatty()

    def __call__(self, done: int, more: str) -> None:
        """So many are done; `more` is added."""
        now_s = time.monotonic()
        if now_s < self._next_s and done != self._total:
            return
        self._next_s = now_s + (0.2 if self._terminal else PROGRESS_EVERY_S)
        rate = done / max(1e-9, now_s - self._began_s)
        line = f"{done} {self._what}, {rate:.2f} {self._what}/s, {more}"
        if self._total is not None:
            minutes, seconds = divmod(round((self._total - done) / rate if rate else 0.0), 60)
            left = f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d} left"
            line = f"{done} of {self._total} {self._what}, {rate:.2f} {self._what}/s, {left}, {more}"
        self.clear()
        print(line, end="" if self._terminal else "\n", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Make room for another line."""
        if self._terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
