"""Handshake and loss of communication, as the VCU sees them."""

from __future__ import annotations

import pytest
from vcu_bench import Bench

from fsai_hil.simulator.ai_link import AI_MESSAGES, AiLink
from fsai_hil.simulator.profiles import SPECIFICATION
from fsai_vcu.interface.enums import Ami, AsState, MissionStatus, ShutdownCause
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiBrake, AiDriveFront, AiDriveRear, AiStatus, AiSteer, VcuSystemStatus
from fsai_vcu.interface.units import MS, S

CYCLE_NS = 10 * MS


def talk(link: AiLink, t_ns: int, handshake: bool, leave_out: type | None = None) -> None:
    for image in (AiStatus(handshake=handshake), AiDriveFront(), AiDriveRear(), AiSteer(), AiBrake()):
        if type(image) is not leave_out:
            link.on_image(image, t_ns)


def test_the_handshake_begins_with_1_and_waits_for_the_echo() -> None:
    link = AiLink(SPECIFICATION)
    assert [link.next_bit(n * CYCLE_NS) for n in range(5)] == [True] * 5
    talk(link, 45 * MS, handshake=True)
    assert link.next_bit(50 * MS) is False
    talk(link, 55 * MS, handshake=True)  # still the old bit
    assert link.next_bit(60 * MS) is False
    talk(link, 65 * MS, handshake=False)
    assert link.next_bit(70 * MS) is True


def test_the_response_time_is_toggle_to_echo_once_per_toggle() -> None:
    link = AiLink(SPECIFICATION)
    link.next_bit(0)
    talk(link, 3 * MS, handshake=True)
    talk(link, 8 * MS, handshake=True)
    link.next_bit(10 * MS)
    link.next_bit(20 * MS)
    talk(link, 24 * MS, handshake=False)
    assert link.response_times_ns == [3 * MS, 14 * MS]


def test_an_echo_missing_for_100_ms_but_not_1_ns_less_is_a_loss() -> None:
    link = AiLink(SPECIFICATION)
    for t_ns in range(0, 20 * CYCLE_NS, CYCLE_NS):
        link.next_bit(t_ns)
        talk(link, t_ns + MS, handshake=link.bit)
    toggled_ns = 20 * CYCLE_NS
    wrong = not link.next_bit(toggled_ns)
    for n in range(10):
        talk(link, toggled_ns + n * CYCLE_NS + MS, handshake=wrong)
        link.next_bit(toggled_ns + (n + 1) * CYCLE_NS)
    assert not link.lost(toggled_ns + 100 * MS - 1)
    assert link.lost(toggled_ns + 100 * MS)
    assert link.echo_missing(toggled_ns + 100 * MS)
    assert not any(link.missing(message, toggled_ns + 100 * MS) for message in AI_MESSAGES)


@pytest.mark.parametrize("message", AI_MESSAGES, ids=lambda message: message.__name__)
def test_any_message_missing_ten_times_in_a_row_is_a_loss(message: type) -> None:
    link = AiLink(SPECIFICATION)
    link.next_bit(0)
    talk(link, 0, handshake=True)
    link.next_bit(CYCLE_NS)  # an AiStatus that goes missing takes its echo along, 10 ms later
    for n in range(1, 11):
        talk(link, n * CYCLE_NS, handshake=link.bit, leave_out=message)
        link.next_bit((n + 1) * CYCLE_NS)
    assert not link.lost(100 * MS - 1)
    assert link.lost(100 * MS)
    assert [m for m in AI_MESSAGES if link.missing(m, 100 * MS)] == [message]


@pytest.mark.parametrize(("leave_out", "echoes"), [(AiSteer, True), (None, False)], ids=["message", "echo"])
def test_what_never_came_is_lost_100_ms_after_the_first_ai_data(leave_out: type | None, echoes: bool) -> None:
    """And not before it; a handshake from before has its full timeout, too."""
    link = AiLink(SPECIFICATION)
    link.next_bit(0)
    assert not link.lost(5 * S)
    assert not link.valid(5 * S)
    for n in range(10):
        talk(link, 5 * S + n * CYCLE_NS, handshake=link.bit is echoes, leave_out=leave_out)
        link.next_bit(5 * S + n * CYCLE_NS + MS)
    assert link.valid(5 * S + 50 * MS) is (leave_out is None)
    assert not link.lost(5 * S + 100 * MS - 1)
    assert link.lost(5 * S + 100 * MS)


# ---------------------------------------------------------------- on the VCU


@pytest.mark.parametrize(
    ("loss", "value", "least_ms", "most_ms"), [("silent_ids", {0x513}, 90, 101), ("echoes", False, 100, 112)]
)
def test_a_lost_message_or_echo_in_as_driving_stops_the_car(
    loss: str, value: object, least_ms: int, most_ms: int
) -> None:
    bench = Bench().to_driving()
    bench.run(S)
    setattr(bench, loss, value)
    begun_ns = bench.now_ns
    bench.run_until(lambda: bench.state is AsState.EMERGENCY_BRAKE, 150 * MS)
    assert least_ms * MS <= bench.now_ns - begun_ns <= most_ms * MS
    assert bench.vcu.shutdown_cause is ShutdownCause.AI_COMMS_FAULT
    assert bench.status().faults.ai_comms_lost


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_in_as_off_a_lost_link_is_reported_and_recovers(name: str) -> None:
    """What was received before acknowledges no mission."""
    bench = Bench(name).power_up()
    bench.say(mission_status=MissionStatus.SELECTED)
    bench.run(50 * MS)
    bench.talks = False
    bench.run(150 * MS)
    bench.switches.ami = Ami.SKIDPAD
    bench.run(S)
    assert bench.state is AsState.AS_OFF
    bench.switches.ami = Ami.NOT_SELECTED
    status = bench.status()
    assert status.faults.ai_comms_lost
    assert status.shutdown_cause is ShutdownCause.NO_SHUTDOWN
    bench.talks = True
    bench.run(50 * MS)
    assert not bench.status().faults.ai_comms_lost


def test_messages_of_the_wrong_length_count_as_missing() -> None:
    bench = Bench().to_driving()
    bench.silent_ids = {0x513}
    for _ in range(12):
        bench.run(10 * MS)
        bench.vcu.on_frame(Frame(0x513, bytes(3), bench.now_ns))
    assert bench.state is AsState.EMERGENCY_BRAKE


def test_frames_of_others_are_no_ai_data() -> None:
    bench = Bench()
    bench.talks = False
    bench.switches.aims = bench.switches.asms = bench.switches.tsms = bench.switches.lvms = True
    for _ in range(100):
        bench.run(10 * MS)
        for can_id in (0x501, 0x515, 0x520, 0x600):
            bench.vcu.on_frame(Frame(can_id, bytes(8), bench.now_ns))
        bench.vcu.on_frame(Frame(0x510, bytes(8), bench.now_ns, error=True))
        bench.vcu.on_frame(Frame(0x510, bytes(8), bench.now_ns, extended=True))
    bench.run(10 * S)
    assert not bench.vcu.comms_lost
    assert not bench.vcu.mission_selectable


def test_the_2021_status_message_names_each_timeout() -> None:
    bench = Bench().power_up()
    bench.silent_ids = {0x512, 0x514}
    bench.run(200 * MS)
    del bench.sent[:]
    bench.run(20 * MS)
    system = bench.images(VcuSystemStatus)[-1]
    assert system.drive_rear_timeout and system.brake_timeout and system.warn_ai_comms_lost
    assert not (system.status_timeout or system.drive_front_timeout or system.steer_timeout or system.handshake_timeout)
