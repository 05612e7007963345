"""The CAN loop without IO: times and data in, actions out; no clock, socket or thread.

The real-time loop, lockstep's AI computer and the fuzz drive this same object, so what is rehearsed is what runs. A
turn begins when something has come or is due (`due_ns`):

    awake(now);
    on_frames, on_edge with all that has waited;
    act(now).

What these return is carried out in order and at once. How a Send or an OPEN went is told by `sent`, `opened` or
`refused`, a bus that broke at any point of a turn by `lost`; they return actions as well. Times are integer monotonic
nanoseconds.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from enum import Enum

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import STATUS_ID
from fsai_vcu.interface.values import Value, shortened
from fsai_vcu.runtime.link import Alive, Answer, Ask, Message, ResetConfirmed
from fsai_vcu.runtime.pacing import Pacing

DEADLINE_MISS_NS = 50_000_000  # safety: a deadline missed by 50 ms is a fault of the loop
REOPEN_FIRST_NS, REOPEN_MOST_NS = 10_000_000, 1_000_000_000  # the first pause also keeps two sends apart
EDGE_HUNG_NS = 3_000_000_000  # it reports once a second that it runs


class Do(Enum):
    """An action that needs no data."""

    OPEN = "open the bus"
    CLOSE = "close the bus"
    REPORT = "send a report to the edge"
    FEED = "feed the watchdog"
    END = "end: no further turn"


class Send(Value, frozen=True):
    """Send a cycle's frames, none in a silent one.

    After a frame that is not taken the rest would be a mixture of two commands. Then there is time for whatever may
    take its time.
    """

    frames: tuple[Frame, ...]


class Note(Value, frozen=True):
    """Write a line into the log."""

    level: int  # as in logging
    words: str


# A request is put to `answer`, each at its own time: what came before it may have taken its time. An Answer is sent.
Action = Send | Do | Note | Ask | Answer


class Turns:
    """Decides what the loop does in each turn.

    It answers each 0x520, keeps its own clock when there is none, and copes with missed deadlines, a bus that goes and
    comes, and an edge that asks, is silent or is gone.
    """

    def __init__(
        self,
        bridge: Bridge,
        codec: Codec,
        now_ns: int,
        bus: str = "the bus",
        report_period_ns: int = 10_000_000,
        watchdog_period_ns: int | None = None,
    ) -> None:
        """Begins with an open bus, named `bus` in words. `watchdog_period_ns`: None where none is to be fed."""
        self.reopened = 0
        self.deadline_misses = 0
        self.stop_number: int | None = None  # of the request to stop
        self._bridge = bridge
        self._codec = codec
        self._bus = bus
        self._report_period_ns = report_period_ns
        self._watchdog_period_ns = watchdog_period_ns
        self._edge_ns = now_ns  # when the edge last sent anything
        self._report_ns = self._fed_ns = 0  # when a report was last sent, and the watchdog fed
        self._stopping = False
        self._pause_ns = REOPEN_FIRST_NS  # before the next try to open a lost bus
        self._loud = True  # the loss in hand is written into the log
        self._begin(now_ns)

    def _begin(self, now_ns: int) -> None:
        """The bus has just been opened."""
        self._pacing = Pacing(now_ns)
        self._open_ns: int | None = None  # when to try to open a lost bus
        self._missed = False  # the deadline of the cycle that is due
        self._cycle_ns = now_ns  # when the cycle that is being sent was made
        self._whole_ns: int | None = None  # the last cycle that was sent whole, or the first that was tried

    @property
    def has_bus(self) -> bool:
        """Return true where the bus is open, as far as the loop knows."""
        return self._open_ns is None

    def due_ns(self) -> int:
        """Return when (ns) `act` next has something to do, if nothing comes: a cycle, or a try to open a lost bus."""
        return self._pacing.due_ns() if self._open_ns is None else self._open_ns

    # ------------------------------------------------------------ a turn

    def awake(self, now_ns: int) -> None:
        """A turn begins, nothing has been read: a deadline was missed in the state that the car was known to be in."""
        if self._open_ns is None:
            self._judge(self._pacing.due_ns(), now_ns)

    def on_frames(self, frames: Sequence[Frame], now_ns: int) -> None:
        """Take in everything that waited on the bus at `now_ns`, oldest first, before the next answer.

        `t_ns` of each frame is when the kernel received it: what has waited is as old as it is, and a backlog is named.
        """
        receive = self._bridge.on_frame
        for frame in frames:
            receive(frame)
            if frame.can_id == STATUS_ID and not (frame.error or frame.extended or frame.remote):
                self._pacing.on_status(frame.t_ns)
        if frames:
            self._bridge.backlog(now_ns - frames[0].t_ns, now_ns)

    def on_edge(self, messages: Iterable[Message] | None, now_ns: int) -> list[Action]:
        """Take in what the edge has sent, read by `now_ns`; None once it is gone.

        The newest of several commands counts. A silent edge's commands get old, and so do those of an edge that is
        gone: the table of reactions stops the car. When that is over there is nothing left to do.
        """
        actions: list[Action] = []
        if messages is None:
            if not self._drives(now_ns):
                self._begin_stop(now_ns)
            return actions
        command: VehicleCommand | None = None
        for message in messages:
            self._edge_ns = now_ns
            match message:
                case VehicleCommand():
                    command = message
                case Alive():
                    pass
                case ResetConfirmed():
                    self._bridge.on_reset_confirmed(message.role, message.run_id)
                case Ask():
                    actions.append(message)
                case _:
                    actions.append(Note(logging.ERROR, f"{type(message).__name__} is not a message for the CAN loop"))
        if command is not None:
            self._bridge.on_command(command, now_ns)
        return actions

    def answer(self, ask: Ask, now_ns: int) -> tuple[Action, ...]:
        """Answer the edge: what is late is not done behind the asker's back, unless it is better late."""
        if ask.what == "deactivate":  # answered after the end
            self.stop_number = ask.number
            self._begin_stop(now_ns)
            return ()
        if now_ns >= ask.until_ns and not ask.better_late:
            return (Answer(ask.number, False, "the CAN loop was late: nothing was done"),)
        match ask:
            case Ask(what="set_mode", argument=str() as mode):
                accepted, message = self._bridge.set_mode(mode, now_ns)
            case Ask(what="emergency_brake", argument=str() as why):
                accepted, message = self._bridge.emergency_brake(why, now_ns)
            case Ask(what="reset"):
                accepted, message = self._bridge.reset(now_ns)
            case _:
                accepted = False
                message = f"{ask.what} is no request to a CAN loop that runs, or not with that argument"
        return (Answer(ask.number, accepted, shortened(message)),)

    def act(self, now_ns: int) -> tuple[Action, ...]:
        """Do what is due at `now_ns`: the end, a cycle, or a try to open a lost bus."""
        has_bus, due_ns = self._open_ns is None, self.due_ns()
        if self._stopping and not has_bus:  # nobody is left to answer
            return Note(logging.INFO, "stopped while the bus was gone"), Do.REPORT, Do.END
        if self._stopping and self._bridge.stopped:
            return Do.REPORT, Do.END
        if now_ns < due_ns:
            return () if has_bus else self._report(now_ns)
        if not has_bus:
            return (Do.OPEN,)
        self._judge(due_ns, now_ns)
        command = self._bridge.cycle(now_ns)
        self._cycle_ns = now_ns
        return (Send(() if command is None else self._codec.encode_command(command, now_ns)),)

    def sent(self, complete: bool, left_ns: int | None, now_ns: int) -> tuple[Action, ...]:
        """A Send was carried out by `now_ns`, `complete` if everything was taken.

        left_ns: when the first frame left, from which the next cycle keeps its distance; None where there was none.
        """
        cycle_ns, config = self._cycle_ns, self._bridge.config
        if left_ns is not None:
            self._bridge.on_sent(complete, cycle_ns)
            if complete or self._whole_ns is None:
                self._whole_ns = cycle_ns
            unsent_ns = cycle_ns - self._whole_ns
            if unsent_ns >= config.send_lost_ns:
                return self.lost(f"{self._bus}: no complete cycle sent for {unsent_ns / 1e6:.0f} ms", now_ns)
        if (complete and left_ns is not None) or config.listen_only:
            self._pause_ns = REOPEN_FIRST_NS  # the bus works again
        self._judge(self._pacing.due_ns(), now_ns)  # made in time, it may have left late
        fed = () if self._missed else self._feed(cycle_ns)
        self._missed = False
        self._pacing.on_sent(cycle_ns if left_ns is None else left_ns)
        if self._stopping and self._bridge.stopped:
            return *fed, Do.REPORT, Do.END
        return *fed, *self._report(now_ns)

    # ------------------------------------------------------------ the bus comes and goes

    def lost(self, why: str, now_ns: int) -> tuple[Action, ...]:
        """The bus is lost: it is opened again after a pause, and the pauses grow until a cycle has been sent whole."""
        self._loud = self._pause_ns == REOPEN_FIRST_NS  # a bus that opens and takes nothing is lost again and again
        self._wait(now_ns)
        self._bridge.bus_lost(why, now_ns)
        return self._noted(logging.ERROR, f"bus lost: {why}"), Do.CLOSE, *self._report(now_ns, at_once=True)

    def refused(self, why: str, now_ns: int) -> tuple[Action, ...]:
        """The bus could not be opened. That is no hang, and a restart would not bring it back."""
        self._wait(now_ns)
        return Note(logging.DEBUG, why), *self._report(now_ns, at_once=True), *self._feed(now_ns)

    def opened(self, now_ns: int) -> tuple[Action, ...]:
        """The bus is open again; the next turn follows at once."""
        self._begin(now_ns)
        self.reopened += 1
        self._bridge.bus_back(now_ns)
        return (self._noted(logging.WARNING, f"bus back: {self._bus}"),)

    def _wait(self, now_ns: int) -> None:
        self._open_ns = now_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, REOPEN_MOST_NS)

    def _noted(self, level: int, words: str) -> Note:
        return Note(level if self._loud else logging.DEBUG, words)

    # ------------------------------------------------------------ the loop itself

    def failed(self, why: str, now_ns: int) -> tuple[Frame, ...]:
        """The loop itself has failed: the frames of its one emergency request, none where it must be silent."""
        self._bridge.loop_fault(why, now_ns)
        command = self._bridge.cycle(now_ns)
        return () if command is None else self._codec.encode_command(command)

    def _judge(self, due_ns: int, now_ns: int) -> None:
        """Judge whether what was due is so late that the bridge must know; it is told once."""
        late_ns = now_ns - due_ns
        if late_ns >= DEADLINE_MISS_NS and not self._missed:
            self._missed = True
            self.deadline_misses += 1
            self._bridge.loop_fault(f"the CAN loop was {late_ns / 1e6:.0f} ms late", now_ns)

    def _drives(self, now_ns: int) -> bool:
        """Return true while the car is in AS_DRIVING, and is received."""
        return self._bridge.run.as_state is AsState.AS_DRIVING and not self._bridge.report(now_ns).vcu_lost

    def _begin_stop(self, now_ns: int) -> None:
        if not self._stopping:
            self._stopping = True
            self._bridge.begin_stop(now_ns)

    def _report(self, now_ns: int, *, at_once: bool = False) -> tuple[Action, ...]:
        if not at_once and now_ns - self._report_ns < self._report_period_ns:
            return ()
        self._report_ns = now_ns
        return (Do.REPORT,)

    def _feed(self, now_ns: int) -> tuple[Action, ...]:
        period_ns = self._watchdog_period_ns
        if period_ns is None or now_ns - self._fed_ns < period_ns:
            return ()
        if now_ns - self._edge_ns >= EDGE_HUNG_NS and not self._drives(now_ns):
            return ()  # both are started again; but a car that drives is braked to rest before
        self._fed_ns = now_ns
        return (Do.FEED,)
