"""How the car comes alive and goes to sleep: power-up by revision, tractive system and EBS.

The two subsystems are small machines over time: given what they need, they take a couple of seconds for each step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from fsai_vcu.interface.enums import AsState, EbsState, EbsStatus, TsState
from fsai_vcu.interface.immutable import Immutable
from fsai_vcu.interface.units import MS


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


@dataclass(frozen=True, slots=True)
class PowerUp(Immutable):
    """What differs between the cars of two interface revisions while they are switched on and off."""

    first_state: AsState
    switches_on: tuple[str, ...]  # fields of Switches in the order in which they are switched on
    switches_off: tuple[str, ...]  # after a mission
    power_cycle_after_mission: bool
    ai_master_switch: bool  # AIMS feeds the AI computer
    sends_op_states: bool  # OP_STATE, TS_STATE and EBS_STATE in 0x520
    front_axle_driven: bool


# a new interface revision is one more entry
POWER_UP: Final[Mapping[str, PowerUp]] = MappingProxyType(
    {
        "2021": PowerUp(
            first_state=AsState.AS_OFF,
            switches_on=("aims", "asms", "tsms", "lvms"),
            switches_off=("asms",),
            power_cycle_after_mission=False,
            ai_master_switch=True,
            sends_op_states=False,
            front_axle_driven=True,
        ),
        "2026": PowerUp(
            first_state=AsState.AS_INIT,
            switches_on=("lvms", "asms", "tsms"),
            switches_off=("asms", "tsms", "lvms"),
            power_cycle_after_mission=True,
            ai_master_switch=False,
            sends_op_states=True,
            front_axle_driven=False,
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


class TractiveSystem:
    """High voltage: precharge, activation, running; off again at once when it is not wanted."""

    def __init__(self, now_ns: int) -> None:
        self.state = TsState.TS_INIT
        self._since_ns = now_ns

    def update(self, now_ns: int, wanted: bool, fault: bool) -> None:
        state = self.state
        if fault:
            self._enter(TsState.TS_FAULT, now_ns)
        elif not wanted:
            if self.live:
                self._enter(TsState.TS_SHUTDOWN, now_ns)
            elif state is TsState.TS_FAULT:
                self._enter(TsState.TS_INIT, now_ns)
        elif state is TsState.TS_PRECHARGE:
            if now_ns - self._since_ns >= PRECHARGE_NS:
                self._enter(TsState.TS_ACTIVATE, now_ns)
        elif state is TsState.TS_ACTIVATE:
            if now_ns - self._since_ns >= ACTIVATE_NS:
                self._enter(TsState.TS_RUNNING, now_ns)
        elif state is not TsState.TS_RUNNING:
            self._enter(TsState.TS_PRECHARGE, now_ns)

    def _enter(self, state: TsState, now_ns: int) -> None:
        if state is not self.state:
            self.state = state
            self._since_ns = now_ns

    @property
    def live(self) -> bool:
        return self.state in (TsState.TS_PRECHARGE, TsState.TS_ACTIVATE, TsState.TS_RUNNING)

    @property
    def running(self) -> bool:
        return self.state is TsState.TS_RUNNING


class EmergencyBrakeSystem:
    """EBS: init, charging, armed; triggered by an emergency, discharged when it is not wanted any more."""

    def __init__(self, now_ns: int) -> None:
        self.state = EbsState.EBS_INIT
        self._since_ns: int = now_ns
        self._wanted = False

    def update(self, now_ns: int, wanted: bool, fault: bool, triggered: bool) -> None:
        state = self.state
        if triggered:
            self._enter(EbsState.EBS_TRIGGERED, now_ns)
        elif fault:
            self._enter(EbsState.EBS_FAULT, now_ns)
        elif not wanted:
            if state in (EbsState.EBS_CHARGING, EbsState.EBS_ARMED, EbsState.EBS_TRIGGERED):
                self._enter(EbsState.EBS_DISCHARGING, now_ns)
            elif state is EbsState.EBS_FAULT or (
                state is EbsState.EBS_DISCHARGING and now_ns - self._since_ns >= EBS_DISCHARGING_NS
            ):
                self._enter(EbsState.EBS_INIT, now_ns)
        elif state is EbsState.EBS_INIT:
            if not self._wanted:
                self._since_ns = now_ns
            if now_ns - self._since_ns >= EBS_INIT_NS:
                self._enter(EbsState.EBS_CHARGING, now_ns)
        elif state is EbsState.EBS_CHARGING:
            if now_ns - self._since_ns >= EBS_CHARGING_NS:
                self._enter(EbsState.EBS_ARMED, now_ns)
        elif state is not EbsState.EBS_ARMED:
            self._enter(EbsState.EBS_INIT, now_ns)
        self._wanted = wanted

    def _enter(self, state: EbsState, now_ns: int) -> None:
        if state is not self.state:
            self.state = state
            self._since_ns = now_ns

    @property
    def armed(self) -> bool:
        return self.state is EbsState.EBS_ARMED

    @property
    def status(self) -> EbsStatus:
        """STATUS_EBS of 0x524, which knows fewer states."""
        return _EBS_STATUS.get(self.state, EbsStatus.UNAVAILABLE)


_EBS_STATUS: Final[Mapping[EbsState, EbsStatus]] = MappingProxyType(
    {EbsState.EBS_ARMED: EbsStatus.ARMED, EbsState.EBS_TRIGGERED: EbsStatus.TRIGGERED}
)
