"""The chain that all tests of this folder share: the nodes live through them, as they do on the car.

Each run is a new power-up of the car, and what a test kills it starts again.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from conftest import logged, new_folder
from fsai_hil.rehearsal.bus_watch import CODEC, BusWatch
from fsai_hil.rehearsal.ros_operator import RosOperator
from fsai_hil.rehearsal.stack import NODES, RunningProcess, Stack
from fsai_hil.rules.checker import checker_for
from fsai_vcu.interface.enums import AsState
from fsai_vcu.runtime.lock import holder_pid

REVISION = "2026"
START_S = 120.0  # five interpreters that import ROS at once, on one slow processor
POWER_UP_S = 60.0
DRIVE_S = 120.0
STOP_S = 20.0
MISSION, TRACK = "trackdrive", "small_oval"
LAPS = 100  # of a trackdrive: more than any test takes, and the most there may be
DRIVES_MPS = 1.5  # driving is driving: no test here waits for more
POWER_CYCLE_S = 1.0
SLOW_PLACE = os.environ.get("FSAI_HIL_PLACE") == "uml"  # one slow processor
OWN = dict(each.split("=", 1) for each in os.environ.get("FSAI_HIL_WITH", "").split(",") if each)  # --with


FLOOD_ID = 0x7FF
INTRUDER = bytes.fromhex("00000F0000C0FFEE")  # no torque, and not to be mistaken for a frame of ours


@pytest.fixture(autouse=True)
def silent_bus() -> None:
    """The bridge lives on between these tests, and speaks: the bus is not silent here."""


class CarRun:
    """One power-up of the simulated car, from its first frame to the end of its process."""

    def __init__(self, vcu: RunningProcess, folder: Path) -> None:
        self.vcu = vcu
        self.log_path = folder / "bus.log"
        self._verdict_path = folder / "verdict.json"

    def type(self, line: str) -> None:
        """A command typed at the interactive simulated car."""
        self.vcu.type(line)

    def verdict(self) -> dict[str, Any]:
        """The judge's, once the car's process has ended."""
        verdict: dict[str, Any] = json.loads(self._verdict_path.read_text())
        return verdict


class Chain:
    """The nodes, the operator, and cars that come and go."""

    def __init__(self, stack: Stack, operator: RosOperator, interface: str, folder: Path) -> None:
        self.stack = stack
        self.operator = operator
        self._interface = interface
        self._folder = folder
        self._shared: CarRun | None = None

    @contextmanager
    def car(self, name: str, *arguments: str, auto: bool = True, only: Iterable[int] = ()) -> Iterator[CarRun]:
        """Powers up a car of its own for one run; at the end its process is over. only: the ids that are logged."""
        self.end_shared_car()  # there is one car on a bus
        folder = self._folder / name
        folder.mkdir(parents=True, exist_ok=True)
        log = logged(self._interface, folder, only)
        vcu = self.start_vcu(f"{name}.vcu", "--result", str(folder / "verdict.json"), *arguments, auto=auto)
        try:
            yield CarRun(vcu, folder)
        finally:
            vcu.stop()
            del self.stack.processes[f"{name}.vcu"]
            log.stop()

    def start_vcu(self, name: str, *arguments: str, auto: bool) -> RunningProcess:
        words = ["vcu", "-i", self._interface, "--revision", REVISION, "--mission", MISSION, "--track", TRACK]
        words += ["--truth", str(self.stack.truth_port), *(["--auto"] if auto else [])]
        if SLOW_PLACE:
            # The frames that nobody decides on are thinned out.
            words += ["--gps-decimation", "20", "--log-decimation", "10"]
        return self.stack.start_verb(name, *words, *arguments, stdin=subprocess.DEVNULL if auto else subprocess.PIPE)

    def shared_car(self) -> CarRun:
        """An interactive car for many runs, started where none is: `power_up` switches it off and on again."""
        if self._shared is None:
            self._shared = CarRun(self.start_vcu("car", "--laps", str(LAPS), auto=False), self._folder)
        return self._shared

    def end_shared_car(self) -> None:
        run, self._shared = self._shared, None
        if run is not None:
            run.vcu.stop()  # whichever it is by now
            del self.stack.processes["car"]

    @contextmanager
    def drive(self, folder: Path) -> Iterator[BusWatch]:
        """The shared car drives, after a power cycle unless it drives already; what was on the bus."""
        log = logged(self._interface, folder)
        try:
            self.driving_car()
            yield log
        finally:
            log.stop()

    def driving_car(self) -> None:
        """The shared car, driving: as the test before has left it, or after a power cycle."""
        drives = self._shared is not None
        run = self.shared_car()
        if drives:
            state = self.operator.await_new_state(STOP_S, "the bridge reports its state")
            drives = state.as_state == AsState.AS_DRIVING and not (state.emergency or state.stopping)
        if not drives:
            self.power_up(run)

    def drives_on(self, seconds: float = 0.0) -> None:
        """For so long, and now, the car drives in order."""
        until = time.monotonic() + seconds
        while True:
            self.operator.spin()
            assert self.state.as_state == AsState.AS_DRIVING, self.operator.describe()
            assert not self.state.emergency and not self.state.stopping, self.operator.describe()
            if time.monotonic() >= until:
                return

    def power_up(self, run: CarRun) -> None:
        """A new power cycle of the shared car, which clears whatever was latched; then it drives."""
        self.make_ready(run)
        self.operator.await_state(lambda s: s.why_not_driving == ["waiting for Go"], POWER_UP_S, "ready for Go")
        self.go(run)

    def make_ready(self, run: CarRun) -> None:
        """A new power cycle of the shared car, up to AS_READY."""
        run.type("off")
        run.type("ami not_selected")
        # No 0x520 for 1 s is what the bridge takes for a power cycle (safety rule 6); NaN before the very first one.
        self.operator.await_state(lambda s: not s.status_age_s <= POWER_CYCLE_S, POWER_UP_S, "the car is off")
        run.type("on")
        self.autonomous()
        self.operator.await_state(lambda s: s.as_state == AsState.AS_OFF, POWER_UP_S, "AS_OFF")
        run.type(f"ami {MISSION}")
        self.operator.await_state(lambda s: s.as_state == AsState.AS_READY, POWER_UP_S, "AS_READY")

    def go(self, run: CarRun) -> None:
        """Go for a car in AS_READY; wait until it drives at speed."""
        run.vcu.give_go(lambda: self.state.as_state != AsState.AS_READY, POWER_UP_S, self.operator.spin)

        def decided() -> bool:
            state = self.state  # an age that is not a number is no young one either: nothing was received yet
            over = state.as_state in (AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED) and state.status_age_s < 0.5
            return bool(over or (state.as_state == AsState.AS_DRIVING and state.speed_mps > DRIVES_MPS))

        self.operator.await_that(decided, POWER_UP_S + DRIVE_S, "the car drives", *NODES)
        assert self.state.as_state == AsState.AS_DRIVING, self.operator.describe()
        assert run.vcu.alive, run.vcu.last_words()

    @property
    def pids(self) -> dict[str, int]:
        """Of the nodes, and of the CAN loop, which has a process of its own and holds the interface."""
        loop = holder_pid(self.stack.bus)
        assert loop is not None, "nobody drives the interface"
        assert loop != self.stack.processes["vcu_bridge"].popen.pid, "the loop has a process of its own"
        return {**{name: self.stack.processes[name].popen.pid for name in NODES}, "CAN loop": loop}

    @property
    def state(self) -> Any:
        return self.operator.state

    def autonomous(self) -> None:
        """The operator's one action before a run."""
        self.operator.become_autonomous(POWER_UP_S)


@pytest.fixture(scope="package")
def chain(interface: str) -> Iterator[Chain]:
    folder = new_folder("chain")
    with Stack(interface, folder, slow_place=SLOW_PLACE, own=OWN) as stack:
        stack.start_nodes({"vcu_bridge": {"revision": REVISION, "car": REVISION}, "path_planner": {"laps": LAPS}})
        operator = RosOperator(stack)
        try:
            operator.await_bridge(START_S)
            operator.await_state(lambda _: True, START_S, "the bridge is active and reports")
            stack.check_alive()
            yield Chain(stack, operator, interface, folder)
        finally:
            operator.close()


@pytest.fixture
def drive(chain: Chain, results: Path) -> Iterator[BusWatch]:
    with chain.drive(results) as log:
        yield log


def rules_kept(wire: BusWatch, *, lost_ns: int | None = None) -> None:
    """The rules that a log shows. Frames of those who do not belong there are no part of it.

    lost_ns: when the bus was lost.
    """
    checker = checker_for(CODEC, busy_machine=True)
    frames = [frame for frame in wire.frames if not (frame.can_id == FLOOD_ID or frame.data == INTRUDER)]
    whole = len(frames) if lost_ns is None else bisect_left(frames, lost_ns, key=lambda frame: frame.t_ns)
    checker.on_frames(frames[:whole])
    if frames[whole:]:
        checker.on_bus_lost()
        checker.on_frames(frames[whole:])
    assert checker.ok, str(checker)
