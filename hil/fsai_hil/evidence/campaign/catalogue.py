"""Every kind of fault, one row each: what it does, what is drawn by chance, where it applies, what must follow.

How a run must end depends on what was drawn, because the safety rules grade their reactions by time. Durations lie in
bands clear of those times: what happens exactly at a limit is for the exhaustive search, which knows no jitter.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from fsai_hil.evidence.campaign.faults import car, computer, wire
from fsai_hil.evidence.campaign.faults.kind import FaultKind
from fsai_vcu.interface.errors import did_you_mean

ROWS: Final[tuple[FaultKind, ...]] = (*wire.ROWS, *car.ROWS, *computer.ROWS)
KINDS: Final[Mapping[str, FaultKind]] = MappingProxyType({kind.name: kind for kind in ROWS})


def kind_named(name: str) -> FaultKind:
    """The kind of that name; ValueError for an unknown one."""
    try:
        return KINDS[name]
    except KeyError:
        raise ValueError(
            f"unknown fault {name!r}{did_you_mean(name, KINDS) or f'; --list-faults shows the {len(KINDS)} there are'}"
        ) from None
