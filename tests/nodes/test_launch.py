"""What is started by which arguments: by `ros2 launch`, with launch's classes as stand-ins, and without it."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from fsai_hil.rehearsal.stall_monitor import StallMonitor
from fsai_nodes import composed, launch
from fsai_nodes.launch import PARAMETERS, Program, arguments, programs
from fsai_vcu.diagnostics.log.recorded import recorded
from fsai_vcu.interface.units import MS

CHECKOUT = Path(__file__).parents[2]
LAUNCH_FILE = CHECKOUT / "nodes" / "fsai_nodes" / "launch" / "fsai.launch.py"
CHAIN = {"vcu_bridge", "sensor_simulator", "cone_detector", "path_planner", "vehicle_controller"}
CLASSES = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument", "ExecuteProcess", "OpaqueFunction", "Shutdown"),
    "launch.substitutions": ("PathJoinSubstitution",),
    "launch_ros.actions": ("Node",),
    "launch_ros.substitutions": ("FindPackageShare",),
}


class Recorded:
    """Whatever launch's classes are made with."""

    def __init__(self, *words: Any, **options: Any) -> None:
        self.words, self.options = words, options


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.setitem(sys.modules, "launch_ros", ModuleType("launch_ros"))
    for name, classes in CLASSES.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, each, type(each, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(LAUNCH_FILE))


def started(**given: str) -> dict[str, Program]:
    return {program.name: program for program in programs({"params_file": "p.yaml", **given})}


def test_every_argument_is_declared_with_words_and_choices(launch_file: dict[str, Any]) -> None:
    *declared, start = launch_file["generate_launch_description"]().words[0]
    assert type(start).__name__ == "OpaqueFunction"
    assert [each.words[0] for each in declared] == [each.name for each in arguments()]
    assert len({each.words[0] for each in declared}) == len(declared) > len(PARAMETERS)
    for each in declared:
        options = each.options
        assert len(options["description"]) > 10, each.words
        assert options["choices"] is None or options["default_value"] in options["choices"], each.words
    with_choice = {each.words[0] for each in declared if each.options["choices"]}
    assert {"revision", "car", "listen_only", "mission", "simulated_car", "rviz"} <= with_choice


def test_ros2_launch_starts_the_same_and_ends_with_the_car(launch_file: dict[str, Any]) -> None:
    given = {"simulated_car": "true", "max_speed": "5.0", "params_file": "p.yaml", "somebody_elses": "x"}
    *nodes, car = launch_file["start"](SimpleNamespace(launch_configurations=given))
    wanted = started(simulated_car="true", max_speed="5.0")
    assert {node.options["executable"] for node in nodes} == CHAIN == set(wanted) - {"simulated_car"}
    for node in nodes:
        assert tuple(node.options["ros_arguments"]) == wanted[node.options["executable"]].ros_words
    assert car.options["cmd"] == wanted["simulated_car"].argv
    assert [type(each).__name__ for each in car.options["on_exit"]] == ["Shutdown"]


def test_the_car_and_the_bridge_meet_on_one_bus_and_one_run() -> None:
    found = started(simulated_car="true", can_interface="loopback:x", laps="2", revision="2021", truth_port="26000")
    car = " ".join(found["simulated_car"].argv)
    assert "vcu -i loopback:x --auto --truth 26000 --mission=autocross --revision=2021 --seed=0 --laps=2" in car
    bridge = found["vcu_bridge"].ros_words
    assert {"can_interface:=loopback:x", "revision:=2021", "autonomous_at_power_up:=true"} <= set(bridge)
    assert "truth_port:=26000" in found["sensor_simulator"].ros_words
    assert "laps:=2" in found["path_planner"].ros_words
    assert "simulated_car" not in started(can_interface="can0")
    assert "autonomous_at_power_up:=true" not in started(can_interface="can0")["vcu_bridge"].ros_words


def test_what_is_started_is_what_was_asked_for() -> None:
    assert set(started()) == CHAIN
    assert set(started(simulated="false", markers="true")) == CHAIN - {"sensor_simulator"} | {"visualization"}
    assert set(started(without="path_planner, vehicle_controller")) == CHAIN - {"path_planner", "vehicle_controller"}
    together = started(composed="true", laps="3", without="cone_detector")
    assert set(together) == {"vcu_bridge", "composed"}
    assert together["composed"].words == ("--nodes", "sensor_simulator,path_planner,vehicle_controller")
    assert together["composed"].ros_words == ("--params-file", "p.yaml", "-p", "path_planner:laps:=3")


def test_the_pit_wall_is_a_process_of_its_own_on_the_same_bus(launch_file: dict[str, Any], tmp_path: Path) -> None:
    found = started(pitwall="true", composed="true", can_interface="loopback:x")
    assert found["pitwall"].argv[1:] == ["-m", "fsai_vcu.cli.main", "pitwall", "loopback:x", "--ros"]
    file = tmp_path / "car.yaml"
    file.write_text("vcu_bridge: {ros__parameters: {can_interface: can7}}\n")
    assert "can7" in started(pitwall="true", params_file=str(file))["pitwall"].words
    assert "vcan0" in started(pitwall="true")["pitwall"].words
    context = SimpleNamespace(launch_configurations={"pitwall": "true", "params_file": "p.yaml"})
    assert launch_file["start"](context)[-1].options["on_exit"] is None  # nobody's drive ends with it


def test_a_run_is_kept_in_the_folder_that_is_named() -> None:
    found = started(simulated_car="true", record="runs/7", can_interface="loopback:x")
    assert found["recorder"].words == ("record", "loopback:x", "-o", "runs/7") and not found["recorder"].needed
    assert {"--result=runs/7/verdict.json", "--plot=runs/7/run.png"} <= set(found["simulated_car"].words)
    assert "--plot" not in " ".join(started(simulated_car="true")["simulated_car"].words)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"lapz": "3"}, "unknown argument lapz: did you mean laps?"),
        ({"mission": "drag race"}, "mission:=drag race: choose of acceleration, skidpad"),
        ({"listen_only": "yes"}, "listen_only:=yes: choose of true, false"),
        ({"without": "planner"}, "without:=planner: choose of vcu_bridge"),
        ({"simulated_car": "true", "can_interface": "loopback:x", "truth_port": "abc"}, "abc: not a port's number"),
    ],
)
def test_a_wrong_argument_is_refused_in_one_line(given: dict[str, str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        programs(given)


def test_without_launch_the_first_needed_that_ends_ends_all(tmp_path: Path) -> None:
    (tmp_path / "watches.py").write_text("import os; open('pid', 'w').write(f'{os.getpid()}.')")
    (tmp_path / "fails.py").write_text(
        "import os, pathlib, sys, time\npid = pathlib.Path('pid')\n"
        "while not (pid.exists() and pid.read_text().endswith('.')): time.sleep(0.01)\n"
        "try:\n    while not time.sleep(0.01): os.kill(int(pid.read_text()[:-1]), 0)\n"
        "except ProcessLookupError:\n    sys.exit(3)\n"
    )
    code = (
        "import sys; from fsai_nodes.launch import Program, run;"
        "sys.exit(run([Program('waits', 'http.server', ('0', '--bind', '127.0.0.1')), Program('fails', 'fails'),"
        " Program('watches', 'watches', needed=False)]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, cwd=tmp_path)
    assert done.returncode == 3
    said = [line for line in done.stderr.splitlines() if line.startswith("launch: ")]
    assert said == [
        "launch: watches has ended with status 0; the others go on",
        "launch: fails has ended with status 3; the others are ended",
    ]


@pytest.mark.parametrize(("status", "stalls_ms", "judged"), [(1, [12, 109], False), (1, [12], True), (0, [109], True)])
def test_a_drive_that_fails_on_a_busy_computer_says_so_last(
    status: int,
    stalls_ms: list[int],
    judged: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(launch, "run", lambda started: status)
    stalls = [(begin_ns, begin_ns + length_ms * MS) for begin_ns, length_ms in enumerate(stalls_ms)]
    monkeypatch.setattr(StallMonitor, "stalls", lambda _, since, least: [(a, b) for a, b in stalls if b - a >= least])
    given = ("simulated_car:=true", f"record:={tmp_path}", "can_interface:=loopback:x")
    monkeypatch.setattr(sys, "argv", ["launch", *given])
    (tmp_path / "run.log").touch()
    (tmp_path / "run.json").write_text('{"lost_in_receive_buffer": 0}')
    assert launch.main() == status
    noted = [round((end_ns - begin_ns) / MS) for begin_ns, end_ns in recorded(tmp_path / "run.log").stalls_ns]
    assert noted == [length_ms for length_ms in stalls_ms if length_ms >= 50]
    last = capsys.readouterr().err.splitlines()[-1]
    busy = "launch: this computer stood still for 109 ms, too busy for the car's deadlines: this run is not judged"
    assert ("why it ended" in last) if judged else last.startswith(busy)


def test_without_launch_the_arguments_are_listed_and_checked() -> None:
    def launched(*words: str) -> subprocess.CompletedProcess[str]:
        argv = [sys.executable, "-m", "fsai_nodes.launch", *words]
        return subprocess.run(argv, capture_output=True, text=True, timeout=300)

    listed = launched("--show-args")
    assert listed.returncode == 0 and all(f"\n{each.name}:={each.default}\n" in listed.stdout for each in arguments())
    for word in ("zebra:=1", "rviz:=true"):
        refused = launched(word)
        assert refused.returncode == 2 and refused.stderr.count("\n") == 1 and word[:4] in refused.stderr


def test_each_executable_lies_where_ros2_run_looks() -> None:
    folder = Path(sys.prefix, "lib", "fsai_nodes")
    assert {*composed.CLASSES, "composed", "ackermann_adapter"} == {each.name for each in folder.iterdir()}
    assert all(os.access(each, os.X_OK) for each in folder.iterdir())


def test_arguments_of_launch_in_the_documentation_exist() -> None:
    pages = [*CHECKOUT.glob("*.md"), *CHECKOUT.glob("docs/*.md"), *CHECKOUT.glob("nodes/*.md")]
    lines = [(page.name, line) for page in pages for line in page.read_text().replace("\\\n", " ").splitlines()]
    commands = [(page, line) for page, line in lines if re.search(r"(launch fsai_nodes|fsai_nodes\.launch) ", line)]
    written = {(page, name) for page, line in commands for name in re.findall(r"\b([a-z_]+):=", line)}
    assert ("computers.md", "can_interface") in written
    known = {each.name for each in arguments()}
    assert {(page, name) for page, name in written if name not in known} == set()
