"""One file for the whole AI computer, /etc/fsai/fsai.toml: read, checked, and turned into every node's parameters.

`KEYS` is the one place that says what may stand in the file and which parameter of which node it becomes. What cannot
be used is refused with file, line and key, all of it at once; the operational limits stand in a file of their own,
because an official imposes them and nobody else may change them with the rest.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from msgspec import field

from fsai_vcu.core.control.settings import CONTROLLER_RANGES, NO_SPEED_LIMIT_MPS, ControllerSettings
from fsai_vcu.core.limits import LimitsError, OperationalLimits
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.settings import PLANNER_RANGES, PlannerSettings
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.files import SETTINGS_BYTES, read_named
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.interface.values import Value
from fsai_vcu.interface.wheels import WHEELS, WheelMapping
from fsai_vcu.runtime.limits_file import read_limits
from fsai_vcu.runtime.toml_lines import TomlLines, line_of, parse_toml, tomllib, words_of
from fsai_vcu.runtime.transport import LOOPBACK, NETWORKS

USUAL_PATH = Path("/etc/fsai/fsai.toml")
SAME_AS_REVISION = "same_as_revision"
BITRATE = 500_000  # interface specification v4.0: 500 kbit/s
_SHORT = 60  # characters of a value in a sentence about it
QUEUE_FRAMES = 10  # two cycles of commands; more would be stale before they left

# Forms that a text must have, and the words for them. Services run in /, where a path that is not whole leads nowhere.
_BUS = (r"[\w.-]{1,15}|[\w-]+:\S+", "a CAN interface such as can0, or KIND:CHANNEL")  # linux/if.h: IFNAMSIZ
_PATH = (r"/[^\0]*", "a whole path, from / on")
_PATH_OR_EMPTY = (rf"({_PATH[0]})?", _PATH[1])

Plain = bool | int | float | str

_CONFIG = BridgeConfig()
_CONTROLLER = ControllerSettings()
_PLANNER = PlannerSettings()
_MISSIONS = MissionSettings()


class ConfigurationError(UserError):
    """The configuration cannot be used. `problems` has one line each; the message is the first, and says how many."""

    def __init__(self, problems: list[str]) -> None:
        self.problems = tuple(problems)
        more = len(problems) - 1
        super().__init__(problems[0] + (f" (and {more} more: fsai-vcu config check shows all)" if more else ""))


class Key(Value, frozen=True):
    """One setting of the file: `name` in `[table]`. `node`: whose `parameter` it becomes, unchanged."""

    table: str
    name: str
    default: object
    meaning: str
    node: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    shape: tuple[str, str] | None = None

    @property
    def spelt(self) -> str:
        return f"[{self.table}] {self.name}"

    @property
    def parameter(self) -> str:
        """Name of the ROS parameter: a speed has no unit in it, the laps no mission."""
        return self.name.removeprefix("trackdrive_").removesuffix("_mps")

    def problem(self, value: object) -> str | None:
        """Say why `value` cannot stand there, as the end of a sentence about it."""
        if isinstance(self.default, WheelMapping):
            return _mapping_problem(value)
        if isinstance(self.default, tuple):
            if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
                return f'must be a list of texts, such as ["/etc/fsai/car.dbc"], not {_short(value)}'
            return next((problem for each in value if (problem := self._shape_problem(each))), None)
        if isinstance(self.default, bool):
            return None if isinstance(value, bool) else f"must be true or false, not {_short(value)}"
        if isinstance(self.default, str):
            return self._text_problem(value)
        return self._number_problem(value)

    def _text_problem(self, value: object) -> str | None:
        if not isinstance(value, str):
            example = str(value) if str(value) in self.choices else self.choices[-1] if self.choices else self.default
            return f'must be a text in quotes, such as "{example}", not {_short(value)}'
        if self.choices and value not in self.choices:
            return f"must be one of {', '.join(self.choices)}, not {_short(value)}{_nearest(value, self.choices)}"
        return self._shape_problem(value)

    def _shape_problem(self, value: str) -> str | None:
        if self.shape is None or re.fullmatch(self.shape[0], value, re.ASCII):
            return None
        return f"must be {self.shape[1]}, not {_short(value)}"

    def _number_problem(self, value: object) -> str | None:
        whole = isinstance(self.default, int)
        kinds = (int,) if whole else (int, float)
        if isinstance(value, bool) or not isinstance(value, kinds):
            return f"must be a {'whole ' if whole else ''}number, not {_short(value)}"
        if not math.isfinite(value):
            return f"must be a finite number, not {value}"
        if self.low is not None and self.high is not None and not self.low <= value <= self.high:
            return f"must be between {self.low:g} and {self.high:g}, not {value:g}"
        return None


Ranges = Mapping[str, tuple[float, float]]
BRAKE_RANGES_PCT: Ranges = {"holding_brake_pct": (0.0, 100.0), "stop_brake_pct": (10.0, 100.0)}


def _of(table: str, node: str, settings: object, ranges: Ranges, **meanings: str) -> Iterator[Key]:
    """Numbers of `settings`, by their names there."""
    for name, meaning in meanings.items():
        yield Key(table, name, getattr(settings, name), meaning, node, *ranges[name])


def _of_the_bridge(table: str, name: str, meaning: str, choices: tuple[str, ...] = ()) -> Key:
    return Key(table, name, getattr(_CONFIG, name), meaning, "vcu_bridge", choices=choices)


_NEVER_SEND = "never send: any frame sent energises the tractive system and arms the EBS"
_AT_POWER_UP = "enter mode autonomous without being asked, when the car is seen at rest in AS_INIT or AS_OFF"
_CARS = (SAME_AS_REVISION, *CARS)
_LIMITS = "operational limits, imposed by an official; empty: none but the car's own"
_CONFIDENCE = "raw cones with a lower confidence are dropped"
_BRAKES = "how the car is held and stopped; motor is for the official simulator"
_KEYSTORE = "SROS2 keystore that fsai-vcu enclaves has made; empty: no encryption, no permissions"
_DISCOVERY_WORDS = "who may find the nodes: this machine only, or also its networks (needs a keystore)"

KEYS: tuple[Key, ...] = (
    Key("can", "interface", "can0", "the bus of the car; a service has its own, fsai-bridge@can0", shape=_BUS),
    Key("can", "revision", "2026", "revision of the car's CAN interface", "vcu_bridge", choices=tuple(REVISIONS)),
    Key(
        "can", "dbc_files", (), "DBC files to use instead of the revision's own; empty: the revision's own", shape=_PATH
    ),
    _of_the_bridge("can", "listen_only", _NEVER_SEND),
    Key("car", "parameters", SAME_AS_REVISION, "whose masses, lengths and actuators", choices=_CARS),
    Key(
        "car",
        "wheel_mapping",
        WheelMapping(),
        "the input of each wheel's sensor; find it with fsai-vcu doctor --wheels",
    ),
    _of_the_bridge("car", "autonomous_at_power_up", _AT_POWER_UP),
    _of_the_bridge("car", "service_brake", _BRAKES, ("hydraulic", "motor")),
    *_of(
        "car",
        "vcu_bridge",
        _CONFIG,
        BRAKE_RANGES_PCT,
        holding_brake_pct="brake that holds the car at rest",
        stop_brake_pct="brake of a service-brake stop",
    ),
    Key("limits", "file", "", _LIMITS, shape=_PATH_OR_EMPTY),
    Key("missions", "trackdrive_laps", _MISSIONS.trackdrive_laps, "laps of a trackdrive", "path_planner", 1, 100),
    *_of(
        "missions",
        "vehicle_controller",
        _CONTROLLER,
        CONTROLLER_RANGES,
        max_speed_mps=f"highest speed in every mission; {NO_SPEED_LIMIT_MPS:g}: not limited",
        lap_max_speed_mps=f"highest speed on laps without a map; above {_CONTROLLER.careful_mps:g} only where the"
        " cones seen confirm the path well and the car can stop within sight",
        race_max_speed_mps="highest speed on laps whose path follows a map",
        skidpad_max_speed_mps="highest speed in the skidpad",
        acceleration_max_speed_mps="highest speed in the acceleration",
    ),
    Key("perception", "confidence_threshold", 0.5, _CONFIDENCE, "cone_detector", 0.0, 1.0),
    *_of(
        "perception",
        "path_planner",
        _PLANNER,
        PLANNER_RANGES,
        range_max_m="cones further away are not used",
        horizon_m="how far to look for the lane",
    ),
    Key("ros", "domain_id", 0, "ROS_DOMAIN_ID of the car", low=0, high=101),
    Key("ros", "discovery", "localhost", _DISCOVERY_WORDS, choices=("localhost", "subnet")),
    Key("ros", "keystore", "", _KEYSTORE, shape=_PATH_OR_EMPTY),
    Key("recording", "folder", "/var/log/fsai", "where bus logs are kept", shape=_PATH),
    Key("recording", "keep_mib", 20_000, "space for all logs; the oldest are deleted first", low=100, high=10_000_000),
    Key("recording", "leave_free_mib", 2_000, "room that recording leaves to others on that disk", low=0, high=10**7),
)
_BY_PLACE = {(key.table, key.name): key for key in KEYS}
TABLES = tuple(dict.fromkeys(key.table for key in KEYS))

_DISCOVERY = {"localhost": LOOPBACK, "subnet": NETWORKS}


class Configuration(Value, frozen=True):
    """Content of the configuration file, with the defaults for what it leaves out. `limits`: None where no file is
    named.
    """

    path: Path | None
    limits: OperationalLimits | None = None
    values: Mapping[tuple[str, str], object] = field(default_factory=dict)

    def value(self, table: str, name: str) -> object:
        return self.values.get((table, name), _BY_PLACE[table, name].default)

    def text(self, table: str, name: str) -> str:
        return str(self.value(table, name))

    def number(self, table: str, name: str) -> float:
        value = self.value(table, name)
        assert isinstance(value, (int, float)), "checked when it was read"
        return value

    @property
    def interface(self) -> str:
        return self.text("can", "interface")

    @property
    def revision(self) -> str:
        return self.text("can", "revision")

    @property
    def car(self) -> str:
        """A name in CARS."""
        name = self.text("car", "parameters")
        return self.revision if name == SAME_AS_REVISION else name

    @property
    def wheel_mapping(self) -> WheelMapping:
        value = self.value("car", "wheel_mapping")
        assert isinstance(value, WheelMapping), "checked when it was read"
        return value

    @property
    def dbc_files(self) -> tuple[str, ...]:
        value = self.value("can", "dbc_files")
        assert isinstance(value, (list, tuple)), "checked when it was read"
        return tuple(value)

    @property
    def limits_path(self) -> Path | None:
        name = self.text("limits", "file")
        return Path(name) if name else None

    def parameters(self, interface: str | None = None) -> dict[str, dict[str, Plain]]:
        """Every node's parameters by node name. `interface`: instead of the file's."""
        found: dict[str, dict[str, Plain]] = {
            "vcu_bridge": {"can_interface": interface or self.interface},
            "cone_detector": {},
            "path_planner": {},
            "vehicle_controller": {},
        }
        for key in filter(lambda key: key.node, KEYS):
            value = self.value(key.table, key.name)
            assert isinstance(value, (bool, int, float, str)), "others have their own line below"
            found[key.node][key.parameter] = float(value) if isinstance(key.default, float) else value
        for node in ("vcu_bridge", "path_planner", "vehicle_controller"):
            found[node]["car"] = self.car
        found["vcu_bridge"]["wheel_mapping"] = str(self.wheel_mapping)
        found["vcu_bridge"]["dbc_files"] = ",".join(self.dbc_files)
        found["vcu_bridge"]["limits"] = str(self.limits_path or "")
        if self.limits is not None:
            # The controller plans with the speed that the gate will let it have.
            wanted = float(found["vehicle_controller"]["max_speed"])
            lowest = CONTROLLER_RANGES["max_speed_mps"][0]
            found["vehicle_controller"]["max_speed"] = max(lowest, min(wanted, self.limits.max_speed_mps))
        return found

    def environment(self) -> dict[str, str]:
        """Return what ROS 2 reads from a process's environment."""
        found = {"ROS_DOMAIN_ID": self.text("ros", "domain_id"), **_DISCOVERY[self.text("ros", "discovery")]}
        if keystore := self.text("ros", "keystore"):
            found |= {
                "ROS_SECURITY_ENABLE": "true",
                "ROS_SECURITY_STRATEGY": "Enforce",
                "ROS_SECURITY_KEYSTORE": keystore,
            }
        return found

    def described(self) -> tuple[str, ...]:
        """The settings, one line each, and after them the limits: for the screen and beside every log."""
        lines = [f"{key.spelt} = {_shown(self.value(key.table, key.name))}" for key in KEYS]
        return (*lines, *(f"operational limits: {line}" for line in self.limits_described()))

    def limits_described(self) -> tuple[str, ...]:
        if self.limits is not None:
            return self.limits.described()
        car, steer_deg = CARS[self.car], REVISIONS[self.revision].steer_limit_deg  # at most: ANGLE_MAX may be lower
        own = OperationalLimits(round(car.speed_max_mps, 1), car.axle_torque_max_nm, steer_deg)
        return (f"none by an official; the car's own: {', '.join(own.described())}",)


def read_configuration(path: Path | str) -> Configuration:
    """The configuration in `path`, with the operational limits it names. Raises ConfigurationError."""
    path = Path(path)
    try:
        text = read_named(path, SETTINGS_BYTES)
    except PermissionError as error:
        who = "root and the group fsai may: sudo, or once: sudo usermod -aG fsai $USER, and log in again"
        raise ConfigurationError(
            [f"{path}: may not be read by this user{f'; {who}' if path == USUAL_PATH else ''}"]
        ) from error
    except OSError as error:
        raise ConfigurationError([f"{path}: cannot be read: {error.strerror}"]) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError([f"{path}: is not a text file in UTF-8"]) from error
    return parse_configuration(text, path)


def parse_configuration(text: str, path: Path) -> Configuration:
    """Read the configuration as `read_configuration`, of a text as if from `path`."""
    try:
        document = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError([_problem(path, line_of(error), f"not valid TOML: {words_of(error)}")]) from error
    problems: list[tuple[int, str]] = []
    values: dict[tuple[str, str], object] = {}
    lines: TomlLines | None = None  # seldom needed

    def refuse(words: str, *place: str) -> None:
        nonlocal lines
        lines = lines or TomlLines(text)
        line = lines.of(*place)
        problems.append((line or 0, _problem(path, line, words)))

    for table, content in document.items():
        if table not in TABLES:
            refuse(_unknown_at_top(table, content), table)
        elif not isinstance(content, dict):
            refuse(f"{table} is a table: write [{table}], and its settings below it", table)
        else:
            for name, value in content.items():
                key = _BY_PLACE.get((table, name))
                if key is None:
                    refuse(_unknown(table, name), table, name)
                elif problem := key.problem(value):
                    refuse(f"{key.spelt} {problem}", table, name)
                else:
                    values[table, name] = _kept(key, value)
    limits = None
    configuration = Configuration(path, None, values)
    if configuration.limits_path is not None:
        try:
            limits = read_limits(configuration.limits_path)
        except LimitsError as error:
            refuse(f"[limits] file: {error}", "limits", "file")
    for file in configuration.dbc_files:
        if problem := _not_there(file, Path.is_file, f"no such file: {file}"):
            refuse(f"[can] dbc_files: {problem}", "can", "dbc_files")
    keystore = configuration.text("ros", "keystore")
    none = f"no such folder: {keystore}; fsai-vcu enclaves makes one"
    if keystore and (problem := _not_there(keystore, Path.is_dir, none)):
        refuse(f"[ros] keystore: {problem}", "ros", "keystore")
    if problems:
        raise ConfigurationError([words for _, words in sorted(problems)])
    return Configuration(path, limits, values)


def usual_environment(environ: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return what an operator's command needs besides `environ` to reach the car's nodes: nothing without the file.

    What the caller has set goes before the file; a file that cannot be used is somebody else's to complain of. Raises
    ConfigurationError where this user may not read it: the car's nodes would be looked for in the wrong place.
    """
    environ = os.environ if environ is None else environ
    try:
        configured = read_configuration(USUAL_PATH).environment()
    except ConfigurationError as error:
        if isinstance(error.__cause__, PermissionError):
            raise
        return {}
    return {name: value for name, value in configured.items() if name not in environ}


def _problem(path: Path, line: int | None, words: str) -> str:
    return f"{path}: {words}" if line is None else f"{path}, line {line}: {words}"


def _not_there(name: str, is_there: Callable[[Path], bool], words: str) -> str | None:
    try:
        return None if is_there(Path(name)) else words
    except OSError as error:
        return f"{name}: {error.strerror}"


def _kept(key: Key, value: object) -> object:
    if isinstance(key.default, WheelMapping):
        assert isinstance(value, dict), "checked by its key"
        return WheelMapping.of(value)
    return tuple(value) if isinstance(value, list) else value


def _mapping_problem(value: object) -> str | None:
    example = '{ fl = "fr", fr = "fl" }'
    if not isinstance(value, dict):
        return f"must be a table such as {example}, not {_short(value)}"
    for wheel in value:
        if wheel not in WHEELS:
            return f"names a wheel '{wheel}'; the wheels are {', '.join(WHEELS)}"
    try:
        WheelMapping.of(value)
    except ValueError:
        return f"must name each of {', '.join(WHEELS)} once, such as {example}"
    return None


def _unknown(table: str, name: str) -> str:
    here = [key.name for key in KEYS if key.table == table]
    hint = _nearest(name, here)
    if not hint:
        elsewhere = [key.spelt for key in KEYS if key.name == name]
        hint = f"; there is {elsewhere[0]}" if elsewhere else f"; there are {', '.join(here)}"
    return f"[{table}] has no setting '{name}'{hint}"


def _unknown_at_top(name: str, content: object) -> str:
    if isinstance(content, dict):
        return f"there is no table [{name}]{_nearest(name, TABLES) or '; there are ' + ', '.join(TABLES)}"
    places = [key.spelt for key in KEYS if key.name == name]
    if places:
        return f"'{name}' stands outside of its table: it is {places[0]}"
    near = difflib.get_close_matches(name[:_SHORT], [key.name for key in KEYS], 1)
    hint = next(f"; did you mean {key.spelt}?" for key in KEYS if key.name == near[0]) if near else ""
    return f"there is no setting '{name}'{hint}"


def _nearest(name: str, known: tuple[str, ...] | list[str]) -> str:
    near = difflib.get_close_matches(name[:_SHORT].lower(), known, 1)
    return f"; did you mean {near[0]}?" if near else ""


def _short(value: object) -> str:
    """A value that stands in a sentence about it."""
    shown = _shown(value)
    return shown if len(shown) <= 2 * _SHORT else f"{shown[:_SHORT]} …"


def _shown(value: object) -> str:
    """A value as it would stand in the file."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, WheelMapping):
        return "{ " + ", ".join(f'{wheel} = "{value.source_of(wheel)}"' for wheel in WHEELS) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_shown(each) for each in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
