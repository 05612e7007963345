"""Every start mode has the loopback profile, unless the operator has chosen otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest

from fsai_vcu.runtime.transport import (
    LOOPBACK,
    NETWORKS,
    PROFILE,
    loopback_environment,
    node_ports_taken,
    ros_trouble,
    set_transport,
)

# The variables in which versions of Fast DDS look for a profile.
FAST_DDS_2, FAST_DDS_3 = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"


@pytest.mark.parametrize(
    "environ",
    [
        {},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"},
        {"ROS_LOCALHOST_ONLY": "1"},
        {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"},
        {**LOOPBACK, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        {**LOOPBACK, "FASTDDS_BUILTIN_TRANSPORTS": "SHM"},  # the profile has its own transports, and no built-in one
    ],
)
def test_the_loopback_profile_holds_where_nothing_else_is_chosen(environ: dict[str, str]) -> None:
    assert set_transport(environ, FAST_DDS_2) == ""
    assert environ.items() >= LOOPBACK.items() and "ROS_LOCALHOST_ONLY" not in environ
    assert PROFILE.is_file()


@pytest.mark.parametrize(
    ("environ", "words"),
    [
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/home/me/dds.xml"}, "FASTRTPS_DEFAULT_PROFILES_FILE=/home/me/dds.xml of"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA"}, "FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA of"),
    ],
)
def test_what_the_operator_has_chosen_holds_and_is_said(environ: dict[str, str], words: str) -> None:
    before = dict(environ)
    assert words in set_transport(environ, FAST_DDS_2) and environ == before


@pytest.mark.parametrize("name", ["ROS_LOCALHOST_ONLY=1", "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"])
def test_a_choice_that_shared_memory_defeats_is_said_to_be(name: str) -> None:
    variable, _, value = name.partition("=")
    assert "shared memory" in set_transport({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", variable: value})


@pytest.mark.parametrize("set_before", [FAST_DDS_2, FAST_DDS_3])
def test_fast_dds_3_is_told_in_the_variable_that_it_reads(set_before: str) -> None:
    """Its middleware warns on each start where the older variable is set."""
    environ = dict(LOOPBACK)
    for _ in range(2):
        assert set_transport(environ, FAST_DDS_3) == ""
        assert environ == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", FAST_DDS_3: str(PROFILE)}
    chosen = {set_before: "/home/me/dds.xml"}
    assert f"{FAST_DDS_3}=/home/me/dds.xml of" in set_transport(chosen, FAST_DDS_3)
    assert chosen == {FAST_DDS_3: "/home/me/dds.xml"}


def test_subnet_opens_a_process_without_shared_memory() -> None:
    environ = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert "every network" in set_transport(environ)
    assert environ == NETWORKS
    assert set_transport(environ) == "" and environ == NETWORKS, "what the configuration says, too"


def test_a_rehearsal_has_the_loopback_profile_in_any_shell() -> None:
    caller = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", "ROS_LOCALHOST_ONLY": "1", "PATH": "/bin", **NETWORKS}
    assert loopback_environment(caller) == {"PATH": "/bin", **LOOPBACK}


def test_a_udp_port_of_a_domain_is_a_sign_of_its_nodes(tmp_path: Path) -> None:
    (tmp_path / "udp6").write_text("  sl  local_address\n   0: 00000000000000000000000000000000:1CE8 0 07\n")
    for port, taken in ((7649, False), (7650, True), (7899, True), (7900, False)):
        (tmp_path / "udp").write_text(f"  sl  local_address\n 300: 0100007F:{port:04X} 00000000:0000 07\n")
        assert node_ports_taken(1, tmp_path) is taken, port
    assert node_ports_taken(0, tmp_path)  # 7400, of the IPv6 table
    (tmp_path / "udp6").unlink()  # a kernel without IPv6
    assert not node_ports_taken(0, tmp_path)
    (tmp_path / "udp").unlink()
    assert node_ports_taken(0, tmp_path), "a kernel that shows none"


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("ROS_DOMAIN_ID", "000000000999", "not a number from 0 to 232"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "not one of LOCALHOST, SUBNET, SYSTEM_DEFAULT, OFF"),
    ],
)
def test_what_ros_would_take_for_something_else_is_refused(variable: str, value: str, words: str) -> None:
    assert ros_trouble({variable: value}) == f"{variable} is '{value}', {words}"
    assert not ros_trouble({"ROS_DOMAIN_ID": "007", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"})
