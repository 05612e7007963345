"""No exception of a callback ends a node: it is said, and the others go on. Only NodeError ends it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fsai_msgs.action import RunMission
from fsai_msgs.srv import SetMode
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient, ActionServer
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_rig import HUMBLE, RosRig, logged
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from fsai_nodes import qos
from fsai_nodes.complaints import complaints_of
from fsai_nodes.executor import ServiceAnswers
from fsai_nodes.parameters import NodeError, NodeParameter, Settings
from fsai_nodes.vcu_bridge import VcuBridge


def fails(*_: Any) -> Any:
    raise RuntimeError("of the test")


def said(log: list[Any], *words: str) -> Callable[[], bool]:
    return lambda: bool(logged(log, *words, "RuntimeError: of the test (test_executor.py:", level=40))


def test_a_subscription_that_raises_is_called_again(rig: RosRig) -> None:
    log = rig.log()
    node = rig.add(Node("listener"))
    taken: list[bool] = []

    def on_flag(message: Bool) -> None:
        taken.append(message.data)
        if message.data:
            fails()

    node.create_subscription(Bool, "flag", on_flag, 10)
    flags = rig.tester.create_publisher(Bool, "flag", 10)
    rig.spin_until(lambda: flags.get_subscription_count() > 0, "the listener")
    for flag in (True, False):
        flags.publish(Bool(data=flag))
    rig.spin_until(lambda: taken == [True, False], "both messages")
    rig.spin_until(said(log, "/flag raised"), "the error")


def test_timers_tasks_and_answers_callbacks_may_raise(rig: RosRig) -> None:
    log = rig.log()
    node = rig.add(Node("worker"))
    node.create_timer(0.01, fails, clock=Clock(clock_type=ClockType.STEADY_TIME))
    rig.spin_until(said(log, "timer fails raised"), "the timer's error")
    rig.executor.create_task(fails)
    rig.spin_until(said(log, "a task raised"), "the task's error")
    node.create_guard_condition(fails).trigger()
    rig.spin_until(said(log, "timer fails raised"), "the guard condition's error")
    node.create_service(Trigger, "well", lambda _, answer: answer)
    client = rig.tester.create_client(Trigger, "well")
    rig.spin_until(client.service_is_ready, "the service")
    before = tasks_raised(rig)
    client.call_async(Trigger.Request()).add_done_callback(fails)
    rig.spin_until(lambda: tasks_raised(rig) > before, "the answer's callback")


def tasks_raised(rig: RosRig) -> int:
    return sum(complaints_of(node).count("a task") for node in rig.nodes)


def test_a_service_that_raises_answers_no_and_why(rig: RosRig) -> None:
    log = rig.log()
    node = rig.add(Node("server"))
    node.create_service(Trigger, "broken", fails)
    for _ in range(2):
        answer = rig.ask(Trigger, "/broken")
        assert (answer.success, answer.message) == (False, "RuntimeError: of the test")
    rig.spin_until(said(log, "/broken raised"), "the error")


def test_what_cannot_be_taken_makes_no_node_deaf(rig: RosRig, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a request whose text cannot be decoded: the next one is heard."""
    log = rig.log()
    node = rig.add(Node("server"))

    def answer(_request: Any, response: Any) -> Any:
        response.success = True
        return response

    node.create_service(Trigger, "well", answer)
    take = SingleThreadedExecutor._take_service
    first = [True]

    def takes(executor: Any, service: Any) -> Any:
        if service.srv_name == "well" and first:
            first.clear()
            take(executor, service)  # it is gone
            fails()
        return take(executor, service)

    monkeypatch.setattr(SingleThreadedExecutor, "_take_service", takes)
    client = rig.tester.create_client(Trigger, "well")
    rig.spin_until(client.service_is_ready, "the service")
    client.call_async(Trigger.Request())
    rig.spin_until(said(log, "/well raised"), "the error")
    assert rig.ask(Trigger, "/well").success


def test_a_goal_and_a_cancel_callback_may_raise(rig: RosRig) -> None:
    log = rig.log()
    node = rig.add(Node("server"))
    server = ActionServer(node, RunMission, "run", fails, goal_callback=fails, cancel_callback=fails)
    client = ActionClient(rig.tester, RunMission, "run")
    rig.spin_until(client.server_is_ready, "the action")
    client.send_goal_async(RunMission.Goal())
    rig.spin_until(said(log, "raised"), "the goal callback's error")
    server.register_goal_callback(None)
    server.register_handle_accepted_callback(lambda _: None)
    goal = client.send_goal_async(RunMission.Goal())
    rig.spin_until(goal.done, "another goal")
    assert goal.result().accepted
    goal.result().cancel_goal_async()
    rig.spin_until(lambda: complaints_of(node).count("ActionServer") == 2, "the cancel callback's error")
    server.destroy()
    client.destroy()


@pytest.mark.skipif(HUMBLE, reason="in Humble it is called when the answer has been given")
def test_a_parameter_callback_that_raises_is_answered(rig: RosRig) -> None:
    log = rig.log()
    node = rig.add(Node("settable"))
    Settings(node, (NodeParameter("gain", 1.0, "A gain for the test.", low=0.0, high=9.0, live=True),), fails)
    value = Parameter(name="gain", value=ParameterValue(type=3, double_value=2.0))
    result = rig.ask(SetParameters, "/settable/set_parameters", parameters=[value]).results[0]
    assert (result.successful, result.reason) == (False, "RuntimeError: of the test")
    rig.spin_until(said(log, "/settable/set_parameters raised"), "the error")
    odd = Parameter(name="gain", value=ParameterValue(type=77))
    result = rig.ask(SetParameters, "/settable/set_parameters", parameters=[odd]).results[0]
    assert (result.successful, result.reason) == (False, "parameters[0].value.type is 77, not 0 to 9")
    assert rig.ask(GetParameters, "/settable/get_parameters", names=["gain"]).values[0].double_value == 2.0


def test_use_sim_time_cannot_change_while_a_node_runs(rig: RosRig) -> None:
    node = rig.add(Node("settable"))
    Settings(node, (), lambda _: None)
    value = Parameter(name="use_sim_time", value=ParameterValue(type=1, bool_value=True))
    result = rig.ask(SetParameters, "/settable/set_parameters", parameters=[value]).results[0]
    assert not result.successful and "use_sim_time cannot change while the node runs" in result.reason
    assert not node.get_clock().ros_time_is_active


def test_one_that_only_raises_for_a_second_is_in_diagnostics(rig: RosRig) -> None:
    log = rig.log()
    told = rig.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
    node = rig.add(Node("worker"))
    broken = [True]

    def work() -> None:
        if broken:
            fails()

    timer = node.create_timer(0.01, work, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def errors() -> list[DiagnosticStatus]:
        return [each for array in told for each in array.status if each.name.startswith("worker: timer ")]

    rig.spin_until(lambda: any("nothing but raise for" in each.message for each in errors()), "/diagnostics")
    assert {each.level for each in errors()} == {DiagnosticStatus.ERROR}
    assert len(logged(log, "work raised")) <= 4, "once, and then once a second"
    broken.clear()
    rig.turns(20)
    assert not rig.executor._raising
    node.destroy_timer(timer)


def test_a_node_error_ends_the_node(rig: RosRig) -> None:
    def ends() -> None:
        raise NodeError("the CAN loop ended by itself")

    rig.executor.create_task(ends)
    with pytest.raises(NodeError):
        rig.turns(5)


# ---------------------------------------------------------------- answers that nobody takes


def test_an_answer_that_waits_holds_up_the_others_for_a_fifth() -> None:
    sent: list[str] = []
    waited: list[Any] = []
    answers = ServiceAnswers(waited.append)

    def wait() -> None:
        time.sleep(0.06)
        sent.append("waited")

    def put(service: str, send: Callable[[], None]) -> None:
        answers.put(service, send)  # type: ignore[arg-type]

    put("deaf", wait)
    assert (sent, waited) == (["waited"], ["deaf"])
    for _ in range(20):
        put("deaf", wait)
    put("emergency_brake", lambda: sent.append("braked"))
    assert sent == ["waited"], "now there is a pause"
    time.sleep(0.3)
    answers.send()
    assert sent == ["waited", "braked", "waited"]
    for _ in range(20):
        answers._due_ns = 0
        answers.send()
    assert sent.count("waited") < 15, "the oldest are given up"


def test_a_client_that_hears_no_answer_delays_no_other_request(rig: RosRig) -> None:
    log = rig.log()
    node, asked = rig.add(Node("serving")), [0]

    def count(_request: Any, response: Any) -> Any:
        asked[0] += 1
        return response

    services = [node.create_service(Trigger, f"/s{number}", count) for number in range(5)]
    deaf = qos.profile(10, kept=True)  # of what is asked; and then what is answered has to be kept, too
    clients = [rig.tester.create_client(Trigger, each.srv_name, qos_profile=deaf) for each in services]
    rig.turns(50)

    def heard() -> bool:
        for client in clients:
            client.call_async(Trigger.Request())
        rig.turns(10)
        return bool(logged(log, "an answer waited for its client"))

    rig.spin_until(heard, "an answer that waited")
    before, begin_s = asked[0], time.monotonic()
    while asked[0] < before + 20:
        heard()
    assert time.monotonic() - begin_s < 1.5, "else each takes 100 ms"


# ---------------------------------------------------------------- the lifecycle


@pytest.mark.parametrize("label", ["", "cleanup", "nonsense", "x" * 1000])
def test_a_transition_not_allowed_is_answered_no(
    rig: RosRig, bus: str, label: str, capfd: pytest.CaptureFixture[str]
) -> None:
    bridge = rig.start(VcuBridge, can_interface=bus, real_time=False)
    wrong = Transition(id=Transition.TRANSITION_CLEANUP, label=label)
    assert not rig.ask(ChangeState, "/vcu_bridge/change_state", transition=wrong).success
    assert rig.ask(GetState, "/vcu_bridge/get_state").current_state.label == "active"
    assert "[rcl_lifecycle]" not in capfd.readouterr().err, "it would have a line for each"
    assert bridge._loop is not None and bridge._loop.running
    assert rig.ask(SetMode, "/set_mode", mode="manual").success
