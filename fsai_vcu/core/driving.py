"""The data that flows through the driving chain: cones seen, motion, plan; and the run they belong to.

Frames: *vehicle frame* is ISO 8855 / REP-103 with its origin at the rear axle's centre on the ground (x forward,
y left); *odometry frame* is the vehicle frame where the run began.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING

from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.values import Value

if TYPE_CHECKING:
    from fsai_vcu.core.arrays import Floats, Ints


class ConeColor(IntEnum):
    """Colour of a cone as a detector reports it."""

    UNKNOWN = 0
    BLUE = 1  # left border
    YELLOW = 2  # right border
    ORANGE = 3  # small orange: entry and exit lanes
    BIG_ORANGE = 4  # start and finish gates


class ConeObservation(Value, frozen=True):
    """Cones seen at one instant, in the vehicle frame.

    xy_m: (N, 2) metres; color: (N,) ConeColor values; confidence: (N,) 0…1.
    """

    t_ns: int
    xy_m: Floats
    color: Ints
    confidence: Floats


class Motion(Value, frozen=True):
    """Dead-reckoned motion in the odometry frame. Rear-axle centre.

    `t_ns` is when the wheel speeds were received that it was made of. `…_sd_…` are standard deviations.
    """

    t_ns: int = 0
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    distance_m: float = 0.0  # driven since the run began
    position_sd_m: float = 0.0  # of x_m and of y_m
    yaw_sd_rad: float = 0.0
    speed_sd_mps: float = 0.0
    yaw_rate_sd_radps: float = 0.0


class Run(Value, frozen=True):
    """The run in hand: a new `run_id` asks planner and controller to forget everything and to confirm it.

    `may_move` is True once AS_DRIVING has lasted the 3 s in which the car must stand still.
    """

    run_id: int
    mission: Ami = Ami.NOT_SELECTED
    as_state: AsState | None = None
    may_move: bool = False


LOST = "lost: "


class Plan(Value, frozen=True):
    """Path to drive, and what is known of it, from the planner to the controller.

    path_m: (M, 2) vehicle frame of the instant `t_sensor_ns`, ordered forward, first point near the car.
    `laps` completed so far; `stop_distance_m` is the length of path left until the car must stand (None: no stop known
    yet); `finished` says the mission's last line has been crossed. `supported_m` is the length of path from the car on
    that cones or a map bear out, `confidence` (0…1) how sure the planner is of it; `mapped` says that the path follows
    a map closed over a whole lap; `slip_radpmps2` is the slip angle of the rear axle by lateral acceleration, as that
    map has shown it (0: it has not yet); `note` says in words why there is no path, or why it is doubted. A planner
    that does not know where the lane is says so by a note that begins with `LOST`: its path is the way to a stop at
    once.
    """

    t_sensor_ns: int
    run_id: int
    mission: Ami
    path_m: Floats
    laps: int = 0
    finished: bool = False
    stop_distance_m: float | None = None
    cones_count_actual: int = 0
    cones_count_all: int = 0
    supported_m: float = math.inf
    confidence: float = 1.0
    mapped: bool = False
    note: str = ""
    slip_radpmps2: float = 0.0

    @property
    def lost(self) -> bool:
        return self.note.startswith(LOST)
