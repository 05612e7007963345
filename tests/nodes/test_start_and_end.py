"""The nodes as processes: bad input gets one clear line and a non-zero status; signals end them in order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime.bus import open_bus

LONG_S = 60.0
# Said where the machine held up the loop, and where the user may neither have real time nor lock memory.
OF_THE_MACHINE = (Reason.LOOP_FAULT.words, "the CAN loop reports", "LimitRTPRIO=", "LimitMEMLOCK=")


def start(module: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", f"fsai_nodes.{module}", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=dict(os.environ, PYTHONUNBUFFERED="1"),
    )


def parameters(**values: object) -> list[str]:
    return ["--ros-args", *(word for name, value in values.items() for word in ("-p", f"{name}:={value}"))]


def complaint(error_output: str) -> list[str]:
    """The lines that are not the log of a start."""
    return [line for line in error_output.splitlines() if "[INFO]" not in line]


def test_what_the_bridge_cannot_start_with_gets_one_clear_line() -> None:
    process = start("vcu_bridge", *parameters(can_interface="loopback:a", revision=2019))
    _, error_output = process.communicate(timeout=LONG_S)
    assert process.returncode == 1
    assert complaint(error_output) == ["vcu_bridge: parameter revision must be one of 2021, 2026, not '2019'"]


@pytest.mark.parametrize("variable", ["ROS_LOG_DIR", "ROS_HOME", "HOME"])
def test_without_a_place_for_log_files_a_node_starts_and_says_so(
    variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    for each in ("ROS_LOG_DIR", "ROS_HOME"):
        monkeypatch.delenv(each, raising=False)
    monkeypatch.setenv(variable, str(tmp_path / "file"))
    process = start("path_planner")
    assert process.stderr is not None
    try:
        line = next(line for line in process.stderr if "[INFO]" not in line)
        assert "[WARN]" in line and "no log files of ROS: " in line and str(tmp_path) in line
        process.send_signal(signal.SIGTERM)
        assert process.wait(LONG_S) == 0
    finally:
        process.kill()
        process.communicate()


def test_a_ros_that_would_not_start_gets_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "9999")
    process = start("path_planner")
    _, error_output = process.communicate(timeout=LONG_S)
    line = "path_planner: ROS 2 does not start: ROS_DOMAIN_ID is '9999', not a number from 0 to 232"
    assert (process.returncode, complaint(error_output)) == (1, [line])


@pytest.mark.parametrize("module", ["rclpy", "numpy"])
def test_ctrl_c_while_a_node_loads_ends_it_without_a_word(module: str) -> None:
    argv = [sys.executable, "-X", "importtime", "-m", "fsai_nodes.path_planner"]  # which says each that is loaded
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert any(f"| {module}" in " ".join(line.split()) for line in process.stderr)
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()  # communicate() would lose what this file has in its buffer already
    said = [line for line in complaint(rest) if not line.startswith("import time:")]
    assert said == [] and process.wait(LONG_S) in (0, -signal.SIGINT)


def test_an_occupied_truth_port_gets_one_clear_line() -> None:
    from fsai_hil.simulator.ground_truth import TruthReceiver

    with TruthReceiver(0) as occupied:
        process = start("sensor_simulator", *parameters(truth_port=occupied.port))
        _, error_output = process.communicate(timeout=LONG_S)
    assert process.returncode == 1
    assert len(complaint(error_output)) == 1 and str(occupied.port) in error_output


def test_an_unknown_node_cannot_be_composed() -> None:
    process = start("composed", "--nodes", "cone_detector,toaster")
    _, error_output = process.communicate(timeout=LONG_S)
    assert process.returncode == 2
    assert "toaster" in error_output and "path_planner" in error_output


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("lapz:=3", "unknown parameter lapz: did you mean laps?"),
        ("path_planner:max_speed:=3.0", "unknown parameter max_speed: path_planner has"),
    ],
)
def test_composed_nodes_refuse_what_none_of_them_has(given: str, words: str) -> None:
    process = start("composed", "--ros-args", "-p", given)
    _, error_output = process.communicate(timeout=LONG_S)
    assert process.returncode == 1
    lines = complaint(error_output)
    assert len(lines) == 1 and lines[0].startswith("composed: ") and words in lines[0], error_output


def test_a_parameter_for_every_node_is_taken_by_who_has_it(tmp_path: Path) -> None:
    file = tmp_path / "shared.yaml"
    file.write_text("/**:\n  ros__parameters:\n    max_speed: 3.0\n    lapz: 3\n    exposure_us: 900\n")
    process = start("composed", "--ros-args", "--params-file", str(file), "-p", "laps:=3")
    from ros_rig import RosRig

    with RosRig() as rig:
        wanted = {"cone_detector", "path_planner", "vehicle_controller"}
        rig.spin_until(lambda: wanted <= set(rig.tester.get_node_names()), "the three nodes", LONG_S)
    process.send_signal(signal.SIGTERM)
    _, error_output = process.communicate(timeout=LONG_S)
    assert process.returncode == 0
    (warning,) = complaint(error_output)
    assert "unknown parameter lapz: did you mean laps?" in warning and "path_planner" in warning


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_bridge_says_goodbye_before_it_falls_silent(number: signal.Signals, tmp_path: Path) -> None:
    name = f"loopback:goodbye-{os.getpid()}-{int(number)}"
    codec = Codec(revision("2026"))
    with open_bus(name) as bus:
        process = start("vcu_bridge", *parameters(can_interface=name))
        until = time.monotonic() + LONG_S
        frame: Frame | None = None
        while frame is None:
            assert time.monotonic() < until, "the bridge never sent"
            frame = bus.recv(0.1)
        process.send_signal(number)
        if number is signal.SIGHUP:  # the kernel and the shell both say it
            time.sleep(0.02)
            process.send_signal(number)
        assert process.wait(LONG_S) == 0
        last: dict[int, Frame] = {}
        while (frame := bus.recv(0.2)) is not None:
            last[frame.can_id] = frame
    _, error_output = process.communicate()
    assert sorted(last) == [0x510, 0x511, 0x512, 0x513, 0x514]
    for can_id in (0x511, 0x512, 0x513, 0x514):
        assert codec.decode(last[can_id]).image is not None
        assert not any(last[can_id].data[:2]), "at rest it leaves with zeros"
    assert [line for line in complaint(error_output) if not any(words in line for words in OF_THE_MACHINE)] == []


def test_the_planner_has_loaded_everything_before_the_first_run() -> None:
    code = (
        "import sys, rclpy; from fsai_nodes.path_planner import PathPlanner; rclpy.init(); PathPlanner();"
        "before = set(sys.modules); import fsai_vcu.core.planning.racing; sys.exit(set(sys.modules) != before)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
