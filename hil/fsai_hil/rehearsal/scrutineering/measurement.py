"""The measurement: bridge, nodes, simulated car and load as processes on one bus, condition by condition.

The simulated VCU measures, as the car's does: from the instant at which a toggled HANDSHAKE was due in a 0x520 to the
arrival of its echo in a 0x510. So its own lateness is part of every figure; it is counted beside it, and the log of the
bus, stamped by the kernel, shows the time between the two frames alone.

Before that the same simulated car, under the same loads, is answered by `polling_loop.c`, a peer to compare with.

`fsai-vcu scrutineering` provides a vcan0 and runs this there, with what is to be measured as JSON. Its keys: result
(the file for what is measured, logs go beside it), conditions (names), and what Measurement takes.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fsai_hil.rehearsal.bus_watch import responses_in
from fsai_hil.rehearsal.ros_operator import RosOperator
from fsai_hil.rehearsal.scrutineering.conditions import Load, LoadCondition, conditions_named
from fsai_hil.rehearsal.scrutineering.load import BUS_BITS_PER_S, FRAME_BITS, LoadNotStarted, car_bits_per_s, loaded
from fsai_hil.rehearsal.scrutineering.machine import machine, scheduling_of
from fsai_hil.rehearsal.stack import NODES, RunningProcess, Stack, StackError, await_condition
from fsai_hil.rehearsal.stall_monitor import StallMonitor
from fsai_hil.rules.checker import read_candump
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.revisions import revision as revision_named
from fsai_vcu.runtime.lock import holder_pid
from fsai_vcu.runtime.realtime import FIFO_PRIORITY

START_S = 240.0  # interpreters that import ROS at once, on one slow processor
POWER_UP_S = 60.0
DRIVE_OFF_S = 60.0
END_S = 15.0
LAPS = 100  # more than any measurement takes
CRUISE_MPS = 2.0
MISSION, TRACK = "trackdrive", "small_oval"
_ATTEMPTS = 3
BETWEEN = "between"  # what the simulated car measures while nothing is asked
_LOOK_S = 0.5
_STALL_NS = 20_000_000  # the machine's own, from which on they are reported
_LOG_PRIORITY = FIFO_PRIORITY - 20
_MISSED_AT_THE_EDGES = 20  # echoes: log and measurement do not begin and end at the same instant
_RULES_SHOWN = 20
_LOGGED = "500:7C0"  # 0x500 to 0x53F: everything of bridge and VCU, and not the load
_PEER = "c-loop"
_NODES_NICE = -15  # of detector, planner and controller on the car PC
_PEER_SOURCE = Path(__file__).with_name("polling_loop.c")


class Measurement:
    """Measures conditions one after another. Call `run` once.

    slow_place: the frames that nobody decides on are thinned out, as one slow processor needs it.
    Raises StackError when a process does not do what it should.
    """

    def __init__(self, bus: str, folder: Path, *, seconds: float, revision: str, slow_place: bool) -> None:
        """Begin with nothing started; `slow_place` sends fewer of the car's frames."""
        self._bus = bus
        self._folder = folder
        self._seconds = seconds
        self._revision = revision
        self._slow_place = slow_place
        self._decimation = {"gps": 20, "log": 10} if slow_place else {"gps": 1, "log": 1}
        self._codec = Codec(revision_named(revision))
        self._cars = 0
        self._car: RunningProcess | None = None
        self._found: dict[str, dict[str, Any]] = {}  # by the condition's name
        self._not_measured: dict[str, str] = {}  # by it too, and why
        self._lost_between = 0
        self._windows: dict[str, tuple[int, int]] = {}  # begin and end by the wall clock, as candump stamps
        self._stack: Stack
        self._monitor: StallMonitor
        self._operator: RosOperator

    def run(self, conditions: Sequence[LoadCondition]) -> dict[str, Any]:
        """Everything measured, for JSON."""
        self._folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="scrutineering-") as memory:
            # Processes write to memory: a disk that is busy on purpose must not hold back those that measure.
            folder = Path(memory)
            try:
                with (
                    Stack(self._bus, folder, slow_place=self._slow_place) as self._stack,
                    StallMonitor(folder / "stalls") as self._monitor,
                ):
                    self._measure_peer(conditions)
                    return self._measure_all(conditions)
            finally:
                for path in sorted(folder.glob("*.log")):
                    shutil.copyfile(path, self._folder / path.name)

    def _measure_peer(self, conditions: Sequence[LoadCondition]) -> None:
        """The C loop in AS_OFF, under each load that is asked for: it drives nothing."""
        program = str(self._stack.folder / _PEER)
        try:
            build = ["cc", "-O2", "-o", program, str(_PEER_SOURCE)]
            subprocess.run(build, check=True, capture_output=True, text=True)
        except (OSError, subprocess.CalledProcessError) as error:
            reason = getattr(error, "stderr", "") or error
            raise StackError(f"{_PEER_SOURCE.name} cannot be compiled: {reason}") from error
        peer = self._stack.start(_PEER, [program, self._bus])
        car = self._switched_on()
        await_condition(lambda: _state_of(car) == AsState.AS_OFF.label, POWER_UP_S, "AS_OFF with the C loop")
        loads = list(dict.fromkeys(condition.load for condition in conditions))
        for number, load in enumerate(loads, start=1):
            condition = LoadCondition(_of_peer(load), AsState.AS_OFF, load)
            _say(f"[{number}/{len(loads)}] {_PEER}: {', '.join(each.value for each in load) or 'nothing else'}")
            self._try_to_measure(condition, (_PEER,), lambda: (_state_of(car), ""))
        self._end_car()
        self._lost_between = 0  # what follows is the bridge's
        peer.stop()
        del self._stack.processes[_PEER]

    def _measure_all(self, conditions: Sequence[LoadCondition]) -> dict[str, Any]:
        """Measure one condition after another on the running bridge; return the facts of all."""
        _say("starting the bridge")
        self._stack.start_node("vcu_bridge", revision=self._revision, car=self._revision)
        operator = self._operator = RosOperator(self._stack, "scrutineer")
        out_of_reach: dict[AsState, str] = {}
        try:
            operator.await_bridge(START_S)
            for number, condition in enumerate(conditions, start=1):
                _say(f"[{number}/{len(conditions)}] {condition.name}: {condition.words}")
                try:
                    if condition.car not in out_of_reach:
                        self._reach(condition.car)
                except StackError as error:
                    out_of_reach[condition.car] = str(error).splitlines()[0]
                why = out_of_reach.get(condition.car) or self._not_measured.get(_of_peer(condition.load))
                if why:
                    self._leave_out(condition, why)
                    continue
                watched = NODES if set(NODES) <= set(self._stack.processes) else ("vcu_bridge",)
                self._try_to_measure(condition, watched, lambda: _state(operator))
            not_measured = {each.name: why for each in conditions if (why := self._not_measured.get(each.name))}
            if len(not_measured) == len(conditions):
                raise StackError(next(iter(not_measured.values())))
            pids = {"CAN loop": holder_pid(self._bus), "vcu": self._car and self._car.popen.pid}
            scheduling = {name: scheduling_of(pid) for name, pid in pids.items() if pid}
            self._end_car()
        finally:
            operator.close()
        return {
            "revision": self._revision,
            "seconds_per_condition": self._seconds,
            "machine": machine(),
            "scheduling": scheduling,
            "decimation": self._decimation,
            "comms_losses_between": self._lost_between,
            "conditions": [self._row(condition) for condition in conditions if condition.name not in not_measured],
            "not_measured": not_measured,
        }

    def _row(self, condition: LoadCondition) -> dict[str, Any]:
        found, peer = self._found[condition.name], self._found[_of_peer(condition.load)]
        return {
            **found,
            "words": condition.words,
            "log_complete": found["wire"]["count"] >= found["response"]["count"] - _MISSED_AT_THE_EDGES,
            "peer": {name: peer[name] for name in ("response", "comms_losses", "wire")},
        }

    # ------------------------------------------------------------ how far the car has come

    def _reach(self, wanted: AsState) -> None:
        """Bring the car there; it is powered up again where it has ended, or ends on the way."""
        operator = self._operator
        for _ in range(_ATTEMPTS):
            if self._car is None or _over(operator):
                self._end_car()
                operator.state = None
                self._switched_on()
                operator.await_state(lambda state: state.as_state == AsState.AS_OFF, POWER_UP_S, "AS_OFF")
            self._bring(wanted)
            if not _over(operator):
                return
            _say(f"    on the way the car went to {operator.state.as_state_label}; it is powered up again")
        raise StackError(f"the car does not come as far as {wanted.label}: {operator.describe()}")

    def _bring(self, wanted: AsState) -> None:
        """Bring the car to the wanted state; return earlier where its run ends on the way."""
        car, operator, stack = self._car, self._operator, self._stack
        assert car is not None
        if operator.state.as_state_label == wanted.label or wanted is AsState.AS_OFF:
            return
        if set(NODES) - set(stack.processes):
            _say("starting the other nodes")
            driving: dict[str, dict[str, object]] = {
                "path_planner": {"car": self._revision, "laps": LAPS},
                "vehicle_controller": {"car": self._revision},
            }
            for name in NODES[1:]:
                process = stack.start_node(name, **driving.get(name, {}))
                with contextlib.suppress(PermissionError):  # as their services do
                    os.setpriority(os.PRIO_PROCESS, process.popen.pid, _NODES_NICE)
            operator.await_that(
                lambda: set(NODES) <= set(operator.node.get_node_names()), START_S, "all nodes are there", *NODES
            )
        if operator.state.as_state != AsState.AS_READY:
            operator.become_autonomous(POWER_UP_S, None, *NODES)
            car.type(f"ami {MISSION}")
        operator.await_that(
            lambda: list(operator.state.why_not_driving) == ["waiting for Go"] or _over(operator),
            START_S,
            "ready for Go",
            *NODES,
        )
        if wanted is AsState.AS_DRIVING and not _over(operator):
            car.give_go(lambda: operator.state.as_state != AsState.AS_READY, DRIVE_OFF_S, operator.spin)
            operator.await_that(
                lambda: operator.state.speed_mps > CRUISE_MPS or _over(operator), DRIVE_OFF_S, "the car drives", *NODES
            )

    def _switched_on(self) -> RunningProcess:
        """One power-up of the simulated car, its switches worked from here."""
        self._cars += 1
        self._start_log()
        name, stack = f"vcu-{self._cars}", self._stack
        words = ["vcu", "-i", stack.bus, "--mission", MISSION, "--track", TRACK, "--laps", str(LAPS), "--quiet"]
        words += ["--truth", str(stack.truth_port), "--result", str(stack.folder / f"{name}.json")]
        words += ["--revision", self._revision]
        words += [f"--{kind}-decimation={each}" for kind, each in self._decimation.items()]
        self._car = stack.start_verb(name, *words, stdin=subprocess.PIPE)
        _count_as(self._car, BETWEEN)
        self._car.type("on")
        return self._car

    def _end_car(self) -> None:
        car, self._car = self._car, None
        if car is None:
            return
        car.type("quit")
        car.wait(END_S)
        car.stop()
        del self._stack.processes[car.name]
        for each in json.loads((self._stack.folder / f"{car.name}.json").read_text())["measurements"]:
            if each["name"] == BETWEEN:
                self._lost_between += each["comms_losses"]
            else:
                self._found[each["name"]] |= each
        self._end_log()

    # ------------------------------------------------------------ one condition

    def _leave_out(self, condition: LoadCondition, why: str) -> None:
        """Leave a condition out with the reason: what has been measured is worth its report all the same."""
        self._not_measured[condition.name] = why
        _say(f"    not measured: {why}")

    def _try_to_measure(
        self, condition: LoadCondition, watched: Sequence[str], state: Callable[[], tuple[str, str]]
    ) -> None:
        try:
            self._measure(condition, watched, state)
        except LoadNotStarted as error:
            self._leave_out(condition, str(error).splitlines()[0])

    def _measure(self, condition: LoadCondition, watched: Sequence[str], state: Callable[[], tuple[str, str]]) -> None:
        """`watched`: processes that must live meanwhile. `state`: what the car shows, and why it stops if it does."""
        car = self._car
        assert car is not None
        car_bits = car_bits_per_s(self._revision, self._decimation["gps"], self._decimation["log"])
        ended = stood = stops = ""
        disk_file = self._folder / "disk-load"
        with loaded(self._stack, condition, disk_file, car_bits, force_disk=not self._slow_place):
            _count_as(car, condition.name)
            before, began_ns, began_wall_ns = self._traffic(), time.monotonic_ns(), time.time_ns()
            until = time.monotonic() + self._seconds
            while (left_s := until - time.monotonic()) > 0.0:
                time.sleep(min(_LOOK_S, left_s))
                self._stack.check_alive(*watched, car.name)
                shown, why = state()
                stops = why or stops
                if shown == AsState.AS_FINISHED.label and condition.car is AsState.AS_DRIVING:
                    # A stop is how it should end where the nodes get no time: the bridge goes on answering.
                    drove_s = (time.monotonic_ns() - began_ns) / 1e9
                    stood = stood or f"drove {drove_s:.0f} s, then stood" + (f": {stops}" if stops else "")
                elif shown != condition.car.label:
                    ended = f"the car went to {shown}" + (f" ({stops})" if stops else "")
                    break
            after, took_s = self._traffic(), (time.monotonic_ns() - began_ns) / 1e9
            self._windows[condition.name] = began_wall_ns, time.time_ns()
            _count_as(car, BETWEEN)
        frames, payload_bytes = after[0] - before[0], after[1] - before[1]
        bits = FRAME_BITS * frames + 8 * payload_bytes
        stalls_ns = self._monitor.stalls_ns(began_ns, _STALL_NS)
        self._found[condition.name] = {
            "frames_per_s": round(frames / took_s),
            "bus_load_pct": round(100.0 * bits / took_s / BUS_BITS_PER_S, 1),
            "machine_stalls_ms": [round(stall_ns / 1e6, 1) for stall_ns in stalls_ns],
            "ended_early": ended,
            "stood": stood,
        }
        note = f"; {ended or stood}" if ended or stood else ""
        _say(f"    {took_s:.0f} s, {frames / took_s:.0f} frames/s{note}")

    def _start_log(self) -> None:
        """One log for each power-up of the car, from before its first frame: the rules need what was before."""
        candump = self._stack.start(f"bus-{self._cars}", ["candump", "-L", f"{self._bus},{_LOGGED}"])
        with contextlib.suppress(PermissionError):
            # Below the bridge and the car, but before the load: a log with gaps in it would show nothing.
            os.sched_setscheduler(candump.popen.pid, os.SCHED_FIFO, os.sched_param(_LOG_PRIORITY))
        await_condition(lambda: candump.log_path.stat().st_size > 0, END_S, "candump receives")

    def _end_log(self) -> None:
        """Read from the log of this car what it shows of each condition."""
        candump = self._stack.processes.pop(f"bus-{self._cars}")
        candump.stop()
        windows, self._windows = self._windows, {}
        for name, (times, broken) in responses_in(read_candump(candump.log_path), self._codec, windows).items():
            self._found[name] |= {"wire": times.as_dict(), "rules_broken": broken[:_RULES_SHOWN]}

    def _traffic(self) -> tuple[int, int]:
        """Frames and payload bytes that have been sent on the interface, by everybody."""
        counters = Path("/sys/class/net") / self._bus / "statistics"
        return int((counters / "tx_packets").read_text()), int((counters / "tx_bytes").read_text())


def _of_peer(load: tuple[Load, ...]) -> str:
    """The name under which the peer's figures with that load are counted."""
    return "-".join((_PEER, *(each.name.lower() for each in load)))


def _state_of(car: RunningProcess) -> str:
    """The AS state, as the car reports it when it is asked."""
    return car.ask("status", " | ASSI ", END_S).splitlines()[-1].partition(" ")[0]


def _count_as(car: RunningProcess, name: str) -> None:
    """Returns once the car counts under that name."""
    car.ask(f"measure {name}", "measuring: ", END_S)


def _state(operator: RosOperator) -> tuple[str, str]:
    operator.spin()
    state = operator.state
    return state.as_state_label, state.emergency or state.stopping


def _over(operator: RosOperator) -> bool:
    return operator.state.as_state in (AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED)


def _say(text: str) -> None:
    print(text, flush=True)


def main() -> int:
    plan = json.loads(sys.argv[1])
    result, names = Path(plan.pop("result")), plan.pop("conditions")
    # A polite kill ends everything that was started, as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        measured = Measurement(folder=result.parent, **plan).run(conditions_named(names))
    except StackError as error:
        print(f"fsai-vcu scrutineering: {error}", file=sys.stderr, flush=True)
        return 1
    except KeyboardInterrupt:
        return 130
    result.write_text(json.dumps(measured) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
