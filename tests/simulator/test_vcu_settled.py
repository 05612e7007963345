"""The VCU need not look again at what has not changed: whatever happens, it does what one does that always looks."""

from __future__ import annotations

import random
from dataclasses import fields

import pytest
from vcu_bench import Bench

from fsai_hil.simulator.profiles import OFFICIAL_SIMULATOR, SPECIFICATION
from fsai_hil.simulator.switches import Switches
from fsai_hil.simulator.vcu import SimulatedVcu
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.units import MS

FLAGS = [one.name for one in fields(Switches) if isinstance(one.default, bool)]
SEEDS = range(4)


def something_happens(bench: Bench, chance: random.Random) -> None:
    """One thing that people, the car or the AI computer may do; mostly such as do not end the run at once."""
    kind = chance.randrange(12)
    if kind == 0:
        name = chance.choice(FLAGS)
        setattr(bench.switches, name, not getattr(bench.switches, name))
    elif kind == 1:
        bench.switches.ami = chance.choice(list(Ami))
    elif kind in (2, 3):
        bench.wheels(*(chance.choice((0.0, 9.0, 10.0, 10.5, 80.0)) for _ in range(4)))
    elif kind == 4:
        bench.say(mission_status=chance.choice(list(MissionStatus)), direction=chance.choice(list(Direction)))
    elif kind == 5:
        bench.say(rear_torque_nm=chance.choice((0.0, 50.0)), rear_brake_pct=chance.choice((0.0, 0.0, 20.0)))
    elif kind == 6:
        bench.say(steer_deg=chance.choice((0.0, 0.0, 4.0, -8.0)), estop_request=chance.random() < 0.1)
    elif kind == 7:
        bench.echoes = chance.random() < 0.8
    elif kind == 8:
        bench.silent_ids = {chance.choice((0x510, 0x512, 0x514))} if chance.random() < 0.3 else set()
    elif kind == 9:
        bench.talks = chance.random() < 0.9
    elif kind == 10:
        bench.switches.torque_limit_nm = chance.choice((None, 40.0))
    else:
        bench.answer(bench.now_ns)


def history(name: str, simulator: bool, seed: int) -> list[object]:
    """Everything that a VCU says, orders and decides in some eventful seconds from one of its states."""
    chance = random.Random(seed)
    bench = Bench(name, OFFICIAL_SIMULATOR if simulator else SPECIFICATION)
    (bench.to_ready, bench.to_driving, bench.to_finished, bench.to_emergency)[seed % 4]()
    seen: list[object] = [bench.now_ns]  # how long power-up, precharge and arming have taken
    for _ in range(40):
        something_happens(bench, chance)
        for _ in range(chance.choice((1, 7, 60, 250))):
            frames = bench.tick(chance.choice((MS, 2 * MS)))
            vcu = bench.vcu
            seen.append((frames, vcu.state, vcu.actuation, vcu.indicators, vcu.faults, vcu.shutdown_cause))
    return [*seen, *bench.vcu.transitions]


@pytest.mark.parametrize(("name", "simulator"), [("2021", True), ("2026", False)])
def test_what_a_vcu_does_not_evaluate_would_have_changed_nothing(
    name: str, simulator: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    spared = [history(name, simulator, seed) for seed in SEEDS]
    monkeypatch.setattr(SimulatedVcu, "_next_change_ns", lambda self, now_ns: now_ns)
    for seed, once in zip(SEEDS, spared, strict=True):
        always = history(name, simulator, seed)
        assert once == always, f"seed {seed}: first difference at {_first_difference(once, always)}"


def test_a_settled_vcu_does_not_evaluate_until_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[int] = []
    closely = SimulatedVcu._look_closely

    def counted(vcu: SimulatedVcu, now_ns: int) -> bool:
        looks.append(now_ns)
        return closely(vcu, now_ns)

    bench = Bench().to_driving()
    bench.run(100 * MS)
    monkeypatch.setattr(SimulatedVcu, "_look_closely", counted)
    bench.run(100 * MS)
    assert len(looks) <= 5, "ten milliseconds of a settled car are one look at most"
    bench.switches.car_estop = True
    bench.tick()
    assert bench.state is AsState.EMERGENCY_BRAKE


def _first_difference(one: list[object], other: list[object]) -> str:
    for place, (left, right) in enumerate(zip(one, other, strict=False)):
        if left != right:
            return f"{place}: {left} != {right}"
    return f"the end: {len(one)} and {len(other)}"
