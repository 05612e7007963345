"""vehicle_controller: /path and /planner_status to /vehicle_cmd, at 50 Hz or more."""

from __future__ import annotations

import math
from functools import partial

from fsai_msgs.msg import PlannerStatus, ResetConfirmation, RunState, VehicleCommand, VehicleState
from msgspec.structs import replace
from nav_msgs.msg import Path
from rclpy.node import Node

from fsai_nodes.clocks import LATE_NS, Clocks, Input, nanoseconds
from fsai_nodes.conversions import BASE_FRAME, command_to_msg, motion_from_state, plan_from_msgs, run_from_msg
from fsai_nodes.door import Door
from fsai_nodes.parameters import NodeParameter, Settings, of_the_file
from fsai_nodes.process import run
from fsai_nodes.qos import publisher
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.control.settings import NO_SPEED_LIMIT_MPS, ControllerSettings
from fsai_vcu.core.driving import Motion, Plan, Run
from fsai_vcu.core.limits import SPEED_NOT_LIMITED
from fsai_vcu.core.vehicle.parameters import CARS

_DEFAULT = ControllerSettings()
_SPEEDS = of_the_file("vehicle_controller", " In m/s.", live=True)

SETTINGS = (
    *_SPEEDS,
    NodeParameter("car", "2026", "Vehicle parameters to control with.", choices=tuple(CARS)),
    # safety: /vehicle_cmd comes at 50 Hz or more
    NodeParameter("rate_hz", 50.0, "How often a command is sent, in Hz.", low=50.0, high=100.0),
)


class VehicleController(Node):
    """Sends a command on every tick of the monotonic clock, with the newest plan and the newest state of the car."""

    def __init__(self, **options: object) -> None:
        """Read the parameters, and make publishers, subscriptions and the timer of the commands."""
        super().__init__("vehicle_controller", **options)
        self._settings = Settings(self, SETTINGS, self._on_change)
        self._clocks = Clocks(self)
        self._controller = Controller(CARS[self._settings.text("car")], self._controller_settings())
        self._run: Run | None = None
        self._state: tuple[VehicleState, Motion] | None = None  # the newest, and the motion in it
        self._limits_received = False  # the operational limits, which the bridge has
        self._status: PlannerStatus | None = None
        self._pending: Path | None = None  # a path whose status has not come yet
        self._plan: Plan | None = None
        self._states = Input(self, "vehicle_state", clocks=self._clocks)
        self._paths = Input(self, "path", clocks=self._clocks)
        self._planner_waits: tuple[str, int] = "", 0  # for what, and when it reported so
        self._trouble = (False, False)  # an input is late, there is no path: the log says so
        self._command = publisher(self, VehicleCommand, "vehicle_cmd")
        self._confirmation = publisher(self, ResetConfirmation, "reset_confirmation")
        door = Door(self)
        door.subscription(RunState, "run_state", self._on_run)
        door.subscription(VehicleState, "vehicle_state", self._on_state, refused=self._states.refused)
        door.subscription(PlannerStatus, "planner_status", self._on_status, refused=self._paths.refused)
        door.subscription(Path, "path", self._on_path, refused=self._paths.refused)
        self._clocks.watch()
        self._clocks.every(1.0 / self._settings.number("rate_hz"), self._tick)

    def _controller_settings(self) -> ControllerSettings:
        return replace(_DEFAULT, **{f"{each.name}_mps": self._settings.number(each.name) for each in _SPEEDS})

    def _on_change(self, _name: str) -> None:
        self._controller.configure(self._controller_settings())

    def _on_run(self, message: RunState) -> None:
        run = run_from_msg(message)
        known, self._run = self._run, run
        if known is not None and known.run_id == run.run_id and known.mission == run.mission:
            return
        self._controller.reset(run)
        self._state = self._status = self._pending = self._plan = None
        self._planner_waits = "", 0
        self._confirmation.publish(ResetConfirmation(role=ResetConfirmation.CONTROLLER, run_id=run.run_id))
        self.get_logger().info(f"reset for run {run.run_id}, mission {run.mission.label}")
        if line := self._controller.too_slow(run.mission):
            self.get_logger().warning(line)

    def _on_state(self, message: VehicleState) -> None:
        """Take in a state of the car; a state of another run counts as none."""
        if not self._limits_received:
            self._limits_received = True
            if (
                SPEED_NOT_LIMITED in message.operational_limits
                and self._settings.number("max_speed") >= NO_SPEED_LIMIT_MPS
            ):
                self.get_logger().warning(
                    "no speed limit is set: neither max_speed nor an operational limit max_speed_mps"
                )
        if self._run is None or message.run_id != self._run.run_id:
            return
        now_ns = self._clocks.now_ns()
        self._states.received(now_ns, now_ns - self._clocks.steady_of(message.header.stamp, now_ns))
        t_ns = self._clocks.measured_ns(message.header.stamp, "vehicle_state", now_ns)
        if t_ns is not None:
            self._state = message, motion_from_state(message, t_ns)

    def _on_status(self, message: PlannerStatus) -> None:
        if message.late:
            self._planner_waits = message.late, self._clocks.now_ns()
            return
        self._status = message
        self._pair()

    def _on_path(self, message: Path) -> None:
        now_ns = self._clocks.now_ns()
        self._paths.received(now_ns, now_ns - self._clocks.steady_of(message.header.stamp, now_ns))
        foreign = bool(message.poses) and message.header.frame_id != BASE_FRAME
        if foreign:
            self._planner_waits = f"/path is in '{message.header.frame_id}', but must be in {BASE_FRAME}", now_ns
        if foreign or not message.poses:
            self._plan = None  # whether or not a status says why
        self._pending = None if foreign else message
        self._pair()

    def _pair(self) -> None:
        """Path and status belong together by their stamp; in which order they come does not matter."""
        status, path = self._status, self._pending
        if status is None or path is None or nanoseconds(status.header.stamp) != nanoseconds(path.header.stamp):
            return
        self._pending = None
        seen_ns = self._clocks.measured_ns(path.header.stamp, "path", self._clocks.now_ns())
        if seen_ns is not None:
            self._plan = plan_from_msgs(status, path, seen_ns)

    def _tick(self) -> None:
        """Send the command that is due, and log why the car does not drive."""
        run = self._run
        if self._state is None or run is None:
            return
        state, motion = self._state
        now_ns = self._clocks.now_ns()
        command = self._controller.command(
            self._plan,
            motion,
            state.standing,
            tuple(float(rpm) for rpm in state.wheel_speed_rpm),
            math.degrees(state.steering_rad),
            run,
            now_ns,
        )
        message = command_to_msg(command, self._clocks.stamp_of(command.t_sensor_ns))
        late = self._late_input(command.t_sensor_ns, now_ns, stuck=bool(command.note)) if run.may_move else ""
        message.note = "; ".join(filter(None, (late, command.note)))
        trouble = bool(late), bool(command.note)
        if trouble != self._trouble:
            self._trouble = trouble
            if message.note:
                self.get_logger().warning(f"not driving: {message.note}")
            elif run.may_move:
                self.get_logger().info("driving again")
        self._command.publish(message)

    def _late_input(self, sensor_ns: int, now_ns: int, *, stuck: bool) -> str:
        """Say whose silence makes the data behind a command old, or leaves the controller `stuck`; else ''."""
        old = now_ns - sensor_ns >= LATE_NS
        if old and (self._plan is None or sensor_ns != self._plan.t_sensor_ns):
            return self._states.late(now_ns)
        if not (old or stuck):
            return ""
        words, said_ns = self._planner_waits
        return words if now_ns - said_ns < LATE_NS else self._paths.late(now_ns)


main = partial(run, [VehicleController], "vehicle_controller")


if __name__ == "__main__":
    raise SystemExit(main())
