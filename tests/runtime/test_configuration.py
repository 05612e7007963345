"""One file configures the whole computer; what is wrong in it is said with file, line and key."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fsai_vcu.cli.main import UserError
from fsai_vcu.cli.services import operator_node
from fsai_vcu.core.limits import LimitsError
from fsai_vcu.runtime import configuration as module
from fsai_vcu.runtime.configuration import (
    KEYS,
    Configuration,
    ConfigurationError,
    parse_configuration,
    read_configuration,
    usual_environment,
)
from fsai_vcu.runtime.limits_file import read_limits
from fsai_vcu.runtime.toml_lines import TomlLines

CHECKOUT = Path(__file__).parents[2]
NAMED = Path("/etc/fsai/fsai.toml")
A_LOOK_S = 20.0  # of the processor: a hundred times what a plain look takes; by powers of the length it is hours


def parsed(text: str) -> Configuration:
    return parse_configuration(text, NAMED)


def problems(text: str) -> tuple[str, ...]:
    with pytest.raises(ConfigurationError) as refused:
        parsed(text)
    return refused.value.problems


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("\n[can]\nrevison = '2026'\n", "line 3: [can] has no setting 'revison'; did you mean revision?"),
        ("[cann]\nrevision = '2026'\n", "line 1: there is no table [cann]; did you mean can?"),
        ("interface = 'can0'\n", "line 1: 'interface' stands outside of its table: it is [can] interface"),
        ("[car]\ninterface = 'can0'\n", "line 2: [car] has no setting 'interface'; there is [can] interface"),
        ("[can]\nrevision = 2026\n", 'line 2: [can] revision must be a text in quotes, such as "2026", not 2026'),
        ("[can]\nrevision = '2062'\n", 'one of 2021, 2026, not "2062"; did you mean 2026?'),
        ("[car]\nautonomous_at_power_up = 'yes'\n", "line 2: [car] autonomous_at_power_up must be true or false"),
        ("[missions]\ntrackdrive_laps = 1.5\n", "line 2: [missions] trackdrive_laps must be a whole number, not 1.5"),
        ("[missions]\ntrackdrive_laps = true\n", "must be a whole number, not true"),
        ("[missions]\nmax_speed_mps = 0.4\n", "line 2: [missions] max_speed_mps must be between 0.5 and 30, not 0.4"),
        ("[missions]\nmax_speed_mps = nan\n", "must be a finite number, not nan"),
        ("[car]\nwheel_mapping = 'fl=fr'\n", "line 2: [car] wheel_mapping must be a table such as { fl"),
        ("[car]\nwheel_mapping = { fl = 'fr' }\n", "line 2: [car] wheel_mapping must name each of fl, fr, rl, rr once"),
        ("[car]\nwheel_mapping = { front = 'fr' }\n", "names a wheel 'front'; the wheels are fl, fr, rl, rr"),
        ("[can]\ndbc_files = 'car.dbc'\n", "line 2: [can] dbc_files must be a list of texts"),
        ("[can]\ndbc_files = ['car.dbc']\n", 'line 2: [can] dbc_files must be a whole path, from / on, not "car.dbc"'),
        ("[can]\ninterface = ''\n", "line 2: [can] interface must be a CAN interface such as can0, or KIND:CHANNEL"),
        ("[can]\ninterface = 'can 0; rm -rf'\n", 'or KIND:CHANNEL, not "can 0; rm -rf"'),
        ("[can]\ninterface = 'sixteen-letters0'\n", "[can] interface must be a CAN interface"),
        ("[can]\ninterface = 'loopback:'\n", "[can] interface must be a CAN interface"),
        ("[limits]\nfile = 'limits.toml'\n", "line 2: [limits] file must be a whole path, from / on"),
        ("[ros]\nkeystore = 'keystore'\n", "line 2: [ros] keystore must be a whole path, from / on"),
        ("[recording]\nfolder = ''\n", 'line 2: [recording] folder must be a whole path, from / on, not ""'),
        ("[recording]\nfolder = 'logs'\n", 'line 2: [recording] folder must be a whole path, from / on, not "logs"'),
        ("[can]\ninterface = can0\n", "line 2: not valid TOML: invalid value"),
        ("car = 3\n", "line 1: car is a table: write [car]"),
    ],
)
def test_what_cannot_be_used_is_refused_with_file_line_and_key(text: str, words: str) -> None:
    (problem,) = problems(text)
    assert problem.startswith(f"{NAMED}, line ")
    assert words in problem


@pytest.mark.parametrize(
    ("table", "setting", "words"),
    [
        ("can", "dbc_files = ['PATH']", "dbc_files: no such file: PATH"),
        ("limits", "file = 'PATH'", "file: cannot read the operational limits PATH"),
        ("ros", "keystore = 'PATH'", "keystore: no such folder: PATH"),
    ],
)
def test_a_path_to_nothing_is_refused_with_file_line_and_key(
    table: str, setting: str, words: str, tmp_path: Path
) -> None:
    path = str(tmp_path / "absent")
    (problem,) = problems(f"[{table}]\n{setting.replace('PATH', path)}\n")
    assert problem.startswith(f"{NAMED}, line 2: [{table}] {words.replace('PATH', path)}")


def test_every_mistake_is_told_at_once_in_the_order_of_the_lines() -> None:
    told = problems("[missions]\nmax_speed_mps = 99\n[can]\nx = 1\n[car]\nservice_brake = 'anchor'\n")
    assert [words.split(":")[0] for words in told] == [f"{NAMED}, line {line}" for line in (2, 4, 6)]
    with pytest.raises(ConfigurationError, match=r"and 2 more: fsai-vcu config check shows all"):
        parsed("[missions]\nmax_speed_mps = 99\n[can]\nx = 1\n[car]\nservice_brake = 'anchor'\n")


@pytest.mark.parametrize("name", ["can0", "vcan0", "can-front_1.2", "fifteen_letters", "loopback:a", "pcan:1"])
def test_an_interface_of_linux_or_a_kind_and_channel_is_taken(name: str) -> None:
    assert parsed(f"[can]\ninterface = '{name}'\n").interface == name


@contextmanager
def somebody_else() -> Iterator[None]:
    """Root may read everything: as root, for once as nobody."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[Path]:
    """A folder into which nobody may look."""
    folder = tmp_path / "locked"
    folder.mkdir()
    (folder / "fsai.toml").write_text("[ros]\ndomain_id = 9\n")
    folder.chmod(0o000)
    yield folder
    folder.chmod(0o700)


def test_an_unreadable_configuration_is_an_error_with_its_remedy(locked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with somebody_else(), pytest.raises(ConfigurationError, match=r"toml: may not be read by this user$"):
        read_configuration(locked / "fsai.toml")
    monkeypatch.setattr(module, "USUAL_PATH", locked / "fsai.toml")
    way_out = (
        r"fsai\.toml: may not be read by this user; .*: sudo, or once: sudo usermod -aG fsai \$USER, and log in again"
    )
    with somebody_else(), pytest.raises(ConfigurationError, match=way_out):
        usual_environment({})
    with somebody_else(), pytest.raises(UserError, match=way_out), operator_node():
        raise AssertionError("looked for the nodes in the wrong place")


def test_a_path_without_access_is_refused_like_a_missing_one(locked: Path) -> None:
    with somebody_else():
        (problem,) = problems(f"[ros]\nkeystore = '{locked}/keystore'\n")
    assert problem == f"{NAMED}, line 2: [ros] keystore: {locked}/keystore: Permission denied"


def test_a_missing_file_or_one_that_is_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"absent\.toml: cannot be read: No such file"):
        read_configuration(tmp_path / "absent.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigurationError, match="is not a text file"):
        read_configuration(tmp_path / "bytes.toml")


def unusable() -> dict[str, str]:
    """Texts that a small file can hold and a careless reader is lost in."""
    return {
        "deep lists": "x = " + "[" * 30_000 + "]" * 30_000,
        "deep tables": "x = " + "{a = " * 10_000 + "1" + "}" * 10_000,
        "a deep key": ".".join("a" * 30_000) + " = 1\n",
        "a deep quoted key": '"a" . ' * 10_000 + "b = 1\n",
        "digits": "x = " + "9" * 60_000,
        "hexadecimal digits": "x = 0x" + "f" * 60_000,
        "an open list": "x = [" + "1,\n" * 20_000,
        "an open text": 'x = """' + "a\n" * 30_000,
        "an invalid date": "x = 1979-02-30\n",
    }


@pytest.mark.parametrize("what", sorted(unusable()))
def test_a_text_in_which_a_reader_is_lost_is_refused(what: str, tmp_path: Path) -> None:
    path = tmp_path / "given.toml"
    path.write_text(unusable()[what])
    began_s = time.process_time()
    with pytest.raises(ConfigurationError, match=r"given\.toml.*: not valid TOML: "):
        read_configuration(path)
    with pytest.raises(LimitsError, match=r"given\.toml.* not valid TOML: "):
        read_limits(path)
    assert time.process_time() - began_s < A_LOOK_S


@pytest.mark.parametrize(
    "text",
    ["".join(f"key{n} = 1\n" for n in range(5000)), "[can]\nrevision = [\n" + "'a',\n" * 10_000 + "]\n"],
    ids=["many keys", "a long list"],
)
def test_the_lines_of_many_mistakes_are_found_in_one_look(text: str) -> None:
    began_s = time.process_time()
    found = problems(text)
    assert time.process_time() - began_s < A_LOOK_S
    assert all(len(problem) < 300 for problem in found)
    assert f"line {2 if text.startswith('[') else 1}: " in found[0]


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/full"])
def test_a_device_is_no_configuration_and_no_limits(path: str) -> None:
    with pytest.raises(ConfigurationError, match="it is a device, not a file"):
        read_configuration(path)
    with pytest.raises(LimitsError, match=rf"cannot read the operational limits {path}: it is a device, not a file"):
        read_limits(path)


def test_a_pipe_and_a_large_file_are_no_limits(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LimitsError, match="it is a pipe, not a file"):
        read_limits(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(LimitsError, match="it is larger than 64 KiB"):
        read_limits(tmp_path / "large")


def test_an_empty_file_is_the_defaults_and_every_key_can_be_said() -> None:
    assert parsed("").interface == "can0"
    assert len(parsed("").described()) == len(KEYS) + 1
    assert len({(key.table, key.name) for key in KEYS}) == len(KEYS)


def test_what_is_shown_of_a_setting_can_stand_in_the_file() -> None:
    configuration = parsed('[car]\nwheel_mapping = { fl = "fr", fr = "fl" }\n[can]\ndbc_files = []\n')
    for line in configuration.described()[: len(KEYS)]:
        table, setting = line.split(" ", 1)
        again = parsed(f"{table}\n{setting}\n")
        key = table[1:-1], setting.split(" = ")[0]
        assert again.value(*key) == configuration.value(*key), line


def test_the_installed_configuration_is_valid(tmp_path: Path) -> None:
    text = (CHECKOUT / "systemd" / "etc" / "fsai.toml").read_text()
    limits = CHECKOUT / "systemd" / "etc" / "limits.toml"
    configuration = parsed(text.replace("/etc/fsai/limits.toml", str(limits)))
    assert configuration.value("car", "autonomous_at_power_up") is True  # no link to the car in staging
    assert configuration.limits == read_limits(limits)
    assert configuration.limits_path == limits
    assert configuration.text("ros", "discovery") == "localhost"


def test_settings_become_the_parameters_of_their_nodes() -> None:
    found = parsed(
        "[can]\ninterface='can7'\nrevision='2021'\nlisten_only=true\n[missions]\ntrackdrive_laps=3\nmax_speed_mps=4\n"
        "lap_max_speed_mps=3.5\nrace_max_speed_mps=3.7\nskidpad_max_speed_mps=3\nacceleration_max_speed_mps=2.5\n"
        "[car]\nwheel_mapping={fl='fr',fr='fl'}\n[perception]\nrange_max_m=11\n"
    ).parameters()
    assert found["vcu_bridge"]["can_interface"] == "can7"
    assert found["vcu_bridge"]["revision"] == "2021" and found["vcu_bridge"]["listen_only"] is True
    assert found["vcu_bridge"]["wheel_mapping"] == "fl=fr,fr=fl,rl=rl,rr=rr"
    assert (found["path_planner"]["laps"], found["path_planner"]["range_max_m"]) == (3, 11.0)
    names = ("max_speed", "lap_max_speed", "race_max_speed", "skidpad_max_speed", "acceleration_max_speed")
    assert [found["vehicle_controller"][name] for name in names] == [4.0, 3.5, 3.7, 3.0, 2.5]
    assert {found[node]["car"] for node in ("vcu_bridge", "path_planner", "vehicle_controller")} == {"2021"}


def test_a_service_is_told_its_own_interface() -> None:
    assert parsed("").parameters("vcan0")["vcu_bridge"]["can_interface"] == "vcan0"


@pytest.mark.parametrize(("limit", "speed"), [("3.5", 3.5), ("12", 6.0), ("0.1", 0.5)])
def test_the_controller_plans_with_the_speed_limit(limit: str, speed: float, tmp_path: Path) -> None:
    (tmp_path / "limits.toml").write_text(f"max_speed_mps = {limit}\n")
    configuration = parsed(f"[limits]\nfile = '{tmp_path}/limits.toml'\n[missions]\nmax_speed_mps = 6\n")
    controller = configuration.parameters()["vehicle_controller"]
    assert controller["max_speed"] == speed


def test_the_limits_in_force_are_confirmed_with_the_settings(tmp_path: Path) -> None:
    (tmp_path / "limits.toml").write_text("max_steer_deg = 12\n")
    described = parsed(f"[limits]\nfile = '{tmp_path}/limits.toml'\n").described()
    assert "operational limits: max_steer_deg = 12" in described


@pytest.mark.parametrize(("revision", "steer_deg"), [("2021", 21), ("2026", 30)])
def test_without_official_limits_the_cars_own_are_told(revision: str, steer_deg: int) -> None:
    last = parsed(f"[can]\nrevision = '{revision}'\n").described()[-1]
    own = f"max_speed_mps = 30.3, max_axle_torque_nm = 195, max_steer_deg = {steer_deg}"
    assert last == f"operational limits: none by an official; the car's own: {own}"


def test_a_wrong_limit_is_refused_with_its_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "limits.toml"
    file.write_text("# venue\nmax_speed_mps = 5\nmax_sped_mps = 3\n")
    with pytest.raises(LimitsError, match=rf"{file}, line 3: unknown limit max_sped_mps"):
        read_limits(file)
    file.write_text("max_speed_mps = 'slow'\n")
    with pytest.raises(LimitsError, match=r"line 1: max_speed_mps is 'slow'"):
        read_limits(file)
    file.write_text("max_speed_mps = 5\nmax_steer_deg = \n")
    with pytest.raises(LimitsError, match=r"line 2 are not valid TOML: invalid value"):
        read_limits(file)


def test_dds_stays_on_this_machine_unless_configured(tmp_path: Path) -> None:
    environment = parsed("[ros]\ndomain_id = 42\n").environment()
    assert environment["ROS_DOMAIN_ID"] == "42"
    profile = Path(environment["FASTRTPS_DEFAULT_PROFILES_FILE"])
    assert "<address>127.0.0.1</address>" in profile.read_text()
    opened = parsed(f"[ros]\ndiscovery = 'subnet'\nkeystore = '{tmp_path}'\n").environment()
    assert opened["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET" and "FASTRTPS_DEFAULT_PROFILES_FILE" not in opened
    assert opened["ROS_SECURITY_STRATEGY"] == "Enforce" and opened["ROS_SECURITY_KEYSTORE"] == str(tmp_path)


def test_the_callers_environment_precedes_the_configured_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "fsai.toml"
    monkeypatch.setattr(module, "USUAL_PATH", file)
    assert usual_environment({}) == {}
    file.write_text("[ros]\ndomain_id = 400\n")
    assert usual_environment({}) == {}
    file.write_text("[ros]\ndomain_id = 9\n")
    assert usual_environment({})["ROS_DOMAIN_ID"] == "9"
    assert "ROS_DOMAIN_ID" not in usual_environment({"ROS_DOMAIN_ID": "3"})


def test_a_key_is_found_on_its_line_whatever_stands_around_it() -> None:
    text = (
        '# [can]\n\n[ can ] # the bus\n"interface" = "a"\ndbc_files = [\n  "x = 1",\n]\ntext = """\n[car]\nq = 1\n"""\n'
    )
    text += "[car]\nwheel_mapping = { fl = 'fr' }\nnested.key = 1\n"
    lines = TomlLines(text)
    assert (lines.of("can"), lines.of("can", "interface"), lines.of("can", "dbc_files")) == (3, 4, 5)
    assert (lines.of("car"), lines.of("car", "wheel_mapping"), lines.of("car", "wheel_mapping", "fl")) == (12, 13, 13)
    assert lines.of("car", "nested", "key") == 14
    assert lines.of("car", "q") == 12 and lines.of("nothing") is None


def test_every_node_takes_its_parameters_of_an_empty_file() -> None:
    pytest.importorskip("rclpy", reason="rclpy is not installed (pip install 'fsai-vcu[ros]')")
    import sys

    sys.path.insert(0, str(CHECKOUT / "nodes" / "fsai_nodes"))
    from fsai_nodes import cone_detector, path_planner, vcu_bridge, vehicle_controller

    tables = {
        each.__name__.rpartition(".")[2]: {setting.name: setting for setting in each.SETTINGS}
        for each in (cone_detector, path_planner, vcu_bridge, vehicle_controller)
    }
    for node, values in parsed("").parameters().items():
        for name, value in values.items():
            assert tables[node][name].problem(value) is None, f"{node} refuses its {name}"
