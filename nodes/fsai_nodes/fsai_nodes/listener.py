"""A program that only receives: it has a ROS context and a thread of its own, and asks nobody to wait for it."""

from __future__ import annotations

import os
import threading
import time

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from fsai_nodes.executor import NodeExecutor
from fsai_vcu.runtime.transport import enclave_words, set_transport

TURN_S = 0.1


class Listener:
    """Receives from `start` to `stop`. What it subscribes to is said in between, on `_node`.

    `heard_ns`: when it last looked for messages (monotonic clock); on a busy machine that is behind the present.
    `error`: what ended its thread, None while it receives.
    """

    def __init__(self, name: str, namespace: str) -> None:
        """Start ROS for this program. Raises ValueError where `namespace` is none."""
        self._context = Context()
        set_transport(os.environ)
        # It leaves no log file behind, and needs no place for one.
        words = ["--ros-args", "--disable-external-lib-logs", *enclave_words("listener", os.environ)]
        rclpy.init(args=words, context=self._context, signal_handler_options=SignalHandlerOptions.NO)
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
            raise ValueError(f"{namespace} is not a ROS namespace; an example is /car1") from error
        self._executor = NodeExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.heard_ns = time.monotonic_ns()
        self.error: Exception | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """The thread first: what it waits for must not be destroyed under it."""
        self._ended.set()
        self._thread.join(5.0)
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        self._context.try_shutdown()

    def _spin(self) -> None:
        try:
            while not self._ended.is_set():
                self.heard_ns = time.monotonic_ns()
                self._executor.spin_once(timeout_sec=TURN_S)
        except Exception as error:
            self.error = error
            raise
