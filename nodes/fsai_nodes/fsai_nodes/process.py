"""One node, or several composed, as a process: start, spin, end; errors as one line; signals in order."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryFile

import rclpy
import rclpy.logging
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from fsai_nodes.clock_step import on_clock_step
from fsai_nodes.clocks import Clocks
from fsai_nodes.config_arguments import Configured
from fsai_nodes.executor import NodeExecutor
from fsai_nodes.parameters import NodeError
from fsai_vcu.runtime.notify import Notifier
from fsai_vcu.runtime.transport import ros_trouble, set_transport

_STOP_SIGNALS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}  # the last one: the terminal is closed


def run(factories: Sequence[Callable[[], Node]], name: str, arguments: Sequence[str] | None = None) -> int:
    """Run the nodes that `factories` make until SIGINT, SIGTERM or SIGHUP; returns the exit status.

    `name`: of the node, or 'composed'; its settings are those of --config, where the command line has one.
    A node that cannot start or go on raises NodeError: its line goes to stderr after `name`, and the status is 1.
    A node with a `stop` method is stopped before ROS is shut down.
    """
    # Not rclpy's own handlers: nodes finish in order (the bridge says goodbye to the car) while ROS still works.
    stop_signals = _StopSignals()
    try:
        configured = Configured(sys.argv if arguments is None else arguments, name)
        transport = set_transport(os.environ)
        if trouble := ros_trouble(os.environ):
            raise NodeError(f"ROS 2 does not start: {trouble}")
        no_files = log_trouble(os.environ) if configured.writes_logs else ""
        quiet = ["--ros-args", "--disable-external-lib-logs", "--"] if no_files else []
        rclpy.init(args=[*configured.arguments, *quiet], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # NodeError; and what a bad --ros-args raises has no class of its own
        print(f"{name}: {_one_line(error)}", file=sys.stderr)
        return 1
    # What the rooms below report by Python's logging goes to ROS's log.
    source = logging.getLogger("fsai_vcu")
    source.setLevel(logging.INFO)
    source.addHandler(_RosHandler())
    source.propagate = False
    executor = NodeExecutor()
    stop_signals.wake(lambda: executor.create_task(lambda: None))
    on_clock_step(lambda: executor.create_task(lambda: None))
    nodes: list[Node] = []
    status = 0
    try:
        for factory in factories:
            nodes.append(factory())
            executor.add_node(nodes[-1])
        for line in filter(None, (*configured.lines, transport)):
            nodes[0].get_logger().info(line)
        if no_files:
            nodes[0].get_logger().warning(no_files)
        if not any(getattr(node, "tells_systemd", False) for node in nodes):
            _tell_systemd(nodes[0])
        while not stop_signals.received.is_set():
            executor.spin_once()
    except NodeError as error:
        print(f"{name}: {error}", file=sys.stderr)
        status = 1
    finally:
        for node in reversed(nodes):
            stop = getattr(node, "stop", None)
            if stop is not None:
                stop()
        executor.shutdown(timeout_sec=1.0)
        for node in reversed(nodes):
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def log_trouble(environ: Mapping[str, str]) -> str:
    """Say in one line why ROS cannot keep log files, or ''. It would not start at all for that."""
    # The rule of rcl_logging.
    home = environ.get("ROS_HOME") or Path(environ.get("HOME", "/")) / ".ros"
    folder = Path(environ.get("ROS_LOG_DIR") or Path(home) / "log").expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return f"no log files of ROS: {folder} cannot be written: {error.strerror or error}"


def _tell_systemd(node: Node) -> None:
    """Tell systemd that the node is ready; the executor feeds the watchdog, so that a hanging node is started again."""
    notifier = Notifier()
    notifier.send("READY=1")
    if notifier.watchdog_period_ns:
        Clocks(node).every(notifier.watchdog_period_ns / 1e9, lambda: notifier.send("WATCHDOG=1"))


class _StopSignals:
    """SIGINT, SIGTERM and SIGHUP as an event, from whatever thread the kernel hands them to.

    The main thread waits inside the middleware, where Python's handlers do not run; Python's wake-up descriptor is
    written at once, and a thread reads it.
    """

    def __init__(self) -> None:
        self.received = threading.Event()
        self._wake: Callable[[], object] = lambda: None
        self._reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in _STOP_SIGNALS:
            if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # as nohup has it
                signal.signal(number, lambda _number, _frame: None)
        threading.Thread(target=self._read, name="signals", daemon=True).start()

    def wake(self, wake: Callable[[], object]) -> None:
        """Have `wake` called when a signal has come, from another thread."""
        self._wake = wake
        if self.received.is_set():
            wake()

    def _read(self) -> None:
        while True:
            for number in os.read(self._reader, 16):
                if number not in _STOP_SIGNALS:
                    continue
                if self.received.is_set() and number == signal.SIGHUP:
                    continue  # the kernel and the shell both say that a terminal is closed
                if self.received.is_set():
                    # A second one means now: silence on the bus stops the car as well.
                    os._exit(128 + number)
                self.received.set()
                self._wake()


class _RosHandler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        try:
            logger, text = rclpy.logging.get_logger(record.name), self.format(record)
            # One line for each severity: rclpy ties a severity to the line that logs.
            if record.levelno >= logging.ERROR:
                logger.error(text)
            elif record.levelno >= logging.WARNING:
                logger.warning(text)
            else:
                logger.info(text)
        except Exception:  # a line that cannot be logged ends nobody's work
            self.handleError(record)


def _one_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
