"""What a ROS stack does wrong is named, each with what to do; a stack in order is left alone. No ROS is needed."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from msgspec.structs import asdict

from fsai_vcu.cli.check_stack import _as_dict, _as_text
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.supervisor import ROLES, Asked
from fsai_vcu.diagnostics.stack.watch import Ends, StackWatch

ROS_S = 1_000.0


def stamped(age_s: float = 0.0, **values: object) -> SimpleNamespace:
    """A message as ROS has it, its stamp so old."""
    stamp_s = ROS_S - age_s
    stamp = SimpleNamespace(sec=int(stamp_s), nanosec=int(stamp_s % 1 * 1e9))
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id=""), **values)


def command(age_s: float = 0.0, **values: object) -> SimpleNamespace:
    return stamped(age_s, **asdict(VehicleCommand(0, **{"run_id": 7, **values})))


def state(**values: object) -> SimpleNamespace:
    return stamped(**{"run_id": 7, "steering_max_rad": 0.36, "emergency": "", "stopping": "", **values})


def run(run_id: int, *, mission: int = 0, may_move: bool = False) -> SimpleNamespace:
    return SimpleNamespace(run_id=run_id, mission=mission, may_move=may_move)


def watched(message: Callable[[], SimpleNamespace] = command, period_s: float = 0.02) -> StackWatch:
    """A stack in order for 2 s, but for its commands."""
    watch = StackWatch()
    watch.receive("run_state", run(7), 0.0, 0)
    for role in ("planner", "controller"):
        watch.receive("reset_confirmation", SimpleNamespace(role=role, run_id=7), 0.0, 0)
    for number in range(round(2.0 / period_s)):
        watch.receive("vehicle_cmd", message(), number * period_s, round(ROS_S * 1e9))
        watch.receive("vehicle_state", state(), number * 0.02, round(ROS_S * 1e9))
    return watch


def wrong(watch: StackWatch) -> list[str]:
    return [f"{each.kind}: {each.words}; {each.remedy}" for each in watch.findings()]


def test_a_stack_in_order_has_nothing_wrong() -> None:
    assert wrong(watched()) == []


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (lambda: command(throttle=0.5, brake=0.1), ("throttle and brake together", "set one of them to 0")),
        (lambda: command(steering_rad=0.4), ("steering_rad is out of range", "+-0.36 rad")),
        (lambda: command(throttle=float("nan")), ("throttle is out of range or not a number", "0 to 1")),
        (lambda: command(brake=1.1), ("brake is out of range", "0 to 1")),
        (lambda: command(age_s=0.6), ("0.60 s old", "pass the newest data on")),
        (lambda: command(age_s=-0.5), ("0.50 s in the future", "this computer's clock")),
        (lambda: command(age_s=ROS_S), ("100 of 100 messages have no stamp", "oldest data behind it")),
    ],
)
def test_a_wrong_command_is_named_with_what_to_do(
    message: Callable[[], SimpleNamespace], words: tuple[str, ...]
) -> None:
    (line,) = wrong(watched(message))
    assert line.startswith("vehicle_cmd: ") and all(word in line for word in words), line


def test_too_slow_commands_are_named_with_their_rate() -> None:
    (line,) = wrong(watched(period_s=0.1))
    assert "10.0 Hz, at least 50 are needed" in line


def test_commands_of_another_run_and_missing_resets_are_named() -> None:
    watch = watched()
    watch.receive("run_state", run(8), 2.0, 0)
    watch.receive("vehicle_cmd", command(), 1.99, round(ROS_S * 1e9))
    planner, controller, stale = wrong(watch)
    assert "the planner has not confirmed run 8" in planner and "the controller has not" in controller
    assert "1 commands belong to another run" in stale


def test_what_the_bridge_counted_meanwhile_is_told_with_detail() -> None:
    watch = watched()
    for count in (3, 5):
        watch.diagnose("count of command_refused", str(count))
        watch.diagnose("last detail of command_refused", "throttle is nan")
        watch.diagnose("count of steer_clamped", "2")  # long before
    (line,) = wrong(watch)
    assert "intervened 2 times" in line and "a vehicle command was refused" in line and "(throttle is nan)" in line


@pytest.mark.parametrize("why", [Asked.MISSION_DONE.value, "wheel speeds (0x525) are missing"])
def test_a_stop_is_told_unless_somebody_asked_for_it(why: str) -> None:
    watch = watched()
    watch.receive("vehicle_state", state(stopping=why), 2.0, round(ROS_S * 1e9))
    told = wrong(watch)
    assert told == [] if why == "mission complete: braking to a stop" else why in told[0]


def test_a_silent_stack_is_named_topic_by_topic() -> None:
    lines = wrong(StackWatch())
    topics = ("vehicle_cmd", "vehicle_state", "run_state")
    assert [line.partition(": nothing was received")[0] for line in lines] == list(topics)


def test_a_path_in_another_frame_is_named() -> None:
    watch = watched()
    path = stamped(poses=["one"])
    path.header.frame_id = "map"
    watch.receive("path", path, 0.0, round(ROS_S * 1e9))
    assert wrong(watch)[0].startswith("path: frame_id is 'map'; points are in base_link")


def test_ends_that_do_not_fit_are_named_by_their_nodes() -> None:
    watch = watched()
    watch.ends = {
        "vehicle_cmd": Ends(publishers=["ours", "team"]),
        "path": Ends(readers=["ours"]),
        "vehicle_state": Ends(readers=["ours"], deaf=[("ours", "team", "best effort and reliable")]),
    }
    assert [each.partition(";")[0] for each in wrong(watch)] == [
        "vehicle_cmd: 2 nodes command the car: ours and team",
        "path: nobody publishes it, and ours waits for it",
        "vehicle_state: ours does not receive team: best effort and reliable",
    ]


def test_a_planner_that_sends_no_plan_is_named_with_its_reason() -> None:
    watch = watched()
    watch.ends = {"path": Ends(publishers=["planner"], readers=["controller"])}
    late = stamped(late="/detected_cones of x: nothing received for 300 ms")
    watch.receive("planner_status", late, 0.0, round(ROS_S * 1e9))
    (line,) = wrong(watch)
    assert line.startswith("path: no plan is sent: planner publishes it but sends nothing, and controller waits")
    assert "the planner says: /detected_cones of x: nothing received" in line


@pytest.mark.parametrize(("mission", "said"), [(4, True), (5, False)])
def test_paths_without_a_point_are_named_where_one_is_needed(mission: int, said: bool) -> None:
    watch = watched()
    watch.receive("run_state", run(7, mission=mission, may_move=True), 1.0, 0)
    for number in range(20):
        at = number * 0.1, round(ROS_S * 1e9)
        watch.receive("planner_status", stamped(late="", note="no lane among 7 cones"), *at)
        watch.receive("path", stamped(poses=[]), *at)
    lines = wrong(watch)
    assert lines == [] or "none of 20 paths has a point; the planner says: no lane among 7 cones" in lines[0]
    assert bool(lines) == said


def test_nodes_by_a_clock_that_nobody_publishes_are_named() -> None:
    watch = watched()
    watch.by_clock = {"planner": True, "bridge": False}
    (line,) = wrong(watch)
    assert line.startswith("clock: nobody publishes it, and use_sim_time is set in planner: that clock stands still")
    watch.clock_published = True
    (line,) = wrong(watch)
    assert line.startswith("clock: planner goes by /clock (use_sim_time), and bridge does not")
    watch.by_clock = {"planner": True, "bridge": True}
    assert wrong(watch) == []


def test_what_nodes_complain_of_is_told() -> None:
    watch = watched()
    watch.complain("vcu_bridge: /vehicle_cmd", "/vehicle_cmd of team refused: throttle is nan")
    watch.complain("path_planner: clock", "this node's own clock stands still at 0 s")
    clock, command = wrong(watch)
    assert clock.startswith("clock: path_planner says: this node's own clock stands still")
    assert command.startswith("vehicle_cmd: vcu_bridge says: /vehicle_cmd of team refused: throttle is nan;")


HOSTILE = "\x1b]0;PWN\x07\r\n" + "x" * 100_000 + "�\ud800\x7f"


def test_what_any_program_says_is_told_in_short_lines() -> None:
    watch = watched()
    watch.receive("vehicle_state", state(stopping=HOSTILE), 2.0, round(ROS_S * 1e9))
    watch.receive("run_state", run(8, mission=4, may_move=True), 1.0, 0)
    watch.receive("planner_status", stamped(late=HOSTILE), 0.0, round(ROS_S * 1e9))
    watch.receive("reset_confirmation", SimpleNamespace(role=HOSTILE, run_id=8), 0.0, 0)
    watch.ends = {"path": Ends(publishers=["planner"], readers=["controller"])}
    for number in range(300):
        path = stamped(poses=["one"])
        path.header.frame_id = f"{number} {HOSTILE}"
        watch.receive("path", path, number * 0.1, round(ROS_S * 1e9))
        watch.complain(f"{number} {HOSTILE}: {HOSTILE}", HOSTILE)
        watch.diagnose(f"count of {HOSTILE}", "1")
    for count in ("3", "-1", "NaN", "9" * 5000, HOSTILE, "5"):
        watch.diagnose("count of steer_clamped", count)
        watch.diagnose("last detail of steer_clamped", HOSTILE)
    found = list(watch.findings())
    lines = "\n".join(map(_as_text, found)).splitlines()
    assert len(lines) == 2 * len(found) < 450
    assert all(line.isprintable() and len(line) < 1200 for line in lines)
    assert any("the bridge intervened 2 times" in line for line in lines)
    assert watch.confirmed == {(role, 7) for role in ROLES}
    told = json.dumps([_as_dict(each) for each in found])
    assert told.isprintable() and len(told) < 1000 * len(found)
