"""The real-time loop: one thread that owns the bus, and slots through which everybody else talks to it.

The thread waits on the socket with a deadline, never on a sleep. Whoever asks something of the bridge (a service, a
new command) leaves it in a slot or a queue and the loop takes it up between two cycles; a reader gets the newest
immutable report. So neither ROS, nor logging, nor a disk can stand between a received frame and its answer.
"""

from __future__ import annotations

import gc
import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.engine import CATCH_UP_NS, DEADLINE_MISS_NS, Engine
from fsai_vcu.runtime.lock import InterfaceLock
from fsai_vcu.runtime.notify import Notifier
from fsai_vcu.runtime.realtime import go_real_time

logger = logging.getLogger(__name__)

_REOPEN_FIRST_S, _REOPEN_MOST_S = 0.01, 1.0  # the first pause also keeps two sends apart
_IDLE_WAIT_S = 0.02
_REPORT_EVERY_NS = 10_000_000
_FULL_COLLECTION_EVERY = 3000  # cycles, sent or not
_REQUEST_TIMEOUT_S = 2.0
_MOST_WAITING = 1000  # frames: more than a socket keeps
_STOP_TIMEOUT_S = 10.0

# What the bridge has use for; intruders on the AI's own ids are heard on purpose.
RECEIVE_IDS = frozenset({0x120, *range(0x500, 0x503), *range(0x510, 0x515), *range(0x520, 0x527), *range(0x600, 0x641)})


class BridgeLoop:
    """Runs a Bridge on a bus in a thread of its own."""

    def __init__(self, bridge: Bridge, codec: Codec, bus_spec: str, *, real_time: bool = True) -> None:
        """Takes the interface's lock and opens it. Raises AlreadyRunning or BusError, with one clear line each."""
        self._bridge = bridge
        self._codec = codec
        self._spec = bus_spec
        self._real_time = real_time
        self._notifier = Notifier()
        self._lock = InterfaceLock(bus_spec)
        try:
            self._bus: CanBus | None = self._open()
        except BaseException:
            self._lock.release()
            raise
        self._command: VehicleCommand | None = None
        self._requests: queue.SimpleQueue[tuple[Callable[[int], object], Future[object]]] = queue.SimpleQueue()
        self._stop_requested = threading.Event()
        self._engine = Engine(bridge, codec, self._send, time.monotonic_ns(), time.monotonic_ns)
        self._report = bridge.report(time.monotonic_ns())
        self._thread = threading.Thread(target=self._run, name="can-loop", daemon=True)
        self._watchdog_ns = 0  # when it was last fed
        self._pause_s = _REOPEN_FIRST_S  # before the next try to open a lost bus
        self.scheduling_refused: tuple[str, ...] = ()
        self.failure: BaseException | None = None
        self.reopened = 0
        self.deadline_misses = 0

    # ------------------------------------------------------------ from any thread

    def start(self) -> None:
        """Start the loop; returns once it runs."""
        started = threading.Event()
        self._requests.put((lambda _now_ns: started.set(), Future()))
        self._thread.start()
        started.wait(_REQUEST_TIMEOUT_S)

    def stop(self) -> None:
        """Stop in order (at rest zeros and NEUTRAL; moving: brake and ESTOP_REQUEST), then fall silent. Idempotent."""
        self._stop_requested.set()
        if self._thread.is_alive():
            self._thread.join(_STOP_TIMEOUT_S)
        self._close_bus()
        self._lock.release()

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def submit_command(self, command: VehicleCommand) -> None:
        """Replace the latest command; the loop reads it in its next turn."""
        self._command = command

    def confirm_reset(self, role: str, run_id: int) -> None:
        """`role` ('planner' or 'controller') has forgotten the previous run and is ready for `run_id`."""
        self._requests.put((lambda _now_ns: self._bridge.on_reset_confirmed(role, run_id), Future()))

    def set_mode(self, mode: str) -> tuple[bool, str]:
        return self._ask(lambda now_ns: self._bridge.set_mode(mode, now_ns))

    def emergency_brake(self, why: str) -> tuple[bool, str]:
        return self._ask(lambda now_ns: self._bridge.emergency_brake(why, now_ns), better_late=True)

    def reset(self) -> tuple[bool, str]:
        return self._ask(self._bridge.reset)

    def report(self) -> BridgeReport:
        """The newest report, at most about 10 ms old while the loop runs."""
        return self._report

    def _ask(self, question: Callable[[int], tuple[bool, str]], *, better_late: bool = False) -> tuple[bool, str]:
        """The loop's answer. What is not answered in time is not done later behind the asker's back, unless it is
        `better_late` than never.
        """
        if not self.running:
            return False, "the CAN loop does not run: nothing is sent"
        future: Future[object] = Future()
        self._requests.put((question, future))
        try:
            answer = future.result(_REQUEST_TIMEOUT_S)
        except FutureTimeoutError:
            if better_late or future.cancel():
                return False, "the CAN loop does not answer"
            answer = future.result(_REQUEST_TIMEOUT_S)  # it is being answered at this very moment
        assert isinstance(answer, tuple)
        return answer

    # ------------------------------------------------------------ the loop's own thread

    def _open(self) -> CanBus:
        return open_bus(self._spec, receive=RECEIVE_IDS, may_send=AI_IDS)

    def _close_bus(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _send(self, frame: Frame) -> bool:
        assert self._bus is not None
        return self._bus.send(frame)

    def _run(self) -> None:
        try:
            if self._real_time:
                self.scheduling_refused = go_real_time()
                for sentence in self.scheduling_refused:
                    logger.warning("%s", sentence)
            # Collections happen right after a send, when there is time, and never by surprise.
            gc.collect()
            gc.freeze()
            gc.disable()
            self._engine = Engine(self._bridge, self._codec, self._send, time.monotonic_ns(), time.monotonic_ns)
            self._notifier.send("READY=1")
            self._turns()
        except _Stopped:
            logger.info("stopped while the bus was gone")
        except Exception as error:
            # The decision is the bridge's: it asks for an emergency stop if one can still be sent, else silence.
            self.failure = error
            self._last_words(f"{type(error).__name__}: {error}")
            logger.exception("the CAN loop failed; the car's own time-out stops it")
        finally:
            gc.enable()
            gc.unfreeze()
            self._notifier.send("STOPPING=1")
            self._close_bus()

    def _turns(self) -> None:
        last_report_ns = 0
        cycles = 0
        taken: VehicleCommand | None = None
        stopping = False
        while True:
            now_ns = time.monotonic_ns()
            if self._bus is None:
                self._reopen()
                continue
            due_ns = self._engine.due_ns()
            try:
                frame = self._bus.recv(min(max(0.0, (due_ns - now_ns) / 1e9), _IDLE_WAIT_S))
                if frame is not None:
                    self._engine.on_frame(frame)
            except BusLost as lost:
                self._lose_bus(str(lost))
                continue
            command = self._command
            if command is not taken and command is not None:
                taken = command
                self._bridge.on_command(command, time.monotonic_ns())
            self._answer_requests()
            if self._stop_requested.is_set() and not stopping:
                stopping = True
                self._bridge.begin_stop(time.monotonic_ns())
            now_ns = time.monotonic_ns()
            due_ns = self._engine.due_ns()
            missed = self._missed(due_ns, now_ns)
            try:
                if now_ns - due_ns >= CATCH_UP_NS:
                    self._catch_up()
                    now_ns = time.monotonic_ns()
                sent = self._engine.poll(now_ns)
            except BusLost as lost:
                self._lose_bus(str(lost))
                continue
            unsent_ns = self._engine.unsent_ns(now_ns)
            if sent and unsent_ns >= self._bridge.config.send_lost_ns:
                self._lose_bus(f"{self._spec}: no complete cycle sent for {unsent_ns / 1e6:.0f} ms")
                continue
            if sent and not missed:
                missed = self._missed(due_ns, time.monotonic_ns())  # made in time, but left late
            if now_ns - last_report_ns >= _REPORT_EVERY_NS:
                last_report_ns = now_ns
                self._report = self._bridge.report(now_ns)
            if sent:
                if not missed:
                    self._feed_watchdog(now_ns)
                if self._engine.cycles > self._engine.incomplete_cycles or self._bridge.config.listen_only:
                    self._pause_s = _REOPEN_FIRST_S  # the bus works again
                cycles += 1
                gc.collect(2 if cycles % _FULL_COLLECTION_EVERY == 0 else 0)
            if stopping and self._bridge.stopped:
                self._report = self._bridge.report(now_ns)
                return

    def _catch_up(self) -> None:
        """After a pause, hear everything that has waited: the oldest frame of it says nothing about now."""
        assert self._bus is not None
        for _ in range(_MOST_WAITING):
            frame = self._bus.recv(0.0)
            if frame is None:
                return
            self._engine.on_frame(frame)

    def _missed(self, due_ns: int, now_ns: int) -> bool:
        """Whether what was due is so late that the bridge must know."""
        late_ns = now_ns - due_ns
        if late_ns < DEADLINE_MISS_NS:
            return False
        self.deadline_misses += 1
        self._bridge.loop_fault(f"the CAN loop was {late_ns / 1e6:.0f} ms late", now_ns)
        return True

    def _feed_watchdog(self, now_ns: int) -> None:
        period_ns = self._notifier.watchdog_period_ns
        if period_ns and now_ns - self._watchdog_ns >= period_ns:
            self._watchdog_ns = now_ns
            self._notifier.send("WATCHDOG=1")

    def _answer_requests(self) -> None:
        while True:
            try:
                question, future = self._requests.get_nowait()
            except queue.Empty:
                return
            if future.set_running_or_notify_cancel():
                future.set_result(question(time.monotonic_ns()))

    def _lose_bus(self, why: str) -> None:
        # A bus that opens and takes nothing is lost again and again: told once.
        logger.log(logging.ERROR if self._pause_s == _REOPEN_FIRST_S else logging.DEBUG, "bus lost: %s", why)
        self._close_bus()
        self._bridge.bus_lost(why, time.monotonic_ns())
        self._report = self._bridge.report(time.monotonic_ns())

    def _reopen(self) -> None:
        """Try until the interface is back or a stop is asked for. The pauses grow until a cycle has been sent whole."""
        first = self._pause_s == _REOPEN_FIRST_S
        while self._bus is None and not self._stop_requested.wait(self._pause_s):
            self._pause_s = min(2 * self._pause_s, _REOPEN_MOST_S)
            try:
                self._bus = self._open()
            except BusError as error:
                logger.debug("%s", error)
                now_ns = time.monotonic_ns()
                self._answer_requests()
                self._report = self._bridge.report(now_ns)
                self._feed_watchdog(now_ns)  # a bus that is gone is no hang, and a restart would not bring it back
        if self._bus is None:
            raise _Stopped
        now_ns = time.monotonic_ns()
        self.reopened += 1
        self._engine = Engine(self._bridge, self._codec, self._send, now_ns, time.monotonic_ns)
        self._bridge.bus_back(now_ns)
        logger.log(logging.WARNING if first else logging.DEBUG, "bus back: %s", self._spec)

    def _last_words(self, why: str) -> None:
        """One attempt at an emergency request after a failure of the loop itself."""
        try:
            now_ns = time.monotonic_ns()
            self._bridge.loop_fault(why, now_ns)
            command = self._bridge.cycle(now_ns)
            if command is not None and self._bus is not None:
                for frame in self._codec.encode_command(command):
                    self._bus.send(frame)
            self._report = self._bridge.report(now_ns)
        except Exception:
            logger.exception("no emergency request could be sent; silence stops the car after 100 ms")


class _Stopped(Exception):
    """A stop was asked for while the bus was gone: there is nobody to say goodbye to."""
