"""The ground-truth side channel between processes."""

from __future__ import annotations

import socket

import pytest
from msgspec.structs import replace

from fsai_hil.simulator.ground_truth import Truth, TruthReceiver, TruthSender, pack, unpack

TRUTH = Truth(123, 1.0, -2.5, 0.25, 3.0, 0.1, -4.0, "AS_DRIVING", "trackdrive", "/some/track.csv", 7, 2)


@pytest.mark.parametrize(
    "datagram",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b"{}",
        pack(TRUTH).replace(b"3.0", b"NaN"),
        pack(TRUTH).replace(b"7", b'"7"'),
        b"x" * 3000,
    ],
)
def test_anything_else_is_refused_in_one_line(datagram: bytes) -> None:
    with pytest.raises(ValueError, match="not a ground-truth datagram") as caught:
        unpack(datagram)
    assert "\n" not in str(caught.value)


def test_the_newest_truth_wins_malformed_ones_are_skipped() -> None:
    with TruthReceiver(0) as receiver, TruthSender(receiver.port) as sender:
        assert receiver.latest() is None
        sender.send(TRUTH)
        sender.send(replace(TRUTH, t_ns=124))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"hello", ("127.0.0.1", receiver.port))
        assert receiver.latest() == replace(TRUTH, t_ns=124)


def test_a_taken_port_is_an_error_and_an_absent_receiver_is_none() -> None:
    with TruthReceiver(0) as receiver, pytest.raises(OSError, match="in use"):
        TruthReceiver(receiver.port)
    with TruthSender(receiver.port) as sender:
        for _ in range(20):
            sender.send(TRUTH)
