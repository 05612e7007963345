"""A message from ROS that does not fit is refused in a sentence, whatever it is, and nothing of it ends a node."""

from __future__ import annotations

import ast
import math
import time
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from pathlib import Path as FilePath
from typing import Any

import pytest
import ros_attacks
from fsai_msgs.action import RunMission
from fsai_msgs.msg import Cone, ConeArray, PlannerStatus, ResetConfirmation, RunState, VehicleCommand, VehicleState
from fsai_msgs.srv import SetMode
from geometry_msgs.msg import Point, Pose, PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import CancelResponse, GoalResponse
from rclpy.node import Node
from rclpy.serialization import serialize_message
from ros_attacks import Attack, attacks, class_of, together
from ros_rig import STATUS, Driving, RosRig, ScriptedVcu, logged, while_driving
from sensor_msgs.msg import Imu
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from visualization_msgs.msg import MarkerArray

import fsai_nodes
from fsai_hil.simulator.ground_truth import TruthReceiver
from fsai_nodes import qos
from fsai_nodes.ackermann_adapter import AckermannAdapter
from fsai_nodes.complaints import complaints_of
from fsai_nodes.cone_detector import ConeDetector
from fsai_nodes.declarations import DECLARED, key_of
from fsai_nodes.door import MOST_GOALS, MOST_KEPT, Door
from fsai_nodes.fields import FREE, UNREAD, Kind, Number, Parts, Several, Text, Whole, listed, printable
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.sensor_simulator import SensorSimulator
from fsai_nodes.vcu_bridge import VcuBridge
from fsai_nodes.vehicle_controller import VehicleController
from fsai_nodes.visualization import Visualization
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.messages import AiDriveFront, AiDriveRear

NODES = FilePath(fsai_nodes.__file__).parent
RUN = 7
GID = bytes(range(16))


# ---------------------------------------------------------------- kinds of fields


UNIT, STOP, STATE = Number(0.0, 1.0), Number(0.0, 10.0, nan="no stop known"), Whole(0, 5, also=(255,))
ROLE = Text(20, ("planner", "controller"))


@pytest.mark.parametrize(
    ("kind", "value", "words"),
    [
        *((UNIT, value, "") for value in (0.0, -0.0, 1.0, 5e-324)),
        (UNIT, 1.5, "f is 1.5, not a number from 0 to 1"),
        (UNIT, -0.1, "f is -0.1, not a number from 0 to 1"),
        (UNIT, math.nan, "f is nan, not a number from 0 to 1"),
        (UNIT, math.inf, "f is inf, not a number from 0 to 1"),
        (UNIT, -math.inf, "f is -inf, not a number from 0 to 1"),
        (STOP, math.nan, ""),
        (STOP, -1.0, "f is -1, not a number from 0 to 10 or NaN (no stop known)"),
        *((STATE, value, "") for value in (0, 5, 255)),
        (STATE, 6, "f is 6, not 0 to 5 or 255"),
        (ROLE, "x" * 21, "f is 'xxxxxxxxxxxxxxxxxxxxx', longer than 20 characters"),
        (ROLE, "driver", "f is 'driver', not one of planner, controller"),
        (Text(20), "a\x1b[2J\n", r"f is 'a\x1b[2J\n', which has control characters"),
        (Several(Text(3), 5), ["abc", "abcd"], "f[1] is 'abcd', longer than 3 characters"),
    ],
)
def test_what_does_not_fit_its_field_is_named_with_its_bounds(kind: Kind, value: Any, words: str) -> None:
    assert kind.misfit(value, "f") == words


def test_a_long_text_is_repeated_shortened() -> None:
    assert printable("A" * 300_000, 10) == "AAAAAAAAAA… (300000 characters)"
    assert len(printable("\x01" * 300_000)) < 100


def test_an_array_says_which_of_its_items_do_not_fit() -> None:
    points = Several(Parts(x=Number(-1.0, 1.0), y=Number(-1.0, 1.0), z=UNREAD), 5)
    array = [Point(), Point(y=math.nan), Point(x=3.0, z=math.inf)]
    assert points.misfit(array, "points") == "points[2].x is 3, not a number from -1 to 1"
    assert points.unfit(array, "points")[0].tolist() == [False, True, True]
    assert points.misfit([Point()] * 6, "points") == "points has 6 items, more than 5"
    assert points.misfit([Point(z=math.nan)], "points") == ""


# ---------------------------------------------------------------- declarations


@pytest.mark.parametrize("key", DECLARED)
def test_each_field_is_declared_or_called_unread(key: str) -> None:
    assert key_of(class_of(key)) == key
    _same_fields(class_of(key), DECLARED[key], key)


def _same_fields(kind: type[Any], parts: Parts, where: str) -> None:
    found = kind.get_fields_and_field_types()
    assert set(parts.fields) == set(found), where
    for name, type_name in found.items():
        field = parts.fields[name]
        item = ros_attacks.item_of(type_name)
        if item is not None and isinstance(field, Several):
            field, type_name = field.each, item
        elif item is not None:
            assert field is UNREAD or (field is FREE and type_name.endswith("]")), f"{where}.{name} has no bound"
            continue
        if isinstance(field, Parts):
            _same_fields(class_of(type_name), field, f"{where}.{name}")
        elif type_name in ("double", "float"):
            by_parameter = where.endswith(".value")  # the parameter's own declaration judges it
            assert isinstance(field, Number) or field is UNREAD or by_parameter, f"{where}.{name}"
        elif type_name == "string":
            assert isinstance(field, Text) or field is UNREAD, f"{where}.{name}"


def test_nothing_is_taken_from_ros_but_through_the_door() -> None:
    made = {"create_subscription", "create_service", "ActionServer"}
    for path in NODES.glob("*.py"):
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call):
                name = ast.unparse(call.func).rpartition(".")[2]
                assert name not in made or path.name == "door.py", f"{path.name}: {name}"


def test_an_undeclared_type_makes_no_subscription_or_service(rig: RosRig) -> None:
    door = Door(rig.tester)
    with pytest.raises(LookupError, match="sensor_msgs/Imu is taken by a node and not declared"):
        door.subscription(Imu, "imu", print)
    with pytest.raises(LookupError, match="std_srvs/SetBool_Request"):
        door.service(SetBool, "switch", print)


# ---------------------------------------------------------------- generated attacks


GOOD: dict[type[Any], Any] = {
    RunState: RunState(run_id=RUN, mission=int(Ami.TRACKDRIVE), as_state=3, may_move=True),
    VehicleState: VehicleState(run_id=RUN, as_state=3, mission=4, speed_mps=3.0, x=1.0),
    ConeArray: ConeArray(
        cones=[Cone(x=x, y=y, color=c, confidence=1.0) for x in (2.0, 5.0, 8.0) for y, c in ((1.5, 1), (-1.5, 2))]
    ),
    PlannerStatus: PlannerStatus(run_id=RUN, mission=4, stop_distance_m=math.nan),
    Path: Path(
        header=Header(frame_id="base_link"),
        poses=[PoseStamped(pose=Pose(position=Point(x=float(x)))) for x in range(4)],
    ),
    ResetConfirmation: ResetConfirmation(role="planner", run_id=RUN),
}


class Stack:
    """All nodes in this process, given messages as their subscriptions are, without a middleware in between."""

    def __init__(self, rig: RosRig, bus: str) -> None:
        with TruthReceiver(0) as free:
            free_port = int(free.port)
        self.rig = rig
        self.bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)
        self.controller = rig.start(VehicleController)
        self.visualization = rig.start(Visualization)
        self.nodes: list[Node] = [
            self.bridge,
            self.controller,
            rig.start(PathPlanner),
            rig.start(ConeDetector),
            *(rig.start(AckermannAdapter, preset=team) for team in ("eufs", "eufs_sim2", "fsai_api")),
            self.visualization,
            rig.start(SensorSimulator, truth_port=free_port),
        ]
        rig.subscribe(MarkerArray, "/markers", qos.VIEW)
        rig.spin_until(lambda: bool(self.visualization._markers.get_subscription_count()), "somebody looks")

    def give(self, kind: type[Any], data: bytes) -> list[tuple[Node, str]]:
        """To each subscription of the type; who refused it, on which topic. What a callback raises is raised here."""
        refused = []
        for node in self.nodes:
            for subscription in list(node.subscriptions):
                if subscription.msg_type is kind:
                    topic = subscription.topic_name
                    before = complaints_of(node).count(topic)
                    subscription.callback(data, {"publisher_gid": GID})
                    if complaints_of(node).count(topic) > before:
                        refused.append((node, topic))
        return refused

    def go_on(self) -> None:
        """Work with what they have now."""
        for kind in (RunState, VehicleState, ConeArray, PlannerStatus, Path, VehicleCommand):
            assert not self.give(kind, serialize_message(self.good(kind))), kind
        self.controller._tick()
        self.visualization._publish()
        self.bridge._publish()
        self.rig.turns()  # and what timers do

    def good(self, kind: type[Any]) -> Any:
        """A message as a stack in order sends it."""
        message = deepcopy(GOOD[kind]) if kind in GOOD else kind()
        if kind is VehicleCommand and self.bridge._outputs.run:
            message.run_id = self.bridge._outputs.run.run_id
        if hasattr(message, "header"):
            message.header.stamp = self.rig.stamp()
        return message


MESSAGES = [key for key in DECLARED if not key.endswith(("_Request", "_Goal"))]


def reads(key: str, field: str) -> bool:
    """Return true where a node reads it."""
    at: Any = DECLARED[key]
    for name in field.split("."):
        if isinstance(at, Several):
            at = at.each
        at = at.fields.get(name, UNREAD) if isinstance(at, Parts) else at
    return at is not UNREAD


def must_be_refused(key: str, attack: Attack) -> bool:
    meant = key == "fsai_msgs/PlannerStatus" and attack.field == "stop_distance_m" and attack.what == "nan"
    return (attack.not_finite and reads(key, attack.field) and not meant) or attack.huge or "1 MB" in attack.what


def test_no_generated_message_ends_a_node_bad_ones_are_refused(rig: RosRig, bus: str) -> None:
    """Each field of each message that a node takes, alone and together; few values: the others in the long form."""
    with ScriptedVcu(bus, STATUS) as vcu:
        stack = Stack(rig, bus)
        stack.go_on()
        given = 0
        for key in MESSAGES:
            kind = class_of(key)
            good = partial(stack.good, kind)
            for attack in (*attacks(kind, good), *together(kind, good, seed=len(key), count=20)):
                refused = stack.give(kind, attack.data)
                assert refused or not must_be_refused(key, attack), f"{attack} is not refused"
                stack.controller._tick()
                given += 1
            stack.go_on()
        assert given > 500
        rig.turns(20)
        torque = {image.torque_nm for image in vcu.received if isinstance(image, (AiDriveFront, AiDriveRear))}
        assert torque == {0.0}


def test_each_generated_request_has_its_answer(rig: RosRig, bus: str) -> None:
    stack = Stack(rig, bus)
    kept = {node: dict(node._parameters) for node in stack.nodes}
    for node, service in [(each, service) for each in stack.nodes for service in each.services]:
        kind, name = service.srv_type.Request, service.srv_name
        assert key_of(kind) in DECLARED, f"{name} takes {key_of(kind)}, which is not declared"
        if "set_parameters" in name or name.endswith("change_state"):
            continue  # these change the node: below
        for attack in attacks(kind):
            if attack.raw is None:
                answer = answer_to(rig, node, service, attack.message)
                assert isinstance(answer, service.srv_type.Response), attack
                if attack.huge:
                    assert complaints_of(node).count(node.resolve_service_name(name)), attack
    for node in stack.nodes:
        for parameter in kept[node].values():
            _set_to_anything(rig, node, parameter.name)
        same = {name: (value.value, node._parameters[name].value) for name, value in kept[node].items()}
        assert not [name for name, (before, now) in same.items() if isinstance(now, float) and not math.isfinite(now)]
    stack.go_on()


def answer_to(rig: RosRig, node: Node, service: Any, request: Any) -> Any:
    """As the executor has it answered."""
    answering = rig.executor._answering(service, node)
    coroutine = answering(request, service.srv_type.Response())
    for _ in range(1000):
        try:
            coroutine.send(None)
        except StopIteration as answer:
            return answer.value
        rig.turns(1)
    raise AssertionError(f"{service.srv_name} does not answer")


def _set_to_anything(rig: RosRig, node: Node, name: str) -> None:
    (service,) = [each for each in node.services if each.srv_name.endswith("/set_parameters")]
    values: list[dict[str, Any]] = [{"type": 200}]
    for field, kind in ParameterValue.get_fields_and_field_types().items():
        if field != "type" and not ros_attacks.item_of(kind):
            own_type = getattr(ParameterType, f"PARAMETER_{field.removesuffix('_value').upper()}", 200)
            bad = ros_attacks.values_of(kind, few=True).values()
            values += [{"type": number, field: value} for number in (0, own_type) for value in bad]
    for value in values:
        request = SetParameters.Request(parameters=[Parameter(name=name, value=ParameterValue(**value))])
        (result,) = answer_to(rig, node, service, request).results
        assert result.successful or result.reason, (name, str(value)[:60])


def test_no_generated_goal_ends_the_bridge(rig: RosRig, bus: str) -> None:
    bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)
    for attack in attacks(RunMission.Goal):
        if attack.raw is None:
            response = bridge._missions.action._goal_callback(attack.message)
            refused = attack.not_finite or attack.huge or attack.what in ("the largest", "control characters")
            assert response == (GoalResponse.REJECT if refused else GoalResponse.ACCEPT), attack
    assert complaints_of(bridge).count("/run_mission") > 5


# ---------------------------------------------------------------- over the wire


def test_what_was_kept_for_a_bridge_that_starts_is_refused(rig: RosRig, bus: str) -> None:
    log = rig.log()
    confirmations = rig.tester.create_publisher(ResetConfirmation, "/reset_confirmation", qos.CONFIRMATION)
    confirmations.publish(ResetConfirmation(role="x" * 300_000, run_id=1))
    confirmations.publish(ResetConfirmation(role="\x1b[2J" * 4, run_id=1))
    bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)
    words = ("/reset_confirmation of tester refused", "bytes, more than")
    rig.spin_until(lambda: bool(logged(log, *words)), words[-1])
    rig.spin_until(lambda: complaints_of(bridge).count("/reset_confirmation") == 2, "both are refused")
    answer = rig.ask(SetMode, "/set_mode", mode="manual")
    assert answer.success


def test_a_kept_state_with_infinity_is_refused(rig: RosRig) -> None:
    log = rig.log()
    states = rig.tester.create_publisher(VehicleState, "/vehicle_state", qos.STATE)
    states.publish(VehicleState(run_id=RUN, x=math.inf))
    rig.announce()
    words = "/vehicle_state of tester refused: x is inf, not a number from -1e+06 to 1e+06"
    nodes = [rig.start(kind) for kind in (PathPlanner, VehicleController)]
    rig.spin_until(lambda: logged(log, "/vehicle_state") == [words, words], words)
    assert [complaints_of(node).count("/vehicle_state") for node in nodes] == [1, 1]


def test_100000_cones_are_refused_before_they_are_unpacked(rig: RosRig) -> None:
    log = rig.log()
    detector = rig.start(ConeDetector)
    cones = rig.tester.create_publisher(ConeArray, "/raw_cones", qos.profile(1))
    message = ConeArray(cones=[Cone()] * 100_000)

    def refused() -> bool:
        cones.publish(message)
        rig.turns(5)
        return bool(logged(log, "/raw_cones of tester refused: it has 24000", "bytes, more than 65536"))

    rig.spin_until(refused, "the refusal")
    assert detector._raw.silence(0) or detector._watch is None, "as if nothing had come"


def test_a_refusal_is_said_at_once_then_once_a_second(rig: RosRig) -> None:
    log = rig.log()
    complaints = complaints_of(rig.tester)
    for now_ns in (0, 1, 999_999_999, 1_000_000_000):
        complaints.say("/path", "/path of x refused: y", now_ns=now_ns)
    rig.spin_until(lambda: len(logged(log, "/path of x refused")) == 2, "two lines")
    assert logged(log, "/path of x refused") == ["/path of x refused: y", "/path of x refused: y [3 times]"]


def test_cones_that_do_not_fit_are_left_out_and_said(rig: RosRig) -> None:
    log = rig.log()
    rig.start(ConeDetector)
    received = rig.subscribe(ConeArray, "/detected_cones", qos.SENSOR)
    cones = rig.tester.create_publisher(ConeArray, "/raw_cones", qos.SENSOR)
    raw = ConeArray(
        cones=[Cone(x=1.0, confidence=1.0), Cone(x=math.nan, confidence=1.0), Cone(color=9, confidence=1.0)]
    )

    def seen() -> bool:
        cones.publish(raw)
        rig.turns(2)
        return bool(received)

    rig.spin_until(seen, "cones")
    assert [cone.x for cone in received[0].cones] == [1.0]
    words = "/raw_cones of tester: 2 of 3 left out: cones[1].x is nan, not a number from -1000 to 1000"
    rig.spin_until(lambda: words in logged(log, "left out"), words)


# ---------------------------------------------------------------- one publisher of commands


def test_a_second_publisher_of_commands_is_refused_and_named() -> None:
    def show(rig: RosRig, vcu: ScriptedVcu, make: Callable[[], Driving]) -> None:
        log = rig.log()
        car = make()
        stranger = rig.add(Node("stranger"))
        other = stranger.create_publisher(VehicleCommand, "/vehicle_cmd", qos.COMMAND)

        def refused() -> bool:
            car.command()
            run_id = car.node._loop.report().run.run_id
            command = VehicleCommand(run_id=run_id, throttle=1.0, speed_limit_mps=5.0)
            command.header.stamp = rig.stamp()
            other.publish(command)
            rig.turns(3)
            return bool(logged(log, "/vehicle_cmd of stranger refused: run", "belongs to tester"))

        rig.spin_until(refused, "the refusal")
        for _ in range(20):
            refused()
        assert {image.torque_nm for image in vcu.received if isinstance(image, (AiDriveFront, AiDriveRear))} == {0.0}
        assert car.node._loop.report().run.as_state is AsState.AS_DRIVING

    while_driving(show)


def test_a_goal_whose_callback_raises_is_rejected(rig: RosRig, bus: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)

    def asks(*_: object) -> tuple[bool, str]:
        raise RuntimeError("of the test")

    monkeypatch.setattr(bridge, "_ask", asks)
    assert bridge._missions.action._cancel_callback(None) == CancelResponse.REJECT
    assert bridge._missions.action._goal_callback(RunMission.Goal()) == GoalResponse.ACCEPT
    bridge._missions.goals.update({bytes([number]): None for number in range(MOST_GOALS)})
    assert bridge._missions.action._goal_callback(RunMission.Goal()) == GoalResponse.REJECT
    bridge._missions.goals.clear()


def test_goals_that_come_without_end_are_refused(rig: RosRig, bus: str) -> None:
    """Each is kept for its result, and stands in every status: also one that is reached at once."""
    bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)
    answers = [bridge._missions.action._goal_callback(RunMission.Goal()) for _ in range(MOST_KEPT + 1)]
    assert answers == [GoalResponse.ACCEPT] * MOST_KEPT + [GoalResponse.REJECT]


def test_names_of_many_senders_are_three_and_a_count() -> None:
    assert listed(["b", "a", "b"], "and") == "a and b"
    assert listed(["a\x1b[2J"], "or") == r"a\x1b[2J"
    assert listed((f"{letter}{'x' * 250}" for letter in "abcde"), "or").endswith("(251 characters) or 2 more")
    assert len(listed((f"{number}{'x' * 250}" for number in range(1000)), "or")) < 300


def test_publishers_that_are_not_heard_are_said_once_a_second(rig: RosRig) -> None:
    log, begin_s = rig.log(), time.monotonic()
    Door(rig.tester).subscription(VehicleCommand, "vehicle_cmd", print)
    best_effort = qos.profile(1, reliable=False)
    for _ in range(10):
        publisher = rig.tester.create_publisher(VehicleCommand, "vehicle_cmd", best_effort)
        rig.turns()
        rig.tester.destroy_publisher(publisher)
    complaints = complaints_of(rig.tester)
    rig.spin_until(lambda: complaints.count("/vehicle_cmd, QoS") == 10, "ten mismatches")
    rig.spin_until(lambda: bool(logged(log, "/vehicle_cmd", "is not received")), "a line on them")
    assert len(logged(log, "/vehicle_cmd", "is not received")) <= 1 + time.monotonic() - begin_s
    assert not logged(log, "New publisher discovered")
