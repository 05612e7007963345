"""Link between the CAN loop's process and its edge: datagrams on socket pairs, and nobody waits for anybody.

The loop shares no interpreter, lock or allocator with its edge (the ROS node). Each message is one datagram, sent
without waiting. What finds no room is dropped and counted, never kept: nothing can wait in front of anything. The next
report, command or Alive replaces a dropped message of its kind; a request that was dropped is refused to its sender at
once. The end of a process is seen at once, as the end of the stream.

There are two lanes, a socket pair each. What stops the car (`URGENT`), all answers and the loop's last word have a lane
of their own, where only those few are: they arrive whatever the other lane is full of.

A message is a value, encoded as msgpack and checked against the bounds of its type where it is decoded; so is what is
sent, but for reports, whose texts the core has shortened. Nothing that arrives can do more than be refused: what cannot
be decoded is dropped, counted and named (`LinkTrouble`). A report's datagram differs from the others by its first byte,
so that of several that wait only the newest is decoded.
"""

from __future__ import annotations

import contextlib
import logging
import select
import socket
from types import MappingProxyType
from typing import Annotated, Final, Literal, NamedTuple

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.values import DETAIL_LENGTH, WORD_LENGTH, Count, Detail, Sentence, Value, Whole, Word, shortened
from fsai_vcu.interface.wheels import STRAIGHT, WheelMapping

LARGEST_BYTES: Final = 200_000  # no legal message is larger, and every Linux carries it; a report has 2 to 20 kB
LOG_LENGTH: Final = 8000
_MOST_AT_ONCE: Final = 256  # messages of a lane that are taken in one turn
_REPORT, _OTHER = b"R", b"M"


# ---------------------------------------------------------------- from the edge to the loop: these, and commands


class LoopSettings(Value, frozen=True, tag=True):
    """Everything that makes a bridge and its loop; the loop's process reads the database and opens the bus."""

    bus: Sentence
    revision: Word
    car: Word
    dbc_files: Annotated[tuple[Annotated[str, Meta(max_length=4096)], ...], Meta(max_length=8)] = ()  # empty: its own
    wheel_mapping: WheelMapping = STRAIGHT
    config: BridgeConfig = BridgeConfig()
    limits: OperationalLimits | None = None
    real_time: bool = True
    report_period_ns: Count = 10_000_000


class ResetConfirmed(Value, frozen=True, tag=True):
    """`role` has forgotten the previous run and is ready for `run_id`."""

    role: Word
    run_id: Whole


class Alive(Value, frozen=True, tag=True):
    """The edge still runs, whether it has anything else to say or not. Sent once a second."""


Request = Literal["configure", "activate", "set_mode", "emergency_brake", "reset", "deactivate"]
URGENT: Final = frozenset({"emergency_brake", "reset", "deactivate"})


class Ask(Value, frozen=True, tag=True):
    """A request that wants an Answer of its number. After `until_ns` nobody waits any more: it is refused then, unless
    it is `better_late` than never. The process is asked to

        configure (LoopSettings): read the database;
        activate (the first run's id): take the interface's lock, open the bus and run;

    and the loop that runs then for set_mode (its name), emergency_brake (why), reset, and to

        deactivate: stop in order, fall silent, give lock and bus back; answered then.
    """

    number: Count
    what: Request
    argument: LoopSettings | Whole | Detail | None
    until_ns: Whole
    better_late: bool


# ---------------------------------------------------------------- from the loop to the edge


class Answer(Value, frozen=True, tag=True):
    """Answer to the request of that number."""

    number: Count
    accepted: bool
    message: Sentence = ""


class LinkTrouble(Value, frozen=True):
    """Trouble at one end of the link since it was made: counts of messages, and the newest in words."""

    dropped: Count = 0  # found no room: the other side did not read
    refused: Count = 0  # were not sent: beyond the bounds of their type
    undecoded: Count = 0  # arrived, and were none
    words: Detail = ""  # of the last two


class LoopReport(Value, frozen=True, tag=True):
    """A snapshot of the bridge, and what the loop knows of itself."""

    bridge: BridgeReport
    reopened: Count = 0  # how often a lost bus was opened again
    deadline_misses: Count = 0
    # Parts of real-time scheduling that were not allowed, in words.
    scheduling_refused: Annotated[tuple[Sentence, ...], Meta(max_length=4)] = ()
    link: LinkTrouble = LinkTrouble()  # of the loop's end


class LogLine(Value, frozen=True, tag=True):
    """Line of the loop's log, with the traceback of what was raised.

    The loop itself writes to no file, terminal or socket of a journal.
    """

    logger: Word
    level: Annotated[int, Meta(ge=0, le=100)]
    text: Annotated[str, Meta(max_length=LOG_LENGTH)]


class Ended(Value, frozen=True, tag=True):
    """The loop has ended by itself: why."""

    failure: Sentence


Message = VehicleCommand | ResetConfirmed | Alive | Ask | Answer | LogLine | Ended | LoopReport


def _plain(value: object) -> object:
    """Return what msgspec can encode in place of a wrapper that only guards it from being changed."""
    if isinstance(value, MappingProxyType):
        return dict(value)
    raise NotImplementedError(f"nothing of the type {type(value).__name__} can be sent")


_encode: Final = msgspec.msgpack.Encoder(enc_hook=_plain).encode
_decode: Final = msgspec.msgpack.Decoder(Message).decode


# ---------------------------------------------------------------- the two ends


class Lanes(NamedTuple):
    """The sockets of one end."""

    ordinary: socket.socket
    urgent: socket.socket


def link_pair() -> tuple[Lanes, Lanes]:
    """The two ends of a new link, neither of which ever blocks."""
    ordinary, urgent = (socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in Lanes._fields)
    return Lanes(ordinary[0], urgent[0]), Lanes(ordinary[1], urgent[1])


class LinkEnd:
    """One end: sends without waiting, and hands over all that has come."""

    def __init__(self, lanes: Lanes) -> None:
        for lane in lanes:
            lane.setblocking(False)
        self._lanes = lanes
        self._buffer = bytearray(LARGEST_BYTES)
        self._view = memoryview(self._buffer)
        self.closed = False  # the other side is gone, or this one was closed
        self.refusal = ""  # why the last message was not sent, in words; empty where it only found no room
        self.trouble = LinkTrouble()

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Return what to wait on for messages; nothing once the link is closed."""
        return () if self.closed else tuple(lane.fileno() for lane in self._lanes)

    def send(self, message: Message) -> bool:
        """Send a message, and return true where it is on its way. Never waits and never raises: a full or dead link is
        the other side's trouble.
        """
        self.refusal = ""
        if self.closed:
            return False
        try:
            datagram = _datagram(message)
        except Exception as error:  # whatever somebody has put into a field
            self.refusal = shortened(f"{_name_of(message)} cannot be sent to the other process: {error}", DETAIL_LENGTH)
            self._note("refused", self.refusal)
            return False
        lane = self._lanes.urgent if _is_urgent(message) else self._lanes.ordinary
        try:
            lane.send(datagram)
        except OSError:  # full; or dead, which is for `receive` to see, after what had still come
            self._note("dropped")
            return False
        return True

    def receive(self) -> list[Message]:
        """Return the messages that wait, the urgent lane's first; of several reports the newest, as the last element.

        At most some hundred messages at once: a flood is read turn by turn.
        """
        if self.closed:
            return []
        messages: list[Message] = []
        reports: list[bytes] = []
        ended = [self._take(lane, messages, reports) for lane in (self._lanes.urgent, self._lanes.ordinary)]
        if any(ended):  # what the far end said last may have come after the urgent lane was read
            self._take(self._lanes.urgent, messages, reports)
            self.closed = True
        for report in reports:
            self._decode_into(messages, report)
        return messages

    def _take(self, lane: socket.socket, messages: list[Message], reports: list[bytes]) -> bool:
        """Read what waits in a lane, the newest report undecoded; return true where the far end has closed it."""
        for _ in range(_MOST_AT_ONCE):
            try:
                size = lane.recv_into(self._buffer)
            except BlockingIOError:
                return False
            except OSError:
                return True
            if size == 0 and _is_over(lane):
                return True
            if self._view[:1] == _REPORT and size:
                reports[:] = [bytes(self._view[1:size])]
            else:
                self._decode_into(messages, self._view[1:size])
        return False

    def close(self) -> None:
        self.closed = True
        for lane in self._lanes:
            lane.close()

    def _decode_into(self, messages: list[Message], datagram: bytes | memoryview) -> None:
        try:
            messages.append(_decode(datagram))
        except Exception as error:  # whatever was put on the link
            words = f"{len(datagram)} bytes are not a message: {error}"
            self._note("undecoded", shortened(words, DETAIL_LENGTH))

    def _note(self, what: str, words: str | None = None) -> None:
        trouble = self.trouble
        counted = {what: getattr(trouble, what) + 1}
        self.trouble = replace(trouble, **counted) if words is None else replace(trouble, **counted, words=words)


def _datagram(message: Message) -> bytes:
    """The message's bytes; any exception where they are not within the bounds of its type."""
    encoded = _encode(message)
    if type(message) is LoopReport:
        prefix = _REPORT
    else:
        _decode(encoded)
        prefix = _OTHER
    if len(encoded) >= LARGEST_BYTES:
        raise ValueError(f"it has {len(encoded)} bytes")
    return prefix + encoded


def _is_urgent(message: Message) -> bool:
    return isinstance(message, (Answer, Ended)) or (isinstance(message, Ask) and message.what in URGENT)


def _name_of(message: Message) -> str:
    return str(message.what)[:DETAIL_LENGTH] if isinstance(message, Ask) else type(message).__name__


def _is_over(lane: socket.socket) -> bool:
    """Return true where nothing can come any more: an empty datagram is read like the end of the stream."""
    waiting = select.poll()
    waiting.register(lane, 0)
    return any(events & (select.POLLHUP | select.POLLERR) for _, events in waiting.poll(0))


class LinkHandler(logging.Handler):
    """Hands log lines to the edge. A line that cannot be handed over is lost: there is nowhere to write it."""

    def __init__(self, link: LinkEnd) -> None:
        super().__init__()
        self._link = link

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(Exception):
            text = shortened(self.format(record), LOG_LENGTH)
            self._link.send(LogLine(shortened(record.name, WORD_LENGTH), record.levelno, text))
