"""path_planner: /detected_cones to /path and /planner_status, for the run that the bridge announces."""

from __future__ import annotations

from functools import partial

import numpy as np
from fsai_msgs.msg import ConeArray, PlannerStatus, ResetConfirmation, RunState, VehicleState
from msgspec.structs import replace
from nav_msgs.msg import Path
from rclpy.node import Node

from fsai_nodes.clocks import WATCH_S, Clocks, Input
from fsai_nodes.conversions import cones_from_msg, motion_from_state, path_to_msg, plan_to_msgs, run_from_msg
from fsai_nodes.door import Door
from fsai_nodes.parameters import NodeParameter, Settings, of_the_file
from fsai_nodes.process import run
from fsai_nodes.qos import publisher
from fsai_vcu.core.control.controller import WITHOUT_PATH
from fsai_vcu.core.driving import Motion, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import CARS

_PLANNER = PlannerSettings()
_MISSIONS = MissionSettings()
# Cones seen so long ago make every command stale (safety: data older than 500 ms).
_COLD_NS = 500_000_000

SETTINGS = (
    NodeParameter("car", "2026", "Vehicle parameters to plan with.", choices=tuple(CARS)),
    *of_the_file("path_planner", " Takes effect with the next run.", live=True),
)


class PathPlanner(Node):
    """Plans with every set of cones; forgets everything when the bridge announces a new run, and says so."""

    def __init__(self, **options: object) -> None:
        """Read the parameters, and make the publishers and subscriptions."""
        super().__init__("path_planner", **options)
        # It loads scipy: now, and not when the first run is announced, while the node would answer nobody.
        import fsai_vcu.core.planning.racing  # noqa: F401

        self._settings = Settings(self, SETTINGS, lambda _name: None)
        self._clocks = Clocks(self)
        self._planner = self._new_planner()
        self._run: Run | None = None
        self._motion: Motion | None = None
        self._cones = Input(self, "detected_cones", note="it, or the sensors before it", clocks=self._clocks)
        self._path = publisher(self, Path, "path")
        self._status = publisher(self, PlannerStatus, "planner_status")
        self._confirmation = publisher(self, ResetConfirmation, "reset_confirmation")
        door = Door(self)
        door.subscription(RunState, "run_state", self._on_run)
        door.subscription(VehicleState, "vehicle_state", self._on_state)
        door.subscription(ConeArray, "detected_cones", self._on_cones, refused=self._cones.refused)
        self._clocks.watch()
        self._clocks.every(WATCH_S, self._watch)

    def _new_planner(self) -> Planner:
        number = self._settings.number
        return Planner(
            CARS[self._settings.text("car")],
            replace(_PLANNER, range_max_m=number("range_max_m"), horizon_m=number("horizon_m")),
            replace(_MISSIONS, trackdrive_laps=self._settings.integer("laps")),
        )

    def _on_run(self, message: RunState) -> None:
        run = run_from_msg(message)
        known, self._run = self._run, run
        if known is not None and known.run_id == run.run_id and known.mission == run.mission:
            self._planner.on_run(run)
            return
        # A new planner, not a cleaned one: parameters changed since the last run take effect, and nothing can be left.
        self._planner = self._new_planner()
        self._planner.reset(run)
        self._cones.forget()
        self._motion = None  # odometry began again; what was received before is of the last run
        self._confirmation.publish(ResetConfirmation(role=ResetConfirmation.PLANNER, run_id=run.run_id))
        self.get_logger().info(f"reset for run {run.run_id}, mission {run.mission.label}")

    def _on_state(self, message: VehicleState) -> None:
        if self._run is None or message.run_id != self._run.run_id:
            return
        t_ns = self._clocks.measured_ns(message.header.stamp, "vehicle_state", self._clocks.now_ns())
        if t_ns is not None:
            self._motion = motion_from_state(message, t_ns)

    def _watch(self) -> None:
        """Say, while driving, whose silence it is that there is no path."""
        run = self._run
        if run is None or not run.may_move or run.mission in WITHOUT_PATH:
            return
        if late := self._cones.watch(self._clocks.now_ns()):
            self._status.publish(PlannerStatus(run_id=run.run_id, mission=int(run.mission), late=late))

    def _on_cones(self, message: ConeArray) -> None:
        """Plan with a set of cones, and publish path and status; an empty path where no way is known."""
        now_ns = self._clocks.now_ns()
        age_ns = now_ns - self._clocks.steady_of(message.header.stamp, now_ns)
        self._cones.received(now_ns, age_ns)
        motion = self._motion
        if self._run is None or motion is None:
            return
        seen_ns = self._clocks.measured_ns(message.header.stamp, "detected_cones", now_ns)
        if seen_ns is None:
            return
        if age_ns >= _COLD_NS:
            self.get_logger().warning(f"cones are {age_ns / 1e6:.0f} ms old: not used", throttle_duration_sec=1.0)
            return
        plan = self._planner.on_cones(cones_from_msg(message, seen_ns), motion)
        if plan is None:
            # An empty path says: no way known. Silence would let the last path be driven on.
            self._path.publish(path_to_msg(np.empty((0, 2)), message.header.stamp))
            return
        status, path = plan_to_msgs(plan, self._clocks.stamp_of(plan.t_sensor_ns))
        self._status.publish(status)
        self._path.publish(path)


main = partial(run, [PathPlanner], "path_planner")


if __name__ == "__main__":
    raise SystemExit(main())
