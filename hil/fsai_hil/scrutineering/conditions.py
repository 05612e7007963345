"""The conditions under which the response time is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum


class Stance(Enum):
    """How far the car has come."""

    ALONE = "AS_OFF"  # the bridge alone, without the nodes that drive
    STANDING = "AS_READY"
    DRIVING = "AS_DRIVING"


@dataclass(frozen=True, slots=True)
class Condition:
    """One row of the report."""

    name: str
    words: str
    stance: Stance
    processors_busy: bool = False
    disk_busy: bool = False
    bus_full: bool = False


_EVERYTHING = "every processor busy, the disk written to, the bus full"

CONDITIONS: tuple[Condition, ...] = (
    Condition("idle", "the bridge alone, car in AS_OFF", Stance.ALONE),
    Condition("idle-loaded", f"the bridge alone, car in AS_OFF; {_EVERYTHING}", Stance.ALONE, True, True, True),
    Condition("standing", "all nodes, car waiting for Go in AS_READY", Stance.STANDING),
    Condition("driving", "all nodes, car driving laps", Stance.DRIVING),
    Condition("driving-busy", "driving; every processor busy at normal priority", Stance.DRIVING, processors_busy=True),
    Condition("driving-disk", "driving; the disk written to without a pause", Stance.DRIVING, disk_busy=True),
    Condition("driving-full-bus", "driving; the bus filled to 500 kbit/s", Stance.DRIVING, bus_full=True),
    Condition("driving-loaded", f"driving; {_EVERYTHING}", Stance.DRIVING, True, True, True),
)
BY_NAME = {condition.name: condition for condition in CONDITIONS}
SHORT = ("idle", "idle-loaded")  # what needs no drive


def conditions_named(names: Sequence[str]) -> tuple[Condition, ...]:
    """In the order of the table: the car comes on and never goes back. Raises ValueError for an unknown name."""
    for name in names:
        if name not in BY_NAME:
            raise ValueError(f"no condition '{name}': choose from {', '.join(BY_NAME)}")
    if not names:
        raise ValueError(f"no condition to measure: choose from {', '.join(BY_NAME)}")
    return tuple(condition for condition in CONDITIONS if condition.name in names)
