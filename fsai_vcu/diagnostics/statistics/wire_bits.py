"""How long frames are on the wire: exact for classic CAN, with every stuff bit, as the CRC and the data make them.

A classic frame is SOF, arbitration, control, data and CRC, all of it stuffed (after five bits alike comes one of the
other kind), then CRC delimiter, acknowledge, its delimiter, seven bits of end and three of intermission (ISO 11898-1).
CRC and stuffing go bit by bit, all frames of one length at once.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.frames import CLASSIC_BYTES, ERROR, EXTENDED, FD, REMOTE, Frames, Ints

CRC15: Final = 0x4599
_UNSTUFFED_BITS: Final = 1 + 1 + 1 + 7 + 3  # behind the CRC
_CRC_BITS: Final = 15
_AT_ONCE: Final = 1 << 15  # frames: what fits a processor's cache is done fastest

Bits = npt.NDArray[np.uint8]  # [place, frame]


def wire_bits(frames: Frames) -> Ints:
    """Bits of each frame including intermission; 0 for error frames, which tell nothing of their length.

    FD frames are estimated, without a faster data phase and with a tenth of stuff bits.
    """
    bits = np.zeros(len(frames), np.int64)
    kinds = (frames.flags & np.uint8(EXTENDED | REMOTE | ERROR | FD)).astype(np.int64) << 8 | frames.length
    for kind in np.flatnonzero(np.bincount(kinds)).tolist():
        rows = np.flatnonzero(kinds == kind)
        flags, length = divmod(kind, 1 << 8)
        if flags & FD and not flags & ERROR:
            crc = 17 if length <= 16 else 21
            head = (32 if flags & EXTENDED else 12) + 9
            bits[rows] = round((head + 8 * length) * 1.1) + 4 + crc + crc // 4 + 1 + _UNSTUFFED_BITS
        elif not flags & ERROR:
            for part in np.split(rows, range(_AT_ONCE, len(rows), _AT_ONCE)):
                data = frames.word[part].astype("<u8").view(np.uint8).reshape(-1, CLASSIC_BYTES)
                bits[part] = _classic_bits(frames.can_id[part].astype(np.int64), data, flags, length)
    return bits


def _classic_bits(can_id: Ints, data: Bits, flags: int, length: int) -> Ints:
    """`can_id` [n] and `data` [n, 8] of frames that have the flags and the length in common."""
    control = (1 << 6 if flags & REMOTE else 0) | min(length, CLASSIC_BYTES)
    if flags & EXTENDED:
        arbitration = (can_id >> 18 << 2 | 0b11) << 18 | can_id & 0x3FFFF  # 11 bits of the id, SRR, IDE, 18 of the id
        header = _bits_of(arbitration << 7 | control, 1 + 31 + 7)
    else:
        header = _bits_of(can_id << 7 | control, 1 + 11 + 7)
    payload = data[:, : 0 if flags & REMOTE else length]
    stuffed = np.concatenate((header, np.unpackbits(payload, axis=1).T))
    stuffed = np.concatenate((stuffed, _bits_of(_crc(stuffed), _CRC_BITS)))
    return len(stuffed) + _stuff_bits(stuffed) + _UNSTUFFED_BITS


def _bits_of(numbers: npt.NDArray[np.integer], count: int) -> Bits:
    """The `count` lowest bits of each number, the highest first."""
    return (numbers >> np.arange(count, dtype=numbers.dtype)[::-1, None] & 1).astype(np.uint8)


def _crc(bits: Bits) -> npt.NDArray[np.uint16]:
    crc = np.zeros(bits.shape[1], np.uint16)
    for bit in bits:
        crc = crc << 1 ^ ((crc >> 14 ^ bit) & 1) * np.uint16(CRC15)
    return crc


def _stuff_bits(bits: Bits) -> Ints:
    count = np.zeros(bits.shape[1], np.int64)
    last, alike = np.ones_like(bits[0]), np.zeros_like(bits[0])  # an idle bus is 1
    for bit in bits:
        alike = alike * (bit == last) + np.uint8(1)
        stuff = (alike == 5).view(np.uint8)
        count += stuff
        last = bit ^ stuff
        alike -= 4 * stuff  # the stuff bit begins a run of its own
    return count
