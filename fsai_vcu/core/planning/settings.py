"""What can be set about planning. Lengths in metres, angles in radians, times in ns."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from fsai_vcu.interface.immutable import Immutable


@dataclass(frozen=True, slots=True)
class PlannerSettings(Immutable):
    """Defaults suit a detector with some 0.1 m of noise that looks 10 to 20 m ahead, ten times a second or oftener."""

    # Cones believed at all
    confidence_min: float = 0.2  # 0…1
    range_max_m: float = 22.0  # 5…50

    # Memory of cones
    same_cone_m: float = 0.8  # 0.3…1.5: sightings nearer than this to a known cone are that cone
    hits_to_believe: int = 2  # 1…10 sightings before a cone counts
    average_over: int = 8  # 1…50 sightings in a cone's mean: few follow odometry's drift, many average noise
    behind_m: float = 12.0  # 3…50: cones further behind are forgotten
    age_m: float = 60.0  # 20…500: cones not seen for so long a way are forgotten
    view_range_m: float = 9.0  # 3…30: within this range …
    view_half_angle_rad: float = math.radians(40.0)  # … and angle to either side a standing cone would be seen
    hit_ratio_min: float = 0.3  # 0…0.9: a cone seen in fewer of the looks at its place is taken for a false one

    # Lane
    lane_half_width_min_m: float = 1.5  # 1…3: the rules grant 3 m of lane; the offset from a lone border
    lane_half_width_max_m: float = 2.5  # 1.5…4
    horizon_m: float = 20.0  # 6…40: how far to look for the lane
    step_m: float = 2.5  # 1…4: length of the arcs tried
    curvature_max_1pm: float = 0.3  # 0.1…0.4: of the tightest arc tried
    beam: int = 14  # 4…64 hypotheses kept
    border_gap_max_m: float = 9.0  # 4…15: the lane is not believed beyond a longer stretch without any cone
    smoothing_m: float = 1.0  # 0.2…2: the path is averaged over about this length to either side
    path_step_m: float = 0.5  # 0.2…1: spacing of the path's points
    keep_path_ns: int = 1_000_000_000  # 0…3 s: for how long the last path is driven on when no lane is seen

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low, high = PLANNER_RANGES[field.name]
            if not (low <= value <= high):
                raise ValueError(f"planner setting {field.name} is {value}, outside {low}…{high}")


PLANNER_RANGES: dict[str, tuple[float, float]] = {
    "confidence_min": (0.0, 1.0),
    "range_max_m": (5.0, 50.0),
    "same_cone_m": (0.3, 1.5),
    "hits_to_believe": (1, 10),
    "average_over": (1, 50),
    "behind_m": (3.0, 50.0),
    "age_m": (20.0, 500.0),
    "view_range_m": (3.0, 30.0),
    "view_half_angle_rad": (0.1, math.pi),
    "hit_ratio_min": (0.0, 0.9),
    "lane_half_width_min_m": (1.0, 3.0),
    "lane_half_width_max_m": (1.5, 4.0),
    "horizon_m": (6.0, 40.0),
    "step_m": (1.0, 4.0),
    "curvature_max_1pm": (0.1, 0.4),
    "beam": (4, 64),
    "border_gap_max_m": (4.0, 15.0),
    "smoothing_m": (0.2, 2.0),
    "path_step_m": (0.2, 1.0),
    "keep_path_ns": (0, 3_000_000_000),
}
