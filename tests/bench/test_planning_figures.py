"""The benchmark of planning: its figures, and what it calls a failure."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from fsai_hil.bench import __main__ as command
from fsai_hil.bench import planning
from fsai_hil.simulator.tracks import Track
from fsai_hil.simulator.tracks.built_in import circuit_from
from fsai_hil.simulator.tracks.generator import line_of
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Plan
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.planning.pose import gaps


def hairpins(lane_m: float, gap_m: float) -> Track:
    """Two lanes beside each other, their inner rows so far apart, with a hairpin of 9 m outside at each end.

    A hairpin wider than the two lanes is reached through a bend outward, as the bulb of a lamp from its neck.
    """
    turn_m, neck_m = 0.5 * (9.0 - lane_m), 8.0  # radii of the middle
    spread = math.acos(min(1.0, (0.5 * (lane_m + gap_m) + neck_m) / (turn_m + neck_m)))
    neck, turn = (neck_m * spread, -1.0 / neck_m), (turn_m * (math.pi + 2.0 * spread), 1.0 / turn_m)
    track = circuit_from("hairpins", line_of(((25.0, 0.0), neck, turn, neck) * 2)[:-1], 12.0, lane_m, 3.5)
    # Where both lanes have a blue cone in the same row one is laid.
    near = np.tril(gaps(track.cones_xy_m, track.cones_xy_m) < 1.2, -1)
    blue = track.cone_colors == ConeColor.BLUE
    alone = ~(near & blue & blue[:, None]).any(axis=1)
    return replace(track, cones_xy_m=track.cones_xy_m[alone], cone_colors=track.cone_colors[alone])


def test_a_hairpin_beside_its_own_lane_is_found() -> None:
    track = hairpins(3.5, 0.5)
    row = planning.judged(track, planning.middle_of(track, "hairpins"), planning.CONDITIONS[0], "hairpins")
    assert row.failed_at_m == () and row.looks > 50
    assert 0.0 < row.error_m <= row.error_max_m


def test_paths_onto_the_cones_or_none_are_failures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    honest = Planner.on_cones
    calls = 0

    def wrong(planner: Planner, seen: ConeObservation, motion: Motion) -> Plan | None:
        nonlocal calls
        calls += 1
        plan = honest(planner, seen, motion)
        assert plan is not None
        path = plan.path_m + np.array([0.0, 1.2]) if calls % 4 == 1 else plan.path_m[:4]
        return replace(plan, path_m=path)

    monkeypatch.setattr(Planner, "on_cones", wrong)
    page = tmp_path / "page.md"
    assert command.main(["planning", "small_oval", "--condition", "ideal", "-o", str(page)]) == 0
    printed = capsys.readouterr().out
    assert "100.00" in printed and printed in page.read_text()


def test_a_track_that_is_no_closed_lane_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["planning", "acceleration"]) == 2
    assert "not a closed lane" in capsys.readouterr().err
