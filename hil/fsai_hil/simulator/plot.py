"""A picture of a run: the track with the path driven, coloured by speed, and speed and AS state over time."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from fsai_hil.simulator.judge import JudgeVerdict
from fsai_hil.simulator.tracks import Track
from fsai_hil.simulator.world import PathSample, Run
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.interface.enums import AsState

MISSING: Final = "no plot: matplotlib is not installed; install it with: pip install 'fsai-vcu[plot]'"

_CONE_STYLE: Final = {
    ConeColor.UNKNOWN: ("#888888", 10),
    ConeColor.BLUE: ("#1f5fd0", 12),
    ConeColor.YELLOW: ("#e8c400", 12),
    ConeColor.ORANGE: ("#ff8c1a", 12),
    ConeColor.BIG_ORANGE: ("#e65c00", 36),
}
_STATE_COLOR: Final = {
    AsState.AS_INIT: "#dddddd",
    AsState.AS_OFF: "#dddddd",
    AsState.AS_READY: "#ffe680",
    AsState.AS_DRIVING: "#b7e4b0",
    AsState.EMERGENCY_BRAKE: "#ff9c9c",
    AsState.AS_FINISHED: "#9cc4ff",
}


def plotted(program: str, path: Path, run: Run) -> bool:
    """Save the picture of a run; where there can be none, print why and return False."""
    track, samples = run.track, run.samples
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
        from matplotlib.collections import LineCollection
    except ImportError:
        print(f"{program}: {MISSING}", file=sys.stderr)
        return False

    figure, (plan, time_axis) = pyplot.subplots(
        2, 1, figsize=(9.0, 11.0), height_ratios=(3, 1), layout="constrained", dpi=110
    )
    for border in (track.left_border_m, track.right_border_m):
        if border is not None:
            ring = np.vstack([border, border[:1]]) if track.closed else border
            plan.plot(ring[:, 0], ring[:, 1], color="#cccccc", linewidth=0.8, zorder=1)
    for color, (shade, size) in _CONE_STYLE.items():
        chosen = track.cone_colors == int(color)
        if chosen.any():
            xy = track.cones_xy_m[chosen]
            plan.scatter(xy[:, 0], xy[:, 1], s=size, color=shade, edgecolors="#333333", linewidths=0.3, zorder=2)
    if len(samples) > 1:
        points = np.array([(s.x_m, s.y_m) for s in samples])
        speeds = np.array([s.speed_mps for s in samples])
        segments = np.stack([points[:-1], points[1:]], axis=1)
        path_line = LineCollection(list(segments), cmap="viridis", linewidths=2.0, zorder=3)
        path_line.set_array(speeds[:-1])
        plan.add_collection(path_line)
        figure.colorbar(path_line, ax=plan, label="speed, m/s", shrink=0.7)
    plan.set_aspect("equal")
    plan.autoscale_view()
    plan.set_xlabel("x, m")
    plan.set_ylabel("y, m")
    plan.set_title(_title(track, run.judge.verdict()), fontsize=10)

    if samples:
        times = [s.t_s for s in samples]
        time_axis.plot(times, [s.speed_mps for s in samples], color="#203864", linewidth=1.2)
        _shade_states(time_axis, samples)
        time_axis.set_xlim(times[0], times[-1] if times[-1] > times[0] else times[0] + 1.0)
    time_axis.set_xlabel("time, s")
    time_axis.set_ylabel("speed, m/s")
    time_axis.grid(alpha=0.3)
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        print(f"{program}: no plot: {path} cannot be written: {error}", file=sys.stderr)
        return False
    finally:
        pyplot.close(figure)
    return True


def _title(track: Track, verdict: JudgeVerdict) -> str:
    title = f"{verdict.mission} on {track.name}: {verdict.result.upper()}"
    if verdict.lap_times_s:
        title += "   laps " + ", ".join(f"{t:.2f} s" for t in verdict.lap_times_s[:6])
        title += " …" if len(verdict.lap_times_s) > 6 else ""
    title += f"   cones hit {verdict.cones_hit}, off course {verdict.off_course}"
    return title + ("\n" + "; ".join(verdict.reasons)[:140] if verdict.reasons else "")


def _shade_states(axis: object, samples: Sequence[PathSample]) -> None:
    """Colour the background by AS state, each named once."""
    named: set[AsState] = set()
    changes = [i for i in range(1, len(samples)) if samples[i].as_state != samples[i - 1].as_state]
    for begin, end in pairwise([0, *changes, len(samples) - 1]):
        state, span_s = AsState(samples[begin].as_state), (samples[begin].t_s, samples[end].t_s)
        label = "_" if state in named else state.label
        axis.axvspan(*span_s, color=_STATE_COLOR[state], alpha=0.6, label=label, zorder=0)  # type: ignore[attr-defined]
        named.add(state)
    axis.legend(fontsize=7, loc="upper left", ncols=3)  # type: ignore[attr-defined]
