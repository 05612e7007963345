"""A program that only receives: it has a ROS context and a thread of its own, and asks nobody to wait for it."""

from __future__ import annotations

import os
import threading

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from fsai_vcu.runtime.transport import set_transport


class Listener:
    """Receives from `start` to `stop`. What it subscribes to is said in between, on `_node`."""

    def __init__(self, name: str, namespace: str) -> None:
        """Raises ValueError where `namespace` is none."""
        self._context = Context()
        set_transport(os.environ)
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        try:
            self._node = Node(
                name,
                context=self._context,
                namespace=namespace,
                enable_rosout=False,
                start_parameter_services=False,
            )
        except InvalidNamespaceException as error:
            self._context.try_shutdown()
            raise ValueError(f"{namespace} is no ROS namespace; one is like /car1") from error
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join(5.0)  # before ROS ends under it
        self._node.destroy_node()
        self._context.try_shutdown()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return  # somebody else has ended ROS
