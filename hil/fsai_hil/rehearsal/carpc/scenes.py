"""Runs as a service of the rehearsed car PC: waits, looks, breaks things, and measures how long it takes to be well.

Nothing is touched by hand but what a person beside the car may touch; faults are what befalls a machine. In the middle
of the last drive the machine is rebooted, and this goes on after the next boot.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fsai_hil.rehearsal.bus_watch import HOUR_NS, BusWatch, send_signal
from fsai_hil.rehearsal.carpc import probe, wifi
from fsai_hil.rehearsal.stack import GO_AGAIN_S, RunningProcess, holds_within
from fsai_hil.rehearsal.stall_monitor import RUNS, STOOD_STILL_NS, StallMonitor
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.diagnostics.doctor.collect import listening_sockets
from fsai_vcu.interface.enums import AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import AiStatus, VcuStatus
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.runtime.lock import holder_pid
from fsai_vcu.runtime.pacing import FALLBACK_AFTER_NS
from fsai_vcu.runtime.turns import EDGE_HUNG_NS

RESULTS = Path("/results")
AGAIN = RESULTS / "again"  # there while the machine is to boot once more
# What one processor of User-Mode Linux has time for, as in the suite on vcan0.
LIGHT = ("--truth", "25510", "--quiet", "--gps-decimation", "20", "--log-decimation", "10")
NODES = ("fsai-detector", "fsai-planner", "fsai-controller")
MISSION = "trackdrive"
MISSIONS_S = 400.0
POWER_UP_S = 60.0
EBS_ARMED_S = 5.0  # in AS_READY, before the car takes Go
OFF_S = 1.2  # no 0x520 for 1 s is a power cycle (safety rule 6)
DRIVES_RPM = 60.0  # 1.6 m/s: driving is driving
AT_EASE_S = 1.5  # so long after everything is back, nothing may set off
GOODBYE_CYCLES = 5  # safety.md, on stop
FULL_S = 4.0
STRANGER_S = 6.0  # so long somebody looks around; the bridge is found in less
_SETTLE = Path("/usr/lib/fsai/settle")
_POLL_S = 0.1
_BOOT_POLL_S = 0.5  # each look takes from the one processor what the services start with

# The times within which the car PC is well again: for one processor of User-Mode Linux, on which an interpreter takes
# several times as long to start as on a car PC.
BOOT_S = 45.0  # from the kernel's start until all services are active
START_TO_FIRST_FRAME_S = 6.0  # of the bridge, which listens for 200 ms first; on a normal machine 1 s (`make bench`)
SERVICE_BACK_S = 20.0  # while the others drive on and take most of that processor; by itself a third of it
HUNG_BACK_S = SERVICE_BACK_S + 3.0 + EDGE_HUNG_NS / 1e9  # its watchdog, and what the loop waits for a silent edge
UNPLUGGED_S = 3.0
PURGED_S = 90.0  # some ten thousand files
RECORDS_AGAIN_S = 10.0
AT_REST_S = 8.0
# What the bus shows is measured against the bridge's own times. On top of each: at most one cycle, and what the machine
# may be held up without being excused.
_TIMES = BridgeConfig()
_CYCLE_S = (FALLBACK_AFTER_NS + STOOD_STILL_NS) / 1e9
TORQUE_WITHOUT_COMMANDS_S = _TIMES.command_stale_ns / 1e9 + _CYCLE_S
TORQUE_WITHOUT_DATA_S = _TIMES.sensor_stale_ns / 1e9 + _CYCLE_S
CAR_STOPS_ITSELF_S = COMMS_LOST_NS / 1e9 + _CYCLE_S  # the car's own: what it needs to see that nobody speaks

# The bridge's unit with another command, that ends, in the place of its own.
PROBE = """[Service]
Type=oneshot
ExecStart=
ExecStart={command}
StandardOutput=file:{printed}
Restart=no
WatchdogSec=0
"""


class CannotGoOn(Exception):
    """A scene has noted why it ends here."""


@dataclass(frozen=True)
class Strike:
    """A service's main process is killed or stopped in mid-drive; of_loop: the process that holds the interface.

    torque_s: within which the last torque is asked for. first: the AS state that ends the drive, where it is another
    than the one that the car ends in.
    """

    what: str
    service: str
    torque_s: float
    ends_in: AsState = AsState.AS_FINISHED
    first: AsState | None = None
    number: signal.Signals = signal.SIGKILL
    of_loop: bool = False


def strikes_of_bridge(what: str, number: signal.Signals) -> tuple[Strike, Strike]:
    """Its edge, without which the loop stops the car, and goes silent when that has finished; and the loop."""
    ends_in, first = AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED
    return (
        Strike(f"bridge {what}", "fsai-bridge", TORQUE_WITHOUT_COMMANDS_S, ends_in, first, number),
        Strike(f"CAN loop {what}", "fsai-bridge", _CYCLE_S, ends_in, None, number, of_loop=True),
    )


UNPLUGGED = Strike("plugged in", "fsai-bridge", 0.0, AsState.EMERGENCY_BRAKE)
DETECTOR_KILLED = Strike("fsai-detector killed", "fsai-detector", TORQUE_WITHOUT_DATA_S)
BRIDGE_KILLED, LOOP_KILLED = strikes_of_bridge("killed", signal.SIGKILL)
STRIKES = (
    Strike("fsai-planner killed", "fsai-planner", TORQUE_WITHOUT_DATA_S),
    Strike("fsai-controller killed", "fsai-controller", TORQUE_WITHOUT_COMMANDS_S),
    BRIDGE_KILLED,
    LOOP_KILLED,
    *strikes_of_bridge("hung", signal.SIGSTOP),
)


class Rehearsal:
    """The car PC's services put through the scenes, step by step, each with its verdict in the report."""

    def __init__(self, interface: str, missions: int, stall_monitor: StallMonitor) -> None:
        self.interface = interface
        self.missions = missions
        self.stall_monitor = stall_monitor
        self.bridge = f"fsai-bridge@{interface}"
        self.recorder = f"fsai-recorder@{interface}"
        self.bench_car = f"fsai-simulated-car@{interface}"
        self.services = (*NODES, self.bridge, self.recorder)
        report = RESULTS / "report.json"
        self.steps: list[dict[str, object]] = json.loads(report.read_text()) if report.exists() else []
        self.car: RunningProcess | None = None
        self.car_is_new = False  # switched on, and not driven yet

    def run_short(self) -> None:
        """Play the scenes that every change of the sources goes through."""
        self.booted()
        self.switch_car_on()
        watch = self.watch("on")
        watch.wait(lambda: watch.as_state is not None, POWER_UP_S)
        watch.stop()
        self.scene("the doctor", lambda: self.doctor(silent=False))
        self.scene("the sandbox", lambda: self.sandboxed(compare=False))
        self.scene(BRIDGE_KILLED.what, lambda: self.struck_in_a_drive(BRIDGE_KILLED))
        self.step("at the end all services are active", self.all_active, 60.0, SERVICE_BACK_S)

    def run(self) -> None:
        """Play the scenes of the first boot, until the machine is to be rebooted."""
        self.booted()
        self.scene("the doctor", lambda: self.doctor(silent=True))
        exposure = output("systemd-analyze", "security", "--no-pager", f"{self.bridge}.service").strip().splitlines()
        self.note(exposure[-1].strip("→ ") if exposure else "no exposure", None)
        self.scene("the sandbox", lambda: self.sandboxed(compare=True))
        self.scene("the network", self.not_found)
        self.scene("the missions", self.driven)
        self.scene("undisturbed", self.undisturbed_drive)
        for strike in STRIKES:
            self.scene(strike.what, partial(self.struck_in_a_drive, strike))
        self.scene("unplugged", self.unplugged)
        self.rebooted(1)

    def go_on(self, reboot: int) -> None:
        """Play the scenes after a reboot in mid-drive.

        reboot: above 1 the machine disturbed the last one, which is repeated as the run of that number.
        """
        self.booted()
        self.scene("after the reboot", self.after_the_reboot)
        if reboot > 1:
            self.rebooted(reboot)
            return
        self.step("at the end all services are active", self.all_active, 60.0, SERVICE_BACK_S)
        self.switched_off()
        self.upgraded()
        self.purged()

    def scene(self, name: str, play: Callable[[], None]) -> None:
        """Play it; again where it failed while the machine stood still, for then it has shown nothing."""
        for run in range(1, RUNS + 1):
            if not self.shows_nothing(name, play, run):
                return

    def shows_nothing(self, name: str, play: Callable[[], None], run: int) -> bool:
        """Play a scene; whether it is to be played again."""
        since_ns, first = time.monotonic_ns(), len(self.steps)
        try:
            play()
            failed = not all(step["passed"] for step in self.steps[first:])
        except CannotGoOn:
            failed = True
        why = self.stall_monitor.disturbed(since_ns) if failed else ""
        if why and run == RUNS:
            self.check(f"{name}: never undisturbed", False, f"in run {run} too the machine {why}")
        elif why:
            for step in self.steps[first:]:
                step["counts"] = False
            self.note(f"{name}: run {run} shows nothing: the machine {why}", None)
        return bool(why) and run < RUNS

    # ------------------------------------------------------------ the drives

    def undisturbed_drive(self) -> None:
        with self.drive("undisturbed") as watch:
            for befalls in (self.clock_stepped, self.disk_filled, self.recorder_killed):
                befalls(watch)
                self.check("and the car drives on", self.undisturbed(watch))
                if not self.undisturbed(watch):
                    raise CannotGoOn
            self.struck(watch, DETECTOR_KILLED)

    def struck_in_a_drive(self, strike: Strike) -> None:
        with self.drive(strike.what.replace(" ", "-")) as watch:
            self.struck(watch, strike)

    def after_the_reboot(self) -> None:
        self.switch_car_on()
        watch = self.watch("after")
        up = watch.wait(lambda: watch.as_state is AsState.AS_OFF, POWER_UP_S)
        self.check("after the reboot the car powers up", up)
        since_ns = time.time_ns()
        watch.wait(lambda: False, AT_EASE_S * 2)
        still = watch.as_state is AsState.AS_OFF and watch.torque_ends(since_ns) == 0
        self.note("after the reboot nothing drives by itself", AT_EASE_S * 2, passed=still)
        watch.stop()
        with self.drive("after-reboot"):
            pass

    # ------------------------------------------------------------ before the faults

    def booted(self) -> None:
        self.await_that(self.all_active, 120.0, _BOOT_POLL_S)
        active_s = max((started_s(service, "ActiveEnterTimestampMonotonic") for service in self.services), default=0.0)
        self.note("boot to ready, from the kernel's start", active_s, BOOT_S, passed=self.all_active())
        ready_s = started_s(self.bridge, "ActiveEnterTimestampMonotonic")
        self.note("the bridge at boot, from its process to READY", ready_s - self.bridge_began_s())
        self.step("fsai.target is reached", lambda: is_active("fsai.target"), 60.0, BOOT_S)

    def driven(self) -> None:
        """The car's operator walks the switches, chooses each mission, gives Go; the judge decides."""
        began = time.monotonic()
        systemctl("restart", self.bench_car)
        run = output("systemctl", "show", self.bench_car, "-p", "InvocationID", "--value").strip()
        while (verdict := self.verdict(run)) is None and time.monotonic() - began < MISSIONS_S:
            time.sleep(_POLL_S * 10)
        systemctl("stop", self.bench_car)
        (RESULTS / "verdict.json").write_text(json.dumps(verdict))
        missions = verdict["missions"] if verdict is not None else []
        words = "; ".join(f"{each['mission']}: {each['result']} {each['reasons'] or ''}".strip() for each in missions)
        passed = len(missions) == self.missions and all(each["result"] == "pass" for each in missions)
        self.note(
            f"missions driven, one after the other: {self.missions}", time.monotonic() - began, None, passed, words
        )

    def doctor(self, *, silent: bool) -> None:
        """silent: the car is not switched on yet."""
        done = subprocess.run(["fsai-vcu", "doctor", "--json"], capture_output=True, text=True, check=False)
        (RESULTS / "doctor.json").write_text(done.stdout)
        try:
            findings = json.loads(done.stdout)["findings"]
        except (ValueError, KeyError):
            self.check(f"doctor failed: {done.stderr.strip()}", False)
            return
        wrong = [f"{each['topic']}: {each['words']}" for each in findings if each["level"] == "wrong"]
        if silent:
            passed = len(wrong) == 1 and wrong[0].startswith("bus: the VCU is silent")
            self.check("doctor finds nothing wrong but a silent car", passed, "; ".join(wrong))
        else:
            received = any(each["topic"] == "bus" and each["level"] == "right" for each in findings)
            self.check("doctor finds nothing wrong", received and not wrong, "; ".join(wrong))

    # ------------------------------------------------------------ who else may do what

    def sandboxed(self, *, compare: bool) -> None:
        """Check what the bridge's sandbox refuses, and who listens on a network.

        compare: that nothing refuses it without the sandbox, else the refusals would show nothing.
        """
        if not Path(f"/sys/class/net/{wifi.INTERFACE}").exists():
            wifi.plug_in()
        for secret in probe.SECRETS:
            secret.parent.mkdir(parents=True, exist_ok=True)
            secret.write_text("nobody's business\n")
        with wifi.talked_to(probe.PORT):
            argv = [sys.executable, "-m", "fsai_hil.rehearsal.carpc.probe", self.interface]
            freely = json.loads(output(*argv) or "{}") if compare else None
            confined = json.loads(self.in_the_bridges_place(" ".join(argv)) or "{}")
        (RESULTS / "sandbox.json").write_text(json.dumps({"outside": freely, "inside": confined}, indent=1))
        if freely is not None:
            refused = [name for name, how in freely.items() if how]
            self.check("outside of a sandbox all of it is allowed", bool(freely) and not refused, ", ".join(refused))
        allowed = [name for name, how in confined.items() if not how]
        words = f"{len(confined) - len(allowed)} refused; allowed: {', '.join(allowed)}"
        self.check("inside of the bridge's, nothing but a CAN socket", allowed == [probe.CAN], words)
        listening = listening_sockets(Path("/proc/self")).values()
        local = bool(listening) and all(address.is_loopback for address in listening)
        words = f"{len(listening)} sockets, all on the loopback" if local else output("ss", "-H", "-lntup")
        self.check("nothing on this machine listens on a network", local, words)

    def in_the_bridges_place(self, command: str) -> str:
        """Return what a command prints that is run by the bridge's unit, with all that restricts it."""
        units, ours = Path("/usr/lib/systemd/system"), Path("/run/systemd/system")
        printed = Path("/run/rehearsal/probe")
        printed.unlink(missing_ok=True)
        shutil.copy(units / "fsai-bridge@.service", ours / "fsai-probe@.service")
        settings = ours / "fsai-probe@.service.d"
        shutil.copytree(units / "fsai-bridge@.service.d", settings, dirs_exist_ok=True)
        (settings / "90-probe.conf").write_text(PROBE.format(command=command, printed=printed))
        systemctl("daemon-reload")
        systemctl("start", f"fsai-probe@{self.interface}")
        return printed.read_text() if printed.exists() else ""

    def not_found(self) -> None:
        """Somebody on the team's Wi-Fi looks for the nodes; the same program on this machine finds them."""
        lines = output("fsai-vcu", "config", "environment").split()
        here = wifi.looked([], STRANGER_S * 4, dict(line.split("=", 1) for line in lines))
        self.check("a ROS program on this machine sees the bridge", here["sees_the_car"] is True, json.dumps(here))
        there = wifi.looked(wifi.from_there(), STRANGER_S, wifi.STRANGERS)
        blind = there == {"nodes": [], "subscribers": 0, "set_mode": False, "sees_the_car": False}
        words = "" if blind else json.dumps(there)
        self.note("one on the team's network sees nothing", STRANGER_S, passed=blind, words=words)

    @contextmanager
    def drive(self, name: str) -> Iterator[BusWatch]:
        """A power cycle of the car, which clears whatever was latched; then AS_OFF, AS_READY, Go, and it drives.

        Where it has just been switched on, and has not been driven yet, nothing is latched.
        """
        self.await_that(self.all_active, 60.0)
        began = time.monotonic()
        car = self.car if self.car is not None and self.car_is_new else self.switch_car_on()
        self.car_is_new = False
        watch = self.watch(name, RESULTS / f"bus-{name}.log")
        drives = watch.wait(lambda: watch.as_state is AsState.AS_OFF, POWER_UP_S)
        if drives:
            car.type(f"ami {MISSION}")
            drives = watch.wait(lambda: watch.as_state is AsState.AS_READY, POWER_UP_S)
        drives = drives and not watch.wait(lambda: watch.as_state is not AsState.AS_READY, EBS_ARMED_S)
        if drives:

            def started() -> bool:
                return watch.as_state is not AsState.AS_READY

            car.give_go(started, POWER_UP_S, lambda: watch.wait(started, GO_AGAIN_S))
        drives = drives and watch.wait(lambda: watch.fastest_rpm > DRIVES_RPM, POWER_UP_S)
        drives = drives and watch.as_state is AsState.AS_DRIVING
        words = "" if drives else f"last seen {watch.as_state and watch.as_state.label}, {watch.fastest_rpm:g} rpm"
        what = "drives, after AS_OFF, AS_READY and Go again"
        self.note(f"{name}: {what}", time.monotonic() - began, passed=drives, words=words)
        try:
            if drives:
                yield watch
            else:
                raise CannotGoOn(name)
        finally:
            watch.stop()

    def watch(self, name: str, kept: Path | None = None) -> BusWatch:
        return BusWatch(self.interface, Path(f"/run/rehearsal/{name}.log"), kept)

    def switch_car_on(self) -> RunningProcess:
        """A power cycle of the simulated car, which is no part of the car PC: no stop of a service ends it."""
        if self.car is not None:
            self.car.stop()
            time.sleep(OFF_S)
        words = ["vcu", "-i", self.interface, "--mission", MISSION, "--track", "small_oval", *LIGHT]
        argv = [sys.executable, "-m", "fsai_vcu.cli.main", *words]
        self.car = RunningProcess("car", argv, Path("/run/rehearsal/car.log"), os.environ, stdin=subprocess.PIPE)
        self.car.type("on")
        self.car_is_new = True
        return self.car

    # ------------------------------------------------------------ what must not matter

    def clock_stepped(self, watch: BusWatch) -> None:
        passed = True
        for step_s in (HOUR_NS / 1e9, -2 * HOUR_NS / 1e9, HOUR_NS / 1e9):
            now_s = time.clock_gettime(time.CLOCK_REALTIME)
            time.clock_settime(time.CLOCK_REALTIME, now_s + step_s)
            # Longer than any deadline of the table.
            passed = passed and not watch.wait(lambda: not self.undisturbed(watch), 1.0)
        self.note("the clock stepped by an hour, both ways: drives on", 3.0, passed=passed)

    def disk_filled(self, watch: BusWatch) -> None:
        """Fill the disk: the car drives on, and the recorder says so."""
        since = len(self.journal_of(self.recorder))
        fill = Path("/var/log/fill")
        since_ns = time.time_ns()
        subprocess.run(["nice", "-n", "19", "sh", "-c", f"cat /dev/zero > {fill}"], capture_output=True, check=False)
        free_kib = shutil.disk_usage("/var/log").free >> 10
        on = not watch.wait(lambda: not self.undisturbed(watch), FULL_S)
        gap_s = watch.longest_gap(since_ns) / 1e9
        fill.unlink()
        words = f"{free_kib} KiB free; longest pause of the bridge {gap_s * 1e3:.0f} ms"
        self.note("the disk full: drives on", FULL_S, passed=on, words=words)
        self.step(
            "with room again the recorder writes again",
            lambda: any("writing again" in line for line in self.journal_of(self.recorder)[since:]),
            30.0,
            RECORDS_AGAIN_S,
        )
        reported = [line for line in self.journal_of(self.recorder)[since:] if "cannot write" in line]
        self.check("it has reported that in one line", len(reported) == 1, "; ".join(reported))

    def recorder_killed(self, watch: BusWatch) -> None:
        before = main_pid(self.recorder)
        os.kill(before, signal.SIGKILL)
        self.step("the recorder killed: back", lambda: self.anew(self.recorder, before), 60.0, SERVICE_BACK_S)
        watch.read()

    def undisturbed(self, watch: BusWatch) -> bool:
        return watch.as_state is AsState.AS_DRIVING and watch.fastest_rpm > DRIVES_RPM / 2

    # ------------------------------------------------------------ what ends the drive

    def struck(self, watch: BusWatch, strike: Strike) -> None:
        """Send a service a signal: the car comes to rest, and the service comes back, both in time."""
        service = self.bridge if strike.service == "fsai-bridge" else strike.service
        before = main_pid(service)
        struck_s = time.monotonic()
        struck_ns, late_ns = send_signal((strike.of_loop and holder_pid(self.interface)) or before, strike.number)
        back = watch.wait(lambda: self.anew(service, before), 40.0)
        back_s = time.monotonic() - struck_s if back else None
        watch.wait(lambda: watch.at_rest_in(strike.ends_in), 40.0)
        within_s = HUNG_BACK_S if strike.number == signal.SIGSTOP else SERVICE_BACK_S
        if strike.first is not None:
            within_s += AT_REST_S  # the car is brought to rest before anything is started again
        self.note(f"{strike.what}: back", back_s, within_s)
        self.rested(watch, strike, struck_ns, late_ns / 1e9)
        if service == self.bridge:
            self.first_frame(watch)

    def rested(self, watch: BusWatch, strike: Strike, struck_ns: int, late_s: float = 0.0) -> None:
        """The run has ended as it must, the car stands, and nothing sets off again.

        late_s: how much later than `struck_ns` it was struck, at the latest.
        """
        what, ends_in, first = strike.what, strike.ends_in, strike.first or strike.ends_in
        watch.wait(lambda: False, AT_EASE_S)
        states = [(t_ns, image.as_state) for t_ns, image in watch.images(VcuStatus, struck_ns)]
        over = [(t_ns - struck_ns, state) for t_ns, state in states if state is not AsState.AS_DRIVING]
        if strike is not UNPLUGGED:
            self.note(f"{what}: the last torque", watch.torque_ends(struck_ns) / 1e9, strike.torque_s + late_s)
            if first is AsState.EMERGENCY_BRAKE:
                stopped_s = over[0][0] / 1e9 if over else None
                self.note(f"{what}: the car stops itself", stopped_s, CAR_STOPS_ITSELF_S + late_s)
        self.note(f"{what}: at rest", in_s(watch.rests_after(struck_ns)), AT_REST_S)
        came = [state for _, state in over]
        stays = watch.as_state is ends_in and came[:1] == [first] and set(came) <= {first, ends_in}
        words = "" if watch.as_state is None else watch.as_state.label
        self.check(f"{what}: ends in {ends_in.label} and does not drive on", stays, words)

    def bridge_began_s(self) -> float:
        """Return when the bridge's newest process was started, by the monotonic clock."""
        return started_s(self.bridge, "ExecMainStartTimestampMonotonic")

    def first_frame(self, watch: BusWatch) -> None:
        """Note the time from the start of the bridge's newest process to the first frame that it sends."""
        began_ns = int(self.bridge_began_s() * 1e9) + time.time_ns() - time.monotonic_ns()
        watch.wait(lambda: bool(watch.images(AiStatus, began_ns)), 5.0)
        first_s = in_s(watch.first(AiStatus, began_ns))
        self.note("the bridge, from its process to its first frame", first_s, START_TO_FIRST_FRAME_S)

    def unplugged(self) -> None:
        with self.drive("unplugged"):
            before = main_pid(self.bridge)
            output("ip", "link", "del", self.interface)
            self.step("unplugged: the bridge is stopped", lambda: not is_active(self.bridge), 30.0, UNPLUGGED_S)
            plugged_ns = time.time_ns()
            output("ip", "link", "add", "dev", self.interface, "type", "vcan")
            after = self.watch("plugged")
            self.step("plugged in: the bridge is back", lambda: self.anew(self.bridge, before), 60.0, SERVICE_BACK_S)
            self.step("and the recorder", lambda: is_active(self.recorder), 60.0, SERVICE_BACK_S)
            after.wait(lambda: after.at_rest_in(AsState.EMERGENCY_BRAKE), 30.0)
            self.rested(after, UNPLUGGED, plugged_ns)
            self.note("no torque since", after.torque_ends(plugged_ns) / 1e9, 0.0)
            after.stop()

    def rebooted(self, run: int) -> None:
        """Reboot the machine in mid-drive; AGAIN says what is to be done after the next boot."""

        def play() -> None:
            with self.drive("rebooted") as watch:
                self.shut_down(watch)

        again = self.shows_nothing("rebooted", play, run)
        if AGAIN.exists():
            AGAIN.write_text(f"{run + 1 if again else 1}\n")
        elif again:  # it had not come to driving
            self.rebooted(run + 1)

    def shut_down(self, watch: BusWatch) -> None:
        """The bridge's goodbye during the shutdown brakes the car to rest; this waits for it before it ends itself."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        AGAIN.touch()
        asked_ns = time.time_ns()
        systemctl("--no-block", "reboot")
        at_rest = watch.wait(lambda: watch.at_rest_in(AsState.EMERGENCY_BRAKE), 30.0)
        watch.wait(lambda: False, AT_EASE_S)
        sent = watch.images(AiStatus, asked_ns)
        watch.stop()
        what = "reboot in mid-drive"
        goodbye = [image for _, image in sent if image.estop_request]
        right = all(
            image.direction is Direction.FORWARD and image.mission_status is MissionStatus.RUNNING for image in goodbye
        )
        asked_s = in_s(watch.estop_after(asked_ns))
        # When the services are stopped is up to systemd, so this is no time of the bridge's.
        self.note(f"{what}: ESTOP_REQUEST", asked_s, passed=asked_s is not None)
        words = f"{len(goodbye)} cycles, {'FORWARD' if right else 'WRONG'}"
        self.check(f"{what}: the goodbye", right and len(goodbye) == GOODBYE_CYCLES, words)
        if asked_s is not None:
            began_ns = asked_ns + int(asked_s * 1e9)
            # A brake may rise only after a cycle without torque, and by then the car may be braking itself.
            itself = watch.first(VcuStatus, began_ns, lambda status: status.as_state is AsState.EMERGENCY_BRAKE)
            soonest_s = in_s(min(watch.brakes_after(began_ns), itself))
            passed = watch.torque_ends(began_ns) == 0
            self.note(f"{what}: brake asked for or EMERGENCY_BRAKE, no torque", soonest_s, 0.1, passed=passed)
            self.note(f"{what}: silence begins", (sent[-1][0] - began_ns) / 1e9, 0.2)
            self.note(f"{what}: at rest", in_s(watch.rests_after(began_ns)), AT_REST_S, passed=at_rest)

    def switched_off(self) -> None:
        """Switched off by hand, nobody sends, not even when an adapter is plugged in; the bus named, all are back."""
        subprocess.run([_SETTLE, "can9"], check=True)
        passed = self.await_that(lambda: not is_active(self.bridge), UNPLUGGED_S)
        self.check("another bus named: nobody goes on sending on this one", passed)
        subprocess.run([_SETTLE, "--off"], check=True)
        output("ip", "link", "del", self.interface)
        device = f"sys-subsystem-net-devices-{self.interface}.device"
        self.await_that(lambda: not is_active(device), SERVICE_BACK_S)
        output("ip", "link", "add", "dev", self.interface, "type", "vcan")
        self.step("switched off, then plugged in", lambda: is_active(device), 30.0, SERVICE_BACK_S)

        def woken() -> set[str]:
            return set(output("systemctl", "is-active", *self.services).split()) - {"inactive", "failed"}

        passed = not self.await_that(lambda: bool(woken()), UNPLUGGED_S, _BOOT_POLL_S)
        self.check("nobody starts", passed)
        subprocess.run([_SETTLE, self.interface], check=True)
        systemctl("start", "--no-block", "fsai.target")
        self.step("the bus named again: all services are active", self.all_active, 60.0, BOOT_S)

    def upgraded(self) -> None:
        """Do what dpkg does before and after it puts a newer package's files over these."""
        scripts = Path("/var/lib/dpkg/info")
        subprocess.run(["sh", scripts / "fsai-vcu.prerm", "upgrade", "9"], check=True)
        active = [service for service in self.services if is_active(service)]
        self.check("an upgrade: nothing runs while files are replaced", not active, ", ".join(active))
        began = time.monotonic()
        subprocess.run(["sh", scripts / "fsai-vcu.postinst", "configure", "1"], check=True)
        passed = self.await_that(self.all_active, BOOT_S, _BOOT_POLL_S)
        self.note("an upgrade: what ran runs again", time.monotonic() - began, BOOT_S, passed=passed)

    def purged(self) -> None:
        """The package is taken away, and nothing of it is left but the logs of the drives."""
        began = time.monotonic()
        done = subprocess.run(["dpkg", "--purge", "fsai-vcu"], capture_output=True, text=True, check=False)
        took_s = time.monotonic() - began
        words = done.stderr.strip()[-200:]
        self.note("dpkg --purge", took_s, PURGED_S, passed=done.returncode == 0, words=words)
        places = ("/opt/fsai", "/usr/lib/fsai", "/usr/share/fsai", "/usr/bin/fsai-vcu", "/etc/fsai")
        left = [place for place in places if Path(place).exists()]
        for pattern in ("usr/lib/systemd/system/fsai*", "etc/systemd/system/*.wants/fsai-bridge*"):
            left += [str(path) for path in Path("/").glob(pattern)]
        left += [service for service in self.services if is_active(service)]
        self.check("nothing of it is left", not left, ", ".join(left))
        logs = list(Path("/var/log/fsai").glob("*"))
        self.check("but the logs of the drives", bool(logs), f"{len(logs)}")

    # ------------------------------------------------------------ conditions

    def all_active(self) -> bool:
        return output("systemctl", "is-active", *self.services).split() == ["active"] * len(self.services)

    def anew(self, service: str, before: int) -> bool:
        return is_active(service) and main_pid(service) not in (0, before)

    def verdict(self, run: str) -> dict[str, list[dict[str, object]]] | None:
        """The judge's of that run of the car, once it has ended."""
        lines = output("journalctl", "-o", "cat", f"_SYSTEMD_INVOCATION_ID={run}").splitlines()
        return next((json.loads(line) for line in reversed(lines) if line.startswith("{")), None)

    def journal_of(self, service: str) -> list[str]:
        return output("journalctl", "-b", "-o", "cat", "-u", service).splitlines()

    # ------------------------------------------------------------ the report

    def await_that(self, condition: Callable[[], bool], patience_s: float, poll_s: float = _POLL_S) -> bool:
        return holds_within(condition, patience_s, lambda: time.sleep(poll_s))

    def step(self, what: str, condition: Callable[[], bool], patience_s: float, within_s: float) -> None:
        """Await `condition`; how long it took is the step's time."""
        began = time.monotonic()
        passed = self.await_that(condition, patience_s)
        self.note(what, time.monotonic() - began, within_s, passed)

    def note(
        self, what: str, seconds: float | None, within_s: float | None = None, passed: bool = True, words: str = ""
    ) -> None:
        """within_s: the time that is stated for it."""
        passed = passed and (within_s is None or (seconds is not None and seconds <= within_s))
        self.steps.append(
            {"what": what, "seconds": seconds, "within": within_s, "passed": passed, "words": words, "counts": True}
        )
        took, stated = ("" if each is None else f"{each:.2f} s" for each in (seconds, within_s))
        print(f"{'ok   ' if passed else 'WRONG'} {took:>10} {stated:>10}   {what}  {words}".rstrip(), flush=True)
        (RESULTS / "report.json").write_text(json.dumps(self.steps, indent=1))

    def check(self, what: str, passed: bool, words: str = "") -> None:
        """A step that takes no time."""
        self.note(what, None, None, passed, words)


def in_s(time_ns: float) -> float | None:
    """None for what never was."""
    return None if math.isinf(time_ns) else time_ns / 1e9


def output(*argv: str) -> str:
    return subprocess.run(argv, capture_output=True, text=True, check=False).stdout


def systemctl(*words: str) -> None:
    subprocess.run(["systemctl", *words], check=False)


def is_active(unit: str) -> bool:
    return output("systemctl", "is-active", unit).strip() == "active"


def main_pid(service: str) -> int:
    return int(output("systemctl", "show", service, "-p", "MainPID", "--value").strip() or 0)


def started_s(service: str, what: str) -> float:
    """An instant of the monotonic clock that systemd noted."""
    return int(output("systemctl", "show", service, "-p", what, "--value").strip() or 0) / 1e6


def main() -> int:
    """Play the scenes on the booted machine, those after a reboot as well; return the exit status."""
    parser = argparse.ArgumentParser()
    parser.add_argument("interface")
    parser.add_argument("missions", type=int)
    parser.add_argument("--short", action="store_true")
    args = parser.parse_args()
    reboot = int(AGAIN.read_text().strip() or 0) if AGAIN.exists() else 0  # 0 on the first boot
    AGAIN.unlink(missing_ok=True)
    with StallMonitor(Path("/run/rehearsal/stall_monitor")) as stall_monitor:
        rehearsal = Rehearsal(args.interface, args.missions, stall_monitor)
        try:
            if reboot:
                rehearsal.go_on(reboot)
            elif args.short:
                rehearsal.run_short()
            else:
                rehearsal.run()
        except Exception as error:
            AGAIN.unlink(missing_ok=True)
            rehearsal.note(f"the rehearsal itself failed: {type(error).__name__}: {error}", None, passed=False)
            raise
        finally:
            journal = f"journal-after-reboot-{reboot}.txt" if reboot else "journal.txt"
            (RESULTS / journal).write_text(output("journalctl", "-b", "--no-pager"))
            if not AGAIN.exists():
                systemctl("poweroff", "--force")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
