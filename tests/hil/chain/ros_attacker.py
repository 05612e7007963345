"""A ROS program that says to the nodes whatever the definitions of their messages allow, and what they do not.

A line of standard input is what to attack: `topic NAME TYPE`, `service NAME TYPE`, `action NAME TYPE` or `parameters
NODE`. `done LINE: NUMBER` is printed when all of it has been said; a service's answers have come by then.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rclpy
from fsai_msgs.msg import RunState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import ListParameters, SetParameters
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from fsai_nodes.qos import STATE, TOPICS

sys.path.insert(0, str(Path(__file__).parents[2] / "nodes"))
from ros_attacks import Attack, attacks, class_of, item_of, together, values_of

PAUSE_S = 0.01
PATIENCE_S = 60.0
TOGETHER = 100


class Attacker:
    def __init__(self) -> None:
        self.node = Node("attacker")
        self.run = RunState()
        self.node.create_subscription(RunState, "/run_state", self._on_run, STATE)

    def _on_run(self, message: RunState) -> None:
        if message.mission:  # the bridge's; what this program says comes back, too
            self.run = message

    def until(self, condition: Any, what: str) -> None:
        until = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > until:
                raise TimeoutError(what)
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def good(self, kind: type[Any]) -> Any:
        """One of the run in hand, stamped now, so that it is read as far as it can be."""
        message = kind()
        fields = kind.get_fields_and_field_types()
        if "header" in fields:
            message.header.stamp = self.node.get_clock().now().to_msg()
            message.header.frame_id = "base_link"
        if "run_id" in fields:
            message.run_id = self.run.run_id
        if "mission" in fields and fields["mission"] == "uint8":
            message.mission = self.run.mission
        if "stop_distance_m" in fields:
            message.stop_distance_m = math.nan
        return message

    def _all(self, kind: type[Any]) -> Iterator[Attack]:
        yield from attacks(kind, lambda: self.good(kind), few=False)
        yield from together(kind, lambda: self.good(kind), seed=1, count=TOGETHER)

    def topic(self, name: str, type_name: str) -> int:
        kind = class_of(type_name)
        kept = TOPICS[name].durability == DurabilityPolicy.TRANSIENT_LOCAL
        durability = DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE
        publisher = self.node.create_publisher(kind, f"/{name}", QoSProfile(depth=10, durability=durability))
        self.until(publisher.get_subscription_count, f"somebody reads /{name}")
        said = 0
        for attack in self._all(kind):
            publisher.publish(attack.data)
            rclpy.spin_once(self.node, timeout_sec=0.0)
            time.sleep(PAUSE_S)
            said += 1
        self.node.destroy_publisher(publisher)
        return said

    def service(self, name: str, type_name: str) -> int:
        kind = class_of(f"{type_name}_Request")
        package, _, outer = type_name.partition("/")
        srv = getattr(__import__(f"{package}.srv", fromlist=[outer]), outer)
        client = self.node.create_client(srv, f"/{name}")
        self.until(client.service_is_ready, f"/{name}")
        said = 0
        for attack in self._all(kind):
            if attack.raw is None:
                answer = client.call_async(attack.message)
                self.until(answer.done, f"an answer to {attack}")
                said += 1
        self.node.destroy_client(client)
        return said

    def action(self, name: str, type_name: str) -> int:
        from rclpy.action import ActionClient

        package, _, outer = type_name.partition("/")
        kind = getattr(__import__(f"{package}.action", fromlist=[outer]), outer)
        client = ActionClient(self.node, kind, f"/{name}")
        self.until(client.server_is_ready, f"/{name}")
        said = 0
        for attack in self._all(kind.Goal):
            if attack.raw is None:
                answer = client.send_goal_async(attack.message)
                self.until(answer.done, f"an answer to {attack}")
                said += 1
        client.destroy()
        return said

    def parameters(self, node: str) -> int:
        """Every parameter of the node set to every value of every type there is, and of one that there is not."""
        names = self._ask(ListParameters, f"/{node}/list_parameters").result.names
        said = 0
        for name in names:
            for field, kind in ParameterValue.get_fields_and_field_types().items():
                values = [] if item_of(kind) or field == "type" else values_of(kind, few=False).values()
                for number, value in [(200, None), *((number, each) for number in range(1, 5) for each in values)]:
                    set_to = ParameterValue(**({} if value is None else {field: value}))
                    set_to.type = number
                    request = {"parameters": [Parameter(name=name, value=set_to)]}
                    if value is True or value is False:
                        continue  # what may be switched is left as it is
                    answer = self._ask(SetParameters, f"/{node}/set_parameters", **request)
                    assert len(answer.results) == 1, (name, field)
                    said += 1
        return said

    def _ask(self, srv: Any, name: str, **request: Any) -> Any:
        client = self.node.create_client(srv, name)
        self.until(client.service_is_ready, name)
        answer = client.call_async(srv.Request(**request))
        self.until(answer.done, f"an answer of {name}")
        self.node.destroy_client(client)
        return answer.result()


def main() -> None:
    rclpy.init()
    attacker = Attacker()
    print("ready", flush=True)
    for line in sys.stdin:
        what, *words = line.split()
        try:
            said = getattr(attacker, what)(*words)
        except Exception as error:
            print(f"failed {line.strip()}: {error!r}", flush=True)
        else:
            print(f"done {line.strip()}: {said}", flush=True)


if __name__ == "__main__":
    main()
