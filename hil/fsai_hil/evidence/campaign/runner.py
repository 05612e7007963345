"""Spreads the cases of a campaign over processes, or over a Dask cluster, and collects their lines.

A worker is given numbers and gives back lines of the record; which worker drives which case changes nothing.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Final

from fsai_hil.evidence.campaign.cases import Selection, case_of
from fsai_hil.evidence.campaign.record import Header, Writer, digest
from fsai_hil.evidence.campaign.scenario import WINDOW_MS, Snapshots, run_case

BATCH: Final = 4  # cases handed over at once: few, so that little is lost when a campaign is ended
AHEAD: Final = 3  # batches waiting per worker
CONNECT_TIMEOUT_S: Final = 15.0  # to a cluster
PRIORITY: Final = 10  # a campaign gives way to everything else on the machine

PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h

Task = tuple[bool, int]  # full-length or not, and the case's number


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """What a campaign consists of."""

    seed: int
    runs: int
    full: int = 0
    selection: Selection = field(default_factory=Selection)
    window_ms: int = WINDOW_MS

    def tasks(self) -> list[Task]:
        """Full-length runs first: the longest ones must not be left to the end."""
        return [(True, index) for index in range(self.full)] + [(False, index) for index in range(self.runs)]

    def header(self) -> Header:
        selection = self.selection
        kinds = selection.kinds()
        return Header(
            self.seed,
            tuple(kind.name for kind in kinds),
            tuple(ami.name.lower() for ami in selection.missions),
            selection.revisions,
            selection.world_seeds,
            self.window_ms,
            len(kinds),
            digest(),
        )


_snapshots: Snapshots | None = None


def _begin_worker(parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who spreads the work
    # A worker waits for work on a pipe of which it holds both ends: it would outlive a campaign that is killed.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        os._exit(1)
    os.nice(PRIORITY)


def drive_batch(plan: CampaignPlan, tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """The lines of some cases. Each process keeps its snapshots between batches."""
    global _snapshots
    if _snapshots is None:
        _snapshots = Snapshots()
    lines = []
    for full, index in tasks:
        case = case_of(plan.seed, index, plan.selection, full=full)
        began = time.monotonic()
        line = run_case(case, _snapshots, plan.window_ms)
        line["wall_s"] = round(time.monotonic() - began, 3)
        lines.append(line)
    return lines


def batches(plan: CampaignPlan, tasks: Iterable[Task]) -> list[list[Task]]:
    """Tasks in the order in which a worker uses few different snapshots at a time, in batches."""

    def place(task: Task) -> tuple[object, ...]:
        full, index = task
        case = case_of(plan.seed, index, plan.selection, full=full)
        key = (case.mission, case.revision, case.seed, case.kind.gps, case.leg_ms or 0)
        return (not full, *key, index)

    ordered = sorted(tasks, key=place)
    return [ordered[at : at + BATCH] for at in range(0, len(ordered), BATCH)]


def _spread(
    pool: Executor, plan: CampaignPlan, work: Sequence[Sequence[Task]], at_once: int
) -> Iterator[list[dict[str, Any]]]:
    waiting = list(reversed(work))
    under_way: set[Future[list[dict[str, Any]]]] = set()
    while waiting or under_way:
        while waiting and len(under_way) < at_once:
            under_way.add(pool.submit(drive_batch, plan, waiting.pop()))
        done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


def in_processes(plan: CampaignPlan, work: Sequence[Sequence[Task]], jobs: int) -> Iterator[list[dict[str, Any]]]:
    """Drive batches in `jobs` processes of this machine; yields their lines as they come."""
    if jobs == 1:
        for tasks in work:
            yield drive_batch(plan, tasks)
        return
    # Forked workers share what is imported already, and a test's seeded defects.
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker, initargs=(os.getpid(),))
    try:
        yield from _spread(pool, plan, work, jobs * AHEAD)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    pool.shutdown()


class ClusterError(Exception):
    """No cluster; the message is one clear line."""


def on_cluster(plan: CampaignPlan, work: Sequence[Sequence[Task]], address: str) -> Iterator[list[dict[str, Any]]]:
    """Drive batches on the Dask cluster at `address` (of its scheduler); yields their lines as they come.

    Its workers need this package in the same version, and are asked for it; they are sent numbers only. Raises
    ClusterError where there is no Dask, or no cluster, or one of other sources.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise ClusterError("--dask needs Dask: pip install 'fsai-vcu[dask]'") from error
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ClusterError(f"no Dask scheduler answers at {address}: {said}") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise ClusterError(f"the Dask scheduler at {address} has no workers")
        here = plan.header().sources
        for worker, there in client.run(digest).items():
            if there != here:
                raise ClusterError(f"the Dask worker {worker} has other sources ({there}, here are {here})")
        # pure=False: a batch that fails on one worker must not be taken from a cache
        yield from _spread(client.get_executor(pure=False), plan, work, threads * AHEAD)


@dataclass(slots=True)
class Pace:
    """How fast it goes, and how long it will take."""

    total: int
    done: int = 0
    worse: int = 0
    began_s: float = field(default_factory=time.monotonic)

    @property
    def runs_per_s(self) -> float:
        return self.done / max(1e-9, time.monotonic() - self.began_s)

    def __str__(self) -> str:
        rate = self.runs_per_s
        left_s = (self.total - self.done) / rate if rate else 0.0
        minutes, seconds = divmod(round(left_s), 60)
        hours, minutes = divmod(minutes, 60)
        return (
            f"{self.done} of {self.total} runs, {rate:.2f} runs/s, {hours}:{minutes:02d}:{seconds:02d} left,"
            f" {self.worse} worse than the rules allow"
        )


def campaign(
    plan: CampaignPlan,
    writer: Writer,
    spread: Callable[[CampaignPlan, Sequence[Sequence[Task]]], Iterator[list[dict[str, Any]]]],
    progress: Callable[[Pace, Sequence[dict[str, Any]]], None] | None = None,
) -> None:
    """Drive what the record does not hold yet. `spread` is where: `in_processes`, or a cluster."""
    done = writer.done
    tasks = [task for task in plan.tasks() if task not in done]
    pace = Pace(len(tasks))
    for lines in spread(plan, batches(plan, tasks)):
        for line in lines:
            writer.add(line)
            pace.done += 1
            pace.worse += line["verdict"] != "ok"
        if progress is not None:
            progress(pace, lines)
