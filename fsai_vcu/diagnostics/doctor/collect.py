"""Looks at this machine: the only part of the doctor that touches it. It never sends, and changes nothing."""

from __future__ import annotations

import getpass
import grp
import importlib.util
import ipaddress
import itertools
import json
import os
import platform
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fsai_vcu.diagnostics.doctor.machine import BusHeard, Link, Machine, Ros, Scheduling, Wanted
from fsai_vcu.diagnostics.frames import Frames
from fsai_vcu.diagnostics.live import LiveSource
from fsai_vcu.diagnostics.revision import guess_revision
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.images import WheelCounts, WheelSpeeds
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.runtime.bus import BusError

_NET = Path("/sys/class/net")
_ARPHRD_CAN = "280"  # linux/if_arp.h
_STATUS_ID = 0x520
_ANSWER_S = 10.0
_PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
_ENABLED = Path("/etc/systemd/system")
_POLICIES = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}
_BRIDGE_MODULE = b"fsai_nodes.vcu_bridge"
_NODE_MODULES = b"fsai_nodes."

Four = tuple[int, int, int, int]


def collect(
    wanted: Wanted | None, problems: tuple[str, ...], codec: Codec | None, seconds: float, proc: Path = Path("/proc")
) -> Machine:
    """The machine, with `seconds` of listening to its bus. `codec`: of the configured revision and wheel mapping."""
    link = link_of(wanted.interface) if wanted is not None and ":" not in wanted.interface else None
    heard = None
    if wanted is not None and codec is not None:
        heard = listen(wanted.interface, codec, seconds)
    folder = Path(wanted.recording_folder) if wanted is not None else None
    here = folder is not None and folder.is_dir()
    return Machine(
        wanted=wanted,
        configuration_problems=problems,
        interfaces=tuple(sorted(path.name for path in _NET.glob("*") if _read(path / "type") == _ARPHRD_CAN)),
        link=link,
        bus=heard,
        ros=_ros(),
        services=services(_ENABLED),
        scheduling=_scheduling(proc),
        rt_runtime_us=_number(proc / "sys/kernel/sched_rt_runtime_us"),
        clock_synchronised=_synchronised(),
        clock_year=time.gmtime().tm_year,
        disk_free_mib=shutil.disk_usage(folder).free >> 20 if folder is not None and here else None,
        folder_problem="" if folder is None or not here else _folder_problem(folder),
        user=_user(),
        groups=_groups(),
        dds_listening=listening_on_networks(proc),
        kernel=platform.release(),
        system=_system(),
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


def listen(interface: str, codec: Codec, seconds: float) -> BusHeard:
    """What is on the bus for so long."""
    try:
        source = LiveSource([interface])
    except BusError as error:
        return BusHeard(seconds, problem=str(error))
    chunks: list[Frames] = []
    with source:
        chunks += source.chunks(seconds)
        if source.lost is not None:
            return BusHeard(seconds, problem=source.lost)
    return heard_in(chunks, codec, seconds)


def heard_in(chunks: list[Frames], codec: Codec, seconds: float) -> BusHeard:
    """The same of frames that have been heard."""
    counts: list[Four] = []
    speeds: list[Four] = []
    for image in images_of(chunks, codec):
        if isinstance(image, WheelCounts):
            counts.append((image.fl, image.fr, image.rl, image.rr))
        else:
            speeds.append(image.all_rpm)
    ids = {int(can_id) for frames in chunks for can_id in set(frames.can_id.tolist())}
    known = max(chunks, key=len, default=None)
    revision = why = ""
    if known is not None and _STATUS_ID in ids:
        found, why = guess_revision(known)
        revision = found.name
    return BusHeard(
        seconds,
        frames=sum(len(frames) for frames in chunks),
        error_frames=sum(int((frames.flags & 0x04 != 0).sum()) for frames in chunks),
        from_car=_STATUS_ID in ids,
        from_ai=not ids.isdisjoint(AI_IDS),
        revision=revision,
        revision_why=why,
        speeds_heard=bool(speeds),
        pulses_heard=bool(counts),
        pulses=_advance(counts),
        speed_max_rpm=_four(max((row[index] for row in speeds), default=0) for index in range(4)),
    )


def images_of(chunks: list[Frames], codec: Codec) -> Iterator[WheelCounts | WheelSpeeds]:
    """Speeds and pulses in the order in which they were heard."""
    for frames in chunks:
        for row in range(len(frames)):
            if int(frames.can_id[row]) not in (0x525, 0x526) or frames.flags[row] & 0x07:
                continue
            data = int(frames.word[row]).to_bytes(8, "little")[: int(frames.length[row])]
            image = codec.decode(Frame(int(frames.can_id[row]), data, int(frames.t_ns[row]))).image
            if isinstance(image, (WheelCounts, WheelSpeeds)):
                yield image


def _advance(counts: list[Four]) -> Four:
    total = [0, 0, 0, 0]
    for before, after in itertools.pairwise(counts):
        for index in range(4):
            total[index] += (after[index] - before[index]) % (1 << 16)
    return _four(total)


def _four(values: Iterator[int] | list[int]) -> Four:
    first, second, third, fourth = values
    return first, second, third, fourth


# ---------------------------------------------------------------- processes, services, the rest


def _ros() -> Ros:
    rclpy = importlib.util.find_spec("rclpy")
    where = "" if rclpy is None or rclpy.origin is None else str(Path(rclpy.origin).parent)
    return Ros(
        rclpy=where,
        distribution=os.environ.get("ROS_DISTRO", ""),
        messages=importlib.util.find_spec("fsai_msgs") is not None,
        nodes=importlib.util.find_spec("fsai_nodes") is not None,
    )


def services(enabled: Path) -> dict[str, str]:
    """The state of each service of ours that starts with the machine, by its name."""
    if not Path("/run/systemd/system").is_dir():
        return {}
    names = sorted({link.name for link in enabled.glob("*.wants/fsai-*.service")})
    links = {name.replace("bridge", "link") for name in names if name.startswith("fsai-bridge@")}
    return {name: _output("systemctl", "is-active", name).strip() or "unknown" for name in [*names, *sorted(links)]}


def _scheduling(proc: Path) -> Scheduling | None:
    """That of the running bridge's most urgent thread."""
    for folder in _processes(proc, _BRIDGE_MODULE):
        threads = []
        for thread in (folder / "task").glob("*"):
            try:
                number = int(thread.name)
                threads.append((os.sched_getparam(number).sched_priority, os.sched_getscheduler(number)))
            except (OSError, ValueError):
                continue
        if threads:
            priority, policy = max(threads)
            locked = any(
                line.startswith("VmLck:") and line.split()[1] != "0" for line in _read(folder / "status").splitlines()
            )
            return Scheduling(_POLICIES.get(policy & 0xFF, str(policy)), priority, locked)
    return None


def listening_on_networks(proc: Path) -> tuple[str, ...]:
    """Addresses, other than the loopback's and multicast ones, on which a node of ours takes UDP."""
    found = {
        str(address)
        for folder in _processes(proc, _NODE_MODULES)
        for address in udp_addresses(folder, proc)
        if not (address.is_loopback or address.is_multicast)
    }
    return tuple(sorted(found))


def udp_addresses(folder: Path, proc: Path) -> list[ipaddress.IPv4Address]:
    """The local addresses of the UDP sockets of the process whose folder in /proc is `folder`."""
    sockets = _udp_sockets(proc)
    found = []
    for entry in _entries(folder / "fd"):
        try:
            target = str(entry.readlink())
        except OSError:
            continue
        address = sockets.get(target.removeprefix("socket:[").removesuffix("]"))
        if address is not None:
            found.append(address)
    return found


def _udp_sockets(proc: Path) -> dict[str, ipaddress.IPv4Address]:
    """The local address of every UDP socket, by its inode (proc(5), /proc/net/udp)."""
    found = {}
    for line in _read(proc / "net" / "udp").splitlines()[1:]:
        fields = line.split()
        found[fields[9]] = ipaddress.IPv4Address(int.from_bytes(bytes.fromhex(fields[1].split(":")[0]), "little"))
    return found


def _processes(proc: Path, module: bytes) -> Iterator[Path]:
    for folder in proc.glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if any(word.startswith(module) for word in words):
            yield folder


def _synchronised() -> bool | None:
    answer = _output("timedatectl", "show", "--property=NTPSynchronized", "--value").strip()
    return {"yes": True, "no": False}.get(answer)


def _folder_problem(folder: Path) -> str:
    """Why the recorder, which runs as the user fsai, cannot write there."""
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
        try:
            names.append(grp.getgrgid(number).gr_name)
        except KeyError:
            continue
    return tuple(names)


def _system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.system()


def _output(*argv: str) -> str:
    """What a command prints; nothing where it is not there or does not answer."""
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


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


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
