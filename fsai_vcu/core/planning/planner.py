"""The planner: cones and motion in, plan out.

One strategy per family of missions: a lane found in the cones around the car (autocross, trackdrive), a straight line
(acceleration), a figure of eight known beforehand (skidpad). Missions without a path get no plan.
"""

from __future__ import annotations

from msgspec.structs import replace

from fsai_vcu.core.driving import ConeObservation, Motion, Plan, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.acceleration_strategy import AccelerationStrategy
from fsai_vcu.core.planning.cone_memory import ConeMemory, believable
from fsai_vcu.core.planning.course import Course, Evidence, Strategy
from fsai_vcu.core.planning.lap_strategy import LapStrategy
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.planning.skidpad_strategy import SkidpadStrategy
from fsai_vcu.core.vehicle.odometry import motion_at, slipped
from fsai_vcu.core.vehicle.parameters import SLIP_RADPMPS2, VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState

COURSE_FIELDS = tuple(name for name in Course.__struct_fields__ if name != "slip")
DOUBT_BY_CONES = 0.2  # of confidence at most is lost to cones that are none or displaced: no reason to stop


class Planner:
    """Cones to a path, for the run in hand. `reset` forgets everything."""

    def __init__(
        self,
        car: VehicleParameters,
        settings: PlannerSettings | None = None,
        missions: MissionSettings | None = None,
    ) -> None:
        self._car = car
        self._settings = settings or PlannerSettings()
        self._missions = missions or MissionSettings()
        self._memory = ConeMemory(self._settings)
        self.reset(Run(run_id=0))

    @property
    def run(self) -> Run:
        return self._run

    def reset(self, run: Run) -> None:
        """Forget everything: `run` begins. Until `on_run` says more, the staging place is the odometry's origin."""
        self._run = run
        self._memory.clear()
        self._strategy = self._strategy_for(run.mission)
        self._evidence = Evidence(self._car.least_radius_m)
        self._last: Motion | None = None  # as odometry has it …
        self._place = Motion()  # … and, in laps, with what the tyres slipped sideways
        self._slip_radpmps2 = SLIP_RADPMPS2
        self._anchor_due = False  # at the next observation: the car stands there for 3 s

    def on_run(self, run: Run) -> None:
        """The run goes on, perhaps in another AS state; another run (id or mission) resets.

        With AS_DRIVING the place where the car stands is its staging place, however it was pushed there before.
        """
        if run.run_id != self._run.run_id or run.mission != self._run.mission:
            self.reset(run)
            return
        starts = run.as_state is AsState.AS_DRIVING and self._run.as_state is not AsState.AS_DRIVING
        self._run = run
        self._anchor_due |= starts

    def on_cones(self, obs: ConeObservation, motion: Motion) -> Plan | None:
        """The plan after an observation; None where the mission needs no path.

        `motion` may be of another instant than the observation, by some tens of ms: it is carried to it.
        """
        there = motion_at(motion, obs.t_ns)
        if self._last is not None and there.distance_m < self._last.distance_m - 1.0:
            self.reset(self._run)  # odometry began again: nothing remembered is where it was
        if self._last is None or not isinstance(self._strategy, LapStrategy):
            self._place = there
        else:
            self._place = slipped(self._place, self._last, there, self._slip_radpmps2)
        self._last, there = there, self._place
        if self._strategy is None:
            return None
        if self._anchor_due:
            self._anchor_due = False
            self._strategy.anchor(there)
            self._evidence = Evidence(self._car.least_radius_m)
        xy, color = believable(obs, self._settings)
        self._memory.add(xy, color, there)
        course = self._evidence.judged(self._strategy.plan(self._memory, xy, there), there)
        self._slip_radpmps2 = course.slip.radpmps2
        course = replace(course, confidence=min(course.confidence, 1.0 - DOUBT_BY_CONES * self._memory.doubt))
        return Plan(
            t_sensor_ns=obs.t_ns,
            run_id=self._run.run_id,
            mission=self._run.mission,
            slip_radpmps2=course.slip.measured_radpmps2,
            **{name: getattr(course, name) for name in COURSE_FIELDS},
            cones_count_actual=len(xy),
            cones_count_all=self._memory.total,
        )

    def _strategy_for(self, mission: Ami) -> Strategy | None:
        car, settings, missions = self._car, self._settings, self._missions
        if mission is Ami.AUTOCROSS:
            return LapStrategy(car, settings, missions, missions.autocross_laps)
        if mission is Ami.TRACKDRIVE:
            return LapStrategy(car, settings, missions, missions.trackdrive_laps)
        if mission is Ami.ACCELERATION:
            return AccelerationStrategy(car, settings, missions)
        if mission is Ami.SKIDPAD:
            return SkidpadStrategy(car, settings, missions)
        return None
