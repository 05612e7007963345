"""`fsai-vcu check-stack`: watches a running stack and lists what it does wrong, each with what to do about it."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Collection
from contextlib import suppress
from typing import Any

from fsai_vcu.arguments import check_numbers
from fsai_vcu.cli.services import operator_node
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.stack.watch import TOPICS, Ends, StackWatch
from fsai_vcu.printable import LINE, printable

EXAMPLE = "fsai-vcu check-stack --seconds 20 && echo in order"
ABOUT = "It only listens. Run it while the car drives. Exit status: 0 nothing is wrong, 1 something is wrong."
_TURN_S = 0.1
_ANSWER_S = 2.0  # for all nodes together to say whose time they go by
_CLOCK = "use_sim_time"
_OWN_PARTS = ("link", "supervision", "car", "loop")  # of vcu_bridge in /diagnostics; the rest are complaints of nodes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=float, default=60.0, metavar="S", help="watch for S seconds, from the first message on (60 s)"
    )
    parser.add_argument(
        "--wait", type=float, default=10.0, metavar="S", help="wait S seconds for a first message (10 s)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--namespace", default="/", metavar="NS", help="the nodes' ROS namespace, such as /car1")


def ends_of(node: Any, topic: str) -> Ends:
    """Find the publishers and readers of a topic, this node aside."""
    from rclpy.qos import QoSCompatibility, qos_check_compatible

    name = node.resolve_topic_name(topic)
    ends = Ends()
    publishers = node.get_publishers_info_by_topic(name)
    ends.publishers.extend(info.node_name for info in publishers)
    for reader in node.get_subscriptions_info_by_topic(name):
        if reader.node_name == node.get_name():
            continue
        ends.readers.append(reader.node_name)
        for publisher in publishers:
            verdict, why = qos_check_compatible(publisher.qos_profile, reader.qos_profile)
            if verdict == QoSCompatibility.ERROR:
                why = why.strip().rstrip(";").removeprefix("ERROR: ").lower()
                ends.deaf.append((reader.node_name, publisher.node_name, why))
    return ends


def listen(node: Any, stack: StackWatch) -> None:
    """Hand over to `stack` what comes on its topics."""
    from diagnostic_msgs.msg import DiagnosticArray
    from fsai_msgs import msg
    from nav_msgs.msg import Path
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

    kinds = {
        "vehicle_cmd": msg.VehicleCommand,
        "vehicle_state": msg.VehicleState,
        "detected_cones": msg.ConeArray,
        "path": Path,
        "planner_status": msg.PlannerStatus,
        "run_state": msg.RunState,
        "reset_confirmation": msg.ResetConfirmation,
    }
    kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

    def on_diagnostics(message: Any) -> None:
        for status in message.status:
            for pair in status.values if status.name == "vcu_bridge: supervision" else ():
                stack.diagnose(pair.key, pair.value)
            own = status.name.partition("vcu_bridge: ")[2] in _OWN_PARTS
            if status.hardware_id == "ADS-DV" and not own:
                stack.complain(status.name, status.message)

    for topic, expected in TOPICS.items():

        def on_message(message: Any, topic: str = topic) -> None:
            stack.receive(topic, message, time.monotonic(), node.get_clock().now().nanoseconds)

        node.create_subscription(
            kinds[topic], topic, on_message, qos_profile_sensor_data if expected.least_hz else kept
        )
    node.create_subscription(DiagnosticArray, "diagnostics", on_diagnostics, 10)


def by_clock(node: Any, names: Collection[str]) -> dict[str, bool]:
    """Tell of each node whether it goes by /clock (parameter use_sim_time); a node that does not answer is left out."""
    import rclpy
    from rcl_interfaces.srv import GetParameters

    asked: dict[str, Any] = {}
    clients = []
    for name, namespace in node.get_node_names_and_namespaces():
        if name in names:
            service = f"{namespace.rstrip('/')}/{name}/get_parameters"
            with suppress(RuntimeError):  # rclpy's, where DDS is encrypted and the keys do not permit it
                clients.append((name, node.create_client(GetParameters, service)))
    until = time.monotonic() + _ANSWER_S
    while time.monotonic() < until and not (len(asked) == len(clients) and all(each.done() for each in asked.values())):
        for name, client in clients:
            if name not in asked and client.service_is_ready():
                asked[name] = client.call_async(GetParameters.Request(names=[_CLOCK]))
        rclpy.spin_once(node, timeout_sec=_TURN_S)
    for _, client in clients:
        node.destroy_client(client)
    answers = {name: future.result().values for name, future in asked.items() if future.done()}
    return {name: values[0].bool_value for name, values in answers.items() if values}


def _say(words: str) -> None:
    print(f"fsai-vcu check-stack: {words}", file=sys.stderr, flush=True)


def watch(namespace: str, seconds: float, wait_s: float) -> StackWatch:
    """Listen for so long from the first message on."""
    stack = StackWatch()
    with operator_node(namespace) as node:
        import rclpy

        listen(node, stack)
        began = False
        _say(f"waiting for the first message of the nodes, {wait_s:g} s at most")
        until = time.monotonic() + wait_s
        while (left_s := until - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=min(_TURN_S, left_s))
            if not began and any(heard.count for heard in stack.heard.values()):
                began, until = True, time.monotonic() + seconds
                _say(f"listening for {seconds:g} s")
        stack.ends = {topic: ends_of(node, topic) for topic in TOPICS}
        names = {name for ends in stack.ends.values() for name in (*ends.publishers, *ends.readers)}
        stack.by_clock = by_clock(node, names)
        stack.clock_published = bool(node.count_publishers("/clock"))
    return stack


def _as_dict(finding: Finding) -> dict[str, str]:
    return {"topic": _shown(finding.kind), "wrong": _shown(finding.words), "to_do": _shown(finding.remedy)}


def _as_text(finding: Finding) -> str:
    return f"/{_shown(finding.kind)}: {_shown(finding.words)}\n    {_shown(finding.remedy)}"


def _shown(text: str) -> str:
    return printable(text, LINE)


def run(args: argparse.Namespace) -> int:
    check_numbers(args, seconds=0.0, wait=0.0)
    stack = watch(args.namespace, args.seconds, args.wait)
    wrong = list(stack.findings())
    rates = {topic: round(heard.rate_hz, 1) for topic, heard in stack.heard.items() if heard.count}
    if args.json:
        print(json.dumps({"seconds": args.seconds, "rates_hz": rates, "wrong": [_as_dict(each) for each in wrong]}))
    elif wrong:
        print("\n".join(map(_as_text, wrong)))
    else:
        heard = ", ".join(f"/{topic} {rate:g} Hz" for topic, rate in rates.items() if TOPICS[topic].least_hz)
        print(f"nothing is wrong in {args.seconds:g} s: {heard}")
    return 1 if wrong else 0
