"""A record survives a kill, goes on where it was, and is never mixed with another or lost."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fsai_hil.evidence.campaign.cases import CampaignPlan
from fsai_hil.evidence.campaign.runner import batches
from fsai_hil.evidence.work import RecordError, RecordFile, driven_files, read

KIND = "campaign"
HEADER = {KIND: 1, "seed": 1}


def written(path: Path, *results: Any) -> Path:
    with RecordFile(path, HEADER) as record:
        for result in results:
            record.add(result)
    return path


def test_what_was_written_is_read_again(tmp_path: Path) -> None:
    path = written(tmp_path / "folder" / "record.jsonl", {"index": 3}, [4, "µ"])
    assert read(path, KIND) == (HEADER, [{"index": 3}, [4, "µ"]])


def test_a_line_cut_short_by_a_kill_is_left_out_and_written_over(tmp_path: Path) -> None:
    path = written(tmp_path / "record.jsonl", {"index": 0}, {"index": 1})
    path.write_bytes(path.read_bytes()[:-4])
    with RecordFile(path, HEADER) as record:
        assert record.results == [{"index": 0}]
        record.add({"index": 1})
    assert read(path, KIND) == (HEADER, [{"index": 0}, {"index": 1}])
    assert all(json.loads(text) for text in path.read_text().splitlines())


@pytest.mark.parametrize(("header", "resume"), [({**HEADER, "seed": 2}, True), (HEADER, False)])
def test_a_record_is_neither_mixed_nor_lost(tmp_path: Path, header: dict[str, Any], resume: bool) -> None:
    path = written(tmp_path / "record.jsonl", 1)
    with RecordFile(path, header, resume=resume) as record:
        assert record.kept_as == tmp_path / "record-before-1.jsonl" and not record.results
    assert read(record.kept_as, KIND) == (HEADER, [1])
    assert read(path, KIND) == (header, [])


def test_two_processes_do_not_write_to_one_record(tmp_path: Path) -> None:
    with RecordFile(tmp_path / "record.jsonl", HEADER), pytest.raises(RecordError, match="being written by another"):
        RecordFile(tmp_path / "record.jsonl", {**HEADER, "seed": 2})


def test_the_digest_covers_the_code_that_decides_a_run() -> None:
    assert {
        "fsai_vcu/core/supervision/gate.py",
        "fsai_vcu/interface/codec.py",
        "fsai_vcu/runtime/turns.py",
        "fsai_vcu/diagnostics/log/reader.py",
        "fsai_vcu/diagnostics/statistics/quantiles.py",
        "fsai_hil/rules/checker.py",
        "fsai_hil/simulator/lockstep.py",
        "fsai_hil/evidence/campaign/catalogue.py",
        "ads_dv_2026.dbc",
    } <= set(driven_files())
    assert not [name for name in driven_files() if {"cli", "mutation", "fuzz.py", "measure.py"} & set(Path(name).parts)]


@pytest.mark.parametrize("text", ["not a record\n", '{"a": 1}\n', "[1]\n"])
def test_a_file_that_is_no_record_is_refused_and_kept(tmp_path: Path, text: str) -> None:
    path = tmp_path / "notes.txt"
    path.write_text(text)
    with pytest.raises(RecordError, match="not a"):
        RecordFile(path, HEADER)
    assert path.read_text() == text


def test_each_task_is_in_one_batch_full_length_runs_first() -> None:
    plan = CampaignPlan(1, runs=20, full=3, faults=("go_off", "status_lost"))
    tasks = [task for batch in batches(plan, plan.tasks()) for task in batch]
    assert sorted(tasks) == sorted(plan.tasks())
    assert [full for full, _ in tasks[:3]] == [True] * 3
