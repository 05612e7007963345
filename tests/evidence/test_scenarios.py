"""Runs of the campaign: a copy of a snapshot is the drive itself, and a replay the run that was recorded."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from fsai_hil.evidence.campaign.cases import CampaignPlan, Case, Since
from fsai_hil.evidence.campaign.runner import SNAPSHOTS, drive_batch
from fsai_hil.evidence.campaign.scenario import Scenario, drive_to, power_up, run_case
from fsai_vcu.cli.main import main
from fsai_vcu.interface.enums import Ami


def case(fault: str, **params: object) -> Case:
    """In the mission without a path, which is quickly driven."""
    return Case(fault, Ami.AUTONOMOUS_DEMO, "2026", 0, Since.DRIVING, 3500, {"chance": 3, **params})


def test_a_run_from_a_copied_snapshot_is_the_run_from_power_up() -> None:
    """With a fault of chance; that of detector and planner goes on from a copy in simulator/test_snapshot.py."""
    one = case("steering_sensor_noisy", size=3.0)
    copied = [Scenario(one, SNAPSHOTS.rig(one), 1000) for _ in range(2)]
    rig = power_up(one.world)
    assert one.leg_ms is not None
    drive_to(rig, one.leg_ms)
    whole = Scenario(one, rig, 1000)
    for scenario in (*copied, whole):
        while not scenario.over:
            scenario.step()
    first, second = copied
    assert _all_of(first) == _all_of(whole)
    assert _all_of(second) == _all_of(whole), "the first copy's run has changed the snapshot"


def _all_of(scenario: Scenario) -> tuple[object, ...]:
    rig = scenario.rig
    return scenario.verdict(), scenario.seen, str(rig.wire), rig.wire.seen, rig.world.car.truth()


def test_the_order_in_which_cases_are_driven_changes_nothing() -> None:
    faults = ("steering_sensor_noisy", "wheel_very_noisy")
    plan = CampaignPlan(5, 2, 0, faults, (Ami.AUTONOMOUS_DEMO,), ("2026",), 1, 1000)
    forward = drive_batch(plan, [(False, 0), (False, 1)])
    backward = drive_batch(plan, [(False, 1), (False, 0)])
    assert [_untimed(line) for line in forward] == [_untimed(line) for line in reversed(backward)]


def _untimed(line: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in line.items() if name != "wall_s"}


def test_a_run_in_which_the_mission_ends_is_seen_to_its_end() -> None:
    """A second after this fault the car is behind the line and brakes: what follows is AS_FINISHED."""
    params = {"chance": 3, "size": 1.0}
    one = Case("steering_sensor_noisy", Ami.ACCELERATION, "2026", 0, Since.DRIVING, 13_400, params)
    assert run_case(one, SNAPSHOTS)["end"] == "ON"


def test_a_run_ends_early_once_nothing_can_happen_any_more() -> None:
    line = run_case(case("emergency_asked"), SNAPSHOTS)
    assert line["verdict"] == "ok" and line["end"] == "ESTOP"
    assert line["sim_s"] < 5.0


@pytest.mark.long
def test_a_full_length_run_goes_from_power_up_to_the_end() -> None:
    one = Case("go_off", Ami.AUTONOMOUS_DEMO, "2021", 0, Since.READY, 3000, {"chance": 0}, full=True)
    line = run_case(one, SNAPSHOTS)
    assert line["verdict"] == "ok" and not line["applies"]
    assert line["sim_s"] > 15.0


def test_a_replay_is_the_recorded_run(capsys: pytest.CaptureFixture[str]) -> None:
    plan = CampaignPlan(1, 1, 0, ("manual_asked",), (Ami.AUTONOMOUS_DEMO,), ("2026",), 1)
    recorded = run_case(plan.case(0), SNAPSHOTS)
    arguments = recorded["replay"].split()[1:]
    assert main([*arguments, "--json"]) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed == {name: value for name, value in recorded.items() if name in replayed}


def test_the_report_has_what_the_bridge_saw_did_and_when(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec, log = "controller_silent:after=5000,duration=1500", tmp_path / "bus.log"
    again = "controller_silent:since=driving,after=5000,duration=1500"
    assert main(["drive", "--mission", "autonomous_demo", "--fault", spec, "--log", str(log)]) == 0
    assert " 513#" in log.read_text()
    printed = capsys.readouterr().out
    again = f"  fsai-vcu drive --mission autonomous_demo --revision 2026 --seed 0 --fault {again} --log {log}"
    assert printed.splitlines()[1] == again, "every option, and no parameter that the seed gives"
    assert "required: " in printed and "as the safety rules demand" in printed
    assert "bridge sees: the vehicle command is stale" in printed
    assert "bridge: AS_DRIVING, torque 0 until the stale input is fresh again" in printed
    assert "bridge stops the car because the vehicle command is stale" in printed
    assert "car: AS_FINISHED (mission FINISHED at rest)" in printed
    assert re.search(
        r"observed: service-brake stop, FINISHED \(service brake after \d+ ms, safe after \d+ ms\)", printed
    )


def test_the_catalogue_is_listed_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", "--list-faults"]) == 0
    listed = capsys.readouterr().out
    assert main(["campaign", "--list"]) == 0
    assert capsys.readouterr().out == listed
    assert "status_lost" in listed and "duration 10…30, 82…86, 130…2500 ms]" in listed
    for word, found in (
        ("Steer", "steer"),
        ("wheel speed", "speed"),
        ("no such word", "no kind of fault with 'no such word'"),
    ):
        assert main(["drive", "--list-faults", word]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines and all(found in line.lower() for line in lines)
