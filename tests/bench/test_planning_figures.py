"""The benchmark of planning: its figures, and what it calls a failure."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from fsai_hil.bench import __main__ as command
from fsai_hil.bench import planning
from fsai_vcu.core.driving import ConeObservation, Motion, Plan
from fsai_vcu.core.planning.planner import Planner


def test_a_hairpin_beside_its_own_lane_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "figures.json"
    page = tmp_path / "page.md"
    assert (
        command.main(["planning", "hairpin-3.5-0.5", "--condition", "ideal", "--json", str(file), "-o", str(page)]) == 0
    )
    row = json.loads(file.read_text())[0]
    assert row["failed_at_m"] == [] and row["looks"] > 50
    assert 0.0 < row["error_m"] <= row["error_max_m"]
    assert capsys.readouterr().out in page.read_text()


def test_paths_onto_the_cones_or_none_are_failures(monkeypatch: pytest.MonkeyPatch) -> None:
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
    [row] = planning.bench(["hairpin-3.5-2"], planning.CONDITIONS[:1])
    assert len(row.failed_at_m) == row.looks


def test_a_track_that_is_no_closed_lane_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["planning", "acceleration"]) == 2
    assert "not a closed lane" in capsys.readouterr().err
