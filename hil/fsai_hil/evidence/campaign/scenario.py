"""Drives one case: from a snapshot or from power-up, through the fault, to the end of what follows from it."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

from fsai_hil.evidence.campaign.cases import LEGS_MS, WINDOW_MS, Case, Since
from fsai_hil.evidence.campaign.faults.kind import Ongoing
from fsai_hil.evidence.campaign.observation import Observer
from fsai_hil.evidence.campaign.verdict import SUPERVISED_MS, CaseVerdict, as_record, judge
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.tracks import load_track
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import MS

AFTERMATH_MS: Final = 4_200  # so long after a fault begins, or ends, all that the rules demand has happened
FINISHING_MS: Final = 10_000  # … and so long, where the mission's end comes meanwhile, until it is AS_FINISHED
DRIVING_MS: Final = 1_500  # a car that has torque so long after a fault is over drives on
DRIVING_ALONG_MS: Final = 3_000  # the same for a fault that lasts
SETTLED_MS: Final = 1_500  # so long after a run's end it is clear that nothing moves again
LONGEST_MS: Final = 120_000
LONGEST_TRACKDRIVE_MS: Final = 600_000  # ten laps
ENDED: Final = frozenset({AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE})
SNAPSHOTS_KEPT: Final = 200

CIRCUITS: Final = frozenset({Ami.AUTOCROSS, Ami.TRACKDRIVE})
World = tuple[Ami, str, int, bool]  # `Case.world`


def power_up(world: World, on_frame: Callable[[Frame], None] | None = None) -> Lockstep:
    """A run before anything has happened."""
    mission, revision, seed, gps = world
    # every second world of a mission in circuits has one of its own
    track = load_track(f"generated-{seed}") if mission in CIRCUITS and seed % 2 else None
    setup = WorldSetup(missions=[mission], track=track, revision=revision, seed=seed, gps=gps, start_timeout_s=40.0)
    rig = Lockstep(setup, on_frame=on_frame)
    rig.computer.confine_failures = True
    return rig


class Snapshots:
    """Runs that are already in AS_DRIVING, each driven there once and copied for every case."""

    def __init__(self, new_log: Callable[[], Callable[[Frame], None]] | None = None) -> None:
        """`new_log` makes what receives every frame of a run; it is copied with the run."""
        self._new_log = new_log
        self._driven = lru_cache(SNAPSHOTS_KEPT)(self._drive)

    def rig(self, case: Case) -> Lockstep:
        leg_ms = case.leg_ms
        return self._power_up(case.world) if leg_ms is None else copy.deepcopy(self._driven(case.world, leg_ms))

    def _drive(self, world: World, leg_ms: int) -> Lockstep:
        earlier = [leg for leg in LEGS_MS[world[0]] if leg < leg_ms]
        rig = copy.deepcopy(self._driven(world, earlier[-1])) if earlier else self._power_up(world)
        drive_to(rig, leg_ms)
        return rig

    def _power_up(self, world: World) -> Lockstep:
        return power_up(world, None if self._new_log is None else self._new_log())


def drive_to(rig: Lockstep, leg_ms: int) -> None:
    """Drive on until the car has been in AS_DRIVING for so long. Raises RuntimeError if it never is."""
    while True:
        began_ns = moment_ns(rig, Since.DRIVING)
        if began_ns is not None and rig.now_ns >= began_ns + leg_ms * MS:
            return
        if rig.now_ns > LONGEST_MS * MS:
            raise RuntimeError("the car does not come to AS_DRIVING by itself")
        rig.step()


def moment_ns(rig: Lockstep, since: Since) -> int | None:
    """Return when a moment of the run was; None: not yet."""
    if since.state is None:
        return rig.world.setup.start_ns
    ended = ENDED if since is Since.FINISHED else (since.state,)
    return next((t_ns for t_ns, state in rig.world.vcu.history if state in ended), None)


class Scenario:
    """One case under way. `step` until `over`; then `verdict`."""

    def __init__(self, case: Case, rig: Lockstep, window_ms: int = WINDOW_MS) -> None:
        self.case = case
        self.rig = rig
        self._began_ns = rig.now_ns
        self._window_ms = window_ms
        self._observer = Observer(rig)
        self.seen = self._observer.seen
        self._fault = Ongoing()
        self.fault_ns: int | None = None
        self.fault_over_ns: int | None = None
        self._duration_ms: int | None = case.params.get("duration")
        self._longest_ms = LONGEST_TRACKDRIVE_MS if case.mission is Ami.TRACKDRIVE else LONGEST_MS
        self._left_course = 0  # before the fault

    def step(self) -> None:
        """One millisecond, with what the fault does in it."""
        rig, case = self.rig, self.case
        now_ns = rig.now_ns
        if self.fault_ns is None:
            since_ns = moment_ns(rig, case.since)
            if since_ns is not None and now_ns - since_ns >= case.after_ms * MS:
                self.fault_ns = now_ns
                self._observer.fault_begins()
                self._left_course = rig.world.run.judge.verdict().off_course
                case.kind.begin(self._fault, rig, case.params, now_ns)
        if self.fault_ns is not None:
            for tick in self._fault.ticks:
                tick(now_ns)
            lasts_ms = self._duration_ms
            if self.fault_over_ns is None and lasts_ms is not None and now_ns >= self.fault_ns + lasts_ms * MS:
                self.fault_over_ns = now_ns
                self._fault.end.close()
        rig.step()
        self._observer.look(self.fault_ns)

    @property
    def over(self) -> bool:
        """Return whether the run has shown all it can: it ended, lasted long enough, or no fault can follow."""
        now_ns = self.rig.now_ns
        lasted_ms = (now_ns - self._began_ns) / MS
        if lasted_ms >= self._longest_ms:
            return True
        since_ns, state = self.rig.world.vcu.history[-1]
        stands = self.rig.world.car.standing
        ended = state in ENDED and stands
        if self.fault_ns is None:
            # the mission was over first, unless that is what the fault waits for
            waits = self.case.since is Since.FINISHED and not self.rig.world.vcu.shut_down
            return not waits and (self.rig.world.done or (ended and now_ns >= since_ns + SETTLED_MS * MS))
        end_ns = self.fault_ns
        if self._duration_ms is not None:
            end_ns += self._duration_ms * MS
        if self.rig.world.done and now_ns >= end_ns + SETTLED_MS * MS:
            return True
        if ended:
            return now_ns >= max(since_ns, end_ns) + SETTLED_MS * MS
        if state in ENDED:
            return False  # until it stands
        if self.case.full:
            return False
        from_ns: int | None = self._began_ns
        if self.case.kind.from_start:
            driving_ns = moment_ns(self.rig, Since.DRIVING)
            from_ns = None if driving_ns is None else driving_ns + SUPERVISED_MS * MS
        if from_ns is None or now_ns < from_ns + self._window_ms * MS:
            return False
        plan = self.rig.computer.plan
        if now_ns >= end_ns + (FINISHING_MS if plan is not None and plan.finished else AFTERMATH_MS) * MS:
            return True
        clear_ms = DRIVING_MS if self._duration_ms is not None else DRIVING_ALONG_MS
        return now_ns >= end_ns + clear_ms * MS and max(self.rig.wire.seen.torque_nm) > 0.0

    def verdict(self) -> CaseVerdict:
        rig, seen = self.rig, self.seen
        seen.ran_out = rig.now_ns - self._began_ns >= self._longest_ms * MS
        seen.left_course = max(0, rig.world.run.judge.verdict().off_course - self._left_course)
        crashes = [f"the {process}'s process ended: {what}" for _, process, what in rig.computer.failures]
        return judge(self.case, seen, self.fault_ns, rig.wire.violations, crashes)


def run_case(case: Case, snapshots: Snapshots, window_ms: int = WINDOW_MS) -> dict[str, Any]:
    """Drive a case; its line of the record."""
    scenario = Scenario(case, snapshots.rig(case), window_ms)
    while not scenario.over:
        scenario.step()
    verdict = scenario.verdict()
    rig = scenario.rig
    extra: dict[str, Any] = {
        "speed_mps": scenario.seen.speed_mps,
        "sim_s": round((rig.now_ns - scenario._began_ns) / 1e9, 2),
        "off_course": scenario.seen.left_course,
    }
    return as_record(case, verdict, extra)
