"""The simulated world as a whole: car, VCU, judge, sensor and operator; the lockstep tests drive its missions."""

from __future__ import annotations

import math

import pytest

from fsai_hil.simulator.tracks import skidpad_track, small_oval
from fsai_hil.simulator.world import World, WorldSetup, mission_named
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.frames import Frame

SECOND_NS = 1_000_000_000


def test_time_may_be_handed_over_in_any_portions() -> None:
    sent = []
    for portion_ns in (1_000_000, 7_000_000, 100_000_000):
        world = World(WorldSetup(missions=[Ami.SKIDPAD]))
        frames: list[Frame] = []
        for t in range(portion_ns, 3_000_000_001, portion_ns):
            frames += world.advance(t)
        sent.append([frame for frame in frames if frame.t_ns < 2_900_000_000])
    assert sent[0] == sent[1] == sent[2]
    assert len(sent[0]) > 100


def test_due_times_lie_ahead_and_nothing_is_sent_before_them() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], gps=False))
    for _ in range(3000):
        due = world.next_due_ns()
        assert world.now_ns < due <= world.now_ns + 10_000_000
        assert world.advance(due - 1) == []
        world.advance(due)


def test_cones_are_seen_from_where_the_car_is() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], noise_level=0.0))
    seen = world.see_cones(123)
    pose = world.truth.pose
    cones = {(round(float(x), 6), round(float(y), 6)) for x, y in world.run.track.cones_xy_m}
    assert len(seen.xy_m) > 5
    for x, y in seen.xy_m:
        at = pose.ahead(float(x), float(y))
        assert min(math.dist(at, cone) for cone in cones) < 1e-6


def test_the_truth_says_what_a_sensor_simulator_must_know() -> None:
    world = World(WorldSetup(missions=[Ami.SKIDPAD], seed=9, start_ns=50))
    truth = world.truth
    assert (truth.mission, truth.track, truth.seed, truth.as_state) == ("skidpad", "skidpad", 9, "AS_INIT")
    assert truth.pose == world.car.pose


def test_another_mission_chosen_moves_the_car_to_its_start() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], auto=False))
    world.advance(SECOND_NS)
    world.vcu.switches.ami = Ami.SKIDPAD
    world.advance(2 * SECOND_NS)
    assert world.run.mission is Ami.SKIDPAD
    assert world.run.track.name == "skidpad"
    assert world.car.pose.x_m == pytest.approx(-15.0 - world.car.facts.nose_ahead_of_rear_axle_m)
    assert len(world.runs) == 1


def test_the_official_simulator_profile_brings_its_own_car() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], profile="official-simulator"))
    facts = world.car.facts
    assert (facts.mass_kg, facts.rolling_radius_m, facts.wheel_pulses_per_rev) == (325.0, 0.15, 36)


@pytest.mark.parametrize(
    ("setup", "words"),
    [
        (WorldSetup(missions=[]), "no mission"),
        (WorldSetup(missions=[Ami.NOT_SELECTED]), "NOT_SELECTED is no mission"),
        (WorldSetup(missions=[Ami.TRACKDRIVE], revision="2019"), "2019"),
        (WorldSetup(missions=[Ami.TRACKDRIVE], profile="lenient"), "lenient"),
        (WorldSetup(missions=[Ami.SKIDPAD], track=small_oval()), "needs a track of kind skidpad"),
        (WorldSetup(missions=[Ami.TRACKDRIVE], track=skidpad_track()), "needs a track of kind circuit"),
        *((WorldSetup(missions=[Ami.SKIDPAD], noise_level=x), "noise_level") for x in (-1.0, math.nan, math.inf)),
        (WorldSetup(missions=[Ami.TRACKDRIVE], laps=0), "laps is 0"),
    ],
)
def test_a_setup_that_cannot_be_built_is_refused_in_one_line(setup: WorldSetup, words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        World(setup)
    assert "\n" not in str(caught.value)


def test_an_unknown_mission_is_refused_with_the_valid_names() -> None:
    assert mission_named("TrackDrive") is Ami.TRACKDRIVE
    with pytest.raises(ValueError, match=r"there are: acceleration, .*autonomous_demo"):
        mission_named("rally")
