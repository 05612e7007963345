"""In a namespace every node finds the others, and nothing is left outside it."""

from __future__ import annotations

import pytest
from fsai_msgs.msg import VehicleState
from fsai_msgs.srv import SetMode
from ros_rig import RosRig, ScriptedVcu, overrides

from fsai_nodes import qos
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.recorder import TopicRecorder
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.vehicle_controller import VehicleController
from fsai_nodes.visualization import Visualization
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.messages import VcuStatus

NAMESPACE = "/car1"


def start(rig: RosRig, kind: type, **parameters: object):  # type: ignore[no-untyped-def]
    options = {"parameter_overrides": overrides(**parameters), "use_global_arguments": False}
    return rig.add(kind(namespace=NAMESPACE, **options))


def test_bridge_and_controller_work_together_in_a_namespace(rig: RosRig, bus: str) -> None:
    with ScriptedVcu(bus, VcuStatus(as_state=AsState.AS_OFF, ami=Ami.STATIC_INSPECTION_A)):
        bridge = start(rig, VcuBridge, can_interface=bus, real_time=False)
        start(rig, VehicleController)
        start(rig, PathPlanner)
        start(rig, Visualization)
        rig.spin_until(
            lambda: set(bridge._loop.report().confirmed) == {"planner", "controller"}, "both confirm their reset"
        )
        rig.spin_until(lambda: bridge._sensor_ns is not None, "a command reaches the bridge")
        assert rig.ask(SetMode, f"{NAMESPACE}/set_mode", mode="manual").success
        names = {name for name, _ in rig.tester.get_topic_names_and_types()}
        services = {name for name, _ in rig.tester.get_service_names_and_types()}
    assert {f"{NAMESPACE}/{topic}" for topic in qos.TOPICS if "cones" not in topic} <= names
    assert not {f"/{topic}" for topic in qos.TOPICS} & names
    assert not {"/set_mode", "/emergency_brake", "/reset", "/run_mission/_action/send_goal"} & services


def test_the_recorder_receives_the_nodes_of_its_namespace(rig: RosRig, bus: str) -> None:
    start(rig, VcuBridge, can_interface=bus, real_time=False)
    other = rig.tester.create_publisher(VehicleState, "/vehicle_state", qos.STATE)
    recorder = TopicRecorder(namespace=NAMESPACE)
    recorder.start()
    try:
        wanted = {f"{NAMESPACE}/vehicle_state", f"{NAMESPACE}/run_state"}

        def recorded() -> bool:
            other.publish(VehicleState())
            return wanted <= set(recorder.topics)

        rig.spin_until(recorded, "the namespace's topics")
        assert "/vehicle_state" not in recorder.topics
    finally:
        recorder.stop()
    with pytest.raises(ValueError, match="car one is not a ROS namespace"):
        TopicRecorder(namespace="car one")
