"""The judgement, on observations made by hand: what is worse than the rules allow is called so."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from fsai_hil.evidence.campaign.cases import Case, Since
from fsai_hil.evidence.campaign.endings import End
from fsai_hil.evidence.campaign.observation import Observation, Observer
from fsai_hil.evidence.campaign.verdict import judge
from fsai_vcu.interface.enums import Ami, AsState, MissionStatus
from fsai_vcu.interface.messages import AiStatus
from fsai_vcu.interface.units import MS

FAULT_NS = 5_000 * MS


def observed(
    *,
    torque_until_ms: int = 10_000,
    brake_from_ms: int | None = None,
    estop_from_ms: int | None = None,
    rest_from_ms: int | None = None,
    then: tuple[int, AsState] | None = None,
    finished_from_ms: int | None = None,
    over_ms: int | None = None,
    left_course: int = 0,
    early: bool = False,
    certain_ms: tuple[int, ...] = (),
) -> Observation:
    """A drive with cycles every 10 ms as the observer sees it; times are ms after the fault, at 5 s of AS_DRIVING."""

    def reached(t_ms: int, from_ms: int | None) -> bool:
        return from_ms is not None and t_ms >= from_ms

    history = [(FAULT_NS - 5_000 * MS, AsState.AS_DRIVING)]
    memory = SimpleNamespace(torque_nm=(0.0, 0.0), brake_pct=(0.0, 0.0))
    certain_ns = {FAULT_NS + ms * MS: FAULT_NS + (ms + 20) * MS for ms in certain_ms}
    wire = SimpleNamespace(cycles=0, ai=AiStatus(), seen=memory, certain_ns=certain_ns)
    truth = SimpleNamespace(speed_mps=5.0, wheel_rpm=(0.0,) * 4)
    car = SimpleNamespace(speed_mps=5.0, truth=lambda: truth)
    run = SimpleNamespace(judge=SimpleNamespace(ends_in=AsState.AS_FINISHED, early_ns=MS if early else None))
    world = SimpleNamespace(vcu=SimpleNamespace(history=history), car=car, run=run)
    command = SimpleNamespace(mission_finished=False, estop_request=False)
    rig: Any = SimpleNamespace(wire=wire, world=world, now_ns=0, computer=SimpleNamespace(commanded=command))
    observer = Observer(rig)
    for t_ms in range(-1900, 10_000, 10):
        rig.now_ns = FAULT_NS + t_ms * MS
        if t_ms == 0:
            observer.fault_begins()
        if then is not None and t_ms >= then[0] and len(history) == 1:
            history.append((FAULT_NS + then[0] * MS, then[1]))
        braking, finished = reached(t_ms, brake_from_ms), reached(t_ms, finished_from_ms)
        memory.torque_nm = 0.0, 100.0 if t_ms < torque_until_ms and not braking else 0.0
        memory.brake_pct = (80.0 if braking else 0.0,) * 2
        status = MissionStatus.FINISHED if finished else MissionStatus.RUNNING
        wire.ai = AiStatus(mission_status=status, estop_request=reached(t_ms, estop_from_ms))
        wire.cycles += 1
        truth.speed_mps = 0.0 if reached(t_ms, rest_from_ms) else 5.0
        command.mission_finished = reached(t_ms, over_ms)
        observer.look(FAULT_NS if t_ms >= 0 else None)
    observer.seen.left_course = left_course
    return observer.seen


def case(fault: str, **params: object) -> Case:
    return Case(fault, Ami.AUTOCROSS, "2026", 0, Since.DRIVING, 5000, {"chance": 0, **params})


SILENT = case("controller_silent", duration=1000)
STOPPED: dict[str, Any] = {"brake_from_ms": 310, "torque_until_ms": 100, "rest_from_ms": 1500}
FINISHED: dict[str, Any] = {"then": (2100, AsState.AS_FINISHED), "finished_from_ms": 2090}
SHORT = case("controller_silent", duration=40)
ASKED = case("emergency_asked")
FAILING = case("brakes_failing")
INTRUDER = case("intruder", message="0x510", frames=5, period=1, payload="zeros")
EARLY = case("planner_finishes_early")
DERATED = case("steering_derated", limit="steer_limit_deg", value=5.0)
DOUBLE = case("pulses_wrong", way="double")
BRAKED: dict[str, Any] = {"torque_until_ms": 10, "brake_from_ms": 20}
ROLLS: dict[str, Any] = {"torque_until_ms": 1500, "rest_from_ms": 7000}


def emergency(estop_ms: int | None, at_ms: int) -> dict[str, Any]:
    return {"torque_until_ms": 10, "estop_from_ms": estop_ms, "then": (at_ms, AsState.EMERGENCY_BRAKE)}


@pytest.mark.parametrize(
    ("one", "what", "end", "wrong"),
    [
        (SILENT, {**STOPPED, **FINISHED}, End.STOP, ""),
        (SILENT, {}, End.ON, "drives on, where the rules demand: service-brake stop"),
        (SHORT, {**STOPPED, **FINISHED}, End.STOP, "where the rules demand: drives on"),
        (SILENT, {**STOPPED, **FINISHED, "rest_from_ms": None}, End.UNSAFE, "moves where it must stand"),
        (SILENT, {**STOPPED, "rest_from_ms": None, "finished_from_ms": 2090}, End.STOP, "a safe state never came"),
        (ASKED, emergency(20, 24), End.ESTOP, ""),
        (ASKED, emergency(40, 44), End.ESTOP, "a safe state came"),
        (case("go_off"), emergency(None, 12), End.SELF, ""),
        (SHORT, {**ROLLS, "over_ms": 6800}, End.ON, ""),
        (SHORT, ROLLS, End.HELD, "stays in AS_DRIVING, torque 0"),
        (FAILING, {**emergency(519, 523), **BRAKED}, End.ESTOP, ""),
        (FAILING, {**emergency(700, 704), **BRAKED}, End.ESTOP, "a safe state came"),
        (FAILING, {**emergency(3010, 3014), **BRAKED}, End.ESTOP, "a safe state came"),
        (INTRUDER, emergency(10, 0), End.SELF, ""),
        (INTRUDER, emergency(20, 4), End.SELF, ""),
        (INTRUDER, emergency(40, 0), End.SELF, "ESTOP_REQUEST came"),
        (INTRUDER, emergency(None, 4), End.SELF, "ESTOP_REQUEST never came"),
        (EARLY, {**STOPPED, **FINISHED, "brake_from_ms": 60, "over_ms": 40}, End.STOP, ""),
        (
            EARLY,
            {"torque_until_ms": 60, "rest_from_ms": 1500, "over_ms": 40},
            End.HELD,
            "stays in AS_DRIVING, torque 0",
        ),
        (DERATED, {}, End.ON, ""),
        (DERATED, {**STOPPED, **FINISHED}, End.STOP, "where the rules demand"),
        (DOUBLE, {"left_course": 1}, End.ON, "left the course"),
        (case("detector_blind", duration=500), {"left_course": 1}, End.ON, ""),
    ],
)
def test_a_reaction_must_come_and_come_in_time(one: Case, what: dict[str, Any], end: End, wrong: str) -> None:
    verdict = judge(one, observed(**what), FAULT_NS, ())
    assert verdict.end is end
    assert verdict.ok is not bool(wrong) and wrong in "; ".join(verdict.faults)


def test_reaction_and_safe_state_are_timed_from_the_fault() -> None:
    verdict = judge(SILENT, observed(**STOPPED, **FINISHED), FAULT_NS, ())
    assert (verdict.reaction_ms, verdict.safe_ms) == (310, 1500)
    assert judge(case("go_off"), observed(**emergency(None, 12)), FAULT_NS, ()).safe_ms == 12


def test_broken_rules_and_ended_processes_are_always_worse() -> None:
    seen = observed(**STOPPED, **FINISHED)
    verdict = judge(SILENT, seen, FAULT_NS, ["1.0 s: rule 1: both"], ["the bridge's process ended: KeyError: 5"])
    assert verdict.faults == ("on the wire: 1.0 s: rule 1: both", "the bridge's process ended: KeyError: 5")


def test_a_mission_that_was_over_before_asks_for_no_reaction() -> None:
    verdict = judge(SILENT, observed(**STOPPED, **FINISHED, over_ms=20), FAULT_NS, ())
    assert verdict.ok and not verdict.applies


def test_a_car_that_moves_before_it_may_is_worse_than_allowed() -> None:
    verdict = judge(SILENT, observed(**STOPPED, **FINISHED, early=True), FAULT_NS, ())
    assert any("before it may" in fault for fault in verdict.faults)


@pytest.mark.parametrize("supervised", [True, False])
def test_a_car_still_moving_where_it_must_stand_is_unsafe(supervised: bool) -> None:
    one = case("status_corrupted", duration=100, bits=3) if supervised else replace(SILENT, since=Since.START)
    standing, moving = (observed(rest_from_ms=rest_ms, **FINISHED) for rest_ms in (1500, None))
    assert judge(one, standing, FAULT_NS, ()).ok
    verdict = judge(one, moving, FAULT_NS, ())
    assert verdict.end is End.UNSAFE and "moves where it must stand" in verdict.faults[-1]


NEVER_ENDS = {
    "it rolls on and nobody drives it": (observed(torque_until_ms=1000), False, True),
    "it is driven by command": (observed(), False, False),
    "it stands, and nobody says that it must drive": (observed(torque_until_ms=1000, rest_from_ms=3000), False, False),
    "it stands, the mission is over, and FINISHED never comes": (
        observed(torque_until_ms=1000, rest_from_ms=3000),
        True,
        True,
    ),
    "the emergency brake never brings it to rest": (observed(then=(3000, AsState.EMERGENCY_BRAKE)), False, True),
}


@pytest.mark.parametrize("ran_out", [True, False])
@pytest.mark.parametrize("name", NEVER_ENDS)
def test_a_run_that_exceeds_the_longest_time_is_unsafe(name: str, ran_out: bool) -> None:
    made, over, unsafe = NEVER_ENDS[name]
    seen = dataclasses.replace(made, ran_out=ran_out, mission_over_ns=FAULT_NS + 2500 * MS if over else None)
    verdict = judge(case("speeds_frozen", duration=100), seen, FAULT_NS, ())
    assert (verdict.end is End.UNSAFE) is (ran_out and unsafe)
    assert verdict.ok is not (ran_out and unsafe)


def test_a_fault_never_injected_does_not_excuse_a_moving_car() -> None:
    verdict = judge(SILENT, observed(then=(100, AsState.AS_OFF)), None, ())
    assert not verdict.ok and verdict.end is End.UNSAFE


@pytest.mark.parametrize(("certain_ms", "reaction_ms"), [((100,), 210), ((100, 150, 400), 160), ((), None)])
def test_a_reaction_to_what_shows_late_is_timed_from_then_on(certain_ms: tuple[int, ...], reaction_ms: int) -> None:
    seen = observed(**STOPPED, **FINISHED, certain_ms=certain_ms)
    assert judge(case("steering_stuck_rack"), seen, FAULT_NS, ()).reaction_ms == reaction_ms


@pytest.mark.parametrize(("brake_ms", "fault"), [(130, ""), (150, "the service brake came 150 ms after the fault")])
def test_a_stop_for_a_fault_before_the_bridge_is_due_in_time(brake_ms: int, fault: str) -> None:
    """The checker times what the bridge is given; a plan that is late to say that the mission is over is not seen."""
    seen = observed(**{**STOPPED, **FINISHED, "brake_from_ms": brake_ms, "torque_until_ms": brake_ms})
    found = judge(case("planner_finishes_early"), seen, FAULT_NS, ()).faults
    assert not found if not fault else found and found[0].startswith(fault)


def test_a_brake_that_comes_with_finished_is_the_reaction() -> None:
    seen = observed(brake_from_ms=100, finished_from_ms=100, rest_from_ms=0, then=(110, AsState.AS_FINISHED))
    assert judge(case("planner_finishes_early"), seen, FAULT_NS, ()).reaction_ms == 100


def test_reactions_to_what_shows_late_are_timed_from_one_zero() -> None:
    reacts = {**emergency(610, 620), "brake_from_ms": 310, "torque_until_ms": 310}
    seen = observed(**reacts, certain_ms=(100,))
    verdict = judge(case("steering_stuck_rack"), seen, FAULT_NS, ())
    assert verdict.ok and verdict.onset_ms == 100
    assert verdict.brake_ms is not None and verdict.reaction_ms == verdict.brake_ms + 300 == 610 - verdict.onset_ms
