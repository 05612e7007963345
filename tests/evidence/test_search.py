"""The search itself: what it visits, what it finds, and that what it leaves out changes nothing."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, cast

import pytest
from msgspec.structs import replace

from fsai_hil.evidence import __main__ as command
from fsai_hil.evidence.__main__ import main
from fsai_hil.evidence.abstraction import FRESH, NOW, TimeFields, edges_of
from fsai_hil.evidence.model import Composition, State
from fsai_hil.evidence.scopes import DEAF, GO, MOVES, MOVING, PATH, SCOPES, STANDS, Scope, scope
from fsai_hil.evidence.search import Move, Search, explore
from fsai_hil.evidence.seeded import SEEDS, Seed, search_for
from fsai_hil.rules.checker import RULES
from fsai_hil.rules.declared import all_edges_ns
from fsai_hil.rules.numbers import CYCLE_NS
from fsai_hil.rules.seen import Violation
from fsai_hil.rules.wheels import WheelAges
from fsai_vcu.core.ages import Ages, NotSearched, Within
from fsai_vcu.core.bridge import BridgeConfig, BridgeState
from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.core.supervision.supervisor import REACTIONS, Asked, Consequence, Latch, Step, SupervisorState
from fsai_vcu.interface.values import Value


@dataclass
class Counter:
    """Counts to ten by one or two; nine is forbidden where `bad`, ten is safe."""

    bad: bool = False
    stuck: bool = False
    endings: Mapping[str, tuple[int, int]] = field(default_factory=lambda: {"counting on": (0, 10)})

    def initial(self) -> int:
        return 0

    def moves(self, state: int) -> Iterable[Move]:
        for label, step in enumerate((1, 2)):
            target = min(10, state + step)
            if self.stuck and state == 4 and label == 0:
                target = 4
            problems = (Violation("nine", "it is nine"),) if self.bad and target == 9 else ()
            yield Move(label, step, target, problems)

    def safe(self, state: int) -> bool:
        return state == 10


def test_the_search_visits_every_state_and_the_longest_safe_way() -> None:
    found = explore(Counter())
    assert (found.states, found.transitions, found.depth) == (11, 22, 5)
    assert found.bounds_ns == {"counting on": 10}
    assert found.holds


def test_the_first_problem_found_has_a_shortest_trace() -> None:
    found = explore(Counter(bad=True))
    assert [problem.rule for problem in found.problems] == ["nine"]
    assert len(found.trace) == 5
    assert found.trace[-1].target == 9
    assert not found.holds


def test_a_state_with_no_safe_end_or_a_late_one_is_a_problem() -> None:
    stuck = explore(Counter(stuck=True))
    assert [problem.rule for problem in stuck.problems] == ["safe end"]
    assert stuck.trace[-1].target == 4
    late = explore(Counter(endings={"counting on": (0, 9)}))
    assert [problem.rule for problem in late.problems] == ["safe end"]


# ---------------------------------------------------------------- the composition


REDUCED = Scope(
    "reduced",
    "a car that is driven, a planner that falls silent, a car that is not heard",
    (replace(GO, rpm=MOVING), replace(GO, rpm=MOVING, command="brake")),
    endings=(STANDS, MOVES, replace(DEAF, within_ns=5_000_000_000)),
)


@pytest.fixture(scope="module")
def searched() -> tuple[Composition, Search, list[Move]]:
    """The reduced scope, what its search found, and every move in it."""
    model = Composition(REDUCED)
    moves: list[Move] = []

    def noted(state: State) -> Iterable[Move]:
        for move in Composition.moves(model, state):
            moves.append(move)
            yield move

    model.moves = noted  # type: ignore[method-assign]
    return model, explore(model), moves


def test_in_a_reduced_scope_rules_hold_and_states_end_safely(searched: tuple[Composition, Search, list[Move]]) -> None:
    _, found, _ = searched
    assert found.problems == ()
    assert found.states > 500
    assert len(found.bounds_ns) == len(REDUCED.endings)


def test_the_search_drives_and_sees_both_sides_of_each_timer(searched: tuple[Composition, Search, list[Move]]) -> None:
    *_, moves = searched
    waits = {move.duration_ns for move in moves}
    assert any(move.seen and cast(Any, move.seen).torque_requested for move in moves)
    for edge_ns in (50_000_000, 100_000_000, 500_000_000, 3_000_000_000, 5_000_000_000):
        assert {edge_ns - 1, edge_ns} <= waits


class Later(SupervisorState, frozen=True):
    """The supervisor's state with a reaction's new time in it."""

    odd_since_ns: int | None = None


class Slid(WheelAges):
    """The ages of the wheels, and a new time that does not say where it matters."""

    sliding_ns: int = -1


class Timed(SupervisorState, frozen=True):
    """The same, and the time says when it matters."""

    odd_since_ns: Annotated[int | None, Ages("implausible_ns", "launch_wait_ns + both_pedals_ns")] = None
    noted_ns: Annotated[int, NotSearched("words")] = 0


class Outer(Value, frozen=True):
    """Values within a value, one of which may be missing."""

    supervisor: Timed
    latch: Annotated[Latch | None, Within(since_ns=Ages("stop_window_ns"))] = None


def test_a_time_without_its_ages_fails_with_the_file_to_change() -> None:
    with pytest.raises(ValueError, match=r"test_search\.py: Later\.odd_since_ns is a time"):
        TimeFields(Later)
    with pytest.raises(ValueError, match=r"test_search\.py: Slid\.sliding_ns is a time"):
        all_edges_ns(Slid)


def test_a_declaration_for_a_field_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="Latch has no until_ns"):
        TimeFields(Latch, {"until_ns": Ages()})


def test_times_within_values_are_taken_out_and_put_back() -> None:
    times = TimeFields(Outer)
    value = Outer(Timed(status_ns=NOW - 7, odd_since_ns=NOW - 3, noted_ns=5), Latch(Asked.MANUAL, NOW - 1))
    ages: list[int] = []
    content = times.apart(value, NOW, ages)
    assert sorted(age for age in ages if 0 < age < 10) == [1, 3, 7]
    assert content == Outer(Timed(stop_window_ns=FRESH), Latch(Asked.MANUAL, FRESH))
    assert times.whole(content, iter(ages)) == replace(value, supervisor=replace(value.supervisor, noted_ns=0))
    edges = edges_of(times, BridgeConfig())
    assert (300_000_000, 3_100_000_000) in edges
    assert (500_000_000,) in edges
    missing: list[int] = []
    assert times.whole(times.apart(Outer(Timed()), NOW, missing), iter(missing)) == Outer(Timed())
    assert len(missing) == len(ages)


def test_each_time_of_the_state_has_ages_of_the_configuration() -> None:
    edges = edges_of(TimeFields(BridgeState), BridgeConfig())
    assert len(edges) > 20
    assert sum(not any(ages) for ages in edges) == 1  # of the gate's last cycle no age matters


NO_AGES = {
    "sensor_stale_ns": "data of that age counts like a stale command",
    "sensor_future_ns": "it is compared once, as the command comes",
    "backlog_ns": "it is compared once, as the frame is read",
    "slip_memory_ns": "the searched environment chooses what the checks find",
}


def test_each_time_of_the_configuration_is_an_age_in_the_state() -> None:
    """A reaction that comes after a new time, and whose state does not say so, would be searched at no edge of it."""
    declared = {
        name for ages in TimeFields(BridgeState).ages for at in (*ages.at, *ages.gap) for name in str(at).split(" + ")
    }
    configured = {name for name in BridgeConfig.__struct_fields__ if name.endswith("_ns")}
    unknown, missing = declared - configured, configured - declared - NO_AGES.keys()
    assert not unknown, f"{unknown}: no time of fsai_vcu/core/supervision/config.py has the name that an Ages(...) has"
    assert not missing, (
        f"{missing}: no time of the bridge's state has that age: what is compared with it says so, Annotated[..., "
        "Ages(...)], in SupervisorState of fsai_vcu/core/supervision/supervisor.py, or in the other parts of "
        "BridgeState; if there is none, say why in NO_AGES of tests/evidence/test_search.py"
    )
    assert not declared & NO_AGES.keys()


def test_every_scope_that_can_send_has_endings() -> None:
    for one in SCOPES:
        assert bool(one.endings) is not one.setting.config.listen_only, one.name


def test_if_as_driving_is_never_left_a_stop_request_is_the_end() -> None:
    found = explore(Composition(replace(scope("any car"), everywhere=())))
    assert found.holds
    assert len(found.bounds_ns) == 2
    assert all(0 < bound_ns <= 5_000_000_000 for bound_ns in found.bounds_ns.values())


def reached(model: Composition, chance: random.Random) -> list[State]:
    """States on the way into AS_DRIVING, and off it by whatever else may happen on it."""
    states = [model.initial()]
    known = set(states)

    def go_on(state: State, label: int) -> None:
        for move in model.moves_under(label, state, model.bridge_of(state)):
            if move.target not in known:
                known.add(cast(State, move.target))
                states.append(cast(State, move.target))

    for state in states:  # which grows meanwhile
        for label in range(len(PATH) if len(states) < 200 else 0):
            go_on(state, label)
    for _ in range(1000):
        state = chance.choice(states)
        go_on(state, chance.choice(model.labels(state, model.bridge_of(state))))
    return states


@pytest.mark.parametrize(
    "name",
    [
        "commands",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("sends", "trouble", "power cycle")),
        "wheel speeds",
    ],
)
def test_what_a_state_forgets_changes_nothing_that_is_sent(name: str) -> None:
    """A bridge that is saved and put back in each cycle sends what one that lives on sends, until an age is rounded."""
    chance = random.Random(name)
    model, living = Composition(scope(name)), Composition(scope(name))
    states = reached(model, chance)
    driven = [state for state in states if model.bridge_of(state).gate.torque_running]
    sent = torque = 0
    for state in (*chance.sample(states, 80), *chance.sample(driven, min(20, len(driven)))):
        held: State = state
        living._load(state)
        kept = chance.random() < 0.5  # what is kept up runs timers out
        for step in range(12):
            if not (kept and step):
                choice = model.choices[chance.randrange(len(model.choices))]
            # Ages go on as they are: compared is what is forgotten, not what is rounded.
            held, _, asked = model._cycle(held, choice, CYCLE_NS)
            _, _, expected = living.live(choice, NOW + (step + 1) * CYCLE_NS)
            assert (asked is None) == (expected is None)
            if asked is not None and expected is not None:
                # The bit is counted from what the VCU sends, so that it does not double the states.
                assert replace(asked, handshake=False) == replace(expected, handshake=False)
                sent += 1
                torque += asked.torque_requested
    assert sent > 100
    assert torque > 0


# ---------------------------------------------------------------- it can fail

# One of each rule that is found soon; `make verify` finds them all.
_QUICK = (
    "torque rises right after the brake",
    "a command lasts 1 ns too long",
    "a wheel under 301 rpm stands",
    "ANGLE_MAX is not looked at",
    "FORWARD in AS_READY",
    "AS_OFF clears the emergency",
    "no command is out of order",
    "the fifth frame has an id that is not ours",
    "the echo follows believed frames only",
    "autonomous at power-up while wheels turn",
    "as_switch_off is only reported",
    "AS_READY without the holding brake",
)
_LONG = {"interval", "10", "safe end"}  # the times of sends are not searched, the others take long


@pytest.mark.parametrize("seed", [seed for seed in SEEDS if seed.name in _QUICK], ids=lambda seed: seed.name)
def test_a_seeded_fault_is_found_and_told_in_words(seed: Seed) -> None:
    found, model = search_for(seed)
    trace = model.described(found.trace)
    assert seed.rule in {problem.rule for problem in found.problems}
    assert 0 < len(trace) <= 16
    assert all("sent:" in line for line in trace)


def test_every_rule_has_a_seed_and_every_seed_an_existing_scope() -> None:
    assert {seed.rule for seed in SEEDS} == set(RULES) - {"interval"}
    assert {seed.rule for seed in SEEDS if seed.name in _QUICK} == set(RULES) - _LONG
    assert {seed.scope for seed in SEEDS if seed.scope} <= {one.name for one in SCOPES}
    assert len({seed.name for seed in SEEDS}) == len(SEEDS)


NOT_SEEDED = {
    Reason.STACK_RESTARTED: "the searched planner and controller confirm once in a run: planner_restarted and "
    "controller_restarted of the campaign",
}


def weakened(reason: Reason) -> bool:
    """True: a seed leaves less of the reaction, and `make verify` fails if the search does not find that."""

    def gravest(steps: Iterable[Step]) -> int:
        return max((step.consequence for step in steps), default=0)

    tables = [rows for seed in SEEDS if seed.scope for _, name, rows in seed.patches if name == "REACTIONS"]
    return any(gravest(cast(Any, rows)[reason]) < gravest(REACTIONS[reason]) for rows in tables)


@pytest.mark.parametrize(
    "reason", [one for one, steps in REACTIONS.items() if any(s.consequence >= Consequence.STOP for s in steps)]
)
def test_each_braking_reaction_has_a_seed_that_weakens_it(reason: Reason) -> None:
    """A reaction that no scope brings about is searched nowhere, and nobody sees it."""
    assert weakened(reason) is not (reason in NOT_SEEDED), (
        f"no seeded fault weakens the reaction to {reason.name}, so nothing shows that the search brings it about: in "
        "hil/fsai_hil/evidence/scopes.py, let a choice or an event bring it about, and name it in `reactions` of the "
        "scope where that is free; what is not just reported, seeded.py weakens. "
        "`python -m fsai_hil.evidence --only-seeded` must find it. If the search cannot bring it about, say why in "
        "NOT_SEEDED of tests/evidence/test_search.py"
    )


# ---------------------------------------------------------------- the command


def test_the_command_prints_figures_and_exits_0_if_all_holds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--scope", "listen only"]) == 0
    out = capsys.readouterr().out
    assert "listen only" in out
    assert "states" in out
    assert "transitions" in out
    assert "none in 'listen only': a process that never sends" in out
    assert "Every rule holds in every state." in out


def test_the_first_seed_of_each_rule_is_traced(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = [
        seed for seed in SEEDS if seed.name in ("FORWARD in AS_READY", "RUNNING in AS_OFF", "reset works everywhere")
    ]
    monkeypatch.setattr(command, "SEEDS", tuple(few))
    assert main(["--only-seeded"]) == 0
    out = capsys.readouterr().out
    assert "sent: mission_status SELECTED; direction FORWARD" in out
    told = [line for line in out.splitlines() if line.startswith("Rule ")]
    assert [line.partition(":")[0] for line in told] == [
        "Rule 5, FORWARD in AS_READY",
        "Rule 6, reset works everywhere",
    ]


def test_the_command_exits_1_with_the_trace_where_a_rule_breaks(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from fsai_vcu.core.supervision import gate

    monkeypatch.setattr(gate, "constant_power_nm", lambda rpm: 195.0)
    assert main(["--scope", "limits"]) == 1
    out = capsys.readouterr().out
    assert "BROKEN, rule 4" in out
    assert "torque" in out


def test_an_unknown_scope_is_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--scope", "nowhere"]) == 2
    assert "unknown scope 'nowhere'" in capsys.readouterr().err
