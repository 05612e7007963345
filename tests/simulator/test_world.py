"""The simulated world as a whole: car, VCU, judge, sensor and operator together, driven by a scripted driver."""

from __future__ import annotations

import math
from collections import Counter

import pytest
from scripted_driver import ScriptedDriver, Style, Wish, follow

from fsai_hil.simulator.faults import Drop, Window
from fsai_hil.simulator.operator import At, Moment
from fsai_hil.simulator.tracks import small_oval
from fsai_hil.simulator.world import World, WorldSetup, mission_named
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import VcuStatus

SECOND_NS = 1_000_000_000


def driven(setup: WorldSetup, style: Style, seconds: float = 150.0, **driver: object) -> World:
    world = World(setup)
    ScriptedDriver(world, style, **driver).run(seconds)  # type: ignore[arg-type]
    return world


def states(world: World) -> list[str]:
    return [state for state, _ in world.verdict().as_states]


def launch_and_stop(world: World, since_s: float) -> Wish:
    nose = world.car.pose.x_m + world.model.nose_m
    if nose < 77.0:
        return Wish(torque_nm=195.0)
    return Wish(brake_pct=40.0, finished=True)


def inspection_a(world: World, since_s: float) -> Wish:
    most = world.model.steer_limit_deg
    if since_s < 12.0:
        return Wish(steer_deg=most if since_s < 5.5 else -most if since_s < 9.0 else 0.0)
    if since_s < 17.0:
        return Wish(torque_nm=30.0, motor_rpm=round(205 * 3.5))
    return Wish(brake_pct=30.0, finished=True)


def inspection_b(world: World, since_s: float) -> Wish:
    return Wish(torque_nm=30.0, motor_rpm=round(52 * 3.5), estop=since_s > 7.0)


def demonstration() -> Style:
    """Sweep; accelerate for 6.5 m, stop; accelerate for 6.5 m, emergency brake."""
    stops: list[float] = []

    def style(world: World, since_s: float) -> Wish:
        if since_s < 8.0:
            return Wish(steer_deg=15.0 if since_s < 4.5 else -15.0 if since_s < 6.0 else 0.0)
        x = world.car.pose.x_m
        if stops:
            return Wish(torque_nm=195.0, estop=x > stops[0] + 6.5)
        if x < 6.5:
            return Wish(torque_nm=195.0)
        if world.car.standing:
            stops.append(x)
        return Wish(brake_pct=40.0)

    return style


# ------------------------------------------------------------ whole missions


def test_an_acceleration_run_goes_from_power_up_to_finished_and_passes() -> None:
    world = driven(WorldSetup(missions=[Ami.ACCELERATION], gps=False), launch_and_stop)
    verdict = world.verdict()
    assert verdict.passed, verdict.reasons
    assert states(world) == ["AS_INIT", "AS_OFF", "AS_READY", "AS_DRIVING", "AS_FINISHED"]
    assert 9.0 < verdict.lap_times_s[0] < 11.0
    assert world.done


def test_a_lap_of_a_circuit_passes() -> None:
    setup = WorldSetup(missions=[Ami.AUTOCROSS], track=small_oval(), gps=False)
    verdict = driven(setup, follow(5.0)).verdict()
    assert verdict.passed, verdict.reasons
    assert verdict.laps == 1
    assert verdict.cones_hit == 0
    assert verdict.max_lateral_error_m < 0.6


def test_a_skidpad_passes() -> None:
    verdict = driven(WorldSetup(missions=[Ami.SKIDPAD], gps=False), follow(5.0, laps=4)).verdict()
    assert verdict.passed, verdict.reasons
    assert verdict.laps == 4


@pytest.mark.parametrize("revision", ["2021", "2026"])
@pytest.mark.parametrize(
    ("mission", "style"), [(Ami.STATIC_INSPECTION_A, inspection_a), (Ami.STATIC_INSPECTION_B, inspection_b)]
)
def test_the_static_inspections_pass_with_the_wheels_in_the_air(revision: str, mission: Ami, style: Style) -> None:
    if revision == "2021":  # its front axle is driven too, and this driver only speaks to the rear one
        world = World(WorldSetup(missions=[mission], revision=revision, gps=False))
        assert world.car.wheels_in_air
        return
    world = driven(WorldSetup(missions=[mission], revision=revision, gps=False), style)
    assert world.verdict().passed, world.verdict().reasons
    assert world.verdict().distance_m == 0.0


def test_the_demonstration_passes() -> None:
    world = driven(WorldSetup(missions=[Ami.AUTONOMOUS_DEMO], gps=False), demonstration())
    assert world.verdict().passed, world.verdict().reasons
    assert states(world)[-1] == "EMERGENCY_BRAKE"


@pytest.mark.parametrize("revision", ["2021", "2026"])
def test_a_second_mission_follows_without_a_restart_on_its_own_track(revision: str) -> None:
    setup = WorldSetup(missions=[Ami.ACCELERATION, Ami.AUTOCROSS], revision=revision, gps=False)
    world = World(setup)
    lap = follow(6.0)

    def style(world: World, since_s: float) -> Wish:
        return (launch_and_stop if world.mission is Ami.ACCELERATION else lap)(world, since_s)

    ScriptedDriver(world, style).run(200.0)
    assert [verdict.mission for verdict in world.verdicts] == ["acceleration", "autocross"]
    assert all(verdict.passed for verdict in world.verdicts), [verdict.reasons for verdict in world.verdicts]
    assert [run.track.name for run in world.runs] == ["acceleration", "autocross"]
    assert world.vcu.power_cycles == (1 if revision == "2026" else 0)


def test_the_same_mission_can_be_driven_twice() -> None:
    world = driven(WorldSetup(missions=[Ami.ACCELERATION] * 2, gps=False), launch_and_stop)
    assert [verdict.result for verdict in world.verdicts] == ["pass", "pass"]
    assert world.runs[1].samples[0].x_m < 0.0


# ------------------------------------------------------------ what goes wrong


def test_a_driver_who_leaves_the_track_fails() -> None:
    setup = WorldSetup(missions=[Ami.AUTOCROSS], track=small_oval(), gps=False)

    def straight_on(world: World, since_s: float) -> Wish:
        return Wish(torque_nm=100.0) if since_s < 12.0 else Wish(brake_pct=50.0, finished=True)

    verdict = driven(setup, straight_on, 60.0).verdict()
    assert not verdict.passed
    assert verdict.off_course == 1
    assert verdict.cones_hit >= 1


def test_a_driver_who_does_not_wait_3_s_fails() -> None:
    verdict = driven(WorldSetup(missions=[Ami.ACCELERATION], gps=False), launch_and_stop, wait_s=1.0).verdict()
    assert any("must wait 3 s" in reason for reason in verdict.reasons)


def test_a_world_without_an_ai_computer_powers_up_and_ends_with_a_reason() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], gps=False))
    ScriptedDriver(world, follow(5.0), silent=True).run(130.0)
    assert world.done
    assert world.verdict().reasons == ("did not start: no AS_DRIVING within 120 s",)


def test_an_ai_computer_that_falls_silent_while_driving_is_braked_to_rest_by_the_car() -> None:
    world = World(WorldSetup(missions=[Ami.ACCELERATION], gps=False))
    driver = ScriptedDriver(world, launch_and_stop)
    driver.run(60.0, until=lambda: world.car.speed_mps > 8.0)
    driver.silent = True
    before = world.now_ns
    driver.run(0.3, until=lambda: world.vcu.state is AsState.EMERGENCY_BRAKE)
    assert world.now_ns - before <= 0.12 * SECOND_NS
    driver.run(10.0)
    verdict = world.verdict()
    assert world.car.standing
    assert verdict.shutdown_cause == "AI_COMMS_FAULT"
    assert not verdict.passed
    assert "AI_COMMS_LOST" in world.faults()


def test_the_remote_estop_pressed_while_driving_ends_the_run() -> None:
    setup = WorldSetup(
        missions=[Ami.ACCELERATION], gps=False, at=[At(6 * SECOND_NS, "remote_estop", True, Moment.DRIVING)]
    )
    world = driven(setup, launch_and_stop)
    assert states(world)[-1] == "EMERGENCY_BRAKE"
    assert world.car.standing


def test_faults_of_the_wire_reach_the_bus() -> None:
    fault = Drop(Window(frozenset({0x525})))
    world = World(WorldSetup(missions=[Ami.ACCELERATION], gps=False, outgoing_faults=[fault]))
    driver = ScriptedDriver(world, launch_and_stop)
    driver.run(5.0)
    assert {frame.can_id for frame in driver.heard} >= {0x520, 0x526}
    assert 0x525 not in {frame.can_id for frame in driver.heard}


# ------------------------------------------------------------ as a part of something


def test_the_same_setup_and_frames_give_the_same_run_to_the_last_bit() -> None:
    setup = WorldSetup(missions=[Ami.ACCELERATION], seed=5)
    heard: list[list[Frame]] = []
    cones = []
    for _ in range(2):
        world = World(setup)
        driver = ScriptedDriver(world, launch_and_stop)
        driver.run(20.0)
        heard.append(driver.heard)
        cones.append(world.see_cones(world.now_ns).xy_m.tolist())
    assert heard[0] == heard[1]
    assert cones[0] == cones[1]


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


def test_frames_come_in_order_with_times_inside_the_portion() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], start_ns=7_000_000_123))
    world.advance(10 * SECOND_NS)
    frames = world.advance(10 * SECOND_NS + 20_000_000)
    times = [frame.t_ns for frame in frames]
    assert times == sorted(times)
    assert all(10 * SECOND_NS - 2_000_000 < t <= 10 * SECOND_NS + 20_000_000 for t in times)
    assert Counter(frame.can_id for frame in frames)[0x520] == 2


@pytest.mark.parametrize(("revision", "kept"), [("2021", True), ("2026", False)])
def test_each_revision_says_its_own_messages(revision: str, kept: bool) -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], revision=revision))
    ids = {frame.can_id for frame in world.advance(10 * SECOND_NS)}
    assert {0x520, 0x521, 0x522, 0x523, 0x524, 0x525, 0x526, 0x500, 0x502} <= ids
    assert (0x120 in ids) is kept


def test_due_times_lie_ahead_and_nothing_is_said_before_them() -> None:
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
    cones = {(round(float(x), 6), round(float(y), 6)) for x, y in world.track.cones_xy_m}
    assert len(seen.xy_m) > 5
    for x, y in seen.xy_m:
        at = pose.ahead(float(x), float(y))
        assert min(math.dist(at, cone) for cone in cones) < 1e-6


def test_the_truth_says_what_a_sensor_simulator_must_know() -> None:
    world = World(WorldSetup(missions=[Ami.SKIDPAD], seed=9, start_ns=50))
    truth = world.truth
    assert (truth.mission, truth.track, truth.seed, truth.as_state) == ("skidpad", "skidpad", 9, "AS_INIT")
    assert truth.pose == world.car.pose


def test_choosing_another_mission_on_the_display_moves_the_car_to_its_start() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], auto=False))
    world.advance(SECOND_NS)
    world.vcu.switches.ami = Ami.SKIDPAD
    world.advance(2 * SECOND_NS)
    assert world.mission is Ami.SKIDPAD
    assert world.track.name == "skidpad"
    assert world.car.pose.x_m == pytest.approx(-15.0 - world.model.nose_m)
    assert len(world.runs) == 1


def test_the_official_simulator_profile_brings_its_own_car() -> None:
    world = World(WorldSetup(missions=[Ami.TRACKDRIVE], profile="official-simulator"))
    assert world.model.wheel_radius_m == 0.15


@pytest.mark.parametrize(
    ("setup", "words"),
    [
        (WorldSetup(missions=[]), "no mission"),
        (WorldSetup(missions=[Ami.NOT_SELECTED]), "NOT_SELECTED is no mission"),
        (WorldSetup(missions=[Ami.TRACKDRIVE], revision="2019"), "2019"),
        (WorldSetup(missions=[Ami.TRACKDRIVE], profile="lenient"), "lenient"),
        (WorldSetup(missions=[Ami.SKIDPAD], track=small_oval()), "needs a track of kind skidpad"),
        (WorldSetup(missions=[Ami.TRACKDRIVE], noise_level=-1.0), "noise_level"),
    ],
)
def test_a_setup_that_cannot_be_built_is_refused_in_one_line(setup: WorldSetup, words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        World(setup)
    assert "\n" not in str(caught.value)


def test_an_unknown_mission_is_refused_with_the_valid_names() -> None:
    assert mission_named("TrackDrive") is Ami.TRACKDRIVE
    with pytest.raises(ValueError, match=r"choose one of acceleration, .*autonomous_demo"):
        mission_named("rally")


def test_the_vcu_status_on_the_bus_says_what_the_judge_sees() -> None:
    world = World(WorldSetup(missions=[Ami.ACCELERATION], gps=False))
    driver = ScriptedDriver(world, launch_and_stop)
    driver.run(14.0)
    last = [frame for frame in driver.heard if frame.can_id == 0x520][-1]
    image = world.codec.decode(last).image
    assert isinstance(image, VcuStatus)
    assert image.as_state.label == states(world)[-1] == "AS_DRIVING"
