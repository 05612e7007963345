"""The keys of encrypted DDS permit what each node opens, all of it: with one endpoint refused none of it starts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rclpy.node import Node
from ros_rig import RosRig

from fsai_nodes.cone_detector import ConeDetector
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.pitwall import PitWall
from fsai_nodes.recorder import TopicRecorder
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.vehicle_controller import VehicleController
from fsai_nodes.visualization import Visualization
from fsai_vcu.cli.check_stack import by_clock, listen
from fsai_vcu.cli.services import operator_node
from fsai_vcu.diagnostics.stack.watch import StackWatch

POLICY = Path(__file__).parents[2] / "systemd" / "security" / "policy.xml"
ASKED = ("publish", "subscribe", "reply", "request")


def permitted(enclave: str) -> dict[str, set[str]]:
    """Names of topics and services by what the enclave's key permits with them."""
    found: dict[str, set[str]] = {how: set() for how in ASKED}
    (policy,) = [each for each in ElementTree.parse(POLICY).iter("enclave") if each.get("path") == f"/fsai/{enclave}"]
    for profile in policy.iter("profile"):
        for group in profile:
            for how in ASKED:
                if group.get(how) == "ALLOW":
                    found[how] |= {f"/{each.text}".replace("/~", f"/{profile.get('node')}") for each in group}
            if group.get("execute") == "ALLOW":
                actions = {f"/{each.text}" for each in group}
                found["publish"] |= {f"{name}/_action/{what}" for name in actions for what in ("feedback", "status")}
                goals = ("send_goal", "cancel_goal", "get_result")
                found["reply"] |= {f"{name}/_action/{what}" for name in actions for what in goals}
    return found


def opened(node: Node) -> Iterator[tuple[str, str]]:
    own = node.get_name(), node.get_namespace()
    for how, names in (
        ("publish", node.get_publisher_names_and_types_by_node(*own)),
        ("subscribe", node.get_subscriber_names_and_types_by_node(*own)),
        ("reply", node.get_service_names_and_types_by_node(*own)),
        ("request", node.get_client_names_and_types_by_node(*own)),
    ):
        for name, _ in names:
            yield how, name


def refused(node: Node, enclave: str) -> list[tuple[str, str]]:
    """What the node opens, and its keys do not permit."""
    may = permitted(enclave)
    found = list(opened(node))
    assert found, enclave
    return [(how, name) for how, name in found if name not in may[how]]


def test_the_nodes_may_open_all_that_they_open(rig: RosRig, bus: str) -> None:
    nodes = [rig.start(VcuBridge, can_interface=bus, real_time=False)]
    nodes += [rig.start(kind) for kind in (ConeDetector, PathPlanner, VehicleController, Visualization)]
    assert {node.get_name(): wrong for node in nodes if (wrong := refused(node, node.get_name()))} == {}


def test_the_operator_may_open_all_that_the_verbs_open() -> None:
    with operator_node() as node:
        listen(node, StackWatch())
        assert refused(node, "operator") == []


def test_who_listens_may_open_all_that_it_opens(rig: RosRig) -> None:
    for listener in (PitWall(), TopicRecorder()):
        try:
            assert refused(listener._node, "listener") == []
        finally:
            listener._node.destroy_node()
            listener._context.try_shutdown()


def test_a_node_that_may_not_be_asked_for_its_clock_is_left_out(rig: RosRig, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: object) -> None:
        raise RuntimeError("Failed to create client")

    monkeypatch.setattr(rig.tester, "create_client", refuses)
    assert by_clock(rig.tester, ["tester"]) == {}
