"""The operator's questions to a running bridge, over ROS 2 services and topics, where ROS 2 is installed."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import Any

from fsai_vcu.arguments import check_numbers
from fsai_vcu.interface.errors import UserError, WrongUse
from fsai_vcu.printable import LINE, printable
from fsai_vcu.runtime.configuration import usual_environment
from fsai_vcu.runtime.transport import enclave_words, node_ports_taken, ros_trouble, set_transport

ASK_AGAIN_S = 1.0
_SAY_S, _SAY_AGAIN_S = 0.5, 3.0  # what is waited for
_TURN_S = 0.1  # within a wait of the middleware nothing answers Ctrl-C
_NO_NODE_S = 0.9  # what a node of another machine has for being found
_STATE_S = 10.0
_WHERE = "is vcu_bridge running, on this ROS_DOMAIN_ID and in this namespace?"
_NO_ROS = (
    "ROS 2 is not in this Python environment ({missing}): source the distribution's setup file, "
    "or, in the checkout, install it with: make setup"
)


def add_bridge_arguments(parser: argparse.ArgumentParser, wait_s: float | None = 10.0) -> None:
    """Add what every question to the bridge can be given; `wait_s` None: as long as `vehicle_state` sees fit."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    usual = f"{_STATE_S:g} s; 1 s where no ROS node runs" if wait_s is None else f"{wait_s:g} s"
    parser.add_argument(
        "--wait", type=float, default=wait_s, metavar="S", help=f"give up after S seconds (default: {usual})"
    )
    parser.add_argument("--namespace", default="/", metavar="NS", help="the nodes' ROS namespace, such as /car1")


def nodes_module(name: str) -> Any:
    """A module of the project's nodes, to find them where the car's configuration says. Raises UserError."""
    _take_environment()
    try:
        return import_module(f"fsai_nodes.{name}")
    except ImportError as error:
        raise UserError(
            f"--ros needs ROS 2 and the project's nodes in this Python environment ({error}): "
            "source the workspace's setup file, or run `make setup`"
        ) from error


@contextmanager
def ros_errors() -> Iterator[None]:
    """Raise UserError for an invalid namespace, and for a ROS or an encrypted DDS that does not come up."""
    try:
        yield
    except ValueError as error:
        raise UserError(f"--namespace {error}") from error
    except RuntimeError as error:  # rclpy's
        why = printable((str(error).splitlines() or ["it gives no reason"])[0], LINE)
        if os.environ.get("ROS_SECURITY_ENABLE") != "true":
            raise UserError(f"ROS 2 does not start: {why}") from error
        keystore = os.environ.get("ROS_SECURITY_KEYSTORE", "the folder that ROS_SECURITY_KEYSTORE must name")
        raise UserError(
            f"DDS encryption is switched on, but does not start ({why}): it needs the distribution's ROS 2, "
            f"and keys of `fsai-vcu enclaves` that this user may read, in {keystore}"
        ) from error


def _take_environment() -> None:
    """Take the car's environment, where this process has none of its own. Raises UserError where ROS would not start in
    it.
    """
    os.environ.update(usual_environment())
    if trouble := ros_trouble(os.environ):
        raise UserError(f"ROS 2 does not start: {trouble}")


@contextmanager
def _meanwhile(urgent: bool) -> Iterator[None]:
    """Add to an error what stops the car meanwhile, where the request for that cannot be sent."""
    try:
        yield
    except UserError as error:
        if not urgent or isinstance(error, WrongUse):
            raise
        words = str(error).removesuffix(".")
        end = "" if words.endswith("?") else "."
        raise UserError(f"{words}{end} Press the remote's E-stop meanwhile") from error.__cause__


@contextmanager
def operator_node(namespace: str = "/") -> Iterator[Any]:
    """A short-lived node, where the car's configuration says that its nodes are to be found.

    Raises UserError where the configuration may not be read, ROS 2 or the project's messages are missing or do not
    start, or the namespace is none.
    """
    _take_environment()
    set_transport(os.environ)
    try:
        import fsai_msgs.msg  # noqa: F401  found missing here, not in the middle of a question
        import rclpy
        from rclpy.exceptions import InvalidNamespaceException
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise UserError(_NO_ROS.format(missing=error)) from error
    # A question leaves no log file behind, and needs no place for one.
    words = ["--ros-args", "--disable-external-lib-logs", *enclave_words("operator", os.environ)]
    # Ctrl-C is answered as by every verb, not by a ROS that has ended meanwhile.
    with ExitStack() as ending:
        try:
            with ros_errors():
                rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
                ending.callback(rclpy.try_shutdown)
                node = rclpy.create_node(
                    "fsai_operator", namespace=namespace, enable_rosout=False, start_parameter_services=False
                )
        except InvalidNamespaceException as error:
            raise UserError(f"--namespace {namespace} is not a ROS namespace; an example is /car1") from error
        ending.callback(node.destroy_node)
        yield node


def call(args: argparse.Namespace, service: str, **request: str) -> int:
    """Ask the bridge's `service`, print its answer; the exit status.

    Raises UserError when no bridge offers it, or none answers in time.
    """
    check_numbers(args, wait=0.0)
    from fsai_vcu.runtime.loop_handle import NO_ANSWER

    urgent = service == "emergency_brake"
    with _meanwhile(urgent), operator_node(args.namespace) as node:
        import rclpy
        from fsai_msgs.srv import SetMode
        from std_srvs.srv import Trigger

        kind = SetMode if service == "set_mode" else Trigger
        client = node.create_client(kind, service)
        name = node.resolve_service_name(service)
        begin_s = time.monotonic()  # from here on: on a busy machine rclpy takes seconds to load
        asked: list[Any] = []
        say_s, ask_s = _SAY_S, 0.0
        while True:
            answers = [each.result() for each in asked if each.done()]
            waited_s = time.monotonic() - begin_s
            over = waited_s >= args.wait
            # The loop brakes however late it takes the request: that it did so, the next answer says.
            final = [each for each in answers if not urgent or each.message != NO_ANSWER]
            if final or (answers and over):
                answer = (final or answers)[0]
                break
            if over:
                if asked:
                    raise UserError(
                        f"the bridge offers {name}, but did not answer within {args.wait:g} s; does it hang?"
                    )
                raise UserError(f"no bridge offers {name} (waited {args.wait:g} s); {_WHERE}")
            if waited_s >= say_s:
                say_s = waited_s + _SAY_AGAIN_S if urgent else math.inf
                what = f"{name} is offered, but not answered" if asked else f"no bridge offers {name}"
                what = f"{name}: {NO_ANSWER}" if answers else what
                press = "PRESS THE REMOTE'S E-STOP: " if urgent else ""
                left = f"{max(1.0, args.wait - waited_s):.0f} s more"
                print(f"{press}{what}; asking for {left}, Ctrl-C ends it", file=sys.stderr, flush=True)
            if waited_s >= ask_s and client.service_is_ready():
                # The answer to a first request is lost when the server has not yet discovered its client: ask again.
                # Every request of the operator may be repeated without harm, and a late answer to any of them counts.
                asked.append(client.call_async(kind.Request(**request)))
                ask_s = waited_s + ASK_AGAIN_S
            rclpy.spin_once(node, timeout_sec=_TURN_S)
    said = printable(answer.message, LINE)
    if args.json:
        print(json.dumps({**request, "success": answer.success, "message": said}))
    else:
        print(said, file=sys.stdout if answer.success else sys.stderr)
    return 0 if answer.success else 1


def vehicle_state(args: argparse.Namespace) -> Any:
    """The newest /vehicle_state. Raises UserError when none comes in time, and, unless told to wait, for no node."""
    check_numbers(args, wait=0.0)
    _take_environment()
    # Asked before this process takes ports of its own; discovery alone takes seconds on a busy machine.
    node_is_here = node_ports_taken(int(os.environ.get("ROS_DOMAIN_ID") or 0))
    with operator_node(args.namespace) as node:
        import rclpy
        from fsai_msgs.msg import VehicleState
        from rclpy.qos import qos_profile_sensor_data

        begin_s = time.monotonic()
        wait_s = _STATE_S if args.wait is None else args.wait
        say_s = _SAY_S + _NO_NODE_S * (args.wait is None)
        received: list[Any] = []
        node.create_subscription(VehicleState, "vehicle_state", received.append, qos_profile_sensor_data)
        while not received:
            waited_s = time.monotonic() - begin_s
            if waited_s >= wait_s:
                topic = node.resolve_topic_name("vehicle_state")
                raise UserError(f"nothing on {topic} for {wait_s:g} s; {_WHERE}")
            others = [name for name in node.get_node_names() if name != node.get_name() and not name.startswith("_")]
            if args.wait is None and waited_s >= _NO_NODE_S and not (others or node_is_here):
                domain = os.environ.get("ROS_DOMAIN_ID", "0")
                instead = "--wait S waits for one, and fsai-vcu monitor shows a bus without ROS"
                raise UserError(f"no ROS node runs here, on ROS_DOMAIN_ID {domain}; {instead}")
            if waited_s >= say_s:
                say_s = math.inf
                print(f"waiting for {node.resolve_topic_name('vehicle_state')}, {wait_s:g} s at most", file=sys.stderr)
            rclpy.spin_once(node, timeout_sec=min(_TURN_S, wait_s - waited_s))
    return received[-1]
