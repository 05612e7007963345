"""What a /run_mission goal waits for."""

from __future__ import annotations

import sys

import pytest
from fsai_msgs.action import RunMission

from fsai_nodes.declarations import declared
from fsai_nodes.mission_goal import GOALS, GoalResult, Waiting
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import S

OFF, READY, DRIVING = AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
FINISHED, EMERGENCY, INIT = AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE, AsState.AS_INIT


def outcome_of(waiting: Waiting, states: list[AsState | None], mission: Ami = Ami.TRACKDRIVE) -> GoalResult | None:
    """The first outcome over one state after another, a second apart."""
    for index, state in enumerate(states):
        outcome = waiting.step(state, mission, index * S)
        if outcome is not None:
            return outcome
    return None


@pytest.mark.parametrize(
    ("until", "states", "ended"),
    [
        ("finished", [OFF, READY, DRIVING, FINISHED], "reached"),
        ("", [OFF, READY, DRIVING, FINISHED], "reached"),
        ("finished", [FINISHED], "reached"),
        ("finished", [OFF, READY, DRIVING, EMERGENCY], "missed"),
        ("finished", [OFF, READY, DRIVING, OFF], "missed"),
        ("finished", [OFF, READY, DRIVING, INIT], "missed"),
        ("finished", [OFF, READY, OFF, READY], None),
        ("finished", [EMERGENCY, OFF, READY, DRIVING, FINISHED], "reached"),
        ("ready", [OFF, READY], "reached"),
        ("ready", [OFF, EMERGENCY], "missed"),
        ("driving", [OFF, READY, DRIVING], "reached"),
        ("driving", [OFF, READY, EMERGENCY], "missed"),
        ("driving", [FINISHED, OFF, READY, DRIVING], "reached"),
        ("emergency", [READY, DRIVING, EMERGENCY], "reached"),
        ("emergency", [READY, DRIVING, FINISHED], "missed"),
        ("emergency", [READY, DRIVING, OFF], "missed"),
        ("off", [FINISHED, OFF], "reached"),
        ("off", [EMERGENCY, INIT], "reached"),
        ("end", [READY, DRIVING, FINISHED], "reached"),
        ("end", [READY, DRIVING, EMERGENCY], "reached"),
        ("end", [READY, DRIVING, OFF], "missed"),
        ("finished", [None, None], None),
    ],
)
def test_a_goal_ends_as_the_table_says(until: str, states: list[AsState | None], ended: str | None) -> None:
    outcome = outcome_of(Waiting("", until, 0.0, 0), states)
    assert (outcome.ended if outcome else None) == ended
    assert outcome is None or outcome.success == (ended == "reached")


def test_another_mission_than_expected_ends_it_once_ready() -> None:
    waiting = Waiting("skidpad", "finished", 0.0, 0)
    assert waiting.step(OFF, Ami.NOT_SELECTED, 0) is None
    assert waiting.step(OFF, Ami.TRACKDRIVE, S) is None  # the choice is not made yet
    outcome = waiting.step(READY, Ami.TRACKDRIVE, 2 * S)
    assert outcome is not None and outcome.ended == "wrong_mission" and not outcome.success
    assert "SKIDPAD" in outcome.message and "TRACKDRIVE" in outcome.message


def test_the_expected_mission_is_followed_to_its_end() -> None:
    outcome = outcome_of(Waiting("Trackdrive", "finished", 0.0, 0), [OFF, READY, DRIVING, FINISHED])
    assert outcome is not None and outcome.success


def test_the_timeout_is_over_at_its_value_and_not_before() -> None:
    waiting = Waiting("", "finished", 2.5, 7)
    assert waiting.step(READY, Ami.TRACKDRIVE, 7 + 2_500_000_000 - 1) is None
    outcome = waiting.step(READY, Ami.TRACKDRIVE, 7 + 2_500_000_000)
    assert outcome is not None and outcome.ended == "timeout" and "AS_READY" in outcome.message


def test_no_timeout_waits_for_ever() -> None:
    assert Waiting("", "finished", 0.0, 0).step(None, Ami.NOT_SELECTED, 10**18) is None


@pytest.mark.parametrize("state", [None, OFF, READY, EMERGENCY, FINISHED])
def test_a_cancelled_goal_ends_once_the_car_does_not_drive(state: AsState | None) -> None:
    waiting = Waiting("skidpad", "finished", 0.0, 0)
    for now_s in (1, 2):
        assert waiting.step(DRIVING, Ami.TRACKDRIVE, now_s * S, cancelled=True) is None
    outcome = waiting.step(state, Ami.TRACKDRIVE, 3 * S, cancelled=True)
    assert outcome is not None and (outcome.success, outcome.ended) == (False, "cancelled")
    assert (state.label if state is not None else "nothing is received") in outcome.message


def test_a_cancelled_goal_has_its_timeout_all_the_same() -> None:
    outcome = Waiting("", "finished", 2.0, 0).step(DRIVING, Ami.TRACKDRIVE, 2 * S, cancelled=True)
    assert outcome is not None and outcome.ended == "timeout"


def test_no_duration_is_negative() -> None:
    waiting = Waiting("", "finished", 0.0, 7 * S)
    assert [waiting.duration_s(now_ns) for now_ns in (6 * S, 7 * S, 9 * S)] == [0.0, 0.0, 2.0]


def test_every_goal_can_be_reached() -> None:
    for name, goal in GOALS.items():
        assert goal.reached, name
        assert not goal.reached & goal.missed, name


@pytest.mark.parametrize(
    ("mission", "until", "timeout_s", "words"),
    [
        ("", "done", 0.0, ", ".join(GOALS)),
        ("drag race", "finished", 0.0, "acceleration, skidpad, autocross, trackdrive"),
        *(
            ("", "finished", timeout_s, "timeout_s")
            for timeout_s in (-1.0, float("nan"), float("inf"), sys.float_info.max)
        ),
    ],
)
def test_a_goal_that_is_none_is_refused_by_naming_the_valid_ones(
    mission: str, until: str, timeout_s: float, words: str
) -> None:
    goal = RunMission.Goal(mission=mission, until=until, timeout_s=timeout_s)
    assert words in declared(RunMission.Goal).misfit(goal, "")


@pytest.mark.parametrize("mission", ["", "Trackdrive", "skidpad"])
def test_a_goal_may_name_the_mission_as_it_likes(mission: str) -> None:
    assert declared(RunMission.Goal).misfit(RunMission.Goal(mission=mission, until="end", timeout_s=60.0), "") == ""


def test_the_longest_timeout_there_is_ends_nothing() -> None:
    assert Waiting("", "", sys.float_info.max, 0).step(READY, Ami.TRACKDRIVE, 10**18) is None
