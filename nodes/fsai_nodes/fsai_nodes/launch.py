"""Start the processes that drive, with their arguments, where there is no `ros2 launch`.

    python -m fsai_nodes.launch simulated_car:=true mission:=autocross        (--show-args lists the arguments)

launch/fsai.launch.py declares the same arguments and starts the same processes.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from fsai_hil.rehearsal.stack import PLOT, VERDICT, simulated_car
from fsai_hil.rehearsal.stall_monitor import BUSY_NS, StallMonitor, on_wall_clock
from fsai_hil.simulator.ground_truth import DEFAULT_PORT
from fsai_hil.simulator.tracks import NAMES as TRACKS
from fsai_hil.vcan.native import INTERFACE, existing_vcan
from fsai_nodes.composed import CLASSES
from fsai_nodes.parameters import misspelt, yaml_of
from fsai_vcu.diagnostics.log.recorded import note_stalls
from fsai_vcu.diagnostics.transmit.replaying import is_physical
from fsai_vcu.interface.enums import Ami

# launch argument, which is a parameter -> the nodes that get it
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "can_interface": ("vcu_bridge",),
    "revision": ("vcu_bridge",),
    "car": ("vcu_bridge", "path_planner", "vehicle_controller"),
    "limits": ("vcu_bridge",),
    "listen_only": ("vcu_bridge",),
    "autonomous_at_power_up": ("vcu_bridge",),
    "noise_level": ("sensor_simulator",),
    "truth_port": ("sensor_simulator",),
    "confidence_threshold": ("cone_detector",),
    "laps": ("path_planner",),
    "max_speed": ("vehicle_controller",),
    "lap_max_speed": ("vehicle_controller",),
    "race_max_speed": ("vehicle_controller",),
    "skidpad_max_speed": ("vehicle_controller",),
    "acceleration_max_speed": ("vehicle_controller",),
}
CLI = "fsai_vcu.cli.main"
_STOP_TIMEOUT_S = 15.0  # time for the bridge's goodbye to the car


@dataclass(frozen=True, slots=True)
class Argument:
    """One launch argument. `choices`: empty where any text is one."""

    name: str
    default: str
    words: str
    choices: tuple[str, ...] = ()


_FLAG = ("true", "false")
_OTHERS = (
    Argument("params_file", "", "Parameter file; arguments override it. Empty: the package's fsai.yaml."),
    Argument("simulated", "true", "Start the sensor simulator.", _FLAG),
    Argument("simulated_car", "false", "Start the simulated VCU and car: it drives a mission, and all ends.", _FLAG),
    Argument(
        "mission",
        "autocross",
        "Mission of the simulated car.",
        tuple(ami.name.lower() for ami in Ami if ami is not Ami.NOT_SELECTED),
    ),
    Argument("track", "", f"Track of the simulated car: a file, or {', '.join(TRACKS)}. Empty: the mission's own."),
    Argument("seed", "0", "Seed of everything random in the simulated car."),
    Argument("without", "", "Nodes that are not started, separated by commas: those your own stack replaces."),
    Argument("composed", "false", "All nodes but the bridge in one process.", _FLAG),
    Argument("pitwall", "false", "Show bus and nodes live on a web page: fsai-vcu pitwall --ros.", _FLAG),
    Argument(
        "record",
        "",
        "Folder in which this run is kept: the log of its bus, and the simulated car's verdict.json and run.png. "
        "Empty: nothing is kept.",
    ),
    Argument("markers", "false", "Start visualization: /markers, the car's model and frames.", _FLAG),
    Argument("rviz", "false", "Open RViz with what visualization publishes; starts that, too (ros2 launch).", _FLAG),
)


def arguments() -> tuple[Argument, ...]:
    """All of them. Those that are parameters are described as the nodes describe them; empty: the file's value."""
    return (*_OTHERS, *_of_the_nodes())


def _of_the_nodes() -> Iterator[Argument]:
    for name, nodes in PARAMETERS.items():
        (setting,) = (each for each in import_module(f"fsai_nodes.{nodes[0]}").SETTINGS if each.name == name)
        choices = _FLAG if isinstance(setting.default, bool) else setting.choices
        yield Argument(name, "", setting.description, ("", *choices) if choices else ())


@dataclass(frozen=True, slots=True)
class Program:
    """One process: the module it is, its own words, and those for ROS. needed: with its end all end."""

    name: str
    module: str
    words: tuple[str, ...] = ()
    ros_words: tuple[str, ...] = ()
    needed: bool = True

    @property
    def argv(self) -> list[str]:
        ros = ("--ros-args", *self.ros_words) if self.ros_words else ()
        return [sys.executable, "-m", self.module, *self.words, *ros]


def programs(given: Mapping[str, str]) -> list[Program]:
    """Return what is to be started by the arguments given. Raises ValueError with one clear line."""
    known = {each.name: each for each in arguments()}
    wrong = misspelt(given, known)
    if wrong:
        raise ValueError(wrong)
    texts = {name: given.get(name, each.default) for name, each in known.items()}
    for name, text in texts.items():
        if known[name].choices and text not in known[name].choices:
            raise ValueError(f"{name}:={text}: choose of {', '.join(filter(None, known[name].choices))}")
    on = {name: text == "true" for name, text in texts.items()}
    without = {name.strip() for name in texts["without"].split(",") if name.strip()}
    if without - set(CLASSES):
        raise ValueError(f"without:={texts['without']}: choose of {', '.join(CLASSES)}")

    car = []
    if on["simulated_car"]:
        texts["can_interface"] = texts["can_interface"] or (INTERFACE if existing_vcan() else "loopback:fsai")
        if is_physical(texts["can_interface"]):
            raise ValueError(f"can_interface:={texts['can_interface']}: a simulated car is for a virtual bus only")
        # Nobody is there to choose the mode.
        texts["autonomous_at_power_up"] = texts["autonomous_at_power_up"] or "true"
        options = {name: texts[name] for name in ("mission", "revision", "seed", "laps", "track") if texts[name]}
        if texts["record"]:
            options |= {"result": str(Path(texts["record"], VERDICT)), "plot": str(Path(texts["record"], PLOT))}
        port = texts["truth_port"] or str(DEFAULT_PORT)
        if not (port.isdecimal() and 0 < int(port) < 1 << 16):
            raise ValueError(f"truth_port:={port}: not a port's number")
        words = simulated_car(texts["can_interface"], int(port), options)
        car = [Program("simulated_car", CLI, tuple(words))]

    if not on["simulated"]:
        without.add("sensor_simulator")
    if not (on["markers"] or on["rviz"]):
        without.add("visualization")
    nodes = [name for name in CLASSES if name not in without]
    file = texts["params_file"] or default_file()
    together = [name for name in nodes if name != "vcu_bridge"] if on["composed"] else []
    started = [Program(name, f"fsai_nodes.{name}", (), _ros_words([name], texts, file)) for name in nodes]
    if together:
        words = ("--nodes", ",".join(together))
        composed = Program("composed", "fsai_nodes.composed", words, _ros_words(together, texts, file))
        started = [each for each in started if each.name not in together] + [composed]
    bus = texts["can_interface"] or bus_of(file)
    beside = [Program("pitwall", CLI, ("pitwall", bus, "--ros"), needed=False)] if on["pitwall"] else []
    if texts["record"]:
        beside.append(Program("recorder", CLI, ("record", bus, "-o", texts["record"]), needed=False))
    return [*started, *beside, *car]


def _ros_words(nodes: Sequence[str], texts: Mapping[str, str], file: str) -> tuple[str, ...]:
    """The parameter file, and on top the arguments given; of several nodes in one process by the nodes' names."""
    words = ["--params-file", file]
    for name, takers in PARAMETERS.items():
        for node in nodes:
            if texts[name] and node in takers:
                prefix = f"{node}:" if len(nodes) > 1 else ""
                words += ["-p", f"{prefix}{name}:={texts[name]}"]
    return tuple(words)


def default_file() -> str:
    """The package's parameter file: of the workspace, or of the pip environment."""
    try:
        share = get_package_share_directory("fsai_nodes")
    except (PackageNotFoundError, OSError):  # no workspace, or another's; no ROS setup file at all
        share = str(Path(sys.prefix, "share", "fsai_nodes"))
    return str(Path(share, "config", "fsai.yaml"))


def bus_of(file: str) -> str:
    """The bus that a parameter file gives the bridge, or its default."""
    content = yaml_of(file)
    try:
        return str(content["vcu_bridge"]["ros__parameters"]["can_interface"])  # type: ignore[index]
    except (TypeError, KeyError):
        return INTERFACE


def run(started: Sequence[Program]) -> int:
    """Start them all; when a needed one ends, or on SIGINT or SIGTERM, end the others. The status is that of the
    needed process.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    processes: dict[int, tuple[Program, subprocess.Popen[bytes]]] = {}
    try:
        # A Ctrl-C at the terminal is for this process, which ends the others in order.
        for program in started:
            process = subprocess.Popen(program.argv, stdin=subprocess.DEVNULL, start_new_session=True)
            processes[process.pid] = program, process
        needed = False
        while not needed:
            pid, code = os.wait()
            program, process = processes[pid]
            process.returncode = status = os.waitstatus_to_exitcode(code)
            needed = program.needed
            then = "the others are ended" if needed else "the others go on"
            print(f"launch: {program.name} has ended with status {status}; {then}", file=sys.stderr)
    except KeyboardInterrupt:
        status = 130
    except OSError as error:
        print(f"launch: {error}", file=sys.stderr)
        status = 1
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the others are being ended
    for _, process in processes.values():
        process.terminate()
    for _, process in processes.values():
        try:
            process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    return status


def rehearsed(started: Sequence[Program], folder: str) -> tuple[int, str]:
    """Run the programs as `run` does; return also how this computer was too busy meanwhile, in words, or ''.

    When it was is written beside the logs in `folder`, if one is named: what is said of them later needs it.
    """
    with tempfile.TemporaryDirectory(prefix="fsai-launch-") as notes, StallMonitor(Path(notes, "stalls")) as monitor:
        since_ns = time.monotonic_ns()
        status = run(started)
        if folder:
            note_stalls(Path(folder), on_wall_clock(monitor.stalls(since_ns, BUSY_NS)))
        return status, monitor.disturbed(since_ns, BUSY_NS)


def _shown(each: Argument) -> str:
    choices = f"\n    one of: {', '.join(filter(None, each.choices))}" if each.choices else ""
    return f"{each.name}:={each.default}\n    {each.words}{choices}"


def main() -> int:
    """Run the command line: list the arguments, or start the processes; return the exit status."""
    words = sys.argv[1:]
    if {"-h", "--help", "--show-args"} & set(words):
        print(__doc__, *map(_shown, arguments()), sep="\n")
        return 0
    given = dict(word.split(":=", 1) for word in words if ":=" in word)
    unknown = [word for word in words if ":=" not in word] or sorted(set(given) - {each.name for each in arguments()})
    try:
        started = programs(given)
        if unknown:
            raise ValueError(f"'{unknown[0]}' is not an argument like mission:=autocross; --show-args lists them")
        if given.get("rviz") == "true":
            raise ValueError("rviz:=true is for ros2 launch, which opens RViz; markers:=true sends what it shows")
    except ValueError as error:
        print(f"launch: {error}", file=sys.stderr)
        return 2
    folder = given.get("record", "")
    status, busy = rehearsed(started, folder) if given.get("simulated_car") == "true" else (run(started), "")
    if folder:
        verb = os.path.relpath(Path(sys.executable).with_name("fsai-vcu"))
        print(f"launch: this run is in {folder}; why it ended: {verb} explain {folder}", file=sys.stderr)
    if busy and status not in (0, 130):  # a person ended it
        then = "too busy for the car's deadlines: this run is not judged; drive again with less running beside it"
        print(f"launch: this computer {busy}, {then}", file=sys.stderr)
    return status


if __name__ == "__main__":
    raise SystemExit(main())
