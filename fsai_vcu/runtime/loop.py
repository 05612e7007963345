"""The real-time loop: it owns the bus, in a process that has nothing else to do.

A turn has four phases: *sleep* until a frame or a message of the edge has come or a send is due, *read* everything that
waits, *update* the bridge with it, *write* what is due. Reports, log lines, the watchdog and the garbage collection
come after a send. `turns.Turns` decides what is done and when; the loop carries it out. The edge (the ROS node) is at
the other end of a link on which nobody waits.
"""

from __future__ import annotations

import gc
import logging
import select
import time
from collections.abc import Iterable

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.values import shortened
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.link import Answer, Ask, Ended, LinkEnd, LoopReport, LoopSettings, Message
from fsai_vcu.runtime.lock import InterfaceLock
from fsai_vcu.runtime.notify import Notifier
from fsai_vcu.runtime.realtime import go_real_time
from fsai_vcu.runtime.turns import Action, Do, Note, Send, Turns

logger = logging.getLogger(__name__)

_IDLE_WAIT_S, _BLIND_WAIT_S = 0.02, 0.001
_FULL_COLLECTION_EVERY = 3000  # cycles

# Frames that the bridge has use for; intruders on the AI's own ids are received on purpose.
RECEIVE_IDS = frozenset({0x120, *range(0x500, 0x503), *range(0x510, 0x515), *range(0x520, 0x527), *range(0x600, 0x641)})


class BridgeLoop:
    """Runs a Bridge on a bus until the edge asks for the end, or is gone and the car does not drive."""

    def __init__(self, bridge: Bridge, codec: Codec, settings: LoopSettings, link: LinkEnd) -> None:
        """Takes the interface's lock and opens it. Raises AlreadyRunning or BusError, with one clear line each."""
        self._bridge = bridge
        self._codec = codec
        self._settings = settings
        self._link = link
        self._notifier = Notifier()
        self._lock = InterfaceLock(settings.bus)
        self._inputs: list[int] = []  # what a turn waits for: the descriptors of bus and edge
        try:
            self._bus: CanBus | None = self._open()
        except BaseException:
            self._lock.release()
            raise
        self._turns = self._new_turns()
        self._refused: tuple[str, ...] = ()
        self._ended = False
        self._cycles = 0

    def run(self, number: int) -> None:
        """Run until the end. An exception is reported to the edge and ends the loop; nothing is raised.

        number: of the request to run, which is answered once the loop runs.
        """
        try:
            if self._settings.real_time:
                self._refused = tuple(map(shortened, go_real_time()))
                for sentence in self._refused:
                    logger.warning("%s", sentence)
            # Collections happen right after a send, when there is time, and never by surprise.
            gc.collect()
            gc.freeze()
            gc.disable()
            self._turns = self._new_turns()
            self._link.send(Answer(number, True))
            self._notifier.send("READY=1")
            while not self._ended:
                self._turn()
        except Exception as error:
            # The decision is the bridge's: it asks for an emergency stop if one can still be sent, else silence.
            why = shortened(f"{type(error).__name__}: {error}")
            self._last_words(why)
            logger.exception("the CAN loop failed; the car's own time-out stops it")
            self._link.send(Ended(why))
        finally:
            gc.enable()
            gc.unfreeze()
            self._notifier.send("STOPPING=1")
            self._close_bus()
            self._lock.release()
            if self._turns.stop_number is not None:
                self._link.send(Answer(self._turns.stop_number, True))

    def _new_turns(self) -> Turns:
        periods_ns = self._settings.report_period_ns, self._notifier.watchdog_period_ns
        return Turns(self._bridge, self._codec, time.monotonic_ns(), self._settings.bus, *periods_ns)

    # ------------------------------------------------------------ a turn

    def _turn(self) -> None:
        """Do one turn: sleep, read, update, and act; a lost bus ends the turn."""
        turns, bus = self._turns, self._bus
        try:
            wait_s = (turns.due_ns() - time.monotonic_ns()) / 1e9
            if wait_s > 0.0:
                select.select(self._inputs, [], [], min(wait_s, self._longest_wait_s))
            turns.awake(time.monotonic_ns())
            frames = () if bus is None else bus.drain()
            messages = self._read_edge()
            now_ns = time.monotonic_ns()  # not before they were read: they would be of the future
            turns.on_frames(frames, now_ns)
            self._do(turns.on_edge(messages, now_ns))
            self._do(turns.act(time.monotonic_ns()))
        except BusLost as lost:
            self._do(turns.lost(str(lost), time.monotonic_ns()))

    def _read_edge(self) -> list[Message] | None:
        """Return what the edge has sent; None once it is gone."""
        if self._link.closed:
            return None
        messages = self._link.receive()
        if self._link.closed:
            self._wait_for(-1 if self._bus is None else self._bus.fileno())  # its end would wake every turn
        return messages

    def _do(self, actions: Iterable[Action]) -> None:
        """Carry out actions in order, those that a Send returns too."""
        for action in actions:
            match action:
                case Send(frames):
                    self._do(self._send(frames))
                    self._collect()
                case Do.REPORT:
                    self._report()
                case Do.FEED:
                    self._notifier.send("WATCHDOG=1")
                case Do.CLOSE:
                    self._close_bus()
                case Do.OPEN:
                    self._do(self._reopen())
                case Do.END:
                    self._ended = True
                case Ask():
                    self._do(self._turns.answer(action, time.monotonic_ns()))
                case Answer():
                    self._link.send(action)
                case Note(level, words):
                    logger.log(level, "%s", words)

    def _send(self, frames: tuple[Frame, ...]) -> Iterable[Action]:
        bus = self._bus
        assert bus is not None
        complete, left_ns = True, None
        for frame in frames:
            complete = bus.send(frame)
            if left_ns is None:
                left_ns = time.monotonic_ns()
            if not complete:
                break
        return self._turns.sent(complete, left_ns, time.monotonic_ns())

    def _collect(self) -> None:
        """The garbage of a cycle, sent or not; seldom all of it, and what else may take its time."""
        self._cycles += 1
        full = self._cycles % _FULL_COLLECTION_EVERY == 0
        gc.collect(2 if full else 0)
        if full:
            self._lock.answer_probes()

    def _report(self) -> None:
        turns, report = self._turns, self._bridge.report(time.monotonic_ns())
        self._link.send(LoopReport(report, turns.reopened, turns.deadline_misses, self._refused, self._link.trouble))

    def _last_words(self, why: str) -> None:
        """Make one attempt at an emergency request after a failure of the loop itself."""
        try:
            for frame in self._turns.failed(why, time.monotonic_ns()):
                if self._bus is not None:
                    self._bus.send(frame)
            self._report()
        except Exception:
            logger.exception("no emergency request could be sent; silence stops the car after 100 ms")

    # ------------------------------------------------------------ the bus

    def _open(self) -> CanBus:
        bus = open_bus(self._settings.bus, receive=RECEIVE_IDS, may_send=AI_IDS)
        descriptor = bus.fileno()
        self._wait_for(descriptor)
        # Where there is nothing to wait on, frames are looked for in short steps.
        self._longest_wait_s = _IDLE_WAIT_S if descriptor >= 0 else _BLIND_WAIT_S
        return bus

    def _reopen(self) -> Iterable[Action]:
        try:
            self._bus = self._open()
        except BusError as error:
            return self._turns.refused(str(error), time.monotonic_ns())
        return self._turns.opened(time.monotonic_ns())

    def _wait_for(self, bus: int = -1) -> None:
        self._inputs = [descriptor for descriptor in (bus, *self._link.descriptors) if descriptor >= 0]

    def _close_bus(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()
        self._wait_for()
