"""The power of the car: it comes alive and goes to sleep by revision, with its tractive system and EBS.

The two subsystems are small machines over time: given what they need, they take a couple of seconds for each step.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Final

from fsai_vcu.interface.enums import AsState, EbsState, EbsStatus, TsState
from fsai_vcu.interface.units import MS
from fsai_vcu.interface.values import Value


class SystemState(IntEnum):
    """SM_SYS of 0x120 (2021), as far as this car goes through it."""

    INITIAL_ACTIONS = 0
    POWER_ON_SELF_TEST = 1
    AUX = 2
    POWERTRAIN_ENABLE = 3
    DRIVE_AUTONOMOUS = 4
    SHUTDOWN = 7
    SHUTDOWN_OFF = 8


class SystemAction(IntEnum):
    """SYS_ACTION_STATE of 0x120 (2021), as far as this car needs it."""

    INITIALISE = 0
    DRIVE_AUTO = 2
    SHUTDOWN = 4


class PowerUp(Value, frozen=True):
    """The differences between the cars of two interface revisions while they are switched on and off."""

    first_state: AsState
    switches_on: tuple[str, ...]  # fields of Switches in the order of power-up; AIMS, if any, feeds the AI computer
    switches_off: tuple[str, ...]  # after a mission; with LVMS among them only a power cycle leads to the next one
    sends_op_states: bool  # OP_STATE, TS_STATE and EBS_STATE in 0x520


# a new interface revision is one more entry
POWER_UP: Final[Mapping[str, PowerUp]] = MappingProxyType(
    {
        "2021": PowerUp(
            first_state=AsState.AS_OFF,
            switches_on=("aims", "asms", "tsms", "lvms"),
            switches_off=("asms",),
            sends_op_states=False,
        ),
        "2026": PowerUp(
            first_state=AsState.AS_INIT,
            switches_on=("lvms", "asms", "tsms"),
            switches_off=("asms", "tsms", "lvms"),
            sends_op_states=True,
        ),
    }
)

# How long the steps take was never published: a couple of seconds in all.
INITIAL_ACTIONS_NS: Final = 300 * MS
SELF_TEST_NS: Final = 500 * MS
PRECHARGE_NS: Final = 1500 * MS
ACTIVATE_NS: Final = 500 * MS
EBS_INIT_NS: Final = 500 * MS
EBS_CHARGING_NS: Final = 2000 * MS
EBS_DISCHARGING_NS: Final = 1000 * MS
SHUTDOWN_NS: Final = 2000 * MS


Step = tuple[bool, tuple[Any, ...], Any, int]  # while it is wanted or not, from these states, to that one, after ns


def _by_state(*steps: Step) -> dict[tuple[bool, Any], tuple[Any, int]]:
    return {(wanted, source): (target, after) for wanted, sources, target, after in steps for source in sources}


TS_LIVE: Final = (TsState.TS_PRECHARGE, TsState.TS_ACTIVATE, TsState.TS_RUNNING)
# High voltage: precharge, activation, running; off again at once when it is not wanted
_TRACTIVE_SYSTEM: Final = _by_state(
    (True, (TsState.TS_INIT, TsState.TS_SHUTDOWN, TsState.TS_FAULT), TsState.TS_PRECHARGE, 0),
    (True, (TsState.TS_PRECHARGE,), TsState.TS_ACTIVATE, PRECHARGE_NS),
    (True, (TsState.TS_ACTIVATE,), TsState.TS_RUNNING, ACTIVATE_NS),
    (False, TS_LIVE, TsState.TS_SHUTDOWN, 0),
    (False, (TsState.TS_FAULT,), TsState.TS_INIT, 0),
)
# EBS: init, charging, armed; triggered by an emergency, discharged when it is not wanted any more
_EMERGENCY_BRAKE_SYSTEM: Final = _by_state(
    (True, (EbsState.EBS_INIT,), EbsState.EBS_CHARGING, EBS_INIT_NS),
    (True, (EbsState.EBS_CHARGING,), EbsState.EBS_ARMED, EBS_CHARGING_NS),
    (True, (EbsState.EBS_DISCHARGING, EbsState.EBS_TRIGGERED, EbsState.EBS_FAULT), EbsState.EBS_INIT, 0),
    (False, (EbsState.EBS_CHARGING, EbsState.EBS_ARMED, EbsState.EBS_TRIGGERED), EbsState.EBS_DISCHARGING, 0),
    (False, (EbsState.EBS_DISCHARGING,), EbsState.EBS_INIT, EBS_DISCHARGING_NS),
    (False, (EbsState.EBS_FAULT,), EbsState.EBS_INIT, 0),
)


class Subsystem:
    """A small machine over time that takes one step at a look."""

    STEPS: Final = {TsState: _TRACTIVE_SYSTEM, EbsState: _EMERGENCY_BRAKE_SYSTEM}

    def __init__(self, first: TsState | EbsState, now_ns: int) -> None:
        self.state: Any = first
        self._steps = self.STEPS[type(first)]
        self._since_ns = now_ns
        self._wanted = False

    def update(self, now_ns: int, wanted: bool, forced: TsState | EbsState | None = None) -> None:
        """A `forced` state is entered at once."""
        began, self._wanted = wanted and not self._wanted, wanted
        if forced is not None:
            if forced is not self.state:
                self.state, self._since_ns = forced, now_ns
            return
        if began:
            self._since_ns = now_ns
        step = self._steps.get((wanted, self.state))
        if step is not None and now_ns - self._since_ns >= step[1]:
            self.state, self._since_ns = step[0], now_ns


# STATUS_EBS of 0x524, which knows fewer states
EBS_STATUS: Final = {EbsState.EBS_ARMED: EbsStatus.ARMED, EbsState.EBS_TRIGGERED: EbsStatus.TRIGGERED}
