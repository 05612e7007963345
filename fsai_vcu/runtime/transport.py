"""Transport between the project's ROS 2 processes: by UDP on the loopback, never by shared memory.

Fast DDS shares memory between processes unless configured otherwise. A program that joins, hangs or is killed then
holds up the others inside `publish`, and what it leaves locked in /dev/shm outlives it. UDP has neither. Each process
sets this for itself before it initialises ROS 2, so it holds however the process was started.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, MutableMapping
from functools import cache
from importlib import metadata
from itertools import chain
from pathlib import Path
from typing import Final

PROFILE: Final = Path(__file__).with_name("dds_loopback.xml")
_RANGE, _PROFILES, _BUILTIN = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
)
_PROFILES_OF_3: Final = "FASTDDS_DEFAULT_PROFILES_FILE"  # Fast DDS 3 reads this, and its rmw warns of the older name
_RCLPY_ON_3: Final = 9  # rclpy's major version in Kilted, the first distribution on Fast DDS 3
_DOMAIN: Final = "ROS_DOMAIN_ID"
DISTRIBUTIONS: Final = ("jazzy", "humble", "kilted")
"""Distributions of ROS 2 with which the nodes, or their part of its API, were tried; the first is preferred."""
DOMAIN_MAX: Final = 232  # beyond it there are no UDP ports
_FIRST_PORT, _PORTS_OF_A_DOMAIN = 7400, 250  # PB and DG of the RTPS specification (DDSI-RTPS 2.5, 9.6.2.3)
_IMPLEMENTATION, _LOCALHOST_ONLY = "RMW_IMPLEMENTATION", "ROS_LOCALHOST_ONLY"
_FAST_DDS: Final = "rmw_fastrtps_cpp"  # rmw_fastrtps_shared_cpp reads the profile and the variables below

# With any other range than SYSTEM_DEFAULT rmw_fastrtps adds transports of its own, for LOCALHOST shared memory too.
LOOPBACK: Final[Mapping[str, str]] = {_RANGE: "SYSTEM_DEFAULT", _PROFILES: str(PROFILE)}
NETWORKS: Final[Mapping[str, str]] = {_RANGE: "SUBNET", _BUILTIN: "UDPv4"}
# All that choose a transport.
VARIABLES: Final = (_RANGE, _PROFILES, _PROFILES_OF_3, _BUILTIN, _LOCALHOST_ONLY, _IMPLEMENTATION)

_THIS_MACHINE: Final = ("", "LOCALHOST", "SYSTEM_DEFAULT")
_RANGES: Final = ("LOCALHOST", "SUBNET", "SYSTEM_DEFAULT", "OFF")  # rcl takes any other for LOCALHOST


@cache
def profiles_variable() -> str:
    """Return the variable that names a profile to the Fast DDS of the installed rclpy."""
    try:
        newer = int(metadata.version("rclpy").partition(".")[0]) >= _RCLPY_ON_3
    except (metadata.PackageNotFoundError, ValueError):
        newer = False
    return _PROFILES_OF_3 if newer else _PROFILES


def set_transport(environ: MutableMapping[str, str], profiles: str = "") -> str:
    """Put the transport into `environ`, before ROS 2 reads it; one line where it is not the loopback profile, or ''.

    A profile, a transport or a middleware that the operator has chosen holds. ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET
    opens the process to the networks, by UDP alone. Called again it changes nothing. profiles: the variable that
    Fast DDS reads, `profiles_variable()` if empty; a profile named in the older variable moves there.
    """
    profiles = profiles or profiles_variable()
    if profiles != _PROFILES and (named := environ.pop(_PROFILES, "")):
        environ.setdefault(profiles, named)
    implementation = environ.get(_IMPLEMENTATION, "")
    profile = environ.get(profiles, "")
    builtin = environ.get(_BUILTIN, "")
    if implementation not in ("", _FAST_DDS):
        return f"transport: that of {_IMPLEMENTATION}={implementation}, for which no profile is set"
    if profile and profile != str(PROFILE):
        return _own(f"{profiles}={profile}", environ)
    if not profile and builtin:
        return "" if environ.items() >= NETWORKS.items() else _own(f"{_BUILTIN}={builtin}", environ)
    if not profile and environ.get(_RANGE, "") not in _THIS_MACHINE:
        environ[_BUILTIN] = NETWORKS[_BUILTIN]
        return f"transport: UDP, on every network of this machine where {_RANGE}={environ[_RANGE]} says so"
    environ.pop(_LOCALHOST_ONLY, None)  # it would go before the range
    environ.update({_RANGE: LOOPBACK[_RANGE], profiles: str(PROFILE)})
    return ""


def node_ports_taken(domain: int, network: Path = Path("/proc/self/net")) -> bool:
    """Return true where a UDP port of this ROS domain is taken on this machine: by a node, or by something else.

    Every DDS participant binds one, so that a domain without any has no node here; discovery needs time to say that.
    True also where the kernel shows no ports.
    """
    ports = range(_FIRST_PORT + domain * _PORTS_OF_A_DOMAIN, _FIRST_PORT + (domain + 1) * _PORTS_OF_A_DOMAIN)
    tables = [path.read_text() for name in ("udp", "udp6") if (path := network / name).is_file()]
    lines = chain.from_iterable(table.splitlines()[1:] for table in tables)
    return not tables or any(int(line.split()[1].rpartition(":")[2], 16) in ports for line in lines)


def ros_trouble(environ: Mapping[str, str]) -> str:
    """Say in one line why ROS 2 would not start in this environment, or on another domain than was meant; or ''."""
    domain, implementation = environ.get(_DOMAIN, ""), environ.get(_IMPLEMENTATION, "")
    if domain and not (domain.isascii() and domain.isdecimal() and int(domain.lstrip("0")[:9] or 0) <= DOMAIN_MAX):
        return f"{_DOMAIN} is '{domain}', not a number from 0 to {DOMAIN_MAX}"
    if (reach := environ.get(_RANGE, "")) and reach not in _RANGES:
        return f"{_RANGE} is '{reach}', not one of {', '.join(_RANGES)}"
    if implementation:
        try:
            ctypes.CDLL(f"lib{implementation}.so")
        except (OSError, ValueError):
            return f"{_IMPLEMENTATION} is '{implementation}', which is not installed: unset it, or take {_FAST_DDS}"
    return ""


def enclave_words(name: str, environ: Mapping[str, str]) -> list[str]:
    """The ROS arguments with which a process takes the keys of `fsai-vcu enclaves`; none where DDS is not encrypted."""
    return ["--enclave", f"/fsai/{name}"] if environ.get("ROS_SECURITY_ENABLE") == "true" else []


def loopback_environment(environ: Mapping[str, str]) -> dict[str, str]:
    """`environ` for the processes of a rehearsal: the loopback profile, whatever the caller has chosen for himself."""
    return {**{name: value for name, value in environ.items() if name not in VARIABLES}, **LOOPBACK}


def _own(chosen: str, environ: Mapping[str, str]) -> str:
    line = f"transport: {chosen} of the environment holds, not the loopback profile"
    if environ.get(_RANGE) == "LOCALHOST" or environ.get(_LOCALHOST_ONLY) == "1":
        line += "; with the discovery range LOCALHOST shared memory is used all the same"
    return line
