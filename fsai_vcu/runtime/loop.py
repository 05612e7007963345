"""The real-time loop: it owns the bus, in a process that has nothing else to do.

A turn has four phases: *sleep* until a frame or a message of the edge has come or a send is due, *read* everything that
waits, *update* the bridge with it, *write* what is due. Reports, log lines, the watchdog and the garbage collection
come after a send. The edge (the ROS node) is at the other end of a link on which nobody waits: when it is silent its
commands get old, and when it is gone the run ends as the table of reactions says.
"""

from __future__ import annotations

import gc
import logging
import select
import time

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.values import shortened
from fsai_vcu.runtime.bus import BusError, BusLost, CanBus, open_bus
from fsai_vcu.runtime.engine import DEADLINE_MISS_NS, Engine
from fsai_vcu.runtime.link import (
    Alive,
    Answer,
    Ask,
    Ended,
    LinkEnd,
    LoopReport,
    LoopSettings,
    Message,
    ResetConfirmed,
)
from fsai_vcu.runtime.lock import InterfaceLock
from fsai_vcu.runtime.notify import Notifier
from fsai_vcu.runtime.realtime import go_real_time

logger = logging.getLogger(__name__)

_REOPEN_FIRST_S, _REOPEN_MOST_S = 0.01, 1.0  # the first pause also keeps two sends apart
_IDLE_WAIT_S, _BLIND_WAIT_S = 0.02, 0.001
EDGE_HUNG_NS = 3_000_000_000  # it reports once a second that it runs
_FULL_COLLECTION_EVERY = 3000  # cycles, sent or not

# What the bridge has use for; intruders on the AI's own ids are received on purpose.
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
        self._engine = self._new_engine()
        self._edge_ns = time.monotonic_ns()  # when the edge last sent anything
        self._stopping = False
        self._stop_number: int | None = None  # of the request to stop
        self._cycles = 0  # sent or not
        self._report_ns = self._watchdog_ns = 0  # when it was last sent, and fed
        self._pause_s = _REOPEN_FIRST_S  # before the next try to open a lost bus
        self._refused: tuple[str, ...] = ()
        self._reopened = 0
        self._deadline_misses = 0

    def run(self, number: int) -> None:
        """Until the end. An exception is reported to the edge and ends it; nothing is raised.

        number: of the request to run, which is answered once it does.
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
            self._engine = self._new_engine()
            self._link.send(Answer(number, True))
            self._notifier.send("READY=1")
            while self._turn():
                pass
            self._send_report(time.monotonic_ns(), at_once=True)
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
            if self._stop_number is not None:
                self._link.send(Answer(self._stop_number, True))

    # ------------------------------------------------------------ a turn

    def _turn(self) -> bool:
        """One turn; False once the orderly end is over."""
        if self._bus is None:
            return self._reopen()
        try:
            self._sleep((self._engine.due_ns() - time.monotonic_ns()) / 1e9)
            # Before anything is read: a deadline was missed in the state that the car was known to be in.
            missed = self._missed(self._engine.due_ns(), time.monotonic_ns())
            frames, messages = self._bus.drain(), self._read_edge()
            self._engine.on_frames(frames, time.monotonic_ns())
            self._update(messages)
            sent = self._write(missed)
        except BusLost as lost:
            self._lose_bus(str(lost))
            return True
        if sent:
            self._after_send()
        return not (self._stopping and self._bridge.stopped)

    def _sleep(self, most_s: float) -> None:
        """Until something has come, or `most_s` have passed."""
        if most_s > 0.0:
            select.select(self._inputs, [], [], min(most_s, self._longest_wait_s))

    def _read_edge(self) -> list[Message] | None:
        """What the edge has sent; None once it is gone."""
        if self._link.closed:
            return None
        messages = self._link.receive()
        if self._link.closed:
            self._wait_for(-1 if self._bus is None else self._bus.fileno())  # its end would wake every turn
        return messages

    def _update(self, messages: list[Message] | None) -> None:
        """What the edge has sent goes into the bridge."""
        now_ns = time.monotonic_ns()  # not before they were read: they would be of the future
        if messages is None:
            self._edge_is_gone(now_ns)
            return
        command: VehicleCommand | None = None
        for message in messages:
            self._edge_ns = now_ns
            match message:
                case Alive():
                    pass
                case VehicleCommand():
                    command = message
                case ResetConfirmed():
                    self._bridge.on_reset_confirmed(message.role, message.run_id)
                case Ask(what="deactivate"):
                    self._stop_number = message.number
                    self._begin_stop(now_ns)
                case Ask():
                    self._answer(message, time.monotonic_ns())  # what came before it may have taken its time
                case _:
                    logger.error("%s is no message to the CAN loop", type(message).__name__)
        if command is not None:
            self._bridge.on_command(command, now_ns)

    def _answer(self, ask: Ask, now_ns: int) -> None:
        """What is not answered in time is not done later behind the asker's back, unless it is better late."""
        if now_ns >= ask.until_ns and not ask.better_late:
            self._link.send(Answer(ask.number, False, "the CAN loop was late: nothing was done"))
            return
        match ask:
            case Ask(what="set_mode", argument=str() as mode):
                accepted, message = self._bridge.set_mode(mode, now_ns)
            case Ask(what="emergency_brake", argument=str() as why):
                accepted, message = self._bridge.emergency_brake(why, now_ns)
            case Ask(what="reset"):
                accepted, message = self._bridge.reset(now_ns)
            case _:
                accepted, message = (
                    False,
                    f"{ask.what} is no request to a CAN loop that runs, or not with that argument",
                )
        self._link.send(Answer(ask.number, accepted, shortened(message)))

    def _edge_is_gone(self, now_ns: int) -> None:
        """Its commands get old, and the table of reactions stops the car. When that is over there is nothing to do."""
        if not self._drives(now_ns):
            self._begin_stop(now_ns)

    def _drives(self, now_ns: int) -> bool:
        """Whether the car is in AS_DRIVING, and is received."""
        report = self._bridge.report(now_ns)
        return report.run.as_state is AsState.AS_DRIVING and not report.vcu_lost

    def _begin_stop(self, now_ns: int) -> None:
        if not self._stopping:
            self._stopping = True
            self._bridge.begin_stop(now_ns)

    def _write(self, missed: bool) -> bool:
        """Send what is due. True if a cycle was due, sent whole or not. `missed`: its deadline was missed already."""
        now_ns = time.monotonic_ns()
        due_ns = self._engine.due_ns()
        missed = missed or self._missed(due_ns, now_ns)
        sent = self._engine.poll(now_ns)
        if not sent:
            return False
        unsent_ns = self._engine.unsent_ns(now_ns)
        if unsent_ns >= self._bridge.config.send_lost_ns:
            raise BusLost(f"{self._settings.bus}: no complete cycle sent for {unsent_ns / 1e6:.0f} ms")
        if not missed and not self._missed(due_ns, time.monotonic_ns()):  # made in time, it may have left late
            self._feed_watchdog(now_ns)
        if self._engine.cycles > self._engine.incomplete_cycles or self._bridge.config.listen_only:
            self._pause_s = _REOPEN_FIRST_S  # the bus works again
        return True

    def _missed(self, due_ns: int, now_ns: int) -> bool:
        """Whether what was due is so late that the bridge must know."""
        late_ns = now_ns - due_ns
        if late_ns < DEADLINE_MISS_NS:
            return False
        self._deadline_misses += 1
        self._bridge.loop_fault(f"the CAN loop was {late_ns / 1e6:.0f} ms late", now_ns)
        return True

    def _after_send(self) -> None:
        """What may take its time, right after a send."""
        self._send_report(time.monotonic_ns())
        self._cycles += 1
        full = self._cycles % _FULL_COLLECTION_EVERY == 0
        gc.collect(2 if full else 0)
        if full:
            self._lock.answer_probes()

    def _send_report(self, now_ns: int, *, at_once: bool = False) -> None:
        if at_once or now_ns - self._report_ns >= self._settings.report_period_ns:
            self._report_ns = now_ns
            report = self._bridge.report(now_ns)
            self._link.send(
                LoopReport(report, self._reopened, self._deadline_misses, self._refused, self._link.trouble)
            )

    def _feed_watchdog(self, now_ns: int) -> None:
        period_ns = self._notifier.watchdog_period_ns
        if period_ns and now_ns - self._watchdog_ns >= period_ns:
            if now_ns - self._edge_ns >= EDGE_HUNG_NS and not self._drives(now_ns):
                return  # both are started anew; but a car that drives is braked to rest before
            self._watchdog_ns = now_ns
            self._notifier.send("WATCHDOG=1")

    # ------------------------------------------------------------ the bus comes and goes

    def _open(self) -> CanBus:
        bus = open_bus(self._settings.bus, receive=RECEIVE_IDS, may_send=AI_IDS)
        descriptor = bus.fileno()
        self._wait_for(descriptor)
        # Where there is nothing to wait on, frames are looked for in short steps.
        self._longest_wait_s = _IDLE_WAIT_S if descriptor >= 0 else _BLIND_WAIT_S
        return bus

    def _wait_for(self, bus: int = -1) -> None:
        self._inputs = [descriptor for descriptor in (bus, *self._link.descriptors) if descriptor >= 0]

    def _close_bus(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()
        self._wait_for()

    def _send(self, frame: Frame) -> bool:
        assert self._bus is not None
        return self._bus.send(frame)

    def _new_engine(self) -> Engine:
        return Engine(self._bridge, self._codec, self._send, time.monotonic_ns(), time.monotonic_ns)

    def _lose_bus(self, why: str) -> None:
        # A bus that opens and takes nothing is lost again and again: logged once.
        logger.log(logging.ERROR if self._pause_s == _REOPEN_FIRST_S else logging.DEBUG, "bus lost: %s", why)
        self._close_bus()
        now_ns = time.monotonic_ns()
        self._bridge.bus_lost(why, now_ns)
        self._send_report(now_ns, at_once=True)

    def _reopen(self) -> bool:
        """Try to open the bus again, after a pause in which the edge is still read.

        The pauses grow until a cycle has been sent whole. False when a stop is asked for: nobody is left to answer.
        """
        first = self._pause_s == _REOPEN_FIRST_S
        until_ns = time.monotonic_ns() + round(self._pause_s * 1e9)
        self._pause_s = min(2 * self._pause_s, _REOPEN_MOST_S)
        while (left_ns := until_ns - (now_ns := time.monotonic_ns())) > 0:
            self._update(self._read_edge())
            self._send_report(now_ns)
            if self._stopping:
                logger.info("stopped while the bus was gone")
                return False
            self._sleep(left_ns / 1e9)
        now_ns = time.monotonic_ns()
        try:
            self._bus = self._open()
        except BusError as error:
            logger.debug("%s", error)
            self._send_report(now_ns, at_once=True)
            self._feed_watchdog(now_ns)  # a bus that is gone is no hang, and a restart would not bring it back
            return True
        self._reopened += 1
        self._engine = self._new_engine()
        self._bridge.bus_back(now_ns)
        logger.log(logging.WARNING if first else logging.DEBUG, "bus back: %s", self._settings.bus)
        return True

    def _last_words(self, why: str) -> None:
        """One attempt at an emergency request after a failure of the loop itself."""
        try:
            now_ns = time.monotonic_ns()
            self._bridge.loop_fault(why, now_ns)
            command = self._bridge.cycle(now_ns)
            if command is not None and self._bus is not None:
                for frame in self._codec.encode_command(command):
                    self._bus.send(frame)
            self._send_report(now_ns, at_once=True)
        except Exception:
            logger.exception("no emergency request could be sent; silence stops the car after 100 ms")
