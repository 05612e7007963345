"""ROS programs of others, started one by one: each receives one message, as `ros2 topic echo --once` does.

A line of standard input starts one: `stay` or `leave`, then the environment that chooses its transport as
`NAME=VALUE` words. `PID received` is printed when it has received, and `PID left` when it has ended in order. They are
forked from a process that has imported ROS 2 already: what is tested is that they join, and on one slow processor the
import would be all that there is to see.
"""

from __future__ import annotations

import gc
import os
import signal
import sys

import rclpy
from fsai_msgs.msg import VehicleState
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier

from fsai_vcu.runtime.transport import VARIABLES

TOPICS = ((Odometry, "/odometry", qos_profile_sensor_data), (VehicleState, "/vehicle_state", 1))  # the second reliable


def visit(number: int, stays: bool) -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f"visitor_{number}")
    received: list[object] = []
    message_type, topic, qos = TOPICS[number % len(TOPICS)]
    node.create_subscription(message_type, topic, received.append, qos)
    while not received:
        rclpy.spin_once(node)
    print(os.getpid(), "received", flush=True)
    while stays:
        rclpy.spin_once(node)
    node.destroy_node()
    rclpy.shutdown()
    print(os.getpid(), "left", flush=True)


def main() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel buries those that end
    # What each of them would have to load by itself, and the pages that a collection would make its own.
    get_rmw_implementation_identifier()
    for message_type, _, _ in TOPICS:
        message_type.__class__.__import_type_support__()
    gc.freeze()
    print("ready", flush=True)
    for number, line in enumerate(sys.stdin):
        if os.fork() == 0:
            os.close(sys.stdin.fileno())
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            what, *transport = line.split()
            for name in VARIABLES:
                os.environ.pop(name, None)
            os.environ.update(word.split("=", 1) for word in transport)
            visit(number, stays=what == "stay")
            os._exit(0)


if __name__ == "__main__":
    main()
