"""The nodes' part of the pit wall: cones, path, pose and status, for `fsai-vcu pitwall --ros`. It never publishes.

All subscriptions are best effort: no publisher waits for this program, or sends it anything again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from fsai_msgs.msg import ConeArray, PlannerStatus, VehicleCommand, VehicleState
from nav_msgs.msg import Path

from fsai_nodes.clocks import Clocks, Input
from fsai_nodes.conversions import plan_from_msgs
from fsai_nodes.door import Door
from fsai_nodes.listener import Listener
from fsai_nodes.qos import profile
from fsai_nodes.scene import Scene
from fsai_vcu.core.driving import Plan
from fsai_vcu.core.planning.pose import lengths_along, to_odometry
from fsai_vcu.core.report import loop_fault_words
from fsai_vcu.diagnostics.monitor.sources import lag_words
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.units import MS

SHOWN_NS = 500 * MS  # older cones and paths are not drawn: nor would they be driven by
SILENT_NS = 1000 * MS  # without a state of the car for so long nothing of the nodes is drawn

Row = tuple[str, str]  # what is said, and "", "warning" or "fault"


class PitWall(Listener):
    """`look` gives what the page shows more of, where the nodes run."""

    def __init__(self, namespace: str = "/") -> None:
        """Subscribe in `namespace`. Raises ValueError where that is no namespace."""
        super().__init__("pitwall", namespace)
        self._lock = threading.Lock()
        self._clocks = Clocks(self._node)
        self._scene = Scene(self._clocks)
        self._command = VehicleCommand()
        self._inputs: dict[str, Input] = {}
        self._newest_ns: dict[str, int] = {}  # of what was measured
        door = Door(self._node, publishes=False)
        for topic, kind, take in (
            ("vehicle_state", VehicleState, self._on_state),
            ("detected_cones", ConeArray, self._scene.on_cones),
            ("planner_status", PlannerStatus, self._scene.on_status),
            ("path", Path, self._scene.on_path),
            ("vehicle_cmd", VehicleCommand, self._on_command),
        ):
            silent_ns = SILENT_NS if topic == "vehicle_state" else SHOWN_NS
            self._inputs[topic] = Input(self._node, topic, silent_ns=silent_ns, clocks=self._clocks)
            door.subscription(
                kind,
                topic,
                self._taker(topic, take),
                qos=profile(5, reliable=False),
                refused=self._inputs[topic].refused,
            )

    def look(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return as JSON types what changes all the time, and the longer rest.

        Only words, and nothing to draw, while the nodes are silent. Lengths are cm in the frame of the odometry.
        """
        if self.error is not None:
            return {
                "nodes": [(f"nothing of the nodes is received any more: {self.error!r}; restart the pit wall", "fault")]
            }, {}
        with self._lock:
            now_ns = self.heard_ns  # what this program has had no time to take is nobody's silence
            late = [(words, "warning") for words in (lag_words(now_ns, self._clocks.now_ns()),) if words]
            silence = self._inputs["vehicle_state"].silence(now_ns)
            if silence:
                return {"nodes": [*late, (silence, "warning")]}, {}
            state = self._scene.state
            plan = self._plan(now_ns)
            drawn = {
                "nodes": [*late, *self._words(plan, now_ns)],
                "run": state.run_id,
                "pose": [round(each, 3) for each in (state.x, state.y, state.yaw_rad)],
                "seen_cm": self._seen(now_ns),
                **self._drawn(plan),
            }
            driven = np.array(self._scene.driven).reshape(-1, 3)
            return drawn, {"way_cm": _cm(driven[:, :2]), "cones_cm": _cm(self._scene.remembered)}

    # ------------------------------------------------------------ what comes

    def _taker(self, topic: str, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def taken(message: Any) -> None:
            with self._lock:
                now_ns = self._clocks.now_ns()
                measured_ns = self._clocks.steady_of(message.header.stamp, now_ns)
                self._inputs[topic].received(now_ns)
                self._newest_ns[topic] = min(measured_ns, now_ns)
                take(message)

        return taken

    def _on_state(self, message: VehicleState) -> None:
        if message.run_id != self._scene.state.run_id:
            self._command = VehicleCommand()
        self._scene.on_state(message)

    def _on_command(self, message: VehicleCommand) -> None:
        self._command = message

    # ------------------------------------------------------------ what is shown

    def _fresh(self, topic: str, now_ns: int) -> bool:
        return topic in self._newest_ns and now_ns - self._newest_ns[topic] < SHOWN_NS

    def _seen(self, now_ns: int) -> list[int]:
        """Return x, y (cm) and colour of each cone, one after the other."""
        seen = self._scene.seen
        there = self._scene.history.at(seen.t_ns)
        if there is None or not self._fresh("detected_cones", now_ns):
            return []
        return _cm(np.column_stack([to_odometry(there, seen.xy_m), seen.color]))

    def _plan(self, now_ns: int) -> Plan | None:
        """Return the plan that may still be driven by."""
        if not self._fresh("path", now_ns):
            return None
        return plan_from_msgs(self._scene.status, self._scene.path, self._newest_ns["path"])

    def _drawn(self, plan: Plan | None) -> dict[str, Any]:
        """Return the path; how many of its points are borne out; which of them is the place to stop at."""
        there = None if plan is None else self._scene.history.at(plan.t_sensor_ns)
        if plan is None or there is None or not len(plan.path_m):
            return {"path_cm": []}
        along = lengths_along(plan.path_m)
        borne_out = int(np.searchsorted(along, plan.supported_m, side="right"))
        stop_m = plan.stop_distance_m
        stop = None if stop_m is None or stop_m > along[-1] else int(np.searchsorted(along, stop_m))
        return {"path_cm": _cm(to_odometry(there, plan.path_m)), "borne_out": borne_out, "stop": stop}

    def _words(self, plan: Plan | None, now_ns: int) -> Iterator[Row]:
        """Yield the lines on bridge, planner and controller, each with its level."""
        state = self._scene.state
        urgent = "warning" if state.as_state == AsState.AS_DRIVING else ""
        if state.emergency:
            yield f"bridge: ESTOP_REQUEST: {state.emergency}", "fault"
        for words in filter(None, (state.stopping, *state.gate_reasons)):
            yield f"bridge: {words}", "warning"
        if busy := loop_fault_words(state.loop_faults):
            yield f"bridge: {busy}", "warning"
        yield f"bridge: {state.phase}", ""
        for topic in ("detected_cones", "path"):
            if late := self._inputs[topic].silence(now_ns):
                yield late, urgent
        if self._scene.status.late and not self._inputs["planner_status"].silence(now_ns):
            yield f"planner: {self._scene.status.late}", urgent
        elif plan is not None:
            yield f"planner: {', '.join(_planned(plan))}", urgent if plan.note else ""
        if late := self._inputs["vehicle_cmd"].silence(now_ns):
            yield late, urgent
        elif self._command.note:
            yield f"controller: {self._command.note}", urgent
        else:
            finished = "the mission is finished" if self._command.mission_finished else ""
            yield f"controller: {finished or f'at most {self._command.speed_limit_mps:.1f} m/s'}", ""


def _planned(plan: Plan) -> Iterator[str]:
    if plan.note:
        yield plan.note
    if len(plan.path_m):
        along = " along its map" if plan.mapped else ""
        yield f"path of {lengths_along(plan.path_m)[-1]:.0f} m{along}, {100 * plan.confidence:.0f} % sure"
    if plan.stop_distance_m is not None:
        yield f"stop in {plan.stop_distance_m:.0f} m"


def _cm(rows: np.ndarray) -> list[int]:
    """Return rows as whole numbers: x, y in cm, and as it is what stands beside them, one after the other."""
    scaled = rows.copy()
    scaled[:, :2] *= 100.0
    whole: list[int] = np.rint(scaled).astype(int).ravel().tolist()
    return whole
