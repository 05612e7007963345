"""The interface revisions in use, as a table. A new revision is a DBC file and one entry here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple


class Revision(NamedTuple):
    """One revision of the car's CAN interface.

    `dbc_files` are names in the project's DBC folder; `steer_limit_deg` is the most that STEER_REQUEST may ask for,
    to either side (the live ANGLE_MAX may be lower).
    """

    name: str
    dbc_files: tuple[str, ...]
    steer_limit_deg: float
    source: str = ""


REVISIONS: Mapping[str, Revision] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            Revision("2021", ("ads_dv_2021.dbc", "pcan_gps.dbc"), 21.0, "interface specification v4.0, June 2021"),
            Revision("2026", ("ads_dv_2026.dbc", "pcan_gps.dbc"), 30.0, "signal databases of April to June 2026"),
        )
    }
)


def revision(name: str) -> Revision:
    """The revision called `name`; ValueError names the valid ones."""
    try:
        return REVISIONS[name]
    except KeyError:
        raise ValueError(f"unknown interface revision {name!r}: choose one of {', '.join(REVISIONS)}") from None


def dbc_dir() -> Path:
    """The folder with the project's DBC files: inside the installed package, else in the checkout."""
    packaged = Path(__file__).parent / "dbc"
    return packaged if packaged.is_dir() else Path(__file__).parents[2] / "dbc"
