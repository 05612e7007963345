"""The campaign itself: every kind once, spread over processes; killed and resumed; and able to fail."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from msgspec.structs import replace

from fsai_hil.evidence.campaign import runner
from fsai_hil.evidence.campaign.cases import CampaignPlan, Case, case_from_spec
from fsai_hil.evidence.campaign.catalogue import ROWS
from fsai_hil.evidence.campaign.runner import KIND, SNAPSHOTS, ClusterError, header_of, on_cluster
from fsai_hil.evidence.campaign.scenario import run_case
from fsai_hil.evidence.seeded import SEEDS, Patches
from fsai_hil.evidence.work import digest, read
from fsai_vcu.cli.main import main
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.supervision import supervisor
from fsai_vcu.core.supervision.supervisor import Asked
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.messages import WheelSpeeds

CAMPAIGN = [sys.executable, "-m", "fsai_vcu.cli.main", "campaign"]
SHORT = ["--full", "0", "--world-seeds", "1", "--window", "1"]
EACH = 28
ONE_CAR = [*SHORT, "--missions", "autonomous_demo", "--revisions", "2026"]  # nobody plans a path in it: quickly driven


def test_faults_of_a_sample_end_as_the_safety_rules_demand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The short form of the campaign, of each part of the catalogue some: `make campaign` has every kind.

    On the car of 2021, which has nearly all; each mission and car costs drives to its beginning. Along a path is driven
    what only happens there, in the 2026 car that other tests here have driven to its beginning.
    """
    possible = [kind for kind in ROWS if Ami.ACCELERATION in kind.missions and len(kind.revisions) == 2]
    kinds = possible[::EACH]  # alike faults stand together
    record, table = tmp_path / "record.jsonl", tmp_path / "faults.md"
    by_mission: dict[Ami, list[str]] = {Ami.ACCELERATION: [], Ami.AUTONOMOUS_DEMO: []}
    for kind in kinds:
        by_mission[Ami.AUTONOMOUS_DEMO if Ami.AUTONOMOUS_DEMO in kind.missions else Ami.ACCELERATION].append(kind.name)
    for mission, names in by_mission.items():
        chosen = ["--missions", mission.name.lower(), "--runs", str(len(names)), "--faults", ",".join(names)]
        chosen += ["--revisions", "2026" if mission is Ami.ACCELERATION else "2021"]
        status = main(["campaign", *SHORT, "--jobs", "1", "--out", str(tmp_path), "-o", str(table), *chosen])
        printed = capsys.readouterr().out
        assert status == 0 and "every run ended as the rules demand" in printed, printed
        assert sorted(run["fault"] for run in read(record, KIND)[1]) == sorted(names)
    text = table.read_text()
    assert main(["campaign", "--table", str(record)]) == 0
    assert capsys.readouterr().out == f"{text}\n"
    assert all(f"| `{name}` |" in text for name in names)
    assert f"Worse than the rules allow: 0 of {len(names)} runs" in text
    assert f"signal databases): `{digest()}`." in text


# ---------------------------------------------------------------- it can fail


def _old_confirm(state: Any, role: str, run_id: int) -> Any:
    return replace(state, confirmed=state.confirmed | {role}) if run_id == state.run_id else state


def _fails_on_nothing(original: Callable[..., Any]) -> Callable[..., Any]:
    def on_cones(planner: Any, seen: Any, motion: Any) -> Any:
        if not len(seen.xy_m):
            raise ValueError("nothing to plan with")
        return original(planner, seen, motion)

    return on_cones


def _fails(*_: object) -> Any:
    raise ZeroDivisionError("of the wheel speeds")


def _stops_for_anything_else(original: Callable[..., Any]) -> Callable[..., Any]:
    def begin_stop(state: Any, cause: object, *rest: Any) -> Any:
        return state if cause is Asked.MISSION_DONE else original(state, cause, *rest)

    return begin_stop


def _seed(name: str) -> Patches:
    return next(seed.patches for seed in SEEDS if seed.name == name)


# One defect of each way in which a run can be worse than the rules allow, where it takes a run to see it: how late is
# too late is in test_verdicts.py, and `make verify` and the fuzz find many more.
SEEDED: dict[str, tuple[str, Patches]] = {
    "no reaction": ("speeds_lost:duration=1500", _seed("lost wheel speeds are only reported")),
    "no ESTOP_REQUEST": (
        "intruder:message=0x510,frames=20,period=1,payload=zeros",
        _seed("intruder is only reported"),
    ),
    "torque stays": (
        "status_undefined_as_state:duration=80,state=9",
        _seed("an AS_STATE that nobody knows is only reported"),
    ),
    "implausible counts": ("wheels_dead:duration=2000", _seed("a pulse count contradicts no wheel speed")),
    "an implausible wheel": ("wheel_offset:wheel=fl,size=290", _seed("odd wheels never ask for the emergency")),
    "a rule of the bus": ("controller_pumping:duration=2000,period=40", _seed("torque rises right after the brake")),
    "driving on by itself": ("planner_restarted:duration=100", ((supervisor, "confirm", _old_confirm),)),
    "the end of the mission is missed": (
        "planner_finishes_early",
        ((supervisor, "_begin_stop", _stops_for_anything_else(supervisor._begin_stop)),),
    ),
    "the planner's process ends": (
        "detector_blind:duration=1500",
        ((Planner, "on_cones", _fails_on_nothing(Planner.on_cones)),),
    ),
    "the bridge's process ends": ("remote_estop", ((supervisor, "TAKES", {WheelSpeeds: _fails}),)),
}


def _case(spec: str) -> Case:
    name, _, parameters = spec.partition(":")
    return case_from_spec(
        f"{name}:after=5500,{parameters}", mission=Ami.ACCELERATION, revision="2026", seed=0, full=False
    )


# Of a stop that is missing, of an implausible value and of a process that ends, one each is shown in short.
REPEATED = ("no ESTOP_REQUEST", "torque stays", "an implausible wheel", "the planner's process ends")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name in REPEATED else name for name in SEEDED]
)
def test_the_campaign_reports_a_defect_put_in_on_purpose(name: str) -> None:
    spec, patches = SEEDED[name]
    case = _case(spec)
    SNAPSHOTS.rig(case)  # driven to its beginning without the defect
    with ExitStack() as stack:
        for owner, attribute, value in patches:
            stack.enter_context(patch.object(owner, attribute, value))
        broken = run_case(case, SNAPSHOTS, 1000)
    assert broken["verdict"] == "worse", f"not noticed: {broken}"
    assert broken["reasons"]


def test_a_failed_campaign_prints_the_line_that_replays_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with patch.object(supervisor, "ask_emergency", lambda state, *rest: state):
        chosen = ["--runs", "2", "--jobs", "2", "--faults", "emergency_asked"]
        status = main(["campaign", *chosen, "--out", str(tmp_path), *ONE_CAR])
    printed = capsys.readouterr().out
    assert status == 1
    worse = [run for run in read(tmp_path / "record.jsonl", KIND)[1] if run["verdict"] == "worse"]
    assert len(worse) == 2
    assert all(f"worse: {run['replay']}" in printed for run in worse)
    assert "drives on, where the rules demand: EMERGENCY_BRAKE by ESTOP_REQUEST" in printed
    assert "2 worse than the rules allow" in printed


# ---------------------------------------------------------------- killed, interrupted, resumed


def _lines(path: Path) -> int:
    return len(path.read_text().splitlines()) if path.exists() else 0


def test_a_campaign_continues_with_the_same_sources_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = tmp_path / "record.jsonl"
    arguments = ["--runs", "400", "--faults", "go_off,emergency_asked", "--jobs", "1", *ONE_CAR]
    command = [*CAMPAIGN, *arguments, "--out", str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, start_new_session=True) as run:
        while _lines(record) < 2:
            assert run.poll() is None, run.communicate()
            time.sleep(0.02)
        os.killpg(run.pid, signal.SIGINT)
        _, error = run.communicate(timeout=120)
    assert run.returncode == 130
    assert "--resume goes on" in error and "Traceback" not in error
    kept = _lines(record) - 1
    assert 1 <= kept < 400
    arguments[1] = str(kept + 2)
    assert main(["campaign", *arguments, "--out", str(tmp_path), "--resume"]) == 0
    assert f"{kept} runs are in" in capsys.readouterr().err
    driven = [run["index"] for run in read(record, KIND)[1]]
    assert len(driven) == len(set(driven)) and set(driven) >= set(range(kept + 2))
    arguments[1], before = "1", record.read_text()
    monkeypatch.setattr(runner, "digest", lambda: "other")
    assert main(["campaign", *arguments, "--out", str(tmp_path), "--resume"]) == 0
    assert "is now record-before-1.jsonl: it is of other sources" in capsys.readouterr().err
    assert (tmp_path / "record-before-1.jsonl").read_text() == before
    assert read(record, KIND)[0]["sources"] == "other"
    assert main(["campaign", *arguments, "--out", str(tmp_path)]) == 0
    assert "is now record-before-2.jsonl: without --resume a campaign begins again" in capsys.readouterr().err


# ---------------------------------------------------------------- on a cluster


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    distributed: Any = import_module("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp"
    ) as made:
        yield made.scheduler_address


def test_a_dask_cluster_drives_the_same_campaign(cluster: str, tmp_path: Path) -> None:
    arguments = ["campaign", "--runs", "2", "--faults", "go_off,emergency_asked", *ONE_CAR]
    assert main([*arguments, "--dask", cluster, "--out", str(tmp_path / "there")]) == 0
    assert main([*arguments, "--jobs", "1", "--out", str(tmp_path / "here")]) == 0
    there, here = (read(tmp_path / place / "record.jsonl", KIND)[1] for place in ("there", "here"))
    assert _untimed(there) == _untimed(here)


def _untimed(runs: list[dict[str, Any]]) -> list[str]:
    kept = [{name: value for name, value in run.items() if name != "wall_s"} for run in runs]
    return sorted(json.dumps(run) for run in kept)


def test_without_dask_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["campaign", "--runs", "1", "--full", "0", "--dask", "tcp://127.0.0.1:1", "--out", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert "pip install 'fsai-vcu[dask]'" in error and error.count("\n") == 1


def test_a_cluster_of_other_sources_is_refused(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = CampaignPlan(1, 1)
    other = {**header_of(plan), "sources": "other"}
    monkeypatch.setattr(runner, "header_of", lambda plan: other)
    with pytest.raises(ClusterError, match=f"has other sources \\({digest()}, here are other\\)"):
        next(on_cluster(plan, plan.tasks(), cluster))


def test_a_cluster_that_is_not_there_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "CONNECT_TIMEOUT_S", 0.5)
    plan = CampaignPlan(1, 1)
    with pytest.raises(ClusterError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        next(on_cluster(plan, plan.tasks(), "tcp://127.0.0.1:9"))
