"""A replay sends what may be sent, when it is due, and nothing else."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of
from fsai_vcu.diagnostics.transmit.replaying import LAP_GAP_NS, Player, choose, is_physical
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, RESERVED_IDS
from fsai_vcu.interface.units import MS

WALL_NS = 1_700_000_000_000_000_000


class Clock:
    """Sleeps take a little longer than asked, sending takes its time, and the clock began somewhere."""

    def __init__(self, oversleep_ns: int = 300_000) -> None:
        self.now_ns = 77_000_000_000
        self.sent: list[tuple[int, Frame]] = []
        self.full = 0
        self._oversleep_ns = oversleep_ns

    def clock(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.now_ns += round(seconds * 1e9) + self._oversleep_ns

    def send(self, frame: Frame) -> bool:
        self.now_ns += 20_000
        if self.full:
            self.full -= 1
            return False
        self.sent.append((self.now_ns, frame))
        return True


def every_10_ms(count: int, can_id: int = 0x520) -> list[LogFrame]:
    return [LogFrame(WALL_NS + n * 10 * MS, "can0", can_id, bytes([n & 0xFF])) for n in range(count)]


def play(clock: Clock, records: list[LogFrame], **how: Any) -> Player:
    player = Player(frames_of(records), clock.send, clock.clock, clock.sleep, **how)
    for _ in player.play():
        pass
    return player


@pytest.mark.parametrize("rate", [1.0, 0.5, 4.0])
def test_each_frame_leaves_when_due_and_lateness_never_adds_up(rate: float) -> None:
    clock = Clock()
    began_ns = clock.now_ns
    player = play(clock, every_10_ms(1000), rate=rate)
    for number, (at_ns, frame) in enumerate(clock.sent):
        late_ns = at_ns - began_ns - number * 10 * MS / rate
        assert 0 <= late_ns <= 320_001 and frame.data == bytes([number & 0xFF])
    assert player.sent == 1000 and player.late_max_ns <= 320_001


def test_laps_follow_each_other_at_the_buss_pace() -> None:
    clock = Clock(0)
    began_ns = clock.now_ns
    player = play(clock, every_10_ms(5), laps=3)
    assert player.laps == 3
    lap_ns = 40 * MS + LAP_GAP_NS
    dues = [began_ns + lap * lap_ns + n * 10 * MS for lap in range(3) for n in range(5)]
    assert [at_ns - 20_000 for at_ns, _ in clock.sent] == dues


def test_a_loop_without_end_goes_on_until_it_is_stopped() -> None:
    clock = Clock()
    player = Player(frames_of(every_10_ms(3)), clock.send, clock.clock, clock.sleep, laps=None)
    for _ in player.play():
        if player.sent == 100:
            break
    assert len(clock.sent) == 100


def test_a_full_queue_is_tried_again_and_given_up_after_a_second() -> None:
    clock = Clock(0)
    clock.full = 10
    player = play(clock, every_10_ms(3))
    assert (player.sent, player.refused) == (3, 0)
    clock.full = 2000
    player = play(clock, every_10_ms(1))
    assert (player.sent, player.refused) == (0, 1)


def test_remote_and_extended_frames_are_sent_as_what_they_are() -> None:
    clock = Clock()
    play(
        clock,
        [
            LogFrame(1, "can0", 0x523, b"", remote=True, length=6),
            LogFrame(2, "can0", 0x18FF0001, b"\x7f", extended=True),
        ],
    )
    assert [(f.can_id, f.data, f.extended, f.remote) for _, f in clock.sent] == [
        (0x523, b"", False, True),
        (0x18FF0001, b"\x7f", True, False),
    ]


# ---------------------------------------------------------------- what is sent at all


def test_reserved_ids_go_to_no_car_ai_ids_only_on_demand() -> None:
    ids = [*range(0x800)]
    frames = frames_of([LogFrame(WALL_NS + n, "can0", can_id) for n, can_id in enumerate(ids)])
    sent, left_out = choose(frames, with_ai_ids=False, physical=True)
    assert set(sent.can_id.tolist()) == set(ids) - RESERVED_IDS - set(AI_IDS)
    ours = "5 frames of 0x510 to 0x514, the AI computer's own (--with-ai-ids: send them too)"
    assert left_out == f"{len(RESERVED_IDS)} frames of reserved ids, {ours}"
    sent, left_out = choose(frames, with_ai_ids=True, physical=True)
    assert set(sent.can_id.tolist()) == set(ids) - RESERVED_IDS
    assert left_out == f"{len(RESERVED_IDS)} frames of reserved ids"
    sent, left_out = choose(frames, with_ai_ids=False, physical=False)
    assert set(sent.can_id.tolist()) == set(ids) - set(AI_IDS), "a virtual bus gets the sensors' too"


def test_a_reserved_number_is_not_sent_as_a_29_bit_one_either() -> None:
    frames = frames_of([LogFrame(1, "can0", 0x080, extended=True), LogFrame(2, "can0", 0x510, extended=True)])
    assert choose(frames, with_ai_ids=False, physical=True)[0].can_id.tolist() == [0x510]


def test_what_cannot_be_sent_is_left_out_and_reported() -> None:
    frames = frames_of(
        [
            LogFrame(1, "can0", 0x40, bytes(8), error=True),
            LogFrame(2, "can0", 0x1F0, bytes(12), fd=True),
            LogFrame(3, "can0", 0x1F0, bytes(8)),
        ]
    )
    sent, left_out = choose(frames, with_ai_ids=False, physical=True)
    assert left_out == "1 error frames, 1 CAN FD frames"
    assert len(sent) == 1


def test_frames_are_sent_in_order_of_time() -> None:
    frames = frames_of([LogFrame(t, "can0", 0x520) for t in (30, 10, 20)])
    assert np.array_equal(choose(frames, with_ai_ids=False, physical=True)[0].t_ns, [10, 20, 30])


# ---------------------------------------------------------------- where to


def link(kind: str | None) -> str:
    return json.dumps([{"ifname": "x", "linkinfo": {"info_kind": kind}} if kind else {"ifname": "x"}])


@pytest.mark.parametrize(
    ("spec", "answer", "physical"),
    [
        ("vcan0", link("vcan"), False),
        ("vx0", link("vxcan"), False),
        ("can0", link("can"), True),
        ("vcan0", link("can"), True),  # a name tells nothing
        ("slcan0", link(None), True),
        ("gone0", "", True),
        ("loopback:bench", "", False),
        ("virtual:bench", "", False),
        ("slcan:/dev/ttyUSB0", "", True),
        ("pcan:PCAN_USBBUS1", "", True),
    ],
)
def test_a_bus_is_physical_unless_it_is_known_not_to_be(
    spec: str, answer: str, physical: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(argv: list[str], **_: Any) -> Any:
        if not answer:
            raise subprocess.CalledProcessError(1, argv)
        return subprocess.CompletedProcess(argv, 0, stdout=answer.encode())

    monkeypatch.setattr(subprocess, "run", run)
    assert is_physical(spec) is physical


def test_without_ip_every_socketcan_interface_counts_as_physical(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert is_physical("vcan0")
