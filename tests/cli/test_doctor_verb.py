"""The doctor: judgement over snapshots of machines, and the verb on this machine."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.doctor.checks import Finding, examine
from fsai_vcu.diagnostics.doctor.machine import BusHeard, Link, Machine, Ros, Scheduling, Wanted
from fsai_vcu.diagnostics.doctor.wheels import Turn, WheelWiringCheck
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.messages import VcuStatus, WheelCounts, WheelSpeeds
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.wheels import WheelMapping
from fsai_vcu.runtime.bus import open_bus

WANTED = Wanted(
    path="/etc/fsai/fsai.toml",
    interface="can0",
    configured_interface="can0",
    revision="2026",
    bitrate=500_000,
    queue_frames=10,
    wheel_mapping="fl=fl,fr=fr,rl=rl,rr=rr",
    limits=("max_speed_mps = 5",),
    limits_path="/etc/fsai/limits.toml",
    environment={"ROS_DOMAIN_ID": "7"},
    discovery="localhost",
    keystore="",
    recording_folder="/var/log/fsai",
    leave_free_mib=2000,
)
LINK = Link("can0", "can", True, 10, 500_000, 100, "ERROR-ACTIVE", "peak_usb")
BUS = BusHeard(
    2.0,
    frames=3000,
    from_car=True,
    from_others=True,
    revision="2026",
    revision_why="0x520 carries OP_STATE",
    speeds_heard=True,
    pulses_heard=True,
)
WELL = Machine(
    wanted=WANTED,
    interfaces=("can0",),
    link=LINK,
    bus=BUS,
    ros=Ros("/opt/ros/jazzy/lib/rclpy", "jazzy", True, True),
    services={"fsai-bridge@can0.service": "active", "fsai-link@can0.service": "active"},
    starts_at_boot=True,
    scheduling=Scheduling("SCHED_FIFO", 45, True),
    rt_runtime_us=-1,
    clock_synchronised=True,
    clock_year=2026,
    disk_free_mib=50_000,
    user="root",
)
BRIDGE = {"fsai-bridge@can0.service": "active"}
CAN1 = replace(WANTED, interface="can1", configured_interface="can1")


def wrong(machine: Machine) -> list[Finding]:
    return [finding for finding in examine(machine) if finding.level == "wrong"]


def test_a_healthy_machine_has_no_finding_and_fits_one_screen() -> None:
    findings = examine(WELL)
    assert wrong(WELL) == []
    assert len(findings) <= 24, "one screen"
    assert {
        "configuration",
        "limits",
        "interface",
        "bitrate",
        "queue",
        "driver",
        "bus",
        "revision",
        "wheels",
        "ROS 2",
        "DDS",
        "services",
        "scheduling",
        "memory",
        "clock",
        "disk",
        "permissions",
        "system",
    } == {finding.topic for finding in findings}


@pytest.mark.parametrize(
    ("machine", "topic", "words"),
    [
        (replace(WELL, wanted=None, configuration_problems=("f.toml, line 3: bad",)), "configuration", "line 3: bad"),
        (replace(WELL, link=None, interfaces=("can1",)), "interface", "no interface can0 (there are: can1)"),
        (replace(WELL, link=replace(LINK, up=False)), "interface", "can0 is down"),
        (replace(WELL, link=replace(LINK, state="BUS-OFF")), "interface", "off the bus"),
        (replace(WELL, link=replace(LINK, kind="ether")), "interface", "no CAN interface but ether"),
        (replace(WELL, link=replace(LINK, bitrate=250_000)), "bitrate", "250000 bit/s instead of 500000"),
        (replace(WELL, link=replace(LINK, queue_frames=1000)), "queue", "1000 frames may wait"),
        (replace(WELL, link=replace(LINK, restart_ms=0), services=BRIDGE), "driver", "nobody does it for it"),
        (replace(WELL, link=replace(LINK, driver="gs_usb"), services=BRIDGE), "driver", "gs_usb does not start again"),
        (replace(WELL, bus=replace(BUS, frames=0)), "bus", "silent for 2 s"),
        (replace(WELL, bus=replace(BUS, from_car=False)), "bus", "none of the VCU's status"),
        (replace(WELL, bus=replace(BUS, error_frames=4)), "bus", "4 error frames"),
        (replace(WELL, bus=BusHeard(2.0, problem="no CAN interface 'can0'")), "bus", "no CAN interface"),
        (replace(WELL, bus=replace(BUS, revision="2021")), "revision", "speaks 2021"),
        (replace(WELL, bus=replace(BUS, pulses_heard=False)), "wheels", "no pulses (0x526)"),
        (replace(WELL, bus=replace(BUS, pulses=(9, 0, 0, 0))), "wheels", "do not agree"),
        (replace(WELL, ros=Ros()), "ROS 2", "rclpy is not in this"),
        (replace(WELL, ros=replace(WELL.ros, distribution="humble")), "ROS 2", "humble"),
        (replace(WELL, ros=replace(WELL.ros, messages=False)), "ROS 2", "fsai_msgs not installed"),
        (replace(WELL, listening=("0.0.0.0",)), "DDS", "listens on 0.0.0.0"),
        (replace(WELL, wanted=replace(WANTED, discovery="subnet")), "DDS", "anybody there can drive the car"),
        (replace(WELL, services={**BRIDGE, "fsai-planner.service": "failed"}), "services", "planner is failed"),
        (replace(WELL, wanted=CAN1, link=replace(LINK, name="can1")), "services", "bridge@can0 is enabled, while"),
        (replace(WELL, services={"fsai-planner.service": "active"}), "services", "no bridge is enabled, while"),
        (replace(WELL, services={}), "services", "no bridge is enabled, while"),
        (replace(WELL, starts_at_boot=False, services={}), "services", "nothing of ours starts at boot"),
        (
            replace(WELL, starts_at_boot=False),
            "services",
            "bridge@can0 starts whenever its adapter is there, and sends",
        ),
        (replace(WELL, scheduling=Scheduling("SCHED_OTHER", 0, True)), "scheduling", "SCHED_OTHER"),
        (replace(WELL, scheduling=Scheduling("SCHED_FIFO", 45, False)), "memory", "not locked"),
        (replace(WELL, rt_runtime_us=0), "scheduling", "no time at all"),
        (replace(WELL, clock_year=1970), "clock", "the year 1970"),
        (replace(WELL, disk_free_mib=3), "disk", "3 MiB free"),
        (replace(WELL, folder_problem="x belongs to root"), "disk", "belongs to root"),
        (
            replace(WELL, bus=replace(BUS, from_car=False, from_ai=True, from_others=False)),
            "bus",
            "only this computer's",
        ),
        (replace(WELL, changed_since_start=(WANTED.path,)), "configuration", "changed after the bridge had started"),
        (replace(WELL, changed_since_start=(WANTED.limits_path,)), "limits", "changed after the bridge had started"),
        (replace(WELL, ros=replace(WELL.ros, implementation="rmw_cyclonedds_cpp")), "DDS", "runs on rmw_cyclonedds"),
        (replace(WELL, file_problems=((WANTED.path, "cannot be read"),)), "permissions", "cannot be read"),
    ],
)
def test_what_is_wrong_is_said_under_its_topic_with_what_to_do(machine: Machine, topic: str, words: str) -> None:
    found = wrong(machine)
    assert [finding.topic for finding in found] == [topic]
    assert words in found[0].words
    assert found[0].todo, "a wrong finding says what to do"


def test_a_bench_without_hardware_or_services_is_nothing_wrong() -> None:
    bench = replace(
        WELL,
        wanted=replace(WANTED, interface="vcan0", limits_path=""),
        link=Link("vcan0", "vcan", True, 10),
        services={},
        starts_at_boot=None,
        scheduling=None,
        clock_synchronised=None,
        disk_free_mib=None,
    )
    assert wrong(bench) == []


@pytest.mark.parametrize(
    "machine",
    [
        replace(WELL, link=None),
        replace(WELL, link=replace(LINK, kind="ether")),
        replace(WELL, wanted=CAN1, link=replace(LINK, name="can1")),
        replace(WELL, starts_at_boot=False),
        replace(WELL, starts_at_boot=False, wanted=None),
    ],
)
def test_advice_on_another_bus_names_the_command_to_move_to_it(machine: Machine) -> None:
    assert any("sudo /usr/lib/fsai/settle " in finding.todo for finding in wrong(machine))


def test_a_configured_stand_in_bus_implies_no_bus_for_services() -> None:
    name = "loopback:rehearsal"
    assert wrong(replace(WELL, wanted=replace(WANTED, interface=name, configured_interface=name), link=None)) == []


def test_a_bus_given_with_i_is_not_expected_of_the_services() -> None:
    asked = replace(WELL, wanted=replace(WANTED, interface="can1"), link=replace(LINK, name="can1"))
    assert wrong(asked) == []


def test_gs_usb_is_restarted_by_its_service_not_by_restart_ms() -> None:
    (said,) = [f for f in examine(replace(WELL, link=replace(LINK, driver="gs_usb"))) if f.topic == "driver"]
    assert said.level == "right" and said.words == "gs_usb; after bus-off fsai-link@can0 starts it again"


def test_a_controller_whom_nobody_answers_is_not_called_right() -> None:
    (said,) = [f for f in examine(replace(WELL, link=replace(LINK, state="ERROR-PASSIVE"))) if f.topic == "interface"]
    assert said.level == "note" and "nobody acknowledges" in said.words


@pytest.mark.parametrize(
    "machine", [replace(WELL, listening=None), replace(WELL, ros=replace(WELL.ros, implementation=None))]
)
def test_what_could_not_be_looked_at_is_not_called_right(machine: Machine) -> None:
    (said,) = [finding for finding in examine(machine) if finding.topic == "DDS"]
    assert said.level == "note" and "not looked at: run with sudo" in said.words


def test_leftovers_of_killed_programs_are_named_with_a_remedy() -> None:
    left = ("/dev/shm/fastrtps_0a", "/dev/shm/fastrtps_0a_el")
    (said,) = [finding for finding in examine(replace(WELL, dds_leftovers=left)) if "killed" in finding.words]
    assert (said.topic, said.level) == ("DDS", "note") and said.words.startswith("2 files in /dev/shm")
    assert said.todo == "sudo rm -f /dev/shm/fastrtps_0a /dev/shm/fastrtps_0a_el"


def test_an_installed_but_unused_ros_distribution_is_mentioned() -> None:
    wheels = replace(WELL, ros=Ros("/opt/fsai/lib/rclpy", "", True, True, unused="/opt/ros/jazzy"))
    assert wrong(wheels) == []
    said = [finding.words for finding in examine(wheels) if finding.topic == "ROS 2"]
    assert said[0] == "from the package index, /opt/fsai/lib/rclpy" and "/opt/ros/jazzy is there too" in said[1]


def test_wheels_that_turn_are_shown_with_their_pulses() -> None:
    turning = replace(WELL, bus=replace(BUS, pulses=(20, 0, 0, 0), speed_max_rpm=(31, 0, 0, 0)))
    (finding,) = [finding for finding in examine(turning) if finding.topic == "wheels"]
    assert finding.level == "right" and finding.words == "front left 20 pulses, 31 rpm"


# ---------------------------------------------------------------- the commissioning check

STEP_NS = 10_000_000
Four = tuple[int, int, int, int]


def turned(check: WheelWiringCheck, signal: int, pulses: int, t_ns: int, counts: list[int]) -> Turn | None:
    """One wheel is turned by hand: its signal counts `pulses`, then all is still for two seconds."""
    found = None
    for step in range(pulses + 200):
        t_ns += STEP_NS
        if step < pulses:
            counts[signal] = (counts[signal] + 1) % 65536
            check.on_speeds(tuple(30 if index == signal else 0 for index in range(4)))  # type: ignore[arg-type]
        found = check.on_counts((counts[0], counts[1], counts[2], counts[3]), t_ns) or found
    return found


def test_wheels_turned_in_turn_tell_the_wiring_across_a_wrap() -> None:
    check, counts = WheelWiringCheck(), [65530, 5, 5, 5]
    asked = []
    for position, signal in enumerate((1, 0, 2, 3)):
        asked.append(check.asked)
        check.on_counts((counts[0], counts[1], counts[2], counts[3]), position * 10**10)
        turn = turned(check, signal, 20, position * 10**10, counts)
        assert turn is not None and turn.counted == 20 and turn.problem(20) is None
    assert asked == ["fl", "fr", "rl", "rr"] and check.asked is None
    assert check.mapping() == WheelMapping(fl="fr", fr="fl")


@pytest.mark.parametrize(
    ("pulses", "speeds", "words"),
    [
        ((20, 20, 0, 0), (30, 30, 0, 0), "more than one signal counted (fl 20, fr 20)"),
        ((20, 0, 0, 0), (0, 0, 0, 0), "pulses come (20), but no speed"),
        ((20, 0, 0, 0), (0, 30, 0, 0), "the pulses are those of fl, the speed is that of fr"),
        ((36, 0, 0, 0), (30, 0, 0, 0), "36 pulses for one turn instead of 20"),
    ],
)
def test_what_is_wrong_with_a_wheel_is_told(pulses: Four, speeds: Four, words: str) -> None:
    assert words in str(Turn("fl", pulses, speeds).problem(20))


def test_a_nudged_wheel_is_no_turn_two_on_one_signal_no_wiring() -> None:
    check, counts = WheelWiringCheck(), [0, 0, 0, 0]
    check.on_counts((0, 0, 0, 0), 0)
    assert turned(check, 0, 3, 0, counts) is None and check.asked == "fl"
    for start in range(1, 5):
        turned(check, 0, 20, start * 10**10, counts)
    assert check.asked is None and check.mapping() is None


# ---------------------------------------------------------------- the verb


class SpeakingCar(threading.Thread):
    """Says 0x520, 0x525 and 0x526 on a stand-in bus; `turn(signal, pulses)` turns a wheel."""

    def __init__(self, bus: str) -> None:
        super().__init__(daemon=True)
        self._bus, self._codec = open_bus(bus), Codec(revision("2026"))
        self._ended = threading.Event()
        self._left = [0, 0, 0, 0]
        self._counts = [65530, 0, 0, 0]

    def turn(self, signal: int, pulses: int) -> None:
        self._left[signal] = pulses

    def run(self) -> None:
        while not self._ended.wait(0.01):
            moving = [bool(left) for left in self._left]
            self._counts = [(count + step) % 65536 for count, step in zip(self._counts, moving, strict=True)]
            self._left = [left - step for left, step in zip(self._left, moving, strict=True)]
            rpm = [30 * step for step in moving]
            for image in (
                VcuStatus(as_state=AsState.AS_OFF),
                WheelSpeeds(rpm[0], rpm[1], rpm[2], rpm[3]),
                WheelCounts(*self._counts),
            ):
                self._bus.send(self._codec.encode(image))
        self._bus.close()

    def end(self) -> None:
        self._ended.set()
        self.join(5.0)


@pytest.fixture
def car(tmp_path: Path) -> Iterator[tuple[SpeakingCar, Path]]:
    bus = f"loopback:doctor-{os.getpid()}"
    file = tmp_path / "fsai.toml"
    file.write_text(f'[can]\ninterface = "{bus}"\n[car]\nwheel_mapping = {{ fl = "fr", fr = "fl" }}\n')
    speaking = SpeakingCar(bus)
    speaking.start()
    yield speaking, file
    speaking.end()


def test_the_bus_is_reported_and_the_exit_status_is_the_verdict(
    car: tuple[SpeakingCar, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    status = main(["doctor", "--config", str(car[1]), "--seconds", "0.3", "--json"])
    said = json.loads(capsys.readouterr().out)
    by_topic = {finding["topic"]: finding for finding in said["findings"]}
    assert by_topic["bus"]["level"] == "right" and "the VCU is heard" in by_topic["bus"]["words"]
    assert by_topic["revision"]["level"] == "right"
    assert by_topic["wheels"]["level"] == "note" and "none turns" in by_topic["wheels"]["words"]
    assert status == (1 if said["wrong"] else 0)
    assert said["wrong"] == sum(finding["level"] == "wrong" for finding in said["findings"])


def test_each_wheel_is_asked_for_and_a_wrong_wiring_is_reported(
    car: tuple[SpeakingCar, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from fsai_vcu.diagnostics.doctor import wheels

    monkeypatch.setattr(wheels, "_STILL_NS", 200_000_000)
    ended = threading.Event()
    signal_of = {"fl": 0, "fr": 1, "rl": 2, "rr": 3}
    hand = threading.Thread(target=lambda: turn_what_is_asked(car[0], signal_of, ended), daemon=True)
    seen: list[WheelWiringCheck] = []
    original: Callable[[WheelWiringCheck], None] = WheelWiringCheck.__init__

    def noted(self: WheelWiringCheck) -> None:
        original(self)
        seen.append(self)

    monkeypatch.setattr(WheelWiringCheck, "__init__", noted)

    def turn_what_is_asked(speaking: SpeakingCar, signals: dict[str, int], done: threading.Event) -> None:
        before: str | None = None
        while not done.wait(0.02):
            asked = seen[0].asked if seen and seen[0]._counts is not None else None
            if asked is not None and asked != before:
                before = asked
                speaking.turn(signals[asked], 20)

    hand.start()
    try:
        status = main(["doctor", "--config", str(car[1]), "--wheels", "--json"])
    finally:
        ended.set()
        hand.join(5.0)
    said = json.loads(capsys.readouterr().out)
    assert status == 1
    assert said["problems"] == ["the wiring is fl=fl,fr=fr,rl=rl,rr=rr, the configuration says fl=fr,fr=fl,rl=rl,rr=rr"]
    assert said["todo"] == "[car] without wheel_mapping"
    assert [turn["source"] for turn in said["turns"]] == ["fl", "fr", "rl", "rr"]


def test_a_missing_configuration_is_reported_the_rest_is_checked(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    before = time.monotonic()
    assert main(["doctor", "--config", str(tmp_path / "absent.toml")]) == 1
    shown = capsys.readouterr().out
    assert "WRONG configuration" in shown and "->" in shown and "permissions" in shown
    assert time.monotonic() - before < 30.0
    assert main(["doctor", "--config", str(tmp_path / "absent.toml"), "--wheels"]) == 1
    assert "absent.toml: cannot be read" in capsys.readouterr().err
