"""One node, or several composed, as a process: start, spin, end; errors as one line; Ctrl-C and SIGTERM in order."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from fsai_nodes.executor import make_executor
from fsai_nodes.parameters import StartError

_STOP_SIGNALS = {signal.SIGINT, signal.SIGTERM}


class Stoppable(Protocol):
    """A node that has something to finish before the process ends."""

    def stop(self) -> None: ...


def run(factories: Sequence[Callable[[], Node]], arguments: Sequence[str] | None = None) -> int:
    """Run the nodes that `factories` make until a signal; returns the exit status.

    A node that cannot start raises StartError: its line goes to stderr and the status is 1.
    """
    # Signals are taken by a thread of their own, so that nodes can finish in order (the bridge says goodbye to the
    # car) while ROS still works. The mask must be set before any other thread is born, to be inherited by all.
    signal.pthread_sigmask(signal.SIG_BLOCK, _STOP_SIGNALS)
    name = os.path.basename(sys.argv[0]).removesuffix(".py")
    nodes: list[Node] = []
    try:
        rclpy.init(
            args=list(sys.argv if arguments is None else arguments), signal_handler_options=SignalHandlerOptions.NO
        )
    except Exception as error:  # rclpy has no common class for what a bad --ros-args raises
        print(f"{name}: {_first_line(error)}", file=sys.stderr)
        return 1
    status = 0
    try:
        executor = make_executor()
        threading.Thread(target=_await_signal, args=(executor.shutdown_soon,), daemon=True).start()
        for factory in factories:
            node = factory()
            nodes.append(node)
            executor.add_node(node)
        executor.spin()
    except StartError as error:
        print(f"{name}: {error}", file=sys.stderr)
        status = 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        for node in nodes:
            stop = getattr(node, "stop", None)
            if stop is not None:
                stop()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def _await_signal(stop: Callable[[], None]) -> None:
    signal.sigwait(_STOP_SIGNALS)
    stop()
    # A second one means now: silence on the bus stops the car as well.
    second = signal.sigwait(_STOP_SIGNALS)
    os._exit(128 + second)


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
