"""The operator's questions to a running bridge, over ROS 2 services and topics, where ROS 2 is installed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fsai_vcu.cli.main import UserError
from fsai_vcu.runtime.configuration import ConfigurationError, usual_environment
from fsai_vcu.runtime.transport import set_transport

WAIT_S = 10.0
ASK_AGAIN_S = 1.0
_NO_ROS = (
    "ROS 2 is not in this Python environment ({missing}): source the distribution's setup file, "
    "or install it with: pip install 'fsai-vcu[ros]' and build the messages with nodes/build-messages"
)


@contextmanager
def operator_node() -> Iterator[Any]:
    """A short-lived node, where the car's configuration says that its nodes are to be found.

    Raises UserError where the configuration may not be read, or ROS 2 or the project's messages are missing.
    """
    try:
        os.environ.update(usual_environment())
    except ConfigurationError as error:
        raise UserError(str(error)) from error
    set_transport(os.environ)
    try:
        import fsai_msgs.msg  # noqa: F401  found missing here, not in the middle of a question
        import rclpy
    except ImportError as error:
        raise UserError(_NO_ROS.format(missing=error)) from error
    # A question leaves no log file behind, and needs no place for one.
    words = ["--ros-args", "--disable-external-lib-logs"]
    if os.environ.get("ROS_SECURITY_ENABLE") == "true":
        words += ["--enclave", "/fsai/operator"]
    rclpy.init(args=words)
    node = rclpy.create_node("fsai_operator")
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def call(node: Any, service_type: Any, name: str, request: Any, timeout_s: float = WAIT_S) -> Any:
    """The answer of service `name`. Raises UserError when no bridge offers it or it does not answer."""
    import rclpy

    client = node.create_client(service_type, name)
    if not client.wait_for_service(timeout_sec=timeout_s):
        raise UserError(
            f"no bridge offers {name} (waited {timeout_s:g} s); is vcu_bridge running, on this ROS_DOMAIN_ID?"
        )
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        # The answer to a first request is lost when the server has not yet discovered its client: ask again. Every
        # request of the operator may be repeated without harm.
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=ASK_AGAIN_S)
        if future.done():
            return future.result()
        client.remove_pending_request(future)
    raise UserError(f"the bridge did not answer {name} within {timeout_s:g} s")


def vehicle_state(node: Any, timeout_s: float = WAIT_S) -> Any:
    """The newest /vehicle_state. Raises UserError when none comes."""
    import rclpy
    from fsai_msgs.msg import VehicleState
    from rclpy.qos import qos_profile_sensor_data

    heard: list[Any] = []
    node.create_subscription(VehicleState, "/vehicle_state", heard.append, qos_profile_sensor_data)
    until = time.monotonic() + timeout_s
    while not heard:
        left_s = until - time.monotonic()
        if left_s <= 0:
            raise UserError(
                f"nothing on /vehicle_state for {timeout_s:g} s; is vcu_bridge running, on this ROS_DOMAIN_ID?"
            )
        rclpy.spin_once(node, timeout_sec=left_s)
    return heard[-1]
