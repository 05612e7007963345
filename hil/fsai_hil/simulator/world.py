"""The whole far side of the bus in virtual time: car, VCU, track, cone sensor, judge and the person with the switches.

Pure: frames in, frames out, the time an argument. The same object runs in lockstep and, given the monotonic clock, as a
process on a bus. Deterministic: the same setup and the same frames at the same times give the same run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from msgspec.structs import replace

from fsai_hil.rules.response import ResponseTimes
from fsai_hil.simulator.car import Car, CarTruth
from fsai_hil.simulator.car_signals import Actuation, CarFeedback
from fsai_hil.simulator.ground_truth import Truth
from fsai_hil.simulator.judge import Judge, JudgeVerdict, check_track
from fsai_hil.simulator.operator import Operator
from fsai_hil.simulator.profiles import PROFILES
from fsai_hil.simulator.sensing import ConeSensor, SensorSettings
from fsai_hil.simulator.tracks import MISSION_TRACK, Track, load_track
from fsai_hil.simulator.vcu import SimulatedVcu
from fsai_vcu.core.driving import ConeObservation
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import codec_of
from fsai_vcu.interface.enums import OFF_LIKE, Ami, AsState
from fsai_vcu.interface.errors import did_you_mean
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.revisions import revision as revision_named
from fsai_vcu.interface.values import Value

STEP_NS: Final = 2_000_000  # the grid on which the VCU looks and the car moves on
LOOK_NS: Final = 10_000_000  # judge and operator
SAMPLE_NS: Final = 50_000_000  # what is kept for the plot
STATIC_INSPECTIONS: Final = frozenset({Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B})


class WorldSetup(Value, frozen=True, kw_only=True):
    """The parts that a world is made of. The defaults drive one mission on its own built-in track, by themselves.

    `missions` are driven one after another without a restart of anything; the first decides what `track` must be, and
    a mission that cannot be driven on it gets its own built-in one. Names are checked by `World`.
    """

    missions: Sequence[Ami]
    track: Track | None = None  # None: the first mission's own
    revision: str = "2026"
    profile: str = "specification"
    seed: int = 0
    laps: int | None = None  # of a trackdrive; None: ten
    auto: bool = True  # somebody walks the switches; else nobody does
    noise_level: float = 1.0
    sensor: SensorSettings = SensorSettings()  # its noise level is the one above
    start_timeout_s: float = 120.0  # until AS_DRIVING, where somebody walks the switches
    gps: bool = True
    gps_decimation: int = 1
    log_decimation: int = 1
    start_ns: int = 0


class PathSample(Value, frozen=True):
    """One point of the driven path: the car, and what the VCU orders of its actuators."""

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    wheels_mps: float  # as the fastest wheel turns
    speed_limit_mps: float  # at which the motors take their torque back
    steer_deg: float
    steer_order_deg: float
    throttle: float  # 0…1 of an axle's full torque, as ordered
    brake: float  # 0…1 of full pressure, as ordered
    as_state: int


@dataclass
class MissionRun:
    """One mission of the sequence."""

    mission: Ami
    track: Track
    judge: Judge
    sensor: ConeSensor
    samples: list[PathSample] = field(default_factory=list)


class World:
    """Composes everything on the car's side.

    Give it the AI computer's frames, let it `advance`, pass on what the car sends, ask it for cones.
    Raises ValueError (TrackError is one) for a setup that cannot be built.
    """

    def __init__(self, setup: WorldSetup) -> None:
        """Build the world of a setup, with the car at the start. Raises ValueError for one that cannot be built."""
        if not setup.missions:
            raise ValueError("no mission to drive")
        if setup.laps is not None and setup.laps < 1:
            raise ValueError(f"laps is {setup.laps}, but must be 1 or more")
        if setup.seed < 0:
            raise ValueError(f"seed is {setup.seed}, but must be 0 or more")
        if setup.profile not in PROFILES:
            raise ValueError(f"unknown profile {setup.profile!r}: choose one of {', '.join(PROFILES)}")
        self.setup = setup
        profile = PROFILES[setup.profile]
        revision = revision_named(setup.revision)
        self.codec = codec_of(revision)
        self.vcu = SimulatedVcu(
            self.codec, revision, profile, setup.start_ns, setup.gps, setup.gps_decimation, setup.log_decimation
        )
        car = CARS[setup.revision]
        if profile.simulators_car:
            car = CARS["official-simulator"].with_steer_limit(revision.steer_limit_deg)
        self.car = Car(car, now_ns=setup.start_ns)
        self.operator = Operator.auto(setup.revision, setup.missions) if setup.auto else Operator()
        self._sensor_settings = replace(setup.sensor, noise_level=setup.noise_level)
        self._first_track = setup.track or load_track(MISSION_TRACK.get(setup.missions[0], "static"))
        self.now_ns = setup.start_ns  # the last step: the instant of everything that can be seen
        self._next_look_ns = setup.start_ns
        self._next_sample_ns = setup.start_ns
        self.verdicts: list[JudgeVerdict] = []  # of the runs that are over
        self.runs: list[MissionRun] = []
        self._spoken_to = False
        # Between what the VCU orders and what the actuators do, and between what is true and what the sensors read.
        self.actuator_faults: list[Callable[[Actuation, int], Actuation]] = []
        self.sensor_faults: list[Callable[[CarFeedback, int], CarFeedback]] = []
        self.run = self._stage(setup.missions[0])  # the present one

    # ------------------------------------------------------------ what goes in

    def on_frame(self, frame: Frame) -> None:
        """A frame from the AI computer arrives at `frame.t_ns`."""
        self.vcu.on_frame(frame)
        self._spoken_to = True

    def advance(self, to_ns: int) -> list[Frame]:
        """Live on until `to_ns`; what the car has sent meanwhile, each frame with its time, in order.

        The world moves in steps of a fixed grid, so it does not matter in what portions time is handed over.
        """
        sent: list[Frame] = []
        now = self.now_ns + STEP_NS
        while now <= to_ns:
            self.now_ns = now
            if now >= self._next_look_ns or self._spoken_to or self.vcu.next_due_ns() <= now:
                self._spoken_to = False
                self._step(now, sent)
            now += STEP_NS
        return sent

    def _step(self, now: int, sent: list[Frame]) -> None:
        order = self.vcu.actuation
        for actuator in self.actuator_faults:
            order = actuator(order, now)
        self.car.advance(now, order)
        feedback = self.car.feedback()
        for sensor in self.sensor_faults:
            feedback = sensor(feedback, now)
        sent += self.vcu.step(now, feedback)
        if now >= self._next_look_ns:
            self._next_look_ns += LOOK_NS
            self._look(now)

    def _look(self, now: int) -> None:
        self.operator.act(now, self.vcu)
        run, state, car = self.run, self.vcu.state, self.car.truth()
        if now >= self._next_sample_ns or (run.samples and run.samples[-1].as_state != state):
            self._next_sample_ns = now + SAMPLE_NS
            run.samples.append(self._sample(now, car, state))
        if not run.judge.done:
            run.judge.observe(car, state, self.vcu.shutdown_cause)
            if run.judge.done:
                self.verdicts.append(run.judge.verdict())
        self._follow_display(state)

    def _sample(self, now: int, car: CarTruth, state: AsState) -> PathSample:
        """Return one point of the path that is kept: pose, speed, and what was asked for."""
        pose, facts, order = car.pose, self.car.facts, self.vcu.actuation
        motor_rpm = max(order.front_motor_speed_max_rpm, order.rear_motor_speed_max_rpm)
        brake_pct = max(order.front_brake_pct, order.rear_brake_pct)
        return PathSample(
            t_s=(now - self.setup.start_ns) / 1e9,
            x_m=pose.x_m,
            y_m=pose.y_m,
            yaw_rad=pose.yaw_rad,
            speed_mps=car.speed_mps,
            wheels_mps=facts.speed_of_wheel_rpm(max(car.wheel_rpm)),
            speed_limit_mps=facts.speed_of_wheel_rpm(motor_rpm / facts.gear_ratio),
            steer_deg=car.steer_deg,
            steer_order_deg=order.steer_deg,
            throttle=max(order.front_torque_nm, order.rear_torque_nm) / facts.axle_torque_max_nm,
            brake=1.0 if order.ebs_engaged else brake_pct / 100.0,
            as_state=int(state),
        )

    def _follow_display(self, state: AsState) -> None:
        """People bring the car to its start when it is off: for a mission newly chosen on the display, and after a run
        (the same mission may be driven twice)."""
        if state not in OFF_LIKE or not self.car.standing:
            return
        run, ami = self.run, self.vcu.switches.ami
        over = run.judge.done and not (self.setup.auto and self.done)
        if over or (ami is not run.mission and ami is not Ami.NOT_SELECTED and not run.judge.done):
            self.run = self._stage(run.mission if ami is Ami.NOT_SELECTED else ami)

    def _stage(self, mission: Ami) -> MissionRun:
        """Stage a mission: its track, judge and sensor, and the car at its place."""
        track = self._first_track
        again = bool(self.runs)
        if again and (mission not in MISSION_TRACK or check_track(track, mission) is not None):
            track = load_track(MISSION_TRACK.get(mission, "static"))
        facts = self.car.facts
        patience_s = self.setup.start_timeout_s if self.setup.auto else None
        judge = Judge(track, mission, facts, self.setup.laps, patience_s, self.now_ns, self.setup.start_ns)
        sensor = ConeSensor(track, self._sensor_settings, self.setup.seed + 1000 * len(self.runs))
        self.car.place(track.staging(mission, facts.nose_ahead_of_rear_axle_m), mission in STATIC_INSPECTIONS)
        run = MissionRun(mission, track, judge, sensor)
        if again and self.runs[-1].judge.waiting:
            self.runs.pop()  # nobody drove it
        self.runs.append(run)
        return run

    # ------------------------------------------------------------ what can be seen

    def next_due_ns(self) -> int:
        """Return when the car next has something to say or to do, as things stand: advance at the latest then."""
        due_ns = min(self.vcu.next_due_ns(), self._next_look_ns)
        steps = max(1, -((self.now_ns - due_ns) // STEP_NS))
        return self.now_ns + steps * STEP_NS

    def see_cones(self, t_ns: int) -> ConeObservation:
        """Return what the cone sensor reports of now: raw, noisy, in the vehicle frame, stamped `t_ns`."""
        return self.run.sensor.see(self.car.pose, t_ns)

    @property
    def truth(self) -> Truth:
        """Return the true state of the car now, as it is sent to sensors."""
        car = self.car.truth()
        return Truth(
            t_ns=car.t_ns,
            x_m=car.pose.x_m,
            y_m=car.pose.y_m,
            yaw_rad=car.pose.yaw_rad,
            speed_mps=car.speed_mps,
            yaw_rate_radps=car.yaw_rate_radps,
            steer_deg=car.steer_deg,
            as_state=self.vcu.state.label,
            mission=self.run.mission.name.lower(),
            track=self.run.track.source,
            seed=self.setup.seed,
            laps=self.run.judge.laps,
        )

    @property
    def done(self) -> bool:
        """Every mission that was asked for has been judged."""
        return len(self.verdicts) >= len(self.setup.missions)

    def verdict(self) -> JudgeVerdict:
        """The latest run's verdict: of the run in hand, or of the last one while none has begun again."""
        if not self.run.judge.done and self.run.judge.waiting and self.verdicts:
            return self.verdicts[-1]
        return self.run.judge.verdict()

    def handshake(self) -> dict[str, Any]:
        """Return how fast the AI computer echoed the handshake, as scrutineering measures it."""
        times = ResponseTimes(self.vcu.response_times_ns).as_dict()
        found = {"echoes": times["count"], "median_ms": times["p50_ms"]}
        found |= {name: times[name] for name in ("p99_ms", "p999_ms", "max_ms")}
        return found if times["count"] else {"echoes": 0}


def mission_named(name: str) -> Ami:
    """The mission of that name in any case; ValueError lists the valid ones."""
    known = {ami.name.lower(): ami for ami in Ami if ami is not Ami.NOT_SELECTED}
    try:
        return known[name.strip().lower()]
    except KeyError:
        raise ValueError(f"unknown mission {name!r}{did_you_mean(name, known)}") from None
