"""How long frames are on the wire: exact for classic CAN, with every stuff bit, as the CRC and the data make them.

A classic frame is SOF, arbitration, control, data and CRC, all of it stuffed (after five bits alike comes one of the
other kind), then CRC delimiter, acknowledge, its delimiter, seven bits of end and three of intermission (ISO 11898-1).
CRC and stuffing go byte by byte through tables, all frames at once.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, FD, REMOTE, Frames, Ints

CRC15: Final = 0x4599
_UNSTUFFED_BITS: Final = 1 + 1 + 1 + 7 + 3  # behind the CRC
_CRC_BITS: Final = 15
_AT_ONCE: Final = 1 << 15  # frames: what fits a processor's cache is done fastest

# Where stuffing stands: the last bit and how many alike came, 1 to 4 (at five the stuff bit itself comes, and is one).
_RUNS: Final = 4


def _state(bit: int, run: int) -> int:
    return bit * _RUNS + run - 1


def _stuff(state: int, bits: int, count: int) -> tuple[int, int]:
    """Feed the `count` lowest of `bits`, the highest first: (state, stuff bits added)."""
    last, run = divmod(state, _RUNS)
    run += 1
    stuffed = 0
    for place in range(count - 1, -1, -1):
        bit = bits >> place & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            last, run = 1 - bit, 1
    return _state(last, run), stuffed


def _crc(crc: int, bits: int, count: int) -> int:
    for place in range(count - 1, -1, -1):
        top = crc >> 14 & 1
        crc = crc << 1 & 0x7FFF
        if top ^ (bits >> place & 1):
            crc ^= CRC15
    return crc


def _stuff_table(count: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """For state * 2**count + bits: the state afterwards, and the stuff bits."""
    pairs = [_stuff(state, bits, count) for state in range(2 * _RUNS) for bits in range(1 << count)]
    return np.array([p[0] for p in pairs], np.uint8), np.array([p[1] for p in pairs], np.uint8)


_BYTE_STATE, _BYTE_STUFFED = _stuff_table(8)
_SEVEN_STATE, _SEVEN_STUFFED = _stuff_table(7)
_CRC_TABLE: Final = np.array([_crc(0, byte, 8) for byte in range(256)], np.uint16)


def _header(can_id: int, length: int, *, extended: bool, remote: bool) -> tuple[int, int]:
    """(bits, how many) from SOF to the DLC."""
    if extended:
        first = can_id >> 18 << 2 | 0b11  # 11 bits of the id, SRR, IDE
        return (first << 18 | can_id & 0x3FFFF) << 7 | remote << 6 | min(length, 8), 1 + 31 + 7
    return can_id << 7 | remote << 6 | min(length, 8), 1 + 11 + 7


def wire_bits(frames: Frames) -> Ints:
    """Bits of each frame including intermission; 0 for error frames, which tell nothing of their length.

    FD frames are estimated, without a faster data phase and with a tenth of stuff bits.
    """
    bits = np.zeros(len(frames), np.int64)
    every = np.flatnonzero((frames.flags & (ERROR | FD)) == 0)
    for begin in range(0, len(every), _AT_ONCE):
        classic = every[begin : begin + _AT_ONCE]
        bits[classic] = _classic_bits(frames.only(classic))
    for row in np.flatnonzero((frames.flags & FD) != 0).tolist():
        length = int(frames.length[row])
        arbitration = 32 if frames.flags[row] & EXTENDED else 12
        crc = 17 if length <= 16 else 21
        bits[row] = round((arbitration + 9 + 8 * length) * 1.1) + 4 + crc + crc // 4 + 1 + _UNSTUFFED_BITS
    return bits


def _classic_bits(frames: Frames) -> Ints:
    kind = frames.flags & np.uint8(EXTENDED | REMOTE)
    keys = frames.can_id.astype(np.int64) << 16 | frames.length.astype(np.int64) << 8 | kind
    distinct, where = np.unique(keys, return_inverse=True)
    begun = [_begin(int(key)) for key in distinct.tolist()]
    columns = np.array(begun, np.int64).reshape(-1, 4)[where]
    crc, state = columns[:, 0].astype(np.uint16), columns[:, 1].astype(np.uint16)
    bits = columns[:, 2].copy()
    data_bytes = columns[:, 3]
    data = frames.data
    for place in range(int(data_bytes.max(initial=0))):
        byte = data[:, place].astype(np.uint16)
        there = data_bytes > place
        index = (crc >> np.uint16(7)) ^ byte
        after = ((crc << np.uint16(8)) & np.uint16(0x7FFF)) ^ _CRC_TABLE[index]
        crc = np.where(there, after, crc)
        at = (state << np.uint16(8)) | byte
        bits += np.where(there, _BYTE_STUFFED[at] + 8, 0)
        state = np.where(there, _BYTE_STATE[at], state).astype(np.uint16)
    at = (state << np.uint16(7)) | (crc >> np.uint16(8))
    bits += _SEVEN_STUFFED[at]
    at = (_SEVEN_STATE[at].astype(np.uint16) << np.uint16(8)) | (crc & np.uint16(0xFF))
    bits += _BYTE_STUFFED[at]
    return bits + _CRC_BITS + _UNSTUFFED_BITS


def _begin(key: int) -> tuple[int, int, int, int]:
    """(CRC, state of stuffing, bits so far, data bytes that follow) behind the header of a frame."""
    can_id, length, kind = key >> 16, key >> 8 & 0xFF, key & 0xFF
    remote = bool(kind & REMOTE)
    header, count = _header(can_id, length, extended=bool(kind & EXTENDED), remote=remote)
    # The first bit is dominant after an idle, recessive bus: it begins a run of its own.
    state, stuffed = _stuff(_state(0, 1), header, count - 1)
    return _crc(0, header, count), state, count + stuffed, 0 if remote else min(length, 8)
