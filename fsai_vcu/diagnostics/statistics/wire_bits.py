"""Length of frames on the wire: exact for classic CAN, with every stuff bit, as the CRC and the data make them.

A classic frame is SOF, arbitration, control, data and CRC, all of it stuffed (after five bits alike comes one of the
other kind), then CRC delimiter, acknowledge, its delimiter, seven bits of end and three of intermission (ISO 11898-1).
CRC and stuffing go byte by byte through tables, all frames of one length at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, reduce
from typing import Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.frames import CLASSIC_BYTES, ERROR, EXTENDED, FD, REMOTE, Frames, Ints

CRC15: Final = 0x4599
_UNSTUFFED_BITS: Final = 1 + 1 + 1 + 7 + 3  # behind the CRC
_CRC_BITS: Final = 15
_MOST_PARTS: Final = 5 + CLASSIC_BYTES  # bytes up to the CRC, of an extended frame
AT_ONCE: Final = 1 << 16  # frames: what of each kind fits a processor's cache is done fastest

Bytes = npt.NDArray[np.uint8]
Halves = npt.NDArray[np.uint16]


def wire_bits(frames: Frames) -> Halves:
    """Bits of each frame including intermission; 0 for error frames, which tell nothing of their length.

    FD frames are estimated, without a faster data phase and with a tenth of stuff bits.
    """
    bits = np.zeros(len(frames), np.uint16)
    for begin in range(0, len(frames), AT_ONCE):
        part = slice(begin, begin + AT_ONCE)
        kinds = (frames.flags[part] & np.uint8(EXTENDED | REMOTE | ERROR | FD)).astype(np.uint16) << np.uint16(8)
        kinds |= frames.length[part]
        for kind in np.flatnonzero(np.bincount(kinds)).tolist():
            its = kinds == kind
            rows = part if its.all() else np.flatnonzero(its) + begin
            flags, length = divmod(kind, 1 << 8)
            if flags & FD and not flags & ERROR:
                crc = 17 if length <= 16 else 21
                head = (32 if flags & EXTENDED else 12) + 9
                bits[rows] = round((head + 8 * length) * 1.1) + 4 + crc + crc // 4 + 1 + _UNSTUFFED_BITS
            elif not flags & ERROR:
                data = frames.word[rows].astype("<u8").view(np.uint8).reshape(-1, CLASSIC_BYTES)
                can_id = frames.can_id[rows].astype(np.int64)
                if (can_id == can_id[0]).all():
                    can_id = can_id[:1]  # what comes before the data is the same in all of them
                bits[rows] = _classic_bits(can_id, data, flags, length)
    return bits


def _classic_bits(can_id: Ints, data: Bytes, flags: int, length: int) -> Bytes:
    """`can_id` [n], or the only one, and `data` [n, 8] of frames that have the flags and the length in common."""
    control = (1 << 6 if flags & REMOTE else 0) | min(length, CLASSIC_BYTES)
    header, bits = can_id << 7 | control, 1 + 11 + 7
    if flags & EXTENDED:
        arbitration = (can_id >> 18 << 2 | 0b11) << 18 | can_id & 0x3FFFF  # 11 bits of the id, SRR, IDE, 18 of the id
        header, bits = arbitration << 7 | control, 1 + 31 + 7
    payload = np.ascontiguousarray(data[:, : 0 if flags & REMOTE else length].T)
    crc = _crc([*_bytes_of(header, bits), *payload])
    # Filled up to whole bytes by what brings no stuff bit: 1 and 0 in turns before the first 0, and at the end another.
    filled = header | (0b1010101 << bits) & ((1 << -(-bits // 8) * 8) - 1)
    tail = _bytes_of(crc << np.uint16(1) | ~crc & np.uint16(1), _CRC_BITS + 1)
    return (
        bits + 8 * len(payload) + _CRC_BITS + _stuff_bits([*_bytes_of(filled, bits), *payload, *tail]) + _UNSTUFFED_BITS
    )


def _bytes_of(numbers: Ints | Halves, bits: int) -> list[Bytes]:
    """The lowest bits of each number, and some above, as bytes, the highest first."""
    return [(numbers >> shift).astype(np.uint8) for shift in range((bits - 1) // 8 * 8, -1, -8)]


def _crc(parts: Sequence[Bytes]) -> Halves:
    """Return the CRC of numbers whose bytes are the parts, as the sum without carry of those of each byte alone."""
    return reduce(np.bitwise_xor, map(np.take, _crc_tables()[len(parts) - 1 :: -1], parts))


def _stuff_bits(parts: Sequence[Bytes]) -> Bytes:
    """Count the stuff bits that come into numbers whose bytes are the parts."""
    count: Halves = np.zeros(1, np.uint16)  # in its low byte; what the states add above is not looked at
    found: Halves = np.zeros(1, np.uint16)
    for part in parts:
        found = np.take(_stuff_table(), found & np.uint16(0xFF00) | part)
        count = count + found
    return count.astype(np.uint8)


@cache
def _crc_tables() -> Halves:
    """Return the checksum that a byte makes by its bits, with so many bytes of zeros behind it: [zeros, byte]."""
    one = np.uint16(1)
    crc: Halves = np.arange(256, dtype=np.uint16) << np.uint16(7)
    tables = []
    for _ in range(_MOST_PARTS):
        for _ in range(8):
            divided = (crc >> np.uint16(14) & one) * np.uint16(CRC15)
            crc = np.bitwise_xor(crc << one, divided) & np.uint16(0x7FFF)
        tables.append(crc)
    return np.array(tables)


@cache
def _stuff_table() -> Halves:
    """Return by state and byte the next state above, the stuff bits below. State: the last bit, how many are alike."""
    number = np.arange(16 << 8)
    last, alike = number >> 11, number >> 8 & 7
    count = np.zeros_like(number)
    for shift in range(7, -1, -1):
        bit = number >> shift & 1
        alike = alike * (bit == last) + 1
        stuff = (alike == 5).astype(np.int64)
        count += stuff
        last = bit ^ stuff
        alike -= 4 * stuff  # the stuff bit begins a run of its own
    return ((last << 3 | alike & 7) << 8 | count).astype(np.uint16)
