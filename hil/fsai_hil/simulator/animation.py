"""A run as a film: the car on its track from above, what it saw and where it meant to drive, as GIF or MP4.

What does not move is drawn once; of each frame only what moves is drawn again.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from bisect import bisect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.plot import bounds, car_outline, draw_track
from fsai_hil.simulator.world import MissionRun, PathSample
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeObservation
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.lights import LIGHTS

if TYPE_CHECKING:
    from PIL.Image import Image

Detector = Callable[[ConeObservation], ConeObservation]

FRAMES_PER_S: Final = 12.5  # GIF counts in hundredths of a second
SIZE_IN, DPI = (7.2, 4.08), 100  # an even number of pixels, as H.264 wants it
CLOSE_M: Final = 12.0  # to either side of the car, in the close view
WIDE: Final = 2.5  # a track so many times wider than high lies above the close view, not beside it
GIF_FRAMES: Final = 1000  # at most: all of them are in memory, and the file grows
GIF_COLORS: Final = 128
PROGRESS: Final = 10  # lines while it renders


@dataclass(frozen=True, slots=True)
class View:
    """A view of the AI computer on one look of the sensor, in the world."""

    t_s: float
    cones_m: Floats
    path_m: Floats


class Views:
    """Keeps what detector and planner of a lockstep run say; it only listens."""

    def __init__(self) -> None:
        self.views: list[View] = []
        self._poses: dict[int, Pose] = {}  # the true ones, at the instants of the sensor

    def watch(self, lockstep: Lockstep) -> None:
        lockstep.detector = partial(self._on_cones, lockstep, lockstep.detector)

    def _on_cones(self, lockstep: Lockstep, detector: Detector, observation: ConeObservation) -> ConeObservation:
        seen = detector(observation)
        plan, setup = lockstep.computer.plan, lockstep.world.setup
        pose = self._poses[seen.t_ns] = lockstep.world.car.pose
        there = None if plan is None else self._poses.get(plan.t_sensor_ns)
        path_m = np.empty((0, 2)) if plan is None or there is None else _in_world(there, plan.path_m)
        t_s = (seen.t_ns - setup.start_ns) / 1e9
        self.views.append(View(t_s, _in_world(pose, seen.xy_m), path_m))
        return seen


def _in_world(pose: Pose, xy_m: Floats) -> Floats:
    cos, sin = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
    return np.asarray(xy_m @ np.array([[cos, sin], [-sin, cos]]) + (pose.x_m, pose.y_m))


def why_not(path: Path) -> str | None:
    """Return in one line why there can be no film of that name; None where there can."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return "no animation: matplotlib is not installed; install it with: pip install 'fsai-vcu[plot]'"
    if path.suffix not in (".gif", ".mp4"):
        return f"no animation: {path} is neither a .gif nor an .mp4"
    if path.suffix == ".mp4" and _ffmpeg() is None:
        return "no animation: .mp4 needs ffmpeg (apt install ffmpeg, or pip install imageio-ffmpeg); .gif needs nothing"
    return None


def _ffmpeg() -> str | None:
    if found := shutil.which("ffmpeg"):
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        return None
    return str(get_ffmpeg_exe())


def animate(program: str, path: Path, run: MissionRun, views: list[View], times_real: float = 2.0) -> int:
    """Save the film, `times_real` times as fast as it was driven; returns the number of frames.

    It begins with AS_DRIVING. A long one is sped up where it is a GIF. Raises OSError where it cannot be written.
    """
    samples = run.samples
    driving = [s.t_s for s in samples if s.as_state == AsState.AS_DRIVING]
    begin_s, end_s = driving[0] if driving else samples[0].t_s, samples[-1].t_s
    if path.suffix == ".gif" and (end_s - begin_s) * FRAMES_PER_S > GIF_FRAMES * times_real:
        times_real = (end_s - begin_s) * FRAMES_PER_S / GIF_FRAMES
        print(f"{program}: {path} is sped up to {times_real:.1f} times real time; .mp4 is not", file=sys.stderr)
    times = np.arange(begin_s, end_s + 1e-6, times_real / FRAMES_PER_S)
    stage = _Stage(run, views)
    frames = (stage.frame(t_s) for t_s in _told(program, times))
    if path.suffix == ".gif":
        _save_gif(path, frames, stage.palette(times))
    else:
        _save_mp4(path, frames, stage.size)
    return len(times)


def _told(program: str, times: Floats) -> Iterator[float]:
    """The times, with a line now and then of how many have gone."""
    for index, t_s in enumerate(times.tolist()):
        if index % -(-len(times) // PROGRESS) == 0:
            print(f"{program}: {index} of {len(times)} frames", file=sys.stderr)
        yield t_s


def _save_gif(path: Path, frames: Iterator[Image], palette: Image) -> None:
    from PIL.Image import Dither

    # One palette: else what stands still would change its colours, and would be stored again.
    reduced = (frame.quantize(palette=palette, dither=Dither.NONE) for frame in frames)
    next(reduced).save(
        path, save_all=True, append_images=reduced, duration=round(1000 / FRAMES_PER_S), loop=0, optimize=True
    )


def _save_mp4(path: Path, frames: Iterator[Image], size: tuple[int, int]) -> None:
    """Pipe the frames through ffmpeg into a film."""
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", str(FRAMES_PER_S), "-i", "-"]
    target = ["-c:v", "libx264", "-crf", "26", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    argv = [_ffmpeg() or "ffmpeg", "-y", "-loglevel", "error", *source, *target]
    encoder = subprocess.Popen(argv, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    assert encoder.stdin is not None and encoder.stderr is not None
    try:
        for frame in frames:
            encoder.stdin.write(frame.tobytes())
        _, said = encoder.communicate()
    except BrokenPipeError:
        said = encoder.stderr.read()
        encoder.wait()
    if encoder.returncode:
        why = said.decode(errors="replace").strip().splitlines()
        raise OSError(1, why[0] if why else f"ffmpeg ended with status {encoder.returncode}", str(path))


class _Stage:
    """The figure of all frames: the whole track, and the car from near."""

    def __init__(self, run: MissionRun, views: list[View]) -> None:
        """Draw what does not move, and keep the parts that do."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import PolyCollection
        from matplotlib.figure import Figure

        self._run, self._views = run, views
        self._view_s = [view.t_s for view in views]
        names = PathSample.__struct_fields__
        self._series = {name: np.array([getattr(s, name) for s in run.samples]) for name in names}
        self._series["yaw_rad"] = np.unwrap(self._series["yaw_rad"])
        figure = Figure(figsize=SIZE_IN, dpi=DPI)
        self._canvas: Any = FigureCanvasAgg(figure)
        self.size: tuple[int, int] = self._canvas.get_width_height()
        (left, low), (right, high) = bounds(run)
        wide = right - left > WIDE * (high - low)
        whole = figure.add_axes((0.02, 0.66, 0.96, 0.22) if wide else (0.02, 0.03, 0.54, 0.84))
        self._near = near = figure.add_axes((0.02, 0.03, 0.96, 0.6) if wide else (0.58, 0.03, 0.4, 0.84))
        for axes in (whole, near):
            axes.set(xticks=[], yticks=[])
        whole.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        draw_track(whole, run.track, 0.4)
        draw_track(near, run.track, 4.0)
        box = near.get_window_extent()
        self._half_m = np.array([max(1.0, box.width / box.height), max(1.0, box.height / box.width)]) * CLOSE_M
        still = set(near.get_children())
        (self._driven,) = whole.plot([], [], color="#203864", linewidth=1.2)
        (self._here,) = whole.plot([], [], "o", color="#d40000", markersize=5)
        (self._path,) = near.plot([], [], color="#10a040", linewidth=2.2, label="planned path", zorder=3)
        self._seen = near.scatter([], [], s=130, facecolors="none", edgecolors="#c000c0", label="cone seen", zorder=4)
        self._car = PolyCollection([], facecolors=["#f4f4f4cc", *["#111111"] * 4], edgecolors="#111111", zorder=5)
        near.add_collection(self._car)
        if views:
            near.legend(loc="lower right", fontsize=7)
        style = {"boxstyle": "square,pad=0.4", "linewidth": 0}
        self._words = figure.text(0.02, 0.93, "", fontsize=11, family="monospace", va="center", bbox=style)
        # What moves in the close view is all that is in it but frame and legend.
        passed = [each for each in still if each in (*near.lines, *near.collections)]
        passed.sort(key=lambda artist: artist.get_zorder())
        self._moving = [
            *((whole, artist) for artist in (self._driven, self._here)),
            *((near, artist) for artist in (*passed, self._path, self._seen, self._car)),
            (figure, self._words),
        ]
        for _, artist in self._moving:
            artist.set_animated(True)
        figure.canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def frame(self, t_s: float) -> Image:
        """The picture at that time of the run."""
        from PIL import Image

        series, sample = self._series, bisect(self._series["t_s"], t_s)
        x, y, yaw, steer, speed = (
            float(np.interp(t_s, series["t_s"], series[name]))
            for name in ("x_m", "y_m", "yaw_rad", "steer_deg", "speed_mps")
        )
        half_x, half_y = self._half_m
        self._near.set(xlim=(x - half_x, x + half_x), ylim=(y - half_y, y + half_y))
        self._driven.set_data(series["x_m"][:sample], series["y_m"][:sample])
        self._here.set_data([x], [y])
        self._car.set_verts(car_outline(Pose(x, y, yaw), steer))
        if latest := bisect(self._view_s, t_s):
            view = self._views[latest - 1]
            self._path.set_data(*view.path_m.T)
            self._seen.set_offsets(view.cones_m)
        state = AsState(int(series["as_state"][max(0, sample - 1)]))
        laps = max(0, bisect(self._run.judge.crossings_s, t_s) - 1)
        mission = self._run.mission.name.lower()
        self._words.set_text(f"{mission}  {state.label:<15}  {t_s:6.1f} s  {speed:4.1f} m/s  laps {laps}")
        self._words.get_bbox_patch().set_facecolor(LIGHTS[state].fill)
        self._words.set_color(LIGHTS[state].ink)
        self._canvas.restore_region(self._background)
        for owner, artist in self._moving:
            if owner is self._words.figure:
                artist.draw(self._canvas.get_renderer())
            else:
                owner.draw_artist(artist)
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())[..., :3].copy())

    def palette(self, times: Floats) -> Image:
        """The colours of a few frames, for all of them; the last is one: a run ends in a state of its own colour."""
        from PIL import Image

        rare_too = Image.Quantize.MAXCOVERAGE
        few = [np.asarray(self.frame(t_s)) for t_s in [*times[:: -(-len(times) // 8)].tolist(), times[-1]]]
        return Image.fromarray(np.vstack(few)).quantize(GIF_COLORS, rare_too)
