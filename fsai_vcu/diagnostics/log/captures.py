"""Captures of Wireshark and tcpdump, pcap and pcapng, of an interface of SocketCAN."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import IO, Final

from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.problems import Problems, ReadingEnds
from fsai_vcu.diagnostics.log.rows import frame_of, told_error

PCAP: Final = {  # byte order, and the unit of the fraction of a second
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
PCAPNG: Final = b"\x0a\x0d\x0d\x0a"
# Link types (tcpdump.org/linktypes.html): of one interface, and of `any` with the head of a cooked capture before.
_SOCKETCAN, _COOKED, _COOKED_2 = 227, 113, 276
_COOKED_HEAD: Final = struct.Struct(">HHH8xH")  # kind of packet, kind of device, …, protocol
_COOKED_2_HEAD: Final = struct.Struct(">HxxLHBB8x")  # protocol, …, number of the interface, kind of device, of packet
_PROTOCOLS: Final = (0x000C, 0x000D)  # CAN, CAN FD (linux/if_ether.h)
_OUTGOING: Final = 4  # kind of packet: sent by the computer that captured (linux/if_packet.h)
_PACKET_BYTES: Final = 256 << 10
_SECTION, _INTERFACE, _SIMPLE, _STATISTICS, _PACKET = 0x0A0D0D0A, 1, 3, 5, 6  # blocks of pcapng
_DROPPED: Final = (5, 7)  # options of statistics: packets that the interface, the operating system had no room for
_RESOLUTION: Final = 9  # option of an interface
_NAME: Final = 2
_INTERFACES: Final = 256


def read_capture(stream: IO[bytes], told: Problems, name: str) -> Iterator[LogFrame]:
    """All CAN frames of a capture. Raises ReadingEnds where it ends before its end."""
    magic = stream.read(4)
    packets = _pcapng(stream, told) if magic == PCAPNG else _pcap(stream, *PCAP[magic])
    for number, (link, channel, t_ns, packet, length, order) in enumerate(packets, 1):
        try:
            if len(packet) < length:
                raise ValueError("it was cut by the capture")
            sent = None
            if link in (_COOKED, _COOKED_2):
                protocol, kind, channel, packet = _uncooked(link, channel, packet)
                if protocol not in _PROTOCOLS:
                    told.note("a packet of another interface, which is not a CAN frame")
                    continue
                sent = kind == _OUTGOING
            elif link != _SOCKETCAN:
                told.note(f"a packet of link type {link}, which is not a frame of a CAN interface")
                continue
            yield _frame(t_ns, channel, packet, ">" if link == _SOCKETCAN else order, sent)
        except (ValueError, struct.error) as error:
            words = "it is too short" if isinstance(error, struct.error) else error
            told.add(f"{name}: packet {number} is left out: {words}")


def _uncooked(link: int, channel: str, packet: bytes) -> tuple[int, int, str, bytes]:
    """(protocol, kind of packet, channel, what is behind the head). Raises struct.error."""
    if link == _COOKED:
        kind, _, _, protocol = _COOKED_HEAD.unpack_from(packet)
        return protocol, kind, channel, packet[_COOKED_HEAD.size :]
    protocol, interface, _, kind, _ = _COOKED_2_HEAD.unpack_from(packet)
    return protocol, kind, f"if{interface}", packet[_COOKED_2_HEAD.size :]


def _frame(t_ns: int, channel: str, packet: bytes, order: str, sent: bool | None) -> LogFrame:
    """Read a frame. order: of the identifier's bytes; in a cooked capture that of the computer that captured."""
    number, length, marks = struct.unpack_from(f"{order}LBB", packet)
    data = packet[8 : 8 + length]
    fd = bool(marks & 4) or len(packet) == 72
    if number & 0x2000_0000:
        return told_error(t_ns, channel, number, data, sent)
    extended, remote = bool(number >> 31), bool(number >> 30 & 1)
    can_id = number & (0x1FFF_FFFF if extended else 0x7FF)
    brs, esi = fd and bool(marks & 1), fd and bool(marks & 2)
    return frame_of(
        t_ns, channel, f"{can_id:X}", data, length, extended=extended, remote=remote, fd=fd, brs=brs, esi=esi, sent=sent
    )


_Packets = Iterator[tuple[int, str, int, bytes, int, str]]
"""Link type, channel, time, content, its whole length, and the order of bytes of the computer that captured."""


def _pcap(stream: IO[bytes], order: str, unit_ns: int) -> _Packets:
    """Yield the packets of a pcap file."""
    head = stream.read(20)
    if len(head) < 20:
        raise ReadingEnds("cut off in its head")
    link = struct.unpack(f"{order}L", head[16:])[0] & 0xFFFF
    while each := stream.read(16):
        if len(each) < 16:
            raise ReadingEnds("cut off")
        seconds, fraction, length, whole = struct.unpack(f"{order}LLLL", each)
        if length > _PACKET_BYTES or length > whole:
            raise ReadingEnds(f"a packet of length {length}")
        packet = stream.read(length)
        if len(packet) < length:
            raise ReadingEnds("cut off")
        yield link, "can0", seconds * 1_000_000_000 + fraction * unit_ns, packet, whole, order


def _pcapng(stream: IO[bytes], told: Problems) -> _Packets:
    """Yield the packets of a pcapng file, of all its interfaces."""
    order, kind = "<", _SECTION
    interfaces: list[tuple[int, str, int]] = []  # link type, channel, units a second
    dropped: dict[int, int] = {}  # by the interface's number: all up to now
    first = True
    while True:
        head = (PCAPNG if first else stream.read(4)) + (stream.read(4))
        first = False
        if not head:
            return
        if len(head) < 8:
            raise ReadingEnds("cut off")
        kind, size = struct.unpack(f"{order}LL", head)
        begin = b""
        if kind == _SECTION:
            begin = stream.read(4)
            order = "<" if begin == b"\x4d\x3c\x2b\x1a" else ">"
            size = struct.unpack(f"{order}L", head[4:])[0]
            interfaces, dropped = [], {}
        if size < 12 + len(begin) or size > _PACKET_BYTES:
            raise ReadingEnds(f"a block of length {size}")
        body = begin + stream.read(size - 8 - len(begin))
        if len(body) < size - 8:
            raise ReadingEnds("cut off")
        if kind == _INTERFACE and len(interfaces) < _INTERFACES and size >= 20:
            interfaces.append(_interface(order, body[:-4], len(interfaces)))
        elif kind == _PACKET and size >= 32:
            number, high, low, length, whole = struct.unpack_from(f"{order}LLLLL", body)
            if number >= len(interfaces) or length > len(body) - 24:
                raise ReadingEnds("an invalid packet")
            link, channel, units = interfaces[number]
            yield link, channel, (high << 32 | low) * 1_000_000_000 // units, body[20 : 20 + length], whole, order
        elif kind == _STATISTICS and size >= 24:
            number = struct.unpack_from(f"{order}L", body)[0]
            lost = _dropped(order, body[12:-4])
            told.lost += max(lost - dropped.get(number, 0), 0)
            dropped[number] = lost
        elif kind == _SIMPLE:
            raise ReadingEnds("packets without times")
        elif kind not in (_SECTION, _INTERFACE):
            told.note(f"a block of type {kind}, which is no packet")


def _interface(order: str, body: bytes, number: int) -> tuple[int, str, int]:
    link = struct.unpack_from(f"{order}H", body)[0]
    channel, units = f"can{number}", 1_000_000
    for option, value in _options(order, body[8:]):
        if option == _RESOLUTION and value:
            units = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** (min(value[0], 12))
        elif option == _NAME and value:
            channel = value[:15].decode("ascii", "replace").rstrip("\0") or channel
    return link, channel, units


def _dropped(order: str, options: bytes) -> int:
    """Packets that statistics of an interface say it lost."""
    found = (value for option, value in _options(order, options) if option in _DROPPED and len(value) == 8)
    return sum(int(struct.unpack(f"{order}Q", value)[0]) for value in found)


def _options(order: str, body: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the options at the end of a block: kind and value."""
    at = 0
    while at + 4 <= len(body):
        option, length = struct.unpack_from(f"{order}HH", body, at)
        if option == 0:
            return
        yield option, body[at + 4 : at + 4 + length]
        at += 4 + length + -length % 4
