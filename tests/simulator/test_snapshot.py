"""A run can be copied in the middle: one drive up to a moment serves many different ends of it."""

from __future__ import annotations

import copy

import pytest

from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import S

# Every kind of planning, control and judging; a lap goes on from a copy in the tests of the campaign's scenarios,
# an inspection in the test below.
MISSIONS = {Ami.ACCELERATION: "2026", Ami.SKIDPAD: "2021", Ami.STATIC_INSPECTION_A: "2026"}
INTO_DRIVING_NS = 5 * S
GOES_ON_NS = 1 * S


def driving(mission: Ami, revision: str) -> Lockstep:
    """A run some seconds into AS_DRIVING, with everything under way that can be: GPS, plans, delayed requests."""
    lockstep = Lockstep(WorldSetup(missions=[mission, mission], revision=revision, seed=5))
    vcu = lockstep.world.vcu
    lockstep.detects = False  # who plans for a car that stands plans the same again and again
    while vcu.state is not AsState.AS_READY or vcu.in_state_ns < 4 * S:
        lockstep.step()
    lockstep.detects = True
    while vcu.state is not AsState.AS_DRIVING or vcu.in_state_ns < INTO_DRIVING_NS:
        lockstep.step()
        assert lockstep.now_ns < 60 * S, "the car never drove"
    return lockstep


def go_on(lockstep: Lockstep) -> list[Frame]:
    """Everything on the bus meanwhile."""
    frames: list[Frame] = []
    lockstep.on_frame = frames.append
    until_ns = lockstep.now_ns + GOES_ON_NS
    while lockstep.now_ns < until_ns:
        lockstep.step()
    return frames


def outcome(lockstep: Lockstep) -> tuple[object, ...]:
    """All that a run shows of itself at an instant."""
    world = lockstep.world
    return (
        world.truth,
        world.verdict(),
        tuple(world.run.samples),
        world.operator.doing,
        world.vcu.switches,
        tuple(world.vcu.transitions),
        str(lockstep.wire),
        lockstep.computer.report(),
        lockstep.computer.commanded,
    )


@pytest.mark.parametrize(
    "mission",
    [pytest.param(ami, marks=[pytest.mark.long] * (ami is not Ami.ACCELERATION)) for ami in MISSIONS],
    ids=lambda ami: ami.name.lower(),
)
def test_a_copy_of_a_run_continues_as_the_run_and_undisturbed(mission: Ami) -> None:
    run = driving(mission, MISSIONS[mission])
    kept = copy.deepcopy(run)
    before = outcome(run)

    # A copy to which something else happens is driven first: nothing of it may be felt by the others.
    disturbed = copy.deepcopy(run)
    disturbed.world.vcu.switches.remote_estop = True
    disturbed_frames = go_on(disturbed)
    assert disturbed.world.vcu.state is AsState.EMERGENCY_BRAKE
    assert outcome(run) == before

    own_frames = go_on(run)
    assert outcome(kept) == before, "the run has moved its copy"
    assert len(own_frames) > 1000
    assert go_on(kept) == own_frames != disturbed_frames
    assert outcome(kept) == outcome(run)


def test_a_copy_taken_between_operator_actions_ends_as_the_run() -> None:
    setup = WorldSetup(missions=[Ami.STATIC_INSPECTION_B], gps=False)
    run = Lockstep(setup)
    copies: list[Lockstep] = []
    for doing in ("giving Go", "waiting until the siren falls silent"):
        while run.world.operator.doing != doing:
            run.step()
            assert run.now_ns < 120 * S, f"never {doing}"
        copies.append(copy.deepcopy(run))
    result = run.run()
    assert result.verdict.result == "pass"
    for kept in copies:
        again = kept.run()
        assert again.verdict == result.verdict
        assert str(again.wire) == str(result.wire)


def test_a_copy_shares_what_never_changes_and_nothing_else() -> None:
    run = Lockstep(WorldSetup(missions=[Ami.AUTOCROSS]))
    kept = copy.deepcopy(run)
    assert kept.world.codec is run.world.codec
    assert kept.world.run.track is run.world.run.track
    assert kept.bridge is not run.bridge
    assert kept.world.vcu is not run.world.vcu
    assert kept.world.vcu.switches is not run.world.vcu.switches
