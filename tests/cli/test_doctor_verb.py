"""The doctor: judgement over snapshots of machines, and the verb on this machine."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.doctor.checks import Finding, examine
from fsai_vcu.diagnostics.doctor.collect import kernel_has
from fsai_vcu.diagnostics.doctor.machine import BusTraffic, Link, Machine, Ros, Scheduling, Wanted
from fsai_vcu.diagnostics.doctor.wheels import Four, Turn, WheelWiringCheck
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import VcuStatus, WheelCounts, WheelSpeeds
from fsai_vcu.interface.revisions import revision

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
BUS = BusTraffic(
    2.0,
    frames=3000,
    from_car=True,
    from_others=True,
    revision="2026",
    revision_why="0x520 carries OP_STATE",
    pulses=(0, 0, 0, 0),
    speed_max_rpm=(0, 0, 0, 0),
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
    return [finding for finding in examine(machine) if finding.severity == "problem"]


def test_a_healthy_machine_has_no_finding_and_fits_one_screen() -> None:
    findings = examine(WELL)
    assert wrong(WELL) == []
    assert len(findings) <= 24, "one screen"
    topics = (
        "configuration, limits, interface, bitrate, queue, driver, bus, revision, wheels, ROS 2, DDS, services, "
        "scheduling, memory, clock, disk, permissions, system"
    )
    assert list(dict.fromkeys(finding.kind for finding in findings)) == topics.split(", ")


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
        (replace(WELL, link=replace(LINK, restart_ms=0), services=BRIDGE), "driver", "no service does it"),
        (replace(WELL, link=replace(LINK, driver="gs_usb"), services=BRIDGE), "driver", "gs_usb does not start again"),
        (replace(WELL, bus=replace(BUS, frames=0)), "bus", "silent for 2 s"),
        (replace(WELL, bus=replace(BUS, from_car=False)), "bus", "none of the VCU's status"),
        (replace(WELL, bus=replace(BUS, error_frames=4)), "bus", "4 error frames"),
        (replace(WELL, bus=BusTraffic(2.0, problem="no CAN interface 'can0'")), "bus", "no CAN interface"),
        (replace(WELL, bus=replace(BUS, revision="2021")), "revision", "the bus has 2021"),
        (replace(WELL, bus=replace(BUS, pulses=None)), "wheels", "no pulses (0x526)"),
        (replace(WELL, bus=replace(BUS, pulses=(9, 0, 0, 0))), "wheels", "do not agree"),
        (replace(WELL, ros=Ros()), "ROS 2", "rclpy is not in this"),
        (replace(WELL, ros=replace(WELL.ros, messages=False)), "ROS 2", "fsai_msgs not installed"),
        (replace(WELL, listening=("0.0.0.0",)), "DDS", "listens on 0.0.0.0"),
        (replace(WELL, wanted=replace(WANTED, discovery="subnet")), "DDS", "anyone there can drive the car"),
        (replace(WELL, services={**BRIDGE, "fsai-planner.service": "failed"}), "services", "planner is failed"),
        (replace(WELL, wanted=CAN1, link=replace(LINK, name="can1")), "services", "bridge@can0 is enabled, while"),
        (replace(WELL, services={"fsai-planner.service": "active"}), "services", "no bridge is enabled, while"),
        (replace(WELL, services={}), "services", "no bridge is enabled, while"),
        (replace(WELL, starts_at_boot=False, services={}), "services", "no service starts at boot"),
        (replace(WELL, starts_at_boot=False), "services", "bridge@can0 starts whenever its adapter is there"),
        (replace(WELL, scheduling=Scheduling("SCHED_OTHER", 0, True)), "scheduling", "SCHED_OTHER"),
        (replace(WELL, scheduling=Scheduling("SCHED_FIFO", 45, False)), "memory", "not locked"),
        (replace(WELL, rt_runtime_us=0), "scheduling", "does not let real-time threads run"),
        (replace(WELL, clock_year=1970), "clock", "the year 1970"),
        (replace(WELL, disk_free_mib=3), "disk", "3 MiB free"),
        (replace(WELL, folder_problem="x belongs to root"), "disk", "belongs to root"),
        (replace(WELL, bus=replace(BUS, from_ai=True, from_others=False)), "bus", "only this computer's"),
        (replace(WELL, changed_since_start=(WANTED.path,)), "configuration", "changed after the start of the bridge"),
        (replace(WELL, changed_since_start=(WANTED.limits_path,)), "limits", "changed after the start of the bridge"),
        (replace(WELL, ros=replace(WELL.ros, implementation="rmw_cyclonedds_cpp")), "DDS", "runs on rmw_cyclonedds"),
        (replace(WELL, file_problems=((WANTED.path, "cannot be read"),)), "permissions", "cannot be read"),
    ],
)
def test_what_is_wrong_is_reported_under_its_topic_with_a_remedy(machine: Machine, topic: str, words: str) -> None:
    found = wrong(machine)
    assert [finding.kind for finding in found] == [topic]
    assert words in found[0].words
    assert found[0].remedy, "a wrong finding has a remedy"


BENCH = replace(
    WELL,
    wanted=replace(WANTED, interface="vcan0", limits_path=""),
    link=Link("vcan0", "vcan", True, 10),
    services={},
    starts_at_boot=None,
    scheduling=None,
    clock_synchronised=None,
    disk_free_mib=None,
)


@pytest.mark.parametrize(
    "machine",
    [
        BENCH,
        replace(WELL, wanted=replace(WANTED, interface="loopback:x", configured_interface="loopback:x"), link=None),
        replace(WELL, wanted=replace(WANTED, interface="can1"), link=replace(LINK, name="can1")),
    ],
    ids=["a bench without hardware", "a configured stand-in", "a bus given with -i"],
)
def test_a_bus_without_hardware_or_services_is_nothing_wrong(machine: Machine) -> None:
    assert wrong(machine) == []


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
    assert any("sudo /usr/lib/fsai/settle " in finding.remedy for finding in wrong(machine))


LEFT = ("/dev/shm/fastrtps_0a", "/dev/shm/fastrtps_0a_el")


@pytest.mark.parametrize(
    ("machine", "topic", "level", "words"),
    [
        (
            replace(WELL, link=replace(LINK, driver="gs_usb")),
            "driver",
            "right",
            "gs_usb; after bus-off fsai-link@can0 starts it again",
        ),
        (replace(WELL, link=replace(LINK, state="ERROR-PASSIVE")), "interface", "note", "nothing acknowledges"),
        (replace(WELL, listening=None), "DDS", "note", "not looked at: run with sudo"),
        (replace(WELL, ros=replace(WELL.ros, implementation=None)), "DDS", "note", "not looked at: run with sudo"),
        (replace(WELL, dds_leftovers=LEFT), "DDS", "note", "2 files in /dev/shm of ROS programs that were killed"),
        (replace(WELL, ros=replace(WELL.ros, distribution="humble")), "ROS 2", "right", "humble"),
        (replace(WELL, ros=replace(WELL.ros, distribution="lunar")), "ROS 2", "note", "lunar, which was never"),
        (replace(WELL, ros=replace(WELL.ros, unused="/opt/ros/jazzy")), "ROS 2", "note", "/opt/ros/jazzy is there too"),
        (replace(WELL, ros=Ros("/opt/fsai", "", True, True)), "ROS 2", "right", "from the package index, /opt/fsai"),
        (
            replace(WELL, bus=replace(BUS, pulses=(20, 0, 0, 0), speed_max_rpm=(31, 0, 0, 0))),
            "wheels",
            "right",
            "front left 20 pulses, 31 rpm",
        ),
    ],
)
def test_a_healthy_machine_with_one_peculiarity(machine: Machine, topic: str, level: str, words: str) -> None:
    assert wrong(machine) == []
    (found,) = [finding for finding in examine(machine) if finding.kind == topic and words in finding.words]
    assert found.severity == level
    assert found.remedy == ("sudo rm -f /dev/shm/fastrtps_0a /dev/shm/fastrtps_0a_el" if machine.dds_leftovers else "")


# ---------------------------------------------------------------- the commissioning check

STEP_NS = 10_000_000


def turned(check: WheelWiringCheck, signal: int, pulses: int, t_ns: int, counts: list[int]) -> Turn | None:
    """One wheel is turned by hand: its signal counts `pulses`, then all is still for two seconds."""
    found = None
    for step in range(pulses + 200):
        t_ns += STEP_NS
        if step < pulses:
            counts[signal] = (counts[signal] + 1) % 65536
            check.on_speeds(tuple(30 if index == signal else 0 for index in range(4)))
        found = check.on_counts(tuple(counts), t_ns) or found
    return found


@pytest.mark.parametrize(
    ("pulses", "speeds", "words"),
    [
        ((20, 20, 0, 0), (30, 30, 0, 0), "more than one signal counted (fl 20, fr 20)"),
        ((20, 0, 0, 0), (0, 0, 0, 0), "pulses come (20), but no speed"),
        ((20, 0, 0, 0), (0, 30, 0, 0), "the pulses are those of fl, the speed is that of fr"),
        ((36, 0, 0, 0), (30, 0, 0, 0), "36 pulses for one turn instead of 20"),
    ],
)
def test_what_is_wrong_with_a_wheel_is_reported(pulses: Four, speeds: Four, words: str) -> None:
    assert words in str(Turn("fl", pulses, speeds).problem(20))


def test_a_nudged_wheel_is_no_turn_two_on_one_signal_no_wiring() -> None:
    check, counts = WheelWiringCheck(), [0, 0, 0, 0]
    check.on_counts((0, 0, 0, 0), 0)
    assert turned(check, 0, 3, 0, counts) is None and check.asked == "fl"
    for start in range(1, 5):
        turned(check, 0, 20, start * 10**10, counts)
    assert check.asked is None and check.mapping() is None


# ---------------------------------------------------------------- the verb


BUS_NAME = f"loopback:doctor-{os.getpid()}"
CODEC = Codec(revision("2026"))


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "fsai.toml"
    path.write_text(f'[can]\ninterface = "{BUS_NAME}"\n[car]\nwheel_mapping = {{ fl = "fr", fr = "fl" }}\n')
    return str(path)


def test_the_bus_is_reported_and_the_exit_status_is_the_verdict(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    images = (VcuStatus(as_state=AsState.AS_OFF), WheelSpeeds(0, 0, 0, 0), WheelCounts(9, 0, 0, 0))
    with talking(BUS_NAME, *(CODEC.encode(image) for image in images)):
        status = main(["doctor", "--config", file, "--seconds", "0.3", "--json"])
    report = json.loads(capsys.readouterr().out)
    by_topic = {finding["topic"]: finding for finding in report["findings"]}
    assert by_topic["bus"]["level"] == "right" and "the VCU sends" in by_topic["bus"]["words"]
    assert by_topic["revision"]["level"] == "right"
    assert by_topic["wheels"]["level"] == "note" and "no wheel turns" in by_topic["wheels"]["words"]
    assert status == (1 if report["wrong"] else 0)
    assert report["wrong"] == sum(finding["level"] == "wrong" for finding in report["findings"])


class TurnedWheels:
    """A bus and its clock: the wheels turn 20 pulses each, fl first, and stand for two seconds after it."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._frames = self._turns()

    def _turns(self) -> Iterator[Frame]:
        counts = [65530, 0, 0, 0]
        for wheel in range(4):
            for step in range(220):
                counts[wheel] = (counts[wheel] + (step < 20)) % 65536
                yield CODEC.encode(WheelSpeeds(*(30 * (step < 20 and each == wheel) for each in range(4))))
                yield CODEC.encode(WheelCounts(*counts))

    def recv(self, _timeout_s: float) -> Frame:
        self.now_ns += 5_000_000
        return next(self._frames)


def test_each_wheel_is_asked_for_and_a_wrong_wiring_is_reported(
    file: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = TurnedWheels()
    monkeypatch.setattr("fsai_vcu.cli.doctor.open_bus", lambda *_, **__: nullcontext(bus))
    monkeypatch.setattr(time, "monotonic_ns", lambda: bus.now_ns)
    assert main(["doctor", "--config", file, "--wheels", "--json"]) == 1
    shown = capsys.readouterr()
    report = json.loads(shown.out)
    wiring = "the wiring is fl=fl,fr=fr,rl=rl,rr=rr, the configuration says fl=fr,fr=fl,rl=rl,rr=rr"
    assert report["problems"] == [wiring]
    assert report["todo"] == "[car] without wheel_mapping"
    assert [turn["source"] for turn in report["turns"]] == ["fl", "fr", "rl", "rr"]
    assert [line.split()[2:4] for line in shown.err.splitlines() if line.startswith("turn")] == [
        ["front", "left"], ["front", "right"], ["rear", "left"], ["rear", "right"]
    ]  # fmt: skip


def test_a_missing_configuration_is_reported_the_rest_is_checked(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["doctor", "--config", str(tmp_path / "absent.toml")]) == 1
    shown = capsys.readouterr().out
    assert "WRONG configuration" in shown and "->" in shown and "permissions" in shown
    assert main(["doctor", "--config", str(tmp_path / "absent.toml"), "--wheels"]) == 1
    assert "absent.toml: cannot be read" in capsys.readouterr().err


# ---------------------------------------------------------------- on a laptop

LAPTOP = Machine(car_pc=False, user="ada", ros=WELL.ros)
HEARD = BusTraffic(2.0, frames=90, from_car=True, from_others=True, revision="2026", revision_why="0x300 comes")


@pytest.mark.parametrize(
    ("machine", "topic", "level", "words", "todo"),
    [
        (LAPTOP, "for the car", "note", "no car software", "sudo make install"),
        (LAPTOP, "for the car", "note", "no CAN adapter", "docs/connect.md"),
        (LAPTOP, "bus", "note", "this kernel has no vcan: loopback:NAME", ""),
        (replace(LAPTOP, kernel_has_vcan=True), "bus", "note", "no vcan0 yet", "ip link add dev vcan0 type vcan"),
        (replace(LAPTOP, vcan="vcan0"), "bus", "right", "vcan0 is up", ""),
        (
            replace(LAPTOP, bus=BusTraffic(2.0, problem="no CAN interface 'can0'")),
            "bus",
            "problem",
            "'can0'",
            "put the",
        ),
        (replace(LAPTOP, bus=BusTraffic(2.0)), "bus", "problem", "silent for 2 s", "low voltage"),
        (replace(LAPTOP, bus=HEARD), "bus", "right", "the VCU sends: 90 frames in 2 s", ""),
        (replace(LAPTOP, bus=HEARD), "revision", "right", "2026 (0x300 comes)", ""),
        (replace(LAPTOP, domain_id="7"), "DDS", "right", "domain 7, on the loopback", ""),
        (replace(LAPTOP, domain_id="233"), "DDS", "problem", "ROS_DOMAIN_ID is 233", "up to 101"),
        (replace(LAPTOP, domain_id="lab"), "DDS", "problem", "ROS_DOMAIN_ID is lab", "unset it"),
        (replace(LAPTOP, transport="transport: UDP, on every network"), "DDS", "note", "every network", "unset"),
        (replace(LAPTOP, dds_leftovers=("/dev/shm/fastrtps_1",)), "DDS", "note", "1 file in /dev/shm", "rm -f /dev"),
        (LAPTOP, "scheduling", "note", "ada's programs may not be real-time", "ada - rtprio 60"),
        (replace(LAPTOP, may_be_real_time=True), "scheduling", "right", "may be real-time", ""),
        (replace(LAPTOP, ros=Ros()), "ROS 2", "problem", "rclpy is not", "make setup"),
    ],
)
def test_a_laptop_is_told_what_it_lacks(machine: Machine, topic: str, level: str, words: str, todo: str) -> None:
    found = [each for each in examine(machine) if each.kind == topic and words in each.words]
    assert len(found) == 1 and found[0].severity == level and todo in found[0].remedy


def test_a_laptop_with_an_adapter_lacks_only_the_software() -> None:
    found = [each.words for each in examine(replace(LAPTOP, interfaces=("can0",))) if each.kind == "for the car"]
    assert len(found) == 1 and "software" in found[0]


def test_a_laptop_is_not_asked_for_what_a_car_pc_has(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("USUAL_PATH", "INSTALLED"):
        monkeypatch.setattr(f"fsai_vcu.cli.doctor.{name}", tmp_path / "absent")
    main(["doctor", "--json"])
    topics = [each["topic"] for each in json.loads(capsys.readouterr().out)["findings"]]
    assert topics[-1] == "for the car" and not {"services", "configuration", "permissions", "disk"} & set(topics)
    (tmp_path / "absent").touch()
    main(["doctor", "--json"])
    assert "configuration" in {each["topic"] for each in json.loads(capsys.readouterr().out)["findings"]}


ON_A_LAPTOP = "; it cannot drive the car: the lines 'for the car' say what it lacks"


@pytest.mark.parametrize(
    ("machine", "last"),
    [
        (replace(LAPTOP, may_be_real_time=True), f"this computer can simulate{ON_A_LAPTOP}"),
        (
            replace(LAPTOP, may_be_real_time=True, dds_leftovers=LEFT),
            f"this computer can simulate; 1 to correct (->){ON_A_LAPTOP}",
        ),
        (replace(LAPTOP, ros=Ros(), dds_leftovers=LEFT), f"1 wrong{ON_A_LAPTOP}"),
    ],
)
def test_what_is_to_be_put_in_order_is_not_all_well(
    machine: Machine, last: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("USUAL_PATH", "INSTALLED"):
        monkeypatch.setattr(f"fsai_vcu.cli.doctor.{name}", tmp_path / "absent")
    monkeypatch.setattr("fsai_vcu.cli.doctor.laptop", lambda *_: machine)
    assert main(["doctor"]) == last.startswith("1 wrong")
    assert capsys.readouterr().out.splitlines()[-1] == last


def test_a_kernel_module_is_found_built_in_or_to_load(tmp_path: Path) -> None:
    here = tmp_path / os.uname().release
    here.mkdir()
    assert not kernel_has("vcan", tmp_path)
    for name, line in (("modules.builtin", "kernel/drivers/net/can/vcan.ko"), ("modules.dep", "a/vcan.ko.zst: b.ko")):
        (here / name).write_text(line)
        assert kernel_has("vcan", tmp_path)
        (here / name).unlink()
