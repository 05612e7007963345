"""What the doctor sees of a machine, on machines made of files: /proc, /sys/class/net, what `ip` prints."""

from __future__ import annotations

import ctypes
import fcntl
import grp
import ipaddress
import os
import socket
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from fsai_vcu.diagnostics.doctor import collect
from fsai_vcu.diagnostics.doctor.collect import (
    dds_leftovers,
    distribution_of,
    file_problems,
    link_of,
    listening_addresses,
    listening_on_networks,
)
from fsai_vcu.diagnostics.doctor.machine import Scheduling

# As `ip -details -json link show dev can0` of iproute2 6.1 prints it.
CAN0 = (
    '[{"ifname":"can0","link_type":"can","linkinfo":{"info_kind":"can","info_data":{"state":"ERROR-PASSIVE",'
    '"restart_ms":100,"bittiming":{"bitrate":500000}}}}]'
)


def adapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, details: str) -> None:
    """can0 of this machine."""
    device = tmp_path / "net" / "can0"
    (device / "device").mkdir(parents=True)
    for name, content in (("type", "280"), ("flags", "0x40081"), ("tx_queue_len", "10")):
        (device / name).write_text(content + "\n")
    (tmp_path / "drivers" / "gs_usb").mkdir(parents=True)
    (device / "device" / "driver").symlink_to(tmp_path / "drivers" / "gs_usb")
    monkeypatch.setattr(collect, "_NET", tmp_path / "net")
    tool = tmp_path / "bin" / "ip"
    tool.parent.mkdir()
    tool.write_text(f"#!/bin/sh\ncat <<'OUT'\n{details}\nOUT\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tool.parent}:{os.environ['PATH']}")


def test_an_adapter_has_bitrate_queue_driver_state_and_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    adapter(tmp_path, monkeypatch, CAN0)
    link = link_of("can0")
    assert link is not None
    assert (link.kind, link.up, link.bitrate, link.queue_frames) == ("can", True, 500_000, 10)
    assert (link.driver, link.state, link.restart_ms) == ("gs_usb", "ERROR-PASSIVE", 100)
    assert link_of("can1") is None


def test_without_a_usable_ip_tool_the_kernels_files_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    adapter(tmp_path, monkeypatch, "Object can0 is unknown")
    link = link_of("can0")
    assert link is not None and link.kind == "can" and link.bitrate is None and link.queue_frames == 10


class Proc:
    """A /proc with one process of ours."""

    def __init__(self, folder: Path, module: str = "fsai_nodes.vcu_bridge") -> None:
        self.folder = folder
        self.process = folder / "77"
        (self.process / "fd").mkdir(parents=True)
        (self.process / "cmdline").write_bytes(b"python\0-m\0" + module.encode() + b"\0")
        folder.mkdir(exist_ok=True)

    def opens(self, table: str, local: str, state: str) -> None:
        """Gives the process a socket, and the kernel's table its line (proc(5))."""
        (self.process / "fd" / "4").symlink_to("socket:[4711]")
        (self.process / "net").mkdir()
        (self.process / "net" / table).write_text(
            "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"
            f"   0: {local}:1CF2 00000000:0000 {state} 00000000:00000000 00:00000000 00000000 1000 0 4711 1\n"
            f"   1: 00000000:1CF2 00000000:0000 {state} 00000000:00000000 00:00000000 00000000 1000 0 4712 1\n"
        )


CONNECTED = "01"


# Both machines we run on (amd64, arm64) are little-endian, and the kernel writes 32-bit words.
@pytest.mark.parametrize(
    ("table", "local", "state", "seen"),
    [
        ("udp", "0100007F", "07", ()),
        ("udp", "00000000", "07", ("0.0.0.0",)),
        ("tcp", "0102A8C0", "0A", ("192.168.2.1",)),
        ("tcp", "0102A8C0", CONNECTED, ()),
        ("udp", "0102A8C0", CONNECTED, ()),
        ("udp", "0100FFEF", "07", ()),  # 239.255.0.1
        ("tcp6", "00000000000000000000000000000000", "0A", ("::",)),
        ("tcp6", "00000000000000000000000001000000", "0A", ()),  # ::1
        ("udp6", "000080FE000000000000000001000000", "07", ("fe80::1",)),
        ("tcp6", "0000000000000000FFFF00000102A8C0", "0A", ("192.168.2.1",)),
    ],
)
def test_a_node_that_listens_on_a_network_is_seen_by_the_address(
    tmp_path: Path, table: str, local: str, state: str, seen: tuple[str, ...]
) -> None:
    Proc(tmp_path).opens(table, local, state)
    assert listening_on_networks(tmp_path) == (seen or (None if state == CONNECTED else ()))


def test_a_node_without_read_permission_is_not_called_local_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proc = Proc(tmp_path)
    proc.opens("udp", "00000000", "07")
    (proc.process / "environ").touch()

    def refused(path: Path) -> None:
        raise PermissionError(path)

    monkeypatch.setattr(Path, "iterdir", refused)
    assert listening_on_networks(tmp_path) is None
    # The names of processes are open to everybody.
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: refused(path) if path.name == "environ" else read(path))
    assert collect._implementation(tmp_path) is None


def test_what_others_listen_on_is_not_reported(tmp_path: Path) -> None:
    Proc(tmp_path, module="somebody.else").opens("tcp", "00000000", "0A")
    assert listening_on_networks(tmp_path) == ()


def test_the_kernels_own_tables_are_understood() -> None:
    families = [(socket.AF_INET, "127.0.0.1")]
    if Path("/proc/net/if_inet6").exists():
        families.append((socket.AF_INET6, "::1"))
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
        for family, local in families:
            before = listening_addresses(Path("/proc/self"))
            with socket.socket(family, kind) as opened:
                opened.bind((local, 0))
                if kind == socket.SOCK_STREAM:
                    opened.listen()
                more = Counter(listening_addresses(Path("/proc/self"))) - Counter(before)
            assert more[ipaddress.ip_address(local)] == 1


@pytest.mark.parametrize("fast", ["fastrtps", "fastdds"])
def test_shared_memory_whose_owner_holds_no_lock_is_left_over(tmp_path: Path, fast: str) -> None:
    port_files = (f"{fast}_port7410", f"{fast}_port7410_sl", f"sem.{fast}_port7410_mutex")
    names = (f"{fast}_0a", f"{fast}_0a_el", *port_files)
    for name in (*names, "somebody_elses", f"{fast}_x; reboot #", f"{fast}_$(reboot)", f"sem.{fast}_x\n_mutex"):
        (tmp_path / name).touch()
    with (tmp_path / f"{fast}_0a_el").open() as segment, (tmp_path / f"{fast}_port7410_sl").open() as port:
        fcntl.flock(segment, fcntl.LOCK_EX)
        assert dds_leftovers(folder=tmp_path) == tuple(str(tmp_path / name) for name in port_files)
        fcntl.flock(port, fcntl.LOCK_SH)
        assert dds_leftovers(folder=tmp_path) == ()
    assert dds_leftovers(folder=tmp_path) == tuple(str(tmp_path / name) for name in names)


@pytest.mark.parametrize(
    ("rclpy", "named", "found"),
    [
        ("{ros}/jazzy/lib/python3.12/site-packages/rclpy", "jazzy", ("jazzy", "")),
        ("{ros}/jazzy/lib/python3.12/site-packages/rclpy", "", ("jazzy", "")),
        ("{ros}/humble/lib/python3.10/site-packages/rclpy", "humble", ("humble", "")),
        ("/opt/fsai/lib/python3.12/site-packages/rclpy", "", ("", "{ros}/jazzy")),
        ("/home/team/ros2_ws/install/rclpy", "jazzy", ("jazzy", "")),
        ("", "", ("", "")),
    ],
)
def test_the_ros_distribution_is_that_of_the_imported_rclpy(
    tmp_path: Path, rclpy: str, named: str, found: tuple[str, str]
) -> None:
    for name in ("jazzy", "humble"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "setup.bash").touch()
    distribution, unused = found
    assert distribution_of(rclpy.format(ros=tmp_path), named, tmp_path) == (distribution, unused.format(ros=tmp_path))


@pytest.fixture
def booted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine on which systemd runs and we are installed. What is returned is its /etc/systemd/system."""
    enabled, units = tmp_path / "etc", tmp_path / "lib"
    (enabled / "multi-user.target.wants").mkdir(parents=True)
    units.mkdir()
    (units / "fsai.target").touch()
    monkeypatch.setattr(collect, "_SYSTEMD", tmp_path)
    monkeypatch.setattr(collect, "_ENABLED", enabled)
    monkeypatch.setattr(collect, "_UNITS", units)
    return enabled


def test_what_starts_at_boot_is_what_the_default_target_wants(
    booted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert collect.starts_at_boot() is False
    (booted / "multi-user.target.wants" / "fsai.target").symlink_to("/usr/lib/systemd/system/fsai.target")
    assert collect.starts_at_boot() is True
    (tmp_path / "lib" / "fsai.target").unlink()
    assert collect.starts_at_boot() is None, "not installed"
    (tmp_path / "lib" / "fsai.target").touch()
    monkeypatch.setattr(collect, "_SYSTEMD", tmp_path / "absent")
    assert collect.starts_at_boot() is None, "systemd does not run"


def test_the_services_are_the_enabled_ones_and_the_running_links(booted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    running = {"fsai-bridge@can0.service": "failed", "fsai-link@can1.service": "active"}

    def is_active(*words: str) -> str:
        assert not {"fsai-link@.service", "fsai-link@loopback:x.service"} & set(words), "no unit's name"
        return "\n".join(running.get(name, "inactive") for name in words[2:])

    monkeypatch.setattr(collect, "_output", is_active)
    assert [collect.services(interface) for interface in ("can0", "", "loopback:x")] == [{}, {}, {}]
    assert collect.services("can1") == {"fsai-link@can1.service": "active"}
    (booted / "fsai.target.wants").mkdir()
    (booted / "fsai.target.wants" / "fsai-bridge@can0.service").touch()
    of_can0 = {"fsai-bridge@can0.service": "failed", "fsai-link@can0.service": "inactive"}
    assert collect.services("can0") == of_can0
    assert collect.services("can1") == {**of_can0, "fsai-link@can1.service": "active"}
    monkeypatch.setattr(collect, "_output", lambda *_: "")
    assert collect.services("can0") == dict.fromkeys(of_can0, "unknown"), "systemctl does not answer"


@pytest.mark.parametrize(("most_wrong_us", "kept"), [(0, True), (15_999_999, True), (16_000_000, False)])
def test_a_clock_is_synchronised_where_its_error_is_bounded(
    monkeypatch: pytest.MonkeyPatch, most_wrong_us: int, kept: bool
) -> None:
    class Kernel:
        @staticmethod
        def adjtimex(answer: ctypes.Array[ctypes.c_char]) -> int:
            assert answer.raw[:4] == bytes(4), "nothing is set"
            # modes, offset, freq, maxerror of a 64-bit kernel
            ctypes.memmove(ctypes.addressof(answer) + 24, most_wrong_us.to_bytes(8, "little"), 8)
            return 0

    assert collect._synchronised() in (True, False), "as the kernel answers"
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Kernel)
    assert collect._synchronised() is kept


@pytest.fixture
def own_group(monkeypatch: pytest.MonkeyPatch) -> int:
    """The services' group is one that this user may give files to."""
    number = os.getegid()
    monkeypatch.setattr(collect, "_GROUP", grp.getgrgid(number).gr_name)
    return number


@pytest.mark.usefixtures("own_group")
@pytest.mark.parametrize(
    ("mode", "words"),
    [
        (0o640, ""),
        (0o600, "cannot be read by the services"),
        (0o660, "may be changed by others than root"),
        (0o646, "may be changed by others than root"),
    ],
)
def test_a_configuration_with_wrong_permissions_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, words: str
) -> None:
    file = tmp_path / "fsai.toml"
    file.touch()
    file.chmod(mode)
    problems = file_problems([file, tmp_path / "absent.toml"])
    assert [name for name, _ in problems] == ([str(file)] if words else [])
    assert all(words in problem for _, problem in problems)
    monkeypatch.setattr(collect, "_GROUP", "no-such-group")
    assert file_problems([file]) == (), "where nothing is installed nobody else is to read it"


def test_limits_written_after_the_bridges_start_are_not_in_force(tmp_path: Path) -> None:
    proc = Proc(tmp_path / "proc")
    ticks = os.sysconf("SC_CLK_TCK")
    (proc.folder / "stat").write_text("cpu 1 2 3\nbtime 1000000\n")
    fields = ["S", *["0"] * 18, str(50 * ticks), "0"]
    (proc.process / "stat").write_text(f"77 (a (strange) name) {' '.join(fields)}\n")
    assert collect._bridge_started_s(proc.folder) == pytest.approx(1_000_050.0)
    limits = tmp_path / "limits.toml"
    limits.touch()
    os.utime(limits, (1_000_049, 1_000_049))
    assert not collect._newer(limits, 1_000_050.0)
    os.utime(limits, (1_000_052, 1_000_052))
    assert collect._newer(limits, 1_000_050.0)
    assert not collect._newer(limits, None), "no bridge runs: the next one reads them"
    assert not collect._newer(tmp_path / "absent", 1_000_050.0)


def test_the_bridges_environment_goes_before_the_doctors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_of_the_shell")
    proc = Proc(tmp_path)
    (proc.process / "environ").write_bytes(b"RMW_IMPLEMENTATION=rmw_cyclonedds_cpp\0HOME=/tmp\0")
    assert collect._implementation(tmp_path) == "rmw_cyclonedds_cpp"
    (proc.process / "environ").write_bytes(b"HOME=/tmp\0")
    assert collect._implementation(tmp_path) == ""
    (proc.process / "environ").unlink()
    assert collect._implementation(tmp_path) == "rmw_of_the_shell"


def ending(_folder: Path) -> Iterator[Path]:
    raise ProcessLookupError


@pytest.mark.parametrize(("locked_kib", "locked"), [(0, False), (81920, True)])
def test_the_loops_most_urgent_thread_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, locked_kib: int, locked: bool
) -> None:
    proc = Proc(tmp_path, "fsai_vcu.runtime.loop_process")
    priorities = {78: 0, 79: 45}
    for thread in priorities:
        (proc.process / "task" / str(thread)).mkdir(parents=True)
    (proc.process / "status").write_text(f"Name:\tpython\nVmLck:\t   {locked_kib} kB\n")
    monkeypatch.setattr(os, "sched_getparam", lambda thread: os.sched_param(priorities[thread]))
    monkeypatch.setattr(
        os, "sched_getscheduler", lambda thread: os.SCHED_FIFO if priorities[thread] else os.SCHED_OTHER
    )
    assert collect._scheduling(tmp_path) == Scheduling("SCHED_FIFO", 45, locked)
    assert collect._scheduling(tmp_path / "none") is None, "no loop runs"
    monkeypatch.setattr(Path, "iterdir", ending)
    assert collect._scheduling(tmp_path) is None, "it ends while it is looked at"


def test_a_log_folder_of_another_group_is_named_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collect, "_user", lambda: "somebody")
    owner = grp.getgrgid(tmp_path.stat().st_gid).gr_name
    assert collect._folder_problem(tmp_path) == f"{tmp_path} belongs to the group {owner}, not to fsai"
    monkeypatch.setattr(collect, "_user", lambda: owner)
    assert collect._folder_problem(tmp_path) == ""
