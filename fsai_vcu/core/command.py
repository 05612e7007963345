"""Command that a controller hands to the gate: what is asked of the car."""

from __future__ import annotations

import math

from fsai_vcu.interface.values import Detail, Value, Whole


class VehicleCommand(Value, frozen=True, tag=True):
    """A request in SI units and fractions. The gate decides what of it reaches the wire.

    `t_sensor_ns` is the monotonic stamp of the oldest sensor data behind the command, `run_id` the run for which it
    was computed: a command of another run counts as no command. `steering_rad` is the bicycle-model road angle,
    positive to the left; throttle and brake are fractions 0…1 of the most that the limits allow.
    """

    t_sensor_ns: Whole
    run_id: Whole
    steering_rad: float = 0.0
    throttle: float = 0.0
    brake: float = 0.0
    speed_limit_mps: float = 0.0
    mission_finished: bool = False  # the mission is over: stop, then FINISHED
    estop_request: bool = False  # the mission ends with an emergency brake, or the controller gives up
    laps: Whole = 0
    cones_count_actual: Whole = 0
    cones_count_all: Whole = 0
    note: Detail = ""  # in words what keeps the controller from driving: no path, an input that is late; else empty

    def problems(self, steer_limit_rad: float) -> tuple[str, ...]:
        """Say why this command must be refused whole; empty when it is in order."""
        found = [
            f"{name} is {value}, not a finite number"
            for name, value in (
                ("steering_rad", self.steering_rad),
                ("throttle", self.throttle),
                ("brake", self.brake),
                ("speed_limit_mps", self.speed_limit_mps),
            )
            if not math.isfinite(value)
        ]
        if found:
            return tuple(found)
        if abs(self.steering_rad) > steer_limit_rad + 1e-9:
            found.append(f"steering_rad {self.steering_rad:.4f} is outside +-{steer_limit_rad:.4f}")
        if not 0.0 <= self.throttle <= 1.0:
            found.append(f"throttle {self.throttle:.4f} is outside 0…1")
        if not 0.0 <= self.brake <= 1.0:
            found.append(f"brake {self.brake:.4f} is outside 0…1")
        if self.speed_limit_mps < 0.0:
            found.append(f"speed_limit_mps {self.speed_limit_mps:.3f} is negative")
        return tuple(found)
