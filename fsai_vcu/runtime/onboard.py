"""The whole AI computer in virtual time: planner, controller and bridge as one object, for lockstep runs.

It is the same engine, bridge, planner and controller that run on the car; only the clock is an argument, and the
delay between a sensor's instant and the plan's arrival is a number instead of a process.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.driving import ConeObservation, Motion, Plan
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.vehicle.odometry import MotionHistory
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.engine import Engine

CONTROL_PERIOD_NS = 20_000_000  # 50 Hz, as the controller's node
PERCEPTION_DELAY_NS = 40_000_000  # from the sensor's instant to the planner's input, as measured between the nodes


class OnboardComputer:
    """Everything that runs on the AI computer, driven from outside by frames, cones and the passing of time."""

    def __init__(self, bridge: Bridge, codec: Codec, planner: Planner, controller: Controller, now_ns: int) -> None:
        self.bridge = bridge
        self.planner = planner
        self.controller = controller
        self.plan: Plan | None = None
        self._out: list[Frame] = []
        self._now_ns = now_ns
        self._engine = Engine(bridge, codec, self._send, now_ns)
        self._seen: deque[ConeObservation] = deque()
        self._next_control_ns = now_ns
        self._run_id: int | None = None
        self._history = MotionHistory()
        # Fault injection sits between the parts, where a real wire or topic would be.
        self.command_filter: Callable[[VehicleCommand, int], VehicleCommand | None] | None = None

    def _send(self, frame: Frame) -> bool:
        self._out.append(Frame(frame.can_id, frame.data, self._now_ns))
        return True

    def on_frame(self, frame: Frame) -> None:
        """A frame from the car, at `frame.t_ns`."""
        self._engine.on_frame(frame)

    def on_cones(self, observation: ConeObservation) -> None:
        """Cones that a detector reports; the planner gets them after the perception's delay."""
        self._seen.append(observation)

    def advance(self, now_ns: int) -> list[Frame]:
        """Let time pass to `now_ns`; returns the frames sent."""
        self._now_ns = now_ns
        self._out = []
        while self._seen and self._seen[0].t_ns + PERCEPTION_DELAY_NS <= now_ns:
            observation = self._seen.popleft()
            if self._run_id is not None:
                self.plan = self.planner.on_cones(observation, self._history.at(observation.t_ns) or Motion())
        if now_ns >= self._next_control_ns:
            self._next_control_ns += CONTROL_PERIOD_NS
            self._control(now_ns)
        self._engine.poll(now_ns)
        return self._out

    def report(self) -> BridgeReport:
        return self.bridge.report(self._now_ns)

    def _control(self, now_ns: int) -> None:
        report = self.report()
        run = report.run
        if run.run_id != self._run_id:
            self.planner.reset(run)
            self.controller.reset(run)
            self.plan = None
            self._history.clear()
            self._run_id = run.run_id
            self.bridge.on_reset_confirmed("planner", run.run_id)
            self.bridge.on_reset_confirmed("controller", run.run_id)
        self.planner.on_run(run)
        self._history.add(report.motion)
        speeds, steer = report.vehicle.speeds, report.vehicle.steer
        command = self.controller.command(
            self.plan,
            report.motion,
            report.standing,
            speeds.all_rpm if speeds is not None else (0, 0, 0, 0),
            steer.angle_deg if steer is not None else 0.0,
            run,
            now_ns,
        )
        filtered = command if self.command_filter is None else self.command_filter(command, now_ns)
        if filtered is not None:
            self.bridge.on_command(filtered, now_ns)
