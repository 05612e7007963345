"""Steps that a /run_mission goal waits for, as a table; pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from fsai_vcu.interface.enums import OFF_LIKE, Ami, AsState

_FINISHED = frozenset({AsState.AS_FINISHED})
_EMERGENCY = frozenset({AsState.EMERGENCY_BRAKE})
_NONE: frozenset[AsState] = frozenset()


@dataclass(frozen=True, slots=True)
class Goal:
    """`reached` ends it well, also where the car is there already; a change into `missed` ends it badly.

    lost_by_off: so does AS_OFF after AS_DRIVING.
    """

    reached: frozenset[AsState]
    missed: frozenset[AsState]
    lost_by_off: bool


GOALS: Mapping[str, Goal] = MappingProxyType(
    {
        "ready": Goal(frozenset({AsState.AS_READY}), _EMERGENCY | _FINISHED, True),
        "driving": Goal(frozenset({AsState.AS_DRIVING}), _EMERGENCY | _FINISHED, False),
        "finished": Goal(_FINISHED, _EMERGENCY, True),
        "emergency": Goal(_EMERGENCY, _FINISHED, True),
        "off": Goal(OFF_LIKE, _NONE, False),
        "end": Goal(_FINISHED | _EMERGENCY, _NONE, True),
    }
)
DEFAULT_GOAL = "finished"
MISSIONS: Mapping[str, Ami] = MappingProxyType({ami.name.lower(): ami for ami in Ami if ami is not Ami.NOT_SELECTED})


@dataclass(frozen=True, slots=True)
class GoalResult:
    """End of a goal: `ended` for programs, `message` for people."""

    success: bool
    ended: str
    message: str


class Waiting:
    """One goal being waited for. Fed with what the car says; returns an outcome once."""

    def __init__(self, mission: str, until: str, timeout_s: float, now_ns: int) -> None:
        """Wait as declared for RunMission: a mission or none, one of GOALS or none, a time (0 s: no limit)."""
        self.until = until or DEFAULT_GOAL
        self._mission = MISSIONS.get(mission.lower())
        self._timeout_s = timeout_s
        self._began_ns = now_ns
        self._before: AsState | None = None
        self._drove = False

    def duration_s(self, now_ns: int) -> float:
        """Return the time since the goal was taken; never negative, though `now_ns` was read before that."""
        return max(0, now_ns - self._began_ns) / 1e9

    def step(
        self, as_state: AsState | None, mission: Ami, now_ns: int, *, cancelled: bool = False
    ) -> GoalResult | None:
        """`as_state` and `mission` as the car reports them now; None while nothing is received.

        cancelled: the car is being stopped, and the goal ends with the drive.
        """
        goal = GOALS[self.until]
        before, self._before = self._before, as_state
        changed = before is not None and as_state is not before
        self._drove |= as_state is AsState.AS_DRIVING
        if cancelled and as_state is not AsState.AS_DRIVING:
            state = "nothing is received from the car" if as_state is None else f"the car is in {as_state.label}"
            return GoalResult(False, "cancelled", f"cancelled, mode is manual: {state}")
        if as_state is not None and not cancelled:
            underway = as_state in (AsState.AS_READY, AsState.AS_DRIVING)
            if underway and self._mission is not None and mission is not self._mission:
                words = f"{as_state.label} with mission {mission.label}, not {self._mission.label}"
                return GoalResult(False, "wrong_mission", words)
            if as_state in goal.reached:
                return GoalResult(True, "reached", f"{as_state.label} reached")
            if changed and as_state in goal.missed:
                return GoalResult(False, "missed", f"{as_state.label} instead of {self.until}")
            if goal.lost_by_off and self._drove and as_state in OFF_LIKE:
                return GoalResult(False, "missed", f"{as_state.label} after AS_DRIVING, instead of {self.until}")
        if self._timeout_s and now_ns - self._began_ns >= self._timeout_s * 1e9:
            state = "nothing received from the car" if as_state is None else f"the car is in {as_state.label}"
            return GoalResult(False, "timeout", f"not {self.until} within {self._timeout_s:g} s: {state}")
        return None
