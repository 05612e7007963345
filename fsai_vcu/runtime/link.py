"""What the CAN loop's process and its edge say to each other: datagrams on a socket pair, and nobody waits for anybody.

The loop shares no interpreter, lock or allocator with its edge (the ROS node). Each message is one datagram, sent
without waiting: where the other side does not read, it is dropped, and the next report replaces it. The end of a
process is seen at once, as the end of the stream. A command or a report costs 4 us like this; shared memory would cost
3 us, and need polling, a guard against torn reads, and another way to notice a death.

The pair is private to the two processes, so messages are pickled objects; a report's datagram differs from the others
by its first byte, so that of several that wait only the newest is unpacked.
"""

from __future__ import annotations

import copyreg
import logging.handlers
import pickle
import queue
import socket
from collections import deque
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.values import Value
from fsai_vcu.interface.wheels import STRAIGHT, WheelMapping

_LARGEST_BYTES = 1 << 17  # a report has 2 to 20 kB
_REPORT, _OTHER = b"R", b"M"


# ---------------------------------------------------------------- from the edge to the loop: these, and commands


class LoopSettings(Value, frozen=True):
    """Everything that makes a bridge and its loop; the loop's process reads the database and opens the bus."""

    bus: str
    revision: str
    car: str
    dbc_files: tuple[Path, ...] = ()  # empty: the revision's own
    wheel_mapping: WheelMapping = STRAIGHT
    config: BridgeConfig = BridgeConfig()
    limits: OperationalLimits | None = None
    real_time: bool = True
    report_period_ns: int = 10_000_000


class ResetConfirmed(Value, frozen=True):
    """`role` has forgotten the previous run and is ready for `run_id`."""

    role: str
    run_id: int


class Alive(Value, frozen=True):
    """The edge still runs, whether it has anything else to say or not. Sent once a second."""


class Ask(Value, frozen=True):
    """A request that wants an Answer of its number. After `until_ns` nobody waits any more: it is refused then, unless
    it is `better_late` than never. The process is asked to

        configure (LoopSettings): read the database;
        activate (the first run's id): take the interface's lock, open the bus and run;

    and the loop that runs then for set_mode (its name), emergency_brake (why), reset, and to

        deactivate: stop in order, fall silent, give lock and bus back; answered then.
    """

    number: int
    what: str
    argument: Any
    until_ns: int
    better_late: bool


# ---------------------------------------------------------------- from the loop to the edge: these, and log records


class Answer(Value, frozen=True):
    """To the request of that number."""

    number: int
    accepted: bool
    message: str = ""


class LoopReport(Value, frozen=True):
    """A snapshot of the bridge, and what the loop knows of itself."""

    bridge: BridgeReport
    reopened: int = 0  # how often a lost bus was opened again
    deadline_misses: int = 0
    scheduling_refused: tuple[str, ...] = ()  # what of real-time scheduling was not allowed, in words


class Ended(Value, frozen=True):
    """The loop has ended by itself: why."""

    failure: str


_REPLACED_BY_THE_NEXT = (LoopReport, VehicleCommand, Alive)
_MOST_KEPT = 100  # messages


# ---------------------------------------------------------------- the two ends


def link_pair() -> tuple[socket.socket, socket.socket]:
    """The two ends of a new link, neither of which ever blocks."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
    return ends


class LinkEnd:
    """One end: sends without waiting, and hands over all that has come."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._socket = end
        self._buffer = bytearray(_LARGEST_BYTES)
        self._view = memoryview(self._buffer)
        self._waiting: deque[bytes] = deque(maxlen=_MOST_KEPT)  # what found no room and must not be lost
        self.closed = False  # the other side is gone, or this one was closed
        self.dropped = 0  # reports and commands that found no room: the next one replaces them

    def fileno(self) -> int:
        return self._socket.fileno()

    def send(self, message: object) -> bool:
        """Whether it is on its way. Never waits and never raises: a full or dead link is the other side's trouble.

        What must not be lost goes out with a later one where there is no room now.
        """
        if self.closed:
            return False
        kind = _REPORT if type(message) is LoopReport else _OTHER
        datagram = kind + pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        if self.flush() and self._sent(datagram):
            return True
        if isinstance(message, _REPLACED_BY_THE_NEXT):
            self.dropped += 1
        else:
            self._waiting.append(datagram)
        return False

    def flush(self) -> bool:
        """Send what has been waiting for room. Whether nothing waits any more."""
        while self._waiting and self._sent(self._waiting[0]):
            self._waiting.popleft()
        return not self._waiting

    def _sent(self, datagram: bytes) -> bool:
        try:
            self._socket.send(datagram)
        except OSError:  # full; or dead, which is for `receive` to see, after what had still come
            return False
        return True

    def receive(self) -> list[Any]:
        """Everything that waits, in order; of several reports the newest, as the last element."""
        messages: list[Any] = []
        newest: bytes | None = None
        while not self.closed:
            try:
                size = self._socket.recv_into(self._buffer)
            except BlockingIOError:
                break
            except OSError:
                size = 0
            if size == 0:
                self.closed = True
                break
            if self._buffer[:1] == _REPORT:
                newest = bytes(self._view[1:size])
            else:
                messages.append(pickle.loads(self._view[1:size]))
        if newest is not None:
            messages.append(pickle.loads(newest))
        return messages

    def close(self) -> None:
        self.closed = True
        self._socket.close()


class LinkHandler(logging.handlers.QueueHandler):
    """Hands log records to the edge: the loop itself writes to no file, terminal or socket of a journal."""

    def __init__(self, link: LinkEnd) -> None:
        super().__init__(queue.SimpleQueue())  # which is not used
        self._link = link

    def enqueue(self, record: logging.LogRecord) -> None:
        self._link.send(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """A line that cannot be handed over is lost: there is nowhere to write it."""


def _read_only(values: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(values)


copyreg.pickle(MappingProxyType, lambda proxy: (_read_only, (dict(proxy),)))
