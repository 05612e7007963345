"""The units, judged by systemd itself; and what the car's safety asks of them."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from install_rig import CHECKOUT, UNITS

from fsai_hil.vcan.native import TX_QUEUE_FRAMES
from fsai_vcu.interface.units import S
from fsai_vcu.runtime import turns
from fsai_vcu.runtime.configuration import BITRATE, QUEUE_FRAMES

NODES = ("fsai-detector.service", "fsai-planner.service", "fsai-controller.service")
ON_THE_BUS = ("fsai-bridge@can0.service", "fsai-recorder@can0.service", "fsai-link@can0.service")
BENCH = ("fsai-simulated-car@vcan0.service", "fsai-simulated-sensors.service")
MOST_EXPOSED = 2.0


def analyze(machine: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["systemd-analyze", "--no-pager", f"--root={machine}", *words], capture_output=True, text=True, check=False
    )


def settings(root: Path, unit: str) -> dict[str, list[str]]:
    """Every assignment of a unit and its drop-ins, in order; an empty one resets."""
    template = re.sub(r"@.*\.", "@.", unit)
    files = [root / UNITS / template, root / UNITS / "fsai-.service.d/50-sandbox.conf"]
    files += sorted((root / UNITS / f"{template}.d").glob("*.conf"))
    found: dict[str, list[str]] = {}
    for file in files:
        for line in file.read_text().splitlines():
            name, equals, value = line.partition("=")
            if equals and not line.startswith("#"):
                found[name] = [*found.get(name, []), value] if value else []
    return found


@pytest.mark.parametrize("unit", ["fsai.target", *NODES, *ON_THE_BUS, "fsai-bridge@vcan0.service", *BENCH])
def test_systemd_finds_nothing_wrong_with_a_unit(machine: Path, unit: str) -> None:
    done = analyze(machine, "verify", "--man=no", "--recursive-errors=no", unit)
    ours = [line for line in done.stderr.splitlines() if "fsai" in line]
    assert (done.returncode, ours) == (0, []), done.stderr


@pytest.mark.parametrize("unit", [*NODES, *ON_THE_BUS])
def test_a_service_has_no_more_rights_than_it_needs(machine: Path, unit: str) -> None:
    done = analyze(machine, "security", "--offline=true", f"--threshold={int(MOST_EXPOSED * 10)}", unit)
    exposure = re.search(r"exposure level for .*: ([\d.]+)", done.stdout)
    assert exposure is not None, done.stderr
    assert float(exposure[1]) <= MOST_EXPOSED, done.stdout
    page = (CHECKOUT / "docs" / "security.md").read_text()
    (version,) = re.findall(r"`systemd-analyze security` of systemd (\d+)", page)
    if subprocess.run(["systemd-analyze", "--version"], capture_output=True, text=True).stdout.split()[1] == version:
        assert f"`{unit.replace('@can0', '@')}` {exposure[1]}" in page, "every systemd counts in its own way"
    listed = json.loads(analyze(machine, "security", "--offline=true", "--json=short", unit).stdout)
    user = next(entry for entry in listed if "DynamicUser" in entry["name"])
    assert user["set"] is True, "it runs as root"


@pytest.mark.parametrize(
    ("page", "unit", "line"),
    [
        ("security.md", "fsai-bridge@can0.service", "IPAddressAllow=192.168.1.0/24 multicast"),
        ("car.md", "fsai-recorder@can0.service", "ReadWritePaths=/data"),
    ],
)
def test_systemd_understands_what_a_page_adds_to_a_unit(machine: Path, page: str, unit: str, line: str) -> None:
    assert f"`{line}`" in (CHECKOUT / "docs" / page).read_text()
    override = machine / "etc/systemd/system" / f"{unit}.d" / "override.conf"
    override.parent.mkdir(parents=True)
    override.write_text(f"[Service]\n{line}\n")
    try:
        done = analyze(machine, "verify", "--man=no", "--recursive-errors=no", unit)
        listed = json.loads(analyze(machine, "security", "--offline=true", "--json=short", unit).stdout)
    finally:
        shutil.rmtree(override.parent)
    assert (done.returncode, [each for each in done.stderr.splitlines() if "fsai" in each]) == (0, []), done.stderr
    if page == "security.md":
        (addresses,) = [each["description"] for each in listed if "IPAddressDeny" in each["name"]]
        assert "non-localhost entries" in addresses


def test_the_bridges_readiness_and_watchdog(root: Path) -> None:
    bridge = settings(root, "fsai-bridge@can0.service")
    assert bridge["Type"] == ["notify"]
    watchdog_s = float(bridge["WatchdogSec"][0].removesuffix("s"))
    # While the bus is gone the loop looks for it, and feeds the watchdog, once in its longest pause; it feeds it at the
    # first look after half of the time.
    assert watchdog_s / 2 + turns.REOPEN_MOST_NS / S < watchdog_s
    assert watchdog_s <= 5.0, "the process comes back within seconds"
    assert bridge["WatchdogSignal"] == ["SIGKILL"], "a stopped process takes no other"


def test_the_bridge_has_real_time_scheduling_and_locked_memory(root: Path) -> None:
    bridge = settings(root, "fsai-bridge@can0.service")
    assert bridge["CPUSchedulingPolicy"] == ["fifo"]
    from fsai_vcu.runtime.realtime import FIFO_PRIORITY

    assert int(bridge["LimitRTPRIO"][0]) >= FIFO_PRIORITY >= int(bridge["CPUSchedulingPriority"][0])
    assert bridge["LimitMEMLOCK"] == ["infinity"]
    assert bridge["RestrictRealtime"][-1] == "no"
    assert "@memlock" in bridge["SystemCallFilter"][-1]


@pytest.mark.parametrize("unit", ["fsai-bridge@can0.service", "fsai-recorder@can0.service"])
def test_bus_services_go_and_come_with_the_adapter(root: Path, unit: str) -> None:
    found = settings(root, unit)
    device = "sys-subsystem-net-devices-%i.device"
    assert device in found["BindsTo"][0] and device in found["After"][0]
    assert device in found["WantedBy"][0], "Restart= does not revive what BindsTo= has stopped"
    assert "fsai-link@%i.service" in found["After"][0]


@pytest.mark.parametrize("unit", [*NODES, *ON_THE_BUS])
def test_a_service_is_started_anew_for_ever(root: Path, unit: str) -> None:
    found = settings(root, unit)
    assert found["Restart"] == ["always"]
    assert found["StartLimitIntervalSec"] == ["0"], "five starts in ten seconds would leave the car dead"
    pause = found["RestartSec"][0]
    assert pause in ("200ms", "1s")


@pytest.mark.parametrize("unit", [*NODES, "fsai-bridge@can0.service"])
def test_a_node_communicates_on_this_machine_only(root: Path, unit: str) -> None:
    found = settings(root, unit)
    assert found["IPAddressDeny"] == ["any"] and found["IPAddressAllow"] == ["localhost"]
    families = set(found["RestrictAddressFamilies"][0].split())
    assert families <= {"AF_CAN", "AF_UNIX", "AF_INET", "AF_NETLINK"}
    assert ("AF_CAN" in families) == (unit == "fsai-bridge@can0.service"), "only the bridge talks to the car"


def test_only_one_service_may_change_the_network(root: Path) -> None:
    with_capabilities = {
        path.parent.name for path in (root / UNITS).rglob("*.conf") if "AmbientCapabilities" in path.read_text()
    }
    assert with_capabilities == {"fsai-link@.service.d"}
    assert settings(root, "fsai-link@can0.service")["CapabilityBoundingSet"] == ["CAP_NET_ADMIN"]


def test_bitrate_and_queue_are_the_same_wherever_they_are_set(root: Path) -> None:
    network = (root / "usr/lib/systemd/network/70-fsai-can.network").read_text()
    assert f"BitRate={BITRATE // 1000}K" in network and "RestartSec=100ms" in network
    assert "RequiredForOnline=no" in network
    names = (root / "usr/lib/systemd/network/70-fsai-can.link").read_text()
    assert f"TransmitQueueLength={QUEUE_FRAMES}" in names and "Name=can0" in names
    assert {"peak_usb", "gs_usb"} <= set(re.findall(r"^Driver=(.*)$", names, re.M)[0].split())
    script = (root / "usr/lib/fsai/link").read_text()
    assert re.findall(r"^(BITRATE|QUEUE)=(\d+)", script, re.M) == [
        ("BITRATE", str(BITRATE)),
        ("QUEUE", str(QUEUE_FRAMES)),
    ]
    assert QUEUE_FRAMES == TX_QUEUE_FRAMES


def test_journal_and_logs_are_bounded(root: Path) -> None:
    journal = (root / "usr/lib/systemd/journald.conf.d/50-fsai.conf").read_text()
    assert "SystemMaxUse=500M" in journal and "SystemKeepFree=1G" in journal
    assert "keep_mib" in (root / "etc/fsai/fsai.toml").read_text()


def test_no_unit_names_a_file_that_is_not_installed(root: Path) -> None:
    for unit in (CHECKOUT / "systemd" / "units").glob("*.service"):
        for command in re.findall(r"^Exec\w+=(\S+)", unit.read_text(), re.M):
            assert command.startswith("/opt/fsai/bin/") or (root / command.lstrip("/")).exists(), command
