"""The interface revisions in use, as a table. A new revision is a DBC file and one entry here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from fsai_vcu.interface.bus_table import BY_NAME
from fsai_vcu.interface.enums import AsState


class Revision(NamedTuple):
    """One revision of the car's CAN interface.

    `dbc_files` are names in the project's DBC folder; `steer_limit_deg` is the most that STEER_REQUEST may ask for,
    to either side (the live ANGLE_MAX may be lower). `power_cycle_after`: the AS states at the end of a run after which
    the car has to be switched off and on. `says_nothing`: signals whose bits mean nothing, whatever a database names.
    """

    name: str
    dbc_files: tuple[str, ...]
    steer_limit_deg: float
    source: str = ""
    power_cycle_after: frozenset[AsState] = frozenset((AsState.EMERGENCY_BRAKE,))
    says_nothing: frozenset[str] = frozenset()


REVISIONS: Mapping[str, Revision] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            Revision(
                "2021",
                ("ads_dv_2021.dbc", "pcan_gps.dbc"),
                21.0,
                "interface specification v4.0, June 2021",
                says_nothing=frozenset(("OP_STATE", "TS_STATE", "EBS_STATE")),
            ),
            Revision(
                "2026",
                ("ads_dv_2026.dbc", "pcan_gps.dbc"),
                30.0,
                "signal databases of April to June 2026",
                frozenset((AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED)),
            ),
        )
    }
)


def revision(name: str) -> Revision:
    """The revision called `name`; ValueError names the valid ones."""
    try:
        return REVISIONS[name]
    except KeyError:
        raise ValueError(f"unknown interface revision {name!r}: choose one of {', '.join(REVISIONS)}") from None


# Bits of 0x520 that only one revision names: OP_STATE, TS_STATE and EBS_STATE are four bits each (2026).
_STATES_2026: Final = 0xF << 4 | 0xF << 28 | 0xF << 36
_AS_STATE_BIT: Final = 16


def revision_by_status(word: int) -> tuple[str, str] | None:
    """The revision that a payload of 0x520 (eight bytes, as a little-endian number) shows, and the observation.

    None where it may be of either: states of 0 show nothing, the official simulator of 2026 leaves them so.
    """
    if word & _STATES_2026:
        return "2026", "0x520 carries OP_STATE, TS_STATE or EBS_STATE"
    return None


_STATUS: Final = BY_NAME["VCU2AI_Status"]
_SYSTEM: Final = BY_NAME["VCU_STATUS"]
REVISION_IDS: Final = frozenset({_STATUS.can_id, _SYSTEM.can_id})


def revision_by_frame(can_id: int, data: bytes) -> tuple[str, str] | None:
    """Tell the revision as `revision_by_status`, of one frame of the VCU on one of `REVISION_IDS`."""
    if can_id == _STATUS.can_id and len(data) == _STATUS.dlc:
        return revision_by_status(int.from_bytes(data, "little"))
    if can_id == _SYSTEM.can_id and len(data) == _SYSTEM.dlc:
        return "2021", f"{_SYSTEM} is only in 2021"
    return None


# ANGLE_MAX: the second word of 0x523, in tenths of a degree (interface specification v4.0).
_ANGLE_MAX_BIT: Final = 16
_ANGLE_MAX_DEG: Final = 0.1


def revision_by_steer(words: Iterable[int]) -> tuple[str, str] | None:
    """Tell the revision as `revision_by_status`, of all 0x523 (six bytes): one of the two steers further."""
    most_deg = max((word >> _ANGLE_MAX_BIT & 0xFFFF for word in words), default=0) * _ANGLE_MAX_DEG
    if most_deg < REVISIONS["2021"].steer_limit_deg:
        return None
    name = "2026" if most_deg > REVISIONS["2021"].steer_limit_deg else "2021"
    return name, f"ANGLE_MAX is {most_deg:g} deg"


def revision_by_init(words: Iterable[int]) -> tuple[str, str] | None:
    """Tell the revision as `revision_by_status`, of all 0x520: AS_INIT is a state of the later revision alone."""
    if any(word >> _AS_STATE_BIT & 0xF == 0 for word in words):
        return "2026", "AS_STATE is 0 (AS_INIT) at times"
    return None


def dbc_dir() -> Path:
    """The folder with the project's DBC files: inside the installed package, else in the checkout."""
    packaged = Path(__file__).parent / "dbc"
    return packaged if packaged.is_dir() else Path(__file__).resolve().parents[2] / "dbc"
