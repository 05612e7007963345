"""The car's messages that end a drive by what they show, or by not coming: a row each; and marks of 0x520.

Written down by the requirement, not by the core. A new condition of a message that is decoded already is a row of
`SHOWN` and nothing else here: the observer remembers since when it is shown, and the search at which ages that matters.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final, NamedTuple

from fsai_hil.rules.numbers import FEEDBACK_LOST_NS, FEEDBACK_STALE_NS
from fsai_vcu.interface.enums import Ami, CarEnum, ShutdownCause
from fsai_vcu.interface.messages import Faults, Image, VcuStatus, VcuSteer


class Shown(NamedTuple):
    """A condition that stops a run once it has been shown for so long, and asks for the emergency brake later.

    It is shown from the first message of its kind in AS_DRIVING that shows it to the first one that does not; without
    `shows` the condition is that no such message comes.
    """

    message: type[Image]
    what: str
    shows: Callable[[Any], bool] | None
    stop_ns: float = math.inf
    alarm_ns: float = math.inf
    supervised: bool = True  # in AS_DRIVING after its first 3 s only

    def since_ns(self, before_ns: int | None, message: Image, t_ns: int) -> int | None:
        """Return since when it is shown, now that a message has come at `t_ns`; or when it came, if it may be missing.

        `before_ns`: what this said before.
        """
        if self.shows is None:
            return t_ns
        return (before_ns or t_ns) if self.shows(message) else None

    @property
    def edges_ns(self) -> tuple[int, ...]:
        """The ages at which it matters since when it is shown."""
        return tuple(int(age) for age in (self.stop_ns, self.alarm_ns) if 0 < age < math.inf)


SHOWN: Final = (
    Shown(VcuStatus, "FAULT_STATUS is 1", lambda status: status.fault, stop_ns=0, supervised=False),
    Shown(VcuSteer, "steering feedback missing", None, FEEDBACK_STALE_NS, FEEDBACK_LOST_NS),
)
"""Conditions with their times, which stand here too, by the names that `BridgeConfig` has for them, in capitals."""


STATES: Final = ("EBS_STATE", "TS_STATE", "OP_STATE")
FAULT_STATE: Final = 15  # of each of them (2026); what no table knows is read as it


def marks_of(status: VcuStatus) -> frozenset[str]:
    """Return what of 0x520 ends a drive by turning up in AS_DRIVING, though FAULT_STATUS stays 0."""
    cause = status.shutdown_cause is not ShutdownCause.NO_SHUTDOWN
    states = status.ebs_state, status.ts_state, status.op_state
    return _marks(status.as_switch, status.ts_switch, status.shutdown_request, status.faults, cause, states, status.ami)


@lru_cache
def _marks(
    as_switch: bool,
    ts_switch: bool,
    shutdown: bool,
    faults: Faults,
    cause: bool,
    states: tuple[CarEnum | None, ...],
    ami: Ami,
) -> frozenset[str]:
    """Return the marks of a 0x520 with these fields by their names; cached, for fields rarely change."""
    shown = {
        f"AMI_STATE becomes {ami.label}": True,
        **{
            f"{name} becomes FAULT": state is not None and state == FAULT_STATE
            for name, state in zip(STATES, states, strict=True)
        },
        "AS_SWITCH_STATUS falls": not as_switch,
        "TS_SWITCH_STATUS falls": not ts_switch,
        "SHUTDOWN_REQUEST rises": shutdown,
        "SHUTDOWN_CAUSE rises": cause,
        **{f"fault bit {name} rises": getattr(faults, name) for name in Faults.__struct_fields__},
    }
    return frozenset(mark for mark, there in shown.items() if there)
