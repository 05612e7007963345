"""Spreads the cases of a campaign over processes, or over a Dask cluster, and collects their lines.

A worker is given numbers and gives back lines of the record; which worker drives which case changes nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from typing import Any, Final

from fsai_hil.evidence import work
from fsai_hil.evidence.campaign.cases import CampaignPlan, Task
from fsai_hil.evidence.campaign.scenario import Snapshots, run_case
from fsai_hil.evidence.work import Header, digest

KIND: Final = "campaign"  # of record
BATCH: Final = 4  # cases handed over at once: few, so that little is lost when a campaign is ended
CONNECT_TIMEOUT_S: Final = 15.0  # to a cluster

Lines = Iterator[list[dict[str, Any]]]


def header_of(plan: CampaignPlan) -> Header:
    kinds = plan.kinds()
    return {
        KIND: 1,
        "seed": plan.seed,
        "faults": [kind.name for kind in kinds],
        "missions": [ami.name.lower() for ami in plan.missions],
        "revisions": list(plan.revisions),
        "world_seeds": plan.world_seeds,
        "window_ms": plan.window_ms,
        "catalogue": len(kinds),
        "sources": digest(),
    }


SNAPSHOTS: Final = Snapshots()
"""The snapshots of this process, kept between batches."""


def drive_batch(plan: CampaignPlan, tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """The lines of some cases."""
    lines = []
    for full, index in tasks:
        case = plan.case(index, full=full)
        began = time.monotonic()
        line = run_case(case, SNAPSHOTS, plan.window_ms)
        line["wall_s"] = round(time.monotonic() - began, 3)
        lines.append(line)
    return lines


def batches(plan: CampaignPlan, tasks: Iterable[Task]) -> list[list[Task]]:
    """Tasks in the order in which a worker uses few different snapshots at a time, in batches."""

    def place(task: Task) -> tuple[object, ...]:
        full, index = task
        case = plan.case(index, full=full)
        return (not full, *case.world, case.leg_ms or 0, index)

    ordered = sorted(tasks, key=place)
    return [ordered[at : at + BATCH] for at in range(0, len(ordered), BATCH)]


class ClusterError(ValueError):
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
        here = header_of(plan)["sources"]
        for worker, there in client.run(digest).items():
            if there != here:
                raise ClusterError(f"the Dask worker {worker} has other sources ({there}, here are {here})")
        # pure=False: a batch that fails on one worker must not be taken from a cache
        pool = client.get_executor(pure=False)
        yield from work.handed_over(pool, partial(drive_batch, plan), batches(plan, tasks), threads * work.AHEAD)
