"""Looks at this machine: the only part of the doctor that touches it. It never sends, and changes nothing."""

from __future__ import annotations

import ctypes
import getpass
import grp
import importlib.util
import ipaddress
import json
import os
import platform
import re
import resource
import shutil
import struct
import subprocess
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fsai_vcu.diagnostics.decode.revision import guess_revision
from fsai_vcu.diagnostics.doctor.machine import BusTraffic, Link, Machine, Ros, Scheduling, Wanted
from fsai_vcu.diagnostics.doctor.wheels import Four
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.log.live import LiveSource
from fsai_vcu.files import is_folder
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import WheelCounts, WheelSpeeds
from fsai_vcu.interface.reserved import AI_IDS, STATUS_ID
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.runtime.bus import BusError
from fsai_vcu.runtime.transport import DISTRIBUTIONS, set_transport

_NET = Path("/sys/class/net")
_ARPHRD_CAN = "280"  # linux/if_arp.h
_ANSWER_S = 10.0
_PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
_ENABLED, _UNITS = Path("/etc/systemd/system"), Path("/usr/lib/systemd/system")
_SYSTEMD = Path("/run/systemd/system")  # there while it runs (sd_booted(3))
_POLICIES = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}
_BRIDGE_MODULE = b"fsai_nodes.vcu_bridge"
_LOOP_MODULE = b"fsai_vcu.runtime.loop_process"  # of the CAN loop, which the bridge starts
_NODE_MODULES = b"fsai_nodes."
_GROUP = "fsai"  # of the services' user
_DISTRIBUTIONS = Path("/opt/ros")
_SHARED_MEMORY = Path("/dev/shm")
_OF_FAST_DDS = re.compile(r"(sem\.)?fast(rtps|dds)_\w+", re.ASCII)  # of version 2, as in Jazzy; of 3, as in Kilted
_MODULES = Path("/lib/modules")

# linux/timex.h: struct timex begins with modes, offset, freq, maxerror. Of a clock that nothing keeps maxerror is 16 s.
_TIMEX_BYTES, _MAX_ERROR_AT, _UNSYNCHRONISED_US = 512, struct.calcsize("@Ill0l"), 16_000_000

_TCP_LISTEN, _UDP_UNCONNECTED = "0A", "07"  # net/tcp_states.h

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def laptop(bus: str | None = None, seconds: float = 2.0, proc: Path = Path("/proc")) -> Machine:
    """A machine on which the car's software is not installed, as far as it matters there.

    bus: one to listen to for so long.
    """
    vcans = [path.name for path in sorted(_NET.glob("*")) if _read(path / "type") == _ARPHRD_CAN]
    up = [name for name in vcans if int(_read(_NET / name / "flags") or "0", 16) & 1]
    return Machine(
        car_pc=False,
        interfaces=tuple(name for name in vcans if (_NET / name / "device").exists()),  # an adapter, no virtual one
        vcan=up[0] if up else "",
        kernel_has_vcan=bool(up) or kernel_has("vcan"),
        bus=None if bus is None else listen(bus, Codec(list(REVISIONS.values())[-1]), seconds),
        may_be_real_time=os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] != 0,
        domain_id=os.environ.get("ROS_DOMAIN_ID") or "0",
        transport=set_transport(dict(os.environ)),
        ros=_ros(proc),
        dds_leftovers=dds_leftovers(proc),
        user=_user(),
        kernel=platform.release(),
        system=system(),
    )


def kernel_has(module: str, folder: Path = _MODULES) -> bool:
    """Return true where the running kernel has a module, built in or to be loaded."""
    here = folder / platform.release()
    return any(f"/{module}.ko" in _read(here / name) for name in ("modules.builtin", "modules.dep"))


def collect(
    wanted: Wanted | None, problems: tuple[str, ...], codec: Codec | None, seconds: float, proc: Path = Path("/proc")
) -> Machine:
    """The car PC, with `seconds` of listening to its bus. `codec`: of the configured revision and wheel mapping."""
    link = link_of(wanted.interface) if wanted is not None and ":" not in wanted.interface else None
    files = [Path(name) for name in (wanted.path, wanted.limits_path) if name] if wanted is not None else []
    folder = Path(wanted.recording_folder) if wanted is not None else None
    here = folder is not None and is_folder(folder)
    return Machine(
        wanted=wanted,
        configuration_problems=problems,
        interfaces=tuple(sorted(path.name for path in _NET.glob("*") if _read(path / "type") == _ARPHRD_CAN)),
        link=link,
        bus=None if wanted is None or codec is None else listen(wanted.interface, codec, seconds),
        ros=_ros(proc),
        services=services(wanted.interface if wanted is not None else ""),
        starts_at_boot=starts_at_boot(),
        scheduling=_scheduling(proc),
        rt_runtime_us=_number(proc / "sys/kernel/sched_rt_runtime_us"),
        clock_synchronised=_synchronised(),
        clock_year=time.gmtime().tm_year,
        disk_free_mib=shutil.disk_usage(folder).free >> 20 if folder is not None and here else None,
        folder_problem="" if folder is None or not here else _folder_problem(folder),
        file_problems=file_problems(files),
        changed_since_start=tuple(str(path) for path in files if _newer(path, _bridge_started_s(proc))),
        user=_user(),
        groups=_groups(),
        listening=listening_on_networks(proc),
        dds_leftovers=dds_leftovers(proc),
        kernel=platform.release(),
        system=system(),
    )


# ---------------------------------------------------------------- the interface


def link_of(name: str) -> Link | None:
    """The interface `name`; None if there is none."""
    device = _NET / name
    if not device.exists():
        return None
    details = _details(name)
    info: dict[str, Any] = details.get("linkinfo", {})
    data: dict[str, Any] = info.get("info_data", {})
    is_can = _read(device / "type") == _ARPHRD_CAN
    kind = str(info.get("info_kind") or ("can" if is_can else details.get("link_type", "another kind")))
    driver = device / "device" / "driver"
    return Link(
        name=name,
        kind=kind,
        up=bool(int(_read(device / "flags") or "0", 16) & 1),
        queue_frames=_number(device / "tx_queue_len") or 0,
        bitrate=data.get("bittiming", {}).get("bitrate"),
        restart_ms=data.get("restart_ms"),
        state=str(data.get("state", "")),
        driver=driver.resolve().name if driver.exists() else "",
    )


def _details(name: str) -> dict[str, Any]:
    output = _output("ip", "-details", "-json", "link", "show", "dev", name)
    try:
        found = json.loads(output or "[]")
    except ValueError:
        return {}
    return found[0] if found and isinstance(found[0], dict) else {}


# ---------------------------------------------------------------- the bus


def listen(interface: str, codec: Codec, seconds: float) -> BusTraffic:
    """Listen for so long and return what is on the bus."""
    try:
        source = LiveSource([interface])
    except BusError as error:
        return BusTraffic(seconds, problem=str(error))
    chunks: list[Frames] = []
    with closing(source):
        chunks += source.chunks(seconds)
        if source.lost is not None:
            return BusTraffic(seconds, problem=source.lost)
    return traffic_in(chunks, codec, seconds)


def traffic_in(chunks: list[Frames], codec: Codec, seconds: float) -> BusTraffic:
    """Return the traffic in frames that have been received."""
    counts: list[Four] = []
    speeds: list[Four] = []
    for frames in chunks:
        for frame in frames.only(np.isin(frames.can_id, (0x525, 0x526)) & (frames.flags & 0x07 == 0)):
            image = codec.decode(Frame(frame.can_id, frame.data)).image
            if isinstance(image, WheelCounts):
                counts.append((image.fl, image.fr, image.rl, image.rr))
            elif isinstance(image, WheelSpeeds):
                speeds.append(image.all_rpm)
    ids = {can_id for frames in chunks for can_id in frames.can_id.tolist()}
    revision = why = ""
    if STATUS_ID in ids:
        found, why = guess_revision(max(chunks, key=len))
        revision = found.name
    return BusTraffic(
        seconds,
        frames=sum(map(len, chunks)),
        error_frames=sum(int((frames.flags & 0x04 != 0).sum()) for frames in chunks),
        from_car=STATUS_ID in ids,
        from_ai=not ids.isdisjoint(AI_IDS),
        from_others=not ids <= set(AI_IDS),
        revision=revision,
        revision_why=why,
        pulses=tuple(map(_counted, zip(*counts, strict=True))) if counts else None,
        speed_max_rpm=tuple(map(max, zip(*speeds, strict=True))) if speeds else None,
    )


def _counted(values: Iterable[int]) -> int:
    """Return how far a counter of 16 bits counted."""
    return sum((after - before) % (1 << 16) for before, after in pairwise(values))


# ---------------------------------------------------------------- processes, services, the rest


def _ros(proc: Path) -> Ros:
    rclpy = importlib.util.find_spec("rclpy")
    where = "" if rclpy is None or rclpy.origin is None else str(Path(rclpy.origin).parent)
    distribution, unused = distribution_of(where, os.environ.get("ROS_DISTRO", ""), _DISTRIBUTIONS)
    return Ros(
        rclpy=where,
        distribution=distribution,
        messages=importlib.util.find_spec("fsai_msgs") is not None,
        nodes=importlib.util.find_spec("fsai_nodes") is not None,
        unused=unused,
        implementation=_implementation(proc),
    )


def distribution_of(rclpy: str, named: str, folder: Path) -> tuple[str, str]:
    """Return whose rclpy it is: a distribution's name, '' for the package index; and an installed one that is not used.

    rclpy: the folder it is imported from. named: ROS_DISTRO. folder: where distributions are, /opt/ros.
    """
    there = sorted(path.parent for path in folder.glob("*/setup.bash"))
    of_rclpy = [path.name for path in there if Path(rclpy).is_relative_to(path)] if rclpy else []
    if of_rclpy:
        return of_rclpy[0], ""
    ours = [folder / name for name in DISTRIBUTIONS if folder / name in there]
    return named, str(ours[0]) if rclpy and not named and ours else ""


def _implementation(proc: Path) -> str | None:
    """RMW_IMPLEMENTATION of the running bridge, None where it may not be read; where none runs, that of this shell."""
    for folder in _processes(proc, _BRIDGE_MODULE):
        try:
            words = (folder / "environ").read_bytes().decode(errors="replace").split("\0")
        except PermissionError:
            return None
        except OSError:  # it has just ended
            continue
        return dict(word.split("=", 1) for word in words if "=" in word).get("RMW_IMPLEMENTATION", "")
    return os.environ.get("RMW_IMPLEMENTATION", "")


def _bridge_started_s(proc: Path) -> float | None:
    """Return when the running bridge was started (s), by the wall clock; None if none runs (proc(5))."""
    booted = [line.split()[1] for line in _read(proc / "stat").splitlines() if line.startswith("btime ")]
    for folder in _processes(proc, _BRIDGE_MODULE):
        fields = _read(folder / "stat").rpartition(")")[2].split()
        if booted and len(fields) > 19:
            return int(booted[0]) + int(fields[19]) / os.sysconf("SC_CLK_TCK")
    return None


def _newer(path: Path, started_s: float | None) -> bool:
    try:
        # A boot's time is known to a second.
        return started_s is not None and path.stat().st_mtime > started_s + 1.0
    except OSError:
        return False


def file_problems(files: list[Path]) -> tuple[tuple[str, str], ...]:
    """List the files that the services' user cannot read, or could change; nothing where there is no such user."""
    try:
        group = grp.getgrnam(_GROUP).gr_gid
    except KeyError:
        return ()
    found = []
    for path in files:
        try:
            status = path.stat()
        except OSError:
            continue
        of_group = status.st_gid == group
        if not (status.st_mode & 0o004 or (of_group and status.st_mode & 0o040)):
            found.append((str(path), "cannot be read by the services, which run as fsai"))
        elif status.st_mode & 0o002 or (of_group and status.st_mode & 0o020):
            found.append((str(path), "may be changed by others than root, the services among them"))
    return tuple(found)


def services(interface: str) -> dict[str, str]:
    """The state of each service of this software that is enabled, by its name; of the interface's link, if it runs."""
    if not _SYSTEMD.is_dir():
        return {}
    names = sorted({link.name for link in _ENABLED.glob("*.wants/fsai-*.service")})
    wanted = [*names, *(name.replace("bridge", "link") for name in names if name.startswith("fsai-bridge@"))]
    links = [f"fsai-link@{interface}.service"] if interface and ":" not in interface else []
    asked = list(dict.fromkeys([*wanted, *links]))
    states = _output("systemctl", "is-active", *asked).split() if asked else []
    if len(states) != len(asked):
        states = ["unknown"] * len(asked)
    return {name: state for name, state in zip(asked, states, strict=True) if name in wanted or state == "active"}


def starts_at_boot() -> bool | None:
    """Return true where this installation starts with the machine; None: there is none, or systemd does not run."""
    if not _SYSTEMD.is_dir() or not (_UNITS / "fsai.target").exists():
        return None
    return (_ENABLED / "multi-user.target.wants" / "fsai.target").is_symlink()


def _scheduling(proc: Path) -> Scheduling | None:
    """Return the scheduling of the running CAN loop."""
    return next(filter(None, map(scheduling_of, _processes(proc, _LOOP_MODULE))), None)


def scheduling_of(process: Path) -> Scheduling | None:
    """Return the scheduling of a process's most urgent thread, by its folder in /proc; None when it has just ended."""
    threads = []
    with suppress(OSError):
        for thread in (process / "task").iterdir():
            with suppress(OSError):
                number = int(thread.name)
                threads.append((os.sched_getparam(number).sched_priority, os.sched_getscheduler(number)))
    if not threads:
        return None
    priority, policy = max(threads)
    locked = any(
        line.startswith("VmLck:") and line.split()[1] != "0" for line in _read(process / "status").splitlines()
    )
    return Scheduling(_POLICIES.get(policy & 0xFF, str(policy)), priority, locked)


def listening_on_networks(proc: Path) -> tuple[str, ...] | None:
    """Addresses, other than the loopback and multicast ones, at which a node of this software takes UDP or TCP.

    None where nothing was found, and this user may not look at all of them: every node has a socket.
    """
    of_nodes = [listening_addresses(process) for process in _processes(proc, _NODE_MODULES)]
    found = {str(each) for each in chain(*of_nodes) if not (each.is_loopback or each.is_multicast)}
    return tuple(sorted(found)) if found or all(of_nodes) else None


def listening_addresses(process: Path) -> list[Address]:
    """The local addresses on which a process takes UDP or TCP; none where this user may not look.

    Args:
        process: its folder in /proc. ss(8) would look at every process, which takes longer than its answer may.
    """
    files = set()
    with suppress(OSError):
        for file in (process / "fd").iterdir():
            with suppress(FileNotFoundError):  # it has just been closed
                files.add(str(file.readlink()))
    return [address for inode, address in listening_sockets(process).items() if f"socket:[{inode}]" in files]


def listening_sockets(process: Path) -> dict[int, Address]:
    """Return by inode the local address of each UDP or TCP socket that listens, in a process's network (proc(5))."""
    found = {}
    for name in ("tcp", "tcp6", "udp", "udp6"):
        for line in _read(process / "net" / name).splitlines()[1:]:
            fields = line.split()
            if fields[3] == (_TCP_LISTEN if name.startswith("tcp") else _UDP_UNCONNECTED):
                words = np.frombuffer(bytes.fromhex(fields[1].partition(":")[0]), ">u4")
                address = ipaddress.ip_address(words.astype("=u4").tobytes())
                found[int(fields[9])] = getattr(address, "ipv4_mapped", None) or address
    return found


def dds_leftovers(proc: Path = Path("/proc"), folder: Path = _SHARED_MEMORY) -> tuple[str, ...]:
    """Files of Fast DDS's shared memory whose owner is gone, as its own `fastdds shm clean` decides it.

    A segment or port `fastrtps_X` is in use while a lock is held on `fastrtps_X_el` or `fastrtps_X_sl`;
    `sem.fastrtps_X_mutex` belongs to it. Fast DDS 3 names them `fastdds_X`. A file with another name is none of them:
    anybody can put one there, and the doctor puts the names into a command. The locks are read (proc_locks(5)), not
    tried: that would hold up an owner.
    """
    locked = {line.split()[5 if "->" not in line else 6] for line in _read(proc / "locks").splitlines()}
    files: dict[str, list[Path]] = {}
    in_use = set()
    for path in folder.glob("*fast*"):
        if _OF_FAST_DDS.fullmatch(path.name) is None:
            continue
        owner = re.sub(r"^sem\.|_(el|sl|mutex)$", "", path.name)
        files.setdefault(owner, []).append(path)
        try:
            status = path.stat()
        except OSError:  # it has just been removed
            continue
        if f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}" in locked:
            in_use.add(owner)
    return tuple(sorted(str(path) for owner in files.keys() - in_use for path in files[owner]))


def _processes(proc: Path, module: bytes) -> Iterator[Path]:
    for folder in proc.glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if any(word.startswith(module) for word in words):
            yield folder


def _synchronised() -> bool | None:
    """Return true where something keeps the kernel's clock right, by timedatectl's rule; None where that is unknown."""
    answer = ctypes.create_string_buffer(_TIMEX_BYTES)  # `modes` is zero: nothing is set
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(answer)
    except (OSError, AttributeError):
        return None
    (most_wrong_us,) = struct.unpack_from("@l", answer, _MAX_ERROR_AT)
    return None if state == -1 else bool(most_wrong_us < _UNSYNCHRONISED_US)


def _folder_problem(folder: Path) -> str:
    """Say why the recorder, which runs as the user fsai, cannot write there."""
    status = folder.stat()
    try:
        owner = grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        owner = str(status.st_gid)
    return "" if owner in ("fsai", _user()) else f"{folder} belongs to the group {owner}, not to fsai"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.geteuid())


def _groups() -> tuple[str, ...]:
    names = []
    for number in os.getgroups():
        with suppress(KeyError):
            names.append(grp.getgrgid(number).gr_name)
    return tuple(names)


def system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.system()


def _output(*argv: str) -> str:
    """Return what a command prints; nothing where it is not there or does not answer."""
    tool = shutil.which(argv[0], path=f"{os.environ.get('PATH', '')}:{_PATH}")
    if tool is None:
        return ""
    try:
        done = subprocess.run(
            [tool, *argv[1:]],
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=_ANSWER_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _number(path: Path) -> int | None:
    text = _read(path)
    try:
        return int(text)
    except ValueError:
        return None
