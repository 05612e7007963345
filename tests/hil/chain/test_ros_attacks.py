"""Whatever is said to the nodes on ROS while the car drives: they live, do not grow, and the car gets no torque by it.

The attacks are made of the messages' own definitions. tests/nodes/test_door.py has the short form, without a car.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from chain.conftest import START_S, Chain, rules_kept
from fsai_hil.rehearsal.stack import RunningProcess, await_condition

pytestmark = pytest.mark.long

SAID_S = 1200.0
GROWTH_MB = 64.0  # of one process, over all attacks: a message of each kind may be kept, and no more than that
TOPICS = {
    "raw_cones": "fsai_msgs/ConeArray",
    "detected_cones": "fsai_msgs/ConeArray",
    "path": "nav_msgs/Path",
    "planner_status": "fsai_msgs/PlannerStatus",
    "vehicle_cmd": "fsai_msgs/VehicleCommand",
    "vehicle_state": "fsai_msgs/VehicleState",
    "run_state": "fsai_msgs/RunState",
    "reset_confirmation": "fsai_msgs/ResetConfirmation",
}
SERVICES = {
    "vcu_bridge/get_parameters": "rcl_interfaces/GetParameters",
    "vcu_bridge/describe_parameters": "rcl_interfaces/DescribeParameters",
    "path_planner/set_parameters_atomically": "rcl_interfaces/SetParametersAtomically",
    "vcu_bridge/change_state": "lifecycle_msgs/ChangeState",
    "set_mode": "fsai_msgs/SetMode",
    "reset": "std_srvs/Trigger",
    "emergency_brake": "std_srvs/Trigger",
}
NODES = ("vcu_bridge", "path_planner", "vehicle_controller", "cone_detector", "sensor_simulator")


@pytest.fixture(scope="module")
def attacker(chain: Chain, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningProcess]:
    argv = ["nice", "-n", "19", sys.executable, str(Path(__file__).with_name("ros_attacker.py"))]
    log = tmp_path_factory.mktemp("attacks") / "attacker.log"
    process = RunningProcess("attacker", argv, log, chain.stack.environ, stdin=subprocess.PIPE)
    try:
        process.await_log("ready", START_S)
        yield process
    finally:
        process.stop()


def memory_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024


def attacked(chain: Chain, attacker: RunningProcess, results: Path, line: str) -> None:
    """The car drives, `line` is said, and everything is as it should be."""
    with chain.drive(results) as wire:
        pids = chain.pids
        before = {name: memory_mb(pid) for name, pid in pids.items()}
        attacker.type(line)

        def said() -> bool:
            chain.operator.spin()
            return any(each in attacker.log() for each in (f"done {line}:", f"failed {line}:"))

        await_condition(said, SAID_S, f"all of '{line}' is said")
    assert f"failed {line}:" not in attacker.log(), attacker.log()[-500:]
    chain.stack.check_alive()
    assert chain.pids == pids, "nothing was started again"
    grown = {name: memory_mb(pid) - before[name] for name, pid in pids.items()}
    print(f"{line}: grown by", ", ".join(f"{name} {by:.1f} MB" for name, by in grown.items()))
    assert all(by < GROWTH_MB for by in grown.values()), grown
    rules_kept(wire)


@pytest.mark.parametrize("name", TOPICS)
def test_nothing_said_on_a_topic_ends_a_node(chain: Chain, attacker: RunningProcess, results: Path, name: str) -> None:
    lines = {each: chain.stack.processes[each].log().count("refused: ") for each in NODES}
    attacked(chain, attacker, results, f"topic {name} {TOPICS[name]}")
    more = {each: chain.stack.processes[each].log().count("refused: ") - count for each, count in lines.items()}
    assert any(more.values()), "what was refused is said"


@pytest.mark.parametrize("node", NODES)
def test_no_value_of_a_parameter_ends_a_node(chain: Chain, attacker: RunningProcess, results: Path, node: str) -> None:
    attacked(chain, attacker, results, f"parameters {node}")


def test_no_goal_ends_the_bridge(chain: Chain, attacker: RunningProcess, results: Path) -> None:
    attacked(chain, attacker, results, "action run_mission fsai_msgs/RunMission")


@pytest.mark.parametrize("name", SERVICES)
def test_no_request_ends_a_node(chain: Chain, attacker: RunningProcess, results: Path, name: str) -> None:
    attacked(chain, attacker, results, f"service {name} {SERVICES[name]}")
