"""The operator at the AI computer's keyboard, over real ROS 2: services, the run's action, the state's topic."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

from fsai_hil.rehearsal.stack import Stack, StackError, holds_within
from fsai_vcu.runtime.transport import VARIABLES, set_transport

ANSWER_TIMEOUT_S = 60.0
ASK_AGAIN_S = 1.0
ASK_PAUSE_S = 0.3
_SPIN_S = 0.1
_QUEUED_S = 0.3  # more than five states of a bridge that publishes 25 a second


class RosOperator:
    """One ROS node on the stack's domain. Not thread-safe; it listens only while one of its methods runs."""

    def __init__(self, stack: Stack, name: str = "operator") -> None:
        """Join the stack's ROS domain, with a client for each of the bridge's interfaces."""
        self._stack = stack
        # rclpy reads its environment once, when it is first initialised.
        for variable in VARIABLES:
            os.environ.pop(variable, None)
        os.environ["ROS_DOMAIN_ID"] = stack.environ["ROS_DOMAIN_ID"]
        set_transport(os.environ)
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from fsai_msgs.action import RunMission
        from fsai_msgs.msg import VehicleState
        from fsai_msgs.srv import SetMode
        from rclpy.action import ActionClient
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import qos_profile_sensor_data
        from std_srvs.srv import Trigger

        self._rclpy = rclpy
        self._types = (RunMission, SetMode, Trigger)
        rclpy.init()
        self.node = rclpy.create_node(name)
        # rclpy.spin_once would take the node into an executor and out of it again at each message.
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._run_mission = ActionClient(self.node, RunMission, "/run_mission")
        self._set_mode = self.node.create_client(SetMode, "/set_mode")
        self._triggers = {each: self.node.create_client(Trigger, each) for each in ("/emergency_brake", "/reset")}
        self.state: Any = None  # the newest VehicleState
        self._diagnostics: dict[str, dict[str, str]] = {}  # the newest, by the bridge's parts

        def on_state(message: Any) -> None:
            self.state = message

        def on_diagnostics(message: Any) -> None:
            for status in message.status:
                values = {value.key: value.value for value in status.values}
                self._diagnostics[status.name.removeprefix("vcu_bridge: ")] = {"message": status.message, **values}

        self.node.create_subscription(VehicleState, "/vehicle_state", on_state, qos_profile_sensor_data)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._rclpy.try_shutdown()

    # ------------------------------------------------------------ waiting

    def spin(self) -> None:
        """Receive what has arrived, for a moment."""
        self._executor.spin_once(timeout_sec=_SPIN_S)

    def await_that(self, condition: Callable[[], bool], timeout_s: float, what: str, *alive: str) -> None:
        """Listen until `condition` holds. Raises StackError when it does not in time, or one of `alive` has ended."""

        def turn() -> None:
            if alive:
                self._stack.check_alive(*alive)
            self.spin()

        if not holds_within(condition, timeout_s, turn):
            raise StackError(f"waited {timeout_s:g} s in vain: {what}; {self.describe()}")

    def await_bridge(self, timeout_s: float) -> None:
        """Listen until the bridge offers its services and its action. Raises StackError as `await_that`."""
        clients = (self._set_mode, *self._triggers.values())
        self.await_that(
            lambda: all(client.service_is_ready() for client in clients) and self._run_mission.server_is_ready(),
            timeout_s,
            "the bridge offers /set_mode, /emergency_brake, /reset and /run_mission",
            "vcu_bridge",
        )

    def await_state(self, condition: Callable[[Any], bool], timeout_s: float, what: str) -> Any:
        """The first VehicleState that meets `condition`."""
        self.await_that(lambda: self.state is not None and condition(self.state), timeout_s, what)
        return self.state

    def await_new_state(self, timeout_s: float, what: str) -> Any:
        """The next VehicleState; none of those that have been waiting in the queue."""
        holds_within(lambda: False, _QUEUED_S, self.spin)
        self.state = None
        return self.await_state(lambda _: True, timeout_s, what)

    def diagnostics(self, part: str) -> dict[str, str]:
        """Return message and values that the bridge next publishes of its 'link', 'supervision', 'car' or 'loop'."""
        self._diagnostics.pop(part, None)
        self.await_that(lambda: part in self._diagnostics, ANSWER_TIMEOUT_S, f"/diagnostics has the {part}")
        return self._diagnostics[part]

    def describe(self) -> str:
        """The newest state in a line, for messages about waiting in vain."""
        state = self.state
        if state is None:
            return "no /vehicle_state was ever received"
        return (
            f"last seen {state.as_state_label}, mode {state.mode}, {state.speed_mps:.1f} m/s, lap {state.laps}, "
            f"emergency '{state.emergency}', stopping '{state.stopping}', why not driving {list(state.why_not_driving)}"
        )

    # ------------------------------------------------------------ asking

    def set_mode(self, mode: str) -> tuple[bool, str]:
        return self._call(self._set_mode, self._types[1].Request(mode=mode))

    def become_autonomous(self, timeout_s: float, refused: Callable[[str], None] | None = None, *alive: str) -> str:
        """Ask for autonomous until the bridge accepts it (it does in AS_INIT, AS_OFF and AS_READY); its answer.

        `refused` gets each new reason for which it does not. Raises StackError when one of `alive` has ended.
        """
        message = ""

        def accepted() -> bool:
            nonlocal message
            if message:  # it has been refused
                holds_within(lambda: False, ASK_PAUSE_S, self.spin)
            reason = message
            accepted, message = self.set_mode("autonomous")
            if not accepted and message != reason and refused is not None:
                refused(message)
            return accepted

        self.await_that(accepted, timeout_s, "autonomous is accepted", *alive)
        return message

    def trigger(self, service: str) -> tuple[bool, str]:
        """Call /emergency_brake or /reset."""
        return self._call(self._triggers[service], self._types[2].Request())

    def _call(self, client: Any, request: Any) -> tuple[bool, str]:
        """Ask until there is an answer: the first one is lost when the server has not yet discovered its client.

        Every request of the operator may be repeated without harm.
        """
        until = time.monotonic() + ANSWER_TIMEOUT_S
        while True:
            future = client.call_async(request)
            if holds_within(future.done, ASK_AGAIN_S, self.spin):
                answer = future.result()
                return answer.success, answer.message
            client.remove_pending_request(future)
            if time.monotonic() > until:
                raise StackError(f"{client.srv_name} did not answer for {ANSWER_TIMEOUT_S:g} s; {self.describe()}")

    def run_mission(
        self, mission: str, until: str, timeout_s: float, feedback: Callable[[Any], None] | None = None, *alive: str
    ) -> Any:
        """Follow a run to its end over the action; its result. `feedback` gets each feedback message."""
        goal = self._types[0].Goal(mission=mission, until=until, timeout_s=timeout_s)
        callback = None if feedback is None else lambda message: feedback(message.feedback)
        sent = self._run_mission.send_goal_async(goal, feedback_callback=callback)
        self.await_that(sent.done, ANSWER_TIMEOUT_S, "the goal is taken")
        handle = sent.result()
        if not handle.accepted:
            raise StackError("the bridge did not take the /run_mission goal")
        future = handle.get_result_async()
        self.await_that(future.done, timeout_s + ANSWER_TIMEOUT_S, f"the run reaches '{until}'", *alive)
        return future.result().result
