"""vcu_bridge: between ROS and the car. The only node that knows the bus, and it knows it through a process of its own.

A managed (lifecycle) node that configures and activates itself unless set otherwise. It is the edge of the CAN loop,
which runs in a process without ROS: commands are handed to it without waiting, services ask it and wait for its answer
for a limited time, a timer publishes what it last reported. Nothing here decides anything about the car. What comes
from ROS enters by `fsai_nodes.door`, checked and bounded; where this process stands still or ends, the loop goes on
without it, and to the loop its commands become stale.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable
from functools import partial, wraps
from typing import Any

from fsai_msgs.msg import ResetConfirmation, VehicleCommand
from fsai_msgs.srv import SetMode
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from fsai_nodes.bridge_outputs import BridgeOutputs
from fsai_nodes.clocks import Clocks, Input
from fsai_nodes.command_owner import CommandOwner
from fsai_nodes.complaints import ANSWERS, complaints_of
from fsai_nodes.conversions import (
    command_from_msg,
)
from fsai_nodes.door import Arrival, Door
from fsai_nodes.mission_goal import GoalResult
from fsai_nodes.mission_server import MissionServer
from fsai_nodes.parameters import NodeError, NodeParameter, Settings, of_the_file
from fsai_nodes.process import run
from fsai_nodes.report_log import Culprit, News, with_refused
from fsai_vcu.core.limits import LimitsError, OperationalLimits, parse_limits
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.config import BridgeConfig, official_simulator
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.values import shortened
from fsai_vcu.interface.wheels import WheelMapping
from fsai_vcu.runtime.configuration import SAME_AS_REVISION
from fsai_vcu.runtime.limits_file import read_limits
from fsai_vcu.runtime.link import LoopSettings
from fsai_vcu.runtime.loop_handle import LoopError, LoopHandle, start_loop_process
from fsai_vcu.runtime.toml_lines import parse_toml, tomllib, words_of

_CONFIG = BridgeConfig()
_DIAGNOSTICS_PERIOD_S = 1.0
_INACTIVE = "vcu_bridge is not active: nothing is sent to the car"

# The times of the graded reactions; the safety rules' defaults.
_TIMES = {
    "command_stale": "Age of the last /vehicle_cmd from which on torque is zero",
    "command_lost": "Age of the last /vehicle_cmd at which the car is braked to rest",
    "sensor_stale": "Age of the data behind a command at which it counts as stale",
    "vcu_stale": "Silence of 0x520 from which on torque is zero",
    "vcu_lost": "Silence of 0x520 at which ESTOP_REQUEST is sent",
    "feedback_stale": "Silence of wheel speeds or steering at which the car is braked",
    "feedback_lost": "Silence of wheel speeds or steering at which ESTOP_REQUEST is sent",
    "implausible": "Duration of implausible feedback after which the car is braked",
    "implausible_lost": "Duration of implausible feedback after which ESTOP_REQUEST is sent",
}

SETTINGS = (
    NodeParameter(
        "can_interface",
        "vcan0",
        "The bus: a SocketCAN interface such as can0, loopback:NAME (a stand-in on one machine), or KIND:CHANNEL.",
    ),
    NodeParameter("car", SAME_AS_REVISION, "Vehicle parameters.", choices=(SAME_AS_REVISION, *CARS)),
    *of_the_file("vcu_bridge"),
    NodeParameter(
        "dbc_files", "", "DBC files to use instead of the revision's own, separated by commas. Empty: its own."
    ),
    NodeParameter(
        "wheel_mapping",
        "",
        "Wheels whose sensors are wired to another wheel's input, such as fl=fr,fr=fl. Empty: as documented.",
    ),
    NodeParameter(
        "limits",
        "",
        "Operational limits: the path of a TOML file, or the limits themselves, such as max_speed_mps=5.0,"
        "max_axle_torque_nm=100,max_steer_deg=20. Empty: none but the car's.",
    ),
    *(
        NodeParameter(f"{name}_ms", getattr(_CONFIG, f"{name}_ns") / 1e6, f"{words}, in ms.", low=10.0, high=2000.0)
        for name, words in _TIMES.items()
    ),
    NodeParameter(
        "real_time", True, "Ask for SCHED_FIFO and locked memory for the CAN loop; go on without when refused."
    ),
    NodeParameter(
        "publish_rate_hz", 50.0, "How often state, odometry and IMU are published, in Hz.", low=20.0, high=100.0
    ),
    NodeParameter("imu_frame_id", "imu_link", "frame_id of /imu: the axes of the PCAN-GPS as it is mounted."),
    NodeParameter("gps_frame_id", "gps_link", "frame_id of /gps/fix."),
    NodeParameter("publish_tf", True, "Broadcast odom -> base_link, where tf2_msgs is installed.", live=True),
    NodeParameter("autostart", True, "Configure and activate without being asked."),
)


_Transition = Callable[["VcuBridge", LifecycleState], TransitionCallbackReturn]


def _reported(transition: _Transition) -> _Transition:
    """A lifecycle transition whose error is reported; rclpy takes it for a failure without a word."""

    @wraps(transition)
    def reported(node: VcuBridge, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(node, state)
        except Exception as error:
            node._report_failure(f"{type(error).__name__}: {error}")
            raise

    return reported


class VcuBridge(LifecycleNode):
    """Node between ROS and the CAN loop. Its constructor raises NodeError when it starts by itself and cannot."""

    # Kilted's context destroys a node whose constructor has raised, too.
    _process: LoopHandle | None = None  # of the loop, from configuring to cleaning up
    _missions: MissionServer | None = None
    tells_systemd = True  # the CAN loop does: its watchdog is fed by cycles that met their deadline, by nothing else

    def __init__(self, **options: object) -> None:
        """Declare the parameters, and configure and activate the node unless set otherwise."""
        super().__init__("vcu_bridge", **options)
        # It has a line on each transition that is not allowed; NodeExecutor says that, too, and not each time.
        set_logger_level("rcl_lifecycle", LoggingSeverity.ERROR)
        self._trouble = ""  # why the last transition failed
        self._starting = True  # this constructor runs
        self._last_answer = ""
        self._settings = Settings(self, SETTINGS, lambda _name: None, self._why_fixed)
        self._clocks = Clocks(self)
        self._configured: LoopSettings | None = None
        self._loop: LoopHandle | None = None  # the same while the node is active
        self._loop_silent = False  # it should report and does not
        self._news, self._culprit = News(), Culprit()
        self._sensor_ns: int | None = None  # of the data behind the last command that came in
        self._commands = Input(self, "vehicle_cmd", clocks=self._clocks)
        self._owner = CommandOwner(_CONFIG.command_lost_ns)
        self._refused_commands, self._refused_command = 0, ""  # at the door: how many, and the last one in words
        self._note = ""  # why the controller does not drive, as its last command says
        self._timers: list[Timer] = []
        self._outputs = BridgeOutputs(self, self._settings, self._clocks)
        door = self._door = Door(self)
        door.subscription(
            VehicleCommand, "vehicle_cmd", self._on_command, refused=self._on_refused_command, with_sender=True
        )
        door.subscription(ResetConfirmation, "reset_confirmation", self._on_confirmation, with_sender=True)
        door.service(SetMode, "set_mode", self._on_set_mode)
        door.service(Trigger, "emergency_brake", self._on_emergency_brake)
        door.service(Trigger, "reset", self._on_reset)
        self._missions = MissionServer(door, self._clocks, refuses=self._refuses_goals, stop=self._stop_for_a_goal)
        self._clocks.watch()
        if self._settings.flag("autostart"):
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() != TransitionCallbackReturn.SUCCESS:
                    trouble = self._trouble or "cannot start"
                    self.destroy_node()
                    raise NodeError(trouble)
        self._starting = False

    # ------------------------------------------------------------ lifecycle

    @_reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self._configured = self._configure()
            # It gets ready while ROS does; the database is read there, and nowhere else.
            self._process = start_loop_process(self._configured.bus)
            self._process.configure(self._configured)
        except (NodeError, LoopError) as error:
            self._end_process()
            return self._failed(str(error))
        limits = self._configured.limits
        for line in limits.described() if limits is not None else ("none but the car's own",):
            self.get_logger().info(f"operational limits: {line}")
        return super().on_configure(state)

    @_reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Have the loop take the interface and run, and publish from then on what it reports."""
        configured, loop = self._configured, self._process
        assert configured is not None and loop is not None, "the lifecycle activates only what is configured"
        try:
            # Drawn again, so that no planner or controller takes this bridge's first run for an old one's.
            loop.activate(secrets.randbelow(2**30) + 1)
        except LoopError as error:
            return self._failed(str(error))
        self._loop = loop
        self._loop_silent = False
        # Stale commands are so by the age of their data: when the loop reports it, less time has passed here.
        silent_ns = configured.config.command_stale_ns // 2
        self._commands = Input(self, "vehicle_cmd", silent_ns=silent_ns, clocks=self._clocks)
        self._owner = CommandOwner(configured.config.command_lost_ns)
        self._news, self._culprit = News(), Culprit()
        self._outputs.begin()
        self._timers = [
            self._clocks.every(1.0 / self._settings.number("publish_rate_hz"), self._publish),
            self._clocks.every(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics),
        ]
        sends = "listens only: nothing is sent" if configured.config.listen_only else "drives the bus"
        self.get_logger().info(
            f"active on {configured.bus}, interface revision {configured.revision}, car {configured.car}; {sends} "
            f"(CAN loop: process {loop.pid})"
        )
        return super().on_activate(state)

    @_reported
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._end_loop()
        self.get_logger().info("inactive: silent on the bus")
        return super().on_deactivate(state)

    @_reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up, also on a shutdown or after an error: neither a loop nor its process is left."""
        self._end_loop()
        self._end_process()
        return super().on_cleanup(state)

    on_shutdown = on_error = on_cleanup

    def stop(self) -> None:
        """Say goodbye to the car before the process ends."""
        if self._loop is not None:
            self.trigger_deactivate()

    def destroy_node(self) -> None:
        self._end_process()
        if self._missions is not None:
            self._missions.destroy()
        super().destroy_node()

    def _failed(self, why: str) -> TransitionCallbackReturn:
        self._report_failure(why)
        return TransitionCallbackReturn.FAILURE

    def _report_failure(self, why: str) -> None:
        self._trouble = why
        if not self._starting:  # else the process ends with this line
            complaints_of(self).say("lifecycle", f"the lifecycle transition failed: {why}", "error", at_once=ANSWERS)

    def _end_loop(self) -> None:
        loop, self._loop = self._loop, None
        if loop is None:
            return
        for timer in self._timers:
            self.destroy_timer(timer)
        self._timers = []
        if not loop.deactivate():
            self.get_logger().error("the CAN loop does not answer, and its process is ended: silence stops the car")
            self._end_process()
        report = self._report(loop)
        now_ns = self._clocks.now_ns()
        self._publish_state(report, now_ns)
        self._missions.step(report, now_ns, GoalResult(False, "bridge_stopped", "vcu_bridge was stopped"))

    def _end_process(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.close()

    def _why_fixed(self) -> str | None:
        label = self._state_machine.current_state[1]
        if label == "unconfigured":
            return None
        name = self.get_fully_qualified_name()
        return f"vcu_bridge is {label}; first: ros2 lifecycle set {name} deactivate, then cleanup"

    def _configure(self) -> LoopSettings:
        """Read and check all parameters. Raises NodeError."""
        text, number = self._settings.text, self._settings.number
        try:
            limits = limits_of(text("limits"))
            wheel_mapping = wheel_mapping_of(text("wheel_mapping"))
            config = BridgeConfig(
                autonomous_at_power_up=self._settings.flag("autonomous_at_power_up"),
                listen_only=self._settings.flag("listen_only"),
                service_brake="motor" if text("service_brake") == "motor" else "hydraulic",
                holding_brake_pct=number("holding_brake_pct"),
                stop_brake_pct=number("stop_brake_pct"),
                **{f"{name}_ns": round(number(f"{name}_ms") * 1e6) for name in _TIMES},
            )
        except (LimitsError, ValueError) as error:
            raise NodeError(str(error)) from error
        if config.motor_brakes:
            config = official_simulator(config)
        car = text("car")
        return LoopSettings(
            bus=text("can_interface"),
            revision=text("revision"),
            car=text("revision") if car == SAME_AS_REVISION else car,
            dbc_files=tuple(name.strip() for name in text("dbc_files").split(",") if name.strip()),
            wheel_mapping=wheel_mapping,
            config=config,
            limits=limits,
            real_time=self._settings.flag("real_time"),
            # A report is at most half as old as the pause between two publications when it is published.
            report_period_ns=round(0.5e9 / number("publish_rate_hz")),
        )

    # ------------------------------------------------------------ from ROS to the car

    def _on_command(self, message: VehicleCommand, came: Arrival) -> None:
        """Hand a command that counts to the loop."""
        loop = self._loop
        if loop is None:
            return
        now_ns = self._clocks.now_ns()
        if not self._is_the_runs(message, came, now_ns):
            return
        # A stamp of the future is handed on as it is: the loop refuses the command, and counts it.
        sensor_ns = self._clocks.steady_of(message.header.stamp, now_ns)
        if sensor_ns > now_ns and (words := self._clocks.refused_by_own(came.topic, now_ns)):
            self._on_refused_command(words)
            return
        self._sensor_ns = sensor_ns
        self._commands.received(now_ns, now_ns - sensor_ns)
        self._note = message.note
        if words := loop.submit_command(command_from_msg(message, sensor_ns)):
            self._on_refused_command(self._door.refuse(came.topic, came.sender, words))

    def _is_the_runs(self, message: VehicleCommand, came: Arrival, now_ns: int) -> bool:
        """Return true where the command is of the one publisher whose commands the run takes."""
        run = self._outputs.run
        if run is None or message.run_id != run.run_id:
            return True  # it counts as none, and the loop says so
        if came.gid is None:
            return True  # this middleware does not tell whose it is; check-stack names all that command the car
        if self._owner.takes(message.run_id, came.gid, now_ns, came.senders.present):
            return True
        owner = came.senders.name(self._owner.gid) or "another publisher"
        why = f"run {message.run_id} belongs to {owner}, which confirmed its reset or commanded first"
        self._door.refuse(came.topic, came.sender, why)
        return False

    def _on_refused_command(self, words: str) -> None:
        self._commands.refused(words)
        self._refused_commands += 1
        self._refused_command = words

    def _whose_silence(self) -> str:
        """Say in words which input is missing where the vehicle command is stale."""
        now_ns = self._clocks.now_ns()
        silence = self._commands.silence(now_ns) or self._note
        return silence or self._commands.old_data() or "commands come, but late or refused"

    def _on_confirmation(self, message: ResetConfirmation, came: Arrival) -> None:
        if self._loop is None:
            return
        if message.role == ResetConfirmation.CONTROLLER and came.gid is not None:
            run = self._outputs.run
            if run is not None and message.run_id == run.run_id:
                self._owner.confirmed(message.run_id, came.gid)
        if words := self._loop.confirm_reset(message.role, message.run_id):
            self._door.refuse(came.topic, came.sender, words)

    def _on_set_mode(self, request: SetMode.Request, response: SetMode.Response) -> SetMode.Response:
        """Sets the mode, `manual` or `autonomous` (`fsai-vcu mode`); a refusal has the reason. It says if that was the
        mode already.
        """
        return self._served(response, f"set_mode '{request.mode}'", lambda loop: loop.set_mode(request.mode))

    def _on_emergency_brake(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Latches ESTOP_REQUEST (`fsai-vcu emergency-brake`)."""
        return self._served(response, "emergency_brake", lambda loop: loop.emergency_brake("by /emergency_brake"))

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clears the latched ESTOP_REQUEST, in AS_INIT and AS_OFF (`fsai-vcu reset`)."""
        return self._served(response, "reset", LoopHandle.reset)

    def _served(self, response: Any, request: str, ask: Callable[[LoopHandle], tuple[bool, str]]) -> Any:
        response.success, response.message = self._ask(request, ask)
        return response

    def _ask(self, request: str, ask: Callable[[LoopHandle], tuple[bool, str]]) -> tuple[bool, str]:
        """Ask the loop and return its answer. The log gets it once: a caller that is refused tends to ask again at
        once.
        """
        done, message = (False, _INACTIVE) if self._loop is None else ask(self._loop)
        line = f"{request}: {message}"
        if line != self._last_answer:
            self._last_answer = line
            complaints_of(self).say(request.partition(" ")[0], line, "info", at_once=ANSWERS)
        return done, message

    # ------------------------------------------------------------ from the car to ROS

    def _report(self, loop: LoopHandle) -> BridgeReport:
        """Return the newest report, in which a stale command is somebody's silence."""
        return self._culprit.named(loop.report(), self._whose_silence)

    def _publish(self) -> None:
        """Publish what the loop last reported. Raises NodeError where the loop has ended by itself."""
        loop = self._loop
        if loop is None:
            return
        if not loop.running:
            self._publish_state(self._report(loop), self._clocks.now_ns())
            raise NodeError(f"the CAN loop ended by itself: {loop.failure or 'no reason known'}")
        report = self._report(loop)
        now_ns = self._clocks.now_ns()
        logger = self.get_logger()
        for line in self._news.of(report):
            if line.level == "error":
                logger.error(line.text)
            elif line.level == "warning":
                logger.warning(line.text)
            else:
                logger.info(line.text)
        if loop.silent is not self._loop_silent:
            self._loop_silent = loop.silent
            if self._loop_silent:
                silent_ms = (now_ns - loop.loop_report().bridge.t_ns) / 1e6
                logger.error(f"the CAN loop has reported nothing for {silent_ms:.0f} ms: nothing is known of the car")
            else:
                logger.warning("the CAN loop reports again")
        self._publish_state(report, now_ns)
        self._outputs.motion(report)
        newest = loop.loop_report().bridge
        # A car that is silent has stopped itself, and so has one whose loop has said nothing for long; a loop that was
        # held up says nothing of it.
        gone = newest.vcu_lost or (self._loop_silent and now_ns - newest.t_ns >= _CONFIG.stop_timeout_ns)
        self._missions.step(report, now_ns, gone=gone)

    def _publish_state(self, report: BridgeReport, now_ns: int) -> None:
        age_s = math.nan if self._sensor_ns is None else (now_ns - self._sensor_ns) / 1e9
        self._outputs.state(report, age_s)

    def _publish_diagnostics(self) -> None:
        loop = self._loop
        if loop is None:
            return
        loop.alive()
        newest = loop.loop_report()
        more: dict[str, object] = {"bus reopened": newest.reopened, "deadline misses": newest.deadline_misses}
        for index, sentence in enumerate(newest.scheduling_refused, 1):
            more[f"not real-time {index}"] = sentence
        more |= loop.link_trouble()
        report = with_refused(self._report(loop), self._refused_commands, self._refused_command)
        self._outputs.diagnostics(report, more)

    def _refuses_goals(self) -> bool:
        """Return true, and say so, where no run can be followed."""
        if self._loop is None:
            complaints_of(self).say("run_mission", f"run_mission refused: {_INACTIVE}", "error")
        return self._loop is None

    def _stop_for_a_goal(self) -> bool:
        """Set the mode to manual, as a client that cancels its goal wants it."""
        return self._ask("run_mission cancelled", lambda loop: loop.set_mode("manual"))[0]


def limits_of(text: str) -> OperationalLimits | None:
    """The operational limits in a parameter: a file's path, or the limits themselves. Raises LimitsError."""
    if not text.strip():
        return None
    if "=" not in text:
        return read_limits(text.strip())
    try:
        return parse_limits(parse_toml(text.replace(",", "\n").replace(";", "\n")))
    except tomllib.TOMLDecodeError as error:
        words = f"parameter limits is '{shortened(text)}', not like max_speed_mps=5.0: {words_of(error)}"
        raise LimitsError(words) from error


def wheel_mapping_of(text: str) -> WheelMapping:
    """Parse a mapping such as fl=fr,fr=fl. Raises ValueError."""
    pairs = [part.strip() for part in text.split(",") if part.strip()]
    for pair in pairs:
        if pair.count("=") != 1:
            raise ValueError(f"parameter wheel_mapping: '{pair}' is not like fl=fr")
    return WheelMapping.of({wheel.strip(): source.strip() for wheel, source in (pair.split("=") for pair in pairs)})


main = partial(run, [VcuBridge], "vcu_bridge")


if __name__ == "__main__":
    raise SystemExit(main())
