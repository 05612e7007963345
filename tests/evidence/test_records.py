"""A campaign's record survives a kill, goes on where it was, and belongs to one campaign."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsai_hil.evidence.campaign.cases import CampaignPlan
from fsai_hil.evidence.campaign.record import RecordError, Writer, files, read
from fsai_hil.evidence.campaign.runner import batches, header_of


def plan(seed: int = 1) -> CampaignPlan:
    return CampaignPlan(seed, runs=20, full=3, faults=("go_off", "status_lost"))


def line(index: int, full: bool = False) -> dict[str, object]:
    return {"index": index, "full": full, "verdict": "ok", "fault": "go_off"}


def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    with Writer(tmp_path / "record.jsonl", header_of(plan())) as writer:
        writer.add(line(3))
        writer.add(line(3, full=True))
    header, runs = read(tmp_path / "record.jsonl")
    assert header == header_of(plan())
    assert [(run["full"], run["index"]) for run in runs] == [(False, 3), (True, 3)]


def test_a_line_cut_short_by_a_kill_is_left_out_and_driven_again(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    with Writer(path, header_of(plan())) as writer:
        writer.add(line(0))
        writer.add(line(1))
    path.write_bytes(path.read_bytes()[:-10])
    with Writer(path, header_of(plan())) as writer:
        assert writer.done == {(False, 0)}
        writer.add(line(1))
    assert [run["index"] for run in read(path)[1]] == [0, 1]
    assert all(json.loads(text) for text in path.read_text().splitlines())


def test_a_record_is_not_mixed_by_accident(tmp_path: Path) -> None:
    path = tmp_path / "record.jsonl"
    Writer(path, header_of(plan(1))).close()
    with pytest.raises(RecordError, match="another campaign"):
        Writer(path, header_of(plan(2)))


def test_the_digest_covers_the_code_that_decides_a_run() -> None:
    assert {
        "fsai_vcu/core/supervision/gate.py",
        "fsai_vcu/interface/codec.py",
        "fsai_vcu/runtime/engine.py",
        "fsai_vcu/diagnostics/log/reader.py",
        "fsai_vcu/diagnostics/statistics/quantiles.py",
        "fsai_hil/rules/checker.py",
        "fsai_hil/simulator/lockstep.py",
        "fsai_hil/evidence/campaign/catalogue.py",
        "ads_dv_2026.dbc",
    } <= set(files())
    assert not [name for name in files() if {"cli", "mutation", "fuzz.py", "measure.py"} & set(Path(name).parts)]


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("not a record\n")
    with pytest.raises(RecordError, match="not a line of a fault campaign"):
        read(path)
    path.write_text('{"a": 1}\n')
    with pytest.raises(RecordError, match="is not the record"):
        read(path)


def test_each_task_is_in_one_batch_full_length_runs_first() -> None:
    tasks = [task for batch in batches(plan(), plan().tasks()) for task in batch]
    assert sorted(tasks) == sorted(plan().tasks())
    assert [full for full, _ in tasks[:3]] == [True] * 3
