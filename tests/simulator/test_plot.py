"""The picture and the film of a run: what is in them, and what is said where there can be none."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from fsai_hil.simulator import animation
from fsai_hil.simulator.animation import FRAMES_PER_S, Views, animate, why_not
from fsai_hil.simulator.car import CarTruth, Pose
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.plot import picture
from fsai_hil.simulator.world import MissionRun, PathSample, World, WorldSetup
from fsai_vcu.core.driving import Plan
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.lights import LIGHTS

pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'fsai-vcu[plot]'")
from matplotlib.colors import to_hex

DRIVING = AsState.AS_DRIVING


@pytest.fixture
def run() -> MissionRun:
    """Down the acceleration's lane for 2 s, out of it over the cone at (20, 1.5), and back."""
    run = World(WorldSetup(missions=[Ami.ACCELERATION], gps=False)).run
    for index, t_s in enumerate(np.arange(0.0, 2.001, 0.05).tolist()):
        x_m = -4.0 + 20.0 * t_s
        y_m = 1.5 if 17.0 < x_m < 19.0 else 6.0 if 19.0 < x_m < 30.0 else 0.0
        run.samples.append(PathSample(t_s, x_m, y_m, 0.0, 20.0, 20.0, 22.0, 1.0, 2.0, 0.5, 0.0, int(DRIVING)))
        truth = CarTruth(round(t_s * 1e9), Pose(x_m, y_m, 0.0), 20.0, 0.0, 0.0, (0.0,) * 4, 20.0 * t_s)
        run.judge.observe(truth, DRIVING if index else AsState.AS_READY)
    assert len(run.judge.hit_cones) >= 1 and len(run.judge.left_course_m) == 1
    return run


def test_the_picture_marks_hits_departures_laps_and_states(run: MissionRun) -> None:
    figure = picture(run)
    plan, speed, steering, pedals, *_ = figure.axes
    marks = {str(each.get_label()): len(each.get_offsets()) for each in plan.collections if hasattr(each, "get_sizes")}
    hit = len(run.judge.hit_cones)
    assert marks[f"cones hit: {hit}"] == hit and marks["off course: 1"] == 1
    lines = {str(line.get_label()) for axes in (plan, speed, steering, pedals) for line in axes.lines}
    assert lines >= {"start line", "finish line", "speed", "speed limit asked", "steering asked", "steering given"}
    assert lines >= {"throttle", "brake"}
    crossed = [line for line in speed.lines if len(line.get_xdata()) == 2 and line.get_linestyle() == ":"]
    assert len(crossed) == len(run.judge.crossings_s) == 1
    (band,) = speed.patches
    assert band.get_label() == "AS_DRIVING" and to_hex(band.get_facecolor()) == LIGHTS[DRIVING].fill
    (outline,) = [line.get_ydata() for line in steering.lines if line.get_label() == "steering asked"]
    assert set(outline) == {2.0}


def test_a_long_title_is_broken_and_not_cut(run: MissionRun) -> None:
    run.judge._reasons += ["did not do what was asked of it here"] * 9
    figure = picture(run)
    figure.draw_without_rendering()
    title = figure._suptitle  # type: ignore[attr-defined]
    assert "\n" in title.get_text()
    box = title.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1


def test_a_gif_has_a_frame_for_each_of_its_instants(run: MissionRun, tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "run.gif"
    for speed in (2.0, 4.0):
        assert animate("drive", path, run, [], speed) == int(2.0 * FRAMES_PER_S / speed) + 1
        with Image.open(path) as film:
            assert film.n_frames == int(2.0 * FRAMES_PER_S / speed) + 1


def test_a_long_gif_is_sped_up_and_says_so(
    run: MissionRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(animation, "GIF_FRAMES", 5)
    assert animate("drive", tmp_path / "run.gif", run, [], 1.0) == 6
    assert "sped up to 5.0 times real time" in capsys.readouterr().err


def test_views_are_the_cones_and_the_path_in_the_world() -> None:
    lockstep = Lockstep(WorldSetup(missions=[Ami.TRACKDRIVE], noise_level=0.0, gps=False))
    views, car, cones = Views(), lockstep.world.car, lockstep.world.run.track.cones_xy_m
    views.watch(lockstep)
    there = Pose(1.0, 0.5, 0.3)
    for t_ns, pose in ((5, there), (6, Pose(2.0, 0.5, 0.4))):
        car.place(pose)
        lockstep.detector(lockstep.world.see_cones(t_ns))
        # It is planned from where the car was when the cones were seen.
        lockstep.computer.plan = Plan(5, 1, Ami.TRACKDRIVE, np.array([[1.0, 0.0], [4.0, 2.0]]))
    before, now = views.views
    assert len(now.cones_m) > 4 and before.path_m.shape == (0, 2)
    for x, y in now.cones_m:
        assert np.hypot(*(cones - (x, y)).T).min() < 1e-6
    assert now.path_m == pytest.approx(np.array([there.ahead(1.0, 0.0), there.ahead(4.0, 2.0)]))


def test_what_a_film_needs_is_said_before_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    assert why_not(Path("run.gif")) is None
    assert "neither a .gif nor an .mp4" in str(why_not(Path("run.avi")))
    monkeypatch.setattr(animation, "_ffmpeg", lambda: None)
    assert "apt install ffmpeg" in str(why_not(Path("run.mp4")))
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "pip install 'fsai-vcu[plot]'" in str(why_not(Path("run.gif")))
