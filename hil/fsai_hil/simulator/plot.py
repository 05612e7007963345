"""A picture of a run: the track with the driven path, in colours of speed; below, what was asked and given."""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.judge import JudgeVerdict
from fsai_hil.simulator.tracks import Track
from fsai_hil.simulator.world import MissionRun, PathSample
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026 as CAR
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.lights import BAND_ALPHA, LIGHTS
from fsai_vcu.printable import drawn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MISSING: Final = "no plot: matplotlib is not installed; install it with: pip install 'fsai-vcu[plot]'"
WIDTH_IN: Final = 11.0
LONG: Final = 8.0  # a track so many times longer than wide is drawn wider than it is

CONE_STYLE: Final = {
    ConeColor.UNKNOWN: ("#888888", 10),
    ConeColor.BLUE: ("#1f5fd0", 12),
    ConeColor.YELLOW: ("#e8c400", 12),
    ConeColor.ORANGE: ("#ff8c1a", 12),
    ConeColor.BIG_ORANGE: ("#e65c00", 36),
}


def plotted(program: str, path: Path, run: MissionRun) -> bool:
    """Save the picture of a run; where there can be none, print why and return False."""
    try:
        picture(run).savefig(path)
    except ImportError:
        print(f"{program}: {MISSING}", file=sys.stderr)
        return False
    except (OSError, ValueError) as error:
        print(f"{program}: no plot: {path} cannot be written: {error}", file=sys.stderr)
        return False
    return True


def picture(run: MissionRun) -> Figure:
    """Raises ImportError without matplotlib."""
    from matplotlib.figure import Figure

    low, high = bounds(run)
    wide_m, tall_m = (high - low).tolist()
    is_long = wide_m > LONG * tall_m
    track_in = 2.2 if is_long else min(1.0 + 0.85 * WIDTH_IN * tall_m / wide_m, 1.5 + 0.15 * tall_m, 8.0)
    figure = Figure(figsize=(WIDTH_IN, track_in + 6.5), layout="constrained", dpi=100)
    grid = figure.add_gridspec(4, 1, height_ratios=(track_in, 2.2, 1.6, 1.3))
    plan = figure.add_subplot(grid[0])
    speed = figure.add_subplot(grid[1])
    steering, pedals = (figure.add_subplot(grid[row], sharex=speed) for row in (2, 3))

    draw_track(plan, run.track)
    _draw_path(plan, run)
    plan.set_aspect("auto" if is_long else "equal")
    plan.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m")
    plan.set_ylabel("y, m (not to scale)" if is_long else "y, m")
    figure.suptitle(textwrap.fill(drawn(_title(run.track, run.judge.verdict())), 110), fontsize=11)

    _draw_over_time(speed, steering, pedals, run)
    # One entry each, however often a state was entered
    entries = [zip(*axes.get_legend_handles_labels(), strict=True) for axes in figure.axes]
    named = {text: handle for each in entries for handle, text in each}
    if named:
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.4)}
        pedals.legend(list(named.values()), list(named), **below, ncol=6, fontsize=8)
    return figure


def bounds(run: MissionRun, margin_m: float = 3.0) -> tuple[Floats, Floats]:
    """Lower left and upper right corner of what there is to see, in the world; never without an extent."""
    seen = np.vstack([run.track.cones_xy_m, np.array([(s.x_m, s.y_m) for s in run.samples]).reshape(-1, 2), [[0, 0]]])
    seen = seen[:-1] if len(seen) > 1 else seen
    return seen.min(axis=0) - margin_m, seen.max(axis=0) + margin_m


def draw_track(plan: Axes, track: Track, cone_scale: float = 1.0) -> None:
    """Borders, cones, start and finish line."""
    for border in (track.left_border_m, track.right_border_m):
        if border is not None:
            ring = np.vstack([border, border[:1]]) if track.closed else border
            plan.plot(ring[:, 0], ring[:, 1], color="#cccccc", linewidth=0.8, zorder=1)
    for color, (shade, size) in CONE_STYLE.items():
        xy = track.cones_xy_m[track.cone_colors == int(color)]
        if len(xy):
            plan.scatter(
                *xy.T, s=size * cone_scale, color=shade, edgecolors="#333333", linewidths=0.3 * cone_scale, zorder=2
            )
    lines = {"start line": track.start_line, "finish line": track.finish_line}
    if track.start_line == track.finish_line:
        lines = {"start and finish line": track.start_line}
    for (name, line), color in zip(lines.items(), ("#111111", "#b00020"), strict=False):
        if line is not None:
            ends = zip(line.ahead(0.0, 2.5), line.ahead(0.0, -2.5), strict=True)
            plan.plot(*ends, color=color, linewidth=1.8, linestyle=(0, (2, 1)), zorder=2.5, label=name)


def car_outline(pose: Pose, steer_deg: float) -> list[Floats]:
    """Corners of body and wheels in the world, the front wheels steered; the car's own name for left is positive."""
    rear_m = CAR.nose_ahead_of_rear_axle_m - CAR.length_m
    boxes = [(Pose(*pose.ahead((CAR.nose_ahead_of_rear_axle_m + rear_m) / 2), pose.yaw_rad), CAR.length_m, CAR.width_m)]
    for ahead_m, turned_deg in ((0.0, 0.0), (CAR.wheelbase_m, steer_deg)):
        for left_m in (CAR.track_m / 2, -CAR.track_m / 2):
            yaw_rad = pose.yaw_rad + math.radians(turned_deg)
            boxes.append((Pose(*pose.ahead(ahead_m, left_m), yaw_rad), 2 * CAR.rolling_radius_m, 0.2))
    corners = ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5))
    return [np.array([box.ahead(a * long_m, b * wide_m) for a, b in corners]) for box, long_m, wide_m in boxes]


def _draw_path(plan: Axes, run: MissionRun) -> None:
    """The path in the colours of its speed; where cones were hit and where the car left the track."""
    from matplotlib.collections import LineCollection

    points = np.array([(s.x_m, s.y_m) for s in run.samples]).reshape(-1, 2)
    if len(points) > 1 and np.ptp(points, axis=0).any():
        driven = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="turbo", linewidths=2, zorder=3)
        driven.set_array(np.array([s.speed_mps for s in run.samples[1:]]))
        plan.add_collection(driven)
        assert plan.figure is not None
        plan.figure.colorbar(driven, ax=plan, label="speed, m/s", fraction=0.03, pad=0.01)
    if run.samples:  # the car where it ended
        last = run.samples[-1]
        for corners in car_outline(Pose(last.x_m, last.y_m, last.yaw_rad), last.steer_deg):
            plan.fill(*corners.T, facecolor="none", edgecolor="#111111", linewidth=0.8, zorder=4)
    judge = run.judge
    hit, left = run.track.cones_xy_m[judge.hit_cones], np.array(judge.left_course_m).reshape(-1, 2)
    if len(hit):
        plan.scatter(*hit.T, s=110, marker="x", color="#d40000", linewidths=2, zorder=5, label=f"cones hit: {len(hit)}")
    if len(left):
        ring = {"facecolors": "none", "edgecolors": "#c000c0", "linewidths": 2}
        plan.scatter(*left.T, s=160, zorder=5, label=f"off course: {len(left)}", **ring)


def _draw_over_time(speed: Axes, steering: Axes, pedals: Axes, run: MissionRun) -> None:
    """Draw speed, steering and pedals over time, asked for and given."""
    series = {name: np.array([getattr(s, name) for s in run.samples]) for name in PathSample.__struct_fields__}
    t_s, measured, wheels, limit = (series[name] for name in ("t_s", "speed_mps", "wheels_mps", "speed_limit_mps"))
    if np.abs(wheels - measured).max(initial=0.0) > 0.5:  # they spin, lock, or turn in the air
        speed.plot(t_s, wheels, color="#8080c0", linewidth=0.9, label="wheels")
    top_mps = max(1.0, float(np.maximum(measured, wheels).max(initial=0.0)))
    limited = np.where((limit > 0.0) & (limit < 1.4 * top_mps), limit, math.nan)
    if np.isfinite(limited).any():
        speed.plot(t_s, limited, color="#d40000", linewidth=1.0, linestyle="--", label="speed limit asked")
        top_mps = max(top_mps, float(np.nanmax(limited)))
    speed.plot(t_s, measured, color="#203864", linewidth=1.3, label="speed")
    steering.plot(t_s, series["steer_order_deg"], color="#e07000", linewidth=1.0, label="steering asked")
    steering.plot(t_s, series["steer_deg"], color="#203864", linewidth=1.0, label="steering given")
    pedals.plot(t_s, series["throttle"], color="#108030", linewidth=1.0, label="throttle")
    pedals.plot(t_s, series["brake"], color="#d40000", linewidth=1.0, label="brake")
    speed.set(ylim=(0.0, 1.08 * top_mps), ylabel="speed, m/s")
    steering.set_ylabel("steering, deg\nleft positive")
    pedals.set(ylim=(min(-0.05, float(series["throttle"].min(initial=0.0))), 1.05), ylabel="throttle, brake")
    pedals.set_xlabel("time, s")
    for axes in (speed, steering, pedals):
        _shade_states(axes, run.samples)
        axes.grid(alpha=0.3)
        axes.tick_params(labelbottom=axes is pedals)
        for at_s in run.judge.crossings_s:
            axes.axvline(at_s, color="#444444", linewidth=0.9, linestyle=":")
    if len(t_s):
        speed.set_xlim(t_s[0], max(t_s[-1], t_s[0] + 1.0))
    for lap, (begin_s, end_s) in enumerate(pairwise(run.judge.crossings_s), 1):
        words: dict[str, Any] = {"transform": speed.get_xaxis_transform(), "ha": "center", "va": "bottom"}
        speed.text((begin_s + end_s) / 2, 1.01, f"{lap}: {end_s - begin_s:.2f} s", fontsize=7, **words)


def _shade_states(axes: Axes, samples: Sequence[PathSample]) -> None:
    """Colour the background by AS state."""
    changes = [i for i in range(1, len(samples)) if samples[i].as_state != samples[i - 1].as_state]
    for begin, end in pairwise([0, *changes, len(samples) - 1] if samples else ()):
        state = AsState(samples[begin].as_state)
        span_s = samples[begin].t_s, samples[end].t_s
        axes.axvspan(*span_s, color=LIGHTS[state].fill, alpha=BAND_ALPHA, linewidth=0, label=state.label, zorder=0)


def _title(track: Track, verdict: JudgeVerdict) -> str:
    where = "" if track.name in (verdict.mission, "static") else f" on {track.name}"
    title = f"{verdict.mission}{where}: {verdict.result.upper()}"
    if verdict.lap_times_s:
        title += "; laps " + ", ".join(f"{t:.2f} s" for t in verdict.lap_times_s)
    title += f"; cones hit {verdict.cones_hit}, off course {verdict.off_course}"
    return title + (": " + "; ".join(verdict.reasons) if verdict.reasons else "")
