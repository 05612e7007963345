"""Settings of planning. Lengths in metres, angles in radians, times in ns."""

from __future__ import annotations

import math
from typing import Annotated

from fsai_vcu.core.ranges import check_ranges, ranges_of, within
from fsai_vcu.interface.values import Value


class PlannerSettings(Value, frozen=True):
    """Defaults suit a detector with some 0.1 m of noise that looks 10 to 20 m ahead, ten times a second or oftener."""

    # Cones believed at all
    confidence_min: Annotated[float, within(0.0, 1.0)] = 0.2
    range_max_m: Annotated[float, within(5.0, 50.0)] = 22.0

    # Memory of cones
    same_cone_m: Annotated[float, within(0.3, 1.5)] = 0.8  # sightings nearer than this to a known cone are that cone
    hits_to_believe: Annotated[int, within(1, 10)] = 2  # sightings before a cone counts
    # Sightings in a cone's mean: few follow odometry's drift, many average noise.
    average_over: Annotated[int, within(1, 50)] = 8
    behind_m: Annotated[float, within(3.0, 50.0)] = 12.0  # cones further behind are forgotten
    age_m: Annotated[float, within(20.0, 500.0)] = 60.0  # cones not seen for so long a way are forgotten
    view_range_m: Annotated[float, within(3.0, 30.0)] = 9.0  # a standing cone within this range …
    # … and angle to a side it would be seen.
    view_half_angle_rad: Annotated[float, within(0.1, math.pi)] = math.radians(40.0)
    hit_ratio_min: Annotated[float, within(0.0, 0.9)] = 0.3  # seen in fewer of the looks at its place, a cone is false

    # Lane
    # The rules grant 3 m of lane; the offset from a lone border.
    lane_half_width_min_m: Annotated[float, within(1.0, 3.0)] = 1.5
    lane_half_width_max_m: Annotated[float, within(1.5, 4.0)] = 2.5
    horizon_m: Annotated[float, within(6.0, 40.0)] = 20.0  # how far to look for the lane
    step_m: Annotated[float, within(1.0, 4.0)] = 2.5  # length of the arcs tried
    curvature_max_1pm: Annotated[float, within(0.1, 0.4)] = 0.4  # of the tightest arc tried
    beam: Annotated[int, within(4, 64)] = 28  # hypotheses kept
    border_gap_max_m: Annotated[float, within(4.0, 15.0)] = 9.0  # beyond a longer one the lane is not believed
    smoothing_m: Annotated[float, within(0.2, 2.0)] = 1.0  # the path is averaged over about this length to either side
    path_step_m: Annotated[float, within(0.2, 1.0)] = 0.5  # spacing of the path's points
    keep_path_ns: Annotated[int, within(0, 3_000_000_000)] = 1_000_000_000  # the last path, when no lane is seen

    def __post_init__(self) -> None:
        check_ranges(self, "planner")


PLANNER_RANGES = ranges_of(PlannerSettings)
