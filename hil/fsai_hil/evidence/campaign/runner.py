"""Spreads the cases of a campaign over processes, or over a Dask cluster, and collects their lines.

A worker is given numbers and gives back lines of the record; which worker drives which case changes nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from typing import Any, Final

from fsai_hil.evidence import work
from fsai_hil.evidence.campaign.cases import Selection, case_of
from fsai_hil.evidence.campaign.record import Header, digest
from fsai_hil.evidence.campaign.scenario import WINDOW_MS, Snapshots, run_case

BATCH: Final = 4  # cases handed over at once: few, so that little is lost when a campaign is ended
CONNECT_TIMEOUT_S: Final = 15.0  # to a cluster

Task = tuple[bool, int]  # full-length or not, and the case's number
Lines = Iterator[list[dict[str, Any]]]


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


def drive_batch(plan: CampaignPlan, tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """The lines of some cases. Each process keeps its snapshots between batches."""
    global _snapshots
    _snapshots = _snapshots or Snapshots()
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


def in_processes(plan: CampaignPlan, tasks: Iterable[Task], jobs: int) -> Lines:
    """Drive cases in `jobs` processes of this machine; yields their lines as they come."""
    return work.spread(partial(drive_batch, plan), batches(plan, tasks), jobs)


class ClusterError(Exception):
    """No cluster; the message is one clear line."""


def on_cluster(plan: CampaignPlan, tasks: Iterable[Task], address: str) -> Lines:
    """Drive cases on the Dask cluster at `address` (of its scheduler); yields their lines as they come.

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
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ClusterError(f"no Dask scheduler answers at {address}: {why}") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise ClusterError(f"the Dask scheduler at {address} has no workers")
        here = plan.header().sources
        for worker, there in client.run(digest).items():
            if there != here:
                raise ClusterError(f"the Dask worker {worker} has other sources ({there}, here are {here})")
        # pure=False: a batch that fails on one worker must not be taken from a cache
        pool = client.get_executor(pure=False)
        yield from work.handed_over(pool, partial(drive_batch, plan), batches(plan, tasks), threads * work.AHEAD)
