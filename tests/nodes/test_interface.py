"""What `ros2 node/topic/service/param/action` see: names, types, quality of service, parameters."""

from __future__ import annotations

import ast
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from fsai_msgs.msg import RunState, VehicleState
from fsai_msgs.srv import SetMode
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_rig import HUMBLE, RosRig, logged

from fsai_hil.simulator.ground_truth import TruthReceiver
from fsai_nodes import cone_detector, path_planner, qos, sensor_simulator, vcu_bridge, vehicle_controller, visualization
from fsai_nodes.complaints import ANSWERS
from fsai_nodes.composed import CLASSES
from fsai_nodes.launch import PARAMETERS
from fsai_nodes.parameters import NodeError, Scattered, misspelt
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits

CHECKOUT = Path(__file__).parents[2]
README = (CHECKOUT / "nodes" / "README.md").read_text()
MODULES = {
    "sensor_simulator": (sensor_simulator, sensor_simulator.SensorSimulator),
    "cone_detector": (cone_detector, cone_detector.ConeDetector),
    "path_planner": (path_planner, path_planner.PathPlanner),
    "vehicle_controller": (vehicle_controller, vehicle_controller.VehicleController),
    "vcu_bridge": (vcu_bridge, vcu_bridge.VcuBridge),
    "visualization": (visualization, visualization.Visualization),
}
TYPES = {
    "/raw_cones": "fsai_msgs/msg/ConeArray",
    "/detected_cones": "fsai_msgs/msg/ConeArray",
    "/path": "nav_msgs/msg/Path",
    "/planner_status": "fsai_msgs/msg/PlannerStatus",
    "/vehicle_cmd": "fsai_msgs/msg/VehicleCommand",
    "/vehicle_state": "fsai_msgs/msg/VehicleState",
    "/run_state": "fsai_msgs/msg/RunState",
    "/reset_confirmation": "fsai_msgs/msg/ResetConfirmation",
    "/odometry": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/gps/fix": "sensor_msgs/msg/NavSatFix",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/markers": "visualization_msgs/msg/MarkerArray",
    "/robot_description": "std_msgs/msg/String",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
}
SERVICES = {
    "/set_mode": "fsai_msgs/srv/SetMode",
    "/emergency_brake": "std_srvs/srv/Trigger",
    "/reset": "std_srvs/srv/Trigger",
    "/vcu_bridge/change_state": "lifecycle_msgs/srv/ChangeState",
    "/vcu_bridge/get_state": "lifecycle_msgs/srv/GetState",
}
PUBLISHERS = {
    "sensor_simulator": {"/raw_cones"},
    "cone_detector": {"/detected_cones"},
    "path_planner": {"/path", "/planner_status", "/reset_confirmation"},
    "vehicle_controller": {"/vehicle_cmd", "/reset_confirmation"},
    "vcu_bridge": {"/vehicle_state", "/run_state", "/odometry", "/imu", "/gps/fix", "/diagnostics", "/tf"},
    "visualization": {"/markers", "/robot_description", "/tf_static"},
}


def free_port() -> int:
    with TruthReceiver(0) as free:
        return free.port


def all_nodes(rig: RosRig) -> None:
    rig.start(vcu_bridge.VcuBridge, can_interface=f"loopback:interface-{os.getpid()}", real_time=False)
    rig.start(sensor_simulator.SensorSimulator, truth_port=free_port())
    rig.start(cone_detector.ConeDetector)
    rig.start(path_planner.PathPlanner)
    rig.start(vehicle_controller.VehicleController)
    rig.start(visualization.Visualization)


def promise(profile: QoSProfile, policy: str) -> object:
    """A policy's value; a time that is not given is endless."""
    value = getattr(profile, policy)
    return 2**63 - 1 if isinstance(value, Duration) and not value.nanoseconds else getattr(value, "nanoseconds", value)


def test_nodes_topics_services_and_types_are_named_as_documented(rig: RosRig) -> None:
    all_nodes(rig)
    see = rig.tester
    rig.spin_until(lambda: set(MODULES) <= set(see.get_node_names()), "all nodes")
    topics = dict(see.get_topic_names_and_types())
    assert {name: topics.get(name) for name in TYPES} == {name: [kind] for name, kind in TYPES.items()}
    services = dict(see.get_service_names_and_types())
    assert {name: services.get(name) for name in SERVICES} == {name: [kind] for name, kind in SERVICES.items()}
    assert "/run_mission/_action/send_goal" in services

    def published(node: str) -> set[str]:
        return {name for name, _ in see.get_publisher_names_and_types_by_node(node, "/")}

    for node, wanted in PUBLISHERS.items():  # which topic is whose is told after the topics and nodes themselves
        rig.spin_until(lambda node=node, wanted=wanted: wanted <= published(node), f"the publishers of {node}")
    for topic, wanted_qos in {**{f"/{name}": each for name, each in qos.TOPICS.items()}, **qos.FRAMES}.items():
        endpoints = see.get_publishers_info_by_topic(topic) + see.get_subscriptions_info_by_topic(topic)
        assert endpoints, topic
        for endpoint in endpoints:
            policies = ["reliability", "durability", "deadline"]
            if endpoint.endpoint_type.name != "SUBSCRIPTION":
                policies.append("lifespan")  # a publisher's promise
            for policy in policies:
                found, wanted_value = promise(endpoint.qos_profile, policy), promise(wanted_qos, policy)
                assert found == wanted_value, (topic, endpoint.node_name, policy)


@pytest.mark.parametrize("name", MODULES)
def test_each_parameter_has_words_range_and_a_place_in_readme(name: str) -> None:
    for setting in MODULES[name][0].SETTINGS:
        assert f"`{setting.name}`" in README, f"{name}: {setting.name}"
        descriptor = setting.descriptor()
        assert len(descriptor.description) > 10, setting.name
        if isinstance(setting.default, (int, float)) and not isinstance(setting.default, bool):
            (bounds,) = (*descriptor.floating_point_range, *descriptor.integer_range)
            assert bounds.from_value < bounds.to_value, setting.name
        assert setting.live or "fixed while the node is active" in descriptor.additional_constraints, setting.name


def set_parameter(rig: RosRig, node: str, name: str, value: object) -> tuple[bool, str]:
    message = Parameter(name, value=value).to_parameter_msg()
    result = rig.ask(SetParameters, f"/{node}/set_parameters", parameters=[message]).results[0]
    return result.successful, result.reason


def test_max_speed_changes_while_the_controller_runs(rig: RosRig) -> None:
    from fsai_vcu.interface.enums import Ami

    node = rig.start(vehicle_controller.VehicleController)

    def goes_by(missions: Iterable[Ami], speeds: list[float]) -> Callable[[], bool]:
        return lambda: [node._controller.max_speed_mps(mission) for mission in missions] == speeds

    for speed in (5, 3.5):  # a whole number is a speed too
        assert set_parameter(rig, "vehicle_controller", "max_speed", speed) == (True, "")
        rig.spin_until(goes_by(Ami, [speed] * len(Ami)), "its speed in every mission")
    for name, speed in (("lap_max_speed", 3.4), ("skidpad_max_speed", 3.3), ("acceleration_max_speed", 3.2)):
        assert set_parameter(rig, "vehicle_controller", name, speed) == (True, "")
    missions = (Ami.AUTOCROSS, Ami.TRACKDRIVE, Ami.SKIDPAD, Ami.ACCELERATION, Ami.AUTONOMOUS_DEMO)
    rig.spin_until(goes_by(missions, [3.4, 3.4, 3.3, 3.2, 3.5]), "the speeds of missions")
    for value in (0.0, -1.0, 100.0, float("nan"), float("inf"), "fast", True):
        done, reason = set_parameter(rig, "vehicle_controller", "max_speed", value)
        assert not done and "max_speed" in reason


@pytest.mark.parametrize(
    ("max_speed", "limits", "loud"),
    [
        (30.0, UNLIMITED, True),
        (30.0, OperationalLimits(max_steer_deg=10.0), True),
        (29.0, UNLIMITED, False),
        (30.0, OperationalLimits(max_speed_mps=5.0), False),
    ],
)
def test_where_no_speed_limit_is_set_one_line_says_so(
    rig: RosRig, capfd: pytest.CaptureFixture[str], max_speed: float, limits: OperationalLimits, loud: bool
) -> None:
    node = rig.start(vehicle_controller.VehicleController, max_speed=max_speed)
    for _ in range(3):
        node._on_state(VehicleState(operational_limits=list(limits.described())))
    assert capfd.readouterr().err.count("no speed limit is set") == int(loud)


def test_a_mission_that_the_limit_forbids_is_named_with_its_run(rig: RosRig, capfd: pytest.CaptureFixture[str]) -> None:
    from fsai_vcu.interface.enums import Ami

    node = rig.start(vehicle_controller.VehicleController, max_speed=3.0)
    node._on_run(RunState(run_id=3, mission=int(Ami.AUTONOMOUS_DEMO)))
    assert "AUTONOMOUS_DEMO needs 4.17 m/s, but the speed limit is 3.00 m/s" in capfd.readouterr().err


def test_setting_an_unknown_parameter_is_refused_by_suggestion(rig: RosRig) -> None:
    rig.start(path_planner.PathPlanner)
    done, reason = set_parameter(rig, "path_planner", "lapz", 3)
    of_humble = "undeclared parameter(s): []" if HUMBLE else None  # it refuses it before any node is asked
    assert not done and (of_humble or "unknown parameter lapz: did you mean laps?") in reason
    done, reason = set_parameter(rig, "path_planner", "zebra", 3)
    words = "unknown parameter zebra: path_planner has car, laps, range_max_m, horizon_m"
    assert not done and (of_humble or words) in reason
    assert set_parameter(rig, "path_planner", "laps", 3) == (True, "")


def test_no_node_starts_with_an_unknown_parameter(rig: RosRig) -> None:
    for module, kind in MODULES.values():
        known = module.SETTINGS[0].name
        with pytest.raises(NodeError, match=f"unknown parameter {known}z: did you mean {known}"):
            rig.start(kind, **{f"{known}z": 1})


def test_parameters_of_ros_itself_are_no_unknown_ones(rig: RosRig) -> None:
    own = {"use_sim_time": False, "start_type_description_service": True, "qos_overrides./rosout.publisher.depth": 5}
    rig.start(path_planner.PathPlanner, **own)


def test_parameters_for_no_node_by_name_are_told_apart(tmp_path: Path) -> None:
    file = tmp_path / "shared.yaml"
    file.write_text(
        "/**:\n  ros__parameters: {laps: 3, camera: {rate: 30}}\n  path_planner:\n    ros__parameters: {car: x}\n"
        "vcu_bridge:\n  ros__parameters: {revision: x}\n/car1:\n  '*':\n    ros__parameters: {horizon_m: 9.0}\n"
    )
    given = "node --ros-args -p max_speed:=3 -p path_planner:range_max_m:=9 --param /**:noise_level:=1 --params-file"
    found = Scattered.among([*given.split(), str(file), "--params-file", str(tmp_path / "absent.yaml")])
    assert found.unnamed == {"max_speed", "noise_level"}
    assert found.of_files == {"laps", "camera.rate", "horizon_m"}


def test_noise_and_confidence_threshold_change_while_running(rig: RosRig) -> None:
    rig.start(sensor_simulator.SensorSimulator, truth_port=free_port())
    detector = rig.start(cone_detector.ConeDetector)
    assert set_parameter(rig, "sensor_simulator", "noise_level", 0.0) == (True, "")
    assert set_parameter(rig, "cone_detector", "confidence_threshold", 0.75) == (True, "")
    rig.spin_until(lambda: detector._threshold == 0.75, "the new threshold")


def test_the_bridge_refuses_another_bus_while_active(rig: RosRig, bus: str) -> None:
    rig.start(vcu_bridge.VcuBridge, can_interface=bus, real_time=False)
    for name, value in (("can_interface", "vcan7"), ("revision", "2021"), ("listen_only", True)):
        done, reason = set_parameter(rig, "vcu_bridge", name, value)
        assert not done and name in reason and "deactivate" in reason


def test_a_bridge_that_waits_to_be_configured_takes_another_bus(rig: RosRig) -> None:
    rig.start(vcu_bridge.VcuBridge, autostart=False)
    assert set_parameter(rig, "vcu_bridge", "can_interface", "vcan7") == (True, "")


def test_a_revision_given_as_a_number_is_that_revision(rig: RosRig) -> None:
    node = rig.start(
        vcu_bridge.VcuBridge, can_interface=f"loopback:revision-{os.getpid()}", real_time=False, revision=2021
    )
    assert node._configured.revision == "2021"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"can_interface": "nosuch0"}, "no CAN interface 'nosuch0'"),
        ({"dbc_files": "absent/car.dbc"}, "absent/car.dbc: no such DBC file"),
        ({"limits": "absent/limits.toml"}, "absent/limits.toml"),
        ({"limits": "max_sped_mps=3.0"}, "unknown limit max_sped_mps"),
        ({"wheel_mapping": "fl=fr"}, "wheel mapping"),
        ({"holding_brake_pct": float("nan")}, "holding_brake_pct"),
    ],
)
def test_a_bridge_that_cannot_start_says_why(
    bus: str, values: dict[str, object], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with RosRig() as rig, pytest.raises(NodeError, match=words):
        rig.start(vcu_bridge.VcuBridge, **{"can_interface": bus, **values})


def test_the_detector_drops_unsure_cones_and_keeps_the_stamp(rig: RosRig) -> None:
    from fsai_msgs.msg import Cone, ConeArray

    rig.start(cone_detector.ConeDetector, confidence_threshold=0.5)
    received = rig.subscribe(ConeArray, "/detected_cones", qos.SENSOR)
    publisher = rig.tester.create_publisher(ConeArray, "/raw_cones", qos.SENSOR)
    rig.spin_until(lambda: publisher.get_subscription_count() > 0, "the detector listens")
    raw = ConeArray(
        cones=[
            Cone(x=1.0, y=1.0, confidence=0.5),
            Cone(x=2.0, y=1.0, confidence=0.49),
            Cone(x=float("nan"), y=1.0, confidence=1.0),
            Cone(x=4.0, y=1.0, confidence=float("nan")),
        ]
    )
    raw.header.stamp.sec = 77

    def answered() -> bool:
        publisher.publish(raw)  # best effort: the first may come before the connection stands
        return bool(received)

    rig.spin_until(answered, "detected cones")
    assert [cone.x for cone in received[0].cones] == [1.0]
    assert received[0].header.stamp.sec == 77


def test_every_timer_goes_by_the_monotonic_clock() -> None:
    """rclpy's default timers go by the wall clock: they stand still when it is set back."""
    for path in (CHECKOUT / "nodes" / "fsai_nodes" / "fsai_nodes").glob("*.py"):
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute):
                if call.func.attr == "create_timer":
                    assert any(keyword.arg == "clock" for keyword in call.keywords), path.name
                assert (call.func.attr, ast.unparse(call.func.value)) != ("time", "time"), path.name


def test_launch_and_parameter_files_name_what_exists() -> None:
    import yaml

    known = {name: {setting.name: setting for setting in module.SETTINGS} for name, (module, _) in MODULES.items()}
    package = CHECKOUT / "nodes" / "fsai_nodes"
    for path in (package / "config").glob("*.yaml"):
        for node, content in yaml.safe_load(path.read_text()).items():
            for name, value in content["ros__parameters"].items():
                assert known[node][name].problem(value) is None, (path.name, node, name)
    for argument, nodes in PARAMETERS.items():
        for node in nodes:
            assert argument in known[node]
    assert set(CLASSES) == set(MODULES)


def test_a_misspelt_launch_argument_is_named_with_the_right_one() -> None:
    known = ["laps", "max_speed", "composed"]
    assert misspelt(["lapz", "max_speed"], known) == "unknown argument lapz: did you mean laps?"
    assert misspelt(["laps", "composed", "robot_name_of_another_file"], known) == ""


@pytest.mark.skipif(HUMBLE, reason="Humble refuses unknown parameters itself")
def test_requests_without_end_get_few_lines_in_the_log(rig: RosRig, bus: str) -> None:
    """Each is answered; what a person asks is all said."""
    log = rig.log()
    rig.start(vcu_bridge.VcuBridge, can_interface=bus, real_time=False)
    before = len(log)
    begin_s = time.monotonic()
    modes = [rig.ask(SetMode, "/set_mode", mode=f"m{number}").message for number in range(20)]
    unknown = [ParameterMessage(name=f"p{number}", value=ParameterValue(type=1)) for number in range(50)]
    answers = rig.ask(SetParameters, "/vcu_bridge/set_parameters", parameters=unknown).results
    atomic = rig.ask(SetParametersAtomically, "/vcu_bridge/set_parameters_atomically", parameters=unknown).result
    for number in range(20):
        flag = ParameterMessage(name="publish_tf", value=ParameterValue(type=1, bool_value=bool(number % 2)))
        assert rig.ask(SetParameters, "/vcu_bridge/set_parameters", parameters=[flag]).results[0].successful
    seconds = time.monotonic() - begin_s
    assert len(set(modes)) == 20 and all("unknown parameter p" in each.reason for each in answers)
    assert atomic.reason.endswith("; and 47 more")
    assert logged(log, "set_mode 'm0'") and logged(log, "set_mode 'm1'") and logged(log, "unknown parameter p2")
    assert len(log) - before < 3 * ANSWERS * (seconds + 2.0)
