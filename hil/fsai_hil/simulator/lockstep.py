"""The whole AI side against the whole car in virtual time: nothing waits, and the same seed is the same run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from msgspec.structs import replace

from fsai_hil.rules.checker import WireChecker
from fsai_hil.simulator.ai_computer import OnboardComputer
from fsai_hil.simulator.judge import JudgeVerdict
from fsai_hil.simulator.watched_bridge import WatchedBridge, process_of
from fsai_hil.simulator.world import World, WorldSetup
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.driving import ConeObservation
from fsai_vcu.core.limits import UNLIMITED, OperationalLimits
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.config import BridgeConfig, official_simulator
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import S
from fsai_vcu.interface.values import Value

STEP_NS = 1_000_000  # the bus is looked at every millisecond
CONE_PERIOD_NS = 50_000_000  # 20 Hz, as a camera or lidar pipeline
CONFIDENCE_THRESHOLD = 0.5  # the detector's default
PROGRESS_PERIOD_NS = 500_000_000
RUNS_OF_A_PROCESS = 1_000_000


class LockstepResult(Value, frozen=True):
    """A run in lockstep: what the judge saw, what the wire showed, what the bridge reported at the end."""

    verdict: JudgeVerdict
    wire: WireChecker
    report: BridgeReport
    sim_time_s: float
    wall_time_s: float
    seed: int
    faults: tuple[str, ...]

    @property
    def passed(self) -> bool:
        return self.verdict.passed and self.wire.ok

    def as_dict(self) -> dict[str, Any]:
        """Return the result as an object for JSON: the verdict's keys and the run's own."""
        reasons = [*self.verdict.reasons, *(f"on the wire: {violation}" for violation in self.wire.violations[:10])]
        return {
            **self.verdict.as_dict(),
            "result": "pass" if self.passed else "fail",
            "reasons": reasons,
            "faults": list(self.faults),
            "gate_reasons": dict(self.report.reason_counts),
            "emergency": self.report.emergency,
            "response_p50_ms": self.wire.responses.quantile_ms(0.5),
            "response_max_ms": self.wire.responses.quantile_ms(1.0),
            "sim_time_s": round(self.sim_time_s, 3),
            "wall_time_s": round(self.wall_time_s, 3),
            "seed": self.seed,
        }


class Lockstep:
    """World and onboard computer, side by side in virtual time."""

    def __init__(
        self,
        setup: WorldSetup,
        *,
        limits: OperationalLimits | None = None,
        controller: ControllerSettings | None = None,
        on_frame: Callable[[Frame], None] | None = None,
    ) -> None:
        """`on_frame` sees every frame of the bus, in order (a log).

        Raises ValueError for a setup that cannot be built.
        """
        self.world = World(setup)
        car = self.world.car.facts
        config = BridgeConfig()
        if setup.profile == "official-simulator":
            config = official_simulator(config)
        missions = MissionSettings() if setup.laps is None else MissionSettings(trackdrive_laps=setup.laps)
        settings = controller or ControllerSettings()
        if limits is not None:
            settings = replace(settings, max_speed_mps=min(settings.max_speed_mps, limits.max_speed_mps))
        self.now_ns = setup.start_ns
        codec = self.world.codec
        self._new_bridge = partial(WatchedBridge, codec, self.world.vcu.revision, car, config, limits)
        new_planner = partial(Planner, car, missions=missions)
        new_controller = partial(Controller, car, settings, missions)
        self._new = {"planner": new_planner, "controller": new_controller}
        self._first_run_id = 1
        bridge = self._new_bridge(self._first_run_id, now_ns=self.now_ns)
        self.computer = OnboardComputer(bridge, codec, new_planner(), new_controller(), self.now_ns)
        # The checker stands in the bridge's own place: it is told what the bridge receives, is asked and sends.
        self.wire = WireChecker(
            codec,
            in_flight_ns=0,
            handshake_in_flight_ns=0,
            clock_slack_ns=0,
            car=car,
            limits=limits or UNLIMITED,
            from_start=True,
            motor_brakes=config.motor_brakes,
            short_sequence=config.short_sequence_allowed,
            process=process_of(config, follows=True),
        )
        self.computer.checker = bridge.checker = self.wire
        self.on_frame = on_frame
        self._next_cones_ns = self.now_ns
        self._asked_autonomous = False
        self.detector: Callable[[ConeObservation], ConeObservation] = confident
        self.detects = True  # False: the detector has stopped

    @property
    def bridge(self) -> Bridge:
        """The bridge in hand: a restart brings another one."""
        return self.computer.bridge

    def start_bridge(self) -> None:
        """The bridge's process is started again: it knows nothing, and is in manual mode."""
        # On the car a new process draws a first run id that no earlier one can have used.
        self._first_run_id += RUNS_OF_A_PROCESS
        self.wire.restarted()
        bridge = self._new_bridge(self._first_run_id, now_ns=self.now_ns)
        bridge.checker = self.wire
        self.computer.start_bridge(bridge, self.now_ns)

    def start(self, process: str) -> None:
        """The planner's or the controller's process is started again."""
        self.computer.start(process, self._new[process]())

    def intrude(self, frame: Frame) -> None:
        """Somebody else's frame is on the bus: everybody receives it."""
        if self.on_frame is not None:
            self.on_frame(frame)
        self.computer.on_frames((frame,))
        self.world.on_frame(frame)

    def step(self) -> None:
        """One millisecond."""
        self.now_ns = now_ns = self.now_ns + STEP_NS
        if frames := self.world.advance(now_ns):
            self._see(frames)
            self.computer.on_frames(frames)
        if now_ns >= self._next_cones_ns:
            self._next_cones_ns += CONE_PERIOD_NS
            seen = self.detector(self.world.see_cones(now_ns))
            if self.detects:
                self.computer.on_cones(seen)
        if not self._asked_autonomous:
            # What the operator types once: the mode is kept for every mission after it.
            self._asked_autonomous = self.bridge.set_mode("autonomous", now_ns)[0]
        if frames := self.computer.advance(now_ns):
            self._see(frames)
            for frame in frames:
                self.world.on_frame(frame)

    def _see(self, frames: Iterable[Frame]) -> None:
        if self.on_frame is not None:
            for frame in frames:
                self.on_frame(frame)

    def run(
        self,
        progress: Callable[[World, BridgeReport], None] | None = None,
        *,
        realtime: bool = False,
    ) -> LockstepResult:
        """Drive until the judge has seen every mission. `progress` is called twice a simulated second."""
        began = time.monotonic()
        start_ns = self.now_ns
        next_progress_ns = start_ns
        while not self.world.done:
            self.step()
            if self.now_ns >= next_progress_ns:
                next_progress_ns += PROGRESS_PERIOD_NS
                if progress is not None:
                    progress(self.world, self.computer.report())
            if realtime:
                ahead_s = (self.now_ns - start_ns) / S - (time.monotonic() - began)
                if ahead_s > 0:
                    time.sleep(ahead_s)
        report = self.computer.report()
        return LockstepResult(
            self.world.verdict(),
            self.wire,
            report,
            (self.now_ns - start_ns) / S,
            time.monotonic() - began,
            self.world.setup.seed,
            self.world.vcu.faults.names,
        )


def confident(observation: ConeObservation, threshold: float = CONFIDENCE_THRESHOLD) -> ConeObservation:
    """Only the cones that a detector is sure enough of."""
    keep = observation.confidence >= threshold
    return ConeObservation(
        observation.t_ns, observation.xy_m[keep], observation.color[keep], observation.confidence[keep]
    )
