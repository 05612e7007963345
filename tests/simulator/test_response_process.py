"""The simulated car as a process measures response times when it is asked to, and tells its own lateness with them."""

from __future__ import annotations

from test_world_process import FakeBus, made

from fsai_hil.simulator.process import result_of
from fsai_vcu.interface.units import MS


def test_a_measurement_covers_one_mark_to_the_next() -> None:
    vcu = made(FakeBus())
    answered, late = vcu.world.vcu.response_times_ns, vcu.status_late_ns
    answered += [90 * MS]  # before anybody measured
    assert vcu.command("measure idle") == "measuring: idle"
    answered += [1 * MS, 2 * MS]
    late += [3 * MS]
    vcu.held_up_ns += 60 * MS
    assert vcu.command("measure") == "measuring: 2"
    answered += [40 * MS]
    vcu.world.vcu.comms_losses += 1
    idle, second = result_of(vcu)["measurements"]
    assert (idle["name"], idle["response"]["count"], idle["response"]["max_ms"]) == ("idle", 2, 2.0)
    assert (idle["status_late"]["max_ms"], idle["held_up_ms"], idle["comms_losses"]) == (3.0, 60.0, 0)
    assert (second["name"], second["response"]["max_ms"], second["comms_losses"]) == ("2", 40.0, 1)
    assert second["held_up_ms"] == 0.0


def test_each_status_that_was_sent_tells_how_late_it_was() -> None:
    bus = FakeBus()
    vcu = made(bus, "--timeout", "0.6")
    vcu.command("on")
    vcu.loop()
    sent = [frame for frame in bus.sent if frame.can_id == 0x520]
    assert len(sent) > 0
    assert len(vcu.status_late_ns) == len(sent)
    assert min(vcu.status_late_ns) >= 0


def test_nothing_measured_is_no_measurement() -> None:
    assert result_of(made(FakeBus()))["measurements"] == []
