"""The same campaign on a Dask cluster: every worker of it drives cases, and keeps its own snapshots.

The workers need this package in the same version, and are asked for it; nothing else is sent to them than numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

from fsai_hil.evidence.campaign.runner import AHEAD, CampaignPlan, Task, drive_batch
from fsai_hil.evidence.campaign.sources import digest

CONNECT_TIMEOUT_S = 15.0


class ClusterError(Exception):
    """No cluster; the message is one clear line."""


def on_cluster(address: str, plan: CampaignPlan, work: Sequence[Sequence[Task]]) -> Iterator[list[dict[str, Any]]]:
    """Drive batches on the Dask cluster at `address` (of its scheduler); yields their lines as they come.

    Raises ClusterError where there is no Dask, or no cluster, or one of other sources.
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
        waiting = list(reversed(work))
        # pure=False: a batch that fails on one worker must not be taken from a cache
        first = [
            client.submit(drive_batch, plan, waiting.pop(), pure=False) for _ in range(min(len(work), threads * AHEAD))
        ]
        results = distributed.as_completed(first, loop=client.loop)
        for future in results:
            yield future.result()
            if waiting:
                results.add(client.submit(drive_batch, plan, waiting.pop(), pure=False))
