"""The judgement: a machine goes in, findings come out, each wrong one with what to do. Pure."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator

from fsai_vcu.diagnostics.doctor.machine import BusTraffic, Machine, Wanted
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.runtime.transport import DISTRIBUTIONS, DOMAIN_MAX

FOR_THE_CAR = "for the car"  # what a laptop lacks to be the car's computer
_FIRST_BELIEVABLE_YEAR = 2025
_WHEELS = ("front left", "front right", "rear left", "rear right")
_IMPLEMENTATION = "rmw_fastrtps_cpp"  # the one that the configuration's DDS settings are for
_NO_CONFIGURATION = "needs the configuration"
_AT_ONCE = 20  # files of a command
_SETTLE = "sudo /usr/lib/fsai/settle"  # sets which bus the services are for
_ANOTHER = f"name another in [can] interface and to the services: {_SETTLE} NAME"
# No do_set_mode in drivers/net/can/usb/gs_usb.c: some kernels refuse restart-ms, others accept it and never restart.
_NEVER_RESTART = ("gs_usb",)


def examine(machine: Machine) -> tuple[Finding, ...]:
    """All findings, in the order in which they are put right."""
    checks = CHECKS if machine.car_pc else LAPTOP_CHECKS
    return tuple(finding for check in checks for finding in check(machine))


# ---------------------------------------------------------------- on a laptop


def vcan(machine: Machine) -> Iterator[Finding]:
    if machine.bus is not None:  # one that was named
        yield from _traffic(machine.bus)
        if machine.bus.revision:
            yield _right("revision", f"{machine.bus.revision} ({machine.bus.revision_why})")
        return
    stand_in = "loopback:NAME can be named instead of a bus, as in fsai-vcu vcu loopback:lab"
    if machine.vcan:
        yield _right("bus", f"{machine.vcan} is up; {stand_in}")
    elif machine.kernel_has_vcan:
        make = "sudo modprobe vcan; sudo ip link add dev vcan0 type vcan; sudo ip link set vcan0 up"
        yield Finding("note", "bus", f"no vcan0 yet; until then {stand_in}", make)
    else:
        yield _note("bus", f"this kernel has no vcan: {stand_in}")


def domain(machine: Machine) -> Iterator[Finding]:
    here = f"domain {machine.domain_id}"
    if not machine.domain_id.isdecimal() or int(machine.domain_id) > DOMAIN_MAX:
        words = f"ROS_DOMAIN_ID is {machine.domain_id}, with which no ROS program starts"
        yield _wrong("DDS", words, "unset it, or set it to a number up to 101 that nobody else on your network uses")
    elif machine.transport:
        yield Finding("note", "DDS", f"{here}; {machine.transport}", "unset that variable to stay on this machine")
    else:
        yield _right(
            "DDS", f"{here}, on the loopback alone: ros2 and your own programs need only the same ROS_DOMAIN_ID"
        )


def real_time(machine: Machine) -> Iterator[Finding]:
    if machine.may_be_real_time:
        yield _right("scheduling", f"{machine.user}'s programs may be real-time")
    else:
        limits = f"{machine.user} - rtprio 60, and {machine.user} - memlock unlimited"
        words = f"{machine.user}'s programs may not be real-time: the CAN loop runs all the same, but late under load"
        todo = f"two lines in /etc/security/limits.d/fsai.conf: {limits}; then log in again"
        yield Finding("note", "scheduling", words, todo)


def to_drive_the_car(machine: Machine) -> Iterator[Finding]:
    """Yield what this computer lacks to be the car's; with the car's software, the checks below say the rest."""
    words = "no car software: no configuration (/etc/fsai/fsai.toml), no services, no real-time priority, no group fsai"
    yield Finding(
        "note", FOR_THE_CAR, words, "sudo make install in the checkout (docs/car.md), then fsai-vcu doctor again"
    )
    if not machine.interfaces:
        yield Finding("note", FOR_THE_CAR, "no CAN adapter", "docs/connect.md says which to buy, and how to connect it")


# ---------------------------------------------------------------- on the car PC


def configuration(machine: Machine) -> Iterator[Finding]:
    wanted = machine.wanted
    if wanted is None:
        for problem in machine.configuration_problems or ("no configuration was read",):
            yield _wrong("configuration", problem, "correct it; fsai-vcu config check says whether it is right")
        return
    if wanted.path in machine.changed_since_start:
        yield _changed("configuration", wanted)
    else:
        yield _right("configuration", f"{wanted.path}: revision {wanted.revision}, {wanted.configured_interface}")


def _changed(topic: str, wanted: Wanted) -> Finding:
    file = wanted.path if topic == "configuration" else wanted.limits_path
    words = f"{file} was changed after the start of the bridge, which still uses the old values"
    return _wrong(topic, words, "sudo systemctl restart fsai.target 'fsai-*.service', with the car at rest")


def limits(machine: Machine) -> Iterator[Finding]:
    wanted = machine.wanted
    if wanted is None:
        yield _note("limits", _NO_CONFIGURATION)
    elif not wanted.limits_path:
        yield _note("limits", "none but the car's own: [limits] file is empty")
    elif wanted.limits_path in machine.changed_since_start:
        yield _changed("limits", wanted)
    else:
        yield _right("limits", f"{wanted.limits_path}: {', '.join(wanted.limits)}")


def interface(machine: Machine) -> Iterator[Finding]:
    """Yield findings on the interface that the configuration names: its state, bitrate, queue and driver."""
    wanted, link = machine.wanted, machine.link
    if wanted is None:
        yield _note("interface", _NO_CONFIGURATION)
        return
    name = wanted.interface
    if ":" in name:
        yield _note("interface", f"{name} is a stand-in for a rehearsal, not a car's bus")
        return
    if link is None:
        there = f"there are: {', '.join(machine.interfaces)}" if machine.interfaces else "this machine has none"
        yield _wrong(
            "interface",
            f"no interface {name} ({there})",
            f"plug the adapter in, look for it in `journalctl -k`, or {_ANOTHER}",
        )
        return
    if link.kind not in ("can", "vcan"):
        yield _wrong("interface", f"{name} is no CAN interface but {link.kind}", _ANOTHER)
        return
    bring_up = f"sudo systemctl restart fsai-link@{name}, and look into its journal"
    if link.state == "BUS-OFF":
        yield _wrong("interface", f"{name} is off the bus (BUS-OFF)", "check wiring, termination and bitrate")
    elif not link.up:
        yield _wrong("interface", f"{name} is down", bring_up)
    elif link.state == "ERROR-PASSIVE":
        yield _note("interface", f"{name} is up, ERROR-PASSIVE: nothing acknowledges its frames, or the wiring is bad")
    else:
        yield _right("interface", f"{name} is up" + (f", {link.state}" if link.state else ""))
    if link.kind == "vcan":
        yield _note("bitrate", f"{name} is virtual: no bitrate, no acknowledge, no bus-off")
    elif link.bitrate != wanted.bitrate:
        yield _wrong("bitrate", f"{link.bitrate or 'unknown'} bit/s instead of {wanted.bitrate}", bring_up)
    else:
        yield _right("bitrate", f"{link.bitrate} bit/s")
    if link.queue_frames > wanted.queue_frames:
        yield _wrong(
            "queue",
            f"{link.queue_frames} frames may wait to be sent: {link.queue_frames * 2} ms of stale commands",
            f"sudo ip link set {name} txqueuelen {wanted.queue_frames}; fsai-link@{name} does it at every start",
        )
    else:
        yield _right("queue", f"{link.queue_frames} frames")
    if link.kind == "can":
        if link.restart_ms and link.driver not in _NEVER_RESTART:
            yield _right("driver", f"{link.driver or 'unknown'}, starts again {link.restart_ms} ms after bus-off")
        elif machine.services.get(f"fsai-link@{name}.service") == "active":
            yield _right("driver", f"{link.driver or 'unknown'}; after bus-off fsai-link@{name} starts it again")
        else:
            yield _wrong(
                "driver",
                f"{link.driver or 'unknown'} does not start again after bus-off, and no service does it",
                f"sudo systemctl start fsai-link@{name}",
            )


def bus(machine: Machine) -> Iterator[Finding]:
    """Yield findings on the traffic: whether the car is heard, and whether it speaks the configured revision."""
    wanted, seen = machine.wanted, machine.bus
    if wanted is None or seen is None:
        yield _note("bus", "not listened to")
        return
    yield from _traffic(seen)
    if not seen.from_car:
        return
    if seen.revision != wanted.revision:
        yield _wrong(
            "revision",
            f"the bus has {seen.revision} ({seen.revision_why}), the configuration says {wanted.revision}",
            f'[can] revision = "{seen.revision}"',
        )
    else:
        yield _right("revision", f"{seen.revision} ({seen.revision_why})")
    yield from _wheels(wanted, seen)


def _traffic(seen: BusTraffic) -> Iterator[Finding]:
    """Yield the finding on the senders of a bus."""
    if seen.problem:
        yield _wrong("bus", seen.problem, "first put the interface right")
        return
    if not seen.frames or (seen.from_ai and not seen.from_others):
        words = f"silent for {seen.seconds:g} s"
        yield _wrong(
            "bus",
            f"the VCU is {words}: only this computer's own frames are there" if seen.frames else words,
            "switch the car's low voltage on; check plug, wiring (CAN high and low) and the two terminations",
        )
        return
    if not seen.from_car:
        yield _wrong(
            "bus",
            f"{seen.frames} frames in {seen.seconds:g} s, but none of the VCU's status (0x520)",
            "is this the AI bus of the car, and is the VCU on?",
        )
        return
    if seen.error_frames:
        yield _wrong(
            "bus",
            f"the VCU sends, with {seen.error_frames} error frames in {seen.seconds:g} s",
            "check wiring and termination (60 ohm between CAN high and low)",
        )
    else:
        yield _right("bus", f"the VCU sends: {seen.frames} frames in {seen.seconds:g} s")


def _wheels(wanted: Wanted, seen: BusTraffic) -> Iterator[Finding]:
    """Yield findings on the wheels: whether their speeds and pulses come and agree."""
    pulses, speeds = seen.pulses, seen.speed_max_rpm
    if pulses is None or speeds is None:
        absent = (("wheel speeds (0x525)", speeds), ("pulses (0x526)", pulses))
        missing = " and ".join(name for name, values in absent if values is None)
        yield _wrong("wheels", f"no {missing} on the bus", "without them the car is braked; check the VCU")
        return
    turning = [index for index in range(4) if pulses[index] or speeds[index]]
    words = ", ".join(f"{_WHEELS[index]} {pulses[index]} pulses, {speeds[index]} rpm" for index in turning)
    if not turning:
        yield _note("wheels", f"no wheel turns ({wanted.wheel_mapping}); to check the wiring: fsai-vcu doctor --wheels")
    elif all(pulses[index] and speeds[index] for index in turning):
        yield _right("wheels", words)
    else:
        yield _wrong(
            "wheels",
            f"speed and pulses do not agree: {words}",
            "a sensor or its wiring; fsai-vcu doctor --wheels shows each",
        )


def ros(machine: Machine) -> Iterator[Finding]:
    """Yield findings on ROS 2: its distribution, and whether the project's packages are beside it."""
    here = machine.ros
    if not here.rclpy:
        yield _wrong(
            "ROS 2",
            "rclpy is not in this Python environment",
            "use the car's own command (/usr/bin/fsai-vcu, after make install), or source /opt/ros/…/setup.bash"
            if machine.car_pc
            else "make setup in a checkout, or source /opt/ros/…/setup.bash; fsai-vcu drive works without",
        )
    else:
        distribution = here.distribution or "from the package index"
        yield _right("ROS 2", f"{distribution}, {here.rclpy}")
        if here.distribution and here.distribution not in DISTRIBUTIONS:
            words = f"the distribution is {here.distribution}, which was never tried"
            yield _note("ROS 2", f"{words}; tried are {', '.join(DISTRIBUTIONS)}")
        if here.unused:
            yield _note("ROS 2", f"{here.unused} is there too, and not used (sudo make install takes it from now on)")
        if not here.messages or not here.nodes:
            missing = " and ".join(
                name for name, there in (("fsai_msgs", here.messages), ("fsai_nodes", here.nodes)) if not there
            )
            yield _wrong("ROS 2", f"{missing} not installed beside it", "make install (or make setup in a checkout)")


def shared_memory(machine: Machine) -> Iterator[Finding]:
    if machine.dds_leftovers:
        files = "1 file" if len(machine.dds_leftovers) == 1 else f"{len(machine.dds_leftovers)} files"
        words = (
            f"{files} in /dev/shm of ROS programs that were killed (no process holds a lock on them): the nodes do not"
            " use them, other programs may hang"
        )
        yield Finding("note", "DDS", words, f"sudo rm -f {' '.join(machine.dds_leftovers[:_AT_ONCE])}")


def dds(machine: Machine) -> Iterator[Finding]:
    """Yield findings on DDS: its domain, its encryption, and where the nodes listen."""
    wanted = machine.wanted
    if wanted is None:
        yield _note("DDS", _NO_CONFIGURATION)
        return
    domain = f"domain {wanted.environment.get('ROS_DOMAIN_ID', '0')}"
    unseen = machine.listening is None or machine.ros.implementation is None
    if unseen:
        yield _note("DDS", f"{domain}; what the running nodes listen on was not looked at: run with sudo")
    if machine.ros.implementation not in ("", None, _IMPLEMENTATION):
        yield _wrong(
            "DDS",
            f"the bridge runs on {machine.ros.implementation}, to which none of these settings applies",
            f"start it without RMW_IMPLEMENTATION, or with {_IMPLEMENTATION}",
        )
    if wanted.discovery == "localhost":
        if machine.listening:
            yield _wrong(
                "DDS",
                f"a node listens on {', '.join(machine.listening)}, but the configuration allows this machine only",
                "start it by its service, or with --config: then it is bound to 127.0.0.1",
            )
        elif not unseen:
            yield _right("DDS", f"{domain}, on the loopback alone")
    elif not wanted.keystore:
        yield _wrong(
            "DDS",
            f"{domain}, open to every network of this machine: anyone there can drive the car",
            '[ros] discovery = "localhost", or keys: fsai-vcu enclaves, and [ros] keystore',
        )
    else:
        yield _right("DDS", f"{domain}, open to the networks, encrypted with {wanted.keystore}")


def services(machine: Machine) -> Iterator[Finding]:
    """Yield findings on the services: whether they start at boot, for which bus, and their states."""
    wanted = machine.wanted
    configured = wanted.configured_interface if wanted is not None and ":" not in wanted.configured_interface else ""
    settle = f"{_SETTLE} {configured or 'INTERFACE'}"
    bridges = [name for name in machine.services if name.startswith("fsai-bridge@")]
    if machine.starts_at_boot is False and bridges:
        words = f"fsai.target is not enabled, but {_short(bridges[0])} starts whenever its adapter is there, and sends"
        yield _wrong("services", words, f"{settle}; or, so that nothing is sent: {_SETTLE} --off")
    elif machine.starts_at_boot is False:
        words = "no service starts at boot: fsai.target is not enabled"
        yield _wrong("services", words, f"{settle}, when all else is right: from then on this computer sends")
        return
    if not machine.services and machine.starts_at_boot is None:
        yield _note("services", "systemd does not run here, or the car's software is not installed")
        return
    if configured and bridges != [f"fsai-bridge@{configured}.service"]:
        words = ", ".join(_short(name) for name in bridges) or "no bridge"
        yield _wrong("services", f"{words} is enabled, while the configuration says {configured}", settle)
    bad = {name: state for name, state in machine.services.items() if state != "active"}
    if bad:
        words = ", ".join(f"{_short(name)} is {state}" for name, state in bad.items())
        first = next(iter(bad))
        yield _wrong("services", words, f"sudo systemctl start fsai.target; journalctl -b -u {first}")
    elif machine.services:
        yield _right("services", f"{len(machine.services)} active: {', '.join(_short(n) for n in machine.services)}")


def scheduling(machine: Machine) -> Iterator[Finding]:
    """Yield findings on the CAN loop's real-time scheduling and memory."""
    if machine.rt_runtime_us == 0:
        yield _wrong(
            "scheduling",
            "this kernel does not let real-time threads run",
            "sudo sysctl kernel.sched_rt_runtime_us=950000",
        )
    here = machine.scheduling
    if here is None:
        yield _note("scheduling", "no CAN loop runs here, so its scheduling cannot be seen")
        return
    if here.policy != "SCHED_FIFO":
        yield _wrong(
            "scheduling",
            f"the CAN loop runs as {here.policy}: late under load",
            "start it by its service, which gives it LimitRTPRIO=; a kernel with RT_GROUP_SCHED refuses real time",
        )
    else:
        yield _right("scheduling", f"the CAN loop runs as {here.policy} {here.priority}")
    if here.memory_locked:
        yield _right("memory", "the CAN loop's memory is locked")
    else:
        yield _wrong(
            "memory",
            "the CAN loop's memory is not locked: a page fault delays a cycle",
            "start it by its service, which has LimitMEMLOCK=infinity",
        )


def clock(machine: Machine) -> Iterator[Finding]:
    if machine.clock_year < _FIRST_BELIEVABLE_YEAR:
        yield _wrong(
            "clock",
            f"it is the year {machine.clock_year} here: logs are dated wrongly (driving uses no date)",
            "connect a network once, or set it: sudo timedatectl set-time",
        )
    elif machine.clock_synchronised:
        yield _right("clock", "synchronised")
    else:
        yield _note("clock", "not synchronised: the dates of logs may be off; driving does not use the date")


def disk(machine: Machine) -> Iterator[Finding]:
    """Yield findings on the recordings' disk: its free room, and whether the recorder may write there."""
    wanted = machine.wanted
    if wanted is None or machine.disk_free_mib is None:
        yield _note("disk", _NO_CONFIGURATION if wanted is None else f"{wanted.recording_folder} is not there yet")
        return
    if machine.disk_free_mib < wanted.leave_free_mib:
        yield _wrong(
            "disk",
            f"{machine.disk_free_mib} MiB free at {wanted.recording_folder}: nothing is recorded",
            f"make room: recording leaves {wanted.leave_free_mib} MiB to others ([recording] leave_free_mib)",
        )
    else:
        yield _right("disk", f"{machine.disk_free_mib} MiB free at {wanted.recording_folder}")
    if machine.folder_problem:
        yield _wrong("disk", machine.folder_problem, "sudo systemd-tmpfiles --create fsai.conf")


def permissions(machine: Machine) -> Iterator[Finding]:
    for file, problem in machine.file_problems:
        name = shlex.quote(file)
        yield _wrong("permissions", f"{file} {problem}", f"sudo chown root:fsai {name}; sudo chmod 640 {name}")
    if machine.user == "root" or "fsai" in machine.groups or machine.user == "fsai":
        yield _right("permissions", f"{machine.user} may read configuration and logs")
    else:
        yield _note(
            "permissions",
            f"{machine.user} is not in the group fsai: configuration and logs may be closed to you "
            f"(sudo usermod -aG fsai {machine.user})",
        )


def system(machine: Machine) -> Iterator[Finding]:
    yield _note("system", f"{machine.system}, Linux {machine.kernel}")


CHECKS: tuple[Callable[[Machine], Iterator[Finding]], ...] = (
    configuration,
    limits,
    interface,
    bus,
    ros,
    dds,
    shared_memory,
    services,
    scheduling,
    clock,
    disk,
    permissions,
    system,
)
LAPTOP_CHECKS: tuple[Callable[[Machine], Iterator[Finding]], ...] = (
    vcan,
    ros,
    domain,
    shared_memory,
    real_time,
    system,
    to_drive_the_car,
)


def _short(unit: str) -> str:
    return unit.removesuffix(".service").removeprefix("fsai-")


def _right(topic: str, words: str) -> Finding:
    return Finding("right", topic, words)


def _note(topic: str, words: str) -> Finding:
    return Finding("note", topic, words)


def _wrong(topic: str, words: str, todo: str) -> Finding:
    return Finding("problem", topic, words, todo)
