"""The examples of examples/: each starts, speaks as its place in the chain asks, and two of them drive a lap."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest
from fsai_msgs.msg import Cone, ConeArray, PlannerStatus, ResetConfirmation, RunState, VehicleCommand, VehicleState
from nav_msgs.msg import Path as PathMessage
from ros_rig import RosRig, Stand, driven, overrides

from fsai_nodes import qos
from fsai_vcu.interface.enums import Ami, AsState

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = sorted(path.parent.name for path in EXAMPLES.glob("*/package.xml"))  # those that are ROS 2 packages


def example(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(EXAMPLES / name)
    return importlib.import_module(name)


def confirmed(rig: RosRig) -> list[ResetConfirmation]:
    return rig.subscribe(ResetConfirmation, "/reset_confirmation", qos.CONFIRMATION)


@pytest.mark.parametrize("name", NAMES)
def test_an_example_is_a_package_that_can_be_copied(name: str) -> None:
    folder = EXAMPLES / name
    assert {"README.md", "package.xml", "setup.py", f"{name}.py"} <= {path.name for path in folder.iterdir()}
    assert f"<name>{name}</name>" in (folder / "package.xml").read_text()
    assert f'NAME = "{name}"' in (folder / "setup.py").read_text()
    assert (folder / "resource" / name).is_file()
    assert f"examples/{name}/{name}.py" in (folder / "README.md").read_text()


def test_own_planner_confirms_and_follows_the_middle(rig: RosRig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.add(example("own_planner", monkeypatch).OwnPlanner())
    said, paths = confirmed(rig), rig.subscribe(PathMessage, "/path", qos.PLAN)
    statuses = rig.subscribe(PlannerStatus, "/planner_status", qos.PLAN)
    rig.announce()
    stand = Stand(rig)
    cones = ConeArray()
    for x in (1.0, 5.0, 9.0):
        cones.cones += [Cone(x=x, y=2.5, color=Cone.BLUE), Cone(x=x, y=-1.5, color=Cone.YELLOW)]

    def pairs() -> list[tuple[PathMessage, PlannerStatus]]:
        """Of one stamp; either may come without the other, for it lives for half a second only."""
        return [(path, status) for path in paths for status in statuses if path.header.stamp == status.header.stamp]

    def planned() -> bool:
        stand.state()
        cones.header.stamp = rig.stamp()
        stand._cones.publish(cones)
        return bool(pairs())

    rig.spin_until(planned, "a path and its status")
    assert (said[0].role, said[0].run_id) == ("planner", 7)
    path, status = pairs()[0]
    assert (status.run_id, status.mission) == (7, int(Ami.TRACKDRIVE))
    assert {round(pose.pose.position.y, 6) for pose in path.poses[4:]} == {0.5}


def test_own_controller_confirms_and_steers_along_the_path(rig: RosRig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.add(example("own_controller", monkeypatch).OwnController())
    said, commands = confirmed(rig), rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)
    rig.announce()
    stand = Stand(rig)

    def brakes() -> bool:
        stand.state()
        return bool(commands)

    def drives() -> bool:
        stand.state()
        stand.plan()  # its points are where the car is
        return commands[-1].throttle > 0.0

    rig.spin_until(brakes, "a command without a path")
    assert commands[0].brake > 0.0 == commands[0].throttle
    assert [(each.role, each.run_id) for each in said] == [("controller", 7)]
    rig.spin_until(drives, "a command along the path")
    assert commands[-1].run_id == 7 and commands[-1].brake == 0.0


def test_own_mission_drives_brakes_and_is_finished(rig: RosRig, monkeypatch: pytest.MonkeyPatch) -> None:
    module = example("own_mission", monkeypatch)
    node = rig.add(module.OwnMission())
    said, commands = confirmed(rig), rig.subscribe(VehicleCommand, "/vehicle_cmd", qos.COMMAND)
    run = RunState(run_id=3, mission=int(Ami.TRACKDRIVE), as_state=int(AsState.AS_DRIVING), may_move=True)
    node.on_run(run)  # of another mission: it is not the one to confirm
    node.on_run(RunState(run_id=4, mission=module.MISSION, as_state=int(AsState.AS_DRIVING), may_move=True))
    states = [
        (VehicleState(run_id=4), lambda c: c.throttle > 0.0 and not c.mission_finished),
        (VehicleState(run_id=4, distance_m=10.5, speed_mps=2.0), lambda c: c.brake > 0.0 and not c.mission_finished),
        (VehicleState(run_id=4, distance_m=11.0, standing=True), lambda c: c.brake > 0.0 and c.mission_finished),
    ]
    for state, wanted in states:
        state.header.stamp = rig.stamp()
        node.on_state(state)
        rig.spin_until(lambda wanted=wanted: bool(commands) and wanted(commands[-1]), str(state))
    rig.spin_until(lambda: len(said) == 2, "both confirmations")
    assert {(each.role, each.run_id) for each in said} == {("planner", 4), ("controller", 4)}
    assert not any(command.throttle and command.brake for command in commands)


@pytest.mark.parametrize("way", ["lists", "text", "cloud"])
def test_cones_go_out_and_come_back_as_they_were(rig: RosRig, monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    inward, outward = example("cone_converter", monkeypatch), importlib.import_module("cones_out")
    rig.start(outward.ConesOut, way=way)
    converter = inward.ConeConverter(parameter_overrides=overrides(way=way), use_global_arguments=False)
    back = converter.cones = rig.add(converter).create_publisher(ConeArray, "back", qos.SENSOR)
    received = rig.subscribe(ConeArray, "/back", qos.SENSOR)
    seen = ConeArray(cones=[Cone(x=5.0, y=1.5, color=Cone.BLUE), Cone(x=5.5, y=-1.5, color=Cone.BIG_ORANGE)])
    seen.header.frame_id, seen.header.stamp = "base_link", rig.stamp()
    cones = rig.tester.create_publisher(ConeArray, "/detected_cones", qos.SENSOR)

    def came() -> bool:
        cones.publish(seen)
        return bool(received)

    rig.spin_until(came, f"the cones on {back.topic_name}")
    assert [(cone.x, cone.y, cone.color) for cone in received[0].cones] == [(5.0, 1.5, 1), (5.5, -1.5, 4)]
    assert {cone.confidence for cone in received[0].cones} == {1.0}
    assert received[0].header.frame_id == "base_link"
    assert (received[0].header.stamp == seen.header.stamp) == (way != "text"), "a string has no stamp"


def test_own_planner_and_controller_drive_to_as_finished(tmp_path: Path) -> None:
    """As their READMEs have it."""
    programs = [
        word for name in ("own_planner", "own_controller") for word in ("--with", str(EXAMPLES / name / f"{name}.py"))
    ]
    said = driven(tmp_path, "--track", "small_oval", *programs)
    assert "autocross: PASS" in said
    assert (tmp_path / "report.html").stat().st_size > 10_000
