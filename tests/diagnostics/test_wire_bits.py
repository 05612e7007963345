"""The length of a frame on the wire is that of the bits which a controller sends, counted one by one."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of
from fsai_vcu.diagnostics.statistics.wire_bits import wire_bits


def bits_sent(frame: LogFrame) -> str:
    """The frame as a controller would send it, before stuffing, up to and with its CRC (ISO 11898-1)."""
    dlc = f"{min(frame.length, 8):04b}"
    rtr = "1" if frame.remote else "0"
    if frame.extended:
        arbitration = f"{frame.can_id >> 18:011b}" + "11" + f"{frame.can_id & 0x3FFFF:018b}" + rtr
        control = "00" + dlc
    else:
        arbitration = f"{frame.can_id:011b}" + rtr
        control = "00" + dlc
    text = "0" + arbitration + control + "".join(f"{byte:08b}" for byte in frame.data)
    remainder = int(text + "0" * 15, 2)
    divisor = 0b1100010110011001  # x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1
    for place in range(len(text) - 1, -1, -1):
        if remainder >> (place + 15) & 1:
            remainder ^= divisor << place
    return text + f"{remainder:015b}"


def stuffed(text: str) -> str:
    out = ""
    for bit in text:
        out += bit
        if len(out) >= 5 and len(set(out[-5:])) == 1:
            out += "1" if bit == "0" else "0"
    return out


def counted(frame: LogFrame) -> int:
    return len(stuffed(bits_sent(frame))) + len("1111111111111")  # delimiter, acknowledge, end, intermission


frames = st.builds(
    lambda extended, remote, can_id, data: LogFrame(
        0,
        "c",
        can_id & (0x1FFF_FFFF if extended else 0x7FF),
        b"" if remote else data,
        extended,
        remote,
        length=len(data),
    ),
    extended=st.booleans(),
    remote=st.booleans(),
    can_id=st.integers(0, 0x1FFF_FFFF) | st.sampled_from([0, 0x1FFF_FFFF, 0x0F83E0F8]),
    data=st.binary(max_size=8) | st.sampled_from([bytes(8), b"\xff" * 8, b"\xf8\x3e\x0f\x83", bytes(5)]),
)


@given(st.lists(frames, min_size=1, max_size=20))
def test_every_frame_is_as_long_as_its_bits_counted_singly(several: list[LogFrame]) -> None:
    assert wire_bits(frames_of(several)).tolist() == [counted(frame) for frame in several]


def test_error_frames_have_no_length_fd_frames_their_bytes() -> None:
    error = LogFrame(0, "c", 0x40, bytes(8), error=True)
    long = LogFrame(0, "c", 0x123, bytes(64), fd=True)
    assert wire_bits(frames_of([error, long])).tolist()[0] == 0
    assert 560 < wire_bits(frames_of([long])).tolist()[0] < 680
