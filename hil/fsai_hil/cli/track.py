"""`fsai-vcu track`: make a circuit by the rules from a seed, or describe a track."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from textwrap import fill
from typing import Any, Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks import FILES, NAMES, STYLES, Track, TrackKind, as_csv, load_track
from fsai_hil.simulator.tracks.layout import NOSE_M
from fsai_hil.simulator.tracks.walking import BEFORE_M
from fsai_vcu.cli.main import UserError, WrongUse
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.planning.pose import resampled_ring
from fsai_vcu.diagnostics.statistics.measure import as_json
from fsai_vcu.files import write_whole
from fsai_vcu.interface.enums import Ami
from fsai_vcu.printable import drawn

STEP_M: Final = 0.25
OVER: Final = 8  # steps to either side, of which a bend is made: cones of a file do not stand on a smooth curve
EXAMPLE = "fsai-vcu track --seed 7 -o seven.csv --plot seven.png\n  fsai-vcu track small_oval"
ABOUT = f"""\
The rules: a lane of 3 m or more, straights of 80 m or less, turns of 50 m outside
diameter or less, hairpins of 9 m or more, cones at most 5 m apart, a lap of 200 to
500 m. Styles: mixed, open (wide turns), islands (mostly hairpins, whose straights
can lie a lane's width apart), tight (hairpins from 9 m: tighter than a car with
21 deg of steering can turn), sharp (corners, hairpins and chicanes from 1.4 m
inside radius: the sharpest that the rules allow, and some sharper). drive --track
takes what is named here.
{fill(f"Files: {FILES} (YAML needs PyYAML).", 82)}
The line is at the file's timing posts, else at its gate of big orange cones, else
at one of small ones, else {BEFORE_M:.1f} m ahead of the staged car; a skidpad's is between
its rings. The car starts at the file's car_start, unless its nose is on or past the
line there."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("track", nargs="?", metavar="FILE|NAME", help=f"a file, {', '.join(NAMES)}")
    add("--seed", type=int, metavar="N", help="instead: make a circuit, for a seed always the same")
    add("--style", choices=list(STYLES), help="with --seed: the style of the circuit, as above (mixed)")
    add("-o", "--output", type=Path, metavar="FILE.csv", help="save the track")
    add("--plot", type=Path, metavar="FILE.png", help="save a picture of the track")
    add("--json", action="store_true", help="print the facts as one JSON object")


def run(args: argparse.Namespace) -> int:
    """Load the track, and print, save and draw it as the arguments ask; return the exit status."""
    if (args.track is None) == (args.seed is None) or (args.style and args.seed is None):
        raise WrongUse("give a file, a name, or --seed N (optionally --style)")
    name = args.track or f"generated-{args.seed}{f'-{args.style}' if args.style else ''}"
    try:
        track = load_track(name)
        facts = _facts(track)
        print(json.dumps(as_json(facts, 3)) if args.json else "\n".join(_words(facts)))
        if args.output:
            write_whole(args.output, as_csv(track, track.staging(_mission(track), NOSE_M)).encode())
            print(f"saved {args.output}", file=sys.stderr if args.json else sys.stdout)
        if args.plot:
            _draw(track, args.plot, _title(facts))
            print(f"saved {args.plot}", file=sys.stderr if args.json else sys.stdout)
    except OSError as error:
        raise UserError(f"{error.filename}: {error.strerror}") from error
    except ValueError as error:
        raise UserError(str(error)) from error
    return 0


def _mission(track: Track) -> Ami:
    """The mission for which the kind of track is made."""
    kinds = {TrackKind.ACCELERATION: Ami.ACCELERATION, TrackKind.SKIDPAD: Ami.SKIDPAD}
    return kinds.get(track.kind, Ami.AUTOCROSS)


def _facts(track: Track) -> dict[str, Any]:
    """Facts of a track; None: it has no such thing."""
    colors = Counter(ConeColor(color).name.lower() for color in track.cone_colors)
    facts: dict[str, Any] = {
        "name": track.name,
        "kind": track.kind.value,
        "length_m": track.length_m or None,
        "cones": dict(colors.most_common()),
        **dict.fromkeys(("start_line", "car", "tightest_radius_m", "lane_m")),
    }
    if line := track.start_line:
        facts["start_line"] = {**_place(line), "known_by": track.line_by}
        start = track.staging(_mission(track), NOSE_M)
        facts["car"] = {**_place(start), "before_line_m": _before_m(track, line, start)}
    if not track.closed or track.centreline_m is None:
        return facts
    middle = resampled_ring(track.centreline_m, STEP_M)
    ahead, behind = (np.roll(middle, shift, axis=0) - middle for shift in (-OVER, OVER))
    turn = np.arctan2(ahead[:, 1], ahead[:, 0]) - np.arctan2(-behind[:, 1], -behind[:, 0])
    bend = np.abs(np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi)
    facts["tightest_radius_m"] = float(OVER * STEP_M / bend.max())
    sides = [
        resampled_ring(border, STEP_M) for border in (track.left_border_m, track.right_border_m) if border is not None
    ]
    width = sum(np.hypot(*(middle[:, None] - side[None]).T).min(axis=0) for side in sides)
    facts["lane_m"] = [float(np.min(width)), float(np.max(width))]
    return facts


def _words(facts: Mapping[str, Any]) -> Iterator[str]:
    """Yield the facts of a track, a line for each."""
    yield _title(facts)
    yield f"cones: {', '.join(f'{count} {color}' for color, count in facts['cones'].items()) or 'none'}"
    if line := facts["start_line"]:
        yield f"start line: {_at(line)}, crossed towards {round(line['yaw_deg'])} deg: {line['known_by']}"
        yield f"car: {_at(facts['car'])}, its nose {facts['car']['before_line_m']:.1f} m before the line"
    if lane_m := facts["lane_m"]:
        yield f"tightest radius of the middle of the lane: {facts['tightest_radius_m']:.1f} m"
        yield f"lane: {lane_m[0]:.1f} to {lane_m[1]:.1f} m wide"


def _title(facts: Mapping[str, Any]) -> str:
    return f"{facts['name']}: {facts['kind']}" + (f", {facts['length_m']:.0f} m" if facts["length_m"] else "")


def _place(pose: Pose) -> dict[str, Any]:
    x_m, y_m = (round(value, 2) + 0.0 for value in (pose.x_m, pose.y_m))  # -0.0 is 0
    return {"x_m": x_m, "y_m": y_m, "yaw_deg": math.degrees(pose.yaw_rad)}


def _at(place: Mapping[str, Any]) -> str:
    return f"{place['x_m']:.2f}, {place['y_m']:.2f} m"


def _before_m(track: Track, line: Pose, start: Pose) -> float:
    """The way of the nose of the car at `start` to the line, along the lane if one is known."""
    nose = start.ahead(NOSE_M)
    before_m = -float(line.seen(*nose)[0])
    if not track.closed or track.centreline_m is None or math.hypot(line.x_m - nose[0], line.y_m - nose[1]) < 10.0:
        return before_m
    step_m = track.length_m / len(track.centreline_m)
    return track.length_m - step_m * float(np.argmin(np.hypot(*(track.centreline_m - nose).T)))


def _draw(track: Track, path: Path, title: str) -> None:
    """Draw the track with the car at its start into a file."""
    path.parent.stat()  # before seconds go into matplotlib: it fails where there is no such folder
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        raise UserError("matplotlib is not installed; install it with: pip install 'fsai-vcu[plot]'") from None
    figure, plan = pyplot.subplots(figsize=(9.0, 9.0), layout="constrained")
    from fsai_hil.simulator.plot import car_outline, draw_track  # slow to import

    draw_track(plan, track)
    if track.start_line is not None:
        start = track.staging(_mission(track), NOSE_M)
        for box, name in zip(car_outline(start, 0.0), ("car at the start", *[None] * 4), strict=True):
            plan.plot(*np.vstack([box, box[:1]]).T, color="#203864", linewidth=0.8, label=name)
        plan.annotate("", start.ahead(NOSE_M + 4.0), start.ahead(NOSE_M), arrowprops={"arrowstyle": "->"})
        plan.legend(loc="best")
    plan.set(aspect="equal", xlabel="x, m", ylabel="y, m", title=drawn(title))
    try:
        figure.savefig(path)
    finally:
        pyplot.close(figure)
