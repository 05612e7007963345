"""The whole AI computer in virtual time: planner, controller and bridge as one object, for lockstep runs.

It is the same loop, bridge, planner and controller that run on the car; only the clock is an argument, and the
delay between a sensor's instant and the plan's arrival is a number instead of a process.

On the car planner and controller are processes, and the bridge is two: the loop that owns the bus, and its edge to ROS.
Processes fail: they hang, end and are started again, and the bus under them fills up or goes. All of that can be done
to them here as well, with the effect it has there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence

from fsai_hil.rules.checker import WireChecker
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.driving import ConeObservation, Motion, Plan, Run
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.vehicle.odometry import MotionHistory
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.link import Message, ResetConfirmed
from fsai_vcu.runtime.turns import Action, Do, Send, Turns

CONTROL_PERIOD_NS = 20_000_000  # 50 Hz, as the controller's node
PERCEPTION_DELAY_NS = 40_000_000  # from the sensor's instant to the planner's input, as measured between the nodes
RECEIVE_BUFFER_FRAMES = 256  # what a socket keeps for a process that does not read: about 200 kB, some 830 B a frame


class OnboardComputer:
    """Everything that runs on the AI computer, driven from outside by frames, cones and the passing of time."""

    def __init__(self, bridge: Bridge, codec: Codec, planner: Planner, controller: Controller, now_ns: int) -> None:
        """Begin with all processes running, nothing received and no fault."""
        self.bridge = bridge
        self.planner = planner
        self.controller = controller
        self.plan: Plan | None = None
        self.commanded: VehicleCommand | None = None  # the controller's newest, before any filter
        self._codec = codec
        self._out: list[Frame] = []
        self._now_ns = now_ns
        self._turns = Turns(bridge, codec, now_ns)
        self._seen: deque[ConeObservation] = deque()
        self._next_control_ns = now_ns
        self._run_ids: dict[str, int] = {}  # of the run that a process has begun
        self._history = MotionHistory()
        self.checker: WireChecker | None = None  # is told what leaves

        # Fault injection sits between the parts, where a real wire or topic would be.
        self.command_filter: Callable[[VehicleCommand, int], VehicleCommand | None] | None = None
        self.plan_filter: Callable[[Plan | None, int], Plan | None] | None = None
        self.takes_frame: Callable[[Frame], bool] | None = None  # False: the transmit queue is full (ENOBUFS)
        self.planner_running = True
        self.controller_running = True
        self.bridge_running = True
        self.edge_running = True
        self._hung_until_ns: int | None = None
        self._edge_hung_until_ns: int | None = None
        self._unread: list[Frame] = []
        self._unheard: list[Message] = []  # what a hanging loop or edge has not read
        self._last_report: BridgeReport | None = None  # what was published last before a hang
        self._no_bus_until_ns: float = -math.inf
        self._broken: str | None = None  # why the bus is gone, as far as the loop has not noticed
        self.confine_failures = False  # an exception ends the process it comes from, not the simulation
        self.failures: list[tuple[int, str, str]] = []  # when, which process, what

    def _takes(self, frame: Frame) -> bool:
        if self.takes_frame is not None and not self.takes_frame(frame):
            return False
        self._out.append(frame)
        if self.checker is not None:
            self.checker.on_sending()
            self.checker.on_frames((frame,))
        return True

    def on_frames(self, frames: Sequence[Frame]) -> None:
        """Frames from the car, oldest first, at the `t_ns` of each."""
        if self._broken is not None or not (self.bridge_running and self._turns.has_bus):
            return
        if self._hung_until_ns is not None:
            self._unread += frames[: RECEIVE_BUFFER_FRAMES - len(self._unread)]
        else:
            self._confined("bridge", self._turns.on_frames, frames, frames[-1].t_ns)

    def on_cones(self, observation: ConeObservation) -> None:
        """Cones that a detector reports; the planner gets them after the perception's delay."""
        self._seen.append(observation)

    def advance(self, now_ns: int) -> list[Frame]:
        """Let time pass to `now_ns`; returns the frames sent."""
        self._now_ns = now_ns
        self._out = []
        while self._seen and self._seen[0].t_ns + PERCEPTION_DELAY_NS <= now_ns:
            observation = self._seen.popleft()
            if "planner" in self._run_ids and self.planner_running:
                self._confined("planner", self._plan, observation, now_ns)
        if now_ns >= self._next_control_ns:
            self._next_control_ns += CONTROL_PERIOD_NS
            self._control(now_ns)
        if self._edge_hung_until_ns is not None and now_ns >= self._edge_hung_until_ns:
            self._edge_hung_until_ns = None
            self._tell(now_ns)
        if self._hung_until_ns is not None and now_ns >= self._hung_until_ns:
            self._hung_until_ns = None
            self._confined("bridge", self._wake, now_ns)
        elif now_ns >= self._turns.due_ns() or not self.edge_running:
            self._confined("bridge", self._turn, now_ns)
        return self._out

    def report(self) -> BridgeReport:
        return self.bridge.report(self._now_ns)

    # ------------------------------------------------------------ the bridge's process

    def _wake(self, now_ns: int) -> None:
        """The loop goes on after a pause: as late as it is, it reads all that has waited before it speaks."""
        if not self.bridge_running:
            return
        self._turns.awake(now_ns)
        self._notice(now_ns)
        waiting, self._unread = self._unread, []
        self._turns.on_frames(waiting, now_ns)
        self._tell(now_ns)
        self._turn(now_ns)

    def _turn(self, now_ns: int) -> None:
        """Do what the loop does at this instant."""
        if self.bridge_running and self._hung_until_ns is None:
            if not self.edge_running:
                self._turns.on_edge(None, now_ns)
            self._do(self._turns.act(now_ns), now_ns)

    def _do(self, actions: Iterable[Action], now_ns: int) -> None:
        """Carry out the actions; reports, the log and the watchdog are not simulated."""
        for action in actions:
            match action:
                case Send(frames):
                    complete, left_ns = all(map(self._takes, frames)), now_ns if frames else None
                    self._do(self._turns.sent(complete, left_ns, now_ns), now_ns)
                case Do.OPEN if now_ns < self._no_bus_until_ns:
                    self._do(self._turns.refused("no such device", now_ns), now_ns)
                case Do.OPEN:
                    self._turns.opened(now_ns)
                    self._turn(now_ns)
                case Do.END:
                    self.bridge_running = False

    def _tell(self, now_ns: int, *messages: Message) -> None:
        """The edge hands messages to the loop, which reads them where neither hangs."""
        self._unheard += messages
        if self.bridge_running and self.edge_running and not self._hangs:
            unheard, self._unheard = self._unheard, []
            self._turns.on_edge(unheard, now_ns)

    def _notice(self, now_ns: int) -> None:
        """The loop meets what has become of its bus."""
        if self._broken is not None and self._turns.has_bus:
            self._turns.lost(self._broken, now_ns)
        self._broken = None

    def _confined(self, process: str, work: Callable[..., object], *given: object) -> None:
        """Do `work`; what it raises ends its process, as it does on the car, where failures are confined."""
        try:
            work(*given)
        except Exception as error:
            if not self.confine_failures:
                raise
            self.failures.append((self._now_ns, process, f"{type(error).__name__}: {error}"))
            # Of the bridge: the loop's last frames fail too, or come too late to matter: silence.
            setattr(self, f"{process}_running", False)

    def due_ns(self) -> int:
        """Return when the bridge next has something to send, as things stand."""
        return self._turns.due_ns()

    def hang_bridge(self, until_ns: int) -> None:
        """The loop's process is stopped until then; what the bus brings meanwhile waits in its socket."""
        self._keep_report()
        self._hung_until_ns = until_ns

    def hang_edge(self, until_ns: int) -> None:
        """The edge's process is stopped until then: no command reaches the loop, and no report gets out."""
        self._keep_report()
        self._edge_hung_until_ns = until_ns

    def _keep_report(self) -> None:
        if not self._hangs:
            self._last_report = self.report()

    @property
    def _hangs(self) -> bool:
        return self._hung_until_ns is not None or self._edge_hung_until_ns is not None

    def kill_bridge(self) -> None:
        """The loop's process ends without a word."""
        self.bridge_running = False
        self._unread.clear()
        self._unheard.clear()

    def kill_edge(self) -> None:
        """The edge's process ends without a word; the loop is left alone."""
        self.edge_running = False
        self._edge_hung_until_ns = None
        self._unheard.clear()

    def start_bridge(self, bridge: Bridge, now_ns: int) -> None:
        """A new edge begins, and a new loop with it."""
        self.bridge = bridge
        self._turns = Turns(bridge, self._codec, now_ns)
        self.bridge_running = self.edge_running = True
        self._hung_until_ns = self._edge_hung_until_ns = None
        self._broken = None if now_ns >= self._no_bus_until_ns else "no such device"
        self._notice(now_ns)

    def lose_bus(self, why: str, now_ns: int, until_ns: float = math.inf) -> None:
        """Bus-off, or the interface is down: nothing is received or sent, and until then the bus cannot be opened."""
        self._no_bus_until_ns = until_ns
        self._broken = why
        self._unread.clear()
        if self.bridge_running and self._hung_until_ns is None:
            self._notice(now_ns)

    # ------------------------------------------------------------ planner and controller

    def start(self, process: str, part: Planner | Controller) -> None:
        """A new process of the planner or the controller begins; it knows nothing of the run in hand."""
        setattr(self, process, part)
        setattr(self, f"{process}_running", True)
        self._run_ids.pop(process, None)

    def _begin(self, process: str, run: Run, now_ns: int) -> bool:
        """Return whether this run is a new one to a process, which begins it then."""
        if self._run_ids.get(process) == run.run_id:
            return False
        getattr(self, process).reset(run)
        self.plan = None
        self._run_ids[process] = run.run_id
        self._tell(now_ns, ResetConfirmed(process, run.run_id))
        return True

    def _plan(self, observation: ConeObservation, now_ns: int) -> None:
        plan = self.planner.on_cones(observation, self._history.at(observation.t_ns) or Motion())
        self.plan = plan if self.plan_filter is None else self.plan_filter(plan, now_ns)

    def _control(self, now_ns: int) -> None:
        if not (self.bridge_running and self.edge_running):
            return  # without the bridge's state nothing is planned, and there is nobody to take a command
        report = self._last_report if self._hangs and self._last_report is not None else self.report()
        self._confined("planner", self._inform_planner, report, now_ns)
        self._confined("controller", self._command, report, now_ns)

    def _inform_planner(self, report: BridgeReport, now_ns: int) -> None:
        if not self.planner_running:
            return
        if self._begin("planner", report.run, now_ns):
            self._history.clear()
        self.planner.on_run(report.run)
        self._history.add(report.motion)

    def _command(self, report: BridgeReport, now_ns: int) -> None:
        """Let the controller make its command, and hand it to the loop."""
        if not self.controller_running:
            return
        self._begin("controller", report.run, now_ns)
        speeds, steer = report.vehicle.speeds, report.vehicle.steer
        command = self.controller.command(
            self.plan,
            report.motion,
            report.standing,
            speeds.all_rpm if speeds is not None else (0, 0, 0, 0),
            steer.angle_deg if steer is not None else 0.0,
            report.run,
            now_ns,
        )
        self.commanded = command
        filtered = command if self.command_filter is None else self.command_filter(command, now_ns)
        if filtered is not None:
            self._tell(now_ns, filtered)
