"""A machine as the doctor sees it: one frozen snapshot. None says that something could not be seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fsai_vcu.diagnostics.doctor.wheels import Four


@dataclass(frozen=True, slots=True)
class Wanted:
    """Settings that the configuration asks for."""

    path: str
    interface: str  # that is looked at
    configured_interface: str  # the file's own; the doctor may have been asked for another
    revision: str
    bitrate: int
    queue_frames: int
    wheel_mapping: str  # fl=fl,fr=fr,…
    limits: tuple[str, ...]  # in words
    limits_path: str
    environment: Mapping[str, str]  # for ROS 2
    discovery: str
    keystore: str
    recording_folder: str
    leave_free_mib: int


@dataclass(frozen=True, slots=True)
class Link:
    """A network interface. bitrate, restart_ms, state: of a CAN controller."""

    name: str
    kind: str  # can, vcan, or another
    up: bool
    queue_frames: int
    bitrate: int | None = None
    restart_ms: int | None = None
    state: str = ""  # ERROR-ACTIVE, ERROR-PASSIVE, BUS-OFF
    driver: str = ""


@dataclass(frozen=True, slots=True)
class BusTraffic:
    """Traffic on the bus while the doctor listened. Pulses and speeds by the configured mapping: fl, fr, rl, rr."""

    seconds: float
    frames: int = 0
    problem: str = ""  # why nothing could be received
    error_frames: int = 0
    from_car: bool = False  # 0x520 was among them
    from_ai: bool = False  # commands are sent
    from_others: bool = False  # by another than the AI computer
    revision: str = ""
    revision_why: str = ""
    pulses: Four | None = None  # counted while listening; None: no 0x526
    speed_max_rpm: Four | None = None  # None: no 0x525


@dataclass(frozen=True, slots=True)
class Ros:
    """ROS 2 in this Python environment.

    implementation: RMW_IMPLEMENTATION as the bridge has it; empty: the usual; None: the bridge may not be looked into.
    """

    rclpy: str = ""  # where it comes from; empty: not there
    distribution: str = ""
    messages: bool = False
    nodes: bool = False
    unused: str = ""  # a distribution that is on this machine, while rclpy comes from elsewhere
    implementation: str | None = ""


@dataclass(frozen=True, slots=True)
class Scheduling:
    """Scheduling of a running CAN loop. policy: SCHED_FIFO, SCHED_OTHER…"""

    policy: str
    priority: int
    memory_locked: bool


@dataclass(frozen=True, slots=True)
class Machine:
    """All of it. `services`: the state of each enabled unit of this software, by name; empty where there is none."""

    car_pc: bool = True  # the car's software is installed here; else this is a laptop, with a checkout or a workspace
    vcan: str = ""  # on a laptop: an interface of that kind that is up
    kernel_has_vcan: bool = False
    may_be_real_time: bool = False  # whether this user's processes may
    domain_id: str = "0"
    transport: str = ""  # reach of this shell's ROS 2 programs, where that is not the loopback alone
    wanted: Wanted | None = None
    configuration_problems: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()  # CAN interfaces there are
    link: Link | None = None
    bus: BusTraffic | None = None
    ros: Ros = Ros()
    services: Mapping[str, str] = field(default_factory=dict)
    starts_at_boot: bool | None = None  # whether fsai.target is enabled; None: not installed, or no systemd
    scheduling: Scheduling | None = None
    rt_runtime_us: int | None = None  # how much of a second real-time threads may have, of 1 000 000; -1: all
    clock_synchronised: bool | None = None
    clock_year: int = 0
    disk_free_mib: int | None = None  # where bus logs go
    folder_problem: str = ""  # why the log folder cannot be used
    file_problems: tuple[tuple[str, str], ...] = ()  # configuration and limits: closed or open to whom
    changed_since_start: tuple[str, ...] = ()  # files that are newer than the running bridge, which has read them once
    user: str = ""
    groups: tuple[str, ...] = ()
    listening: (
        tuple[str, ...] | None
    ) = ()  # where a process of this software takes anything from this machine's networks
    dds_leftovers: tuple[str, ...] = ()  # files of shared memory that ended programs have left
    kernel: str = ""
    system: str = ""
