"""A sweep of the steering: left, right, straight, each end held until the actuator has come."""

from __future__ import annotations

from msgspec.structs import replace

from fsai_vcu.core.missions.request import CarView
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.interface.values import Value

ENDS = (1.0, -1.0, 0.0)  # in units of the full angle, positive left
PATIENCE_S = 2.0  # an end that is not reached by then is left all the same: the judge, not the car, stands still
STEP_MAX_S = 0.1  # a longer pause between two calls does not make the angle jump


class SweepState(Value, frozen=True):
    """`end`: index of the end under way; `angle_rad`: asked for; `held_s`: for how long that end has been asked for."""

    end: int = 0
    angle_rad: float = 0.0
    held_s: float = 0.0
    t_ns: int | None = None

    @property
    def done(self) -> bool:
        return self.end >= len(ENDS)


NOT_BEGUN = SweepState()


def advance_sweep(state: SweepState, view: CarView, full_rad: float, settings: MissionSettings) -> SweepState:
    """The sweep at `view.now_ns`, which is not done yet."""
    dt_s = 0.0 if state.t_ns is None else min(max(0, view.now_ns - state.t_ns) / 1e9, STEP_MAX_S)
    target = ENDS[state.end] * full_rad
    most = settings.sweep_rate_radps * dt_s
    angle = state.angle_rad + min(max(target - state.angle_rad, -most), most)
    if angle != target:
        return replace(state, angle_rad=angle, held_s=0.0, t_ns=view.now_ns)
    held_s = state.held_s + dt_s
    arrived = abs(view.steer_rad - target) <= settings.sweep_tolerance_rad
    if (arrived and held_s >= settings.sweep_hold_s) or held_s >= PATIENCE_S:
        return SweepState(state.end + 1, angle, 0.0, view.now_ns)
    return SweepState(state.end, angle, held_s, view.now_ns)
