"""Every time and limit of the supervision, with the safety rules' defaults. Times are integer nanoseconds."""

from __future__ import annotations

import math
from typing import Literal

from msgspec.structs import replace

from fsai_vcu.interface.specification import COMMS_LOST_NS, WHEEL_SPEED_MAX_RPM
from fsai_vcu.interface.units import MS, S
from fsai_vcu.interface.values import Value


class BridgeConfig(Value, frozen=True):
    """Behaviour of the AI side of one car. A timer has run out *at* its value: T - 1 ns is still in time."""

    # Permissions
    autonomous_at_power_up: bool = False  # enter autonomous by itself: no link to the car is allowed in staging
    listen_only: bool = False  # never send: sending energises the tractive system and arms the EBS
    service_brake: Literal["hydraulic", "motor"] = "hydraulic"  # motor: never a hydraulic request (see below)

    # Life of a run
    listen_first_ns: int = 200 * MS  # on start a process listens, then sends
    launch_wait_ns: int = 3 * S  # the car must not move after entering AS_DRIVING
    ready_wait_ns: int = 4900 * MS  # of the 5 s in AS_READY, less the 100 ms that 0x520 may be missing
    short_sequence_allowed: bool = False  # AS_DRIVING may come sooner, and without an edge of Go
    standstill_rpm: int = 10  # interface specification v4.0: a wheel under 10 rpm stands
    standstill_ns: int = 500 * MS
    power_cycle_ns: int = 1 * S  # no 0x520 for so long: the car was switched off
    stop_cycles: int = 5  # cycles sent on an orderly stop before the silence

    # Vehicle command
    command_stale_ns: int = 100 * MS
    command_lost_ns: int = 300 * MS
    sensor_stale_ns: int = 500 * MS  # age of the oldest data behind a command
    sensor_future_ns: int = 20 * MS  # a stamp further ahead would hide old data
    both_pedals_ns: int = 100 * MS

    # The service-brake stop
    stop_timeout_ns: int = 3 * S
    stop_window_ns: int = 500 * MS  # over which a deceleration must show
    stop_min_drop_rpm: int = 9  # 0.5 m/s2 over the window, on a rolling radius of 0.2535 m
    stop_brake_pct: float = 80.0  # from the car's top speed to rest in under 3 s
    holding_brake_pct: float = 30.0

    # Messages of the car
    vcu_stale_ns: int = 50 * MS
    vcu_lost_ns: int = COMMS_LOST_NS
    as_state_known_ns: int = 100 * MS  # so long known again before torque returns: a state that flickers gives none
    feedback_stale_ns: int = 100 * MS  # wheel speeds, steering feedback, torque limits
    feedback_lost_ns: int = 300 * MS
    implausible_ns: int = 300 * MS
    implausible_lost_ns: int = 600 * MS

    # Wheel speeds that are not believed
    wheel_max_rpm: int = WHEEL_SPEED_MAX_RPM
    wheel_change_max_rpm: int = 300  # no tyre speeds a wheel up, or slows it down, by more from one frame to the next
    wheel_jump_ns: int = 350 * MS  # a jump is not believed for so long: what stays is reacted to as a missing speed
    wheel_doubt_turns: float = 0.5  # of a wheel: by so much speed and pulse count may contradict each other

    # Our own loop and bus
    backlog_ns: int = 20 * MS  # frames that waited so long are reported
    send_lost_ns: int = 50 * MS  # without one complete cycle counts as bus loss

    # Plausibility of steering and wheels
    steer_rate_spread: float = 0.25  # the actuator's true rate lies within this share of the car's parameter
    steer_margin_deg: float = 2.0  # beyond delay and backlash: rounding, tyres, the model's own error
    wheel_margin_rpm: float = 60.0
    wheel_margin_fraction: float = 0.30
    slip_memory_ns: int = 1 * S  # torque or brake so long ago still explains a slipping wheel

    # The gate
    steer_rate_degps: float | None = None  # None: the car's own steering rate

    def __post_init__(self) -> None:
        if self.service_brake not in ("hydraulic", "motor"):
            raise ValueError(f"service_brake is {self.service_brake!r}: hydraulic or motor")
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, (int, float)) and (not math.isfinite(value) or value < 0):
                raise ValueError(f"{name} is {value}: a finite number of 0 or more")
        for name in ("stop_brake_pct", "holding_brake_pct"):
            if getattr(self, name) > 100.0:
                raise ValueError(f"{name} is {getattr(self, name)}: 100 at most")

    @property
    def motor_brakes(self) -> bool:
        return self.service_brake == "motor"

    @property
    def held_brake_pct(self) -> float:
        """The holding brake, which a car that takes every brake request for an emergency does without."""
        return 0.0 if self.motor_brakes else self.holding_brake_pct


def official_simulator(config: BridgeConfig | None = None) -> BridgeConfig:
    """The configuration for the official simulator, which takes any hydraulic request for an emergency brake.

    The motors alone hold and stop the car there, so a stop may last longer and decelerates less. Its VCU does not keep
    to the 5 s in AS_READY.
    """
    return replace(
        config or BridgeConfig(),
        service_brake="motor",
        short_sequence_allowed=True,
        stop_brake_pct=100.0,
        stop_timeout_ns=20 * S,
        stop_window_ns=2 * S,
        stop_min_drop_rpm=5,
    )
