"""The driving chain in one process, for a machine too small for five: one interpreter, one middleware, one thread.

    python -m fsai_nodes.composed [--nodes NAME,NAME...] [--ros-args ...]

The default leaves out vcu_bridge and sensor_simulator: the bridge is safest in a process of its own, and the simulator
is not for the car.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable

from rclpy.node import Node

from fsai_nodes.parameters import several_nodes

# In the order in which they start.
CLASSES = {
    "vcu_bridge": "VcuBridge",
    "sensor_simulator": "SensorSimulator",
    "cone_detector": "ConeDetector",
    "path_planner": "PathPlanner",
    "vehicle_controller": "VehicleController",
    "visualization": "Visualization",
}
DEFAULT = ("cone_detector", "path_planner", "vehicle_controller")


def factories(names: list[str]) -> list[Callable[[], Node]]:
    """Return the factories of the nodes called `names`, in order of CLASSES. Imports only those."""
    modules = {name: importlib.import_module(f"fsai_nodes.{name}") for name in CLASSES if name in names}
    several_nodes(module.SETTINGS for module in modules.values())
    return [getattr(module, CLASSES[name]) for name, module in modules.items()]


def main() -> int:
    parser = argparse.ArgumentParser(prog="composed", description="Several nodes in one process.")
    parser.add_argument("--nodes", default=",".join(DEFAULT), help=f"comma-separated, of {', '.join(CLASSES)}")
    arguments, for_ros = parser.parse_known_args()
    names = [name.strip() for name in arguments.nodes.split(",") if name.strip()]
    unknown = [name for name in names if name not in CLASSES]
    if unknown or not names:
        print(f"composed: unknown node '{', '.join(unknown)}': choose of {', '.join(CLASSES)}", file=sys.stderr)
        return 2

    from fsai_nodes.process import run

    return run(factories(names), "composed", [sys.argv[0], *for_ros])


if __name__ == "__main__":
    raise SystemExit(main())
