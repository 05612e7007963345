"""A message stamped more than 20 ms ahead of now is refused by every node that reads stamps, and named in the log."""

from __future__ import annotations

import time

from nav_msgs.msg import Path
from ros_rig import RosRig, Stand, logged

from fsai_nodes import qos
from fsai_nodes.path_planner import PathPlanner
from fsai_nodes.vehicle_controller import VehicleController

AHEAD_MS = -60_000.0  # still ahead when a machine that was held up reads it


def test_the_planner_refuses_cones_and_states_of_the_future(rig: RosRig) -> None:
    log = rig.log()
    planner = rig.start(PathPlanner)
    rig.announce()
    stand = Stand(rig)
    paths = rig.subscribe(Path, "/path", qos.PLAN)

    def state_refused() -> bool:
        stand.state(run_id=6)  # of another run
        stand.state(age_ms=AHEAD_MS)
        return bool(logged(log, "/vehicle_state refused", "ms ahead"))

    def ready() -> bool:
        stand.state()
        return planner._motion is not None

    def cones_refused() -> bool:
        stand.cones(age_ms=AHEAD_MS)
        return bool(logged(log, "/detected_cones refused", "ms ahead"))

    def planned() -> bool:
        stand.cones()
        return bool(paths)

    began_s = time.monotonic()
    rig.spin_until(state_refused, "the state is refused")
    for _ in range(40):
        state_refused()
        rig.turns(1)
    assert planner._motion is None
    refusals = logged(log, "/vehicle_state refused")
    assert len(refusals) <= 1 + (time.monotonic() - began_s), "not one line for every message"
    rig.spin_until(ready, "the planner knows where the car is")
    rig.spin_until(cones_refused, "the cones are refused")
    assert paths == []
    rig.spin_until(planned, "cones of now are planned with")


def test_the_controller_refuses_a_path_of_the_future(rig: RosRig) -> None:
    log = rig.log()
    controller = rig.start(VehicleController)
    rig.announce()
    stand = Stand(rig)

    def refused() -> bool:
        stand.plan(age_ms=AHEAD_MS)
        return bool(logged(log, "/path refused", "ms ahead"))

    def taken() -> bool:
        stand.plan()
        return controller._plan is not None

    rig.spin_until(refused, "the path is refused")
    assert controller._plan is None

    def no_way() -> bool:
        stand.plan(poses=0)
        return controller._plan is not None and not len(controller._plan.path_m)

    rig.spin_until(taken, "a path of now is taken")
    rig.spin_until(no_way, "a path without points, which says that there is no way")
