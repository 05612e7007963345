"""The conditions under which the response time is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.errors import WrongUse


class Load(Enum):
    """The work that the machine and the bus have to do besides."""

    PROCESSORS = "every processor busy at normal priority"
    DISK = "the disk written to without a pause"
    BUS = "the bus filled to 500 kbit/s"
    MEMORY = "a neighbour that takes, touches and gives back most of the free memory"
    PIT_WALL = "a pit wall on the bus, with ten viewers"
    PIT_WALL_ROS = "a pit wall on the bus and, by --ros, on the nodes, with ten viewers"


@dataclass(frozen=True, slots=True)
class LoadCondition:
    """One row of the report."""

    name: str
    car: AsState  # how far it has come; in AS_OFF the bridge is alone, without the nodes that drive
    load: tuple[Load, ...] = ()

    @property
    def words(self) -> str:
        load = "all of it at once" if self.load == _ALL else ", ".join(each.value for each in self.load)
        return _CAR[self.car] + (f"; {load}" if load else "")


_CAR = {
    AsState.AS_OFF: "the bridge alone, car in AS_OFF",
    AsState.AS_READY: "all nodes, car waiting for Go in AS_READY",
    AsState.AS_DRIVING: "all nodes, car driving laps",
}
_ALL = (Load.PROCESSORS, Load.DISK, Load.BUS, Load.MEMORY)
_LOADS: dict[str, tuple[Load, ...]] = {
    "": (),
    "-busy": (Load.PROCESSORS,),
    "-disk": (Load.DISK,),
    "-full-bus": (Load.BUS,),
    "-memory": (Load.MEMORY,),
    "-loaded": _ALL,
}
_WATCHED: dict[str, tuple[Load, ...]] = {"-pitwall": (Load.PIT_WALL,), "-pitwall-ros": (Load.PIT_WALL_ROS,)}

CONDITIONS: tuple[LoadCondition, ...] = (
    *(LoadCondition(f"idle{name}", AsState.AS_OFF, load) for name, load in (_LOADS | _WATCHED).items()),
    LoadCondition("standing", AsState.AS_READY),
    *(LoadCondition(f"driving{name}", AsState.AS_DRIVING, load) for name, load in _LOADS.items()),
)
BY_NAME = {condition.name: condition for condition in CONDITIONS}
SHORT = ("idle", "idle-loaded")  # what needs no drive


def conditions_named(names: Sequence[str]) -> tuple[LoadCondition, ...]:
    """Return the named conditions in the table's order, in which the car never goes back to an earlier state.

    Raises WrongUse for an unknown name, or none.
    """
    unknown = [name for name in names if name not in BY_NAME]
    if unknown or not names:
        what = f"'{unknown[0]}'" if unknown else "to measure"
        raise WrongUse(f"no condition {what}: choose from {', '.join(BY_NAME)}")
    return tuple(condition for condition in CONDITIONS if condition.name in names)
